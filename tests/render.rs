//! Pictures of known geometry, and cameras fitted to it.

use std::f64::consts::PI;

use fmmgi_gpu::points::{PointCloud, Surfels};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::render::{Image, encode_png, fit, picture};
use fmmgi_gpu::scene::Camera;
use fmmgi_gpu::visibility::{Segment, Visibility};
use fmmgi_gpu::{Error, IlluminationMap, Result};
use glam::{DVec3, Vec3};

const RED: Vec3 = Vec3::new(1.0, 0.0, 0.0);
const GREEN: Vec3 = Vec3::new(0.0, 1.0, 0.0);

/// Discs with their colours.
#[derive(Clone, Default)]
struct Lit {
    cloud: PointCloud,
    map: IlluminationMap,
}

impl Lit {
    fn add(&mut self, position: DVec3, normal: Vec3, radius: f32, colour: Vec3) {
        self.cloud.positions.push(position);
        self.cloud.normals.push(normal);
        self.cloud.areas.push(radius * radius * PI as f32);
        self.map.radius.push(radius);
        self.map.radiosity.push(colour);
    }

    fn disc(position: DVec3, normal: Vec3, radius: f32, colour: Vec3) -> Self {
        let mut lit = Self::default();
        lit.add(position, normal, radius, colour);
        lit
    }

    /// `n` points spread evenly on the unit sphere; normals point out (1) or in (-1).
    fn sphere(n: usize, side: f32) -> Self {
        let mut lit = Self::default();
        for k in 0..n {
            let z = 1.0 - (2 * k + 1) as f64 / n as f64;
            let (sin, cos) = (k as f64 * PI * (3.0 - 5f64.sqrt())).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let p = DVec3::new(r * cos, r * sin, z);
            let colour = (p.as_vec3() + Vec3::ONE) / 2.0;
            lit.add(p, side * p.as_vec3(), (4.0 / n as f32).sqrt(), colour);
        }
        lit
    }

    fn map_positions(mut self, f: impl Fn(DVec3) -> DVec3) -> Self {
        self.cloud.positions.iter_mut().for_each(|p| *p = f(*p));
        self
    }

    fn surfels(&self) -> Surfels {
        let cloud = &self.cloud;
        let sum: DVec3 = cloud.positions.iter().sum();
        let origin = sum / cloud.len() as f64;
        Surfels {
            origin,
            positions: cloud
                .positions
                .iter()
                .map(|p| (p - origin).as_vec3())
                .collect(),
            normals: cloud.normals.clone(),
            areas: cloud.areas.clone(),
            offsets: self.map.radius.iter().map(|r| 0.1 * r).collect(),
            points: (0..cloud.len() as u32).collect(),
            ..Surfels::default()
        }
    }

    fn picture(&self, camera: &Camera, width: u32, height: u32) -> Image {
        picture(&self.cloud, &self.map, camera, width, height, &Silent).unwrap()
    }

    fn fit(&self, aspect: f64) -> Camera {
        let surfels = self.surfels();
        fit(&self.cloud, &surfels, &Discs(&surfels), aspect).unwrap()
    }
}

/// Every segment against every surfel, as a disc that overlaps its neighbours.
struct Discs<'a>(&'a Surfels);

impl Visibility for Discs<'_> {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        let surfels = self.0;
        let blocks = |s: &Segment, i: usize| {
            let (from, to) = (Vec3::from(s.from), Vec3::from(s.to));
            let (normal, position) = (surfels.normals[i], surfels.positions[i]);
            let t = normal.dot(position - from) / normal.dot(to - from);
            let d = from + (to - from) * t - position;
            let skipped = i as u32 == s.skip_from || i as u32 == s.skip_to;
            !skipped && t > 0.0 && t < 1.0 && d.length_squared() < 0.7 * surfels.areas[i]
        };
        let free = |s: &Segment| !(0..surfels.len()).any(|i| blocks(s, i));
        Ok(segments.iter().map(free).collect())
    }
}

/// At (0, 0, 0), looking along +y.
fn ahead(fov: f64) -> Camera {
    Camera {
        position: DVec3::ZERO,
        look_at: DVec3::Y,
        up: DVec3::Z,
        fov,
    }
}

/// Pixels covered, in parts of the picture.
fn covered(image: &Image) -> f64 {
    image.coverage.iter().map(|&c| f64::from(c)).sum::<f64>() / image.coverage.len() as f64
}

fn centre(image: &Image) -> Vec3 {
    image.radiosity[(image.height / 2 * image.width + image.width / 2) as usize]
}

