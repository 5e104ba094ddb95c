//! A shard of a campaign: a part of the budget of every method.
//!
//! Shard I of N makes the I-th of N parts of the evaluations of each method. The reference searches do not depend on
//! values, so their parts are those of the undivided campaign. The requested method starts a new search in every shard,
//! with a seed from the campaign's seed and the number of earlier evaluations.
//!
//! A run folder contains `shard.json`, the configuration, and `findings.json`, the results with replayed, shrunk and
//! classified failures. Evaluations are not recorded, except in the journal while the shard runs.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::config::CampaignRecord;
use super::failures::{FailureGroup, Failures};
use super::findings::{CampaignFindings, MethodResults};
use super::front::ParetoFront;
use super::journal::Journal;
use super::resolved_config::ResolvedConfig;
use super::run::{CampaignProgress, CampaignRun, JOURNAL_FILE};
use super::{Campaign, CampaignError, EvaluationLog, FailureCandidate, FailureKind};
use crate::falsify::Method;
use crate::falsify::counterexample::{ExaminedFailure, ExaminedFailureRecord, Examiner};
use crumple_core::observer::Observer;
use crumple_store::run_folder::{CompletedRun, RunFolderError};
use crumple_store::shard::{ShardId, Sharded, open_shard};

/// Kind of a shard's run folder in its `work.json`.
pub const CAMPAIGN_SHARD_KIND: &str = "shard of a campaign";

const FINDINGS_FILE: &str = ShardedCampaign::RESULTS_FILE;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ShardedCampaign {
    pub(super) nondeterministic: bool,
    pub(super) campaign: CampaignRecord,
}

impl Sharded for ShardedCampaign {
    const KIND: &'static str = CAMPAIGN_SHARD_KIND;
    const VERSION: u32 = 1;
    const RESULTS_FILE: &'static str = "findings.json";
    const PARTS_NAME: &'static str = "evaluations of each method";

    fn part_count(&self) -> u64 {
        self.campaign.budget
    }

    fn differing_field(&self, other: &Self) -> Option<String> {
        if self == other {
            return None;
        }
        let [own, other] = [self, other].map(|one| serde_json::to_value(&one.campaign).unwrap_or_default());
        let differs = |key: &&String| own.get(key) != other.get(key);
        let keys = own.as_object().into_iter().chain(other.as_object()).flat_map(serde_json::Map::keys);
        let key = keys.into_iter().find(differs).map(|key| format!("campaign.{key}"));
        Some(key.unwrap_or_else(|| "nondeterministic".to_owned()))
    }
}

/// The file `findings.json`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FindingsFile {
    methods: Vec<MethodResults>,
    kinds: Vec<FailureGroupRecord>,
    front: Vec<FailureCandidate>,
    examined: Vec<ExaminedFailureRecord>,
    /// Examined failures that did not fail again, as happens at robustness within rounding of zero.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    not_reproduced: Vec<(Method, u64)>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FailureGroupRecord {
    by_method: Vec<(Method, u64, u64)>,
    first: FailureCandidate,
    severest: FailureCandidate,
    likeliest: FailureCandidate,
}

/// Results of a shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ShardSummary {
    /// Evaluations of all methods.
    pub evaluations: u64,
    /// Number of failing evaluations.
    pub failures: u64,
    /// Number of failure kinds.
    pub kinds: usize,
}

