//! Random and damaged files: an error or a sound cloud, never a panic.

use glam::Vec3;
use proptest::prelude::*;

use super::*;

proptest! {
    #[test]
    fn random_bytes_do_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = read(&[b"ply\n".to_vec(), bytes].concat());
    }

    #[test]
    fn random_headers_do_no_harm(
        lines in prop::collection::vec("(element|property|format|comment|list| |\n|vertex|x|y|z|uchar|float|double|ascii|binary_little_endian|1\\.0|[0-9]{1,22}|-1|end_header\n){1,8}", 0..12),
        body in prop::collection::vec(any::<u8>(), 0..64),
    ) {
        let header = format!("ply\nformat ascii 1.0\n{}\n", lines.join("\n"));
        let _ = read(&[header.into_bytes(), body].concat());
    }

    #[test]
    fn mutated_files_do_no_harm(
        kind in 0..3,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        length in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let mut bytes = match kind {
            0 => rich_binary(false),
            1 => rich_binary(true),
            _ => two_points("property list uchar float l\nproperty float nx\n", "2 3 4 5", "0 6"),
        };
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        if cut {
            bytes.truncate(length.index(bytes.len()));
        }
        // Whatever comes out fits together.
        if let Ok(cloud) = read(&bytes) {
            let n = cloud.len();
            prop_assert!(n > 0 && cloud.reflectance.len() == n && cloud.emission.len() == n);
            let zero_to_one = |r: &Vec3| r.cmpge(Vec3::ZERO).all() && r.cmple(Vec3::ONE).all();
            prop_assert!(cloud.reflectance.iter().all(zero_to_one));
        }
    }
}
