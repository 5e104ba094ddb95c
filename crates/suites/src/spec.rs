//! Data types of a suite file.

use serde::{Deserialize, Serialize};

use super::parameter::{ImpactLimit, Origin, ParameterKind, TestParameter, TestParameters};
use super::run::Criterion;

/// A suite as its file states it, before validation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a suite: a table of fields")]
#[cfg_attr(
    feature = "schema",
    schemars(rename = "Suite", title = "crumple suite, version 1")
)]
pub struct SuiteSpec {
    /// Version of the file format: 1.
    pub version: u32,
    /// Short name: small letters, digits and hyphens.
    pub name: String,
    /// Purpose of the suite, in a sentence.
    pub about: String,
    /// Document that the suite is modelled on.
    pub document: String,
    /// Edition of the document.
    pub edition: String,
    /// Source of the parameters.
    #[serde(alias = "figures_from")]
    pub parameter_source: String,
    /// Requirements of the document that the model cannot represent.
    #[serde(default)]
    #[serde(alias = "outside")]
    pub not_modelled: Vec<String>,
    /// Omitted parameters, each with the reason.
    #[serde(default)]
    #[serde(alias = "left_out")]
    pub omitted_parameters: Vec<String>,
    /// Runs of each point, 1 to 100, each with another seed: the worst one counts. Default: 1, and 10 for a controller
    /// that acts at random.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 100)))]
    pub seeds: Option<u32>,
    /// Clauses; 1 to 100.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 100)))]
    pub clauses: Vec<ClauseSpec>,
}

/// A clause and its tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a clause: a table of fields")]
pub struct ClauseSpec {
    /// Number of the clause in the document.
    pub clause: String,
    /// Summary of the clause.
    #[serde(alias = "says")]
    pub summary: String,
    /// Tests; 1 to 100. A test passes if it ends without a collision, or with one at most as fast as `impact_at_most`.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 100)))]
    pub tests: Vec<TestSpec>,
}

/// A test of a clause: a manoeuvre and its parameters, or the reason why the test cannot be run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a test: a table of fields")]
pub struct TestSpec {
    /// Short name, unique in the suite: small letters, digits and hyphens.
    pub name: String,
    /// Names of the requirements that the test verifies, at most 100, each of 1 to 200 bytes without a comma.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(length(max = 100)))]
    pub requirement: Vec<String>,
    /// Manoeuvre of the vehicle ahead. A test has either this or `refusal_reason`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lead: Option<LeadManeuver>,
    /// Reason why the test cannot be run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "refused")]
    pub refusal_reason: Option<String>,
    /// Parameters. The test is run at every combination of their values.
    #[serde(default)]
    #[serde(alias = "figures")]
    pub parameters: TestParameters,
    /// True if the test driver holds the speed of the start: the vehicle under test brakes, but does not accelerate.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub holds_speed: bool,
    /// Largest impact speed that passes; without it no collision passes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub impact_at_most: Option<ImpactLimit>,
    /// Parameters for which the document allows every value from the smallest to the largest. The worst point between
    /// them is searched for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(length(max = 14)))]
    pub ranges: Vec<ParameterKind>,
    /// Directions in which the test is made harder until it fails.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(length(max = 10)))]
    pub margins: Vec<MarginSweep>,
}

/// Manoeuvre of the vehicle ahead.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum LeadManeuver {
    /// The vehicle ahead stands. The test ends when the vehicle under test stands.
    Stopped,
    /// The vehicle ahead is slower, at constant speed. The test ends when the vehicle under test no longer closes in.
    Slower,
    /// The vehicle ahead brakes to standstill from the start, from the speed of the vehicle under test unless
    /// `lead_speed` is stated. The test ends when the vehicle under test stands.
    Decelerating,
    /// A slower vehicle enters the lane at the start, at the gap that the closing time determines. 300 m ahead of it
    /// drives a vehicle at the speed of the vehicle under test. The test ends when the vehicle under test no longer
    /// closes in.
    CutIn,
    /// The vehicle ahead has the speed of the vehicle under test and leaves the lane at the start. Its gap to a
    /// standing vehicle ahead is then the closing time multiplied by its speed. The test ends when the vehicle under
    /// test stands.
    CutOut,
    /// No vehicle is in the way. For `ghost_time` the sensor reports a standing object that does not exist, at the gap
    /// that the closing time determines. 300 m ahead drives a vehicle at the speed of the vehicle under test. The test
    /// fails if the vehicle under test brakes with `allowed_deceleration` or more beyond manual braking. The test ends
    /// when the front of the vehicle under test reaches the place of the object, or when the vehicle stands.
    Ghost,
    /// The manoeuvre `ghost` for a pair of standing vehicles beside the path: the test ends when the rear of the
    /// vehicle under test passes their front, or when the vehicle stands.
    PassThrough,
}

/// Direction in which a test is made harder.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    deny_unknown_fields,
    expecting = "a direction: a table of `parameter` and `to`"
)]
pub struct MarginSweep {
    /// Parameter that is varied. The first value is the value of the grid nearest to `to`.
    #[serde(alias = "push")]
    pub parameter: ParameterKind,
    /// Last value, in the unit of the parameter; beyond all its values.
    pub to: f64,
}

