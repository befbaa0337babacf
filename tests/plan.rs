//! What is planned: choices, time and memory beforehand, and that the work follows.

mod common;
mod program;

use std::fs;

use common::scene;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{
    Backend, Error, Method, Occlusion, Options, Plan, Scene, Stats, Transport, cgroup, illuminate,
};
use glam::Vec3;
use program::{fails, folder, run};

fn options(tolerance: f64) -> Options {
    Options {
        tolerance: Some(tolerance),
        ..Options::default()
    }
}

fn plan(scene: &Scene, options: &Options) -> Plan {
    Plan::new(scene, options, &Backend::Cpu).unwrap()
}

fn solve(scene: &Scene, options: &Options) -> Stats {
    illuminate(scene, options, Backend::Cpu, &Silent)
        .unwrap()
        .stats
}

#[test]
fn each_method_is_taken_where_it_wins() {
    for (name, points, tolerance, method) in [
        ("cornell", 300, 0.03, Method::Direct),
        ("cave", 20_000, 0.1, Method::Gather),
        ("organic", 2000, 0.03, Method::Direct),
        ("cave", 30_000, 0.03, Method::Gather),
        ("cave", 4000, 0.03, Method::Direct),
        ("cornell", 100_000, 0.03, Method::Fmm),
    ] {
        let plan = plan(&scene(name, points), &options(tolerance));
        println!("{name}, {points} points to {tolerance}:\n{plan}");
        assert_eq!(plan.method, method, "{name}");
        assert_eq!(plan.rays.is_some(), method == Method::Gather);
        assert_eq!(plan.order.is_some(), method == Method::Fmm);
    }
}

#[test]
fn rays_are_tried_where_that_adds_little() {
    // No number of them is expected to do in either. Their noise alone would take thousands, but they begin with
    // 256 at most.
    let large = plan(&scene("cave", 20_000), &options(0.005));
    assert_eq!((large.method, large.rays), (Method::Gather, Some(256)));
    assert_eq!(large.instead, Some(Method::Direct), "{large}");
    // But no longer than half of what follows.
    assert_eq!(large.most_rays, Some(1024), "{large}");
    let small = plan(&scene("cave", 4000), &options(0.01));
    assert_eq!((small.method, small.instead), (Method::Direct, None));
    // In a body that is smooth for so many points they are.
    let smooth = plan(&scene("organic", 10_000), &options(0.01));
    assert_eq!((smooth.method, smooth.rays), (Method::Gather, Some(128)));
    // Rays that are expected to do may need one more round before they are given up.
    let rooms = plan(&scene("two_rooms", 3000), &options(0.01));
    assert_eq!(rooms.instead, Some(Method::Direct), "{rooms}");
    assert_eq!(rooms.most_rays, rooms.rays.map(|rays| 2 * rays), "{rooms}");
    // Links that follow may take longer than expected as well: then a multiple of what these take.
    let late = plan(&scene("cornell", 20_000), &options(0.03));
    assert_eq!(late.instead, Some(Method::Fmm), "{late}");
    let times = late.most_rays.unwrap() / late.rays.unwrap();
    assert!((4..=16).contains(&times), "{late}");
}

#[test]
fn nothing_is_chosen_that_cannot_do_it() {
    let cave = scene("cave", 20_000);
    let wanted = options(0.1);
    assert_eq!(plan(&cave, &wanted).method, Method::Gather);
    let not_rays = |scene: &Scene, options: &Options| {
        assert_ne!(plan(scene, options).method, Method::Gather);
    };
    not_rays(
        &cave,
        &Options {
            occlusion: Occlusion::None,
            ..wanted.clone()
        },
    );
    not_rays(
        &cave,
        &Options {
            max_bounces: Some(0),
            ..wanted.clone()
        },
    );
    let ordered = Options {
        order: Some(1),
        ..wanted.clone()
    };
    assert_eq!(plan(&cave, &ordered).method, Method::Fmm);
    // They see nothing that is black.
    let mut black = cave.clone();
    black.cloud.reflectance.fill(Vec3::ZERO);
    not_rays(&black, &wanted);
}

