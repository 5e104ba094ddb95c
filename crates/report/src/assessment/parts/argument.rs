//! The argument in Goal Structuring Notation (GSN Community Standard, version 3, with its dialectic extension).
//!
//! Goals are the claims of the verdict about one controller; solutions are the evidence for them; a counterexample is a goal
//! that challenges a claim, which is then defeated. Nothing here is stated that another part does not show.

use std::fmt::Write;

use maud::{Markup, html};
use serde::Serialize;

use super::argument_figure;
use super::{Claim, Distribution, Limits, Proofs, Searches, Strength, Summary};
use crate::assessment::table::Mark;
use crate::assessment::{AssessmentPlan, Part};
use crumple_search::falsify::counterexample::AvoidabilityClass;

/// The argument, its elements in the order of their identifiers' numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Argument {
    /// Its elements; the first one is the top goal.
    pub elements: Vec<Element>,
}

/// One element of the notation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Element {
    /// Identifier, its first letters saying what it is.
    pub id: String,
    /// What it is.
    pub kind: ElementKind,
    /// What it says.
    pub text: String,
    /// Identifiers of what supports it.
    pub supported_by: Vec<String>,
    /// Identifiers of contexts and assumptions it holds in.
    pub in_context_of: Vec<String>,
    /// Identifier of what it challenges, if it does.
    pub challenges: Option<String>,
    /// Whether a challenge has defeated it.
    pub defeated: bool,
    /// Whether nothing supports it yet.
    pub undeveloped: bool,
    /// Where its evidence stands, from the folder of the report.
    pub url: Option<String>,
}

/// What an element is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ElementKind {
    /// A claim.
    Goal,
    /// How a claim follows from others.
    Strategy,
    /// Evidence.
    Solution,
    /// What the argument speaks about.
    Context,
    /// What is taken for granted.
    Assumption,
}

