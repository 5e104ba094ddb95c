//! The first page: the question, the answer, and the main reasons.

use maud::html;
use serde::Serialize;

use super::certificates::describe_estimator;
use super::domain_followers::{describe_followers_of_claims, followers_of_claim};
use super::summary::SubjectClaim;
use super::{
    AssessmentLimits, ClaimSummary, FailureSearches, FollowerReport, RecordedDrives, ScenarioCases,
    UsefulnessReport,
};
use crate::assessment::claims::{AssuranceClaim, Domain, InferenceRule, Property, Strength};
use crate::assessment::document::ReportDocument;
use crate::assessment::followers::describe_followers;
use crate::assessment::report_block::{ListStyle, ParagraphStyle, ReportBlock, TitledList};
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::rich_text::RichText;
use crate::assessment::{AssessmentPlan, ReportIdentity};
use crumple_core::quoting::TerminalText;

/// The answer to the question of whether the subject collides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SafetyAnswer {
    /// The subject fails in some runs.
    NotSafe,
    /// No run failed, and bounds or proofs cover the domains considered.
    SafeInDomain,
    /// No run failed and nothing more is known, or the evidence is contradictory.
    Undecided,
}

/// The first page of a report.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FirstPage {
    /// Question in words.
    pub question: String,
    /// Answer to the question.
    pub answer: SafetyAnswer,
    /// Answer in words that can be quoted.
    pub answer_text: String,
    /// Evidence against the subject, the gravest first.
    pub against: Vec<String>,
    /// Evidence for the subject, the strongest first.
    pub speaks_for: Vec<String>,
    /// Assumptions of the assessment.
    pub assumed: Vec<&'static str>,
    /// Drivers of the followers in the domains of the measured claims, as a sentence; empty without such claims.
    #[serde(skip)]
    followers: String,
    /// Name of the controller that the question is about.
    #[serde(skip)]
    subject: String,
}

const MAX_FAILURES_SHOWN: usize = 3;

impl FirstPage {
    pub(in crate::assessment) fn new(
        plan: &AssessmentPlan,
        summary: &ClaimSummary,
        limits: &AssessmentLimits,
    ) -> Self {
        let claims = strongest_first(summary.claims_about(plan.subject_index));
        let against: Vec<String> = claims
            .iter()
            .filter(|subject_claim| speaks_against(subject_claim))
            .map(|subject_claim| describe_refutation(plan, subject_claim))
            .collect();
        let answer = SafetyAnswer::new(plan, &claims);
        let answer_text = answer.describe(plan, &relevant_claims(plan, &claims), &against);
        let comparison = describe_comparison(plan, &claims);
        Self {
            question: ask_question(plan),
            answer,
            answer_text: format!("{answer_text} {comparison}").trim_end().to_owned(),
            against,
            speaks_for: claims
                .iter()
                .filter(|subject_claim| speaks_for(subject_claim))
                .map(|subject_claim| describe_support(plan, subject_claim))
                .collect(),
            assumed: limits
                .assumptions
                .iter()
                .map(|limit| limit.assumed)
                .collect(),
            followers: describe_followers_of_claims(plan, summary.measured_claims()),
            subject: plan.subject_name().to_owned(),
        }
    }

    fn evidence_lists(&self) -> Vec<TitledList> {
        vec![
            TitledList {
                title: format!("Evidence against `{}`", self.subject),
                lines: self.against.clone(),
            },
            TitledList {
                title: format!("Evidence for `{}`", self.subject),
                lines: self.speaks_for.clone(),
            },
        ]
    }
}

