// Number of this invocation in a dispatch of rows of workgroups.
fn invocation(local: u32, group: vec3<u32>, groups: vec3<u32>) -> u32 {
    return (group.y * groups.x + group.x) * WORKGROUP + local;
}

// The words of a table's texel as reals.
fn reals(words: vec4<u32>) -> vec4<f32> {
    return bitcast<vec4<f32>>(words);
}
