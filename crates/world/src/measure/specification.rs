//! What a controller must not do, and how near a run came to it.

use std::fmt;

use super::stl::{
    Formula, FormulaParseError, MonitorError, SampledSignals, SignalsError, motion_signal_names, motion_signals,
    signal_column,
};
use super::{ContactRole, DrivingRule};
use crate::scenario::{Scenario, VehicleClass};
use crate::sim::{AfterContact, Outcome, RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate};

/// What must hold in every run.
///
/// ```
/// use crumple_world::control::ControllerSpec;
/// use crumple_world::measure::Specification;
/// use crumple_world::scenario::built_in;
/// use crumple_world::sim::RunOptions;
///
/// let scenario = built_in("paper-1").unwrap();
/// let headway = Specification::parse("always v1.time_gap_s > 0.3", &scenario).unwrap();
/// let options = RunOptions::new(ControllerSpec::named("idm").unwrap());
/// assert!(!headway.judge_scenario(&scenario, options).unwrap().is_violation());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Specification {
    /// No vehicles touch. Robustness is the smallest gap between any two successive vehicles, in metres, and after a
    /// contact the negative impact speed of the first one, in m/s: a slope towards contact on one side, and towards
    /// severity on the other.
    NoContact,
    /// A formula over the signals of the run, which goes on after contacts: those that touch stick together.
    Formula(Formula),
    /// A rule for the vehicles under test, whoever touches.
    DrivingRule(DrivingRule),
}

/// Why a formula is no specification.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SpecificationError {
    /// It does not parse.
    #[error(transparent)]
    Parse(#[from] FormulaParseError),
    /// It compares nothing, as a rule misspelt does, and it is no rule.
    #[error("{formula}; nor is this `{}`, or a rule as {} are", Specification::NO_CONTACT, DrivingRule::EXAMPLES.map(|rule| format!("`{rule}`")).join(", "))]
    UnknownRule {
        /// Why it is no formula.
        formula: FormulaParseError,
    },
    /// It cannot be evaluated.
    #[error(transparent)]
    Monitor(#[from] MonitorError),
    /// Its signals cannot be collected.
    #[error(transparent)]
    Signals(#[from] SignalsError),
    /// It names a signal that a run does not have.
    #[error("column {column}: there is no signal `{name}`; there are: {}", known.join(", "))]
    UnknownSignal {
        /// Where it is first named, counted in characters from 1.
        column: usize,
        /// The name.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// It speaks of a time after the end of the runs.
    #[error("the formula looks {horizon_s} s ahead, and runs last {duration_s} s")]
    HorizonTooLong {
        /// How far it looks, in seconds.
        horizon_s: f64,
        /// How long runs last, in seconds.
        duration_s: f64,
    },
    /// The scenario cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The trace was not kept.
    #[error("the run has no trace")]
    NoTrace,
}

/// What a run was worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunVerdict {
    /// Below 0 if and only if the specification is violated.
    pub robustness: f64,
    /// The first contact, if there was one.
    pub contact: Option<FirstContact>,
    /// When a controller failed, in seconds, and the index of its vehicle; none if none did. A run with such a failure
    /// violates every specification, with a robustness of negative infinity. Beside a robustness that is not negative it is the controller
    /// of a run that this one was set against.
    pub failure: Option<(f64, u32)>,
}

impl RunVerdict {
    /// The verdict on a run without contact and without failure.
    #[must_use]
    pub fn new(robustness: f64) -> Self {
        Self { robustness, contact: None, failure: None }
    }

    /// Whether the specification is violated.
    #[must_use]
    pub fn is_violation(&self) -> bool {
        self.robustness < 0.0
    }
}

/// The first contact of a run, as far as failures are told apart by it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstContact {
    /// When, in seconds.
    pub time_s: f64,
    /// Index of the vehicle that is hit.
    pub front_vehicle: u32,
    /// Index of the vehicle that hits it.
    pub rear_vehicle: u32,
    /// Difference of their speeds, in m/s.
    pub impact_speed_mps: f64,
    /// How hard the vehicle under test among the two had braked until then.
    pub ego_braking: BrakingLevel,
    /// Class of the vehicle that hits.
    pub rear_class: VehicleClass,
}

/// How hard a vehicle braked at the hardest, relative to what it can do on the road.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum BrakingLevel {
    /// Not notably: less than a tenth.
    None = 0,
    /// In between.
    Partial = 1,
    /// Fully: at least 95 %. An emergency brake has fired.
    Full = 2,
}

impl BrakingLevel {
    /// All of them, by number.
    pub const ALL: [Self; 3] = [Self::None, Self::Partial, Self::Full];

    /// The name in logs.
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

/// A contact must have negative robustness even at an impact speed of zero.
const MIN_VIOLATION: f64 = 1e-9;

impl Specification {
    /// The name of the default specification.
    pub const NO_CONTACT: &str = "no contact";

