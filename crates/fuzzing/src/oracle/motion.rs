//! Oracle: vehicles move forwards and continuously, and braking adds no energy.

use super::{OracleContext, OracleOutcome, OracleResult, ROUNDING_M, ensure};
use crate::Invariant;
use crumple_sim::engine::{SimulationResult, Track};

/// State of a vehicle at a sample of a trace.
#[derive(Clone, Copy)]
struct KinematicSample {
    time_s: f64,
    position_m: f64,
    speed_mps: f64,
    acceleration_mps2: f64,
}

/// Two successive samples of a vehicle.
struct MotionStep {
    vehicle: usize,
    /// Number of the first sample, from 0.
    sample: usize,
    now: KinematicSample,
    next: KinematicSample,
}

/// Checks that no vehicle reverses, that positions follow from speeds, and that braking never adds energy.
///
/// # Errors
/// [`Invariant::ForwardMotion`], [`Invariant::Continuity`] or [`Invariant::Energy`].
pub fn motion_is_physical(question: &OracleContext<'_>) -> OracleResult {
    let trace = question.trace()?;
    for (vehicle, track) in trace.vehicles.iter().enumerate() {
        let samples = kinematic_samples(&trace.time_s, track);
        for (sample, pair) in samples.windows(2).enumerate() {
            let &[now, next] = pair else { continue };
            let step = MotionStep {
                vehicle,
                sample,
                now,
                next,
            };
            step.check_forward_motion()?;
            if !is_hit_between(&question.result, vehicle, now.time_s, next.time_s) {
                step.check_continuity()?;
            }
        }
    }
    Ok(OracleOutcome::Holds)
}

fn kinematic_samples(times_s: &[f64], track: &Track) -> Vec<KinematicSample> {
    let positions = times_s.iter().zip(&track.position_m);
    let speeds = track.speed_mps.iter().zip(&track.acceleration_mps2);
    positions
        .zip(speeds)
        .map(
            |((&time_s, &position_m), (&speed_mps, &acceleration_mps2))| KinematicSample {
                time_s,
                position_m,
                speed_mps,
                acceleration_mps2,
            },
        )
        .collect()
}

impl MotionStep {
    fn describe(&self, problem: &str) -> String {
        let Self {
            vehicle,
            sample,
            now,
            next,
        } = self;
        format!(
            "vehicle {vehicle} {problem} at sample {sample}, {} s: {} to {} m, {} to {} m/s",
            now.time_s, now.position_m, next.position_m, now.speed_mps, next.speed_mps
        )
    }

    fn ensure(
        &self,
        condition: bool,
        invariant: Invariant,
        problem: &str,
    ) -> Result<(), (Invariant, String)> {
        ensure(condition, invariant, || self.describe(problem))
    }

    fn check_forward_motion(&self) -> Result<(), (Invariant, String)> {
        let [speed_mps, next_mps] = [self.now, self.next].map(|sample| sample.speed_mps);
        let is_forward = speed_mps >= 0.0 && next_mps >= 0.0;
        self.ensure(is_forward, Invariant::ForwardMotion, "reverses")?;
        let has_advanced = self.next.position_m >= self.now.position_m;
        self.ensure(has_advanced, Invariant::ForwardMotion, "moves back")
    }

    fn check_continuity(&self) -> Result<(), (Invariant, String)> {
        let Self { now, next, .. } = self;
        let duration_s = next.time_s - now.time_s;
        let distance_m = next.position_m - now.position_m;
        let slower_m = now.speed_mps.min(next.speed_mps) * duration_s;
        let faster_m = now.speed_mps.max(next.speed_mps) * duration_s;
        let has_stopped = next.speed_mps == 0.0;
        let is_near = distance_m <= faster_m + ROUNDING_M;
        self.ensure(is_near, Invariant::Continuity, "leaps")?;
        let is_far = has_stopped || distance_m >= slower_m - ROUNDING_M;
        self.ensure(is_far, Invariant::Continuity, "lags behind its speed")?;
        let gains_no_energy = now.acceleration_mps2 > 0.0 || next.speed_mps <= now.speed_mps;
        self.ensure(
            gains_no_energy,
            Invariant::Energy,
            "gains energy from its brakes",
        )?;
        let gained_mps = now.acceleration_mps2 * duration_s;
        let excess_mps = next.speed_mps - now.speed_mps - gained_mps;
        let follows = has_stopped || excess_mps.abs() <= 1e-9;
        self.ensure(follows, Invariant::Continuity, "jumps in speed")
    }
}

fn is_hit_between(result: &SimulationResult, vehicle: usize, from_s: f64, to_s: f64) -> bool {
    result.impacts.iter().any(|impact| {
        impact.involves(vehicle) && (from_s - 1e-9..=to_s + 1e-9).contains(&impact.collision.time_s)
    })
}
