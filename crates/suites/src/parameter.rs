//! Figures of a suite: the numbers that a clause asks for, in the document's units, and who says so.

use std::fmt;

use serde::{Deserialize, Serialize};

use crumple_world::control::STANDARD_GRAVITY_MPS2;

/// What a figure is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ParameterKind {
    /// Speed of the vehicle under test at the start.
    OwnSpeed,
    /// Speed of the vehicle ahead.
    LeadSpeed,
    /// The gap at the start, or when a vehicle enters or leaves the lane, as the time that closing it takes.
    ClosingTime,
    /// The gap at the start, bumper to bumper.
    Gap,
    /// The gap at the start, as the time that driving it takes.
    TimeGap,
    /// Braking of the vehicle ahead, positive.
    Deceleration,
    /// Time within which it is reached.
    Ramp,
}

/// A unit that documents use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum ParameterUnit {
    /// Kilometres an hour.
    #[serde(rename = "km/h")]
    Kmph,
    /// Metres a second.
    #[serde(rename = "m/s")]
    Mps,
    /// Seconds.
    #[serde(rename = "s")]
    Second,
    /// Metres.
    #[serde(rename = "m")]
    Metre,
    /// Metres a second squared.
    #[serde(rename = "m/s2", alias = "m/s²", alias = "m/s^2")]
    Mps2,
    /// Standard gravity, 9.80665 m/s².
    #[serde(rename = "g")]
    Gravity,
}

/// Who says that a figure is so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The document states every value.
    Document,
    /// The document states the smallest and the largest value; those between are chosen here.
    Ends,
    /// Chosen here: what the document says could not be read, or it says nothing.
    Chosen,
}

/// The values of a parameter, which together with those of others make a grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a figure: a table of values, unit and origin")]
pub struct TestParameter {
    /// The values, increasing; 1 to 100 of them.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 100)))]
    pub values: Vec<f64>,
    /// Their unit.
    pub unit: ParameterUnit,
    /// Who says so.
    pub origin: Origin,
    /// How far a test may be from a value, both ways, in the unit: it has to pass there too, and the worst is searched for.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub tolerance: f64,
    /// Where the document says so, or why they were chosen.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// A value that a contact may have: the difference of the speeds up to which a test passes nevertheless.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "an impact speed: a table of value, unit and origin")]
pub struct ImpactLimit {
    /// The difference of the speeds at the contact.
    pub value: f64,
    /// Its unit: `km/h` or `m/s`.
    pub unit: ParameterUnit,
    /// Who says so.
    pub origin: Origin,
    /// Where the document says so, or why it was chosen.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// Whether a tolerance is none.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde calls it")]
fn is_zero(tolerance: &f64) -> bool {
    *tolerance == 0.0
}

/// The figures of a test.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a table of figures")]
pub struct TestParameters {
    /// Speed of the vehicle under test at the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own_speed: Option<TestParameter>,
    /// Speed of the vehicle ahead, of a slower one or one that cuts in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lead_speed: Option<TestParameter>,
    /// The gap at the start as the time that closing it takes, behind a vehicle that stands or is slower; that to a vehicle that
    /// cuts in when it enters; that of a vehicle that cuts out to the one that stands, when it leaves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub closing_time: Option<TestParameter>,
    /// The gap at the start, behind a vehicle that brakes or cuts out. There is either this or `time_gap`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gap: Option<TestParameter>,
    /// The gap at the start, behind a vehicle that brakes or cuts out, as the time that driving it takes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_gap: Option<TestParameter>,
    /// Braking of the vehicle ahead, positive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deceleration: Option<TestParameter>,
    /// Time within which it is reached.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ramp: Option<TestParameter>,
}

impl ParameterKind {
    /// All of them, in the order in which points state their values.
    pub const ALL: [Self; 7] =
        [Self::OwnSpeed, Self::LeadSpeed, Self::ClosingTime, Self::Gap, Self::TimeGap, Self::Deceleration, Self::Ramp];

    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::OwnSpeed => "own_speed",
            Self::LeadSpeed => "lead_speed",
            Self::ClosingTime => "closing_time",
            Self::Gap => "gap",
            Self::TimeGap => "time_gap",
            Self::Deceleration => "deceleration",
            Self::Ramp => "ramp",
        }
    }

    /// Its name in sentences.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::OwnSpeed => "own speed",
            Self::LeadSpeed => "lead speed",
            Self::ClosingTime => "closing time",
            Self::Gap => "gap",
            Self::TimeGap => "time gap",
            Self::Deceleration => "lead deceleration",
            Self::Ramp => "ramp",
        }
    }

    /// The units that it may be stated in.
    #[must_use]
    pub(crate) fn allowed_units(self) -> &'static [ParameterUnit] {
        match self {
            Self::OwnSpeed | Self::LeadSpeed => &[ParameterUnit::Kmph, ParameterUnit::Mps],
            Self::ClosingTime | Self::TimeGap | Self::Ramp => &[ParameterUnit::Second],
            Self::Gap => &[ParameterUnit::Metre],
            Self::Deceleration => &[ParameterUnit::Mps2, ParameterUnit::Gravity],
        }
    }

    /// The least and the largest value, in SI units.
    #[must_use]
    pub(crate) fn range(self) -> [f64; 2] {
        match self {
            Self::OwnSpeed | Self::LeadSpeed => [0.5, 100.0],
            Self::ClosingTime | Self::TimeGap => [0.1, 60.0],
            Self::Gap => [0.1, 1000.0],
            Self::Deceleration => [0.1, 30.0],
            Self::Ramp => [0.0, 60.0],
        }
    }
}

impl ParameterUnit {
    /// What one of it is in SI units.
    #[must_use]
    pub fn si_factor(self) -> f64 {
        match self {
            Self::Kmph => 1.0 / 3.6,
            Self::Mps | Self::Second | Self::Metre | Self::Mps2 => 1.0,
            Self::Gravity => STANDARD_GRAVITY_MPS2,
        }
    }
}

impl fmt::Display for ParameterUnit {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Kmph => "km/h",
            Self::Mps => "m/s",
            Self::Second => "s",
            Self::Metre => "m",
            Self::Mps2 => "m/s²",
            Self::Gravity => "g",
        })
    }
}

impl Origin {
    /// In words.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Document => "stated",
            Self::Ends => "ends stated, values between chosen",
            Self::Chosen => "chosen",
        }
    }
}

impl TestParameter {
    /// One value that was chosen here.
    pub(super) fn from_chosen(value: f64, unit: ParameterUnit) -> Self {
        Self { values: vec![value], unit, origin: Origin::Chosen, tolerance: 0.0, note: String::new() }
    }
}

impl TestParameters {
    /// The figure of a parameter.
    #[must_use]
    pub fn get(&self, parameter: ParameterKind) -> Option<&TestParameter> {
        match parameter {
            ParameterKind::OwnSpeed => self.own_speed.as_ref(),
            ParameterKind::LeadSpeed => self.lead_speed.as_ref(),
            ParameterKind::ClosingTime => self.closing_time.as_ref(),
            ParameterKind::Gap => self.gap.as_ref(),
            ParameterKind::TimeGap => self.time_gap.as_ref(),
            ParameterKind::Deceleration => self.deceleration.as_ref(),
            ParameterKind::Ramp => self.ramp.as_ref(),
        }
    }

    /// Those that are stated, in the order of [`ParameterKind::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = (ParameterKind, &TestParameter)> {
        ParameterKind::ALL.into_iter().filter_map(|parameter| Some((parameter, self.get(parameter)?)))
    }
}
