//! Tables of multi-indices.

/// Number of multi-indices of degree up to `order`: C(order + 3, 3).
pub const fn count(order: usize) -> usize {
    (order + 1) * (order + 2) * (order + 3) / 6
}

/// The multi-indices γ = (γ_x, γ_y, γ_z) of degree |γ| up to an order, by degree and within a degree
/// lexicographically with x highest first: 1, x, y, z, xx, xy, xz, yy, yz, zz, ... So those of a
/// lower order come first.
#[derive(Clone, Debug)]
pub struct Indices {
    order: usize,
    exponents: Vec<[u8; 3]>,
    /// For each β one after the other: where β + α is, for all α of degree up to order - |β|.
    sums: Vec<u16>,
    /// Where the sums of each β begin.
    begin: Vec<u32>,
}

impl Indices {
    pub fn new(order: usize) -> Indices {
        let mut exponents = Vec::with_capacity(count(order));
        for degree in 0..=order {
            for x in (0..=degree).rev() {
                let rest = degree - x;
                exponents.extend((0..=rest).map(|z| [x as u8, (rest - z) as u8, z as u8]));
            }
        }
        let mut indices = Indices {
            order,
            exponents,
            sums: Vec::new(),
            begin: Vec::new(),
        };
        for b in &indices.exponents {
            indices.begin.push(indices.sums.len() as u32);
            let degree = b.iter().map(|&e| usize::from(e)).sum::<usize>();
            let sum = |a: &[u8; 3]| position(std::array::from_fn(|i| a[i] + b[i])) as u16;
            let partners = &indices.exponents[..count(order - degree)];
            indices.sums.extend(partners.iter().map(sum));
        }
        indices
    }

    /// The highest degree.
    pub fn order(&self) -> usize {
        self.order
    }

    /// (γ_x, γ_y, γ_z) of each.
    pub fn exponents(&self) -> &[[u8; 3]] {
        &self.exponents
    }

    /// Where β + α is for each α, in order, of which |β + α| is at most the order.
    #[inline(always)]
    pub fn sums(&self, b: usize) -> &[u16] {
        let end = self
            .begin
            .get(b + 1)
            .map_or(self.sums.len(), |&e| e as usize);
        &self.sums[self.begin[b] as usize..end]
    }

    /// Those of one degree.
    #[inline(always)]
    pub fn of_degree(degree: usize) -> std::ops::Range<usize> {
        let begin = if degree == 0 { 0 } else { count(degree - 1) };
        begin..count(degree)
    }
}

/// Where a multi-index is in the order of [`Indices`].
pub fn position([x, y, z]: [u8; 3]) -> usize {
    let [x, y, z] = [x, y, z].map(usize::from);
    let (degree, rest) = (x + y + z, y + z);
    degree * (degree + 1) * (degree + 2) / 6 + rest * (rest + 1) / 2 + z
}
