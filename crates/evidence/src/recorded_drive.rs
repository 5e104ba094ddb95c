//! A recorded drive of a file: the checks that make a scenario one, and its measures.

use std::path::PathBuf;

use crumple_core::digest::sha256;
use crumple_core::field_error::FieldError;
use crumple_measure::{DriveSeries, UsefulnessMeasures};
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_sim::scenario::{
    Driver, InvalidField, LeadProfile, RecordedMotion, RecordedSpeeds, Scenario,
};

/// Largest difference of the recorded start to that of the scenario, in metres and m/s: files have three decimals.
const START_TOLERANCE: f64 = 0.01;

/// Time before the end of a drive at which the recorded speeds of the leader may end, in seconds.
const LEADER_TOLERANCE_S: f64 = 0.5;

/// Reason why a folder is no domain of drives.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DriveSetError {
    /// A file that cannot be read, or is no valid scenario; or a folder with too many files or bytes.
    #[error(transparent)]
    File(#[from] ScenarioFileError),
    /// A path that is no folder.
    #[error("{}: is no folder", path.display())]
    NoFolder {
        /// The path.
        path: PathBuf,
    },
    /// No scenario file.
    #[error("{}: holds no scenario file", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// A scenario that cannot be written as TOML, for its hash.
    #[error("{}: {source}", path.display())]
    Render {
        /// The file.
        path: PathBuf,
        /// Error of the serializer.
        source: toml::ser::Error,
    },
    /// A scenario that is no recorded drive.
    #[error("{}: {invalid}", path.display())]
    NoDrive {
        /// The file.
        path: PathBuf,
        /// Field and problem.
        invalid: FieldError<DriveProblem>,
    },
}

/// Problem of a field of a scenario that is no recorded drive.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DriveProblem {
    /// Not one vehicle under test behind another vehicle.
    #[error(
        "{found} vehicles under test that follow another one; a drive has one, as `crumple import --whole` writes"
    )]
    NotOneUnderTest {
        /// Number of vehicles under test, without the first vehicle.
        found: usize,
    },
    /// A leader that does not repeat recorded speeds.
    #[error("is `{found}`, but the leader of a recorded drive repeats `recorded` speeds")]
    Leader {
        /// Name of the driver.
        found: &'static str,
    },
    /// No recorded motion of the vehicle under test.
    #[error(
        "is missing; `crumple import --whole` writes the gaps and speeds of the recorded vehicle"
    )]
    NoMotion,
    /// Recorded motion that starts elsewhere than the vehicle.
    #[error("begins with {recorded} {unit}, but the vehicle starts with {start} {unit}")]
    Start {
        /// First recorded value.
        recorded: f64,
        /// Value of the scenario.
        start: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// Recorded motion or speeds that do not last as long as the scenario.
    #[error("lasts {recorded_s:.1} s, but the drive {duration_s:.1} s")]
    Duration {
        /// Duration of the recorded values, in seconds.
        recorded_s: f64,
        /// Duration of the scenario, in seconds.
        duration_s: f64,
    },
    /// The recorded motion of another file.
    #[error("is the motion in {}, and each drive counts once", other.display())]
    Duplicate {
        /// The other file.
        other: PathBuf,
    },
}

type FieldResult<T> = Result<T, FieldError<DriveProblem>>;

/// A drive of a folder.
#[derive(Debug, Clone)]
pub struct RecordedDrive {
    /// Path of the file.
    pub path: PathBuf,
    /// The scenario.
    pub scenario: Scenario,
    /// Index of the only vehicle under test.
    pub tested: usize,
    /// The recorded drive in the place of the vehicle under test.
    pub recorded: MeasuredDrive,
    /// Interval of the recorded motion, in seconds.
    pub(super) interval_s: f64,
}

/// Measures of a drive, of a controller or of a recorded driver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredDrive {
    /// Duration until the end or a collision, in seconds.
    pub duration_s: f64,
    /// Distance, in metres.
    pub distance_m: f64,
    /// Measures at the full time resolution.
    pub measures: UsefulnessMeasures,
    /// Hardest deceleration, in m/s².
    pub peak_brake_mps2: f64,
    /// Measures from the speeds at the recorded intervals, with accelerations averaged over half a second.
    pub sampled: UsefulnessMeasures,
}

impl MeasuredDrive {
    /// Measures a drive of which only the series is known.
    pub(super) fn from_series(series: &DriveSeries) -> Self {
        let measured = series.measure();
        Self {
            duration_s: series.duration_s(),
            distance_m: series.distance_m(),
            measures: measured.usefulness,
            peak_brake_mps2: measured.peak_brake_mps2,
            sampled: measured.usefulness,
        }
    }
}

impl RecordedDrive {
    pub(super) fn new(path: PathBuf, scenario: Scenario) -> Result<Self, DriveSetError> {
        match check(&scenario) {
            Ok(checked) => Ok(Self {
                path,
                scenario,
                tested: checked.tested,
                recorded: checked.recorded,
                interval_s: checked.interval_s,
            }),
            Err(invalid) => Err(DriveSetError::NoDrive { path, invalid }),
        }
    }