#[test]
fn a_disc_projects_to_an_ellipse_of_the_right_area() {
    // Squared size ratio of the disc at its drawn radius and the screen; the same for each tilt.
    let mut drawn = Vec::new();
    for tilt in [0.0f64, 30.0, 60.0] {
        let (sin, cos) = tilt.to_radians().sin_cos();
        let normal = Vec3::new(sin as f32, -cos as f32, 0.0);
        let lit = Lit::disc(DVec3::Y * 100.0, normal, 5.0, RED);
        let image = lit.picture(&ahead(20.0), 400, 400);
        let screen = (200.0 * 10f64.to_radians().tan()).powi(2);
        // From far away the ellipse has the area of the disc times the cosine.
        drawn.push((covered(&image) * screen / (PI * 25.0 * cos)).sqrt());
        assert_eq!(centre(&image), RED);
    }
    // The margin is the perspective at 8 units in 100 and the 2 x 2 samples of 400 x 400 pixels.
    for scale in drawn {
        assert!(
            (scale / 1.7 - 1.0).abs() < 0.01,
            "drawn radius / radius: {scale}"
        );
    }
}

#[test]
fn the_nearer_disc_hides_the_farther_one() {
    let near = Lit::disc(DVec3::Y * 2.0, Vec3::NEG_Y, 0.5, RED);
    let mut both = near.clone();
    both.add(DVec3::Y * 4.0, Vec3::NEG_Y, 0.5, GREEN);
    assert_eq!(
        near.picture(&ahead(60.0), 65, 65),
        both.picture(&ahead(60.0), 65, 65)
    );
    let behind = Lit::disc(DVec3::Y * -2.0, Vec3::Y, 0.5, RED);
    assert_eq!(covered(&behind.picture(&ahead(60.0), 65, 65)), 0.0);
}

#[test]
fn a_back_is_not_seen() {
    let back = Lit::disc(DVec3::Y * 2.0, Vec3::Y, 0.5, RED);
    assert_eq!(covered(&back.picture(&ahead(60.0), 65, 65)), 0.0);
    let mut lit = back;
    lit.add(DVec3::Y * 4.0, Vec3::NEG_Y, 0.5, GREEN);
    assert_eq!(centre(&lit.picture(&ahead(60.0), 65, 65)), GREEN);
}

#[test]
fn light_runs_smoothly_over_a_plane() {
    // A wall of 40 x 40 points whose radiosity is linear: the blend must stay close to it.
    let mut lit = Lit::default();
    let step = 0.05;
    for k in 0..1600 {
        let at = DVec3::new((k % 40) as f64 - 19.5, 0.0, (k / 40) as f64 - 19.5) * step;
        let colour = Vec3::splat(1.0 + at.x as f32);
        lit.add(
            at + DVec3::Y,
            Vec3::NEG_Y,
            (step / PI.sqrt()) as f32,
            colour,
        );
    }
    let image = lit.picture(&ahead(60.0), 120, 120);
    let pixel = 2.0 * 30f64.to_radians().tan() / 120.0;
    for (i, (&c, b)) in image.coverage.iter().zip(&image.radiosity).enumerate() {
        let x = ((i % 120) as f64 + 0.5 - 60.0) * pixel;
        assert_eq!(c, 1.0);
        // A kernel of radius 1.7 * 0.56 steps reaches less than a step to either side.
        assert!((f64::from(b.x) - 1.0 - x).abs() < 0.25 * step, "{b} at {x}");
    }
}

#[test]
fn the_order_of_points_does_not_matter() {
    let lit = Lit::sphere(3000, 1.0);
    let mut shuffled = Lit::default();
    for k in 0..3000 {
        let i = k * 1009 % 3000;
        shuffled.add(
            lit.cloud.positions[i],
            lit.cloud.normals[i],
            lit.map.radius[i],
            lit.map.radiosity[i],
        );
    }
    let camera = lit.fit(1.5);
    assert_eq!(
        lit.picture(&camera, 150, 100),
        shuffled.picture(&camera, 150, 100)
    );
}

#[test]
fn a_large_offset_changes_nothing() {
    // Powers of two keep every position exact: positions of the sphere are rounded to 2^-20 first.
    let exact = |p: DVec3| (p * 1048576.0).round() / 1048576.0;
    let offset = DVec3::new(524288.0, 4194304.0, 1024.0);
    let lit = Lit::sphere(2000, 1.0).map_positions(exact);
    let far = lit.clone().map_positions(|p| p + offset);
    let camera = Camera {
        position: DVec3::new(0.5, -3.0, 1.0),
        look_at: DVec3::ZERO,
        ..ahead(50.0)
    };
    let moved = Camera {
        position: camera.position + offset,
        look_at: offset,
        ..camera
    };
    let (here, there) = (lit.picture(&camera, 120, 90), far.picture(&moved, 120, 90));
    assert!(covered(&here) > 0.2);
    assert_eq!(here, there);
}

