//! The first page: the question, the answer, and the main reasons.

use maud::html;
use serde::Serialize;

use super::ScenarioCases;
use super::certificates::describe_estimator;
use super::summary::SubjectClaim;
use crate::assessment::claims::{InferenceRule, Property, Strength};
use crate::assessment::document::ReportDocument;
use crate::assessment::prose::prose_to_html;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentPlan, AssessmentReport, GateResult, ReportPart};
use crate::draw::Svg;
use crumple_core::markdown::Inline;
use crumple_core::quoting::TerminalText;

/// The answer to the question of whether the subject collides.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SafetyAnswer {
    /// The subject fails in some runs.
    NotSafe,
    /// No run failed, and bounds or proofs cover the domains considered.
    SafeInDomain,
    /// No run failed and nothing more is known, or the evidence is contradictory.
    #[default]
    Undecided,
}

/// The first page of a report.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FirstPage {
    /// Question in words.
    pub question: String,
    /// Answer to the question.
    pub answer: SafetyAnswer,
    /// Answer in words that can be quoted.
    #[serde(rename = "words")]
    pub answer_text: String,
    /// Evidence against the subject, the gravest first.
    pub against: Vec<String>,
    /// Evidence for the subject, the strongest first.
    pub speaks_for: Vec<String>,
    /// Assumptions of the assessment.
    pub assumed: Vec<&'static str>,
    #[serde(skip)]
    pub(in crate::assessment) gates: Vec<GateResult>,
    /// Table that compares the subject with the first controller.
    #[serde(skip)]
    comparison: ReportTable,
    #[serde(skip)]
    worst_failures: Vec<ScenarioCases>,
    /// Table of safety and usefulness of all controllers, a sentence that explains it, and a figure.
    #[serde(skip)]
    both_sides: Option<(ReportTable, String, Svg)>,
}

const MAX_FAILURES_SHOWN: usize = 3;

impl FirstPage {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan, found: &AssessmentReport) -> Self {
        let subject = plan
            .subject()
            .map_or("", |controller| controller.name.as_str());
        let mut claims = found.summary.claims_about(plan.subject_index);
        // The strongest first: a refutation outweighs everything.
        claims.sort_by(|a, b| {
            b.status
                .strength
                .weight()
                .total_cmp(&a.status.strength.weight())
        });
        // Omit claims that are refuted only because a part of them is: the part is listed.
        let speaks_against = |one: &&SubjectClaim<'_>| {
            (one.status.strength.is_refutation()
                && one.status.rule != Some(InferenceRule::RefutedInPart))
                || matches!(
                    one.status.strength,
                    Strength::Contradicted | Strength::Unanswered { .. }
                )
        };
        let against: Vec<String> = claims
            .iter()
            .filter(speaks_against)
            .map(describe_refutation)
            .collect();
        let speaks_for = |one: &&SubjectClaim<'_>| {
            one.status.strength.is_assurance()
                || one.status.strength.is_gain_in_limit()
                || matches!(
                    one.status.strength,
                    Strength::Tested { .. } | Strength::PartlyProved { .. }
                )
        };
        let describe = |one: &SubjectClaim<'_>| {
            format!("{}: {}", one.row.claim, one.status.strength.describe())
        };
        let speaks_for = claims.iter().filter(speaks_for).map(describe).collect();
        let (answer, answer_text) = SafetyAnswer::new(plan, subject, &claims, &against);
        let answer_text = format!("{answer_text} {}", describe_comparison(plan, &claims));
        let compared = match plan.controllers.first() {
            Some(first) if plan.subject_index != 0 => {
                format!(", and is it safer than `{}`", first.name)
            }
            _ => String::new(),
        };
        let question = format!(
            "Does `{subject}`, {}, avoid collisions with the surrounding vehicles{compared}?",
            describe_estimator(plan.config.estimator)
        );
        Self {
            question,
            answer,
            answer_text: answer_text.trim_end().to_owned(),
            against,
            speaks_for,
            assumed: found
                .limits
                .assumptions
                .iter()
                .map(|limit| limit.assumed)
                .collect(),
            // Filled in later, because gates evaluate all other parts.
            gates: Vec::new(),
            comparison: found.summary.comparison_table(plan.subject_index),
            worst_failures: found.searches.worst_failures(subject, MAX_FAILURES_SHOWN),
            both_sides: found.usefulness.as_ref().map(|usefulness| {
                (
                    usefulness.both_sides_table(),
                    usefulness.both_sides_note(),
                    usefulness.figure("both-sides"),
                )
            }),
        }
    }
}

