//! Worst-case braking profiles of the leader: the least braking that makes a controller collide, or the fastest impact.

use super::profile_simulator::ProfileSimulator;
use super::sequential;
use crumple_core::observer::{Observer, RunProgress, Stopped};
use crumple_sim::engine::{Outcome, RunError, RunOptions};
use crumple_sim::scenario::{Driver, InvalidField, Scenario};

/// Objective of an attack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum AttackObjective {
    /// A collision with the least ∫ a² of the leader.
    Mildest,
    /// A collision with the least peak of the leader's braking.
    LeastPeak,
    /// The fastest impact.
    Severest,
}

impl AttackObjective {
    /// All objectives.
    pub const ALL: [Self; 3] = [Self::Mildest, Self::LeastPeak, Self::Severest];

    /// Returns the name used on the command line and in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mildest => "mildest",
            Self::LeastPeak => "least-peak",
            Self::Severest => "severest",
        }
    }

    /// Returns the cost of a profile of one acceleration per cell: its peak, or ∫ a².
    pub(super) fn cost(self, cells_mps2: &[f64], cell_s: f64) -> f64 {
        match self {
            Self::LeastPeak => cells_mps2.iter().fold(0.0, |most, a| most.max(-a)),
            Self::Mildest | Self::Severest => cells_mps2.iter().map(|a| a * a * cell_s).sum(),
        }
    }
}

/// Limits of the leader's braking.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Envelope {
    /// Hardest braking, in m/s², positive; at most what the road allows.
    pub max_brake_mps2: f64,
    /// Maximum jerk, in m/s³: accelerations of successive cells of 0.1 s differ by at most a tenth of it.
    pub jerk_mps3: f64,
}

impl Envelope {
    /// Default jerk limit, in m/s³: an emergency braking builds up in about a second.
    pub const DEFAULT_JERK_MPS3: f64 = 10.0;

    /// Creates the envelope of all braking that the road allows the leader.
    #[must_use]
    pub fn from_scenario(scenario: &Scenario) -> Self {
        Self {
            max_brake_mps2: scenario.usable_brake_mps2(0),
            jerk_mps3: Self::DEFAULT_JERK_MPS3,
        }
    }
}

/// A braking profile, with the results of its replay.
#[derive(Debug, Clone, PartialEq)]
pub struct Attack {
    /// The scenario with the profile as the leader's script.
    pub scenario: Scenario,
    /// Outcome of the simulation.
    pub outcome: Outcome,
    /// ∫ a² of the leader until it stands or the first collision, in m²/s³.
    pub effort_m2ps3: f64,
    /// Hardest braking of the script, in m/s², positive.
    pub peak_brake_mps2: f64,
    /// Margin that the convex program predicted, in metres: the smallest gap, or minus v²/10 of an impact at v m/s.
    pub predicted_margin_m: f64,
    /// Margin of the simulation, in metres.
    pub margin_m: f64,
    /// Number of simulations.
    pub evaluations: usize,
    /// Number of convex programs solved.
    pub programs: usize,
}

/// Result of an attack.
#[derive(Debug, Clone, PartialEq)]
pub struct AttackResult {
    /// Attack, if some profile makes the controller collide.
    pub attack: Option<Attack>,
    /// Number of simulations.
    pub evaluations: usize,
    /// Number of convex programs solved.
    pub programs: usize,
}

