//! Actions of scripted vehicles.
//!
//! Braking at a constant rate is a speed action by rate. Every other script is a speed profile with the speeds that the
//! simulation gives the vehicle alone on the road, which include the limits of the vehicle and the road.

use std::io;

use super::polyline::simplify_polyline;
use super::storyboard::{VehicleManeuver, write_speed_action};
use super::{OpenScenarioError, Xml, format_number, write_element, write_empty_element};
use crate::openscenario::vocabulary::{POSITION_MODE, TransitionDimension, TransitionShape, path};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::scenario::{
    BrakeToSpeed, Driver, LeadProfile, RecordedSpeeds, Scenario, VehicleSpec,
};

/// Maximum error of a speed profile, in m/s: one millimetre in a quarter of an hour.
const PROFILE_TOLERANCE_MPS: f64 = 1e-6;
/// Position of a second vehicle, which a scenario requires and which the scripted one never meets.
const DUMMY_FOLLOWER_POSITION_M: f64 = -1e6;

pub(super) struct ScriptedVehicle {
    index: usize,
    action: ScriptedAction,
}

enum ScriptedAction {
    /// Braking from a time on, at a rate, to a speed.
    Brake {
        onset_s: f64,
        rate_mps2: f64,
        final_speed_mps: f64,
    },
    /// Pairs of a time after the previous entry, in seconds, and a speed.
    Profile(Vec<(f64, f64)>),
    /// Constant speed.
    KeepSpeed,
}

pub(super) fn scripted_vehicles(
    scenario: &Scenario,
) -> Result<Vec<ScriptedVehicle>, OpenScenarioError> {
    let mut scripted = Vec::new();
    for (index, vehicle) in scenario.vehicles().iter().enumerate() {
        if let Driver::Profile(profile) = &vehicle.driver {
            let action = scripted_action(scenario, index, profile)?;
            scripted.push(ScriptedVehicle { index, action });
        }
    }
    Ok(scripted)
}

fn scripted_action(
    scenario: &Scenario,
    index: usize,
    profile: &LeadProfile,
) -> Result<ScriptedAction, OpenScenarioError> {
    match profile {
        LeadProfile::ConstantSpeed => Ok(ScriptedAction::KeepSpeed),
        LeadProfile::Brake(script) => Ok(braking_action(
            scenario,
            index,
            BrakeToSpeed {
                onset_s: script.onset_s,
                rate_mps2: script.rate_mps2,
                final_speed_mps: 0.0,
            },
        )),
        LeadProfile::BrakeToSpeed(script) => Ok(braking_action(scenario, index, script.clone())),
        LeadProfile::RampBrake(_) | LeadProfile::Pieces(_) => {
            Ok(simulate_alone(scenario, index)?.simplified_profile())
        }
        LeadProfile::Recorded(recorded) => {
            let speeds = simulate_alone(scenario, index)?;
            Ok(match recorded_entries(recorded, &speeds) {
                Some(entries) => ScriptedAction::Profile(entries),
                None => speeds.simplified_profile(),
            })
        }
    }
}

/// Returns the braking of a vehicle as the simulation limits it. It keeps its speed if it never brakes.
fn braking_action(scenario: &Scenario, index: usize, script: BrakeToSpeed) -> ScriptedAction {
    let BrakeToSpeed {
        onset_s,
        rate_mps2: wanted_mps2,
        final_speed_mps,
    } = script;
    let start_mps = scenario
        .vehicles()
        .get(index)
        .map_or(0.0, |vehicle| vehicle.speed_mps);
    let rate_mps2 = wanted_mps2.min(scenario.usable_brake_mps2(index));
    // With a rate of 0 the action would never end; after the end of the scenario it would never begin.
    let brakes =
        rate_mps2 > 0.0 && final_speed_mps < start_mps && onset_s < scenario.spec().duration_s;
    if !brakes {
        return ScriptedAction::KeepSpeed;
    }
    // In the step of the onset, the limit applies to the mean of the script: less braking is cut off.
    let step_s = scenario.spec().step_s;
    let step_end_s = ((onset_s / step_s).floor() + 1.0) * step_s;
    let braking_s = ((step_end_s - onset_s) * wanted_mps2 / rate_mps2).min(step_s);
    ScriptedAction::Brake {
        onset_s: if wanted_mps2 > rate_mps2 {
            step_end_s - braking_s
        } else {
            onset_s
        },
        rate_mps2,
        final_speed_mps,
    }
}

/// Speeds of a simulation at its steps.
#[derive(Default)]
struct SimulatedSpeeds {
    time_s: Vec<f64>,
    speed_mps: Vec<f64>,
}

