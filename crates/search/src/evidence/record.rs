//! A count as it is on record: all that decides it but the controllers themselves, and what its blocks come to.

use std::ops::Range;

use crumple_verify::rate::{MOST_BLOCKS, MOST_RUNS, tail_at_most, tail_by_powers};
use crumple_verify::{Certificate, Comparison, Rate, Registration, Statement};
use serde::{Deserialize, Serialize};
use statrs::distribution::{Beta, ContinuousCDF};

use super::CountedBlock;
use crate::worst_case::certificate_about;
use crumple_world::digest::sha256;

/// What was fixed before the first run, and the space as a file: enough for the certificate of what was counted, wherever that was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CountRecord {
    pub(super) registration: Registration,
    /// The space that runs are drawn from, in TOML.
    pub(super) space_text: String,
}

/// What has been counted so far. A run fails if vehicles touch, or if its controller fails.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tally {
    /// Digest of the registration this belongs to.
    pub registration_sha256: String,
    /// Runs made.
    pub runs: u64,
    /// Runs in which the controller failed; of two, both.
    pub failures: u64,
    /// Of two controllers: runs in which only the first failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// The blocks that these runs make, in order.
    pub blocks: Vec<CountedBlock>,
}

impl Tally {
    /// Runs that failed: of two controllers, those in which either did.
    #[must_use]
    pub fn failed(&self) -> u64 {
        self.failures.saturating_add(self.only_first_failed).saturating_add(self.only_second_failed)
    }

    /// Adds the next block, of so many runs.
    pub(super) fn add(&mut self, runs: u64, block: CountedBlock) {
        self.runs += runs;
        self.failures += block.failures;
        self.only_first_failed += block.only_first_failed;
        self.only_second_failed += block.only_second_failed;
        self.blocks.push(block);
    }
}

impl CountRecord {
    /// What is not right with one that was read from a file; nothing if a count may have it.
    pub(super) fn problem(&self) -> Option<&'static str> {
        let Registration { configuration, runs, confidence, block_runs } = &self.registration;
        let is_count = (1..=MOST_RUNS).contains(runs) && *confidence > 0.5 && *confidence < 1.0;
        let has_blocks =
            block_runs.is_some_and(|block_runs| block_runs > 0 && runs.div_ceil(block_runs) <= MOST_BLOCKS);
        let space = configuration.get("space_sha256");
        match () {
            () if !is_count => Some("registration: no number of runs and confidence that a count may have"),
            () if !has_blocks => Some("registration.block_runs: no length of a block that a count may have"),
            () if space != Some(&sha256(&self.space_text)) => Some("space_text: not the space that is registered"),
            () => None,
        }
    }

    /// What was fixed before the first run.
    #[must_use]
    pub fn registration(&self) -> &Registration {
        &self.registration
    }

    /// Whether two controllers are compared.
    #[must_use]
    pub fn is_of_two(&self) -> bool {
        self.registration.configuration.contains_key("against")
    }

    pub(super) fn block_runs(&self) -> u64 {
        self.registration.block_runs.unwrap_or(1).max(1)
    }

    /// How many blocks there are.
    #[must_use]
    pub fn blocks(&self) -> u64 {
        self.registration.runs.div_ceil(self.block_runs())
    }

    /// The runs of blocks that follow each other.
    #[must_use]
    pub fn runs_of(&self, blocks: Range<u64>) -> Range<u64> {
        let at = |block: u64| block.saturating_mul(self.block_runs()).min(self.registration.runs);
        at(blocks.start)..at(blocks.end)
    }

    /// Nothing counted yet.
    #[must_use]
    pub fn tally(&self) -> Tally {
        Tally { registration_sha256: self.registration.digest(), ..Tally::default() }
    }

    /// Whether a tally is of the first of some blocks, adds up, and counts no more runs than there are.
    #[must_use]
    pub(super) fn is_sound(&self, blocks: &Range<u64>, tally: &Tally) -> bool {
        let counted = tally.blocks.len() as u64;
        let runs_of = |block: u64| length(&self.runs_of(block..block.saturating_add(1)));
        let may_be = |(block, counted): (u64, &CountedBlock)| {
            let CountedBlock { failures, only_first_failed: first, only_second_failed: second, sha256 } = counted;
            let is_hash =
                sha256.len() == 64 && sha256.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte));
            let sum = failures.saturating_add(*first).saturating_add(*second);
            is_hash && sum <= runs_of(block) && (self.is_of_two() || first.saturating_add(*second) == 0)
        };
        let sum = |of: fn(&CountedBlock) -> u64| tally.blocks.iter().map(of).fold(0, u64::saturating_add);
        counted <= blocks.end.saturating_sub(blocks.start)
            && tally.registration_sha256 == self.registration.digest()
            && tally.runs == length(&self.runs_of(blocks.start..blocks.start + counted))
            && (blocks.start..).zip(&tally.blocks).all(may_be)
            && sum(|block| block.failures) == tally.failures
            && sum(|block| block.only_first_failed) == tally.only_first_failed
            && sum(|block| block.only_second_failed) == tally.only_second_failed
    }

    /// What a full tally shows. For one controller the lowest rate that is accepted, to nine digits.
    #[must_use]
    pub fn certificate(&self, tally: &Tally) -> Certificate {
        let registration = self.registration.clone();
        let registration_sha256 = registration.digest();
        let statement = if self.is_of_two() {
            Statement::Comparison(Comparison {
                registration,
                registration_sha256,
                only_first_failed: tally.only_first_failed,
                only_second_failed: tally.only_second_failed,
                blocks: tally
                    .blocks
                    .iter()
                    .map(|block| ([block.only_first_failed, block.only_second_failed], block.sha256.clone()))
                    .collect(),
            })
        } else {
            let rate_at_most = self.rate_at_most(tally.failures);
            let blocks = tally.blocks.iter().map(|block| (block.failures, block.sha256.clone())).collect();
            Statement::Rate(Rate { registration, registration_sha256, failures: tally.failures, rate_at_most, blocks })
        };
        let space = self.registration.configuration.get("space").cloned().unwrap_or_default();
        certificate_about(space, Some(self.space_text.clone()), None, statement)
    }

    /// The rate that so many failures of all runs show, at the registered confidence; 1 if they show none.
    #[must_use]
    pub fn rate_at_most(&self, failures: u64) -> f64 {
        upper_bound(failures, self.registration.runs, self.registration.confidence)
    }
}

