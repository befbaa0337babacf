//! Form factors in closed form, after J. R. Howell, A Catalog of Radiation Heat Transfer Configuration
//! Factors.
#![allow(dead_code)]

use glam::DVec2;

/// Form factor from an element to a rectangle in a parallel plane at distance 1, one corner above
/// the element and the opposite one at (x, y) from there (Howell, B-3).
fn parallel_corner(x: f64, y: f64) -> f64 {
    let (a, b) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
    (x / a * (y / a).atan() + y / b * (x / b).atan()) / std::f64::consts::TAU
}

/// From a place in the unit square to the facing one at distance 1.
pub fn parallel(p: DVec2) -> f64 {
    [p.x, 1.0 - p.x]
        .iter()
        .flat_map(|&x| [p.y, 1.0 - p.y].map(|y| parallel_corner(x, y)))
        .sum()
}

/// Form factor from an element at distance c from a perpendicular rectangle of depth 1, whose
/// width runs from the element's foot to b (Howell, B-4).
fn perpendicular_corner(c: f64, b: f64) -> f64 {
    if b == 0.0 {
        return 0.0;
    }
    let (x, y) = (1.0 / b, c / b);
    let d = (x * x + y * y).sqrt();
    ((1.0 / y).atan() - y / d * (1.0 / d).atan()) / std::f64::consts::TAU
}

/// From a place at height `p.y` of the unit wall, `p.x` along the edge, to the unit floor.
pub fn perpendicular(p: DVec2) -> f64 {
    perpendicular_corner(p.y, p.x) + perpendicular_corner(p.y, 1.0 - p.x)
}

/// From an element to a disc of radius r in a parallel plane at distance h, whose axis passes the
/// element at distance a (B-13).
pub fn element_to_disc(a: f64, h: f64, r: f64) -> f64 {
    // With lengths squared instead of Z and R, so that a may be 0.
    let sum = a * a + h * h + r * r;
    0.5 * (1.0 - (sum - 2.0 * r * r) / (sum * sum - 4.0 * a * a * r * r).sqrt())
}

/// From a disc of radius r1 to a coaxial parallel one of radius r2 at distance h (C-41).
pub fn disc_to_disc(r1: f64, r2: f64, h: f64) -> f64 {
    let x = 1.0 + (h * h + r2 * r2) / (r1 * r1);
    0.5 * (x - (x * x - 4.0 * (r2 / r1).powi(2)).sqrt())
}

/// From an element to a sphere of radius r that its plane does not cut; the centre is at height h
/// over the plane, and its foot at distance a from the element (B-38).
pub fn element_to_sphere(a: f64, h: f64, r: f64) -> f64 {
    r * r * h / (a * a + h * h).powf(1.5)
}

/// From a sphere to a coaxial disc of radius r whose plane is at distance h from the centre
/// (C-109).
pub fn sphere_to_disc(r: f64, h: f64) -> f64 {
    0.5 * (1.0 - h / h.hypot(r))
}
