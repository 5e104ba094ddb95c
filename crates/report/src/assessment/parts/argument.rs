//! The safety case in Goal Structuring Notation (GSN Community Standard, version 3, with its dialectic extension).
//!
//! Goals are claims about one controller; solutions are their evidence. A counterexample is a goal that challenges and
//! defeats a claim.

use std::fmt::Write;

use super::certificates::describe_estimator;
use super::{AssessmentLimits, ClaimRow, ClaimSummary};
use crate::assessment::AssessmentPlan;
use crate::assessment::claims::{AssuranceClaim, ClaimStatus, Property, Strength};
use crate::assessment::table::CellMark;
use crumple_core::quoting::TerminalText;

/// The safety case, with elements in the order of their numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Argument {
    /// Elements; the first one is the top goal.
    pub elements: Vec<GsnElement>,
}

/// One element of the notation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GsnElement {
    /// Identifier, whose letters state the kind.
    pub id: String,
    /// Kind of the element.
    pub kind: GsnElementKind,
    /// Statement of the element.
    pub text: String,
    /// Identifiers of the supporting elements.
    pub supported_by: Vec<String>,
    /// Identifiers of the contexts and assumptions.
    pub in_context_of: Vec<String>,
    /// Identifier of the challenged element, if any.
    pub challenges: Option<String>,
    /// True if a challenge has defeated the element.
    pub defeated: bool,
    /// True if no element supports it yet.
    pub undeveloped: bool,
    /// Location of the evidence, relative to the report folder.
    pub url: Option<String>,
}

/// The kind of an element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum GsnElementKind {
    /// A claim.
    Goal,
    /// An inference from claims to a claim.
    Strategy,
    /// Evidence.
    Solution,
    /// The context of the argument.
    Context,
    /// An assumption.
    Assumption,
}

impl GsnElementKind {
    fn prefix(self) -> &'static str {
        match self {
            Self::Goal => "G",
            Self::Strategy => "S",
            Self::Solution => "Sn",
            Self::Context => "C",
            Self::Assumption => "A",
        }
    }
}

#[derive(Default)]
struct ArgumentBuilder {
    elements: Vec<GsnElement>,
}

impl ArgumentBuilder {
    fn add(&mut self, kind: GsnElementKind, text: impl Into<String>) -> String {
        let number = 1 + self.elements.iter().filter(|element| element.kind == kind).count();
        let id = format!("{}{number}", kind.prefix());
        self.elements.push(GsnElement {
            id: id.clone(),
            kind,
            text: text.into(),
            supported_by: Vec::new(),
            in_context_of: Vec::new(),
            challenges: None,
            defeated: false,
            undeveloped: false,
            url: None,
        });
        id
    }

    fn update(&mut self, id: &str, change: impl FnOnce(&mut GsnElement)) {
        if let Some(element) = self.elements.iter_mut().find(|element| element.id == id) {
            change(element);
        }
    }

    fn add_support(&mut self, id: &str, by: String) {
        self.update(id, |element| element.supported_by.push(by));
    }

    fn add_claim(&mut self, strategy: &str, proposition: &Proposition<'_>) {
        let goal = self.add(GsnElementKind::Goal, proposition.text());
        self.add_support(strategy, goal.clone());
        let strength = &proposition.status.strength;
        match strength.mark() {
            _ if matches!(strength, Strength::PartlyProved { .. }) => self.add_solution(&goal, proposition),
            CellMark::Good => self.add_solution(&goal, proposition),
            CellMark::Bad => {
                let counter = self.add(GsnElementKind::Goal, format!("Refuted: {}", strength.describe()));
                self.add_solution(&counter, proposition);
                self.update(&counter, |element| element.challenges = Some(goal.clone()));
                self.update(&goal, |element| element.defeated = true);
            }
            CellMark::Neutral | CellMark::Number => self.update(&goal, |element| element.undeveloped = true),
        }
    }

    fn add_solution(&mut self, below: &str, proposition: &Proposition<'_>) {
        let solution = self.add(GsnElementKind::Solution, proposition.status.describe());
        self.update(&solution, |element| element.url = Some(format!("assessment.html#{}", proposition.row.part)));
        self.add_support(below, solution);
    }
}

/// A claim about the subject, as a sentence that is true or false.
struct Proposition<'a> {
    row: &'a ClaimRow,
    claim: &'a AssuranceClaim,
    status: &'a ClaimStatus,
}

impl Proposition<'_> {
    fn text(&self) -> String {
        let name = &self.claim.subject.controller.name;
        match self.status.strength {
            Strength::PartlyProved { share_percent } => {
                let seeing = describe_estimator(self.claim.subject.estimator);
                format!(
                    "{name}, {seeing}, has no collision in {share_percent} % of the initial states: {}",
                    self.claim.domain.describe()
                )
            }
            _ => format!("Claim about {name}: {}", self.row.claim),
        }
    }
}

impl ArgumentBuilder {
    fn propagate_defeat(&mut self) {
        // Elements come before those that support them.
        for index in (0..self.elements.len()).rev() {
            let Some(element) = self.elements.get(index) else { continue };
            let of = |id: &String| self.elements.iter().find(|other| other.id == *id);
            let rests_on_defeat = element.supported_by.iter().filter_map(of).any(|below| below.defeated);
            if rests_on_defeat && let Some(element) = self.elements.get_mut(index) {
                element.defeated = true;
            }
        }
    }
}

