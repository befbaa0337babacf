// L2L: adds to the local expansions of one level those of their parents. The twin of
// src/passes/cpu/l2l.rs.
// Tables: facets. Expansions: locals.

fn l2l(f: u32) {
    let facet = reals(facets(f * FACET_TEXELS));
    let parent = facets(f * FACET_TEXELS + 2u).x;
    let above = reals(facets(parent * FACET_TEXELS));
    let inverse_scale = 1.0 / above.w;
    let ratio = facet.w * inverse_scale;
    let place = (facet.xyz - above.xyz) * inverse_scale;
    let inherited = load_locals(parent);
    var sum = load_locals(f);
    sum.zeroth += inherited.zeroth
        + mat3x3(inherited.first[0] * place, inherited.first[1] * place, inherited.first[2] * place);
    sum.first[0] += inherited.first[0] * ratio;
    sum.first[1] += inherited.first[1] * ratio;
    sum.first[2] += inherited.first[2] * ratio;
    sum.scalar += inherited.scalar;
    store_locals(f, sum);
}
