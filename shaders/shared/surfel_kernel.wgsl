// The matrices of `kernel` times a normal: what a surfel gets from the moments of a facet, or gives
// to a local expansion.
fn surfel_kernel(normal: vec3<f32>, u: vec3<f32>) -> array<f32, COEFFICIENTS> {
    let matrix = kernel(u);
    var vector: array<f32, COEFFICIENTS>;
    #for a of degree 0..=ORDER
    #for i in axes
    #for k in axes
    vector[$(a,i)] += matrix[$(a,i,k)] * normal[$k];
    #end
    #end
    #end
    return vector;
}
