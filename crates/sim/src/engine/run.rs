//! Runs: scenarios with their controllers, estimators and integration steps.

use std::sync::{Arc, OnceLock};

use super::AfterCollision;
use super::lane::{Bodies, LaneState};
use super::motion::Motion;
use super::platoon::PlatoonState;
use crate::control::{
    AnyController, BuiltInController, Controller, ControllerFailure, ControllerSource, Ego,
    IntoSource, PolicyDriver, PolicySource, RequiredNeighbours, ShieldRefusal, VehicleInRun,
    clamp_command, not_started,
};
use crate::estimate::{EgoEstimator, EgoTuning, TrueState};
use crate::observation::{EstimatorKind, Neighbour, Observation};
use crate::scenario::{
    Driver, LeadProfile, MAX_VEHICLE_STEPS, Scenario, VehicleSpec, whole_multiple,
};

/// Options of a run.
///
/// ```
/// use crumple_sim::control::BuiltInController;
/// use crumple_sim::observation::EstimatorKind;
/// use crumple_sim::engine::{AfterCollision, RunOptions};
///
/// let options = RunOptions::new(BuiltInController::from_name("baseline").unwrap())
///     .with_estimator(EstimatorKind::Truth)
///     .with_after_collision(AfterCollision::Continue);
/// assert_eq!(options.dt_s, None);
/// ```
#[derive(Clone)]
pub struct RunOptions {
    /// Controller of the vehicles under test.
    pub controller: Arc<dyn ControllerSource>,
    /// Estimator of the vehicles under test. All others observe the true state.
    pub estimator: EstimatorKind,
    /// Integration step in seconds, a whole fraction of the scenario's step; `None` for the scenario's step.
    pub dt_s: Option<f64>,
    /// Continuation after a collision.
    pub after_collision: AfterCollision,
}

impl RunOptions {
    /// Creates options with the Kalman filter, the scenario's step, and an end at the first collision.
    #[must_use]
    pub fn new(controller: impl IntoSource) -> Self {
        Self {
            controller: controller.into_source(),
            estimator: EstimatorKind::default(),
            dt_s: None,
            after_collision: AfterCollision::default(),
        }
    }

    /// Sets the estimator.
    #[must_use]
    pub fn with_estimator(mut self, estimator: EstimatorKind) -> Self {
        self.estimator = estimator;
        self
    }

    /// Sets the integration step, in seconds.
    #[must_use]
    pub fn with_dt_s(mut self, dt_s: f64) -> Self {
        self.dt_s = Some(dt_s);
        self
    }

    /// Sets the continuation after a collision.
    #[must_use]
    pub fn with_after_collision(mut self, after_collision: AfterCollision) -> Self {
        self.after_collision = after_collision;
        self
    }
}

/// A controller that observes what the caller supplies, and whose commands move no vehicle.
pub struct OpenLoopController {
    controller: AnyController,
    limits: Ego,
    has_decided: bool,
}

impl OpenLoopController {
    /// Returns the command for an observation, in m/s², within the limits of the vehicle.
    ///
    /// In place of the last command, the vehicle has executed the acceleration that is observed now. The controller is
    /// told so ([`Controller::record_command`]).
    ///
    /// # Errors
    /// [`ControllerFailure`] if the controller gives no answer.
    pub fn command_mps2(&mut self, observed: &Observation) -> Result<f64, ControllerFailure> {
        let Ego {
            max_brake_mps2,
            max_accel_mps2,
            ..
        } = self.limits;
        if std::mem::replace(&mut self.has_decided, true) {
            self.controller.record_command(observed.acceleration_mps2);
        }
        Ok(clamp_command(
            self.controller.decide(observed)?,
            max_brake_mps2,
            max_accel_mps2,
        ))
    }
}

