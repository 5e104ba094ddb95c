//! Merging the shards of a campaign, in any order, perhaps with duplicates and gaps.
//!
//! The order of merging does not matter, so each shard is read, merged and dropped: memory does not grow with the
//! number of evaluations. Each shard has examined its own failures, among them the severest of each kind.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use super::config::Sharding;
use super::findings::CampaignFindings;
use super::resolved_config::ResolvedConfig;
use super::run::{
    CONFIGURATION_FILE, JOURNAL_FILE, MAX_EXAMINED_KINDS, SUMMARY_FILE, SUMMARY_TEXT_FILE, open_run_folder,
};
use super::shard::{ShardFindings, ShardedCampaign};
use super::summary::CampaignSummary;
use super::{CampaignError, FailureCandidate};
use crate::falsify::Method;
use crate::falsify::counterexample::{ExaminedFailure, Recorder};
use crumple_core::digest::sha256;
use crumple_store::run_folder::{CompletedRun, RunFolderError};
use crumple_store::shard::{MergeError, MissingShards, Parts, SHARD_FILE, Sharded, read_shard};

/// Shards of one campaign.
#[derive(Debug)]
pub struct MergedCampaign {
    sharded: ShardedCampaign,
    config: ResolvedConfig,
    /// Evaluations of each method, with the digests of their results.
    parts: Parts<String>,
    findings: CampaignFindings,
    /// Examined failures that may be reported, by method and number of the evaluation.
    examined: BTreeMap<(usize, u64), ExaminedFailure>,
}

impl MergedCampaign {
    /// Creates a merge of one shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn from_shard(folder: &Path, found: &CompletedRun) -> Result<Self, MergeError> {
        let (_, work, _) = read_shard::<ShardedCampaign>(found)?;
        let terms = ResolvedConfig::from_shard_record(work.campaign.clone(), work.nondeterministic)
            .map_err(|problem| found.damaged_error(SHARD_FILE, format!("campaign.{problem}")))?;
        let findings = CampaignFindings::new(&terms);
        let mut merged =
            Self { sharded: work, config: terms, parts: Parts::new(folder), findings, examined: BTreeMap::new() };
        merged.add_shard(folder, found)?;
        Ok(merged)
    }

    /// Adds another shard. After an error nothing has changed.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or belongs to another campaign.
    pub fn add_shard(&mut self, folder: &Path, found: &CompletedRun) -> Result<(), MergeError> {
        let (shard, work, part) = read_shard(found)?;
        if let Some(field) = self.sharded.differing_field(&work) {
            return Err(self.parts.foreign_error(folder, field));
        }
        let ShardFindings { findings, examined, text } = ShardFindings::read(found, &part, &self.config)?;
        let duplicates = self.parts.duplicates();
        self.parts.insert(folder, shard, part, sha256(text))?;
        if self.parts.duplicates() > duplicates {
            return Ok(());
        }
        let methods = self.config.methods();
        self.findings.merge(findings, &methods);
        let place = |method: &Method, number: u64| (methods.iter().position(|known| known == method), number);
        let known = examined.into_iter().filter_map(|one| {
            let (method, number) = place(&one.method, one.number);
            Some(((method?, number), one))
        });
        self.examined.extend(known);
        let picks = self.findings.failures.examination_candidates(usize::MAX);
        let is_picked = |(method, number): &(usize, u64)| {
            picks.iter().any(|pick: &&FailureCandidate| place(&pick.method, pick.number) == (Some(*method), *number))
        };
        self.examined.retain(|key, _| is_picked(key));
        Ok(())
    }

    /// Returns the evaluations of each method that no shard contains, counted from 0.
    #[must_use]
    pub fn missing_ranges(&self) -> Vec<Range<u64>> {
        self.parts.missing_ranges(self.config.record.budget)
    }

    /// Returns the missing shards.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.parts.missing_shards()
    }

    /// Returns the division of the campaign, if it differs from the undivided campaign.
    fn sharding(&self) -> Option<Sharding> {
        let missing = self.missing_ranges();
        let searches = if self.config.record.method.is_non_adaptive() { 1 } else { self.parts.shard_count() };
        let MissingShards { shard_count: of_shards, missing_shards } = self.parts.missing_shards();
        (searches > 1 || !missing.is_empty()).then(|| Sharding {
            searches,
            of_shards: of_shards.filter(|_| !missing.is_empty()),
            missing_shards,
            missing_evaluations: missing.iter().map(|range| [range.start + 1, range.end]).collect(),
        })
    }

    fn merged_findings(&self) -> (ResolvedConfig, CampaignFindings, Vec<ExaminedFailure>) {
        let mut terms = self.config.clone();
        terms.record.sharding = self.sharding();
        let mut findings = self.findings.clone();
        findings.failures.front = findings.failures.front.thin();
        let methods = terms.methods();
        let place =
            |pick: &&FailureCandidate| Some((methods.iter().position(|known| *known == pick.method)?, pick.number));
        let picks = self.findings.failures.examination_candidates(MAX_EXAMINED_KINDS);
        let examined = picks.iter().filter_map(|pick| self.examined.get(&place(pick)?)).cloned().collect();
        let distinct = Recorder { config: &terms }.select_distinct(examined);
        (terms, findings, distinct)
    }

    /// Writes the run folder of the campaign, unless the folder contains it already, and returns its summary.
    ///
    /// Without missing parts, a reference search or a single shard equals the undivided campaign without a log byte for
    /// byte.
    ///
    /// # Errors
    /// [`CampaignError`] if the folder cannot be used, or contains anything else.
    pub fn write_to(&self, folder: &Path) -> Result<CampaignSummary, CampaignError> {
        let (terms, findings, distinct) = self.merged_findings();
        let configuration = terms.record.to_toml()?;
        let work = open_run_folder(folder, &configuration, true)?;
        let summarised = |results: &mut crumple_store::run_folder::FolderTransaction<'_>| {
            let counterexamples = Recorder { config: &terms }.record_all(&distinct, results)?;
            CampaignSummary::from_findings(&terms, &findings, counterexamples, &self.missing_ranges())
        };
        let mut results = work.transaction();
        let summary = summarised(&mut results)?;
        if work.is_complete() {
            return match work.read_required(SUMMARY_FILE)? == summary.to_json()?.into_bytes() {
                true => Ok(summary),
                false => {
                    let problem = "the folder holds a campaign of the same configuration with other results";
                    Err(RunFolderError::damaged(&work.path(SUMMARY_FILE), problem).into())
                }
            };
        }
        results.write(CONFIGURATION_FILE, configuration).write(SUMMARY_TEXT_FILE, summary.to_text());
        // An interrupted run of the same campaign leaves a journal in the folder.
        results.write(SUMMARY_FILE, summary.to_json()?).remove(JOURNAL_FILE).commit()?;
        work.finish()?;
        Ok(summary)
    }

    /// Returns the summary without writing it.
    ///
    /// # Errors
    /// [`CampaignError`] in principle, if a file cannot be encoded.
    pub fn summary(&self) -> Result<CampaignSummary, CampaignError> {
        let (terms, findings, distinct) = self.merged_findings();
        let counterexamples = Recorder { config: &terms }.describe_all(&distinct)?;
        CampaignSummary::from_findings(&terms, &findings, counterexamples, &self.missing_ranges())
    }
}

#[cfg(test)]
#[path = "merge_tests.rs"]
mod tests;
