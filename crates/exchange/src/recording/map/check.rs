//! Validation of maps.

use crumple_core::digits::format_number;
use crumple_core::field_error::FieldError;
use crumple_core::format_version::check_version;

#[cfg(any(feature = "mdf", feature = "parquet"))]
use super::super::platoon_columns::column_number;
use super::{
    BehindSpec, LayoutSpec, LengthSpec, PairsSpec, PlatoonSpec, RecordingMapSpec, Spacing,
    SpeedSpec, TimeSpec, TracksSpec,
};

pub(super) const MAP_VERSION: u32 = 1;
const MAX_TEXT_LENGTH: usize = 200;
const MAX_LINES_BEFORE_NAMES: usize = 1000;
/// Longest hole that may be interpolated, in seconds.
const MAX_INTERPOLATION_S: f64 = 2.0;
/// Longest blip of a lane id, in seconds; a vehicle may pass through a lane in a longer time.
const MAX_LANE_BLIP_S: f64 = 5.0;

/// Checks a map. The error names the first invalid field.
pub(super) fn check(spec: &RecordingMapSpec) -> Result<(), FieldError> {
    if let Err(unsupported) = check_version(spec.version, MAP_VERSION) {
        return Err(FieldError::new("version", unsupported.to_string()));
    }
    check_map_name(&spec.name)?;
    if spec.lines_before_names > MAX_LINES_BEFORE_NAMES {
        let lines = spec.lines_before_names;
        let problem = format!("must be at most {MAX_LINES_BEFORE_NAMES}, found {lines}");
        return Err(FieldError::new("lines_before_names", problem));
    }
    check_frame_choices(spec)?;
    let interpolation_s = [0.0, MAX_INTERPOLATION_S];
    check_range("interpolate_s", spec.interpolate_s, interpolation_s)?;
    let columns = spec.columns();
    columns
        .iter()
        .try_for_each(|(field, column)| check_name(field, column))?;
    if let TimeSpec::Frames(frames) = &spec.time {
        check_range("time.frames.rate_hz", frames.rate_hz, [0.5, 1000.0])?;
    }
    match &spec.layout {
        LayoutSpec::Platoon(platoon) => check_platoon(platoon),
        LayoutSpec::Pairs(pairs) => check_pairs(pairs),
        LayoutSpec::Tracks(tracks) => check_tracks(tracks),
    }?;
    check_distinct(&columns)
}

fn check_map_name(name: &str) -> Result<(), FieldError> {
    let is_plain = name
        .chars()
        .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
    if (1..=40).contains(&name.len()) && is_plain {
        Ok(())
    } else {
        let problem = "must be 1 to 40 lower-case letters, digits and hyphens";
        Err(FieldError::new("name", problem))
    }
}

/// Checks that a map without a DBC file chooses no CAN frames.
fn check_frame_choices(spec: &RecordingMapSpec) -> Result<(), FieldError> {
    for (field, choice) in [
        ("bus_channel", &spec.bus_channel),
        ("source_address", &spec.source_address),
    ] {
        if choice.is_some() && spec.dbc.is_none() {
            let problem = "applies only to raw CAN frames, which need a DBC file (`dbc`)";
            return Err(FieldError::new(field, problem));
        }
    }
    Ok(())
}

/// Checks that no two fields name the same column.
fn check_distinct(columns: &[FieldColumn<'_>]) -> Result<(), FieldError> {
    for (index, (field, column)) in columns.iter().enumerate() {
        let mut earlier = columns.iter().take(index);
        if let Some((other_field, _)) = earlier.find(|(_, name)| name == column) {
            let problem = format!("`{column}` is already the column of `{other_field}`");
            return Err(FieldError::new(*field, problem));
        }
    }
    Ok(())
}

/// A field of a map that names a column, and the name.
pub(in crate::recording) type FieldColumn<'m> = (&'static str, &'m str);

/// A field of a map that may name a column.
type OptionalColumn<'m> = (&'static str, Option<&'m String>);

/// Role of a column of a file in a map.
#[cfg(feature = "mdf")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::recording) struct ColumnRole {
    /// A column of times.
    pub(in crate::recording) is_clock: bool,
    /// An id of a vehicle, a lane or an event.
    pub(in crate::recording) is_id: bool,
    /// A column of spacings or positions that gives the times of the rows.
    pub(in crate::recording) is_spacing: bool,
}

