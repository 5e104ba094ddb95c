//! Inputs for the corpora of the fuzz targets, from the strategies of this suite and from `corpora/`.
//!
//! `fuzz/renew-seeds` writes them to `fuzz/fresh/` and keeps those that reach new code.

use crumple_sim::scenario::NoDriverFiles;
use std::fs;
use std::path::{Path, PathBuf};

use crumple_core::observer::Quiet;
use crumple_evidence::{BoxSpec, ReachPlan, shipped_kernels};
use crumple_fuzzing::targets::TARGETS;
use crumple_fuzzing::{self, LANE_CASE_BYTES, ScenarioFormat, TEST_CASE_BYTES, TestCase};
use crumple_search::worst_case::{AvoidOptions, AvoidanceVerdict, avoid, certify};
use crumple_sim::engine::{RecordingLevel, Run, simulate};
use crumple_sim::policy::{Network, POLICY_VERSION, Policy, PolicyHeader, STATE_LEN};
use crumple_sim::scenario::Scenario;
use crumple_sim::scenario::file::load_all;
use crumple_verify::reach::{BoxDimension, PartitionCell};
use crumple_verify::{Certificate, ReachClaim, Statement};
use proptest::prelude::*;

use crate::generate::{any_scenario, any_test_case, first_values};

const INPUTS_PER_TARGET: usize = 200;

/// A folder, complete or unfinished, and up to three changes of its files, of four bytes each.
fn folder_changes() -> Vec<Vec<u8>> {
    first_values(
        INPUTS_PER_TARGET,
        &prop::collection::vec(any::<u8>(), 0..14),
    )
    .collect()
}

