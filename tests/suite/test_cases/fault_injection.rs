//! Every oracle detects the fault that it is meant to detect, in programs with one fault each.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::LazyLock;

use crumple_fuzzing::oracle::{
    avoidability_bound_holds, engines_agree, estimates_within_bounds, files_round_trip,
    impacts_are_inelastic, metrics_agree, monitor_agrees, motion_is_physical,
    shield_prevents_front_collisions, step_size_changes_nothing,
};
use crumple_fuzzing::{
    Crumple, Invariant, ORACLES, ObservationSample, OracleFn, ScenarioFormat, System,
    TEST_CASE_BYTES, TestCase,
};
use crumple_measure::CollisionRole;
use crumple_measure::stl::{Formula, MonitorError, SampledSignals};
use crumple_search::worst_case::{self, Avoidance};
use crumple_sim::control::{BuiltInController, ControllerSource, IntoSource};
use crumple_sim::engine::{
    self, Collision, Outcome, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
use crumple_sim::observation::Observation;
use crumple_sim::scenario::Scenario;
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_verify::Certificate;
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner};

use crate::generate::{any_bytes, any_test_case, first_values, with_cases};

/// A proof about another subject.
static PROOF: LazyLock<Certificate> = LazyLock::new(|| {
    Certificate::from_json(include_str!(
        "../../../corpora/fuzz/certificate/unavoidable"
    ))
    .expect("a certificate")
});

pub(super) struct FaultySystem(pub(super) Fault);

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Fault {
    /// Collisions are computed between front bumpers.
    GapSign,
    /// Vehicles that brake to standstill reverse.
    NoStandstill,
    /// Half of a sample's motion is sometimes missing.
    Leap,
    CoastingAccelerates,
    /// Noise and controllers act at the integration step.
    NoiseOnSubsteps,
    /// A run in a batch returns its neighbour's result.
    BatchOffByOne,
    /// A run in a batch uses the noise of another seed.
    BatchSeed,
    /// The batch engine loses its first sample.
    BatchSample,
    /// The struck vehicle keeps its speed.
    ElasticImpact,
    /// Vehicles separate after a collision.
    CollisionReleased,
    /// The run continues without reporting the collision.
    CollisionForgotten,
    /// The smallest gap is that at the samples only, of the pair behind.
    GapOfVehicleBehind,
    FrictionIgnored,
    /// The report swaps the striking and the struck vehicle.
    CollisionRoleSwapped,
    /// The closing speed has the wrong sign.
    RateSign,
    /// Estimated speeds may be negative.
    Reversing,
    /// Files lose the second digit of a position.
    RoundedFile,
    /// Files lose the seed.
    SeedlessFile,
    LateWindow,
    AlwaysSatisfied,
    NoShield,
    HalvedBound,
    AlwaysUnavoidable,
}

impl System for FaultySystem {
    fn simulate(&self, run: &Run, keep: RecordingLevel) -> SimulationResult {
        match self.0 {
            Fault::GapSign => {
                // Without the vehicle's length a collision is detected 2 m or more too late.
                let short = run.scenario().edited(|spec| {
                    spec.vehicles
                        .iter_mut()
                        .for_each(|vehicle| vehicle.length_m = Some(0.1));
                });
                let mut result = simulate(
                    &Run::new(&short.unwrap(), run.options().clone()).unwrap(),
                    keep,
                );
                let vehicles = run.scenario().vehicles();
                if let Some(trace) = &mut result.trace {
                    trace
                        .vehicles
                        .iter_mut()
                        .zip(vehicles)
                        .for_each(|(track, v)| track.length_m = v.length_m());
                }
                result
            }
            Fault::NoiseOnSubsteps if run.substeps() > 1 => {
                let finer = run.scenario().edited(|spec| spec.step_s = run.dt_s());
                let options = RunOptions {
                    dt_s: None,
                    ..run.options().clone()
                };
                match finer.map(|finer| Run::new(&finer, options).map(|run| simulate(&run, keep))) {
                    Ok(Ok(result)) => result,
                    _ => simulate(run, keep),
                }
            }
            fault => inject_fault(fault, simulate(run, keep), run),
        }
    }

    fn simulate_batch(&self, runs: &[Run], keep: RecordingLevel) -> Vec<SimulationResult> {
        let mut results = engine::simulate_batch(runs, keep, |_, simulated| simulated);
        match self.0 {
            Fault::BatchOffByOne => results.rotate_left(1),
            Fault::BatchSeed => {
                let reseeded: Vec<Scenario> = runs
                    .iter()
                    .map(|run| run.scenario().edited(|spec| spec.seed ^= 4).unwrap())
                    .collect();
                let runs: Vec<_> = reseeded
                    .iter()
                    .zip(runs)
                    .map(|(s, run)| Run::new(s, run.options().clone()).unwrap())
                    .collect();
                results = engine::simulate_batch(&runs, keep, |_, simulated| simulated);
            }
            Fault::BatchSample => {
                for trace in results
                    .iter_mut()
                    .filter_map(|result| result.trace.as_mut())
                {
                    trace.time_s.remove(0);
                }
            }
            _ => {}
        }
        results
    }