/// Reason why a scenario cannot be run with given options.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The integration step does not divide the scenario's.
    #[error(
        "an integration step of {dt_s} s does not divide the scenario's step of {step_s} s into whole parts"
    )]
    IntegrationStep {
        /// Requested integration step, in seconds.
        dt_s: f64,
        /// The scenario's step, in seconds.
        step_s: f64,
    },
    /// The run would record too much data.
    #[error(
        "an integration step of {dt_s} s makes {found} vehicle-samples, and at most {limit} are allowed"
    )]
    TooFine {
        /// Requested integration step, in seconds.
        dt_s: f64,
        /// Maximum number.
        limit: usize,
        /// Integration steps times vehicles.
        found: usize,
    },
    /// The decision interval of a controller is not a multiple of the scenario's step.
    #[error(
        "the controller decides every {interval_s} s, which is not a multiple of the scenario's step of {step_s} s"
    )]
    DecisionInterval {
        /// Decision interval of the controller, in seconds.
        interval_s: f64,
        /// The scenario's step, in seconds.
        step_s: f64,
    },
    /// The controller cannot drive a vehicle because a neighbour is missing.
    #[error(
        "the controller cannot drive vehicle {vehicle}: there is no vehicle {missing} it that stays in the lane"
    )]
    MissingNeighbour {
        /// Index of the vehicle.
        vehicle: usize,
        /// Side without a neighbour: `ahead of` or `behind`.
        missing: &'static str,
    },
    /// A shield gives no guarantee for a vehicle under test.
    #[error("a shield cannot protect vehicle {vehicle}: {refusal}")]
    Shield {
        /// Index of the vehicle.
        vehicle: usize,
        /// Reason of the refusal.
        refusal: ShieldRefusal,
    },
}

/// A scenario with the options of its run, ready to be simulated.
///
/// ```
/// use crumple_sim::control::BuiltInController;
/// use crumple_sim::scenario::built_in_scenario;
/// use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
///
/// let scenario = built_in_scenario("paper-1").unwrap();
/// let idm = BuiltInController::from_name("idm").unwrap();
/// let run = Run::new(&scenario, RunOptions::new(idm)).unwrap();
/// assert!(simulate(&run, RecordingLevel::Summary).outcome.is_safe());
/// ```
pub struct Run {
    scenario: Scenario,
    options: RunOptions,
    pub(super) time_grid: TimeGrid,
    /// Created on demand: most runs with the true state never need it.
    tuning: OnceLock<Arc<EgoTuning>>,
}

/// Times of a run. The stepwise engine has a copy, which saves a pointer access per step.
#[derive(Debug, Clone, Copy)]
pub(super) struct TimeGrid {
    pub(super) step_s: f64,
    pub(super) dt_s: f64,
    pub(super) substeps: usize,
    pub(super) steps: usize,
    pub(super) after_collision: AfterCollision,
}

impl TimeGrid {
    /// Returns the time `substep` integration steps after the start of step `step`, in seconds.
    pub(super) fn time_s(self, step: usize, substep: usize) -> f64 {
        step as f64 * self.step_s + substep as f64 * self.dt_s
    }
}

impl Run {
    /// Prepares a run, which shares the data of the scenario.
    ///
    /// # Errors
    /// [`RunError`] if steps do not fit or are too many, a neighbour is missing, or a shield gives no guarantee or is
    /// inside another.
    pub fn new(scenario: &Scenario, options: RunOptions) -> Result<Self, RunError> {
        let step_s = scenario.spec().step_s;
        let substeps = match options.dt_s {
            None => 1,
            Some(dt_s) => {
                whole_multiple(step_s, dt_s).ok_or(RunError::IntegrationStep { dt_s, step_s })?
            }
        };
        let dt_s = step_s / substeps as f64;
        let time_grid = TimeGrid {
            step_s,
            dt_s,
            substeps,
            steps: scenario.steps(),
            after_collision: options.after_collision,
        };
        let run = Self {
            scenario: scenario.clone(),
            options,
            time_grid,
            tuning: OnceLock::new(),
        };
        let samples = run.vehicle_samples();
        if samples > MAX_VEHICLE_STEPS {
            return Err(RunError::TooFine {
                dt_s,
                limit: MAX_VEHICLE_STEPS,
                found: samples,
            });
        }
        for vehicle in 0..scenario.vehicles().len() {
            run.check_driver(vehicle)?;
        }
        Ok(run)
    }

    /// Refuses a driver that cannot drive vehicle `index`.
    fn check_driver(&self, index: usize) -> Result<(), RunError> {
        let vehicles = self.scenario.vehicles();
        let source: &dyn ControllerSource = match &vehicles[index].driver {
            Driver::Profile(_) => return Ok(()),
            Driver::Controller(spec) => spec,
            Driver::File(file) => match file.controller() {
                Some(controller) => &**controller,
                None => return Ok(()),
            },
            Driver::UnderTest => {
                let source = &self.options.controller;
                source
                    .check_vehicle(&self.vehicle_in_run(index, source))
                    .map_err(|refusal| RunError::Shield {
                        vehicle: index,
                        refusal,
                    })?;
                &**source
            }
        };
        let step_s = self.time_grid.step_s;
        if let Some(interval_s) = source.interval_s() {
            whole_multiple(interval_s, step_s)
                .ok_or(RunError::DecisionInterval { interval_s, step_s })?;
        }
        self.check_neighbours(index, source.required_neighbours())
    }

