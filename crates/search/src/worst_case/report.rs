//! Machine-readable result of an attack.

use serde::Serialize;

use super::{AttackObjective, AttackResult};
use crumple_sim::engine::{NamedController, Outcome};
use crumple_sim::observation::EstimatorKind;

/// Output of `crumple worst-case --format json`. Fields of the profile are absent if none was found.
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
    /// ∫ a² of the leader's script, in m²/s³.
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
}

impl AttackReport {
    /// Creates the report of an attack on a controller in the scenario of that name.
    #[must_use]
    pub fn new(
        scenario: &str,
        controller: &NamedController,
        estimator: EstimatorKind,
        aim: AttackObjective,
        result: &AttackResult,
    ) -> Self {
        let found = result.attack.as_ref();
        // A simulation that its controller ended has no margin and no optimality.
        let answered = found.filter(|attack| attack.outcome.failed_controller().is_none());
        Self {
            scenario: scenario.to_owned(),
            controller: controller.name.clone(),
            estimator: estimator.name(),
            aim: aim.name(),
            nondeterministic: !controller.source.is_deterministic(),
            found: found.is_some(),
            method: answered.map(|_| "sequential"),
            optimality: answered.map(|_| "best-found"),
            outcome: found.map(|attack| attack.outcome.clone()),
            effort_m2ps3: found.map(|attack| attack.effort_m2ps3),
            peak_brake_mps2: found.map(|attack| attack.peak_brake_mps2),
            predicted_margin_m: answered.map(|attack| attack.predicted_margin_m),
            margin_m: answered.map(|attack| attack.margin_m),
            evaluations: result.evaluations,
            programs: result.programs,
        }
    }
}
