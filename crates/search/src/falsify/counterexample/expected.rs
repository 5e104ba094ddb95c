//! Recorded verdicts of scenario files and controllers, and their replay.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Avoidability, AvoidabilityClass};
use crate::falsify::evaluator::Evaluator;
use crate::falsify::{FailureCriterion, FailureCriterionRecord};
use crumple_controllers::{Controllers, UnknownController};
use crumple_core::format_version::check_version;
use crumple_core::text_file::{self, FileError};
use crumple_measure::{RunVerdict, Specification, SpecificationError};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file::{self, ScenarioFileError};

pub(crate) const EXPECTED_VERSION: u32 = 1;

/// The file [`EXPECTED_FILE_NAME`](file::EXPECTED_FILE_NAME) beside scenario files, with their recorded verdicts.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExpectedFile {
    /// Version of the format: 1.
    pub version: u32,
    /// One entry per scenario and controller.
    #[serde(default)]
    pub expected: Vec<ExpectedVerdict>,
}

/// Recorded verdict of a scenario file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExpectedVerdict {
    /// Name of the scenario file, beside this one.
    pub scenario: String,
    /// Controller under test: a built-in name, or a policy file beside this one.
    pub controller: String,
    /// Hash of the policy. A policy of the same name with another hash is another controller.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy_sha256: Option<String>,
    /// Hash of a controller that its name and policy do not identify, such as a network, a controller file or an FMU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller_sha256: Option<String>,
    /// Estimator of the vehicles under test.
    pub estimator: EstimatorKind,
    /// Specification: `no collision`, or a formula.
    pub specification: String,
    /// True if the specification is violated.
    pub violated: bool,
    /// Robustness.
    pub robustness: f64,
    /// Time of the first collision, in seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "contact_time_s")]
    pub collision_time_s: Option<f64>,
    /// Index of the vehicle that is hit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub front_vehicle: Option<u32>,
    /// Index of the vehicle that hits it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rear_vehicle: Option<u32>,
    /// True if the failure disappears at a tenth of the step.
    #[serde(default)]
    pub dt_fragile: bool,
    /// Class of avoidability.
    #[serde(default)]
    pub avoidable: AvoidabilityClass,
    /// Smallest gap of the best escape found, in metres, if avoidable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_min_gap_m: Option<f64>,
    /// Reason, if undecided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub undecided_because: Option<String>,
    /// Additional condition. Without it a violation does not count, and the robustness is not negative.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "contrast")]
    pub failure_criterion: Option<FailureCriterionRecord>,
}

/// Result of a replay, and its agreement with the record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayResult {
    /// Verdict at the scenario's step.
    pub nominal: RunVerdict,
    /// Verdict at a tenth of the step.
    pub finer: RunVerdict,
    /// True if the replay agrees with the record. The nominal verdict must have the recorded violation, vehicles and
    /// time of the collision (within a millisecond). The finer verdict must have the recorded violation and vehicles,
    /// or differ in them if the record is `dt_fragile`.
    pub as_recorded: bool,
}

/// An error of replaying a recorded verdict.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// The scenario cannot be read.
    #[error(transparent)]
    Scenario(#[from] ScenarioFileError),
    /// The recorded verdicts cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The controller is unknown.
    #[error(transparent)]
    Controller(#[from] UnknownController),
    /// The controller differs from the recorded one.
    #[error(
        "{scenario}: the recorded controller is not available: its SHA-256 is {expected}, and `{controller}` has \
         {found}"
    )]
    OtherController {
        /// Name of the scenario file.
        scenario: String,
        /// Name of the controller.
        controller: String,
        /// Recorded hash.
        expected: String,
        /// Actual hash.
        found: String,
    },
    /// No folder has the file of the controller.
    #[error("there is no such file in {}", describe_folders(folders))]
    MissingController {
        /// Folders that were searched; an empty path is the current folder.
        folders: Vec<PathBuf>,
    },
    /// The simulation or the specification failed.
    #[error(transparent)]
    Specification(#[from] SpecificationError),
}