    fn for_each_observation(
        &self,
        run: &Run,
        each: &mut dyn FnMut(&ObservationSample<'_>) -> bool,
    ) {
        Crumple.for_each_observation(run, &mut |sight| {
            let Observation {
                speed_mps: own_mps, ..
            } = sight.observation;
            let mut seen = sight.observation;
            match (self.0, &mut seen.ahead) {
                (Fault::RateSign, Some(ahead)) => {
                    ahead.speed_mps = own_mps - (ahead.speed_mps - own_mps)
                }
                (Fault::Reversing, _) if own_mps < 0.5 => seen.speed_mps = own_mps - 0.5,
                _ => {}
            }
            each(&ObservationSample {
                observation: seen,
                ..*sight
            })
        });
    }

    fn shielded_full_throttle(&self) -> Arc<dyn ControllerSource> {
        if self.0 == Fault::NoShield {
            BuiltInController::FullThrottle(Default::default()).into_source()
        } else {
            Crumple.shielded_full_throttle()
        }
    }

    fn avoid(&self, scenario: &Scenario) -> Option<Avoidance> {
        let mut avoidance = Crumple.avoid(scenario)?;
        if self.0 == Fault::HalvedBound {
            avoidance.min_gap_bound_m = avoidance.min_gap_bound_m.map(|bound_m| 0.5 * bound_m);
        }
        if self.0 == Fault::AlwaysUnavoidable {
            avoidance.verdict = worst_case::AvoidanceVerdict::Unavoidable(Box::new(PROOF.clone()));
        }
        Some(avoidance)
    }

    fn file_round_trip(
        &self,
        scenario: &Scenario,
        format: ScenarioFormat,
    ) -> Result<Scenario, ScenarioFileError> {
        let back = Crumple.file_round_trip(scenario, format)?;
        Ok(match self.0 {
            Fault::RoundedFile => back
                .edited(|spec| {
                    spec.vehicles[0].speed_mps = (spec.vehicles[0].speed_mps * 1e6).round() / 1e6
                })
                .unwrap_or(back),
            Fault::SeedlessFile => back.edited(|spec| spec.seed = 0).unwrap_or(back),
            _ => back,
        })
    }

    fn robustness_over_time(
        &self,
        formula: &Formula,
        signals: &SampledSignals<'_>,
    ) -> Result<Vec<f64>, MonitorError> {
        let mut over_time = Crumple.robustness_over_time(formula, signals)?;
        if self.0 == Fault::LateWindow {
            over_time.rotate_left(1);
        }
        Ok(over_time)
    }

    fn is_satisfied(
        &self,
        formula: &Formula,
        signals: &SampledSignals<'_>,
    ) -> Result<bool, MonitorError> {
        Ok(self.0 == Fault::AlwaysSatisfied || Crumple.is_satisfied(formula, signals)?)
    }

    fn collision_role(&self, collision: &Collision, scenario: &Scenario) -> CollisionRole {
        match Crumple.collision_role(collision, scenario) {
            CollisionRole::Hits if self.0 == Fault::CollisionRoleSwapped => {
                CollisionRole::HitFromBehind
            }
            role => role,
        }
    }
}

fn inject_fault(fault: Fault, mut result: SimulationResult, run: &Run) -> SimulationResult {
    let Some(trace) = &mut result.trace else {
        return result;
    };
    match fault {
        Fault::NoStandstill => {
            for track in &mut trace.vehicles {
                for k in 1..track.speed_mps.len() {
                    let dt_s = trace.time_s[k] - trace.time_s[k - 1];
                    let through_mps =
                        track.speed_mps[k - 1] + track.acceleration_mps2[k - 1] * dt_s;
                    if track.speed_mps[k] == 0.0 && through_mps < 0.0 {
                        track.speed_mps[k] = through_mps;
                    }
                }
            }
        }
        Fault::Leap => {
            for track in &mut trace.vehicles {
                let last = track.position_m.len() - 1;
                track.position_m[last] +=
                    0.5 * track.speed_mps[last] * (trace.time_s[last] - trace.time_s[last - 1]);
            }
        }
        Fault::CoastingAccelerates => {
            for track in &mut trace.vehicles {
                if let Some(k) = track.acceleration_mps2.iter().position(|a| *a == 0.0)
                    && let Some(next_mps) = track.speed_mps.get_mut(k + 1)
                {
                    *next_mps += 1e-6;
                }
            }
        }
        Fault::CollisionReleased => {
            for impact in &result.impacts {
                let last_mps = trace.vehicles[impact.collision.rear_vehicle]
                    .speed_mps
                    .last_mut();
                *last_mps.expect("every track has samples") *= 0.5;
            }
        }
        Fault::ElasticImpact => {
            if let Some(impact) = result.impacts.first_mut() {
                impact.common_speed_mps = impact.collision.rear_speed_mps;
            }
        }
        Fault::CollisionForgotten => {
            result.impacts.clear();
            result.outcome = Outcome::NoCollision;
        }
        Fault::GapOfVehicleBehind => {
            let rears = result.vehicles.len() - 1;
            for index in 1..rears {
                result.vehicles[index].min_gap_m = result.vehicles[index + 1].min_gap_m;
            }
        }
        Fault::FrictionIgnored => {
            let friction = run.scenario().spec().environment.friction;
            for (track, summary) in trace.vehicles.iter_mut().zip(&mut result.vehicles) {
                track
                    .acceleration_mps2
                    .iter_mut()
                    .for_each(|a| *a = a.min(*a / friction));
                summary.max_brake_mps2 /= friction;
            }
        }
        _ => {}
    }
    result
}

/// Checked through the suite and through the fuzz target.
#[test]
fn every_oracle_notices_its_fault() {
    let wrong: [(Fault, OracleFn, Invariant); 23] = [
        (Fault::GapSign, metrics_agree, Invariant::MetricsAgree),
        (
            Fault::NoStandstill,
            motion_is_physical,
            Invariant::ForwardMotion,
        ),
        (Fault::Leap, motion_is_physical, Invariant::Continuity),
        (
            Fault::CoastingAccelerates,
            motion_is_physical,
            Invariant::Energy,
        ),
        (
            Fault::NoiseOnSubsteps,
            step_size_changes_nothing,
            Invariant::StepSize,
        ),
        (Fault::BatchOffByOne, engines_agree, Invariant::Engines),
        (Fault::BatchSeed, engines_agree, Invariant::Engines),
        (Fault::BatchSample, engines_agree, Invariant::Engines),
        (
            Fault::ElasticImpact,
            impacts_are_inelastic,
            Invariant::Momentum,
        ),
        (
            Fault::CollisionReleased,
            impacts_are_inelastic,
            Invariant::Sticking,
        ),
        (
            Fault::CollisionForgotten,
            monitor_agrees,
            Invariant::Monitor,
        ),
        (
            Fault::GapOfVehicleBehind,
            metrics_agree,
            Invariant::MetricsAgree,
        ),
        (Fault::FrictionIgnored, metrics_agree, Invariant::Limits),
        (
            Fault::CollisionRoleSwapped,
            metrics_agree,
            Invariant::CollisionRole,
        ),
        (
            Fault::RateSign,
            estimates_within_bounds,
            Invariant::Estimates,
        ),
        (
            Fault::Reversing,
            estimates_within_bounds,
            Invariant::Estimates,
        ),
        (Fault::RoundedFile, files_round_trip, Invariant::Files),
        (Fault::SeedlessFile, files_round_trip, Invariant::Files),
        (Fault::LateWindow, monitor_agrees, Invariant::Monitor),
        (Fault::AlwaysSatisfied, monitor_agrees, Invariant::Monitor),
        (
            Fault::NoShield,
            shield_prevents_front_collisions,
            Invariant::Shield,
        ),
        (
            Fault::HalvedBound,
            avoidability_bound_holds,
            Invariant::Avoidability,
        ),
        (
            Fault::AlwaysUnavoidable,
            avoidability_bound_holds,
            Invariant::Avoidability,
        ),
    ];
    let oracles: HashSet<usize> = wrong
        .iter()
        .map(|(_, oracle, _)| *oracle as usize)
        .collect();
    let laws: HashSet<Invariant> = wrong.iter().map(|(.., law)| *law).collect();
    // One of the 18 invariants is that every test case can be simulated; two belong to targets that read files.
    assert_eq!((oracles.len(), laws.len()), (ORACLES.len(), 15));
    for (fault, oracle, law) in wrong {
        let system = FaultySystem(fault);
        let config = ProptestConfig {
            failure_persistence: None,
            max_shrink_iters: 0,
            cases: 256,
            ..with_cases(256)
        };
        let mut runner =
            TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
        let property = runner.run(&any_test_case(), |test_case| {
            match test_case.check(oracle, &system) {
                Err(violation) if violation.invariant == law => {
                    Err(TestCaseError::fail(violation.to_string()))
                }
                _ => Ok(()),
            }
        });
        assert!(
            matches!(property, Err(TestError::Fail(..))),
            "the suite misses {fault:?}"
        );
        let strategy = any_bytes(TEST_CASE_BYTES);
        // Some faults show in few scenarios: that of the bound only without noise and collisions.
        let mut inputs = first_values(4096, &strategy);
        // Any oracle may detect it; the correct program passes all.
        let is_noticed = |bytes: Vec<u8>| {
            let test_case = TestCase::from_bytes(&bytes);
            test_case.check_all(&system).is_err() && test_case.check_all(&Crumple).is_ok()
        };
        assert!(inputs.any(is_noticed), "the fuzz target misses {fault:?}");
    }
}
