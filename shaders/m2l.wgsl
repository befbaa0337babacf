// M2L: each facet's local expansion from the moments of the facets that it is linked to. The twin
// of src/passes/cpu/m2l.rs.
// Tables: facets, rows, links, moments. Expansions: locals.

const INVERSE_PI = 0.31830988618;

fn moment(i: u32) -> vec3<f32> {
    return reals(moments(i)).xyz;
}

// Adds the field of facet `source` times the visible `fraction`: the terms of order zero and one.
fn add_moments(sum: ptr<function, Expansion>, to: vec4<f32>, source: u32, fraction: f32) {
    let facet = reals(facets(source * FACET_TEXELS));
    let way = to.xyz - facet.xyz;
    let inverse = 1.0 / length(way);
    let u = way * inverse;
    let source_scale = facet.w * inverse;
    let strength = -fraction * INVERSE_PI * inverse * inverse;
    let slope = strength * (to.w * inverse);

    let at = source * COEFFICIENTS;
    let q = mat3x3(moment(at + 1u), moment(at + 2u), moment(at + 3u));
    let m0 = mat3x3(moment(at + 4u), moment(at + 7u), moment(at + 10u));
    let m1 = mat3x3(moment(at + 5u), moment(at + 8u), moment(at + 11u));
    let m2 = mat3x3(moment(at + 6u), moment(at + 9u), moment(at + 12u));

    let uq = q * u;
    let trace = m0[0] + m1[1] + m2[2];
    let mu = mat3x3(m0 * u, m1 * u, m2 * u);
    let um = m0 * u.x + m1 * u.y + m2 * u.z;
    let umu = mu * u;
    let first = um + outer(trace - umu * 4.0, u);
    (*sum).zeroth += (outer(uq, u) - first * source_scale) * strength;

    let steep = uq * -4.0;
    let zero = vec3(0.0);
    (*sum).first[0] += (q * u.x + outer(steep * u.x, u) + mat3x3(uq, zero, zero)) * slope;
    (*sum).first[1] += (q * u.y + outer(steep * u.y, u) + mat3x3(zero, uq, zero)) * slope;
    (*sum).first[2] += (q * u.z + outer(steep * u.z, u) + mat3x3(zero, zero, uq)) * slope;
}

fn m2l(i: u32) {
    let row = rows(i);
    let to = reals(facets(row.x * FACET_TEXELS));
    var sum: Expansion;
    for (var k = row.y; k < row.z; k++) {
        let entry = link(k);
        add_moments(&sum, to, entry.source, entry.weight);
    }
    for (var k = row.z; k < row.w; k++) {
        let entry = link(k);
        sum.scalar += moment(entry.source * COEFFICIENTS) * entry.weight;
    }
    store_locals(row.x, sum);
}
