use fmmgi_gpu::glam::*;
use fmmgi_gpu::points::*;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Options, Scene};
fn main() {
    let a: Vec<String> = std::env::args().skip(1).collect();
    let scene = Scene::load(a[0].as_ref(), &SceneOptions::default(), &Silent).unwrap();
    let lamps: Vec<DVec3> = a[1]
        .split(';')
        .filter(|s| !s.is_empty())
        .map(|s| {
            let v: Vec<f64> = s.split(',').map(|x| x.parse().unwrap()).collect();
            dvec3(v[0], v[1], v[2])
        })
        .collect();
    let evidence = Evidence {
        facing: Options::default().facing,
        lamps,
        half: None,
    };
    let thinning = Thinning {
        enough_for: Some(0.03),
        ..Thinning::default()
    };
    let start = std::time::Instant::now();
    let p = Surfels::of_scan(&scene.cloud, &evidence, &thinning, &Silent).unwrap();
    eprintln!(
        "{} surfels, {:.1} s",
        p.surfels.len(),
        start.elapsed().as_secs_f64()
    );
    for s in &p.repairs {
        eprintln!("{s}");
    }
    let o = p.surfels.origin;
    if let Ok(f) = std::env::var("DUMP") {
        use std::io::Write;
        let mut w = std::io::BufWriter::new(std::fs::File::create(f).unwrap());
        for k in 0..p.surfels.len() {
            let q = p.surfels.positions[k].as_dvec3() + o;
            let n = p.surfels.normals[k];
            writeln!(
                w,
                "{} {} {} {} {} {} {} {}",
                q.x,
                q.y,
                q.z,
                n.x,
                n.y,
                n.z,
                p.surfels.areas[k],
                p.surfels.back(k).map_or(-1, |b| b as i64)
            )
            .unwrap();
        }
    }
    for q in &a[2..] {
        let (i, rest) = q.split_once(':').unwrap_or((q, "6"));
        let i: usize = i.parse().unwrap();
        let n: usize = rest.parse().unwrap();
        let x = scene.cloud.positions[i];
        let own = p.surfel_of_point[i];
        println!(
            "point {i} {:.3} owner {own:?} colour {:.2}",
            x, scene.cloud.reflectance[i]
        );
        let mut all: Vec<usize> = (0..p.surfels.len()).collect();
        all.sort_by(|&a, &b| {
            let d = |k: usize| (p.surfels.positions[k].as_dvec3() + o).distance(x);
            d(a).total_cmp(&d(b))
        });
        if let Some(k) = own {
            all.insert(0, k as usize);
        }
        for &k in &all[..n] {
            let pos = p.surfels.positions[k].as_dvec3() + o;
            let nn = p.surfels.normals[k];
            println!(
                "   {k} at {:.3} d {:.3} n {:.3} height {:.4} r {:.3} back {:?} col {:.2}",
                pos,
                pos.distance(x),
                nn,
                nn.as_dvec3().dot(x - pos),
                (p.surfels.areas[k] / 3.14159).sqrt(),
                p.surfels.back(k),
                p.surfels.reflectance[k]
            );
        }
    }
}
