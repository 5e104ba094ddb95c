//! The evidence of a plan as tasks that can run alone, on any machine. The assessment then does not gather it again.
//!
//! Runs of single scenarios are not cached, so they are no tasks. A new kind of evidence needs a task here.

use super::avoidance::CertifiedAvoidance;
use super::gather_context::GatherContext;
use super::parts::{
    FailureMaps, FailureSearch, FileScenarios, PaperScenarios, SpaceSample, SpecificationSearchPlan, UsefulnessReport,
    WorstProfile, WorstProfiles, planned_rate_counts, run_suite,
};
use super::{AssessError, AssessmentPlan};
use crumple_core::digest::sha256;

type GatherFn<'p> = Box<dyn Fn(&GatherContext<'_>) -> Result<(), AssessError> + 'p>;

pub(super) struct EvidenceTask<'p> {
    /// Name, unique in a plan.
    pub(super) name: String,
    gather: GatherFn<'p>,
}

impl EvidenceTask<'_> {
    pub(super) fn gather(&self, work: &GatherContext<'_>) -> Result<(), AssessError> {
        (self.gather)(work)
    }
}

/// Returns all tasks of a plan, in an order that scatters the slow ones.
pub(super) fn evidence_tasks<'p>(plan: &'p AssessmentPlan) -> Result<Vec<EvidenceTask<'p>>, AssessError> {
    let mut all: Vec<EvidenceTask<'p>> = Vec::new();
    let mut add = |name: String, gather: GatherFn<'p>| {
        all.push(EvidenceTask { name, gather });
    };
    for scenario in PaperScenarios::scenarios(plan)? {
        let name = format!("best of {}", scenario.spec().name);
        add(name, Box::new(move |work| Ok(CertifiedAvoidance::load_or_compute(&scenario, work).map(drop)?)));
    }
    for named in &plan.rate_spaces {
        add(format!("draws of {}", named.name), Box::new(move |work| SpaceSample::gather(named, work).map(drop)));
    }
    if !plan.file_scenarios.is_empty() {
        add("scenarios from files".to_owned(), Box::new(move |work| FileScenarios::gather(work).map(drop)));
    }
    for named in &plan.search_spaces {
        for one in plan.controllers.iter().enumerate() {
            let name = format!("search {} in {}", one.1.name, named.name);
            add(name, Box::new(move |work| FailureSearch::gather(named, one, work).map(drop)));
        }
    }
    if let Some((scenario, envelope)) = WorstProfiles::scenario(plan)? {
        for controller in &plan.controllers {
            let (name, scenario) = (format!("worst profile against {}", controller.name), scenario.clone());
            let gather =
                move |work: &GatherContext<'_>| WorstProfile::gather((&scenario, envelope), controller, work).map(drop);
            add(name, Box::new(gather));
        }
    }
    if plan.config.paper {
        add("failure maps".to_owned(), Box::new(move |work| FailureMaps::gather(work).map(drop)));
    }
    if plan.config.everyday_draws > 0 {
        add("usefulness".to_owned(), Box::new(move |work| UsefulnessReport::gather(work).map(drop)));
    }
    for counted in planned_rate_counts(plan) {
        let name = format!("count {}", counted.name);
        add(name, Box::new(move |work| counted.clone().gather(work).map(drop)));
    }
    for searched in SpecificationSearchPlan::from_plan(plan) {
        add(searched.name(), Box::new(move |work| searched.gather(work).map(drop)));
    }
    for planned in &plan.suites {
        let name = format!("suite {}", planned.content_id.name);
        add(name, Box::new(move |work| run_suite(planned, work).map(drop)));
    }
    all.sort_by_cached_key(|piece| sha256(&piece.name));
    Ok(all)
}
