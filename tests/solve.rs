//! The solver against dense algebra.

mod clouds;

use clouds::random;
use fmmgi_gpu::Result;
use fmmgi_gpu::operator::{Fields, HostFields, TransportOperator};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::solve::{Ended, Stop, solve};
use glam::DVec3;
use rand::RngExt;

/// A matrix of form factors.
struct Dense {
    rows: Vec<Vec<f64>>,
    fields: HostFields<f64>,
}

impl TransportOperator for Dense {
    type Fields = HostFields<f64>;

    fn fields(&self) -> &HostFields<f64> {
        &self.fields
    }

    fn apply(&self, b: &Vec<DVec3>) -> Result<Vec<DVec3>> {
        let dot = |row: &Vec<f64>| row.iter().zip(b).map(|(&f, &b)| b * f).sum();
        Ok(self.rows.iter().map(dot).collect())
    }
}

/// The same in f32.
struct Narrow(Dense, HostFields<f32>);

impl TransportOperator for Narrow {
    type Fields = HostFields<f32>;

    fn fields(&self) -> &HostFields<f32> {
        &self.1
    }

    fn apply(&self, b: &Vec<glam::Vec3>) -> Result<Vec<glam::Vec3>> {
        let dot = |row: &Vec<f64>| row.iter().zip(b).map(|(&f, &b)| b * f as f32).sum();
        Ok(self.0.rows.iter().map(dot).collect())
    }
}

/// Random rows that sum up to `row_sum`, reciprocal up to areas.
fn dense(n: usize, row_sum: f64, seed: u64) -> Dense {
    let mut rng = random(seed);
    let mut rows = vec![vec![0.0; n]; n];
    for row in &mut rows {
        // Sparse, so that bounces differ.
        row.iter_mut()
            .for_each(|f| *f = (rng.random::<f64>() - 0.6).max(0.0));
        let sum: f64 = row.iter().sum();
        row.iter_mut().for_each(|f| *f *= row_sum / sum.max(1e-3));
    }
    let fields = HostFields::default();
    Dense { rows, fields }
}

fn colours(n: usize, most: f64, seed: u64) -> Vec<DVec3> {
    let mut rng = random(seed);
    (0..n)
        .map(|_| DVec3::from_array(std::array::from_fn(|_| most * rng.random::<f64>())))
        .collect()
}

/// Solves (I - ρF) x = source by elimination, channel by channel.
fn eliminated(f: &Dense, reflectance: &[DVec3], source: &[DVec3]) -> Vec<DVec3> {
    let n = source.len();
    let mut x = vec![DVec3::ZERO; n];
    for c in 0..3 {
        let mut m: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                let entry = |j: usize| f64::from(i == j) - reflectance[i][c] * f.rows[i][j];
                (0..n).map(entry).chain([source[i][c]]).collect()
            })
            .collect();
        for k in 0..n {
            let pivot = (k..n).max_by(|&a, &b| m[a][k].abs().total_cmp(&m[b][k].abs()));
            m.swap(k, pivot.expect("rows"));
            let row = m[k].clone();
            for other in m.iter_mut().skip(k + 1) {
                let factor = other[k] / row[k];
                other
                    .iter_mut()
                    .zip(&row)
                    .for_each(|(o, r)| *o -= factor * r);
            }
        }
        for k in (0..n).rev() {
            let known: f64 = (k + 1..n).map(|j| m[k][j] * x[j][c]).sum();
            x[k][c] = (m[k][n] - known) / m[k][k];
        }
    }
    x
}

fn norm(x: &[DVec3]) -> f64 {
    x.iter().map(|v| v.length_squared()).sum::<f64>().sqrt()
}

fn apart(a: &[DVec3], b: &[DVec3]) -> f64 {
    norm(&a.iter().zip(b).map(|(a, b)| *a - *b).collect::<Vec<_>>())
}

/// |source - (I - ρF) x| / |source|
fn residual(f: &Dense, reflectance: &[DVec3], source: &[DVec3], x: &[DVec3]) -> f64 {
    let applied = f.apply(&x.to_vec()).expect("applied");
    let left: Vec<DVec3> = (0..x.len())
        .map(|i| source[i] - x[i] + reflectance[i] * applied[i])
        .collect();
    norm(&left) / norm(source)
}

fn run(
    f: &Dense,
    reflectance: &[DVec3],
    source: &[DVec3],
    start: Option<Vec<DVec3>>,
    residual: f64,
    bounces: Option<u32>,
) -> (Vec<DVec3>, Ended) {
    let stop = Stop { residual, bounces };
    let (reflectance, source) = (reflectance.to_vec(), source.to_vec());
    solve(f, &reflectance, &source, start, stop, &Silent).expect("solved")
}

