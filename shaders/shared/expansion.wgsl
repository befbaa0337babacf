// Expansions of first order as in src/expansion/tensor, red, green and blue together: a matrix holds
// one colour a column.
struct Expansion {
    // The power, or what does not depend on the normal.
    scalar: vec3<f32>,
    // Column k is the charge Q_k, or the field F_k.
    zeroth: mat3x3<f32>,
    // Column l of matrix k is the dipole M_kl, or the gradient G_kl.
    first: array<mat3x3<f32>, 3>,
}

// In memory: so many vectors of red, green, blue and 0: the scalar, the zeroth order, then column 0 of
// the three matrices of first order, column 1, column 2.
const COEFFICIENTS = 13u;

// What the texels of the table of facets hold.
struct Facet {
    centre: vec3<f32>,
    scale: f32,
    begin: u32,
    end: u32,
    first_child: u32,
    child_count: u32,
    parent: u32,
    padding: array<u32, 3>,
}

const FACET_TEXELS = 3u;

// What the texels of the table of surfels hold.
struct Surfel {
    position: vec3<f32>,
    area: f32,
    normal: vec3<f32>,
    padding: f32,
}

const SURFEL_TEXELS = 2u;

// Column k is colour * v_k.
fn outer(colour: vec3<f32>, v: vec3<f32>) -> mat3x3<f32> {
    return mat3x3(colour * v.x, colour * v.y, colour * v.z);
}