fn describe_folders(folders: &[PathBuf]) -> String {
    let names: Vec<_> = folders
        .iter()
        .map(|folder| match folder.as_os_str().is_empty() {
            true => "the current folder".to_owned(),
            false => folder.display().to_string(),
        })
        .collect();
    names.join(", ")
}

impl ExpectedFile {
    /// Reads the recorded verdicts of a folder, from the file with the earlier name if there is no other.
    ///
    /// # Errors
    /// [`FileError`] for a file that cannot be read or parsed.
    pub fn load_from_folder(folder: &Path) -> Result<Self, FileError> {
        let earlier = folder.join(file::LEGACY_EXPECTED_FILE_NAME);
        let path = folder.join(file::EXPECTED_FILE_NAME);
        Self::load(if !path.exists() && earlier.exists() {
            &earlier
        } else {
            &path
        })
    }

    /// Reads recorded verdicts.
    ///
    /// # Errors
    /// [`FileError`] for a file that cannot be read or parsed.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let text = text_file::read(path)?;
        let file: Self = text_file::parse_toml(&text, path)?;
        check_version(file.version, EXPECTED_VERSION).map_err(|unsupported| FileError::Syntax {
            path: path.to_owned(),
            line: text_file::line_in_toml(&text, "version"),
            message: format!("version: {unsupported}"),
        })?;
        Ok(file)
    }
}

impl ExpectedVerdict {
    /// Replays the scenario from its file, which is in `folder`.
    ///
    /// # Errors
    /// [`ReplayError`] if a file cannot be read, a controller is unknown or not the recorded one, or the simulation or
    /// the specification fails.
    pub fn replay(
        &self,
        folder: &Path,
        controllers: Controllers,
    ) -> Result<ReplayResult, ReplayError> {
        let scenario = file::load(&folder.join(&self.scenario), &controllers)?;
        let controller = self.find_controller(folder, controllers)?;
        let criterion = self.resolve_criterion(folder, controllers)?;
        let specification = Specification::parse(&self.specification, &scenario)?;
        let evaluator = Evaluator {
            specification: &specification,
            controller: &controller,
            estimator: self.estimator,
            failure_criterion: criterion.as_ref(),
        };
        let nominal = evaluator.evaluate(&scenario, 1)?;
        let finer = evaluator.evaluate(&scenario, FINER_STEP_DIVISOR)?;
        Ok(ReplayResult {
            nominal,
            finer,
            as_recorded: self.agrees_in_failure(&nominal)
                && self.agrees_in_time(&nominal)
                && self.agrees_in_failure(&finer) != self.dt_fragile,
        })
    }

    /// Resolves the additional condition, and checks that its controller is the recorded one.
    fn resolve_criterion(
        &self,
        folder: &Path,
        controllers: Controllers,
    ) -> Result<Option<FailureCriterion>, ReplayError> {
        let criterion = self
            .failure_criterion
            .as_ref()
            .map(|record| record.resolve(folder, controllers))
            .transpose()?;
        if let (
            Some(FailureCriterion::Differential(partner)),
            Some(FailureCriterionRecord::Differential {
                policy_sha256,
                controller_sha256,
                ..
            }),
        ) = (&criterion, &self.failure_criterion)
        {
            self.check_identity(partner, policy_sha256.as_ref(), controller_sha256.as_ref())?;
        }
        Ok(criterion)
    }

    /// Returns true if a verdict has the recorded violation and vehicles.
    fn agrees_in_failure(&self, verdict: &RunVerdict) -> bool {
        let vehicles = verdict
            .collision
            .map(|collision| (collision.front_vehicle, collision.rear_vehicle));
        (verdict.robustness < 0.0) == self.violated
            && vehicles == self.front_vehicle.zip(self.rear_vehicle)
    }

