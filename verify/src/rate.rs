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

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::bounded;
use crate::canonical;
use crate::work::OpBudget;
use crate::{ProvedClaim, Rejection};

/// Maximum number of runs of a certificate.
pub const MAX_RUNS: u64 = 1_000_000_000;
/// Maximum number of runs for a tail with one factor per run; above it, powers of the common factor are used.
const MAX_FACTORWISE_RUNS: u64 = 100_000_000;

/// Maximum number of blocks of runs.
pub const MAX_BLOCKS: u64 = 10_000;

const MAX_ENTRIES: usize = 10_000;
const OPS_PER_RUN: u64 = 100;

/// Parameters that were fixed before the first run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registration {
    /// Controllers, scenario space, seed and version of the runs. Nothing is concluded from them.
    #[serde(deserialize_with = "bounded::deserialize_map::<MAX_ENTRIES, _>")]
    pub configuration: BTreeMap<String, String>,
    /// n, the number of runs.
    pub runs: u64,
    /// γ, above 1/2, read as the nearest floating-point number.
    pub confidence: f64,
    /// Runs per hashed block; the last block may be shorter. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub block_runs: Option<u64>,
}

/// Counts of a block of runs, and a hash that only the author of the runs can know.
pub(crate) type CertifiedBlock<T> = (T, String);

impl Registration {
    /// Returns the SHA-256 in hexadecimal of the registration as compact JSON with fields in the order of this type.
    #[must_use]
    pub fn digest(&self) -> String {
        // A struct of strings and numbers always has a JSON form.
        canonical::sha256(serde_json::to_vec(self).unwrap_or_default())
    }
}

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
    /// p₀, read as the nearest floating-point number.
    pub rate_at_most: f64,
    /// Failures and hash of each block of runs, in order. Since version 2.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "bounded::deserialize_list::<{ MAX_BLOCKS as usize }, _, _>"
    )]
    pub blocks: Vec<CertifiedBlock<u64>>,
}

/// The claim that the first of two controllers fails less often than the second on the same samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ComparisonClaim {
    /// Parameters that were fixed before the first run.
    pub registration: Registration,
    /// Published digest of the registration.
    pub registration_sha256: String,
    /// k, the runs in which the first fails and the second does not.
    pub only_first_failed: u64,
    /// d - k, the runs in which the second fails and the first does not.
    pub only_second_failed: u64,
    /// For each block in order: runs that only the first and only the second failed, and its hash. Since version 2.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "bounded::deserialize_list::<{ MAX_BLOCKS as usize }, _, _>"
    )]
    pub blocks: Vec<CertifiedBlock<[u64; 2]>>,
}

pub(crate) fn check_rate(claim: &RateClaim, work: &OpBudget) -> Result<ProvedClaim, Rejection> {
    let registration = &claim.registration;
    check_registration(registration, &claim.registration_sha256)?;
    if claim.failures >= registration.runs {
        return Err(Rejection::invalid(
            "failures",
            "equal the number of runs: no bound on the rate follows",
        ));
    }
    if !(claim.rate_at_most > 0.0 && claim.rate_at_most < 1.0) {
        return Err(Rejection::invalid(
            "rate_at_most",
            "must be between 0 and 1",
        ));
    }
    work.charge_or_reject(registration.runs.saturating_mul(OPS_PER_RUN))?;
    check_tail(
        claim.failures,
        registration.runs,
        claim.rate_at_most,
        registration.confidence,
    )?;
    Ok(ProvedClaim::Rate {
        max_rate: claim.rate_at_most,
        confidence: registration.confidence,
    })
}

pub(crate) fn check_comparison(
    claim: &ComparisonClaim,
    work: &OpBudget,
) -> Result<ProvedClaim, Rejection> {
    let registration = &claim.registration;
    check_registration(registration, &claim.registration_sha256)?;
    let differ = claim
        .only_first_failed
        .saturating_add(claim.only_second_failed);
    if differ > registration.runs {
        return Err(Rejection::invalid(
            "only_first_failed",
            "and `only_second_failed` must not exceed the runs",
        ));
    }
    work.charge_or_reject(differ.saturating_mul(OPS_PER_RUN))?;
    check_tail(
        claim.only_first_failed,
        differ,
        0.5,
        registration.confidence,
    )?;
    Ok(ProvedClaim::FailsLessOften {
        confidence: registration.confidence,
    })
}

fn check_registration(registration: &Registration, published: &str) -> Result<(), Rejection> {
    if registration.digest() != published {
        return Err(Rejection::invalid(
            "registration_sha256",
            "is not the digest of `registration`",
        ));
    }
    if !(1..=MAX_RUNS).contains(&registration.runs) {
        return Err(Rejection::invalid(
            "registration.runs",
            "must be from 1 to 1000 million",
        ));
    }
    // For γ between 1/2 and 1 the subtraction 1 - γ does not round.
    if !(registration.confidence > 0.5 && registration.confidence < 1.0) {
        return Err(Rejection::invalid(
            "registration.confidence",
            "must be between 1/2 and 1",
        ));
    }
    Ok(())
}