fn networks() -> Vec<Vec<u8>> {
    let files = fs::read_dir(root().join("corpora/controllers"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let files = files.filter(|path| {
        path.extension()
            .is_some_and(|extension| extension == "onnx" || extension == "zip")
    });
    let small = files
        .map(|path| fs::read(path).unwrap())
        .filter(|bytes| bytes.len() < 4096);
    small
        .flat_map(|bytes| [bytes.clone(), bytes[..bytes.len() / 2].to_vec()])
        .collect()
}

fn descriptions() -> Vec<Vec<u8>> {
    let texts = [
        include_str!("../../examples/controllers/fmu/modelDescription.xml"),
        include_str!("fmus/odd.xml"),
    ];
    let cuts = |text: &'static str| {
        text.match_indices('<')
            .map(move |(place, _)| text.as_bytes()[..place].to_vec())
    };
    texts
        .into_iter()
        .flat_map(|text| cuts(text).chain([text.as_bytes().to_vec()]))
        .collect()
}

/// The seeds, cut before each element.
fn openscenario_files() -> Vec<Vec<u8>> {
    let seeds = fs::read_dir(root().join("corpora/fuzz/openscenario"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let cuts = |text: String| {
        text.match_indices('<')
            .map(|(place, _)| text.as_bytes()[..place].to_vec())
            .collect()
    };
    seeds
        .flat_map(|path| -> Vec<_> { cuts(fs::read_to_string(path).unwrap()) })
        .collect()
}

/// Writes `fuzz/fresh/TARGET/NUMBER`.
#[test]
#[ignore = "writes files; fuzz/renew-seeds runs it"]
fn fresh_seeds() {
    for (target, _) in TARGETS {
        let inputs = match target {
            "scenario" => scenarios(TEST_CASE_BYTES),
            "lanes" => scenarios(LANE_CASE_BYTES),
            "scenario_file" => scenario_files(),
            "policy_file" => policy_files(),
            "network_file" => networks(),
            "fmu_file" => descriptions(),
            "certificate" => certificates(),
            "recording" => recordings(),
            "openscenario" => openscenario_files(),
            "binary_recording" | "dbc_file" => committed_mdf_files(target),
            "stl" => formulas(),
            "work_folder" => folder_changes(),
            other => panic!("nothing is generated for {other}"),
        };
        let folder = root().join("fuzz/fresh").join(target);
        fs::create_dir_all(&folder).unwrap();
        for (number, input) in inputs.iter().enumerate() {
            fs::write(folder.join(number.to_string()), input).unwrap();
        }
    }
}

/// Files of other tools, with the extension that the target reads.
fn committed_mdf_files(target: &str) -> Vec<Vec<u8>> {
    let extension = if target == "dbc_file" { "dbc" } else { "mf4" };
    let entries = fs::read_dir(root().join("corpora/recordings/mdf")).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths
        .filter(|path| path.extension().is_some_and(|actual| actual == extension))
        .map(|path| fs::read(path).unwrap())
        .collect()
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn corpus_scenarios() -> Vec<(PathBuf, Scenario)> {
    load_all(&root().join("corpora/scenarios"), &NoDriverFiles).unwrap()
}

/// Up to the length of a test case; missing bytes are nominal.
fn scenarios(bytes: usize) -> Vec<Vec<u8>> {
    first_values(
        INPUTS_PER_TARGET,
        &prop::collection::vec(any::<u8>(), 0..=bytes),
    )
    .collect()
}

fn scenario_files() -> Vec<Vec<u8>> {
    let kept = corpus_scenarios()
        .into_iter()
        .map(|(path, _)| fs::read(path).unwrap());
    let strategy = any_scenario();
    let generated =
        first_values(INPUTS_PER_TARGET, &strategy).zip(ScenarioFormat::ALL.into_iter().cycle());
    kept.chain(generated.map(|(scenario, format)| format.to_text(&scenario).into_bytes()))
        .collect()
}

/// Small networks; a trained one is too large for a seed.
fn policy_files() -> Vec<Vec<u8>> {
    let reference = Policy::reference();
    let hidden = prop::collection::vec(1_usize..4, 0..3);
    let header = (hidden, 0.5..100.0, -8.0..0.0, 0.0..3.0, 1_u32..50).prop_map(
        move |(hidden, limit, low_mps2, high_mps2, steps)| {
            let mut header = PolicyHeader {
                version: POLICY_VERSION,
                hidden,
                ..reference.header().clone()
            };
            header.observation.limit = limit;
            (header.action.low_mps2, header.action.high_mps2) = (low_mps2, high_mps2);
            (header.decision_interval_s, header.training) =
                (0.01 * f64::from(steps), serde_json::Value::Null);
            header
        },
    );
    let policy =
        (header, prop::collection::vec(-2.0_f32..2.0, 64)).prop_map(|(header, weights)| {
            let sizes: Vec<usize> = [STATE_LEN]
                .into_iter()
                .chain(header.hidden.iter().copied())
                .chain([1])
                .collect();
            let mut network = Network::zeros(&sizes);
            network
                .parameters_mut()
                .iter_mut()
                .zip(weights.iter().cycle())
                .for_each(|(to, from)| *to = *from);
            Policy::new(header, network).and_then(|policy| policy.to_bytes())
        });
    first_values(INPUTS_PER_TARGET, &policy).flatten().collect()
}

/// Certificates of kept or generated scenarios, the shipped kernels, and a box under the reference policy.
fn certificates() -> Vec<Vec<u8>> {
    let kept = corpus_scenarios().into_iter().map(|(_, scenario)| scenario);
    let strategy = any_scenario();
    let generated = first_values(INPUTS_PER_TARGET, &strategy);
    let proved = kept
        .chain(generated)
        .filter_map(|scenario| prove(&scenario));
    let kernels = shipped_kernels()
        .into_iter()
        .map(|(_, certificate)| certificate);
    let reach = reach_certificates();
    proved
        .chain(kernels)
        .chain(reach)
        .map(|certificate| serde_json::to_vec(&certificate).unwrap())
        .collect()
}

/// The first seconds of a box under the reference policy, short enough for the target to check.
fn reach_certificates() -> Vec<Certificate> {
    let paper_2 = fs::read_to_string(root().join("corpora/boxes/paper-2.toml")).unwrap();
    let plan = ReachPlan::new(
        Policy::reference(),
        &BoxSpec::from_toml(&paper_2, Path::new("paper-2.toml")).unwrap(),
    )
    .unwrap();
    let whole = plan.partition(0, &Quiet).unwrap().certificate;
    let Statement::Reach(claim) = &whole.statement else {
        panic!("a statement about reach")
    };
    let middle = [16.0, 16.0, 25.0, 25.0, 25.0, 3.0, 7.5, 120.0];
    let parts = [
        vec![PartitionCell::Verified],
        vec![
            PartitionCell::Cut(BoxDimension::LeaderBrakeMps2),
            PartitionCell::Verified,
            PartitionCell::Undecided,
        ],
        vec![PartitionCell::Falsified(middle)],
    ];
    let stating = |(partition, steps)| {
        let statement = Statement::Reach(ReachClaim {
            partition,
            steps,
            ..claim.clone()
        });
        Certificate {
            statement,
            ..whole.clone()
        }
    };
    parts
        .into_iter()
        .flat_map(|part| [100, 200].map(|steps| stating((part.clone(), steps))))
        .collect()
}

fn prove(scenario: &Scenario) -> Option<Certificate> {
    match avoid(scenario, AvoidOptions::default()).ok()?.verdict {
        AvoidanceVerdict::Unavoidable(proof) => Some(*proof),
        AvoidanceVerdict::Avoidable(escape) => certify(scenario, &escape).ok(),
        AvoidanceVerdict::Undecided(_) => None,
    }
}

/// Simulated drives in both input formats, and the beginning of the committed recording.
fn recordings() -> Vec<Vec<u8>> {
    let kept = fs::read_to_string(root().join("corpora/recordings/synthetic-platoon.csv")).unwrap();
    let beginning: String = kept.split_inclusive('\n').take(40).collect();
    let strategy = any_test_case();
    let simulated = first_values(INPUTS_PER_TARGET, &strategy)
        .flat_map(|test_case| [open_acc_csv(&test_case), car_following_csv(&test_case)]);
    [beginning]
        .into_iter()
        .chain(simulated)
        .map(String::into_bytes)
        .collect()
}

/// Samples a test case at up to 10 Hz: time, speeds and gaps.
fn sample_run(test_case: &TestCase) -> Vec<(f64, Vec<f64>, Vec<f64>)> {
    let options = test_case.setup.options(test_case.scenario.spec().step_s);
    let run = Run::new(&test_case.scenario, options).unwrap();
    let trace = simulate(&run, RecordingLevel::Trace).trace.unwrap();
    let every = (0.1 / run.dt_s()).round().max(1.0) as usize;
    let sample = |k: usize| {
        let speeds = trace
            .vehicles
            .iter()
            .map(|track| track.speed_mps[k])
            .collect();
        let gaps = (1..trace.vehicles.len())
            .filter_map(|rear| Some(trace.pairs(rear).first()?.gaps_m().nth(k)?.1))
            .collect();
        (trace.time_s[k], speeds, gaps)
    };
    (0..trace.len())
        .step_by(every)
        .take(60)
        .map(sample)
        .collect()
}

fn join_numbers(numbers: &[f64]) -> String {
    numbers
        .iter()
        .map(|number| format!("{number:.3}"))
        .collect::<Vec<_>>()
        .join(",")
}

fn open_acc_csv(test_case: &TestCase) -> String {
    let vehicles = test_case.scenario.vehicles().len();
    let names: Vec<String> = (1..=vehicles).map(|n| format!("V{n}")).collect();
    let columns = (1..=vehicles)
        .map(|n| format!("Speed{n}"))
        .chain((1..vehicles).map(|n| format!("IVS{n}")));
    let head = format!(
        "Date,1,1,2026\nVehicle_order,{},\nNumber_of_vehicles,{vehicles}\nACC,1\nDistance_setting,S\nTime,{}\n",
        names.join(","),
        columns.collect::<Vec<_>>().join(",")
    );
    let rows = sample_run(test_case).into_iter().map(|(t, speeds, gaps)| {
        format!("{t:.2},{},{}\n", join_numbers(&speeds), join_numbers(&gaps))
    });
    head + &rows.collect::<String>()
}

fn car_following_csv(test_case: &TestCase) -> String {
    let head =
        "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n".to_owned();
    let rows = sample_run(test_case).into_iter().map(|(t, speeds, gaps)| {
        let [leader, follower] = [speeds[0], speeds[1]];
        format!(
            "1,{t:.2},{}\n",
            join_numbers(&[gaps[0], follower, leader - follower, leader])
        )
    });
    head + &rows.collect::<String>()
}

/// Formulas over names that the target knows.
fn formulas() -> Vec<Vec<u8>> {
    let formula = prop::collection::vec(any::<u8>(), 0..80).prop_map(|bytes| {
        crumple_fuzzing::formula_from_bytes(&bytes, &["x", "gap1_m", "v0_mps"], 0.1).unwrap()
    });
    first_values(INPUTS_PER_TARGET, &formula)
        .map(|formula| formula.to_string().into_bytes())
        .collect()
}
