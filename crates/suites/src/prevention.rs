//! Preventability of a collision: whether reference drivers prevent it, as regulations ask, and whether a driver that
//! knows the future could.

use crumple_sim::control::{BuiltInController, IntoSource, Role};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::result::TestVerdict;
use super::run::{ControllerSetup, Criterion, PreventabilityCache};
use super::scenario::PointRun;
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

#[derive(Debug, Clone, Default)]
pub(super) struct Preventability {
    pub(super) references: Vec<ReferenceRun>,
    pub(super) classification: AvoidabilityAnalysis,
}

/// Assesses the preventability of these points of a test, and adds new assessments to the cache.
pub(super) fn assess_preventability(
    criterion: Criterion,
    runs: &[&PointRun],
    cache: &mut PreventabilityCache,
) -> Vec<Preventability> {
    add_references(criterion, runs, cache);
    let analysed = runs.iter().take(MAX_AVOIDABILITY_CHECKS);
    add_avoidability(analysed.map(|run| &run.scenario), cache);
    // Drop analyses that were made for another controller: a result must not depend on which controllers run
    // together.
    runs.iter()
        .enumerate()
        .filter_map(|(index, run)| {
            let mut preventability = cache.get(&run.scenario.spec().name)?.clone();
            if index >= MAX_AVOIDABILITY_CHECKS {
                preventability.classification = AvoidabilityAnalysis::default();
            }
            Some(preventability)
        })
        .collect()
}

/// Runs the reference drivers, alone in the vehicle, at the points that the cache lacks.
fn add_references(criterion: Criterion, runs: &[&PointRun], cache: &mut PreventabilityCache) {
    let new: Vec<PointRun> = runs
        .iter()
        .filter(|run| !cache.contains_key(&run.scenario.spec().name))
        .map(|&run| PointRun {
            test_driver: None,
            ..run.clone()
        })
        .collect();
    let runs_by_driver = run_references(criterion, &new);
    for (index, run) in new.iter().enumerate() {
        let references = runs_by_driver
            .iter()
            .filter_map(|runs| runs.get(index).cloned())
            .collect();
        cache.insert(
            run.scenario.spec().name.clone(),
            Preventability {
                references,
                classification: AvoidabilityAnalysis::default(),
            },
        );
    }
}

/// Analyses the avoidability of the scenarios for which the cache lacks it.
fn add_avoidability<'s>(
    scenarios: impl Iterator<Item = &'s Scenario>,
    cache: &mut PreventabilityCache,
) {
    let new: Vec<&Scenario> = scenarios
        .filter(|scenario| {
            cache
                .get(&scenario.spec().name)
                .is_some_and(|cached| cached.classification.avoidability == Avoidability::NotAsked)
        })
        .collect();
    let analyses: Vec<_> = new
        .par_iter()
        .map(|scenario| AvoidabilityAnalysis::classify_collision(scenario))
        .collect();
    for (scenario, analysis) in new.into_iter().zip(analyses) {
        if let Some(cached) = cache.get_mut(&scenario.spec().name) {
            cached.classification = analysis;
        }
    }
}

/// Runs each reference driver at each point; the outer index is that of the driver.
fn run_references(criterion: Criterion, points: &[PointRun]) -> Vec<Vec<ReferenceRun>> {
    let drivers = BuiltInController::all()
        .into_iter()
        .filter(|spec| spec.role() == Role::Reference);
    let runs = drivers.map(|spec| {
        let driver = spec.name();
        let controller = spec.into_source();
        let setup = ControllerSetup {
            controller: &controller,
            estimator: EstimatorKind::Truth,
            seeds: 1,
        };
        setup
            .run_points(criterion, points)
            .into_iter()
            .map(|result| ReferenceRun {
                driver: driver.to_owned(),
                prevention: match result.verdict {
                    TestVerdict::Passed => Prevention::Prevents,
                    _ if result.max_brake_mps2 > 0.0 => Prevention::Collides,
                    _ => Prevention::DoesNotReact,
                },
            })
            .collect()
    });
    runs.collect()
}
