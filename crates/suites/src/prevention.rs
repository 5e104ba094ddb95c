//! Preventability of a collision: whether reference drivers prevent it, as regulations ask, and whether a driver that
//! knows the future could.

use crumple_world::control::{BuiltInController, IntoSource, Role};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Scenario;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::result::TestVerdict;
use super::run::{ControllerSetup, Criterion, PreventabilityCache};
use crumple_search::falsify::counterexample::{Avoidability, AvoidabilityAnalysis};

/// Maximum number of failed points of a test whose avoidability is analysed; these are the first ones.
const MAX_AVOIDABILITY_CHECKS: usize = 3;

/// Behaviour of a reference driver at a point where a controller failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Prevention {
    /// The test passes with the driver.
    Prevents,
    /// The driver brakes and collides.
    Collides,
    /// The driver collides and never brakes: its model does not cover the situation.
    DoesNotReact,
}

/// A reference driver and its behaviour.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReferenceRun {
    /// Name of the driver among the controllers.
    pub driver: String,
    /// Behaviour of the driver.
    pub prevention: Prevention,
}

#[derive(Debug, Clone)]
pub(super) struct Preventability {
    pub(super) references: Vec<ReferenceRun>,
    pub(super) classification: AvoidabilityAnalysis,
}

/// Assesses the preventability of these scenarios of a test, and adds new assessments to `known`.
pub(super) fn assess_preventability(
    criterion: Criterion,
    scenarios: &[&Scenario],
    known: &mut PreventabilityCache,
) -> Vec<Preventability> {
    let name = |scenario: &Scenario| scenario.spec().name.clone();
    let new: Vec<Scenario> = scenarios
        .iter()
        .filter(|scenario| !known.contains_key(&name(scenario)))
        .map(|&one| one.clone())
        .collect();
    let references = run_references(criterion, &new);
    for (index, scenario) in new.iter().enumerate() {
        let references = references
            .iter()
            .filter_map(|all| all.get(index).cloned())
            .collect();
        known.insert(
            name(scenario),
            Preventability {
                references,
                classification: AvoidabilityAnalysis::default(),
            },
        );
    }
    let is_open = |scenario: &&&Scenario| {
        known
            .get(&name(scenario))
            .is_some_and(|known| known.classification.avoidability == Avoidability::NotAsked)
    };
    let asked: Vec<_> = scenarios
        .iter()
        .take(MAX_AVOIDABILITY_CHECKS)
        .filter(is_open)
        .collect();
    let answers: Vec<_> = asked
        .par_iter()
        .map(|scenario| {
            (
                name(scenario),
                AvoidabilityAnalysis::classify_contact(scenario),
            )
        })
        .collect();
    for (name, answer) in answers {
        if let Some(known) = known.get_mut(&name) {
            known.classification = answer;
        }
    }
    // Drop answers that were computed for another controller: a result must not depend on which controllers run
    // together.
    let told = scenarios
        .iter()
        .enumerate()
        .filter_map(|(index, scenario)| {
            let mut prevented = known.get(&name(scenario))?.clone();
            if index >= MAX_AVOIDABILITY_CHECKS {
                prevented.classification = AvoidabilityAnalysis::default();
            }
            Some(prevented)
        });
    told.collect()
}

fn run_references(criterion: Criterion, scenarios: &[Scenario]) -> Vec<Vec<ReferenceRun>> {
    let drivers = BuiltInController::all()
        .into_iter()
        .filter(|spec| spec.role() == Role::Reference);
    let runs = drivers.map(|spec| {
        let driver = spec.name();
        let controller = spec.into_source();
        let seen = ControllerSetup {
            controller: &controller,
            estimator: EstimatorKind::Truth,
        }
        .run_scenarios(criterion, scenarios);
        let prevention = |seen: super::run::RunResult| match seen.verdict {
            TestVerdict::Passed => Prevention::Prevents,
            _ if seen.max_brake_mps2 > 0.0 => Prevention::Collides,
            _ => Prevention::DoesNotReact,
        };
        seen.into_iter()
            .map(|seen| ReferenceRun {
                driver: driver.to_owned(),
                prevention: prevention(seen),
            })
            .collect()
    });
    runs.collect()
}
