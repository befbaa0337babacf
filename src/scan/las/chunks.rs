//! Compressed points: chunks, each on its own, in parallel.

use std::io::{self, Cursor, Read, Seek, SeekFrom};

use laz::laszip::ChunkTable;
use laz::record::{
    LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor,
};
use laz::{DecompressionSelection, LazItemRecordBuilder, LazItemType, LazVlr};

use super::header::Header;

/// Points that are decompressed before they are handed on.
const BLOCK: u64 = 1 << 12;
/// Most points that a compressed byte can stand for. In scans it is less than one; equal points,
/// which compress best, come to 148 in chunks of 50,000.
const MOST_POINTS_A_BYTE: u64 = 256;
/// Where the table of chunks is.
const OFFSET: u64 = 8;

/// How the points are compressed, checked against the header and the file's length.
pub struct Compression {
    vlr: LazVlr,
    layered: bool,
    stride: usize,
    /// Where the first chunk begins in the file.
    pub begin: u64,
    pub chunks: Vec<Chunk>,
}

#[derive(Clone, Copy)]
pub struct Chunk {
    pub points: u64,
    pub bytes: u64,
}

impl Compression {
    /// Of a file of `bytes` bytes; fails with what is wrong.
    pub fn read(
        input: &mut (impl Read + Seek),
        bytes: u64,
        header: &Header,
    ) -> Result<Self, String> {
        let record = header
            .laszip
            .as_deref()
            .ok_or("compressed, but without the record that says how")?;
        let vlr = LazVlr::from_buffer(record).map_err(|e| format!("compression: {e}"))?;
        check_items(&vlr, header)?;
        let layered = vlr.items()[0].version() > 2;
        let kind = u16::from_le_bytes([record[0], record[1]]);
        let (begin, chunks) = match (kind, layered) {
            // One stream, as was written before there were chunks.
            (1, false) => (
                header.begin,
                vec![Chunk {
                    points: header.points,
                    bytes: bytes - header.begin,
                }],
            ),
            (2, false) | (3, true) => (
                header.begin + OFFSET,
                read_table(input, bytes, header, &vlr)?,
            ),
            _ => {
                return Err(format!(
                    "compression of kind {kind} does not fit the points"
                ));
            }
        };
        let dense = |chunk: &&Chunk| chunk.points > chunk.bytes.saturating_mul(MOST_POINTS_A_BYTE);
        if let Some(chunk) = chunks.iter().find(dense) {
            return Err(format!(
                "{} points are said to be in {} compressed bytes, which cannot be",
                chunk.points, chunk.bytes
            ));
        }
        Ok(Compression {
            vlr,
            layered,
            stride: header.stride,
            begin,
            chunks,
        })
    }

    /// Decompresses a chunk and hands the bytes of its points to `take`, block by block: with `all` every
    /// field, else those that make a cloud.
    pub fn decompress(
        &self,
        chunk: Chunk,
        bytes: &[u8],
        all: bool,
        mut take: impl FnMut(&[u8]),
    ) -> laz::Result<()> {
        let mut points: Box<dyn RecordDecompressor<Cursor<&[u8]>>> = if self.layered {
            check_layers(bytes, self.stride, self.vlr.items())?;
            Box::new(LayeredPointRecordDecompressor::new(Cursor::new(bytes)))
        } else {
            Box::new(SequentialPointRecordDecompressor::new(Cursor::new(bytes)))
        };
        points.set_fields_from(self.vlr.items())?;
        points.set_selection(match all {
            true => DecompressionSelection::all(),
            false => DecompressionSelection::xy_returns_channel()
                .decompress_z()
                .decompress_classification()
                .decompress_flags()
                .decompress_rgb()
                .decompress_extra_bytes(),
        });
        let mut block = vec![0; chunk.points.min(BLOCK) as usize * self.stride];
        let mut left = chunk.points;
        while left > 0 {
            let count = left.min(BLOCK);
            let block = &mut block[..count as usize * self.stride];
            points.decompress_many(block)?;
            take(block);
            left -= count;
        }
        Ok(())
    }
}

