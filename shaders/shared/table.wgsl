// How a stage reads a table, which is read-only data in texels of 16 bytes: NAME(i) is texel i.
// The words are integers because integers come out of a texture as they went in; `bitcast` makes
// reals of them. NAME and BINDING are filled in for each table of a stage.
@group(0) @binding(BINDING) var NAME_texels: texture_2d<u32>;

fn NAME(i: u32) -> vec4<u32> {
    return textureLoad(NAME_texels, vec2(i % TABLE_WIDTH, i / TABLE_WIDTH), 0);
}
