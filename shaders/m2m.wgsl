// M2M: moments of the inner facets of one level from those of their children. The twin of
// src/passes/cpu/m2m.rs.
// Tables: facets, expansions (moments of the children). Writes moments.

fn m2m(f: u32) {
    let facet = sphere(f);
    let children = facets(f * FACET_TEXELS + 1u).zw;
    if children.y == 0u {
        return;
    }
    let inverse_scale = 1.0 / facet.w;
    var sum: array<Light, COEFFICIENTS>;
    for (var c = children.x; c < children.x + children.y; c++) {
        let child = sphere(c);
        let ratio = degrees(child.w * inverse_scale);
        let place = powers((child.xyz - facet.xyz) * inverse_scale);
        sum[0] += expansion(c, 0u);
        #for b of degree 0..=ORDER
        #for k in axes
        {
            let moment = expansion(c, $(b,k)u) * ratio[$|b|];
            #for a of degree 0..=ORDER-|b|
            sum[$(a+b,k)] += moment * (place[$a] * (1.0 / $a!.0));
            #end
        }
        #end
        #end
    }
    store_moments(f, 0u, sum[0]);
    #for a of degree 0..=ORDER
    #for k in axes
    store_moments(f, $(a,k)u, sum[$(a,k)]);
    #end
    #end
}
