//! Motion of a scripted leader, which reacts to no vehicle.

use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{Motion, RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::scenario::{Driver, LeadProfile, Scenario, VehicleClass, VehicleSpec};

#[derive(Debug, Clone)]
pub(super) struct ScriptedLeader {
    pub(super) position_m: f64,
    pub(super) speed_mps: f64,
    pub(super) length_m: f64,
    pub(super) acceleration_mps2: Vec<f64>,
    /// Rear bumper at each instant.
    pub(super) rear_m: Vec<f64>,
    /// First step from which it stands.
    pub(super) standstill_step: usize,
}

impl ScriptedLeader {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let acceleration_mps2 = script_acceleration_mps2(scenario);
        let leader = scenario.vehicles().first();
        let length_m = leader.map_or(0.0, VehicleSpec::length_m);
        let position_m = leader.map_or(0.0, |leader| leader.position_m);
        let speed_mps = leader.map_or(0.0, |leader| leader.speed_mps);
        let mut motion = Motion {
            position_m,
            speed_mps,
            acceleration_mps2: 0.0,
        };
        let mut rear_m = vec![motion.position_m - length_m];
        for &step_mps2 in &acceleration_mps2 {
            motion = Motion {
                acceleration_mps2: step_mps2,
                ..motion
            }
            .after(scenario.spec().step_s);
            rear_m.push(motion.position_m - length_m);
        }
        let moves = rear_m
            .windows(2)
            .rposition(|pair| pair.first() != pair.last());
        let rests_from = moves.map_or(0, |step| step + 1);
        Self {
            position_m,
            speed_mps,
            length_m,
            acceleration_mps2,
            rear_m,
            standstill_step: rests_from,
        }
    }
}

/// Returns the acceleration of the scripted leader in each step. Without noise it is the command, also at standstill.
fn script_acceleration_mps2(scenario: &Scenario) -> Vec<f64> {
    let Some(leader) = scenario.vehicles().first() else {
        return Vec::new();
    };
    let Driver::Profile(profile) = &leader.driver else {
        return Vec::new();
    };
    if leader.acceleration_noise_mps2 > 0.0 {
        return simulated_acceleration_mps2(scenario);
    }
    let step_s = scenario.spec().step_s;
    let mut motion = Motion {
        position_m: 0.0,
        speed_mps: leader.speed_mps,
        acceleration_mps2: 0.0,
    };
    let mut accelerations_mps2 = Vec::with_capacity(scenario.steps());
    for step in 0..scenario.steps() {
        let command_mps2 = profile.acceleration_mps2(
            step as f64 * step_s,
            (step + 1) as f64 * step_s,
            motion.speed_mps,
        );
        let acceleration_mps2 = command_mps2
            .max(-scenario.usable_brake_mps2(0))
            .min(leader.max_accel_mps2());
        motion = Motion {
            acceleration_mps2,
            ..motion
        }
        .after(step_s);
        accelerations_mps2.push(acceleration_mps2);
    }
    accelerations_mps2
}

/// Returns the acceleration of the scripted leader in each step, by simulation.
fn simulated_acceleration_mps2(scenario: &Scenario) -> Vec<f64> {
    let alone = scenario.edited(|spec| {
        spec.vehicles.truncate(2);
        if let Some(follower) = spec.vehicles.get_mut(1) {
            *follower = VehicleSpec::new(
                VehicleClass::Light,
                -1e6,
                0.0,
                Driver::Profile(LeadProfile::ConstantSpeed),
            );
        }
    });
    let Ok(alone) = alone else { return Vec::new() };
    let Ok(run) = Run::new(
        &alone,
        RunOptions::new(BuiltInController::MatchLeader(Default::default())),
    ) else {
        return Vec::new();
    };
    let trace = simulate(&run, RecordingLevel::Trace).trace;
    let leader = trace.and_then(|trace| trace.vehicles.into_iter().next());
    leader.map_or(Vec::new(), |track| {
        track
            .acceleration_mps2
            .into_iter()
            .take(scenario.steps())
            .collect()
    })
}
