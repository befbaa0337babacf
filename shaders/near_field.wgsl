// Near field (P2P): adds what each surfel gets from the surfels it is linked to. The twin of
// src/passes/cpu/near_field.rs.
// Tables: rows, links, radiosity.

@group(0) @binding(3) var<storage, read_write> irradiance: array<vec4<f32>>;

fn near_field(i: u32) {
    let row = rows(i);
    var sum = irradiance[row.x].xyz;
    for (var k = row.y; k < row.z; k++) {
        let entry = link(k);
        sum += reals(radiosity(entry.source)).xyz * entry.weight;
    }
    irradiance[row.x] = vec4(sum, 0.0);
}
