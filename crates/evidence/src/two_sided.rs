//! Certificates of two-sided shields: for a filter, and for the initial state of a run.

use crumple_verify::two_sided as claim;
use crumple_verify::{Certificate, ConstantPiece, Rejection, Statement, TwoSidedClaim};
use serde::Serialize;

use super::certificate_without_scenario;
use crumple_core::digits::format_number;
use crumple_measure::describe_outside_class;
use crumple_sim::control::{
    CommandsAfterFiring, FollowerClass, FollowerPhase, FollowerTrigger, LevelMeter, PlanCommands,
    ShieldRefusal, TwoSidedParams, TwoSidedSettings,
};
use crumple_sim::engine::{RecordingLevel, Run, Stepper};
use crumple_sim::observation::{Neighbour, Observation};

/// Reason why there is no certificate of a two-sided shield.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoTwoSidedCertificate {
    /// The run has no such vehicle, or it observes nothing at the start.
    #[error("vehicle {vehicle} observes nothing at the start")]
    NoObservation {
        /// Index of the vehicle.
        vehicle: usize,
    },
    /// A shield gives no guarantee for the vehicle.
    #[error(transparent)]
    Refused(#[from] ShieldRefusal),
    /// The checker has no bounds of an actuator with lag.
    #[error("certificates do not cover an actuator with lag: set `actuator_lag_s` to 0")]
    Lag,
    /// No plan was found for the initial state.
    #[error(
        "no plan was found that avoids a collision on both sides behind a leader that brakes at up to {} m/s² on this \
         road; the highest level with a plan is {} m/s²{}",
        format_number(*level_mps2),
        format_number(*highest_mps2),
        describe_setting(*setting_mps2)
    )]
    NoPlan {
        /// Level to keep on this road, in m/s².
        level_mps2: f64,
        /// Highest level with a plan on this road, in m/s².
        highest_mps2: f64,
        /// The setting `level` for that, on a dry road, in m/s², rounded down; `None` if there is none.
        setting_mps2: Option<f64>,
    },
    /// The checker rejects the certificate.
    #[error("the checker rejects the certificate: {0}")]
    Rejected(Rejection),
}

fn describe_setting(setting_mps2: Option<f64>) -> String {
    setting_mps2.map_or_else(String::new, |level_mps2| {
        format!(" (level={})", format_number(level_mps2))
    })
}

/// Returns the setting `level`, on a dry road, for a level on this road, which includes `noise_mps2` of the leader.
fn setting_mps2(level_mps2: f64, noise_mps2: f64, friction: f64) -> Option<f64> {
    // Rounded down, so that a plan exists, but not if only the division was inexact.
    let dry_mps2 = ((level_mps2 - noise_mps2) / friction * 100.0 + 1e-6).floor() / 100.0;
    (dry_mps2 > 0.0).then_some(dry_mps2)
}

/// Returns the setting `level` of the highest level of a vehicle.
fn highest_setting_mps2(
    run: &Run,
    vehicle: usize,
    settings: &TwoSidedSettings,
    highest_mps2: f64,
) -> Option<f64> {
    let level_mps2 = Some(1.0);
    let of_one = run.two_sided_shield(
        vehicle,
        &TwoSidedSettings {
            level_mps2,
            ..*settings
        },
    );
    let friction = run.scenario().spec().environment.friction;
    let noise_mps2 = of_one.ok()?.level_mps2 - friction;
    setting_mps2(highest_mps2, noise_mps2, friction)
}

/// Returns the certificate of a filter with these parameters.
///
/// # Errors
/// [`NoTwoSidedCertificate`] if the parameters are not covered.
pub fn filter_certificate(params: &TwoSidedParams) -> Result<Certificate, NoTwoSidedCertificate> {
    accepted(claim_without_start(params)?)
}

/// Returns the certificate of a plan for a state: the observation of the first step, and the commands.
///
/// # Errors
/// [`NoTwoSidedCertificate`] if the parameters are not covered, or the checker rejects the plan.
pub fn plan_certificate(
    params: &TwoSidedParams,
    observation: &Observation,
    plan: &PlanCommands,
) -> Result<Certificate, NoTwoSidedCertificate> {
    let mut claim = claim_without_start(params)?;
    claim.start = Some(start(params, observation, plan));
    accepted(claim)
}

/// Returns the certificate of the initial state of a vehicle of a run, with the level of the settings, or else the
/// limit of its leader.
///
/// # Errors
/// [`NoTwoSidedCertificate`] if a shield does not cover the vehicle, or there is no plan.
pub fn initial_state_certificate(
    run: &Run,
    vehicle: usize,
    settings: &TwoSidedSettings,
) -> Result<Certificate, NoTwoSidedCertificate> {
    let params = run.two_sided_shield(vehicle, settings)?;
    claim_without_start(&params)?;
    let observation = Stepper::new(run, RecordingLevel::Summary)
        .observe(vehicle)
        .ok_or(NoTwoSidedCertificate::NoObservation { vehicle })?;
    let mut meter = LevelMeter::new(params);
    meter.observe(&observation);
    let level_mps2 = params.level_mps2;
    let plan = meter.plan_commands(level_mps2);
    let plan = plan.ok_or_else(|| {
        let highest_mps2 = meter.level_mps2();
        NoTwoSidedCertificate::NoPlan {
            level_mps2,
            highest_mps2,
            setting_mps2: highest_setting_mps2(run, vehicle, settings, highest_mps2),
        }
    })?;
    plan_certificate(&params, &observation, &plan)
}

