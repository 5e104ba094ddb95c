//! Read-only view of a running or finished campaign. Takes no lock and writes nothing.
//!
//! While the campaign runs, verdicts come from the journal, and points from the search, which is run again with these
//! values. A complete campaign has both in its tables, which are checked by their hashes.

use std::path::{Path, PathBuf};

use super::config::CampaignRecord;
use super::failures::Failures;
use super::resolved_config::ResolvedConfig;
use super::run::{CAMPAIGN_KIND, CONFIGURATION_FILE, JOURNAL_FILE, SUMMARY_FILE};
use super::{CampaignError, CampaignSummary, EvaluatedPoint, FailureKind, FrontPoint, journal, table};
use crate::falsify::{Method, SearchAlgorithm};
use crumple_store::disk;
use crumple_store::run_folder::{self, CompletedRun, RunFolderError, RunState};
use crumple_world::measure::{RunVerdict, Specification};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::space::ScenarioSpace;
use crumple_world::scenario::{Scenario, file};
use crumple_world::sim::NamedController;

/// Maximum number of evaluations that are read, the first ones. Each takes about 400 bytes.
pub const MAX_READ_EVALUATIONS: usize = 200_000;

const MAX_CONFIGURATION_BYTES: u64 = file::MAX_BYTES;

/// A view of the campaign in a folder.
#[derive(Debug)]
pub struct CampaignReader {
    folder: PathBuf,
    config: ResolvedConfig,
    evaluations: Vec<(Method, EvaluatedPoint)>,
    failures: Failures,
    stage: ReaderStage,
}

#[derive(Debug)]
enum ReaderStage {
    Running(JournalTail),
    Finished { finished: CompletedRun, summary: Box<CampaignSummary>, parts: Vec<String> },
}

/// State of the search that is run again.
#[derive(Debug, Default)]
struct JournalTail {
    identity: String,
    method: usize,
    search: Option<Box<dyn SearchAlgorithm>>,
    evaluation_count: u64,
    pending_points: Vec<Vec<f64>>,
    pending_costs: Vec<f64>,
}

impl CampaignReader {
    /// Opens the campaign in a folder. [`Self::poll`] reads evaluations.
    ///
    /// # Errors
    /// [`CampaignError`] if there is none, it is damaged, or another build of crumple runs it.
    pub fn open(folder: &Path) -> Result<Self, CampaignError> {
        let damaged = |name: &str, problem: String| RunFolderError::damaged(&folder.join(name), problem);
        let other_kind = |found: String| RunFolderError::OtherKind {
            path: folder.join(run_folder::MANIFEST_FILE),
            found,
            kind: CAMPAIGN_KIND.to_owned(),
        };
        let (text, stage) = match run_folder::read_state(folder)? {
            RunState::Missing => {
                return Err(CampaignError::Folder(format!("{}: the folder holds no campaign", folder.display())));
            }
            RunState::InProgress(kind) if kind == CAMPAIGN_KIND => {
                let path = folder.join(CONFIGURATION_FILE);
                let bytes =
                    disk::read(&path, MAX_CONFIGURATION_BYTES)?.ok_or_else(|| RunFolderError::missing(&path))?;
                let text = String::from_utf8(bytes).map_err(|error| damaged(CONFIGURATION_FILE, error.to_string()))?;
                let identity = run_folder::identity(CAMPAIGN_KIND, &text)?;
                (text, ReaderStage::Running(JournalTail { identity, ..JournalTail::default() }))
            }
            RunState::Complete(finished) if finished.kind() == CAMPAIGN_KIND => {
                let text = finished.read_configuration(CONFIGURATION_FILE)?;
                let summary = Box::new(CampaignSummary::from_json(&finished.read(SUMMARY_FILE)?)?);
                let mut parts: Vec<String> =
                    finished.file_names().into_iter().filter(|name| name.starts_with("evaluations/")).collect();
                parts.sort_unstable_by(|one, other| other.cmp(one));
                (text, ReaderStage::Finished { finished, summary, parts })
            }
            RunState::InProgress(kind) => return Err(other_kind(kind).into()),
            RunState::Complete(finished) => return Err(other_kind(finished.kind().to_owned()).into()),
        };
        let record: CampaignRecord =
            toml::from_str(&text).map_err(|error| damaged(CONFIGURATION_FILE, error.message().to_owned()))?;
        let terms =
            ResolvedConfig::from_record(record, false).map_err(|problem| damaged(CONFIGURATION_FILE, problem))?;
        let failures = Failures::new(terms.specification.clone());
        Ok(Self { folder: folder.to_owned(), config: terms, evaluations: Vec::new(), failures, stage })
    }

