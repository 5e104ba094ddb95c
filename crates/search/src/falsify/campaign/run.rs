//! Running a campaign, from its first evaluation to its summary.

use std::path::Path;

use super::config::CampaignRecord;
use super::findings::{CampaignFindings, MethodResults};
use super::journal::Journal;
use super::resolved_config::ResolvedConfig;
use super::summary::CampaignSummary;
use super::table::EvaluationTable;
use super::{Campaign, CampaignError, EvaluationLog, MAX_BUDGET, MAX_SEED};
use crate::falsify::counterexample::{ExaminedFailure, Examiner, Recorder};
use crate::falsify::{Method, SearchAlgorithm};
use crumple_core::observer::Observer;
use crumple_measure::RunVerdict;
use crumple_sim::engine::NamedController;
use crumple_sim::scenario::Scenario;
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::{FolderExamination, FolderTransaction, RunFolder, RunFolderError};
use crumple_store::study::{Study, StudyStep};

/// Batches of a non-adaptive method that are evaluated together: enough to use the simulator on all cores.
const BLIND_BATCHES: usize = 16;
/// Maximum number of failure kinds that are examined: the most frequent ones.
pub(super) const MAX_EXAMINED_KINDS: usize = 12;

/// Progress of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct CampaignProgress {
    /// Current method; `None` after the search.
    pub method: Option<Method>,
    /// Current step of the examination of counterexamples; `None` during the search and after the examination.
    pub examination: Option<ExaminationStep>,
    /// Evaluations done, of all methods.
    pub evaluations: u64,
    /// Evaluations of the complete campaign.
    pub total: u64,
    /// Number of failing evaluations.
    pub failures: u64,
    /// Smallest robustness so far.
    pub best_robustness: f64,
}

/// A step of the examination of counterexamples, which follows the search. Its duration is not known beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ExaminationStep {
    /// Replays failures and shrinks their scenarios.
    Shrinking,
    /// Searches for escapes.
    Classifying,
    /// Replays failures and escapes with another plant.
    Confirming,
}

impl ExaminationStep {
    /// Describes the step, in lower case.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::Shrinking => "replaying and shrinking failures",
            Self::Classifying => "deciding which failures were avoidable",
            Self::Confirming => "replaying failures with the multi-body plant",
        }
    }
}

/// Search of a campaign so far.
pub struct CampaignState {
    config: ResolvedConfig,
    journal: Journal,
    table: Option<EvaluationTable>,
    findings: CampaignFindings,
    /// Search of the current method; none between two methods.
    current: Option<MethodSearch>,
}

struct MethodSearch {
    algorithm: Box<dyn SearchAlgorithm>,
    results: MethodResults,
}

