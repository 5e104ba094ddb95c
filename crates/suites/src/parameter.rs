//! Parameters of a suite: the numbers of a clause in the document's units, with their origin.

use std::fmt;

use serde::{Deserialize, Serialize};

use crumple_sim::control::STANDARD_GRAVITY_MPS2;

/// Quantity of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ParameterKind {
    /// Speed of the vehicle under test at the start.
    OwnSpeed,
    /// Speed of the vehicle ahead.
    LeadSpeed,
    /// Gap at the start, or when a vehicle enters or leaves the lane, divided by the closing speed.
    ClosingTime,
    /// Gap at the start.
    Gap,
    /// Gap at the start, divided by the speed of the vehicle under test.
    TimeGap,
    /// Deceleration of the vehicle ahead, positive.
    Deceleration,
    /// Time to reach that deceleration.
    Ramp,
    /// Time for which the sensor reports an object that does not exist.
    GhostTime,
    /// Distance from the start to the place of such an object, divided by the speed at the start.
    ApproachTime,
    /// Deceleration, beyond that of manual braking, from which a test without a vehicle in the way fails.
    AllowedDeceleration,
    /// Deceleration of manual braking, positive.
    ManualDeceleration,
    /// Time from the warning to the onset of manual braking.
    ManualDelay,
    /// Distance to the place of an object that does not exist, divided by the speed at the start, at which manual
    /// braking begins.
    ManualClosingTime,
    /// Gap divided by the closing speed at which the reference warning is given. A controller that reports warnings
    /// needs no reference warning.
    WarningClosingTime,
}

/// Unit that documents use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum ParameterUnit {
    /// Kilometres per hour.
    #[serde(rename = "km/h")]
    Kmph,
    /// Metres per second.
    #[serde(rename = "m/s")]
    Mps,
    /// Seconds.
    #[serde(rename = "s")]
    Second,
    /// Metres.
    #[serde(rename = "m")]
    Metre,
    /// Metres per second squared.
    #[serde(rename = "m/s2", alias = "m/s²", alias = "m/s^2")]
    Mps2,
    /// Standard gravity, 9.80665 m/s².
    #[serde(rename = "g")]
    Gravity,
}

/// Origin of a parameter or limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The document states every value.
    Document,
    /// The document states the smallest and the largest value; crumple chose those between.
    Ends,
    /// crumple chose the values: the document states none, or could not be read.
    Chosen,
}

/// Values of one parameter. The grid of a test combines those of all its parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    deny_unknown_fields,
    expecting = "a figure: a table of values, unit and origin"
)]
pub struct TestParameter {
    /// Values, increasing; 1 to 100 of them.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 100)))]
    pub values: Vec<f64>,
    /// Unit of the values.
    pub unit: ParameterUnit,
    /// Origin of the values.
    pub origin: Origin,
    /// Allowed deviation from each value, up and down, in `unit`. The test must pass at every value within it. crumple
    /// searches for the worst one.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub tolerance: f64,
    /// Place in the document, or reason for the choice.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// Largest impact speed that passes a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    deny_unknown_fields,
    expecting = "an impact speed: a table of value, unit and origin"
)]
pub struct ImpactLimit {
    /// Impact speed.
    pub value: f64,
    /// Unit: `km/h` or `m/s`.
    pub unit: ParameterUnit,
    /// Origin of the value.
    pub origin: Origin,
    /// Place in the document, or reason for the choice.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// True for the default, which files omit.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde calls it")]
fn is_zero(tolerance: &f64) -> bool {
    *tolerance == 0.0
}

/// Parameters of a test.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a table of parameters")]
pub struct TestParameters {
    /// Speed of the vehicle under test at the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own_speed: Option<TestParameter>,
    /// Speed of the vehicle ahead, if it is slower or cuts in. A vehicle that brakes has the speed of the vehicle under
    /// test by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lead_speed: Option<TestParameter>,
    /// Gap divided by the closing speed. Behind a standing or slower vehicle it is the value at the start; for a
    /// cut-in, the value when the vehicle enters; for a cut-out, that of the leaving vehicle towards the standing one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub closing_time: Option<TestParameter>,
    /// Gap at the start, behind a vehicle that brakes or cuts out. A test has either this or `time_gap`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gap: Option<TestParameter>,
    /// Gap at the start, behind a vehicle that brakes or cuts out, divided by the speed of the vehicle under test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_gap: Option<TestParameter>,
    /// Deceleration of the vehicle ahead, positive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deceleration: Option<TestParameter>,
    /// Time to reach that deceleration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ramp: Option<TestParameter>,
    /// Time for which the sensor reports an object that does not exist.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ghost_time: Option<TestParameter>,
    /// Distance from the start to the place of such an object, divided by the speed at the start. By default 2 s more
    /// than the closing time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub approach_time: Option<TestParameter>,
    /// Deceleration, beyond that of manual braking, from which a test without a vehicle in the way fails. By default
    /// 0.25 g.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub allowed_deceleration: Option<TestParameter>,
    /// Deceleration of manual braking, positive. It builds up in 0.25 s and lasts until the end of the test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub manual_deceleration: Option<TestParameter>,
    /// Time from the warning to the onset of manual braking, with a vehicle in the way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub manual_delay: Option<TestParameter>,
    /// Distance to the place of an object that does not exist, divided by the speed at the start, at which manual
    /// braking begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub manual_closing_time: Option<TestParameter>,
    /// Gap divided by the closing speed, as the controller observes them, at which the reference warning is given. A
    /// controller that reports warnings needs no reference warning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning_closing_time: Option<TestParameter>,
}

impl ParameterKind {
    /// All parameters, in the order of the values of a point.
    pub const ALL: [Self; 14] = [
        Self::OwnSpeed,
        Self::LeadSpeed,
        Self::ClosingTime,
        Self::Gap,
        Self::TimeGap,
        Self::Deceleration,
        Self::Ramp,
        Self::GhostTime,
        Self::ApproachTime,
        Self::AllowedDeceleration,
        Self::ManualDeceleration,
        Self::ManualDelay,
        Self::ManualClosingTime,
        Self::WarningClosingTime,
    ];

