//! Bounds of failure rates from observed failures.
//!
//! If each of n independent runs fails with probability p, then k failures or fewer happen with probability
//!
//! ```text
//! F(k; n, p) = Σ over i <= k of C(n, i) pⁱ (1 - p)ⁿ⁻ⁱ,
//! ```
//!
//! which falls as p rises. The claim "p <= p₀ at confidence γ" after k failures is the one-sided bound of Clopper and
//! Pearson (Biometrika 26, 1934). It is made exactly if F(k; n, p₀) <= 1 - γ, so a false claim has probability 1 - γ at
//! most, for any true p. That holds only if n, γ and the distribution of runs were fixed beforehand. The certificate
//! therefore carries its registration; a third party can hold its digest before the first run.
//!
//! The exact McNemar test (sign test) compares two controllers on the same samples. Of the d samples in which exactly
//! one of them fails, the first one fails in k. If both failed equally often, k would be binomial with rate 1/2; so
//! F(k; d, 1/2) <= 1 - γ shows that the first fails less often.
//!
//! The tail is evaluated upwards: every factor is positive, and every operation rounds to nearest and then up by one
//! floating-point number. The result is an upper bound of F.

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::bounded;
use crate::certificate::CertificateProvenance;
use crate::number;
use crate::registration::{CertifiedBlock, Registration};
pub use crate::registration::{MAX_BLOCKS, MAX_RUNS};
use crate::rejection::Rejection;
use crate::scope::Scope;
use crate::work::OpBudget;
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

/// Maximum number of runs for a tail with one factor per run; above it, powers of the common factor are used.
const MAX_FACTORWISE_RUNS: u64 = 100_000_000;

pub(crate) const OPS_PER_RUN: u64 = 100;

/// The claim that a controller fails in a space at no more than a rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateClaim {
    /// Parameters that were fixed before the first run.
    pub registration: Registration,
    /// Published digest of the registration.
    pub registration_sha256: String,
    /// k, the runs that failed.
    pub failures: u64,
    /// p₀, read as the nearest floating-point number. 1 claims nothing: a count of which every run failed has a
    /// certificate for its place in a [`pool`](crate::pool).
    pub rate_at_most: f64,
    /// Failures and hash of each block of runs, in order. Since version 2.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "bounded::deserialize_list::<{ MAX_BLOCKS as usize }, _, _>"
    )]
    pub blocks: Vec<CertifiedBlock<u64>>,
}

impl Claim for RateClaim {
    fn name(&self) -> &'static str {
        "rate"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::Runs(&self.registration)
    }

    fn assumptions(&self) -> Vec<Assumption> {
        vec![Assumption::RegisteredDraws]
    }

    fn scope(&self) -> Scope {
        self.registration.scope()
    }

    fn check_fields(&self, provenance: &CertificateProvenance) -> Result<(), Rejection> {
        self.registration.check_entries(provenance, 1)?;
        self.registration
            .check_blocks(&self.two_controller_blocks(), [self.failures, 0])
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        let registration = &self.registration;
        registration.check(&self.registration_sha256)?;
        if self.failures > registration.runs {
            return Err(Rejection::invalid("failures", "exceed the number of runs"));
        }
        if !(self.rate_at_most > 0.0 && self.rate_at_most <= 1.0) {
            return Err(Rejection::invalid(
                "rate_at_most",
                "must be above 0 and at most 1",
            ));
        }
        if self.rate_at_most < 1.0 {
            self.check_bound(input.work)?;
        }
        Ok(ProvedClaim::Rate {
            max_rate: self.rate_at_most,
            confidence: registration.confidence,
        })
    }

    fn counted_blocks(&self) -> Option<Vec<CertifiedBlock<[u64; 2]>>> {
        Some(self.two_controller_blocks())
    }
}

impl RateClaim {
    /// Checks that the counts show a bound below 1.
    fn check_bound(&self, work: &OpBudget) -> Result<(), Rejection> {
        let Registration {
            runs, confidence, ..
        } = self.registration;
        if self.failures == runs {
            return Err(Rejection::invalid(
                "rate_at_most",
                "must be 1, because every run failed",
            ));
        }
        work.charge_or_reject(runs.saturating_mul(OPS_PER_RUN))?;
        check_tail(self.failures, runs, self.rate_at_most, confidence)
    }

    /// Returns the blocks with counts for two controllers, of which the second never fails.
    fn two_controller_blocks(&self) -> Vec<CertifiedBlock<[u64; 2]>> {
        let blocks = self.blocks.iter();
        blocks
            .map(|(failures, sha256)| ([*failures, 0], sha256.clone()))
            .collect()
    }
}

