//! Gates, claims about the subject and tests of suites in JUnit format, for build servers and requirements tools.

use super::claims::{ClaimStatus, Domain, Property, StrengthLevel};
use super::parts::{PlannedSuiteResult, SuiteOutcome};
use super::{AssessmentReport, AssuranceClaim, ClaimRow, GateResult};
use crate::junit::{self, JunitCase, JunitStatus, JunitSuite};
use crate::suite::{describe_min_margins, describe_outcome};

/// Renders gates, claims about the subject and tests of suites as test cases. The claims about other controllers are
/// properties.
pub(super) fn render_junit(assessment: &AssessmentReport) -> String {
    let gates = assessment.summary.gates.iter();
    let mut suites = vec![JunitSuite {
        name: "gates".to_owned(),
        cases: gates.map(|gate| assessment.gate_case(gate)).collect(),
        ..assessment.empty_junit_suite()
    }];
    suites.extend(assessment.claims_suites());
    let results = assessment.results.suites.iter();
    for suite in results.flat_map(|suites| &suites.suites) {
        suites.push(JunitSuite {
            name: suite.content_id.name.clone(),
            cases: suite_cases(suite),
            ..assessment.empty_junit_suite()
        });
    }
    let run_info = assessment.provenance.run_info.as_ref();
    let time_s = run_info.map(|run| run.duration_s);
    junit::render_xml(&assessment.identity.one_line(), time_s, &suites)
}

impl AssessmentReport {
    /// Returns a suite without cases, with the identity of the report as its properties.
    fn empty_junit_suite(&self) -> JunitSuite {
        let rows = self.identity.rows().into_iter();
        JunitSuite {
            timestamp: self.identity.date.clone(),
            properties: rows.map(|(name, value)| (name.to_owned(), value)).collect(),
            ..JunitSuite::default()
        }
    }

    /// Returns a suite for each part of the report with claims, which has the measured time of that part.
    fn claims_suites(&self) -> Vec<JunitSuite> {
        let mut parts: Vec<&str> = Vec::new();
        for row in &self.summary.claims {
            if !parts.contains(&row.part) {
                parts.push(row.part);
            }
        }
        let suites = parts.into_iter().map(|part| self.claims_suite(part));
        suites.collect()
    }

    /// Returns the suite of the claims of a part.
    fn claims_suite(&self, part: &str) -> JunitSuite {
        let mut headings = self.results.parts().into_iter().map(|part| part.heading());
        let heading = headings.find(|heading| heading.anchor == part);
        let title = heading.map_or(part, |heading| heading.title);
        let mut suite = JunitSuite {
            name: format!("claims: {title}"),
            time_s: self.results.part_times.find_s(part),
            ..self.empty_junit_suite()
        };
        let rows = self.summary.claims.iter();
        for row in rows.filter(|row| row.part == part) {
            for (claim, status) in row.claims.iter().zip(&row.statuses) {
                let Some(claim) = claim else {
                    continue;
                };
                let controller = &claim.subject.controller.name;
                if *controller == self.identity.subject {
                    suite.cases.push(self.claim_case(row, claim, status));
                } else {
                    let name = format!("{controller}: {}", row.claim);
                    suite.properties.push((name, status.describe()));
                }
            }
        }
        suite
    }

    fn claim_case(
        &self,
        row: &ClaimRow,
        claim: &AssuranceClaim,
        status: &ClaimStatus,
    ) -> JunitCase {
        let description = status.describe();
        let junit_status = match status.strength.level() {
            StrengthLevel::Proved | StrengthLevel::Bounded | StrengthLevel::Tested => {
                JunitStatus::Passed
            }
            StrengthLevel::Refuted => JunitStatus::Failed,
            StrengthLevel::NotShown | StrengthLevel::NotExamined => JunitStatus::Skipped,
        };
        let is_failure = junit_status == JunitStatus::Failed;
        JunitCase {
            class: junit::join_class(&["crumple", "claims", &claim.subject.controller.name]),
            name: row.claim.clone(),
            file: is_failure.then(|| self.failing_scenario(claim)).flatten(),
            verifier: row.claim.clone(),
            requirements: Vec::new(),
            status: junit_status,
            message: (junit_status != JunitStatus::Passed).then(|| description.clone()),
            output: description,
        }
    }

