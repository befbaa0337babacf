// P2P: adds what the surfels of each facet get, by the clamped point kernel, from those of the facets
// in its row that are not near them. The twin of src/passes/cpu/p2p.rs.
// Tables: items, spans, surfels, radiosity. Adds to irradiance.

// What a texel of the table of items holds: some receivers of one facet, and its row.
struct Item {
    first: u32,
    end: u32,
    first_span: u32,
    end_span: u32,
}

// What a texel of the table of spans holds: sources that act with one weight.
struct Span {
    begin: u32,
    end: u32,
    weight: f32,
    padding: u32,
}

const INVERSE_PI = 0.31830988618;
// Near range, squared, of a surfel of area 1 (`Surface::is_near`).
const NEAR: f32 = 2.02 * 2.02;
// The same of any surfel, at least: none lights itself.
const SMALLEST = 1e-36;
// Receivers of an invocation, one a component.
const OWN = 4u;

struct Source {
    position: vec3<f32>,
    // Square of the near range.
    near: f32,
    normal: vec3<f32>,
    // A B / pi times the weight of the link.
    charge: vec3<f32>,
}

// Four receivers.
struct Receivers {
    x: vec4<f32>,
    y: vec4<f32>,
    z: vec4<f32>,
    // Against the normal.
    inward_x: vec4<f32>,
    inward_y: vec4<f32>,
    inward_z: vec4<f32>,
    near: vec4<f32>,
}

// What they got.
struct Sum {
    red: vec4<f32>,
    green: vec4<f32>,
    blue: vec4<f32>,
}

// Square of the near range.
fn near_range(area: f32) -> f32 {
    return max(NEAR * area, SMALLEST);
}

// Source i, or one without light from `end` on.
fn load_source(i: u32, end: u32, weight: f32) -> Source {
    let j = min(i, end - 1u);
    let surfel = reals(surfels(2u * j));
    let normal = reals(surfels(2u * j + 1u)).xyz;
    let strength = select(0.0, surfel.w * weight * INVERSE_PI, i < end);
    return Source(surfel.xyz, near_range(surfel.w), normal, reals(radiosity(j)).xyz * strength);
}

// Receivers first, first + stride, ...; those beyond the end are the last one.
fn load_receivers(first: u32, stride: u32, end: u32) -> Receivers {
    let i = 2u * min(vec4(first, first + stride, first + 2u * stride, first + 3u * stride), vec4(end - 1u));
    let a = reals(surfels(i.x));
    let b = reals(surfels(i.y));
    let c = reals(surfels(i.z));
    let d = reals(surfels(i.w));
    let n_a = -reals(surfels(i.x + 1u)).xyz;
    let n_b = -reals(surfels(i.y + 1u)).xyz;
    let n_c = -reals(surfels(i.z + 1u)).xyz;
    let n_d = -reals(surfels(i.w + 1u)).xyz;
    return Receivers(
        vec4(a.x, b.x, c.x, d.x),
        vec4(a.y, b.y, c.y, d.y),
        vec4(a.z, b.z, c.z, d.z),
        vec4(n_a.x, n_b.x, n_c.x, n_d.x),
        vec4(n_a.y, n_b.y, n_c.y, n_d.y),
        vec4(n_a.z, n_b.z, n_c.z, n_d.z),
        vec4(near_range(a.w), near_range(b.w), near_range(c.w), near_range(d.w)),
    );
}

// The clamped kernel, times pi, of four receivers and one source; (x, y, z) runs from source to
// receiver. Not divided by r⁴, which leaves the range of f32.
fn point_kernel(to: Receivers, source: Source) -> vec4<f32> {
    let x = to.x - source.position.x;
    let y = to.y - source.position.y;
    let z = to.z - source.position.z;
    let square = x * x + y * y + z * z;
    let inverse = select(1.0 / square, vec4(0.0), square < max(to.near, vec4(source.near)));
    let cos_to = max(to.inward_x * x + to.inward_y * y + to.inward_z * z, vec4(0.0));
    let cos_source = max(source.normal.x * x + source.normal.y * y + source.normal.z * z, vec4(0.0));
    return (cos_to * inverse) * (cos_source * inverse);
}

// What four receivers get from a span. Each lane reads every lanes-th source, for all; `team` of
// `teams` takes every teams-th of them.
fn from_span(to: Receivers, span: Span, lane: u32, lanes: u32, team: u32, teams: u32) -> Sum {
    var sum: Sum;
    for (var first = span.begin; first < span.end; first += lanes) {
        let own = load_source(first + lane, span.end, span.weight);
        let steps = (min(lanes, span.end - first) + teams - 1u) / teams;
        for (var k = 0u; k < steps; k++) {
            let giver = k * teams + team;
            let source = Source(
                of_lane(own.position, giver),
                of_lane1(own.near, giver),
                of_lane(own.normal, giver),
                of_lane(own.charge, giver),
            );
            let kernel = point_kernel(to, source);
            sum.red += kernel * source.charge.x;
            sum.green += kernel * source.charge.y;
            sum.blue += kernel * source.charge.z;
        }
    }
    return sum;
}

// Invocations `lane` of `lanes` in step work on an item together. As many of them as its receivers
// need are a team; several teams share the sources.
fn p2p(i: u32, lane: u32, lanes: u32) {
    let texel = items(i);
    let item = Item(texel.x, texel.y, texel.z, texel.w);
    var members = 1u;
    while members < lanes && members * OWN < item.end - item.first {
        members *= 2u;
    }
    let member = lane % members;
    let team = lane / members;
    let teams = lanes / members;
    for (var first = item.first; first < item.end; first += members * OWN) {
        let to = load_receivers(first + member, members, item.end);
        var sum: Sum;
        for (var k = item.first_span; k < item.end_span; k++) {
            let words = spans(k);
            let span = Span(words.x, words.y, bitcast<f32>(words.z), 0u);
            let part = from_span(to, span, lane, lanes, team, teams);
            sum.red += part.red;
            sum.green += part.green;
            sum.blue += part.blue;
        }
        for (var other = members; other < lanes; other *= 2u) {
            sum.red += of_lane4(sum.red, lane ^ other);
            sum.green += of_lane4(sum.green, lane ^ other);
            sum.blue += of_lane4(sum.blue, lane ^ other);
        }
        if team == 0u {
            for (var k = 0u; k < OWN; k++) {
                let at = first + member + k * members;
                if at < item.end {
                    let more = vec3(sum.red[k], sum.green[k], sum.blue[k]);
                    store_irradiance(at, 0u, load_irradiance(at, 0u) + more);
                }
            }
        }
    }
}