/// Describes an upper bound of a rate, of which 1 is none.
pub(crate) fn describe_bound(max_rate: f64) -> String {
    match max_rate < 1.0 {
        true => format!("at most {}", number::round_up(max_rate)),
        false => "no bound below 1".to_owned(),
    }
}

/// Checks that the observed failures, or fewer, are improbable at this rate.
pub(crate) fn check_tail(
    failures: u64,
    runs: u64,
    rate: f64,
    confidence: f64,
) -> Result<(), Rejection> {
    let tail = binomial_tail_upper_bound(failures, runs, rate);
    let allowed = 1.0 - confidence;
    if tail <= allowed {
        Ok(())
    } else {
        Err(Rejection::NotSignificant {
            tail_probability: tail,
            max_tail_probability: allowed,
        })
    }
}

/// Returns an upper bound of F(k; n, p) for 0 < p < 1, within about n · 4e-16 of it; 1 for more than [`MAX_RUNS`] runs.
#[must_use]
pub fn binomial_tail_upper_bound(failures: u64, runs: u64, rate: f64) -> f64 {
    match runs {
        0..=MAX_FACTORWISE_RUNS => tail_upper_bound(failures, runs, rate),
        _ if runs > MAX_RUNS => 1.0,
        _ => tail_upper_bound_by_powers(failures, runs, rate),
    }
}

/// Returns an upper bound of equal accuracy in about min(k, n - k) + √n steps instead of n.
pub(crate) fn tail_upper_bound_by_powers(failures: u64, runs: u64, rate: f64) -> f64 {
    let [k, n] = [failures, runs];
    if k >= n {
        return 1.0;
    }
    let q = round_up(1.0 - rate);
    // C(n, k) pᵏ qⁿ⁻ᵏ stays the same if failures and successes change places.
    let term = match k <= n - k {
        true => last_term(k, n, rate, &powers(q, n)),
        false => last_term(n - k, n, q, &powers(rate, n)),
    };
    sum_of_terms(term, [k, n], rate, NEGLIGIBLE_SHARE)
}

/// Returns upper bounds of powers of a number, each with its exponent, in increasing order.
fn powers(base: f64, runs: u64) -> Vec<(f64, u64)> {
    let mut powers = vec![(base, 1)];
    while let Some(&(power, exponent)) = powers.last()
        && exponent <= runs
        && power * power >= 0.5
    {
        powers.push((round_up(power * power), 2 * exponent));
    }
    powers
}

fn round_up(rounded: f64) -> f64 {
    rounded.next_up()
}

/// Bounds the tail with one factor per run.
fn tail_upper_bound(failures: u64, runs: u64, rate: f64) -> f64 {
    if failures >= runs {
        return 1.0;
    }
    let term = last_term(failures, runs, rate, &[(round_up(1.0 - rate), 1)]);
    sum_of_terms(term, [failures, runs], rate, 0.0)
}

/// Bounds the last term of the tail, C(n, k) pᵏ qⁿ⁻ᵏ. `powers` are upper bounds of powers of q = 1 - p, each with its
/// exponent, in increasing order; the first is q itself. All others must be at least 1/2, so that the product does not
/// underflow.
fn last_term(k: u64, n: u64, rate: f64, mut powers: &[(f64, u64)]) -> f64 {
    // The term is a product of k factors p (n - k + i)/i and n - k factors q. While the product is below 1, multiply by
    // one of the first kind, else by one of the second, so that it neither overflows nor underflows early.
    let mut term = 1.0_f64;
    let mut taken = 0;
    let mut damped = 0;
    while taken < k || damped < n - k {
        if taken < k && (term < 1.0 || damped == n - k) {
            taken += 1;
            term =
                round_up(term * round_up(round_up(rate * (n - k + taken) as f64) / taken as f64));
            continue;
        }
        while let [rest @ .., (_, exponent)] = powers
            && *exponent > n - k - damped
            && !rest.is_empty()
        {
            powers = rest;
        }
        let (power, exponent) = powers.last().copied().unwrap_or((1.0, 1));
        damped += exponent;
        term = round_up(term * power);
    }
    term
}

/// Share of the sum below which [`sum_of_terms`] bounds all further terms together; far below the rounding of the sum.
const NEGLIGIBLE_SHARE: f64 = 1e-20;

