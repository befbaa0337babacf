// Light that a stage reads and writes, STRIDE vectors an item: the part that this dispatch needs,
// from the item `range.base` on. NAME, BINDING and STRIDE are filled in.
@group(0) @binding(BINDING) var<storage, read_write> NAME: array<vec4<f32>>;

fn load_NAME(item: u32, k: u32) -> Light {
    return light(NAME[(item - range.base) * STRIDE + k]);
}

fn store_NAME(item: u32, k: u32, value: Light) {
    NAME[(item - range.base) * STRIDE + k]PLACE = VALUE;
}