    /// Returns true if the collision of a verdict is within a millisecond of the recorded one.
    fn agrees_in_time(&self, verdict: &RunVerdict) -> bool {
        match (verdict.collision, self.collision_time_s) {
            (Some(collision), Some(time_s)) => (collision.time_s - time_s).abs() < 1e-3,
            (None, None) => true,
            _ => false,
        }
    }

    /// Finds the controller of the verdict. Relative paths start at `folder`.
    ///
    /// # Errors
    /// [`ReplayError`] if the controller is unknown or not the recorded one.
    pub fn find_controller(
        &self,
        folder: &Path,
        controllers: Controllers,
    ) -> Result<NamedController, ReplayError> {
        let controller = controllers.find(&self.controller, folder)?;
        self.check_identity(
            &controller,
            self.policy_sha256.as_ref(),
            self.controller_sha256.as_ref(),
        )?;
        Ok(controller)
    }

    /// Checks that a controller has the recorded hashes. Records of earlier versions omit the hash of a network.
    fn check_identity(
        &self,
        controller: &NamedController,
        policy_sha256: Option<&String>,
        controller_sha256: Option<&String>,
    ) -> Result<(), ReplayError> {
        let policy_hashes = policy_sha256.map(|expected| {
            let actual = controller.policy().map(|policy| policy.digest());
            (expected, actual)
        });
        let controller_hashes =
            controller_sha256.map(|expected| (expected, controller.disambiguating_hash()));
        for (expected, actual) in policy_hashes.into_iter().chain(controller_hashes) {
            let actual = actual.unwrap_or_default();
            if *expected != actual {
                return Err(ReplayError::OtherController {
                    scenario: self.scenario.clone(),
                    controller: controller.name.clone(),
                    expected: expected.clone(),
                    found: actual,
                });
            }
        }
        Ok(())
    }
}

impl ExpectedVerdict {
    /// Returns a new record of this scenario and controller, with a new avoidability analysis of a collision.
    ///
    /// # Errors
    /// [`ReplayError`] if a file cannot be read, a controller is unknown, or the simulation or the specification fails.
    pub fn renew(&self, folder: &Path, controllers: Controllers) -> Result<Self, ReplayError> {
        let scenario = file::load(&folder.join(&self.scenario), &controllers)?;
        let controller = controllers.find(&self.controller, folder)?;
        let policy_sha256 = controller.policy().map(|policy| policy.digest());
        let controller_sha256 = controller.disambiguating_hash();
        let specification = Specification::parse(&self.specification, &scenario)?;
        let criterion = self
            .failure_criterion
            .as_ref()
            .map(|record| record.resolve(folder, controllers))
            .transpose()?;
        let criterion = criterion.as_ref().map(FailureCriterion::to_record);
        let mut renewed = Self {
            policy_sha256,
            controller_sha256,
            failure_criterion: criterion,
            dt_fragile: false,
            ..self.clone()
        };
        let verdict = renewed.replay(folder, controllers)?.nominal;
        let violated = verdict.robustness < 0.0;
        let class = Avoidability::classify(&specification, &verdict, &scenario);
        renewed = Self {
            violated,
            robustness: verdict.robustness,
            collision_time_s: verdict.collision.map(|collision| collision.time_s),
            front_vehicle: verdict.collision.map(|collision| collision.front_vehicle),
            rear_vehicle: verdict.collision.map(|collision| collision.rear_vehicle),
            avoidable: class.class(),
            best_min_gap_m: class.best_min_gap_m(),
            undecided_because: class.undecided_because().map(str::to_owned),
            ..renewed
        };
        // All other fields agree with the replay by now, so `as_recorded` is false only if the finer step differs.
        renewed.dt_fragile = !renewed.replay(folder, controllers)?.as_recorded;
        Ok(renewed)
    }
}

/// Divisor of the scenario's step. A failure that disappears at this finer step is `dt_fragile`.
pub(super) const FINER_STEP_DIVISOR: u32 = 10;
