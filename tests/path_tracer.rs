//! The path tracer, which other tests take for the truth, against closed forms.

mod closed_forms;
mod tracer;

use closed_forms::{parallel, perpendicular};
use glam::{DVec2, DVec3};
use tracer::{Bounces, Estimate, Receiver, Room};

fn grid(normal: DVec3, place: impl Fn(DVec2) -> DVec3) -> Vec<Receiver> {
    let at = |k: usize| DVec2::new(0.05 + 0.3 * (k % 4) as f64, 0.05 + 0.3 * (k / 4) as f64);
    (0..16)
        .map(|k| Receiver {
            place: place(at(k)),
            normal,
        })
        .collect()
}

/// Errors of the estimates in units of their own standard errors, and relative to the truth.
fn errors(found: &[Estimate], truth: impl Fn(usize) -> f64) -> (f64, f64) {
    let n = found.len() as f64;
    let mut sums = (0.0, 0.0);
    for (k, e) in found.iter().enumerate() {
        let off = e.irradiance.x - truth(k);
        // Bits that repeat exactly leave an error of rounding.
        sums.0 += (off / e.error.x.max(1e-9)).powi(2) / n;
        sums.1 += (off / truth(k)).powi(2) / n;
    }
    (sums.0.sqrt(), sums.1.sqrt())
}

#[test]
fn plates() {
    let upper = grid(DVec3::NEG_Y, |p| DVec3::new(p.x, 1.0, p.y));
    let wall = grid(DVec3::Z, |p| DVec3::new(p.x, p.y, 0.0));
    for (name, receivers) in [("plates_parallel", upper), ("plates_perpendicular", wall)] {
        let found = Room::load(name).irradiance(&receivers, Bounces::All, 1 << 16);
        let (sigmas, relative) = errors(&found, |k| {
            let p = receivers[k].place;
            match name {
                "plates_parallel" => parallel(DVec2::new(p.x, p.z)),
                _ => perpendicular(DVec2::new(p.x, p.y)),
            }
        });
        println!("{name}: off by {relative:.1e}, {sigmas:.2} standard errors");
        assert!(sigmas < 1.6 && relative < 5e-3);
    }
}

/// Radiosity 1 / (1 - reflectance), and so irradiance, whatever the number of bounces that takes.
#[test]
fn furnaces() {
    let receivers: Vec<Receiver> = grid(DVec3::Z, |p| DVec3::new(p.x, 1.0, p.y))
        .iter()
        .map(|r| r.place.normalize())
        .map(|out| Receiver {
            place: out,
            normal: -out,
        })
        .collect();
    for (shape, reflectance) in [
        (
            "sphere = { centre = [0, 0, 0], radius = 1, inward = true }",
            0.5,
        ),
        (
            "sphere = { centre = [0, 0, 0], radius = 1, inward = true }",
            0.9,
        ),
        (
            "box = { centre = [0, 0, 0], size = [3, 4, 5], rotate = [9, 8, 7], inward = true }",
            0.9,
        ),
    ] {
        let text = format!("[[shape]]\n{shape}\nreflectance = {reflectance}\nemission = 1");
        let found = Room::read(&text).irradiance(&receivers, Bounces::All, 1 << 16);
        let (sigmas, relative) = errors(&found, |_| 1.0 / (1.0 - reflectance));
        println!("{text}: off by {relative:.1e}, {sigmas:.2} standard errors");
        // The box is its own lamp: samples from corner to corner have heavy tails.
        assert!(sigmas < 1.6 && relative < 0.03);
    }
}
