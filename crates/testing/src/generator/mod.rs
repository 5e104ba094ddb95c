//! Scenarios from bytes, as variations of the paper's scenario 1. Property tests pass random bytes and fuzzers pass
//! evolved bytes. No bytes, or zero bytes, give that scenario.

mod choices;
mod driver;
mod lanes;
mod scenario;
mod shape;

pub use choices::Choices;
pub use driver::{
    CONTROLLERS, DRIVER_BYTES, controller_from_bytes, make_scripted, profile_from_bytes,
};
pub use lanes::{LANE_BYTES, with_lane_changes};
pub(crate) use scenario::place_vehicles;
pub use scenario::{SCENARIO_BYTES, read_scenario, read_scenario_of_shape, with_compatible_step};
pub use shape::{DriverKind, ScenarioShape};
