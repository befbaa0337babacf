// P2M: moments of the leaves from the radiosity of their surfels; other facets get zeros. The twin
// of src/passes/cpu/p2m.rs.
// Tables: facets, surfels, radiosity. Expansions: moments.

fn p2m(f: u32) {
    let facet = reals(facets(f * FACET_TEXELS));
    let members = facets(f * FACET_TEXELS + 1u);
    let inverse_scale = 1.0 / facet.w;
    var sum: Expansion;
    if members.w == 0u {
        for (var j = members.x; j < members.y; j++) {
            let surfel = reals(surfels(j * SURFEL_TEXELS));
            let normal = reals(surfels(j * SURFEL_TEXELS + 1u)).xyz;
            let flux = reals(radiosity(j)).xyz * surfel.w;
            let place = (surfel.xyz - facet.xyz) * inverse_scale;
            let charge = outer(flux, normal);
            sum.zeroth += charge;
            sum.first[0] += outer(charge[0], place);
            sum.first[1] += outer(charge[1], place);
            sum.first[2] += outer(charge[2], place);
            sum.scalar += flux;
        }
    }
    store_moments(f, sum);
}
