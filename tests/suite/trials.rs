//! The oracles that suite and fuzzer ask notice what is wrong, and what the fuzzer once found stays found.

use std::fs;
use std::path::{Path, PathBuf};

use crumple::estimate::Observation;
use crumple::measure::stl::{Formula, MonitorError, Signals};
use crumple::scenario::Scenario;
use crumple::scenario::file::FileError;
use crumple::sim::{self, Keep, Outcome, Run, RunOptions, Simulated, Stress, UnderTest, simulate};
use crumple::trial::oracle::{
    engines_agree, estimates_are_sane, files_keep_scenarios, impacts_are_inelastic, monitor_agrees, motion_is_physical,
    nobody_does_the_impossible, one_story, shield_keeps_clear, step_size_decides_nothing,
};
use crumple::trial::targets::{self, TARGETS};
use crumple::trial::{Crumple, FileFormat, Hunt, ORACLES, Oracle, Sight, System, TRIAL_BYTES, Trial, behaviour};
use crumple::worst_case::Avoidance;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner};

use crate::generate::{any_trial, ask, bytes, cases};

/// Where the corpora of the fuzz targets are.
fn seeds_of(target: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/fuzz").join(target);
    let entries = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    // What a local fuzzer added is named by its hash, and is not committed.
    let is_committed = |path: &PathBuf| path.file_name().is_some_and(|name| name.len() != 40);
    let mut seeds: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).filter(is_committed).collect();
    seeds.sort();
    seeds
}

/// Every committed seed of every target passes.
#[test]
fn committed_seeds_pass() {
    for (name, target) in TARGETS {
        let seeds = seeds_of(name);
        assert!(seeds.len() >= 5, "{name} has {} seeds", seeds.len());
        for seed in seeds {
            let bytes = fs::read(&seed).expect("readable");
            if let Err(violation) = target(&bytes) {
                panic!("{}: {violation}", seed.display());
            }
        }
    }
}

/// Most oracles decide most trials: what rounding decides is the exception.
#[test]
fn hardly_any_trial_is_left_undecided() {
    let mut runner = TestRunner::deterministic();
    let strategy = bytes(TRIAL_BYTES);
    let answers = (0..64).map(|_| targets::decided(&strategy.new_tree(&mut runner).unwrap().current()).unwrap());
    let decided: usize = answers.sum();
    let asked = 64 * ORACLES.len();
    assert!(decided >= asked - 6, "{decided} of {asked} answers");
}

proptest! {
    #![proptest_config(cases(256))]

    /// Full throttle behind a shield keeps clear of the vehicle ahead.
    #[test]
    fn a_shield_keeps_clear(trial in any_trial()) {
        ask(&trial, shield_keeps_clear)?;
    }

    /// No controller survives what is unavoidable, or keeps a larger gap than anybody could.
    #[test]
    fn no_controller_does_the_impossible(trial in any_trial()) {
        ask(&trial, nobody_does_the_impossible)?;
    }
}

/// The program with something wrong in it.
struct Wrong(Fault);

/// What is wrong with a system.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    /// Contact is looked for between front bumpers.
    GapSign,
    /// Vehicles that brake to standstill reverse.
    NoStandstill,
    /// Noise and controllers act at the integration step.
    NoiseOnSubsteps,
    /// A run's result in a batch is its neighbour's.
    BatchOffByOne,
    /// A run in a batch takes the noise of another seed.
    BatchSeed,
    /// The batch engine's first sample is lost.
    BatchSample,
    /// The struck vehicle keeps its speed.
    ElasticImpact,
    /// The run goes on, and reports nothing.
    ContactForgotten,
    /// The smallest gap is that at the samples only, of the pair behind.
    GapOfTheNext,
    /// Braking is reported without regard to the road.
    Limitless,
    /// Closing speed has the wrong sign.
    RateSign,
    /// Estimates may say that a vehicle reverses.
    Reversing,
    /// The second digit of a position is lost in the file.
    RoundedFile,
    /// Files forget the seed.
    SeedlessFile,
    /// "Always" begins a sample late.
    LateWindow,
    /// Nobody stands between full throttle and the brake.
    NoShield,
    /// The bound over all drivers is half of what it should be.
    HalfTheBound,
}

