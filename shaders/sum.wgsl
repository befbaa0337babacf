// Sums of the parts of an inner product, a workgroup of them: invocation k adds up every
// WORKGROUP-th part. The host adds the sums up.

@group(0) @binding(0) var<uniform> parts: u32;
@group(0) @binding(1) var<storage, read> part: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

fn sum(k: u32) {
    var total = 0.0;
    for (var j = k; j < parts; j += WORKGROUP) {
        total += part[j];
    }
    sums[k] = total;
}
