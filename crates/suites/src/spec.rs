//! A suite as a file states it.

use serde::{Deserialize, Serialize};

use super::parameter::{ImpactLimit, Origin, ParameterKind, TestParameter, TestParameters};
use super::run::Criterion;

/// A suite as a file states it: plain data that may hold nonsense.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a suite: a table of fields")]
#[cfg_attr(feature = "schema", schemars(rename = "Suite", title = "crumple suite, version 1"))]
pub struct SuiteSpec {
    /// Version of the file format: 1.
    pub version: u32,
    /// Short name: small letters, digits and hyphens.
    pub name: String,
    /// What it tests, in a sentence.
    pub about: String,
    /// The document that it is after.
    pub document: String,
    /// Its edition.
    pub edition: String,
    /// What the figures were read from.
    #[serde(rename = "figures_from")]
    pub parameter_source: String,
    /// What the document asks for and the model does not have.
    #[serde(default)]
    #[serde(rename = "outside")]
    pub not_modelled: Vec<String>,
    /// Figures that were left out, and why.
    #[serde(default)]
    #[serde(rename = "left_out")]
    pub omitted_parameters: Vec<String>,
    /// Its clauses; 1 to 100.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 100)))]
    pub clauses: Vec<ClauseSpec>,
}

/// A clause and its tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a clause: a table of fields")]
pub struct ClauseSpec {
    /// Its number in the document.
    pub clause: String,
    /// What it says, in short.
    #[serde(rename = "says")]
    pub summary: String,
    /// Its tests; 1 to 100. A test passes if there is no contact before it ends, or none faster than it allows.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 100)))]
    pub tests: Vec<TestSpec>,
}

/// A test of a clause: a situation and its figures, or the reason why there is none.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a test: a table of fields")]
pub struct TestSpec {
    /// Short name, unique in the suite: small letters, digits and hyphens.
    pub name: String,
    /// What the vehicle ahead does. Either this or `refused`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lead: Option<LeadManeuver>,
    /// Why the test cannot be run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "refused")]
    pub refusal_reason: Option<String>,
    /// Its figures. The test is run at every combination of their values.
    #[serde(default)]
    #[serde(rename = "figures")]
    pub parameters: TestParameters,
    /// The fastest contact at which it passes nevertheless; without it no contact passes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub impact_at_most: Option<ImpactLimit>,
    /// Figures of which the document allows every value from the smallest to the largest: the worst point is searched for there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(length(max = 7)))]
    pub ranges: Vec<ParameterKind>,
    /// How it is pushed until it fails.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(length(max = 10)))]
    pub margins: Vec<MarginSweep>,
}

/// What the vehicle ahead does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum LeadManeuver {
    /// It stands. The test ends when the vehicle under test stands.
    Stopped,
    /// It drives slower, at a constant speed. The test ends when the vehicle under test no longer closes in.
    Slower,
    /// It drives as fast as the vehicle under test and brakes to standstill from the start on. The test ends when the vehicle under
    /// test stands.
    Decelerating,
    /// It cuts in: slower, it enters the lane at the start, as far ahead as the closing time says. 300 m ahead of it drives a vehicle
    /// that is as fast as the vehicle under test. The test ends when the vehicle under test no longer closes in.
    CutIn,
    /// It cuts out: as fast as the vehicle under test, it leaves the lane at the start, the closing time before a vehicle that stands.
    /// The test ends when the vehicle under test stands.
    CutOut,
}

/// A direction in which a test is made harder.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a direction: a table of `push` and `to`")]
pub struct MarginSweep {
    /// What is pushed, from the value of the grid that is next to `to`.
    #[serde(rename = "push")]
    pub parameter: ParameterKind,
    /// How far, in the unit of the figure; beyond all its values.
    pub to: f64,
}

