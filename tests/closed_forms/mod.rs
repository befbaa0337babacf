//! Form factors in closed form, after J. R. Howell, A Catalog of Radiation Heat Transfer Configuration
//! Factors.
#![allow(dead_code)]

#[allow(unused_imports)]
pub use fmmgi_gpu::chart::closed_forms::{parallel, perpendicular};

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
