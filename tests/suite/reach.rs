//! Proofs about external networks hold in the simulator.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_evidence::{BoxSpec, ReachPlan, check_binding};
use crumple_networks::network::{Elementwise, FeedForward, Linear, NetworkFile, NetworkStep};
use crumple_networks::{
    HistoryPadding, InputMapping, Mapping, NetworkController, OutputMapping, Squash,
};
use crumple_sim::control::{BuiltInController, ControllerSource, IntoSource, ObservedQuantity};
use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunOptions, Trace, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::Driver;
use crumple_verify::reach::{
    BoxDimension, InitialRanges, NeuralController, PartitionCell, ReachProblem, reach_with_tube,
};
use crumple_verify::{Certificate, ProvedClaim, Statement, WorkLimit, check_with};
use rand::rngs::Xoshiro256PlusPlus;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};

use crate::command_line::{assert_prints, assert_refused, exit_code, run_crumple, stderr, stdout};
use crate::networks::{controller_corpus, find_source, folder_with};

fn box_spec(scenario: &str, ranges: &str) -> BoxSpec {
    let text = format!("version = 1\nscenario = \"{scenario}\"\n[ranges]\n{ranges}");
    BoxSpec::from_toml(&text, Path::new("box.toml")).unwrap()
}

fn random_product(
    before: usize,
    after: usize,
    gain: f32,
    random: &mut Xoshiro256PlusPlus,
) -> NetworkStep {
    let scale = gain * (3.0 / before as f32).sqrt();
    let weights = (0..before * after)
        .map(|_| scale * random.random_range(-1.0..1.0_f32))
        .collect();
    let biases = (0..after)
        .map(|_| 0.3 * random.random_range(-1.0..1.0_f32))
        .collect();
    NetworkStep::Linear(Linear { weights, biases })
}

fn any_elementwise(width: usize, random: &mut Xoshiro256PlusPlus) -> NetworkStep {
    let mut operands = |low: f32, high: f32| -> Vec<f32> {
        (0..width).map(|_| random.random_range(low..high)).collect()
    };
    let (some, away_from_0) = (operands(-1.0, 1.0), operands(0.5, 2.0));
    let number = some[0];
    NetworkStep::Elementwise(match random.random_range(0..9_u32) {
        0 => Elementwise::Relu,
        1 => Elementwise::LeakyRelu {
            slope: 0.5 * number,
        },
        2 => Elementwise::Elu {
            alpha: number.abs(),
        },
        3 => Elementwise::Tanh,
        4 => Elementwise::Sigmoid,
        5 => Elementwise::Add(some),
        6 => Elementwise::Multiply(some),
        7 => Elementwise::Divide(away_from_0),
        _ => Elementwise::Clip {
            low: vec![number - 0.5; width],
            high: vec![number + 0.5; width],
        },
    })
}

fn any_network(random: &mut Xoshiro256PlusPlus) -> NetworkController {
    use ObservedQuantity as Q;
    let quantities = [
        (Q::GapAheadM, 16.0),
        (Q::GapBehindM, 16.0),
        (Q::SpeedMps, 12.5),
        (Q::SpeedAheadMps, 12.5),
        (Q::SpeedBehindMps, 12.5),
        (Q::AccelerationMps2, 5.0),
        (Q::AccelerationAheadMps2, 5.0),
        (Q::AccelerationBehindMps2, 5.0),
        (Q::RelativeSpeedAheadMps, 5.0),
        (Q::RelativeSpeedBehindMps, 5.0),
        (Q::IsAhead, 1.0),
        (Q::IsBehind, 1.0),
    ];
    let inputs: Vec<InputMapping> = (0..random.random_range(2..9_usize))
        .map(|corner| {
            let (quantity, size) = *quantities.choose(random).expect("some");
            let is_constant = corner == 0;
            InputMapping {
                quantity: (!is_constant).then_some(quantity),
                variable: None,
                constant: is_constant.then_some(1.4),
                offset: size * random.random_range(0.0..1.0),
                scale: if random.random_bool(0.8) { size } else { -size },
                low: if random.random_bool(0.5) { -1e6 } else { -1.5 },
                high: if random.random_bool(0.5) { 1e6 } else { 1.2 },
                absent: None,
            }
        })
        .collect();
    let (mut steps, mut width) = (Vec::new(), inputs.len());
    for depth in 0..random.random_range(1..4_u32) {
        if depth > 0 {
            steps.push(any_elementwise(width, random));
        }
        let after = random.random_range(1..14);
        steps.push(random_product(
            width,
            after,
            random.random_range(0.3..1.2),
            random,
        ));
        width = after;
    }
    if random.random_bool(0.5) {
        steps.push(any_elementwise(width, random));
    }
    let mapping = Mapping {
        decision_interval_s: Some(*[0.05, 0.1, 0.1, 0.25].choose(random).expect("some")),
        history: 1,
        history_padding: HistoryPadding::First,
        newest_first: false,
        output: OutputMapping {
            variable: None,
            answer: Some(random.random_range(0..width)),
            squash: random.random_bool(0.5).then_some(Squash::Tanh),
            scale_mps2: 5.25,
            offset_mps2: -2.25,
            low_mps2: if random.random_bool(0.5) { -7.5 } else { -5.0 },
            high_mps2: 3.0,
        },
        inputs,
    };
    let mut file = NetworkFile::load(&controller_corpus().join("reference.onnx")).unwrap();
    file.network = FeedForward::new(mapping.inputs.len(), steps).unwrap();
    NetworkController::new(file, mapping).unwrap_or_else(|error| panic!("{error}"))
}

