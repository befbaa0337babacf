// y += a x, colour by colour.

@group(0) @binding(0) var<uniform> a: f32;
@group(0) @binding(1) var<storage, read> x: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> y: array<vec4<f32>>;

fn axpy(item: u32) {
    let i = item - range.base;
    y[i] = vec4(y[i].xyz + x[i].xyz * a, 0.0);
}
