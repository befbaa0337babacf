// P2M, M2L and L2P of one link at a time: adds to the irradiance of the surfels of a facet that have
// a source's centre in front what comes from those of its surfels that have the facet's centre in
// front. The twin of src/passes/cpu/mixed.rs.
// Tables: facets, surfels, items, parts, radiosity. Adds to irradiance.

// What two texels of the table of items hold: some receivers of a facet, and parts of its row.
struct Item {
    facet: u32,
    first: u32,
    end: u32,
    first_part: u32,
    end_part: u32,
    padding: array<u32, 3>,
}

// What a texel of the table of parts holds: some surfels of a source.
struct Part {
    source: u32,
    begin: u32,
    end: u32,
    weight: f32,
}

const ITEM_TEXELS = 2u;

fn mixed(k: u32) {
    let item = items(k * ITEM_TEXELS);
    let last = items(k * ITEM_TEXELS + 1u).x;
    let to = sphere(item.x);
    for (var e = item.w; e < last; e++) {
        let words = parts(e);
        let part = Part(words.x, words.y, words.z, bitcast<f32>(words.w));
        let source = sphere(part.source);
        var moments = moments_towards(to.xyz, source, part.begin, part.end);
        var local: array<Light, COEFFICIENTS>;
        add_field(&local, &moments, to.xyz - source.xyz, vec2(source.w, to.w), part.weight);
        #for b of degree 0..=ORDER
        #for k in axes
        local[$(b,k)] *= 1.0 / $b!.0;
        #end
        #end
        for (var i = item.y; i < item.z; i++) {
            let position = reals(surfels(i * SURFEL_TEXELS)).xyz;
            let normal = reals(surfels(i * SURFEL_TEXELS + 1u)).xyz;
            if dot(normal, source.xyz - position) > 0.0 {
                let sum = irradiance_at(&local, normal, (position - to.xyz) * (1.0 / to.w));
                store_irradiance(i, 0u, load_irradiance(i, 0u) + sum);
            }
        }
    }
}

// Moments about a source's centre of those of the surfels that have a point in front.
fn moments_towards(
    point: vec3<f32>,
    source: vec4<f32>,
    begin: u32,
    end: u32,
) -> array<Light, COEFFICIENTS> {
    var moments: array<Light, COEFFICIENTS>;
    for (var j = begin; j < end; j++) {
        let surfel = reals(surfels(j * SURFEL_TEXELS));
        let normal = reals(surfels(j * SURFEL_TEXELS + 1u)).xyz;
        if dot(normal, point - surfel.xyz) > 0.0 {
            let flux = light(reals(radiosity(j)) * surfel.w);
            add_surfel(&moments, flux, normal, (surfel.xyz - source.xyz) * (1.0 / source.w));
        }
    }
    #for a of degree 0..=ORDER
    #for k in axes
    moments[$(a,k)] *= 1.0 / $a!.0;
    #end
    #end
    return moments;
}