impl Campaign {
    /// Runs a shard of the campaign in `folder`. With `resume`, continues an interrupted shard.
    ///
    /// # Errors
    /// [`CampaignError`] if there are too few evaluations, the controller has no identity, the folder cannot be used, a
    /// scenario cannot be simulated, or `observer` stops the shard.
    pub fn run_shard(
        &self,
        shard: ShardId,
        folder: &Path,
        resume: bool,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<ShardSummary, CampaignError> {
        let part = shard.range(self.budget, ShardedCampaign::PARTS_NAME)?;
        if let Some(unknown) = self.controllers().find(|driver| driver.kind.identity().is_none()) {
            return Err(CampaignError::NoIdentityInShards(unknown.name.clone()));
        }
        if let Method::Custom(_) = self.method {
            return Err(CampaignError::CustomMethodInShards(self.method.name().to_owned()));
        }
        let terms = ResolvedConfig::from_campaign(self, EvaluationLog::Summary)?;
        self.check(&terms.nominal)?;
        let (nondeterministic, campaign) = (terms.nondeterministic, terms.record.clone());
        let work = open_shard(&ShardedCampaign { nondeterministic, campaign }, shard, folder, resume)?;
        if work.is_complete() {
            let read = serde_json::from_slice(&work.read_required(FINDINGS_FILE)?);
            return Ok(FindingsFile::summary(&read.map_err(CampaignError::from_encoding_error)?));
        }
        work.transaction().append_only(JOURNAL_FILE).commit()?;
        let journal = Journal::open_in_folder(&work, JOURNAL_FILE, resume)?;
        let findings = CampaignFindings::new(&terms);
        let mut searching = CampaignRun {
            campaign: self,
            config: &terms,
            run_folder: &work,
            journal,
            table: None,
            findings,
            evaluation_range: part,
        };
        searching.search_all(observer)?;
        searching.find_unanswered_reasons()?;
        observer.notify(&searching.progress(None))?;
        let (findings, examiner) = (&searching.findings, Examiner::new(self, &terms));
        // Examine all kinds: the most frequent ones of the whole campaign are unknown here.
        let mut examined = examiner.examine_all(&findings.failures.examination_candidates(usize::MAX))?;
        examiner.classify_all(&mut examined);
        self.ensure_all_trusted()?;
        observer.notify(&searching.progress(None))?;
        let file = FindingsFile::from_findings(findings, &examined)?;
        work.transaction().write(FINDINGS_FILE, to_json(&file)?).remove(JOURNAL_FILE).commit()?;
        work.finish()?;
        Ok(file.summary())
    }
}

impl FindingsFile {
    fn from_findings(findings: &CampaignFindings, examined: &[ExaminedFailure]) -> Result<Self, CampaignError> {
        let row = |kind: &FailureGroup| FailureGroupRecord {
            by_method: kind.by_method.clone(),
            first: kind.first.clone(),
            severest: kind.severest.clone(),
            likeliest: kind.likeliest.clone(),
        };
        let is_examined = |pick: &&&FailureCandidate| {
            examined.iter().any(|one| (&one.method, one.number) == (&pick.method, pick.number))
        };
        let picks = findings.failures.examination_candidates(usize::MAX);
        let not_reproduced =
            picks.iter().filter(|pick| !is_examined(pick)).map(|pick| (pick.method.clone(), pick.number));
        Ok(Self {
            methods: findings.method_results.clone(),
            kinds: findings.failures.groups.iter().map(row).collect(),
            front: findings.failures.front.failures().to_vec(),
            examined: examined.iter().map(ExaminedFailureRecord::from_examined).collect::<Result<_, _>>()?,
            not_reproduced: not_reproduced.collect(),
        })
    }

    fn summary(&self) -> ShardSummary {
        let sum = |of: fn(&MethodResults) -> u64| self.methods.iter().map(of).fold(0, u64::saturating_add);
        ShardSummary {
            evaluations: sum(|reached| reached.evaluations),
            failures: sum(|reached| reached.failures),
            kinds: self.kinds.len(),
        }
    }

