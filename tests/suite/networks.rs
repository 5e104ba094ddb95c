//! External networks: outputs, driving, and refused files. `corpora/controllers/` documents the origin of the files.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::slice;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crumple_controllers::Controllers;
use crumple_controllers::controller_file::controller_file_schema;
use crumple_networks::NetworkController;
use crumple_networks::network::NetworkFile;
use crumple_sim::control::{ControllerSource, IntoSource};
use crumple_sim::engine::{
    RecordingLevel, Run, RunOptions, SimulationResult, simulate, simulate_batch,
};
use crumple_sim::policy::{Policy, Workspace};
use crumple_sim::scenario::{PaperDistribution, Scenario, file};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use serde::Deserialize;
use tempfile::TempDir;

use crate::command_line::{
    exit_code, json_objects, run_crumple, run_ok, stderr, stdout, temp_folder,
};
use crate::schema::{assert_committed, validate};
use crate::tiny::assert_contains;

pub(crate) fn controller_corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/controllers")
}

/// Creates a folder with some files of the corpus.
pub(crate) fn folder_with(names: &[&str]) -> TempDir {
    let folder = temp_folder();
    for name in names {
        fs::copy(controller_corpus().join(name), folder.path().join(name)).unwrap();
    }
    folder
}

/// Observations, and the answers of the network's original framework.
#[derive(Deserialize)]
struct ReferenceAnswers {
    inputs: Vec<Vec<f32>>,
    answers: Vec<Vec<f64>>,
}

fn load_reference_answers(file: &str) -> BTreeMap<String, ReferenceAnswers> {
    serde_json::from_str(&fs::read_to_string(controller_corpus().join(file)).expect("there"))
        .expect("as it was written")
}

/// Returns the largest difference of answers, relative to the larger of 1 and the answer.
fn largest_difference(path: &Path, inputs: &[f32], answers: &[f64]) -> f64 {
    let network = NetworkFile::load(path)
        .unwrap_or_else(|error| panic!("{error}"))
        .network;
    let batch = inputs.len() / network.inputs();
    let mut space = Workspace::default();
    let together = network.forward(inputs, batch, &mut space).to_vec();
    assert_eq!(together.len(), answers.len(), "{}", path.display());
    // Single evaluations give the same bits.
    for (row, own) in inputs
        .chunks_exact(network.inputs())
        .zip(together.chunks_exact(network.outputs()))
        .take(100)
    {
        assert_eq!(network.forward(row, 1, &mut space), own);
    }
    let differences = together
        .iter()
        .zip(answers)
        .map(|(own, other)| (f64::from(*own) - other).abs() / other.abs().max(1.0));
    differences.fold(0.0, f64::max)
}

#[test]
fn networks_answer_as_their_makers_do() {
    for (file, expected) in load_reference_answers("networks.json")
        .into_iter()
        .chain(load_reference_answers("models.json"))
    {
        let (inputs, answers) = (expected.inputs.concat(), expected.answers.concat());
        let difference = largest_difference(&controller_corpus().join(&file), &inputs, &answers);
        assert!(difference <= 1e-5, "{file}: {difference:e}");
    }
}

/// Any number of observations: `make.py oracle DIR`, then this test with `CRUMPLE_NETWORKS=DIR`.
#[test]
#[ignore = "needs a folder that make.py wrote"]
fn networks_agree_with_their_makers() {
    let folder = PathBuf::from(std::env::var("CRUMPLE_NETWORKS").expect("a folder"));
    let numbers = |path: &Path| -> Vec<f32> {
        fs::read(path)
            .expect("there")
            .as_chunks::<4>()
            .0
            .iter()
            .map(|&bytes| f32::from_le_bytes(bytes))
            .collect()
    };
    let mut paths: Vec<_> = fs::read_dir(folder)
        .expect("there")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    paths.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "onnx" || extension == "zip")
    });
    paths.sort();
    for path in paths {
        let beside = |what: &str| numbers(&PathBuf::from(format!("{}.{what}", path.display())));
        let (inputs, answers) = (beside("inputs"), beside("answers"));
        let answers: Vec<f64> = answers.into_iter().map(f64::from).collect();
        let difference = largest_difference(&path, &inputs, &answers);
        println!(
            "{}: {} answers, {difference:.2e}",
            path.display(),
            answers.len()
        );
        assert!(difference <= 1e-5);
    }
}

