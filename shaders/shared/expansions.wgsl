// Expansions that a stage reads and writes. NAME and BINDING are filled in.
@group(0) @binding(BINDING) var<storage, read_write> NAME: array<vec4<f32>>;

fn load_NAME(f: u32) -> Expansion {
    let at = f * COEFFICIENTS;
    return Expansion(
        NAME[at].xyz,
        mat3x3(NAME[at + 1u].xyz, NAME[at + 2u].xyz, NAME[at + 3u].xyz),
        array(
            mat3x3(NAME[at + 4u].xyz, NAME[at + 7u].xyz, NAME[at + 10u].xyz),
            mat3x3(NAME[at + 5u].xyz, NAME[at + 8u].xyz, NAME[at + 11u].xyz),
            mat3x3(NAME[at + 6u].xyz, NAME[at + 9u].xyz, NAME[at + 12u].xyz),
        ),
    );
}

fn store_NAME(f: u32, expansion: Expansion) {
    let at = f * COEFFICIENTS;
    NAME[at] = vec4(expansion.scalar, 0.0);
    NAME[at + 1u] = vec4(expansion.zeroth[0], 0.0);
    NAME[at + 2u] = vec4(expansion.zeroth[1], 0.0);
    NAME[at + 3u] = vec4(expansion.zeroth[2], 0.0);
    NAME[at + 4u] = vec4(expansion.first[0][0], 0.0);
    NAME[at + 5u] = vec4(expansion.first[1][0], 0.0);
    NAME[at + 6u] = vec4(expansion.first[2][0], 0.0);
    NAME[at + 7u] = vec4(expansion.first[0][1], 0.0);
    NAME[at + 8u] = vec4(expansion.first[1][1], 0.0);
    NAME[at + 9u] = vec4(expansion.first[2][1], 0.0);
    NAME[at + 10u] = vec4(expansion.first[0][2], 0.0);
    NAME[at + 11u] = vec4(expansion.first[1][2], 0.0);
    NAME[at + 12u] = vec4(expansion.first[2][2], 0.0);
}
