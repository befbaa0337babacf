// Adds a sum, not yet divided by the factorials, to a local expansion, or begins it.
fn add_to_local(f: u32, begins: bool, sum: ptr<function, array<Light, COEFFICIENTS>>) {
    #for b of degree 0..=ORDER
    #for k in axes
    (*sum)[$(b,k)] *= 1.0 / $b!.0;
    #end
    #end
    if begins {
        store_locals(f, 0u, (*sum)[0]);
    } else {
        #for b of degree 0..=ORDER
        #for k in axes
        (*sum)[$(b,k)] += load_locals(f, $(b,k)u);
        #end
        #end
    }
    #for b of degree 0..=ORDER
    #for k in axes
    store_locals(f, $(b,k)u, (*sum)[$(b,k)]);
    #end
    #end
}