pub(crate) fn find_source(name: &str) -> Arc<dyn ControllerSource> {
    Controllers::default()
        .find(name, &controller_corpus())
        .unwrap_or_else(|error| panic!("{error}"))
        .source
}

fn draw_scenarios(count: u64) -> Vec<Scenario> {
    (0..count)
        .map(|index| PaperDistribution { seed: 20 }.draw(index).unwrap())
        .collect()
}

fn simulate_together(
    scenarios: &[Scenario],
    kinds: &[Arc<dyn ControllerSource>],
) -> Vec<SimulationResult> {
    let run = |(index, scenario): (usize, _)| {
        Run::new(
            scenario,
            RunOptions::new(kinds[index % kinds.len()].clone()),
        )
        .unwrap()
    };
    let runs: Vec<_> = scenarios.iter().enumerate().map(run).collect();
    simulate_batch(&runs, RecordingLevel::Trace, |_, simulated| simulated)
}

#[test]
fn the_reference_policy_written_as_onnx_drives_to_the_same_bits() {
    let (own, outside) = (
        Policy::reference().into_source(),
        find_source("reference.onnx"),
    );
    let scenarios = draw_scenarios(300);
    assert_eq!(
        simulate_together(&scenarios, slice::from_ref(&own)),
        simulate_together(&scenarios, slice::from_ref(&outside))
    );
    for scenario in &scenarios[..20] {
        let alone = |kind: &Arc<dyn ControllerSource>| {
            simulate(
                &Run::new(scenario, RunOptions::new(kind.clone())).unwrap(),
                RecordingLevel::Trace,
            )
        };
        assert_eq!(alone(&own), alone(&outside));
    }
    assert_ne!(own.identity(), outside.identity());
}

/// In any batch, with or without a memory of the last decisions.
#[test]
fn outside_networks_in_lockstep_drive_as_alone() {
    let kinds = [
        "stacked.toml",
        "acc.toml",
        "a2c.toml",
        "sac-gsde.zip",
        "leaky-40-clip.onnx",
    ]
    .map(find_source);
    let scenarios = draw_scenarios(100);
    for (index, simulated) in simulate_together(&scenarios, &kinds)
        .into_iter()
        .enumerate()
    {
        let run = Run::new(
            &scenarios[index],
            RunOptions::new(kinds[index % kinds.len()].clone()),
        )
        .unwrap();
        assert_eq!(
            simulate(&run, RecordingLevel::Trace),
            simulated,
            "run {index}"
        );
    }
}

const FOLLOWING: &str = r#"version = 1
name = "following"
duration_s = 60.0

[[vehicles]]
class = "light"
position_m = 60.0
speed_mps = 20.0
driver.brake-to-speed = { onset_s = 10.0, rate_mps2 = 1.0, final_speed_mps = 12.0 }

[[vehicles]]
class = "light"
position_m = 0.0
speed_mps = 24.0
driver = "under-test"
"#;

