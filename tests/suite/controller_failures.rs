//! Controllers that give no usable answer: the run ends there, in both engines alike, and every claim counts it.

use std::sync::Arc;

use crumple_core::observer::Quiet;
use crumple_evidence::{InvalidRate, RateConfig, RatePlan};
use crumple_measure::Specification;
use crumple_report::assessment::{
    AssessConfig, AssessmentPlan, CaseVerdict, EvidenceCache, assess,
};
use crumple_search::falsify::campaign::Campaign;
use crumple_sim::control::{
    Controller, ControllerFailure, ControllerSource, Ego, IntoSource, RequiredNeighbours,
    ShieldSettings,
};
use crumple_sim::engine::{
    FailedController, NamedController, Outcome, RecordingLevel, Run, RunError, RunOptions,
    ShieldedSource, simulate, simulate_batch,
};
use crumple_sim::observation::{EstimatorKind, Observation};
use crumple_sim::scenario::{Driver, Scenario, built_in_scenario};
use crumple_spaces::{ScenarioSpace, built_in_space};
use crumple_store::study::Study;
use proptest::prelude::*;

use crate::generate::with_cases;

/// A controller that accelerates mildly, and fails at answer `fails_at`: with an error, or with a non-finite number.
#[derive(Clone)]
struct FailingController {
    fails_at: usize,
    answer: Result<f64, ControllerFailure>,
    needs: RequiredNeighbours,
    identity: Option<&'static str>,
    answered: usize,
}

impl FailingController {
    fn new(fails_at: usize, answer: Result<f64, ControllerFailure>) -> Self {
        Self {
            fails_at,
            answer,
            needs: RequiredNeighbours::Nothing,
            identity: Some("failing"),
            answered: 0,
        }
    }

    fn into_kind(self) -> Arc<dyn ControllerSource> {
        Arc::new(self).into_source()
    }

    fn into_named(self) -> NamedController {
        NamedController::from_source("failing", Arc::new(self))
    }
}

impl ControllerSource for FailingController {
    fn identity(&self) -> Option<String> {
        self.identity.map(str::to_owned)
    }

    fn required_neighbours(&self) -> RequiredNeighbours {
        self.needs
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        match (&self.answer, self.fails_at) {
            (Err(failure), 0) => Err(failure.clone()),
            _ => Ok(Box::new(self.clone())),
        }
    }
}

impl Controller for FailingController {
    fn decide(&mut self, _seen: &Observation) -> Result<f64, ControllerFailure> {
        self.answered += 1;
        if self.answered > self.fails_at {
            self.answer.clone()
        } else {
            Ok(0.2)
        }
    }
}

fn died_failure() -> ControllerFailure {
    ControllerFailure::Died {
        message: "no longer there".to_owned(),
    }
}

fn all_under_test_scenario() -> Scenario {
    let edited = built_in_scenario("paper-2")
        .unwrap()
        .edited(|spec| spec.vehicles[2].driver = Driver::UnderTest);
    edited.unwrap()
}

proptest! {
    #![proptest_config(with_cases(64))]

    /// Both engines give one outcome and one trace, which end at the instant of the failed decision, in batches too.
    #[test]
    fn both_engines_end_the_run_at_the_same_instant(
        fails_at in prop::collection::vec(0..1200_usize, 1..9),
        answer in prop_oneof![Just(Ok(f64::NAN)), Just(Ok(f64::NEG_INFINITY)), Just(Err(died_failure()))],
        estimator in prop_oneof![Just(EstimatorKind::Truth), Just(EstimatorKind::Kalman)],
        after_collision in crate::generate::any_after_collision(),
        shielded in any::<bool>(),
    ) {
        let scenario = all_under_test_scenario();
        let kind = |&fails_at: &usize| {
            let controller = FailingController::new(fails_at, answer.clone()).into_kind();
            let settings = ShieldSettings::default();
            if shielded { ShieldedSource { controller, settings: settings.into() }.into_source() } else { controller }
        };
        let runs: Vec<_> = fails_at
            .iter()
            .map(|fails_at| {
                let options = RunOptions::new(kind(fails_at)).with_estimator(estimator);
                Run::new(&scenario, options.with_after_collision(after_collision)).unwrap()
            })
            .collect();
        let together = simulate_batch(&runs, RecordingLevel::Trace, |_, result| result);
        for ((run, result), &fails_at) in runs.iter().zip(together).zip(&fails_at) {
            prop_assert_eq!(&simulate(run, RecordingLevel::Trace), &result);
            let trace = result.trace.as_ref().unwrap();
            let end_s = *trace.time_s.last().unwrap();
            match &result.outcome {
                Outcome::ControllerFailed(FailedController { time_s, vehicle, failure }) => {
                    prop_assert_eq!((*time_s, *vehicle), (end_s, 1));
                    prop_assert!((end_s - fails_at as f64 * 0.01).abs() < 1e-9, "{} {}", end_s, fails_at);
                    prop_assert_eq!(failure, &answer.clone().err().unwrap_or(ControllerFailure::NotFinite));
                }
                Outcome::Collision(collision) => prop_assert!(collision.time_s <= fails_at as f64 * 0.01),
                Outcome::NoCollision => prop_assert!(fails_at as f64 * 0.01 >= scenario.spec().duration_s),
            }
            prop_assert!(trace.time_s.is_sorted_by(|before, after| before < after));
        }
    }
}

