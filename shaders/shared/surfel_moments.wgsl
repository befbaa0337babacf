// Adds a surfel at `place`, in units of the scale, to moments that lack their factors 1/a!.
fn add_surfel(
    moments: ptr<function, array<Light, COEFFICIENTS>>,
    flux: Light,
    normal: vec3<f32>,
    place: vec3<f32>,
) {
    let power = powers(place);
    (*moments)[0] += flux;
    #for k in axes
    {
        let charge = flux * normal[$k];
        #for a of degree 0..=ORDER
        (*moments)[$(a,k)] += charge * power[$a];
        #end
    }
    #end
}
