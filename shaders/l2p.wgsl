// L2P: adds to the irradiance of the surfels of a leaf what its local expansion says. The twin of
// src/passes/cpu/l2p.rs.
// Tables: facets, surfels, expansions (local ones). Adds to irradiance.

fn l2p(f: u32) {
    let facet = sphere(f);
    let members = facets(f * FACET_TEXELS + 1u);
    if members.w > 0u {
        return;
    }
    let inverse_scale = 1.0 / facet.w;
    var local: array<Light, COEFFICIENTS>;
    local[0] = expansion(f, 0u);
    #for b of degree 0..=ORDER
    #for k in axes
    local[$(b,k)] = expansion(f, $(b,k)u);
    #end
    #end
    for (var i = members.x; i < members.y; i++) {
        let place = (reals(surfels(i * SURFEL_TEXELS)).xyz - facet.xyz) * inverse_scale;
        let normal = reals(surfels(i * SURFEL_TEXELS + 1u)).xyz;
        let sum = irradiance_at(&local, normal, place);
        store_irradiance(i, 0u, load_irradiance(i, 0u) + sum);
    }
}
