//! Specifications of a controller, and the robustness of a run.

use std::fmt;
use std::str::FromStr;

use super::stl::{
    Formula, FormulaParseError, FormulaPart, MIN_VIOLATION, MonitorError, SignalsError,
    motion_signal_names, motion_signals, signal_column,
};
use super::{CollisionRole, DrivingRule};
use crumple_sim::engine::{
    AfterCollision, Outcome, RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate,
};
use crumple_sim::scenario::{Scenario, VehicleClass};

/// A requirement of every run.
///
/// ```
/// use crumple_sim::control::BuiltInController;
/// use crumple_measure::Specification;
/// use crumple_sim::scenario::built_in_scenario;
/// use crumple_sim::engine::RunOptions;
///
/// let scenario = built_in_scenario("paper-1").unwrap();
/// let headway = Specification::parse("always v1.time_gap_s > 0.3", &scenario).unwrap();
/// let options = RunOptions::new(BuiltInController::from_name("idm").unwrap());
/// assert!(!headway.evaluate_scenario(&scenario, options).unwrap().is_violation());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Specification {
    /// No collision. Robustness is the smallest gap between successive vehicles, in metres, or the negative impact
    /// speed of the first collision, in m/s, so that searches have a slope on both sides.
    NoCollision,
    /// A formula over the signals of a run, which continues after collisions: colliding vehicles stick together.
    Formula(Formula),
    /// A rule for the vehicles under test, independent of collisions.
    DrivingRule(DrivingRule),
}

/// An error of a specification.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SpecificationError {
    /// A text that does not parse.
    #[error(transparent)]
    Parse(#[from] FormulaParseError),
    /// A text that is neither a rule nor a formula with a comparison, such as a misspelt rule.
    #[error(
        "{formula}. Other specifications: `{}`, {}",
        Specification::NO_COLLISION,
        DrivingRule::EXAMPLES.map(|rule| format!("`{rule}`")).join(", ")
    )]
    UnknownRule {
        /// Error of the text as a formula.
        formula: FormulaParseError,
    },
    /// A formula that cannot be evaluated.
    #[error(transparent)]
    Monitor(#[from] MonitorError),
    /// Signals that cannot be collected.
    #[error(transparent)]
    Signals(#[from] SignalsError),
    /// A signal that a run does not have.
    #[error("column {column}: there is no signal `{name}`; there are: {}", known.join(", "))]
    UnknownSignal {
        /// Column of its first use, in characters from 1.
        column: usize,
        /// Name in the formula.
        name: String,
        /// Existing names.
        known: Vec<String>,
    },
    /// A formula that refers to times after the end of the run.
    #[error("the formula needs {horizon_s} s, and runs last {duration_s} s")]
    HorizonTooLong {
        /// Horizon of the formula, in seconds.
        horizon_s: f64,
        /// Duration of runs, in seconds.
        duration_s: f64,
    },
    /// A scenario that cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A run without a trace.
    #[error("the run has no trace")]
    NoTrace,
    /// A formula whose parts need too much memory.
    #[error("the parts of the formula have {values} values, more than {MAX_PART_VALUES}")]
    TooManyParts {
        /// Number of parts times samples.
        values: usize,
    },
}

/// Verdict of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunVerdict {
    /// Robustness; below 0 if and only if the specification is violated.
    pub robustness: f64,
    /// First collision, if there was one.
    pub collision: Option<FirstCollision>,
    /// Time of a controller failure, in seconds, and index of its vehicle. The run then violates every specification,
    /// with a robustness of negative infinity. In a comparison with a partner run, a failure with non-negative
    /// robustness is that of the partner's controller.
    pub failure: Option<(f64, u32)>,
}

impl RunVerdict {
    /// Creates the verdict of a run without collision and without failure.
    #[must_use]
    pub fn new(robustness: f64) -> Self {
        Self {
            robustness,
            collision: None,
            failure: None,
        }
    }

    /// Returns true if the specification is violated.
    #[must_use]
    pub fn is_violation(&self) -> bool {
        self.robustness < 0.0
    }
}

/// First collision of a run, with the data that distinguishes failures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstCollision {
    /// Time, in seconds.
    pub time_s: f64,
    /// Index of the vehicle that is hit.
    pub front_vehicle: u32,
    /// Index of the vehicle that hits it.
    pub rear_vehicle: u32,
    /// Difference of their speeds, in m/s.
    pub impact_speed_mps: f64,
    /// Hardest braking before the collision, of the vehicle under test among the two.
    pub ego_braking: BrakingLevel,
    /// Class of the vehicle that hits.
    pub rear_class: VehicleClass,
}

