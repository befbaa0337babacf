//! Written files: whole or not there, and readable again.

use std::fs;
use std::io;
use std::path::Path;

use fmmgi_gpu::compare::{compare_files, read_irradiance};
use fmmgi_gpu::output::{check_writable, write_atomic, write_ply, write_stats};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{IlluminationMap, PointCloud, Stats, scan};
use glam::{DVec3, Vec3};

/// A cloud of `n` points around `origin`, and some light on it.
fn lit(n: usize, origin: DVec3) -> (PointCloud, IlluminationMap) {
    let unit = |i: usize, k: f64| (i as f64 * k).fract();
    let cloud = PointCloud {
        positions: (0..n)
            .map(|i| origin + DVec3::new(unit(i, 0.618), unit(i, 0.755), unit(i, 0.570)))
            .collect(),
        normals: vec![Vec3::new(0.0, 0.6, 0.8); n],
        reflectance: vec![Vec3::splat(0.5); n],
        emission: vec![Vec3::ZERO; n],
        ..PointCloud::default()
    };
    let irradiance: Vec<Vec3> = (0..n).map(|i| Vec3::new(1.0, 0.1, i as f32)).collect();
    let map = IlluminationMap {
        radiosity: irradiance.iter().map(|h| h * 0.5).collect(),
        irradiance,
        radius: vec![0.25; n],
        in_transport: (0..n).map(|i| i % 3 > 0).collect(),
        ..IlluminationMap::default()
    };
    (cloud, map)
}

#[test]
fn a_lit_cloud_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lit.ply");
    // More than one block, and a point that is nowhere.
    let (mut cloud, map) = lit(200_000, DVec3::ZERO);
    cloud.positions[7] = DVec3::NAN;
    write_ply(&path, &cloud, &map).unwrap();

    let header = fs::read(&path).unwrap();
    let header = String::from_utf8_lossy(&header[..800]).into_owned();
    assert!(header.contains("property float x\n"), "{header}");
    assert!(header.contains("property uchar scalar_in_transport\nend_header\n"));

    let back = scan::read(&path, &Silent).unwrap();
    assert_eq!(back.len(), cloud.len());
    assert!(back.positions[7].is_nan());
    for (a, b) in back.positions.iter().zip(&cloud.positions).skip(8) {
        assert_eq!(*a, b.as_vec3().as_dvec3());
    }
    assert_eq!(back.normals, cloud.normals);
    let area = std::f32::consts::PI * 0.0625;
    assert!(back.areas.iter().all(|a| (a / area - 1.0).abs() < 1e-6));
    let (_, irradiance) = read_irradiance(&path, &Silent).unwrap();
    assert_eq!(irradiance, map.irradiance);
}

#[test]
fn far_coordinates_keep_their_detail() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("far.ply");
    for origin in [
        DVec3::new(244_398.9, 6_010_935.7, 18.1),
        DVec3::splat(1e300),
    ] {
        let (cloud, map) = lit(100, origin);
        write_ply(&path, &cloud, &map).unwrap();
        assert_eq!(
            scan::read(&path, &Silent).unwrap().positions,
            cloud.positions
        );
    }
}

