//! One bound of a failure rate from the counts of several seeds.
//!
//! Certificates whose registrations differ only in the seed count independent samples of one distribution. The sum of
//! their failures is therefore binomial in all runs, and bounds the rate as in [`rate`](crate::rate). That holds only
//! if no count was left out: a seed that may be omitted could hide failures. The seeds must therefore form a range
//! without gaps, which the claim states. Only [`Pool::of_seeds`] shows that the first or the last seed is missing.
//! Nothing in the certificates shows when the range was fixed.

use std::collections::{BTreeMap, HashMap};
use std::ops::RangeInclusive;

use crate::certificate::{Certificate, CertificateProvenance};
use crate::rate::{OPS_PER_RUN, describe_bound, tail_upper_bound_by_powers};
use crate::registration::{MAX_RUNS, Registration};
use crate::rejection::Rejection;
use crate::scope::Scope;
use crate::work::{OpBudget, WorkLimit};
use crate::{Assumption, RateClaim, Statement, canonical, check_with};

/// Maximum number of certificates of a pool.
pub const MAX_POOLED_CERTIFICATES: usize = 10_000;

/// Maximum number of blocks of runs of a pool. So many need about half a gigabyte of memory.
pub const MAX_POOLED_BLOCKS: usize = 10_000_000;

/// Assumption of the claim of a pool, besides those of its certificates.
pub const FIXED_RANGE_ASSUMPTION: &str = "the range of seeds was fixed before the first run";

/// Caveat of a pool without an expected range.
pub const UNSTATED_RANGE_CAVEAT: &str = "the range of seeds is that of the certificates: a first or last seed that was \
                                         left out is noticed only if the expected range is given (--seeds)";

/// Largest distance of a bound from the smallest accepted one, relative to its distance from the observed rate.
const RELATIVE_TOLERANCE: f64 = 1e-7;

/// Maximum number of tails that the search for a bound evaluates. It needs about ten.
const MAX_STEPS: u32 = 100;

/// Reason for which certificates make no pool.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PoolRejection {
    /// A certificate proves nothing, or the check takes too long.
    #[error(transparent)]
    Certificate(#[from] Rejection),
    /// A certificate counts no failures of one controller.
    #[error("a certificate of kind `{0}` cannot be pooled, only one of kind `rate`")]
    OtherKind(&'static str),
    /// A certificate of version 1 contains no space and no hashes.
    #[error(
        "a certificate of version 1 cannot be pooled: it contains neither its space nor hashes of its runs"
    )]
    FirstVersion,
    /// A certificate has another configuration than those before it.
    #[error("`{field}` differs from that of the other certificates")]
    OtherConfiguration {
        /// Field that differs.
        field: String,
    },
    /// Two certificates have the same seed.
    #[error("seed {seed} occurs twice")]
    RepeatedSeed {
        /// Seed of both.
        seed: u64,
    },
    /// Two blocks of runs have the same hash. A hash covers the seed and the numbers of the runs, so that only copies
    /// agree.
    #[error(
        "`blocks[{block}]` has the hash of `blocks[{other_block}]` of seed {other_seed}, so one is a copy of the other"
    )]
    CopiedRuns {
        /// Index of the block.
        block: usize,
        /// Seed of the certificate with the other block.
        other_seed: u64,
        /// Index of the other block.
        other_block: usize,
    },
    /// A certificate has a seed outside the expected range.
    #[error("seed {seed} is outside the expected range {first}-{last}")]
    UnexpectedSeed {
        /// Seed of the certificate.
        seed: u64,
        /// First expected seed.
        first: u64,
        /// Last expected seed.
        last: u64,
    },
    /// Seeds of the range are missing.
    #[error(
        "the seeds {first} to {last} are incomplete: {} missing, the first of them is {missing}",
        describe_count(*count)
    )]
    MissingSeeds {
        /// First seed of the range.
        first: u64,
        /// Last seed of the range.
        last: u64,
        /// First missing seed.
        missing: u64,
        /// Number of missing seeds.
        count: u64,
    },
    /// There is no certificate.
    #[error("a pool needs at least one certificate")]
    Empty,
    /// There are too many certificates.
    #[error("a pool has at most {MAX_POOLED_CERTIFICATES} certificates")]
    TooManyCertificates,
    /// There are too many blocks of runs.
    #[error("a pool has at most {MAX_POOLED_BLOCKS} blocks of runs")]
    TooManyBlocks,
    /// There are too many runs.
    #[error("a pool has at most {MAX_RUNS} runs, found {runs}")]
    TooManyRuns {
        /// Number of runs.
        runs: u64,
    },
}

