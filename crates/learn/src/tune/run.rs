//! Execution of a tuning, from the first candidate to the report.

use std::path::Path;

use super::objective::{ControllerScore, ScoringSet};
use super::plan::{CANDIDATES, PLAN, REPORT_JSON, REPORT_MARKDOWN, SetKind};
use super::{TuneError, TuningFinalist, TuningPlan, TuningReport};
use crumple_core::observer::Observer;
use crumple_store::run_folder::{RunFolder, RunFolderError};
use crumple_world::control::BuiltInController;

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

/// Candidates so far: in memory, and in a file with one line each.
struct CandidateLog<'a> {
    plan: &'a TuningPlan,
    run_folder: &'a RunFolder,
    observer: &'a dyn Observer<TuningProgress>,
    /// Candidates of an earlier process.
    earlier: Vec<ControllerScore>,
    text: String,
    candidates: Vec<ControllerScore>,
}

impl TuningPlan {
    /// Runs the tuning in `folder`, or continues it with `resume`. Of a complete one, reads the report.
    ///
    /// # Errors
    /// [`TuneError`] if the plan or the folder is unusable, a scenario cannot be run, or `observer` stops the tuning.
    pub fn run(
        &self,
        folder: &Path,
        resume: bool,
        observer: &dyn Observer<TuningProgress>,
    ) -> Result<TuningReport, TuneError> {
        self.check()?;
        let work = self.open_run_folder(folder, resume)?;
        if work.is_complete() {
            return parse_json(&work, REPORT_JSON, &work.read_required(REPORT_JSON)?);
        }
        work.write(PLAN, self.to_toml()?)?;
        let mut log = CandidateLog::open(self, &work, observer)?;
        self.search(&mut log)?;
        let finalists = self.select(&log)?;
        let tuned = finalists
            .iter()
            .min_by(|a, b| a.selection.objective.total_cmp(&b.selection.objective));
        let tuned = tuned.map_or(Ok(self.search.initial().clone()), |one| {
            parse_controller(&one.tuning.controller)
        })?;
        let scored = self.test(&log, &tuned)?;
        let report = TuningReport::new(self, tuned, finalists, scored)?;
        let json = serde_json::to_string_pretty(&report).map_err(TuneError::encoding)? + "\n";
        work.transaction()
            .write(REPORT_MARKDOWN, report.to_markdown())
            .write(REPORT_JSON, json)
            .commit()?;
        work.finish()?;
        Ok(report)
    }

    /// Evaluates the initial settings, and then the points of the search method.
    fn search(&self, log: &mut CandidateLog<'_>) -> Result<(), TuneError> {
        let invalid = |problem| TuneError::Method {
            method: self.method.name().to_owned(),
            problem,
        };
        let set = self.scoring_set(SetKind::Tuning)?;
        let cube = self.search.cube().map_err(TuneError::encoding)?;
        let mut search = self.method.start(&cube, self.search_seed());
        log.add(&set, self.search.initial())?;
        while log.len() < self.evaluations {
            let mut points = search.ask();
            points.truncate(usize::try_from(self.evaluations - log.len()).unwrap_or(usize::MAX));
            cube.check_points(&points).map_err(invalid)?;
            let add = |point: &Vec<f64>| log.add(&set, &self.search.controller_at(point));
            search.tell(&points.iter().map(add).collect::<Result<Vec<_>, _>>()?);
        }
        Ok(())
    }

    /// Evaluates the initial settings and the best candidates in the selection set. The initial settings come first.
    fn select(&self, log: &CandidateLog<'_>) -> Result<Vec<TuningFinalist>, TuneError> {
        let Some((initial, others)) = log.candidates.split_first() else {
            return Ok(Vec::new());
        };
        let mut ranked: Vec<&ControllerScore> = others
            .iter()
            .filter(|one| one.objective < initial.objective)
            .collect();
        ranked.sort_by(|a, b| a.objective.total_cmp(&b.objective));
        let mut finalists = vec![initial];
        for candidate in ranked {
            if finalists.len() <= FINALISTS
                && finalists
                    .iter()
                    .all(|other| other.controller != candidate.controller)
            {
                finalists.push(candidate);
            }
        }
        let set = self.scoring_set(SetKind::Selection)?;
        let mut done = log.len() * self.runs_per_candidate();
        let select = |finalist: &ControllerScore| {
            let selection = set.score(&parse_controller(&finalist.controller)?)?;
            done += self.runs_per_candidate();
            log.notify(done)?;
            Ok(TuningFinalist {
                tuning: finalist.clone(),
                selection,
            })
        };
        finalists.into_iter().map(select).collect()
    }