/// A vehicle that is not under test drives as the controller would under test. A scenario written to another folder
/// still finds its controller, and refuses another one in its place.
#[test]
fn scenario_files_take_drivers_from_files() {
    let folder = folder_with(&["acc-5x20.onnx", "acc.toml"]);
    let text = FOLLOWING.replace("\"under-test\"", "{ file = { path = \"acc.toml\" } }");
    let path = folder.path().join("following.toml");
    fs::write(&path, &text).unwrap();
    let scenario =
        file::load(&path, &Controllers::default()).unwrap_or_else(|error| panic!("{error}"));
    let under_test = file::from_toml(
        FOLLOWING,
        Path::new("following.toml"),
        &Controllers::default(),
    )
    .unwrap();
    let truth = |controller: Arc<dyn ControllerSource>| {
        RunOptions::new(controller).with_estimator(crumple_sim::observation::EstimatorKind::Truth)
    };
    let run = |scenario, controller| {
        simulate(
            &Run::new(scenario, truth(controller)).unwrap(),
            RecordingLevel::Trace,
        )
    };
    let driven = run(&scenario, find_source("reference.onnx"));
    assert_eq!(driven, run(&under_test, find_source("acc.toml")));
    let batch = [Run::new(&scenario, truth(find_source("ppo.zip"))).unwrap()];
    assert_eq!(
        simulate_batch(&batch, RecordingLevel::Trace, |_, simulated| simulated),
        [driven]
    );

    let written = file::to_toml(&scenario).unwrap();
    let again = file::from_toml(
        &written,
        Path::new("elsewhere/following.toml"),
        &Controllers::default(),
    )
    .unwrap();
    assert_eq!(again, scenario);
    assert_eq!(file::to_toml(&again).unwrap(), written);
    let controller = fs::read_to_string(controller_corpus().join("acc.toml")).unwrap();
    fs::write(
        folder.path().join("acc.toml"),
        controller.replace("1.4 #", "1.5 #"),
    )
    .unwrap();
    let error = file::from_toml(&written, &path, &Controllers::default())
        .expect_err("another controller")
        .to_string();
    assert!(
        error.contains("vehicles[1].driver.file.path: ") && error.contains("is wanted"),
        "{error}"
    );
    let error = file::from_toml(
        &text.replace("acc.toml", "none.toml"),
        &path,
        &Controllers::default(),
    )
    .expect_err("no file")
    .to_string();
    assert!(
        error.contains("following.toml:15: vehicles[1].driver.file.path: there is no file"),
        "{error}"
    );
}

/// `UPDATE_SCHEMA=1 cargo test --test suite schema` updates the committed schema.
#[test]
fn the_schema_of_controller_files_is_committed_and_accepts_the_corpus() {
    let schema = controller_file_schema();
    assert_committed("crates/controllers/src/controller.schema.json", &schema);
    for name in [
        "acc.toml",
        "stacked.toml",
        "a2c.toml",
        "normalised/ppo.toml",
    ] {
        let file: serde_json::Value =
            toml::from_str(&fs::read_to_string(controller_corpus().join(name)).unwrap()).unwrap();
        validate(&schema, &schema, &file, name).unwrap();
    }
}

#[test]
fn the_identity_of_a_network_covers_everything_that_affects_driving() {
    let folder = folder_with(&["acc-5x20.onnx"]);
    let text = fs::read_to_string(controller_corpus().join("acc.toml")).unwrap();
    let identity = |text: &str| {
        fs::write(folder.path().join("a.toml"), text).unwrap();
        Controllers::default()
            .find("a.toml", folder.path())
            .unwrap()
            .disambiguating_hash()
            .expect("not said by its name")
    };
    let own = identity(&text);
    assert_eq!(Some(&own), find_source("acc.toml").identity().as_ref());
    assert_eq!(own, identity(&format!("# a comment\n{text}")));
    for (was, is) in [
        ("1.4 #", "1.5 #"),
        ("-7.5", "-7.25"),
        ("interval_s = 0.1", "interval_s = 0.2"),
    ] {
        assert_ne!(own, identity(&text.replacen(was, is, 1)), "{is}");
    }
}