impl Study for Campaign {
    const KIND: &'static str = "campaign";
    const CONFIGURATION_FILE: &'static str = CONFIGURATION_FILE;
    const OUTPUTS: &'static [&'static str] = &[
        CONFIGURATION_FILE,
        JOURNAL_FILE,
        SUMMARY_FILE,
        SUMMARY_TEXT_FILE,
        "counterexamples/",
        "counterexamples/originals/",
        "counterexamples/escapes/",
        "evaluations/",
    ];

    type State = CampaignState;
    type Progress = CampaignProgress;
    type Report = CampaignSummary;
    type Error = CampaignError;

    fn check(&self) -> Result<(), CampaignError> {
        self.check_at(&ResolvedConfig::from_campaign(self)?.nominal)
    }

    fn configuration(&self) -> Result<String, CampaignError> {
        self.to_toml()
    }

    /// Records are compared, because 0.3.0 has another name for a specification.
    fn is_configured_by(&self, existing: &str) -> bool {
        let requested = CampaignRecord::from_campaign(self);
        let existing: Result<CampaignRecord, _> = toml::from_str(existing);
        match (requested, existing) {
            (Ok(requested), Ok(existing)) => requested.has_results_of(existing),
            _ => false,
        }
    }

    fn unidentified_controller(&self) -> Option<&str> {
        self.controllers()
            .find(|controller| controller.source.identity().is_none())
            .map(|controller| controller.name.as_str())
    }

    fn load(&self, folder: &RunFolder) -> Result<CampaignState, CampaignError> {
        folder.transaction().append_only(JOURNAL_FILE).commit()?;
        let config = ResolvedConfig::from_campaign(self)?;
        let path = folder.path(JOURNAL_FILE);
        Ok(CampaignState {
            journal: Journal::resume(&path, &folder.identity())?,
            table: (self.search.log == EvaluationLog::Full).then(EvaluationTable::default),
            findings: CampaignFindings::new(&config),
            current: None,
            config,
        })
    }

    /// Evaluates the next points of the current method.
    fn step(
        &self,
        state: &mut CampaignState,
        folder: &RunFolder,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<StudyStep, CampaignError> {
        let Some(mut current) = state.current.take().or_else(|| self.next_method(state)) else {
            return Ok(StudyStep::Done);
        };
        let points = self.next_points(&mut current, &state.config)?;
        let verdicts = self.evaluate_or_read(state, &points)?;
        // If the observer stops the campaign, this batch is dropped: some of its simulations may have ended early.
        observer.notify(&self.progress(&state.findings, Some(&current.results)))?;
        if let Some(prefix) = state.journal.append(verdicts.unlogged())? {
            folder.record_prefix(JOURNAL_FILE, prefix)?;
        }
        let costs = self.add_all(state, &mut current.results, points, verdicts, folder)?;
        current.algorithm.tell(&costs);
        observer.notify(&self.progress(&state.findings, Some(&current.results)))?;
        if current.results.evaluations < self.search.budget {
            state.current = Some(current);
        } else {
            state.findings.method_results.push(current.results);
        }
        Ok(StudyStep::Continue)
    }

    fn finish(
        &self,
        mut state: CampaignState,
        _: &RunFolder,
        results: &mut FolderTransaction<'_>,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<CampaignSummary, CampaignError> {
        self.find_unanswered_reasons(&mut state)?;
        let CampaignState {
            config,
            table,
            findings,
            ..
        } = &state;
        if let Some(table) = table {
            table.finish(&config.space, results)?;
        }
        let distinct = self.examine(config, findings, observer)?;
        let counterexamples = Recorder { config }.record_all(&distinct, results)?;
        let summary = CampaignSummary::from_findings(self, config, findings, counterexamples)?;
        observer.notify(&self.progress(findings, None))?;
        results
            .write(SUMMARY_TEXT_FILE, summary.to_text())
            .write(SUMMARY_FILE, summary.to_json()?)
            .remove(JOURNAL_FILE);
        Ok(summary)
    }

    fn read(
        &self,
        folder: &RunFolder,
        _: &dyn Observer<CampaignProgress>,
    ) -> Result<CampaignSummary, CampaignError> {
        Ok(folder.read_required_json(SUMMARY_FILE)?)
    }
}

/// Verdicts of a batch: those that the journal had, and then new ones.
struct BatchVerdicts {
    verdicts: Vec<RunVerdict>,
    logged: usize,
}

impl BatchVerdicts {
    fn unlogged(&self) -> &[RunVerdict] {
        self.verdicts.get(self.logged..).unwrap_or_default()
    }
}

impl Campaign {
    fn next_method(&self, state: &CampaignState) -> Option<MethodSearch> {
        let method = self
            .methods()
            .into_iter()
            .nth(state.findings.method_results.len())?;
        Some(MethodSearch {
            algorithm: method.start(&state.config.cube, self.seed),
            results: MethodResults::new(method),
        })
    }

    fn next_points(
        &self,
        current: &mut MethodSearch,
        config: &ResolvedConfig,
    ) -> Result<Vec<Vec<f64>>, CampaignError> {
        let method = &current.results.method;
        // The points of a non-adaptive method do not depend on values, so many batches can be requested at once.
        let batches = if method.is_non_adaptive() {
            BLIND_BATCHES
        } else {
            1
        };
        let left = self.search.budget - current.results.evaluations;
        next_points(&mut *current.algorithm, (method, batches), config, left)
    }

    /// Returns the verdicts of points: those of the journal, and then those of simulations.
    fn evaluate_or_read(
        &self,
        state: &mut CampaignState,
        points: &[Vec<f64>],
    ) -> Result<BatchVerdicts, CampaignError> {
        let mut verdicts = Vec::with_capacity(points.len());
        while verdicts.len() < points.len()
            && let Some(verdict) = state.journal.next_verdict()?
        {
            verdicts.push(verdict);
        }
        let logged = verdicts.len();
        let new_points = points.get(logged..).unwrap_or_default();
        verdicts.extend(self.evaluate(&state.config.space, new_points)?);
        Ok(BatchVerdicts { verdicts, logged })
    }

