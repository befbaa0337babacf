//! Tables of multi-indices.

/// Number of multi-indices of degree up to `order`: C(order + 3, 3).
#[inline(always)]
pub const fn count(order: usize) -> usize {
    (order + 1) * (order + 2) * (order + 3) / 6
}

/// The multi-indices γ = (γ_x, γ_y, γ_z) of degree |γ| up to an order, by degree and within a
/// degree lexicographically with x highest first: 1, x, y, z, xx, xy, xz, yy, yz, zz, ... So those
/// of a lower order come first.
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
        let all = std::iter::successors(Some([0; 3]), |&g| Some(next(g)));
        let exponents = all.take(count(order)).collect();
        let mut indices = Indices {
            order,
            exponents,
            sums: Vec::new(),
            begin: Vec::new(),
        };
        for b in &indices.exponents {
            indices.begin.push(indices.sums.len() as u32);
            let partners = &indices.exponents[..count(order - degree(*b))];
            indices.sums.extend(partners.iter().map(|a| sum(*a, *b)));
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

/// The multi-index after this one.
const fn next([x, y, z]: [u8; 3]) -> [u8; 3] {
    match (x, y) {
        (_, 1..) => [x, y - 1, z + 1],
        (1.., 0) => [x - 1, z + 1, 0],
        (0, 0) => [z + 1, 0, 0],
    }
}

/// The first N of [`Indices::exponents`].
pub(super) const fn exponents<const N: usize>() -> [[u8; 3]; N] {
    let mut all = [[0; 3]; N];
    let mut i = 1;
    while i < N {
        all[i] = next(all[i - 1]);
        i += 1;
    }
    all
}

/// The first N of [`Indices::sums`] of a multi-index.
pub(super) const fn sums<const N: usize>(b: [u8; 3]) -> [u16; N] {
    let exponents = exponents::<N>();
    let mut all = [0; N];
    let mut i = 0;
    while i < N {
        all[i] = sum(exponents[i], b);
        i += 1;
    }
    all
}

const fn sum(a: [u8; 3], b: [u8; 3]) -> u16 {
    position([a[0] + b[0], a[1] + b[1], a[2] + b[2]]) as u16
}

/// |γ|
pub(super) const fn degree(g: [u8; 3]) -> usize {
    g[0] as usize + g[1] as usize + g[2] as usize
}

/// Where a multi-index is in the order of [`Indices`].
pub const fn position(g: [u8; 3]) -> usize {
    let (degree, rest) = (degree(g), g[1] as usize + g[2] as usize);
    degree * (degree + 1) * (degree + 2) / 6 + rest * (rest + 1) / 2 + g[2] as usize
}

/// γ! = γ_x! γ_y! γ_z!
pub(super) const fn factorial(g: [u8; 3]) -> f64 {
    let (mut product, mut axis) = (1.0, 0);
    while axis < 3 {
        let mut e = g[axis];
        while e > 1 {
            product *= e as f64;
            e -= 1;
        }
        axis += 1;
    }
    product
}
