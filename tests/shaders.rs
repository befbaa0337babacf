//! The WGSL as it is used: valid, and of the same layout and numbers as the Rust beside it.

use std::mem::offset_of;

use fmmgi_gpu::expansion::{NEAR_SPACINGS, coefficients};
use fmmgi_gpu::passes::gpu::wgsl::EXPANSION_STAGES;
use fmmgi_gpu::passes::gpu::{
    Cell, Facet, Link, MAX_ORDER, MixedItem, MixedPart, PointItem, PointSpan, PointTestUniform,
    SHADERS, Shader, Surfel,
};
use fmmgi_gpu::visibility::{LOOKUP, MAX_CLOSEST, Node, Occluder, PointOccluder, Segment};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{Expression, Literal, Module, TypeInner};

fn module(name: &str) -> Module {
    parsed(SHADERS.iter().find(|s| s.name == name).unwrap())
}

fn parsed(shader: &Shader) -> Module {
    let name = shader.name;
    let source = shader.source();
    naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(&source)))
}

/// Names and offsets of a struct's members, and its size in an array.
fn layout(module: &Module, name: &str) -> (Vec<(String, usize)>, usize) {
    let (_, ty) = module
        .types
        .iter()
        .find(|(_, ty)| ty.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("no struct {name}"));
    let TypeInner::Struct { members, span } = &ty.inner else {
        panic!("{name} is no struct");
    };
    let members = members
        .iter()
        .map(|m| (m.name.clone().unwrap(), m.offset as usize))
        .collect();
    (members, *span as usize)
}

/// Compares the offsets of all members, in order, and the size.
macro_rules! same_layout {
    ($module:expr, $rust:ty, $name:literal, [$($field:ident => $member:literal),* $(,)?]) => {
        let expected = vec![$(($member.to_owned(), offset_of!($rust, $field))),*];
        assert_eq!(layout($module, $name), (expected, size_of::<$rust>()), $name);
    };
}

fn constant(module: &Module, name: &str) -> u32 {
    match literal(module, name) {
        Literal::U32(value) => value,
        other => panic!("{name}: {other:?}"),
    }
}

fn literal(module: &Module, name: &str) -> Literal {
    let (_, constant) = module
        .constants
        .iter()
        .find(|(_, c)| c.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("no constant {name}"));
    match module.global_expressions[constant.init] {
        Expression::Literal(value) => value,
        ref other => panic!("{name}: {other:?}"),
    }
}

#[test]
fn all_stages_are_valid() {
    let orders = (0..=MAX_ORDER).flat_map(|full| [(full, full), (full / 2, full)]);
    let expansions = orders.flat_map(|(order, full)| {
        let of_order = move |shader: &&Shader| shader.of_order(order, full);
        EXPANSION_STAGES.iter().map(of_order)
    });
    for shader in SHADERS.iter().map(|&&s| s).chain(expansions) {
        let module = parsed(&shader);
        Validator::new(ValidationFlags::all(), Capabilities::SUBGROUP)
            .validate(&module)
            .unwrap_or_else(|e| panic!("{}: {}", shader.name, e.emit_to_string(&shader.source())));
        assert_eq!(module.entry_points.len(), 1, "{}", shader.name);
        assert_eq!(module.entry_points[0].name, "main", "{}", shader.name);
    }
}

#[test]
fn every_stage_file_is_listed() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/shaders");
    let mut files: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter_map(|file| file.strip_suffix(".wgsl").map(str::to_owned))
        .collect();
    let mut listed: Vec<&str> = SHADERS.iter().map(|s| s.name).collect();
    files.sort();
    listed.sort();
    assert_eq!(files, listed);
}

#[test]
fn visibility_reads_what_rust_writes() {
    let module = module("visibility");
    same_layout!(&module, Segment, "Segment", [
        from => "start", skip_from => "skip_from", to => "end", skip_to => "skip_to",
    ]);
    same_layout!(&module, Node, "Node", [
        min => "min", skip => "skip", max => "max", leaf => "leaf",
    ]);
    same_layout!(&module, Occluder, "Occluder", [
        position => "position", surfel => "surfel",
        normal => "normal", radius_squared => "radius_squared",
        tangent => "tangent", back => "back",
        corners => "corners",
    ]);
    assert_eq!(
        constant(&module, "NODE_TEXELS") as usize,
        size_of::<Node>() / 16
    );
    assert_eq!(
        constant(&module, "OCCLUDER_TEXELS") as usize,
        size_of::<Occluder>() / 16
    );
    assert_eq!(constant(&module, "COUNT_BITS"), Node::COUNT_BITS);
}

