//! The verdict: claims about each controller, and the strength of their evidence.

use maud::html;
use serde::Serialize;

use super::certificates::{describe_estimator, kernel_domain, shield_kernels};
use super::{OscillationGain, Suites};
use crate::assessment::claims::{
    AssuranceClaim, ClaimStatus, ContentId, Domain, InferenceRule, Property,
};
use crate::assessment::document::ReportDocument;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentPlan, AssessmentReport, GateResult, ReportPart, Rounded};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::built_in_space_summary;

/// Every claim about every controller.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ClaimSummary {
    /// Controller that the question is about.
    pub subject: Option<String>,
    /// Names of the controllers, in the order of each claim's statuses.
    pub controllers: Vec<String>,
    /// Explanations of the names of controllers and scenario spaces.
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
    /// Name of a controller or scenario space.
    pub name: String,
    /// Explanation in a few words.
    #[serde(rename = "what")]
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
    #[serde(rename = "standings")]
    pub statuses: Vec<ClaimStatus>,
}

/// A claim about one controller, and its status.
#[derive(Clone, Copy)]
pub(super) struct SubjectClaim<'a> {
    pub(super) row: &'a ClaimRow,
    pub(super) claim: &'a AssuranceClaim,
    pub(super) status: &'a ClaimStatus,
}

/// Largest failure rate that counts as rare, in percent.
const RARE_PERCENT: f64 = 1.0;

impl ClaimSummary {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan, found: &AssessmentReport) -> Self {
        let controllers: Vec<_> = plan
            .controllers
            .iter()
            .map(|controller| controller.name.clone())
            .collect();
        let claims = claim_rows(plan, found);
        let subject = plan.subject().map(|subject| subject.name.clone());
        let is_asked = |&index: &usize| {
            index == 0
                || index == plan.subject_index
                || plan
                    .controllers
                    .get(index)
                    .is_some_and(|one| one.source.is_learned())
        };
        let main_columns = (0..controllers.len()).filter(is_asked).collect();
        Self {
            subject,
            controllers,
            named: explain_names(plan),
            claims,
            gates: Vec::new(),
            main_columns,
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

    /// Returns the table of all claims: the main controllers first, then the others.
    fn table(&self) -> ReportTable {
        let is_main = |index: &usize| self.main_columns.contains(index);
        let (main, others): (Vec<usize>, Vec<usize>) =
            (0..self.controllers.len()).partition(is_main);
        self.table_of(&[main, others].concat(), |_| true)
    }

    /// Returns the measured claims about the first controller and the subject.
    pub(super) fn comparison_table(&self, subject_index: usize) -> ReportTable {
        let is_measured = |claim: &AssuranceClaim| match (&claim.property, &claim.domain) {
            (Property::FailsLessOften { .. }, _) => false,
            (Property::RateAtMost { .. }, _) => true,
            (_, domain) => matches!(
                domain,
                Domain::Scenarios { .. }
                    | Domain::Draws { .. }
                    | Domain::Search { .. }
                    | Domain::Oscillations { .. }
            ),
        };
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
        for claim in self
            .claims
            .iter()
            .filter(|row| row.claims.iter().flatten().any(&is_shown))
        {
            let of = |&index: &usize| {
                Some((
                    claim.claims.get(index)?.as_ref(),
                    claim.statuses.get(index)?,
                ))
            };
            let cells = columns
                .iter()
                .filter_map(of)
                .map(|(claim, status)| match claim {
                    Some(_) => {
                        ReportCell::with_mark(status.strength.table_text(), status.strength.mark())
                    }
                    None => ReportCell::text("–"),
                });
            table.push_row(
                std::iter::once(ReportCell::text(&claim.claim))
                    .chain(cells)
                    .collect(),
            );
        }
        table
    }

    fn name_table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.named,
            &[
                ("name", &|one| ReportCell::text(&one.name)),
                ("explanation", &|one| ReportCell::text(&one.explanation)),
            ],
        )
    }
}

fn explain_names(plan: &AssessmentPlan) -> Vec<NameExplanation> {
    let controllers = plan.controllers.iter().map(|one| NameExplanation {
        name: one.name.clone(),
        explanation: one.source.description(),
    });
    let spaces = plan.all_spaces().into_iter().map(|space| {
        let explanation =
            built_in_space_summary(&space).unwrap_or_else(|| first_clause(&space.spec().about));
        NameExplanation {
            name: format!("space `{}`", space.name()),
            explanation: explanation.to_owned(),
        }
    });
    controllers.chain(spaces).collect()
}

/// Returns the text before the first `.` or `:` that is not part of a word or number.
fn first_clause(text: &str) -> &str {
    let is_end = |at: usize| {
        text.get(at + 1..)
            .is_none_or(|rest| rest.chars().next().is_none_or(char::is_whitespace))
    };
    let end = text
        .match_indices(['.', ':'])
        .map(|(at, _)| at)
        .find(|at| is_end(*at));
    end.and_then(|end| text.get(..end)).unwrap_or(text)
}

