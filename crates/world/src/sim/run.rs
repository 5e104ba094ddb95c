//! A scenario made ready to run: who drives what, through which estimator, how finely integrated.

use std::sync::{Arc, OnceLock};

use super::AfterContact;
use super::actuator::{Actuator, Disturbance};
use super::motion::Motion;
use super::platoon::Platoon;
use super::shielding::{ShieldRefusal, Shielded};
use crate::control::{AnyController, Controller, Ego, Frame, FullThrottle, RandomActions, Shield};
use crate::estimate::{EgoEstimator, EgoTuning, EstimatorKind, Neighbour, Observation, TrueState};
use crate::policy::Policy;
use crate::random::{self, Purpose};
use crate::scenario::{ControllerSpec, Driver, LeadProfile, MOST_VEHICLE_STEPS, Scenario, VehicleSpec, whole_multiple};

/// What drives the vehicles under test.
#[derive(Clone)]
pub enum ControllerKind {
    /// A built-in controller.
    BuiltIn(ControllerSpec),
    /// A learned policy.
    Policy(Arc<Policy>),
    /// A controller nobody would drive with.
    Stress(Stress),
    /// Any of these behind a shield.
    Shielded(Arc<Shielded>),
    /// Anything else.
    Custom(ControllerFactory),
}

/// Controllers that show what a shield is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stress {
    /// Full acceleration at all times.
    FullThrottle,
    /// A random action each step, from the scenario's seed.
    RandomActions,
}

impl Stress {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::FullThrottle, Self::RandomActions];

    /// The name used on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::FullThrottle => "full-throttle",
            Self::RandomActions => "random-actions",
        }
    }

    /// What it does, in one line.
    #[must_use]
    pub fn summary(self) -> &'static str {
        match self {
            Self::FullThrottle => "full acceleration at all times, to show what a shield is worth",
            Self::RandomActions => "a random action each step, for the same purpose",
        }
    }
}

impl From<Stress> for ControllerKind {
    fn from(stress: Stress) -> Self {
        Self::Stress(stress)
    }
}

impl From<Shielded> for ControllerKind {
    fn from(shielded: Shielded) -> Self {
        Self::Shielded(Arc::new(shielded))
    }
}

/// Builds a controller for a vehicle: called for each vehicle under test whenever a run is prepared or started, so a
/// controller's state must begin anew with each call.
pub type ControllerFactory = Arc<dyn Fn(&Ego) -> Box<dyn Controller> + Send + Sync>;

impl From<ControllerSpec> for ControllerKind {
    fn from(spec: ControllerSpec) -> Self {
        Self::BuiltIn(spec)
    }
}

impl From<Arc<Policy>> for ControllerKind {
    fn from(policy: Arc<Policy>) -> Self {
        Self::Policy(policy)
    }
}

/// How to run a scenario.
#[derive(Clone)]
pub struct RunOptions {
    /// What drives the vehicles under test.
    pub controller: ControllerKind,
    /// What the vehicles under test look through. All others see the truth.
    pub estimator: EstimatorKind,
    /// Integration step in seconds, a whole fraction of the scenario's step; none for the scenario's step itself.
    pub dt_s: Option<f64>,
    /// What happens at a contact.
    pub after_contact: AfterContact,
}

impl RunOptions {
    /// Runs of a controller with the Kalman filter, at the scenario's step, that end at contact.
    #[must_use]
    pub fn new(controller: impl Into<ControllerKind>) -> Self {
        Self {
            controller: controller.into(),
            estimator: EstimatorKind::default(),
            dt_s: None,
            after_contact: AfterContact::default(),
        }
    }

    /// The same with another estimator.
    #[must_use]
    pub fn with_estimator(mut self, estimator: EstimatorKind) -> Self {
        self.estimator = estimator;
        self
    }

    /// The same with another integration step, in seconds.
    #[must_use]
    pub fn with_dt_s(mut self, dt_s: f64) -> Self {
        self.dt_s = Some(dt_s);
        self
    }

    /// The same with another rule for contacts.
    #[must_use]
    pub fn with_after_contact(mut self, after_contact: AfterContact) -> Self {
        self.after_contact = after_contact;
        self
    }
}

