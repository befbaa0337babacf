// M2L: local expansions from the moments of the facets that they are linked to, by links of order
// ORDER. Those of the full order come first, with the sampled links, and begin the expansion;
// others add to it. The twin of src/passes/cpu/m2l.rs.
// Tables: facets, rows, links, expansions (moments). Writes locals.

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
    if BEGINS {
        store_locals(row.x, 0u, sum[0]);
    }
    #for b of degree 0..=ORDER
    #for i in axes
    {
        var coefficient = sum[$(b,i)] * (1.0 / $b!.0);
        if !BEGINS {
            coefficient += load_locals(row.x, $(b,i)u);
        }
        store_locals(row.x, $(b,i)u, coefficient);
    }
    #end
    #end
}
