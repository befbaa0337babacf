//! Points with their light as LAS, LAZ, CSV and NPY: everything comes back.

use std::fs;
use std::path::{Path, PathBuf};

use fmmgi_gpu::output::{self, Format};
use fmmgi_gpu::points::Grid;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Error, IlluminationMap, PointCloud, scan};
use glam::{DVec3, Vec3, dvec3};
use las::Reader;

const GOLDEN: f64 = 0.618_033_988_749_895;

/// A cloud of `n` points on a grid of millimetres in map coordinates, and some light on it.
fn lit(n: usize) -> (PointCloud, IlluminationMap) {
    let grid = Grid {
        scale: DVec3::splat(0.001),
        offset: dvec3(244_398.0, 6_010_935.0, 18.0),
        reference: vec![(34735, vec![1, 0, 1, 0])],
    };
    let integer = |i: usize, k: f64| (i as f64 * k).fract() * 1e5 - 5e4;
    let integers = |i| dvec3(integer(i, GOLDEN), integer(i, 0.755), integer(i, 0.57)).round();
    let cloud = PointCloud {
        positions: (0..n)
            .map(|i| integers(i) * grid.scale + grid.offset)
            .collect(),
        normals: vec![Vec3::new(0.0, 0.6, 0.8); n],
        reflectance: vec![Vec3::splat(0.5); n],
        emission: vec![Vec3::ZERO; n],
        grid: Some(grid),
        ..PointCloud::default()
    };
    (cloud, light(n))
}

fn light(n: usize) -> IlluminationMap {
    let irradiance: Vec<Vec3> = (0..n)
        .map(|i| Vec3::new(1.0 / 3.0, 1e-12 * i as f32, i as f32))
        .collect();
    IlluminationMap {
        radiosity: irradiance.iter().map(|h| h * 0.3).collect(),
        irradiance,
        radius: vec![0.25; n],
        in_transport: (0..n).map(|i| i % 3 > 0).collect(),
        ..IlluminationMap::default()
    }
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Folder(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, cloud: &PointCloud, map: &IlluminationMap) -> PathBuf {
        let path = self.0.path().join(name);
        output::write(&path, cloud, map).unwrap();
        path
    }
}

#[test]
fn endings_say_the_format() {
    let of = |name: &str| Format::of(Path::new(name));
    for (name, format) in [
        ("a.ply", Format::Ply),
        ("A.PLY", Format::Ply),
        ("/dev/stdout", Format::Ply),
        ("a.b.las", Format::Las),
        ("a.Laz", Format::Laz),
        ("a.csv", Format::Csv),
        ("a.npy", Format::Npy),
    ] {
        assert_eq!(of(name).unwrap(), format, "{name}");
    }
    for name in ["a.txt", "a.e57", "a."] {
        let error = of(name).unwrap_err();
        assert!(matches!(error, Error::Usage(_)), "{name}: {error}");
        assert!(error.to_string().contains(".laz"), "{error}");
    }
}

/// The floats and the byte of the extra dimensions of all points, as the crate `las` reads them.
fn extra(path: &Path) -> (Vec<[f32; 6]>, Vec<u8>) {
    let mut reader = Reader::from_path(path).unwrap();
    let points = reader.read_all().unwrap();
    points
        .points()
        .map(|point| {
            let bytes = point.unwrap().extra_bytes;
            assert_eq!(bytes.len(), 25);
            let float = |k: usize| f32::from_le_bytes(bytes[4 * k..4 * k + 4].try_into().unwrap());
            (std::array::from_fn(float), bytes[24])
        })
        .unzip()
}

