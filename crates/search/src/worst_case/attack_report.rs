//! Report of an attack, as text and as JSON.

use serde::Serialize;

use super::{AttackObjective, AttackResult};
use crumple_core::quoting::TerminalText;
use crumple_sim::engine::{NamedController, Outcome};
use crumple_sim::observation::EstimatorKind;

/// Report of an attack by braking. Fields of the profile are absent if none was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AttackReport {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the controller.
    pub controller: String,
    /// Estimator of the vehicles under test.
    pub estimator: &'static str,
    /// Objective of the attack.
    pub aim: &'static str,
    /// True if the controller declares itself non-deterministic.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub nondeterministic: bool,
    /// True if some profile makes the controller fail.
    pub found: bool,
    /// Method that found it; `None` if the controller gave no answer.
    pub method: Option<&'static str>,
    /// `best-found`; `None` if the controller gave no answer.
    pub optimality: Option<&'static str>,
    /// Outcome of the simulation with the profile.
    pub outcome: Option<Outcome>,
    /// ∫ a² of the leader until it stands or the run ends, in m²/s³.
    pub effort_m2ps3: Option<f64>,
    /// Hardest braking of the script, in m/s², positive.
    pub peak_brake_mps2: Option<f64>,
    /// Margin that the convex program predicted, in metres; like `margin_m`, `None` if the controller gave no answer.
    pub predicted_margin_m: Option<f64>,
    /// Margin of the simulation, in metres.
    pub margin_m: Option<f64>,
    /// Number of simulations.
    pub evaluations: usize,
    /// Number of convex programs solved.
    pub programs: usize,
    /// Requested number of simulations.
    pub budget: usize,
    /// True if the attack made more simulations than requested.
    pub is_over_budget: bool,
    /// Reason for more simulations than requested, if there were more.
    pub over_budget_because: Option<&'static str>,
}

const OVER_BUDGET_REASON: &str =
    "the method completes its round and always runs its first and last simulations";

impl AttackReport {
    /// Creates the report of an attack on a controller in the scenario of that name; `budget` is the requested number
    /// of simulations.
    #[must_use]
    pub fn new(
        scenario: &str,
        controller: &NamedController,
        estimator: EstimatorKind,
        objective: AttackObjective,
        budget: usize,
        result: &AttackResult,
    ) -> Self {
        let attack = result.attack.as_ref();
        // A simulation that its controller ended has no margin and no optimality.
        let answered = attack.filter(|attack| attack.outcome.failed_controller().is_none());
        let is_over_budget = result.evaluations > budget;
        Self {
            scenario: scenario.to_owned(),
            controller: controller.name.clone(),
            estimator: estimator.name(),
            aim: objective.name(),
            nondeterministic: !controller.source.is_deterministic(),
            found: attack.is_some(),
            method: answered.map(|_| "sequential"),
            optimality: answered.map(|_| "best-found"),
            outcome: attack.map(|attack| attack.outcome.clone()),
            effort_m2ps3: attack.map(|attack| attack.effort_m2ps3),
            peak_brake_mps2: attack.map(|attack| attack.peak_brake_mps2),
            predicted_margin_m: answered.map(|attack| attack.predicted_margin_m),
            margin_m: answered.map(|attack| attack.margin_m),
            evaluations: result.evaluations,
            programs: result.programs,
            budget,
            is_over_budget,
            over_budget_because: is_over_budget.then_some(OVER_BUDGET_REASON),
        }
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{}: {}, estimator {}, {}\n",
            TerminalText(&self.scenario),
            TerminalText(&self.controller),
            self.estimator,
            self.aim
        );
        if self.nondeterministic {
            text += "  the controller declares that it is not deterministic: another attack may give another result\n";
        }
        text += &self.describe_outcome();
        text += &self.describe_profile();
        text += &self.describe_search();
        if let Some(reason) = self.over_budget_because {
            let budget = self.budget;
            text += &format!("  more simulations than --budget {budget}: {reason}\n");
        }
        text
    }

    fn describe_outcome(&self) -> String {
        match &self.outcome {
            Some(Outcome::ControllerFailed(failed)) => {
                format!("  CONTROLLER FAILED and gave no valid command: {failed}\n")
            }
            Some(Outcome::Collision(collision)) => format!("  COLLISION {collision}\n"),
            Some(Outcome::NoCollision) | None => String::new(),
        }
    }

    fn describe_profile(&self) -> String {
        let mut text = String::new();
        if let (Some(effort), Some(peak)) = (self.effort_m2ps3, self.peak_brake_mps2) {
            text +=
                &format!("  braking of the leader: ∫a² {effort:.3} m²/s³, peak {peak:.2} m/s²\n");
        }
        if let (Some(predicted), Some(margin)) = (self.predicted_margin_m, self.margin_m) {
            text += &format!(
                "  margin {margin:.3} m (after an impact at v m/s: -v²/10); the last convex program \
                 predicted {predicted:.3} m\n"
            );
        }
        text
    }

    fn describe_search(&self) -> String {
        let simulations = self.evaluations;
        let programs = self.programs;
        if !self.found {
            return format!(
                "  no collision found in {simulations} simulations and {programs} convex programs\n"
            );
        }
        match self.method {
            Some(_) => {
                format!("  best found; {simulations} simulations, {programs} convex programs\n")
            }
            None => {
                format!("  found in {simulations} simulations and {programs} convex programs\n")
            }
        }
    }
}