/// A text is no range of seeds.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("must be a range of seeds, such as 0-99")]
pub struct InvalidSeedRange;

/// Reads a range of seeds, such as `0-99`, as in a Slurm array.
///
/// # Errors
/// [`InvalidSeedRange`] for other texts, and a range that ends before it begins.
pub fn parse_seed_range(text: &str) -> Result<RangeInclusive<u64>, InvalidSeedRange> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.parse(), last.parse()) {
        (Ok(first), Ok(last)) if first <= last => Ok(first..=last),
        _ => Err(InvalidSeedRange),
    }
}

fn describe_seeds(first: u64, last: u64) -> String {
    match first == last {
        true => format!("seed {first}"),
        false => format!("the seeds {first} to {last} together"),
    }
}

fn describe_count(seeds: u64) -> String {
    match seeds {
        1 => "1 seed is".to_owned(),
        _ => format!("{seeds} seeds are"),
    }
}

/// Certificates of one configuration and different seeds.
#[derive(Debug, Clone, Default)]
pub struct Pool {
    expected: Option<RangeInclusive<u64>>,
    subject: Option<PoolSubject>,
    seeds: BTreeMap<u64, SeedCount>,
    /// Place of each block, by its hash.
    blocks: HashMap<BlockHash, BlockPlace>,
}

/// First half of the SHA-256 of a block. It tells 10⁷ blocks apart: two of them agree by chance with a probability of
/// 10⁻²⁵.
type BlockHash = u128;

/// Place of a block of runs.
#[derive(Debug, Clone, Copy)]
struct BlockPlace {
    seed: u64,
    block: u32,
}

/// Content that all certificates of a pool share.
#[derive(Debug, Clone, PartialEq)]
struct PoolSubject {
    /// Registration without its seed.
    registration: Registration,
    provenance: CertificateProvenance,
    assumptions: Vec<Assumption>,
    /// Description of the space.
    about: String,
}

/// Count of one seed.
#[derive(Debug, Clone)]
struct SeedCount {
    failures: u64,
    /// Digest of the certificate.
    sha256: String,
}

/// The proved claim of a pool: a controller fails in a space at no more than a rate.
#[derive(Debug, Clone, PartialEq)]
pub struct PooledRate {
    /// Smallest seed.
    pub first_seed: u64,
    /// Largest seed.
    pub last_seed: u64,
    /// Runs of all seeds.
    pub runs: u64,
    /// Failures of all seeds.
    pub failures: u64,
    /// Upper bound of the rate; 1 if the counts show none.
    pub max_rate: f64,
    /// Confidence level.
    pub confidence: f64,
    /// True if the range of seeds was given for the check, false if it is that of the certificates.
    pub is_expected_range: bool,
    /// SHA-256 of the digests of the certificates, in hexadecimal, in the order of their seeds, with a line feed after
    /// each.
    pub sha256: String,
    /// Scope of the claim.
    pub scope: Scope,
    /// Assumptions of every certificate. [`FIXED_RANGE_ASSUMPTION`] comes in addition.
    pub assumptions: Vec<Assumption>,
}

impl std::fmt::Display for PooledRate {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            formatter,
            "rate: {} at confidence {}, for {}, if the counts are right",
            describe_bound(self.max_rate),
            self.confidence,
            describe_seeds(self.first_seed, self.last_seed)
        )
    }
}

impl Pool {
    /// Creates a pool that must have all of these seeds, and no others.
    #[must_use]
    pub fn of_seeds(seeds: RangeInclusive<u64>) -> Self {
        Self {
            expected: Some(seeds),
            ..Self::default()
        }
    }

