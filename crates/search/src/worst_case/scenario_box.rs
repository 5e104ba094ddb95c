//! Boxes of scenarios: a scenario with ranges in place of some numbers.

use serde::{Deserialize, Serialize};

use crumple_world::scenario::{Driver, InvalidField, LeadProfile, Scenario, ScenarioSpec};

/// Ranges as in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScenarioRanges {
    /// Version of the file format: 1.
    pub version: u32,
    /// Fields with ranges; the box contains all combinations of their values.
    pub ranges: Vec<FieldRange>,
}

/// Range of one field of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FieldRange {
    /// Path of the field: `vehicles[i].position_m`, `vehicles[i].speed_mps`, or, of a leader with constant braking,
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

/// An error of ranges that define no box.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioBoxError {
    /// The file is of another version.
    #[error("version {0} of a file of ranges is not supported: this release reads version 1")]
    Version(u32),
    /// The field cannot have a range.
    #[error(
        "{field}: this field cannot have a range; use vehicles[i].position_m or .speed_mps, or, for a leader that \
         brakes, vehicles[0].driver.brake.rate_mps2 or .onset_s"
    )]
    UnsupportedField {
        /// Path of the field.
        field: String,
    },
    /// The ends are not two numbers in order.
    #[error("{field}: {low} to {high} is not a range: both bounds must be finite and the lower one first")]
    InvalidRange {
        /// Path of the field.
        field: String,
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// A field has two ranges.
    #[error("{field} has two ranges")]
    DuplicateField {
        /// Path of the field.
        field: String,
    },
    /// An end or the middle of the box is not a valid scenario.
    #[error("at an end or in the middle of the ranges, {0}")]
    Scenario(#[from] InvalidField),
}

impl ScenarioBoxError {
    /// Returns the path of the error in the file of these ranges, such as `ranges[1].low`.
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
    /// Creates a box of one scenario.
    #[must_use]
    pub fn point(scenario: &Scenario) -> Self {
        Self { centre: scenario.clone(), low: scenario.clone(), high: scenario.clone(), ranges: Vec::new() }
    }

    /// Creates a box from a scenario and ranges.
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
            // A leader that brakes harder is further back, so its ends are swapped.
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

    /// Returns the scenario in the middle.
    #[must_use]
    pub fn centre(&self) -> &Scenario {
        &self.centre
    }

    /// Returns the ranges around [`ScenarioBox::centre`]; `None` for a single scenario.
    #[must_use]
    pub(crate) fn ranges(&self) -> Option<ScenarioRanges> {
        (!self.is_point()).then(|| ScenarioRanges { version: 1, ranges: self.ranges.clone() })
    }

    /// Returns the scenarios with the least and with the greatest positions and speeds, also of the leader's script.
    pub(super) fn ends(&self) -> [&Scenario; 2] {
        [&self.low, &self.high]
    }

    #[must_use]
    pub(crate) fn is_point(&self) -> bool {
        self.low == self.high
    }
}

/// Returns the number at a path in a scenario, if it may have a range.
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
