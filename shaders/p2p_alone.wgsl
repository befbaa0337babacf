// P2P on devices without subgroups: each invocation works on an item alone, as one lane of one.

fn of_lane(v: vec3<f32>, lane: u32) -> vec3<f32> {
    return v;
}

fn of_lane1(v: f32, lane: u32) -> f32 {
    return v;
}

fn of_lane4(v: vec4<f32>, lane: u32) -> vec4<f32> {
    return v;
}

fn p2p_alone(i: u32) {
    p2p(i, 0u, 1u);
}