fn random_point(ranges: &InitialRanges, random: &mut Xoshiro256PlusPlus) -> [f64; 8] {
    BoxDimension::ALL.map(|dimension| {
        let range = ranges.get(dimension);
        (range.low() + random.random::<f64>() * (range.high() - range.low()))
            .clamp(range.low(), range.high())
    })
}

fn observed_values(trace: &Trace, k: usize) -> Vec<(usize, f64)> {
    let [leader, ego, rest @ ..] = trace.vehicles.as_slice() else {
        panic!("two at least")
    };
    let before = |a: &[f64]| k.checked_sub(1).map_or(0.0, |before| a[before]);
    let mut seen = vec![
        (
            0,
            leader.position_m[k] - leader.length_m - ego.position_m[k],
        ),
        (2, leader.speed_mps[k]),
        (3, ego.speed_mps[k]),
        (5, before(&leader.acceleration_mps2)),
        (6, before(&ego.acceleration_mps2)),
    ];
    if let [follower] = rest {
        seen.push((1, ego.position_m[k] - ego.length_m - follower.position_m[k]));
        seen.push((4, follower.speed_mps[k]));
        seen.push((7, before(&follower.acceleration_mps2)));
    }
    seen
}

#[derive(Debug, Default)]
struct ReachComparison {
    verified: usize,
    falsified: usize,
    numbers: usize,
}

