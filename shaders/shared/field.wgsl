// Adds the field of moments, `way` from their centre, to a local expansion that lacks its factors
// 1/b!. `scales` are those of the moments and of the expansion.
fn add_field(
    local: ptr<function, array<Light, COEFFICIENTS>>,
    moments: ptr<function, array<Light, COEFFICIENTS>>,
    way: vec3<f32>,
    scales: vec2<f32>,
    weight: f32,
) {
    let inverse = 1.0 / length(way);
    let matrix = kernel(way * inverse);
    let factor = strength(weight, inverse);
    let source_scale = degrees(-scales.x * inverse);
    let target_scale = degrees(scales.y * inverse);
    #for a of degree 0..=ORDER
    #for k in axes
    (*moments)[$(a,k)] *= factor * source_scale[$|a|];
    #end
    #end
    #for b of degree 0..=ORDER
    #for i in axes
    {
        var derivative = Light();
        #for a of degree 0..=ORDER-|b|
        #for k in axes
        derivative += (*moments)[$(a,k)] * matrix[$(a+b,i,k)];
        #end
        #end
        (*local)[$(b,i)] += derivative * target_scale[$|b|];
    }
    #end
    #end
}
