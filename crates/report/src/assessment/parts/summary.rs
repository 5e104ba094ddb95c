//! The verdict: claims about each controller, and the strength of their evidence.

use serde::Serialize;

use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{
    AssuranceClaim, ClaimStatus, Domain, InferenceRule, Ledger, Property,
};
use crate::assessment::document::ReportDocument;
use crate::assessment::followers::{explain_follower, follower_kinds};
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentPlan, GateResult};
use crumple_core::markdown::prose_name;
use crumple_sim::control::{BuiltInController, ControllerSource as _};
use crumple_spaces::built_in_space_summary;

/// Every claim about every controller.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ClaimSummary {
    /// Controller that the question is about.
    pub subject: Option<String>,
    /// Names of the controllers, in the order of each claim's statuses.
    pub controllers: Vec<String>,
    /// Explanations of the names of controllers, followers and scenario spaces.
    pub named: Vec<NameExplanation>,
    /// One row per claim.
    pub claims: Vec<ClaimRow>,
    /// Results of the gates.
    pub gates: Vec<GateResult>,
    /// Indices of the first controller, the subject, and the learned ones.
    #[serde(skip)]
    main_columns: Vec<usize>,
}

/// A name and its explanation.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NameExplanation {
    /// Name of a controller, follower or scenario space.
    pub name: String,
    /// Explanation in a few words.
    pub explanation: String,
}

/// One property in one domain, claimed of every controller.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ClaimRow {
    /// Claim in words.
    pub claim: String,
    /// Anchor of the part with the evidence.
    pub part: &'static str,
    /// Claim about each controller; absent if it does not apply.
    pub claims: Vec<Option<AssuranceClaim>>,
    /// Status of the claim for each controller.
    pub statuses: Vec<ClaimStatus>,
}

/// A claim about one controller, and its status.
#[derive(Clone, Copy)]
pub(super) struct SubjectClaim<'a> {
    pub(super) row: &'a ClaimRow,
    pub(super) claim: &'a AssuranceClaim,
    pub(super) status: &'a ClaimStatus,
}

impl SubjectClaim<'_> {
    pub(super) fn weight(&self) -> f64 {
        self.status.strength.weight()
    }
}

impl ClaimSummary {
    pub(in crate::assessment) fn new(
        plan: &AssessmentPlan,
        claims: Vec<ClaimRow>,
        gates: Vec<GateResult>,
    ) -> Self {
        Self {
            subject: plan.subject().map(|subject| subject.name.clone()),
            controllers: plan.controller_names(),
            named: explain_names(plan),
            claims,
            gates,
            main_columns: main_columns(plan),
        }
    }