#[test]
fn a_sphere_closes_around_the_camera() {
    let lit = Lit::sphere(2000, -1.0);
    let camera = lit.fit(1.5);
    assert!(camera.position.length() < 0.9, "{camera:?}");
    let image = lit.picture(&camera, 300, 200);
    assert!(image.coverage.iter().all(|&c| c == 1.0));
    assert_eq!(camera, lit.fit(1.5));
}

#[test]
fn a_thing_is_seen_from_outside_and_fills_the_frame() {
    for aspect in [0.5, 1.0, 2.0] {
        let lit = Lit::sphere(2000, 1.0);
        let camera = lit.fit(aspect);
        assert!(camera.position.length() > 1.5, "{camera:?}");
        let (width, height) = ((200.0 * aspect) as u32, 200);
        let image = lit.picture(&camera, width, height);
        let row = |y: u32| &image.coverage[(y * width) as usize..((y + 1) * width) as usize];
        let empty = |c: &[f32]| c.iter().all(|&c| c == 0.0);
        assert!(empty(row(0)) && empty(row(height - 1)));
        // The disc's diameter is 0.92 of the narrower side.
        let narrow = f64::from(width.min(height));
        let disc = PI / 4.0 * (0.92 * narrow).powi(2) / f64::from(width * height);
        assert!(
            (covered(&image) / disc - 1.0).abs() < 0.1,
            "{}",
            covered(&image) / disc
        );
    }
}

#[test]
fn a_wall_is_seen_from_its_front() {
    for normal in [Vec3::Y, Vec3::NEG_Y, Vec3::X, Vec3::Z] {
        let mut lit = Lit::default();
        let (u, v) = normal.as_dvec3().any_orthonormal_pair();
        for k in 0..400 {
            let at = u * (k % 20) as f64 + v * (k / 20) as f64;
            lit.add(at, normal, 0.57, RED);
        }
        let image = lit.picture(&lit.fit(1.0), 64, 64);
        assert!(covered(&image) > 0.3, "{normal}: {}", covered(&image));
    }
}

#[test]
fn up_follows_the_stated_rule() {
    // A closed tunnel along z, and a dome without its underside; both have y up.
    let long = DVec3::new(1.0, 1.0, 5.0);
    let mut tunnel = Lit::sphere(4000, -1.0).map_positions(|p| p * long);
    tunnel.map.radius.iter_mut().for_each(|r| *r *= 2.5);
    tunnel.cloud.areas.iter_mut().for_each(|a| *a *= 6.0);
    let camera = tunnel.fit(1.0);
    assert!((camera.position / long).length() < 1.0, "{camera:?}");
    assert_eq!(camera.up, DVec3::Y);

    let sphere = Lit::sphere(2000, 1.0);
    let mut dome = Lit::default();
    for (p, n) in sphere.cloud.positions.iter().zip(&sphere.cloud.normals) {
        if p.y > -0.8 {
            dome.add(*p, *n, 0.045, RED);
        }
    }
    assert_eq!(dome.fit(1.0).up, DVec3::Y);
    assert_eq!(sphere.fit(1.0).up, DVec3::Z);
}

#[test]
fn poor_clouds_still_get_a_camera() {
    let offset = DVec3::new(500_000.0, 5_000_000.0, 100.0);
    let same = |_: usize| offset;
    let line = |k: usize| offset + DVec3::new(0.35, -0.77, 0.34) * k as f64;
    let clouds: [(usize, &dyn Fn(usize) -> DVec3); 4] =
        [(1, &same), (100, &same), (100, &line), (2, &line)];
    for (n, place) in clouds {
        for radius in [0.0, 1e-6, 0.1] {
            let mut lit = Lit::default();
            (0..n).for_each(|k| lit.add(place(k), Vec3::Z, radius, RED));
            let mut cameras = vec![lit.fit(1.0)];
            let none = Surfels::default();
            cameras.push(fit(&lit.cloud, &none, &Discs(&none), 1.0).unwrap());
            for camera in cameras {
                assert!(camera.position.is_finite() && camera.look_at.is_finite());
                assert_ne!(camera.position, camera.look_at);
                lit.picture(&camera, 8, 8);
            }
        }
    }
    let (cloud, none) = (PointCloud::default(), Surfels::default());
    assert!(matches!(
        fit(&cloud, &none, &Discs(&none), 1.0),
        Err(Error::Invalid(_))
    ));
    let aspect = fit(&cloud, &none, &Discs(&none), f64::NAN);
    assert!(matches!(aspect, Err(Error::Usage(_))));
}

