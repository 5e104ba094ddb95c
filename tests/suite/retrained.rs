//! The committed retrained policy matches the committed retraining.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crumple_controllers::Controllers;
use crumple_core::digest::{Sha256, sha256};
use crumple_learn::retrain::{Cases, RetrainingReport, TestSetResults, training_preset};
use crumple_sim::control::{ControllerSource, IntoSource};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{PaperDistribution, Scenario, built_in_scenario};
use crumple_spaces::{ScenarioSpace, built_in_space};

fn corpora_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora")
}

fn read_json<T: serde::de::DeserializeOwned>(name: &str) -> T {
    serde_json::from_slice(&fs::read(corpora_folder().join("retraining").join(name)).unwrap())
        .unwrap()
}

fn space() -> ScenarioSpace {
    built_in_space("high-risk").unwrap()
}

fn count_collisions(
    controller: &Arc<dyn ControllerSource>,
    scenarios: &[Scenario],
    estimator: EstimatorKind,
) -> usize {
    let options = RunOptions::new(controller.clone()).with_estimator(estimator);
    let runs: Vec<_> = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()).unwrap())
        .collect();
    let collided = simulate_batch(&runs, RecordingLevel::Summary, |_, result| {
        result.outcome.collision().is_some()
    });
    collided.into_iter().filter(|&collided| collided).count()
}

#[test]
fn the_committed_files_are_those_of_the_report() {
    let report: RetrainingReport = read_json("report.json");
    assert_eq!(sha256(Policy::retrained_bytes()), report.retrained_sha256);
    assert_eq!(
        Policy::reference().digest(),
        report.first_sha256,
        "it was retrained from the reference policy"
    );
    for file in report
        .files
        .iter()
        .filter(|file| file.file != "policy.safetensors")
    {
        assert_eq!(
            sha256(fs::read(corpora_folder().join("retraining").join(&file.file)).unwrap()),
            file.sha256,
            "{}",
            file.file
        );
    }
    let preset = training_preset().unwrap().to_header_value().unwrap();
    let header = Policy::retrained().header().training.clone();
    for (field, value) in preset
        .as_object()
        .unwrap()
        .iter()
        .filter(|(field, _)| *field != "episodes")
    {
        assert_eq!(
            header[field], *value,
            "the committed preset reproduces the committed policy: {field}"
        );
    }
}

#[test]
fn the_cases_match_the_stated_hash() {
    let cases: Cases = read_json("retrained-on.json");
    let mut digest = Sha256::default();
    for case in cases.scenarios(&space().into()).unwrap() {
        digest.update(serde_json::to_string(case.spec()).unwrap());
    }
    assert_eq!(digest.hexadecimal(), cases.scenarios_sha256);
    assert_eq!(
        cases.space_sha256,
        sha256(serde_json::to_string(space().spec()).unwrap())
    );
}

#[test]
fn the_retrained_policy_is_five_times_safer_and_breaks_nothing_of_the_papers() {
    let retrained = Policy::retrained().into_source();
    let paper: Vec<Scenario> = ["paper-1", "paper-2", "paper-3"]
        .map(|name| built_in_scenario(name).unwrap())
        .into();
    for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
        assert_eq!(
            count_collisions(&retrained, &paper, estimator),
            0,
            "{estimator:?}"
        );
    }
    let draws: Vec<_> = (0..1000)
        .map(|index| PaperDistribution { seed: 1 }.draw(index).unwrap())
        .collect();
    assert_eq!(
        count_collisions(&retrained, &draws, EstimatorKind::Kalman),
        0
    );
    // A part of the test set: counts within three standard deviations of the recorded rates.
    let evaluated: TestSetResults = read_json("judged-on.json");
    let space = space();
    let indices: Vec<u64> = evaluated.corpus.indices().take(2000).collect();
    let part: Vec<_> = indices
        .iter()
        .map(|&index| space.draw(evaluated.corpus.seed, index).unwrap())
        .collect();
    let policies = [
        Policy::reference().into_source(),
        Arc::clone(&Policy::retrained()).into_source(),
    ];
    for (policy, tally) in policies.iter().zip(&evaluated.tallies) {
        let rate = tally.collisions as f64 / evaluated.corpus.avoidable as f64;
        let (mean, found) = (
            2000.0 * rate,
            count_collisions(policy, &part, EstimatorKind::Kalman) as f64,
        );
        assert!(
            (found - mean).abs() < 3.0 * (mean * (1.0 - rate)).sqrt() + 1.0,
            "{}: {found} {mean}",
            tally.controller
        );
    }
    let [first, retrained, ..] = evaluated.tallies.as_slice() else {
        panic!("two policies")
    };
    assert!(
        first.collisions > 5 * retrained.collisions,
        "{} {}",
        first.collisions,
        retrained.collisions
    );
}

/// A shield is not learned, but the controller that it guards may be.
#[test]
fn a_shielded_policy_can_be_retrained() {
    let digest = |name: &str| {
        Controllers::default()
            .find(name, Path::new(""))
            .unwrap()
            .policy()
            .map(|policy| policy.digest())
    };
    let reference = Some(Policy::reference().digest());
    for name in [
        "policy",
        "shield:policy",
        "shield,ahead=7.5,gap-error=0:policy",
    ] {
        assert_eq!(digest(name), reference, "{name}");
    }
    for name in ["baseline", "idm", "shield:match-leader", "full-throttle"] {
        assert_eq!(digest(name), None, "{name}");
    }
}
