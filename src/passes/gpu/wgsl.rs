//! All stages in WGSL, and what each of them reads.

use super::Shader;

/// The entry point: calls a function of the stage's name for each of a part of its items.
const RANGE: &str = include_str!("../../../shaders/shared/range.wgsl");
/// Expansions and facets.
const EXPANSION: &str = include_str!("../../../shaders/shared/expansion.wgsl");
/// Reading coefficients from a table.
const COEFFICIENTS: &str = include_str!("../../../shaders/shared/coefficients.wgsl");
/// Derivatives of the kernel.
pub(super) const KERNEL: &str = include_str!("../../../shaders/shared/kernel.wgsl");
/// The same for a surfel.
const SURFEL_KERNEL: &str = include_str!("../../../shaders/shared/surfel_kernel.wgsl");
/// P2M of a surfel.
const SURFEL_MOMENTS: &str = include_str!("../../../shaders/shared/surfel_moments.wgsl");
/// M2L of a link.
const FIELD: &str = include_str!("../../../shaders/shared/field.wgsl");
/// L2P of a surfel.
const SURFEL_FIELD: &str = include_str!("../../../shaders/shared/surfel_field.wgsl");
/// Reading a table of links.
const LINK: &str = include_str!("../../../shaders/shared/link.wgsl");
/// The hierarchy of boxes that segments walk, and the entry point: an answer for each segment.
const BVH: &str = include_str!("../../../shaders/shared/bvh.wgsl");
/// The entry point: a subgroup for each of a part of the items.
const SUBGROUP: &str = include_str!("../../../shaders/shared/subgroup.wgsl");

macro_rules! stage {
    ($name:literal, [$($table:literal),*], [$($vectors:literal),*], [$($shared:expr),*]) => {
        Shader {
            name: $name,
            tables: &[$($table),*],
            vectors: &[$($vectors),*],
            shared: &[$($shared),*],
            lanes: 1,
            text: include_str!(concat!("../../../shaders/", $name, ".wgsl")),
            order: 0,
            full_order: 0,
        }
    };
}

// Name, tables, light, shared texts.
pub const VISIBILITY: Shader = stage!("visibility", ["nodes", "occluders"], [], [BVH]);
pub const POINT_VISIBLE: Shader = stage!("point_visible", ["nodes", "points"], [], [BVH]);
pub const P2M: Shader = stage!(
    "p2m",
    ["facets", "surfels", "radiosity"],
    ["moments"],
    [RANGE, EXPANSION, SURFEL_MOMENTS]
);
pub const M2M: Shader = stage!(
    "m2m",
    ["facets", "expansions"],
    ["moments"],
    [RANGE, EXPANSION, COEFFICIENTS]
);
pub const M2L: Shader = stage!(
    "m2l",
    ["facets", "rows", "links", "expansions"],
    ["locals"],
    [RANGE, EXPANSION, COEFFICIENTS, KERNEL, FIELD, LINK]
);
pub const P2L: Shader = stage!(
    "p2l",
    ["facets", "surfels", "rows", "links", "radiosity"],
    ["locals"],
    [RANGE, EXPANSION, KERNEL, SURFEL_KERNEL, LINK]
);
pub const M2P: Shader = stage!(
    "m2p",
    ["facets", "surfels", "rows", "links", "expansions"],
    ["irradiance"],
    [RANGE, EXPANSION, COEFFICIENTS, KERNEL, SURFEL_KERNEL, LINK]
);
pub const L2L: Shader = stage!(
    "l2l",
    ["facets", "expansions"],
    ["locals"],
    [RANGE, EXPANSION, COEFFICIENTS]
);
pub const L2P: Shader = stage!(
    "l2p",
    ["facets", "surfels", "expansions"],
    ["irradiance"],
    [RANGE, EXPANSION, COEFFICIENTS, SURFEL_FIELD]
);
pub const MIXED: Shader = stage!(
    "mixed",
    ["facets", "surfels", "items", "parts", "radiosity"],
    ["irradiance"],
    [
        RANGE,
        EXPANSION,
        SURFEL_MOMENTS,
        KERNEL,
        FIELD,
        SURFEL_FIELD
    ]
);
pub const NEAR_FIELD: Shader = stage!(
    "near_field",
    ["rows", "links", "radiosity"],
    ["irradiance"],
    [RANGE, LINK]
);
pub const P2P: Shader = Shader {
    lanes: 8,
    ..stage!(
        "p2p",
        ["items", "spans", "surfels", "radiosity"],
        ["irradiance"],
        [SUBGROUP]
    )
};
pub const P2P_ALONE: Shader = stage!(
    "p2p_alone",
    ["items", "spans", "surfels", "radiosity"],
    ["irradiance"],
    [RANGE, P2P.text]
);
pub const FORM_FACTOR: Shader = stage!("form_factor", ["cells"], [], [RANGE]);
pub const AXPY: Shader = stage!("axpy", [], [], [RANGE]);
pub const SCALE: Shader = stage!("scale", [], [], [RANGE]);
pub const MULTIPLY: Shader = stage!("multiply", [], [], [RANGE]);
pub const INNER_PRODUCT: Shader = stage!("inner_product", [], [], [RANGE]);
pub const SUM: Shader = stage!("sum", [], [], [RANGE]);

/// Those on expansions, which there are of every order.
pub const EXPANSION_STAGES: &[&Shader] = &[&P2M, &M2M, &M2L, &P2L, &M2P, &L2L, &L2P];

/// All of them.
pub const SHADERS: &[&Shader] = &[
    &VISIBILITY,
    &POINT_VISIBLE,
    &P2M,
    &M2M,
    &M2L,
    &P2L,
    &M2P,
    &L2L,
    &L2P,
    &MIXED,
    &NEAR_FIELD,
    &P2P,
    &P2P_ALONE,
    &FORM_FACTOR,
    &AXPY,
    &SCALE,
    &MULTIPLY,
    &INNER_PRODUCT,
    &SUM,
];