impl LeadManeuver {
    /// The figures that it needs: one of each entry.
    #[must_use]
    pub(crate) fn parameters(self) -> &'static [&'static [ParameterKind]] {
        use ParameterKind::{ClosingTime, Deceleration, Gap, LeadSpeed, OwnSpeed, Ramp, TimeGap};
        match self {
            Self::Stopped => &[&[OwnSpeed], &[ClosingTime]],
            Self::Slower | Self::CutIn => &[&[OwnSpeed], &[LeadSpeed], &[ClosingTime]],
            Self::Decelerating => &[&[OwnSpeed], &[Gap, TimeGap], &[Deceleration], &[Ramp]],
            Self::CutOut => &[&[OwnSpeed], &[Gap, TimeGap], &[ClosingTime]],
        }
    }

    /// The place of the vehicle under test in the line, from the front.
    #[must_use]
    pub(crate) fn under_test_index(self) -> usize {
        match self {
            Self::Stopped | Self::Slower | Self::Decelerating => 1,
            Self::CutIn | Self::CutOut => 2,
        }
    }

    /// Whether the vehicle under test has to be faster than the one ahead.
    pub(super) fn requires_slower_lead(self) -> bool {
        matches!(self, Self::Slower | Self::CutIn)
    }

    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stopped => "stopped",
            Self::Slower => "slower",
            Self::Decelerating => "decelerating",
            Self::CutIn => "cut-in",
            Self::CutOut => "cut-out",
        }
    }
}

impl TestSpec {
    /// Whether all that the document asks for is as it states it; else some figure was chosen.
    #[must_use]
    pub(crate) fn is_as_stated(&self) -> bool {
        let figures = self.parameters.iter().map(|(_, figure)| figure.origin);
        figures.chain(self.impact_at_most.iter().map(|limit| limit.origin)).all(|origin| origin != Origin::Chosen)
    }

    /// When it is over and what passes; none if it cannot be run.
    pub(super) fn criterion(&self) -> Option<Criterion> {
        let impact_at_most_mps = self.impact_at_most.as_ref().map(|limit| limit.value * limit.unit.si_factor());
        Some(Criterion { lead: self.lead?, impact_at_most_mps })
    }

    /// Every combination of the figures' values, in the units of the figures; the last figure varies fastest.
    #[must_use]
    pub fn grid(&self) -> Vec<Vec<f64>> {
        self.parameters.iter().fold(vec![Vec::new()], |points, (_, figure)| {
            let extended = |point: &Vec<f64>| {
                let each = |&value: &f64| point.iter().copied().chain([value]).collect();
                figure.values.iter().map(each).collect::<Vec<_>>()
            };
            points.iter().flat_map(extended).collect()
        })
    }

    /// How many combinations there are.
    pub(super) fn point_count(&self) -> usize {
        self.parameters.iter().fold(1, |points: usize, (_, figure)| points.saturating_mul(figure.values.len()))
    }

    /// Where a parameter stands in a point.
    pub(super) fn find_parameter(&self, parameter: ParameterKind) -> Option<(usize, &TestParameter)> {
        let mut stated = self.parameters.iter().enumerate();
        stated.find(|(_, (found, _))| *found == parameter).map(|(place, (_, figure))| (place, figure))
    }

    /// A point in words, as in `own speed 50 km/h, gap 12 m`.
    #[must_use]
    pub(crate) fn describe_point(&self, point: &[f64]) -> String {
        self.describe_point_without(point, None)
    }

    /// A point in words, without the value at a place.
    pub(super) fn describe_point_without(&self, point: &[f64], without: Option<usize>) -> String {
        let each = self.parameters.iter().zip(point).enumerate().filter(|(place, _)| Some(*place) != without);
        let words =
            each.map(|(_, ((parameter, figure), value))| format!("{} {value} {}", parameter.label(), figure.unit));
        words.collect::<Vec<_>>().join(", ")
    }
}

/// A point with another value at a place.
pub(super) fn with_value(point: &[f64], place: usize, value: f64) -> Vec<f64> {
    point.iter().enumerate().map(|(at, &old)| if at == place { value } else { old }).collect()
}