/// The solve does what the plan says, and keeps the tolerance by whatever method.
#[test]
fn a_plan_is_followed() {
    for (name, points, tolerance) in [("cornell", 300, 0.03), ("cave", 20_000, 0.2)] {
        let (scene, options) = (scene(name, points), options(tolerance));
        let stats = solve(&scene, &options);
        let followed = stats.plan.as_ref().unwrap();
        println!(
            "{name}: {:?}, planned {:?}, error {:?}",
            stats.method,
            followed.method,
            stats.error.map(|error| error.bound())
        );
        assert_eq!(followed.method, plan(&scene, &options).method);
        assert_eq!(
            (stats.method, stats.order),
            (followed.method, followed.order)
        );
        assert!(stats.converged && stats.error.is_none_or(|error| error.met));
        assert_eq!(stats.error.is_none(), stats.method == Method::Direct);
    }
}

/// Rays meet cells where sums take points: in a coarse cave no number of them is good enough.
#[test]
fn rays_that_miss_the_tolerance_are_followed_by_what_was_planned() {
    let scene = scene("cave", 1500);
    let options = Options {
        below_model: true,
        ..options(0.06)
    };
    for instead in [Method::Fmm, Method::Direct] {
        let plan = Plan {
            method: Method::Gather,
            instead: Some(instead),
            ..plan(&scene, &options)
        };
        let mut transport =
            Transport::planned(&scene, &options, Backend::Cpu, plan, &Silent).unwrap();
        let stats = transport.illuminate(&scene, &Silent).unwrap().stats;
        assert_eq!((stats.method, stats.rays), (instead, None));
        assert!(stats.converged && stats.error.is_none_or(|error| error.met));
    }
}

/// Where more rays would do, but are more than what follows takes.
#[test]
fn rays_that_would_take_too_long_are_given_up() {
    let (scene, options) = (scene("cornell", 1500), options(0.02));
    let solved = |most_rays| {
        let plan = Plan {
            method: Method::Gather,
            rays: Some(16),
            instead: Some(Method::Direct),
            most_rays,
            ..plan(&scene, &options)
        };
        let mut transport =
            Transport::planned(&scene, &options, Backend::Cpu, plan, &Silent).unwrap();
        let stats = transport.illuminate(&scene, &Silent).unwrap().stats;
        (stats.method, stats.rays)
    };
    let (method, rays) = solved(None);
    assert_eq!(method, Method::Gather);
    assert_eq!(solved(rays), (method, rays));
    let fewer = rays.map(|rays| rays / 2);
    assert_eq!(solved(fewer), (Method::Direct, None), "{rays:?}");
}

#[test]
fn more_points_and_smaller_errors_take_more() {
    let [few, many] = [5000, 20_000].map(|points| scene("organic", points));
    let by_links = |tolerance| Options {
        method: Method::Fmm,
        ..options(tolerance)
    };
    let [rough, fine] = [0.05, 0.01].map(|tolerance| plan(&few, &by_links(tolerance)));
    let larger = plan(&many, &by_links(0.05));
    for more in [&fine, &larger] {
        assert!(more.seconds > rough.seconds && more.bytes > rough.bytes);
    }
    let sum: f64 = rough.stages.iter().map(|stage| stage.seconds).sum();
    assert!((sum - rough.seconds).abs() < 1e-12);
}

#[test]
fn what_does_not_fit_is_refused_beforehand_and_told_what_would() {
    let scene = scene("cornell", 20_000);
    let wanted = Options {
        method: Method::Fmm,
        ..options(0.03)
    };
    let within = |max_points: Option<usize>| {
        let mut options = wanted.clone();
        options.thinning.max_points = max_points;
        Plan::within(&scene, &options, &Backend::Cpu, Some(34 << 20)).unwrap()
    };
    let refused = within(None);
    let fit = refused.points_that_fit.unwrap();
    let error = refused.check().unwrap_err();
    assert!(matches!(error, Error::TooLarge(_)));
    let words = error.to_string();
    println!("{words}");
    for part in [
        "34 MiB are free",
        &format!("--max-points {fit} fits"),
        "tolerance",
    ] {
        assert!(words.contains(part), "{words} lacks {part}");
    }
    assert!(fit > 0 && fit < 20_000);
    within(Some(fit)).check().unwrap();
    within(Some(fit + fit / 20)).check().unwrap_err();
    // The work itself is refused before it starts, and nothing is where nothing is known.
    let plan = Transport::planned(&scene, &wanted, Backend::Cpu, refused, &Silent);
    assert!(matches!(plan, Err(Error::TooLarge(_))));
    let unknown = Plan::within(&scene, &wanted, &Backend::Cpu, None).unwrap();
    unknown.check().unwrap();
}