    /// Checks a certificate alone, and adds it.
    ///
    /// # Errors
    /// [`PoolRejection`] if it is rejected, is not about the failures of one controller, differs from the others in
    /// more than its seed and counts, has an unexpected seed, or repeats a seed or a block of runs. The pool is then
    /// unchanged.
    pub fn add(
        &mut self,
        certificate: &Certificate,
        limit: WorkLimit,
    ) -> Result<(), PoolRejection> {
        let Statement::Rate(claim) = &certificate.statement else {
            return Err(PoolRejection::OtherKind(certificate.statement.name()));
        };
        if certificate.is_first_version() {
            return Err(PoolRejection::FirstVersion);
        }
        if self.seeds.len() == MAX_POOLED_CERTIFICATES {
            return Err(PoolRejection::TooManyCertificates);
        }
        check_with(certificate, None, limit)?;
        let seed = seed_of(claim)?;
        let subject = PoolSubject::new(certificate, claim);
        if let Some(common) = &self.subject {
            common.compare(&subject)?;
        }
        self.check_seed(seed)?;
        let blocks = self.place_new_blocks(seed, claim)?;
        self.subject.get_or_insert(subject);
        self.blocks.extend(blocks);
        let count = SeedCount {
            failures: claim.failures,
            sha256: certificate.digest(),
        };
        self.seeds.insert(seed, count);
        Ok(())
    }

    /// Checks that a seed is expected, and new.
    fn check_seed(&self, seed: u64) -> Result<(), PoolRejection> {
        if let Some(expected) = &self.expected
            && !expected.contains(&seed)
        {
            let [first, last] = [*expected.start(), *expected.end()];
            return Err(PoolRejection::UnexpectedSeed { seed, first, last });
        }
        match self.seeds.contains_key(&seed) {
            true => Err(PoolRejection::RepeatedSeed { seed }),
            false => Ok(()),
        }
    }

    /// Returns the places of the blocks of a certificate, none of which may occur twice.
    fn place_new_blocks(
        &self,
        seed: u64,
        claim: &RateClaim,
    ) -> Result<HashMap<BlockHash, BlockPlace>, PoolRejection> {
        if self.blocks.len() + claim.blocks.len() > MAX_POOLED_BLOCKS {
            return Err(PoolRejection::TooManyBlocks);
        }
        let mut places = HashMap::with_capacity(claim.blocks.len());
        for (block, (_, sha256)) in (0_u32..).zip(&claim.blocks) {
            let hash = block_hash(block, sha256)?;
            let same = self.blocks.get(&hash).or_else(|| places.get(&hash));
            if let Some(other) = same.copied() {
                return Err(PoolRejection::CopiedRuns {
                    block: block as usize,
                    other_seed: other.seed,
                    other_block: other.block as usize,
                });
            }
            places.insert(hash, BlockPlace { seed, block });
        }
        Ok(places)
    }

    /// Returns the number of certificates.
    #[must_use]
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// True without certificates.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// Concludes the smallest bound that follows from all certificates, to about seven digits.
    ///
    /// # Errors
    /// [`PoolRejection`] if seeds are missing, there are too many runs, or the check takes too long.
    pub fn conclude(&self, limit: WorkLimit) -> Result<PooledRate, PoolRejection> {
        let Some(subject) = &self.subject else {
            return Err(PoolRejection::Empty);
        };
        let [first_seed, last_seed] = self.check_range()?;
        let registration = &subject.registration;
        let runs = registration.runs.saturating_mul(self.seeds.len() as u64);
        if runs > MAX_RUNS {
            return Err(PoolRejection::TooManyRuns { runs });
        }
        let counts = self.seeds.values();
        let failures = counts.fold(0, |sum: u64, count| sum.saturating_add(count.failures));
        let work = OpBudget::new(limit);
        let digests = self
            .seeds
            .values()
            .map(|count| format!("{}\n", count.sha256));
        Ok(PooledRate {
            first_seed,
            last_seed,
            runs,
            failures,
            max_rate: upper_bound([failures, runs], registration.confidence, &work)?,
            confidence: registration.confidence,
            is_expected_range: self.expected.is_some(),
            sha256: canonical::sha256(digests.collect::<String>()),
            scope: subject.scope(first_seed, last_seed, runs),
            assumptions: subject.assumptions.clone(),
        })
    }

    /// Checks that no seed of the range is missing, and returns the first and the last one.
    fn check_range(&self) -> Result<[u64; 2], PoolRejection> {
        let seeds = || self.seeds.keys().copied();
        let own_range = seeds().next().zip(seeds().next_back());
        let expected = self.expected.clone().map(RangeInclusive::into_inner);
        let (first, last) = expected.or(own_range).ok_or(PoolRejection::Empty)?;
        // All seeds are in the range.
        let count = (last - first).saturating_sub(self.seeds.len() as u64 - 1);
        if count == 0 {
            return Ok([first, last]);
        }
        let missing = (first..=last).find(|seed| !self.seeds.contains_key(seed));
        Err(PoolRejection::MissingSeeds {
            first,
            last,
            missing: missing.unwrap_or(last),
            count,
        })
    }
}

