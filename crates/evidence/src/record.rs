//! Record of a count: its configuration, and the results of its blocks.

use std::ops::Range;

use crumple_verify::rate::binomial_tail_upper_bound;
use crumple_verify::{Certificate, ComparisonClaim, RateClaim, Registration, Statement};
use serde::{Deserialize, Serialize};

use super::CountedBlock;
use crumple_core::binomial;
use crumple_search::worst_case::build_certificate;
use crumple_sim::engine::FailedControllerRuns;

/// Registration of a count, and its space as a file.
#[derive(Debug, Clone, PartialEq)]
pub struct CountRecord {
    pub(super) registration: Registration,
    pub(super) space_text: String,
}

/// Counts so far. A run fails if vehicles collide, or if a controller gives no answer.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CountTally {
    /// Digest of the registration.
    pub registration_sha256: String,
    /// Number of runs.
    pub runs: u64,
    /// Runs in which the controller failed; with two controllers, both, unless the second gave no answer.
    pub failures: u64,
    /// Runs in which only the first of two controllers failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// Completed blocks, in order.
    pub blocks: Vec<CountedBlock>,
}

impl CountTally {
    /// Returns the number of failed runs; with two controllers, those in which either failed.
    #[must_use]
    pub fn failed_runs(&self) -> u64 {
        self.failures
            .saturating_add(self.only_first_failed)
            .saturating_add(self.only_second_failed)
    }

    /// Returns runs without an answer of the controller, or of the first of two, and of the second.
    #[must_use]
    pub fn missing_answers(&self) -> [Option<FailedControllerRuns>; 2] {
        let mut all = [None, None];
        for block in &self.blocks {
            let own = [&block.missing_answers, &block.second_missing_answers];
            all.iter_mut()
                .zip(own)
                .for_each(|(all, own)| FailedControllerRuns::merge(all, own.clone()));
        }
        all
    }

    /// Describes the counts of one controller, or of two.
    #[must_use]
    pub fn summary(&self, is_of_two: bool) -> String {
        let Self {
            runs,
            failures,
            only_first_failed,
            only_second_failed,
            ..
        } = self;
        let counts = if is_of_two {
            format!(
                "{only_first_failed} runs in which only the first failed, {only_second_failed} only the second, \
                 {failures} both, of {runs} runs"
            )
        } else {
            format!("{failures} failures in {runs} runs")
        };
        counts + &self.missing_answers_summary()
    }

    /// Describes missing answers, each after a semicolon; empty without any.
    #[must_use]
    pub fn missing_answers_summary(&self) -> String {
        let who = [
            "; the controller ",
            "; the other controller, whose runs without an answer count for neither, ",
        ];
        let words = who.into_iter().zip(self.missing_answers());
        words
            .filter_map(|(who, silent)| Some(format!("{who}{}", silent?.describe(self.runs))))
            .collect()
    }

    pub(super) fn add_block(&mut self, runs: u64, block: CountedBlock) {
        self.runs += runs;
        self.failures += block.failures;
        self.only_first_failed += block.only_first_failed;
        self.only_second_failed += block.only_second_failed;
        self.blocks.push(block);
    }
}

impl CountRecord {
    /// True if two controllers are compared.
    #[must_use]
    pub fn is_comparison(&self) -> bool {
        self.registration.configuration.contains_key("against")
    }

    pub(super) fn block_runs(&self) -> u64 {
        self.registration.block_runs.unwrap_or(1).max(1)
    }

    #[must_use]
    pub(crate) fn block_count(&self) -> u64 {
        self.registration.runs.div_ceil(self.block_runs())
    }

    #[must_use]
    pub(crate) fn run_range(&self, blocks: Range<u64>) -> Range<u64> {
        let [first, end] = [blocks.start, blocks.end].map(|block| {
            block
                .saturating_mul(self.block_runs())
                .min(self.registration.runs)
        });
        first..end
    }

    /// Returns a tally without runs.
    #[must_use]
    pub fn empty_tally(&self) -> CountTally {
        CountTally {
            registration_sha256: self.registration.digest(),
            ..CountTally::default()
        }
    }

    /// True if a tally is of the first blocks, adds up, and has no more runs than there are.
    #[must_use]
    pub(super) fn is_consistent(&self, tally: &CountTally) -> bool {
        let count = tally.blocks.len() as u64;
        count <= self.block_count()
            && tally.registration_sha256 == self.registration.digest()
            && tally.runs == range_len(&self.run_range(0..count))
            && (0..)
                .zip(&tally.blocks)
                .all(|(index, block)| self.is_possible_block(index, block))
            && sum_of_blocks(tally, |block| block.failures) == tally.failures
            && sum_of_blocks(tally, |block| block.only_first_failed) == tally.only_first_failed
            && sum_of_blocks(tally, |block| block.only_second_failed) == tally.only_second_failed
    }