/// Returns a sentence on failing less often than the first controller; empty if the subject is the first.
fn describe_comparison(plan: &AssessmentPlan, claims: &[SubjectClaim<'_>]) -> String {
    let Some(first) = plan.controllers.first().filter(|_| plan.subject_index != 0) else {
        return String::new();
    };
    let is_shown = |one: &&SubjectClaim<'_>| {
        matches!(one.claim.property, Property::FailsLessOften { .. })
            && one.status.strength.is_assurance()
    };
    let spaces: Vec<_> = claims
        .iter()
        .filter(is_shown)
        .map(|one| one.claim.describe_domain())
        .collect();
    match spaces.as_slice() {
        [] => format!("It is not shown to fail less often than `{}`.", first.name),
        spaces => format!(
            "A certificate shows that it fails less often than `{}` {}; for other domains this is not shown.",
            first.name,
            spaces.join(" and ")
        ),
    }
}

/// Describes a claim that does not hold: the violation first, then its frequency.
fn describe_refutation(SubjectClaim { row, claim, status }: &SubjectClaim<'_>) -> String {
    let (domain, strength) = (claim.describe_domain(), status.strength.describe());
    match status.strength {
        // No violation occurred; the controller only failed to answer.
        Strength::Unanswered {
            failures: 0,
            refutes: true,
            ..
        } => format!("failure {domain}: {strength}"),
        _ if status.strength.is_refutation() => {
            format!(
                "{} {domain}: {strength}",
                claim.property.describe_violation()
            )
        }
        _ => format!("{}: {strength}", row.claim),
    }
}

impl SafetyAnswer {
    /// Derives the answer, and describes it with its domain and strength, so that it can be quoted alone. A failed run
    /// outweighs all other evidence; claims of another estimator or only the leader do not count.
    fn new(
        plan: &AssessmentPlan,
        subject: &str,
        claims: &[SubjectClaim<'_>],
        against: &[String],
    ) -> (Self, String) {
        let is_relevant = |one: &&SubjectClaim<'_>| {
            matches!(
                one.claim.property,
                Property::NoContact | Property::RateAtMost { .. }
            ) && one.claim.subject.estimator == plan.config.estimator
        };
        let about: Vec<_> = claims.iter().filter(is_relevant).collect();
        let is_refuted = |one: &&SubjectClaim<'_>| one.status.strength.is_refutation();
        let is_refuted_beside = |one: &&SubjectClaim<'_>| {
            one.status
                .secondary
                .iter()
                .any(|beside| beside.strength.is_refutation())
        };
        let besides = against.first().map_or(String::new(), |first| {
            format!(" Evidence against it: {first}.")
        });
        let assured = about
            .iter()
            .filter(|one| one.status.strength.is_assurance());
        let assured: Vec<_> = assured
            .map(|one| format!("{} ({})", one.row.claim, one.status.strength.describe()))
            .collect();
        if about
            .iter()
            .any(|one| is_refuted(one) || is_refuted_beside(one))
        {
            let mut refuted = about.iter().copied().filter(is_refuted);
            let why = refuted.find(|one| one.status.rule != Some(InferenceRule::RefutedInPart));
            let why = why.map_or_else(
                || "a failed run in a part of a domain".to_owned(),
                describe_refutation,
            );
            (
                Self::NotSafe,
                format!("Not safe. Main evidence against `{subject}`: {why}."),
            )
        } else if assured.is_empty()
            || about
                .iter()
                .any(|one| one.status.strength == Strength::Contradicted)
        {
            let words = format!("no result of this report bounds the failure rate of `{subject}`");
            (Self::Undecided, format!("Undecided: {words}.{besides}"))
        } else {
            let words = format!(
                "Safe in the examined domains: no run of `{subject}` failed, and the report shows: {}. Nothing is \
                 known about other situations.{besides}",
                assured.join("; ")
            );
            (Self::SafeInDomain, words)
        }
    }

    fn css_class(self) -> &'static str {
        match self {
            Self::NotSafe => "answer bad",
            Self::SafeInDomain => "answer good",
            Self::Undecided => "answer",
        }
    }
}