#[test]
fn point_visibility_reads_what_rust_writes() {
    let module = module("point_visible");
    same_layout!(&module, Node, "Node", [
        min => "min", skip => "skip", max => "max", leaf => "leaf",
    ]);
    same_layout!(&module, PointOccluder, "Point", [
        position => "position", surfel => "surfel",
        normal => "normal", inverse_area => "inverse_area",
    ]);
    same_layout!(&module, Segment, "Segment", [
        from => "start", skip_from => "skip_from", to => "end", skip_to => "skip_to",
    ]);
    same_layout!(&module, PointTestUniform, "Test", [
        threshold => "threshold", closest => "closest", limit => "limit", steps => "steps",
        lookup => "lookup",
    ]);
    assert_eq!(
        constant(&module, "NODE_TEXELS") as usize,
        size_of::<Node>() / 16
    );
    assert_eq!(
        constant(&module, "POINT_TEXELS") as usize,
        size_of::<PointOccluder>() / 16
    );
    assert_eq!(constant(&module, "COUNT_BITS"), Node::COUNT_BITS);
    assert_eq!(constant(&module, "LOOKUP") as usize, LOOKUP);
    assert_eq!(constant(&module, "MAX_CLOSEST") as usize, MAX_CLOSEST);
}

#[test]
fn expansions_read_what_rust_writes() {
    for stage in EXPANSION_STAGES {
        let module = parsed(&stage.of_order(2, 4));
        same_layout!(&module, Facet, "Facet", [
            centre => "centre", scale => "scale", begin => "begin", end => "end",
            first_child => "first_child", child_count => "child_count",
            parent => "parent", padding => "padding",
        ]);
        same_layout!(&module, Surfel, "Surfel", [
            position => "position", area => "area", normal => "normal", padding => "padding",
        ]);
        assert_eq!(
            constant(&module, "FACET_TEXELS") as usize,
            size_of::<Facet>() / 16
        );
        assert_eq!(
            constant(&module, "SURFEL_TEXELS") as usize,
            size_of::<Surfel>() / 16
        );
        assert_eq!(constant(&module, "COEFFICIENTS") as usize, coefficients(2));
        assert_eq!(constant(&module, "STRIDE") as usize, coefficients(4));
    }
}

#[test]
fn links_are_read_as_rust_writes_them() {
    for name in ["m2l", "p2l", "m2p", "near_field"] {
        same_layout!(&module(name), Link, "Link", [source => "source", weight => "weight"]);
    }
}

#[test]
fn points_are_read_as_rust_writes_them() {
    for name in ["p2p", "p2p_alone"] {
        let module = module(name);
        same_layout!(&module, PointItem, "Item", [
            first => "first", end => "end", first_span => "first_span", end_span => "end_span",
        ]);
        same_layout!(&module, PointSpan, "Span", [
            begin => "begin", end => "end", weight => "weight", padding => "padding",
        ]);
        let near = (NEAR_SPACINGS * NEAR_SPACINGS) as f32;
        assert_eq!(literal(&module, "NEAR"), Literal::F32(near));
    }
}

#[test]
fn mixed_links_are_read_as_rust_writes_them() {
    let module = module("mixed");
    same_layout!(&module, MixedItem, "Item", [
        facet => "facet", first => "first", end => "end", first_part => "first_part",
        end_part => "end_part", padding => "padding",
    ]);
    same_layout!(&module, MixedPart, "Part", [
        source => "source", begin => "begin", end => "end", weight => "weight",
    ]);
    assert_eq!(
        constant(&module, "ITEM_TEXELS") as usize,
        size_of::<MixedItem>() / 16
    );
}

#[test]
fn form_factors_read_what_rust_writes() {
    let module = module("form_factor");
    same_layout!(&module, Cell, "Cell", [
        position => "position", area => "area", normal => "normal", padding0 => "padding0",
        tangent => "tangent", padding1 => "padding1", corners => "corners",
    ]);
    assert_eq!(
        constant(&module, "CELL_TEXELS") as usize,
        size_of::<Cell>() / 16
    );
}
