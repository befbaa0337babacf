// Derivatives of the kernel at distance 1 in direction `u`, without its factor: entry (i, k) of the
// matrix of multi-index a is ∂^a of (∂_i ∂_k - δ_ik Δ) log r = -2 r_i r_k / r⁴.
fn kernel(u: vec3<f32>) -> array<f32, 9 * TERMS> {
    let g = derivatives(u);
    var matrix: array<f32, 9 * TERMS>;
    #for a of degree 0..=ORDER
    #for i in axes
    #for k in axes
    matrix[$(a,i,k)] = g[$(a+i+k)];
    #end
    #end
    matrix[$(a,x,x)] = -g[$(a+y+y)] - g[$(a+z+z)];
    matrix[$(a,y,y)] = -g[$(a+z+z)] - g[$(a+x+x)];
    matrix[$(a,z,z)] = -g[$(a+x+x)] - g[$(a+y+y)];
    #end
    return matrix;
}

// The factor of the kernel, for a part of the light, at 1 / `inverse`.
fn strength(weight: f32, inverse: f32) -> f32 {
    return 0.15915494309 * weight * inverse * inverse; // 1 / 2π
}