impl FirstPage {
    /// Returns question, answer and reasons as text for a terminal.
    #[must_use]
    pub fn to_plain_text(&self) -> String {
        let list = |head: &str, lines: &[String]| {
            let lines: String = lines
                .iter()
                .map(|line| format!("  {}\n", TerminalText(line)))
                .collect();
            if lines.is_empty() {
                String::new()
            } else {
                format!("{head}\n{lines}")
            }
        };
        let text = format!(
            "{}\n{}\n",
            TerminalText(&self.question),
            TerminalText(&self.answer_text)
        );
        text + &list("evidence against it:", &self.against)
            + &list("evidence for it:", &self.speaks_for)
    }

    /// Returns the gates and their results, as text for a terminal; empty without gates.
    #[must_use]
    pub fn gates_to_plain_text(&self) -> String {
        let line = |gate: &GateResult| {
            let verdict = if gate.holds { "holds " } else { "FAILED" };
            format!(
                "  {verdict}  {}\n",
                TerminalText(&format!("{} ({})", gate.gate, gate.reason))
            )
        };
        let lines: String = self.gates.iter().map(line).collect();
        if lines.is_empty() {
            lines
        } else {
            format!("gates:\n{lines}{}\n", self.describe_gates())
        }
    }

    fn describe_gates(&self) -> String {
        let holding = self.gates.iter().filter(|gate| gate.holds).count();
        match (holding, self.gates.len()) {
            (1, 1) => "The gate holds.".to_owned(),
            (all, of) if all == of => format!("All {of} gates hold."),
            (holding, of) => format!("{holding} of {of} gates hold."),
        }
    }

    fn gate_table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.gates,
            &[
                ("gate", &|gate| ReportCell::text(&gate.gate)),
                ("result", &|gate| {
                    ReportCell::with_verdict(&gate.reason, gate.holds)
                }),
            ],
        )
    }
}

const COMPARISON_NOTE: &str = "A cell counts the runs that fail or the distinct failures of a search, or bounds a rate \
    with a confidence level. All controllers run the same scenarios.";

const GATES_NOTE: &str = "The configuration sets the gates, and they alone decide the exit code.";

impl ReportPart for FirstPage {
    fn write(&self, out: &mut ReportDocument) {
        out.push_html(
            html! { p class=(self.answer.css_class()) { (prose_to_html(&self.answer_text)) } },
        );
        out.markdown_mut().paragraph(self.answer_text.as_str());
        if !self.comparison.is_empty() {
            out.table(&self.comparison);
            out.paragraph(COMPARISON_NOTE);
        }
        if let Some((table, note, _)) = &self.both_sides {
            out.table(table);
            out.paragraph(note);
        }
        out.push_html(html! { p { b { "Question: " } (prose_to_html(&self.question)) } });
        out.markdown_mut()
            .paragraph(Inline::strong("Question:").and_prose(&format!(" {}", self.question)));
        if !self.gates.is_empty() {
            out.push_html(
                html! { h3 { "Gates" } p { b { (self.describe_gates()) } " " (GATES_NOTE) } },
            );
            out.markdown_mut()
                .paragraph(format!("{} {GATES_NOTE}", self.describe_gates()));
            out.table(&self.gate_table());
        }
        let sides = [
            ("Evidence against it", &self.against),
            ("Evidence for it", &self.speaks_for),
        ];
        out.push_html(html! {
            div.sides { @for (title, lines) in sides {
                div {
                    h3 { (title) }
                    ul { @for line in lines { li { (prose_to_html(line)) } } @if lines.is_empty() { li { "none" } } }
                }
            } }
            @if let Some((_, _, sides)) = &self.both_sides {
                h3 { "Safety and usefulness of each controller" }
                p { "Collisions in dangerous scenarios and unnecessary braking in ordinary ones; further left is \
                    better." }
                figure { (sides) }
            }
            @if !self.worst_failures.is_empty() {
                h3 { "Severest failures" }
                div.worst { @for cases in &self.worst_failures { @for case in &cases.cases {
                    figure {
                        (cases.figure(case)) figcaption { (case.verdict.describe()) " · " (cases.replay_html(case)) }
                    }
                } } }
            }
            h3 { "Assumptions" }
            ul.short { @for line in &self.assumed { li { (line) } } }
        });
        for (title, lines) in sides {
            out.markdown_mut().paragraph(format!("{title}:"));
            out.markdown_mut().list(lines.iter().map(String::as_str));
        }
        out.markdown_mut()
            .paragraph("The assumptions are in the section \"Limits\".");
    }
}
