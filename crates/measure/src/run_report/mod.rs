//! Report of a simulated run, as text and as JSON.

mod lane_changes;
mod specification_result;
mod text;

use serde::Serialize;

pub use lane_changes::LaneChanges;
pub use specification_result::{PartReport, SpecificationResult};

use super::level::LevelMeasures;
use super::usefulness::{UnnecessaryBraking, UsefulnessMeasures};
use crumple_sim::control::{ControllerSource, FollowerClass, ShieldKind, TwoSidedSettings};
use crumple_sim::engine::{
    Impact, Intervention, NamedController, Outcome, Run, SimulationResult, VehicleSummary,
};
use crumple_sim::scenario::{PlantKind, Scenario};

/// Report of a simulated run.
#[derive(Debug, Clone, Serialize)]
pub struct RunReport<'a> {
    /// Name of the scenario.
    pub scenario: &'a str,
    /// The scenario.
    #[serde(skip)]
    pub simulated_scenario: &'a Scenario,
    /// Name of the controller.
    pub controller: &'a str,
    /// Estimator of the vehicles under test.
    pub estimator: &'static str,
    /// Integration step, in seconds.
    pub dt_s: f64,
    /// Seed of all noise.
    pub seed: u64,
    /// Plant of the vehicles that a controller drives, if it is not that of the scenario.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plant: Option<&'static str>,
    /// True if the controller declares that it is not deterministic.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub nondeterministic: bool,
    /// The first collision, or the end of the run without one.
    pub outcome: Outcome,
    /// Summaries, one per vehicle, front to rear.
    pub vehicles: &'a [VehicleSummary],
    /// Impacts in order of time.
    pub impacts: &'a [Impact],
    /// Number of vehicles with at least one impact.
    pub vehicles_involved: usize,
    /// Lane changes, including scheduled ones that did not happen.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lane_changes: Vec<LaneChanges>,
    /// Interventions of shields, by vehicle and time.
    #[serde(skip_serializing_if = "<[Intervention]>::is_empty")]
    pub interventions: &'a [Intervention],
    /// One entry per vehicle under test; empty without a trace.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unnecessary_braking: Vec<UnnecessaryBrakingReport>,
    /// True if only a vehicle behind causes the unnecessary braking, which then does not count against the controller.
    /// False unless [`with_cause_of_braking`](Self::with_cause_of_braking) compared the run.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub brakes_only_with_vehicle_behind: bool,
    /// Vehicles under test that fell behind their leader; empty without a trace.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fell_behind: Vec<usize>,
    /// Levels of the vehicles under test, if they were requested.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub levels: Vec<LevelMeasures>,
    /// Vehicles under test without a level, if levels were requested.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing_levels: Vec<MissingLevel>,
    /// True if the controller is behind a two-sided shield.
    #[serde(skip)]
    pub has_two_sided_shield: bool,
    /// Results of the specifications.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub specifications: Vec<SpecificationResult>,
}

/// Unnecessary braking of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnnecessaryBrakingReport {
    /// Index of the vehicle, from the front.
    pub vehicle: usize,
    /// Measure of the braking.
    #[serde(flatten)]
    pub braking: UnnecessaryBraking,
}

/// Reason why a vehicle has no level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MissingLevel {
    /// Index of the vehicle, from the front.
    pub vehicle: usize,
    /// Reason in words.
    pub reason: String,
}

/// Description of a controller in a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReportedController<'a> {
    /// Name of the controller.
    pub name: &'a str,
    /// True unless the controller declares that it is not deterministic.
    pub is_deterministic: bool,
    /// True behind a two-sided shield.
    pub has_two_sided_shield: bool,
}

impl<'a> From<&'a NamedController> for ReportedController<'a> {
    fn from(controller: &'a NamedController) -> Self {
        Self {
            name: &controller.name,
            is_deterministic: controller.source.is_deterministic(),
            has_two_sided_shield: has_two_sided_shield(&*controller.source),
        }
    }
}

/// True if the source is a two-sided shield, or has one inside: behind a test driver, for example.
fn has_two_sided_shield(source: &dyn ControllerSource) -> bool {
    match source.as_shield() {
        Some(shield) => matches!(shield.settings, ShieldKind::BothSides(_)),
        None => source.inner().is_some_and(has_two_sided_shield),
    }
}

