// The entry point of a stage whose items are each worked on by a subgroup, of any size. Workgroups
// report like those in range.wgsl.
struct Range {
    first: u32,
    count: u32,
    base: u32,
}

// Items of a workgroup.
const ITEMS = WORKGROUP / INVOCATIONS;

@group(0) @binding(RANGE_BINDING) var<uniform> range: Range;
@group(0) @binding(REPORTS_BINDING) var<storage, read_write> reports: atomic<u32>;

// The value that another lane of the subgroup has.
fn of_lane(v: vec3<f32>, lane: u32) -> vec3<f32> {
    return subgroupShuffle(v, lane);
}

fn of_lane1(v: f32, lane: u32) -> f32 {
    return subgroupShuffle(v, lane);
}

fn of_lane4(v: vec4<f32>, lane: u32) -> vec4<f32> {
    return subgroupShuffle(v, lane);
}

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(local_invocation_index) local: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(num_subgroups) subgroups: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_size) lanes: u32,
) {
    let first = invocation(0u, group, groups) / INVOCATIONS;
    let end = min(first + ITEMS, range.count);
    for (var i = first + subgroup; i < end; i += subgroups) {
        CALL
    }
    if local == 0u {
        atomicAdd(&reports, 1u);
    }
}
