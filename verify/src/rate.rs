//! Failure rates that were observed, and what they show about the rate behind them.
//!
//! If each of n independent runs fails with probability p, then k failures or fewer happen with probability
//!
//! ```text
//! F(k; n, p) = Σ over i <= k of C(n, i) pⁱ (1 - p)ⁿ⁻ⁱ,
//! ```
//!
//! which falls as p rises. The claim "p <= p₀ at confidence γ" after k failures is the one-sided bound of Clopper and
//! Pearson (Biometrika 26, 1934): it is made exactly where F(k; n, p₀) <= 1 - γ, so whatever the true p is, a false claim is
//! made with probability 1 - γ at most. That holds only if n, γ and the distribution of runs were fixed beforehand: the
//! certificate therefore carries its registration, whose digest can be held by somebody else before the first run.
//!
//! Two controllers that drove the same draws are compared by the sign test (McNemar's test, exact): of the d draws in which
//! exactly one of them fails, the first one fails in k. If it failed as often as the second, k would be binomial with rate
//! 1/2; so F(k; d, 1/2) <= 1 - γ shows that it fails less often.
//!
//! The tail is evaluated upwards: every factor is positive, every operation rounds to nearest and then moves up by one
//! floating-point number, so the result is an upper bound of F.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Most runs a certificate may speak about: evaluating its tail takes as many multiplications.
pub const MOST_RUNS: u64 = 100_000_000;

/// What was fixed before the first run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registration {
    /// Version of the program that runs.
    pub crumple: String,
    /// The controllers, one or two, by name.
    pub controllers: Vec<String>,
    /// SHA-256 of each controller's policy file, in hexadecimal; empty for one that is not learned.
    pub policy_sha256: Vec<String>,
    /// What the vehicles under test look through.
    pub estimator: String,
    /// The distribution that runs are drawn from, by name.
    pub space: String,
    /// SHA-256 of the distribution's definition, in hexadecimal.
    pub space_sha256: String,
    /// Seed of all draws.
    pub seed: u64,
    /// n, the number of runs.
    pub runs: u64,
    /// γ, read as the nearest floating-point number.
    pub confidence: f64,
}

impl Registration {
    /// SHA-256 of the registration as compact JSON, in hexadecimal.
    #[must_use]
    pub fn digest(&self) -> String {
        // A struct of strings and numbers always has a JSON form.
        let json = serde_json::to_vec(self).unwrap_or_default();
        Sha256::digest(json).iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// The claim that a controller fails in a space at no more than a rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rate {
    /// What was fixed before the first run.
    pub registration: Registration,
    /// Its digest, as it was published.
    pub registration_sha256: String,
    /// k, the runs that failed.
    pub failures: u64,
    /// p₀, read as the nearest floating-point number.
    pub rate_at_most: f64,
}

/// The claim that the first of two controllers fails less often than the second, in the same draws.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Comparison {
    /// What was fixed before the first run.
    pub registration: Registration,
    /// Its digest, as it was published.
    pub registration_sha256: String,
    /// k: the first fails, the second does not.
    pub only_first_failed: u64,
    /// d - k: the second fails, the first does not.
    pub only_second_failed: u64,
}

/// Why a rate is not shown.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RateFlaw {
    /// The registration is not the one whose digest was published.
    #[error("`registration_sha256` is not the digest of `registration`, which is {0}")]
    Digest(String),
    /// A number is outside its range.
    #[error("`{0}` is out of range")]
    Range(&'static str),
    /// The observation is not rare enough.
    #[error("what was observed, or better, has probability {tail:e} if the claim is false; {allowed:e} is allowed")]
    NotShown {
        /// Upper bound of the probability.
        tail: f64,
        /// 1 - confidence.
        allowed: f64,
    },
}