#[test]
fn unusable_points_are_not_drawn() {
    let nan = f32::NAN;
    let mut lit = Lit::default();
    let at = DVec3::Y * 2.0;
    lit.add(DVec3::splat(f64::NAN), Vec3::NEG_Y, 0.5, RED);
    lit.add(at, Vec3::splat(nan), 0.5, RED);
    lit.add(at, Vec3::ZERO, 0.5, RED);
    for radius in [0.0, -1.0, nan, f32::INFINITY] {
        lit.add(at, Vec3::NEG_Y, radius, RED);
    }
    lit.add(at, Vec3::NEG_Y, 0.5, Vec3::new(nan, 0.0, 0.0));
    assert_eq!(covered(&lit.picture(&ahead(60.0), 33, 33)), 0.0);
}

#[test]
fn surfels_around_the_camera_are_safe() {
    let mut lit = Lit::default();
    // Beside, through the plane of the camera, and a hair's breadth before it.
    lit.add(DVec3::Z * -0.1, Vec3::Z, 10.0, GREEN);
    lit.add(DVec3::X * 1e-9, Vec3::NEG_X, 1.0, GREEN);
    lit.add(DVec3::ZERO, Vec3::NEG_Y, 1.0, RED);
    let image = lit.picture(&ahead(60.0), 64, 64);
    // The floor fills the lower half up to its rim at 17 units, which is 0.4 pixels under the
    // horizon; the wall at the right hides it there.
    assert!((covered(&image) - 0.75).abs() < 0.02, "{}", covered(&image));
    lit.add(DVec3::Y * 1e-30, Vec3::NEG_Y, 1e-3, RED);
    assert!(
        lit.picture(&ahead(60.0), 64, 64)
            .coverage
            .iter()
            .all(|&c| c == 1.0)
    );
}

#[test]
fn sizes_and_cameras_have_limits() {
    let lit = Lit::disc(DVec3::Y * 2.0, Vec3::NEG_Y, 0.5, RED);
    let draw = |camera: &Camera, width, height| {
        picture(&lit.cloud, &lit.map, camera, width, height, &Silent)
    };
    let good = ahead(40.0);
    assert_eq!(draw(&good, 1, 1).unwrap().radiosity, [RED]);
    assert_eq!(draw(&good, 20_000, 1).unwrap().radiosity.len(), 20_000);
    for (width, height) in [(0, 10), (10, 0), (u32::MAX, u32::MAX)] {
        assert!(matches!(draw(&good, width, height), Err(Error::Usage(_))));
    }
    for fov in [0.0, 180.0, -10.0, f64::NAN] {
        assert!(matches!(draw(&ahead(fov), 4, 4), Err(Error::Invalid(_))));
    }
    let nowhere = Camera {
        look_at: DVec3::ZERO,
        ..good
    };
    assert!(matches!(draw(&nowhere, 4, 4), Err(Error::Invalid(_))));
    // Up along the view is no reason to fail.
    for up in [DVec3::Y, DVec3::NEG_Y, DVec3::ZERO] {
        assert_eq!(centre(&draw(&Camera { up, ..good }, 33, 33).unwrap()), RED);
    }
    let mut bare = lit.clone();
    bare.cloud.normals.clear();
    let bare = picture(&bare.cloud, &bare.map, &good, 4, 4, &Silent);
    assert!(matches!(bare, Err(Error::Invalid(_))));
}

#[test]
fn the_png_holds_the_picture() {
    let lit = Lit::disc(DVec3::Y * 2.0, Vec3::NEG_Y, 0.2, GREEN);
    let bytes = encode_png(&lit.picture(&ahead(60.0), 40, 30), 1.0).unwrap();
    let read = image::load_from_memory(&bytes).unwrap().to_rgb8();
    assert_eq!(read.dimensions(), (40, 30));
    let [r, g, b] = read.get_pixel(20, 15).0;
    assert!(g > 100 && g > r && g > b);
    let [r, g, b] = read.get_pixel(0, 0).0;
    assert!(r.max(g).max(b) < 50 && r.abs_diff(g) < 8 && g.abs_diff(b) < 8);
}