/// An error of starting or running an attack.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AttackError {
    /// The leader is not scripted, so no profile can be varied.
    #[error(
        "vehicle 0 does not follow a script, so it has no profile to vary: use a scenario with a scripted leader"
    )]
    LeaderNotScripted,
    /// The order of vehicles changes, which the programs do not model.
    #[error("vehicles enter or leave the lane: search such scenarios with `crumple falsify`")]
    LaneChanges,
    /// The envelope allows no braking.
    #[error("an envelope of {max_brake_mps2} m/s² and {jerk_mps3} m/s³ allows no braking")]
    EmptyEnvelope {
        /// Hardest braking of the envelope, in m/s².
        max_brake_mps2: f64,
        /// Jerk limit of the envelope, in m/s³.
        jerk_mps3: f64,
    },
    /// The scenario is too large for thousands of simulations.
    #[error(
        "{vehicles} vehicles over {steps} steps are too many: the limit is {MAX_VEHICLE_STEPS} vehicles times steps"
    )]
    TooLarge {
        /// Number of vehicles.
        vehicles: usize,
        /// Number of steps.
        steps: usize,
    },
    /// The simulations would take more than an hour.
    #[error(
        "{budget} simulations of {vehicles} vehicles over {steps} steps are too many: the limit is \
         {MAX_TOTAL_VEHICLE_STEPS} vehicles times steps in all, which allows {} simulations",
        MAX_TOTAL_VEHICLE_STEPS / vehicles.saturating_mul(*steps).max(1)
    )]
    TooManySimulations {
        /// Requested simulations.
        budget: usize,
        /// Number of vehicles.
        vehicles: usize,
        /// Number of steps.
        steps: usize,
    },
    /// The observer stopped the search.
    #[error("the search was {0}")]
    Stopped(#[from] Stopped),
    /// A profile made an invalid scenario.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// The scenario cannot be simulated with these options.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Maximum number of simulations of an [`attack()`] that a user may request.
pub const MAX_SIMULATIONS: u32 = 10_000_000;

/// Maximum number of vehicles times steps in [`attack()`]: a simulation then takes some hundredths of a second.
pub const MAX_VEHICLE_STEPS: usize = 500_000;

/// Maximum number of vehicles times steps of all simulations of an [`attack()`]: some minutes on one core.
pub const MAX_TOTAL_VEHICLE_STEPS: usize = 20_000_000_000;

/// Searches for a braking profile of the leader that makes the controller collide, in about `budget` simulations.
///
/// The result is exact for the baseline, if the first vehicle under test answers without lag and noise and about 1500
/// programs suffice. Otherwise it is the best of pulses, ramps and sequential convex programming.
///
/// # Errors
/// [`AttackError`] if nothing can be varied, the options do not fit the scenario, or `observer` stops the search.
///
/// ```
/// use crumple_core::observer::Quiet;
/// use crumple_search::worst_case::{AttackObjective, Envelope, attack};
/// use crumple_sim::control::BuiltInController;
/// use crumple_sim::observation::EstimatorKind;
/// use crumple_sim::scenario::built_in_scenario;
/// use crumple_sim::engine::RunOptions;
///
/// let scenario = built_in_scenario("paper-1").unwrap();
/// let baseline = BuiltInController::from_name("baseline").unwrap();
/// let options = RunOptions::new(baseline).with_estimator(EstimatorKind::Truth);
/// let envelope = Envelope::from_scenario(&scenario);
/// let result = attack(&scenario, &options, AttackObjective::Mildest, envelope, 100, &Quiet).unwrap();
/// // The paper's leader brakes at 3 m/s².
/// assert!(result.attack.unwrap().peak_brake_mps2 < 3.0);
/// ```
pub fn attack(
    scenario: &Scenario,
    options: &RunOptions,
    objective: AttackObjective,
    envelope: Envelope,
    budget: usize,
    observer: &dyn Observer<RunProgress>,
) -> Result<AttackResult, AttackError> {
    if !matches!(
        scenario.vehicles().first().map(|leader| &leader.driver),
        Some(Driver::Profile(_))
    ) {
        return Err(AttackError::LeaderNotScripted);
    }
    if !scenario.keeps_lanes() {
        return Err(AttackError::LaneChanges);
    }
    check_size(scenario, budget)?;
    let usable = usable_envelope(envelope, scenario)?;
    let mut simulator = ProfileSimulator::new(scenario, options, usable, budget, observer);
    // A jerk limit that allows full braking within half a cell has no effect, and a huge one would make the program
    // ill-conditioned.
    let boundless_mps3 = 2.0 * usable.max_brake_mps2 / simulator.cell_s();
    simulator.envelope.jerk_mps3 = usable.jerk_mps3.min(boundless_mps3);
    let attack = sequential::attack(&mut simulator, objective, budget)?;
    Ok(AttackResult {
        attack,
        evaluations: simulator.evaluations,
        programs: simulator.programs,
    })
}

/// Limits an envelope to the braking of the leader.
///
/// # Errors
/// [`AttackError::EmptyEnvelope`] if it allows no braking.
fn usable_envelope(envelope: Envelope, scenario: &Scenario) -> Result<Envelope, AttackError> {
    let requested_mps2 = envelope.max_brake_mps2;
    let max_brake_mps2 = requested_mps2.min(scenario.usable_brake_mps2(0));
    if !(max_brake_mps2 > 0.0 && envelope.jerk_mps3 > 0.0) || requested_mps2.is_nan() {
        return Err(AttackError::EmptyEnvelope {
            max_brake_mps2: requested_mps2,
            jerk_mps3: envelope.jerk_mps3,
        });
    }
    Ok(Envelope {
        max_brake_mps2,
        ..envelope
    })
}

/// Checks the size of a scenario, and that of `budget` simulations of it.
pub(super) fn check_size(scenario: &Scenario, budget: usize) -> Result<(), AttackError> {
    let vehicles = scenario.vehicles().len();
    let steps = scenario.steps();
    let all = vehicles.saturating_mul(steps);
    if all > MAX_VEHICLE_STEPS {
        Err(AttackError::TooLarge { vehicles, steps })
    } else if all.saturating_mul(budget) > MAX_TOTAL_VEHICLE_STEPS {
        Err(AttackError::TooManySimulations {
            budget,
            vehicles,
            steps,
        })
    } else {
        Ok(())
    }
}
