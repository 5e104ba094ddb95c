//! Gates: the conditions of an assessment to pass.
//!
//! A gate is a row of the table below, from which the enum, the schema and the list in the printed configuration
//! follow. The row names the rule of the gate: a function of its fields that returns its condition in words, what it
//! needs of a configuration, the claim that it is about, and its evaluation.

mod certificates;
mod changes;
mod collisions;
mod drives;
mod indicator;
mod rates;
mod searches;
mod suites;

use serde::{Deserialize, Serialize};

use super::claims::{AssuranceClaim, Domain};
use super::gate::GateConfig;
use super::{
    AssessConfig, AssessmentComparison, AssessmentPlan, ClaimRow, GatheredResults, Ledger, Rounded,
};
use crumple_core::field_error::FieldError;
use crumple_core::quoting::TerminalText;
use indicator::{EventCount, GateMetric};
pub use indicator::{IndicatorInterval, SafetyIndicator};

/// Declares gates. A row has the gate, its name in a configuration, its fields, and its rule. Each field has a role:
/// `controller`, `space` and `suite` name a part of the configuration, a `number` does not.
macro_rules! gate_table {
    ($(
        $(#[$attribute:meta])*
        $gate:ident $name:literal {
            $($(#[$field_attribute:meta])* $role:ident $field:ident: $type:ty,)*
        } $rule:path,
    )*) => {
        /// A condition that must hold for an assessment to pass.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        #[cfg_attr(
            feature = "schema",
            schemars(transform = super::gate::add_requirement_to_schema)
        )]
        #[serde(tag = "require", deny_unknown_fields)]
        #[non_exhaustive]
        pub enum AssessmentGate {
            $($(#[$attribute])* #[serde(rename = $name)] $gate {
                $($(#[$field_attribute])* $field: $type,)*
            },)*
        }

        /// The name of each gate in a configuration, and its fields.
        const GATES: &[(&str, &[&str])] = &[$(($name, &[$(stringify!($field)),*]),)*];

        impl AssessmentGate {
            /// Returns the names of controllers, spaces and suites that the gate states.
            pub(super) fn names_mut(&mut self) -> Vec<GateName<'_>> {
                let fields: Vec<Option<GateName<'_>>> = match self {
                    $(Self::$gate { $($field,)* } => {
                        vec![$(gate_name!($role $field)),*]
                    })*
                };
                fields.into_iter().flatten().collect()
            }

            fn rule(&self, config: &AssessConfig) -> GateRule<'_> {
                match self {
                    $(Self::$gate { $($field,)* } => $rule(config, $($field),*),)*
                }
            }
        }
    };
}

/// Returns the name that a field of a gate states, by the role of the field.
macro_rules! gate_name {
    (number $field:ident) => {{
        let _ = $field;
        None
    }};
    (controller $field:ident) => {
        GateName::new(NameRole::Controller, stringify!($field), $field)
    };
    (space $field:ident) => {
        GateName::new(NameRole::Space, stringify!($field), $field)
    };
    (suite $field:ident) => {
        GateName::new(NameRole::Suite, stringify!($field), $field)
    };
}

