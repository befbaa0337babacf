// L2P: irradiance of the surfels of a leaf from its local expansion. The twin of
// src/passes/cpu/l2p.rs.
// Tables: facets, surfels. Expansions: locals.

@group(0) @binding(3) var<storage, read_write> irradiance: array<vec4<f32>>;

fn l2p(f: u32) {
    let facet = reals(facets(f * FACET_TEXELS));
    let members = facets(f * FACET_TEXELS + 1u);
    if members.w > 0u {
        return;
    }
    let inverse_scale = 1.0 / facet.w;
    let own = load_locals(f);
    for (var i = members.x; i < members.y; i++) {
        let place = (reals(surfels(i * SURFEL_TEXELS)).xyz - facet.xyz) * inverse_scale;
        let normal = reals(surfels(i * SURFEL_TEXELS + 1u)).xyz;
        let field = own.zeroth
            + mat3x3(own.first[0] * place, own.first[1] * place, own.first[2] * place);
        irradiance[i] = vec4(own.scalar + field * normal, 0.0);
    }
}