/// Hardest braking of a vehicle, relative to its limit on the road.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum BrakingLevel {
    /// Below a tenth of the limit.
    None = 0,
    /// From a tenth to 95 % of the limit.
    Partial = 1,
    /// At least 95 % of the limit: an emergency brake has fired.
    Full = 2,
}

impl BrakingLevel {
    /// All levels, by number.
    pub const ALL: [Self; 3] = [Self::None, Self::Partial, Self::Full];

    /// Returns the name in logs.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Partial => "partial",
            Self::Full => "full",
        }
    }

    fn new(hardest_mps2: f64, usable_mps2: f64) -> Self {
        match hardest_mps2 / usable_mps2 {
            share if share < 0.1 => Self::None,
            share if share < 0.95 => Self::Partial,
            _ => Self::Full,
        }
    }
}

/// Maximum number of values that [`Specification::parts_over_time`] returns.
const MAX_PART_VALUES: usize = 20_000_000;

impl Specification {
    /// Name of the default specification.
    pub const NO_COLLISION: &str = "no collision";
    /// Name of the default specification up to version 0.3.0, which is still read.
    pub const LEGACY_NO_COLLISION: &str = "no contact";

    /// Parses `no collision`, a rule as in [`DrivingRule::EXAMPLES`], or a formula.
    ///
    /// # Errors
    /// [`SpecificationError`] for text that does not parse, names a signal that runs of `nominal` do not have, or
    /// refers to times after their end.
    pub fn parse(text: &str, nominal: &Scenario) -> Result<Self, SpecificationError> {
        let specification = text.parse()?;
        let Self::Formula(formula) = &specification else {
            return Ok(specification);
        };
        let signals = motion_signal_names(nominal.vehicles().len());
        if let Some(name) = formula
            .signal_names()
            .into_iter()
            .find(|name| !signals.iter().any(|signal| signal == name))
        {
            let column = signal_column(text, name).unwrap_or(1);
            return Err(SpecificationError::UnknownSignal {
                column,
                name: name.to_owned(),
                known: signals,
            });
        }
        // A window without an end is clipped to the run. A stated end must lie within the run.
        let horizon_s = formula.stated_horizon_s();
        let duration_s = nominal.spec().duration_s;
        if horizon_s > duration_s {
            return Err(SpecificationError::HorizonTooLong {
                horizon_s,
                duration_s,
            });
        }
        Ok(specification)
    }

    /// Returns a warning if a part of a formula is evaluated only at the first sample.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        if let Self::Formula(formula) = self {
            formula.warning()
        } else {
            None
        }
    }

    /// Returns the number of vehicles in runs that have all signals of a formula; 0 for other specifications.
    #[must_use]
    pub fn vehicle_count(&self) -> usize {
        match self {
            Self::Formula(formula) => formula.vehicle_count(),
            Self::NoCollision | Self::DrivingRule(_) => 0,
        }
    }

    /// Returns true for a formula or a rule about a vehicle behind vehicle `index`.
    #[must_use]
    pub fn is_about_vehicle_behind(&self, index: usize) -> bool {
        match self {
            Self::Formula(_) => self.vehicle_count() > index + 1,
            Self::DrivingRule(rule) => matches!(rule, DrivingRule::InducedBraking { .. }),
            Self::NoCollision => false,
        }
    }

    /// Returns the recording level that [`Self::evaluate`] needs.
    #[must_use]
    pub fn recording_level(&self) -> RecordingLevel {
        match self {
            Self::NoCollision => RecordingLevel::Summary,
            Self::Formula(_) | Self::DrivingRule(_) => RecordingLevel::Trace,
        }
    }

    /// Returns the required behaviour after a collision.
    #[must_use]
    pub fn after_collision(&self) -> AfterCollision {
        match self {
            Self::NoCollision => AfterCollision::Stop,
            Self::Formula(_) | Self::DrivingRule(_) => AfterCollision::Continue,
        }
    }

    /// Runs a scenario as the specification needs, to the first collision or beyond it, and returns the verdict.
    ///
    /// # Errors
    /// [`SpecificationError`] if the scenario cannot be run with these options, or a formula does not fit it.
    pub fn evaluate_scenario(
        &self,
        scenario: &Scenario,
        options: RunOptions,
    ) -> Result<RunVerdict, SpecificationError> {
        let run = Run::new(
            scenario,
            options.with_after_collision(self.after_collision()),
        )?;
        self.evaluate(&run, &simulate(&run, self.recording_level()))
    }

    /// Returns the verdict of a run with [`Self::recording_level`] and [`Self::after_collision`].
    ///
    /// # Errors
    /// [`SpecificationError`] if a formula does not fit the run.
    pub fn evaluate(
        &self,
        run: &Run,
        result: &SimulationResult,
    ) -> Result<RunVerdict, SpecificationError> {
        let robustness = match (self, &result.outcome) {
            (_, Outcome::ControllerFailed(_)) => f64::NEG_INFINITY,
            (Self::NoCollision, Outcome::Collision(collision)) => {
                -collision.impact_speed_mps.max(MIN_VIOLATION)
            }
            (Self::NoCollision, Outcome::NoCollision) => {
                let gaps = result
                    .vehicles
                    .iter()
                    .filter_map(|vehicle| vehicle.min_gap_m);
                // Rounding must not make a gap of zero a collision.
                gaps.fold(f64::INFINITY, f64::min).max(0.0)
            }
            (Self::Formula(formula), _) => {
                let trace = result.trace.as_ref().ok_or(SpecificationError::NoTrace)?;
                let signals = motion_signals(trace, run.dt_s(), &formula.signal_names())?;
                formula
                    .decided_robustness(&signals, 1)?
                    .first()
                    .copied()
                    .unwrap_or(f64::NAN)
            }
            (Self::DrivingRule(rule), _) => rule
                .robustness(run.scenario(), result)
                .ok_or(SpecificationError::NoTrace)?,
        };
        let failed = result.outcome.failed_controller();
        Ok(RunVerdict {
            robustness,
            collision: first_collision(run, result),
            failure: failed.map(|failed| (failed.time_s, failed.vehicle as u32)),
        })
    }

    /// Returns the parts of a formula and their robustness over time, one sample per time step of the run; nothing for
    /// other specifications.
    ///
    /// # Errors
    /// [`SpecificationError`] if the formula does not fit the run.
    pub fn parts_over_time(
        &self,
        run: &Run,
        result: &SimulationResult,
    ) -> Result<Vec<FormulaPart>, SpecificationError> {
        let Self::Formula(formula) = self else {
            return Ok(Vec::new());
        };
        let trace = result.trace.as_ref().ok_or(SpecificationError::NoTrace)?;
        let values = formula.part_count() * trace.time_s.len();
        if values > MAX_PART_VALUES {
            return Err(SpecificationError::TooManyParts { values });
        }
        Ok(
            formula.parts_over_time(&motion_signals(
                trace,
                run.dt_s(),
                &formula.signal_names(),
            )?)?,
        )
    }
}