    /// Reads at most `most` further evaluations, or one table. Returns true if more may be available.
    ///
    /// # Errors
    /// [`CampaignError`] if the data are damaged, or belong to another campaign.
    pub fn poll(&mut self, most: usize) -> Result<bool, CampaignError> {
        let most = most.min(MAX_READ_EVALUATIONS.saturating_sub(self.evaluations.len()));
        match &mut self.stage {
            ReaderStage::Finished { finished, parts, .. } => {
                let Some(name) = parts.last() else { return Ok(false) };
                // Keep a damaged table as the next one, so that every later call reports the damage, too.
                let rows = table::decode_part(name, &finished.read_bytes(name)?, &self.config)?;
                parts.pop();
                let left = MAX_READ_EVALUATIONS.saturating_sub(self.evaluations.len());
                for (method, evaluated) in rows.into_iter().take(left) {
                    self.failures.add(&method, &evaluated);
                    self.evaluations.push((method, evaluated));
                }
                if self.evaluations.len() >= MAX_READ_EVALUATIONS {
                    parts.clear();
                }
                Ok(!parts.is_empty())
            }
            ReaderStage::Running(_) if !matches!(run_folder::read_state(&self.folder)?, RunState::InProgress(_)) => {
                // The campaign is complete, and its tables contain all evaluations.
                let now = Self::open(&self.folder)?;
                if now.config.record != self.config.record {
                    return Err(CampaignError::Folder(format!(
                        "{}: the folder holds another campaign now",
                        self.folder.display()
                    )));
                }
                *self = now;
                Ok(true)
            }
            ReaderStage::Running(following) => {
                let known = self.evaluations.len();
                let verdicts = journal::read_verdicts_after(
                    &self.folder.join(JOURNAL_FILE),
                    &following.identity,
                    known as u64,
                    most,
                )?;
                // The journal does not exist yet, or has just been removed.
                let Some(verdicts) = verdicts else { return Ok(false) };
                let is_more = most > 0 && verdicts.len() == most;
                for verdict in verdicts {
                    let Some((method, evaluated)) = following.next_evaluation(&self.config, verdict) else {
                        return Ok(false);
                    };
                    self.failures.add(&method, &evaluated);
                    self.evaluations.push((method, evaluated));
                }
                Ok(is_more)
            }
        }
    }

    /// Returns the evaluations read so far, in the order in which they were made.
    #[must_use]
    pub fn evaluations(&self) -> &[(Method, EvaluatedPoint)] {
        &self.evaluations
    }

    /// Returns the name of the controller under test.
    #[must_use]
    pub fn controller(&self) -> &str {
        &self.config.record.controller
    }

    /// Returns true if a controller is the recorded one: by its name and, where the record states one, its identity.
    #[must_use]
    pub fn is_for_controller(&self, controller: &NamedController) -> bool {
        let record = &self.config.record;
        controller.name == record.controller
            && controller.policy().map(|policy| policy.digest()) == record.policy_sha256
            && controller.disambiguating_hash() == record.controller_sha256
    }

    /// Returns the estimator of the vehicles under test.
    #[must_use]
    pub fn estimator(&self) -> EstimatorKind {
        self.config.record.estimator
    }

    /// Returns the scenario space.
    #[must_use]
    pub fn space(&self) -> &ScenarioSpace {
        &self.config.space
    }

    /// Returns the specification.
    #[must_use]
    pub fn specification(&self) -> &Specification {
        &self.config.specification
    }

