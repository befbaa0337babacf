//! Form factors in closed form, after J. R. Howell, A Catalog of Radiation Heat Transfer Configuration
//! Factors.

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
