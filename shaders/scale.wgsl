// x *= a, colour by colour.

@group(0) @binding(0) var<uniform> a: f32;
@group(0) @binding(1) var<storage, read_write> x: array<vec4<f32>>;

fn scale(item: u32) {
    let i = item - range.base;
    x[i] = vec4(x[i].xyz * a, 0.0);
}