gate_table! {
    /// A controller collides in none of the paper's scenarios. Before 0.4.0: `no-contact-in-paper-scenarios`.
    #[serde(alias = "no-contact-in-paper-scenarios")]
    NoCollisionInPaperScenarios "no-collision-in-paper-scenarios" {
        /// Name of the controller.
        controller controller: String,
    } collisions::in_paper_scenarios,
    /// A controller collides in none of the scenarios of `scenarios` and `recordings`; spaces are not considered.
    NoCollisionInScenarioFiles "no-collision-in-scenario-files" {
        /// Name of the controller.
        controller controller: String,
    } collisions::in_scenario_files,
    /// A controller collides in none of the simulated random scenarios of a space. Scenarios that a collision of other
    /// vehicles ends count against it.
    NoCollisionInSpace "no-collision-in-space" {
        /// Name of the controller.
        controller controller: String,
        /// Scenario space: one of `distributions`, or `traffic`, `high-risk`, `followers` or `everyday` if
        /// `everyday_draws` is above 0.
        space space: String,
    } collisions::in_space,
    /// The failure rate of a controller in a scenario space is at most this, by bounds on counted runs.
    RateAtMost "rate-at-most" {
        /// Name of the controller.
        controller controller: String,
        /// Largest bound that passes, in percent.
        number percent: f64,
        /// Scenario space, one of `distributions`. Default: the only one there is.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space space: Option<String>,
    } rates::at_most,
    /// A controller collides in no more random scenarios of a space than another one.
    RateNotAbove "rate-not-above" {
        /// Name of the controller.
        controller controller: String,
        /// Name of the other controller.
        controller than: String,
        /// Scenario space, one of `distributions`. Default: the only one there is.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space space: Option<String>,
    } rates::not_above,
    /// No search found a failure of a controller that is avoidable or undecided.
    NoAvoidableFailure "no-avoidable-failure" {
        /// Name of the controller.
        controller controller: String,
        /// Scenario space of the search.
        space space: String,
    } searches::no_avoidable_failure,
    /// A controller brakes unnecessarily in at most this share of its drives in everyday traffic.
    #[serde(alias = "needless-braking-at-most")]
    UnnecessaryBrakingAtMost "unnecessary-braking-at-most" {
        /// Name of the controller.
        controller controller: String,
        /// Largest share that passes, in percent.
        number percent: f64,
        /// Scenario space: `traffic` (the default) or `everyday`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space space: Option<String>,
    } drives::unnecessary_braking_at_most,
    /// A controller falls behind in at most this share of its drives in everyday traffic: at the end it is slower than
    /// half its leader's speed, or its gap is longer than at the start and than 20 m plus 6 s times the leader's speed.
    LeftBehindAtMost "left-behind-at-most" {
        /// Name of the controller.
        controller controller: String,
        /// Largest share that passes, in percent.
        number percent: f64,
        /// Scenario space: `traffic` (the default) or `everyday`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space space: Option<String>,
    } drives::left_behind_at_most,
    /// No speed oscillation grows from vehicle to vehicle in a line with a controller: the largest gain over all mean
    /// speeds and frequencies, rounded to three decimals, is at most 1.000. Before 0.4.0: in a single manoeuvre.
    StringStable "string-stable" {
        /// Name of the controller.
        controller controller: String,
    } drives::string_stable,
    /// A controller passes every test of a suite that can be run.
    SuitePassed "suite-passed" {
        /// Name of the controller.
        controller controller: String,
        /// Suite, as `suites` names it.
        suite suite: String,
    } suites::passed,
    /// The checker accepts every certificate.
    ProofsAccepted "proofs-accepted" {
    } certificates::accepted,
    /// The assessment is compared with an earlier one, and no result is worse.
    NothingWorse "nothing-worse" {
    } changes::nothing_worse,
}

/// The name of a part of the configuration in a field of a gate.
pub(super) struct GateName<'a> {
    pub(super) role: NameRole,
    pub(super) field: &'static str,
    pub(super) name: &'a mut String,
}

/// The part of the configuration that a field of a gate names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NameRole {
    Controller,
    Space,
    Suite,
}

impl<'a> GateName<'a> {
    fn new(
        role: NameRole,
        field: &'static str,
        name: impl Into<Option<&'a mut String>>,
    ) -> Option<Self> {
        let name = name.into()?;
        Some(Self { role, field, name })
    }
}

/// Returns the gates as lines of comments in a configuration: the name of each, and its fields.
pub(super) fn gate_comments() -> String {
    let lines = GATES.iter().map(|(name, fields)| match fields {
        [] => format!("#   {name}\n"),
        fields => format!("#   {name}: {}\n", fields.join(", ")),
    });
    lines.collect()
}

