//! How little lead braking makes a controller collide, and how badly it can end.

use super::exact;
use super::profile_simulator::ProfileSimulator;
use super::sequential;
use crumple_core::observer::{Observer, RunProgress, Stopped};
use crumple_world::control::ControllerSpec;
use crumple_world::scenario::{Driver, InvalidField, Scenario};
use crumple_world::sim::{ControllerKind, Outcome, RunError, RunOptions};

/// What an attack is after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum AttackObjective {
    /// A collision with the least ∫ a² of the leader.
    Mildest,
    /// A collision with the least peak of its braking.
    LeastPeak,
    /// The fastest impact.
    Severest,
}

impl AttackObjective {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Mildest, Self::LeastPeak, Self::Severest];

    /// What it is called on the command line and in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mildest => "mildest",
            Self::LeastPeak => "least-peak",
            Self::Severest => "severest",
        }
    }
}

/// How the leader may brake.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Envelope {
    /// Hardest braking, in m/s², positive; never more than the leader has on this road.
    pub max_brake_mps2: f64,
    /// Fastest change of acceleration, in m/s³: accelerations of successive tenths of a second differ by no more than a tenth
    /// of it.
    pub jerk_mps3: f64,
}

impl Envelope {
    /// Fastest change of acceleration unless another is asked for, in m/s³: an emergency braking builds up in about a second.
    pub const DEFAULT_JERK_MPS3: f64 = 10.0;

    /// All the braking the leader has on this road.
    #[must_use]
    pub fn from_scenario(scenario: &Scenario) -> Self {
        Self { max_brake_mps2: scenario.usable_brake_mps2(0), jerk_mps3: Self::DEFAULT_JERK_MPS3 }
    }
}

/// How an attack was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum AttackMethod {
    /// By enumerating when the controller fires: no profile on this grid does with less.
    Exact,
    /// By the same enumeration, which knows neither noise nor a filter, and then braking somewhat more until it collides: near
    /// the least, and not shown to be it.
    Widened,
    /// By simulating pulses and ramps, and by sequential convex programming from the best of them: the best found.
    Sequential,
}

impl AttackMethod {
    /// Returns the sense in which the result is the best, as results name it: `exact-on-grid` or `best-found`.
    #[must_use]
    pub fn optimality(self) -> &'static str {
        match self {
            Self::Exact => "exact-on-grid",
            Self::Widened | Self::Sequential => "best-found",
        }
    }
}

/// A braking profile and what it does, replayed.
#[derive(Debug, Clone, PartialEq)]
pub struct Attack {
    /// The scenario with the profile as the leader's script.
    pub scenario: Scenario,
    /// What the simulation says about it.
    pub outcome: Outcome,
    /// ∫ a² of the leader's script, in m²/s³.
    pub effort_m2ps3: f64,
    /// Hardest braking of the script, in m/s², positive.
    pub peak_brake_mps2: f64,
    /// Margin that the convex program predicted, in metres: the smallest gap, or minus v²/10 of an impact at v m/s.
    pub predicted_margin_m: f64,
    /// The margin that the simulation has, in metres.
    pub margin_m: f64,
    /// Simulations spent.
    pub evaluations: usize,
    /// Convex programs solved.
    pub programs: usize,
    /// How it was found.
    pub method: AttackMethod,
}

/// What an attack found, and what it spent.
#[derive(Debug, Clone, PartialEq)]
pub struct AttackResult {
    /// The profile, if one makes the controller collide.
    pub attack: Option<Attack>,
    /// Simulations spent.
    pub evaluations: usize,
    /// Convex programs solved.
    pub programs: usize,
}