impl LeadManeuver {
    /// Returns the parameters that the manoeuvre needs. An entry with two parameters means that either is enough.
    #[must_use]
    pub(crate) fn parameters(self) -> &'static [&'static [ParameterKind]] {
        use ParameterKind::{
            ClosingTime, Deceleration, Gap, GhostTime, LeadSpeed, OwnSpeed, Ramp, TimeGap,
        };
        match self {
            Self::Stopped => &[&[OwnSpeed], &[ClosingTime]],
            Self::Slower | Self::CutIn => &[&[OwnSpeed], &[LeadSpeed], &[ClosingTime]],
            Self::Decelerating => &[&[OwnSpeed], &[Gap, TimeGap], &[Deceleration], &[Ramp]],
            Self::CutOut => &[&[OwnSpeed], &[Gap, TimeGap], &[ClosingTime]],
            Self::Ghost | Self::PassThrough => &[&[OwnSpeed], &[ClosingTime], &[GhostTime]],
        }
    }

    /// Returns the parameters that a test with the manoeuvre may state. An entry with several parameters means that a
    /// test states all of them or none.
    #[must_use]
    pub(crate) fn optional_parameters(self) -> &'static [&'static [ParameterKind]] {
        use ParameterKind::{
            AllowedDeceleration, ApproachTime, LeadSpeed, ManualClosingTime, ManualDeceleration,
            ManualDelay, WarningClosingTime,
        };
        match self {
            Self::Stopped | Self::Slower | Self::CutIn | Self::CutOut => {
                &[&[ManualDeceleration, ManualDelay, WarningClosingTime]]
            }
            Self::Decelerating => &[
                &[LeadSpeed],
                &[ManualDeceleration, ManualDelay, WarningClosingTime],
            ],
            Self::Ghost | Self::PassThrough => &[
                &[ApproachTime],
                &[AllowedDeceleration],
                &[ManualDeceleration, ManualClosingTime],
            ],
        }
    }

    /// True if no vehicle is in the way, so that braking is a false activation.
    pub(super) fn is_false_activation(self) -> bool {
        matches!(self, Self::Ghost | Self::PassThrough)
    }

    #[must_use]
    pub(crate) fn under_test_index(self) -> usize {
        match self {
            Self::Stopped | Self::Slower | Self::Decelerating | Self::Ghost | Self::PassThrough => {
                1
            }
            Self::CutIn | Self::CutOut => 2,
        }
    }

    pub(super) fn requires_slower_lead(self) -> bool {
        matches!(self, Self::Slower | Self::CutIn)
    }

    /// Returns the name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stopped => "stopped",
            Self::Slower => "slower",
            Self::Decelerating => "decelerating",
            Self::CutIn => "cut-in",
            Self::CutOut => "cut-out",
            Self::Ghost => "ghost",
            Self::PassThrough => "pass-through",
        }
    }
}

impl TestSpec {
    #[must_use]
    pub(crate) fn is_as_stated(&self) -> bool {
        let figures = self.parameters.iter().map(|(_, figure)| figure.origin);
        figures
            .chain(self.impact_at_most.iter().map(|limit| limit.origin))
            .all(|origin| origin != Origin::Chosen)
    }

    pub(super) fn criterion(&self) -> Option<Criterion> {
        let impact_at_most_mps = self
            .impact_at_most
            .as_ref()
            .map(|limit| limit.value * limit.unit.si_factor());
        Some(Criterion {
            lead: self.lead?,
            impact_at_most_mps,
        })
    }

    /// True if the driver brakes after a warning.
    #[must_use]
    pub(crate) fn has_warning(&self) -> bool {
        self.parameters.warning_closing_time.is_some()
    }

    /// Returns all combinations of the values, in the units of the parameters; the last parameter varies fastest.
    #[must_use]
    pub fn grid(&self) -> Vec<Vec<f64>> {
        self.parameters
            .iter()
            .fold(vec![Vec::new()], |points, (_, figure)| {
                let mut extended = Vec::new();
                for point in &points {
                    for &value in &figure.values {
                        extended.push(point.iter().copied().chain([value]).collect());
                    }
                }
                extended
            })
    }

    pub(super) fn point_count(&self) -> usize {
        self.parameters
            .iter()
            .fold(1, |points: usize, (_, figure)| {
                points.saturating_mul(figure.values.len())
            })
    }

    pub(super) fn find_parameter(
        &self,
        parameter: ParameterKind,
    ) -> Option<(usize, &TestParameter)> {
        let mut stated = self.parameters.iter().enumerate();
        stated
            .find(|(_, (kind, _))| *kind == parameter)
            .map(|(position, (_, figure))| (position, figure))
    }

    /// Describes a point, as in `own speed 50 km/h, gap 12 m`.
    #[must_use]
    pub fn describe_point(&self, point: &[f64]) -> String {
        self.describe_point_without(point, None)
    }

    pub(super) fn describe_point_without(&self, point: &[f64], without: Option<usize>) -> String {
        let mut values = Vec::new();
        for (position, ((parameter, figure), value)) in
            self.parameters.iter().zip(point).enumerate()
        {
            if Some(position) != without && (figure.varies() || !parameter.is_of_driver_or_limit())
            {
                values.push(format!("{} {value} {}", parameter.label(), figure.unit));
            }
        }
        values.join(", ")
    }
}

/// Returns a point with another value at a position.
pub(super) fn with_value(point: &[f64], position: usize, value: f64) -> Vec<f64> {
    point
        .iter()
        .enumerate()
        .map(|(index, &old)| if index == position { value } else { old })
        .collect()
}
