//! Maps: what the columns of a recording mean, as a file.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use crate::scenario::file::{FileError, line_in_toml, parse_toml, read_at_most};

/// The version of the map format that this release reads.
const MAP_VERSION: u32 = 1;
/// Most bytes of a map.
const MOST_MAP_BYTES: u64 = 64 << 10;
/// Longest text of a map, in letters.
const LONGEST_TEXT: usize = 200;
/// Most lines before the names of columns.
const MOST_LINES_BEFORE: usize = 1000;
/// Longest hole that may be filled by a straight line, in seconds.
const LONGEST_INTERPOLATION_S: f64 = 2.0;

/// What the columns of a recording mean, as a file states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a map: a table of fields")]
#[cfg_attr(feature = "schema", schemars(title = "crumple map of a recording, version 1"))]
pub struct MapSpec {
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
    pub relative_speed: Option<RelativeSpec>,
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
pub struct RelativeSpec {
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
    pub of: Point,
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
pub enum Point {
    /// The front bumper.
    Front,
    /// Half-way between the bumpers.
    Centre,
    /// The rear bumper.
    Rear,
    /// Whichever bumper has the smaller position, as in highD: the rear one, or the front one of who drives the other way.
    LowEnd,
}

macro_rules! units {
    ($(#[$about:meta])* $name:ident { $($(#[$doc:meta])* $unit:ident = $written:literal: $factor:expr;)* }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub enum $name {
            $($(#[$doc])* #[serde(rename = $written)] $unit,)*
        }

        impl $name {
            /// How many of the metric unit one is.
            pub(super) fn factor(self) -> f64 {
                match self {
                    $(Self::$unit => $factor,)*
                }
            }
        }
    };
}

units! {
    /// Units of time.
    TimeUnit {
        /// Seconds.
        #[default]
        Seconds = "s": 1.0;
        /// Milliseconds.
        Milliseconds = "ms": 1e-3;
        /// Microseconds.
        Microseconds = "us": 1e-6;
    }
}

units! {
    /// Units of speed.
    SpeedUnit {
        /// Metres a second.
        #[default]
        MetresPerSecond = "m/s": 1.0;
        /// Kilometres an hour.
        KilometresPerHour = "km/h": 1.0 / 3.6;
        /// Feet a second.
        FeetPerSecond = "ft/s": 0.3048;
        /// Miles an hour.
        MilesPerHour = "mph": 0.447_04;
    }
}

units! {
    /// Units of length.
    LengthUnit {
        /// Metres.
        #[default]
        Metres = "m": 1.0;
        /// Feet.
        Feet = "ft": 0.3048;
        /// Centimetres.
        Centimetres = "cm": 1e-2;
    }
}

/// A map that was found valid.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingMap {
    spec: MapSpec,
}

impl RecordingMap {
    /// Reads a map.
    ///
    /// # Errors
    /// [`FileError`] for a file that cannot be read, has more than 64 KiB, or is no valid map, with line and field.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Self::from_toml(&read_at_most(path, MOST_MAP_BYTES)?, path)
    }

    /// Reads a map from TOML text; `path` only names it in errors.
    ///
    /// # Errors
    /// [`FileError`] for text that is no valid map.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, FileError> {
        let spec: MapSpec = parse_toml(text, path)?;
        check(&spec).map_err(|(field, problem)| FileError::Syntax {
            path: path.to_owned(),
            line: line_in_toml(text, &field),
            message: format!("{field}: {problem}"),
        })?;
        Ok(Self { spec })
    }

    /// What it says.
    #[must_use]
    pub fn spec(&self) -> &MapSpec {
        &self.spec
    }

    /// The map of OpenACC files.
    pub(super) fn openacc() -> Result<Self, RecordingError> {
        built_in(include_str!("built_in/openacc.toml"))
    }