/// Bounds the sum of the terms 0 to k. `term` is the last one. Terms below a share of the sum are bounded together.
fn sum_of_terms(mut term: f64, [k, n]: [u64; 2], rate: f64, negligible_share: f64) -> f64 {
    // Each term follows from the next: C(n, i-1)/C(n, i) = i/(n - i + 1).
    let odds = round_up(round_up(1.0 - rate) / rate);
    let mut sum = term;
    for i in (1..=k).rev() {
        let ratio = round_up(round_up(i as f64 / (n - i + 1) as f64) * odds);
        // Further ratios are smaller, so that all further terms are below those of a geometric series.
        let slack = (1.0 - ratio).next_down();
        if term < negligible_share * sum * slack {
            sum = round_up(sum + round_up(term / slack));
            break;
        }
        term = round_up(term * ratio);
        sum = round_up(sum + term);
    }
    sum.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that powers, another order of the same product, are as tight and never below the exact tail.
    #[test]
    fn grouped_powers_equal_products_of_factors() {
        for (failures, runs, rate) in [
            (0, 300_000, 3e-5),
            (7, 300_000, 5e-5),
            (900, 300_000, 3.2e-3),
            (1, 1000, 1e-7),
            (140_000, 300_000, 0.47),
            (150_000, 300_000, 0.503),
            (160_000, 300_000, 0.535),
            (294_000, 300_000, 0.9805),
            (299_997, 300_000, 0.99999),
        ] {
            let one_by_one = binomial_tail_upper_bound(failures, runs, rate);
            let together = tail_upper_bound_by_powers(failures, runs, rate);
            assert!(
                (together / one_by_one - 1.0).abs() < 2e-10,
                "{failures} {runs} {rate}: {together} {one_by_one}"
            );
        }
        // q^n for q = 1 - 2^-27 and n = 2^29, which is exp(-4) to within 2e-8.
        let rate = 2.0_f64.powi(-27);
        let actual = binomial_tail_upper_bound(0, 1 << 29, rate);
        let exact = (-4.0_f64 - 2.0 * rate).exp();
        assert!(
            actual >= exact && actual < exact * (1.0 + 4e-7),
            "{actual} {exact}"
        );
    }

    /// Compares with exact fractions, for all numbers of failures.
    #[test]
    fn powers_bound_the_exact_tail_closely() {
        use num_rational::BigRational;
        use num_traits::{One, Zero};
        let fraction = |number: f64| BigRational::from_float(number).unwrap();
        for (runs, rate) in [(1, 0.5), (2, 0.9), (13, 0.03), (24, 0.5), (31, 0.97)] {
            let [p, q] = [fraction(rate), BigRational::one() - fraction(rate)];
            let (mut exact, mut choose) = (BigRational::zero(), BigRational::one());
            for k in 0..runs {
                exact += &choose * p.pow(k) * q.pow(runs - k);
                choose *= BigRational::new((runs - k).into(), (k + 1).into());
                let bound = fraction(tail_upper_bound_by_powers(k as u64, runs as u64, rate));
                let most = (&exact * fraction(1.0 + 1e-12)).min(BigRational::one());
                assert!(bound >= exact && bound <= most, "{k} {runs} {rate}");
            }
        }
    }

    /// The terms that are bounded together change nothing that is above the rounding.
    #[test]
    fn negligible_terms_are_bounded_together() {
        for (failures, runs, rate) in [(900, 300_000, 3.2e-3), (294_000, 300_000, 0.9805)] {
            let term = last_term(failures, runs, rate, &powers(round_up(1.0 - rate), runs));
            let all = sum_of_terms(term, [failures, runs], rate, 0.0);
            let most = sum_of_terms(term, [failures, runs], rate, NEGLIGIBLE_SHARE);
            assert!(most <= all && most >= all * (1.0 - 1e-9), "{most} {all}");
            let loose = sum_of_terms(term, [failures, runs], rate, 1e-3);
            assert!(loose > all && loose < all * 1.002, "{loose} {all}");
        }
    }

    #[test]
    fn the_binomial_tail_uses_powers_for_many_runs() {
        let times =
            |factor: f64, count: u32| (0..count).fold(1.0, |product, _| round_up(product * factor));
        let squared = |rate: f64, often: u32| {
            (0..often).fold(round_up(1.0 - rate), |power, _| round_up(power * power))
        };
        for rate in (1..=50).map(|n| 1e-5 * f64::from(n)) {
            assert_eq!(
                binomial_tail_upper_bound(0, 1000, rate),
                times(round_up(1.0 - rate), 1000)
            );
            assert_eq!(
                tail_upper_bound_by_powers(0, 1024, rate),
                times(squared(rate, 10), 1)
            );
            let each_once = (0..10).rev().fold(1.0, |product, often| {
                round_up(product * squared(rate, often))
            });
            assert_eq!(tail_upper_bound_by_powers(0, 1023, rate), each_once);
        }
        // 0.9^4 is 0.66, and its square is less than a half.
        assert_eq!(
            tail_upper_bound_by_powers(0, 64, 0.1),
            times(squared(0.1, 2), 16)
        );
    }
}
