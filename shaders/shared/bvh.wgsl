// A hierarchy of boxes that segments walk, and an entry point that answers each segment by the
// stage's `answer`. Table: nodes (2 texels each).

struct Segment {
    start: vec3<f32>,
    skip_from: u32,
    end: vec3<f32>,
    skip_to: u32,
}

// What the texels of the table hold; they are loaded one by one, as late as possible.
struct Node {
    min: vec3<f32>,
    skip: u32,
    max: vec3<f32>,
    leaf: u32,
}

const NODE_TEXELS = 2u;
const COUNT_BITS = 3u;
const SMALLEST = 1e-20;
const ROUNDING = 1.0 + 4.0 * 1.1920929e-7;

// Answers; 0 is what an output holds that no invocation has written. A driver may leave loops early
// (see turns.rs): then the answer is unknown.
const BLOCKED = 1u;
const VISIBLE = 2u;
const UNKNOWN = 3u;

@group(0) @binding(2) var<storage, read> segments: array<Segment>;
@group(0) @binding(3) var<storage, read_write> answers: array<u32>;

fn inverse_of(v: vec3<f32>) -> vec3<f32> {
    let smallest = select(vec3(SMALLEST), vec3(-SMALLEST), v < vec3(0.0));
    return 1.0 / select(smallest, v, abs(v) >= vec3(SMALLEST));
}

fn meets_box(low: vec3<f32>, high: vec3<f32>, start: vec3<f32>, inverse: vec3<f32>) -> bool {
    let a = (low - start) * inverse;
    let b = (high - start) * inverse;
    let enter = min(a, b);
    let leave = max(a, b);
    let near = max(max(0.0, enter.x), max(enter.y, enter.z));
    let far = min(min(1.0, leave.x), min(leave.y, leave.z));
    return near <= far * ROUNDING;
}

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(local_invocation_index) local: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let i = invocation(local, group, groups);
    if i >= arrayLength(&segments) {
        return;
    }
    answers[i] = answer(segments[i]);
}
