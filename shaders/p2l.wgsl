// P2L: adds to local expansions the field of each surfel of the facets that they are linked to, if
// the surfel has their centre in front. The twin of src/passes/cpu/p2l.rs.
// Tables: facets, surfels, rows, links, radiosity. Adds to locals.

fn p2l(i: u32) {
    let row = rows(i);
    let to = sphere(row.x);
    var sum: array<Light, COEFFICIENTS>;
    for (var e = row.y; e < row.z; e++) {
        let entry = link(e);
        let members = facets(entry.source * FACET_TEXELS + 1u);
        for (var j = members.x; j < members.y; j++) {
            let surfel = reals(surfels(j * SURFEL_TEXELS));
            let normal = reals(surfels(j * SURFEL_TEXELS + 1u)).xyz;
            let way = to.xyz - surfel.xyz;
            if dot(normal, way) <= 0.0 {
                continue;
            }
            let flux = light(reals(radiosity(j)) * surfel.w);
            let inverse = 1.0 / length(way);
            let target_scale = degrees(to.w * inverse);
            let factor = strength(entry.weight, inverse);
            let vector = surfel_kernel(normal * factor, way * inverse);
            #for b of degree 0..=ORDER
            #for i in axes
            sum[$(b,i)] += flux * (vector[$(b,i)] * target_scale[$|b|]);
            #end
            #end
        }
    }
    #for b of degree 0..=ORDER
    #for i in axes
    store_locals(row.x, $(b,i)u, load_locals(row.x, $(b,i)u) + sum[$(b,i)] * (1.0 / $b!.0));
    #end
    #end
}