/// How long a range is.
pub(super) fn length(range: &Range<u64>) -> u64 {
    range.end.saturating_sub(range.start)
}

/// A rate that the checker accepts, little above the bound of Clopper and Pearson; 1 if there is none below.
pub(super) fn upper_bound(failures: u64, runs: u64, confidence: f64) -> f64 {
    let (k, n) = (failures as f64, runs as f64);
    let quantile = if runs > FEW_RUNS {
        bisected(failures, runs, 1.0 - confidence)
    } else {
        Beta::new(k + 1.0, n - k).map_or(1.0, |beta| beta.inverse_cdf(confidence))
    };
    // The quantile is approximate: step up until the outward-rounded tail agrees.
    let candidates = (0..40).map(|doubling| quantile * (1.0 + 1e-10 * f64::from(2_u32.pow(doubling.min(30)))));
    candidates
        .take_while(|rate| *rate > 0.0 && *rate < 1.0)
        .find(|&rate| tail_at_most(failures, runs, rate) <= 1.0 - confidence)
        .unwrap_or(1.0)
}

/// For more runs than this the quantile of statrs has few digits, or does not come back.
const FEW_RUNS: u64 = 10_000_000;

/// The smallest rate, to ten digits, at which that many failures or fewer are as unlikely as `allowed`; 1 if there is none.
fn bisected(failures: u64, runs: u64, allowed: f64) -> f64 {
    let suffices = |rate: f64| tail_by_powers(failures, runs, rate) <= allowed;
    let observed = (failures as f64 + 1.0) / runs as f64;
    let widths = (0..40).map(|doubling| 1e-4 * f64::from(2_u32.pow(doubling.min(30))));
    let above = widths.map(|width| observed * (1.0 + width)).take_while(|rate| *rate < 1.0);
    let (mut low, Some(mut high)) = (0.0, above.into_iter().find(|&rate| suffices(rate))) else { return 1.0 };
    while high - low > 1e-10 * high {
        let middle = low + 0.5 * (high - low);
        if suffices(middle) { high = middle } else { low = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_accepted_and_hardly_above_the_closed_form() {
        for (failures, runs, confidence) in
            [(0, 1000, 0.99), (3, 1000, 0.999), (0, 138_149, 1.0 - 1e-6), (999, 1000, 0.9)]
        {
            let bound = upper_bound(failures, runs, confidence);
            assert!(tail_at_most(failures, runs, bound) <= 1.0 - confidence);
            assert!(tail_at_most(failures, runs, bound * (1.0 - 1e-6)) > 1.0 - confidence, "{failures} {runs} {bound}");
        }
        assert!(upper_bound(0, 138_149, 1.0 - 1e-6) <= 1e-4);
        assert!(upper_bound(0, 138_148, 1.0 - 1e-6) > 1e-4);
        assert_eq!(upper_bound(10, 10, 0.99), 1.0);
        for (failures, confidence) in [(0, 0.999), (3, 0.99), (2000, 0.9)] {
            let bound = upper_bound(failures, 700_000_000, confidence);
            assert!(tail_at_most(failures, 700_000_000, bound) <= 1.0 - confidence);
            assert!(tail_at_most(failures, 700_000_000, bound * (1.0 - 1e-8)) > 1.0 - confidence, "{failures} {bound}");
        }
        // 1 - (1 - γ)^(1/n), within what the tail rounds.
        let (bound, exact) = (upper_bound(0, 700_000_000, 0.999), -(0.001_f64.ln() / 7e8).exp_m1());
        assert!(bound >= exact && bound < exact * (1.0 + 1e-7), "{bound} {exact}");
    }
}
