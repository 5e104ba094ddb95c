//! Execution of a retraining, from the first search to the report.

use std::sync::Arc;

use super::cases::Cases;
use super::corpus::Corpus;
use super::files::{
    CHECKPOINTS, LEARNER, PLAN, POLICY, REPORT_JSON, REPORT_MARKDOWN, ROUND_RECORD, SELECTION_SET,
    TEST_SET, TRAINING_CASES, VALIDATION_SET,
};
use super::plan::{RetrainingPlan, SELECTION_SEED, VALIDATION_SET_SEED};
use super::progress::{RetrainingObserver, RetrainingProgress};
use super::regression_spaces::RegressionSet;
use super::report::{RetrainingEnding, RetrainingReport};
use super::round::{Round, RoundContext, load_corpus, named_policy, round_path};
use super::search::RoundFindings;
use super::test_set::{TestSetResults, witnesses};
use super::{RegressionResults, RetrainError};
use crumple_core::observer::Observer;
use crumple_sim::policy::Policy;
use crumple_store::run_folder::{FolderTransaction, RunFolder, RunFolderError};
use crumple_store::study::{Study, StudyStep};

const RETRAINED_NAME: &str = "retrained";

/// State of a retraining between two steps.
#[derive(Debug, Default)]
pub struct RetrainingState {
    validation_set: Option<Corpus>,
    selection_set: Option<Corpus>,
    rounds: Option<RoundsState>,
}

/// State of a retraining after the evaluation of the initial policy.
#[derive(Debug)]
struct RoundsState {
    regression: RegressionSet,
    initial_results: RegressionResults,
    /// The last accepted policy, or the initial one.
    policy: Arc<Policy>,
    /// Results of that policy.
    results: RegressionResults,
    cases: Cases,
    finished: Vec<Round>,
    /// The last search, if it found nothing that is avoidable.
    empty_search: Option<Box<RoundFindings>>,
}

/// The first steps build the validation set and the selection set, and evaluate the initial policy. Each further step
/// is a round.
impl Study for RetrainingPlan {
    const KIND: &'static str = "retraining";
    const CONFIGURATION_FILE: &'static str = PLAN;
    const OUTPUTS: &'static [&'static str] = &[
        PLAN,
        POLICY,
        TRAINING_CASES,
        SELECTION_SET,
        VALIDATION_SET,
        TEST_SET,
        REPORT_JSON,
        REPORT_MARKDOWN,
        "rounds/",
    ];

    type State = RetrainingState;
    type Progress = RetrainingProgress;
    type Report = RetrainingReport;
    type Error = RetrainError;

    fn check(&self) -> Result<(), RetrainError> {
        self.check_policy()
    }

    fn configuration(&self) -> Result<String, RetrainError> {
        self.to_toml()
    }

    fn load(&self, _: &RunFolder) -> Result<RetrainingState, RetrainError> {
        Ok(RetrainingState::default())
    }

    fn step(
        &self,
        state: &mut RetrainingState,
        folder: &RunFolder,
        observer: &dyn Observer<RetrainingProgress>,
    ) -> Result<StudyStep, RetrainError> {
        let Some(validation_set) = &state.validation_set else {
            state.validation_set = Some(self.load_validation_set(folder, observer)?);
            return Ok(StudyStep::Continue);
        };
        let Some(selection_set) = &state.selection_set else {
            state.selection_set = Some(self.load_selection_set(folder, observer)?);
            return Ok(StudyStep::Continue);
        };
        let Some(rounds) = &mut state.rounds else {
            state.rounds = Some(RoundsState::new(self, validation_set)?);
            return Ok(StudyStep::Continue);
        };
        if rounds.are_over(self) {
            return Ok(StudyStep::Done);
        }
        rounds.run_next(self, [validation_set, selection_set], folder, observer)?;
        Ok(StudyStep::Continue)
    }

    fn finish(
        &self,
        state: RetrainingState,
        folder: &RunFolder,
        results: &mut FolderTransaction<'_>,
        observer: &dyn Observer<RetrainingProgress>,
    ) -> Result<RetrainingReport, RetrainError> {
        let rounds = state.rounds.ok_or_else(|| RunFolderError::NotFinished {
            folder: folder.path(""),
            problem: "the retraining has no rounds yet".to_owned(),
        })?;
        rounds.write_policy(folder)?;
        let test_results = self.evaluate_in_test_set(&rounds.policy, folder, observer)?;
        let ending = match rounds.empty_search {
            Some(search) => RetrainingEnding::NothingFound { search },
            None => RetrainingEnding::RoundsExhausted,
        };
        let report = RetrainingReport::new(
            self,
            folder,
            (rounds.initial_results, rounds.results),
            rounds.finished,
            ending,
            test_results,
        )?;
        results
            .write(REPORT_MARKDOWN, report.to_markdown())
            .write_json(REPORT_JSON, &report)?;
        Ok(report)
    }

    fn read(
        &self,
        folder: &RunFolder,
        _: &dyn Observer<RetrainingProgress>,
    ) -> Result<RetrainingReport, RetrainError> {
        Ok(folder.read_required_json(REPORT_JSON)?)
    }
}

