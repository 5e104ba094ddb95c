//! The policy `corpora/policy/road.safetensors` matches the preset `road`, and is useful.

use std::path::Path;
use std::sync::Arc;

use crumple_learn::rl::{LrDecay, TrainingConfig};
use crumple_world::control::ControllerSpec;
use crumple_world::measure::UsefulnessMeasures;
use crumple_world::observation::EstimatorKind;
use crumple_world::policy::Policy;
use crumple_world::scenario::space::built_in_space;
use crumple_world::scenario::{Scenario, built_in_scenario};
use crumple_world::sim::{ControllerKind, RecordingLevel, Run, RunOptions, simulate_batch};

fn road_policy() -> Arc<Policy> {
    Arc::new(Policy::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/policy/road.safetensors")).unwrap())
}

#[test]
fn the_preset_is_that_of_the_policy() {
    let policy = road_policy();
    let preset = TrainingConfig::preset("road").unwrap();
    let mut training = policy.header().training.clone();
    let spaces = training.as_object_mut().unwrap().remove("scenarios").unwrap();
    assert_eq!(training, serde_json::to_value(&preset).unwrap());
    assert_eq!(Some(spaces.as_str().unwrap().to_owned()), preset.scenario_source().unwrap().identity().unwrap());
    assert_eq!(policy.header().observation, preset.environment.observation.scaling());
}

/// The configurations of the front in `reports/training.md` are valid, and equal the preset except for the stated
/// changes.
#[test]
fn trained_policies_have_configurations() {
    let road = TrainingConfig::preset("road").unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/training");
    let mut names = Vec::new();
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    for path in files.filter(|path| path.is_file()) {
        let config = TrainingConfig::parse(&std::fs::read_to_string(&path).unwrap(), &path).unwrap();
        assert_eq!(Some(config.name.as_str()), path.file_stem().and_then(|stem| stem.to_str()));
        if config.name == "paper-net-to-the-end" {
            let mut preset = TrainingConfig::preset("paper-net").unwrap();
            (preset.name, preset.episodes, preset.evaluation.master_gap_m) = (config.name.clone(), 400, 0.0);
            assert_eq!(config, preset);
            continue;
        }
        // The evaluated weights may be averaged; the evaluation is the same.
        let mut evaluated = config.evaluation.clone();
        evaluated.weight_average_updates = 0;
        assert_eq!((&config.network, &config.td3, &evaluated), (&road.network, &road.td3, &road.evaluation));
        assert_ne!(config, road);
        names.push(config.name);
    }
    assert_eq!(names.len(), 8, "{names:?}");
}

/// The further experiments in `reports/training.md` match their rows.
#[test]
fn each_tried_variant_has_a_configuration() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/training");
    let read = |path: &Path| TrainingConfig::parse(&std::fs::read_to_string(path).unwrap(), path).unwrap();
    let [looking_back, smooth] = ["looking-back.toml", "smooth.toml"].map(|name| read(&folder.join(name)));
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder.join("tried")).unwrap() {
        let path = entry.unwrap().path();
        let config = read(&path);
        assert_eq!(Some(config.name.as_str()), path.file_stem().and_then(|stem| stem.to_str()));
        let mut expected = match config.name.split_once('-') {
            Some(("looking", _)) => looking_back.clone(),
            Some(("smooth", _)) => smooth.clone(),
            _ => TrainingConfig::preset("road").unwrap(),
        };
        let falls = |until_episode, to_share| Some(LrDecay { until_episode, final_factor: to_share });
        let TrainingConfig { environment, learning, evaluation, episodes, .. } = &mut expected;
        match config.name.as_str() {
            "longer" => *episodes = 4000,
            "mean-of-weights" => evaluation.weight_average_updates = 10_000,
            "four-decisions" => (*episodes, environment.observation.history) = (750, 4),
            "falling" => learning.lr_decay = falls(1000, 0.1),
            "falling-privileged" => (learning.lr_decay, learning.privileged_critic) = (falls(1000, 0.1), true),
            "falling-slow" => {
                (*episodes, learning.lr_decay, learning.privileged_critic) = (750, falls(1000, 0.1), true);
                environment.residual_over.as_mut().unwrap().rate_per_s = 10.0;
            }
            "looking-back-jerk" => (*episodes, environment.costs.jerk) = (1300, 3.0),
            "looking-back-mean" => {
                (environment.costs.jerk, evaluation.weight_average_updates) = (1.5, 5000);
                learning.lr_decay = falls(700, 0.05);
            }
            "smooth-60" => (*episodes, learning.smoothness_penalty) = (600, 60.0),
            "smooth-6" => (*episodes, learning.smoothness_penalty) = (450, 6.0),
            "smooth-needless" => {
                (*episodes, learning.smoothness_penalty, environment.costs.unnecessary_braking) = (525, 15.0, 1.0);
            }
            other => panic!("{other}"),
        }
        expected.name.clone_from(&config.name);
        assert_eq!(config, expected);
        names.push(config.name);
    }
    assert_eq!(names.len(), 11, "{names:?}");
}