impl<'a> RunReport<'a> {
    /// Creates the report of a run's result, without specifications. `controller` is that of the run.
    #[must_use]
    pub fn new(
        run: &'a Run,
        controller: impl Into<ReportedController<'a>>,
        result: &'a SimulationResult,
    ) -> Self {
        let controller = controller.into();
        let scenario = run.scenario();
        Self {
            scenario: &scenario.spec().name,
            simulated_scenario: scenario,
            controller: controller.name,
            estimator: run.options().estimator.name(),
            dt_s: run.dt_s(),
            seed: scenario.spec().seed,
            plant: None,
            nondeterministic: !controller.is_deterministic,
            outcome: result.outcome.clone(),
            vehicles: &result.vehicles,
            impacts: &result.impacts,
            vehicles_involved: result.vehicles_involved(),
            lane_changes: LaneChanges::list(scenario, result),
            interventions: &result.interventions,
            unnecessary_braking: unnecessary_braking(scenario, result),
            brakes_only_with_vehicle_behind: false,
            fell_behind: fell_behind(scenario, result),
            levels: Vec::new(),
            missing_levels: Vec::new(),
            has_two_sided_shield: controller.has_two_sided_shield,
            specifications: Vec::new(),
        }
    }

    /// Adds the levels of the vehicles under test; none without a trace. `describe_followers` states a class in words.
    #[must_use]
    pub fn with_levels(
        mut self,
        run: &Run,
        result: &SimulationResult,
        settings: &TwoSidedSettings,
        describe_followers: fn(&FollowerClass) -> String,
    ) -> Self {
        for (vehicle, level) in LevelMeasures::of_vehicles_under_test(run, result, settings) {
            match level {
                Ok(level) => {
                    self.levels
                        .push(level.with_class(run, settings, describe_followers));
                }
                Err(reason) => self.missing_levels.push(MissingLevel {
                    vehicle,
                    reason: reason.to_string(),
                }),
            }
        }
        self
    }

    /// States the plant that replaces that of the scenario.
    #[must_use]
    pub fn with_plant(self, plant: Option<PlantKind>) -> Self {
        let plant = plant.map(PlantKind::name);
        Self { plant, ..self }
    }

    /// Adds results of specifications.
    #[must_use]
    pub fn with_specifications(self, specifications: Vec<SpecificationResult>) -> Self {
        Self {
            specifications,
            ..self
        }
    }

    /// Returns true if a vehicle under test brakes unnecessarily, whatever causes it.
    #[must_use]
    pub fn brakes_unnecessarily(&self) -> bool {
        has_braking(&self.unnecessary_braking)
    }

    /// Returns true if a vehicle was evaluated, none falls behind, and none brakes unnecessarily, or only because of a
    /// vehicle behind.
    #[must_use]
    pub fn is_useful(&self) -> bool {
        let is_evaluated = !self.unnecessary_braking.is_empty();
        let brakes_by_itself = self.brakes_unnecessarily() && !self.brakes_only_with_vehicle_behind;
        is_evaluated && !brakes_by_itself && self.fell_behind.is_empty()
    }

    /// Returns true if a specification is violated.
    #[must_use]
    pub fn violates_specification(&self) -> bool {
        self.specifications.iter().any(|result| !result.satisfied)
    }
}

/// Returns true if a vehicle under test brakes unnecessarily in a traced result.
pub(crate) fn brakes_unnecessarily(scenario: &Scenario, result: &SimulationResult) -> bool {
    has_braking(&unnecessary_braking(scenario, result))
}

fn has_braking(vehicles: &[UnnecessaryBrakingReport]) -> bool {
    vehicles.iter().any(|vehicle| !vehicle.braking.is_empty())
}

/// Returns the unnecessary braking of the vehicles under test, front to rear.
fn unnecessary_braking(
    scenario: &Scenario,
    result: &SimulationResult,
) -> Vec<UnnecessaryBrakingReport> {
    let Some(trace) = &result.trace else {
        return Vec::new();
    };
    (0..trace.vehicles.len())
        .filter(|&vehicle| scenario.is_under_test(vehicle))
        .filter_map(|vehicle| {
            let braking = UnnecessaryBraking::from_trace(trace, &result.impacts, vehicle)?;
            Some(UnnecessaryBrakingReport { vehicle, braking })
        })
        .collect()
}

/// Returns the vehicles under test that fall behind their leader.
fn fell_behind(scenario: &Scenario, result: &SimulationResult) -> Vec<usize> {
    let Some(trace) = &result.trace else {
        return Vec::new();
    };
    (0..trace.vehicles.len())
        .filter(|&vehicle| scenario.is_under_test(vehicle))
        .filter(|&vehicle| {
            UsefulnessMeasures::from_trace(trace, &result.impacts, vehicle)
                .and_then(|measures| measures.following)
                .is_some_and(|following| following.fell_behind)
        })
        .collect()
}