#[test]
fn files_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b, other] = ["a.ply", "b.ply", "other.ply"].map(|name| folder.path().join(name));
    let (mut cloud, mut map) = lit(1000, DVec3::ZERO);
    cloud.positions[3] = DVec3::new(f64::NAN, 0.0, 0.0);
    write_ply(&b, &cloud, &map).unwrap();
    map.irradiance.iter_mut().for_each(|h| *h *= 1.01);
    write_ply(&a, &cloud, &map).unwrap();
    let comparison = compare_files(&a, &b, &Silent).unwrap();
    for error in [
        comparison.rel_l2,
        comparison.median,
        comparison.p99,
        comparison.bias,
    ] {
        assert!((error - 0.01).abs() < 1e-6, "{comparison}");
    }

    let message = |a: &Path, b: &Path| compare_files(a, b, &Silent).unwrap_err().to_string();
    cloud.positions[5].y += 1e-3;
    write_ply(&other, &cloud, &map).unwrap();
    assert!(message(&other, &b).contains("point 5 is at"));
    cloud.positions[5].y = f64::NAN;
    write_ply(&other, &cloud, &map).unwrap();
    assert!(message(&other, &b).contains("point 5 is at"));
    let (cloud, mut map) = lit(999, DVec3::ZERO);
    write_ply(&other, &cloud, &map).unwrap();
    assert!(message(&other, &b).contains("has 999 points"));
    map.irradiance.fill(Vec3::ZERO);
    write_ply(&other, &cloud, &map).unwrap();
    assert!(message(&other, &other).contains("zero everywhere"));
    fs::write(&other, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n").unwrap();
    assert!(message(&other, &b).contains("has no property \"irradiance_r\""));
}

#[test]
fn a_file_is_whole_or_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.txt");
    let disk_full = |writer: &mut dyn io::Write| {
        writer.write_all(&[0; 100_000])?;
        Err(io::Error::from(io::ErrorKind::StorageFull))
    };
    let error = write_atomic(&path, disk_full).unwrap_err().to_string();
    assert!(
        error.contains("out.txt: cannot be written: no storage space"),
        "{error}"
    );
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0, "nothing is left");

    write_atomic(&path, |writer| writer.write_all(b"first")).unwrap();
    write_atomic(&path, disk_full).unwrap_err();
    assert_eq!(fs::read(&path).unwrap(), b"first", "the old file stays");
    write_atomic(&path, |writer| writer.write_all(b"second")).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"second");
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);

    let missing = folder.path().join("no/out.txt");
    let error = check_writable(&missing).unwrap_err().to_string();
    assert!(error.contains("no directory"), "{error}");
    let error = check_writable(folder.path()).unwrap_err().to_string();
    assert!(error.contains("is a directory"), "{error}");
}

#[cfg(unix)]
#[test]
fn links_stay_links_and_devices_devices() {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt};
    let folder = tempfile::tempdir().unwrap();
    let [file, link] = ["file", "link"].map(|name| folder.path().join(name));
    fs::write(&file, "old").unwrap();
    std::os::unix::fs::symlink(&file, &link).unwrap();
    write_atomic(&link, |writer| writer.write_all(b"new")).unwrap();
    assert!(link.is_symlink());
    assert_eq!(fs::read(&file).unwrap(), b"new");
    // As any new file: readable by others as the umask has it, not only by the owner.
    let ordinary = folder.path().join("ordinary");
    fs::write(&ordinary, "").unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&file), mode(&ordinary));

    let null = Path::new("/dev/null");
    write_atomic(null, |writer| writer.write_all(b"gone")).unwrap();
    assert!(fs::metadata(null).unwrap().file_type().is_char_device());
    // A device that is always full.
    if Path::new("/dev/full").exists() {
        let error = write_atomic(Path::new("/dev/full"), |writer| writer.write_all(b"x"));
        assert!(error.unwrap_err().to_string().contains("No space left"));
    }
}

#[test]
fn statistics_are_json() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stats.json");
    let stats = Stats {
        points: 5,
        backend: "cpu".to_owned(),
        ..Stats::default()
    };
    write_stats(&path, &stats).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    assert_eq!(json["points"], 5);
    assert_eq!(json["method"], "auto");
    assert!(json["seconds"]["total"].is_number());
}

#[test]
fn a_map_of_another_cloud_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (cloud, _) = lit(3, DVec3::ZERO);
    let (_, map) = lit(2, DVec3::ZERO);
    let error = write_ply(&folder.path().join("x.ply"), &cloud, &map).unwrap_err();
    assert!(error.to_string().contains("the cloud 3 points"));
}
