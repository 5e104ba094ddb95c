//! Maps: files that state the meaning of the columns of a recording.

mod built_in;
mod check;
mod units;

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

#[cfg(feature = "mdf")]
pub(in crate::recording) use check::ColumnRole;
pub(in crate::recording) use check::is_same_name;
pub(in crate::recording) use units::{
    ColumnUnit, NamedUnit, list_units, unit_by_name, unit_in_name, unknown_unit_in_name, words,
};

pub use built_in::{BUILT_IN_MAPS, RecordingMap};
pub use units::{
    AccelerationUnit, DecimalMark, Delimiter, LengthUnit, ReferencePoint, Sign, Spacing, SpeedUnit,
    TimeUnit,
};

/// Content of a map file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(title = "crumple map of a recording, version 1")
)]
#[serde(deny_unknown_fields, expecting = "a map: a table of fields")]
pub struct RecordingMapSpec {
    /// Version of the format: 1.
    pub version: u32,
    /// First part of the names of imported scenarios: 1 to 40 lower-case letters, digits and hyphens.
    pub name: String,
    /// Number of lines, without blank ones, before the column names. Default 0.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 1000)))]
    pub lines_before_names: usize,
    /// Separator of columns. Default: detected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delimiter: Option<Delimiter>,
    /// Mark of decimals. Default: detected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decimal: Option<DecimalMark>,
    /// DBC file that describes the raw CAN frames of MDF files; a relative path starts at the folder of the map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dbc: Option<PathBuf>,
    /// Bus channel of the raw CAN frames: one for all messages, or a table of channels by the names of messages.
    /// Default: any, if only one channel has frames of the signals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bus_channel: Option<FrameChoice>,
    /// Source address of J1939 messages that have the address 254 (any) in the DBC file: one for all, or a table by the
    /// names of messages. Default: any, if only one address sends the signals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_address: Option<FrameChoice>,
    /// Time of each row.
    pub time: TimeSpec,
    /// Longest hole that is interpolated linearly, in seconds. Default 0: none.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 2.0)))]
    pub interpolate_s: f64,
    /// Content of a row.
    pub layout: LayoutSpec,
}

impl RecordingMapSpec {
    /// Returns the text of a map file.
    ///
    /// # Errors
    /// [`toml::ser::Error`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Creates a map with detected separators and without interpolation.
    pub(in crate::recording) fn new(name: String, time: TimeSpec, layout: LayoutSpec) -> Self {
        Self {
            version: check::MAP_VERSION,
            name,
            lines_before_names: 0,
            delimiter: None,
            decimal: None,
            dbc: None,
            bus_channel: None,
            source_address: None,
            time,
            interpolate_s: 0.0,
            layout,
        }
    }
}

/// Frames of some messages, by a number of their bus or sender.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    untagged,
    expecting = "must be a number from 0 to 255, or a table of such numbers by the names of messages"
)]
pub enum FrameChoice {
    /// One number for all messages.
    All(u8),
    /// A number for each of some messages, by name.
    ByMessage(BTreeMap<String, u8>),
}

impl FrameChoice {
    /// Returns the number for a message; `None` for any.
    #[cfg(feature = "mdf")]
    pub(in crate::recording) fn for_message(&self, message: &str) -> Option<u64> {
        match self {
            Self::All(number) => Some(u64::from(*number)),
            Self::ByMessage(numbers) => numbers.get(message).copied().map(u64::from),
        }
    }
}

/// Time of a row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TimeSpec {
    /// A column of times.
    Clock(ClockSpec),
    /// A column of frame numbers.
    Frames(FramesSpec),
}

/// A column of times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ClockSpec {
    /// Name of the column.
    pub column: String,
    /// Unit of numbers. Default: seconds, or a smaller unit if times are above 10^11. ISO 8601 time stamps need none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<TimeUnit>,
}

/// A column of frame numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FramesSpec {
    /// Name of the column.
    pub column: String,
    /// Frames per second.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.5, max = 1000.0)))]
    pub rate_hz: f64,
}