#[test]
fn controller_files_are_refused_by_file_line_and_field() {
    let folder = folder_with(&["acc-5x20.onnx"]);
    let text = fs::read_to_string(controller_corpus().join("acc.toml")).unwrap();
    let cases = [
        (
            "version = 1",
            "version = 2",
            "a.toml:2: version: version 2 is not supported",
        ),
        (
            "interval_s = 0.1",
            "interval_s = 0",
            "a.toml:4: decision_interval_s: must be positive, found 0",
        ),
        (
            "interval_s = 0.1",
            "interval = 0.1",
            "a.toml:4: decision_interval: unknown field",
        ),
        (
            "constant = 1.4",
            "constant = nan",
            "a.toml:10: inputs[1].constant: must be a finite number",
        ),
        (
            "constant = 1.4",
            "constant = 1.4\nquantity = \"speed_mps\"",
            "a.toml:10: inputs[1].constant: an input is a quantity or",
        ),
        (
            "constant = 1.4",
            "scale = 2.0",
            "a.toml:9: inputs[1]: needs a quantity or a constant",
        ),
        (
            "\"speed_mps\"",
            "\"speed\"",
            "a.toml:13: inputs[2].quantity: unknown variant `speed`",
        ),
        (
            "low = 0.0\nhigh = 50.0",
            "scale = 0.0",
            "a.toml:14: inputs[2].scale: must not be 0",
        ),
        (
            "high = 50.0",
            "high = -1.0",
            "a.toml:14: inputs[2].low: must not be above high",
        ),
        (
            "high = 50.0",
            "absent = 1.0",
            "a.toml:15: inputs[2].absent: is allowed only for quantities of another vehicle",
        ),
        (
            "[output]",
            "[[inputs]]\nconstant = 1\n[output]",
            "inputs: there are 6, and the network has 5 inputs",
        ),
        (
            "[output]",
            "[output]\nanswer = 1",
            "a.toml:30: output.answer: must be below 1",
        ),
        (
            "interval_s = 0.1",
            "interval_s = 0.1\nhistory_padding = \"ones\"",
            "a.toml:5: history_padding: unknown variant `ones`",
        ),
        (
            "high_mps2 = 3.0",
            "high_mps2 = -9",
            "a.toml:30: output.low_mps2: must be below high_mps2",
        ),
        (
            "acc-5x20.onnx",
            "none.onnx",
            "a.toml:3: network: there is no file ",
        ),
        (
            "acc-5x20.onnx",
            "a.toml",
            "a network's file ends in .onnx, or in .zip",
        ),
    ];
    for (was, is, message) in cases {
        assert!(text.contains(was), "{was}");
        fs::write(folder.path().join("a.toml"), text.replacen(was, is, 1)).unwrap();
        let error = Controllers::default()
            .find("a.toml", folder.path())
            .expect_err(is)
            .to_string();
        assert!(error.contains(message), "{error}\n  should say\n{message}");
    }
}

#[test]
fn networks_that_need_a_controller_file_say_so() {
    let refused = |name: &str| {
        Controllers::default()
            .find(name, &controller_corpus())
            .expect_err(name)
            .to_string()
    };
    for (name, message) in [
        ("acc-5x20.onnx", "inputs: 5, outputs: 1;"),
        (
            "a2c.zip",
            "its action space is -7.5 to 3; without a controller file crumple expects -1 to 1",
        ),
        ("elu-7-5.onnx", "inputs: 3, outputs: 4;"),
        ("mixed-50-25.onnx", "its output is not limited to -1 to 1"),
        ("normalised-64-64-64.onnx", ""),
    ] {
        if message.is_empty() {
            find_source(name);
        } else {
            let error = refused(name);
            assert!(
                error.contains(message) && error.contains("docs/controllers.md"),
                "{error}"
            );
        }
    }
    let folder = temp_folder();
    fs::copy(
        controller_corpus().join("sac-gsde.zip"),
        folder.path().join("m.zip"),
    )
    .unwrap();
    assert!(Controllers::default().find("m.zip", folder.path()).is_ok());
    fs::write(folder.path().join("vecnormalize.pkl"), "").unwrap();
    let error = Controllers::default()
        .find("m.zip", folder.path())
        .expect_err("normalised")
        .to_string();
    assert!(
        error.contains("`vecnormalize.pkl` is in the same folder"),
        "{error}"
    );
    // The content of the pickle counts, in any place: this one states that observations were not normalised.
    fs::copy(
        normalised_path("rewards-alone.pkl"),
        folder.path().join("vecnormalize.pkl"),
    )
    .unwrap();
    assert!(Controllers::default().find("m.zip", folder.path()).is_ok());
}

fn normalised_path(name: &str) -> PathBuf {
    controller_corpus().join("normalised").join(name)
}

