//! Ends of exact Clopper-Pearson intervals, for up to 10⁹ runs. With X failures in n runs at rate p, ln P(X <= k) falls
//! with the log-odds t = ln(p/(1 - p)) and is concave in t: its slope E(X | X <= k) - E(X) falls by Var(X) - Var(X | X
//! <= k). Newton's method therefore converges from above, and its rounding error makes the interval longer. The tail is
//! summed downwards from C(n, k) pᵏ qⁿ⁻ᵏ, which is computed by deviances to a part in 10¹² (Loader, Fast and accurate
//! computation of binomial probabilities, 2000). Logarithms of factorials keep only six digits at 10⁹ runs.

use libm::{exp, log, log1p};

/// Outward shift of an end in log-odds; exceeds the rounding error, which
/// `interval_ends_are_never_inside_the_exact_ones` shows.
const ROUNDING_MARGIN: f64 = 1e-12;

/// Returns the rate at which P(X <= `failures`) is `tail`, rounded up; 1 if there is none.
#[must_use]
pub fn clopper_pearson_upper(failures: u64, runs: u64, tail: f64) -> f64 {
    solve_log_odds(failures, runs, tail)
        .map_or(1.0, |odds| 1.0 / (1.0 + exp(-(odds + ROUNDING_MARGIN))))
}

/// Returns the rate at which P(X >= `failures`) is `tail`, rounded down; 0 if there is none.
#[must_use]
pub fn clopper_pearson_lower(failures: u64, runs: u64, tail: f64) -> f64 {
    // By symmetry: the upper end for successes.
    let odds = solve_log_odds(runs.saturating_sub(failures), runs, tail);
    odds.map_or(0.0, |odds| 1.0 / (1.0 + exp(odds + ROUNDING_MARGIN)))
}

/// Returns the log-odds at which P(X <= k) is `tail`; `None` if there are none.
fn solve_log_odds(k: u64, n: u64, tail: f64) -> Option<f64> {
    if k >= n || !(tail > 0.0 && tail < 1.0) {
        return None;
    }
    let wanted = log(tail);
    let left = (n - k) as f64;
    // Start near the median of the rate.
    let mut odds = log((k as f64 + 2.0 / 3.0) / (left - 1.0 / 3.0));
    for step in 0..MAX_STEPS {
        let [p, q] = [1.0 / (1.0 + exp(-odds)), 1.0 / (1.0 + exp(odds))];
        let ln_mass = ln_pmf(k, n, p, q);
        let ln_tail = ln_cdf(k, n, p, q);
        let slope = -left * p * exp(ln_mass - ln_tail);
        let next = odds - (ln_tail - wanted) / slope;
        if !next.is_finite() || (step > 0 && next >= odds) {
            break;
        }
        odds = next;
    }
    Some(odds)
}

const MAX_STEPS: u32 = 100;

/// Returns ln P(X <= k), from the smaller tail.
fn ln_cdf(k: u64, n: u64, p: f64, q: f64) -> f64 {
    let is_low = (k as f64) < n as f64 * p;
    if is_low {
        return ln_pmf(k, n, p, q) + log(cdf_to_pmf_ratio(k, n, p, q));
    }
    let above = if k >= n {
        0.0
    } else {
        exp(ln_pmf(k + 1, n, p, q)) * cdf_to_pmf_ratio(n - k - 1, n, q, p)
    };
    log1p(-above)
}

/// Returns P(X <= k)/P(X = k), for k up to the mean.
fn cdf_to_pmf_ratio(k: u64, n: u64, p: f64, q: f64) -> f64 {
    let odds = q / p;
    let mut term = 1.0;
    let mut sum = 1.0;
    // C(n, i-1)/C(n, i) = i/(n - i + 1).
    for i in (1..=k).rev() {
        term *= i as f64 / (n - i + 1) as f64 * odds;
        sum += term;
        // The remainder is at most a geometric sum, with as many terms as a standard deviation.
        if term < 1e-22 * sum {
            break;
        }
    }
    sum
}

fn ln_pmf(k: u64, n: u64, p: f64, q: f64) -> f64 {
    let [x, y, all] = [k, n - k, n].map(|count| count as f64);
    match (k, n - k) {
        (0, _) => all * if p < 0.5 { log1p(-p) } else { log(q) },
        (_, 0) => all * if q < 0.5 { log1p(-q) } else { log(p) },
        _ => {
            let stirling = stirling_error(n) - stirling_error(k) - stirling_error(n - k);
            stirling
                - deviance(x, all * p)
                - deviance(y, all * q)
                - 0.5 * log(2.0 * std::f64::consts::PI * x * (y / all))
        }
    }
}

/// Returns x ln(x/m) + m - x, without cancellation for x near m.
fn deviance(x: f64, m: f64) -> f64 {
    if (x - m).abs() >= 0.1 * (x + m) {
        return x * log(x / m) + m - x;
    }
    let v = (x - m) / (x + m);
    let mut sum = (x - m) * v;
    let mut power = 2.0 * x * v;
    for odd in (3..200_u32).step_by(2) {
        power *= v * v;
        let next = sum + power / f64::from(odd);
        if next == sum {
            break;
        }
        sum = next;
    }
    sum
}

