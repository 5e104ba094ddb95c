//! The table of the first page: the subject of the assessment next to the first controller.

use super::{CertificateSubject, ClaimSummary, GatheredEvidence, ScenarioCases};
use crate::assessment::AssessmentPlan;
use crate::assessment::claims::{AssuranceClaim, Property};
use crate::assessment::table::{ReportCell, ReportTable};
use crumple_search::falsify::counterexample::AvoidabilityClass;

/// Returns one row per measure, with a column for the first controller and one for the subject.
pub(super) fn compare_controllers(
    plan: &AssessmentPlan,
    summary: &ClaimSummary,
    found: &GatheredEvidence<'_>,
) -> ReportTable {
    let mut columns = vec![0];
    if plan.subject_index != 0 {
        columns.push(plan.subject_index);
    }
    let names = columns.iter().filter_map(|&index| plan.controllers.get(index)).map(|one| one.name.as_str());
    let mut table = ReportTable::new(&std::iter::once("measure").chain(names).collect::<Vec<_>>());
    let mut add_row = |measure: String, cell: &dyn Fn(usize) -> Option<ReportCell>| {
        let cells: Vec<_> = columns.iter().map(|&index| cell(index)).collect();
        if cells.iter().any(Option::is_some) {
            let cells = cells.into_iter().map(|cell| cell.unwrap_or_else(|| ReportCell::text("–")));
            table.push_row(std::iter::once(ReportCell::text(measure)).chain(cells).collect());
        }
    };

    if let Some(paper) = found.paper {
        add_row("collisions in the paper's scenarios".to_owned(), &|index| count_cases(&paper.scenarios, index));
    }
    if let Some(files) = found.traffic {
        add_row("collisions in scenario files".to_owned(), &|index| count_cases(&files.scenarios, index));
    }
    let sampled = || found.rate_spaces.spaces.iter().filter(|sample| sample.random_scenarios > 0);
    for sample in sampled() {
        add_row(format!("collisions in random scenarios of `{}`", sample.space.name), &|index| {
            let own = sample.controllers.get(index)?;
            let runs = sample.random_scenarios - own.ended_by_others;
            Some(count_cell(own.collisions, own.unanswered_runs(), runs))
        });
    }
    if let Some(everyday) = found.usefulness {
        for (place, space) in everyday.spaces.iter().enumerate() {
            if sampled().any(|sample| sample.space == *space) {
                continue;
            }
            add_row(format!("collisions in random scenarios of `{}`", space.name), &|index| {
                let own = everyday.controllers.get(index)?;
                let (failures, unanswered) = ([own.failures, own.high_risk_failures][place], own.unanswered_runs());
                let runs = everyday.random_scenarios - own.ended_by_others[place];
                Some(count_cell(failures.saturating_sub(unanswered[place]), unanswered[place], runs))
            });
        }
    }
    let rate_claim = |claims: &[Option<AssuranceClaim>]| -> Option<String> {
        let is_rate = |claim: &&AssuranceClaim| matches!(claim.property, Property::RateAtMost { .. });
        Some(claims.iter().flatten().find(is_rate)?.describe_domain())
    };
    for row in &summary.claims {
        if let Some(domain) = rate_claim(&row.claims) {
            add_row(format!("collision rate {domain}"), &|index| {
                let strength = &row.statuses.get(index)?.strength;
                Some(ReportCell::with_mark(strength.table_text(), strength.mark()))
            });
        }
    }
    for searched in &found.searches.spaces {
        add_row(format!("distinct failures found by search in `{}`", searched.name), &|index| {
            let search = searched.controllers.get(index)?;
            let (all, avoidable) = (search.distinct_count(), search.count(AvoidabilityClass::Avoidable));
            Some(ReportCell::with_verdict(format!("{all} ({avoidable} avoidable)"), all == 0))
        });
    }
    if let Some(everyday) = found.usefulness {
        let [traffic, _] = &everyday.spaces;
        add_row(format!("drives in `{}` with unnecessary braking", traffic.name), &|index| {
            let own = everyday.controllers.get(index)?;
            Some(count_cell(own.unnecessary_braking, own.unanswered_runs()[0], everyday.random_scenarios))
        });
        add_row(format!("drives in `{}` that fall behind", traffic.name), &|index| {
            let own = everyday.controllers.get(index)?;
            Some(count_cell(own.left_behind, own.unanswered_runs()[0], everyday.random_scenarios))
        });
    }
    add_row("accepted certificates about the controller".to_owned(), &|index| {
        let controller = plan.claim_subject(index, plan.config.estimator)?.controller;
        let is_about = |subject: &CertificateSubject| match subject {
            CertificateSubject::Claim(claim) => claim.subject.controller == controller,
            _ => false,
        };
        let accepted = found.proofs.certificates.iter().filter(|one| one.is_accepted() && is_about(&one.subject));
        Some(ReportCell::text(accepted.count()))
    });
    table
}

/// Counts the runs of a controller, without those that a collision of other vehicles ended.
fn count_cases(scenarios: &[ScenarioCases], index: usize) -> Option<ReportCell> {
    let verdicts = scenarios.iter().filter_map(|scenario| scenario.cases.get(index)).map(|case| &case.verdict);
    let (mut runs, mut failures, mut unanswered) = (0, 0, 0);
    for verdict in verdicts.filter(|verdict| verdict.is_conclusive()) {
        runs += 1;
        match verdict.unanswered() {
            Some(_) => unanswered += 1,
            None => failures += u64::from(verdict.is_failure()),
        }
    }
    (runs > 0).then(|| count_cell(failures, unanswered, runs))
}

fn count_cell(failures: u64, unanswered: u64, runs: u64) -> ReportCell {
    let mut text = format!("{failures} of {runs}");
    if unanswered > 0 {
        text += &format!(", no answer in {unanswered}");
    }
    ReportCell::with_verdict(text, failures + unanswered == 0)
}
