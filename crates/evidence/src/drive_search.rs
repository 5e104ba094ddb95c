//! Failures of a controller on recorded drives, the severest first.

use serde::Serialize;

use super::drive_report::{DriveReport, EventRate, exposure};
use super::drives::{DriveEnd, DriveError, DriveRun, DriveSet, RecordedDrive, RunPair};
use super::replay_report::plural;
use crumple_core::digits::format_rounded;
use crumple_core::observer::{Observer, RunProgress};
use crumple_core::quoting::TerminalText;
use crumple_measure::{Specification, SpecificationError};
use crumple_sim::engine::{Run, RunOptions, SimulationResult};

/// Maximum number of failures that the text lists.
const MAX_LISTED: usize = 20;

/// Reason why drives cannot be searched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DriveSearchError {
    /// A controller that cannot drive, or an observer that stopped.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// A specification that does not parse, or names a signal that no drive has.
    #[error(transparent)]
    Parse(#[from] SpecificationError),
    /// A formula about a vehicle that no drive has.
    #[error(
        "the formula names `v{vehicle}`, but the drives have only the vehicles `v0` to `v{last}`{}",
        describe_last(*last == *tested)
    )]
    NoSuchVehicle {
        /// Index of the vehicle.
        vehicle: usize,
        /// Largest index of a vehicle in the drives.
        last: usize,
        /// Index of the vehicle under test in these drives.
        tested: usize,
    },
    /// A formula that cannot be evaluated on a drive.
    #[error("{drive}: {source}")]
    Specification {
        /// Name of the drive.
        drive: String,
        /// Problem of the formula.
        source: SpecificationError,
    },
}

fn describe_last(is_under_test: bool) -> &'static str {
    match is_under_test {
        true => "; no drive has a vehicle behind the one under test",
        false => "",
    }
}

/// A drive in which a controller fails.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveFailure {
    /// Index in the set of drives.
    #[serde(skip)]
    pub index: usize,
    /// Name of the drive.
    pub name: String,
    /// Robustness; for collisions the negative impact speed, in m/s.
    pub robustness: f64,
    /// End of the drive, as text.
    pub description: String,
}

/// All failures of a controller on a set of drives, each of which it drove once.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveSearch {
    /// Specification that a failure violates.
    pub specification: String,
    /// Number of failures, with their rate on the drives that the specification applies to.
    pub violations: EventRate,
    /// Drives that violate it, but not without the vehicle behind. They do not count against the controller, and are no
    /// failures.
    pub violated_only_with_vehicle_behind: u64,
    /// Drives without a vehicle that the specification is about: it does not apply to them.
    pub not_applicable: u64,
    /// Drives that violate it and count against the controller, the severest first.
    pub failures: Vec<DriveFailure>,
    /// Counts of all drives.
    pub counts: DriveReport,
}

impl DriveSearch {
    /// Reads a specification of drives, of which at least one has all vehicles of a formula.
    ///
    /// # Errors
    /// [`DriveSearchError`] for text that does not parse, or a formula that fits no drive.
    pub fn parse_specification(
        text: &str,
        drives: &DriveSet,
    ) -> Result<Specification, DriveSearchError> {
        let parsed: Specification = text.parse()?;
        let Some(largest) = drives.with_most_vehicles() else {
            return Ok(parsed);
        };
        let vehicles = largest.scenario.vehicles().len();
        if parsed.vehicle_count() > vehicles {
            return Err(DriveSearchError::NoSuchVehicle {
                vehicle: parsed.vehicle_count() - 1,
                last: vehicles - 1,
                tested: largest.tested,
            });
        }
        Ok(Specification::parse(text, &largest.scenario)?)
    }

    /// Lets a controller drive each drive once, and those that fail again without the vehicle behind. Without
    /// collisions that count against it, a drive satisfies [`Specification::NoCollision`]. The violation of a formula
    /// about other vehicles than the one behind counts against it only if the drive also violates the formula without
    /// that vehicle, or ends with a collision or a missing answer that counts against it. `name` is the name of the
    /// controller, and `text` that of the specification.
    ///
    /// # Errors
    /// [`DriveSearchError`] if a drive cannot be simulated, or a formula does not fit it.
    pub fn run(
        drives: &DriveSet,
        (name, options): (&str, RunOptions),
        (text, specification): (&str, &Specification),
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Self, DriveSearchError> {
        let options = options.with_after_collision(specification.after_collision());
        let reduce = |drive: &RecordedDrive, run: &Run, simulated: &SimulationResult| {
            EvaluatedRun::new(drive, (run, simulated), specification)
        };
        let pairs =
            drives.run_twice(&options, observer, &reduce, &EvaluatedRun::needs_comparison)?;
        let evaluated = pairs.into_iter().map(RunPair::decide);
        let evaluated = evaluated.collect::<Result<Vec<_>, _>>()?;
        let count = |verdict: DriveVerdict| {
            let same = evaluated.iter().filter(|(_, other)| *other == verdict);
            same.count() as u64
        };
        let mut failures: Vec<_> = (0..)
            .zip(&evaluated)
            .filter_map(DriveFailure::new)
            .collect();
        failures.sort_by(|a, b| a.robustness.total_cmp(&b.robustness));
        let applicable = evaluated
            .iter()
            .filter(|(_, verdict)| *verdict != DriveVerdict::NotApplicable);
        let driven = exposure(applicable.map(|(run, _)| &run.drive));
        Ok(Self {
            specification: text.to_owned(),
            violations: EventRate::new(failures.len() as u64, driven),
            violated_only_with_vehicle_behind: count(DriveVerdict::CausedBehind),
            not_applicable: count(DriveVerdict::NotApplicable),
            failures,
            counts: {
                let runs: Vec<_> = evaluated.into_iter().map(|(run, _)| run).collect();
                DriveReport::new(name, &runs, drives)
            },
        })
    }

    fn notes(&self) -> String {
        let notes = [
            (
                self.violated_only_with_vehicle_behind,
                "violated only with the vehicle behind: not counted against the controller",
            ),
            (
                self.not_applicable,
                "without a vehicle that the specification is about: not evaluated",
            ),
        ];
        let shown = notes.into_iter().filter(|(count, _)| *count > 0);
        shown
            .map(|(count, note)| format!("  {count} drive{} {note}\n", plural(count)))
            .collect()
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = self.counts.to_text();
        text += &self.violations.row("failed drives");
        text += &self.notes();
        for failure in self.failures.iter().take(MAX_LISTED) {
            let line = format!("{}: {}", failure.name, failure.description);
            text += &format!(
                "    {:>9}  {}\n",
                format_rounded(failure.robustness, 3),
                TerminalText(&line)
            );
        }
        if self.failures.len() > MAX_LISTED {
            let more = self.failures.len() - MAX_LISTED;
            text += &format!("    {more} more with --format json\n");
        }
        text
    }
}

/// Verdict about a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DriveVerdict {
    Satisfied,
    /// The specification is about a vehicle that the drive does not have.
    NotApplicable,
    /// The drive violates the specification only with the vehicle behind.
    CausedBehind,
    /// The drive violates the specification, and counts against the controller.
    Failed {
        robustness: f64,
    },
}

