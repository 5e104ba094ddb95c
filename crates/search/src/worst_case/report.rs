//! What an attack found, for a program that reads it.

use serde::Serialize;

use super::{AttackMethod, AttackObjective, AttackResult};
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::{NamedController, Outcome};

/// What `crumple worst-case --format json` prints. Everything about the profile is absent if none was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AttackReport {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the controller.
    pub controller: String,
    /// What it looked through.
    pub estimator: &'static str,
    /// What was looked for.
    pub aim: &'static str,
    /// Whether the controller says of itself that another run may end otherwise.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub nondeterministic: bool,
    /// Whether some profile makes the controller fail.
    pub found: bool,
    /// How it was found; none where the controller gave no answer.
    pub method: Option<AttackMethod>,
    /// `exact-on-grid` if nothing on the grid is better, `best-found` if nothing shows that; none where the controller gave no
    /// answer.
    pub optimality: Option<&'static str>,
    /// How the run with it ended.
    pub outcome: Option<Outcome>,
    /// ∫ a² of the leader's script, in m²/s³.
    pub effort_m2ps3: Option<f64>,
    /// Hardest braking of the script, in m/s², positive.
    pub peak_brake_mps2: Option<f64>,
    /// Margin that the convex program predicted, in metres; none where the controller gave no answer, as that below.
    pub predicted_margin_m: Option<f64>,
    /// The margin that the simulation has, in metres.
    pub margin_m: Option<f64>,
    /// Simulations spent.
    pub evaluations: usize,
    /// Convex programs solved.
    pub programs: usize,
}

impl AttackReport {
    /// The report of an attack on a controller in the scenario of that name.
    #[must_use]
    pub fn new(
        scenario: &str,
        controller: &NamedController,
        estimator: EstimatorKind,
        aim: AttackObjective,
        result: &AttackResult,
    ) -> Self {
        let found = result.attack.as_ref();
        // A run that its controller ended has no margin, and is no optimum of anything.
        let answered = found.filter(|attack| attack.outcome.failed_controller().is_none());
        Self {
            scenario: scenario.to_owned(),
            controller: controller.name.clone(),
            estimator: estimator.name(),
            aim: aim.name(),
            nondeterministic: !controller.kind.is_deterministic(),
            found: found.is_some(),
            method: answered.map(|attack| attack.method),
            optimality: answered.map(|attack| attack.method.optimality()),
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
