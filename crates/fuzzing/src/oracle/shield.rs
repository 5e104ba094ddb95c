//! What a shield promises, whatever it is wrapped around.

use super::{Checked, Finding, Question, must};
use crate::Law;
use crumple_world::control::{BuiltIn, FullThrottle};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Driver;
use crumple_world::sim::{AfterContact, Outcome, RecordingLevel, Run, RunError, RunOptions};

/// Behind a shield that knows the truth, full throttle hits the vehicle ahead only where there was no way out when the
/// shield first had to brake.
///
/// # Errors
/// [`Law::Shield`].
pub fn shield_prevents_front_collisions(question: &Question<'_>) -> Finding {
    let scenario = &question.test_case.scenario;
    let options = RunOptions { dt_s: question.run.options().dt_s, ..RunOptions::new(question.system.full_throttle()) };
    let options = options.with_estimator(EstimatorKind::Truth).with_after_contact(AfterContact::Stop);
    let run = match Run::new(scenario, options) {
        Ok(run) => run,
        // A shield refuses vehicles it cannot vouch for.
        Err(RunError::Shield { .. }) => return Ok(Checked::DoesNotApply),
        Err(error) => return Err((Law::Runs, error.to_string())),
    };
    let result = question.system.simulate(&run, RecordingLevel::Summary);
    let Outcome::Collision(contact) = result.outcome else { return Ok(Checked::Holds) };
    let striker = contact.rear_vehicle;
    if scenario.vehicles().get(striker).is_none_or(|vehicle| vehicle.driver != Driver::UnderTest) {
        return Ok(Checked::Holds);
    }
    let hopeless = result.interventions.iter().any(|i| i.vehicle == striker && i.outside_kernel);
    must(hopeless, Law::Shield, || {
        let name = FullThrottle::NAME;
        format!("shield:{name} hits the vehicle ahead of {striker} at {} s, out of the kernel", contact.time_s)
    })?;
    Ok(Checked::DoesNotApply)
}
