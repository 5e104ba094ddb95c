//! The safety case in Goal Structuring Notation (GSN Community Standard, version 3, with its dialectic extension).
//!
//! Goals are claims about one controller; solutions are their evidence. A counterexample is a goal that challenges and
//! defeats a claim.

use std::fmt::Write;

use super::certificates::describe_estimator;
use super::summary::SubjectClaim;
use super::{AssessmentLimits, ClaimSummary};
use crate::assessment::claims::{Property, Strength};
use crate::assessment::table::CellMark;
use crate::assessment::{AssessmentPlan, ReportIdentity};
use crumple_core::quoting::TerminalText;

/// Prefixes of identifiers, which state the kind of an element.
const GOAL: &str = "G";
const STRATEGY: &str = "S";
const SOLUTION: &str = "Sn";
const CONTEXT: &str = "C";
const ASSUMPTION: &str = "A";

/// The safety case: elements in the order of their numbers, the top goal first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Argument {
    elements: Vec<GsnElement>,
}

/// The elements of a safety case that is being written.
struct ArgumentBuilder {
    elements: Vec<GsnElement>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct GsnElement {
    id: String,
    text: String,
    /// Identifiers of the supporting elements.
    supported_by: Vec<String>,
    /// Identifiers of the contexts and assumptions.
    in_context_of: Vec<String>,
    /// Identifier of the challenged element, if any.
    challenges: Option<String>,
    /// True if a challenge has defeated the element.
    defeated: bool,
    /// True if no element supports it yet.
    undeveloped: bool,
    /// Location of the evidence, relative to the report folder.
    url: Option<String>,
}

impl GsnElement {
    /// Returns the identifier without its number, which states the kind of the element.
    fn prefix(&self) -> &str {
        self.id
            .trim_end_matches(|letter: char| letter.is_ascii_digit())
    }
}

impl ArgumentBuilder {
    fn add(&mut self, prefix: &str, text: impl Into<String>) -> String {
        let number = 1 + self
            .elements
            .iter()
            .filter(|element| element.prefix() == prefix)
            .count();
        let id = format!("{prefix}{number}");
        self.elements.push(GsnElement {
            id: id.clone(),
            text: text.into(),
            ..GsnElement::default()
        });
        id
    }

    fn update(&mut self, id: &str, change: impl FnOnce(&mut GsnElement)) {
        if let Some(element) = self.elements.iter_mut().find(|element| element.id == id) {
            change(element);
        }
    }

    fn add_support(&mut self, id: &str, supporting_id: String) {
        self.update(id, |element| element.supported_by.push(supporting_id));
    }

    fn add_claim(&mut self, strategy: &str, subject_claim: &SubjectClaim<'_>) {
        let goal = self.add(GOAL, state_claim(subject_claim));
        self.add_support(strategy, goal.clone());
        let strength = &subject_claim.status.strength;
        match strength.mark() {
            _ if matches!(strength, Strength::PartlyProved { .. }) => {
                self.add_solution(&goal, subject_claim)
            }
            CellMark::Good | CellMark::Tested => self.add_solution(&goal, subject_claim),
            CellMark::Bad => {
                let counter = self.add(GOAL, format!("Refuted: {}", strength.describe_facts()));
                self.add_solution(&counter, subject_claim);
                self.update(&counter, |element| element.challenges = Some(goal.clone()));
                self.update(&goal, |element| element.defeated = true);
            }
            CellMark::Neutral | CellMark::Number => {
                self.update(&goal, |element| element.undeveloped = true)
            }
        }
    }