    /// Returns the name of the scenario.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.scenario.spec().name
    }

    pub(super) fn has_vehicle_behind(&self) -> bool {
        self.tested + 1 < self.scenario.vehicles().len()
    }

    /// Returns the recorded motion of the vehicle in whose place the controller drives.
    pub(super) fn motion(&self) -> Option<&RecordedMotion> {
        let vehicle = self.scenario.vehicles().get(self.tested)?;
        vehicle.recorded.as_deref()
    }

    /// Returns the drive that ends with the vehicle under test.
    pub(super) fn without_vehicle_behind(&self) -> Result<Self, InvalidField> {
        let vehicles = self.tested + 1;
        let scenario = self
            .scenario
            .edited(|spec| spec.vehicles.truncate(vehicles))?;
        Ok(Self {
            scenario,
            path: self.path.clone(),
            ..*self
        })
    }

    /// Returns a hash of the recorded motion, which two files share only if they hold one drive.
    pub(super) fn motion_identity(&self) -> String {
        let motion = self.motion().into_iter();
        let values = motion.flat_map(|motion| motion.gap_m.iter().chain(&motion.speed_mps));
        let bytes = values.flat_map(|value| value.to_le_bytes());
        sha256(bytes.collect::<Vec<u8>>())
    }

    /// Returns the error that another file holds the same drive.
    pub(super) fn duplicate_of(&self, other: PathBuf) -> DriveSetError {
        let field = format!("vehicles[{}].recorded", self.tested);
        DriveSetError::NoDrive {
            path: self.path.clone(),
            invalid: FieldError::new(field, DriveProblem::Duplicate { other }),
        }
    }
}

/// The drive in a scenario: the index of the vehicle under test, and the recorded drive in its place.
struct CheckedDrive {
    tested: usize,
    recorded: MeasuredDrive,
    interval_s: f64,
}

fn check(scenario: &Scenario) -> FieldResult<CheckedDrive> {
    let tested = find_tested(scenario)?;
    let leader = check_leader(scenario, tested - 1)?;
    let field = format!("vehicles[{tested}].recorded");
    let missing = || FieldError::new(&field, DriveProblem::NoMotion);
    let vehicle = scenario.vehicles().get(tested).ok_or_else(missing)?;
    let motion = vehicle.recorded.as_deref().ok_or_else(missing)?;
    let series = DriveSeries::recorded(leader, motion);
    check_duration(scenario, series.duration_s(), motion.interval_s, &field)?;
    let start_gap_m = scenario.initial_gap_m(tested).unwrap_or_default();
    check_start(&motion.gap_m, start_gap_m, "m", format!("{field}.gap_m[0]"))?;
    let speeds_at = format!("{field}.speed_mps[0]");
    check_start(&motion.speed_mps, vehicle.speed_mps, "m/s", speeds_at)?;
    Ok(CheckedDrive {
        tested,
        recorded: MeasuredDrive::from_series(&series),
        interval_s: motion.interval_s,
    })
}

/// Checks that recorded values begin where the vehicle starts.
fn check_start(values: &[f64], start: f64, unit: &'static str, field: String) -> FieldResult<()> {
    match values.first() {
        Some(&recorded) if (recorded - start).abs() > START_TOLERANCE => {
            let problem = DriveProblem::Start {
                recorded,
                start,
                unit,
            };
            Err(FieldError::new(field, problem))
        }
        _ => Ok(()),
    }
}

fn find_tested(scenario: &Scenario) -> FieldResult<usize> {
    let followers = 1..scenario.vehicles().len();
    let tested: Vec<usize> = followers
        .filter(|&index| scenario.is_under_test(index))
        .collect();
    match tested[..] {
        [tested] => Ok(tested),
        _ => Err(FieldError::new(
            "vehicles",
            DriveProblem::NotOneUnderTest {
                found: tested.len(),
            },
        )),
    }
}

/// Returns the recorded speeds of the leader.
fn check_leader(scenario: &Scenario, index: usize) -> FieldResult<&RecordedSpeeds> {
    let field = format!("vehicles[{index}].driver");
    let driver = scenario.vehicles().get(index).map(|leader| &leader.driver);
    let Some(Driver::Profile(LeadProfile::Recorded(speeds))) = driver else {
        let problem = DriveProblem::Leader {
            found: driver.map_or("", Driver::name),
        };
        return Err(FieldError::new(field, problem));
    };
    // Speeds that last longer than the drive do no harm.
    let last_s = speeds.time_s.last().copied().unwrap_or(0.0);
    let last_s = last_s.min(scenario.spec().duration_s);
    let times_at = format!("{field}.recorded.time_s");
    check_duration(scenario, last_s, LEADER_TOLERANCE_S, &times_at)?;
    Ok(speeds)
}

/// Checks that recorded values end with the scenario, up to an interval.
fn check_duration(
    scenario: &Scenario,
    recorded_s: f64,
    interval_s: f64,
    field: &str,
) -> FieldResult<()> {
    let duration_s = scenario.spec().duration_s;
    match (recorded_s - duration_s).abs() <= interval_s + 1e-6 {
        true => Ok(()),
        false => Err(FieldError::new(
            field,
            DriveProblem::Duration {
                recorded_s,
                duration_s,
            },
        )),
    }
}
