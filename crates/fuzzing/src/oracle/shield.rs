//! Oracle: a shield prevents collisions with the leader.

use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_sim::control::{BuiltIn, FullThrottle};
use crumple_sim::engine::{AfterCollision, Outcome, RecordingLevel, Run, RunError, RunOptions};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Driver;

/// Checks that full throttle behind a shield with the true state hits its leader only if the collision was unavoidable
/// when the shield first had to brake.
///
/// # Errors
/// [`Invariant::Shield`].
pub fn shield_prevents_front_collisions(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    let options = RunOptions {
        dt_s: question.run.options().dt_s,
        ..RunOptions::new(question.system.shielded_full_throttle())
    };
    let options = options
        .with_estimator(EstimatorKind::Truth)
        .with_after_collision(AfterCollision::Stop);
    let run = match Run::new(scenario, options) {
        Ok(run) => run,
        // A shield refuses vehicles that it cannot protect.
        Err(RunError::Shield { .. }) => return Ok(OracleOutcome::NotApplicable),
        Err(error) => return Err((Invariant::Runnable, error.to_string())),
    };
    let result = question.system.simulate(&run, RecordingLevel::Summary);
    let Outcome::Collision(collision) = result.outcome else {
        return Ok(OracleOutcome::Holds);
    };
    let striker = collision.rear_vehicle;
    if scenario
        .vehicles()
        .get(striker)
        .is_none_or(|vehicle| vehicle.driver != Driver::UnderTest)
    {
        return Ok(OracleOutcome::Holds);
    }
    let hopeless = result
        .interventions
        .iter()
        .any(|i| i.vehicle == striker && i.outside_kernel);
    ensure(hopeless, Invariant::Shield, || {
        let name = FullThrottle::NAME;
        format!(
            "shield:{name} hits the vehicle ahead of {striker} at {} s, out of the kernel",
            collision.time_s
        )
    })?;
    Ok(OracleOutcome::NotApplicable)
}