    /// Returns the findings, or an error if no evaluations of that part can have them.
    fn into_findings(
        self,
        terms: &ResolvedConfig,
        part: &Range<u64>,
    ) -> Result<(CampaignFindings, Vec<ExaminedFailure>), String> {
        let methods = terms.methods();
        let dimension = terms.space.dimension();
        let is_sound = self.methods.iter().map(|reached| &reached.method).eq(&methods)
            && self.methods.iter().all(|reached| reached.is_consistent_with(part, dimension));
        if !is_sound {
            return Err("methods: inconsistent with this part of the budget".to_owned());
        }
        let mut failures = Failures::new(terms.specification.clone());
        for row in self.kinds {
            let kind = row.into_group(terms, &methods, part)?;
            if failures.groups.iter().any(|known| known.kind == kind.kind) {
                return Err("kinds: a kind is listed twice".to_owned());
            }
            failures.groups.push(kind);
        }
        // Every failure has one kind, and the severest of all is the severest of its kind.
        for MethodResults { method, first, failures: failed, .. } in &self.methods {
            let by_method = || failures.groups.iter().flat_map(|kind| &kind.by_method).filter(|(by, ..)| by == method);
            let counted = by_method().map(|(_, count, _)| *count).fold(0, u64::saturating_add);
            if counted != *failed || by_method().map(|(.., first)| *first).min() != *first {
                return Err(format!("kinds: differ from the failures that {method} found"));
            }
        }
        let best = self.methods.iter().map(|reached| reached.best).fold(f64::INFINITY, f64::min);
        let severest =
            failures.groups.iter().map(|kind| kind.severest.verdict.robustness).fold(f64::INFINITY, f64::min);
        if !failures.groups.is_empty() && best != severest {
            return Err("kinds: the severest failure is missing".to_owned());
        }
        let is_failure = |found: &FailureCandidate| {
            let kind = found.checked_kind(terms, &methods, part);
            kind.is_some_and(|kind| failures.groups.iter().any(|known| known.kind == kind))
        };
        if self.front.is_empty() != failures.groups.is_empty() || !self.front.iter().all(is_failure) {
            return Err("front: contains failures of another campaign".to_owned());
        }
        failures.front = ParetoFront::from_failures(self.front);
        let picks = failures.examination_candidates(usize::MAX);
        let looked_at =
            self.examined.iter().map(ExaminedFailureRecord::evaluation_id).chain(self.not_reproduced.iter().cloned());
        let mut looked_at: Vec<(Method, u64)> = looked_at.collect();
        let mut wanted: Vec<(Method, u64)> = picks.iter().map(|pick| (pick.method.clone(), pick.number)).collect();
        let order = |(method, number): &(Method, u64)| (methods.iter().position(|known| known == method), *number);
        looked_at.sort_by_key(order);
        wanted.sort_by_key(order);
        if looked_at != wanted {
            return Err("examined: differ from the failures that crumple examines".to_owned());
        }
        let examined = self.examined.into_iter().map(|row| row.into_examined(terms)).collect::<Result<_, _>>()?;
        Ok((CampaignFindings { method_results: self.methods, failures }, examined))
    }
}

impl FailureGroupRecord {
    fn into_group(self, terms: &ResolvedConfig, methods: &[Method], part: &Range<u64>) -> Result<FailureGroup, String> {
        let Self { by_method, first, severest, likeliest } = self;
        let [kind, others @ ..] = [&first, &severest, &likeliest].map(|found| found.checked_kind(terms, methods, part));
        let Some(kind) = kind.filter(|kind| others.iter().all(|other| other == &Some(*kind))) else {
            return Err("kinds: contain failures of another campaign".to_owned());
        };
        let order = |method: &Method| methods.iter().position(|known| known == method);
        let is_made = |(_, count, first): &(Method, u64, u64)| {
            part.contains(&first.wrapping_sub(1)) && (1..=part.end - part.start).contains(count)
        };
        let is_known = |(method, ..): &(Method, u64, u64)| methods.contains(method);
        let is_counted =
            by_method.first().is_some_and(|(by, _, number)| (by, *number) == (&first.method, first.number))
                && by_method.iter().all(|by| is_known(by) && is_made(by))
                && by_method.is_sorted_by(|(one, ..), (other, ..)| order(one) < order(other));
        let is_severest =
            [&first, &likeliest].iter().all(|found| found.verdict.robustness >= severest.verdict.robustness);
        match is_counted && is_severest {
            true => Ok(FailureGroup { kind, by_method, first, severest, likeliest }),
            false => Err("kinds: counts are inconsistent with this part of the budget".to_owned()),
        }
    }
}

impl FailureCandidate {
    /// Returns the kind of the failure, if these evaluations can have it.
    fn checked_kind(&self, terms: &ResolvedConfig, methods: &[Method], part: &Range<u64>) -> Option<FailureKind> {
        let is_made = methods.contains(&self.method)
            && part.contains(&self.number.wrapping_sub(1))
            && terms.space.contains(&self.values)
            // Allows for rounding.
            && (0.0..=1.0 + 1e-9).contains(&self.distance_from_nominal)
            && !self.ln_likelihood.is_nan();
        FailureKind::from_verdict(&self.verdict, &terms.specification).filter(|_| is_made)
    }
}

pub(super) struct ShardFindings {
    pub(super) findings: CampaignFindings,
    pub(super) examined: Vec<ExaminedFailure>,
    pub(super) text: String,
}

impl ShardFindings {
    /// Reads the findings of the evaluations `part`.
    ///
    /// # Errors
    /// [`RunFolderError`] if the file is not as it was written, or no such part can have these findings.
    pub(super) fn read(
        found: &CompletedRun,
        part: &Range<u64>,
        terms: &ResolvedConfig,
    ) -> Result<Self, RunFolderError> {
        let text = found.read(FINDINGS_FILE)?;
        let file: FindingsFile =
            serde_json::from_str(&text).map_err(|error| found.unreadable_error(FINDINGS_FILE, &error))?;
        let (findings, examined) =
            file.into_findings(terms, part).map_err(|problem| found.damaged_error(FINDINGS_FILE, problem))?;
        Ok(Self { findings, examined, text })
    }
}

fn to_json(value: &impl Serialize) -> Result<String, CampaignError> {
    Ok(serde_json::to_string(value).map_err(CampaignError::from_encoding_error)? + "\n")
}