#[test]
fn krylov_agrees_with_elimination() {
    for (n, most, row_sum) in [
        (1, 0.9, 1.0),
        (2, 0.9, 1.0),
        (20, 0.5, 0.7),
        (60, 0.95, 1.0),
        (40, 1.0, 0.99),
    ] {
        let f = dense(n, row_sum, n as u64);
        let reflectance = colours(n, most, 1);
        let source = colours(n, 1.0, 2);
        let wanted = eliminated(&f, &reflectance, &source);
        let (x, ended) = run(&f, &reflectance, &source, None, 1e-10, None);
        assert!(ended.converged && ended.residual <= 1e-10, "{n}: {ended:?}");
        // The residual bounds the error by the norm of the inverse, 1 / (1 - most * row_sum) in the
        // maximum norm; a hundred is enough here.
        assert!(apart(&x, &wanted) < 1e-8 * norm(&wanted), "{n}");
        // What is reported is the true residual (up to rounding of the recurrence).
        let truth = residual(&f, &reflectance, &source, &x);
        assert!(
            (truth - ended.residual).abs() < 1e-12,
            "{n}: {truth} {ended:?}"
        );
    }
}

#[test]
fn the_residual_reported_is_the_true_one() {
    let n = 50;
    let f = dense(n, 1.0, 3);
    let (reflectance, source) = (vec![DVec3::splat(0.9); n], colours(n, 1.0, 4));
    for wanted in [0.1, 1e-2, 1e-4, 1e-6] {
        for start in [None, Some(colours(n, 5.0, 5)), Some(vec![DVec3::ZERO; n])] {
            let (x, ended) = run(&f, &reflectance, &source, start, wanted, None);
            let truth = residual(&f, &reflectance, &source, &x);
            assert!(ended.converged && ended.residual <= wanted);
            assert!(
                (truth / ended.residual - 1.0).abs() < 1e-6,
                "{truth} {ended:?}"
            );
        }
    }
    // In f32 down to a few roundings of the solution, whose size is ten times the source's.
    let narrow = Narrow(dense(n, 1.0, 3), HostFields::default());
    let fields = narrow.fields();
    let up = |v: &[DVec3]| fields.upload(v).expect("upload");
    let stop = Stop {
        residual: 1e-4,
        bounces: None,
    };
    let (x, ended) = solve(
        &narrow,
        &up(&reflectance),
        &up(&source),
        None,
        stop,
        &Silent,
    )
    .expect("solved");
    let truth = residual(
        &f,
        &reflectance,
        &source,
        &fields.download(&x).expect("download"),
    );
    assert!(
        ended.converged && (truth - ended.residual).abs() < 1e-5,
        "{truth} {ended:?}"
    );
}

#[test]
fn bounces_are_terms_of_the_neumann_series() {
    let n = 30;
    let f = dense(n, 0.9, 6);
    let (reflectance, source) = (colours(n, 0.8, 7), colours(n, 1.0, 8));
    // None: nothing is reflected. One: the light of the sources is. Two: and what that lights.
    let (x, ended) = run(&f, &reflectance, &source, None, 1e-3, Some(0));
    assert!(ended.converged && ended.iterations == 0 && norm(&x) == 0.0);
    let mut sum = vec![DVec3::ZERO; n];
    let mut term = source.clone();
    for bounces in 1..=60 {
        (0..n).for_each(|i| sum[i] += term[i]);
        let applied = f.apply(&term).expect("applied");
        term = (0..n).map(|i| reflectance[i] * applied[i]).collect();
        let (x, ended) = run(&f, &reflectance, &source, None, 1e-3, Some(bounces));
        // Bounces under 1e-8 of the first are left out.
        assert!(apart(&x, &sum) < 1e-7 * norm(&sum), "{bounces}");
        assert!(ended.iterations == bounces - 1 || ended.iterations > 10);
    }
    // In the end they are all there are.
    let (all, _) = run(&f, &reflectance, &source, None, 1e-12, None);
    assert!(apart(&all, &sum) < 1e-8 * norm(&all));
}

#[test]
fn nothing_shines_and_nothing_reflects() {
    let n = 20;
    let f = dense(n, 1.0, 9);
    let (reflectance, source) = (colours(n, 0.9, 10), colours(n, 1.0, 11));
    let dark = vec![DVec3::ZERO; n];
    for bounces in [None, Some(0), Some(3)] {
        let (x, ended) = run(&f, &reflectance, &dark, Some(source.clone()), 1e-6, bounces);
        assert!(norm(&x) == 0.0 && ended.converged && ended.residual == 0.0);
    }
    let (x, ended) = run(&f, &dark, &source, None, 1e-6, None);
    assert_eq!(x, source);
    assert!(ended.converged && ended.iterations <= 1, "{ended:?}");
    // One channel dark.
    let red: Vec<DVec3> = source.iter().map(|s| DVec3::new(s.x, 0.0, 0.0)).collect();
    let (x, _) = run(&f, &reflectance, &red, None, 1e-6, None);
    assert!(x.iter().all(|x| x.y == 0.0 && x.z == 0.0));
}

