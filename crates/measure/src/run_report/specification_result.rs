//! Results of specifications, with the robustness of the parts of formulas.

use serde::Serialize;

use crate::specification::{Specification, SpecificationError};
use crate::stl::FormulaPart;
use crumple_core::non_finite;
use crumple_sim::engine::{
    AfterCollision, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
use crumple_sim::scenario::Scenario;

/// Result of a specification.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpecificationResult {
    /// Text of the specification.
    pub specification: String,
    /// True if the run satisfies it.
    pub satisfied: bool,
    /// Negative if and only if the specification is violated.
    #[serde(with = "non_finite")]
    pub robustness: f64,
    /// The formula and its parts, if they are requested.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartReport>,
}

/// Robustness of a part of a formula, at each step `dt_s` of the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartReport {
    depth: usize,
    formula: String,
    robustness: Vec<Robustness>,
    /// The part.
    #[serde(skip)]
    pub part: FormulaPart,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Robustness(#[serde(with = "non_finite")] f64);

/// Simulated runs of one scenario. Specifications that need the same kind of run share one.
struct SharedRuns<'a> {
    scenario: &'a Scenario,
    options: &'a RunOptions,
    simulated: Vec<SharedRun>,
}

struct SharedRun {
    recording_level: RecordingLevel,
    after_collision: AfterCollision,
    run: Run,
    result: SimulationResult,
}

impl SpecificationResult {
    /// Evaluates specifications, given as texts, on simulations of a scenario; those that need the same kind of run
    /// share one. `options` has controller, estimator and step.
    ///
    /// # Errors
    /// [`SpecificationError`] for a text that is no specification of this scenario, or cannot be evaluated.
    pub fn evaluate_all(
        texts: &[String],
        scenario: &Scenario,
        options: &RunOptions,
        with_parts: bool,
    ) -> Result<Vec<Self>, SpecificationError> {
        let mut runs = SharedRuns {
            scenario,
            options,
            simulated: Vec::new(),
        };
        texts
            .iter()
            .map(|text| {
                let specification = Specification::parse(text, scenario)?;
                Self::evaluate(&specification, runs.find(&specification)?, with_parts)
            })
            .collect()
    }

    fn evaluate(
        specification: &Specification,
        shared: &SharedRun,
        with_parts: bool,
    ) -> Result<Self, SpecificationError> {
        let verdict = specification.evaluate(&shared.run, &shared.result)?;
        let parts = if with_parts {
            specification.parts_over_time(&shared.run, &shared.result)?
        } else {
            Vec::new()
        };
        Ok(Self {
            specification: specification.to_string(),
            satisfied: !verdict.is_violation(),
            robustness: verdict.robustness,
            parts: parts.into_iter().map(PartReport::from).collect(),
        })
    }
}

impl SharedRuns<'_> {
    /// Returns the run that a specification needs; simulates it if there is none.
    fn find(&mut self, specification: &Specification) -> Result<&SharedRun, SpecificationError> {
        let recording_level = specification.recording_level();
        let after_collision = specification.after_collision();
        let existing = self.simulated.iter().position(|shared| {
            shared.recording_level == recording_level && shared.after_collision == after_collision
        });
        let index = match existing {
            Some(index) => index,
            None => {
                let run = self.simulate(recording_level, after_collision)?;
                self.simulated.push(run);
                self.simulated.len() - 1
            }
        };
        Ok(&self.simulated[index])
    }

    fn simulate(
        &self,
        recording_level: RecordingLevel,
        after_collision: AfterCollision,
    ) -> Result<SharedRun, SpecificationError> {
        let options = self.options.clone().with_after_collision(after_collision);
        let run = Run::new(self.scenario, options)?;
        let result = simulate(&run, recording_level);
        Ok(SharedRun {
            recording_level,
            after_collision,
            run,
            result,
        })
    }
}

impl From<FormulaPart> for PartReport {
    fn from(part: FormulaPart) -> Self {
        let robustness = part.robustness.iter().copied().map(Robustness).collect();
        Self {
            depth: part.depth,
            formula: part.formula.to_string(),
            robustness,
            part,
        }
    }
}

impl PartReport {
    /// Returns the least robustness, and the times between which the part is violated.
    pub(super) fn describe(&self, step_s: f64) -> String {
        let (sample, least) = self.part.least().unwrap_or_default();
        let robustness = &self.part.robustness;
        let first = robustness.iter().position(|value| *value < 0.0);
        let last = robustness.iter().rposition(|value| *value < 0.0);
        let violated = match first.zip(last) {
            Some((first, last)) => format!(
                ", below 0 between {:.2} and {:.2} s",
                first as f64 * step_s,
                last as f64 * step_s
            ),
            None => String::new(),
        };
        let indent = "  ".repeat(self.depth);
        format!(
            "    {indent}least {least:.3} at {:.2} s{violated}: {}",
            sample as f64 * step_s,
            self.formula
        )
    }
}
