// Expansions as in src/expansion/tensor, of order ORDER: a scalar, then a vector for each of TERMS
// multi-indices. Loops over multi-indices (#for) are written out by src/passes/gpu/unroll.rs.
const COEFFICIENTS = 1 + 3 * TERMS;

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

// Centre and scale of a facet.
fn sphere(f: u32) -> vec4<f32> {
    return reals(facets(f * FACET_TEXELS));
}

// v^a
fn powers(v: vec3<f32>) -> array<f32, TERMS> {
    var power: array<f32, TERMS>;
    power[0] = 1.0;
    #for a of degree 0..=ORDER-1
    #for k in axes
    power[$(a+k)] = power[$a] * v[$k];
    #end
    #end
    return power;
}

// 1, x, x², ...
fn degrees(x: f32) -> array<f32, ORDER + 1> {
    var power: array<f32, ORDER + 1>;
    power[0] = 1.0;
    #for d in 1..=ORDER
    power[$d] = power[$d - 1] * x;
    #end
    return power;
}
