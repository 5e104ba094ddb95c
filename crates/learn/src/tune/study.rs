//! Execution of a tuning, from the first candidate to the report.

use super::candidates::CandidateLog;
use super::objective::{ControllerScore, ScoringSet};
use super::plan::{CANDIDATES, PLAN, REPORT_JSON, REPORT_MARKDOWN, SetKind};
use super::{TuneError, TuningFinalist, TuningPlan, TuningReport};
use crumple_core::observer::Observer;
use crumple_search::falsify::{SearchAlgorithm, UnitCube};
use crumple_sim::control::BuiltInController;
use crumple_store::run_folder::{FolderTransaction, RunFolder};
use crumple_store::study::{Study, StudyStep};

/// Number of candidates that the selection set compares with the initial settings.
const FINALISTS: usize = 5;

/// Progress of a tuning.
#[derive(Debug, Clone, PartialEq)]
pub struct TuningProgress {
    /// Simulations done.
    pub done: u64,
    /// Simulations of the whole tuning, at most.
    pub total: u64,
    /// Number of candidates so far.
    pub candidates: u64,
    /// Smallest objective so far.
    pub best: f64,
}

/// State of a tuning between two generations of candidates.
#[derive(Debug)]
pub struct TuningState {
    method: Box<dyn SearchAlgorithm>,
    cube: UnitCube,
    tuning_set: ScoringSet,
    log: CandidateLog,
}

/// A step evaluates the initial settings, and after that a generation of the search method.
impl Study for TuningPlan {
    const KIND: &'static str = "tuning";
    const CONFIGURATION_FILE: &'static str = PLAN;
    const OUTPUTS: &'static [&'static str] = &[PLAN, CANDIDATES, REPORT_JSON, REPORT_MARKDOWN];

    type State = TuningState;
    type Progress = TuningProgress;
    type Report = TuningReport;
    type Error = TuneError;

    fn check(&self) -> Result<(), TuneError> {
        self.check_spaces()
    }

    fn configuration(&self) -> Result<String, TuneError> {
        self.to_toml()
    }

    fn load(&self, folder: &RunFolder) -> Result<TuningState, TuneError> {
        let cube = self.search.cube()?;
        Ok(TuningState {
            method: self.config.method.start(&cube, self.search_seed()),
            cube,
            tuning_set: self.scoring_set(SetKind::Tuning)?,
            log: CandidateLog::load(folder)?,
        })
    }

    fn step(
        &self,
        state: &mut TuningState,
        folder: &RunFolder,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<StudyStep, TuneError> {
        if state.log.len() == 0 {
            self.add_candidate(self.search.initial(), state, folder, observer)?;
        } else if state.log.len() < self.config.evaluations {
            self.add_generation(state, folder, observer)?;
        }
        if state.log.len() < self.config.evaluations {
            Ok(StudyStep::Continue)
        } else {
            Ok(StudyStep::Done)
        }
    }

    fn finish(
        &self,
        state: TuningState,
        _: &RunFolder,
        results: &mut FolderTransaction<'_>,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<TuningReport, TuneError> {
        let finalists = self.select(&state.log, observer)?;
        let tuned = self.tuned_controller(&finalists)?;
        let test = self.test(&state.log, &tuned, observer)?;
        let report = TuningReport::new(self, tuned, finalists, test)?;
        results
            .write(REPORT_MARKDOWN, report.to_markdown())
            .write_json(REPORT_JSON, &report)?;
        Ok(report)
    }

    fn read(
        &self,
        folder: &RunFolder,
        _: &dyn Observer<TuningProgress>,
    ) -> Result<TuningReport, TuneError> {
        Ok(folder.read_required_json(REPORT_JSON)?)
    }
}