/// Content of a row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LayoutSpec {
    /// State of a line of vehicles, in columns numbered front to rear.
    Platoon(PlatoonSpec),
    /// State of one follower and its leader.
    Pairs(PairsSpec),
    /// State of one vehicle among many.
    Tracks(TracksSpec),
}

/// Columns of a line of vehicles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PlatoonSpec {
    /// Columns of speeds; `{}` in the name stands for the vehicle's number, from 1.
    pub speed: SpeedSpec,
    /// Columns of spacings, with the number of the vehicle ahead.
    pub spacing: SpacingSpec,
    /// Length of the vehicles in metres, required for spacings from front to front.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 100.0)))]
    pub length_m: Option<f64>,
    /// First field of the line before the column names that lists the vehicles, front to rear.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub names_line: Option<String>,
    /// First field of the line before the column names that states the number of vehicles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count_line: Option<String>,
}

/// Columns of a follower and its leader. Two of the three speeds are required.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PairsSpec {
    /// Column of the event, whose rows are consecutive. Default: the file is one event.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event: Option<String>,
    /// Column of spacings.
    pub spacing: SpacingSpec,
    /// Length of the leader in metres, required for spacings from front to front.
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
    /// Columns of the vehicle behind the follower, as a rear radar measures it. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub behind: Option<BehindSpec>,
}

/// Columns of the vehicle behind the follower: the spacing, and its speed or the difference of speeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct BehindSpec {
    /// Column of spacings between the follower and the vehicle behind it.
    pub spacing: SpacingSpec,
    /// Length of the follower in metres, required for spacings from front to front.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 100.0)))]
    pub length_m: Option<f64>,
    /// Column of the speed of the vehicle behind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed: Option<SpeedSpec>,
    /// Column of the difference of speeds, in place of `speed`; the follower is the leader of the vehicle behind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_speed: Option<RelativeSpeedSpec>,
}

/// Columns of one vehicle among many, as in highD and NGSIM.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TracksSpec {
    /// Column of vehicle ids: whole numbers or text.
    pub vehicle: String,
    /// Column of lanes. Default: a single lane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lane: Option<String>,
    /// Column of positions along the road. Their change from row to row gives the direction of driving.
    pub position: PositionSpec,
    /// Column of speeds along the road; the sign does not matter.
    pub speed: SpeedSpec,
    /// Length of the vehicles.
    pub length: LengthSpec,
    /// Lane ids that a vehicle has for less than this time, in seconds, are ignored. Default 0.5.
    #[serde(default = "default_lane_blip_s")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 5.0)))]
    pub lane_blip_s: f64,
}

fn default_lane_blip_s() -> f64 {
    0.5
}

/// A column of speeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SpeedSpec {
    /// Name of the column.
    pub column: String,
    /// Unit. Default: that in the file, or m/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<SpeedUnit>,
    /// Column of the accelerations, which only checks the speeds. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration: Option<AccelerationSpec>,
}

/// A column of accelerations, positive when the speed grows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct AccelerationSpec {
    /// Name of the column.
    pub column: String,
    /// Unit. Default: that in the file, or m/s2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<AccelerationUnit>,
}

/// A column of speed differences.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RelativeSpeedSpec {
    /// Name of the column.
    pub column: String,
    /// Unit. Default: that in the file, or m/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<SpeedUnit>,
    /// Sign of the difference. Default: leader minus follower, negative when the gap closes.
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
    /// Unit. Default: that in the file, or metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<LengthUnit>,
    /// Reference points. Default: bumper to bumper.
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
    /// Unit. Default: that in the file, or metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<LengthUnit>,
    /// Reference point of the vehicle.
    pub of: ReferencePoint,
}

/// Length of vehicles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LengthSpec {
    /// A column of lengths.
    Column(LengthColumnSpec),
    /// One length of all vehicles, in metres.
    Metres(f64),
}

/// A column of lengths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LengthColumnSpec {
    /// Name of the column.
    pub name: String,
    /// Unit. Default: that in the file, or metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<LengthUnit>,
}

/// Returns the JSON Schema of maps.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(RecordingMapSpec).to_value()
}