    /// True if the counts of a block are within its runs, and it has a hash.
    pub(super) fn is_possible_block(&self, index: u64, block: &CountedBlock) -> bool {
        let CountedBlock {
            failures,
            only_first_failed,
            only_second_failed,
            sha256,
            ..
        } = block;
        let is_hash = sha256.len() == 64
            && sha256
                .bytes()
                .all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte));
        let runs = range_len(&self.run_range(index..index.saturating_add(1)));
        let first_failed = failures.saturating_add(*only_first_failed);
        let any_failed = first_failed.saturating_add(*only_second_failed);
        let [first_missing, second_missing] =
            [&block.missing_answers, &block.second_missing_answers]
                .map(|missing| missing.as_ref().map_or(0, |missing| missing.runs));
        let is_for_one_controller = block.second_missing_answers.is_none()
            && only_first_failed.saturating_add(*only_second_failed) == 0;
        is_hash
            // A run in which both gave no answer is no failure.
            && first_missing <= first_failed.saturating_add(second_missing)
            && any_failed.saturating_add(second_missing) <= runs.saturating_add(*failures)
            && any_failed <= runs
            && (self.is_comparison() || is_for_one_controller)
    }

    /// Builds the certificate of a complete tally. For one controller it states the lowest accepted rate, to nine
    /// digits.
    #[must_use]
    pub fn certificate(&self, tally: &CountTally) -> Certificate {
        let registration = self.registration.clone();
        let registration_sha256 = registration.digest();
        let blocks = tally.blocks.iter();
        let statement = if self.is_comparison() {
            let blocks = blocks.map(|block| {
                let failed = [block.only_first_failed, block.only_second_failed];
                (failed, block.sha256.clone())
            });
            Statement::Comparison(ComparisonClaim {
                registration,
                registration_sha256,
                only_first_failed: tally.only_first_failed,
                only_second_failed: tally.only_second_failed,
                blocks: blocks.collect(),
            })
        } else {
            Statement::Rate(RateClaim {
                registration,
                registration_sha256,
                failures: tally.failures,
                rate_at_most: self.rate_at_most(tally.failures),
                blocks: blocks
                    .map(|block| (block.failures, block.sha256.clone()))
                    .collect(),
            })
        };
        let facts = &self.registration.configuration;
        let registered = |name| facts.get(name).cloned().unwrap_or_default();
        let text = Some(self.space_text.clone());
        let mut certificate = build_certificate(registered("space"), text, None, statement);
        certificate.provenance.crumple = registered("crumple");
        certificate
    }

    /// Returns the accepted upper bound on the rate if so many of all runs fail; 1 if there is none.
    #[must_use]
    pub fn rate_at_most(&self, failures: u64) -> f64 {
        upper_bound(
            failures,
            self.registration.runs,
            self.registration.confidence,
        )
    }
}

fn sum_of_blocks(tally: &CountTally, count: fn(&CountedBlock) -> u64) -> u64 {
    tally.blocks.iter().map(count).fold(0, u64::saturating_add)
}

pub(super) fn range_len(range: &Range<u64>) -> u64 {
    range.end.saturating_sub(range.start)
}

/// Returns a rate that the checker accepts, little above the Clopper-Pearson bound; 1 if there is none.
pub(super) fn upper_bound(failures: u64, runs: u64, confidence: f64) -> f64 {
    let allowed = 1.0 - confidence;
    let (mut aimed_at, mut rejected) = (allowed, 0.0);
    for doubling in 0..MAX_TRIES {
        let rate = binomial::clopper_pearson_upper(failures, runs, aimed_at);
        if !(rate > 0.0 && rate < 1.0) {
            break;
        }
        let tail = binomial_tail_upper_bound(failures, runs, rate);
        if tail <= allowed {
            return lowest_accepted(rejected, rate, |rate| {
                binomial_tail_upper_bound(failures, runs, rate) <= allowed
            });
        }
        // The checker rounds its tail upwards, more so for more runs; correct by the observed excess. It cannot
        // distinguish all rates below 10⁻⁸.
        rejected = rate;
        aimed_at *= allowed / tail * (1.0 - 1e-11 * f64::from(1_u32 << doubling));
    }
    1.0
}

/// Bisects to the lowest accepted rate, to nine digits.
fn lowest_accepted(mut rejected: f64, mut accepted: f64, is_accepted: impl Fn(f64) -> bool) -> f64 {
    while rejected > 0.0 && accepted - rejected > 1e-9 * accepted {
        let middle = 0.5 * (rejected + accepted);
        if is_accepted(middle) {
            accepted = middle
        } else {
            rejected = middle
        }
    }
    accepted
}

const MAX_TRIES: u32 = 30;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_accepted_and_hardly_above_the_closed_form() {
        for (failures, runs, confidence) in [
            (0, 1000, 0.99),
            (3, 1000, 0.999),
            (0, 138_149, 1.0 - 1e-6),
            (999, 1000, 0.9),
        ] {
            let bound = upper_bound(failures, runs, confidence);
            assert!(binomial_tail_upper_bound(failures, runs, bound) <= 1.0 - confidence);
            assert!(
                binomial_tail_upper_bound(failures, runs, bound * (1.0 - 1e-6)) > 1.0 - confidence,
                "{failures} {runs} {bound}"
            );
        }
        assert!(upper_bound(0, 138_149, 1.0 - 1e-6) <= 1e-4);
        assert!(upper_bound(0, 138_148, 1.0 - 1e-6) > 1e-4);
        assert_eq!(upper_bound(10, 10, 0.99), 1.0);
        let bound = upper_bound(12, 20_000_000, 0.995);
        assert!(
            (bound / 1.207_246_691_693_724e-6 - 1.0).abs() < 1e-7
                && bound > 1.207_246_691_693_724e-6,
            "{bound:e}"
        );
        for (failures, confidence) in [(0, 0.999), (3, 0.99), (2000, 0.9)] {
            let bound = upper_bound(failures, 700_000_000, confidence);
            assert!(binomial_tail_upper_bound(failures, 700_000_000, bound) <= 1.0 - confidence);
            assert!(
                binomial_tail_upper_bound(failures, 700_000_000, bound * (1.0 - 1e-8))
                    > 1.0 - confidence,
                "{failures} {bound}"
            );
        }
        // Closed form: 1 - (1 - γ)^(1/n).
        let (bound, exact) = (
            upper_bound(0, 700_000_000, 0.999),
            -(0.001_f64.ln() / 7e8).exp_m1(),
        );
        assert!(
            bound >= exact && bound < exact * (1.0 + 1e-7),
            "{bound} {exact}"
        );
    }
}
