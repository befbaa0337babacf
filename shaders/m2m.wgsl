// M2M: moments of the inner facets of one level from those of their children. The twin of
// src/passes/cpu/m2m.rs.
// Tables: facets. Expansions: moments.

fn m2m(f: u32) {
    let facet = reals(facets(f * FACET_TEXELS));
    let children = facets(f * FACET_TEXELS + 1u).zw;
    if children.y == 0u {
        return;
    }
    let inverse_scale = 1.0 / facet.w;
    var sum: Expansion;
    for (var c = children.x; c < children.x + children.y; c++) {
        let at = reals(facets(c * FACET_TEXELS));
        let ratio = at.w * inverse_scale;
        let place = (at.xyz - facet.xyz) * inverse_scale;
        let child = load_moments(c);
        sum.zeroth += child.zeroth;
        sum.first[0] += child.first[0] * ratio + outer(child.zeroth[0], place);
        sum.first[1] += child.first[1] * ratio + outer(child.zeroth[1], place);
        sum.first[2] += child.first[2] * ratio + outer(child.zeroth[2], place);
        sum.scalar += child.scalar;
    }
    store_moments(f, sum);
}