/// The model file reveals `VecNormalize`, with or without the statistics next to it.
#[test]
fn a_model_behind_vec_normalize_needs_its_statistics() {
    use crumple_networks::network::VecNormalizeUse as Trace;
    let trace = |path: &Path| {
        NetworkFile::load(path)
            .unwrap()
            .saved_model()
            .unwrap()
            .vec_normalize
    };
    assert_eq!(trace(&normalised_path("ppo.zip")), Trace::Behind);
    assert_eq!(
        ["ppo.zip", "sac.zip"].map(|name| trace(&controller_corpus().join(name))),
        [Trace::None, Trace::Unknown]
    );

    let folder = temp_folder();
    let described = fs::read_to_string(normalised_path("ppo.toml")).unwrap();
    let undescribed = described.replace("normalised = true\n", "");
    let find = |text: &str| {
        fs::write(folder.path().join("a.toml"), text).unwrap();
        Controllers::default()
            .find("a.toml", folder.path())
            .map(|controller| controller.disambiguating_hash())
    };
    fs::copy(normalised_path("ppo.zip"), folder.path().join("ppo.zip")).unwrap();
    let message = find(&undescribed).expect_err("not told").to_string();
    assert_contains(
        &message,
        &["a.toml:1: normalised: is missing: ", "its data shows that"],
    );
    let message = Controllers::default()
        .find("ppo.zip", folder.path())
        .expect_err("not told")
        .to_string();
    assert_contains(
        &message,
        &[
            "its data shows that it was trained with VecNormalize",
            "`normalised = true`",
        ],
    );
    let identity = find(&described).unwrap();
    // A statement about training does not change the controller.
    assert_eq!(
        find(&undescribed.replacen("version = 1", "version = 1\nnormalised = false", 1)).unwrap(),
        identity
    );
    // With the statistics next to the model, `normalised` is optional, unless the inputs contradict them.
    fs::copy(
        normalised_path("ppo_vecnormalize.pkl"),
        folder.path().join("ppo_vecnormalize.pkl"),
    )
    .unwrap();
    assert_eq!(find(&undescribed).unwrap(), identity);
    let message = find(&undescribed.replace("high = 5.0", "high = 10.0"))
        .expect_err("another limit")
        .to_string();
    assert!(
        message.contains("`ppo_vecnormalize.pkl` seems to contain the statistics"),
        "{message}"
    );
    fs::copy(
        normalised_path("rewards-alone.pkl"),
        folder.path().join("ppo_vecnormalize.pkl"),
    )
    .unwrap();
    assert!(find(&undescribed.replace("high = 5.0", "high = 10.0")).is_ok());
}

/// The controller file and `VecNormalize` normalise alike.
#[test]
fn a_model_behind_vec_normalize_answers_as_its_maker() {
    #[derive(Deserialize)]
    struct Answers {
        seen: Vec<Vec<f64>>,
        answers: Vec<Vec<f64>>,
    }
    let text = fs::read_to_string(normalised_path("answers.json")).unwrap();
    let Answers { seen, answers } = serde_json::from_str(&text).unwrap();
    let source = find_source("normalised/ppo.toml");
    let controller = source.downcast_ref::<NetworkController>().unwrap();
    let mapped = |row: Vec<f64>| -> Vec<f32> {
        let inputs = &controller.mapping().inputs;
        let scale = |(value, input): (f64, &crumple_networks::InputMapping)| {
            ((value - input.offset) / input.scale).clamp(input.low, input.high) as f32
        };
        row.into_iter().zip(inputs).map(scale).collect()
    };
    let inputs: Vec<f32> = seen.into_iter().flat_map(mapped).collect();
    let difference = largest_difference(&normalised_path("ppo.zip"), &inputs, &answers.concat());
    assert!(difference <= 1e-5, "{difference:e}");
    assert!(
        controller.warnings().is_empty(),
        "{:?}",
        controller.warnings()
    );
}

