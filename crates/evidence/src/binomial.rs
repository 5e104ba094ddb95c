//! Rates at which a binomial tail has a given probability: the ends of exact intervals, for up to 10⁹ runs.
//!
//! With X the failures among n runs at rate p, ln P(X <= k) falls as the log-odds t = ln(p/(1 - p)) rise, and is concave in t: its slope is
//! E(X | X <= k) - E(X), and falls by Var(X) - Var(X | X <= k). So Newton's steps come to the rate from above, wherever they begin, and what
//! rounding leaves of the last one is on the side on which the interval is longer. Terms of the tail are added downwards from C(n, k) pᵏ qⁿ⁻ᵏ,
//! which is evaluated by deviances (Loader, Fast and accurate computation of binomial probabilities, 2000): a part in 10¹² of it, where
//! differences of logarithms of factorials leave six digits at 10⁹ runs.

use libm::{exp, log, log1p};

/// How far an end is moved outwards on the scale of log-odds: more than is lost to rounding, of which `ends_are_never_inside` shows how
/// much that is.
const ROUNDING_MARGIN: f64 = 1e-12;

/// The rate at which `failures` or fewer of `runs` have the probability `tail`, from above: 1 if there is none below.
pub(super) fn clopper_pearson_upper(failures: u64, runs: u64, tail: f64) -> f64 {
    solve_log_odds(failures, runs, tail).map_or(1.0, |odds| 1.0 / (1.0 + exp(-(odds + ROUNDING_MARGIN))))
}

/// The rate at which `failures` or more of `runs` have the probability `tail`, from below: 0 if there is none above.
pub(super) fn clopper_pearson_lower(failures: u64, runs: u64, tail: f64) -> f64 {
    // As many successes or fewer, at the rate of successes.
    let odds = solve_log_odds(runs.saturating_sub(failures), runs, tail);
    odds.map_or(0.0, |odds| 1.0 / (1.0 + exp(odds + ROUNDING_MARGIN)))
}

/// The log-odds at which X <= k has a probability; none if it has at all rates, or that is no probability.
fn solve_log_odds(k: u64, n: u64, tail: f64) -> Option<f64> {
    if k >= n || !(tail > 0.0 && tail < 1.0) {
        return None;
    }
    let (wanted, left) = (log(tail), (n - k) as f64);
    // Near the median of the rate.
    let mut odds = log((k as f64 + 2.0 / 3.0) / (left - 1.0 / 3.0));
    for step in 0..MAX_STEPS {
        let [p, q] = [1.0 / (1.0 + exp(-odds)), 1.0 / (1.0 + exp(odds))];
        let (ln_mass, ln_tail) = (ln_pmf(k, n, p, q), ln_cdf(k, n, p, q));
        let slope = -left * p * exp(ln_mass - ln_tail);
        let next = odds - (ln_tail - wanted) / slope;
        // From the second one on they go down, until nothing but rounding is left.
        if !next.is_finite() || (step > 0 && next >= odds) {
            break;
        }
        odds = next;
    }
    Some(odds)
}

/// More than it takes: the distance is squared at each.
const MAX_STEPS: u32 = 100;

/// ln P(X <= k), by the smaller one of both tails.
fn ln_cdf(k: u64, n: u64, p: f64, q: f64) -> f64 {
    let is_low = (k as f64) < n as f64 * p;
    if is_low {
        return ln_pmf(k, n, p, q) + log(cdf_to_pmf_ratio(k, n, p, q));
    }
    // X > k is as many successes as n - k - 1, or fewer.
    let above = if k >= n { 0.0 } else { exp(ln_pmf(k + 1, n, p, q)) * cdf_to_pmf_ratio(n - k - 1, n, q, p) };
    log1p(-above)
}

/// P(X <= k) in units of P(X = k), for k that is not above the mean.
fn cdf_to_pmf_ratio(k: u64, n: u64, p: f64, q: f64) -> f64 {
    let (odds, mut term, mut sum) = (q / p, 1.0, 1.0);
    // C(n, i-1)/C(n, i) = i/(n - i + 1).
    for i in (1..=k).rev() {
        term *= i as f64 / (n - i + 1) as f64 * odds;
        sum += term;
        // What is left is a geometric sum at most, of at most as many terms as a standard deviation is long.
        if term < 1e-22 * sum {
            break;
        }
    }
    sum
}

/// ln P(X = k).
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

