//! The policy `road` is that of its preset, safe and useful; the configurations of `reports/training.md` are valid.

use std::path::Path;

use crumple_learn::rl::TrainingConfig;
use crumple_measure::UsefulnessMeasures;
use crumple_sim::control::{BuiltInController, IntoSource};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{Scenario, built_in_scenario};
use crumple_spaces::built_in_space;

#[test]
fn the_preset_is_that_of_the_policy() {
    let policy = Policy::road();
    let preset = TrainingConfig::preset("road").unwrap();
    let mut training = policy.header().training.clone();
    let spaces = training
        .as_object_mut()
        .unwrap()
        .remove("scenarios")
        .unwrap();
    assert_eq!(training, preset.to_header_value().unwrap());
    assert_eq!(
        Some(spaces.as_str().unwrap().to_owned()),
        preset.scenario_source().unwrap().identity().unwrap()
    );
    assert_eq!(
        policy.header().observation,
        preset.environment.observation.scaling()
    );
}

/// All links exist, and no configuration of an experiment is unused.
#[test]
fn the_report_links_to_the_configurations_of_its_tables() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let report = std::fs::read_to_string(root.join("reports/training.md")).unwrap();
    let links = report
        .split("](")
        .skip(1)
        .filter_map(|rest| rest.split(')').next());
    let links: Vec<_> = links.filter(|link| !link.starts_with("http")).collect();
    for link in &links {
        let path = link.split('#').next().unwrap();
        assert!(
            path.is_empty() || root.join("reports").join(path).exists(),
            "{link}"
        );
    }
    for entry in std::fs::read_dir(root.join("corpora/training/ablation")).unwrap() {
        let file = format!(
            "../corpora/training/ablation/{}",
            entry.unwrap().file_name().to_str().unwrap()
        );
        assert!(links.contains(&file.as_str()), "{file}");
    }
}

/// Each ablation in `reports/training.md` changes one setting of the paper.
#[test]
fn an_ablation_changes_one_thing() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/training/ablation");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let config =
            TrainingConfig::parse(&std::fs::read_to_string(&path).unwrap(), &path).unwrap();
        let mut literal = TrainingConfig::preset("paper").unwrap();
        (literal.name, literal.episodes) = (config.name.clone(), 200);
        match config.name.as_str() {
            "penalty" => literal.learning.saturation_penalty = config.learning.saturation_penalty,
            "reward-scale" => literal.environment.reward_scale = config.environment.reward_scale,
            "first-weights" => literal.network.final_layer_bound = config.network.final_layer_bound,
            "rates" => {
                let fast = TrainingConfig::preset("fast").unwrap().learning;
                (literal.learning.actor_rate, literal.learning.critic_rate) =
                    (fast.actor_rate, fast.critic_rate);
            }
            // The discount per second stays the same.
            "interval" => {
                (literal.environment.action_repeat, literal.learning.discount) = (10, 0.9999)
            }
            other => panic!("{other}"),
        }
        assert_eq!(config, literal);
        names.push(config.name);
    }
    assert_eq!(names.len(), 5, "{names:?}");
}

/// Collisions, drives with hard unnecessary braking or in which the vehicle falls behind, and the mean squares of
/// acceleration and jerk.
struct Driven {
    collisions: usize,
    faults: usize,
    mean_squares: [f64; 2],
}

fn drive(controller: &str, scenarios: &[Scenario], estimator: EstimatorKind) -> Driven {
    let spec = BuiltInController::parse(controller).unwrap().unwrap();
    let options = RunOptions::new(spec.into_source()).with_estimator(estimator);
    let runs: Vec<_> = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()).unwrap())
        .collect();
    let each = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
        let useful = result
            .trace
            .as_ref()
            .and_then(|trace| UsefulnessMeasures::from_trace(trace, &result.impacts, 1));
        (result.outcome.collision().is_some(), useful.unwrap())
    });
    let mean = |of: &dyn Fn(&UsefulnessMeasures) -> f64| {
        each.iter().map(|(_, useful)| of(useful)).sum::<f64>() / each.len() as f64
    };
    Driven {
        collisions: each.iter().filter(|(collided, _)| *collided).count(),
        faults: each
            .iter()
            .filter(|(_, useful)| {
                !useful.hard.is_empty()
                    || useful
                        .following
                        .is_some_and(|following| following.fell_behind)
            })
            .count(),
        mean_squares: [
            mean(&|useful| useful.rms_acceleration_mps2.unwrap_or_default().powi(2)),
            mean(&|useful| useful.rms_jerk_mps3.unwrap_or_default().powi(2)),
        ],
    }
}

/// Scenarios of a space that no training or selection used.
fn draw(space: &str, count: u64) -> Vec<Scenario> {
    let space = built_in_space(space).unwrap();
    (0..count)
        .map(|index| space.draw(0x726f_6164, index).unwrap())
        .collect()
}

#[test]
fn predictive_and_road_are_safe_in_the_papers_task() {
    let paper = ["paper-1", "paper-2", "paper-3"].map(|name| built_in_scenario(name).unwrap());
    for (controller, estimator) in ["predictive", "road"].into_iter().flat_map(|controller| {
        [EstimatorKind::Kalman, EstimatorKind::Truth].map(|estimator| (controller, estimator))
    }) {
        assert_eq!(
            drive(controller, &paper, estimator).collisions,
            0,
            "{controller} {estimator:?}"
        );
    }
}

/// Both collide half as often as `idm` before six kinds of follower and none, and with humans behind no more often.
/// Both are as comfortable in traffic as `idm-damped`, which amplifies no oscillation of 0.3 m/s.
#[test]
fn predictive_and_road_are_safe_and_useful() {
    let kalman = EstimatorKind::Kalman;
    let traffic = draw("traffic", 200);
    let emergencies = [("followers", 420), ("high-risk-human", 300)];
    let emergencies = emergencies.map(|(space, count)| draw(space, count));
    let damped = drive("idm-damped", &traffic, kalman).mean_squares;
    let idm = [0, 1].map(|space| drive("idm", &emergencies[space], kalman).collisions);
    for controller in ["predictive", "road"] {
        let Driven {
            collisions,
            faults,
            mean_squares,
        } = drive(controller, &traffic, kalman);
        assert_eq!((collisions, faults), (0, 0), "{controller}");
        let [acceleration, jerk] = [0, 1].map(|index| (mean_squares[index] / damped[index]).sqrt());
        assert!(
            acceleration < 1.2 && jerk < 1.2,
            "{controller}: {acceleration} and {jerk} times those of idm-damped"
        );
        let [any, human] =
            [0, 1].map(|space| drive(controller, &emergencies[space], kalman).collisions);
        assert!(
            2 * any < idm[0] && human <= idm[1],
            "{controller}: {any} and {human}, idm {idm:?}"
        );
    }
}