impl PoolSubject {
    fn new(certificate: &Certificate, claim: &RateClaim) -> Self {
        let mut registration = claim.registration.clone();
        registration.configuration.remove("seed");
        Self {
            registration,
            provenance: certificate.provenance.clone(),
            assumptions: certificate.assumptions.clone(),
            about: certificate.scope().about,
        }
    }

    /// Names the first field in which another certificate differs.
    fn compare(&self, other: &Self) -> Result<(), PoolRejection> {
        let [ours, theirs] = [&self.registration, &other.registration];
        let keys = ours.configuration.keys().chain(theirs.configuration.keys());
        let mut keys =
            keys.filter(|key| ours.configuration.get(*key) != theirs.configuration.get(*key));
        let field = match keys.next() {
            Some(key) => format!("registration.configuration.{key}"),
            None if ours.runs != theirs.runs => "registration.runs".to_owned(),
            None if ours != theirs => "registration".to_owned(),
            None if self.provenance != other.provenance => "provenance".to_owned(),
            None if self.assumptions != other.assumptions => "assumptions".to_owned(),
            None => return Ok(()),
        };
        Err(PoolRejection::OtherConfiguration { field })
    }

    /// Returns the scope of a claim about all runs of a range of seeds.
    fn scope(&self, first: u64, last: u64, runs: u64) -> Scope {
        let mut registration = self.registration.clone();
        registration.runs = runs;
        let seeds = format!("{first} to {last}");
        registration.configuration.insert("seed".to_owned(), seeds);
        Scope {
            about: self.about.clone(),
            ..registration.scope()
        }
    }
}

/// Returns the registered seed. The check of a certificate has shown that it is a whole number.
fn seed_of(claim: &RateClaim) -> Result<u64, Rejection> {
    let text = claim.registration.configuration.get("seed");
    text.and_then(|text| text.parse().ok()).ok_or_else(|| {
        Rejection::invalid("registration.configuration.seed", "must be a whole number")
    })
}

/// Returns the part of a SHA-256 that identifies a block. The check of a certificate has shown that it is hexadecimal.
fn block_hash(block: u32, sha256: &str) -> Result<BlockHash, Rejection> {
    let half = sha256.get(..32);
    half.and_then(|digits| BlockHash::from_str_radix(digits, 16).ok())
        .ok_or_else(|| Rejection::invalid(format!("blocks[{block}]"), "must have a SHA-256"))
}

/// A rate, and the logarithm of its tail relative to the allowed one: at most 0 if the rate is accepted.
#[derive(Debug, Clone, Copy)]
struct TriedRate {
    rate: f64,
    height: f64,
}

/// Tails of one count, at different rates.
struct TailSearch<'a> {
    failures: u64,
    runs: u64,
    /// 1 - confidence, which does not round for a confidence between 1/2 and 1.
    allowed: f64,
    work: &'a OpBudget,
}

