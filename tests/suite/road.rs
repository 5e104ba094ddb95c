//! The policy `corpora/policy/road.safetensors` is one of the preset `road`, and of use.

use std::path::Path;
use std::sync::Arc;

use crumple_learn::rl::TrainingConfig;
use crumple_world::measure::Usefulness;
use crumple_world::observation::EstimatorKind;
use crumple_world::policy::Policy;
use crumple_world::scenario::space::built_in_space;
use crumple_world::scenario::{Scenario, built_in};
use crumple_world::sim::{RecordingLevel, Run, RunOptions, simulate_batch};

fn policy() -> Arc<Policy> {
    Arc::new(Policy::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/policy/road.safetensors")).unwrap())
}

#[test]
fn the_preset_is_that_of_the_policy() {
    let policy = policy();
    let preset = TrainingConfig::preset("road").unwrap();
    let mut training = policy.header().training.clone();
    let spaces = training.as_object_mut().unwrap().remove("scenarios").unwrap();
    assert_eq!(training, serde_json::to_value(&preset).unwrap());
    assert_eq!(Some(spaces.as_str().unwrap().to_owned()), preset.source().unwrap().identity().unwrap());
    assert_eq!(policy.header().observation, preset.environment.observation.scaling());
}

/// In draws that no training and no selection saw it touches nobody in the paper's scenarios and in traffic, and follows there as
/// a driver would.
#[test]
fn it_is_safe_in_the_papers_task_and_of_use_in_traffic() {
    let policy = policy();
    let drive = |scenarios: &[Scenario], estimator| -> Vec<(bool, Option<Usefulness>)> {
        let options = RunOptions::new(Arc::clone(&policy)).with_estimator(estimator);
        let runs: Vec<_> = scenarios.iter().map(|scenario| Run::new(scenario, options.clone()).unwrap()).collect();
        simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
            let useful = result.trace.as_ref().and_then(|trace| Usefulness::of(trace, &result.impacts, 1));
            (result.outcome.contact().is_some(), useful)
        })
    };
    let paper = ["paper-1", "paper-2", "paper-3"].map(|name| built_in(name).unwrap());
    for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
        assert!(drive(&paper, estimator).iter().all(|(touched, _)| !touched), "{estimator:?}");
    }
    let traffic = built_in_space("traffic").unwrap();
    let draws: Vec<_> = (0..60).map(|index| traffic.draw(0x726f_6164, index).unwrap()).collect();
    for (touched, useful) in drive(&draws, EstimatorKind::Kalman) {
        let useful = useful.unwrap();
        assert!(!touched && useful.hard.is_none() && !useful.following.unwrap().left_behind, "{useful:?}");
    }
}
