// M2P: adds to the irradiance of the surfels of a facet what they get from the moments of the
// facets that it is linked to, if they have the centre of these in front. The twin of
// src/passes/cpu/m2p.rs.
// Tables: facets, surfels, rows, links, expansions (moments). Adds to irradiance.

fn m2p(k: u32) {
    let row = rows(k);
    let members = facets(row.x * FACET_TEXELS + 1u);
    for (var i = members.x; i < members.y; i++) {
        let position = reals(surfels(i * SURFEL_TEXELS)).xyz;
        let normal = reals(surfels(i * SURFEL_TEXELS + 1u)).xyz;
        var sum = Light();
        for (var e = row.y; e < row.z; e++) {
            let entry = link(e);
            let source = sphere(entry.source);
            let way = position - source.xyz;
            if dot(normal, way) >= 0.0 {
                continue;
            }
            let inverse = 1.0 / length(way);
            let source_scale = degrees(-source.w * inverse);
            let factor = strength(entry.weight, inverse);
            let vector = surfel_kernel(normal * factor, way * inverse);
            #for a of degree 0..=ORDER
            #for k in axes
            sum += expansion(entry.source, $(a,k)u) * (vector[$(a,k)] * source_scale[$|a|]);
            #end
            #end
        }
        store_irradiance(i, 0u, load_irradiance(i, 0u) + sum);
    }
}