impl ReachComparison {
    /// The checker accepts the certificate, every trajectory is in the tube, no gap is below the bound, and falsified
    /// states collide.
    fn compare_plan(
        &mut self,
        plan: &ReachPlan,
        options: &RunOptions,
        random: &mut Xoshiro256PlusPlus,
        seed: u64,
    ) {
        let partition = plan.partition(2, &Quiet).unwrap();
        let accepted = check_with(
            &partition.certificate,
            Some(plan.policy_bytes()),
            WorkLimit::default(),
        );
        assert!(
            matches!(accepted, Ok(ProvedClaim::Reach { .. })),
            "{seed}: {accepted:?}"
        );
        check_binding(
            &partition.certificate,
            Some(plan.policy_bytes()),
            Controllers::default(),
        )
        .unwrap();
        let actor = NeuralController::from_bytes(plan.policy_bytes()).unwrap();
        let Statement::Reach(claim) = &partition.certificate.statement else {
            panic!("reach")
        };
        let whole = claim.problem(&actor).unwrap();
        for (cell, ranges, _) in claim.leaves().unwrap() {
            if let PartitionCell::Falsified(point) = cell {
                self.falsified += 1;
                let run = Run::new(&plan.scenario_at(&point).unwrap(), options.clone()).unwrap();
                assert_ne!(
                    simulate(&run, RecordingLevel::Summary).outcome,
                    Outcome::NoCollision,
                    "{seed}"
                );
            }
            let scene = ReachProblem {
                ranges,
                stop_when_undecided: false,
                ..whole.clone()
            };
            let (_, tube) = reach_with_tube(&scene);
            for _ in 0..4 {
                let scenario = plan.scenario_at(&random_point(&ranges, random)).unwrap();
                let run = simulate(
                    &Run::new(&scenario, options.clone()).unwrap(),
                    RecordingLevel::Trace,
                );
                let trace = run.trace.as_ref().expect("recorded");
                if cell == PartitionCell::Verified {
                    self.verified += 1;
                    assert_eq!(run.outcome, Outcome::NoCollision, "{seed}");
                    let gaps = (0..trace.time_s.len()).flat_map(|k| observed_values(trace, k));
                    let least = gaps
                        .filter(|(number, _)| *number < 2)
                        .map(|(_, gap)| gap)
                        .fold(f64::INFINITY, f64::min);
                    assert!(least >= claim.min_gap_m_at_least - 1e-8, "{seed}: {least}");
                }
                let Some(tube) = &tube else { continue };
                for (decision, bounds) in tube.iter().enumerate() {
                    let k = decision * scene.decision_steps as usize;
                    if k + 1 >= trace.time_s.len() && run.outcome != Outcome::NoCollision
                        || k >= trace.time_s.len()
                    {
                        break;
                    }
                    for (number, seen) in observed_values(trace, k) {
                        let bound = bounds[number];
                        let inside = bound.low() - 1e-7 <= seen && seen <= bound.high() + 1e-7;
                        assert!(
                            inside,
                            "{seed}: number {number} at decision {decision}: {seen} not in {bound:?}"
                        );
                        self.numbers += 1;
                    }
                }
            }
        }
    }
}

fn any_box(seed: u64, random: &mut Xoshiro256PlusPlus) -> BoxSpec {
    let size = [0.0, 0.05, 0.3][seed as usize % 3];
    let ranges = format!(
        "gap_ahead_m = {{ low = {}, high = 16.1 }}\nego_speed_mps = {{ low = 24.9, high = {} }}",
        16.0 - size,
        24.9 + size
    );
    let scenario = if random.random_bool(0.5) {
        "paper-1"
    } else {
        "paper-2"
    };
    let followers = ["baseline", "idm", "acc-aeb"].map(BuiltInController::from_name);
    let follower_drives = followers[seed as usize % 4 % 3]
        .clone()
        .map(Driver::Controller);
    BoxSpec {
        follower_drives,
        ..box_spec(scenario, &ranges)
    }
}

/// Compares the proofs about random controllers with their runs.
fn compare_controllers(
    seeds: u64,
    make: impl Fn(u64, &mut Xoshiro256PlusPlus) -> (Arc<dyn ControllerSource>, BoxSpec),
) -> ReachComparison {
    let mut compared = ReachComparison::default();
    for seed in 0..seeds {
        let random = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
        let (controller, spec) = make(seed, random);
        let options = RunOptions::new(controller.clone()).with_estimator(EstimatorKind::Truth);
        let plan =
            ReachPlan::new(controller, &spec).unwrap_or_else(|error| panic!("{seed}: {error}"));
        compared.compare_plan(&plan, &options, random, seed);
    }
    println!("{compared:?}");
    assert!(
        compared.verified > 10 && compared.falsified > 0 && compared.numbers > 50_000,
        "{compared:?}"
    );
    compared
}

#[test]
fn runs_of_external_networks_stay_within_proved_bounds() {
    let compared = compare_controllers(60, |seed, random| {
        let network = Arc::new(any_network(random));
        (network.into_source(), any_box(seed, random))
    });
    assert!(compared.falsified > 10, "{compared:?}");
}

