//! The transport operator F: radiosity in, irradiance out. The one seam between ways to apply it
//! (here exact sums and links with expansions) and those who use it (solver, relighting).

mod all_pairs;
mod direct;
mod fields;
mod fmm;
mod gpu;
mod gpu_fields;
mod hausner;
mod sampled;
mod trial;

pub use all_pairs::AllPairs;
pub use direct::{Direct, exact_irradiance, exact_irradiances};
pub use fields::{Fields, HostFields};
pub use fmm::{Fmm, GreyFmm};
pub use gpu::GpuFmm;
pub use gpu_fields::GpuFields;
pub use hausner::Hausner;
pub use sampled::{Draw, Sampler};
pub use trial::trial;

use crate::error::Result;

/// Applies H = F B, with H_i = Σ_j F_ij V_ij B_j. Visibility was found when the operator was made,
/// so that every bounce and every light can use it again.
pub trait TransportOperator {
    /// Where its fields live and how to calculate with them.
    type Fields: Fields;

    /// Arithmetic on the fields that it applies to.
    fn fields(&self) -> &Self::Fields;

    /// Irradiance from radiosity.
    fn apply(
        &self,
        radiosity: &<Self::Fields as Fields>::Field,
    ) -> Result<<Self::Fields as Fields>::Field>;
}
