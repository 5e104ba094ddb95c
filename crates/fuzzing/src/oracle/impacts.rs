//! Oracle: impacts are perfectly inelastic.

use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_sim::engine::{AfterContact, Impact, Trace};

/// Largest gap between two vehicles that stick together, in metres.
const CONTACT_TOLERANCE_M: f64 = 1e-8;

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
    if question.run.options().after_contact == AfterContact::Stop {
        ensure(impacts.len() <= 1, Invariant::Sticking, || {
            format!("{} impacts in a run that ends at one", impacts.len())
        })?;
        return Ok(OracleOutcome::Holds);
    }
    for (index, impact) in impacts.iter().enumerate() {
        let rear = impact.contact.rear_vehicle;
        let again = impacts
            .iter()
            .skip(index + 1)
            .any(|later| later.contact.rear_vehicle == rear);
        ensure(!again, Invariant::Sticking, || {
            format!("vehicle {rear} hits the same vehicle twice")
        })?;
        let pairs = trace.pairs(rear);
        let Some(pair) = pairs.last() else { continue };
        let speeds = |sample: usize| {
            pair.front
                .speed_mps
                .get(sample)
                .zip(pair.rear.speed_mps.get(sample))
        };
        let samples = pair.gaps_m().filter_map(|(sample, gap_m)| {
            Some((trace.time_s.get(sample)?, gap_m, speeds(sample)?))
        });
        for (t, gap_m, (front, behind)) in samples {
            let together = gap_m.abs() < CONTACT_TOLERANCE_M && front == behind;
            let is_after = *t > impact.contact.time_s + 1e-9;
            ensure(!is_after || together, Invariant::Sticking, || {
                format!(
                    "vehicle {rear} at {t} s: {gap_m} m from the vehicle that it hit, {behind} against {front} m/s"
                )
            })?;
        }
    }
    Ok(OracleOutcome::Holds)
}

fn check_impact(trace: &Trace, impact: &Impact) -> Result<(), (Invariant, String)> {
    let contact = &impact.contact;
    let mass_kg = |vehicles: std::ops::RangeInclusive<usize>| -> f64 {
        let involved = vehicles.filter(|vehicle| !impact.beside.contains(vehicle));
        involved
            .filter_map(|vehicle| trace.vehicles.get(vehicle))
            .map(|track| track.mass_kg)
            .sum()
    };
    let front_kg = mass_kg(impact.first_involved..=contact.front_vehicle);
    let rear_kg = mass_kg(contact.rear_vehicle..=impact.last_involved);
    let [front_mps, rear_mps] = [contact.front_speed_mps, contact.rear_speed_mps];
    let common_mps = impact.common_speed_mps;
    let at = |what: &str| {
        format!(
            "{what}: {front_kg} kg at {front_mps} m/s and {rear_kg} kg at {rear_mps} m/s make {common_mps} m/s"
        )
    };
    let momentum = front_kg * front_mps + rear_kg * rear_mps;
    let kept = (momentum - (front_kg + rear_kg) * common_mps).abs() <= 1e-9 * momentum.max(1.0);
    ensure(kept, Invariant::Momentum, || at("momentum changes"))?;
    let energy = front_kg * front_mps * front_mps + rear_kg * rear_mps * rear_mps;
    let left = (front_kg + rear_kg) * common_mps * common_mps;
    ensure(left <= energy * (1.0 + 1e-12), Invariant::Energy, || {
        at("energy increases")
    })?;
    let apart_mps = (contact.impact_speed_mps - (rear_mps - front_mps)).abs();
    ensure(apart_mps <= 1e-9, Invariant::Momentum, || {
        at("the impact speed differs")
    })?;
    ensure(
        contact.impact_speed_mps >= -1e-9,
        Invariant::Continuity,
        || at("the vehicle hits a faster leader"),
    )?;
    let gained = impact.delta_v_mps(contact.front_vehicle) - (common_mps - front_mps);
    let lost = impact.delta_v_mps(contact.rear_vehicle) - (rear_mps - common_mps);
    ensure(
        gained.abs() < 1e-12 && lost.abs() < 1e-12,
        Invariant::Momentum,
        || at("a reported change of speed is wrong"),
    )
}