    /// Adds evaluations to the findings and the table. Returns their costs for the search.
    fn add_all(
        &self,
        state: &mut CampaignState,
        results: &mut MethodResults,
        points: Vec<Vec<f64>>,
        verdicts: BatchVerdicts,
        folder: &RunFolder,
    ) -> Result<Vec<f64>, CampaignError> {
        let mut costs = Vec::with_capacity(points.len());
        for (point, verdict) in points.into_iter().zip(verdicts.verdicts) {
            let number = results.evaluations + 1;
            let evaluated = state.config.evaluated_point(number, point, verdict);
            costs.push(self.search.objective.cost(&evaluated));
            state.findings.add(results, &evaluated);
            if let Some(table) = &mut state.table {
                table.add(&state.config.space, &results.method, &evaluated, folder)?;
            }
        }
        Ok(costs)
    }

    /// Replays, shrinks and classifies the failures. Returns the distinct ones.
    fn examine(
        &self,
        config: &ResolvedConfig,
        findings: &CampaignFindings,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<Vec<ExaminedFailure>, CampaignError> {
        let searched = self.progress(findings, None);
        let notify = |step| {
            observer.notify(&CampaignProgress {
                examination: Some(step),
                ..searched.clone()
            })
        };
        notify(ExaminationStep::Shrinking)?;
        let examiner = Examiner::new(self, config);
        let candidates = findings.failures.examination_candidates(MAX_EXAMINED_KINDS);
        let mut distinct = Recorder { config }.select_distinct(examiner.examine_all(&candidates)?);
        notify(ExaminationStep::Classifying)?;
        examiner.classify_all(&mut distinct);
        notify(ExaminationStep::Confirming)?;
        examiner.confirm_all(&mut distinct);
        self.ensure_all_trusted()?;
        Ok(distinct)
    }

    /// Finds the reasons why the partner controller gave no answer, because the journal does not record them.
    fn find_unanswered_reasons(&self, state: &mut CampaignState) -> Result<(), CampaignError> {
        for results in &mut state.findings.method_results {
            if let Some(unanswered) = &mut results.second_missing_answers {
                let scenario = state.config.space.scenario(&unanswered.values)?;
                let reason = self.evaluator().partner_failure_reason(&scenario);
                unanswered.reason = reason
                    .unwrap_or_else(|| "it gives an answer when the run is repeated".to_owned());
            }
        }
        self.ensure_all_trusted()
    }

    fn progress(
        &self,
        findings: &CampaignFindings,
        current: Option<&MethodResults>,
    ) -> CampaignProgress {
        let mut progress = CampaignProgress {
            method: current.map(|results| results.method.clone()),
            examination: None,
            evaluations: 0,
            total: self.total_evaluations(),
            failures: 0,
            best_robustness: f64::INFINITY,
        };
        for results in findings.method_results.iter().chain(current) {
            progress.evaluations += results.evaluations;
            progress.failures += results.failures;
            progress.best_robustness = progress.best_robustness.min(results.best);
        }
        progress
    }

    fn total_evaluations(&self) -> u64 {
        self.search
            .budget
            .saturating_mul(self.methods().len() as u64)
    }

    /// Checks everything that would fail at every point, before any file is written.
    pub(super) fn check_at(&self, nominal: &Scenario) -> Result<(), CampaignError> {
        CampaignError::check_range("budget", self.search.budget, 1..=MAX_BUDGET)?;
        CampaignError::check_range("seed", self.seed, 0..=MAX_SEED)?;
        if !nominal.has_vehicle_under_test() {
            return Err(CampaignError::NoVehicleUnderTest(
                self.space.name().to_owned(),
            ));
        }
        if self
            .failure_criterion
            .as_ref()
            .is_some_and(|criterion| criterion.is_self_comparison(&self.controller))
        {
            return Err(CampaignError::ComparedWithItself(
                self.controller.name.clone(),
            ));
        }
        self.evaluator().evaluate(nominal, 1)?;
        self.ensure_all_trusted()
    }

    /// Checks that the controllers are deterministic and available, before results are written or reported.
    pub(super) fn ensure_all_trusted(&self) -> Result<(), CampaignError> {
        Ok(self
            .controllers()
            .try_for_each(NamedController::ensure_trusted)?)
    }

    pub(super) fn evaluate(
        &self,
        space: &ScenarioSpace,
        points: &[Vec<f64>],
    ) -> Result<Vec<RunVerdict>, CampaignError> {
        let scenarios = points
            .iter()
            .map(|point| space.scenario_at(point))
            .collect::<Result<Vec<_>, _>>()?;
        let simulations: Vec<_> = scenarios.iter().map(|scenario| (scenario, 1)).collect();
        let verdicts = self
            .evaluator()
            .evaluate_all(&simulations)
            .into_iter()
            .collect::<Result<_, _>>()?;
        self.ensure_all_trusted()?;
        Ok(verdicts)
    }
}

/// Returns the next points of a search, some batches, but at most `most` points.
pub(super) fn next_points(
    search: &mut dyn SearchAlgorithm,
    (method, batches): (&Method, usize),
    config: &ResolvedConfig,
    most: u64,
) -> Result<Vec<Vec<f64>>, CampaignError> {
    let mut points = search.ask();
    (1..batches).for_each(|_| points.extend(search.ask()));
    points.truncate(usize::try_from(most).unwrap_or(usize::MAX));
    config
        .cube
        .check_points(&points)
        .map_err(|problem| CampaignError::InvalidPoints {
            method: method.name().to_owned(),
            problem,
        })?;
    points
        .iter_mut()
        .for_each(|point| *point = config.space.search_point(point));
    Ok(points)
}

/// Checks the journal of an incomplete campaign, of which the manifest knows only a prefix.
///
/// # Errors
/// [`RunFolderError::Disk`] if it cannot be read. Damage is reported in the examination, as for every other file.
pub fn verify_journal(
    folder: &Path,
    mut examination: FolderExamination,
) -> Result<FolderExamination, RunFolderError> {
    let Some(identity) = &examination.identity else {
        return Ok(examination);
    };
    if let Some((_, state @ Ok(()))) = examination
        .files
        .iter_mut()
        .find(|(name, _)| name == JOURNAL_FILE)
    {
        match Journal::verify(&folder.join(JOURNAL_FILE), identity) {
            Err(RunFolderError::Damaged { problem, .. }) => *state = Err(problem),
            verified => verified?,
        }
    }
    Ok(examination)
}

pub(super) const CONFIGURATION_FILE: &str = "campaign.toml";
pub(super) const JOURNAL_FILE: &str = "evaluations.journal";
pub(super) const SUMMARY_FILE: &str = "summary.json";
pub(super) const SUMMARY_TEXT_FILE: &str = "summary.txt";

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crumple_core::observer::{Listener, Quiet};