    /// Evaluates the initial settings, the tuned settings and `idm` in the test set.
    fn test(
        &self,
        log: &CandidateLog<'_>,
        tuned: &BuiltInController,
    ) -> Result<Vec<ControllerScore>, TuneError> {
        let set = self.scoring_set(SetKind::Test)?;
        let mut done = (self.evaluations + 1 + FINALISTS as u64) * self.runs_per_candidate();
        let idm = BuiltInController::Idm(Default::default());
        let test = |controller: BuiltInController| {
            log.notify(done)?;
            done += self.test_runs * (self.spaces.len() as u64 + 1);
            Ok(set.score(&controller)?)
        };
        [self.search.initial().clone(), tuned.clone(), idm]
            .into_iter()
            .map(test)
            .collect()
    }

    fn total_runs(&self) -> u64 {
        let candidates =
            (self.evaluations + 1 + FINALISTS as u64).saturating_mul(self.runs_per_candidate());
        let test = self
            .test_runs
            .saturating_mul(3 * (self.spaces.len() as u64 + 1));
        candidates.saturating_add(test)
    }
}

impl<'a> CandidateLog<'a> {
    fn open(
        plan: &'a TuningPlan,
        run_folder: &'a RunFolder,
        observer: &'a dyn Observer<TuningProgress>,
    ) -> Result<Self, TuneError> {
        let bytes = run_folder.read(CANDIDATES)?.unwrap_or_default();
        let lines = bytes
            .split(|&byte| byte == b'\n')
            .filter(|line| !line.is_empty());
        let earlier = lines
            .map(|line| parse_json(run_folder, CANDIDATES, line))
            .collect::<Result<_, _>>()?;
        let text = String::from_utf8_lossy(&bytes).into_owned();
        Ok(Self {
            plan,
            run_folder,
            observer,
            earlier,
            text,
            candidates: Vec::new(),
        })
    }

    fn len(&self) -> u64 {
        self.candidates.len() as u64
    }

    /// Evaluates the next candidate, or reads its result, and returns its objective.
    fn add(&mut self, set: &ScoringSet, controller: &BuiltInController) -> Result<f64, TuneError> {
        let name = controller.to_arg();
        let score = match self.earlier.get(self.candidates.len()) {
            Some(earlier) if earlier.controller == name => earlier.clone(),
            Some(_) => {
                let problem = format!(
                    "line {} is not the candidate of this tuning",
                    self.candidates.len() + 1
                );
                return Err(
                    RunFolderError::damaged(&self.run_folder.path(CANDIDATES), problem).into(),
                );
            }
            None => {
                let known = self
                    .candidates
                    .iter()
                    .find(|candidate| candidate.controller == name);
                let score =
                    known.map_or_else(|| set.score(controller), |known| Ok(known.clone()))?;
                self.text += &(serde_json::to_string(&score).map_err(TuneError::encoding)? + "\n");
                self.run_folder.write(CANDIDATES, self.text.as_str())?;
                score
            }
        };
        let objective = score.objective;
        self.candidates.push(score);
        self.notify(self.len() * self.plan.runs_per_candidate())?;
        Ok(objective)
    }

    fn notify(&self, done: u64) -> Result<(), TuneError> {
        let best = self
            .candidates
            .iter()
            .map(|candidate| candidate.objective)
            .fold(f64::INFINITY, f64::min);
        let progress = TuningProgress {
            done,
            total: self.plan.total_runs(),
            candidates: self.len(),
            best,
        };
        Ok(self.observer.notify(&progress)?)
    }
}

fn parse_controller(text: &str) -> Result<BuiltInController, TuneError> {
    Ok(BuiltInController::parse(text).ok_or_else(|| TuneError::NotBuiltIn(text.to_owned()))??)
}

fn parse_json<T: serde::de::DeserializeOwned>(
    work: &RunFolder,
    name: &str,
    bytes: &[u8],
) -> Result<T, TuneError> {
    serde_json::from_slice(bytes).map_err(|error| {
        let problem = format!("differs from what a tuning writes: {error}");
        RunFolderError::damaged(&work.path(name), problem).into()
    })
}
