//! Running a campaign, from its first evaluation to its summary.

use std::path::Path;

use super::findings::{CampaignFindings, MethodResults};
use super::journal::Journal;
use super::resolved_config::ResolvedConfig;
use super::summary::CampaignSummary;
use super::table::EvaluationTable;
use super::{Campaign, CampaignError, CampaignOptions, EvaluationLog, MAX_BUDGET, MAX_SEED};
use crate::falsify::counterexample::{Examiner, Recorder};
use crate::falsify::{Method, SearchAlgorithm};
use crumple_core::observer::Observer;
use crumple_measure::RunVerdict;
use crumple_sim::engine::NamedController;
use crumple_sim::scenario::Scenario;
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::{FolderExamination, RunFolder, RunFolderError, RunFolderOptions};

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

pub(super) struct CampaignRun<'a> {
    pub(super) campaign: &'a Campaign,
    pub(super) config: &'a ResolvedConfig,
    pub(super) run_folder: &'a RunFolder,
    pub(super) journal: Journal,
    pub(super) table: Option<EvaluationTable<'a>>,
    pub(super) findings: CampaignFindings,
}

impl Campaign {
    /// Runs the campaign in `folder`. If `observer` stops it, the folder keeps its evaluations for `resume`.
    ///
    /// # Errors
    /// [`CampaignError`] if the folder cannot be used, a scenario cannot be run, or `observer` stops the campaign.
    pub fn run(
        &self,
        folder: &Path,
        CampaignOptions { log, resume }: CampaignOptions,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<CampaignSummary, CampaignError> {
        if let Some(unknown) = self
            .controllers()
            .find(|driver| resume && driver.source.identity().is_none())
        {
            return Err(CampaignError::NoIdentity(unknown.name.clone()));
        }
        let terms = ResolvedConfig::from_campaign(self, log)?;
        self.check(&terms.nominal)?;
        let configuration = terms.record.to_toml()?;
        let work = open_run_folder(folder, &configuration, resume)?;
        if work.is_complete() {
            return CampaignSummary::from_json(&String::from_utf8_lossy(
                &work.read_required(SUMMARY_FILE)?,
            ));
        }
        work.transaction()
            .write(CONFIGURATION_FILE, configuration)
            .append_only(JOURNAL_FILE)
            .commit()?;
        let mut searching = CampaignRun {
            campaign: self,
            config: &terms,
            run_folder: &work,
            journal: Journal::open_in_folder(&work, JOURNAL_FILE, resume)?,
            table: (log == EvaluationLog::Full).then(|| EvaluationTable::new(&terms.space, &work)),
            findings: CampaignFindings::new(&terms),
        };
        searching.search_all(observer)?;
        searching.find_unanswered_reasons()?;
        let CampaignRun {
            table, findings, ..
        } = &mut searching;
        // The journal stays until all results are written.
        let mut results = work.transaction();
        table
            .take()
            .map_or(Ok(()), |table| table.finish(&mut results))?;
        let searched = campaign_progress(None, &findings.method_results, self.total_evaluations());
        let notify = |step| {
            observer.notify(&CampaignProgress {
                examination: Some(step),
                ..searched.clone()
            })
        };
        notify(ExaminationStep::Shrinking)?;
        let (examiner, recorder) = (Examiner::new(self, &terms), Recorder { config: &terms });
        let mut distinct = recorder.select_distinct(
            examiner.examine_all(&findings.failures.examination_candidates(MAX_EXAMINED_KINDS))?,
        );
        notify(ExaminationStep::Classifying)?;
        examiner.classify_all(&mut distinct);
        notify(ExaminationStep::Confirming)?;
        examiner.confirm_all(&mut distinct);
        self.ensure_all_trusted()?;
        let counterexamples = recorder.record_all(&distinct, &mut results)?;
        let summary = CampaignSummary::from_findings(&terms, findings, counterexamples)?;
        observer.notify(&searched)?;
        results
            .write(SUMMARY_TEXT_FILE, summary.to_text())
            .write(SUMMARY_FILE, summary.to_json()?)
            .remove(JOURNAL_FILE)
            .commit()?;
        work.finish()?;
        Ok(summary)
    }

    fn total_evaluations(&self) -> u64 {
        self.budget.saturating_mul(self.methods().len() as u64)
    }

    /// Checks everything that would fail at every point, before any file is written.
    pub(super) fn check(&self, nominal: &Scenario) -> Result<(), CampaignError> {
        CampaignError::check_range("budget", self.budget, 1..=MAX_BUDGET)?;
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
        let asked: Vec<(&Scenario, u32)> = scenarios.iter().map(|scenario| (scenario, 1)).collect();
        let verdicts = self
            .evaluator()
            .evaluate_all(&asked)
            .into_iter()
            .collect::<Result<_, _>>()?;
        self.ensure_all_trusted()?;
        Ok(verdicts)
    }
}

impl CampaignRun<'_> {
    pub(super) fn search_all(
        &mut self,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<(), CampaignError> {
        for method in self.campaign.methods() {
            let reached = self.search(method, observer)?;
            self.findings.method_results.push(reached);
        }
        Ok(())
    }

    /// Finds the reasons why the partner controller gave no answer, because the journal does not record them.
    pub(super) fn find_unanswered_reasons(&mut self) -> Result<(), CampaignError> {
        for reached in &mut self.findings.method_results {
            if let Some(silent) = &mut reached.other_unanswered {
                let because = self
                    .campaign
                    .evaluator()
                    .partner_failure_reason(&self.config.space.scenario(&silent.values)?);
                silent.because = because
                    .unwrap_or_else(|| "it gives an answer when the run is repeated".to_owned());
            }
        }
        self.campaign.ensure_all_trusted()
    }

    pub(super) fn progress(&self, current: Option<&MethodResults>) -> CampaignProgress {
        campaign_progress(
            current,
            &self.findings.method_results,
            self.campaign.total_evaluations(),
        )
    }

    fn search(
        &mut self,
        method: Method,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<MethodResults, CampaignError> {
        let (terms, space) = (self.config, &self.config.space);
        let mut search = method.start(&terms.cube, terms.record.seed);
        let mut reached = MethodResults::new(method.clone());
        let budget = self.campaign.budget;
        while reached.evaluations < budget {
            // The points of a non-adaptive method do not depend on values, so many batches can be requested at once.
            let batches = if method.is_non_adaptive() {
                BLIND_BATCHES
            } else {
                1
            };
            let points = next_points(
                &mut *search,
                (&method, batches),
                terms,
                budget - reached.evaluations,
            )?;
            let mut verdicts = Vec::with_capacity(points.len());
            while verdicts.len() < points.len()
                && let Some(verdict) = self.journal.next_verdict()?
            {
                verdicts.push(verdict);
            }
            let known = verdicts.len();
            verdicts.extend(
                self.campaign
                    .evaluate(space, points.get(known..).unwrap_or_default())?,
            );
            // If the observer stops the campaign, this batch is dropped: some of its simulations may have ended early.
            observer.notify(&self.progress(Some(&reached)))?;
            if let Some(durable) = self
                .journal
                .append(verdicts.get(known..).unwrap_or_default())?
            {
                self.run_folder.record_prefix(JOURNAL_FILE, durable)?;
            }
            let mut costs = Vec::with_capacity(points.len());
            for (point, verdict) in points.into_iter().zip(verdicts) {
                let number = reached.evaluations + 1;
                let evaluated = terms.evaluated_point(number, point, verdict);
                costs.push(self.campaign.objective.cost(&evaluated));
                self.findings.add(&mut reached, &evaluated);
                if let Some(table) = &mut self.table {
                    table.add(&method, &evaluated)?;
                }
            }
            search.tell(&costs);
            observer.notify(&self.progress(Some(&reached)))?;
        }
        Ok(reached)
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
    let invalid = |problem| CampaignError::InvalidPoints {
        method: method.name().to_owned(),
        problem,
    };
    config.cube.check_points(&points).map_err(invalid)?;
    points
        .iter_mut()
        .for_each(|point| *point = config.space.search_point(point));
    Ok(points)
}

/// Opens the run folder of a campaign. If it contains another campaign, the error names the first field that differs.
pub(super) fn open_run_folder(
    folder: &Path,
    configuration: &str,
    resume: bool,
) -> Result<RunFolder, CampaignError> {
    let asked = RunFolderOptions {
        kind: CAMPAIGN_KIND,
        configuration,
        configuration_file: CONFIGURATION_FILE,
        resume,
        outputs: &[
            CONFIGURATION_FILE,
            JOURNAL_FILE,
            SUMMARY_FILE,
            SUMMARY_TEXT_FILE,
            "counterexamples/",
            "counterexamples/originals/",
            "counterexamples/escapes/",
            "evaluations/",
        ],
    };
    Ok(RunFolder::open(folder, asked)?)
}

/// Checks the journal of an incomplete campaign, of which the manifest knows only a prefix.
///
/// # Errors
/// [`RunFolderError::Disk`] if it cannot be read. Damage is reported in the examination, as for every other file.
pub fn verify_journal(
    folder: &Path,
    mut found: FolderExamination,
) -> Result<FolderExamination, RunFolderError> {
    let Some(identity) = &found.identity else {
        return Ok(found);
    };
    if let Some((_, state @ Ok(()))) = found
        .files
        .iter_mut()
        .find(|(name, _)| name == JOURNAL_FILE)
    {
        match Journal::verify(&folder.join(JOURNAL_FILE), identity) {
            Err(RunFolderError::Damaged { problem, .. }) => *state = Err(problem),
            looked => looked?,
        }
    }
    Ok(found)
}

/// Kind of a campaign's run folder in its `work.json`.
pub const CAMPAIGN_KIND: &str = "campaign";

pub(super) const CONFIGURATION_FILE: &str = "campaign.toml";
pub(super) const JOURNAL_FILE: &str = "evaluations.journal";
pub(super) const SUMMARY_FILE: &str = "summary.json";
pub(super) const SUMMARY_TEXT_FILE: &str = "summary.txt";

fn campaign_progress(
    current: Option<&MethodResults>,
    done: &[MethodResults],
    total: u64,
) -> CampaignProgress {
    let all = || done.iter().chain(current);
    CampaignProgress {
        method: current.map(|reached| reached.method.clone()),
        examination: None,
        evaluations: all().map(|reached| reached.evaluations).sum(),
        total,
        failures: all().map(|reached| reached.failures).sum(),
        best_robustness: all()
            .map(|reached| reached.best)
            .fold(f64::INFINITY, f64::min),
    }
}

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
            let refused = campaign.run(
                &folder.path().join("campaign"),
                CampaignOptions::default(),
                &Quiet,
            );
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
        let seen = Mutex::new(Vec::new());
        let observer = Listener(|progress: &CampaignProgress| {
            if progress.method.is_none() {
                assert_eq!(progress.evaluations, progress.total);
                seen.lock().unwrap().push(progress.examination);
            }
        });
        let summary = campaign
            .run(
                &folder.path().join("campaign"),
                CampaignOptions::default(),
                &observer,
            )
            .unwrap();
        assert!(summary.falsified);
        let steps = [
            ExaminationStep::Shrinking,
            ExaminationStep::Classifying,
            ExaminationStep::Confirming,
        ];
        assert_eq!(
            seen.into_inner().unwrap(),
            [steps.map(Some).as_slice(), &[None]].concat()
        );
    }
}
