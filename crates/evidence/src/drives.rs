//! Recorded drives as a domain: a controller drives each of them once.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crumple_core::digest::sha256;
use crumple_core::observer::{Observer, ProgressCounter, RunProgress, Stopped};
use crumple_measure::{CollisionRole, DriveSeries, UsefulnessMeasures, is_far_behind};
use crumple_sim::engine::{
    Collision, FailedController, RecordingLevel, Run, RunError, RunOptions, SimulationResult,
    simulate_batch,
};
use crumple_sim::scenario::file;
use crumple_sim::scenario::{InvalidField, OpenDriver, Scenario};

pub use super::recorded_drive::{DriveProblem, DriveSetError, MeasuredDrive, RecordedDrive};

/// Number of steps times vehicles that are simulated together; their traces take 200 MB.
const MAX_TOGETHER: usize = 8_000_000;

/// All drives of a folder, in the order of their names.
#[derive(Debug, Clone)]
pub struct DriveSet {
    drives: Vec<RecordedDrive>,
    identity: String,
}

/// Reason why drives cannot be simulated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DriveError {
    /// A controller that cannot drive in a scenario.
    #[error("{}: {source}", path.display())]
    Run {
        /// File of the drive.
        path: PathBuf,
        /// Problem of the controller.
        source: RunError,
    },
    /// A drive that is no valid scenario without the vehicle behind.
    #[error("{}: {source}", path.display())]
    Scenario {
        /// File of the drive.
        path: PathBuf,
        /// Invalid field.
        source: InvalidField,
    },
    /// The observer stopped the drives.
    #[error("the drives were {0}")]
    Stopped(#[from] Stopped),
}

impl DriveSet {
    /// Reads the scenario files of a folder.
    ///
    /// # Errors
    /// [`DriveSetError`] for a folder without drives, for a file that is no recorded drive of one vehicle, and for two
    /// files with the same drive. A folder may have [`file::MAX_FILES`] files and [`file::MAX_FOLDER_BYTES`] bytes.
    pub fn load(folder: &Path, opener: &dyn OpenDriver) -> Result<Self, DriveSetError> {
        if !folder.is_dir() {
            return Err(DriveSetError::NoFolder {
                path: folder.to_owned(),
            });
        }
        let files = file::load_all(folder, opener)?;
        if files.is_empty() {
            return Err(DriveSetError::Empty {
                path: folder.to_owned(),
            });
        }
        let mut digests = String::new();
        let mut drives = Vec::with_capacity(files.len());
        let mut paths_by_motion = BTreeMap::new();
        for (path, scenario) in files {
            match file::to_toml(&scenario) {
                Ok(text) => digests += &sha256(text),
                Err(source) => return Err(DriveSetError::Render { path, source }),
            }
            let drive = RecordedDrive::new(path, scenario)?;
            if let Some(other) = paths_by_motion.insert(drive.motion_identity(), drive.path.clone())
            {
                return Err(drive.duplicate_of(other));
            }
            drives.push(drive);
        }
        Ok(Self {
            drives,
            identity: sha256(digests),
        })
    }

    /// Returns the drives, in the order of their names.
    #[must_use]
    pub fn drives(&self) -> &[RecordedDrive] {
        &self.drives
    }

    /// Returns a SHA-256 of all scenarios.
    #[must_use]
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Iterates over the recorded drives in the places of the vehicles under test.
    pub fn recorded(&self) -> impl Iterator<Item = &MeasuredDrive> + Clone {
        self.drives.iter().map(|drive| &drive.recorded)
    }

    /// Returns the number of drives whose last vehicle is under test.
    #[must_use]
    pub fn without_vehicle_behind(&self) -> usize {
        let ends_under_test = |drive: &&RecordedDrive| !drive.has_vehicle_behind();
        self.drives.iter().filter(ends_under_test).count()
    }

    /// Returns the number of drives whose recorded vehicle is too far behind its leader to follow it.
    #[must_use]
    pub fn far_behind_leader(&self) -> usize {
        let motions = self.drives.iter().filter_map(RecordedDrive::motion);
        motions.filter(|motion| is_far_behind(motion)).count()
    }

    /// Returns the number of simulations of [`Self::run`].
    #[must_use]
    pub fn run_count(&self) -> u64 {
        (2 * self.drives.len() - self.without_vehicle_behind()) as u64
    }

