//! Controllers: one trait, one table of built-in controllers, one file each.
//!
//! A controller maps an [`Observation`] to a commanded acceleration. The simulation applies limits, lag and friction.
//!
//! To add a built-in controller, implement [`BuiltIn`] in a new file, and add a module and a row of the table here. The
//! controller is then part of the command line, scenario files, their schema, spaces, lists, the lockstep engine and
//! the fuzzing strategies.

/// Built-in controllers that serve tests and comparisons rather than driving. `crumple list` shows them on request.
pub const CONTROLLERS_FOR_TESTS: [&str; 6] = [
    "baseline-unlatched",
    "match-leader",
    "constant-brake",
    "full-throttle",
    "random-actions",
    "retrained",
];

/// Passes the table to a macro. A row of `rules` is a controller type. A row of `policies` is a name and the type that
/// provides the policy. The documentation of a row is the description of its name in the schema of scenario files.
macro_rules! with_controllers {
    ($then:ident) => {
        $then! {
            rules {
                /// The paper's baseline ADAS.
                Baseline,
                /// The baseline ADAS, which releases the brake when TTC recovers.
                BaselineUnlatched,
                /// Commands the observed acceleration of the leader.
                MatchLeader,
                /// Brakes at a constant rate once the leader is observed to brake.
                ConstantBrake,
                /// Intelligent Driver Model.
                Idm,
                /// Adaptive cruise control with emergency braking.
                AccAeb,
                /// Predicts the stopping places of leader and follower, and drives between them.
                Predictive,
                /// A configurable emergency brake.
                EmergencyBrake,
                /// Autoware's emergency brake.
                AutowareAeb,
                /// The longitudinal limits of openpilot.
                Openpilot,
                /// A human driver.
                Human,
                /// Reference driver: the competent and careful human of UN R157.
                CompetentHuman,
                /// Reference driver: the simple model of UN R157.
                R157Simple,
                /// Reference driver: the fuzzy safety model of UN R157.
                FuzzySafety,
                /// Reference driver: Responsibility-Sensitive Safety.
                Rss,
                /// Full acceleration at all times.
                FullThrottle,
                /// A random action at each step, from the scenario's seed.
                RandomActions,
            }
            policies {
                /// The committed reference policy.
                Policy(ReferencePolicy),
                /// The committed policy that was retrained in the space `high-risk`.
                Retrained(RetrainedPolicy),
                /// The committed policy that imitates `predictive`.
                Road(RoadPolicy),
            }
        }
    };
}

mod acc_aeb;
mod autoware_aeb;
mod baseline;
mod batch_query;
mod built_in;
mod competent_human;
mod constant_brake;
mod cruise_preset;
mod decision_timer;
mod emergency_brake;
mod fuzzy_safety;
mod human;
mod idm;
mod match_leader;
mod openpilot;
mod policy;
mod predictive;
mod preset;
mod process_failure;
mod r157_simple;
mod reaction;
mod rss;
mod serve;
mod set_speed;
mod shield;
mod source;
mod source_file;
mod start_refusal;
mod stateless;
mod stress;
mod test_driver;
mod two_sided;
mod zero_order_hold;

