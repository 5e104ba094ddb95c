//! Rates and comparisons are accepted exactly if the binomial tail permits.

use std::collections::BTreeMap;

use crumple_verify::rate::binomial_tail_upper_bound;
use crumple_verify::{
    ComparisonClaim, ProvedClaim, RateClaim, Registration, Rejection, Statement, check,
};

use crate::support::certificate;

fn check_statement(statement: Statement) -> Result<ProvedClaim, Rejection> {
    check(&certificate(statement))
}

fn registration(runs: u64, confidence: f64) -> Registration {
    let configuration = BTreeMap::from([("controller".to_owned(), "policy".to_owned())]);
    Registration {
        configuration,
        runs,
        confidence,
        block_runs: None,
    }
}

pub fn rate(failures: u64, runs: u64, rate_at_most: f64, confidence: f64) -> RateClaim {
    let registration = registration(runs, confidence);
    RateClaim {
        registration_sha256: registration.digest(),
        registration,
        failures,
        rate_at_most,
        blocks: Vec::new(),
    }
}

pub fn comparison(
    (runs, confidence): (u64, f64),
    only_first_failed: u64,
    only_second_failed: u64,
) -> Statement {
    let registration = registration(runs, confidence);
    Statement::Comparison(ComparisonClaim {
        registration_sha256: registration.digest(),
        registration,
        only_first_failed,
        only_second_failed,
        blocks: Vec::new(),
    })
}

fn is_shown(rate: RateClaim) -> bool {
    match check_statement(Statement::Rate(rate)) {
        Ok(accepted) => matches!(accepted, ProvedClaim::Rate { .. }),
        Err(rejection) => !matches!(rejection, Rejection::NotSignificant { .. }),
    }
}

#[test]
fn one_in_ten_thousand_takes_138_149_clean_runs() {
    let confidence = 1.0 - 1e-6;
    assert!(is_shown(rate(0, 138_149, 1e-4, confidence)));
    assert!(!is_shown(rate(0, 138_148, 1e-4, confidence)));
    assert!(!is_shown(rate(1, 138_149, 1e-4, confidence)));
    assert!(is_shown(rate(0, 1_000_000, 1.382e-5, confidence)));
    assert!(!is_shown(rate(0, 1_000_000, 1.381e-5, confidence)));
}

#[test]
fn the_tail_is_above_the_exact_one_and_close() {
    use num_rational::BigRational;
    use num_traits::{One, Zero};
    for (k, n, p) in [
        (0, 1, 0.5),
        (3, 10, 0.25),
        (0, 200, 0.01),
        (7, 120, 0.125),
        (59, 60, 0.9),
        (50, 100, 0.5),
    ] {
        let exact = BigRational::from_float(p).unwrap();
        let rest = BigRational::one() - &exact;
        let (mut sum, mut choose) = (BigRational::zero(), BigRational::one());
        for i in 0..=k {
            sum += &choose * exact.pow(i) * rest.pow(n - i);
            choose = choose * BigRational::from_integer((n - i).into())
                / BigRational::from_integer((i + 1).into());
        }
        let tail = binomial_tail_upper_bound(k as u64, n as u64, p);
        let bound = BigRational::from_float(tail).unwrap();
        assert!(bound >= sum, "{k} {n} {p}");
        assert!(
            bound <= sum * BigRational::from_float(1.0 + 1e-12).unwrap(),
            "{k} {n} {p}"
        );
    }
}

#[test]
fn no_term_vanishes_or_overflows_for_large_counts() {
    // Median of a binomial with mean 500 000: between its mean less one and its mean plus one.
    let tail = binomial_tail_upper_bound(500_000, 1_000_000, 0.5);
    assert!((0.5..0.501).contains(&tail), "{tail}");
    assert!(binomial_tail_upper_bound(9_000, 1_000_000, 0.01) < 1e-20);
}

#[test]
fn a_change_of_any_number_that_matters_is_rejected() {
    let sound = serde_json::to_value(rate(3, 1000, 0.0201, 0.999)).unwrap();
    let judge = |value: &serde_json::Value| {
        check_statement(Statement::Rate(
            serde_json::from_value(value.clone()).unwrap(),
        ))
    };
    assert_eq!(
        judge(&sound),
        Ok(ProvedClaim::Rate {
            max_rate: 0.0201,
            confidence: 0.999
        })
    );
    for (path, worse) in [
        ("/failures", 9.into()),
        ("/failures", 1001.into()),
        ("/rate_at_most", 0.01.into()),
        ("/rate_at_most", 0.0.into()),
        ("/registration/runs", 999.into()),
        ("/registration/confidence", 0.9999.into()),
        ("/registration/configuration/controller", "idm".into()),
        ("/registration_sha256", "".into()),
    ] {
        let mut mutant = sound.clone();
        *mutant.pointer_mut(path).unwrap() = worse;
        assert!(judge(&mutant).is_err(), "{path}");
    }
}