impl Rate {
    /// Checks the claim.
    ///
    /// # Errors
    /// [`RateFlaw`] if it is not shown.
    pub fn check(&self) -> Result<(), RateFlaw> {
        let registration = &self.registration;
        check_registration(registration, &self.registration_sha256, 1)?;
        if self.failures > registration.runs {
            return Err(RateFlaw::Range("failures"));
        }
        if !(self.rate_at_most > 0.0 && self.rate_at_most <= 1.0) {
            return Err(RateFlaw::Range("rate_at_most"));
        }
        // That every run may fail is no news.
        if self.rate_at_most == 1.0 {
            return Ok(());
        }
        shown(self.failures, registration.runs, self.rate_at_most, registration.confidence)
    }
}

impl Comparison {
    /// Checks the claim.
    ///
    /// # Errors
    /// [`RateFlaw`] if it is not shown.
    pub fn check(&self) -> Result<(), RateFlaw> {
        let registration = &self.registration;
        check_registration(registration, &self.registration_sha256, 2)?;
        let differ = self.only_first_failed.checked_add(self.only_second_failed);
        match differ.filter(|&differ| differ <= registration.runs) {
            None => Err(RateFlaw::Range("only_first_failed")),
            Some(0) => Err(RateFlaw::NotShown { tail: 1.0, allowed: allowed(registration.confidence) }),
            Some(differ) => shown(self.only_first_failed, differ, 0.5, registration.confidence),
        }
    }
}

fn check_registration(registration: &Registration, published: &str, controllers: usize) -> Result<(), RateFlaw> {
    let digest = registration.digest();
    if digest != published {
        return Err(RateFlaw::Digest(digest));
    }
    if registration.controllers.len() != controllers || registration.policy_sha256.len() != controllers {
        return Err(RateFlaw::Range("registration.controllers"));
    }
    if !(1..=MOST_RUNS).contains(&registration.runs) {
        return Err(RateFlaw::Range("registration.runs"));
    }
    if !(registration.confidence > 0.5 && registration.confidence < 1.0) {
        return Err(RateFlaw::Range("registration.confidence"));
    }
    Ok(())
}

fn shown(failures: u64, runs: u64, rate: f64, confidence: f64) -> Result<(), RateFlaw> {
    let (tail, allowed) = (tail_at_most(failures, runs, rate), allowed(confidence));
    if tail <= allowed { Ok(()) } else { Err(RateFlaw::NotShown { tail, allowed }) }
}

/// 1 - γ, exactly: for γ between 1/2 and 1 the subtraction does not round.
#[must_use]
pub fn allowed(confidence: f64) -> f64 {
    1.0 - confidence
}

