//! Decompression of LZF (Marc Lehmann's LibLZF), as PCD files use it.

/// The most bytes that one compressed byte can stand for: three bytes give 264.
const MAX_RATIO: u64 = 88;

/// Refuses sizes that cannot both be true, before anything is allocated for them.
pub fn check(packed: u64, unpacked: u64) -> Result<(), String> {
    if unpacked > packed * MAX_RATIO {
        return Err(format!(
            "{packed} compressed bytes cannot hold {unpacked}: LZF saves a factor of {MAX_RATIO} at \
             most"
        ));
    }
    Ok(())
}

/// Fills `output` exactly.
///
/// A byte below 32 comes before that many and one literal bytes. Otherwise its upper three bits are
/// a length less 2 (7: the next byte is added), its lower five and a next byte a distance less 1 of
/// bytes to repeat.
pub fn decompress(input: &[u8], output: &mut [u8]) -> Result<(), String> {
    let damaged = || "the compressed points are damaged".to_owned();
    let mut rest = input;
    let mut done = 0;
    while let Some((&control, after)) = rest.split_first() {
        let control = usize::from(control);
        rest = after;
        if control < 32 {
            let (literal, after) = rest.split_at_checked(control + 1).ok_or_else(damaged)?;
            let place = output.get_mut(done..done + literal.len());
            place.ok_or_else(damaged)?.copy_from_slice(literal);
            done += literal.len();
            rest = after;
            continue;
        }
        let mut next = || {
            let (&byte, after) = rest.split_first().ok_or_else(damaged)?;
            rest = after;
            Ok::<usize, String>(usize::from(byte))
        };
        let mut length = control >> 5;
        if length == 7 {
            length += next()?;
        }
        let distance = ((control & 31) << 8) + next()? + 1;
        let from = done.checked_sub(distance).ok_or_else(damaged)?;
        let end = done + length + 2;
        if end > output.len() {
            return Err(damaged());
        }
        // What is repeated may be what is being written.
        for i in done..end {
            output[i] = output[from + i - done];
        }
        done = end;
    }
    if done == output.len() {
        Ok(())
    } else {
        Err(damaged())
    }
}