    /// The specification in words: `no contact`, one of [`Conduct::EXAMPLES`], or a formula.
    ///
    /// # Errors
    /// [`SpecificationError`] for text that does not parse, names a signal that runs like `nominal` do not have, or looks beyond
    /// their end.
    pub fn parse(text: &str, nominal: &Scenario) -> Result<Self, SpecificationError> {
        if text == Self::NO_CONTACT {
            return Ok(Self::NoContact);
        }
        if let Ok(conduct) = text.parse() {
            return Ok(Self::DrivingRule(conduct));
        }
        let formula: Formula = text.parse().map_err(|formula| match text.contains(['<', '>']) {
            true => SpecificationError::Parse(formula),
            false => SpecificationError::UnknownRule { formula },
        })?;
        let known = motion_signal_names(nominal.vehicles().len());
        if let Some(name) = formula.signal_names().into_iter().find(|name| !known.iter().any(|k| k == name)) {
            let column = signal_column(text, name).unwrap_or(1);
            return Err(SpecificationError::UnknownSignal { column, name: name.to_owned(), known });
        }
        // A window without an end is cut at the end of the run; one that states an end means it.
        let (horizon_s, duration_s) = (formula.horizon_s(), nominal.spec().duration_s);
        if horizon_s.is_finite() && horizon_s > duration_s {
            return Err(SpecificationError::HorizonTooLong { horizon_s, duration_s });
        }
        Ok(Self::Formula(formula))
    }

    /// Returns a warning if some part of a formula is judged at the first instant only.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        match self {
            Self::Formula(formula) => formula.warning(),
            Self::NoContact | Self::DrivingRule(_) => None,
        }
    }

    /// What must be kept of a run to judge it.
    #[must_use]
    pub fn recording_level(&self) -> RecordingLevel {
        match self {
            Self::NoContact => RecordingLevel::Summary,
            Self::Formula(_) | Self::DrivingRule(_) => RecordingLevel::Trace,
        }
    }

    /// What must happen after a contact.
    #[must_use]
    pub fn after_contact(&self) -> AfterContact {
        match self {
            Self::NoContact => AfterContact::Stop,
            Self::Formula(_) | Self::DrivingRule(_) => AfterContact::Continue,
        }
    }

    /// The verdict on a scenario, run as the specification needs: to the first contact, or on after it.
    ///
    /// # Errors
    /// [`SpecificationError`] if the scenario cannot be run with these options, or a formula does not fit it.
    pub fn judge_scenario(&self, scenario: &Scenario, options: RunOptions) -> Result<RunVerdict, SpecificationError> {
        let run = Run::new(scenario, options.with_after_contact(self.after_contact()))?;
        self.judge(&run, &simulate(&run, self.recording_level()))
    }

    /// The verdict on a run that was made with [`Self::keep`] and [`Self::after_contact`].
    ///
    /// # Errors
    /// [`SpecificationError`] if a formula does not fit the run.
    pub fn judge(&self, run: &Run, result: &SimulationResult) -> Result<RunVerdict, SpecificationError> {
        let robustness = match (self, &result.outcome) {
            (_, Outcome::ControllerFailed(_)) => f64::NEG_INFINITY,
            (Self::NoContact, Outcome::Collision(contact)) => -contact.impact_speed_mps.max(MIN_VIOLATION),
            (Self::NoContact, Outcome::NoCollision) => {
                let gaps = result.vehicles.iter().filter_map(|vehicle| vehicle.min_gap_m);
                // A gap of zero would be a contact; rounding must not make it one.
                gaps.fold(f64::INFINITY, f64::min).max(0.0)
            }
            (Self::Formula(formula), _) => {
                let trace = result.trace.as_ref().ok_or(SpecificationError::NoTrace)?;
                let signals = motion_signals(trace, run.dt_s(), &formula.signal_names())?;
                judge_formula(formula, &signals)?
            }
            (Self::DrivingRule(conduct), _) => {
                conduct.robustness(run.scenario(), result).ok_or(SpecificationError::NoTrace)?
            }
        };
        let failed = result.outcome.failed_controller().map(|failed| (failed.time_s, failed.vehicle as u32));
        Ok(RunVerdict { robustness, contact: first_contact(run, result), failure: failed })
    }
}

/// At exactly zero the formula itself decides.
fn judge_formula(formula: &Formula, signals: &SampledSignals<'_>) -> Result<f64, MonitorError> {
    let robustness = formula.robustness(signals)?;
    let violated_at_zero = robustness == 0.0 && !formula.is_satisfied(signals)?;
    Ok(if violated_at_zero { -MIN_VIOLATION } else { robustness })
}

fn first_contact(run: &Run, result: &SimulationResult) -> Option<FirstContact> {
    let contact = result.outcome.contact()?;
    let scenario = run.scenario();
    // Of two vehicles under test the one that hits.
    let ego = match ContactRole::new(contact, scenario) {
        ContactRole::IsHit => contact.front_vehicle,
        ContactRole::Hits | ContactRole::Bystander => contact.rear_vehicle,
    };
    let hardest_mps2 = match &result.trace {
        None => result.vehicles.get(ego).map_or(0.0, |vehicle| vehicle.max_brake_mps2),
        Some(trace) => {
            let before = trace.time_s.partition_point(|&time_s| time_s < contact.time_s);
            let held = trace.vehicles.get(ego).map(|track| &track.acceleration_mps2);
            held.into_iter().flatten().take(before).fold(0.0, |hardest: f64, accel| hardest.max(-accel))
        }
    };
    Some(FirstContact {
        time_s: contact.time_s,
        front_vehicle: contact.front_vehicle as u32,
        rear_vehicle: contact.rear_vehicle as u32,
        impact_speed_mps: contact.impact_speed_mps,
        ego_braking: BrakingLevel::new(hardest_mps2, scenario.usable_brake_mps2(ego)),
        rear_class: scenario.vehicles().get(contact.rear_vehicle).map_or(VehicleClass::Light, |v| v.class),
    })
}

impl fmt::Display for Specification {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoContact => out.write_str(Self::NO_CONTACT),
            Self::Formula(formula) => formula.fmt(out),
            Self::DrivingRule(conduct) => conduct.fmt(out),
        }
    }
}