/// The unit of light is the user's: photometric, radiometric, of the sun or of a candle.
#[test]
fn the_unit_of_light_does_not_matter() {
    let n = 40;
    let f = dense(n, 1.0, 12);
    let (reflectance, source) = (colours(n, 0.9, 13), colours(n, 1.0, 14));
    let (x, ended) = run(&f, &reflectance, &source, None, 1e-8, None);
    for unit in [1e-30, 1e-12, 1e12, 1e20] {
        let bright: Vec<DVec3> = source.iter().map(|s| *s * unit).collect();
        let (y, same) = run(&f, &reflectance, &bright, None, 1e-8, None);
        assert!(same.converged, "{unit}: {same:?}");
        assert_eq!(same.iterations, ended.iterations, "{unit}");
        let y: Vec<DVec3> = y.iter().map(|y| *y / unit).collect();
        assert!(apart(&x, &y) < 1e-10 * norm(&x), "{unit}");
    }
}

/// Closed and symmetric (all areas equal): what is absorbed is what the sources sent out.
/// With irradiance H = H0 + F R and row and column sums 1: sum (1 - ρ) H = sum H0.
#[test]
fn energy_balances() {
    let n = 40;
    let mut f = dense(n, 1.0, 15);
    // Sinkhorn: a symmetric matrix with rows that sum up to 1.
    for i in 0..n {
        for j in 0..i {
            let mean = 0.5 * (f.rows[i][j] + f.rows[j][i]);
            (f.rows[i][j], f.rows[j][i]) = (mean, mean);
        }
    }
    for _ in 0..500 {
        let scale: Vec<f64> = f
            .rows
            .iter()
            .map(|r| r.iter().sum::<f64>().sqrt())
            .collect();
        for i in 0..n {
            for j in 0..n {
                f.rows[i][j] /= scale[i] * scale[j];
            }
        }
    }
    let (reflectance, lights) = (colours(n, 0.95, 16), colours(n, 1.0, 17));
    let source: Vec<DVec3> = (0..n).map(|i| reflectance[i] * lights[i]).collect();
    let (x, _) = run(&f, &reflectance, &source, None, 1e-12, None);
    let bounced = f.apply(&x).expect("applied");
    let absorbed: DVec3 = (0..n)
        .map(|i| (DVec3::ONE - reflectance[i]) * (lights[i] + bounced[i]))
        .sum();
    let sent: DVec3 = lights.iter().sum();
    assert!(
        (absorbed - sent).length() < 1e-8 * sent.length(),
        "{absorbed} {sent}"
    );
}

#[test]
fn a_singular_equation_is_not_called_solved() {
    // Nothing is absorbed and nothing gets out: there is no solution.
    let n = 10;
    let f = Dense {
        rows: vec![vec![1.0 / n as f64; n]; n],
        fields: HostFields::default(),
    };
    let ones = vec![DVec3::ONE; n];
    let (x, ended) = run(&f, &ones, &ones, None, 1e-6, None);
    assert!(!ended.converged, "{ended:?}");
    assert!(x.iter().all(|x| x.is_finite()), "{x:?}");
}

/// In f32, where next to nothing is absorbed, the vectors must stay orthogonal: then as many steps
/// do as in f64. (Measured: 15 and 11; with the modified Gram-Schmidt process 31, without an end.)
#[test]
fn rounding_takes_no_more_steps() {
    let n = 200;
    let (reflectance, source) = (vec![DVec3::splat(0.999); n], colours(n, 1.0, 4));
    let narrow = Narrow(dense(n, 1.0, 3), HostFields::default());
    let [r, s] = [&reflectance, &source].map(|v| narrow.fields().upload(v).expect("upload"));
    let stop = Stop {
        residual: 1e-6,
        bounces: None,
    };
    let (_, single) = solve(&narrow, &r, &s, None, stop, &Silent).expect("solved");
    let f = dense(n, 1.0, 3);
    let (_, double) = run(&f, &reflectance, &source, None, 1e-6, None);
    println!(
        "{} steps in f32, {} in f64",
        single.iterations, double.iterations
    );
    assert!(single.converged && single.iterations <= double.iterations + 5);
}
