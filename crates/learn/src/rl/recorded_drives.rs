//! Recorded drives in which a policy must be useful.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::config::TrainingConfig;
use super::config_error::TrainingConfigError;
use super::usefulness::{ComparedOutcome, compare_with_idm};
use crumple_evidence::drives::{DriveRun, DriveSet};
use crumple_sim::control::{BuiltInController, IntoSource};
use crumple_sim::engine::{RecordingLevel, Run, RunError, RunOptions, simulate_batch};
use crumple_sim::observation::EstimatorKind;

/// Result of a controller in recorded drives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedUsefulness {
    /// Number of drives.
    pub drive_count: u64,
    /// Drives in which this controller has a fault, and `idm` has none: a collision that counts against it,
    /// unnecessary braking, braking above 4 m/s² whose cause required less than 3 m/s², or falling behind.
    pub faults: u64,
    /// RMS of jerk over all drives, relative to that of `idm`.
    pub jerk_times_idm: f64,
}

/// The result of `idm`, and of any controller without drives.
impl Default for RecordedUsefulness {
    fn default() -> Self {
        Self {
            drive_count: 0,
            faults: 0,
            jerk_times_idm: 1.0,
        }
    }
}

/// Recorded drives, with the results of `idm` in them.
#[derive(Debug, Clone)]
pub(crate) struct RecordedBenchmark {
    drives: Arc<DriveSet>,
    idm: Vec<ComparedOutcome>,
}

impl RecordedBenchmark {
    pub(crate) fn new(drives: Arc<DriveSet>, estimator: EstimatorKind) -> Result<Self, RunError> {
        let idm = BuiltInController::Idm(Default::default()).into_source();
        let options = RunOptions::new(idm).with_estimator(estimator);
        Ok(Self {
            idm: drive_all(&drives, &options)?,
            drives,
        })
    }

    pub(crate) fn evaluate(&self, options: &RunOptions) -> Result<RecordedUsefulness, RunError> {
        let outcomes = drive_all(&self.drives, options)?;
        let (faults, jerk_times_idm) = compare_with_idm(&outcomes, &self.idm);
        Ok(RecordedUsefulness {
            drive_count: outcomes.len() as u64,
            faults,
            jerk_times_idm,
        })
    }
}

/// Simulates a controller once in each drive.
fn drive_all(drives: &DriveSet, options: &RunOptions) -> Result<Vec<ComparedOutcome>, RunError> {
    let mut outcomes = Vec::new();
    for batch in drives.batches() {
        let runs = batch
            .iter()
            .map(|drive| Run::new(&drive.scenario, options.clone()))
            .collect::<Result<Vec<_>, _>>()?;
        outcomes.extend(simulate_batch(
            &runs,
            RecordingLevel::Trace,
            |index, result| {
                let run = DriveRun::new(&batch[index], &result);
                ComparedOutcome::new(run.end.is_failure(), Some(run.drive.measures))
            },
        ));
    }
    Ok(outcomes)
}

impl TrainingConfig {
    /// Loads the drives of the evaluation; none if it has none.
    ///
    /// # Errors
    /// [`TrainingConfigError::Field`] if they cannot be read, or are not the drives of the stated SHA-256.
    pub fn load_drives(&self) -> Result<Option<Arc<DriveSet>>, TrainingConfigError> {
        let error = |problem: String| TrainingConfigError::field("evaluation.drives", problem);
        let evaluation = &self.evaluation;
        let Some(folder) = &evaluation.drives else {
            return Ok(None);
        };
        let drives = DriveSet::load(Path::new(folder), &self.controllers)
            .map_err(|problem| error(problem.to_string()))?;
        match &evaluation.drives_sha256 {
            Some(stated) if stated != drives.identity() => Err(error(format!(
                "{folder}: the drives have the SHA-256 {}, not {stated}",
                drives.identity()
            ))),
            _ => Ok(Some(Arc::new(drives))),
        }
    }

    /// Adds the SHA-256 of the drives of the evaluation, if it has drives.
    ///
    /// # Errors
    /// [`TrainingConfigError::Field`], for the reasons of [`Self::load_drives`].
    pub fn state_drives(&mut self) -> Result<(), TrainingConfigError> {
        let drives = self.load_drives()?;
        self.evaluation.drives_sha256 = drives.map(|drives| drives.identity().to_owned());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A preset states its drives; other drives, and drives without a comparison with `idm`, are refused.
    #[test]
    fn drives_of_a_preset_are_stated_and_checked() {
        let mut config = TrainingConfig::preset("road").unwrap();
        config.state_drives().unwrap();
        assert_eq!(config, TrainingConfig::preset("road").unwrap());
        config.evaluation.drives_sha256 = Some("0".repeat(64));
        let problem = "evaluation.drives_sha256: needs evaluation.drives";
        assert_eq!(config.check().unwrap_err().to_string(), problem);
        config.evaluation.drives = Some("missing".to_owned());
        config.check().unwrap();
        let problem = "evaluation.drives: missing: is no folder";
        assert_eq!(config.load_drives().unwrap_err().to_string(), problem);
        config.evaluation.usefulness_draws = 0;
        let problem = "evaluation.drives: needs evaluation.usefulness_draws of at least 1";
        assert_eq!(config.check().unwrap_err().to_string(), problem);
    }
}
