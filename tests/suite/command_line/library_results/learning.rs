//! Trainings, retrainings, tunings, and what a network or an FMU contains.

use crumple_controllers::controller_file::ControllerFileDraft;
use crumple_fmu::{Fmu, FmuReport};
use crumple_learn::retrain::{RetrainingPlan, RetrainingSettings, SearchedSpaces};
use crumple_learn::rl::{EvaluationSet, SeedTraining, TrainingConfig, format_table};
use crumple_learn::tune::{
    SettingRequest, SettingSearch, TuningConfig, TuningObjective, TuningPlan, TuningSpace,
};
use crumple_networks::network::{FoundStatistics, NetworkDescription, NetworkFile};
use crumple_search::falsify::Method;

use super::*;

#[test]
fn a_training() {
    let folder = temp_folder();
    fs::write(folder.path().join("tiny.toml"), tiny::training()).unwrap();
    let mut config = TrainingConfig::parse(&tiny::training(), Path::new("tiny.toml")).unwrap();
    config.episodes = 12;
    let held_out = EvaluationSet::from_config(&config).unwrap();
    let training = SeedTraining {
        config: &config,
        seed: 5,
        held_out: &held_out,
    };
    let results = [run_study(&training)];
    let code = i32::from(!results[0].has_learned());
    let text = format_table(&results, config.evaluation.ranking_draws);
    assert_same_study(
        folder.path(),
        code,
        "train --preset tiny.toml --seed 5 --episodes 12 --out out",
        &LibraryResult::new(&results, text),
    );
}

#[test]
fn a_tuning() {
    let folder = temp_folder();
    let setting = SettingRequest {
        name: "ttc_s".to_owned(),
        range: Some([0.0, 3.0]),
    };
    let plan = TuningPlan {
        search: SettingSearch::parse("baseline", &[setting]).unwrap(),
        spaces: vec![TuningSpace {
            space: find_space("paper"),
            weight: 1.0,
        }],
        drives: None,
        config: TuningConfig {
            objective: TuningObjective::Safety,
            method: Method::CmaEs,
            seed: 3,
            evaluations: 6,
            runs: 4,
            test_runs: 4,
            estimator: EstimatorKind::Kalman,
        },
    };
    let report = run_study(&plan);
    assert_same_study(
        folder.path(),
        0,
        "tune --controller baseline --setting ttc_s=0..3 --space paper --objective safety --evaluations 6 --runs 4 \
         --test-runs 4 --seed 3 --out tuned",
        &LibraryResult::new(&report, report.to_markdown()),
    );
}

#[test]
fn a_retraining() {
    let folder = temp_folder();
    fs::write(folder.path().join("tiny.toml"), tiny::retraining()).unwrap();
    let plan = RetrainingPlan {
        initial_policy: find_controller("policy").policy().unwrap(),
        initial_policy_name: "policy".to_owned(),
        spaces: SearchedSpaces::new(vec![find_space("high-risk")]).unwrap(),
        attacked: Vec::new(),
        regression_spaces: Vec::new(),
        training: TrainingConfig::parse(&tiny::retraining(), Path::new("tiny.toml")).unwrap(),
        method: Method::Auto,
        seed: 3,
        settings: RetrainingSettings {
            rounds: 1,
            episodes: 5,
            budget: 12,
            draws: 10,
            validation_draws: 4,
            nominal: 5,
            regression: 0,
            test_draws: 4,
            ..RetrainingSettings::DEFAULT
        },
    };
    let report = run_study(&plan);
    assert!(report.retrained_results.paper.is_empty() && report.is_retrained());
    assert_same_study(
        folder.path(),
        0,
        "retrain --preset tiny.toml --space high-risk --regression none --rounds 1 --episodes 5 \
         --budget 12 --draws 10 --validation-draws 4 --nominal 5 --test-draws 4 --seed 3 --out retrained",
        &LibraryResult::new(&report, report.to_markdown()),
    );
}

#[test]
fn descriptions_of_networks() {
    let folder = temp_folder();
    for name in ["ppo.zip", "acc-5x20.onnx"] {
        let path = corpus("controllers").join(name);
        let file = path.display().to_string();
        let network = NetworkFile::load(&path).unwrap();
        let statistics = FoundStatistics::find(&network, &path);
        let drives_as_it_is = crumple_controllers::Controllers::default()
            .find(&file, Path::new(""))
            .is_ok();
        let draft = ControllerFileDraft {
            path: &file,
            network: &network,
            normalisation: statistics.normalisation.as_ref(),
            drives_as_it_is,
        };
        let text = draft.to_toml();
        let report =
            NetworkDescription::new(file.clone(), &network, statistics, drives_as_it_is, text);
        assert_same(
            folder.path(),
            &format!("describe {}", quote(&path)),
            &LibraryResult::new(&report, report.to_text()),
        );
    }
}

/// `describe` runs no code of an FMU, so its library may be empty.
#[cfg(unix)]
#[test]
fn the_variables_of_an_fmu() {
    use crate::fmus::{library_member, zip_archive};

    let folder = temp_folder();
    let path = folder.path().join("follower.fmu");
    let xml = include_bytes!("../../../../examples/controllers/fmu/modelDescription.xml");
    let library = library_member(2, "follower");
    let members: [(&str, &[u8]); 2] = [("modelDescription.xml", xml), (&library, b"")];
    fs::write(&path, zip_archive(&members)).unwrap();
    let fmu = Fmu::open(&path).unwrap();
    let report = FmuReport::new(&path, fmu.description());
    assert_same(
        folder.path(),
        &format!("describe {}", quote(&path)),
        &LibraryResult::new(&report, report.to_text()),
    );
}