impl System for Wrong {
    fn simulate(&self, run: &Run<'_>, keep: Keep) -> Simulated {
        match self.0 {
            Fault::GapSign => {
                // A vehicle without length is touched 2 m or more too late.
                let short = run.scenario().edited(|spec| {
                    spec.vehicles.iter_mut().for_each(|vehicle| vehicle.length_m = Some(0.1));
                });
                let mut result = simulate(&Run::new(&short.unwrap(), run.options().clone()).unwrap(), keep);
                let vehicles = run.scenario().vehicles();
                if let Some(trace) = &mut result.trace {
                    trace.vehicles.iter_mut().zip(vehicles).for_each(|(track, v)| track.length_m = v.length_m());
                }
                result
            }
            Fault::NoiseOnSubsteps if run.substeps() > 1 => {
                let finer = run.scenario().edited(|spec| spec.step_s = run.dt_s());
                let options = RunOptions { dt_s: None, ..run.options().clone() };
                match finer.map(|finer| Run::new(&finer, options).map(|run| simulate(&run, keep))) {
                    Ok(Ok(result)) => result,
                    _ => simulate(run, keep),
                }
            }
            fault => damaged(fault, simulate(run, keep), run),
        }
    }

    fn simulate_batch(&self, runs: &[Run<'_>], keep: Keep) -> Vec<Simulated> {
        let mut results = sim::simulate_batch(runs, keep, |_, simulated| simulated);
        match self.0 {
            Fault::BatchOffByOne => results.rotate_left(1),
            Fault::BatchSeed => {
                let reseeded: Vec<Scenario> =
                    runs.iter().map(|run| run.scenario().edited(|spec| spec.seed ^= 4).unwrap()).collect();
                let runs: Vec<_> =
                    reseeded.iter().zip(runs).map(|(s, run)| Run::new(s, run.options().clone()).unwrap()).collect();
                results = sim::simulate_batch(&runs, keep, |_, simulated| simulated);
            }
            Fault::BatchSample => {
                for trace in results.iter_mut().filter_map(|result| result.trace.as_mut()) {
                    trace.time_s.remove(0);
                }
            }
            _ => {}
        }
        results
    }

    fn observe(&self, run: &Run<'_>, each: &mut dyn FnMut(&Sight<'_>) -> bool) {
        Crumple.observe(run, &mut |sight| {
            let Observation { speed_mps: own_mps, .. } = sight.seen;
            let mut seen = sight.seen;
            match (self.0, &mut seen.ahead) {
                (Fault::RateSign, Some(ahead)) => ahead.speed_mps = own_mps - (ahead.speed_mps - own_mps),
                (Fault::Reversing, _) if own_mps < 0.5 => seen.speed_mps = own_mps - 0.5,
                _ => {}
            }
            each(&Sight { seen, ..*sight })
        });
    }

    fn full_throttle(&self) -> UnderTest {
        if self.0 == Fault::NoShield { Stress::FullThrottle.into() } else { Crumple.full_throttle() }
    }

    fn avoid(&self, scenario: &Scenario) -> Option<Avoidance> {
        let mut avoidance = Crumple.avoid(scenario)?;
        if self.0 == Fault::HalfTheBound {
            avoidance.min_gap_bound_m = avoidance.min_gap_bound_m.map(|bound_m| 0.5 * bound_m);
        }
        Some(avoidance)
    }

    fn through_file(&self, scenario: &Scenario, format: FileFormat) -> Result<Scenario, FileError> {
        let back = Crumple.through_file(scenario, format)?;
        Ok(match self.0 {
            Fault::RoundedFile => back
                .edited(|spec| spec.vehicles[0].speed_mps = (spec.vehicles[0].speed_mps * 1e6).round() / 1e6)
                .unwrap_or(back),
            Fault::SeedlessFile => back.edited(|spec| spec.seed = 0).unwrap_or(back),
            _ => back,
        })
    }

    fn robustness_over_time(&self, formula: &Formula, signals: &Signals<'_>) -> Result<Vec<f64>, MonitorError> {
        let mut over_time = Crumple.robustness_over_time(formula, signals)?;
        if self.0 == Fault::LateWindow {
            over_time.rotate_left(1);
        }
        Ok(over_time)
    }
}

/// A result with something wrong in it.
fn damaged(fault: Fault, mut result: Simulated, run: &Run<'_>) -> Simulated {
    let Some(trace) = &mut result.trace else { return result };
    match fault {
        Fault::NoStandstill => {
            for track in &mut trace.vehicles {
                for k in 1..track.speed_mps.len() {
                    let dt_s = trace.time_s[k] - trace.time_s[k - 1];
                    let through_mps = track.speed_mps[k - 1] + track.acceleration_mps2[k - 1] * dt_s;
                    if track.speed_mps[k] == 0.0 && through_mps < 0.0 {
                        track.speed_mps[k] = through_mps;
                    }
                }
            }
        }
        Fault::ElasticImpact => {
            if let Some(impact) = result.impacts.first_mut() {
                impact.common_speed_mps = impact.contact.rear_speed_mps;
            }
        }
        Fault::ContactForgotten => {
            result.impacts.clear();
            result.outcome = Outcome::NoCollision;
        }
        Fault::GapOfTheNext => {
            let rears = result.vehicles.len() - 1;
            for index in 1..rears {
                result.vehicles[index].min_gap_m = result.vehicles[index + 1].min_gap_m;
            }
        }
        Fault::Limitless => {
            let friction = run.scenario().spec().environment.friction;
            for track in &mut trace.vehicles {
                track.acceleration_mps2.iter_mut().for_each(|a| *a = a.min(*a / friction));
            }
        }
        _ => {}
    }
    result
}