    /// Lets the controller of `options` drive each drive once, and again without the vehicle behind where there is one:
    /// the difference is what that vehicle causes. Calls `observer` with the number of simulations.
    ///
    /// # Errors
    /// [`DriveError`] if a controller cannot drive, or the observer stops.
    pub fn run(
        &self,
        options: &RunOptions,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<DriveRuns, DriveError> {
        let counter = ProgressCounter::new(observer, Some(self.run_count()));
        let reduce = |drive: &RecordedDrive, _: &Run, simulated: &SimulationResult| {
            DriveRun::new(drive, simulated)
        };
        let driven = run_each(&self.drives, options, &counter, &reduce)?;
        let with_follower = self
            .drives
            .iter()
            .filter(|drive| drive.has_vehicle_behind());
        let shortened = with_follower
            .map(shortened)
            .collect::<Result<Vec<_>, _>>()?;
        if shortened.is_empty() {
            return Ok(DriveRuns {
                driven,
                alone: None,
            });
        }
        let mut shortened = run_each(&shortened, options, &counter, &reduce)?.into_iter();
        let runs = self.drives.iter().zip(&driven);
        let alone = runs.filter_map(|(drive, run)| match drive.has_vehicle_behind() {
            true => shortened.next(),
            false => Some(run.clone()),
        });
        Ok(DriveRuns {
            alone: Some(alone.collect()),
            driven,
        })
    }

    /// Simulates each drive once with its trace, and returns what `reduce` makes of each run.
    ///
    /// # Errors
    /// [`DriveError`] if a controller cannot drive, or the observer stops.
    pub fn run_with<R: Send>(
        &self,
        options: &RunOptions,
        observer: &dyn Observer<RunProgress>,
        reduce: &(dyn Fn(&RecordedDrive, &Run, &SimulationResult) -> R + Sync),
    ) -> Result<Vec<R>, DriveError> {
        let counter = ProgressCounter::new(observer, Some(self.drives.len() as u64));
        run_each(&self.drives, options, &counter, reduce)
    }
}

/// Returns the drive without the vehicle behind.
fn shortened(drive: &RecordedDrive) -> Result<RecordedDrive, DriveError> {
    let shortened = drive.without_vehicle_behind();
    shortened.map_err(|source| DriveError::Scenario {
        path: drive.path.clone(),
        source,
    })
}

/// Simulates drives with their traces, as many together as memory allows.
fn run_each<R: Send>(
    drives: &[RecordedDrive],
    options: &RunOptions,
    counter: &ProgressCounter<'_>,
    reduce: &(dyn Fn(&RecordedDrive, &Run, &SimulationResult) -> R + Sync),
) -> Result<Vec<R>, DriveError> {
    let mut results = Vec::with_capacity(drives.len());
    let mut rest = drives;
    while !rest.is_empty() {
        let (together, later) = rest.split_at(count_together(rest));
        let runs = together
            .iter()
            .map(|drive| drive.prepare(options))
            .collect::<Result<Vec<_>, _>>()?;
        results.extend(simulate_batch(
            &runs,
            RecordingLevel::Trace,
            |index, simulated| reduce(&together[index], &runs[index], &simulated),
        ));
        counter.add(together.len() as u64)?;
        rest = later;
    }
    Ok(results)
}

/// Returns the number of first drives that are simulated together, at least one.
fn count_together(drives: &[RecordedDrive]) -> usize {
    let mut vehicle_steps = 0;
    let fits = |drive: &&RecordedDrive| {
        vehicle_steps += drive.scenario.steps() * drive.scenario.vehicles().len();
        vehicle_steps <= MAX_TOGETHER
    };
    drives.iter().take_while(fits).count().max(1)
}

impl RecordedDrive {
    fn prepare(&self, options: &RunOptions) -> Result<Run, DriveError> {
        Run::new(&self.scenario, options.clone()).map_err(|source| DriveError::Run {
            path: self.path.clone(),
            source,
        })
    }
}

/// End of a drive of a controller.
#[derive(Debug, Clone, PartialEq)]
pub enum DriveEnd {
    /// The end of the recording.
    Complete,
    /// A collision, with the role of the vehicle under test.
    Collision(CollisionRole, Collision),
    /// The controller gave no answer.
    NoAnswer(FailedController),
}

impl DriveEnd {
    /// True if the controller is to blame: it hits the leader, is hit by a vehicle that can react, or gives no answer.
    #[must_use]
    pub fn is_failure(&self) -> bool {
        match self {
            Self::Complete => false,
            Self::Collision(role, _) => {
                matches!(role, CollisionRole::Hits | CollisionRole::HitFromBehind)
            }
            Self::NoAnswer(_) => true,
        }
    }
}

/// All drives of a controller, in the order of the set.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveRuns {
    /// The drives with the vehicles behind.
    pub driven: Vec<DriveRun>,
    /// The drives without any vehicle behind; `None` if no drive has one.
    pub alone: Option<Vec<DriveRun>>,
}

/// A drive of a controller.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveRun {
    /// Name of the scenario.
    pub name: String,
    /// End of the drive.
    pub end: DriveEnd,
    /// Measures until the end.
    pub drive: MeasuredDrive,
    /// Root mean square of the difference of the gap to the recorded gap, in metres; `None` without recorded motion.
    pub rms_spacing_error_m: Option<f64>,
}

impl DriveRun {
    /// Measures a run with its trace.
    #[must_use]
    pub fn new(drive: &RecordedDrive, simulated: &SimulationResult) -> Self {
        let RecordedDrive {
            scenario, tested, ..
        } = drive;
        let recorded = drive.motion();
        let interval_s = drive.interval_s;
        let trace = simulated.trace.as_ref();
        let series = trace
            .and_then(|trace| DriveSeries::from_trace(trace, *tested, interval_s))
            .unwrap_or_else(|| DriveSeries::empty(interval_s));
        let end_s = simulated
            .outcome
            .collision()
            .map(|collision| collision.time_s);
        let series = series.until(end_s.unwrap_or(f64::INFINITY));
        let exact = trace
            .and_then(|trace| UsefulnessMeasures::from_trace(trace, &simulated.impacts, *tested));
        let sampled = MeasuredDrive::from_series(&series);
        let summary = simulated.vehicles.get(*tested);
        Self {
            name: drive.name().to_owned(),
            end: DriveEnd::new(simulated, scenario),
            drive: MeasuredDrive {
                peak_brake_mps2: summary.map_or(0.0, |vehicle| vehicle.max_brake_mps2),
                measures: exact.unwrap_or(sampled.measures),
                ..sampled
            },
            rms_spacing_error_m: recorded
                .and_then(|motion| series.rms_gap_difference_m(&motion.gap_m)),
        }
    }
}

impl DriveEnd {
    fn new(simulated: &SimulationResult, scenario: &Scenario) -> Self {
        if let Some(failed) = simulated.outcome.failed_controller() {
            return Self::NoAnswer(failed.clone());
        }
        match simulated.outcome.collision() {
            Some(collision) => Self::Collision(CollisionRole::new(collision, scenario), *collision),
            None => Self::Complete,
        }
    }
}