/// Returns whether two names of columns are equal, except for capital letters.
pub(in crate::recording) fn is_same_name(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b)
}

impl RecordingMapSpec {
    /// Returns whether the map names a column of a table, except for capital letters.
    #[cfg(feature = "parquet")]
    pub(in crate::recording) fn has_column(&self, name: &str) -> bool {
        self.columns()
            .into_iter()
            .any(|(_, column)| is_same_name(column, name) || column_number(name, column).is_some())
    }

    /// Returns the role of a column; `None` if the map does not name it.
    #[cfg(feature = "mdf")]
    pub(in crate::recording) fn column_role(&self, name: &str) -> Option<ColumnRole> {
        let columns = self.columns();
        let field = columns
            .iter()
            .find(|(_, column)| *column == name || column_number(name, column).is_some())?
            .0;
        Some(ColumnRole {
            is_clock: field == "time.clock.column",
            is_id: field.ends_with(".event")
                || field.ends_with(".vehicle")
                || field.ends_with(".lane"),
            is_spacing: field.ends_with("position.column")
                || field.ends_with("spacing.column") && !field.contains(".behind."),
        })
    }

    /// Returns every field that names a column, with the name.
    pub(in crate::recording) fn columns(&self) -> Vec<FieldColumn<'_>> {
        let time = match &self.time {
            TimeSpec::Clock(clock) => ("time.clock.column", Some(&clock.column)),
            TimeSpec::Frames(frames) => ("time.frames.column", Some(&frames.column)),
        };
        let layout = match &self.layout {
            LayoutSpec::Platoon(platoon) => platoon_columns(platoon),
            LayoutSpec::Pairs(pairs) => pair_columns(pairs),
            LayoutSpec::Tracks(tracks) => track_columns(tracks),
        };
        let all = std::iter::once(time).chain(layout);
        all.filter_map(|(field, column)| Some((field, column?.as_str())))
            .collect()
    }
}

fn platoon_columns(spec: &PlatoonSpec) -> Vec<OptionalColumn<'_>> {
    vec![
        ("layout.platoon.speed.column", Some(&spec.speed.column)),
        ("layout.platoon.spacing.column", Some(&spec.spacing.column)),
    ]
}

fn pair_columns(spec: &PairsSpec) -> Vec<OptionalColumn<'_>> {
    let follower_speed = spec.follower_speed.as_ref();
    let leader_speed = spec.leader_speed.as_ref();
    let relative_speed = spec.relative_speed.as_ref();
    let behind = spec.behind.as_ref();
    vec![
        ("layout.pairs.event", spec.event.as_ref()),
        ("layout.pairs.spacing.column", Some(&spec.spacing.column)),
        (
            "layout.pairs.follower_speed.column",
            follower_speed.map(|speed| &speed.column),
        ),
        (
            "layout.pairs.follower_speed.acceleration.column",
            acceleration(follower_speed),
        ),
        (
            "layout.pairs.leader_speed.acceleration.column",
            acceleration(leader_speed),
        ),
        (
            "layout.pairs.leader_speed.column",
            leader_speed.map(|speed| &speed.column),
        ),
        (
            "layout.pairs.relative_speed.column",
            relative_speed.map(|speed| &speed.column),
        ),
        (
            "layout.pairs.behind.spacing.column",
            behind.map(|behind| &behind.spacing.column),
        ),
        (
            "layout.pairs.behind.speed.column",
            behind.and_then(|behind| Some(&behind.speed.as_ref()?.column)),
        ),
        (
            "layout.pairs.behind.relative_speed.column",
            behind.and_then(|behind| Some(&behind.relative_speed.as_ref()?.column)),
        ),
    ]
}

fn track_columns(spec: &TracksSpec) -> Vec<OptionalColumn<'_>> {
    let length = match &spec.length {
        LengthSpec::Column(column) => Some(&column.name),
        LengthSpec::Metres(_) => None,
    };
    vec![
        ("layout.tracks.vehicle", Some(&spec.vehicle)),
        ("layout.tracks.lane", spec.lane.as_ref()),
        ("layout.tracks.position.column", Some(&spec.position.column)),
        ("layout.tracks.speed.column", Some(&spec.speed.column)),
        (
            "layout.tracks.speed.acceleration.column",
            acceleration(Some(&spec.speed)),
        ),
        ("layout.tracks.length.column.name", length),
    ]
}

