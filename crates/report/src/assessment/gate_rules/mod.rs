//! The rules of gates: the condition of each in words, what it needs of a configuration, and its evaluation.
//!
//! A gate has a row in the table below, which names its rule: a function of its fields.

mod certificates;
mod changes;
mod collisions;
mod drives;
mod rates;
mod searches;
mod suites;

use serde::Serialize;

use super::{
    AssessConfig, AssessmentComparison, AssessmentGate, AssessmentPlan, GatheredResults, Ledger,
};
use crumple_core::quoting::TerminalText;

/// Declares the rules of gates. A row has the gate, its fields that name controllers, its other fields, and its rule.
macro_rules! gate_table {
    ($($gate:ident [$($controller:ident),*] [$($field:ident),*] $rule:path,)*) => {
        impl AssessmentGate {
            /// Returns the fields that name controllers.
            pub(super) fn controllers_mut(&mut self) -> Vec<(&'static str, &mut String)> {
                match self {
                    $(Self::$gate { $($controller,)* .. } => {
                        vec![$((stringify!($controller), $controller)),*]
                    })*
                }
            }

            fn rule(&self, config: &AssessConfig) -> GateRule<'_> {
                match self {
                    $(Self::$gate { $($controller,)* $($field,)* } => {
                        $rule(config, $($controller,)* $($field),*)
                    })*
                }
            }
        }
    };
}

gate_table! {
    NoCollisionInPaperScenarios [controller] [] collisions::in_paper_scenarios,
    NoCollisionInScenarioFiles [controller] [] collisions::in_scenario_files,
    NoCollisionInSpace [controller] [space] collisions::in_space,
    RateAtMost [controller] [percent, space] rates::at_most,
    RateNotAbove [controller, than] [space] rates::not_above,
    NoAvoidableFailure [controller] [space] searches::no_avoidable_failure,
    UnnecessaryBrakingAtMost [controller] [percent] drives::unnecessary_braking_at_most,
    LeftBehindAtMost [controller] [percent] drives::left_behind_at_most,
    StringStable [controller] [] drives::string_stable,
    SuitePassed [controller] [suite] suites::passed,
    ProofsAccepted [] [] certificates::accepted,
    NothingWorse [] [] changes::nothing_worse,
}

/// The rule of a gate.
struct GateRule<'a> {
    /// Condition in words.
    condition: String,
    problem: Option<ConfigProblem>,
    verdict: Box<dyn Fn(&GateInputs<'_>) -> GateVerdict + 'a>,
}

/// A field of a gate, and the problem that prevents any assessment of the configuration from evaluating it.
type ConfigProblem = (&'static str, String);

/// The results that gates evaluate.
pub(super) struct GateInputs<'a> {
    pub(super) plan: &'a AssessmentPlan,
    pub(super) results: &'a GatheredResults,
    pub(super) evidence: &'a Ledger,
    pub(super) comparison: Option<&'a AssessmentComparison>,
}

struct GateVerdict {
    holds: bool,
    /// Deciding fact, in words.
    reason: String,
}

/// The result of a gate.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GateResult {
    /// Condition in words.
    pub gate: String,
    /// True if the condition holds.
    pub holds: bool,
    /// Deciding fact, in words.
    pub reason: String,
}

impl AssessmentGate {
    /// Returns the field, and the problem, that prevents any assessment of this configuration from evaluating the gate.
    pub(super) fn config_problem(&self, config: &AssessConfig) -> Option<ConfigProblem> {
        self.rule(config).problem
    }

    pub(super) fn evaluate(&self, inputs: &GateInputs<'_>) -> GateResult {
        let rule = self.rule(&inputs.plan.config);
        let verdict = (rule.verdict)(inputs);
        GateResult {
            gate: rule.condition,
            holds: verdict.holds,
            reason: verdict.reason,
        }
    }
}

impl<'a> GateRule<'a> {
    fn new(
        condition: String,
        problem: Option<ConfigProblem>,
        verdict: impl Fn(&GateInputs<'_>) -> GateVerdict + 'a,
    ) -> Self {
        Self {
            condition,
            problem,
            verdict: Box::new(verdict),
        }
    }
}

impl GateVerdict {
    fn new(holds: bool, reason: impl Into<String>) -> Self {
        Self {
            holds,
            reason: reason.into(),
        }
    }

    fn holds(reason: impl Into<String>) -> Self {
        Self::new(true, reason)
    }

    fn fails(reason: impl Into<String>) -> Self {
        Self::new(false, reason)
    }
}

impl GateResult {
    /// Returns the result as a line for a terminal.
    pub(super) fn to_plain_text(&self) -> String {
        let verdict = if self.holds { "holds " } else { "FAILED" };
        let text = format!("{} ({})", self.gate, self.reason);
        format!("  {verdict}  {}\n", TerminalText(&text))
    }
}

/// Returns the problem that a gate needs another setting, unless it `has` it.
fn require(has: bool, setting: &str) -> Option<ConfigProblem> {
    (!has).then(|| ("require", format!("needs {setting}")))
}

fn share_problem(percent: f64) -> Option<ConfigProblem> {
    let is_share = (0.0..=100.0).contains(&percent);
    (!is_share).then(|| ("percent", format!("must be from 0 to 100, found {percent}")))
}