    /// Returns the name in files.
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
            Self::GhostTime => "ghost_time",
            Self::ApproachTime => "approach_time",
            Self::AllowedDeceleration => "allowed_deceleration",
            Self::ManualDeceleration => "manual_deceleration",
            Self::ManualDelay => "manual_delay",
            Self::ManualClosingTime => "manual_closing_time",
            Self::WarningClosingTime => "warning_closing_time",
        }
    }

    /// Returns the name in sentences.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::OwnSpeed => "own speed",
            Self::LeadSpeed => "leader's speed",
            Self::ClosingTime => "closing time",
            Self::Gap => "gap",
            Self::TimeGap => "time gap",
            Self::Deceleration => "leader's deceleration",
            Self::Ramp => "ramp",
            Self::GhostTime => "ghost time",
            Self::ApproachTime => "approach time",
            Self::AllowedDeceleration => "allowed deceleration",
            Self::ManualDeceleration => "manual deceleration",
            Self::ManualDelay => "manual delay",
            Self::ManualClosingTime => "manual closing time",
            Self::WarningClosingTime => "warning closing time",
        }
    }

    #[must_use]
    pub(crate) fn allowed_units(self) -> &'static [ParameterUnit] {
        match self {
            Self::OwnSpeed | Self::LeadSpeed => &[ParameterUnit::Kmph, ParameterUnit::Mps],
            Self::ClosingTime
            | Self::TimeGap
            | Self::Ramp
            | Self::GhostTime
            | Self::ApproachTime
            | Self::ManualDelay
            | Self::ManualClosingTime
            | Self::WarningClosingTime => &[ParameterUnit::Second],
            Self::Gap => &[ParameterUnit::Metre],
            Self::Deceleration | Self::AllowedDeceleration | Self::ManualDeceleration => {
                &[ParameterUnit::Mps2, ParameterUnit::Gravity]
            }
        }
    }

    /// Returns the smallest and the largest allowed value, in SI units.
    #[must_use]
    pub(crate) fn range(self) -> [f64; 2] {
        match self {
            Self::OwnSpeed | Self::LeadSpeed => [0.5, 100.0],
            Self::ClosingTime
            | Self::TimeGap
            | Self::ApproachTime
            | Self::ManualClosingTime
            | Self::WarningClosingTime => [0.1, 60.0],
            Self::Gap => [0.1, 1000.0],
            Self::Deceleration | Self::AllowedDeceleration | Self::ManualDeceleration => {
                [0.1, 30.0]
            }
            Self::Ramp | Self::GhostTime | Self::ManualDelay => [0.0, 60.0],
        }
    }
}

impl ParameterKind {
    /// True for a parameter of the test driver, or of a test without a vehicle in the way. The description of a point
    /// omits it if it does not vary.
    pub(crate) fn is_of_driver_or_limit(self) -> bool {
        matches!(
            self,
            Self::ApproachTime
                | Self::AllowedDeceleration
                | Self::ManualDeceleration
                | Self::ManualDelay
                | Self::ManualClosingTime
                | Self::WarningClosingTime
        )
    }
}

impl TestParameter {
    /// True for several values, or a value with a tolerance.
    pub(crate) fn varies(&self) -> bool {
        self.values.len() > 1 || self.tolerance > 0.0
    }
}

impl ParameterUnit {
    /// Returns the factor that converts to SI units.
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
    /// Returns the description for readers.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Document => "stated",
            Self::Ends => "ends stated, values between chosen",
            Self::Chosen => "chosen",
        }
    }
}

impl TestParameters {
    /// Returns a parameter.
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
            ParameterKind::GhostTime => self.ghost_time.as_ref(),
            ParameterKind::ApproachTime => self.approach_time.as_ref(),
            ParameterKind::AllowedDeceleration => self.allowed_deceleration.as_ref(),
            ParameterKind::ManualDeceleration => self.manual_deceleration.as_ref(),
            ParameterKind::ManualDelay => self.manual_delay.as_ref(),
            ParameterKind::ManualClosingTime => self.manual_closing_time.as_ref(),
            ParameterKind::WarningClosingTime => self.warning_closing_time.as_ref(),
        }
    }

    /// Iterates over the stated parameters, in the order of [`ParameterKind::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = (ParameterKind, &TestParameter)> {
        ParameterKind::ALL
            .into_iter()
            .filter_map(|parameter| Some((parameter, self.get(parameter)?)))
    }
}