impl SimulatedSpeeds {
    /// Returns a speed profile with as few entries as the tolerance permits.
    fn simplified_profile(&self) -> ScriptedAction {
        let samples =
            simplify_polyline(&self.time_s, &self.speed_mps, PROFILE_TOLERANCE_MPS, |_| {
                None
            });
        let mut before_s = 0.0;
        let entries = samples.into_iter().filter_map(|sample| {
            let now_s = *self.time_s.get(sample)?;
            let speed_mps = *self.speed_mps.get(sample)?;
            Some((now_s - std::mem::replace(&mut before_s, now_s), speed_mps))
        });
        ScriptedAction::Profile(entries.collect())
    }
}

/// Simulates a scripted vehicle alone on the road.
fn simulate_alone(scenario: &Scenario, index: usize) -> Result<SimulatedSpeeds, OpenScenarioError> {
    let options = RunOptions::new(BuiltInController::MatchLeader(Default::default()));
    let run = isolate_vehicle(scenario, index)
        .and_then(|alone| Run::new(&alone, options).map_err(|error| error.to_string()))
        .map_err(|why| OpenScenarioError::Script {
            vehicle: index,
            why,
        })?;
    let trace = simulate(&run, RecordingLevel::Trace).trace;
    let speeds = trace.and_then(|trace| {
        Some(SimulatedSpeeds {
            time_s: trace.time_s,
            speed_mps: trace.vehicles.into_iter().next()?.speed_mps,
        })
    });
    Ok(speeds.unwrap_or_default())
}

/// Returns the entries of recorded speeds as they are, if the vehicle follows them: an imported profile is exported
/// unchanged.
fn recorded_entries(
    recorded: &RecordedSpeeds,
    simulated: &SimulatedSpeeds,
) -> Option<Vec<(f64, f64)>> {
    let mut samples = simulated.time_s.iter().zip(&simulated.speed_mps);
    let follows = samples.all(|(time_s, mps)| {
        (recorded.speed_at_mps(*time_s) - mps).abs() <= 2.0 * PROFILE_TOLERANCE_MPS
    });
    let first_s = recorded.time_s.first()?;
    let last_s = recorded.time_s.last()?;
    // The recorded time is a sum of rounded durations.
    if !follows || *first_s != 0.0 || *last_s > *simulated.time_s.last()? + 1e-9 {
        return None;
    }
    let before_s = std::iter::once(&0.0).chain(&recorded.time_s);
    let after_s = recorded
        .time_s
        .iter()
        .zip(before_s)
        .map(|(now_s, before_s)| now_s - before_s);
    Some(after_s.zip(recorded.speed_mps.iter().copied()).collect())
}

/// Returns the scripted vehicle alone on the same road, without noise.
fn isolate_vehicle(scenario: &Scenario, index: usize) -> Result<Scenario, String> {
    let edited = scenario.edited(|spec| {
        let Some(mut scripted) = spec.vehicles.get(index).cloned() else {
            return;
        };
        scripted.acceleration_noise_mps2 = 0.0;
        scripted.position_m = 0.0;
        let still = Driver::Profile(LeadProfile::ConstantSpeed);
        let mut standing = VehicleSpec::new(scripted.class, DUMMY_FOLLOWER_POSITION_M, 0.0, still);
        standing.length_m = scripted.length_m;
        spec.vehicles = vec![scripted, standing];
    });
    edited.map_err(|invalid| invalid.to_string())
}

impl ScriptedVehicle {
    /// Returns the entries of the speed profile; empty for another action.
    pub(super) fn profile(&self) -> &[(f64, f64)] {
        if let ScriptedAction::Profile(entries) = &self.action {
            entries
        } else {
            &[]
        }
    }
}

impl VehicleManeuver for ScriptedVehicle {
    fn vehicle_index(&self) -> usize {
        self.index
    }

    fn start_event(&self) -> Option<(&'static str, f64)> {
        match self.action {
            ScriptedAction::Brake { onset_s, .. } => Some(("brake", onset_s)),
            ScriptedAction::Profile(_) => Some(("speeds", 0.0)),
            ScriptedAction::KeepSpeed => None,
        }
    }

    fn write_action(&self, xml: &mut Xml) -> io::Result<()> {
        match &self.action {
            ScriptedAction::KeepSpeed => Ok(()),
            ScriptedAction::Brake {
                rate_mps2,
                final_speed_mps,
                ..
            } => {
                let dynamics = (
                    TransitionShape::Linear,
                    TransitionDimension::Rate,
                    *rate_mps2,
                );
                write_speed_action(xml, dynamics, *final_speed_mps)
            }
            ScriptedAction::Profile(entries) => write_element(
                xml,
                path::SPEED_PROFILE_ACTION,
                &[("followingMode", POSITION_MODE)],
                |xml| {
                    entries.iter().try_for_each(|&(after_s, mps)| {
                        let [time, speed] = [after_s, mps].map(format_number);
                        write_empty_element(
                            xml,
                            "SpeedProfileEntry",
                            &[("time", &time), ("speed", &speed)],
                        )
                    })
                },
            ),
        }
    }
}
