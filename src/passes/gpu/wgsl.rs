//! All stages in WGSL, and what each of them reads.

use super::Shader;

/// The entry point: calls a function of the stage's name for each of a part of its items.
const RANGE: &str = include_str!("../../../shaders/shared/range.wgsl");
/// Expansions and facets.
const EXPANSION: &str = include_str!("../../../shaders/shared/expansion.wgsl");
/// Reading a table of links.
const LINK: &str = include_str!("../../../shaders/shared/link.wgsl");
/// The entry point: a subgroup for each of a part of the items.
const SUBGROUP: &str = include_str!("../../../shaders/shared/subgroup.wgsl");

macro_rules! stage {
    ($name:literal, [$($table:literal),*], [$($expansion:literal),*], [$($shared:expr),*]) => {
        Shader {
            name: $name,
            tables: &[$($table),*],
            expansions: &[$($expansion),*],
            shared: &[$($shared),*],
            lanes: 1,
            text: include_str!(concat!("../../../shaders/", $name, ".wgsl")),
        }
    };
}

// Name, tables, expansions, shared texts.
pub const VISIBILITY: Shader = stage!("visibility", ["nodes", "occluders"], [], []);
pub const P2M: Shader = stage!(
    "p2m",
    ["facets", "surfels", "radiosity"],
    ["moments"],
    [RANGE, EXPANSION]
);
pub const M2M: Shader = stage!("m2m", ["facets"], ["moments"], [RANGE, EXPANSION]);
pub const M2L: Shader = stage!(
    "m2l",
    ["facets", "rows", "links", "moments"],
    ["locals"],
    [RANGE, EXPANSION, LINK]
);
pub const L2L: Shader = stage!("l2l", ["facets"], ["locals"], [RANGE, EXPANSION]);
pub const L2P: Shader = stage!("l2p", ["facets", "surfels"], ["locals"], [RANGE, EXPANSION]);
pub const NEAR_FIELD: Shader = stage!(
    "near_field",
    ["rows", "links", "radiosity"],
    [],
    [RANGE, LINK]
);
pub const P2P: Shader = Shader {
    lanes: 8,
    ..stage!(
        "p2p",
        ["items", "spans", "surfels", "radiosity"],
        [],
        [SUBGROUP]
    )
};
pub const P2P_ALONE: Shader = stage!(
    "p2p_alone",
    ["items", "spans", "surfels", "radiosity"],
    [],
    [RANGE, P2P.text]
);
pub const FORM_FACTOR: Shader = stage!("form_factor", ["cells"], [], [RANGE]);
pub const AXPY: Shader = stage!("axpy", [], [], [RANGE]);
pub const SCALE: Shader = stage!("scale", [], [], [RANGE]);
pub const MULTIPLY: Shader = stage!("multiply", [], [], [RANGE]);
pub const INNER_PRODUCT: Shader = stage!("inner_product", [], [], [RANGE]);

/// All of them.
pub const SHADERS: &[&Shader] = &[
    &VISIBILITY,
    &P2M,
    &M2M,
    &M2L,
    &L2L,
    &L2P,
    &NEAR_FIELD,
    &P2P,
    &P2P_ALONE,
    &FORM_FACTOR,
    &AXPY,
    &SCALE,
    &MULTIPLY,
    &INNER_PRODUCT,
];
