//! Surfaces close to each other: walls, plates, open books. Lengths are in spacings.

use glam::{DVec3, Vec3};

use crate::clouds::{joined, moved, rotation};
use crate::harness::*;
use crate::rooms::{Rect, Sampling, inside_of, points, rect};

const NO_WALL: &str = "Two sides at one place are no wall: cells end where they meet, and some light comes through. Exact sums \
    are off by 27% there, and so are close pairs beside rays; what links find is smoothed, and stays within 3%.";

/// A dark room beside a lit one, turned out of the axes. What the lit room has alone is the truth of
/// its points, and no light that of the others.
pub fn walls() -> Vec<Case> {
    const ROOM: f64 = 9.0;
    let wall = |thickness: f64| {
        let room = |x: f64| inside_of(DVec3::X * x, DVec3::splat(ROOM));
        let mut lit = points(&room(0.0), 1.0, Sampling::Strata, 1);
        for (p, e) in lit.positions.iter().zip(&mut lit.emission) {
            if p.z == ROOM {
                *e = Vec3::ONE;
            }
        }
        let dark = points(&room(ROOM + thickness), 1.0, Sampling::Strata, 2);
        let mut truth = sums(&lit);
        truth.resize(lit.len() + dark.len(), 0.0);
        let both = moved(&joined([lit, dark]), rotation(3), 1.0, DVec3::ZERO);
        let name = format!("a wall of {thickness} spacings");
        let case = Case::new(name, both, Truth::Known(truth));
        if thickness > 0.25 {
            return case;
        }
        let case = case.but(Way::Classic, Within(0.08)).remedy(NO_WALL);
        match thickness > 0.0 {
            true => case,
            false => case.but(Way::Direct, Within(0.3)).but(Way::Gather, NotMet),
        }
    };
    [5.0, 2.0, 1.0, 0.5, 0.25, 0.0].map(wall).into()
}

fn black(r: Rect) -> Rect {
    Rect {
        reflectance: 0.0,
        ..r
    }
}

/// One of two black rectangles shines; the other has the light of its form factors.
fn pair(name: String, lamp: Rect, other: Rect, truth: impl Fn(DVec3, DVec3) -> f64) -> Case {
    let lamp = Rect {
        emission: 1.0,
        ..black(lamp)
    };
    let all = points(&[lamp, black(other)], 1.0, Sampling::Strata, 1);
    let light = |k: usize| match all.emission[k].x > 0.0 {
        true => f64::NAN,
        false => truth(all.positions[k], all.normals[k].as_dvec3()),
    };
    let truth = (0..all.len()).map(light).collect();
    Case::new(name, all, Truth::Known(truth))
}

pub fn plates() -> Vec<Case> {
    let lower = rect(DVec3::ZERO, DVec3::X * 20.0, DVec3::Y * 20.0);
    let plates = |gap: f64| {
        let upper = rect(DVec3::Z * gap, DVec3::Y * 20.0, DVec3::X * 20.0);
        let light = |p, n| lower.form_factor(p, n);
        pair(format!("plates {gap} spacings apart"), lower, upper, light)
    };
    let mut cases: Vec<Case> = [3.0, 1.0, 0.5, 0.2, 0.1, 0.01].map(plates).into();
    let on_it = rect(DVec3::ZERO, DVec3::Y * 20.0, DVec3::X * 20.0);
    let contact = pair("a plate on the other".into(), lower, on_it, |_, _| 0.0);
    cases.push(contact.expect(Within(0.0)).remedy(CONTACT));
    cases
}

const CONTACT: &str =
    "A plate that lies on another gets no light from it, one that is 0.01 spacings off all of it.";

const CREASE: &str =
    "The first row of points beside the crease is off by up to 7%: cells are cut off between them.";

/// Two leaves of a book, which see each other the more grazingly the wider it is open.
pub fn books() -> Vec<Case> {
    let floor = rect(DVec3::ZERO, DVec3::X * 20.0, DVec3::Y * 20.0);
    let book = |degrees: f64| {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        let leaf = rect(
            DVec3::ZERO,
            DVec3::Y * 20.0,
            DVec3::new(cosine, 0.0, sine) * 20.0,
        );
        let name = format!("a book open by {degrees} degrees");
        let case = pair(name, floor, leaf, |p, n| floor.form_factor(p, n)).expect(Within(0.045));
        case.but(Way::Classic, Within(0.06)).remedy(CREASE)
    };
    [90.0, 150.0, 170.0, 178.0, 179.9].map(book).into()
}