/// An upper bound of F(k; n, p) for 0 < p < 1, within about n · 4e-16 of it.
#[must_use]
pub fn tail_at_most(failures: u64, runs: u64, rate: f64) -> f64 {
    let up = |rounded: f64| rounded.next_up();
    if failures >= runs {
        return 1.0;
    }
    let (k, n) = (failures, runs);
    let q = up(1.0 - rate);
    // The last term, C(n, k) pᵏ qⁿ⁻ᵏ, by k factors p (n - k + i)/i and n - k factors q. A large factor is taken whenever the
    // product is below one and a small one otherwise, so that it neither overflows nor vanishes before its time.
    let mut term = 1.0_f64;
    let (mut taken, mut damped) = (0, 0);
    while taken < k || damped < n - k {
        if taken < k && (term < 1.0 || damped == n - k) {
            taken += 1;
            term = up(term * up(up(rate * (n - k + taken) as f64) / taken as f64));
        } else {
            damped += 1;
            term = up(term * q);
        }
    }
    // The terms before it, each from the next: C(n, i-1)/C(n, i) = i/(n - i + 1).
    let odds = up(q / rate);
    let mut sum = term;
    for i in (1..=k).rev() {
        term = up(term * up(up(i as f64 / (n - i + 1) as f64) * odds));
        sum = up(sum + term);
    }
    sum.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registration(runs: u64, confidence: f64, controllers: &[&str]) -> Registration {
        Registration {
            crumple: "0.1.0".to_owned(),
            controllers: controllers.iter().map(|&name| name.to_owned()).collect(),
            policy_sha256: vec![String::new(); controllers.len()],
            estimator: "kalman".to_owned(),
            space: "paper".to_owned(),
            space_sha256: "00".to_owned(),
            seed: 1,
            runs,
            confidence,
        }
    }

    fn rate(failures: u64, runs: u64, rate_at_most: f64, confidence: f64) -> Rate {
        let registration = registration(runs, confidence, &["policy"]);
        Rate { registration_sha256: registration.digest(), registration, failures, rate_at_most }
    }

    #[test]
    fn one_in_ten_thousand_takes_138_149_clean_runs() {
        let confidence = 1.0 - 1e-6;
        assert_eq!(rate(0, 138_149, 1e-4, confidence).check(), Ok(()));
        assert!(matches!(rate(0, 138_148, 1e-4, confidence).check(), Err(RateFlaw::NotShown { .. })));
        assert!(matches!(rate(1, 138_149, 1e-4, confidence).check(), Err(RateFlaw::NotShown { .. })));
        assert_eq!(rate(0, 1_000_000, 1.382e-5, confidence).check(), Ok(()));
        assert!(rate(0, 1_000_000, 1.381e-5, confidence).check().is_err());
    }

    #[test]
    fn the_tail_is_above_the_exact_one_and_close() {
        use num_rational::BigRational;
        use num_traits::{One, Zero};
        for (k, n, p) in [(0, 1, 0.5), (3, 10, 0.25), (0, 200, 0.01), (7, 120, 0.125), (59, 60, 0.9), (50, 100, 0.5)] {
            let exact = BigRational::from_float(p).unwrap();
            let rest = BigRational::one() - &exact;
            let (mut sum, mut choose) = (BigRational::zero(), BigRational::one());
            for i in 0..=k {
                sum += &choose * exact.pow(i) * rest.pow(n - i);
                choose = choose * BigRational::from_integer((n - i).into()) / BigRational::from_integer((i + 1).into());
            }
            let tail = tail_at_most(k as u64, n as u64, p);
            let bound = BigRational::from_float(tail).unwrap();
            assert!(bound >= sum, "{k} {n} {p}");
            assert!(bound <= sum * BigRational::from_float(1.0 + 1e-12).unwrap(), "{k} {n} {p}");
        }
    }

    #[test]
    fn no_term_vanishes_or_overflows_for_large_counts() {
        // Median of a binomial with mean 500 000: between its mean less one and its mean plus one.
        let tail = tail_at_most(500_000, 1_000_000, 0.5);
        assert!((0.5..0.501).contains(&tail), "{tail}");
        assert!(tail_at_most(9_000, 1_000_000, 0.01) < 1e-20);
    }

    #[test]
    fn a_change_of_any_number_that_matters_is_rejected() {
        let sound = serde_json::to_value(rate(3, 1000, 0.0201, 0.999)).unwrap();
        let check = |value: &serde_json::Value| serde_json::from_value::<Rate>(value.clone()).unwrap().check();
        assert_eq!(check(&sound), Ok(()));
        for (path, worse) in [
            ("/failures", 9.into()),
            ("/failures", 1001.into()),
            ("/rate_at_most", 0.01.into()),
            ("/rate_at_most", 0.0.into()),
            ("/registration/runs", 999.into()),
            ("/registration/confidence", 0.9999.into()),
            ("/registration/seed", 2.into()),
            ("/registration/controllers", vec!["idm"].into()),
            ("/registration_sha256", "".into()),
        ] {
            let mut mutant = sound.clone();
            *mutant.pointer_mut(path).unwrap() = worse;
            assert!(check(&mutant).is_err(), "{path}");
        }
    }

    #[test]
    fn the_better_of_two_is_told_by_the_draws_that_tell_them_apart() {
        let registration = registration(100_000, 0.99, &["policy", "baseline"]);
        let claim = |only_first_failed, only_second_failed| Comparison {
            registration_sha256: registration.digest(),
            registration: registration.clone(),
            only_first_failed,
            only_second_failed,
        };
        assert_eq!(claim(0, 7).check(), Ok(()), "1/128 is below 1 %");
        assert!(claim(0, 6).check().is_err(), "1/64 is not");
        assert!(claim(7, 0).check().is_err());
        assert!(claim(0, 0).check().is_err());
        assert_eq!(claim(400, 500).check(), Ok(()));
    }
}