pub(crate) fn check_rate_blocks(claim: &RateClaim) -> Result<(), Rejection> {
    let counts = claim
        .blocks
        .iter()
        .map(|(failures, sha256)| (*failures, 0, sha256.as_str()));
    check_blocks(&claim.registration, counts, [claim.failures, 0])
}

pub(crate) fn check_comparison_blocks(claim: &ComparisonClaim) -> Result<(), Rejection> {
    let counts = claim
        .blocks
        .iter()
        .map(|([first, second], sha256)| (*first, *second, sha256.as_str()));
    check_blocks(
        &claim.registration,
        counts,
        [claim.only_first_failed, claim.only_second_failed],
    )
}

/// Checks that the blocks cover the runs and that their counts sum to the claimed ones.
fn check_blocks<'a>(
    registration: &Registration,
    blocks: impl ExactSizeIterator<Item = (u64, u64, &'a str)>,
    claimed: [u64; 2],
) -> Result<(), Rejection> {
    let block_runs = registration.block_runs.filter(|&block_runs| block_runs > 0);
    let block_runs = block_runs
        .ok_or_else(|| Rejection::invalid("registration.block_runs", "must be positive"))?;
    if blocks.len() as u64 != registration.runs.div_ceil(block_runs) {
        return Err(Rejection::invalid("blocks", "must cover all runs"));
    }
    let (mut sums, mut left) = ([0_u64; 2], registration.runs);
    for (index, (first, second, sha256)) in blocks.enumerate() {
        let runs = left.min(block_runs);
        if first.saturating_add(second) > runs {
            return Err(Rejection::invalid(
                format!("blocks[{index}]"),
                "counts more runs than it has",
            ));
        }
        if !canonical::is_sha256(sha256) {
            return Err(Rejection::invalid(
                format!("blocks[{index}]"),
                "must have a SHA-256",
            ));
        }
        (sums, left) = (
            [
                sums[0].saturating_add(first),
                sums[1].saturating_add(second),
            ],
            left - runs,
        );
    }
    if sums == claimed {
        Ok(())
    } else {
        Err(Rejection::invalid(
            "blocks",
            "do not add up to the claimed counts",
        ))
    }
}

fn check_tail(failures: u64, runs: u64, rate: f64, confidence: f64) -> Result<(), Rejection> {
    let (tail, allowed) = (
        binomial_tail_upper_bound(failures, runs, rate),
        1.0 - confidence,
    );
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
        0..=MAX_FACTORWISE_RUNS => {
            tail_upper_bound(failures, runs, rate, &[(round_up(1.0 - rate), 1)])
        }
        _ if runs > MAX_RUNS => 1.0,
        _ => tail_upper_bound_by_powers(failures, runs, rate),
    }
}

/// Returns an upper bound of equal accuracy in about k + log n steps instead of n.
fn tail_upper_bound_by_powers(failures: u64, runs: u64, rate: f64) -> f64 {
    let mut powers = vec![(round_up(1.0 - rate), 1)];
    while let Some(&(power, exponent)) = powers.last()
        && exponent <= runs
        && power * power >= 0.5
    {
        powers.push((round_up(power * power), 2 * exponent));
    }
    tail_upper_bound(failures, runs, rate, &powers)
}

fn round_up(rounded: f64) -> f64 {
    rounded.next_up()
}

/// Bounds the tail. `powers` are upper bounds of powers of q = 1 - p, each with its exponent, in increasing order; the
/// first is q itself. All others must be at least 1/2, so that the product does not underflow.
fn tail_upper_bound(failures: u64, runs: u64, rate: f64, mut powers: &[(f64, u64)]) -> f64 {
    let (k, n) = (failures, runs);
    if k >= n {
        return 1.0;
    }
    let q = round_up(1.0 - rate);
    // The last term, C(n, k) pᵏ qⁿ⁻ᵏ, is a product of k factors p (n - k + i)/i and n - k factors q. While the product
    // is below 1, multiply by one of the first kind, else by one of the second, so that it neither overflows nor
    // underflows early.
    let mut term = 1.0_f64;
    let (mut taken, mut damped) = (0, 0);
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
        let (power, exponent) = powers.last().copied().unwrap_or((q, 1));
        damped += exponent;
        term = round_up(term * power);
    }
    // The terms before it, each from the next: C(n, i-1)/C(n, i) = i/(n - i + 1).
    let odds = round_up(q / rate);
    let mut sum = term;
    for i in (1..=k).rev() {
        term = round_up(term * round_up(round_up(i as f64 / (n - i + 1) as f64) * odds));
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
        let found = binomial_tail_upper_bound(0, 1 << 29, rate);
        let exact = (-4.0_f64 - 2.0 * rate).exp();
        assert!(
            found >= exact && found < exact * (1.0 + 4e-7),
            "{found} {exact}"
        );
    }

    #[test]
    fn few_runs_are_a_factor_each_and_many_are_powers_of_two() {
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