pub use crate::observation::ObservedQuantity;
pub use acc_aeb::{AccAeb, AccAebSettings};
pub use autoware_aeb::{AutowareAeb, AutowareAebSettings};
pub(crate) use baseline::FIRING_TTC_S;
pub use baseline::{AebSettings, Baseline, BaselineUnlatched};
pub use batch_query::{BatchQuery, decide_by_query};
pub(crate) use built_in::AnyController;
pub use built_in::{BuiltIn, BuiltInController, Role};
pub use competent_human::{CompetentHuman, CompetentHumanSettings};
pub use constant_brake::{ConstantBrake, ConstantBrakeSettings};
pub use cruise_preset::CRUISE_PRESETS;
pub use decision_timer::DecisionTimer;
pub use emergency_brake::{EmergencyBrake, EmergencyBrakeSettings};
pub use fuzzy_safety::{FuzzySafety, FuzzySafetySettings};
pub use human::{Human, HumanSettings};
pub use match_leader::MatchLeader;
pub use openpilot::{Openpilot, OpenpilotSettings};
pub use policy::{PolicyDriver, PolicySource, ReferencePolicy, RetrainedPolicy, RoadPolicy};
pub use predictive::{Predictive, PredictiveSettings};
pub use preset::{CONTROLLER_PRESETS, ControllerPreset};
pub use process_failure::{PROTOCOL_VERSION, ProcessFailure, ProcessProblem, escaped_excerpt};
pub use r157_simple::{R157Simple, R157SimpleSettings};
pub use rss::{Rss, RssSettings};
pub use serve::{ServingError, serve};
pub use shield::{
    ErrorBounds, FiringRule, FiringSpeeds, MIN_MARGIN_M, MotionSample, Override, Real,
    RearVehicleParams, ShieldKind, ShieldParams, ShieldRefusal, ShieldSettings, ShieldState,
    ShieldedSource, ViabilityKernel, distance_and_speed_after, max_closing_m, min_quadratic,
};
pub(crate) use shield::{MAX_MARGIN_M, MotionBounds};
pub use source::{
    BatchController, ControllerFailure, ControllerSource, IntoSource, RequiredNeighbours,
    VehicleInRun,
};
pub(crate) use source::{ShieldAssumptions, not_started};
pub use source_file::SourceFile;
pub use start_refusal::StartRefusal;
pub use stateless::{StatelessController, stateless};
pub use stress::{FullThrottle, RandomActions};
pub use test_driver::{TestDriverSettings, TestDriverSource};
pub use two_sided::{
    CREEP_SPEED_MPS, CommandsAfterFiring, FollowerClass, FollowerPhase, FollowerTrigger,
    LevelMeter, MAX_LEVEL_MPS2, NOTICED_BRAKE_MPS2, PlanCommands, RearErrorBounds, TwoSidedFilter,
    TwoSidedParams, TwoSidedSettings,
};
pub(crate) use with_controllers;

pub use crate::idm::{Idm, IdmSettings};
use crate::observation::Observation;
pub use crate::settings::{ControllerSettings, InvalidSetting, NoSettings, SettingField};

/// Properties of the ego vehicle that its controller knows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ego {
    /// Index of the vehicle, counted from the front.
    pub vehicle: usize,
    /// Maximum deceleration on a dry road, in m/s², positive. Controllers do not know the friction.
    pub max_brake_mps2: f64,
    /// Maximum acceleration, in m/s².
    pub max_accel_mps2: f64,
    /// Length from bumper to bumper, in metres.
    pub length_m: f64,
    /// Time step of the scenario, in seconds.
    pub step_s: f64,
}

/// Standard gravity, in m/s²: regulations state braking in shares of it.
pub const STANDARD_GRAVITY_MPS2: f64 = 9.806_65;

/// A controller: maps observations to commanded accelerations.
///
/// ```
/// use crumple_sim::control::{Controller, ControllerFailure};
/// use crumple_sim::observation::Observation;
///
/// /// Never brakes.
/// struct Coasting;
///
/// impl Controller for Coasting {
///     fn decide(&mut self, _seen: &Observation) -> Result<f64, ControllerFailure> {
///         Ok(0.0)
///     }
/// }
/// ```
pub trait Controller: Send {
    /// Returns the commanded acceleration until the next decision, in m/s². The simulation clips it to limits.
    ///
    /// # Errors
    /// [`ControllerFailure`] if there is no answer; the run ends there.
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure>;

    /// Receives the true state of a step, before the controller decides on an estimate. Only models of humans use it:
    /// a human looks at the road, not through the sensors of the vehicle. Not called if the observation is the true
    /// state. A controller around another one passes it on.
    #[inline]
    fn perceive(&mut self, _truth: &Observation) {}

