// P2M: moments of the leaves from the radiosity of their surfels; other facets get zeros. The twin
// of src/passes/cpu/p2m.rs.
// Tables: facets, surfels, radiosity. Writes moments.

fn p2m(f: u32) {
    let facet = sphere(f);
    let members = facets(f * FACET_TEXELS + 1u);
    let inverse_scale = 1.0 / facet.w;
    var sum: array<Light, COEFFICIENTS>;
    if members.w == 0u {
        for (var j = members.x; j < members.y; j++) {
            let surfel = reals(surfels(j * SURFEL_TEXELS));
            let normal = reals(surfels(j * SURFEL_TEXELS + 1u)).xyz;
            let flux = light(reals(radiosity(j)) * surfel.w);
            add_surfel(&sum, flux, normal, (surfel.xyz - facet.xyz) * inverse_scale);
        }
    }
    store_moments(f, 0u, sum[0]);
    #for a of degree 0..=ORDER
    #for k in axes
    store_moments(f, $(a,k)u, sum[$(a,k)] * (1.0 / $a!.0));
    #end
    #end
}