fn check_tracks(spec: &TracksSpec) -> Result<(), FieldError> {
    let blip_s = [0.0, MAX_LANE_BLIP_S];
    check_range("layout.tracks.lane_blip_s", spec.lane_blip_s, blip_s)?;
    match spec.length {
        LengthSpec::Column(_) => Ok(()),
        LengthSpec::Metres(metres) => {
            check_range("layout.tracks.length.metres", metres, [0.1, 100.0])
        }
    }
}

fn check_platoon(spec: &PlatoonSpec) -> Result<(), FieldError> {
    for (field, column) in [
        ("speed", &spec.speed.column),
        ("spacing", &spec.spacing.column),
    ] {
        if column.matches("{}").count() != 1 {
            let problem = "must hold `{}` once, where the vehicle's number stands";
            let field = format!("layout.platoon.{field}.column");
            return Err(FieldError::new(field, problem));
        }
    }
    for (field, line) in [
        ("names_line", &spec.names_line),
        ("count_line", &spec.count_line),
    ] {
        line.as_ref().map_or(Ok(()), |line| {
            check_name(&format!("layout.platoon.{field}"), line)
        })?;
    }
    if spec.speed.acceleration.is_some() {
        let problem = "acceleration: is not used for platoons: remove it";
        return Err(FieldError::new("layout.platoon.speed", problem));
    }
    check_length("layout.platoon", spec.spacing.from, spec.length_m)
}

fn check_pairs(spec: &PairsSpec) -> Result<(), FieldError> {
    let speeds = [
        spec.follower_speed.is_some(),
        spec.leader_speed.is_some(),
        spec.relative_speed.is_some(),
    ];
    if speeds.into_iter().filter(|is_given| *is_given).count() < 2 {
        let problem = "needs two of follower_speed, leader_speed and relative_speed";
        return Err(FieldError::new("layout.pairs", problem));
    }
    if let Some(behind) = &spec.behind {
        check_behind(behind)?;
    }
    check_length("layout.pairs", spec.spacing.from, spec.length_m)
}

fn check_behind(spec: &BehindSpec) -> Result<(), FieldError> {
    const FIELD: &str = "layout.pairs.behind";
    if spec.speed.is_some() == spec.relative_speed.is_some() {
        let problem = "needs either speed or relative_speed";
        return Err(FieldError::new(FIELD, problem));
    }
    if acceleration(spec.speed.as_ref()).is_some() {
        let problem = "acceleration: is not used for the vehicle behind: remove it";
        return Err(FieldError::new(format!("{FIELD}.speed"), problem));
    }
    check_length(FIELD, spec.spacing.from, spec.length_m)
}

/// Requires a length exactly where spacings are from front to front.
fn check_length(layout: &str, from: Spacing, length_m: Option<f64>) -> Result<(), FieldError> {
    let field = format!("{layout}.length_m");
    match (from, length_m) {
        (Spacing::FrontToFront, None) => Err(FieldError::new(
            layout,
            "length_m: is needed for spacings from front to front",
        )),
        (Spacing::BumperToBumper, Some(_)) => Err(FieldError::new(
            field,
            "is not used for spacings from bumper to bumper: remove it",
        )),
        (Spacing::FrontToFront, Some(length_m)) => check_range(&field, length_m, [0.1, 100.0]),
        (Spacing::BumperToBumper, None) => Ok(()),
    }
}

fn check_name(field: &str, name: &str) -> Result<(), FieldError> {
    let letters = name.chars().count();
    if name.trim() != name || !(1..=MAX_TEXT_LENGTH).contains(&letters) {
        let problem = format!(
            "must be 1 to {MAX_TEXT_LENGTH} letters without blanks around them, found {letters}"
        );
        return Err(FieldError::new(field, problem));
    }
    Ok(())
}

fn check_range(field: &str, value: f64, [min, max]: [f64; 2]) -> Result<(), FieldError> {
    if (min..=max).contains(&value) {
        Ok(())
    } else {
        let value = format_number(value);
        Err(FieldError::new(
            field,
            format!("must be from {min} to {max}, found {value}"),
        ))
    }
}

fn acceleration(speed: Option<&SpeedSpec>) -> Option<&String> {
    Some(&speed?.acceleration.as_ref()?.column)
}