impl RetrainingPlan {
    fn load_validation_set(
        &self,
        folder: &RunFolder,
        observer: &RetrainingObserver<'_>,
    ) -> Result<Corpus, RetrainError> {
        let wanted = self.spaces.total(self.settings.validation_draws);
        let corpus = (VALIDATION_SET, VALIDATION_SET_SEED, wanted);
        load_corpus(self, folder, corpus, observer)
    }

    fn load_selection_set(
        &self,
        folder: &RunFolder,
        observer: &RetrainingObserver<'_>,
    ) -> Result<Corpus, RetrainError> {
        // An imitation alone has one checkpoint.
        let wanted = if self.settings.episodes == 0 {
            0
        } else {
            self.training.evaluation.ranking_draws
        };
        let corpus = (SELECTION_SET, SELECTION_SEED, wanted);
        load_corpus(self, folder, corpus, observer)
    }

    /// Simulates the initial policy, the retrained one and the baselines in the test set.
    fn evaluate_in_test_set(
        &self,
        retrained: &Arc<Policy>,
        folder: &RunFolder,
        observer: &RetrainingObserver<'_>,
    ) -> Result<TestSetResults, RetrainError> {
        let contenders = witnesses(&[
            named_policy(&self.initial_policy_name, &self.initial_policy),
            named_policy(RETRAINED_NAME, retrained),
        ]);
        TestSetResults::load_or_evaluate((folder, TEST_SET), self, &contenders, observer)
    }
}

impl RoundsState {
    /// Evaluates the initial policy.
    fn new(plan: &RetrainingPlan, validation_set: &Corpus) -> Result<Self, RetrainError> {
        let policy = Arc::clone(&plan.initial_policy);
        let regression = RegressionSet::new(plan)?;
        let results = RegressionResults::evaluate(&policy, plan, validation_set, &regression)?;
        Ok(Self {
            regression,
            initial_results: results.clone(),
            policy,
            results,
            cases: Cases::empty(&plan.spaces)?,
            finished: Vec::new(),
            empty_search: None,
        })
    }

    fn are_over(&self, plan: &RetrainingPlan) -> bool {
        self.empty_search.is_some() || self.finished.len() as u64 >= plan.settings.rounds
    }

    /// Runs the next round, or reads the parts that an earlier process finished.
    fn run_next(
        &mut self,
        plan: &RetrainingPlan,
        [validation_set, selection_set]: [&Corpus; 2],
        folder: &RunFolder,
        observer: &RetrainingObserver<'_>,
    ) -> Result<(), RetrainError> {
        let context = RoundContext {
            plan,
            run_folder: folder,
            validation_set,
            selection_set,
            regression: &self.regression,
            policy: &self.policy,
            initial_results: &self.initial_results,
            results: &self.results,
            cases: &self.cases,
            previous_round: self.finished.last(),
        };
        let findings = context.search(observer)?;
        if findings.is_empty() {
            self.empty_search = Some(Box::new(findings));
            return Ok(());
        }
        let cases = context.extended_cases(&findings)?;
        let round = match folder.read_json(&context.path(ROUND_RECORD))? {
            Some(round) => round,
            None => context.finish(findings, &cases, observer)?,
        };
        self.cases = cases;
        self.add(round, folder)
    }

    /// Adds a round, and removes the files that only its training needed.
    fn add(&mut self, round: Round, folder: &RunFolder) -> Result<(), RetrainError> {
        let previous_round = self.finished.len() as u64;
        folder
            .transaction()
            .remove(&round_path(previous_round + 1, CHECKPOINTS))
            .remove(&round_path(previous_round, LEARNER))
            .commit()?;
        if round.acceptance.is_accepted() {
            self.policy = Arc::new(round.candidate(folder)?);
            self.results = round.after.clone();
        }
        self.finished.push(round);
        Ok(())
    }

    /// Writes the retrained policy and its cases, and removes the learner of the last round.
    fn write_policy(&self, folder: &RunFolder) -> Result<(), RetrainError> {
        let last_round = self.finished.len() as u64;
        folder
            .transaction()
            .remove(&round_path(last_round, LEARNER))
            .write(POLICY, self.policy.to_bytes()?)
            .write_json(TRAINING_CASES, &self.cases)?
            .commit()?;
        Ok(())
    }
}
