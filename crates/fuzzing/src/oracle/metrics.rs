//! Oracle: verdict, summary, trace and report agree.

use super::{Finding, OracleContext, OracleOutcome, OracleResult, ROUNDING_M, ensure, is_grazing};
use crate::Invariant;
use crumple_measure::CollisionRole;
use crumple_sim::engine::{AfterCollision, Outcome, VehiclePair};
use crumple_sim::scenario::Driver;

/// Checks that trace, outcome and role in the collision agree, and that no vehicle exceeds the limits of road and
/// vehicle.
///
/// # Errors
/// [`Invariant::MetricsAgree`], [`Invariant::Limits`] or [`Invariant::CollisionRole`].
pub fn metrics_agree(question: &OracleContext<'_>) -> OracleResult {
    check_outcome(question)?;
    for index in 0..question.result.vehicles.len() {
        check_braking(question, index)?;
        check_gaps(question, index)?;
    }
    check_limits(question)?;
    check_collision_role(question)?;
    Ok(OracleOutcome::Holds)
}

fn ensure_consistent(holds: bool, finding: impl FnOnce() -> String) -> Result<(), Finding> {
    ensure(holds, Invariant::MetricsAgree, finding)
}

/// True if the run ends at its first collision.
fn stops_at_collision(question: &OracleContext<'_>) -> bool {
    question.run.options().after_collision == AfterCollision::Stop
}

/// Checks that the outcome is the first impact, and that the trace ends with it or with the scenario.
fn check_outcome(question: &OracleContext<'_>) -> Result<(), Finding> {
    let result = &question.result;
    let scenario = &question.test_case.scenario;
    let first = result.impacts.first().map(|impact| impact.collision);
    let is_first = result.outcome.collision().copied() == first
        || result.outcome.failed_controller().is_some();
    ensure_consistent(is_first, || {
        "the outcome is not the first impact".to_owned()
    })?;
    let in_order = result.impacts.windows(2).all(|pair| match pair {
        [before, after] => before.collision.time_s <= after.collision.time_s,
        _ => true,
    });
    ensure_consistent(in_order, || "impacts are not in order of time".to_owned())?;
    let end_s = question.trace()?.time_s.last().copied().unwrap_or(f64::NAN);
    let has_right_end = match &result.outcome {
        Outcome::Collision(collision) if stops_at_collision(question) => end_s == collision.time_s,
        Outcome::ControllerFailed(failed) => {
            end_s == failed.time_s && can_controller_fail(question)
        }
        _ => (end_s - scenario.spec().duration_s).abs() < 1e-9,
    };
    ensure_consistent(has_right_end, || {
        format!("the trace ends at {end_s} s, with {:?}", result.outcome)
    })?;
    ensure_consistent(result.vehicles.len() == scenario.vehicles().len(), || {
        "a vehicle is missing".to_owned()
    })
}

/// Checks that the summary of vehicle `index` has the braking and the standstill of the trace.
fn check_braking(question: &OracleContext<'_>, index: usize) -> Result<(), Finding> {
    let result = &question.result;
    let vehicles = &question.trace()?.vehicles;
    let Some((summary, track)) = result.vehicles.get(index).zip(vehicles.get(index)) else {
        return Ok(());
    };
    // The last sample is not held for a step, and an impact just before it may have changed its acceleration.
    let is_last_excluded = !result.impacts.is_empty() && !stops_at_collision(question);
    let samples = track
        .acceleration_mps2
        .len()
        .saturating_sub(usize::from(is_last_excluded));
    let hardest_mps2 = track
        .acceleration_mps2
        .iter()
        .take(samples)
        .fold(0.0_f64, |hardest, a| hardest.max(-a));
    ensure_consistent(summary.max_brake_mps2 == hardest_mps2, || {
        format!(
            "vehicle {index} braked at {hardest_mps2} m/s², reported {}",
            summary.max_brake_mps2
        )
    })?;
    let stopped = track.speed_mps.last() == Some(&0.0);
    ensure_consistent(summary.stopped == stopped, || {
        format!("vehicle {index} stands: {stopped}, reported otherwise")
    })
}