/// The driving output must be named if there are several; a model's spaces are compared with the controller file.
#[test]
fn mismatches_with_a_model_are_reported() {
    let folder = folder_with(&["a2c.zip", "elu-7-5.onnx"]);
    let find = |text: &str| {
        fs::write(folder.path().join("a.toml"), text).unwrap();
        Controllers::default().find("a.toml", folder.path())
    };
    let fitting = fs::read_to_string(controller_corpus().join("a2c.toml")).unwrap();
    assert_eq!(
        find(&fitting).unwrap().source.warnings(),
        Vec::<String>::new()
    );
    let undecided = |text: &str| find(text).unwrap().source.warnings().join("\n");
    let unscaled = fitting.replacen(
        "offset = 16.0\nscale = 16.0\nlow = -4.0\nhigh = 4.0\n",
        "",
        1,
    );
    assert!(
        undecided(&unscaled).contains("inputs[0] (gap_ahead_m) is 10 to 50, of -4 to 4"),
        "{}",
        undecided(&unscaled)
    );
    for (message, doubt) in [
        (
            "scale_mps2 = 0.1",
            "the model's actions of -7.5 to 3 mean -0.75 to 0.3 m/s² here, of low_mps2 = -7.5 to high_mps2 = 3",
        ),
        (
            "scale_mps2 = 2.0",
            "mean -15 to 6 m/s² here, cut to low_mps2 = -7.5 to high_mps2 = 3",
        ),
    ] {
        let undecided = undecided(&fitting.replace("[output]", &format!("[output]\n{message}")));
        assert!(undecided.contains(doubt), "{undecided}");
    }
    let message = find(&fitting.replace("[output]", "[output]\noffset_mps2 = 20.0"))
        .expect_err("one action")
        .to_string();
    assert!(
        message.contains("output: excludes every action of the model: actions of -7.5 to 3"),
        "{message}"
    );
    let noted = run_crumple(
        folder.path(),
        "simulate paper-1 --controller shield:a2c.zip",
    );
    assert_eq!(exit_code(&noted), 2);
    fs::write(folder.path().join("a.toml"), &unscaled).unwrap();
    let noted = run_crumple(folder.path(), "simulate paper-1 --controller shield:a.toml");
    let message = stderr(&noted);
    assert!(
        message.starts_with("note: shield:a.toml: in ordinary driving")
            && message.lines().count() == 1,
        "{message}"
    );
    let quiet = run_crumple(
        folder.path(),
        "simulate paper-1 --controller shield:a.toml --quiet",
    );
    assert!(quiet.stderr.is_empty() && quiet.stdout == noted.stdout);

    let several = "version = 1\nnetwork = \"elu-7-5.onnx\"\ndecision_interval_s = 0.1\n\
                   [[inputs]]\nquantity = \"gap_ahead_m\"\nscale = 100.0\n[[inputs]]\nquantity = \"speed_mps\"\nscale \
                   = 40.0\n\
                   [[inputs]]\nquantity = \"acceleration_mps2\"\n[output]\nlow_mps2 = -7.5\nhigh_mps2 = 3.0\n";
    let message = find(several).expect_err("which?").to_string();
    assert!(
        message.contains("output.answer: is missing: the network has 4 outputs"),
        "{message}"
    );
    assert!(find(&several.replace("[output]", "[output]\nanswer = 3")).is_ok());
}

/// `model.save("ppo_0.5")` writes no `.zip`.
#[test]
fn a_model_is_known_by_its_first_bytes_and_a_name_without_its_ending_is_guessed() {
    let folder = temp_folder();
    for name in ["ppo_0.5", "plain", "m.zip"] {
        fs::copy(
            controller_corpus().join("ppo.zip"),
            folder.path().join(name),
        )
        .unwrap();
    }
    for name in ["ppo_0.5", "plain"] {
        let controller = Controllers::default().find(name, folder.path()).unwrap();
        assert_eq!(
            controller.source.identity(),
            find_source("ppo.zip").identity()
        );
    }
    let message = Controllers::default()
        .find("m", folder.path())
        .expect_err("no ending")
        .to_string();
    assert_eq!(
        message,
        "there is no controller `m`; did you mean the file `m.zip`?"
    );
}

/// The printed controller file works for any network.
#[test]
fn described_networks_drive() {
    let folder = temp_folder();
    let names = [
        "ppo.zip",
        "sac.zip",
        "td3.zip",
        "acc-5x20.onnx",
        "elu-7-5.onnx",
        "normalised/ppo.zip",
    ];
    for name in names {
        let path = controller_corpus().join(name).display().to_string();
        let described = run_ok(folder.path(), &format!("describe '{path}'"));
        fs::write(folder.path().join("a.toml"), &described.stdout).unwrap();
        let controller = Controllers::default()
            .find("a.toml", folder.path())
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let json = run_crumple(folder.path(), &format!("describe '{path}' --format json"));
        let json = &json_objects(&json)[0];
        let text = stdout(&described);
        assert!(
            text.ends_with(json["controller_file"].as_str().unwrap()),
            "{name}"
        );
        if name == "normalised/ppo.zip" {
            let Some(controller) = controller.source.downcast_ref::<NetworkController>() else {
                panic!("a network")
            };
            let written = find_source("normalised/ppo.toml");
            let written = written.downcast_ref::<NetworkController>().unwrap();
            assert_eq!(controller.mapping().inputs, written.mapping().inputs);
            assert!(text.contains("VecNormalize: used in training"), "{text}");
        }
    }
}

