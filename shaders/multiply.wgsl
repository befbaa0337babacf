// x *= factor, colour by colour.

@group(0) @binding(0) var<storage, read> factor: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> x: array<vec4<f32>>;

fn multiply(item: u32) {
    let i = item - range.base;
    x[i] = vec4(x[i].xyz * factor[i].xyz, 0.0);
}