/// All links exist, and no configuration of an experiment is unused.
#[test]
fn the_report_links_to_the_configurations_of_its_tables() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let report = std::fs::read_to_string(root.join("reports/training.md")).unwrap();
    let links = report.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let links: Vec<_> = links.filter(|link| !link.starts_with("http")).collect();
    for link in &links {
        let path = link.split('#').next().unwrap();
        assert!(path.is_empty() || root.join("reports").join(path).exists(), "{link}");
    }
    for folder in ["ablation", "tried"] {
        for entry in std::fs::read_dir(root.join("corpora/training").join(folder)).unwrap() {
            let file = format!("../corpora/training/{folder}/{}", entry.unwrap().file_name().to_str().unwrap());
            assert!(links.contains(&file.as_str()), "{file}");
        }
    }
}

/// Each ablation in `reports/training.md` changes one setting of the paper.
#[test]
fn an_ablation_changes_one_thing() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/training/ablation");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let config = TrainingConfig::parse(&std::fs::read_to_string(&path).unwrap(), &path).unwrap();
        let mut literal = TrainingConfig::preset("paper").unwrap();
        (literal.name, literal.episodes) = (config.name.clone(), 200);
        match config.name.as_str() {
            "penalty" => literal.learning.saturation_penalty = config.learning.saturation_penalty,
            "reward-scale" => literal.environment.reward_scale = config.environment.reward_scale,
            "first-weights" => literal.network.final_layer_bound = config.network.final_layer_bound,
            "rates" => {
                let fast = TrainingConfig::preset("fast").unwrap().learning;
                (literal.learning.actor_rate, literal.learning.critic_rate) = (fast.actor_rate, fast.critic_rate);
            }
            // The discount per second stays the same.
            "interval" => (literal.environment.action_repeat, literal.learning.discount) = (10, 0.9999),
            other => panic!("{other}"),
        }
        assert_eq!(config, literal);
        names.push(config.name);
    }
    assert_eq!(names.len(), 5, "{names:?}");
}

fn simulate_all(
    controller: impl Into<ControllerKind>,
    scenarios: &[Scenario],
    estimator: EstimatorKind,
) -> Vec<(bool, Option<UsefulnessMeasures>)> {
    let options = RunOptions::new(controller).with_estimator(estimator);
    let runs: Vec<_> = scenarios.iter().map(|scenario| Run::new(scenario, options.clone()).unwrap()).collect();
    simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
        let useful = result.trace.as_ref().and_then(|trace| UsefulnessMeasures::from_trace(trace, &result.impacts, 1));
        (result.outcome.contact().is_some(), useful)
    })
}

#[test]
fn it_is_safe_in_the_papers_task() {
    let paper = ["paper-1", "paper-2", "paper-3"].map(|name| built_in_scenario(name).unwrap());
    for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
        assert!(simulate_all(road_policy(), &paper, estimator).iter().all(|(collided, _)| !collided), "{estimator:?}");
    }
}

/// In traffic that no training or selection used, it avoids every collision, falls behind in no drive, brakes hard and
/// unnecessarily in at most 1 of 100 drives, and is about as comfortable as `idm`: at most 10 % more acceleration and
/// twice the jerk.
#[test]
fn it_is_useful_in_traffic() {
    let traffic = built_in_space("traffic").unwrap();
    let draws: Vec<_> = (0..200).map(|index| traffic.draw(0x726f_6164, index).unwrap()).collect();
    let mut squares = [[0.0; 2]; 2];
    let both = [ControllerKind::from(road_policy()), ControllerSpec::from_name("idm").unwrap().into()];
    for (controller, sums) in both.into_iter().zip(&mut squares) {
        let mut hard = 0;
        for (collided, useful) in simulate_all(controller, &draws, EstimatorKind::Kalman) {
            let useful = useful.unwrap();
            assert!(!collided && !useful.following.unwrap().fell_behind, "{useful:?}");
            hard += u32::from(!useful.hard.is_empty());
            sums[0] += useful.rms_acceleration_mps2.unwrap().powi(2);
            sums[1] += useful.rms_jerk_mps3.unwrap().powi(2);
        }
        assert!(hard <= 2, "{hard} of 200");
    }
    let [acceleration, jerk] = [0, 1].map(|of| (squares[0][of] / squares[1][of]).sqrt());
    assert!(acceleration < 1.1 && jerk < 2.0, "{acceleration} and {jerk} times those of idm");
}
