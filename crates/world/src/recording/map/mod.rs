//! Maps: what the columns of a recording mean, as a file.

mod check;
mod units;

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use crate::scenario::file::{FileError, parse_toml, read_at_most};

pub use units::{LengthUnit, SpeedUnit, TimeUnit};

use check::check;

/// Most bytes of a map.
const MAX_MAP_BYTES: u64 = 64 << 10;

/// What the columns of a recording mean, as a file states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a map: a table of fields")]
#[cfg_attr(feature = "schema", schemars(title = "crumple map of a recording, version 1"))]
pub struct RecordingMapSpec {
    /// Version of the format: 1.
    pub version: u32,
    /// First part of the names of imported scenarios: 1 to 40 lower-case letters, digits and hyphens.
    pub name: String,
    /// Lines, blank ones not counted, before the one that names the columns. Default 0.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 1000)))]
    pub lines_before_names: usize,
    /// What stands between columns. Default: a comma.
    #[serde(default)]
    pub delimiter: Delimiter,
    /// When each row was recorded.
    pub time: TimeSpec,
    /// Values missing for at most this long are filled by a straight line, in seconds. Default 0: none are.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 2.0)))]
    pub interpolate_s: f64,
    /// What a row holds.
    pub layout: LayoutSpec,
}

/// What stands between columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Delimiter {
    /// `,`
    #[default]
    Comma,
    /// `;`
    Semicolon,
    /// A tab.
    Tab,
}

/// When a row was recorded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TimeSpec {
    /// A column of times.
    Clock(ClockSpec),
    /// A column of numbers of frames.
    Frames(FramesSpec),
}

/// A column of times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ClockSpec {
    /// Name of the column.
    pub column: String,
    /// Default: seconds.
    #[serde(default)]
    pub unit: TimeUnit,
}

/// A column of numbers of frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FramesSpec {
    /// Name of the column.
    pub column: String,
    /// Frames a second.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.5, max = 1000.0)))]
    pub rate_hz: f64,
}

/// What a row holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LayoutSpec {
    /// One instant of a line of vehicles, in columns that are numbered front to rear.
    Platoon(PlatoonSpec),
    /// One instant of one vehicle that follows another.
    Pairs(PairsSpec),
    /// One instant of one vehicle among many.
    Tracks(TracksSpec),
}

/// One instant of a line of vehicles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PlatoonSpec {
    /// Columns of speeds; `{}` in the name stands for the vehicle's number, from 1.
    pub speed: SpeedSpec,
    /// Columns of spacings, numbered after the vehicle ahead.
    pub spacing: SpacingSpec,
    /// Length of the vehicles in metres, needed where spacings are from front to front.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 100.0)))]
    pub length_m: Option<f64>,
    /// First field of the line before the columns' names that names the vehicles, front to rear.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub names_line: Option<String>,
    /// First field of the line before the columns' names that says how many vehicles there were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count_line: Option<String>,
}

/// One instant of one vehicle that follows another. Two of the three speeds are needed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PairsSpec {
    /// Column of what tells events apart, rows of which stand together; without it, the file is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event: Option<String>,
    /// Column of spacings.
    pub spacing: SpacingSpec,
    /// Length of the vehicle ahead in metres, needed where spacings are from front to front.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 100.0)))]
    pub length_m: Option<f64>,
    /// Column of the follower's speed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follower_speed: Option<SpeedSpec>,
    /// Column of the leader's speed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader_speed: Option<SpeedSpec>,
    /// Column of the difference of the two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_speed: Option<RelativeSpeedSpec>,
}

/// One instant of one vehicle among many, as in highD and NGSIM.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TracksSpec {
    /// Column of the vehicle's number, whole, from 0.
    pub vehicle: String,
    /// Column of the lane; without it, all drive in one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lane: Option<String>,
    /// Column of positions along the road. Which way a vehicle drives shows in how its own change.
    pub position: PositionSpec,
    /// Column of speeds along the road; the sign does not matter.
    pub speed: SpeedSpec,
    /// The length of vehicles.
    pub length: LengthSpec,
}

