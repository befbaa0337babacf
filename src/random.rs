//! Random numbers that depend on what they are for, not on threads or order.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

/// What a stream of random numbers is for.
#[derive(Clone, Copy)]
pub(crate) enum Purpose {
    SelectLinks = 1,
    MeasureLinks,
    Sky,
    Emitters,
    Checks,
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
