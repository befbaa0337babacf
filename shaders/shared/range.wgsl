// The entry point of a stage that works on a part of its items. Each workgroup reports that it ran:
// a driver that gives up on a dispatch without a word is found out by the missing reports.
struct Range {
    first: u32,
    count: u32,
    // The first item of the parts of buffers that are bound.
    base: u32,
}

@group(0) @binding(RANGE_BINDING) var<uniform> range: Range;
@group(0) @binding(REPORTS_BINDING) var<storage, read_write> reports: atomic<u32>;

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(local_invocation_index) local: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let i = invocation(local, group, groups);
    if i < range.count * INVOCATIONS {
        CALL
    }
    if local == 0u {
        atomicAdd(&reports, 1u);
    }
}