/// Why an attack cannot be tried.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AttackError {
    /// The leader is not scripted, so there is nothing to vary.
    #[error("vehicle 0 does not follow a script, so it has no profile to vary")]
    LeaderNotScripted,
    /// Who is ahead of whom changes, which the programs do not model.
    #[error("vehicles enter or leave the lane: search such scenarios with falsify")]
    LaneChanges,
    /// The envelope is empty.
    #[error("an envelope of {max_brake_mps2} m/s² and {jerk_mps3} m/s³ allows no braking")]
    EmptyEnvelope {
        /// Its hardest braking, in m/s².
        max_brake_mps2: f64,
        /// Its jerk, in m/s³.
        jerk_mps3: f64,
    },
    /// More than can be simulated thousands of times.
    #[error(
        "{vehicles} vehicles over {steps} steps are too much to attack: at most {MAX_VEHICLE_STEPS} vehicles times steps"
    )]
    TooLarge {
        /// Vehicles of the scenario.
        vehicles: usize,
        /// Its steps.
        steps: usize,
    },
    /// More simulations than end within an hour.
    #[error(
        "{budget} simulations of {vehicles} vehicles over {steps} steps are too many: at most {MAX_TOTAL_VEHICLE_STEPS} vehicles \
         times steps in all, so {} here",
        MAX_TOTAL_VEHICLE_STEPS / vehicles.saturating_mul(*steps).max(1)
    )]
    TooManySimulations {
        /// Simulations asked for.
        budget: usize,
        /// Vehicles of the scenario.
        vehicles: usize,
        /// Its steps.
        steps: usize,
    },
    /// The observer stopped the search.
    #[error("the search was {0}")]
    Stopped(#[from] Stopped),
    /// A profile made an invalid scenario.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// The scenario cannot be run as asked.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Most vehicles times steps of a scenario that [`attack()`] takes on: a simulation then takes some hundredths of a second.
pub const MAX_VEHICLE_STEPS: usize = 500_000;

/// Most vehicles times steps of all simulations of an [`attack()`] together: some minutes of one core.
pub const MAX_TOTAL_VEHICLE_STEPS: usize = 20_000_000_000;

/// Searches for a braking profile of the leader that makes the controller collide, with about `budget` simulations at most.
///
/// Exact for the baseline, whatever the vehicles behind it are, as long as the first vehicle under test answers without lag
/// and noise and the enumeration stays within some 1500 programs. For every other controller it is the best of pulses, ramps and
/// steps of sequential convex programming from them.
///
/// # Errors
/// [`AttackError`] if there is nothing to vary, the run does not fit the scenario, or `observer` stops the search.
///
/// ```
/// use crumple_core::observer::Quiet;
/// use crumple_search::worst_case::{Aim, Envelope, attack};
/// use crumple_world::control::ControllerSpec;
/// use crumple_world::observation::EstimatorKind;
/// use crumple_world::scenario::built_in;
/// use crumple_world::sim::RunOptions;
///
/// let scenario = built_in("paper-1").unwrap();
/// let options = RunOptions::new(ControllerSpec::named("baseline").unwrap()).with_estimator(EstimatorKind::Truth);
/// let result = attack(&scenario, &options, Aim::Mildest, Envelope::of(&scenario), 100, &Quiet).unwrap();
/// // The paper's leader brakes at 3 m/s².
/// assert!(result.found.unwrap().peak_brake_mps2 < 3.0);
/// ```
pub fn attack(
    scenario: &Scenario,
    options: &RunOptions,
    aim: AttackObjective,
    envelope: Envelope,
    budget: usize,
    observer: &dyn Observer<RunProgress>,
) -> Result<AttackResult, AttackError> {
    if !matches!(scenario.vehicles().first().map(|leader| &leader.driver), Some(Driver::Profile(_))) {
        return Err(AttackError::LeaderNotScripted);
    }
    if !scenario.keeps_lanes() {
        return Err(AttackError::LaneChanges);
    }
    let (vehicles, steps) = (scenario.vehicles().len(), scenario.steps());
    if vehicles.saturating_mul(steps) > MAX_VEHICLE_STEPS {
        return Err(AttackError::TooLarge { vehicles, steps });
    }
    if vehicles.saturating_mul(steps).saturating_mul(budget) > MAX_TOTAL_VEHICLE_STEPS {
        return Err(AttackError::TooManySimulations { budget, vehicles, steps });
    }
    let asked_mps2 = envelope.max_brake_mps2;
    let max_brake_mps2 = asked_mps2.min(scenario.usable_brake_mps2(0));
    if !(max_brake_mps2 > 0.0 && envelope.jerk_mps3 > 0.0) || asked_mps2.is_nan() {
        return Err(AttackError::EmptyEnvelope { max_brake_mps2: asked_mps2, jerk_mps3: envelope.jerk_mps3 });
    }
    let mut bench = ProfileSimulator::new(scenario, options, Envelope { max_brake_mps2, ..envelope }, budget, observer);
    // From nothing to full braking in half a cell: more is no limit, and huge numbers would spoil the programs.
    let boundless_mps3 = 2.0 * max_brake_mps2 / bench.cell_s();
    bench.envelope.jerk_mps3 = envelope.jerk_mps3.min(boundless_mps3);
    let found = if aim != AttackObjective::Severest
        && let ControllerKind::BuiltIn(ControllerSpec::Baseline(aeb)) = &options.controller
        && exact::is_applicable(scenario)
    {
        exact::find_mildest(&mut bench, aeb.ttc_s, aim, budget)?
    } else {
        sequential::attack(&mut bench, aim, budget)?
    };
    Ok(AttackResult { attack: found, evaluations: bench.evaluations, programs: bench.programs })
}
