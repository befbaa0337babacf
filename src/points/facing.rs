//! What is told of the lit side of a surface.

use glam::DVec3;

use super::PointCloud;

/// Which side of a surface is lit, where points have no normals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Facing {
    /// That of the scanner, where the cloud knows where that was; otherwise that which sees free space.
    #[default]
    Auto,
    /// The inner one: a room, a cave.
    Inward,
    /// The outer one: an object.
    Outward,
    /// That of the place, in the scan's coordinates, from which all was seen.
    Viewpoint(DVec3),
}

impl Facing {
    /// From where point `i` of the cloud was seen, if that is known.
    pub(super) fn viewpoint(&self, cloud: &PointCloud, i: usize) -> Option<DVec3> {
        match *self {
            Facing::Viewpoint(place) => Some(place),
            Facing::Auto => {
                let scan = cloud.scanners.partition_point(|s| s.points.end <= i);
                let scanner = cloud.scanners.get(scan)?;
                scanner.points.contains(&i).then_some(scanner.position)
            }
            _ => None,
        }
    }
}