#[test]
fn a_controller_is_not_put_where_the_neighbour_it_needs_is_missing() {
    let scenario = all_under_test_scenario();
    for (needs, missing) in [
        (RequiredNeighbours::Nothing, None),
        (RequiredNeighbours::Ahead, None),
        (RequiredNeighbours::AheadAndBehind, Some("behind")),
    ] {
        let refused = Run::new(
            &scenario,
            RunOptions::new(
                FailingController {
                    needs,
                    ..FailingController::new(9, Ok(0.0))
                }
                .into_kind(),
            ),
        )
        .err();
        assert_eq!(
            refused,
            missing.map(|missing| RunError::MissingNeighbour {
                vehicle: 2,
                missing
            })
        );
    }
}

#[test]
fn every_specification_is_violated_at_its_worst() {
    let scenario = all_under_test_scenario();
    let options = RunOptions::new(FailingController::new(100, Err(died_failure())).into_kind());
    for text in [Specification::NO_COLLISION, "always v1.speed_mps >= 0"] {
        let specification = Specification::parse(text, &scenario).unwrap();
        let verdict = specification
            .evaluate_scenario(&scenario, options.clone())
            .unwrap();
        assert_eq!(
            (verdict.robustness, verdict.failure),
            (f64::NEG_INFINITY, Some((1.0, 1))),
            "{text}"
        );
    }
}

fn paper_space() -> ScenarioSpace {
    built_in_space("paper").unwrap()
}

fn rate_plan(controller: NamedController) -> Result<RatePlan, InvalidRate> {
    RatePlan::new(RateConfig {
        seed: 1,
        estimator: EstimatorKind::Truth,
        ..RateConfig::new(controller, paper_space(), 50)
    })
}

#[test]
fn a_rate_counts_and_reports_controller_failures() {
    let plan = rate_plan(FailingController::new(10, Err(died_failure())).into_named()).unwrap();
    let mut tally = plan.empty_tally();
    plan.count_batch(&mut tally).unwrap();
    assert_eq!((tally.runs, tally.failures), (50, 50));
    let configuration = &plan.registration().configuration;
    assert_eq!(
        configuration["failure"],
        "vehicles touch, or a controller fails"
    );
    assert_eq!(configuration["controller_sha256"], "failing");
    let unknown = FailingController {
        identity: None,
        ..FailingController::new(10, Err(died_failure()))
    }
    .into_named();
    assert!(
        matches!(rate_plan(unknown), Err(InvalidRate::NoIdentity { controller }) if controller == "failing")
    );
}

fn campaign(controller: NamedController) -> Campaign {
    Campaign {
        estimator: EstimatorKind::Truth,
        ..Campaign::new(controller, paper_space()).with_budget(30)
    }
}

#[test]
fn a_campaign_finds_it_keeps_it_and_goes_on_by_identity() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("campaign");
    let own = campaign(FailingController::new(10, Err(died_failure())).into_named());
    let summary = own.run(&out, false, &Quiet).unwrap();
    assert!(summary.falsified);
    let counterexample = &summary.counterexamples[0];
    assert_eq!(counterexample.kind, "the controller of vehicle 1 fails");
    assert_eq!(
        (counterexample.robustness, counterexample.collision_time_s),
        (f64::NEG_INFINITY, None)
    );
    assert!(
        counterexample.file.ends_with("01-controller-1-fails.toml")
            && out.join(&counterexample.file).exists(),
        "{}",
        counterexample.file
    );
    let again = own.run(&out, true, &Quiet).unwrap();
    assert_eq!(again.to_json().unwrap(), summary.to_json().unwrap());
    let other = FailingController {
        identity: Some("other"),
        ..FailingController::new(10, Err(died_failure()))
    }
    .into_named();
    let refused = campaign(other)
        .run(&out, true, &Quiet)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("the campaign there has a different configuration"),
        "{refused}"
    );
    let unknown = FailingController {
        identity: None,
        ..FailingController::new(10, Err(died_failure()))
    }
    .into_named();
    let refused = campaign(unknown)
        .run(&out, true, &Quiet)
        .unwrap_err()
        .to_string();
    assert!(
        refused.starts_with(
            "the controller `failing` states no identity, so its campaign cannot be resumed"
        ),
        "{refused}"
    );
}

#[test]
fn an_assessment_names_the_failed_controller_and_the_time() {
    let mut config = AssessConfig::default();
    // The other controller avoids collisions: classifying each collision would take most of the time.
    config.controllers = vec!["idm".to_owned()];
    config.gates.clear();
    (
        config.draws,
        config.search.budget,
        config.rates.runs,
        config.everyday_draws,
    ) = (20, 5, 0, 0);
    (config.search.spaces, config.certificates) =
        (Some(vec!["paper".to_owned()]), Some(Vec::new()));
    config.distributions = Some(vec!["paper".to_owned()]);
    let own = [FailingController::new(100, Ok(f64::NAN)).into_named()];
    let plan = AssessmentPlan::new(config, own, std::path::Path::new("")).unwrap();
    let assessment = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap();
    let case = &assessment
        .results
        .paper_scenarios
        .as_ref()
        .unwrap()
        .scenarios[0]
        .cases[1];
    assert!(
        matches!(
            &case.verdict,
            CaseVerdict::ControllerFailed { vehicle: 1, .. }
        ),
        "{:?}",
        case.verdict
    );
    assert!(
        assessment
            .to_markdown()
            .contains("controller of 1 failed at 1.00 s: it answered with a number")
    );
    let drawn = assessment.results.rate_spaces.spaces[0]
        .controllers
        .iter()
        .find(|drawn| drawn.controller == "failing")
        .unwrap();
    assert_eq!(
        (drawn.ends.collisions, drawn.ends.failures()),
        (0, 20),
        "all runs fail without a collision"
    );
    assert_eq!(drawn.mean_impact_speed_mps, None);
}
