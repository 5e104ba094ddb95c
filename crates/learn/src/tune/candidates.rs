//! Candidates of a tuning so far: in memory, and in a file with one line each.

use super::TuneError;
use super::objective::{ControllerScore, ScoringSet};
use super::plan::CANDIDATES;
use crumple_sim::control::BuiltInController;
use crumple_store::run_folder::{RunFolder, RunFolderError};

/// Candidates so far, and those of an earlier process.
#[derive(Debug)]
pub(super) struct CandidateLog {
    earlier: Vec<ControllerScore>,
    text: String,
    candidates: Vec<ControllerScore>,
}

impl CandidateLog {
    /// Reads the candidates of an earlier process.
    pub(super) fn load(folder: &RunFolder) -> Result<Self, TuneError> {
        let bytes = folder.read(CANDIDATES)?.unwrap_or_default();
        let lines = bytes
            .split(|&byte| byte == b'\n')
            .filter(|line| !line.is_empty());
        let earlier = lines
            .map(|line| folder.parse_json(CANDIDATES, line))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            earlier,
            text: String::from_utf8_lossy(&bytes).into_owned(),
            candidates: Vec::new(),
        })
    }

    pub(super) fn candidates(&self) -> &[ControllerScore] {
        &self.candidates
    }

    pub(super) fn len(&self) -> u64 {
        self.candidates.len() as u64
    }

    /// Evaluates the next candidate, or reads its result, and returns its objective.
    pub(super) fn add(
        &mut self,
        controller: &BuiltInController,
        set: &ScoringSet,
        folder: &RunFolder,
    ) -> Result<f64, TuneError> {
        let score = match self.earlier_score(controller, folder)? {
            Some(score) => score,
            None => {
                let score = self.score(controller, set)?;
                self.write(&score, folder)?;
                score
            }
        };
        let objective = score.objective;
        self.candidates.push(score);
        Ok(objective)
    }

    /// Returns the result of the next candidate by an earlier process.
    fn earlier_score(
        &self,
        controller: &BuiltInController,
        folder: &RunFolder,
    ) -> Result<Option<ControllerScore>, RunFolderError> {
        match self.earlier.get(self.candidates.len()) {
            Some(earlier) if earlier.controller != controller.to_arg() => {
                let line = self.candidates.len() + 1;
                let problem = format!("line {line} is not the candidate of this tuning");
                Err(RunFolderError::damaged(&folder.path(CANDIDATES), problem))
            }
            earlier => Ok(earlier.cloned()),
        }
    }

    /// Evaluates a candidate, unless an equal one was evaluated.
    fn score(
        &self,
        controller: &BuiltInController,
        set: &ScoringSet,
    ) -> Result<ControllerScore, TuneError> {
        let name = controller.to_arg();
        let equal = self
            .candidates
            .iter()
            .find(|candidate| candidate.controller == name);
        match equal {
            Some(equal) => Ok(equal.clone()),
            None => Ok(set.score(controller)?),
        }
    }

    fn write(&mut self, score: &ControllerScore, folder: &RunFolder) -> Result<(), RunFolderError> {
        let line = serde_json::to_string(score)
            .map_err(|error| RunFolderError::encoding(CANDIDATES, error))?;
        self.text += &line;
        self.text.push('\n');
        folder.write(CANDIDATES, self.text.as_str())
    }
}
