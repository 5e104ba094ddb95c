//! Oracle: verdict, summary, trace and report agree.

use super::{OracleContext, OracleOutcome, OracleResult, ROUNDING_M, ensure, is_grazing};
use crate::Invariant;
use crumple_measure::ContactRole;
use crumple_sim::engine::{AfterContact, Outcome, VehiclePair};
use crumple_sim::scenario::Driver;

/// Checks that trace, outcome and role in the collision agree, and that no vehicle exceeds the limits of road and
/// vehicle.
///
/// # Errors
/// [`Invariant::MetricsAgree`], [`Invariant::Limits`] or [`Invariant::ContactRole`].
pub fn metrics_agree(question: &OracleContext<'_>) -> OracleResult {
    let (trace, result, scenario) = (
        question.trace()?,
        &question.result,
        &question.test_case.scenario,
    );
    let ensure_consistent =
        |holds: bool, finding: &dyn Fn() -> String| ensure(holds, Invariant::MetricsAgree, finding);
    let stops = question.run.options().after_contact == AfterContact::Stop;
    let first = result.impacts.first().map(|impact| impact.contact);
    let is_first =
        result.outcome.contact().copied() == first || result.outcome.failed_controller().is_some();
    ensure_consistent(is_first, &|| {
        "the outcome is not the first impact".to_owned()
    })?;
    let in_order = result.impacts.windows(2).all(|pair| match pair {
        [before, after] => before.contact.time_s <= after.contact.time_s,
        _ => true,
    });
    ensure_consistent(in_order, &|| "impacts are not in order of time".to_owned())?;
    let end_s = trace.time_s.last().copied().unwrap_or(f64::NAN);
    let ended = match &result.outcome {
        Outcome::Collision(contact) if stops => end_s == contact.time_s,
        Outcome::ControllerFailed(failed) => {
            end_s == failed.time_s && can_controller_fail(question)
        }
        _ => (end_s - scenario.spec().duration_s).abs() < 1e-9,
    };
    ensure_consistent(ended, &|| {
        format!("the trace ends at {end_s} s, with {:?}", result.outcome)
    })?;
    ensure_consistent(result.vehicles.len() == scenario.vehicles().len(), &|| {
        "a vehicle is missing".to_owned()
    })?;
    for (index, (summary, track)) in result.vehicles.iter().zip(&trace.vehicles).enumerate() {
        // The last sample is not held for a step, and an impact just before it may have changed its acceleration.
        let held = track
            .acceleration_mps2
            .len()
            .saturating_sub(usize::from(!result.impacts.is_empty() && !stops));
        let hardest_mps2 = track
            .acceleration_mps2
            .iter()
            .take(held)
            .fold(0.0_f64, |hardest, a| hardest.max(-a));
        let braked = summary.max_brake_mps2 == hardest_mps2;
        ensure_consistent(braked, &|| {
            format!(
                "vehicle {index} braked at {hardest_mps2} m/s², reported {}",
                summary.max_brake_mps2
            )
        })?;
        let stopped = track.speed_mps.last() == Some(&0.0);
        ensure_consistent(summary.stopped == stopped, &|| {
            format!("vehicle {index} stands: {stopped}, reported otherwise")
        })?;
        let pairs = trace.pairs(index);
        if pairs.is_empty() {
            continue;
        }
        let gaps_m: Vec<f64> = pairs
            .iter()
            .flat_map(VehiclePair::gaps_m)
            .map(|(_, gap_m)| gap_m)
            .collect();
        let sampled_m = gaps_m.iter().copied().fold(f64::INFINITY, f64::min);
        let min_gap_m = summary.min_gap_m.unwrap_or(f64::NAN);
        let below = min_gap_m <= sampled_m.max(0.0) + ROUNDING_M;
        ensure_consistent(below, &|| {
            format!("vehicle {index}: smallest gap {min_gap_m} m, but a sample has {sampled_m} m")
        })?;
        let ends_m = gaps_m.last().copied().unwrap_or(f64::NAN);
        ensure_consistent(min_gap_m >= 0.0, &|| {
            format!("vehicle {index}: the reported smallest gap is {min_gap_m} m")
        })?;
        let collides = result
            .impacts
            .iter()
            .any(|impact| impact.contact.rear_vehicle == index);
        // A run ends at its first collision, the foremost of simultaneous ones; the others are not recorded.
        let at_once = stops && first.is_some() && !collides && ends_m.abs() < ROUNDING_M;
        if at_once {
            continue;
        }
        ensure_consistent(collides == (min_gap_m == 0.0), &|| {
            format!("vehicle {index} collides: {collides}, gap {min_gap_m} m")
        })?;
        let through = !collides && sampled_m <= 0.0 && !is_grazing(result);
        ensure_consistent(!through, &|| {
            format!(
                "vehicle {index} passes through another: a gap of {sampled_m} m, and no collision"
            )
        })?;
        let in_contact = !collides || ends_m.abs() < ROUNDING_M;
        ensure_consistent(in_contact, &|| {
            format!("vehicle {index} collides, but ends with a gap of {ends_m} m")
        })?;
    }
    check_limits(question)?;
    check_contact_role(question)?;
    Ok(OracleOutcome::Holds)
}