    /// A search without an evaluation would find no failure.
    #[test]
    fn numbers_out_of_range_are_refused_before_any_file_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let campaign =
            |budget, seed| Campaign::of_match_leader("high-risk", Method::Halton, budget, seed);
        for (campaign, expected) in [
            (
                campaign(0, 0),
                "budget: must be from 1 to 1000000000, found 0",
            ),
            (
                campaign(MAX_BUDGET + 1, 0),
                "budget: must be from 1 to 1000000000, found 1000000001",
            ),
            (
                campaign(1, MAX_SEED + 1),
                "seed: must be from 0 to 9223372036854775807, found 9223372036854775808",
            ),
        ] {
            let refused = campaign.run(&folder.path().join("campaign"), false, &Quiet);
            assert_eq!(refused.unwrap_err().to_string(), expected);
            assert_eq!(
                campaign.find_first_failure(&Quiet).unwrap_err().to_string(),
                expected
            );
        }
        assert!(!folder.path().join("campaign").exists());
    }

    /// The observer learns what follows the counted evaluations.
    #[test]
    fn the_observer_sees_each_step_of_the_examination() {
        let folder = tempfile::tempdir().unwrap();
        let campaign = Campaign::of_match_leader("high-risk", Method::Halton, 20, 0);
        let notified = Mutex::new(Vec::new());
        let observer = Listener(|progress: &CampaignProgress| {
            if progress.method.is_none() {
                assert_eq!(progress.evaluations, progress.total);
                notified.lock().unwrap().push(progress.examination);
            }
        });
        let summary = campaign
            .run(&folder.path().join("campaign"), false, &observer)
            .unwrap();
        assert!(summary.falsified);
        let steps = [
            ExaminationStep::Shrinking,
            ExaminationStep::Classifying,
            ExaminationStep::Confirming,
        ];
        assert_eq!(
            notified.into_inner().unwrap(),
            [steps.map(Some).as_slice(), &[None]].concat()
        );
    }
}
