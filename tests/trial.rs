//! A device on trial: a driver that computes wrongly is found, whichever stage it gets wrong.

mod common;

use common::gpu;
use fmmgi_gpu::operator::trial;
use fmmgi_gpu::passes::gpu::{Gpu, MAX_ORDER, Shader, wgsl};

const ORDER: usize = 1;

/// What a wrong driver makes of each stage, once in its text, and what the trial says of it.
const WRONG: [(&Shader, &str, &str, &str); 17] = [
    (&wgsl::P2M, "* surfel.w", "* sqrt(surfel.w)", "P2M"),
    (&wgsl::M2M, "* ratio[$|b|]", "", "M2M"),
    (&wgsl::M2L, "entry.weight);", "1.0);", "M2L"),
    (&wgsl::M2L, "* entry.weight", "", "samples"),
    (&wgsl::L2L, "inherited * ratio[$|b|]", "inherited", "L2L"),
    (&wgsl::L2P, "+ sum", "- sum", "L2P"),
    (&wgsl::P2L, "* target_scale[$|b|]", "", "P2L"),
    (&wgsl::M2P, "* source_scale[$|a|]", "", "M2P"),
    (&wgsl::MIXED, "1.0 / $b!.0", "1.01", "mixed"),
    (
        &wgsl::NEAR_FIELD,
        "e < row.z",
        "e + 1u < row.z",
        "near field",
    ),
    (&wgsl::P2P, "0.31830988618", "0.3184", "P2P"),
    (&wgsl::AXPY, "* a", "* (a + 1.0)", "fields"),
    (&wgsl::SCALE, "* a", "* abs(a)", "fields"),
    (&wgsl::MULTIPLY, "factor[i].xyz", "factor[i].xzy", "fields"),
    (
        &wgsl::INNER_PRODUCT,
        "item < items",
        "item + 1u < items",
        "fields",
    ),
    (&wgsl::SUM, "j < parts", "j + 1u < parts", "fields"),
    (&wgsl::VISIBILITY, "> second.w", "< second.w", "visibility"),
];

/// A stage as the trial asks for it.
fn stage(shader: &Shader) -> Shader {
    match wgsl::EXPANSION_STAGES.contains(&shader) || shader.name == "mixed" {
        true => shader.of_order(ORDER, ORDER),
        false => *shader,
    }
}

#[test]
fn a_wrong_kernel_is_found() {
    for (shader, right, wrong, name) in WRONG {
        let device = Gpu::new(&gpu().device, &gpu().queue);
        let right_one = stage(shader);
        assert!(shader.text.contains(right), "{}: {right}", shader.name);
        let text = shader.text.replacen(right, wrong, 1);
        let wrong_one = Shader {
            text: text.leak(),
            ..right_one
        };
        device.mistake(&right_one, &wrong_one).unwrap();
        let found = trial(&device, ORDER);
        let error = found.expect_err(shader.name);
        assert_eq!(error.exit_code(), 3);
        let message = error.to_string();
        println!("{}: {message}", shader.name);
        assert!(message.contains(name), "{}: {message}", shader.name);
    }
}

#[test]
fn a_right_device_passes_at_any_order() {
    for order in [0, 1, 3, MAX_ORDER] {
        trial(&Gpu::new(&gpu().device, &gpu().queue), order).unwrap();
    }
}