impl TuningPlan {
    /// Evaluates the next points of the search method.
    fn add_generation(
        &self,
        state: &mut TuningState,
        folder: &RunFolder,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<(), TuneError> {
        let left = self.config.evaluations - state.log.len();
        let mut points = state.method.ask();
        points.truncate(usize::try_from(left).unwrap_or(usize::MAX));
        state
            .cube
            .check_points(&points)
            .map_err(|problem| TuneError::Method {
                method: self.config.method.name().to_owned(),
                problem,
            })?;
        let mut objectives = Vec::new();
        for point in &points {
            let controller = self.search.controller_at(point);
            objectives.push(self.add_candidate(&controller, state, folder, observer)?);
        }
        state.method.tell(&objectives);
        Ok(())
    }

    /// Evaluates a candidate in the tuning set, and returns its objective.
    fn add_candidate(
        &self,
        controller: &BuiltInController,
        state: &mut TuningState,
        folder: &RunFolder,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<f64, TuneError> {
        let objective = state.log.add(controller, &state.tuning_set, folder)?;
        let done = state.log.len() * self.runs_per_candidate();
        self.notify(done, &state.log, observer)?;
        Ok(objective)
    }

    /// Evaluates the initial settings and the best candidates in the selection set. The initial settings come first.
    fn select(
        &self,
        log: &CandidateLog,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<Vec<TuningFinalist>, TuneError> {
        let set = self.scoring_set(SetKind::Selection)?;
        let mut done = log.len() * self.runs_per_candidate();
        let mut finalists = Vec::new();
        for tuning in best_candidates(log.candidates()) {
            let selection = set.score(&parse_controller(&tuning.controller)?)?;
            done += self.runs_per_candidate();
            self.notify(done, log, observer)?;
            finalists.push(TuningFinalist { tuning, selection });
        }
        Ok(finalists)
    }

    /// Returns the controller that is best in the selection set.
    fn tuned_controller(
        &self,
        finalists: &[TuningFinalist],
    ) -> Result<BuiltInController, TuneError> {
        let best = finalists
            .iter()
            .min_by(|a, b| a.selection.objective.total_cmp(&b.selection.objective));
        match best {
            Some(best) => parse_controller(&best.tuning.controller),
            None => Ok(self.search.initial().clone()),
        }
    }

    /// Evaluates the initial settings, the tuned settings and `idm` in the test set.
    fn test(
        &self,
        log: &CandidateLog,
        tuned: &BuiltInController,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<Vec<ControllerScore>, TuneError> {
        let set = self.scoring_set(SetKind::Test)?;
        let mut done = self.max_search_runs();
        let idm = BuiltInController::Idm(Default::default());
        let mut scores = Vec::new();
        for controller in [self.search.initial(), tuned, &idm] {
            self.notify(done, log, observer)?;
            scores.push(set.score(controller)?);
            done += self.test_runs_per_controller();
        }
        Ok(scores)
    }

    /// Returns the number of simulations of all candidates and finalists, at most.
    fn max_search_runs(&self) -> u64 {
        let candidates = self.config.evaluations + 1 + FINALISTS as u64;
        candidates.saturating_mul(self.runs_per_candidate())
    }

    fn test_runs_per_controller(&self) -> u64 {
        let spaces = self.spaces.len() as u64 + 1;
        self.config.test_runs.saturating_mul(spaces) + self.drive_count()
    }

    fn notify(
        &self,
        done: u64,
        log: &CandidateLog,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<(), TuneError> {
        let objectives = log.candidates().iter().map(|candidate| candidate.objective);
        let test_runs = self.test_runs_per_controller().saturating_mul(3);
        let progress = TuningProgress {
            done,
            total: self.max_search_runs().saturating_add(test_runs),
            candidates: log.len(),
            best: objectives.fold(f64::INFINITY, f64::min),
        };
        Ok(observer.notify(&progress)?)
    }
}

/// Returns the initial settings, and then up to [`FINALISTS`] different candidates that are better, best first.
fn best_candidates(candidates: &[ControllerScore]) -> Vec<ControllerScore> {
    let Some((initial, others)) = candidates.split_first() else {
        return Vec::new();
    };
    let mut ranked: Vec<&ControllerScore> = others
        .iter()
        .filter(|candidate| candidate.objective < initial.objective)
        .collect();
    ranked.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    let mut best = vec![initial.clone()];
    for candidate in ranked {
        let is_new = best
            .iter()
            .all(|other| other.controller != candidate.controller);
        if is_new && best.len() <= FINALISTS {
            best.push(candidate.clone());
        }
    }
    best
}

fn parse_controller(text: &str) -> Result<BuiltInController, TuneError> {
    Ok(BuiltInController::parse(text).ok_or_else(|| TuneError::NotBuiltIn(text.to_owned()))??)
}