/// The rule of a gate.
struct GateRule<'a> {
    /// Condition in words.
    condition: String,
    metric: GateMetric,
    /// Field and problem that prevent any assessment of the configuration from evaluating the gate.
    problem: Option<FieldError>,
    verdict: Box<dyn Fn(&GateInputs<'_>) -> GateVerdict + 'a>,
    /// True for the claim that a gate with the own names of spaces and suites is about.
    is_about: Box<ClaimTest<'a>>,
}

/// Tells whether a gate is about a claim.
type ClaimTest<'a> = dyn Fn(&ClaimRow, &AssuranceClaim) -> bool + 'a;

/// The results that gates evaluate.
pub(super) struct GateInputs<'a> {
    pub(super) plan: &'a AssessmentPlan,
    pub(super) results: &'a GatheredResults,
    pub(super) evidence: &'a Ledger,
    pub(super) claims: &'a [ClaimRow],
    pub(super) comparison: Option<&'a AssessmentComparison>,
}

struct GateVerdict {
    holds: bool,
    /// Deciding fact, in words.
    reason: String,
    /// Value of the metric, and its interval.
    value: Option<f64>,
    interval: Option<IndicatorInterval>,
    /// Domain of the deciding runs, if claims about several domains come into question.
    domain: Option<Domain>,
    /// File of a scenario that decides against the gate, if the claim alone does not determine it.
    file: Option<String>,
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
    /// Requirements that the gate verifies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub requirement: Vec<String>,
    /// Gate as a safety performance indicator.
    pub indicator: SafetyIndicator,
    /// Claim of the report that the gate is about.
    #[serde(skip)]
    pub(super) claim: Option<AssuranceClaim>,
    /// File of a scenario that decides against the gate, if the claim alone does not determine it.
    #[serde(skip)]
    pub(super) file: Option<String>,
}

impl AssessmentGate {
    /// Returns the field, and the problem, that prevents any assessment of this configuration from evaluating the gate.
    pub(super) fn config_problem(&self, config: &AssessConfig) -> Option<FieldError> {
        self.rule(config).problem
    }

    /// Returns the gate with the own names of spaces and suites, which claims use, in place of those of the
    /// configuration.
    fn with_own_names(&self, plan: &AssessmentPlan) -> Self {
        let mut gate = self.clone();
        if let Self::RateAtMost { space, .. } | Self::RateNotAbove { space, .. } = &mut gate
            && space.is_none()
        {
            *space = plan.rate_spaces.first().map(|named| named.name.clone());
        }
        for GateName { role, name, .. } in gate.names_mut() {
            let own = match role {
                NameRole::Space => plan.find_named_space(name).map(|named| &named.content_id),
                NameRole::Suite => plan.find_suite(name).map(|planned| &planned.content_id),
                NameRole::Controller => None,
            };
            if let Some(own) = own {
                own.name.clone_into(name);
            }
        }
        gate
    }

    /// Returns the space, as the configuration names it, and the limit of a gate on the failure rate.
    pub(super) fn rate_limit(&self, config: &AssessConfig) -> Option<(String, Rounded<2>)> {
        let Self::RateAtMost { percent, space, .. } = self else {
            return None;
        };
        let space = rates::named_or_only(space, config);
        Some((space, rates::claimed_percent(*percent)))
    }

    /// Returns the first controller that the gate names, if it names one.
    fn controller(&self) -> Option<String> {
        let mut gate = self.clone();
        let mut names = gate.names_mut().into_iter();
        let named = names.find(|named| named.role == NameRole::Controller)?;
        Some(named.name.clone())
    }
}

impl GateConfig {
    pub(super) fn evaluate(&self, inputs: &GateInputs<'_>) -> GateResult {
        let config = &inputs.plan.config;
        let rule = self.gate.rule(config);
        let verdict = (rule.verdict)(inputs);
        let named = self.gate.with_own_names(inputs.plan);
        let named_rule = named.rule(config);
        let controller = named.controller();
        let domain = verdict.domain.as_ref();
        let about = controller.and_then(|name| named_rule.find_claim(&name, inputs, domain));
        let claim = about.map(|(row, claim)| {
            let controller = &claim.subject.controller.name;
            format!("{controller}: {}", row.claim)
        });
        GateResult {
            gate: named_rule.condition,
            holds: verdict.holds,
            reason: verdict.reason,
            requirement: self.requirement.clone(),
            indicator: rule
                .metric
                .indicator(verdict.value, verdict.interval, claim),
            claim: about.map(|(_, claim)| claim.clone()),
            file: verdict.file,
        }
    }
}