    /// Tells the controller that another acceleration than its answer is commanded in this step, in m/s², because a
    /// shield replaces it, or because the controller is only consulted (training, replay of a recording). A controller
    /// that learns from the effect of its commands needs this. Called after [`decide`](Self::decide) and before the
    /// next call; for a controller with a decision interval, in each such step, also between its decisions. The limits
    /// of the vehicle are no reason for a call.
    ///
    /// Networks, policies, processes and FMUs receive the command as their input `last_answer_mps2`, if they have it.
    fn record_command(&mut self, _command_mps2: f64) {}

    /// Returns true while the controller warns its driver of a forward collision, after its last decision. Read only if
    /// its source [reports warnings](ControllerSource::reports_warnings).
    fn is_warning(&self) -> bool {
        false
    }

    /// Returns the controller as one whose queries can be combined, if it is one.
    fn as_batch_query(&mut self) -> Option<&mut dyn BatchQuery> {
        None
    }

    /// Returns the periods in which the controller, a shield, replaced commands.
    fn overrides(&self) -> &[Override] {
        &[]
    }

    /// Decides for many vehicles. Calls `see` once per controller, in order; each controller decides as it would alone.
    /// Writes answers to `commands_mps2`, and failures with their index to `failed`.
    #[inline]
    fn decide_batch(
        all: &mut [Self],
        mut observe: impl FnMut(usize) -> Observation,
        commands_mps2: &mut [f64],
        failed: &mut Vec<(usize, ControllerFailure)>,
    ) where
        Self: Sized,
    {
        for (index, (command_mps2, controller)) in commands_mps2.iter_mut().zip(all).enumerate() {
            match controller.decide(&observe(index)) {
                Ok(answer_mps2) => *command_mps2 = answer_mps2,
                Err(failure) => failed.push((index, failure)),
            }
        }
    }
}

impl Controller for Box<dyn Controller> {
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        (**self).decide(observation)
    }

    fn perceive(&mut self, truth: &Observation) {
        (**self).perceive(truth);
    }

    fn record_command(&mut self, command_mps2: f64) {
        (**self).record_command(command_mps2);
    }

    fn is_warning(&self) -> bool {
        (**self).is_warning()
    }

    fn as_batch_query(&mut self) -> Option<&mut dyn BatchQuery> {
        (**self).as_batch_query()
    }

    fn overrides(&self) -> &[Override] {
        (**self).overrides()
    }

    fn decide_batch(
        all: &mut [Self],
        observe: impl FnMut(usize) -> Observation,
        commands_mps2: &mut [f64],
        failed: &mut Vec<(usize, ControllerFailure)>,
    ) {
        batch_query::decide_batch(all, observe, commands_mps2, failed);
    }
}