fn first_collision(run: &Run, result: &SimulationResult) -> Option<FirstCollision> {
    let collision = result.outcome.collision()?;
    let scenario = run.scenario();
    // Of two vehicles under test, the one that hits.
    let ego = match CollisionRole::new(collision, scenario) {
        CollisionRole::HitFromBehind | CollisionRole::HitByRecording => collision.front_vehicle,
        CollisionRole::Hits | CollisionRole::Bystander => collision.rear_vehicle,
    };
    let hardest_mps2 = match &result.trace {
        None => result
            .vehicles
            .get(ego)
            .map_or(0.0, |vehicle| vehicle.max_brake_mps2),
        Some(trace) => {
            let before = trace
                .time_s
                .partition_point(|&time_s| time_s < collision.time_s);
            let accelerations = trace
                .vehicles
                .get(ego)
                .map(|track| &track.acceleration_mps2);
            accelerations
                .into_iter()
                .flatten()
                .take(before)
                .fold(0.0, |hardest: f64, accel| hardest.max(-accel))
        }
    };
    Some(FirstCollision {
        time_s: collision.time_s,
        front_vehicle: collision.front_vehicle as u32,
        rear_vehicle: collision.rear_vehicle as u32,
        impact_speed_mps: collision.impact_speed_mps,
        ego_braking: BrakingLevel::new(hardest_mps2, scenario.usable_brake_mps2(ego)),
        rear_class: scenario
            .vehicles()
            .get(collision.rear_vehicle)
            .map_or(VehicleClass::Light, |v| v.class),
    })
}

/// Reads a specification of any scenario: its signals may not exist.
impl FromStr for Specification {
    type Err = SpecificationError;

    fn from_str(text: &str) -> Result<Self, SpecificationError> {
        if [Self::NO_COLLISION, Self::LEGACY_NO_COLLISION].contains(&text) {
            return Ok(Self::NoCollision);
        }
        if let Ok(conduct) = text.parse() {
            return Ok(Self::DrivingRule(conduct));
        }
        text.parse()
            .map(Self::Formula)
            .map_err(|formula| match text.contains(['<', '>']) {
                true => SpecificationError::Parse(formula),
                false => SpecificationError::UnknownRule { formula },
            })
    }
}

impl fmt::Display for Specification {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoCollision => out.write_str(Self::NO_COLLISION),
            Self::Formula(formula) => formula.fmt(out),
            Self::DrivingRule(conduct) => conduct.fmt(out),
        }
    }
}