    /// Refuses a controller of vehicle `index` if a neighbour that it needs is missing.
    fn check_neighbours(&self, index: usize, required: RequiredNeighbours) -> Result<(), RunError> {
        let vehicles = self.scenario.vehicles();
        let needs_ahead = required != RequiredNeighbours::Nothing;
        let needs_behind = required == RequiredNeighbours::AheadAndBehind;
        // A vehicle that enters or leaves is not always a neighbour.
        let has_ahead = vehicles[..index].iter().any(VehicleSpec::keeps_lane);
        let has_behind = vehicles[index + 1..].iter().any(VehicleSpec::keeps_lane);
        let missing = if needs_ahead && !has_ahead {
            "ahead of"
        } else if needs_behind && !has_behind {
            "behind"
        } else {
            return Ok(());
        };
        Err(RunError::MissingNeighbour {
            vehicle: index,
            missing,
        })
    }

    /// Returns the scenario.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// Returns the options.
    #[must_use]
    pub fn options(&self) -> &RunOptions {
        &self.options
    }

    /// Returns the number of integration steps per step of the scenario.
    #[must_use]
    pub fn substeps(&self) -> usize {
        self.time_grid.substeps
    }

    /// Returns the integration step, in seconds.
    #[must_use]
    pub fn dt_s(&self) -> f64 {
        self.time_grid.dt_s
    }

    pub(super) fn vehicle_samples(&self) -> usize {
        self.scenario
            .steps()
            .saturating_mul(self.scenario.vehicles().len())
            .saturating_mul(self.substeps())
    }

    pub(super) fn tuning(&self) -> &Arc<EgoTuning> {
        let spec = self.scenario.spec();
        self.tuning
            .get_or_init(|| Arc::new(EgoTuning::new(spec.step_s, &spec.sensors)))
    }

    /// Starts the controller under test in vehicle `index`, for observations that the caller supplies; `None` if there
    /// is no such vehicle.
    #[must_use]
    pub fn open_loop_controller(&self, index: usize) -> Option<OpenLoopController> {
        self.scenario
            .vehicles()
            .get(index)
            .map(|_| OpenLoopController {
                controller: self.start_controller(index, &self.options.controller),
                limits: self.ego(index),
                has_decided: false,
            })
    }

    fn ego(&self, index: usize) -> Ego {
        let vehicle = &self.scenario.vehicles()[index];
        Ego {
            vehicle: index,
            max_brake_mps2: vehicle.max_brake_mps2(),
            max_accel_mps2: vehicle.max_accel_mps2(),
            length_m: vehicle.length_m(),
            step_s: self.scenario.spec().step_s,
        }
    }

    /// True if the run can be simulated in lockstep with others.
    pub(super) fn supports_lockstep(&self) -> bool {
        self.scenario
            .vehicles()
            .iter()
            .enumerate()
            .all(|(index, vehicle)| match &vehicle.driver {
                Driver::Profile(_) | Driver::Controller(_) => true,
                Driver::File(file) => file
                    .controller()
                    .is_none_or(|controller| controller.supports_lockstep(&self.ego(index))),
                Driver::UnderTest => self.options.controller.supports_lockstep(&self.ego(index)),
            })
    }

    pub(super) fn start_driver(&self, index: usize) -> VehicleController<&LeadProfile> {
        match &self.scenario.vehicles()[index].driver {
            Driver::Profile(profile) => VehicleController::Profile(profile),
            Driver::Controller(spec) => VehicleController::Controller(AnyController::from_spec(
                spec,
                &self.ego(index),
                self.scenario.spec().seed,
            )),
            Driver::File(file) => VehicleController::Controller(match file.controller() {
                Some(controller) => self.start_controller(index, controller),
                None => AnyController::Other(not_started(ControllerFailure::Died {
                    message: "it was not read".to_owned(),
                })),
            }),
            Driver::UnderTest => VehicleController::Controller(
                self.start_controller(index, &self.options.controller),
            ),
        }
    }

