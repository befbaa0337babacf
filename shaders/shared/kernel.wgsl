const INVERSE_PI = 0.31830988618;

// Derivatives of the kernel at distance 1 in direction `u`, times `strength`: entry (i, k) of the
// matrix of multi-index a is ∂^a of -r_i r_k / (π r⁴) = (∂_i ∂_k - δ_ik Δ) log r / 2π.
fn kernel(u: vec3<f32>, strength: f32) -> array<f32, 9 * TERMS> {
    let half = 0.5 * INVERSE_PI * strength;
    let g = derivatives(u);
    var matrix: array<f32, 9 * TERMS>;
    #for a of degree 0..=ORDER
    #for i in axes
    #for k in axes
    matrix[$(a,i,k)] = half * g[$(a+i+k)];
    #end
    #end
    matrix[$(a,x,x)] = -half * (g[$(a+y+y)] + g[$(a+z+z)]);
    matrix[$(a,y,y)] = -half * (g[$(a+z+z)] + g[$(a+x+x)]);
    matrix[$(a,z,z)] = -half * (g[$(a+x+x)] + g[$(a+y+y)]);
    #end
    return matrix;
}