fn claim_rows(plan: &AssessmentPlan, found: &AssessmentReport) -> Vec<ClaimRow> {
    let mut rows = Vec::new();
    let mut add = |part, words: Option<String>, claims: Vec<Option<AssuranceClaim>>| {
        let Some(first) = claims.iter().flatten().next() else {
            return;
        };
        if rows.iter().any(|known: &ClaimRow| known.claims == claims) {
            return;
        }
        let claim = words.unwrap_or_else(|| first.describe());
        let status = |claim: &Option<AssuranceClaim>| {
            claim
                .as_ref()
                .map_or_else(ClaimStatus::default, |one| found.evidence.claim_status(one))
        };
        let statuses = claims.iter().map(status).collect();
        rows.push(ClaimRow {
            claim,
            part,
            claims,
            statuses,
        });
    };
    let of_all = |property: Property,
                  domain: Domain,
                  estimator: EstimatorKind|
     -> Vec<Option<AssuranceClaim>> {
        let claim = |index| {
            let subject = plan.claim_subject(index, estimator)?;
            Some(AssuranceClaim {
                subject,
                property: property.clone(),
                domain: domain.clone(),
            })
        };
        (0..plan.controllers.len()).map(claim).collect()
    };
    let own = plan.config.estimator;
    if let Some(paper) = &found.paper_scenarios {
        add(
            "paper",
            None,
            of_all(Property::NoContact, paper.domain(), own),
        );
    }
    if let Some(traffic) = &found.file_scenarios {
        add(
            "traffic",
            None,
            of_all(Property::NoContact, traffic.domain(), own),
        );
    }
    for claims in Suites::claims(plan) {
        add("suites", None, claims);
    }
    let drawn_from = found.rate_spaces.spaces.iter().zip(&plan.rate_spaces);
    for (drawn, named) in drawn_from.filter(|(drawn, _)| drawn.random_scenarios > 0) {
        let (space, seed, draws) = (|| drawn.space.clone(), drawn.seed, drawn.random_scenarios);
        let in_draws = || Domain::Draws {
            space: space(),
            seed,
            draws,
        };
        add(
            "distribution",
            None,
            of_all(Property::NoContact, in_draws(), own),
        );
        if named.can_others_collide() {
            add(
                "distribution",
                None,
                of_all(Property::OthersKeepClear, in_draws(), own),
            );
        }
        let rare = Property::RateAtMost {
            percent: Rounded::new(RARE_PERCENT),
        };
        add(
            "distribution",
            None,
            of_all(rare, Domain::Space { space: space() }, own),
        );
        if let Some(first) = plan.claim_subject(0, own) {
            let fewer = Property::FailsLessOften {
                than: first.controller,
            };
            for (part, domain) in [
                ("distribution", in_draws()),
                ("proofs", Domain::Space { space: space() }),
            ] {
                let mut claims = of_all(fewer.clone(), domain, own);
                // The first controller cannot fail less often than itself.
                claims[0] = None;
                add(part, None, claims);
            }
        }
    }
    for searched in &found.searches.spaces {
        add(
            "search",
            None,
            of_all(Property::NoContact, searched.domain(plan), own),
        );
    }
    if let Some(usefulness) = &found.usefulness {
        let [traffic, danger] = usefulness.domains();
        add(
            "usefulness",
            None,
            of_all(Property::NoUnnecessaryBraking, traffic.clone(), own),
        );
        add(
            "usefulness",
            None,
            of_all(Property::KeepsUp, traffic.clone(), own),
        );
        add(
            "usefulness",
            None,
            of_all(
                Property::NoGrowingOscillation,
                OscillationGain::domain(),
                EstimatorKind::Truth,
            ),
        );
        add(
            "usefulness",
            None,
            of_all(Property::NoContact, traffic, own),
        );
        add("usefulness", None, of_all(Property::NoContact, danger, own));
    }
    // For a whole space only a proof could support the claim; one failure refutes it.
    let mut spaces: Vec<&ContentId> = Vec::new();
    let drawn = found
        .rate_spaces
        .spaces
        .iter()
        .filter(|drawn| drawn.random_scenarios > 0)
        .map(|drawn| &drawn.space);
    for space in drawn.chain(
        found
            .searches
            .spaces
            .iter()
            .map(|searched| &searched.content_id),
    ) {
        if !spaces.contains(&space) {
            spaces.push(space);
            add(
                "search",
                None,
                of_all(
                    Property::NoContact,
                    Domain::Space {
                        space: space.clone(),
                    },
                    own,
                ),
            );
        }
    }
    for claim in found.proofs.reach_claims() {
        let words = format!(
            "{}, {}",
            claim.describe(),
            describe_estimator(claim.subject.estimator)
        );
        add(
            "proofs",
            Some(words),
            of_all(
                claim.property.clone(),
                claim.domain.clone(),
                claim.subject.estimator,
            ),
        );
    }
    let shielded = |controller: &NamedController| controller.source.as_shield().is_some();
    let domain = |controller: &NamedController| kernel_domain(&shield_kernels(controller));
    for one in plan.controllers.iter().filter(|one| shielded(one)) {
        // Shields with other limits prove other claims.
        let claim = |(index, other): (usize, &NamedController)| {
            let is_same = shielded(other) && domain(other) == domain(one);
            let subject = plan.claim_subject(index, own).filter(|_| is_same)?;
            Some(AssuranceClaim {
                subject,
                property: Property::NoContactAhead,
                domain: domain(one),
            })
        };
        add(
            "proofs",
            None,
            plan.controllers.iter().enumerate().map(claim).collect(),
        );
    }
    rows
}

impl ReportPart for ClaimSummary {
    fn write(&self, out: &mut ReportDocument) {
        out.collapsible("names of controllers and spaces", |out| {
            out.table(&self.name_table())
        });
        out.paragraph(LEGEND);
        out.table(&self.table());
        out.push_html(html! {
            details {
                summary { "rules from evidence to claims" }
                ul {
                    li { (InferenceRule::Direct.describe()) }
                    @for rule in InferenceRule::DERIVED { li { (rule.describe()) } }
                }
            }
        });
    }
}

const LEGEND: &str = "✓ supported, ✗ refuted, – not claimed. A cell gives the failures of the runs (`0 of 1000`), the \
    failures of both controllers in the same runs (`0 against 1000`), bounds of a rate with their confidence level \
    (`≤ 0.24 % (99.9 %)`), the distinct failures of a search, or the largest gain. A proof holds under the assumptions \
    in the section \"Proofs\".";