#[test]
fn las_and_laz_come_back() {
    let folder = Folder::new();
    // More than one block of writing, and many chunks.
    let n = 600_000;
    let (cloud, map) = lit(n);
    for name in ["lit.laz", "lit.las"] {
        let path = folder.write(name, &cloud, &map);
        let back = scan::read(&path, &Silent).unwrap();
        // To the last bit, on the same grid.
        assert_eq!(back.positions, cloud.positions);
        assert_eq!(back.grid, cloud.grid);

        let (light, in_transport) = extra(&path);
        for i in 0..n {
            let (h, b) = (map.irradiance[i], map.radiosity[i]);
            assert_eq!(light[i], [h.x, h.y, h.z, b.x, b.y, b.z]);
            assert_eq!(in_transport[i], u8::from(map.in_transport[i]));
        }
        let reader = Reader::from_path(&path).unwrap();
        let header = reader.header();
        assert_eq!((header.version().major, header.version().minor), (1, 4));
        let (min, max) = (header.bounds().min, header.bounds().max);
        let low = cloud.positions.iter().copied().reduce(DVec3::min).unwrap();
        let high = cloud.positions.iter().copied().reduce(DVec3::max).unwrap();
        assert!((dvec3(min.x, min.y, min.z) - low).abs().max_element() <= 0.0011);
        assert!((dvec3(max.x, max.y, max.z) - high).abs().max_element() <= 0.0011);
        let described = header.vlrs().iter().find(|vlr| vlr.record_id == 4).unwrap();
        let names: Vec<&[u8]> = described.data.chunks(192).map(|d| &d[4..16]).collect();
        assert_eq!(names[0], b"irradiance_r");
        assert_eq!(names[6], b"in_transport");
    }
    let size = |name: &str| fs::metadata(folder.0.path().join(name)).unwrap().len();
    assert!(size("lit.laz") < size("lit.las"));
}

#[test]
fn clouds_without_a_grid_get_a_fine_one() {
    let folder = Folder::new();
    let n = 1000;
    for (origin, extent) in [
        (DVec3::ZERO, 1.0),
        (dvec3(244_398.9, 6_010_935.7, 18.1), 100.0),
        (DVec3::splat(-1e9), 1e-3),
        (DVec3::splat(3.0), 0.0),
        (DVec3::ZERO, 1e200),
    ] {
        let (mut cloud, map) = lit(n);
        cloud.grid = None;
        let unit = |i: usize, k: f64| (i as f64 * k).fract() * extent;
        cloud.positions = (0..n)
            .map(|i| origin + dvec3(unit(i, GOLDEN), unit(i, 0.755), unit(i, 0.57)))
            .collect();
        cloud.positions[7].y = f64::NAN;
        cloud.positions[8].x = f64::INFINITY;
        let path = folder.write("fine.laz", &cloud, &map);
        let back = scan::read(&path, &Silent).unwrap();
        let rounding = 1e-8 * extent + 2e-16 * origin.abs().max_element();
        for (i, (p, q)) in cloud.positions.iter().zip(&back.positions).enumerate() {
            let distance = (*p - *q).abs().max_element();
            assert!(
                i == 7 || i == 8 || distance <= rounding,
                "{i}: {distance}, {extent}"
            );
        }
        let mut reader = Reader::from_path(&path).unwrap();
        let points = reader.read_all().unwrap();
        let withheld = |i: &usize| points.points().nth(*i).unwrap().unwrap().is_withheld;
        assert_eq!((0..10).filter(withheld).collect::<Vec<_>>(), [7, 8]);
    }
}

#[test]
fn a_grid_is_moved_where_it_does_not_reach() {
    let folder = Folder::new();
    let (mut cloud, map) = lit(10);
    // A tile of the same survey, far from where the grid begins.
    let far = dvec3(5e6, 0.0, 0.0);
    cloud.positions.iter_mut().for_each(|p| *p += far);
    let path = folder.write("moved.las", &cloud, &map);
    let back = scan::read(&path, &Silent).unwrap();
    for (p, q) in cloud.positions.iter().zip(&back.positions) {
        assert!((*p - *q).abs().max_element() < 1e-8, "{p} {q}");
    }
    let grid = back.grid.unwrap();
    assert_eq!(grid.scale, DVec3::splat(0.001));
    assert_eq!(grid.reference, cloud.grid.unwrap().reference);
}

