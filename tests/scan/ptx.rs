//! PTX: grids with poses.

use glam::{DMat4, DQuat, DVec3, EulerRot};
use proptest::prelude::*;

use super::*;

/// A grid of `columns` by `rows`; points beyond are directions without a return.
fn grid(pose: DMat4, columns: usize, points: &[DVec3], colour: bool) -> String {
    let rows = points.len().div_ceil(columns);
    let mut text = format!("{columns}\n{rows}\n");
    let place = pose.w_axis;
    text += &format!("{} {} {}\n", place.x, place.y, place.z);
    for axis in [pose.x_axis, pose.y_axis, pose.z_axis] {
        text += &format!("{} {} {}\n", axis.x, axis.y, axis.z);
    }
    for axis in pose.to_cols_array_2d() {
        text += &format!("{} {} {} {}\n", axis[0], axis[1], axis[2], axis[3]);
    }
    for i in 0..columns * rows {
        let p = points.get(i).copied().unwrap_or(DVec3::ZERO);
        text += &format!("{} {} {} 0.5", p.x, p.y, p.z);
        text += if colour { " 255 0 188\n" } else { "\n" };
    }
    text
}

fn pose() -> impl Strategy<Value = DMat4> {
    let angles = [-3.0..3.0f64, -1.5..1.5, -3.0..3.0];
    let place = [1.0..1e6f64, -1e6..1e6, -1e3..1e3];
    (angles, place).prop_map(|([a, b, c], place)| {
        DMat4::from_rotation_translation(
            DQuat::from_euler(EulerRot::XYZ, a, b, c),
            DVec3::from(place),
        )
    })
}

fn places() -> impl Strategy<Value = Vec<DVec3>> {
    let place = [0.1..50f64, -50.0..50.0, -50.0..50.0].prop_map(DVec3::from);
    prop::collection::vec(place, 1..40)
}

proptest! {
    #[test]
    fn grids_are_turned_by_their_poses(
        grids in prop::collection::vec((pose(), places(), 1..5usize), 1..4),
        colour in any::<bool>(),
    ) {
        let texts = grids.iter().map(|(pose, points, columns)| grid(*pose, *columns, points, colour));
        let text: String = texts.collect();
        let cloud = read(text.as_bytes()).unwrap();
        let expected: Vec<DVec3> = grids
            .iter()
            .flat_map(|(pose, points, _)| points.iter().map(|&p| pose.transform_point3(p)))
            .collect();
        prop_assert_eq!(&cloud.positions, &expected);
        let mut begin = 0;
        for ((pose, points, _), scanner) in grids.iter().zip(&cloud.scanners) {
            prop_assert_eq!(scanner.position, pose.w_axis.truncate());
            prop_assert_eq!(&scanner.points, &(begin..begin + points.len()));
            begin += points.len();
        }
        prop_assert_eq!(cloud.scanners.len(), grids.len());
        let white = if colour { 0.9 } else { 0.5 };
        prop_assert!(cloud.reflectance.iter().all(|r| r.x == white));
        let columns = grids.iter().map(|(_, points, columns)| points.len().next_multiple_of(*columns));
        let left_out = columns.sum::<usize>() - expected.len();
        let told = (left_out > 0).then(|| format!("{left_out} directions without a return left out"));
        prop_assert_eq!(cloud.repairs, told.into_iter().collect::<Vec<_>>());
    }

    #[test]
    fn damaged_files_do_no_harm(
        pose in pose(),
        points in places(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = grid(pose, 3, &points, true).repeat(2).into_bytes();
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        sound(&bytes, "ptx");
    }
}

#[test]
fn what_is_wrong_is_told() {
    let whole = grid(DMat4::IDENTITY, 2, &[DVec3::ONE; 6], false);
    for (from, to, expected) in [
        (
            "2\n3\n",
            "2\n4\n",
            "cut short: it ends after 6 of the 8 points of grid 1",
        ),
        (
            "2\n3\n",
            "2\n99999999999999\n",
            "line 2: a grid of 2 by 99999999999999 is too large",
        ),
        (
            "2\n3\n",
            "2\n-3\n",
            "line 2: \"-3\" is no number (columns or rows of a grid)",
        ),
        (
            "2\n3\n0",
            "2\n3\nnan",
            "line 3: \"nan\" is no number (header of a grid)",
        ),
        (
            "1 1 1 0.5\n",
            "1 1\n",
            "line 11: a point has 3, 4 or 7 values",
        ),
        (
            "1 1 1 0.5\n",
            "1 1 one\n",
            "line 11: \"one\" is no number (z)",
        ),
        ("1 1 1 0.5\n", "0 0 0 0.5\n", "empty cloud"),
    ] {
        let message = error_named(whole.replace(from, to).as_bytes(), "ptx");
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
    let message = error_named(&whole.repeat(2).as_bytes()[..whole.len() + 4], "ptx");
    assert!(
        message.contains("ends in the header of a grid"),
        "{message}"
    );
}