/// Why a scenario cannot be run as asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The integration step does not divide the scenario's.
    #[error("an integration step of {dt_s} s does not divide the scenario's step of {step_s} s into whole parts")]
    Dt {
        /// The integration step asked for, in seconds.
        dt_s: f64,
        /// The scenario's step, in seconds.
        step_s: f64,
    },
    /// The run would record more than memory should hold.
    #[error("an integration step of {dt_s} s makes {found} vehicle-samples, and at most {limit} are allowed")]
    TooFine {
        /// The integration step asked for, in seconds.
        dt_s: f64,
        /// The limit.
        limit: usize,
        /// Integration steps times vehicles.
        found: usize,
    },
    /// A controller wants to decide at instants that are not the scenario's.
    #[error(
        "the controller decides every {interval_s} s, which is not a multiple of the scenario's step of {step_s} s"
    )]
    Interval {
        /// The controller's interval, in seconds.
        interval_s: f64,
        /// The scenario's step, in seconds.
        step_s: f64,
    },
    /// A shield cannot vouch for a vehicle under test.
    #[error("a shield cannot vouch for vehicle {vehicle}: {why}")]
    Shield {
        /// Index of the vehicle.
        vehicle: usize,
        /// Why.
        why: ShieldRefusal,
    },
}

/// A scenario ready to run.
pub struct Run<'s> {
    scenario: &'s Scenario,
    options: RunOptions,
    substeps: usize,
    /// Made when the first vehicle needs it: most runs with the true state never do.
    tuning: OnceLock<EgoTuning>,
    /// What shields take for granted, an entry a vehicle; none for one that is not shielded.
    frames: Vec<Option<Frame>>,
}