/// A network that limits its outputs needs a scale to m/s²: without it the vehicle accelerates by at most 1 m/s².
#[test]
fn the_draft_of_a_network_that_limits_its_answers_scales_them() {
    let folder = temp_folder();
    let drafted = |name: &str| {
        let path = controller_corpus().join(name);
        let described = run_ok(folder.path(), &format!("describe '{}'", path.display()));
        fs::write(folder.path().join("a.toml"), &described.stdout).unwrap();
        let controller = Controllers::default()
            .find("a.toml", folder.path())
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let Some(controller) = controller.source.downcast_ref::<NetworkController>() else {
            panic!("a network")
        };
        let output = controller.mapping().output.clone();
        assert_eq!(output.squash, None, "{name}");
        (
            stdout(&described).to_owned(),
            [output.offset_mps2, output.scale_mps2],
        )
    };
    for name in [
        "reference.onnx",
        "tanh-33-17.onnx",
        "td3.zip",
        "sac-gsde.zip",
    ] {
        let (text, found) = drafted(name);
        assert_eq!(found, [-2.25, 5.25], "{name}");
        assert_contains(&text, &["limits its outputs to -1.0 to 1.0: "]);
    }
    // The outputs are accelerations already: from -7.5 to 3 m/s².
    assert_eq!(drafted("sac.zip").1, [0.0, 1.0]);
    // The outputs have no bounds: the draft explains what to do if training squashed them.
    let (text, found) = drafted("elu-7-5.onnx");
    assert_eq!(found, [0.0, 1.0]);
    assert!(
        text.contains("does not limit its outputs") && text.contains("squash = \"tanh\""),
        "{text}"
    );
}

/// The format of `torch.save` before PyTorch 1.6 is no zip archive; such a model is not damaged.
#[test]
fn weights_in_pytorchs_old_format_are_named() {
    // Start of `torch.save(..., _use_new_zipfile_serialization=False)`: magic number, version, system.
    let mut legacy =
        b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}q\x00.".to_vec();
    legacy.extend([0; 64]);
    let model = fs::read(controller_corpus().join("ppo.zip")).unwrap();
    let mut whole = zip::ZipArchive::new(std::io::Cursor::new(model)).unwrap();
    let mut written = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for index in 0..whole.len() {
        let mut member = whole.by_index(index).unwrap();
        let name = member.name().unwrap().into_owned();
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Stored);
        written.start_file(&name, options).unwrap();
        if name == "policy.pth" {
            std::io::Write::write_all(&mut written, &legacy).unwrap();
        } else {
            std::io::copy(&mut member, &mut written).unwrap();
        }
    }
    let old = written.finish().unwrap().into_inner();
    for (bytes, what) in [
        (old.as_slice(), "its weights, `policy.pth`, are"),
        (&legacy, "it is a file of `torch.save`"),
    ] {
        let message = NetworkFile::from_sb3(bytes)
            .expect_err("the old format")
            .to_string();
        assert!(
            message.starts_with(what) && message.contains("in the format of PyTorch before 1.6"),
            "{message}"
        );
        assert!(
            message.contains("`PPO.load(\"old\").save(\"new\")`")
                && !message.contains("not a whole"),
            "{message}"
        );
    }
}