fn accepted(claim: TwoSidedClaim) -> Result<Certificate, NoTwoSidedCertificate> {
    let certificate = certificate_without_scenario(Statement::TwoSided(Box::new(claim)));
    crumple_verify::check(&certificate).map_err(NoTwoSidedCertificate::Rejected)?;
    Ok(certificate)
}

fn claim_without_start(params: &TwoSidedParams) -> Result<TwoSidedClaim, NoTwoSidedCertificate> {
    if params.response_fraction < 1.0 {
        return Err(NoTwoSidedCertificate::Lag);
    }
    Ok(TwoSidedClaim {
        follower: params.follower.map(claimed_class),
        leader_brakes_at_most_mps2: params.level_mps2,
        ego: claim::TwoSidedEgo {
            step_s: params.step_s,
            brake_mps2: params.brake_mps2,
            accel_mps2: params.accel_mps2,
            noise_mps2: params.noise_mps2,
            delay_steps: saturating(params.delay_steps),
        },
        observation_error: claim::ObservationErrors {
            gap_ahead_m: params.errors.gap_m,
            leader_speed_mps: params.errors.ahead_speed_mps,
            ego_speed_mps: params.errors.speed_mps,
            gap_behind_m: params.rear_errors.gap_m,
            follower_speed_mps: params.rear_errors.speed_mps,
        },
        start: None,
    })
}

/// The followers that a two-sided certificate covers, and the follower of its scenario.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScenarioFollower {
    /// The followers of the class, in words after "a follower that".
    pub followers: String,
    /// The driver of the scenario's follower, unless it is known to be of the class.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub driver_outside_class: Option<&'static str>,
}

impl ScenarioFollower {
    /// Compares the follower of vehicle `vehicle` with the class of the settings; `None` without a follower.
    #[must_use]
    pub fn of_vehicle(run: &Run, vehicle: usize, settings: &TwoSidedSettings) -> Option<Self> {
        let class = run.two_sided_shield(vehicle, settings).ok()?.follower?;
        Some(Self {
            followers: describe_followers(&class),
            driver_outside_class: run.driver_outside_class(vehicle, &class),
        })
    }

    /// Returns the note that the class may not contain the follower, which is vehicle `vehicle`.
    #[must_use]
    pub fn note(&self, vehicle: usize) -> Option<String> {
        let driver = self.driver_outside_class?;
        Some(describe_outside_class(vehicle, driver))
    }
}

/// Returns the followers of a class in words, after "a follower that".
#[must_use]
pub fn describe_followers(class: &FollowerClass) -> String {
    claimed_class(*class).describe()
}

fn claimed_class(class: FollowerClass) -> claim::CoveredFollowers {
    claim::CoveredFollowers {
        brakes_when: match class.trigger {
            FollowerTrigger::TimeToCollision(ttc_s) => claim::FollowerCue::TtcBelowS(ttc_s),
            FollowerTrigger::LeaderBrakes => claim::FollowerCue::EgoBrakes,
        },
        reaction_s: class.reaction_s,
        brake_mps2: class.brake_mps2,
        drift_mps2: class.drift_mps2,
    }
}

fn start(
    params: &TwoSidedParams,
    observation: &Observation,
    plan: &PlanCommands,
) -> claim::TwoSidedStart {
    let observed = |neighbour: Neighbour| claim::ObservedNeighbour {
        gap_m: neighbour.gap_m,
        speed_mps: neighbour.speed_mps,
    };
    let commands = plan.commands.iter();
    claim::TwoSidedStart {
        ego_speed_mps: observation.speed_mps,
        leader: observation.ahead.map(observed),
        follower: params.follower.and(observation.behind).map(observed),
        phase: match plan.phase {
            FollowerPhase::Waiting => claim::KnownPhase::Waiting,
            FollowerPhase::Unknown => claim::KnownPhase::Unknown,
            FollowerPhase::Braking(left_s) => claim::KnownPhase::BrakesWithinS(left_s),
        },
        plan: claim::TwoSidedPlan {
            commands: commands
                .map(|&(steps, command)| ConstantPiece(saturating(steps), command))
                .collect(),
            after_firing: plan.after_firing.as_ref().map(claimed_commands),
        },
    }
}

fn claimed_commands(after: &CommandsAfterFiring) -> claim::PlanAfterFiring {
    let steps = after.steps.iter();
    claim::PlanAfterFiring {
        accel_mps2: after.accel_mps2,
        steps: steps
            .map(|&(firings, steps)| ConstantPiece(saturating(firings), saturating(steps)))
            .collect(),
    }
}

fn saturating(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests;