/// Checks that the smallest gap of vehicle `index` agrees with the trace and its collisions.
fn check_gaps(question: &OracleContext<'_>, index: usize) -> Result<(), Finding> {
    let result = &question.result;
    let pairs = question.trace()?.pairs(index);
    let Some(summary) = result.vehicles.get(index).filter(|_| !pairs.is_empty()) else {
        return Ok(());
    };
    let gaps_m: Vec<f64> = pairs
        .iter()
        .flat_map(VehiclePair::gaps_m)
        .map(|(_, gap_m)| gap_m)
        .collect();
    let sampled_m = gaps_m.iter().copied().fold(f64::INFINITY, f64::min);
    let min_gap_m = summary.min_gap_m.unwrap_or(f64::NAN);
    let is_smallest = min_gap_m <= sampled_m.max(0.0) + ROUNDING_M;
    ensure_consistent(is_smallest, || {
        format!("vehicle {index}: smallest gap {min_gap_m} m, but a sample has {sampled_m} m")
    })?;
    let last_m = gaps_m.last().copied().unwrap_or(f64::NAN);
    ensure_consistent(min_gap_m >= 0.0, || {
        format!("vehicle {index}: the reported smallest gap is {min_gap_m} m")
    })?;
    let mut impacts = result.impacts.iter();
    let collides = impacts.any(|impact| impact.collision.rear_vehicle == index);
    // A run ends at its first collision, the foremost of simultaneous ones; the others are not recorded.
    let has_ended_run = stops_at_collision(question) && !result.impacts.is_empty();
    if has_ended_run && !collides && last_m.abs() < ROUNDING_M {
        return Ok(());
    }
    ensure_consistent(collides == (min_gap_m == 0.0), || {
        format!("vehicle {index} collides: {collides}, gap {min_gap_m} m")
    })?;
    let passes_through = !collides && sampled_m <= 0.0 && !is_grazing(result);
    ensure_consistent(!passes_through, || {
        format!("vehicle {index} passes through another: a gap of {sampled_m} m, and no collision")
    })?;
    ensure_consistent(!collides || last_m.abs() < ROUNDING_M, || {
        format!("vehicle {index} collides, but ends with a gap of {last_m} m")
    })
}

/// True for external controllers; only they can fail.
fn can_controller_fail(question: &OracleContext<'_>) -> bool {
    question.run.options().controller.can_fail()
}

/// Checks the limits of acceleration for vehicles without noise or impacts that push them.
fn check_limits(question: &OracleContext<'_>) -> Result<(), Finding> {
    let trace = question.trace()?;
    let scenario = &question.test_case.scenario;
    for (index, (vehicle, track)) in scenario.vehicles().iter().zip(&trace.vehicles).enumerate() {
        let mut impacts = question.result.impacts.iter();
        let is_pushed = question.run.options().after_collision.continues()
            && impacts.any(|impact| impact.involves(index));
        if vehicle.acceleration_noise_mps2 > 0.0 || is_pushed {
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
fn check_collision_role(question: &OracleContext<'_>) -> Result<(), Finding> {
    let trace = question.trace()?;
    let scenario = &question.test_case.scenario;
    let Some(collision) = question.result.outcome.collision() else {
        return Ok(());
    };
    let role = question.system.collision_role(collision, scenario);
    let ends_in_collision = (1..trace.vehicles.len()).any(|rear| {
        let pairs = trace.pairs(rear);
        let last = pairs.last().and_then(|pair| pair.gaps_m().last());
        last.is_some_and(|(_, gap_m)| gap_m < ROUNDING_M)
    });
    let [is_rear_tested, is_front_tested] =
        [collision.rear_vehicle, collision.front_vehicle].map(|index| {
            let vehicle = scenario.vehicles().get(index);
            vehicle.is_some_and(|vehicle| vehicle.driver == Driver::UnderTest)
        });
    let is_rear_recorded = scenario
        .vehicles()
        .get(collision.rear_vehicle)
        .is_some_and(|vehicle| vehicle.driver.name() == "recorded");
    let agrees = match role {
        CollisionRole::Hits => is_rear_tested && ends_in_collision,
        CollisionRole::HitFromBehind => !is_rear_tested && is_front_tested && !is_rear_recorded,
        CollisionRole::HitByRecording => is_rear_recorded && is_front_tested,
        CollisionRole::Bystander => !is_rear_tested && !is_front_tested,
    };
    ensure(agrees, Invariant::CollisionRole, || {
        format!("the reported role in the collision is {role:?}: {collision:?}")
    })
}