    /// Returns the methods in the order in which they run.
    #[must_use]
    pub fn methods(&self) -> Vec<Method> {
        self.config.methods()
    }

    /// Returns the number of evaluations of all methods in the complete campaign.
    #[must_use]
    pub fn total_evaluations(&self) -> u64 {
        self.config.record.budget.saturating_mul(self.methods().len() as u64)
    }

    /// Returns the summary; `None` while the campaign runs.
    #[must_use]
    pub fn summary(&self) -> Option<&CampaignSummary> {
        match &self.stage {
            ReaderStage::Finished { summary, .. } => Some(summary),
            ReaderStage::Running(_) => None,
        }
    }

    /// Returns the Pareto front of severity and likelihood over the evaluations read so far, or all of a complete
    /// campaign.
    #[must_use]
    pub fn front(&self) -> Vec<FrontPoint> {
        match &self.stage {
            ReaderStage::Finished { summary, .. } => summary.front.clone(),
            ReaderStage::Running(_) => self.failures.front.points(&self.config.specification, &self.config.nominal),
        }
    }

    /// Describes the failure of an evaluation; `None` if it did not fail.
    #[must_use]
    pub fn describe_failure(&self, evaluated: &EvaluatedPoint) -> Option<String> {
        let verdict = &evaluated.verdict;
        // A table does not state which controller failed.
        if verdict.robustness == f64::NEG_INFINITY && verdict.contact.is_none() && verdict.failure.is_none() {
            return Some("a controller fails".to_owned());
        }
        FailureKind::from_verdict(verdict, &self.config.specification).map(|kind| kind.describe(&self.config.nominal))
    }

    /// Returns the scenario of these values, with the campaign's noise.
    ///
    /// # Errors
    /// [`CampaignError::Scenario`] for values outside the space.
    pub fn scenario(&self, values: &[f64]) -> Result<Scenario, CampaignError> {
        Ok(self.config.space.scenario(values)?)
    }

    /// Reads the file of a distinct failure, by its index in the summary; `None` if there is no such failure.
    ///
    /// # Errors
    /// [`CampaignError`] if it is not as it was written.
    pub fn counterexample(&self, place: usize) -> Result<Option<Scenario>, CampaignError> {
        let ReaderStage::Finished { finished, summary, .. } = &self.stage else { return Ok(None) };
        let Some(found) = summary.counterexamples.get(place) else { return Ok(None) };
        let text = finished.read(&found.file)?;
        let scenario = file::from_toml(&text, &self.folder.join(&found.file));
        Ok(Some(scenario.map_err(|error| CampaignError::Encoding(error.to_string()))?))
    }
}

impl JournalTail {
    /// Returns the evaluation of the next verdict, from the search that receives all verdicts; `None` beyond the last.
    fn next_evaluation(&mut self, terms: &ResolvedConfig, verdict: RunVerdict) -> Option<(Method, EvaluatedPoint)> {
        let methods = terms.methods();
        let (seed, budget) = (terms.record.seed, terms.record.budget);
        if self.evaluation_count == budget {
            (self.method, self.evaluation_count, self.search) = (self.method + 1, 0, None);
            self.pending_points.clear();
            self.pending_costs.clear();
        }
        let method = methods.get(self.method)?.clone();
        let search = self.search.get_or_insert_with(|| method.start(&terms.cube, seed));
        if self.pending_costs.len() == self.pending_points.len() {
            if !self.pending_points.is_empty() {
                search.tell(&self.pending_costs);
            }
            self.pending_costs.clear();
            self.pending_points = search.ask();
            self.pending_points.truncate(usize::try_from(budget - self.evaluation_count).unwrap_or(usize::MAX));
        }
        let point = self.pending_points.get(self.pending_costs.len())?.clone();
        self.evaluation_count += 1;
        let evaluated = terms.evaluated_point(self.evaluation_count, point, verdict);
        self.pending_costs.push(terms.record.objective.cost(&evaluated));
        Some((method, evaluated))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress, SearchObjective};
    use crumple_core::observer::{Listener, Quiet};
    use std::fs;
    use std::sync::Mutex;

    fn read_all(look: &mut CampaignReader) {
        while look.poll(37).unwrap() {}
    }