/// A run with its robustness; `None` if the specification does not apply.
struct EvaluatedRun<'s> {
    run: DriveRun,
    specification: &'s Specification,
    robustness: Option<Result<f64, SpecificationError>>,
}

impl<'s> EvaluatedRun<'s> {
    fn new(
        drive: &RecordedDrive,
        (run, simulated): (&Run, &SimulationResult),
        specification: &'s Specification,
    ) -> Self {
        let has_vehicles = specification.vehicle_count() <= drive.scenario.vehicles().len();
        let is_about_behind = specification.is_about_vehicle_behind(drive.tested);
        let applies = has_vehicles && (drive.has_vehicle_behind() || !is_about_behind);
        let evaluate = || {
            let verdict = specification.evaluate(run, simulated)?;
            Ok(verdict.robustness)
        };
        Self {
            run: DriveRun::new(drive, simulated),
            specification,
            robustness: applies.then(evaluate),
        }
    }

    fn is_violation(&self) -> bool {
        matches!(self.robustness, Some(Ok(robustness)) if robustness < 0.0)
    }

    /// Returns true if the end of the drive counts against the controller. Rules hold until the first collision.
    fn ends_in_failure(&self) -> bool {
        match self.specification {
            Specification::NoCollision | Specification::Formula(_) => self.run.end.is_failure(),
            Specification::DrivingRule(_) => matches!(self.run.end, DriveEnd::NoAnswer(_)),
        }
    }

    /// Returns true if the drive without the vehicle behind may show that only this vehicle causes a failure.
    fn needs_comparison(&self) -> bool {
        let is_about_motion = *self.specification != Specification::NoCollision;
        let is_open = self.is_violation() && is_about_motion && !self.ends_in_failure();
        is_open || self.run.brakes_unnecessarily()
    }
}

impl RunPair<EvaluatedRun<'_>> {
    /// Decides about the drive, by the drive without the vehicle behind where that is known.
    fn decide(self) -> Result<(DriveRun, DriveVerdict), DriveSearchError> {
        let counts = self.counts_against_controller();
        let alone = self.alone.map(|alone| alone.run);
        let specification = self.run.specification;
        let run = RunPair {
            run: self.run.run,
            alone,
        };
        let run = run.compared();
        let Some(robustness) = self.run.robustness else {
            return Ok((run, DriveVerdict::NotApplicable));
        };
        let robustness = robustness.map_err(|source| DriveSearchError::Specification {
            drive: run.name.clone(),
            source,
        })?;
        let verdict = match (robustness < 0.0, specification) {
            (false, _) => DriveVerdict::Satisfied,
            (true, _) if counts => DriveVerdict::Failed { robustness },
            // A collision of other vehicles, or with one that cannot react.
            (true, Specification::NoCollision) => DriveVerdict::Satisfied,
            (true, _) => DriveVerdict::CausedBehind,
        };
        Ok((run, verdict))
    }

    /// Returns true if a violation counts against the controller.
    fn counts_against_controller(&self) -> bool {
        let is_about_motion = *self.run.specification != Specification::NoCollision;
        // Without the vehicle that it is about, a specification says nothing.
        let fails = |evaluated: &EvaluatedRun<'_>| {
            evaluated.robustness.is_none() || evaluated.is_violation()
        };
        let is_caused_behind = self.is_caused_behind(|evaluated| &evaluated.run, fails);
        self.run.ends_in_failure() || is_about_motion && !is_caused_behind
    }
}

impl DriveFailure {
    fn new((index, (run, verdict)): (usize, &(DriveRun, DriveVerdict))) -> Option<Self> {
        let DriveVerdict::Failed { robustness } = *verdict else {
            return None;
        };
        Some(Self {
            index,
            name: run.name.clone(),
            robustness,
            description: run.describe_end(),
        })
    }
}

impl DriveRun {
    /// Describes the end of the drive.
    pub(super) fn describe_end(&self) -> String {
        match &self.end {
            DriveEnd::Complete => "driven to its end".to_owned(),
            DriveEnd::Collision(_, collision) => collision.to_string(),
            DriveEnd::NoAnswer(failed) => failed.reason(),
        }
    }
}
