//! Avoidability of a collision.

use crumple_search::worst_case::{AvoidOptions, AvoidReport, Escape, avoid};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use serde::Serialize;

use crate::error::RequestError;
use crate::render::render_replay;

#[derive(Debug, Serialize)]
pub(crate) struct AvoidabilityResponse {
    /// `avoidable`, `unavoidable` or `undecided`.
    verdict: &'static str,
    statements: Vec<String>,
    /// Figure of the escape; empty if there is none.
    escape_figure: String,
}

/// Decides avoidability as `crumple avoid` does.
pub(crate) fn check_avoidability(
    scenario: &Scenario,
) -> Result<AvoidabilityResponse, RequestError> {
    let avoidance = avoid(scenario, AvoidOptions::default())
        .map_err(|error| RequestError::invalid("scenario", error))?;
    let escape = avoidance.verdict.escape();
    let mut statements = AvoidReport::new(scenario, &avoidance).main_statements();
    if escape.is_some() {
        statements
            .push("a driver with knowledge of the future can drive like this escape".to_owned());
    }
    Ok(AvoidabilityResponse {
        verdict: avoidance.verdict.class().name(),
        statements,
        escape_figure: escape
            .map_or(Ok(String::new()), |escape| render_escape(scenario, escape))?,
    })
}

/// Renders an escape, whose vehicles follow scripts, so that the controller of the run has no influence.
fn render_escape(scenario: &Scenario, escape: &Escape) -> Result<String, RequestError> {
    let options = RunOptions::new(BuiltInController::MatchLeader(Default::default()))
        .with_estimator(EstimatorKind::Truth);
    let run = Run::new(&escape.scenario, options)
        .map_err(|error| RequestError::Internal(error.to_string()))?;
    Ok(render_replay(
        scenario,
        &simulate(&run, RecordingLevel::Trace),
        "An escape",
    ))
}
