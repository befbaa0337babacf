//! What follows from measured points: how one quantity grows with another, and which points no other
//! beats.

/// The exponent e of y = c x^e that fits best to points (x, y), by least squares of the logarithms.
/// `None` of fewer than two different x, or where a number is not positive.
pub fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    if points.iter().any(|&(x, y)| !(x > 0.0 && y > 0.0)) {
        return None;
    }
    let logs: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (x.ln(), y.ln())).collect();
    let mean =
        |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / logs.len().max(1) as f64;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let square: f64 = logs.iter().map(|p| (p.0 - x).powi(2)).sum();
    let product: f64 = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    (square > 1e-12).then(|| product / square)
}

/// Which of some points (cost, error) are on the Pareto front, by rising cost: those than which no
/// other is better in one and as good in the other. Of equal points the first counts.
pub fn pareto(points: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (points[a], points[b]);
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let mut least = f64::INFINITY;
    order.retain(|&k| {
        let better = points[k].1 < least;
        least = least.min(points[k].1);
        better
    });
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_of_powers() {
        let power = |e: f64| {
            let at = |n: f64| (n, 3e-5 * n.powf(e));
            exponent(&[2e3, 1e4, 5e4, 1e6].map(at)).unwrap()
        };
        for e in [-0.5, 0.0, 0.67, 1.0, 2.0] {
            assert!((power(e) - e).abs() < 1e-12);
        }
        // Factors 2 and 1/2 at both ends of two decades turn the line by less than 0.31.
        let noisy = [(1e3, 2e3), (1e4, 1e4), (1e5, 5e4)];
        let expected = 1.0 - 4f64.ln() / 100f64.ln();
        assert!((exponent(&noisy).unwrap() - expected).abs() < 1e-12);
    }

    #[test]
    fn no_exponent_of_nothing() {
        assert_eq!(exponent(&[]), None);
        assert_eq!(exponent(&[(10.0, 1.0)]), None);
        assert_eq!(exponent(&[(10.0, 1.0), (10.0, 2.0)]), None);
        assert_eq!(exponent(&[(10.0, 0.0), (20.0, 1.0)]), None);
        assert_eq!(exponent(&[(10.0, f64::NAN), (20.0, 1.0)]), None);
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        let points = [
            (2.0, 0.1),
            (1.0, 0.5),
            (3.0, 0.2),
            (2.0, 0.3),
            (9.0, 0.05),
            (2.0, 0.1),
        ];
        assert_eq!(pareto(&points), [1, 0, 4]);
        assert!(pareto(&[]).is_empty());
        // Against the definition.
        let mut x = 1u32;
        let mut next = || {
            x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(x >> 24)
        };
        let points: Vec<(f64, f64)> = (0..200).map(|_| (next(), next())).collect();
        let beaten = |a: usize, b: usize| {
            let ((ca, ea), (cb, eb)) = (points[a], points[b]);
            cb <= ca && eb <= ea && ((cb, eb) != (ca, ea) || b < a)
        };
        let mut expected: Vec<usize> = (0..points.len())
            .filter(|&a| !(0..points.len()).any(|b| beaten(a, b)))
            .collect();
        expected.sort_by(|&a, &b| points[a].0.total_cmp(&points[b].0));
        assert_eq!(pareto(&points), expected);
    }
}