/// Every oracle notices what it is there to notice, when the suite asks it and when the fuzz target does.
#[test]
fn every_oracle_bites() {
    let wrong: [(Fault, Oracle); 17] = [
        (Fault::GapSign, one_story),
        (Fault::NoStandstill, motion_is_physical),
        (Fault::NoiseOnSubsteps, step_size_decides_nothing),
        (Fault::BatchOffByOne, engines_agree),
        (Fault::BatchSeed, engines_agree),
        (Fault::BatchSample, engines_agree),
        (Fault::ElasticImpact, impacts_are_inelastic),
        (Fault::ContactForgotten, monitor_agrees),
        (Fault::GapOfTheNext, one_story),
        (Fault::Limitless, one_story),
        (Fault::RateSign, estimates_are_sane),
        (Fault::Reversing, estimates_are_sane),
        (Fault::RoundedFile, files_keep_scenarios),
        (Fault::SeedlessFile, files_keep_scenarios),
        (Fault::LateWindow, monitor_agrees),
        (Fault::NoShield, shield_keeps_clear),
        (Fault::HalfTheBound, nobody_does_the_impossible),
    ];
    for (fault, oracle) in wrong {
        let system = Wrong(fault);
        // As a property of the suite.
        let config = ProptestConfig { failure_persistence: None, max_shrink_iters: 0, cases: 256, ..cases(256) };
        let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
        let property = runner.run(&any_trial(), |trial| {
            trial.ask(oracle, &system).map(drop).map_err(|violation| TestCaseError::fail(violation.to_string()))
        });
        assert!(matches!(property, Err(TestError::Fail(..))), "the suite misses {fault:?}");
        // As the fuzz target asks it.
        let mut runner = TestRunner::deterministic();
        let strategy = bytes(TRIAL_BYTES);
        // Some faults show in few of all scenarios: that of the bound only where nothing is noisy and nobody collides.
        let mut inputs = (0..4096).map(|_| strategy.new_tree(&mut runner).unwrap().current());
        assert!(
            inputs.any(|bytes| Trial::of_bytes(&bytes).examine(&system).is_err()),
            "the fuzz target misses {fault:?}"
        );
    }
}

/// A violation says what was found and how to see it again, in a file that can be read and run.
#[test]
fn a_violation_brings_a_scenario_file() {
    let trial = Trial::of_bytes(&[]);
    let violation = trial.ask(one_story, &Wrong(Fault::ContactForgotten)).expect_err("must be noticed");
    let path = Path::new("reproducer.toml");
    let read = crumple::scenario::file::from_toml(&violation.reproducer, path).expect("a scenario file");
    assert_eq!(read, trial.scenario);
    assert!(violation.reproducer.starts_with("# crumple simulate THIS-FILE.toml --controller baseline\n"));
    assert!(violation.to_string().contains("tell one story"), "{violation}");
}

/// A hunt keeps one scenario file for each kind of collision, which collides when it is run, and tells the fuzzer
/// something of every run.
#[test]
fn a_hunt_keeps_collisions_as_scenario_files() {
    let folder = tempfile::tempdir().expect("a place for temporary files");
    let hunt = Hunt::new("baseline", Some(folder.path())).expect("built in");
    for input in [&[][..], &[0], &[3], &[0; 100]] {
        let features = hunt.take(input).expect("no law is broken");
        assert!(!features.is_empty() && features.iter().all(|&feature| feature < behaviour::FEATURES));
    }
    let mut files = crumple::scenario::file::load_all(folder.path()).expect("scenario files");
    assert_eq!(files.len(), 2, "the paper's scenario 1 once, and scenario 3");
    let (path, scenario) = files.remove(0);
    assert_eq!(path.file_name().unwrap(), "baseline-1-of-3-hit-by-baseline-at-10-mps.toml");
    let baseline = crumple::scenario::ControllerSpec::named("baseline").unwrap();
    let run = Run::new(&scenario, RunOptions::new(baseline)).unwrap();
    assert!(simulate(&run, Keep::Summary).outcome.contact().is_some());
    assert!(Hunt::new("nobody", None).is_err());
}
