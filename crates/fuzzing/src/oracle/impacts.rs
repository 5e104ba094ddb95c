//! Oracle: impacts are perfectly inelastic.

use std::ops::RangeInclusive;

use super::{Finding, OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_sim::engine::{AfterCollision, Impact, Trace};

/// Largest gap between two vehicles that stick together, in metres.
const COLLISION_TOLERANCE_M: f64 = 1e-8;

/// Checks that every impact conserves momentum and adds no energy, and that collided bodies stay together and collide
/// once.
///
/// # Errors
/// [`Invariant::Momentum`], [`Invariant::Energy`] or [`Invariant::Sticking`].
pub fn impacts_are_inelastic(question: &OracleContext<'_>) -> OracleResult {
    let trace = question.trace()?;
    let impacts = &question.result.impacts;
    for impact in impacts {
        check_impact(trace, impact)?;
    }
    if question.run.options().after_collision == AfterCollision::Stop {
        ensure(impacts.len() <= 1, Invariant::Sticking, || {
            format!("{} impacts in a run that ends at one", impacts.len())
        })?;
        return Ok(OracleOutcome::Holds);
    }
    for (index, impact) in impacts.iter().enumerate() {
        let rear = impact.collision.rear_vehicle;
        let again = impacts
            .iter()
            .skip(index + 1)
            .any(|later| later.collision.rear_vehicle == rear);
        ensure(!again, Invariant::Sticking, || {
            format!("vehicle {rear} hits the same vehicle twice")
        })?;
        check_stays_together(trace, impact)?;
    }
    Ok(OracleOutcome::Holds)
}

/// Checks that the two vehicles of an impact have no gap and equal speeds afterwards.
fn check_stays_together(trace: &Trace, impact: &Impact) -> Result<(), Finding> {
    let rear = impact.collision.rear_vehicle;
    let pairs = trace.pairs(rear);
    let Some(pair) = pairs.last() else {
        return Ok(());
    };
    let samples = pair.gaps_m().filter_map(|(sample, gap_m)| {
        let front_mps = pair.front.speed_mps.get(sample)?;
        let rear_mps = pair.rear.speed_mps.get(sample)?;
        Some((trace.time_s.get(sample)?, gap_m, front_mps, rear_mps))
    });
    for (t, gap_m, front_mps, rear_mps) in samples {
        let are_together = gap_m.abs() < COLLISION_TOLERANCE_M && front_mps == rear_mps;
        let is_after = *t > impact.collision.time_s + 1e-9;
        ensure(!is_after || are_together, Invariant::Sticking, || {
            format!(
                "vehicle {rear} at {t} s: {gap_m} m from the vehicle that it hit, {rear_mps} against {front_mps} m/s"
            )
        })?;
    }
    Ok(())
}

/// Returns the mass of those vehicles that are involved in an impact, in kg.
fn involved_mass_kg(trace: &Trace, impact: &Impact, vehicles: RangeInclusive<usize>) -> f64 {
    vehicles
        .filter(|vehicle| !impact.beside.contains(vehicle))
        .filter_map(|vehicle| trace.vehicles.get(vehicle))
        .map(|track| track.mass_kg)
        .sum()
}

fn check_impact(trace: &Trace, impact: &Impact) -> Result<(), Finding> {
    let collision = &impact.collision;
    let front_kg = involved_mass_kg(
        trace,
        impact,
        impact.first_involved..=collision.front_vehicle,
    );
    let rear_kg = involved_mass_kg(trace, impact, collision.rear_vehicle..=impact.last_involved);
    let [front_mps, rear_mps] = [collision.front_speed_mps, collision.rear_speed_mps];
    let common_mps = impact.common_speed_mps;
    let at = |what: &str| {
        format!(
            "{what}: {front_kg} kg at {front_mps} m/s and {rear_kg} kg at {rear_mps} m/s make {common_mps} m/s"
        )
    };
    let momentum = front_kg * front_mps + rear_kg * rear_mps;
    let is_conserved =
        (momentum - (front_kg + rear_kg) * common_mps).abs() <= 1e-9 * momentum.max(1.0);
    ensure(is_conserved, Invariant::Momentum, || at("momentum changes"))?;
    let energy = front_kg * front_mps * front_mps + rear_kg * rear_mps * rear_mps;
    let energy_after = (front_kg + rear_kg) * common_mps * common_mps;
    let adds_no_energy = energy_after <= energy * (1.0 + 1e-12);
    ensure(adds_no_energy, Invariant::Energy, || at("energy increases"))?;
    let apart_mps = (collision.impact_speed_mps - (rear_mps - front_mps)).abs();
    ensure(apart_mps <= 1e-9, Invariant::Momentum, || {
        at("the impact speed differs")
    })?;
    ensure(
        collision.impact_speed_mps >= -1e-9,
        Invariant::Continuity,
        || at("the vehicle hits a faster leader"),
    )?;
    let gained = impact.delta_v_mps(collision.front_vehicle) - (common_mps - front_mps);
    let lost = impact.delta_v_mps(collision.rear_vehicle) - (rear_mps - common_mps);
    ensure(
        gained.abs() < 1e-12 && lost.abs() < 1e-12,
        Invariant::Momentum,
        || at("a reported change of speed is wrong"),
    )
}
