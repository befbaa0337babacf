// Form factor F_ij of pairs of surfels without occlusion. The twin of src/expansion/kernel.rs
// (`Surface::form_factor`) and src/expansion/form_factor.rs.
// Tables: cells (7 texels each).

// What the texels of the table hold.
struct Cell {
    position: vec3<f32>,
    area: f32,
    normal: vec3<f32>,
    padding0: f32,
    tangent: vec3<f32>,
    padding1: f32,
    corners: array<vec4<f32>, 4>,
}

const CELL_TEXELS = 7u;
const NEAR_SPACINGS = 2.02;
const PI = 3.14159265359;

@group(0) @binding(1) var<storage, read> pairs: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> form_factors: array<f32>;

// Angle of the place (x, y), y >= 0, in [0, pi], to the last bits; WGSL promises no more than 11 bits
// of atan2. The polynomial is that of atanf in Cephes (Moshier 1989).
fn angle(y: f32, x: f32) -> f32 {
    let most = max(y, abs(x));
    let t = min(y, abs(x)) / most;
    let steep = t > 0.41421357;
    let u = select(t, (t - 1.0) / (t + 1.0), steep);
    let z = u * u;
    let series = ((0.080537446 * z - 0.13877685) * z + 0.19977711) * z - 0.3333295;
    var a = select(0.0, 0.25 * PI, steep) + (u + u * z * series);
    a = select(a, 0.5 * PI - a, y > abs(x));
    return select(a, PI - a, x < 0.0);
}

// Angle under which the edge start a to b is seen, times the cosine between `normal` and its plane.
fn edge(normal: vec3<f32>, a: vec3<f32>, b: vec3<f32>) -> f32 {
    let product = cross(a, b);
    let sine = length(product);
    if sine > 0.0 {
        return angle(sine, dot(a, b)) * dot(normal, product) / sine;
    }
    return 0.0;
}

// Walk past the corners of the polygon's part above the horizon, one by one. (An edge that lies in
// the horizon may cross it several times by rounding.)
struct Walk {
    sum: f32,
    begun: bool,
    first: vec3<f32>,
    last: vec3<f32>,
}

fn pass_corner(walk: ptr<function, Walk>, normal: vec3<f32>, p: vec3<f32>) {
    if (*walk).begun {
        (*walk).sum += edge(normal, (*walk).last, p);
    } else {
        (*walk).begun = true;
        (*walk).first = p;
    }
    (*walk).last = p;
}

// The edge from a, which the walk has not passed yet, to b, which it will pass next.
fn pass_edge(walk: ptr<function, Walk>, normal: vec3<f32>, a: vec3<f32>, b: vec3<f32>) {
    let height_a = dot(normal, a);
    let height_b = dot(normal, b);
    if height_a >= 0.0 {
        pass_corner(walk, normal, a);
    }
    if (height_a >= 0.0) != (height_b >= 0.0) {
        pass_corner(walk, normal, a + (b - a) * (height_a / (height_a - height_b)));
    }
}

// To the cell of surfel j, whose centre is at r.
fn polygon_form_factor(normal: vec3<f32>, r: vec3<f32>, n: vec3<f32>, j: u32) -> f32 {
    let tangent = reals(cells(j * CELL_TEXELS + 2u)).xyz;
    let bitangent = cross(n, tangent);
    let scale = 1.0 / length(r); // as areas are squared, which must stay in the range of f32
    var walk: Walk;
    var first: vec3<f32>;
    var last: vec3<f32>;
    for (var k = 0u; k < 4u; k++) {
        let two = reals(cells(j * CELL_TEXELS + 3u + k));
        let a = (r + (tangent * two.x + bitangent * two.y)) * scale;
        let b = (r + (tangent * two.z + bitangent * two.w)) * scale;
        if k == 0u {
            first = a;
        } else {
            pass_edge(&walk, normal, last, a);
        }
        pass_edge(&walk, normal, a, b);
        last = b;
    }
    pass_edge(&walk, normal, last, first);
    if walk.begun {
        walk.sum += edge(normal, walk.last, walk.first);
    }
    return max(-walk.sum / (2.0 * PI), 0.0);
}

fn pair_form_factor(i: u32, j: u32) -> f32 {
    let to = reals(cells(i * CELL_TEXELS));
    let to_normal = reals(cells(i * CELL_TEXELS + 1u)).xyz;
    let source = reals(cells(j * CELL_TEXELS));
    let normal = reals(cells(j * CELL_TEXELS + 1u)).xyz;
    let r = source.xyz - to.xyz;
    let r2 = dot(r, r);
    let cos_to = dot(to_normal, r);
    let cos_source = -dot(normal, r);
    if r2 >= NEAR_SPACINGS * NEAR_SPACINGS * max(to.w, source.w) {
        let faces = cos_to > 0.0 && cos_source > 0.0;
        let inverse = 1.0 / r2;
        return select(0.0, source.w * ((cos_to * inverse) * (cos_source * inverse) / PI), faces);
    }
    if i == j || cos_source <= 0.0 {
        return 0.0; // a cell does not light its own plane or what lies behind it
    }
    return polygon_form_factor(to_normal, r, normal, j);
}

fn form_factor(k: u32) {
    let pair = pairs[k];
    form_factors[k] = pair_form_factor(pair.x, pair.y);
}
