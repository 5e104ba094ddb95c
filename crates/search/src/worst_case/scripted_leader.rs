//! Motion of a scripted leader, which reacts to no vehicle, in all scenarios of a box.

use crumple_verify::Interval;

use crumple_world::control::ControllerSpec;
use crumple_world::scenario::{Driver, LeadProfile, Scenario, VehicleClass, VehicleSpec};
use crumple_world::sim::{Motion, RecordingLevel, Run, RunOptions, simulate};

#[derive(Debug, Clone)]
pub(super) struct ScriptedLeader {
    pub(super) position_m: Interval,
    pub(super) speed_mps: Interval,
    pub(super) length_m: f64,
    pub(super) acceleration_mps2: Vec<Interval>,
    /// Rear bumper at each instant.
    pub(super) rear_m: Vec<Interval>,
    /// First step from which it stands in every scenario of the box.
    pub(super) standstill_step: usize,
}

impl ScriptedLeader {
    pub(super) fn new(low: &Scenario, high: &Scenario) -> Self {
        let (one, other) = (script_acceleration_mps2(low), script_acceleration_mps2(high));
        let hull = one.iter().zip(&other).map(|(&a, &b)| interval_hull(a, b));
        let driver = |scenario: &Scenario| scenario.vehicles().first().map(|leader| leader.driver.clone());
        let mut hardest = Interval::point(0.0);
        // If rate or onset vary, one end of the box may stand while other members still brake. Its acceleration is then
        // 0, so the hardest braking so far is kept in the interval.
        let acceleration_mps2: Vec<Interval> = if driver(low) == driver(high) {
            hull.collect()
        } else {
            hull.map(|span| {
                hardest = hardest.hull(Interval::point(span.low()));
                span.hull(Interval::point(hardest.low()))
            })
            .collect()
        };
        let first = |of: fn(&VehicleSpec) -> f64| {
            let of = |scenario: &Scenario| scenario.vehicles().first().map_or(0.0, of);
            interval_hull(of(low), of(high))
        };
        let length_m = low.vehicles().first().map_or(0.0, VehicleSpec::length_m);
        let (position_m, speed_mps) = (first(|v| v.position_m), first(|v| v.speed_mps));
        let drive = |pick: fn(Interval) -> f64| {
            let mut motion =
                Motion { position_m: pick(position_m), speed_mps: pick(speed_mps), acceleration_mps2: 0.0 };
            let mut rear_m = vec![motion.position_m - length_m];
            for span in &acceleration_mps2 {
                motion = Motion { acceleration_mps2: pick(*span), ..motion }.after(low.spec().step_s);
                rear_m.push(motion.position_m - length_m);
            }
            rear_m
        };
        let (rearmost, foremost) = (drive(Interval::low), drive(Interval::high));
        let rear_m: Vec<Interval> =
            rearmost.iter().zip(&foremost).map(|(&low, &high)| interval_hull(low, high)).collect();
        let moves = rear_m.windows(2).rposition(|pair| pair.first() != pair.last());
        let rests_from = moves.map_or(0, |step| step + 1);
        Self { position_m, speed_mps, length_m, acceleration_mps2, rear_m, standstill_step: rests_from }
    }
}

pub(super) fn interval_hull(one: f64, other: f64) -> Interval {
    Interval::point(one).hull(Interval::point(other))
}

/// Returns the acceleration of the scripted leader in each step. Without noise it is the command, also at standstill,
/// because another member of the box may still move. Commands never increase with speed, so the commands of the two
/// ends bound those of all members.
fn script_acceleration_mps2(scenario: &Scenario) -> Vec<f64> {
    let Some(leader) = scenario.vehicles().first() else { return Vec::new() };
    let Driver::Profile(profile) = &leader.driver else { return Vec::new() };
    if leader.acceleration_noise_mps2 > 0.0 {
        return simulated_acceleration_mps2(scenario);
    }
    let step_s = scenario.spec().step_s;
    let mut motion = Motion { position_m: 0.0, speed_mps: leader.speed_mps, acceleration_mps2: 0.0 };
    let of_step = |step: usize| {
        let asked = profile.acceleration_mps2(step as f64 * step_s, (step + 1) as f64 * step_s, motion.speed_mps);
        let acceleration_mps2 = asked.max(-scenario.usable_brake_mps2(0)).min(leader.max_accel_mps2());
        motion = Motion { acceleration_mps2, ..motion }.after(step_s);
        acceleration_mps2
    };
    (0..scenario.steps()).map(of_step).collect()
}

/// Returns the acceleration of the scripted leader in each step, by simulation.
fn simulated_acceleration_mps2(scenario: &Scenario) -> Vec<f64> {
    let alone = scenario.edited(|spec| {
        spec.vehicles.truncate(2);
        if let Some(other) = spec.vehicles.get_mut(1) {
            *other = VehicleSpec::new(VehicleClass::Light, -1e6, 0.0, Driver::Profile(LeadProfile::ConstantSpeed));
        }
    });
    let Ok(alone) = alone else { return Vec::new() };
    let Ok(run) = Run::new(&alone, RunOptions::new(ControllerSpec::MatchLeader(Default::default()))) else {
        return Vec::new();
    };
    let trace = simulate(&run, RecordingLevel::Trace).trace;
    let leader = trace.and_then(|trace| trace.vehicles.into_iter().next());
    leader.map_or(Vec::new(), |track| track.acceleration_mps2.into_iter().take(scenario.steps()).collect())
}
