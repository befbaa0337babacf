//! What tells one cloud from another.

use bytemuck::cast_slice;
use xxhash_rust::xxh3::Xxh3Default;

use super::PointCloud;

impl PointCloud {
    /// A number that stands for positions, normals, areas, flags and scanners: what surfels are made from.
    /// Two clouds have the same one only by chance.
    pub fn fingerprint(&self) -> u64 {
        let mut hash = Xxh3Default::new();
        let arrays: [&[u8]; 3] = [
            cast_slice(&self.positions),
            cast_slice(&self.normals),
            cast_slice(&self.areas),
        ];
        for array in arrays {
            hash.update(&(array.len() as u64).to_le_bytes());
            hash.update(array);
        }
        hash.update(cast_slice(&self.flagged));
        for scanner in &self.scanners {
            hash.update(cast_slice(&[scanner.position]));
            let ends = [scanner.points.start, scanner.points.end].map(|end| end as u64);
            hash.update(cast_slice(&ends));
        }
        hash.digest()
    }
}