    fn gate_case(&self, gate: &GateResult) -> JunitCase {
        let file = (!gate.holds).then(|| self.scenario_against(gate)).flatten();
        JunitCase {
            class: "crumple.gates".to_owned(),
            name: gate.gate.clone(),
            file,
            verifier: gate.gate.clone(),
            requirements: gate.requirement.clone(),
            status: if gate.holds {
                JunitStatus::Passed
            } else {
                JunitStatus::Failed
            },
            message: (!gate.holds).then(|| gate.reason.clone()),
            output: gate.reason.clone(),
        }
    }

    /// Returns the file of a scenario that decides against a gate, or that fails against its claim, if the report has
    /// one.
    fn scenario_against(&self, gate: &GateResult) -> Option<String> {
        let file = gate.file.clone();
        file.or_else(|| self.failing_scenario(gate.claim.as_ref()?))
    }

    /// Returns the file of the first scenario that fails against a claim, if the report has one.
    fn failing_scenario(&self, claim: &AssuranceClaim) -> Option<String> {
        if let Some(file) = self.violations.find(claim) {
            return Some(file.to_owned());
        }
        let controller = &claim.subject.controller.name;
        match &claim.domain {
            // A failure that a search found tells nothing about a rate or a comparison.
            Domain::Search { space, .. } | Domain::Space { space }
                if claim.property == Property::NoCollision =>
            {
                let mut spaces = self.results.searches.spaces.iter();
                let searches = spaces.find(|searches| searches.content_id == *space)?;
                let failure = searches.find(controller)?.failures.first()?;
                Some(failure.file.clone())
            }
            Domain::Suite { suite } => {
                let suites = self.results.suites.as_ref()?;
                let mut results = suites.suites.iter();
                let result = results.find(|result| result.content_id == *suite)?;
                let mut outcomes = result.outcomes_of(controller);
                outcomes.find_map(|outcome| Some(outcome.failure?.file.clone()))
            }
            Domain::Scenarios { all, .. } => {
                let files = self.results.file_scenarios.as_ref()?;
                files.failing_file(controller, all)
            }
            _ => None,
        }
    }
}

/// Returns a case for each test and each of its controllers.
fn suite_cases(suite: &PlannedSuiteResult) -> Vec<JunitCase> {
    let name = &suite.content_id.name;
    let controllers = suite.controllers.iter();
    let outcomes = controllers.flat_map(|controller| suite.outcomes_of(controller));
    outcomes.map(|outcome| suite_case(name, outcome)).collect()
}

fn suite_case(suite: &str, outcome: SuiteOutcome<'_>) -> JunitCase {
    let SuiteOutcome { test, tested, .. } = outcome;
    let status = match tested.outcome() {
        Some(true) => JunitStatus::Passed,
        Some(false) if tested.total_unanswered().is_some() => JunitStatus::Error,
        Some(false) => JunitStatus::Failed,
        None => JunitStatus::Skipped,
    };
    JunitCase {
        class: junit::join_class(&["crumple", "suites", suite, &tested.controller]),
        // Converters of requirements tools identify a case by its name and the last part of its class.
        name: format!("{suite} {}: {}", outcome.clause.clause, test.name),
        file: outcome.failure.map(|failure| failure.file.clone()),
        verifier: format!("{suite}: {}", test.name),
        requirements: test.requirement.clone(),
        status,
        message: (status != JunitStatus::Passed).then(|| describe_outcome(tested)),
        output: describe_min_margins(&tested.margins).join("\n"),
    }
}

#[cfg(test)]
mod tests;
