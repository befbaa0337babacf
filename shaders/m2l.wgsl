// M2L: adds to local expansions the field of the moments of the facets that they are linked to, by
// links of order ORDER and sampled ones. The twin of src/passes/cpu/m2l.rs.
// Tables: facets, rows, links, expansions (moments). Adds to locals.

fn m2l(i: u32) {
    let row = rows(i);
    let to = sphere(row.x);
    var sum: array<Light, COEFFICIENTS>;
    for (var e = row.y; e < row.z; e++) {
        let entry = link(e);
        let source = sphere(entry.source);
        var moments: array<Light, COEFFICIENTS>;
        #for a of degree 0..=ORDER
        #for k in axes
        moments[$(a,k)] = expansion(entry.source, $(a,k)u);
        #end
        #end
        add_field(&sum, &moments, to.xyz - source.xyz, vec2(source.w, to.w), entry.weight);
    }
    for (var e = row.z; e < row.w; e++) {
        let entry = link(e);
        sum[0] += expansion(entry.source, 0u) * entry.weight;
    }
    store_locals(row.x, 0u, load_locals(row.x, 0u) + sum[0]);
    #for b of degree 0..=ORDER
    #for i in axes
    store_locals(row.x, $(b,i)u, load_locals(row.x, $(b,i)u) + sum[$(b,i)] * (1.0 / $b!.0));
    #end
    #end
}