    /// The map of car-following events.
    pub(super) fn car_following() -> Result<Self, RecordingError> {
        built_in(include_str!("built_in/car-following.toml"))
    }
}

fn built_in(text: &str) -> Result<RecordingMap, RecordingError> {
    RecordingMap::from_toml(text, Path::new("built in")).map_err(|error| RecordingError::Map(Box::new(error)))
}

/// The first field that is wrong, and what is.
fn check(spec: &MapSpec) -> Result<(), (String, String)> {
    let wrong = |field: &str, problem: String| Err((field.to_owned(), problem));
    if spec.version != MAP_VERSION {
        return wrong("version", format!("version {} is not supported: this release reads version 1", spec.version));
    }
    let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    if spec.name.is_empty() || spec.name.len() > 40 || !spec.name.chars().all(is_plain) {
        return wrong("name", "must be 1 to 40 lower-case letters, digits and hyphens".to_owned());
    }
    if spec.lines_before_names > MOST_LINES_BEFORE {
        let found = spec.lines_before_names;
        return wrong("lines_before_names", format!("must be at most {MOST_LINES_BEFORE}, found {found}"));
    }
    within("interpolate_s", spec.interpolate_s, [0.0, LONGEST_INTERPOLATION_S])?;
    match &spec.time {
        TimeSpec::Clock(clock) => named("time.clock.column", &clock.column)?,
        TimeSpec::Frames(frames) => {
            named("time.frames.column", &frames.column)?;
            within("time.frames.rate_hz", frames.rate_hz, [0.5, 1000.0])?;
        }
    }
    match &spec.layout {
        LayoutSpec::Platoon(platoon) => check_platoon(platoon),
        LayoutSpec::Pairs(pairs) => check_pairs(pairs),
        LayoutSpec::Tracks(tracks) => check_tracks(tracks),
    }
}

fn check_platoon(spec: &PlatoonSpec) -> Result<(), (String, String)> {
    for (field, column) in [("speed", &spec.speed.column), ("spacing", &spec.spacing.column)] {
        let field = format!("layout.platoon.{field}.column");
        named(&field, column)?;
        if column.matches("{}").count() != 1 {
            return Err((field, "must hold `{}` once, where the vehicle's number stands".to_owned()));
        }
    }
    for (field, line) in [("names_line", &spec.names_line), ("count_line", &spec.count_line)] {
        line.as_ref().map_or(Ok(()), |line| named(&format!("layout.platoon.{field}"), line))?;
    }
    check_length("layout.platoon", spec.spacing.from, spec.length_m)
}

fn check_pairs(spec: &PairsSpec) -> Result<(), (String, String)> {
    let speeds = [&spec.follower_speed, &spec.leader_speed].map(|speed| speed.as_ref().map(|speed| &speed.column));
    let relative = spec.relative_speed.as_ref().map(|speed| &speed.column);
    let columns = [
        ("event", spec.event.as_ref()),
        ("spacing.column", Some(&spec.spacing.column)),
        ("follower_speed.column", speeds[0]),
        ("leader_speed.column", speeds[1]),
        ("relative_speed.column", relative),
    ];
    for (field, column) in columns {
        column.map_or(Ok(()), |column| named(&format!("layout.pairs.{field}"), column))?;
    }
    if speeds.iter().chain([&relative]).flatten().count() < 2 {
        let problem = "needs two of follower_speed, leader_speed and relative_speed";
        return Err(("layout.pairs".to_owned(), problem.to_owned()));
    }
    check_length("layout.pairs", spec.spacing.from, spec.length_m)
}

fn check_tracks(spec: &TracksSpec) -> Result<(), (String, String)> {
    let columns = [
        ("vehicle", Some(&spec.vehicle)),
        ("lane", spec.lane.as_ref()),
        ("position.column", Some(&spec.position.column)),
        ("speed.column", Some(&spec.speed.column)),
    ];
    for (field, column) in columns {
        column.map_or(Ok(()), |column| named(&format!("layout.tracks.{field}"), column))?;
    }
    match &spec.length {
        LengthSpec::Column(column) => named("layout.tracks.length.column.name", &column.name),
        LengthSpec::Metres(metres) => within("layout.tracks.length.metres", *metres, [0.1, 100.0]),
    }
}

/// A length there is if and only if it is needed.
fn check_length(layout: &str, from: Spacing, length_m: Option<f64>) -> Result<(), (String, String)> {
    let field = format!("{layout}.length_m");
    match (from, length_m) {
        (Spacing::FrontToFront, None) => {
            Err((layout.to_owned(), "length_m: is needed for spacings from front to front".to_owned()))
        }
        (Spacing::BumperToBumper, Some(_)) => {
            Err((field, "is of no use for spacings from bumper to bumper".to_owned()))
        }
        (Spacing::FrontToFront, Some(length_m)) => within(&field, length_m, [0.1, 100.0]),
        (Spacing::BumperToBumper, None) => Ok(()),
    }
}

fn named(field: &str, name: &str) -> Result<(), (String, String)> {
    let letters = name.chars().count();
    if name.trim() != name || !(1..=LONGEST_TEXT).contains(&letters) {
        let problem = format!("must be 1 to {LONGEST_TEXT} letters without blanks around them, found {letters}");
        return Err((field.to_owned(), problem));
    }
    Ok(())
}

fn within(field: &str, found: f64, [min, max]: [f64; 2]) -> Result<(), (String, String)> {
    if (min..=max).contains(&found) {
        Ok(())
    } else {
        Err((field.to_owned(), format!("must be from {min} to {max}, found {found}")))
    }
}

/// The JSON Schema of maps.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(MapSpec).to_value()
}
