// Reading coefficients from the table of expansions.
fn expansion(f: u32, k: u32) -> Light {
    return light(reals(expansions(f * STRIDE + k)));
}