    fn add_solution(&mut self, below: &str, subject_claim: &SubjectClaim<'_>) {
        let solution = self.add(SOLUTION, subject_claim.status.describe());
        self.update(&solution, |element| {
            element.url = Some(format!("assessment.html#{}", subject_claim.row.part))
        });
        self.add_support(below, solution);
    }
}

/// Returns a claim as a sentence that is true or false.
fn state_claim(SubjectClaim { row, claim, status }: &SubjectClaim<'_>) -> String {
    let name = &claim.subject.controller.name;
    match status.strength {
        Strength::PartlyProved { share_percent } => {
            let estimator = describe_estimator(claim.subject.estimator);
            let domain = claim.domain.describe();
            format!(
                "{name}, {estimator}, has no collision in {share_percent} % of the initial states: {domain}"
            )
        }
        _ => format!("Claim about {name}: {}", row.claim),
    }
}

impl ArgumentBuilder {
    fn propagate_defeat(&mut self) {
        // Elements come before those that support them.
        let mut defeated: Vec<String> = Vec::new();
        for element in self.elements.iter_mut().rev() {
            element.defeated |= element
                .supported_by
                .iter()
                .any(|below| defeated.contains(below));
            if element.defeated {
                defeated.push(element.id.clone());
            }
        }
    }
}

/// A goal below the top one.
struct Goal {
    statement: &'static str,
    strategy: &'static str,
    /// True for the properties that the goal is about.
    is_about: fn(&Property) -> bool,
}

const GOALS: [Goal; 6] = [
    Goal {
        statement: "has no collision in any run of this report",
        strategy: "over the domains of the report",
        is_about: |property| matches!(property, Property::NoCollision | Property::NoCollisionAhead),
    },
    Goal {
        statement: "passes the tests that are modelled on regulations",
        strategy: "over suites of tests",
        is_about: |property| matches!(property, Property::PassesTests),
    },
    Goal {
        statement: "fails rarely",
        strategy: "over the distributions of spaces",
        is_about: |property| matches!(property, Property::RateAtMost { .. }),
    },
    Goal {
        statement: "fails less often than the first controller",
        strategy: "over the same runs of both",
        is_about: |property| matches!(property, Property::FailsLessOften { .. }),
    },
    Goal {
        statement: "causes no collision of other vehicles",
        strategy: "over runs in which other vehicles may collide",
        is_about: |property| matches!(property, Property::OthersKeepClear),
    },
    Goal {
        statement: "is useful in ordinary traffic: no unnecessary braking, keeps up, no oscillation that grows",
        strategy: "over ordinary traffic",
        is_about: |property| {
            matches!(
                property,
                Property::NoUnnecessaryBraking | Property::KeepsUp | Property::NoGrowingOscillation
            )
        },
    },
];

/// Returns the domains of claims about rates, which must not be read without them.
fn describe_rate_domains(claims: &[&SubjectClaim<'_>]) -> String {
    let mut domains: Vec<String> = claims
        .iter()
        .filter(|subject_claim| {
            matches!(
                subject_claim.claim.property,
                Property::RateAtMost { .. } | Property::FailsLessOften { .. }
            )
        })
        .map(|subject_claim| subject_claim.claim.describe_domain())
        .collect();
    domains.dedup();
    if domains.is_empty() {
        String::new()
    } else {
        format!(", {}", domains.join(" and "))
    }
}

impl ArgumentBuilder {
    /// Adds the context of the top goal: simulation, domains and assumptions. Returns the identifiers.
    fn add_contexts(
        &mut self,
        claims: &[SubjectClaim<'_>],
        limits: &AssessmentLimits,
    ) -> Vec<String> {
        let mut contexts = vec![self.add(CONTEXT, "")];
        contexts.push(self.add(
            CONTEXT,
            "simulated vehicles in one lane of a straight road; each goal names its domain",
        ));
        for domain in distinct_domains(claims) {
            contexts.push(self.add(CONTEXT, domain));
        }
        for limit in &limits.assumptions {
            let id = self.add(ASSUMPTION, limit.assumed);
            self.update(&id, |element| {
                element.url = Some("assessment.html#limits".to_owned())
            });
            contexts.push(id);
        }
        contexts
    }

    /// Adds a goal about some properties of the subject, with the claims about them; nothing without claims.
    fn add_goal(&mut self, below: &str, subject: &str, goal: &Goal, claims: &[SubjectClaim<'_>]) {
        let relevant: Vec<_> = claims
            .iter()
            .filter(|subject_claim| (goal.is_about)(&subject_claim.claim.property))
            .collect();
        if relevant.is_empty() {
            return;
        }
        let text = format!(
            "{subject} {}{}",
            goal.statement,
            describe_rate_domains(&relevant)
        );
        let id = self.add(GOAL, text);
        self.add_support(below, id.clone());
        let strategy = self.add(STRATEGY, goal.strategy);
        self.add_support(&id, strategy.clone());
        for subject_claim in relevant {
            self.add_claim(&strategy, subject_claim);
        }
    }
}

fn distinct_domains(claims: &[SubjectClaim<'_>]) -> Vec<String> {
    let mut domains: Vec<String> = Vec::new();
    for subject_claim in claims {
        let domain = format!("domain: {}", subject_claim.claim.domain.describe());
        if !domains.contains(&domain) {
            domains.push(domain);
        }
    }
    domains
}

impl Argument {
    pub(in crate::assessment) fn new(
        plan: &AssessmentPlan,
        summary: &ClaimSummary,
        limits: &AssessmentLimits,
    ) -> Self {
        let subject = plan.subject_name();
        let claims = summary.claims_about(plan.subject_index);
        let mut argument = ArgumentBuilder {
            elements: Vec::new(),
        };
        let estimator = describe_estimator(plan.config.estimator);
        let goal =
            format!("{subject}, {estimator}, avoids collisions in the domains of this report");
        let top = argument.add(GOAL, goal);
        let strategy = argument.add(STRATEGY, "over collisions, failure rates and usefulness");
        argument.add_support(&top, strategy.clone());
        let contexts = argument.add_contexts(&claims, limits);
        argument.update(&top, |element| element.in_context_of = contexts);
        for goal in &GOALS {
            argument.add_goal(&strategy, subject, goal, &claims);
        }
        argument.propagate_defeat();
        Self {
            elements: argument.elements,
        }
    }

    /// States the identity of the report in the first context of the top goal.
    #[must_use]
    pub(in crate::assessment) fn with_identity(mut self, identity: &ReportIdentity) -> Self {
        let rows = identity.rows().into_iter();
        let rows: Vec<String> = rows
            .map(|(name, value)| format!("{name}: {value}"))
            .collect();
        let mut elements = self.elements.iter_mut();
        if let Some(context) = elements.find(|element| element.prefix() == CONTEXT) {
            context.text = rows.join("; ");
        }
        self
    }

    /// Returns the argument as YAML for GSN tools: one entry per element, under its identifier.
    #[must_use]
    pub fn to_yaml(&self) -> String {
        let mut text = String::from(
            "# Goal Structuring Notation; dialectic extension: challenges, defeated\n",
        );
        for element in &self.elements {
            // Writing to a string cannot fail.
            let _ = element.write_yaml(&mut text);
        }
        text
    }
}

impl GsnElement {
    fn write_yaml(&self, out: &mut String) -> std::fmt::Result {
        // A JSON string is also a YAML string, except for surrogate pairs.
        let quoted =
            |text: &str| serde_json::Value::from(TerminalText(text).to_string()).to_string();
        writeln!(out, "{}:\n  text: {}", self.id, quoted(&self.text))?;
        for (key, ids) in [
            ("supportedBy", &self.supported_by),
            ("inContextOf", &self.in_context_of),
        ] {
            if !ids.is_empty() {
                writeln!(out, "  {key}: [{}]", ids.join(", "))?;
            }
        }
        if let Some(challenged) = &self.challenges {
            writeln!(out, "  challenges: {challenged}")?;
        }
        for (key, is_set) in [
            ("defeated", self.defeated),
            ("undeveloped", self.undeveloped),
        ] {
            if is_set {
                writeln!(out, "  {key}: true")?;
            }
        }
        if let Some(url) = &self.url {
            writeln!(out, "  url: {}", quoted(url))?;
        }
        Ok(())
    }
}
