//! Arrays of 32-bit words in a file, little-endian on every machine, with a checksum over all of them.

use std::io::{self, Read, Write};

use bytemuck::{Pod, cast_slice, cast_slice_mut};
use xxhash_rust::xxh3::Xxh3Default;

/// Words that go through the processor's cache at once.
const CHUNK: usize = 1 << 16;

/// Writes arrays.
pub struct Writer<W> {
    to: W,
    hash: Xxh3Default,
}

impl<W: Write> Writer<W> {
    pub fn new(to: W) -> Writer<W> {
        Writer {
            to,
            hash: Xxh3Default::new(),
        }
    }

    /// Numbers of 32 bits, or what is made of them.
    pub fn array<T: Pod>(&mut self, values: &[T]) -> io::Result<()> {
        let mut chunk = Vec::with_capacity(CHUNK);
        for words in cast_slice::<T, u32>(values).chunks(CHUNK) {
            chunk.clear();
            chunk.extend(words.iter().map(|w| w.to_le()));
            self.hash.update(cast_slice(&chunk));
            self.to.write_all(cast_slice(&chunk))?;
        }
        Ok(())
    }

    /// Writes the checksum of all that was written.
    pub fn end(mut self) -> io::Result<()> {
        self.to.write_all(&self.hash.digest().to_le_bytes())
    }
}

/// Reads them again.
pub struct Reader<R> {
    from: R,
    hash: Xxh3Default,
}

impl<R: Read> Reader<R> {
    pub fn new(from: R) -> Reader<R> {
        Reader {
            from,
            hash: Xxh3Default::new(),
        }
    }

    /// So many values; the caller knows that the file has them.
    pub fn array<T: Pod>(&mut self, count: usize) -> io::Result<Vec<T>> {
        let mut values = bytemuck::zeroed_vec::<T>(count);
        for words in cast_slice_mut::<T, u32>(&mut values).chunks_mut(CHUNK) {
            self.from.read_exact(cast_slice_mut(words))?;
            self.hash.update(cast_slice(words));
            words.iter_mut().for_each(|w| *w = u32::from_le(*w));
        }
        Ok(values)
    }

    /// Whether what was read has the checksum that follows.
    pub fn end(mut self) -> io::Result<bool> {
        let mut checksum = [0; 8];
        self.from.read_exact(&mut checksum)?;
        Ok(u64::from_le_bytes(checksum) == self.hash.digest())
    }
}
