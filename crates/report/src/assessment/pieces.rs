//! The evidence of a plan, piece by piece: what can be gathered by itself, wherever, and is not gathered again by the assessment.
//!
//! What is not kept in the store, such as runs of single scenarios, is no piece. A new kind of evidence has to be a piece here, too.

use super::best::CertifiedBest;
use super::parts::{
    Distribution, FailureMaps, PaperScenarios, RulePlan, Search, Traffic, Usefulness, WorstProfile, WorstProfiles,
    count_one, counted_names, run_suite,
};
use super::plan::NamedSpace;
use super::planned_suite::PlannedSuite;
use super::work::Work;
use super::{AssessError, AssessmentPlan};
use crumple_core::digest::sha256;
use crumple_world::scenario::Scenario;
use crumple_world::sim::NamedController;

/// A piece of evidence that can be gathered by itself.
pub(super) enum Piece<'p> {
    /// The best that a driver can do in a scenario of the paper.
    Best(Box<Scenario>),
    Distribution(&'p NamedSpace),
    /// Of the scenarios from files, those that are shown.
    Traffic,
    Search(&'p NamedSpace, usize, &'p NamedController),
    Worst(&'p NamedController),
    Maps,
    Usefulness,
    Counted(String),
    Rule(RulePlan<'p>),
    Suite(&'p PlannedSuite),
}

/// All of a plan, in an order that scatters what takes long.
pub(super) fn pieces(plan: &AssessmentPlan) -> Result<Vec<Piece<'_>>, AssessError> {
    let mut all: Vec<Piece<'_>> =
        PaperScenarios::scenarios(plan)?.into_iter().map(|scenario| Piece::Best(Box::new(scenario))).collect();
    all.extend(plan.distributions.iter().map(Piece::Distribution));
    all.extend((!plan.traffic.is_empty()).then_some(Piece::Traffic));
    for space in &plan.spaces {
        all.extend(plan.controllers.iter().enumerate().map(|(index, one)| Piece::Search(space, index, one)));
    }
    if WorstProfiles::scenario(plan)?.is_some() {
        all.extend(plan.controllers.iter().map(Piece::Worst));
    }
    all.extend(plan.config.paper.then_some(Piece::Maps));
    all.extend((plan.config.everyday_draws > 0).then_some(Piece::Usefulness));
    all.extend(counted_names(plan).into_iter().map(Piece::Counted));
    all.extend(RulePlan::all(plan).map(Piece::Rule));
    all.extend(plan.suites.iter().map(Piece::Suite));
    all.sort_by_cached_key(|piece| sha256(piece.name()));
    Ok(all)
}

impl Piece<'_> {
    /// For readers; one of a kind in a plan.
    pub(super) fn name(&self) -> String {
        match self {
            Self::Best(scenario) => format!("best of {}", scenario.spec().name),
            Self::Distribution(named) => format!("draws of {}", named.name),
            Self::Traffic => "scenarios from files".to_owned(),
            Self::Search(named, _, controller) => format!("search {} in {}", controller.name, named.name),
            Self::Worst(controller) => format!("worst profile against {}", controller.name),
            Self::Maps => "failure maps".to_owned(),
            Self::Usefulness => "usefulness".to_owned(),
            Self::Counted(name) => format!("count {name}"),
            Self::Rule(searched) => searched.name(),
            Self::Suite(planned) => format!("suite {}", planned.known.name),
        }
    }

    /// Has it kept.
    pub(super) fn gather(&self, plan: &AssessmentPlan, work: &Work<'_>) -> Result<(), AssessError> {
        match self {
            Self::Best(scenario) => Ok(CertifiedBest::kept(scenario, work).map(drop)?),
            Self::Distribution(named) => Distribution::gather(plan, named, work).map(drop),
            Self::Traffic => Traffic::gather(plan, work).map(drop),
            Self::Search(named, index, controller) => Search::gather(plan, named, (*index, controller), work).map(drop),
            Self::Worst(controller) => match WorstProfiles::scenario(plan)? {
                Some((scenario, envelope)) => {
                    WorstProfile::gather(plan, (&scenario, envelope), controller, work).map(drop)
                }
                None => Ok(()),
            },
            Self::Maps => FailureMaps::gather(plan, work).map(drop),
            Self::Usefulness => Usefulness::gather(plan, work).map(drop),
            Self::Counted(name) => count_one(plan, name, work),
            Self::Rule(searched) => searched.gather(plan, work).map(drop),
            Self::Suite(planned) => run_suite(plan, planned, work).map(drop),
        }
    }
}