/// The parts of a point must be those of its format: the decompressors rely on their sizes.
fn check_items(vlr: &LazVlr, header: &Header) -> Result<(), String> {
    let extra = header.stride - usize::from(header.format.len());
    let expected = LazItemRecordBuilder::default_for_point_format_id(
        header.format_number,
        extra as u16, // the stride is 16 bit
    )
    .map_err(|e| format!("compression: {e}"))?;
    let same = vlr.items().len() == expected.len()
        && vlr.items().iter().zip(&expected).all(|(item, expected)| {
            item.item_type() == expected.item_type() && item.size() == expected.size()
        });
    if same {
        Ok(())
    } else {
        Err(format!(
            "what is compressed is not point format {} with {extra} extra bytes",
            header.format_number
        ))
    }
}

fn read_table(
    input: &mut (impl Read + Seek),
    bytes: u64,
    header: &Header,
    vlr: &LazVlr,
) -> Result<Vec<Chunk>, String> {
    let failed = |e: io::Error| format!("the table of chunks: {e}");
    let begin = header.begin + OFFSET;
    let table = table_offset(input, header.begin).map_err(failed)?;
    // The table begins with a version and the number of chunks.
    if table < begin || table.saturating_add(8) > bytes {
        return Err(
            "the file is cut short: the table of chunks at its end is not there".to_owned(),
        );
    }
    let mut head = [0; 8];
    input.seek(SeekFrom::Start(table)).map_err(failed)?;
    input.read_exact(&mut head).map_err(failed)?;
    let count = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
    // The first point of each chunk is not compressed.
    if u64::from(count) * header.stride as u64 > table - begin {
        return Err(format!("there is no room for {count} chunks"));
    }
    input.seek(SeekFrom::Start(table)).map_err(failed)?;
    let variable = vlr.uses_variable_size_chunks();
    let entries = ChunkTable::read(&mut &mut *input, variable).map_err(failed)?;

    let (mut points, mut end) = (0, begin);
    let mut chunks = Vec::with_capacity(entries.len());
    for entry in &entries {
        let left = header.points - points;
        let chunk = Chunk {
            points: match variable {
                true => entry.point_count,
                false => left.min(vlr.chunk_size().into()),
            },
            bytes: entry.byte_count,
        };
        if chunk.points > left || chunk.bytes > table - end {
            return Err("the table of chunks does not fit the file".to_owned());
        }
        points += chunk.points;
        end += chunk.bytes;
        if chunk.points > 0 {
            chunks.push(chunk);
        }
    }
    if points < header.points {
        return Err(format!(
            "the header promises {} points, and the chunks hold {points}",
            header.points
        ));
    }
    Ok(chunks)
}

/// Before the points, or, if the writer could not go back to there, at the end of the file.
fn table_offset(input: &mut (impl Read + Seek), begin: u64) -> io::Result<u64> {
    let mut at = |position| {
        let mut bytes = [0; 8];
        input.seek(position)?;
        input.read_exact(&mut bytes)?;
        Ok(u64::try_from(i64::from_le_bytes(bytes)).unwrap_or(0))
    };
    match at(SeekFrom::Start(begin))? {
        offset if offset <= begin => at(SeekFrom::End(-8)),
        offset => Ok(offset),
    }
}

/// The decompressor allocates what the lengths of the layers say; they must fit the chunk.
fn check_layers(bytes: &[u8], stride: usize, items: &[laz::LazItem]) -> laz::Result<()> {
    let layers: usize = items
        .iter()
        .map(|item| match item.item_type() {
            LazItemType::Point14 => 9,
            LazItemType::RGBNIR14 => 2,
            LazItemType::Byte14(count) => count.into(),
            _ => 1,
        })
        .sum();
    // The first point, the number of points, the lengths, the layers.
    let lengths = bytes.get(stride + 4..).and_then(|b| b.get(..4 * layers));
    let needed = lengths.map(|lengths| {
        let length = |b: &[u8]| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        lengths.chunks_exact(4).map(length).sum::<u64>()
    });
    let room = bytes.len().saturating_sub(stride + 4 + 4 * layers) as u64;
    match needed {
        Some(needed) if needed <= room => Ok(()),
        _ => Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
    }
}
