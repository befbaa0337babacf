//! A surfel to be, and what the surface around a point may be.

use glam::Vec3;

use super::curved::Curved;
use super::plane::{Around, OFF, Plane, allowed, same_side};
use super::round::Round;
use super::samples::Samples;

/// Radius of the footprint that a surfel is fitted to, in sizes.
pub(super) const FOOTPRINT: f32 = 2.0;
/// A cylinder is thin if its radius is less than the size of its surfels over this.
const THIN: f32 = 0.2;

/// A surfel to be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// The sample that stands for it.
    pub sample: u32,
    pub position: Vec3,
    /// Of either sign.
    pub normal: Vec3,
    /// No surfel of the same surface is nearer than this.
    pub size: f32,
    /// Deviation of points from their surface.
    pub noise: f32,
    /// Deviation of those within its size from its plane.
    pub rough: f32,
    /// Whether it is a plane within the noise.
    pub flat: bool,
    /// The cylinder that it is a part of.
    pub round: Option<Round>,
    /// Mean colour of the points on it, and how far they are off that (root mean square).
    pub colour: Vec3,
    pub mottled: f32,
    /// Distance of the points around.
    pub spacing: f32,
    /// From where the sample was seen that it was fitted at: a unit vector, or zero.
    pub view: Vec3,
    /// Whether both sides may be lit.
    pub both: bool,
}

impl Patch {
    /// Whether a patch beside it is of the same cylinder.
    pub fn is_round_with(&self, other: &Patch) -> bool {
        self.round.is_some()
            && other.round.is_some()
            && self.deviations(other.position).abs() < OFF
            && other.deviations(self.position).abs() < OFF
    }

    /// Whether the cylinder that it is of is thin, a few of its sizes, and its normal points away from the axis; `None`
    /// if it is of none.
    pub fn points_outward(&self) -> Option<bool> {
        let bend = self.round.as_ref()?.bend();
        (bend.abs() * self.size > THIN).then_some(bend < 0.0)
    }

    /// How far a colour is off that of the points here, in their deviations.
    pub fn strange(&self, colour: Vec3) -> f32 {
        colour.distance(self.colour) / self.mottled
    }

    /// Whether a sample was seen on the same side.
    pub fn is_seen_with(&self, samples: &Samples, k: u32) -> bool {
        samples
            .view(k)
            .is_none_or(|view| same_side(self.normal, self.view, view))
    }

    /// How far a place is off the plane or the cylinder, in deviations of the points on it.
    pub fn deviations(&self, place: Vec3) -> f32 {
        match &self.round {
            Some(round) => round.height(place) / self.noise,
            None => self.normal.dot(place - self.position) / self.rough,
        }
    }

    /// Its plane next to a place.
    pub fn tangent_at(&self, place: Vec3) -> Plane {
        let height = self.normal.dot(place - self.position);
        match &self.round {
            Some(round) => round.tangent_at(place),
            None => Plane {
                normal: self.normal,
                centre: place - height * self.normal,
                along: [0.0; 2],
            },
        }
    }

    /// How far a place is beside the surface of this patch, in what counts as off: up to 1 it is on it.
    pub fn beside(&self, place: Vec3) -> f32 {
        let way = place - self.position;
        let height = self.normal.dot(way);
        let along = way - height * self.normal;
        match (&self.round, self.flat) {
            (Some(round), _) => round.height(place).abs() / (OFF * self.noise),
            (None, true) => height.abs() / (OFF * self.noise),
            (None, false) => height.abs() / allowed(along, FOOTPRINT * self.size, self.noise),
        }
    }
}

/// The surface around a point: a plane or a cylinder within the noise, its tangent plane, or where that holds for
/// too few points a paraboloid.
pub(super) enum Model {
    Flat(Plane),
    Round(Round),
    Tangent(Plane),
    Curved(Curved),
}

impl Model {
    pub fn tangent(&self) -> Plane {
        match self {
            Model::Flat(plane) | Model::Tangent(plane) => *plane,
            Model::Round(round) => round.tangent(),
            Model::Curved(curved) => curved.tangent(),
        }
    }

    /// How far place k is off, in what is allowed.
    pub fn off(&self, around: &Around, k: usize) -> f32 {
        match self {
            Model::Flat(plane) => around.off_flat(plane, k),
            Model::Tangent(plane) => around.off(plane, k),
            Model::Round(round) => round.off(around, k),
            Model::Curved(curved) => curved.off(around, k),
        }
    }
}