/// Files as the kernel shows them: the smallest of all limits counts, whatever is cached.
#[test]
fn limits_of_containers_count() {
    let root = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = root.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    assert_eq!(cgroup::left(root.path()), None);
    write("proc/self/cgroup", "0::/pod/job\n");
    write("sys/fs/cgroup/pod/job/memory.max", "max\n");
    write("sys/fs/cgroup/pod/job/memory.current", "1000\n");
    assert_eq!(cgroup::left(root.path()), None);
    write("sys/fs/cgroup/pod/memory.max", "5000\n");
    write("sys/fs/cgroup/pod/memory.current", "4000\n");
    write(
        "sys/fs/cgroup/pod/memory.stat",
        "anon 1000\ninactive_file 500\n",
    );
    assert_eq!(cgroup::left(root.path()), Some(1500));
    write("proc/self/cgroup", "4:cpu,memory:/box\n0::/pod/job\n");
    write("sys/fs/cgroup/memory/box/memory.limit_in_bytes", "900\n");
    write("sys/fs/cgroup/memory/box/memory.usage_in_bytes", "1000\n");
    assert_eq!(cgroup::left(root.path()), Some(0));
    // Inside of a container its own group is the root.
    write("proc/self/cgroup", "0::/elsewhere\n");
    write("sys/fs/cgroup/memory.max", "700\n");
    write("sys/fs/cgroup/memory.current", "100\n");
    assert_eq!(cgroup::left(root.path()), Some(600));
}

#[test]
fn the_command_tells_a_plan_in_words_and_in_json() {
    let folder = folder();
    let args = "plan scan.ply --backend cpu --sky 1,1,1 --tolerance 0.1";
    let words = run(folder.path(), args).success();
    let words = String::from_utf8_lossy(&words.get_output().stdout).into_owned();
    for part in [
        "points      8, of which 8",
        "tolerance   0.1",
        "method      direct: expected are exact sums",
        "colours     three: ",
        "precision   f64: exact sums",
        "backend     cpu",
        "time        about",
        "memory      about",
    ] {
        assert!(words.contains(part), "{words} lacks {part}");
    }
    let args = format!("{args} --json --method fmm --max-points 5");
    let json = run(folder.path(), &args).success();
    let json: serde_json::Value = serde_json::from_slice(&json.get_output().stdout).unwrap();
    assert_eq!((&json["points"], &json["surfels"]), (&8.into(), &5.into()));
    assert_eq!(json["method"], "fmm");
    assert_eq!(json["choices"][0]["why"], "asked for");
    assert!(json["seconds"].as_f64().unwrap() > 0.0 && json["bytes"].as_u64().unwrap() > 0);
    fails(&folder, "plan", 2, "required");
    fails(&folder, "plan missing.ply", 1, "missing.ply");
    fails(
        &folder,
        "plan scan.ply --method gather --visibility none",
        2,
        "the gather method follows rays",
    );
}

/// Memory of a whole process, in which nothing else happens: the points themselves count in both.
#[test]
fn memory_is_foreseen() {
    let folder = folder();
    let scene = format!("{}/scenes/organic.toml", env!("CARGO_MANIFEST_DIR"));
    let asked = format!("{scene} --points 30000 --method fmm --backend cpu --tolerance 0.03");
    run(folder.path(), &format!("solve {asked} --stats stats.json")).success();
    let stats = fs::read(folder.path().join("stats.json")).unwrap();
    let stats: serde_json::Value = serde_json::from_slice(&stats).unwrap();
    let planned = stats["plan"]["bytes"].as_f64().unwrap();
    let taken = stats["peak_memory_bytes"].as_f64().unwrap();
    println!("planned {planned:e}, taken {taken:e}");
    assert!(taken < 2.0 * planned && planned < 2.0 * taken);
}