impl ElementKind {
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

/// An argument on its way: elements get their numbers as they come.
#[derive(Default)]
struct Building {
    elements: Vec<Element>,
}

impl Building {
    fn add(&mut self, kind: ElementKind, text: impl Into<String>) -> String {
        let number = 1 + self.elements.iter().filter(|element| element.kind == kind).count();
        let id = format!("{}{number}", kind.prefix());
        self.elements.push(Element {
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

    fn change(&mut self, id: &str, change: impl FnOnce(&mut Element)) {
        if let Some(element) = self.elements.iter_mut().find(|element| element.id == id) {
            change(element);
        }
    }

    fn support(&mut self, id: &str, by: String) {
        self.change(id, |element| element.supported_by.push(by));
    }

    /// A goal below a strategy, with its evidence: for it or against it.
    fn claim(&mut self, strategy: &str, text: &str, evidence: &Evidence) {
        let goal = self.add(ElementKind::Goal, text);
        self.support(strategy, goal.clone());
        let solution = |building: &mut Self, below: &str| {
            let solution = building.add(ElementKind::Solution, evidence.words.clone());
            building.change(&solution, |element| element.url = Some(format!("assessment.html#{}", evidence.part)));
            building.support(below, solution);
        };
        match evidence.mark {
            Mark::Good => solution(self, &goal),
            Mark::Bad => {
                let counter = self.add(ElementKind::Goal, format!("not so: {}", evidence.words));
                solution(self, &counter);
                self.change(&counter, |element| element.challenges = Some(goal.clone()));
                self.change(&goal, |element| element.defeated = true);
            }
            Mark::None | Mark::Number => self.change(&goal, |element| element.undeveloped = true),
        }
    }
}

impl Building {
    /// A goal that rests on a defeated one is defeated as well.
    fn carry_defeat(&mut self) {
        // Elements come before what supports them.
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

/// What speaks for a claim or against it.
struct Evidence {
    words: String,
    mark: Mark,
    part: &'static str,
}

impl Argument {
    pub(in crate::assessment) fn of(
        plan: &AssessmentPlan,
        summary: &Summary,
        distribution: &Distribution,
        searches: &Searches,
        proofs: &Proofs,
        limits: &Limits,
    ) -> Self {
        let name = |index: usize| plan.controllers.get(index).map_or("", |controller| controller.name.as_str());
        let (subject, first) = (name(plan.subject), name(0));
        let mut building = Building::default();
        let top = building.add(ElementKind::Goal, format!("{subject} can be relied on within the stated limits"));
        let over =
            building.add(ElementKind::Strategy, "over what it avoids, and over what it does better than another");
        building.support(&top, over.clone());
        let context = format!(
            "one lane; the paper's three scenarios; {} draws of its distribution (seed {}); searches of {}",
            distribution.draws,
            distribution.seed,
            searches.spaces.iter().map(|space| space.name.as_str()).collect::<Vec<_>>().join(", ")
        );
        let context = building.add(ElementKind::Context, context);
        let assumptions =
            format!("{} assumptions and limits, under \"What this does not show\"", limits.assumptions.len());
        let assumption = building.add(ElementKind::Assumption, assumptions);
        building.change(&assumption, |element| element.url = Some("assessment.html#limits".to_owned()));
        building.change(&top, |element| element.in_context_of = vec![context, assumption]);

        let avoids = building.add(ElementKind::Goal, format!("{subject} touches nobody"));
        building.support(&over, avoids.clone());
        let by_claim = building.add(ElementKind::Strategy, "over the claims of the verdict, each with its strength");
        building.support(&avoids, by_claim.clone());
        for claim in &summary.claims {
            let Some(strength) = claim.strengths.get(plan.subject) else { continue };
            building.claim(&by_claim, &claim.claim, &Evidence::of_strength(claim, strength));
        }
        if plan.subject != 0 {
            let better = building.add(ElementKind::Goal, format!("{subject} is safer than {first}"));
            building.support(&over, better.clone());
            let by_pair = building.add(ElementKind::Strategy, "over the same runs and searches of both");
            building.support(&better, by_pair.clone());
            for (text, evidence) in compared(subject, first, distribution, searches, proofs) {
                building.claim(&by_pair, &text, &evidence);
            }
        }
        building.carry_defeat();
        Self { elements: building.elements }
    }

    /// The argument as YAML, as tools of the notation read it: one entry an element, under its identifier.
    #[must_use]
    pub fn yaml(&self) -> String {
        let mut text = String::from("# Goal Structuring Notation; dialectic extension: challenges, defeated\n");
        for element in &self.elements {
            // Writing to a string cannot fail.
            let _ = element.write_yaml(&mut text);
        }
        text
    }

    /// The element of that identifier.
    pub(super) fn find(&self, id: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.id == id)
    }

    /// What challenges an element.
    pub(super) fn challenges_to(&self, id: &str) -> impl Iterator<Item = &Element> {
        self.elements.iter().filter(move |element| element.challenges.as_deref() == Some(id))
    }
}

impl Element {
    fn write_yaml(&self, out: &mut String) -> std::fmt::Result {
        // A JSON string is a YAML string too.
        let quoted = |text: &str| serde_json::Value::from(text).to_string();
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

impl Evidence {
    fn of_strength(claim: &Claim, strength: &Strength) -> Self {
        Self { words: strength.words(), mark: strength.mark(), part: claim.part }
    }
}

/// Claims about one controller beside another.
fn compared(
    subject: &str,
    first: &str,
    distribution: &Distribution,
    searches: &Searches,
    proofs: &Proofs,
) -> Vec<(String, Evidence)> {
    let mut claims = Vec::new();
    let sampled = |name: &str| distribution.controllers.iter().find(|sampled| sampled.controller == name);
    if let (Some(own), Some(other)) = (sampled(subject), sampled(first))
        && distribution.draws > 0
    {
        let words = format!("{} against {} of {} draws collide", own.collisions, other.collisions, distribution.draws);
        let mark = better(&own.collisions, &other.collisions);
        let evidence = Evidence { words, mark, part: "distribution" };
        claims.push(("it collides in fewer of the same draws of the paper's distribution".to_owned(), evidence));
    }
    let pair = [subject.to_owned(), first.to_owned()];
    if let Some(proof) = proofs.certificates.iter().find(|proof| proof.controllers == pair) {
        let mark = if proof.is_accepted() { Mark::Good } else { Mark::Bad };
        let evidence = Evidence { words: proof.status.words(), mark, part: "proofs" };
        claims.push(("it fails less often, by a certificate".to_owned(), evidence));
    }
    for space in &searches.spaces {
        let (Some(own), Some(other)) = (space.of(subject), space.of(first)) else { continue };
        let (Some(own_share), Some(other_share)) = (own.uniform_share(), other.uniform_share()) else { continue };
        let words = format!(
            "{own_share} % against {other_share} % of uniform points collide; {} against {} distinct avoidable failures",
            own.count(AvoidabilityClass::Avoidable),
            other.count(AvoidabilityClass::Avoidable)
        );
        let mark = better(&own_share, &other_share);
        let evidence = Evidence { words, mark, part: "search" };
        claims.push((format!("it collides at fewer uniform points of `{}`", space.name), evidence));
    }
    claims
}

/// Fewer is better, and as many shows nothing.
fn better<T: PartialOrd>(own: &T, other: &T) -> Mark {
    match own.partial_cmp(other) {
        Some(std::cmp::Ordering::Less) => Mark::Good,
        Some(std::cmp::Ordering::Greater) => Mark::Bad,
        Some(std::cmp::Ordering::Equal) | None => Mark::None,
    }
}

const INTRODUCTION: &str = "The verdict as a goal structure: a goal is claimed, a strategy says how it follows, a solution is \
    evidence. A goal with a cross is defeated: a counterexample challenges it, and stands beside it with evidence of its \
    own; or it rests on a goal that is defeated. A goal with a diamond has no evidence. The same argument is in assessment.gsn.yaml.";

impl Part for Argument {
    fn heading(&self) -> (&'static str, String) {
        ("argument", "Argument".to_owned())
    }

    fn html(&self) -> Markup {
        html! { p { (INTRODUCTION) } figure.wide { (argument_figure::draw(self)) } }
    }

    fn markdown(&self) -> String {
        let mut text = format!("{INTRODUCTION}\n\n");
        if let Some(top) = self.elements.first() {
            self.outline(top, 0, &mut text);
        }
        text
    }
}

impl Argument {
    fn outline(&self, element: &Element, depth: usize, text: &mut String) {
        let sign = match (element.defeated, element.undeveloped) {
            (true, _) => "✗ ",
            (_, true) => "◇ ",
            _ => "",
        };
        *text += &format!("{}- **{}** {sign}{}\n", "  ".repeat(depth), element.id, element.text);
        let below = element.supported_by.iter().chain(&element.in_context_of).filter_map(|id| self.find(id));
        for next in below.chain(self.challenges_to(&element.id)) {
            self.outline(next, depth + 1, text);
        }
    }
}
