//! Shape of scenarios: the step and the kinds of drivers. Scenarios of one batch share it.

use arbitrary::Unstructured;

use super::choices::Choices;

/// Steps, in seconds; the paper's first.
const STEPS_S: [f64; 4] = [0.01, 0.02, 0.05, 0.1];
/// Numbers of vehicles; the paper's first.
const VEHICLE_COUNTS: [usize; 5] = [3, 2, 4, 5, 6];
pub(super) const MAX_VEHICLES: usize = 6;
const PROFILE_COUNT: u8 = 6;

/// Kind of a driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriverKind {
    /// The controller under test.
    UnderTest,
    /// A lead profile, by its index in [`profile_from_bytes`](super::profile_from_bytes).
    Profile(u8),
    /// A controller of the scenario, by its index in [`CONTROLLERS`](super::CONTROLLERS).
    Controller(u8),
}

/// Step of a scenario and kinds of its drivers, front to rear.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioShape {
    /// Step of the scenario, in seconds.
    pub step_s: f64,
    /// Kinds of the drivers, at least two.
    pub drivers: Vec<DriverKind>,
}

impl DriverKind {
    const BRAKE: Self = Self::Profile(1);
    const BASELINE: Self = Self::Controller(0);

    /// Returns the nominal driver of vehicle `index` of `count`: a braking leader, vehicles under test, and with more
    /// than two vehicles a last one with the baseline.
    fn nominal(index: usize, count: usize) -> Self {
        match index {
            0 => Self::BRAKE,
            index if index + 1 == count && count > 2 => Self::BASELINE,
            _ => Self::UnderTest,
        }
    }

    /// Returns a driver kind other than the nominal: a third each under test, profiles and controllers.
    #[must_use]
    pub fn non_nominal(byte: u8) -> Self {
        match byte % 3 {
            0 => Self::UnderTest,
            1 => Self::Profile(byte / 3 % PROFILE_COUNT),
            _ => Self::Controller(byte / 3),
        }
    }

    pub(super) fn from_byte(byte: u8, index: usize, count: usize) -> Self {
        byte.checked_sub(1)
            .map_or_else(|| Self::nominal(index, count), Self::non_nominal)
    }
}

impl ScenarioShape {
    /// Bytes of a shape.
    pub const BYTES: usize = 2 + MAX_VEHICLES;

    /// Reads a shape; no bytes give the paper's.
    pub fn read(from: &mut Unstructured<'_>) -> Self {
        let mut choices = Choices::read_block(from, Self::BYTES);
        let count = choices.choose(&VEHICLE_COUNTS).unwrap_or(VEHICLE_COUNTS[0]);
        let step_s = choices.choose(&STEPS_S).unwrap_or(STEPS_S[0]);
        let drivers = (0..count)
            .map(|index| DriverKind::from_byte(choices.byte(), index, count))
            .collect();
        Self { step_s, drivers }
    }
}