/// Clips a command to the limits of the vehicle; NaN counts as 0.
///
/// Uses plain comparisons, as `f64::max` of 0 and -0 may return either, and separately compiled engines could differ.
#[inline]
pub(crate) fn clamp_command(command_mps2: f64, max_brake_mps2: f64, max_accel_mps2: f64) -> f64 {
    let command_mps2 = if command_mps2.is_nan() {
        0.0
    } else {
        command_mps2
    };
    let command_mps2 = if command_mps2 < -max_brake_mps2 {
        -max_brake_mps2
    } else {
        command_mps2
    };
    if command_mps2 > max_accel_mps2 {
        max_accel_mps2
    } else {
        command_mps2
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::observation::Neighbour;

    pub(crate) const EGO: Ego = Ego {
        vehicle: 1,
        max_brake_mps2: 7.5,
        max_accel_mps2: 3.0,
        length_m: 2.0,
        step_s: 0.01,
    };

    /// Returns an observation at `speed_mps`, with a leader at `gap_m`, `ahead_mps` and `ahead_mps2`.
    pub(crate) fn leader_observation(
        speed_mps: f64,
        gap_m: f64,
        ahead_mps: f64,
        ahead_mps2: f64,
    ) -> Observation {
        let ahead = Neighbour {
            gap_m,
            speed_mps: ahead_mps,
            acceleration_mps2: ahead_mps2,
        };
        Observation {
            speed_mps,
            acceleration_mps2: 0.0,
            ahead: Some(ahead),
            behind: None,
        }
    }

    /// Returns the command for [`leader_observation`] with these arguments.
    pub(crate) fn command_behind(
        driver: &mut impl Controller,
        speed_mps: f64,
        gap_m: f64,
        ahead_mps: f64,
        ahead_mps2: f64,
    ) -> f64 {
        driver
            .decide(&leader_observation(speed_mps, gap_m, ahead_mps, ahead_mps2))
            .unwrap()
    }

    /// Returns the stopping distance from `speed_mps` of a driver; `observe` returns its observation at each speed.
    pub(crate) fn stopping_distance_m(
        mut driver: impl Controller,
        speed_mps: f64,
        observe: impl Fn(f64) -> Observation,
    ) -> f64 {
        let mut way_m = 0.0;
        let mut speed_mps = speed_mps;
        loop {
            let a = driver.decide(&observe(speed_mps)).unwrap();
            let next_mps = speed_mps + a * EGO.step_s;
            if next_mps <= 0.0 {
                return way_m - speed_mps * speed_mps / (2.0 * a);
            }
            way_m += 0.5 * (speed_mps + next_mps) * EGO.step_s;
            speed_mps = next_mps;
        }
    }

    #[test]
    fn every_built_in_controller_answers_an_empty_road_with_a_finite_command() {
        let alone = Observation {
            speed_mps: 20.0,
            acceleration_mps2: 0.0,
            ahead: None,
            behind: None,
        };
        for spec in BuiltInController::all() {
            let command = AnyController::from_spec(&spec, &EGO, 0)
                .decide(&alone)
                .unwrap();
            assert!(command.is_finite(), "{}: {command}", spec.name());
            assert!(
                spec.role() > Role::Reference || command >= 0.0,
                "{} brakes on an empty road: {command}",
                spec.name()
            );
        }
    }

    #[test]
    fn a_controller_has_one_identity_in_arguments_and_files() {
        for mut spec in BuiltInController::all() {
            let plain = (spec.identity(), spec.to_arg());
            assert_eq!(plain.1, spec.name());
            let fields = spec.fields();
            for (index, field) in fields.iter().enumerate() {
                *spec.get_mut(index).unwrap() =
                    0.3 * field.typical_range[0] + 0.7 * field.typical_range[1];
            }
            assert_eq!(
                BuiltInController::parse(&spec.to_arg()),
                Some(Ok(spec.clone()))
            );
            assert_eq!(
                fields.is_empty(),
                plain == (spec.identity(), spec.to_arg()),
                "{}",
                spec.to_arg()
            );
        }
    }

    #[test]
    fn unknown_settings_and_values_out_of_range_are_refused_by_name() {
        let problem = |words: &str| {
            BuiltInController::parse(words)
                .unwrap()
                .unwrap_err()
                .to_string()
        };
        assert_eq!(BuiltInController::parse("no-such,ttc_s=1"), None);
        assert_eq!(
            problem("baseline,ttc=1"),
            "`ttc=1` is not a setting of baseline: there are ttc_s, each with a number, as in `ttc_s=4`"
        );
        assert_eq!(
            problem("match-leader,x"),
            "`x` is not a setting of match-leader: it has none"
        );
        assert_eq!(
            problem("baseline,ttc_s=1,ttc_s=2"),
            "baseline: ttc_s is given twice"
        );
        for bad in [
            "baseline,ttc_s=NaN",
            "baseline,ttc_s=101",
            "baseline,ttc_s",
            "baseline,ttc_s=inf",
        ] {
            assert!(
                problem(bad).starts_with("baseline: ttc_s must be a number from 0 to 100, found `"),
                "{bad}"
            );
        }
    }
}