impl<'a> GateRule<'a> {
    fn new(
        condition: String,
        metric: GateMetric,
        problem: Option<FieldError>,
        verdict: impl Fn(&GateInputs<'_>) -> GateVerdict + 'a,
    ) -> Self {
        Self {
            condition,
            metric,
            problem,
            verdict: Box::new(verdict),
            is_about: Box::new(|_, _| false),
        }
    }

    /// Sets the claim of the report that the gate is about.
    fn about(self, is_about: impl Fn(&ClaimRow, &AssuranceClaim) -> bool + 'a) -> Self {
        Self {
            is_about: Box::new(is_about),
            ..self
        }
    }

    /// Returns the claim about a controller that the gate is about, and its row; in `domain`, if that is stated.
    fn find_claim<'c>(
        &self,
        controller: &str,
        inputs: &GateInputs<'c>,
        domain: Option<&Domain>,
    ) -> Option<(&'c ClaimRow, &'c AssuranceClaim)> {
        inputs.claims.iter().find_map(|row| {
            let mut claims = row.claims.iter().flatten();
            let claim = claims.find(|claim| claim.subject.controller.name == controller)?;
            let is_in_domain = domain.is_none_or(|domain| claim.domain == *domain);
            (is_in_domain && (self.is_about)(row, claim)).then_some((row, claim))
        })
    }
}

impl GateVerdict {
    fn new(holds: bool, reason: impl Into<String>) -> Self {
        Self {
            holds,
            reason: reason.into(),
            value: None,
            interval: None,
            domain: None,
            file: None,
        }
    }

    fn with_value(self, value: f64) -> Self {
        Self {
            value: Some(value),
            ..self
        }
    }

    fn with_interval(self, interval: Option<IndicatorInterval>) -> Self {
        Self { interval, ..self }
    }

    fn with_domain(self, domain: Domain) -> Self {
        Self {
            domain: Some(domain),
            ..self
        }
    }

    fn with_file(self, file: Option<String>) -> Self {
        Self { file, ..self }
    }

    fn holds(reason: impl Into<String>) -> Self {
        Self::new(true, reason)
    }

    fn fails(reason: impl Into<String>) -> Self {
        Self::new(false, reason)
    }
}

impl GateResult {
    /// True for a gate that does not hold and is about a claim.
    pub(super) fn is_failed_about(&self, claim: &AssuranceClaim) -> bool {
        !self.holds && self.claim.as_ref() == Some(claim)
    }

    /// Returns the result as a line for a terminal.
    pub(super) fn to_plain_text(&self) -> String {
        let verdict = if self.holds { "holds " } else { "FAILED" };
        let text = format!("{} ({})", self.gate, self.reason);
        format!("  {verdict}  {}\n", TerminalText(&text))
    }
}

/// Returns the problem that a gate needs another setting, unless it `has` it.
fn require(has: bool, setting: &str) -> Option<FieldError> {
    (!has).then(|| FieldError::new("require", format!("needs {setting}")))
}

fn share_problem(percent: f64) -> Option<FieldError> {
    let is_share = (0.0..=100.0).contains(&percent);
    (!is_share)
        .then(|| FieldError::new("percent", format!("must be from 0 to 100, found {percent}")))
}

/// True for a claim about random scenarios of a space, or about the whole space.
fn is_in_space(claim: &AssuranceClaim, name: &str) -> bool {
    match &claim.domain {
        Domain::Draws { space, .. } | Domain::Space { space } => space.name == *name,
        _ => false,
    }
}
