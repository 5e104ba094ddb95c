//! Random scenarios for the property tests.
//!
//! [`crumple_testing::generator`] reads all of them from random bytes, as for the fuzzer. Bytes shrink to zero, and
//! zero bytes are paper-1.

use arbitrary::Unstructured;
pub(crate) use crumple_cases::with_cases;
use crumple_fuzzing::{
    Crumple, LANE_CASE_BYTES, OracleFn, OracleOutcome, RunSetup, SETUP_BYTES, TEST_CASE_BYTES,
    TestCase,
};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{
    AfterCollision, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
use crumple_sim::scenario::{
    Driver, Environment, LeadProfile, SCENARIO_VERSION, Scenario, ScenarioSpec, Sensors,
    VehicleSpec,
};
use crumple_testing::generator::{self, SCENARIO_BYTES, ScenarioShape};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;

pub(crate) fn simulate_traced(scenario: &Scenario, options: &RunOptions) -> SimulationResult {
    simulate(
        &Run::new(scenario, options.clone()).expect("fits"),
        RecordingLevel::Trace,
    )
}

/// Returns a specification with default sensors, a dry road and seed 0.
pub(crate) fn scenario_spec(
    name: &str,
    step_s: f64,
    duration_s: f64,
    vehicles: Vec<VehicleSpec>,
) -> ScenarioSpec {
    ScenarioSpec {
        version: SCENARIO_VERSION,
        name: name.to_owned(),
        about: String::new(),
        duration_s,
        step_s,
        seed: 0,
        environment: Environment::default(),
        sensors: Sensors::default(),
        vehicles,
    }
}

/// Checks an oracle; a test case that rounding decides does not count.
pub(crate) fn check_oracle(test_case: &TestCase, oracle: OracleFn) -> Result<(), TestCaseError> {
    match test_case.check(oracle, &Crumple) {
        Ok(OracleOutcome::Holds | OracleOutcome::NotApplicable) => Ok(()),
        Ok(OracleOutcome::Undecided) => Err(TestCaseError::reject("rounding decides it")),
        Err(violation) => Err(TestCaseError::fail(violation.to_string())),
    }
}

/// Returns the first values of a strategy with the fixed seed of proptest.
pub(crate) fn first_values<S: Strategy>(
    count: usize,
    strategy: &S,
) -> impl Iterator<Item = S::Value> + use<'_, S> {
    let mut runner = TestRunner::deterministic();
    (0..count).map(move |_| strategy.new_tree(&mut runner).expect("generates").current())
}

/// Random bytes of a fixed length: only values shrink.
pub(crate) fn any_bytes(count: usize) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), count)
}

pub(crate) fn any_test_case() -> impl Strategy<Value = TestCase> {
    any_bytes(TEST_CASE_BYTES).prop_map(|bytes| TestCase::from_bytes(&bytes))
}

pub(crate) fn any_lane_case() -> impl Strategy<Value = TestCase> {
    any_bytes(LANE_CASE_BYTES).prop_map(|bytes| TestCase::from_bytes_with_lanes(&bytes))
}

pub(crate) fn any_scenario() -> impl Strategy<Value = Scenario> {
    any_bytes(SCENARIO_BYTES)
        .prop_map(|bytes| generator::read_scenario(&mut Unstructured::new(&bytes)))
}

pub(crate) fn any_scenario_of_shape(
    shape: &ScenarioShape,
) -> impl Strategy<Value = Scenario> + use<> {
    let shape = shape.clone();
    any_bytes(SCENARIO_BYTES).prop_map(move |bytes| {
        generator::read_scenario_of_shape(&shape, &mut Unstructured::new(&bytes))
    })
}

pub(crate) fn any_shape() -> impl Strategy<Value = ScenarioShape> {
    any_bytes(ScenarioShape::BYTES)
        .prop_map(|bytes| ScenarioShape::read(&mut Unstructured::new(&bytes)))
}

/// Any controller under test, either estimator, the scenario's step or a smaller one, either behaviour after a
/// collision.
pub(crate) fn any_setup() -> impl Strategy<Value = RunSetup> {
    any_bytes(SETUP_BYTES).prop_map(|bytes| RunSetup::read(&mut Unstructured::new(&bytes)))
}

pub(crate) fn any_after_collision() -> impl Strategy<Value = AfterCollision> {
    prop_oneof![Just(AfterCollision::Stop), Just(AfterCollision::Continue)]
}

/// Returns lead profiles of the kind `index`.
pub(crate) fn any_profile(index: u8) -> impl Strategy<Value = LeadProfile> {
    any_bytes(32).prop_map(move |bytes| generator::profile_from_bytes(index, &bytes))
}

/// Any built-in controller, with any sensible settings.
pub(crate) fn any_controller() -> impl Strategy<Value = BuiltInController> {
    let index = 0..BuiltInController::all().len() as u8;
    (index, any_bytes(32))
        .prop_map(|(index, bytes)| generator::controller_from_bytes(index, &bytes))
}

/// Returns a scenario without noise; reaction and actuator delays stay.
pub(crate) fn without_noise(scenario: &Scenario) -> Scenario {
    let quiet = |spec: &mut ScenarioSpec| {
        for vehicle in &mut spec.vehicles {
            vehicle.acceleration_noise_mps2 = 0.0;
            if let Driver::Controller(driver) = &mut vehicle.driver {
                make_average(driver);
            }
        }
    };
    scenario.edited(quiet).expect("still valid")
}

/// Makes a human driver the average one without glances off the road, and lets emergency brakes detect all standing
/// vehicles, so that they draw no random numbers.
pub(crate) fn make_average(driver: &mut BuiltInController) {
    match driver {
        BuiltInController::Human(human) => {
            (
                human.reaction_shape,
                human.brake_deviation_mps2,
                human.glance_per_s,
            ) = (0.0, 0.0, 0.0);
        }
        BuiltInController::EmergencyBrake(brake) => brake.standing_miss_share = 0.0,
        _ => {}
    }
}

/// Replaces learned drivers, which observe the vehicle behind and round to single precision.
pub(crate) fn without_learned_drivers(scenario: &Scenario) -> Scenario {
    let learned = Driver::Controller(BuiltInController::Policy(Default::default()));
    let replace = |spec: &mut ScenarioSpec| {
        for vehicle in spec
            .vehicles
            .iter_mut()
            .filter(|vehicle| vehicle.driver == learned)
        {
            vehicle.driver = Driver::Controller(BuiltInController::MatchLeader(Default::default()));
        }
    };
    scenario.edited(replace).expect("still valid")
}
