// Irradiance of a surfel at `place`, in units of the scale, from a local expansion.
fn irradiance_at(
    local: ptr<function, array<Light, COEFFICIENTS>>,
    normal: vec3<f32>,
    place: vec3<f32>,
) -> Light {
    let power = powers(place);
    var sum = (*local)[0];
    #for k in axes
    {
        var field = Light();
        #for b of degree 0..=ORDER
        field += (*local)[$(b,k)] * power[$b];
        #end
        sum += field * normal[$k];
    }
    #end
    return sum;
}