/// Runs an example of `examples/controllers`. Returns false if Python or one of its packages is missing.
fn run_example(script: &str, needs: &str, arguments: &[&str], folder: &Path) -> bool {
    let python = |arguments: &[&str]| {
        let mut python = std::process::Command::new("python3");
        python
            .args(arguments)
            .current_dir(folder)
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .output()
    };
    if !python(&["-c", &format!("import {needs}")]).is_ok_and(|output| output.status.success()) {
        println!("skipped {script}: python3 has not all of {needs}");
        return false;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("examples/controllers")
        .join(script);
    let done = python(&[&[script.to_str().unwrap()], arguments].concat()).unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    true
}

#[test]
fn the_examples_make_controllers() {
    let folder = temp_folder();
    let scenario = file::from_toml(
        FOLLOWING,
        Path::new("following.toml"),
        &Controllers::default(),
    )
    .unwrap();
    let drive = |name: &str| {
        let controller = Controllers::default()
            .find(name, folder.path())
            .unwrap_or_else(|error| panic!("{error}"));
        simulate(
            &Run::new(&scenario, RunOptions::new(controller.source)).unwrap(),
            RecordingLevel::Summary,
        )
        .outcome
    };
    if run_example(
        "export_onnx.py",
        "torch, onnx, onnxscript",
        &["follower.onnx"],
        folder.path(),
    ) {
        assert!(drive("follower.onnx").is_safe());
    }
    let statistics = normalised_path("ppo_vecnormalize.pkl")
        .display()
        .to_string();
    run_example(
        "vecnormalize.py",
        "stable_baselines3",
        &[&statistics],
        folder.path(),
    );
    if run_example(
        "train_sb3.py",
        "stable_baselines3",
        &["follower.zip", "150"],
        folder.path(),
    ) {
        drive("follower.zip");
    }
}

/// The files next to a report make the same controllers, so its commands reproduce its results.
#[test]
fn a_report_of_networks_can_be_replayed_from_its_folder() {
    let folder = folder_with(&["ppo.zip", "acc-5x20.onnx", "acc.toml"]);
    let config = "version = 1\ncontrollers = [\"baseline\", \"ppo.zip\", \"shield:acc.toml\"]\npaper = false\ndraws = \
        20\n\
                  everyday_draws = 0\ncertificates = []\nrates = { runs = 0 }\ndistributions = [\"paper\"]\n\
                  search = { spaces = [\"high-risk\"], budget = 8 }\n";
    fs::write(folder.path().join("a.toml"), config).unwrap();
    let assessed = run_crumple(folder.path(), "assess a.toml --out report");
    assert_eq!(exit_code(&assessed), 0, "{}", stderr(&assessed));
    let report = folder.path().join("report");
    let there = |name: &str| {
        let identity = find_source(name).identity().unwrap();
        let path = format!("controllers/{}.toml", &identity[..16]);
        assert_eq!(
            Controllers::default()
                .find(&path, &report)
                .unwrap()
                .source
                .identity(),
            Some(identity)
        );
        path
    };
    let words = [there("ppo.zip"), there("acc.toml")];
    let replay = fs::read_to_string(report.join("replay.sh")).unwrap();
    assert!(words.iter().all(|word| replay.contains(word)), "{replay}");
}

/// Cut files, flipped bits, and false lengths and counts give one clear error or a network, quickly. `DAMAGES` is the
/// number of each.
#[test]
fn damaged_files_are_refused_and_nothing_worse() {
    let damages: usize =
        std::env::var("DAMAGES").map_or(150, |count| count.parse().expect("a number"));
    let mut stream = Xoshiro256PlusPlus::seed_from_u64(20);
    for file in [
        "reference.onnx",
        "acc-5x20.onnx",
        "leaky-40-clip.onnx",
        "ppo.zip",
        "sac.zip",
        "td3.zip",
    ] {
        let whole = fs::read(controller_corpus().join(file)).unwrap();
        let read = |bytes: &[u8]| {
            let begun = Instant::now();
            let read = if file.ends_with("onnx") {
                NetworkFile::from_onnx(bytes)
            } else {
                NetworkFile::from_sb3(bytes)
            };
            assert!(begun.elapsed() < Duration::from_secs(20), "{file}");
            if let Err(error) = &read {
                let message = error.to_string();
                assert!(
                    message.len() < 1000 && !message.chars().any(char::is_control),
                    "{message:?}"
                );
            }
            read.is_err()
        };
        assert!(!read(&whole));
        let mut refused = 0;
        for _ in 0..damages {
            assert!(
                read(&whole[..stream.random_range(0..whole.len())]),
                "{file} cut off"
            );
            let (mut turned, mut lies) = (whole.clone(), whole.clone());
            // Lengths and counts are at the start of an ONNX file, and at the end of an archive.
            let near = if file.ends_with("onnx") {
                0..200
            } else {
                whole.len() - 900..whole.len()
            };
            turned[stream.random_range(0..whole.len())] ^= 1 << stream.random_range(0..8);
            lies[stream.random_range(near)] = [0x00, 0x7f, 0x80, 0xff][stream.random_range(0..4)];
            refused += usize::from(read(&turned)) + usize::from(read(&lies));
        }
        println!("{file}: {refused} of {} changed files refused", 2 * damages);
    }
}
