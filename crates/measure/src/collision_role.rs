//! Roles of the vehicles under test in a collision.

use crumple_sim::engine::Collision;
use crumple_sim::scenario::{Driver, LeadProfile, Scenario};

/// Role of the vehicles under test in a collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CollisionRole {
    /// A vehicle under test hits its leader.
    Hits,
    /// A vehicle under test is hit from behind by a vehicle that is not under test.
    HitFromBehind,
    /// A vehicle under test is hit from behind by a vehicle that repeats recorded speeds. That vehicle cannot react, so
    /// the collision does not count against the controller.
    HitByRecording,
    /// Neither vehicle is under test.
    Bystander,
}

impl CollisionRole {
    /// Determines the role of the vehicles under test in a collision of a scenario.
    #[must_use]
    pub fn new(collision: &Collision, scenario: &Scenario) -> Self {
        if scenario.is_under_test(collision.rear_vehicle) {
            Self::Hits
        } else if !scenario.is_under_test(collision.front_vehicle) {
            Self::Bystander
        } else if repeats_recorded_speeds(scenario, collision.rear_vehicle) {
            Self::HitByRecording
        } else {
            Self::HitFromBehind
        }
    }
}

/// Returns true if a vehicle repeats recorded speeds, whatever happens ahead of it.
fn repeats_recorded_speeds(scenario: &Scenario, vehicle: usize) -> bool {
    scenario
        .vehicles()
        .get(vehicle)
        .is_some_and(|vehicle| matches!(vehicle.driver, Driver::Profile(LeadProfile::Recorded(_))))
}