    /// A view of a running campaign equals the beginning of the complete one, bit for bit.
    #[test]
    fn a_campaign_looks_the_same_while_it_runs_and_afterwards() {
        for (method, aim, space) in [
            (Method::Auto, SearchObjective::Likeliest, "high-risk"),
            (Method::CmaEs, SearchObjective::Severest, "high-risk"),
            (Method::Uniform, SearchObjective::Severest, "paper"),
        ] {
            let campaign = Campaign { objective: aim, ..Campaign::of_match_leader(space, method, 300, 7) };
            let parent = tempfile::tempdir().unwrap();
            let folder = parent.path().join("campaign");
            assert!(CampaignReader::open(&folder).is_err());
            // The early reader, its observations, and the number of progress reports.
            let state = Mutex::new((None::<CampaignReader>, Vec::new(), 0));
            let observer = Listener(|progress: &CampaignProgress| {
                let (early, seen, reports) = &mut *state.lock().unwrap();
                *reports += 1;
                // Poll occasionally, also starting in the middle.
                if *reports % 5 == 2 {
                    let look = early.get_or_insert_with(|| CampaignReader::open(&folder).unwrap());
                    read_all(look);
                    seen.push((progress.evaluations, look.evaluations().len() as u64));
                    let mut fresh = CampaignReader::open(&folder).unwrap();
                    read_all(&mut fresh);
                    assert_eq!(fresh.evaluations(), look.evaluations());
                }
            });
            let summary = campaign.run(&folder, CampaignOptions::default(), &observer).unwrap();
            let (early, seen, _) = state.into_inner().unwrap();
            assert!(seen.iter().any(|(_, seen)| *seen > 100), "{seen:?}");
            assert!(seen.iter().all(|(made, seen)| seen >= made), "{seen:?}");
            let while_running = early.as_ref().unwrap().evaluations().to_vec();
            let mut finished = CampaignReader::open(&folder).unwrap();
            read_all(&mut finished);
            assert_eq!(finished.evaluations().len() as u64, finished.total_evaluations());
            // Tables contain values; all points in the share of a choice have the same value.
            let seen = |(method, one): &(Method, EvaluatedPoint)| {
                (method.clone(), one.number, one.values.clone(), one.verdict)
            };
            let same = finished.evaluations()[..while_running.len()].iter().map(seen);
            assert!(same.eq(while_running.iter().map(seen)));
            assert_eq!((finished.summary(), finished.front()), (Some(&summary), summary.front.clone()));
            let mut early = early.unwrap();
            read_all(&mut early);
            assert!(early.evaluations().iter().map(seen).eq(finished.evaluations().iter().map(seen)));
            for (place, found) in summary.counterexamples.iter().enumerate() {
                assert_eq!(
                    early.counterexample(place).unwrap().unwrap(),
                    file::load(&folder.join(&found.file)).unwrap()
                );
            }
            assert!(early.counterexample(summary.counterexamples.len()).unwrap().is_none());
        }
    }
    /// Every later request reports the damage, too, until the table is restored.
    #[test]
    fn damage_stays_visible_as_long_as_it_is_there() {
        let campaign = Campaign::of_match_leader("high-risk", Method::Uniform, 40, 7);
        let folder = tempfile::tempdir().unwrap();
        campaign.run(folder.path(), CampaignOptions::default(), &Quiet).unwrap();
        let table = fs::read_dir(folder.path().join("evaluations")).unwrap().next().unwrap().unwrap().path();
        let whole = fs::read(&table).unwrap();
        let mut damaged = whole.clone();
        damaged[whole.len() / 2] ^= 1;
        fs::write(&table, damaged).unwrap();
        let mut look = CampaignReader::open(folder.path()).unwrap();
        for _ in 0..3 {
            let error = look.poll(1000).unwrap_err().to_string();
            assert!(error.ends_with("has changed since it was written"), "{error}");
        }
        fs::write(&table, whole).unwrap();
        read_all(&mut look);
        assert_eq!(look.evaluations().len() as u64, look.total_evaluations());
    }
}