/// The goals below the top one: statement, strategy, and filter of the properties.
type PropertyFilter = fn(&Property) -> bool;
const GOALS: [(&str, &str, PropertyFilter); 6] = [
    ("has no collision in any run of this report", "over the domains of the report", |property| {
        matches!(property, Property::NoContact | Property::NoContactAhead)
    }),
    ("passes the tests that are modelled on regulations", "over suites of tests", |property| {
        matches!(property, Property::PassesTests)
    }),
    ("fails rarely", "over the distributions of spaces", |property| matches!(property, Property::RateAtMost { .. })),
    ("fails less often than the first controller", "over the same runs of both", |property| {
        matches!(property, Property::FailsLessOften { .. })
    }),
    ("causes no collision of other vehicles", "over runs in which other vehicles may collide", |property| {
        matches!(property, Property::OthersKeepClear)
    }),
    (
        "is useful in ordinary traffic: no unnecessary braking, keeps up, string stability",
        "over ordinary traffic",
        |property| matches!(property, Property::NoUnnecessaryBraking | Property::KeepsUp | Property::StringStable),
    ),
];

/// Returns the domains of claims about rates, which must not be read without them.
fn describe_rate_domains(about: &[&Proposition<'_>]) -> String {
    let is_rate = |one: &&&Proposition<'_>| {
        matches!(one.claim.property, Property::RateAtMost { .. } | Property::FailsLessOften { .. })
    };
    let mut places: Vec<String> = about.iter().filter(is_rate).map(|one| one.claim.describe_domain()).collect();
    places.dedup();
    if places.is_empty() { String::new() } else { format!(", {}", places.join(" and ")) }
}

impl Argument {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan, summary: &ClaimSummary, limits: &AssessmentLimits) -> Self {
        let subject = plan.subject().map_or("", |controller| controller.name.as_str());
        let mut building = ArgumentBuilder::default();
        let all: Vec<_> = summary
            .claims
            .iter()
            .filter_map(|row| {
                let (claim, status) =
                    (row.claims.get(plan.subject_index)?.as_ref()?, row.statuses.get(plan.subject_index)?);
                Some(Proposition { row, claim, status })
            })
            .collect();
        let estimator = describe_estimator(plan.config.estimator);
        let goal = format!("{subject}, {estimator}, avoids collisions in the domains of this report");
        let top = building.add(GsnElementKind::Goal, goal);
        let over = building.add(GsnElementKind::Strategy, "over collisions, failure rates and usefulness");
        building.add_support(&top, over.clone());
        let mut around = vec![building.add(
            GsnElementKind::Context,
            "simulated vehicles in one lane of a straight road; each goal names its domain",
        )];
        let mut domains: Vec<String> = Vec::new();
        for domain in all.iter().map(|one| format!("domain: {}", one.claim.domain.describe())) {
            if !domains.contains(&domain) {
                around.push(building.add(GsnElementKind::Context, domain.clone()));
                domains.push(domain);
            }
        }
        for limit in &limits.assumptions {
            let id = building.add(GsnElementKind::Assumption, limit.assumed);
            building.update(&id, |element| element.url = Some("assessment.html#limits".to_owned()));
            around.push(id);
        }
        building.update(&top, |element| element.in_context_of = around);
        for (says, by, is_about) in GOALS {
            let about: Vec<_> = all.iter().filter(|one| is_about(&one.claim.property)).collect();
            if about.is_empty() {
                continue;
            }
            let goal = building.add(GsnElementKind::Goal, format!("{subject} {says}{}", describe_rate_domains(&about)));
            building.add_support(&over, goal.clone());
            let strategy = building.add(GsnElementKind::Strategy, by);
            building.add_support(&goal, strategy.clone());
            for proposition in about {
                building.add_claim(&strategy, proposition);
            }
        }
        building.propagate_defeat();
        Self { elements: building.elements }
    }

    /// Returns the argument as YAML for GSN tools: one entry per element, under its identifier.
    #[must_use]
    pub fn to_yaml(&self) -> String {
        let mut text = String::from("# Goal Structuring Notation; dialectic extension: challenges, defeated\n");
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
        let quoted = |text: &str| serde_json::Value::from(TerminalText(text).to_string()).to_string();
        writeln!(out, "{}:\n  text: {}", self.id, quoted(&self.text))?;
        for (key, ids) in [("supportedBy", &self.supported_by), ("inContextOf", &self.in_context_of)] {
            if !ids.is_empty() {
                writeln!(out, "  {key}: [{}]", ids.join(", "))?;
            }
        }
        if let Some(challenged) = &self.challenges {
            writeln!(out, "  challenges: {challenged}")?;
        }
        for (key, is_so) in [("defeated", self.defeated), ("undeveloped", self.undeveloped)] {
            if is_so {
                writeln!(out, "  {key}: true")?;
            }
        }
        if let Some(url) = &self.url {
            writeln!(out, "  url: {}", quoted(url))?;
        }
        Ok(())
    }
}