/// Sorts claims by their weight: a refutation outweighs everything.
fn strongest_first(mut claims: Vec<SubjectClaim<'_>>) -> Vec<SubjectClaim<'_>> {
    claims.sort_by(|a, b| b.weight().total_cmp(&a.weight()));
    claims
}

/// True for a claim that does not hold, unless only a part of it is refuted: that part is another claim.
fn speaks_against(subject_claim: &SubjectClaim<'_>) -> bool {
    let is_refuted_itself = subject_claim.status.strength.is_refutation()
        && subject_claim.status.rule != Some(InferenceRule::RefutedInPart);
    is_refuted_itself
        || matches!(
            subject_claim.status.strength,
            Strength::Contradicted | Strength::Unanswered { .. }
        )
}

fn speaks_for(subject_claim: &SubjectClaim<'_>) -> bool {
    subject_claim.status.strength.is_assurance()
        || subject_claim.status.strength.is_gain_in_limit()
        || matches!(
            subject_claim.status.strength,
            Strength::Tested { .. } | Strength::PartlyProved { .. }
        )
}

fn describe_support(plan: &AssessmentPlan, subject_claim: &SubjectClaim<'_>) -> String {
    format!(
        "{}: {}",
        with_followers(plan, subject_claim.claim, &subject_claim.row.claim),
        subject_claim.status.strength.describe()
    )
}

/// Names the drivers of the followers in brackets at the end of a phrase, if the claim is about collisions or failures.
fn with_followers(plan: &AssessmentPlan, claim: &AssuranceClaim, phrase: &str) -> String {
    let Some(drivers) = followers_of_claim(plan, claim) else {
        return phrase.to_owned();
    };
    let followers = describe_followers(&drivers);
    match phrase.strip_suffix(')') {
        Some(open) => format!("{open}; {followers})"),
        None => format!("{phrase} ({followers})"),
    }
}

fn ask_question(plan: &AssessmentPlan) -> String {
    let compared = match plan.controllers.first() {
        Some(first) if plan.subject_index != 0 => {
            format!(", and is it safer than `{}`", first.name)
        }
        _ => String::new(),
    };
    format!(
        "Does `{}`, {}, avoid collisions with the surrounding vehicles{compared}?",
        plan.subject_name(),
        describe_estimator(plan.config.estimator)
    )
}

/// Returns a sentence on failing less often than the first controller; empty if the subject is the first.
fn describe_comparison(plan: &AssessmentPlan, claims: &[SubjectClaim<'_>]) -> String {
    let Some(first) = plan.controllers.first().filter(|_| plan.subject_index != 0) else {
        return String::new();
    };
    let first = &first.name;
    let fewer = compared_domains(claims, Strength::is_assurance);
    let more = compared_domains(claims, |strength| {
        matches!(strength, Strength::CountedAgainst { .. })
    });
    let fewer = fewer.map(|spaces| {
        format!(
            "A certificate shows that it fails less often than `{first}` {spaces}; for other domains this is not shown."
        )
    });
    let more = more.map(|spaces| {
        format!("Counted runs show that it fails more often than `{first}` {spaces}.")
    });
    let sentences: Vec<String> = more.into_iter().chain(fewer).collect();
    if sentences.is_empty() {
        let counts = match plan.config.draws {
            0 => "",
            _ => "; the sections on random scenarios compare the counts of both",
        };
        return format!("No certificate shows that it fails less often than `{first}`{counts}.");
    }
    sentences.join(" ")
}

/// Returns the domains in which the comparison with the first controller has such a strength; `None` without any.
fn compared_domains(
    claims: &[SubjectClaim<'_>],
    has_strength: impl Fn(&Strength) -> bool,
) -> Option<String> {
    let compared = claims.iter().filter(|subject_claim| {
        matches!(
            subject_claim.claim.property,
            Property::FailsLessOften { .. }
        ) && has_strength(&subject_claim.status.strength)
    });
    let domains: Vec<String> = compared
        .map(|subject_claim| subject_claim.claim.describe_domain())
        .collect();
    (!domains.is_empty()).then(|| domains.join(" and "))
}

/// Describes a claim that does not hold: the violation and its frequency.
fn describe_refutation(
    plan: &AssessmentPlan,
    SubjectClaim { row, claim, status }: &SubjectClaim<'_>,
) -> String {
    let violation = claim.property.describe_violation();
    if let (Strength::Refuted { failures, runs }, Domain::Draws { space, seed, draws }) =
        (&status.strength, &claim.domain)
        && runs == draws
    {
        let scenarios = format!(
            "{failures} of {draws} random scenarios of `{}` (seed {seed})",
            space.name
        );
        let scenarios = with_followers(plan, claim, &scenarios);
        return format!("{violation} in {scenarios}");
    }
    let domain = with_followers(plan, claim, &claim.describe_domain());
    let strength = status.strength.describe_facts();
    match status.strength {
        // No violation occurred; the controller only failed to answer.
        Strength::Unanswered {
            failures: 0,
            refutes: true,
            ..
        } => format!("failure {domain}: {strength}"),
        _ if status.strength.is_refutation() => format!("{violation} {domain}: {strength}"),
        _ => format!("{}: {strength}", row.claim),
    }
}

/// Returns the claims that decide the answer: those of another estimator or about only the leader do not.
fn relevant_claims<'c, 'a>(
    plan: &AssessmentPlan,
    claims: &'c [SubjectClaim<'a>],
) -> Vec<&'c SubjectClaim<'a>> {
    claims
        .iter()
        .filter(|subject_claim| {
            matches!(
                subject_claim.claim.property,
                Property::NoCollision | Property::RateAtMost { .. }
            ) && subject_claim.claim.subject.estimator == plan.config.estimator
        })
        .collect()
}

fn is_refuted(subject_claim: &SubjectClaim<'_>) -> bool {
    subject_claim.status.strength.is_refutation()
}

/// True if some evidence refutes the claim, even if it is not the strongest.
fn has_refutation(subject_claim: &SubjectClaim<'_>) -> bool {
    let mut secondary = subject_claim.status.secondary.iter();
    is_refuted(subject_claim) || secondary.any(|evidence| evidence.strength.is_refutation())
}

impl SafetyAnswer {
    /// Derives the answer. A failed run outweighs all other evidence.
    fn new(plan: &AssessmentPlan, claims: &[SubjectClaim<'_>]) -> Self {
        let relevant = relevant_claims(plan, claims);
        let is_assured = relevant
            .iter()
            .any(|subject_claim| subject_claim.status.strength.is_assurance());
        let is_contradicted = relevant
            .iter()
            .any(|subject_claim| subject_claim.status.strength == Strength::Contradicted);
        if relevant
            .iter()
            .any(|subject_claim| has_refutation(subject_claim))
        {
            Self::NotSafe
        } else if is_assured && !is_contradicted {
            Self::SafeInDomain
        } else {
            Self::Undecided
        }
    }

    /// Describes the answer with its domain and strength, so that it can be quoted alone. `relevant` are the claims
    /// that decide it.
    fn describe(
        self,
        plan: &AssessmentPlan,
        relevant: &[&SubjectClaim<'_>],
        against: &[String],
    ) -> String {
        let subject = plan.subject_name();
        let objection = against.first().map_or(String::new(), |first| {
            format!(" Evidence against it: {first}.")
        });
        match self {
            Self::NotSafe => format!(
                "Not safe. Main evidence against `{subject}`: {}.",
                main_refutation(plan, relevant)
            ),
            Self::Undecided => format!(
                "Undecided: no result of this report bounds the failure rate of `{subject}`.{objection}"
            ),
            Self::SafeInDomain => format!(
                "Safe in the examined domains: no run of `{subject}` failed, and the report shows: {}. Nothing is \
                 known about other situations.{objection}",
                list_assurances(plan, relevant)
            ),
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

fn main_refutation(plan: &AssessmentPlan, relevant: &[&SubjectClaim<'_>]) -> String {
    let main = relevant.iter().copied().find(|subject_claim| {
        is_refuted(subject_claim) && subject_claim.status.rule != Some(InferenceRule::RefutedInPart)
    });
    main.map_or_else(
        || "a failed run in a part of a domain".to_owned(),
        |subject_claim| describe_refutation(plan, subject_claim),
    )
}

fn list_assurances(plan: &AssessmentPlan, relevant: &[&SubjectClaim<'_>]) -> String {
    let assured = relevant
        .iter()
        .filter(|subject_claim| subject_claim.status.strength.is_assurance())
        .map(|subject_claim| {
            format!(
                "{} ({})",
                with_followers(plan, subject_claim.claim, &subject_claim.row.claim),
                subject_claim.status.strength.describe()
            )
        });
    assured.collect::<Vec<_>>().join("; ")
}

impl FirstPage {
    /// Returns question, answer and reasons as text for a terminal.
    #[must_use]
    pub fn to_plain_text(&self) -> String {
        let text = format!(
            "{}\n{}\n",
            TerminalText(&self.question),
            TerminalText(&self.answer_text)
        );
        let subject = TerminalText(&self.subject);
        text + &plain_text_list(&format!("evidence against `{subject}`:"), &self.against)
            + &plain_text_list(&format!("evidence for `{subject}`:"), &self.speaks_for)
    }
}

/// Returns a heading and its lines; empty without lines.
fn plain_text_list(heading: &str, lines: &[String]) -> String {
    let lines: String = lines
        .iter()
        .map(|line| format!("  {}\n", TerminalText(line)))
        .collect();
    if lines.is_empty() {
        String::new()
    } else {
        format!("{heading}\n{lines}")
    }
}

const COMPARISON_NOTE: &str = "Proved: a checked certificate. Bounded: a rate with its confidence level. Tested: no \
    failure in these runs; others may fail. Refuted: runs that fail, distinct failures of a search, a lower bound of \
    the failure rate, or the largest gain. All controllers run the same random scenarios. A search chooses its own for \
    each controller, by several methods with the stated number of simulations each.";

const BOTH_SIDES_NOTE: &str = "Failures in dangerous scenarios and unnecessary braking in ordinary ones; further left \
    is better.";

const NO_RECORDED_DRIVES: &str = "No recorded drives were assessed (`--drives`): the counts hold in the stated spaces \
    only.";

const GATES_NOTE: &str = "The configuration sets the gates, and they alone decide the exit code.";

/// The section of the first page, with the results that it shows.
pub(in crate::assessment) struct FirstPageSection<'a> {
    pub(in crate::assessment) identity: &'a ReportIdentity,
    pub(in crate::assessment) page: &'a FirstPage,
    pub(in crate::assessment) summary: &'a ClaimSummary,
    pub(in crate::assessment) searches: &'a FailureSearches,
    pub(in crate::assessment) usefulness: Option<&'a UsefulnessReport>,
    pub(in crate::assessment) followers: Option<&'a FollowerReport>,
    pub(in crate::assessment) recorded_drives: Option<&'a RecordedDrives>,
}

impl ReportPart for FirstPageSection<'_> {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Verdict,
            anchor: "answer",
            title: "Result",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        let identity = self.identity.rows().into_iter();
        out.push(ReportBlock::Definitions(
            identity
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
        ));
        self.write_answer(out);
        self.write_gates(out);
        out.push(ReportBlock::Columns(self.page.evidence_lists()));
        self.write_both_sides_figure(out);
        self.write_worst_failures(out);
        self.write_assumptions(out);
    }
}

impl FirstPageSection<'_> {
    fn write_answer(&self, out: &mut ReportDocument) {
        let style = ParagraphStyle::Class(self.page.answer.css_class());
        out.push(ReportBlock::Paragraph(
            (&self.page.answer_text).into(),
            style,
        ));
        let comparison = self.summary.comparison_table();
        if !comparison.is_empty() {
            out.table(comparison);
            let note = format!("{} {COMPARISON_NOTE}", self.page.followers);
            out.paragraph(note.trim_start());
        }
        if let Some(usefulness) = self.usefulness {
            out.table(usefulness.both_sides_table());
            out.paragraph(usefulness.both_sides_note());
        }
        if let Some(followers) = self.followers {
            followers.write_first_page(out);
        }
        match self.recorded_drives {
            Some(drives) => {
                out.paragraph(drives.first_page_note());
                out.table(drives.first_page_table());
            }
            None => out.paragraph(NO_RECORDED_DRIVES),
        }
        out.paragraph(RichText::strong("Question: ").and_prose(&self.page.question));
    }

    fn write_gates(&self, out: &mut ReportDocument) {
        if self.summary.gates.is_empty() {
            return;
        }
        let verdict = self.summary.describe_gates();
        out.heading("Gates");
        out.paragraph(RichText::strong(verdict).and_prose(format!(" {GATES_NOTE}")));
        out.table(self.summary.gate_table());
    }

    fn write_both_sides_figure(&self, out: &mut ReportDocument) {
        let Some(usefulness) = self.usefulness else {
            return;
        };
        let figure = html! { (usefulness.figure("both-sides")) };
        let note = format!("{BOTH_SIDES_NOTE} {}.", usefulness.describe_followers());
        let figure = ReportBlock::Figure(figure, Some(note.into()));
        out.titled("Safety and usefulness of each controller", figure);
    }

    fn write_worst_failures(&self, out: &mut ReportDocument) {
        let subject = self.summary.subject.as_deref().unwrap_or_default();
        let worst = self.searches.worst_failures(subject, MAX_FAILURES_SHOWN);
        if worst.is_empty() {
            return;
        }
        let figures = worst.iter().flat_map(ScenarioCases::captioned_drawings);
        let figures = ReportBlock::Gallery(figures.collect());
        out.titled("Severest failures", figures);
    }

    fn write_assumptions(&self, out: &mut ReportDocument) {
        let lines = self.page.assumed.iter().map(|&line| line.into()).collect();
        out.heading("Assumptions and limits");
        out.push(ReportBlock::List(lines, ListStyle::Short));
    }
}
