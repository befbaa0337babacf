//! What all targets do: the readers' one entrance, with a file of any content under an ending.
//!
//! `cargo +nightly fuzz run pcd fuzz/seeds/pcd` with any files of the format as seeds.

use std::cell::RefCell;
use std::fs::File;
use std::io::{Seek, Write};

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan::{ReadOptions, Scan};
use tempfile::NamedTempFile;

thread_local! {
    static FILE: RefCell<Option<NamedTempFile>> = const { RefCell::new(None) };
}

/// Reads a file with this content, as points and as a mesh. What comes out must fit together.
pub fn read(content: &[u8], ending: &str) {
    FILE.with_borrow_mut(|kept| {
        let file = kept.get_or_insert_with(|| {
            let mut builder = tempfile::Builder::new();
            builder.suffix(ending).tempfile().expect("a temporary file")
        });
        write(file.as_file_mut(), content).expect("the temporary file can be written");
        for faces in [false, true] {
            let options = ReadOptions {
                faces,
                points: Some(50),
                ..ReadOptions::default()
            };
            if let Ok(scan) = Scan::read(file.path(), &options, &Silent) {
                check(&scan);
            }
        }
    });
}

fn write(file: &mut File, content: &[u8]) -> std::io::Result<()> {
    file.set_len(0)?;
    file.rewind()?;
    file.write_all(content)
}

fn check(scan: &Scan) {
    let cloud = &scan.cloud;
    let n = cloud.len();
    assert!(n > 0 && cloud.reflectance.len() == n && cloud.emission.len() == n);
    for optional in [cloud.normals.len(), cloud.areas.len()] {
        assert!(optional == 0 || optional == n);
    }
    for light in cloud.reflectance.iter().chain(&cloud.emission) {
        assert!(light.is_finite() && light.min_element() >= 0.0);
    }
    assert!(cloud.scanners.iter().all(|s| s.points.end <= n));
}

/// An E57 file whose pages of 1024 bytes have the checksums at their ends that they should have.
pub fn sealed(content: &[u8]) -> Vec<u8> {
    let mut bytes = content.to_vec();
    for page in bytes.chunks_exact_mut(1024) {
        let (data, sum) = page.split_at_mut(1020);
        sum.copy_from_slice(&crc32c::crc32c(data).to_be_bytes());
    }
    bytes
}