    /// Returns the claims about the controller with that index.
    pub(super) fn claims_about(&self, index: usize) -> Vec<SubjectClaim<'_>> {
        let claims = self.claims.iter().filter_map(|row| {
            Some(SubjectClaim {
                row,
                claim: row.claims.get(index)?.as_ref()?,
                status: row.statuses.get(index)?,
            })
        });
        claims.collect()
    }

    /// Returns the measured claims about any controller, one for each row.
    pub(super) fn measured_claims(&self) -> impl Iterator<Item = &AssuranceClaim> {
        self.claims
            .iter()
            .filter_map(|row| row.claims.iter().flatten().find(|claim| is_measured(claim)))
    }

    /// Returns the table of all claims: the main controllers first, then the others.
    fn table(&self) -> ReportTable {
        // The sort is stable: within both groups the order stays.
        let mut columns: Vec<usize> = (0..self.controllers.len()).collect();
        columns.sort_by_key(|index| !self.main_columns.contains(index));
        self.table_of(&columns, |_| true)
    }

    /// Returns the index of the subject among the controllers.
    fn subject_index(&self) -> usize {
        let subject = self.subject.as_deref();
        self.controllers
            .iter()
            .position(|name| Some(name.as_str()) == subject)
            .unwrap_or_default()
    }

    /// Returns the measured claims about the first controller and the subject.
    pub(super) fn comparison_table(&self) -> ReportTable {
        let subject_index = self.subject_index();
        let columns = if subject_index == 0 {
            vec![0]
        } else {
            vec![0, subject_index]
        };
        self.table_of(&columns, is_measured)
    }

    fn table_of(
        &self,
        columns: &[usize],
        is_shown: impl Fn(&AssuranceClaim) -> bool,
    ) -> ReportTable {
        let names = columns
            .iter()
            .filter_map(|&index| self.controllers.get(index).map(String::as_str));
        let header: Vec<&str> = std::iter::once("claim").chain(names).collect();
        let mut table = ReportTable::new(&header);
        for row in self
            .claims
            .iter()
            .filter(|row| row.claims.iter().flatten().any(&is_shown))
        {
            let cells = columns.iter().filter_map(|&index| row.cell(index));
            table.push_row(
                std::iter::once(ReportCell::text(&row.claim))
                    .chain(cells)
                    .collect(),
            );
        }
        table
    }

    /// Returns the gates and their results, as text for a terminal; empty without gates.
    #[must_use]
    pub fn gates_to_plain_text(&self) -> String {
        let lines: String = self.gates.iter().map(GateResult::to_plain_text).collect();
        if lines.is_empty() {
            lines
        } else {
            format!("gates:\n{lines}{}\n", self.describe_gates())
        }
    }

    pub(super) fn describe_gates(&self) -> String {
        let holding = self.gates.iter().filter(|gate| gate.holds).count();
        match (holding, self.gates.len()) {
            (1, 1) => "The gate holds.".to_owned(),
            (holding, all) if holding == all => format!("All {all} gates hold."),
            (holding, all) => format!("{holding} of {all} gates hold."),
        }
    }

    pub(super) fn gate_table(&self) -> ReportTable {
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

    fn name_table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.named,
            &[
                ("name", &|named| ReportCell::text(&named.name)),
                ("explanation", &|named| ReportCell::text(&named.explanation)),
            ],
        )
    }
}

/// True for a claim that runs decide, not proofs.
fn is_measured(claim: &AssuranceClaim) -> bool {
    match (&claim.property, &claim.domain) {
        (Property::FailsLessOften { .. }, _) => false,
        (Property::RateAtMost { .. }, _) => true,
        (_, domain) => matches!(
            domain,
            Domain::Scenarios { .. }
                | Domain::Draws { .. }
                | Domain::Search { .. }
                | Domain::RecordedDrives { .. }
                | Domain::Oscillations { .. }
        ),
    }
}

fn main_columns(plan: &AssessmentPlan) -> Vec<usize> {
    plan.controllers
        .iter()
        .enumerate()
        .filter(|(index, controller)| {
            *index == 0 || *index == plan.subject_index || controller.source.is_learned()
        })
        .map(|(index, _)| index)
        .collect()
}

fn explain_names(plan: &AssessmentPlan) -> Vec<NameExplanation> {
    let controllers = plan.controllers.iter().map(|controller| NameExplanation {
        name: controller.name.clone(),
        explanation: controller.source.description(),
    });
    let spaces = plan.all_spaces().into_iter().map(|space| {
        let explanation =
            built_in_space_summary(&space).unwrap_or_else(|| first_clause(&space.spec().about));
        NameExplanation {
            name: format!("space `{}`", prose_name(space.name())),
            explanation: explanation.to_owned(),
        }
    });
    let followers = explain_followers(plan).into_iter();
    controllers.chain(followers).chain(spaces).collect()
}

/// Explains the followers of the spaces that are no controllers of the assessment, each once.
fn explain_followers(plan: &AssessmentPlan) -> Vec<NameExplanation> {
    let mut followers: Vec<NameExplanation> = Vec::new();
    for kind in plan.all_spaces().iter().flat_map(follower_kinds) {
        let name = format!("follower `{}`", prose_name(&kind));
        let is_controller = plan
            .controllers
            .iter()
            .any(|controller| controller.name == kind);
        let is_known = followers.iter().any(|follower| follower.name == name);
        let explanation = explain_follower(&kind).map(str::to_owned).or_else(|| {
            let built_in = BuiltInController::from_name_or_preset(&kind)?;
            Some(built_in.description())
        });
        if let Some(explanation) = explanation
            && !is_controller
            && !is_known
        {
            followers.push(NameExplanation { name, explanation });
        }
    }
    followers
}

