// Points between two points: the twin of src/visibility/point_visible.rs, in the same order of
// operations, so that both round alike where a driver leaves products and sums apart.
// Tables: nodes, points (2 texels each).

// What the texels of the table hold.
struct Point {
    position: vec3<f32>,
    surfel: u32,
    normal: vec3<f32>,
    inverse_area: f32,
}

const LOOKUP = 6u;

struct Test {
    threshold: f32,
    closest: u32,
    // Δ²
    limit: f32,
    // Entries of the look-up table a spacing.
    steps: f32,
    lookup: array<vec4<f32>, 2>,
}

const POINT_TEXELS = 2u;
const MAX_CLOSEST = 16u;
// Square of a distance from which on nothing is in the way.
const FAR = 1e30;

@group(0) @binding(4) var<uniform> test: Test;

struct Occluder {
    distance: f32,
    surfel: u32,
    crossing: f32,
}

struct Ends {
    p: vec3<f32>,
    q: vec3<f32>,
    way: vec3<f32>,
    length_squared: f32,
}

// The occluders closest to the segment, nearest first.
var<private> found: array<Occluder, MAX_CLOSEST>;

// `dot` may add in another order.
fn inner(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

// Square of the distance from a point, in its plane, to where the segment crosses it, in spacings;
// Δ² if the point is no occluder.
fn crossing_of(at: u32, ends: Ends) -> f32 {
    let x = reals(points(at * POINT_TEXELS)).xyz;
    let second = reals(points(at * POINT_TEXELS + 1u));
    let p = ends.p - x;
    let q = ends.q - x;
    let a = inner(p, second.xyz);
    let b = inner(q, second.xyz);
    if !((a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0)) {
        return test.limit;
    }
    let inverse = 1.0 / (b - a);
    let hit = (p * b - q * a) * inverse;
    let squared = inner(hit, hit);
    let to_end = min(a * a, b * b) * (inverse * inverse) * ends.length_squared;
    return select(test.limit, min(squared * second.w, test.limit), squared < to_end);
}

// Square of the distance of a point from the segment, in spacings.
fn distance_of(at: u32, ends: Ends) -> f32 {
    let p = ends.p - reals(points(at * POINT_TEXELS)).xyz;
    let along = -inner(p, ends.way) * (1.0 / ends.length_squared);
    let across = p + ends.way * along;
    return inner(across, across) * reals(points(at * POINT_TEXELS + 1u)).w;
}

fn entry(k: u32) -> f32 {
    return test.lookup[k / 4u][k % 4u];
}

fn look_up(distance: f32) -> f32 {
    let place = distance * test.steps;
    if place < f32(LOOKUP - 1u) {
        let cell = u32(place);
        let low = entry(cell);
        let high = entry(cell + 1u);
        return low + (high - low) * (place - f32(cell));
    }
    return 1.0;
}

fn answer(segment: Segment) -> u32 {
    let way = segment.end - segment.start;
    let ends = Ends(segment.start, segment.end, way, inner(way, way));
    let inverse = inverse_of(way);
    let most = min(test.closest, MAX_CLOSEST);
    let end = nodes(0u).w;
    var count = 0u;
    var i = 0u;
    while i < end {
        var leaf = 0u;
        while i < end && leaf == 0u {
            let low = nodes(i * NODE_TEXELS);
            let high = nodes(i * NODE_TEXELS + 1u);
            let meets = meets_box(reals(low).xyz, reals(high).xyz, ends.p, inverse);
            leaf = select(0u, high.w, meets);
            i += select(low.w, 1u, meets);
        }
        let first = leaf >> COUNT_BITS;
        let last = first + (leaf & ((1u << COUNT_BITS) - 1u));
        var at = first;
        for (; at < last; at++) {
            let crossing = crossing_of(at, ends);
            let surfel = points(at * POINT_TEXELS).w;
            let excluded = surfel == segment.skip_from || surfel == segment.skip_to;
            if crossing >= test.limit || excluded {
                continue;
            }
            // What alone is enough needs no others.
            if look_up(sqrt(crossing)) <= test.threshold {
                return BLOCKED;
            }
            var next = Occluder(distance_of(at, ends), surfel, crossing);
            var k = 0u;
            for (; k < count; k++) {
                let old = found[k];
                if next.distance < old.distance
                    || (next.distance == old.distance && next.surfel < old.surfel) {
                    found[k] = next;
                    next = old;
                }
            }
            if k < count {
                return UNKNOWN;
            }
            if count < most {
                found[count] = next;
                count++;
            }
        }
        if at < last {
            return UNKNOWN;
        }
    }
    // Those that are crossed closest to their middle decide.
    var nearest = vec3(FAR);
    var k = 0u;
    for (; k < count; k++) {
        let crossing = found[k].crossing;
        if crossing < nearest.x {
            nearest = vec3(crossing, nearest.xy);
        } else if crossing < nearest.y {
            nearest = vec3(nearest.x, crossing, nearest.y);
        } else if crossing < nearest.z {
            nearest.z = crossing;
        }
    }
    if i < end || k < count {
        return UNKNOWN;
    }
    let root = sqrt(nearest);
    let visibility = look_up(root.x) * look_up(root.y) * look_up(root.z);
    return select(BLOCKED, VISIBLE, visibility > test.threshold);
}
