// Segments against the cells: the twin of src/visibility/segment.rs, which tests cells alike, operation
// by operation, but four boxes at once.
// Tables: nodes, occluders (7 texels each).

// What the texels of the table hold.
struct Occluder {
    position: vec3<f32>,
    surfel: u32,
    normal: vec3<f32>,
    radius_squared: f32,
    tangent: vec3<f32>,
    back: u32,
    corners: array<vec4<f32>, 4>,
}

const OCCLUDER_TEXELS = 7u;

// True where (x, y) lies to the left of the edge from c to d, or on it.
fn left_of(c: vec2<f32>, d: vec2<f32>, x: f32, y: f32) -> bool {
    return (d.x - c.x) * (y - c.y) - (d.y - c.y) * (x - c.x) >= 0.0;
}

fn meets_cell(at: u32, segment: Segment) -> bool {
    let first = occluders(at);
    let second = reals(occluders(at + 1u));
    let position = reals(first).xyz;
    let normal = second.xyz;
    let p = segment.start - position;
    let q = segment.end - position;
    let a = dot(p, normal);
    let b = dot(q, normal);
    if !((a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0)) {
        return false;
    }
    let hit = (p * b - q * a) * (1.0 / (b - a));
    if dot(hit, hit) > second.w || first.w == segment.skip_from || first.w == segment.skip_to {
        return false;
    }
    let tangent = reals(occluders(at + 2u)).xyz;
    let x = dot(hit, tangent);
    let y = dot(hit, cross(normal, tangent));
    let c01 = reals(occluders(at + 3u));
    let c23 = reals(occluders(at + 4u));
    let c45 = reals(occluders(at + 5u));
    let c67 = reals(occluders(at + 6u));
    return left_of(c01.xy, c01.zw, x, y) && left_of(c01.zw, c23.xy, x, y)
        && left_of(c23.xy, c23.zw, x, y) && left_of(c23.zw, c45.xy, x, y)
        && left_of(c45.xy, c45.zw, x, y) && left_of(c45.zw, c67.xy, x, y)
        && left_of(c67.xy, c67.zw, x, y) && left_of(c67.zw, c01.xy, x, y);
}

// Walks to the next leaf that is met, then tests its cells: invocations that run in step wait for
// each other twice a leaf. (With the cells tested inside the walk, all waited at every step: 2.5
// times slower on eight lanes.)
fn answer(segment: Segment) -> u32 {
    let inverse = inverse_of(segment.end - segment.start);
    let end = nodes(0u).w;
    var i = 0u;
    while i < end {
        var leaf = 0u;
        while i < end && leaf == 0u {
            let low = nodes(i * NODE_TEXELS);
            let high = nodes(i * NODE_TEXELS + 1u);
            let meets = meets_box(reals(low).xyz, reals(high).xyz, segment.start, inverse);
            leaf = select(0u, high.w, meets);
            i += select(low.w, 1u, meets);
        }
        let count = leaf & ((1u << COUNT_BITS) - 1u);
        let first = leaf >> COUNT_BITS;
        var k = first;
        for (; k < first + count; k++) {
            if meets_cell(k * OCCLUDER_TEXELS, segment) {
                return BLOCKED;
            }
        }
        if k < first + count {
            return UNKNOWN;
        }
    }
    return select(UNKNOWN, VISIBLE, i >= end);
}