/// x ln(x/m) + m - x, without the cancellation where x is near m.
fn deviance(x: f64, m: f64) -> f64 {
    if (x - m).abs() >= 0.1 * (x + m) {
        return x * log(x / m) + m - x;
    }
    let v = (x - m) / (x + m);
    let (mut sum, mut power) = ((x - m) * v, 2.0 * x * v);
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

/// ln n! - ln(√(2πn) (n/e)ⁿ).
fn stirling_error(n: u64) -> f64 {
    let x = n as f64;
    if n <= 15 {
        let factorial = log((2..=n).product::<u64>() as f64);
        return factorial - (x + 0.5) * log(x) + x - 0.5 * log(2.0 * std::f64::consts::PI);
    }
    let square = x * x;
    (1.0 / 12.0
        - (1.0 / 360.0
            - (1.0 / 1260.0 - (1.0 / 1680.0 - (1.0 / 1188.0 - 691.0 / 360_360.0 / square) / square) / square) / square)
            / square)
        / x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_verify::rate::binomial_tail_upper_bound;
    use proptest::prelude::*;

    /// An end as it should be, and never inside of that by a part in 10¹⁵, nor outside by more than a part in 10¹¹.
    fn assert_end(found: f64, exact: f64, outwards: f64) {
        let beyond = outwards * (found - exact) / exact;
        assert!((-1e-15..1e-11).contains(&beyond), "{found:e} {exact:e}: {beyond:e}");
    }

    /// By bisection in 50 decimal digits. The quantiles of the beta distribution in scipy 1.16 are the same to 15 digits, but for the upper
    /// end of 12 of 2·10⁷, which is 6·10⁻¹¹ of itself too low there. Where there are closed forms, these.
    #[test]
    fn ends_are_those_of_clopper_and_pearson() {
        for (failures, runs, tail, ends) in [
            (3, 1000, 0.005, [0.000_338_144_529_066_493_27, 0.010_933_777_420_405_242]),
            (12, 20_000_000, 0.005, [2.471_558_749_808_974_6e-7, 1.207_246_691_762_830_8e-6]),
            (150, 1_000_000_000, 1e-4, [1.086_653_018_671_793_6e-7, 2.010_293_807_913_290_4e-7]),
            (700, 1500, 0.025, [0.441_172_927_572_352_56, 0.492_291_153_412_647_3]),
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
                assert_end(clopper_pearson_lower(1, runs, tail), -libm::expm1(log1p(-tail) / runs as f64), -1.0);
                assert_end(clopper_pearson_lower(runs, runs, tail), exp(log(tail) / runs as f64), -1.0);
                assert_eq!((clopper_pearson_lower(0, runs, tail), clopper_pearson_upper(runs, runs, tail)), (0.0, 1.0));
            }
        }
    }

    proptest! {
        /// The checker's tail is never below the exact one, and above it by what it rounds upwards, at most eight units in the last place
        /// for each run: at the end it is what was asked for, a little inside of the end it is more.
        #[test]
        fn ends_are_never_inside(
            runs in prop_oneof![1..50_u64, 50..3000_u64, 3000..2_000_000_u64],
            share in prop_oneof![0.0..1.0_f64, 0.0..1e-3_f64],
            tail in prop_oneof![1e-3..0.5_f64, 1e-9..1e-3_f64],
        ) {
            let failures = ((runs as f64 * share) as u64).min(runs - 1);
            let high = clopper_pearson_upper(failures, runs, tail);
            // Of a rate near 1 what is left of it has few digits, and it counts once for each run that holds.
            let (runs_f64, holding) = (runs as f64, (runs - failures) as f64);
            let loose = 1.0 + 1e-12 + 8.0 * f64::EPSILON * (runs_f64 + holding / (1.0 - high));
            prop_assert!(binomial_tail_upper_bound(failures, runs, high) <= tail * loose);
            let inside = high * (1.0 - 1e-8);
            prop_assert!(binomial_tail_upper_bound(failures, runs, inside) >= tail, "{high}");
            // The rate of successes cannot be written where there are hardly any failures.
            let low = clopper_pearson_lower(failures, runs, tail);
            if low > 1e-7 {
                prop_assert!(binomial_tail_upper_bound(runs - failures, runs, 1.0 - low) <= tail * (1.0 + 1e-8));
                prop_assert!(binomial_tail_upper_bound(runs - failures, runs, 1.0 - low * (1.0 + 1e-8)) >= tail, "{low}");
            }
        }
    }

    #[test]
    fn what_has_no_end_has_none() {
        for tail in [0.0, 1.0, f64::NAN, -1.0] {
            assert_eq!((clopper_pearson_lower(3, 10, tail), clopper_pearson_upper(3, 10, tail)), (0.0, 1.0));
        }
        assert_eq!((clopper_pearson_lower(0, 0, 0.1), clopper_pearson_upper(0, 0, 0.1)), (0.0, 1.0));
    }
}