/// A column of speeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SpeedSpec {
    /// Name of the column.
    pub column: String,
    /// Default: m/s.
    #[serde(default)]
    pub unit: SpeedUnit,
}

/// A column of differences of speeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RelativeSpeedSpec {
    /// Name of the column.
    pub column: String,
    /// Default: m/s.
    #[serde(default)]
    pub unit: SpeedUnit,
    /// Which is taken from which. Default: leader minus follower, negative when they close in.
    #[serde(default)]
    pub sign: Sign,
}

/// A column of spacings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SpacingSpec {
    /// Name of the column.
    pub column: String,
    /// Default: metres.
    #[serde(default)]
    pub unit: LengthUnit,
    /// From where to where. Default: bumper to bumper.
    #[serde(default)]
    pub from: Spacing,
}

/// A column of positions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PositionSpec {
    /// Name of the column.
    pub column: String,
    /// Default: metres.
    #[serde(default)]
    pub unit: LengthUnit,
    /// What of the vehicle is there.
    pub of: ReferencePoint,
}

/// The length of vehicles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LengthSpec {
    /// A column of lengths.
    Column(LengthColumnSpec),
    /// All are as long, in metres.
    Metres(f64),
}

/// A column of lengths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LengthColumnSpec {
    /// Name of the column.
    pub name: String,
    /// Default: metres.
    #[serde(default)]
    pub unit: LengthUnit,
}

/// Which speed is taken from which.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Sign {
    /// Negative when they close in.
    #[default]
    LeaderMinusFollower,
    /// Positive when they close in.
    FollowerMinusLeader,
}

/// From where to where a spacing is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Spacing {
    /// From the rear bumper ahead to the own front bumper.
    #[default]
    BumperToBumper,
    /// From front bumper to front bumper, the length of the vehicle ahead included.
    FrontToFront,
}

/// A point of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ReferencePoint {
    /// The front bumper.
    Front,
    /// Half-way between the bumpers.
    Centre,
    /// The rear bumper.
    Rear,
    /// Whichever bumper has the smaller position, as in highD: the rear one, or the front one of who drives the other way.
    LowEnd,
}

/// A map that was found valid.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingMap {
    spec: RecordingMapSpec,
}

impl RecordingMap {
    /// Reads a map.
    ///
    /// # Errors
    /// [`FileError`] for a file that cannot be read, has more than 64 KiB, or is no valid map, with line and field.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Self::from_toml(&read_at_most(path, MAX_MAP_BYTES)?, path)
    }

    /// Reads a map from TOML text; `path` only names it in errors.
    ///
    /// # Errors
    /// [`FileError`] for text that is no valid map.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, FileError> {
        let spec: RecordingMapSpec = parse_toml(text, path)?;
        check(&spec).map_err(|(field, problem)| FileError::from_field(path, text, &field, problem))?;
        Ok(Self { spec })
    }

    /// What it says.
    #[must_use]
    pub fn spec(&self) -> &RecordingMapSpec {
        &self.spec
    }

    /// The map of OpenACC files.
    pub(super) fn openacc() -> Result<Self, RecordingError> {
        parse_built_in(OPENACC)
    }

    /// The map of car-following events.
    pub(super) fn car_following() -> Result<Self, RecordingError> {
        parse_built_in(CAR_FOLLOWING)
    }
}

/// Name and text of every map that is built in.
pub const BUILT_IN_MAPS: [(&str, &str); 2] = [("openacc", OPENACC), ("car-following", CAR_FOLLOWING)];

const OPENACC: &str = include_str!("../built_in/openacc.toml");
const CAR_FOLLOWING: &str = include_str!("../built_in/car-following.toml");

fn parse_built_in(text: &str) -> Result<RecordingMap, RecordingError> {
    RecordingMap::from_toml(text, Path::new("built in")).map_err(|error| RecordingError::Map(Box::new(error)))
}

/// The JSON Schema of maps.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(RecordingMapSpec).to_value()
}
