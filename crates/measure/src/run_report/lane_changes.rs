//! Lane changes of the vehicles of a run.

use serde::Serialize;

use crumple_sim::engine::SimulationResult;
use crumple_sim::scenario::{LaneChange, Scenario, VehicleSpec};

/// Times at which a vehicle entered and left the lane, in seconds; `None` for an event that did not happen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LaneChanges {
    /// Index of the vehicle, from the front.
    pub vehicle: usize,
    /// Time at which it entered the lane.
    pub entered_s: Option<f64>,
    /// Time at which it left the lane.
    pub left_s: Option<f64>,
}

impl LaneChanges {
    /// Lists the vehicles whose scenario schedules a lane change; none without a trace.
    pub(super) fn list(scenario: &Scenario, result: &SimulationResult) -> Vec<Self> {
        let Some(trace) = &result.trace else {
            return Vec::new();
        };
        let vehicles = scenario.vehicles().iter().zip(&trace.vehicles).enumerate();
        vehicles
            .filter(|(_, (vehicle, _))| !vehicle.keeps_lane())
            .map(|(vehicle, (_, track))| Self::new(vehicle, track.in_lane_s))
            .collect()
    }

    fn new(vehicle: usize, in_lane_s: [f64; 2]) -> Self {
        let [entered_s, left_s] =
            in_lane_s.map(|time_s| Some(time_s).filter(|time_s| time_s.is_finite()));
        Self {
            vehicle,
            entered_s,
            left_s,
        }
    }

    pub(super) fn describe(&self, scenario: &Scenario) -> String {
        let entered = if self.schedules(scenario, |vehicle| vehicle.enters) {
            describe_entry(self.entered_s)
        } else {
            String::new()
        };
        let lane = if entered.is_empty() { "the lane" } else { "it" };
        let is_in_lane = self.entered_s.is_some() || entered.is_empty();
        let left = match self.left_s {
            _ if !self.schedules(scenario, |vehicle| vehicle.leaves) => String::new(),
            Some(time_s) => format!("leaves {lane} at {time_s:.2} s"),
            None if is_in_lane => {
                format!("does not leave {lane}: its trigger does not occur, or it collides before")
            }
            None => String::new(),
        };
        let both = if entered.is_empty() || left.is_empty() {
            ""
        } else {
            " and "
        };
        format!("vehicle {} {entered}{both}{left}", self.vehicle)
    }

    fn schedules(
        &self,
        scenario: &Scenario,
        change: fn(&VehicleSpec) -> Option<LaneChange>,
    ) -> bool {
        let vehicle = scenario.vehicles().get(self.vehicle);
        vehicle.and_then(change).is_some()
    }
}

fn describe_entry(entered_s: Option<f64>) -> String {
    match entered_s {
        Some(time_s) => format!("enters the lane at {time_s:.2} s"),
        None => "does not enter the lane: its trigger does not occur, or the lane has no room"
            .to_owned(),
    }
}
