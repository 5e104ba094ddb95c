//! Requests of the page: a scenario and its edits.

use std::path::Path;

use crumple_core::text_file::parse_json;
use crumple_sim::control::TestDriverSettings;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{
    Driver, LeadProfile, PiecewiseAcceleration, Scenario, ScenarioSpec, VehicleClass,
};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::catalog::{Catalog, scenario_error};
use crate::error::RequestError;

/// Maximum number of vehicle steps for one request, over all its controllers: half a second of work.
pub(crate) const MAX_VEHICLE_STEPS: usize = 400_000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EditedScenario {
    scenario: ScenarioSpec,
    #[serde(default)]
    edits: Edits,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunRequest {
    scenario: ScenarioSpec,
    #[serde(default)]
    edits: Edits,
    pub(crate) controllers: Vec<String>,
    #[serde(default)]
    pub(crate) estimator: EstimatorKind,
    #[serde(default)]
    pub(crate) narrow: bool,
    /// Test driver that drives with each controller, as in names of controllers (`test-driver,hold_mps=20:`).
    #[serde(default)]
    pub(crate) test_driver: Option<String>,
}

/// Edits of a scenario; none keeps a value.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Edits {
    name: Option<String>,
    friction: Option<f64>,
    vehicles: Vec<VehicleEdit>,
    /// Acceleration of vehicle 0, which replaces its driver.
    lead: Option<PiecewiseAcceleration>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct VehicleEdit {
    vehicle: usize,
    class: Option<VehicleClass>,
    /// Bumper-to-bumper gap to the vehicle listed before it.
    gap_m: Option<f64>,
    speed_mps: Option<f64>,
}

/// Parses a test driver; none without a text.
pub(crate) fn parse_test_driver(
    text: Option<&str>,
) -> Result<Option<TestDriverSettings>, RequestError> {
    let Some(text) = text else {
        return Ok(None);
    };
    let settings = text.trim_end_matches(':').trim_start_matches("test-driver");
    TestDriverSettings::parse(settings)
        .map(Some)
        .map_err(|error| RequestError::invalid("test_driver", error))
}

pub(crate) fn parse_body<T: DeserializeOwned>(body: &[u8]) -> Result<T, RequestError> {
    let text = std::str::from_utf8(body).map_err(|error| RequestError::Malformed {
        line: 1 + body
            .iter()
            .take(error.valid_up_to())
            .filter(|&&byte| byte == b'\n')
            .count(),
        message: "not UTF-8".to_owned(),
    })?;
    Ok(parse_json(text, Path::new("request"))?)
}

impl EditedScenario {
    pub(crate) fn into_scenario(self, catalog: &Catalog) -> Result<Scenario, RequestError> {
        apply_edits(self.scenario, self.edits, 1, catalog)
    }
}

impl RunRequest {
    /// Returns the scenario with its edits, and takes the edits out.
    pub(crate) fn take_scenario(&mut self, catalog: &Catalog) -> Result<Scenario, RequestError> {
        let edits = std::mem::take(&mut self.edits);
        apply_edits(
            self.scenario.clone(),
            edits,
            self.controllers.len(),
            catalog,
        )
    }
}

/// Applies edits to a scenario, and checks that it is valid and small enough for `runs` runs.
fn apply_edits(
    mut spec: ScenarioSpec,
    edits: Edits,
    runs: usize,
    catalog: &Catalog,
) -> Result<Scenario, RequestError> {
    catalog.resolve_drivers(&mut spec)?;
    edits.apply(&mut spec)?;
    let scenario = Scenario::new(spec).map_err(scenario_error)?;
    let vehicle_steps = scenario
        .steps()
        .saturating_mul(scenario.vehicles().len())
        .saturating_mul(runs.max(1));
    if vehicle_steps > MAX_VEHICLE_STEPS {
        let problem = format!(
            "asks for {vehicle_steps} vehicle-steps over all controllers, and at most {MAX_VEHICLE_STEPS} are allowed"
        );
        return Err(RequestError::invalid("scenario.duration_s", problem));
    }
    Ok(scenario)
}

impl Edits {
    fn apply(self, spec: &mut ScenarioSpec) -> Result<(), RequestError> {
        if let Some(name) = self.name {
            spec.name = name;
        }
        if let Some(friction) = self.friction {
            spec.environment.friction = friction;
        }
        // Keep positions exact if no gap or class changed.
        let moves = self
            .vehicles
            .iter()
            .any(|edit| edit.gap_m.is_some() || edit.class.is_some());
        let mut gaps_m = gaps_m(spec);
        for (index, edit) in self.vehicles.iter().enumerate() {
            edit.apply(spec, &mut gaps_m, &format!("edits.vehicles[{index}]"))?;
        }
        if moves {
            place_vehicles(spec, &gaps_m);
        }
        if let (Some(pieces), Some(lead)) = (self.lead, spec.vehicles.first_mut()) {
            lead.driver = Driver::Profile(LeadProfile::Pieces(pieces));
            // A script determines the motion directly.
            (
                lead.reaction_delay_s,
                lead.actuator_lag_s,
                lead.actuator_delay_s,
                lead.jerk_limit_mps3,
            ) = (0.0, 0.0, 0.0, None);
            (lead.plant, lead.body) = Default::default();
        }
        Ok(())
    }
}

impl VehicleEdit {
    /// Changes class and speed in the scenario, and the gap in `gaps_m`. `field` is the path of this edit in errors.
    fn apply(
        &self,
        spec: &mut ScenarioSpec,
        gaps_m: &mut [f64],
        field: &str,
    ) -> Result<(), RequestError> {
        let Some(vehicle) = spec.vehicles.get_mut(self.vehicle) else {
            let problem = format!("there is no vehicle {} in the scenario", self.vehicle);
            return Err(RequestError::invalid(format!("{field}.vehicle"), problem));
        };
        vehicle.class = self.class.unwrap_or(vehicle.class);
        vehicle.speed_mps = self.speed_mps.unwrap_or(vehicle.speed_mps);
        if let Some(gap_m) = self.gap_m {
            let gap = self
                .vehicle
                .checked_sub(1)
                .and_then(|before| gaps_m.get_mut(before));
            *gap.ok_or_else(|| {
                RequestError::invalid(
                    format!("{field}.gap_m"),
                    "no vehicle is ahead of the first vehicle",
                )
            })? = gap_m;
        }
        Ok(())
    }
}

/// Returns the bumper-to-bumper gap ahead of each vehicle but the first, in metres.
pub(crate) fn gaps_m(spec: &ScenarioSpec) -> Vec<f64> {
    let pairs = spec.vehicles.iter().zip(spec.vehicles.iter().skip(1));
    pairs
        .map(|(ahead, behind)| ahead.position_m - ahead.length_m() - behind.position_m)
        .collect()
}

fn place_vehicles(spec: &mut ScenarioSpec, gaps_m: &[f64]) {
    let Some(first) = spec.vehicles.first() else {
        return;
    };
    let mut rear_bumper_m = first.position_m - first.length_m();
    for (vehicle, gap_m) in spec.vehicles.iter_mut().skip(1).zip(gaps_m) {
        // Round to the nanometre, so that a file shows the chosen gap.
        vehicle.position_m = ((rear_bumper_m - gap_m) * 1e9).round() / 1e9;
        rear_bumper_m = vehicle.position_m - vehicle.length_m();
    }
}