    fn vehicle_in_run<'r>(
        &'r self,
        index: usize,
        source: &'r Arc<dyn ControllerSource>,
    ) -> VehicleInRun<'r> {
        VehicleInRun {
            ego: self.ego(index),
            seed: self.scenario.spec().seed,
            source,
            assumptions: self,
        }
    }

    fn start_controller(&self, index: usize, source: &Arc<dyn ControllerSource>) -> AnyController {
        let vehicle = self.vehicle_in_run(index, source);
        if let Some(spec) = source.downcast_ref::<BuiltInController>() {
            return AnyController::from_spec(spec, &vehicle.ego, vehicle.seed);
        }
        if let Some(policy) = source.downcast_ref::<PolicySource>() {
            return AnyController::Policy(PolicyDriver::new(policy.shared(), &vehicle.ego));
        }
        let started = source.start_in_run(&vehicle);
        AnyController::Other(started.unwrap_or_else(not_started))
    }

    /// Returns the command of vehicle `index` after it has hit its leader, in m/s²; `None` if its driver, or a script,
    /// decides.
    pub(super) fn command_after_impact_mps2(&self, index: usize) -> Option<f64> {
        let is_script = matches!(
            self.scenario.vehicles().get(index)?.driver,
            Driver::Profile(_)
        );
        let command_mps2 = self.options.after_collision.command_after_impact_mps2();
        command_mps2.filter(|_| !is_script)
    }

    /// Creates sensors and filters of vehicle `index`; `None` if it observes the true state.
    pub(super) fn estimator(&self, index: usize, platoon: &PlatoonState) -> Option<EgoEstimator> {
        let vehicle = &self.scenario.vehicles()[index];
        let estimates =
            vehicle.driver == Driver::UnderTest && self.options.estimator == EstimatorKind::Kalman;
        estimates.then(|| {
            let spec = self.scenario.spec();
            EgoEstimator::with_noise_shares(
                spec.seed,
                self.scenario.noise_shares(),
                index,
                &spec.sensors,
                self.tuning(),
                &true_state(platoon, index),
            )
        })
    }

    /// Returns all vehicles in their initial state.
    pub(super) fn initial_platoon(&self) -> PlatoonState {
        let vehicles = self.scenario.vehicles();
        let mut platoon = PlatoonState {
            motion: vehicles
                .iter()
                .map(|v| Motion {
                    position_m: v.position_m,
                    speed_mps: v.speed_mps,
                    acceleration_mps2: 0.0,
                })
                .collect(),
            length_m: vehicles.iter().map(|v| v.length_m()).collect(),
            mass_kg: vehicles.iter().map(|v| v.mass_kg()).collect(),
            lane: LaneState::with_all(vehicles.len()),
            locked_to_front: vec![false; vehicles.len()],
            min_gap_m: vec![f64::INFINITY; vehicles.len()],
        };
        platoon.lane = LaneState::new(
            vehicles,
            Bodies {
                motion: &platoon.motion,
                length_m: &platoon.length_m,
            },
        );
        platoon.track_gaps();
        platoon
    }
}

/// Driver of one vehicle of a run; `P` is a profile, borrowed or owned.
pub(super) enum VehicleController<P> {
    Profile(P),
    Controller(AnyController),
}

/// Returns the true state of vehicle `index` and its neighbours.
pub(super) fn true_state(platoon: &PlatoonState, index: usize) -> TrueState {
    let own = platoon.motion[index];
    TrueState {
        position_m: own.position_m,
        observation: Observation {
            speed_mps: own.speed_mps,
            acceleration_mps2: own.acceleration_mps2,
            ahead: platoon
                .lane
                .ahead(index)
                .map(|front| neighbour(platoon, front, [front, index])),
            behind: platoon
                .lane
                .behind(index)
                .map(|rear| neighbour(platoon, rear, [index, rear])),
        },
    }
}

/// Returns the state of vehicle `index`, which is one of the pair `[front, rear]`, as its partner observes it.
#[inline]
fn neighbour(platoon: &PlatoonState, index: usize, [front, rear]: [usize; 2]) -> Neighbour {
    let motion = platoon.motion[index];
    Neighbour {
        gap_m: platoon.gap_between_m(front, rear),
        speed_mps: motion.speed_mps,
        acceleration_mps2: motion.acceleration_mps2,
    }
}
