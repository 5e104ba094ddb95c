//! What scenarios of one batch have in common: the step, and who drives.

use arbitrary::Unstructured;

use super::choices::Choices;

/// Steps of scenarios, in seconds; the paper's first.
const STEPS_S: [f64; 4] = [0.01, 0.02, 0.05, 0.1];
/// Numbers of vehicles; the paper's first.
const VEHICLE_COUNTS: [usize; 5] = [3, 2, 4, 5, 6];
/// The most vehicles in a scenario.
pub(super) const MAX_VEHICLES: usize = 6;
/// Sorts of lead profiles.
const PROFILE_COUNT: u8 = 6;

/// What sort of driver sits in a seat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriverKind {
    /// The controller under test.
    UnderTest,
    /// A script, by its place in [`super::profile`].
    Profile(u8),
    /// A controller of the scenario's own, by its place in [`super::controller`].
    Controller(u8),
}

/// The step of a scenario and who drives its vehicles, front to rear.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioShape {
    /// The scenario's step, in seconds.
    pub step_s: f64,
    /// One entry a vehicle, at least two.
    pub drivers: Vec<DriverKind>,
}

impl DriverKind {
    /// The braking leader of the paper, and its baseline.
    const BRAKE: Self = Self::Profile(1);
    const BASELINE: Self = Self::Controller(0);

    /// Who drives vehicle `index` of `count` unless something else is chosen: a braking leader, vehicles under test, and a
    /// follower with the baseline if there is a place for one.
    fn nominal(index: usize, count: usize) -> Self {
        match index {
            0 => Self::BRAKE,
            index if index + 1 == count && count > 2 => Self::BASELINE,
            _ => Self::UnderTest,
        }
    }

    /// Any sort of driver but the nominal one: a third under test, a third scripts, a third controllers.
    #[must_use]
    pub fn non_nominal(byte: u8) -> Self {
        match byte % 3 {
            0 => Self::UnderTest,
            1 => Self::Profile(byte / 3 % PROFILE_COUNT),
            _ => Self::Controller(byte / 3),
        }
    }

    /// The sort a byte stands for: nominal if it is zero.
    pub(super) fn from_byte(byte: u8, index: usize, count: usize) -> Self {
        byte.checked_sub(1).map_or_else(|| Self::nominal(index, count), Self::non_nominal)
    }
}

impl ScenarioShape {
    /// Bytes that a shape is read from.
    pub const BYTES: usize = 2 + MAX_VEHICLES;

    /// Reads a shape; no bytes are the paper's.
    pub fn read(from: &mut Unstructured<'_>) -> Self {
        let mut choices = Choices::read_block(from, Self::BYTES);
        let count = choices.choose(&VEHICLE_COUNTS).unwrap_or(VEHICLE_COUNTS[0]);
        let step_s = choices.choose(&STEPS_S).unwrap_or(STEPS_S[0]);
        let drivers = (0..count).map(|index| DriverKind::from_byte(choices.byte(), index, count)).collect();
        Self { step_s, drivers }
    }
}
