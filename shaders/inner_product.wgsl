// Parts of Σ x · y over items and colours: part k sums items k, k + parts, k + 2 parts, ..., so that
// invocations side by side read side by side. The host adds the parts up.

@group(0) @binding(0) var<uniform> items: u32;
@group(0) @binding(1) var<storage, read> x: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> y: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> parts: array<f32>;

fn inner_product(k: u32) {
    var sum = 0.0;
    for (var i = k; i < items; i += arrayLength(&parts)) {
        sum += dot(x[i].xyz, y[i].xyz);
    }
    parts[k] = sum;
}
