// L2L: adds to the local expansions of one level those of their parents. The twin of
// src/passes/cpu/l2l.rs.
// Tables: facets, expansions (local ones). Writes locals.

fn l2l(f: u32) {
    let facet = sphere(f);
    let parent = facets(f * FACET_TEXELS + 2u).x;
    let above = sphere(parent);
    let inverse_scale = 1.0 / above.w;
    let ratio = degrees(facet.w * inverse_scale);
    let place = powers((facet.xyz - above.xyz) * inverse_scale);
    store_locals(f, 0u, expansion(f, 0u) + expansion(parent, 0u));
    var local: array<Light, COEFFICIENTS>;
    #for b of degree 0..=ORDER
    #for k in axes
    local[$(b,k)] = expansion(parent, $(b,k)u);
    #end
    #end
    #for b of degree 0..=ORDER
    #for k in axes
    {
        var inherited = local[$(b,k)];
        #for a of degree 1..=ORDER-|b|
        inherited += local[$(a+b,k)] * (place[$a] * $(a+b over b).0);
        #end
        store_locals(f, $(b,k)u, expansion(f, $(b,k)u) + inherited * ratio[$|b|]);
    }
    #end
    #end
}