/// True for external controllers; only they can fail.
fn can_controller_fail(question: &OracleContext<'_>) -> bool {
    question.run.options().controller.can_fail()
}

/// Checks the limits of acceleration for vehicles without noise or impacts that push them.
fn check_limits(question: &OracleContext<'_>) -> Result<(), (Invariant, String)> {
    let (trace, scenario) = (question.trace()?, &question.test_case.scenario);
    for (index, (vehicle, track)) in scenario.vehicles().iter().zip(&trace.vehicles).enumerate() {
        let involved = |impact: &crumple_sim::engine::Impact| impact.involves(index);
        let pushed = question.run.options().after_contact == AfterContact::Continue
            && question.result.impacts.iter().any(involved);
        if vehicle.acceleration_noise_mps2 > 0.0 || pushed {
            continue;
        }
        let usable_mps2 = vehicle.max_brake_mps2() * scenario.spec().environment.friction;
        let allowed = -usable_mps2 - 1e-12..=vehicle.max_accel_mps2() + 1e-12;
        let beyond = track
            .acceleration_mps2
            .iter()
            .find(|a| !allowed.contains(*a));
        ensure(beyond.is_none(), Invariant::Limits, || {
            format!("vehicle {index} accelerates at {beyond:?} m/s², not {allowed:?}")
        })?;
    }
    Ok(())
}

/// Checks the role in the collision against the pair whose gap is closed at the end of the trace.
fn check_contact_role(question: &OracleContext<'_>) -> Result<(), (Invariant, String)> {
    let (trace, scenario) = (question.trace()?, &question.test_case.scenario);
    let Some(contact) = question.result.outcome.contact() else {
        return Ok(());
    };
    let role = question.system.contact_role(contact, scenario);
    let closed = |rear: &usize| {
        let gap_m = trace
            .pairs(*rear)
            .last()
            .and_then(|pair| pair.gaps_m().last());
        gap_m.is_some_and(|(_, gap_m)| gap_m < ROUNDING_M)
    };
    let touching = (1..trace.vehicles.len()).find(closed);
    let under_test = |index: usize| {
        scenario
            .vehicles()
            .get(index)
            .is_some_and(|v| v.driver == Driver::UnderTest)
    };
    let tested = (
        under_test(contact.rear_vehicle),
        under_test(contact.front_vehicle),
    );
    let agrees = match role {
        ContactRole::Hits => tested.0 && touching.is_some(),
        ContactRole::HitFromBehind => tested == (false, true),
        ContactRole::Bystander => tested == (false, false),
    };
    ensure(agrees, Invariant::ContactRole, || {
        format!("the reported role in the collision is {role:?}: {contact:?}")
    })
}
