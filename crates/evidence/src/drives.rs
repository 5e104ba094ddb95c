//! Recorded drives as a domain: a controller drives each of them once.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crumple_core::digest::sha256;
use crumple_core::observer::{Observer, ProgressCounter, RunProgress, Stopped};
use crumple_measure::{CollisionRole, DriveSeries, UsefulnessMeasures, is_far_behind};
use crumple_sim::engine::{
    Collision, FailedController, RecordingLevel, Run, RunError, RunOptions, SimulationResult,
    Trace, simulate_batch,
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

    /// Yields the drives in groups that are small enough to be simulated together with their traces.
    pub fn batches(&self) -> impl Iterator<Item = &[RecordedDrive]> {
        batches(&self.drives)
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

    /// Returns the largest number of simulations of [`Self::run`]: if the controller fails in every drive.
    #[must_use]
    pub fn max_run_count(&self) -> u64 {
        (2 * self.drives.len() - self.without_vehicle_behind()) as u64
    }

    /// Returns the drive with the most vehicles, the first of several; `None` without drives.
    #[must_use]
    pub fn with_most_vehicles(&self) -> Option<&RecordedDrive> {
        let vehicles = |drive: &&RecordedDrive| drive.scenario.vehicles().len();
        // Of equal ones, the maximum is the last.
        self.drives.iter().rev().max_by_key(vehicles)
    }

    /// Lets the controller of `options` drive each drive once, and those with unnecessary braking again without the
    /// vehicle behind.
    ///
    /// # Errors
    /// [`DriveError`] if a controller cannot drive, or the observer stops.
    pub fn run(
        &self,
        options: &RunOptions,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Vec<DriveRun>, DriveError> {
        let reduce = |drive: &RecordedDrive, _: &Run, simulated: &SimulationResult| {
            DriveRun::new(drive, simulated)
        };
        let runs = self.run_twice(options, observer, &reduce, &DriveRun::brakes_unnecessarily)?;
        Ok(runs.into_iter().map(RunPair::compared).collect())
    }

    /// Simulates each drive once with its trace, and again without the vehicle behind, if there is one and `fails`
    /// returns true. Returns what `reduce` makes of each run. Calls `observer` with the number of simulations.
    ///
    /// # Errors
    /// [`DriveError`] if a controller cannot drive, or the observer stops.
    pub(super) fn run_twice<R: Send>(
        &self,
        options: &RunOptions,
        observer: &dyn Observer<RunProgress>,
        reduce: &(dyn Fn(&RecordedDrive, &Run, &SimulationResult) -> R + Sync),
        fails: &dyn Fn(&R) -> bool,
    ) -> Result<Vec<RunPair<R>>, DriveError> {
        let counter = ProgressCounter::new(observer, Some(self.max_run_count()));
        let driven = run_each(&self.drives, options, &counter, reduce)?;
        let runs = || self.drives.iter().zip(&driven);
        let again = runs().map(|(drive, run)| drive.has_vehicle_behind() && fails(run));
        let again: Vec<bool> = again.collect();
        let repeated = self.drives.iter().zip(&again).filter(|(_, again)| **again);
        let shortened = repeated.map(|(drive, _)| shortened(drive));
        let shortened = shortened.collect::<Result<Vec<_>, _>>()?;
        // Drives that need no second run are done.
        let done = self.drives.len() + shortened.len();
        counter.add(self.max_run_count().saturating_sub(done as u64))?;
        let mut alone = run_each(&shortened, options, &counter, reduce)?.into_iter();
        let pairs = driven.into_iter().zip(again).map(|(run, again)| RunPair {
            run,
            alone: again.then(|| alone.next()).flatten(),
        });
        Ok(pairs.collect())
    }
}

/// Results of a drive.
pub(super) struct RunPair<R> {
    /// Result with the vehicle behind, if there is one.
    pub(super) run: R,
    /// Result without it; `None` if there is none, or the drive did not fail.
    pub(super) alone: Option<R>,
}

impl<R> RunPair<R> {
    /// Returns true if the drive fails only because of the vehicle behind: without it, the same drive is complete and
    /// does not fail. Such a failure does not count against the controller.
    pub(super) fn is_caused_behind(
        &self,
        drive: impl Fn(&R) -> &DriveRun,
        fails: impl Fn(&R) -> bool,
    ) -> bool {
        let is_fine = |alone: &R| drive(alone).is_complete() && !fails(alone);
        fails(&self.run) && self.alone.as_ref().is_some_and(is_fine)
    }
}

impl RunPair<DriveRun> {
    /// Returns the run with what is known of the drive without the vehicle behind.
    pub(super) fn compared(self) -> DriveRun {
        let is_caused_behind = self.is_caused_behind(|run| run, DriveRun::brakes_unnecessarily);
        DriveRun {
            brakes_only_with_vehicle_behind: is_caused_behind,
            ..self.run
        }
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
    for together in batches(drives) {
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
    }
    Ok(results)
}

fn batches(drives: &[RecordedDrive]) -> impl Iterator<Item = &[RecordedDrive]> {
    let mut rest = drives;
    std::iter::from_fn(move || {
        let (together, later) = rest.split_at_checked(count_together(rest))?;
        rest = later;
        Some(together)
    })
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
    /// True if the end counts against the controller: it hits the leader, is hit by a vehicle that can react, or gives
    /// no answer.
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
    /// True if only the vehicle behind causes unnecessary braking: the same drive without it has none.
    pub brakes_only_with_vehicle_behind: bool,
}

impl DriveRun {
    /// False if the drive ended because the controller gave no answer.
    #[must_use]
    pub fn is_answered(&self) -> bool {
        !matches!(self.end, DriveEnd::NoAnswer(_))
    }

    /// True if the drive reached the end of the recording.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.end == DriveEnd::Complete
    }

    /// True with unnecessary braking, whatever causes it.
    #[must_use]
    pub fn brakes_unnecessarily(&self) -> bool {
        !self.drive.measures.unnecessary.is_empty()
    }

    /// Returns the number of unnecessary brakings that count against the controller, and of those that only the vehicle
    /// behind causes.
    #[must_use]
    pub fn unnecessary_by_cause(&self) -> [usize; 2] {
        let count = self.drive.measures.unnecessary.count;
        match self.brakes_only_with_vehicle_behind {
            true => [0, count],
            false => [count, 0],
        }
    }

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
        let [duration_s, distance_m] = trace
            .zip(end_s)
            .and_then(|(trace, end_s)| exposure_until(trace, *tested, end_s))
            .unwrap_or([sampled.duration_s, sampled.distance_m]);
        let summary = simulated.vehicles.get(*tested);
        Self {
            name: drive.name().to_owned(),
            end: DriveEnd::new(simulated, scenario),
            drive: MeasuredDrive {
                peak_brake_mps2: summary.map_or(0.0, |vehicle| vehicle.max_brake_mps2),
                measures: exact.unwrap_or(sampled.measures),
                duration_s,
                distance_m,
                ..sampled
            },
            rms_spacing_error_m: recorded
                .and_then(|motion| series.rms_gap_difference_m(&motion.gap_m)),
            brakes_only_with_vehicle_behind: false,
        }
    }
}

/// Returns the time in seconds and the distance in metres of a vehicle until a time of its run.
fn exposure_until(trace: &Trace, vehicle: usize, end_s: f64) -> Option<[f64; 2]> {
    let track = trace.vehicles.get(vehicle)?;
    let start_m = track.position_m.first()?;
    let after = trace.time_s.partition_point(|time_s| *time_s < end_s);
    let last_m = match track.position_m.get(after) {
        Some(first_m) if after == 0 => *first_m,
        Some(after_m) => {
            let [before_s, after_s] = [*trace.time_s.get(after - 1)?, *trace.time_s.get(after)?];
            let before_m = track.position_m.get(after - 1)?;
            before_m + (after_m - before_m) * (end_s - before_s) / (after_s - before_s)
        }
        None => *track.position_m.last()?,
    };
    Some([end_s, last_m - start_m])
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