#[test]
fn the_better_controller_is_decided_by_discordant_samples() {
    let shown = |first, second| check_statement(comparison((100_000, 0.99), first, second)).is_ok();
    assert!(shown(0, 7), "1/128 is below 1 %");
    assert!(!shown(0, 6), "1/64 is not");
    assert!(!shown(7, 0));
    assert!(!shown(0, 0));
    assert!(shown(400, 500));
}

#[test]
fn too_many_runs_or_only_failures_bound_no_rate() {
    let most = crumple_verify::rate::MAX_RUNS;
    let exact = (most as f64 * (-1e-9_f64).ln_1p()).exp();
    let tail = binomial_tail_upper_bound(0, most, 1e-9);
    assert!(
        tail >= exact * (1.0 - 1e-12) && tail <= exact * (1.0 + 5e-7),
        "{tail} {exact}"
    );
    for runs in [most + 1, most + 2, u64::MAX] {
        for rate in [1e-9, 1e-300, 0.5] {
            assert_eq!(
                binomial_tail_upper_bound(0, runs, rate),
                1.0,
                "{runs} {rate}"
            );
        }
    }
    for (failures, runs) in [(5, 5), (6, 5), (0, 0)] {
        assert_eq!(
            binomial_tail_upper_bound(failures, runs, 0.5),
            1.0,
            "{failures} of {runs}"
        );
    }
}

/// 1 - p rounds to 1, and its upper bound exceeds 1: no factor reduces the product.
#[test]
fn the_tail_of_a_rate_near_zero_is_one() {
    for runs in 1..9 {
        for failures in 0..runs {
            assert_eq!(
                binomial_tail_upper_bound(failures, runs, 1e-300),
                1.0,
                "{failures} of {runs}"
            );
        }
    }
}

fn rejection_text(statement: Statement) -> String {
    check_statement(statement).unwrap_err().to_string()
}

#[test]
fn limits_of_registrations_and_claims_are_exact() {
    for confidence in [-1.0, 0.4, 0.5, 1.0, 1.1, f64::NAN] {
        let refused = rejection_text(Statement::Rate(rate(0, 100, 0.9, confidence)));
        assert_eq!(
            refused, "`registration.confidence` must be between 1/2 and 1",
            "{confidence}"
        );
    }
    for confidence in [0.5_f64.next_up(), 1.0_f64.next_down()] {
        assert!(is_shown(rate(0, 100, 0.9, confidence)), "{confidence}");
        assert!(
            check_statement(Statement::Rate(rate(0, 100, 0.9, confidence))).is_ok(),
            "{confidence}"
        );
    }
    for rate_at_most in [-0.1, 0.0, 1.0_f64.next_up(), 1.5, f64::NAN] {
        let refused = rejection_text(Statement::Rate(rate(0, 100, rate_at_most, 0.9)));
        assert_eq!(
            refused, "`rate_at_most` must be above 0 and at most 1",
            "{rate_at_most}"
        );
    }
    assert!(check_statement(Statement::Rate(rate(99, 100, 1.0_f64.next_down(), 0.9))).is_ok());
    for (runs, failures) in [(0, 0), (1_000_000_001, 0)] {
        let refused = rejection_text(Statement::Rate(rate(failures, runs, 0.5, 0.9)));
        assert_eq!(
            refused, "`registration.runs` must be from 1 to 1000 million",
            "{runs}"
        );
    }
    for rate_at_most in [0.5, 1.0_f64.next_down()] {
        let refused = rejection_text(Statement::Rate(rate(100, 100, rate_at_most, 0.9)));
        assert_eq!(
            refused,
            "`rate_at_most` must be 1, because every run failed"
        );
    }
    for rate_at_most in [0.5, 1.0] {
        let refused = rejection_text(Statement::Rate(rate(101, 100, rate_at_most, 0.9)));
        assert_eq!(refused, "`failures` exceed the number of runs");
    }
    for failures in [0, 99, 100] {
        let nothing = check_statement(Statement::Rate(rate(failures, 100, 1.0, 0.9))).unwrap();
        let text = "rate: no bound below 1 at confidence 0.9, if its counts are right";
        assert_eq!(nothing.to_string(), text);
    }

    assert_eq!(
        check_statement(comparison((10, 0.99), 0, 10)),
        Ok(ProvedClaim::FailsLessOften { confidence: 0.99 }),
        "2^-10 is below 1 %"
    );
    for only_second_failed in [11, 12, u64::MAX] {
        let refused = rejection_text(comparison((10, 0.99), 0, only_second_failed));
        assert_eq!(
            refused,
            "`only_first_failed` and `only_second_failed` must not exceed the runs"
        );
    }
}