impl TailSearch<'_> {
    fn observed_rate(&self) -> f64 {
        self.failures as f64 / self.runs as f64
    }

    fn try_rate(&self, rate: f64) -> Result<TriedRate, Rejection> {
        // Factors of failures or successes, whichever are fewer, as many powers as their expected number needs, and
        // the terms that are not negligible.
        let fewer = self.failures.min(self.runs.saturating_sub(self.failures));
        let expected = 3.0 * rate.min(1.0 - rate) * self.runs as f64;
        let terms = 10.0 * (self.runs as f64).sqrt();
        let operations = (2 * fewer)
            .saturating_add((expected + terms) as u64)
            .saturating_add(1000);
        self.work
            .charge_or_reject(operations.saturating_mul(OPS_PER_RUN))?;
        let tail = tail_upper_bound_by_powers(self.failures, self.runs, rate);
        // The comparison decides, not the rounded logarithm.
        let height = (tail / self.allowed).ln();
        let height = if tail <= self.allowed {
            height.min(0.0)
        } else {
            height.max(f64::MIN_POSITIVE)
        };
        Ok(TriedRate { rate, height })
    }

    /// Returns a rejected and an accepted rate. A rate of 1 counts as accepted.
    fn bracket(&self) -> Result<[TriedRate; 2], Rejection> {
        let [failures, runs] = [self.failures as f64, self.runs as f64];
        let observed = self.observed_rate();
        let needed = -self.allowed.ln();
        // Half of the runs have at most the expected number of failures.
        let mut rejected = TriedRate {
            rate: observed,
            height: needed,
        };
        let mut excess = ((2.0 * needed * failures * (1.0 - observed)).sqrt() + needed) / runs;
        while observed + excess < 1.0 {
            let tried = self.try_rate(observed + excess)?;
            if tried.height <= 0.0 {
                return Ok([rejected, tried]);
            }
            rejected = tried;
            excess *= 2.0;
        }
        let certain = TriedRate {
            rate: 1.0,
            height: -1.0,
        };
        Ok([rejected, certain])
    }

    /// Closes in on the smallest accepted rate by the method of false position, with the change of Illinois (Dowell and
    /// Jarratt, BIT 11, 1971).
    fn smallest_accepted(&self) -> Result<f64, Rejection> {
        let [mut rejected, mut accepted] = self.bracket()?;
        let tolerance = RELATIVE_TOLERANCE * (accepted.rate - self.observed_rate());
        let mut was_accepted = None;
        for _ in 0..MAX_STEPS {
            let width = accepted.rate - rejected.rate;
            if width <= tolerance {
                break;
            }
            let share = rejected.height / (rejected.height - accepted.height);
            let rate = rejected.rate + share * width;
            let [low, high] = [
                rejected.rate + 0.25 * tolerance,
                accepted.rate - 0.25 * tolerance,
            ];
            let tried = self.try_rate(rate.max(low).min(high))?;
            let is_accepted = tried.height <= 0.0;
            let is_repeated = was_accepted == Some(is_accepted);
            let [closer, other] = if is_accepted {
                [&mut accepted, &mut rejected]
            } else {
                [&mut rejected, &mut accepted]
            };
            *closer = tried;
            other.height *= if is_repeated { 0.5 } else { 1.0 };
            was_accepted = Some(is_accepted);
        }
        Ok(accepted.rate)
    }
}

/// Returns an accepted bound close to the smallest one; 1 if none below 1 is accepted.
fn upper_bound(
    [failures, runs]: [u64; 2],
    confidence: f64,
    work: &OpBudget,
) -> Result<f64, Rejection> {
    if failures >= runs {
        return Ok(1.0);
    }
    let search = TailSearch {
        failures,
        runs,
        allowed: 1.0 - confidence,
        work,
    };
    search.smallest_accepted()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rate::binomial_tail_upper_bound;

    fn bound(failures: u64, runs: u64, confidence: f64) -> f64 {
        let work = OpBudget::new(WorkLimit::default());
        upper_bound([failures, runs], confidence, &work).unwrap()
    }

    /// Compares with the closed form without failures, 1 - (1 - γ)^(1/n), and with the tail of the other algorithm.
    #[test]
    fn bounds_are_accepted_and_hardly_above_the_smallest() {
        for runs in [1_u64, 7, 1000, 138_149, 100_000_000, MAX_RUNS] {
            let exact = -(0.001_f64.ln() / runs as f64).exp_m1();
            let bound = bound(0, runs, 0.999);
            assert!(
                bound >= exact && bound < exact * (1.0 + 1e-5),
                "{runs} {bound} {exact}"
            );
        }
        for (failures, runs) in [
            (1, 2),
            (3, 1000),
            (999, 1000),
            (500, 200_000),
            (90_000, 300_000),
            (294_000, 300_000),
        ] {
            for confidence in [0.9, 0.999, 1.0 - 1e-6] {
                let bound = bound(failures, runs, confidence);
                let tail = |rate: f64| binomial_tail_upper_bound(failures, runs, rate);
                let allowed = (1.0 - confidence) * (1.0 + 1e-9);
                assert!(
                    tail(bound) <= allowed,
                    "{failures} {runs} {confidence} {bound}"
                );
                assert!(
                    tail(bound - (1e-5 * bound).min(1e-7)) > allowed,
                    "{failures} {runs} {bound}"
                );
            }
        }
    }

    #[test]
    fn the_bound_is_1_if_all_runs_failed_and_undecided_if_the_limit_is_too_low() {
        assert_eq!(bound(10, 10, 0.9), 1.0);
        let work = OpBudget::new(WorkLimit::from_operations(1000));
        let refused = upper_bound([0, 1000], 0.9, &work).unwrap_err();
        assert!(matches!(refused, Rejection::BudgetExceeded { .. }));
    }
}