#[test]
fn csv_comes_back() {
    let folder = Folder::new();
    let (mut cloud, map) = lit(10_000);
    let read = |path: &Path| {
        let text = fs::read_to_string(path).unwrap();
        let mut lines = text.lines();
        let header = lines.next().unwrap();
        assert!(header.starts_with("x,y,z,nx,ny,nz,red,green,blue,radius,irradiance_r,"));
        assert_eq!(header.split(',').count(), 17);
        lines
            .map(|line| line.split(',').map(str::to_owned).collect())
            .collect::<Vec<Vec<String>>>()
    };
    let rows = read(&folder.write("grid.csv", &cloud, &map));
    assert_eq!(rows.len(), cloud.len());
    for (i, row) in rows.iter().enumerate() {
        assert_eq!(row.len(), 17);
        for k in 0..3 {
            let (_, decimals) = row[k].split_once('.').unwrap();
            assert_eq!(decimals.len(), 3, "{}", row[k]);
            let x: f64 = row[k].parse().unwrap();
            assert!((x - cloud.positions[i][k]).abs() < 1e-8);
            let float = |column: usize| row[column].parse::<f32>().unwrap();
            assert_eq!(float(3 + k), cloud.normals[i][k]);
            assert_eq!(float(10 + k), map.irradiance[i][k]);
            assert_eq!(float(13 + k), map.radiosity[i][k]);
        }
        assert_eq!(row[9], "0.25");
        assert_eq!(row[16] == "1", map.in_transport[i]);
    }
    // f64 as it is, f32 as such; the program reads both again.
    cloud.grid = None;
    let path = folder.write("double.csv", &cloud, &map);
    let back = scan::read(&path, &Silent).unwrap();
    assert_eq!(back.positions, cloud.positions);
    assert_eq!(back.normals, cloud.normals);
    for p in &mut cloud.positions {
        *p = (*p - dvec3(244_398.0, 6_010_935.0, 18.0))
            .as_vec3()
            .as_dvec3();
    }
    cloud.positions[3] = DVec3::NAN;
    let rows = read(&folder.write("single.csv", &cloud, &map));
    assert!(rows.iter().all(|row| row[0].len() < 13), "digits of f32");
    assert_eq!(rows[3][..3], ["NaN"; 3]);
    for (row, p) in rows.iter().zip(&cloud.positions).skip(4) {
        assert_eq!(row[1].parse::<f32>().unwrap(), p.y as f32);
    }
}

#[test]
fn npy_is_as_numpy_has_it() {
    let folder = Folder::new();
    for n in [1, 200_000] {
        let (cloud, map) = lit(n);
        let bytes = fs::read(folder.write("lit.npy", &cloud, &map)).unwrap();
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        let header = std::str::from_utf8(&bytes[10..10 + length]).unwrap();
        assert_eq!((10 + length) % 64, 0);
        assert!(header.ends_with('\n'));
        assert_eq!(
            header.trim_end(),
            format!(
                "{{'descr': [('position', '<f8', (3,)), ('normal', '<f4', (3,)), \
                 ('colour', '|u1', (3,)), ('radius', '<f4'), ('irradiance', '<f4', (3,)), \
                 ('radiosity', '<f4', (3,)), ('in_transport', '|b1')], \
                 'fortran_order': False, 'shape': ({n},), }}"
            )
        );
        let rows = &bytes[10 + length..];
        assert_eq!(rows.len(), 68 * n);
        for (i, row) in rows.chunks_exact(68).enumerate() {
            let double = |at: usize| f64::from_le_bytes(row[at..at + 8].try_into().unwrap());
            let float = |at: usize| f32::from_le_bytes(row[at..at + 4].try_into().unwrap());
            for k in 0..3 {
                assert_eq!(double(8 * k), cloud.positions[i][k]);
                assert_eq!(float(24 + 4 * k), cloud.normals[i][k]);
                assert_eq!(float(43 + 4 * k), map.irradiance[i][k]);
                assert_eq!(float(55 + 4 * k), map.radiosity[i][k]);
            }
            assert_eq!(float(39), 0.25);
            assert_eq!(row[67], u8::from(map.in_transport[i]));
        }
    }
}

#[test]
fn a_map_of_another_cloud_is_refused() {
    let folder = Folder::new();
    let (cloud, _) = lit(3);
    for name in ["x.ply", "x.las", "x.laz", "x.csv", "x.npy"] {
        let path = folder.0.path().join(name);
        let error = output::write(&path, &cloud, &light(2)).unwrap_err();
        assert!(error.to_string().contains("the cloud 3 points"), "{error}");
        assert!(!path.exists());
    }
}

#[cfg(unix)]
#[test]
fn a_full_device_is_told() {
    let folder = Folder::new();
    let (cloud, map) = lit(1000);
    if Path::new("/dev/full").exists() {
        let link = folder.0.path().join("full.csv");
        std::os::unix::fs::symlink("/dev/full", &link).unwrap();
        let error = output::write(&link, &cloud, &map).unwrap_err();
        assert!(error.to_string().contains("No space left"), "{error}");
        let link = folder.0.path().join("full.laz");
        std::os::unix::fs::symlink("/dev/full", &link).unwrap();
        let error = output::write(&link, &cloud, &map).unwrap_err();
        assert!(error.to_string().contains("no regular file"), "{error}");
    }
}
