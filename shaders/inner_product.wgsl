// Parts of Σ x · y over items and colours: a workgroup sums up a block of items, each invocation
// every WORKGROUP-th, so that invocations side by side read side by side.

@group(0) @binding(0) var<uniform> items: u32;
@group(0) @binding(1) var<storage, read_write> parts: array<f32>;
@group(0) @binding(2) var<storage, read> x: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> y: array<vec4<f32>>;

fn inner_product(k: u32) {
    let first = k / WORKGROUP * (WORKGROUP * WORKGROUP) + k % WORKGROUP;
    var sum = 0.0;
    for (var j = 0u; j < WORKGROUP; j++) {
        let item = first + j * WORKGROUP;
        if item < items {
            sum += dot(x[item - range.base].xyz, y[item - range.base].xyz);
        }
    }
    parts[k] = sum;
}