impl<'s> Run<'s> {
    /// Prepares a run.
    ///
    /// # Errors
    /// [`RunError`] if steps do not fit each other, or there would be too many.
    pub fn new(scenario: &'s Scenario, options: RunOptions) -> Result<Self, RunError> {
        let step_s = scenario.spec().step_s;
        let substeps = match options.dt_s {
            None => 1,
            Some(dt_s) => whole_multiple(step_s, dt_s).ok_or(RunError::Dt { dt_s, step_s })?,
        };
        let mut run = Self { scenario, options, substeps, tuning: OnceLock::new(), frames: Vec::new() };
        let found = run.vehicle_samples();
        if found > MOST_VEHICLE_STEPS {
            return Err(RunError::TooFine { dt_s: run.dt_s(), limit: MOST_VEHICLE_STEPS, found });
        }
        run.frames = run.shield_frames()?;
        for index in 0..scenario.vehicles().len() {
            if let ActiveDriver::Controller(controller) = run.driver(index)
                && let Some(interval_s) = controller.interval_s()
            {
                whole_multiple(interval_s, step_s).ok_or(RunError::Interval { interval_s, step_s })?;
            }
        }
        Ok(run)
    }

    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &'s Scenario {
        self.scenario
    }

    /// How it is run.
    #[must_use]
    pub fn options(&self) -> &RunOptions {
        &self.options
    }

    /// Integration steps in each step of the scenario.
    #[must_use]
    pub fn substeps(&self) -> usize {
        self.substeps
    }

    /// The integration step, in seconds.
    #[must_use]
    pub fn dt_s(&self) -> f64 {
        self.scenario.spec().step_s / self.substeps as f64
    }

    /// Integration steps times vehicles.
    pub(super) fn vehicle_samples(&self) -> usize {
        self.scenario.steps().saturating_mul(self.scenario.vehicles().len()).saturating_mul(self.substeps)
    }

    /// The instant `substep` integration steps after the start of step `step`, in seconds.
    pub(super) fn time_s(&self, step: usize, substep: usize) -> f64 {
        step as f64 * self.scenario.spec().step_s + substep as f64 * self.dt_s()
    }

    pub(super) fn tuning(&self) -> &EgoTuning {
        self.tuning.get_or_init(|| EgoTuning::new(self.scenario.spec().step_s, &self.scenario.spec().sensors))
    }

    fn shield_frames(&self) -> Result<Vec<Option<Frame>>, RunError> {
        let vehicles = self.scenario.vehicles();
        let ControllerKind::Shielded(shielded) = &self.options.controller else {
            return Ok(vec![None; vehicles.len()]);
        };
        let frame = |(vehicle, spec): (usize, &VehicleSpec)| match spec.driver {
            Driver::UnderTest => {
                self.frame(vehicle, &shielded.settings).map(Some).map_err(|why| RunError::Shield { vehicle, why })
            }
            _ => Ok(None),
        };
        vehicles.iter().enumerate().map(frame).collect()
    }

    fn ego(&self, index: usize) -> Ego {
        let vehicle = &self.scenario.vehicles()[index];
        Ego {
            max_brake_mps2: vehicle.max_brake_mps2(),
            max_accel_mps2: vehicle.max_accel_mps2(),
            length_m: vehicle.length_m(),
            step_s: self.scenario.spec().step_s,
        }
    }

    /// Who drives vehicle `index`.
    pub(super) fn driver(&self, index: usize) -> ActiveDriver<'s> {
        match &self.scenario.vehicles()[index].driver {
            Driver::Profile(profile) => ActiveDriver::Profile(profile),
            Driver::Controller(spec) => ActiveDriver::Controller(AnyController::built_in(spec, &self.ego(index))),
            Driver::UnderTest => ActiveDriver::Controller(self.under_test(index, &self.options.controller)),
        }
    }

    fn under_test(&self, index: usize, what: &ControllerKind) -> AnyController {
        let ego = self.ego(index);
        match what {
            ControllerKind::BuiltIn(spec) => AnyController::built_in(spec, &ego),
            ControllerKind::Policy(policy) => AnyController::policy(Arc::clone(policy), &ego),
            ControllerKind::Stress(Stress::FullThrottle) => AnyController::Custom(Box::new(FullThrottle::new(&ego))),
            ControllerKind::Stress(Stress::RandomActions) => {
                let stream = random::stream(self.scenario.spec().seed, Purpose::RandomActions, index as u64);
                AnyController::Custom(Box::new(RandomActions::new(&ego, stream)))
            }
            ControllerKind::Shielded(shielded) => {
                let controller = self.under_test(index, &shielded.controller);
                match self.frames.get(index).copied().flatten() {
                    Some(frame) => AnyController::Shielded(Shield::new(controller, frame)),
                    None => controller,
                }
            }
            ControllerKind::Custom(build) => AnyController::custom(build(&ego), &ego),
        }
    }

    /// Sensors and filters of vehicle `index`; none if it sees the truth.
    pub(super) fn estimator(&self, index: usize, platoon: &Platoon) -> Option<EgoEstimator> {
        let vehicle = &self.scenario.vehicles()[index];
        let estimates = vehicle.driver == Driver::UnderTest && self.options.estimator == EstimatorKind::Kalman;
        estimates.then(|| {
            let spec = self.scenario.spec();
            EgoEstimator::new(spec.seed, index, &spec.sensors, self.tuning(), &truth(platoon, index))
        })
    }

    pub(super) fn actuator(&self, index: usize) -> Actuator {
        Actuator::new(self.scenario, index)
    }

    pub(super) fn disturbance(&self, index: usize) -> Option<Disturbance> {
        Disturbance::new(self.scenario, index)
    }

    /// Everybody at the start.
    pub(super) fn platoon(&self) -> Platoon {
        let vehicles = self.scenario.vehicles();
        Platoon {
            motion: vehicles
                .iter()
                .map(|v| Motion { position_m: v.position_m, speed_mps: v.speed_mps, acceleration_mps2: 0.0 })
                .collect(),
            length_m: vehicles.iter().map(|v| v.length_m()).collect(),
            mass_kg: vehicles.iter().map(|v| v.mass_kg()).collect(),
            sticks: vec![false; vehicles.len()],
            min_gap_m: (0..vehicles.len()).map(|i| self.scenario.initial_gap_m(i).unwrap_or(f64::INFINITY)).collect(),
        }
    }
}

/// Whoever decides a vehicle's acceleration.
pub(super) enum ActiveDriver<'s> {
    Profile(&'s LeadProfile),
    Controller(AnyController),
}

/// What is true of vehicle `index` and its neighbours.
pub(super) fn truth(platoon: &Platoon, index: usize) -> TrueState {
    let own = platoon.motion[index];
    let neighbour = |other: usize, gap_m: f64| {
        let motion = platoon.motion[other];
        Neighbour { gap_m, speed_mps: motion.speed_mps, acceleration_mps2: motion.acceleration_mps2 }
    };
    TrueState {
        position_m: own.position_m,
        observation: Observation {
            speed_mps: own.speed_mps,
            acceleration_mps2: own.acceleration_mps2,
            ahead: index.checked_sub(1).map(|front| neighbour(front, platoon.gap_m(index))),
            behind: (index + 1 < platoon.motion.len()).then(|| neighbour(index + 1, platoon.gap_m(index + 1))),
        },
    }
}
