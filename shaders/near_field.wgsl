// Near field (P2P): adds what each surfel gets from the surfels it is linked to. The twin of
// src/passes/cpu/near_field.rs.
// Tables: rows, links, radiosity. Adds to irradiance.

fn near_field(i: u32) {
    let row = rows(i);
    var sum = load_irradiance(row.x, 0u);
    for (var e = row.y; e < row.z; e++) {
        let entry = link(e);
        sum += light(reals(radiosity(entry.source))) * entry.weight;
    }
    store_irradiance(row.x, 0u, sum);
}