/// Returns ln n! - ln(√(2πn) (n/e)ⁿ).
fn stirling_error(n: u64) -> f64 {
    let x = n as f64;
    if n <= 15 {
        let factorial = log((2..=n).product::<u64>() as f64);
        return factorial - (x + 0.5) * log(x) + x - 0.5 * log(2.0 * std::f64::consts::PI);
    }
    let square = x * x;
    (1.0 / 12.0
        - (1.0 / 360.0
            - (1.0 / 1260.0
                - (1.0 / 1680.0 - (1.0 / 1188.0 - 691.0 / 360_360.0 / square) / square) / square)
                / square)
            / square)
        / x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_verify::rate::binomial_tail_upper_bound;
    use proptest::prelude::*;

    fn assert_end(computed: f64, exact: f64, outwards: f64) {
        let beyond = outwards * (computed - exact) / exact;
        assert!(
            (-1e-15..1e-11).contains(&beyond),
            "{computed:e} {exact:e}: {beyond:e}"
        );
    }

    /// Reference: bisection with 50 digits, or closed forms. scipy 1.16 agrees to 15 digits, except for the upper end
    /// of 12 of 2·10⁷, where it is relatively 6·10⁻¹¹ too low.
    #[test]
    fn interval_ends_match_clopper_and_pearson() {
        for (failures, runs, tail, ends) in [
            (
                3,
                1000,
                0.005,
                [0.000_338_144_529_066_493_27, 0.010_933_777_420_405_242],
            ),
            (
                12,
                20_000_000,
                0.005,
                [2.471_558_749_808_974_6e-7, 1.207_246_691_762_830_8e-6],
            ),
            (
                150,
                1_000_000_000,
                1e-4,
                [1.086_653_018_671_793_6e-7, 2.010_293_807_913_290_4e-7],
            ),
            (
                700,
                1500,
                0.025,
                [0.441_172_927_572_352_56, 0.492_291_153_412_647_3],
            ),
        ] {
            assert_end(clopper_pearson_lower(failures, runs, tail), ends[0], -1.0);
            assert_end(clopper_pearson_upper(failures, runs, tail), ends[1], 1.0);
        }
        let by_scipy: f64 = 1.207_246_691_693_724e-6;
        assert!((clopper_pearson_upper(12, 20_000_000, 0.005) / by_scipy - 1.0).abs() < 1e-10);
        for runs in [1, 2, 30, 100_000, 20_000_000, 1_000_000_000] {
            for tail in [0.45, 0.025, 5e-4, 1e-6, 1e-12] {
                let none = -libm::expm1(log(tail) / runs as f64);
                assert_end(clopper_pearson_upper(0, runs, tail), none, 1.0);
                assert_end(
                    clopper_pearson_lower(1, runs, tail),
                    -libm::expm1(log1p(-tail) / runs as f64),
                    -1.0,
                );
                assert_end(
                    clopper_pearson_lower(runs, runs, tail),
                    exp(log(tail) / runs as f64),
                    -1.0,
                );
                assert_eq!(
                    (
                        clopper_pearson_lower(0, runs, tail),
                        clopper_pearson_upper(runs, runs, tail)
                    ),
                    (0.0, 1.0)
                );
            }
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Compares with the checker's tail, which rounds upwards by at most eight units in the last place per run.
        #[test]
        fn interval_ends_are_never_inside_the_exact_ones(
            runs in prop_oneof![1..50_u64, 50..3000_u64, 3000..2_000_000_u64],
            share in prop_oneof![0.0..1.0_f64, 0.0..1e-3_f64],
            tail in prop_oneof![1e-3..0.5_f64, 1e-9..1e-3_f64],
        ) {
            let failures = ((runs as f64 * share) as u64).min(runs - 1);
            let high = clopper_pearson_upper(failures, runs, tail);
            // For a rate near 1, 1 - rate has few correct digits, and the tail contains it as a factor once per
            // success.
            let (runs_f64, holding) = (runs as f64, (runs - failures) as f64);
            let loose = 1.0 + 1e-12 + 8.0 * f64::EPSILON * (runs_f64 + holding / (1.0 - high));
            prop_assert!(binomial_tail_upper_bound(failures, runs, high) <= tail * loose);
            let inside = high * (1.0 - 1e-8);
            prop_assert!(binomial_tail_upper_bound(failures, runs, inside) >= tail, "{high}");
            // The complement of a tiny rate is not representable.
            let low = clopper_pearson_lower(failures, runs, tail);
            if low > 1e-7 {
                prop_assert!(binomial_tail_upper_bound(runs - failures, runs, 1.0 - low) <= tail * (1.0 + 1e-8));
                let beyond = 1.0 - low * (1.0 + 1e-8);
                prop_assert!(binomial_tail_upper_bound(runs - failures, runs, beyond) >= tail, "{low}");
            }
        }
    }

    #[test]
    fn unbounded_intervals_have_no_end() {
        for tail in [0.0, 1.0, f64::NAN, -1.0] {
            assert_eq!(
                (
                    clopper_pearson_lower(3, 10, tail),
                    clopper_pearson_upper(3, 10, tail)
                ),
                (0.0, 1.0)
            );
        }
        assert_eq!(
            (
                clopper_pearson_lower(0, 0, 0.1),
                clopper_pearson_upper(0, 0, 0.1)
            ),
            (0.0, 1.0)
        );
    }
}
