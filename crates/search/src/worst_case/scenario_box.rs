//! Boxes of scenarios: one scenario with ranges in place of some of its numbers.

use serde::{Deserialize, Serialize};

use crumple_world::scenario::{Driver, InvalidField, LeadProfile, Scenario, ScenarioSpec};

/// Ranges as a file states them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScenarioRanges {
    /// Version of the file format: 1.
    pub version: u32,
    /// The fields that are not single numbers; any combination of their values is meant.
    pub ranges: Vec<FieldRange>,
}

/// All values of one field of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FieldRange {
    /// Path of the field: `vehicles[i].position_m`, `vehicles[i].speed_mps`, or of a leader that brakes at a constant rate
    /// `vehicles[0].driver.brake.rate_mps2` or `vehicles[0].driver.brake.onset_s`.
    pub field: String,
    /// Smallest value, in the unit of the field.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// One scenario, or all scenarios of a box.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioBox {
    centre: Scenario,
    low: Scenario,
    high: Scenario,
    ranges: Vec<FieldRange>,
}

/// Why ranges make no box.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioBoxError {
    /// The file is of another version.
    #[error("version {0} of a file of ranges is not supported: this release reads version 1")]
    Version(u32),
    /// A field that cannot have a range.
    #[error(
        "{field}: cannot have a range; there are vehicles[i].position_m and .speed_mps, and of a leader that brakes \
         vehicles[0].driver.brake.rate_mps2 and .onset_s"
    )]
    UnsupportedField {
        /// The field.
        field: String,
    },
    /// Ends that are not two numbers in order.
    #[error("{field}: {low} to {high} is not a range")]
    InvalidRange {
        /// The field.
        field: String,
        /// Its lower end.
        low: f64,
        /// Its upper end.
        high: f64,
    },
    /// A field has two ranges.
    #[error("{field} has two ranges")]
    DuplicateField {
        /// Its path.
        field: String,
    },
    /// An end or the middle of the box is no valid scenario.
    #[error("at an end or in the middle of the ranges, {0}")]
    Scenario(#[from] InvalidField),
}

impl ScenarioBoxError {
    /// The path in a file of these ranges of what is wrong, such as `ranges[1].low`.
    #[must_use]
    pub fn field_location(&self, ranges: &ScenarioRanges) -> String {
        let of = |field: &str| ranges.ranges.iter().position(|range| range.field == field);
        let last_of = |field: &str| ranges.ranges.iter().rposition(|range| range.field == field);
        let (index, key) = match self {
            Self::Version(_) => return "version".to_owned(),
            Self::UnsupportedField { field } => (of(field), ".field"),
            Self::DuplicateField { field } => (last_of(field), ".field"),
            Self::InvalidRange { field, low, .. } => (of(field), if low.is_finite() { ".high" } else { ".low" }),
            Self::Scenario(invalid) => (of(&invalid.field), ""),
        };
        index.map_or_else(|| "ranges".to_owned(), |index| format!("ranges[{index}]{key}"))
    }
}

impl ScenarioBox {
    /// One scenario.
    #[must_use]
    pub fn point(scenario: &Scenario) -> Self {
        Self { centre: scenario.clone(), low: scenario.clone(), high: scenario.clone(), ranges: Vec::new() }
    }

    /// A scenario with ranges.
    ///
    /// # Errors
    /// [`ScenarioBoxError`] names the field that cannot have that range.
    pub fn new(scenario: &Scenario, ranges: &ScenarioRanges) -> Result<Self, ScenarioBoxError> {
        if ranges.version != 1 {
            return Err(ScenarioBoxError::Version(ranges.version));
        }
        let mut specs = [scenario.spec().clone(), scenario.spec().clone(), scenario.spec().clone()];
        let [centre, least, most] = &mut specs;
        for (index, FieldRange { field, low, high }) in ranges.ranges.iter().enumerate() {
            if ranges.ranges.iter().take(index).any(|before| before.field == *field) {
                return Err(ScenarioBoxError::DuplicateField { field: field.clone() });
            }
            if !(low.is_finite() && high.is_finite() && low <= high) {
                return Err(ScenarioBoxError::InvalidRange { field: field.clone(), low: *low, high: *high });
            }
            // A leader that brakes harder is further back: the ends of a box are those of positions and speeds.
            let turned = field.ends_with("rate_mps2");
            let values = if turned { [*high, *low] } else { [*low, *high] };
            let targets = [(&mut *least, values[0]), (&mut *most, values[1]), (&mut *centre, 0.5 * (low + high))];
            for (spec, value) in targets {
                *field_mut(spec, field).ok_or_else(|| ScenarioBoxError::UnsupportedField { field: field.clone() })? =
                    value;
            }
        }
        let [centre, low, high] = specs;
        Ok(Self {
            centre: Scenario::new(centre)?,
            low: Scenario::new(low)?,
            high: Scenario::new(high)?,
            ranges: ranges.ranges.clone(),
        })
    }

    /// The scenario in the middle.
    #[must_use]
    pub fn centre(&self) -> &Scenario {
        &self.centre
    }

    /// Its ranges; none if it is a single scenario. Around [`ScenarioBox::centre`] they make this family.
    #[must_use]
    pub(crate) fn ranges(&self) -> Option<ScenarioRanges> {
        (!self.is_point()).then(|| ScenarioRanges { version: 1, ranges: self.ranges.clone() })
    }

    /// The scenarios with every position and speed least and most, and the leader's script likewise.
    pub(super) fn ends(&self) -> [&Scenario; 2] {
        [&self.low, &self.high]
    }

    /// Whether it is a single scenario.
    #[must_use]
    pub(crate) fn is_point(&self) -> bool {
        self.low == self.high
    }
}

/// The number in a scenario that a path names, if it is one that may have a range.
fn field_mut<'a>(spec: &'a mut ScenarioSpec, field: &str) -> Option<&'a mut f64> {
    let (index, rest) = field.strip_prefix("vehicles[")?.split_once("].")?;
    let index: usize = index.parse().ok()?;
    let vehicle = spec.vehicles.get_mut(index)?;
    match rest {
        "position_m" => Some(&mut vehicle.position_m),
        "speed_mps" => Some(&mut vehicle.speed_mps),
        _ => match &mut vehicle.driver {
            Driver::Profile(LeadProfile::Brake(brake)) if index == 0 => match rest {
                "driver.brake.rate_mps2" => Some(&mut brake.rate_mps2),
                "driver.brake.onset_s" => Some(&mut brake.onset_s),
                _ => None,
            },
            _ => None,
        },
    }
}