/// Returns the text before the first `.` or `:` that is not part of a word or number.
fn first_clause(text: &str) -> &str {
    let end = text
        .match_indices(['.', ':'])
        .map(|(index, _)| index)
        .find(|index| {
            let rest = text.get(index + 1..).unwrap_or_default();
            rest.chars().next().is_none_or(char::is_whitespace)
        });
    end.and_then(|end| text.get(..end)).unwrap_or(text)
}

impl ClaimRow {
    /// Looks up the evidence of each claim. Drops claims about no controller, and repeated ones.
    pub(in crate::assessment) fn from_drafts(
        drafts: Vec<ClaimDraft>,
        evidence: &Ledger,
    ) -> Vec<Self> {
        let mut rows: Vec<Self> = Vec::new();
        for draft in drafts {
            let is_repeated = rows.iter().any(|row| row.claims == draft.claims);
            if !is_repeated {
                rows.extend(Self::from_draft(draft, evidence));
            }
        }
        rows
    }

    /// Returns the cell of a controller; a dash if the claim does not apply to it.
    fn cell(&self, index: usize) -> Option<ReportCell> {
        let claim = self.claims.get(index)?;
        let strength = &self.statuses.get(index)?.strength;
        Some(match claim {
            Some(_) => ReportCell::with_mark(strength.table_text(), strength.mark()),
            None => ReportCell::text("–"),
        })
    }

    fn from_draft(draft: ClaimDraft, evidence: &Ledger) -> Option<Self> {
        let first = draft.claims.iter().flatten().next()?;
        let claim = draft.text.unwrap_or_else(|| first.describe());
        let statuses = draft
            .claims
            .iter()
            .map(|claim| claim_status(claim.as_ref(), evidence))
            .collect();
        Some(Self {
            claim,
            part: draft.part,
            claims: draft.claims,
            statuses,
        })
    }
}

/// Returns the status of a claim; [`Strength::Untried`](crate::assessment::Strength::Untried) without a claim.
fn claim_status(claim: Option<&AssuranceClaim>, evidence: &Ledger) -> ClaimStatus {
    claim.map_or_else(ClaimStatus::default, |claim| evidence.claim_status(claim))
}

impl ReportPart for ClaimSummary {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Verdict,
            anchor: "verdict",
            title: "Claims",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        out.collapsible(
            "names of controllers, followers and spaces",
            self.name_table(),
        );
        out.paragraph(LEGEND);
        out.list(LEVELS);
        out.table(self.table());
        let mut rules = ReportDocument::new();
        rules.list(
            std::iter::once(InferenceRule::Direct)
                .chain(InferenceRule::DERIVED)
                .map(InferenceRule::describe),
        );
        out.collapsible("rules from evidence to claims", rules);
    }
}

const LEGEND: &str = "A dash: not claimed. Each cell begins with the strength of the evidence:";

/// The words of cells, and what their numbers mean.
const LEVELS: [&str; 6] = [
    "proved: the checker accepted certificates, under the assumptions in the section \"Proofs\"",
    "bounded: a bound of the failure rate with its confidence level (`≤ 0.24 % (99.9 %)`), or a certified comparison",
    "tested: no failure in these runs (`0 of 1000`), fewer failures in the same runs (`0 against 1000`), or the \
     largest gain; other runs may fail",
    "refuted: runs that fail (`points`: mean speeds and frequencies), distinct failures of a search, a lower bound of \
     the failure rate, the largest gain, or more failures in counted runs (`more (99.9 %)`)",
    "not shown: evidence was gathered, about the claim or a part of its domain, and does not decide the claim",
    "not examined: no evidence about the claim was gathered",
];