/// The file format of the reference policy does not matter, except that the last tanh is applied a step earlier.
#[test]
fn a_policy_exported_to_onnx_has_the_same_proof() {
    let spec = box_spec(
        "paper-2",
        "gap_ahead_m = { low = 15.5, high = 16.5 }\nonset_s = { low = 1.0, high = 1.1 }",
    );
    let claims = [
        Policy::reference().into_source(),
        find_source("reference.onnx"),
    ]
    .map(|kind| {
        let plan = ReachPlan::new(kind, &spec).unwrap();
        let certificate = plan.partition(4, &Quiet).unwrap().certificate;
        check_with(
            &certificate,
            Some(plan.policy_bytes()),
            WorkLimit::default(),
        )
        .unwrap();
        let Statement::Reach(claim) = certificate.statement else {
            panic!("reach")
        };
        claim
    });
    let [own, outside] = claims;
    assert_eq!(own.partition, outside.partition);
    assert_eq!(own.verified_share_at_least, outside.verified_share_at_least);
    assert!(
        (own.min_gap_m_at_least - outside.min_gap_m_at_least).abs() < 1e-5,
        "{own:?} {outside:?}"
    );
    assert!(own.verified_share_at_least > 0.99 && own.source.is_none() && outside.source.is_some());
}

#[test]
fn networks_are_proved_and_checked_on_the_command_line() {
    let folder = folder_with(&["acc-5x20.onnx"]);
    let text = "version = 1
scenario = \"paper-1\"\n[ranges]\ngap_ahead_m = { low = 15.99, high = 16.01 }";
    std::fs::write(folder.path().join("box.toml"), text).unwrap();
    let shown = |path: PathBuf| path.display().to_string();
    let run = |words: &str| run_crumple(folder.path(), words);
    for name in ["acc.toml", "leaky-40-clip.onnx", "td3.zip"] {
        let source = shown(controller_corpus().join(name));
        let made = run(&format!(
            "verify reach --controller '{source}' --box box.toml --depth 2 --certificate c.json"
        ));
        let nothing = format!("{}{}", stdout(&made), stderr(&made)).contains("nothing verified");
        assert_eq!(
            exit_code(&made),
            i32::from(nothing),
            "{name}: {}",
            stderr(&made)
        );
        for policy in [String::new(), format!("--policy '{source}'")] {
            let passages = [
                "accepted: reach",
                "read from a file in the format",
                "as crumple read it",
            ];
            assert_prints(&run(&format!("check c.json {policy}")), 0, &passages);
        }
        let other = shown(controller_corpus().join("reference.onnx"));
        assert_prints(
            &run(&format!("check c.json --policy '{other}'")),
            1,
            &["has SHA-256"],
        );
        let text = std::fs::read_to_string(folder.path().join("c.json")).unwrap();
        let certificate = Certificate::from_json(&text).unwrap();
        let path = folder
            .path()
            .join(certificate.policy_reference().expect("of a network").0);
        let mut bytes = std::fs::read(&path).unwrap();
        let last = bytes.len() - 2;
        bytes[last] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert_prints(&run("check c.json"), 1, &["has SHA-256"]);
    }
    let acc = std::fs::read_to_string(controller_corpus().join("acc.toml")).unwrap();
    let with = |name: &str, from: &str, to: &str| {
        assert!(acc.contains(from), "{from}");
        std::fs::write(folder.path().join(name), acc.replace(from, to)).unwrap();
    };
    with("time-gap.toml", "\"gap_ahead_m\"", "\"time_gap_ahead_s\"");
    with(
        "memory.toml",
        "quantity = \"speed_mps\"",
        "quantity = \"last_answer_mps2\"",
    );
    with("hard.toml", "low_mps2 = -7.5", "low_mps2 = -9.0");
    let stacked = shown(controller_corpus().join("stacked.toml"));
    for (controller, words) in [
        (
            "time-gap.toml",
            "inputs[3].quantity: `time_gap_ahead_s` is a quotient of what is observed",
        ),
        (
            "memory.toml",
            "inputs[2].quantity: `last_answer_mps2` is memory",
        ),
        (
            stacked.as_str(),
            "history: is 3, and only a network that sees nothing but the present",
        ),
        (
            "hard.toml",
            "hard.toml:30: cannot be verified: output.low_mps2: commands up to -9 m/s², and the limits of the vehicle \
             are -7.5 to 3",
        ),
        ("idm", "must be a policy of crumple or a network"),
        ("shield:policy", "must be a policy of crumple or a network"),
        ("exec:true", "`true` ended by itself with exit code 0"),
    ] {
        assert_refused(
            &run(&format!(
                "verify reach --controller '{controller}' --box box.toml"
            )),
            words,
        );
    }
}
