//! Avoidability of a collision.

use crumple_core::digits::{format_fixed_down, format_fixed_up};
use crumple_search::worst_case::{AvoidOptions, AvoidanceVerdict, Escape, avoid};
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
    sentences: Vec<String>,
    /// Figure of the escape; empty if there is none.
    escape_figure: String,
}

/// Decides avoidability as `crumple avoid` does.
pub(crate) fn check_avoidability(
    scenario: &Scenario,
) -> Result<AvoidabilityResponse, RequestError> {
    let avoidance = avoid(scenario, AvoidOptions::default())
        .map_err(|error| RequestError::invalid("scenario", error))?;
    let answer = match &avoidance.verdict {
        AvoidanceVerdict::Avoidable(escape) => {
            format!(
                "Yes: this escape keeps {} m. A driver with knowledge of the future can drive like this.",
                format_fixed_down(escape.min_gap_m, 2)
            )
        }
        AvoidanceVerdict::Unavoidable(_) => {
            "No: every driver collides. This is proved, and the checker has accepted the proof."
                .to_owned()
        }
        AvoidanceVerdict::Undecided(reason) => format!("Undecided: {reason}"),
    };
    let bound = avoidance.min_gap_bound_m.map(|bound_m| {
        format!(
            "No driver keeps more than {} m. This is a computed bound without a certificate.",
            format_fixed_up(bound_m, 2)
        )
    });
    let sentences = [answer].into_iter().chain(bound).collect();
    let escape = avoidance.verdict.escape();
    Ok(AvoidabilityResponse {
        verdict: avoidance.verdict.class().name(),
        sentences,
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
