//! The operator by brute force: what every faster way is timed against.

use crate::error::Result;
use crate::expansion::Surface;
use crate::math::Real;
use crate::operator::{HostFields, TransportOperator};
use crate::passes::cpu::all_pairs;
use crate::points::Surfels;

/// All pairs by the point kernel, in the instructions of P2P: nothing stands in the way, and pairs
/// near each other are left out. For exact values see [`Direct`](super::Direct).
pub struct AllPairs<T: Real> {
    surface: Surface<T>,
    fields: HostFields<T>,
}

impl<T: Real> AllPairs<T> {
    pub fn new(surfels: &Surfels) -> Self {
        AllPairs {
            surface: Surface::new(surfels),
            fields: HostFields::default(),
        }
    }
}

impl<T: Real> TransportOperator for AllPairs<T> {
    type Fields = HostFields<T>;

    fn fields(&self) -> &HostFields<T> {
        &self.fields
    }

    fn apply(&self, radiosity: &Vec<T::Vec3>) -> Result<Vec<T::Vec3>> {
        Ok(all_pairs(&self.surface, radiosity))
    }
}
