//! Random numbers that depend on what they are for, not on threads or order.

use glam::Vec3;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// What a stream of random numbers is for.
#[derive(Clone, Copy)]
pub(crate) enum Purpose {
    SelectLinks = 1,
    MeasureLinks,
    Sky,
    Emitters,
    /// Fields, rows and senders that an operator is checked with.
    CheckFields,
    CheckRows,
    CheckEnergy,
    Rays,
    /// Orders in which points are thinned out, rays that find the lit side of a surface or what is
    /// buried.
    Thin,
    Sides,
    Buried,
    Errors,
    Mesh,
    /// Receivers that a solution is verified at, and what is drawn for them.
    Verify,
    /// Light of parts of a cloud, whose differences are the error of the model.
    Model,
    /// Pairs of points that a plan looks at.
    Sketch,
    /// Order in which surfels are fitted, and planes that are tried for them.
    Fit,
    /// Rays that find holes.
    Holes,
}

/// The stream of one item: a surfel, or a pair of facets in one number.
pub(crate) fn stream(seed: u64, purpose: Purpose, item: u64) -> Pcg64Mcg {
    let key = mixed(seed ^ mixed(purpose as u64));
    Pcg64Mcg::seed_from_u64(mixed(key ^ item))
}

/// Spreads every bit over all (the finaliser of SplitMix64: Steele, Lea and Flood 2014).
fn mixed(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// A sequence in the unit square. Its first 2ᵏ points are stratified, and so is every other run of
/// 2ᵏ that begins at a multiple of 2ᵏ: in each rectangle of area 2⁻ᵏ, halved from the square, there
/// is one. (The first two dimensions of Sobol's sequence with Owen's scrambling, by hashing: Burley
/// 2020, "Practical hash-based Owen scrambling"; the hash is that of Vegdahl 2021.)
pub(crate) struct Stratified([u32; 2]);

impl Stratified {
    pub fn new(random: &mut impl Rng) -> Stratified {
        Stratified([random.next_u32(), random.next_u32()])
    }

    pub fn get(&self, k: u32) -> [f32; 2] {
        let second = (0..u32::BITS - k.leading_zeros())
            .fold((0, 1 << 31), |(x, column), bit| {
                let x = if k >> bit & 1 == 1 { x ^ column } else { x };
                (x, column ^ column >> 1)
            })
            .0;
        [
            scrambled(k, self.0[0]),
            scrambled(u32::reverse_bits(second), self.0[1]),
        ]
    }
}

/// The number in [0, 1) whose binary digits are those of `x`, read from the last one, each flipped
/// or not as those before it decide.
fn scrambled(mut x: u32, seed: u32) -> f32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul(seed >> 16 | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    // As many digits as f32 has.
    (x.reverse_bits() >> 8) as f32 * (-24f32).exp2()
}

/// Cosine-weighted direction about `normal` for (u, v) in the unit square (Malley's method).
pub(crate) fn cosine_direction(normal: Vec3, tangent: Vec3, u: f32, v: f32) -> Vec3 {
    let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
    let radius = u.sqrt();
    tangent * (radius * cos)
        + normal.cross(tangent) * (radius * sin)
        + normal * (1.0 - u).max(0.0).sqrt()
}
