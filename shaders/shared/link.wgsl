// Links in a table, two a texel.
struct Link {
    source: u32,
    weight: f32,
}

fn link(k: u32) -> Link {
    let pair = links(k >> 1u);
    let words = select(pair.xy, pair.zw, (k & 1u) == 1u);
    return Link(words.x, bitcast<f32>(words.y));
}
