//! A draft of a map, from the names and units of the columns and from their consistency.

use std::path::Path;

use serde_json::Value;

use super::binary::{self, FileColumns};
use super::dropped::{Omission, SPEEDS_LEFT_OUT};
use super::error::RecordingError;
use super::load::load_first_rows;
use super::map::{
    BehindSpec, ClockSpec, LayoutSpec, LengthColumnSpec, LengthSpec, LengthUnit, PairsSpec,
    PositionSpec, RecordingMap, RecordingMapSpec, ReferencePoint, RelativeSpeedSpec, Sign, Spacing,
    SpacingSpec, SpeedSpec, SpeedUnit, TimeSpec, TimeUnit, TracksSpec, unit_in_name, words,
};
use super::series::{MAX_USUAL_SPEED_MPS, NOT_LATER};
use super::{LineProblem, RecordedTraffic, Recording};

/// Words in the names of columns, in lower case.
const TIMES: &str = "time timestamp t zeit sec seconds";
const SPACINGS: &str = "gap spacing distance dist range clearance headway abstand d dx";
const RELATIVE: &str = "rel relative relativ closing rangerate dv deltav vrel differenz";
const SPEEDS: &str =
    "speed velocity vel v geschwindigkeit mps kmh kph mph xvelocity vego vl vf vlead vrel tempo";
const LEADERS: &str = "lead leader target front preceding ahead object obj tgt vl vlead vorn vorne voraus \
    vorausfahrend ziel objekt";
const BEHIND: &str = "rear behind back hinten hinter heck";
/// Words of the vehicle behind in a recording that also describes the vehicle ahead. In other recordings of pairs, the
/// follower is the vehicle under test.
const BEHIND_OR_FOLLOWING: &str = "rear behind back hinten hinter heck follow tail tailing tailgat trail trailing \
    nachfolg folgefahrzeug";
/// Words of wheels, whose speeds are those of the own vehicle.
const WHEELS: &str = "wheel wheels whl tyre tire axle rad reifen achse fl fr rl rr";
const VEHICLES: &str = "id vehicle track trackid vehicleid fahrzeug";
const EVENTS: &str = "event eventid episode episodeid pair pairid";
const LANES: &str = "lane laneid spur fahrstreifen";
const POSITIONS: &str = "x y pos position s station localy";
const LENGTHS: &str = "length len";
/// Words that compounds contain besides those above.
const OTHERS: &str = "ego own";

/// Units of speeds and of relative speeds in recordings that mix them: of a dashboard and of a radar.
const MIXED_UNITS: [[&str; 2]; 2] = [["km/h", "m/s"], ["mph", "m/s"]];

/// Maximum number of rows that a guess reads, over all candidates.
const MAX_ROWS_READ: usize = 5_000_000;

/// A map that fits a recording.
#[derive(Debug)]
pub struct MapDraft {
    /// The map.
    pub map: RecordingMapSpec,
    /// Name of the built-in map, if it is one.
    pub built_in: Option<&'static str>,
    /// The first rows of the recording, read with it.
    pub recording: Recording,
    /// Columns that look like spacings or speeds, and that the map does not read.
    pub unread: Vec<String>,
    /// Other units and signs of the same columns that also contradict nothing, each in words.
    pub other_readings: Vec<String>,
}

impl MapDraft {
    /// Creates a draft without other readings.
    fn new(columns: &Columns, map: RecordingMapSpec, recording: Recording) -> Self {
        Self {
            unread: columns.unread(&map),
            map,
            built_in: None,
            recording,
            other_readings: Vec::new(),
        }
    }
}

/// Columns of a file with the words of their names.
struct Columns(Vec<(String, Vec<String>)>);

impl Columns {
    /// Splits names into words.
    fn new(names: Vec<String>) -> Self {
        let columns = names.into_iter().map(|name| {
            let mut words = words(&name);
            let parts: Vec<_> = words
                .iter()
                .filter_map(|word| split_compound(word))
                .collect();
            words.extend(parts.into_iter().flatten());
            (name, words)
        });
        Self(columns.collect())
    }

    /// Returns the first column with one of the words, and with none of `without`.
    fn find(&self, words: &str, without: &[&str]) -> Option<&String> {
        self.find_both(words, words, without)
    }

    /// Returns the first column with one of the words and one of the others, and with none of `without`.
    fn find_both(&self, words: &str, others: &str, without: &[&str]) -> Option<&String> {
        let mut columns = self.0.iter();
        let column = columns.find(|(_, name_words)| {
            has_word(name_words, words)
                && has_word(name_words, others)
                && !without
                    .iter()
                    .any(|excluded| has_word(name_words, excluded))
        });
        column.map(|(name, _)| name)
    }

    /// Returns the columns that look like spacings or speeds, and that a map does not read.
    fn unread(&self, map: &RecordingMapSpec) -> Vec<String> {
        let read = map.columns();
        let is_read = |name: &String| read.iter().any(|(_, column)| column == name);
        let is_motion = |words: &[String]| {
            let kinds = [SPACINGS, RELATIVE, SPEEDS];
            kinds.into_iter().any(|kind| has_word(words, kind))
        };
        let columns = self.0.iter();
        let unread = columns.filter(|(name, words)| is_motion(words) && !is_read(name));
        unread.map(|(name, _)| name.clone()).collect()
    }
}

/// Returns the two known words of a compound such as `tailgap`. Shorter words are parts of too many others.
fn split_compound(word: &str) -> Option<[String; 2]> {
    const MIN_LETTERS: usize = 3;
    let lists = [
        TIMES,
        SPACINGS,
        RELATIVE,
        SPEEDS,
        LEADERS,
        BEHIND_OR_FOLLOWING,
        WHEELS,
        POSITIONS,
        LENGTHS,
        OTHERS,
    ];
    let is_word = |part: &str| {
        let mut words = lists.iter().flat_map(|list| list.split(' '));
        part.len() >= MIN_LETTERS && words.any(|word| word == part)
    };
    let mut places = word.char_indices().map(|(place, _)| word.split_at(place));
    let parts = places.find(|(first, second)| is_word(first) && is_word(second));
    parts.map(|(first, second)| [first, second].map(str::to_owned))
}

/// Returns whether a name has one of the wanted words. Long words are also found within compounds.
fn has_word(name_words: &[String], wanted: &str) -> bool {
    name_words.iter().any(|word| {
        wanted
            .split(' ')
            .any(|wanted| word == wanted || wanted.len() > 5 && word.contains(wanted))
    })
}

/// Returns the unit in the name of a column, or a default unit.
fn unit_or_default<U: serde::de::DeserializeOwned>(
    all: &[(&'static str, f64)],
    column: &str,
    default_unit: &str,
) -> Option<U> {
    serde_json::from_value(
        unit_in_name(all, column)
            .map_or(default_unit, |(unit, _)| unit)
            .into(),
    )
    .ok()
}

/// Columns of a recording, as far as their names show them.
struct NamedColumns<'c> {
    time: &'c String,
    spacing: Option<&'c String>,
    relative: Option<&'c String>,
    leader: Option<&'c String>,
    own: Option<&'c String>,
    position: Option<&'c String>,
    event: Option<&'c String>,
    vehicle: Option<&'c String>,
    lane: Option<&'c String>,
    length: Option<&'c String>,
    spacing_behind: Option<&'c String>,
    speed_behind: Option<&'c String>,
    relative_behind: Option<&'c String>,
}

impl<'c> NamedColumns<'c> {
    /// Finds the columns, those of the vehicle behind by the words `behind`; `None` without times.
    fn find(columns: &'c Columns, behind: &str) -> Option<Self> {
        let not_vehicle = [
            LANES, TIMES, SPEEDS, SPACINGS, LENGTHS, POSITIONS, LEADERS, EVENTS,
        ];
        Some(Self {
            time: columns.find(TIMES, &[SPACINGS])?,
            spacing: columns.find(SPACINGS, &[RELATIVE, TIMES, behind]),
            relative: columns.find(RELATIVE, &[behind]),
            leader: columns.find_both(SPEEDS, LEADERS, &[RELATIVE, SPACINGS, WHEELS, behind]),
            own: columns
                .find(
                    SPEEDS,
                    &[RELATIVE, LEADERS, TIMES, SPACINGS, WHEELS, behind],
                )
                // Wheels have the own speed, also those at the rear.
                .or_else(|| {
                    columns.find_both(SPEEDS, WHEELS, &[RELATIVE, LEADERS, TIMES, SPACINGS])
                }),
            position: columns.find(POSITIONS, &[SPEEDS, LEADERS, TIMES]),
            event: columns.find(EVENTS, &[TIMES]),
            vehicle: columns.find(VEHICLES, &not_vehicle),
            lane: columns.find(LANES, &[LEADERS]),
            length: columns.find(LENGTHS, &[LEADERS, behind]),
            spacing_behind: columns.find_both(SPACINGS, behind, &[RELATIVE, TIMES]),
            speed_behind: columns.find_both(SPEEDS, behind, &[RELATIVE, TIMES, SPACINGS, WHEELS]),
            relative_behind: columns.find_both(RELATIVE, behind, &[]),
        })
    }

    /// Returns the columns that a layout needs, with their meanings.
    fn recognised(&self) -> Vec<(&'static str, String)> {
        let roles = [
            ("time", Some(self.time)),
            ("spacing", self.spacing),
            ("speed of the leader", self.leader),
            ("speed of the follower", self.own),
            ("relative speed", self.relative),
            ("vehicle", self.vehicle),
            ("position", self.position),
        ];
        let named = roles
            .into_iter()
            .filter_map(|(role, column)| Some((role, column?.clone())));
        named.collect()
    }

    /// Returns the candidate layouts with default units, the likeliest first. A row of a recording of traffic, which
    /// has lanes, may also describe the leader.
    fn layouts(&self, units: DefaultUnits) -> Vec<LayoutSpec> {
        let pairs = self.pairs(units);
        let tracks = self.tracks(units.speed, units.length);
        if self.lane.is_some() {
            tracks.into_iter().chain(pairs).collect()
        } else {
            pairs.into_iter().chain(tracks).collect()
        }
    }

    /// Returns the layouts of pairs with each sign of the relative speed, also with exchanged speeds.
    fn pairs(&self, units: DefaultUnits) -> Vec<LayoutSpec> {
        let Some(spacing) = self.spacing else {
            return Vec::new();
        };
        let speeds = [self.relative, self.leader, self.own];
        if speeds.into_iter().flatten().count() < 2 {
            return Vec::new();
        }
        let spacing = spacing_spec(spacing, units.length);
        let mut layouts = Vec::new();
        for [follower, leader] in [[self.own, self.leader], [self.leader, self.own]] {
            for sign in [Sign::LeaderMinusFollower, Sign::FollowerMinusLeader] {
                let pairs = PairsSpec {
                    event: self.event.cloned(),
                    spacing: spacing.clone(),
                    length_m: None,
                    follower_speed: follower.map(|name| speed(name, units.speed)),
                    leader_speed: leader.map(|name| speed(name, units.speed)),
                    relative_speed: self
                        .relative
                        .map(|name| relative_speed(name, units.relative, sign)),
                    behind: None,
                };
                let behind = self.behind(units);
                let with_behind = behind.into_iter().map(|behind| PairsSpec {
                    behind: Some(behind),
                    ..pairs.clone()
                });
                layouts.extend(with_behind.map(LayoutSpec::Pairs));
                layouts.push(LayoutSpec::Pairs(pairs));
            }
        }
        layouts
    }

    /// Returns the columns of the vehicle behind, with each sign of its relative speed.
    fn behind(&self, units: DefaultUnits) -> Vec<BehindSpec> {
        let Some(spacing) = self.spacing_behind else {
            return Vec::new();
        };
        let spacing = spacing_spec(spacing, units.length);
        let behind = |speed, relative_speed| BehindSpec {
            spacing: spacing.clone(),
            length_m: None,
            speed,
            relative_speed,
        };
        match (self.speed_behind, self.relative_behind) {
            (Some(name), _) => vec![behind(Some(speed(name, units.speed)), None)],
            (None, Some(name)) => [Sign::LeaderMinusFollower, Sign::FollowerMinusLeader]
                .map(|sign| behind(None, Some(relative_speed(name, units.relative, sign))))
                .into(),
            (None, None) => Vec::new(),
        }
    }

    fn tracks(&self, speed_unit: &str, length_unit: &str) -> Option<LayoutSpec> {
        let position = self.position?;
        let length = self.length.map(|name| LengthColumnSpec {
            name: name.clone(),
            unit: unit_or_default(LengthUnit::ALL, name, length_unit),
        });
        Some(LayoutSpec::Tracks(TracksSpec {
            vehicle: self.vehicle?.clone(),
            lane: self.lane.cloned(),
            position: PositionSpec {
                column: position.clone(),
                unit: unit_or_default(LengthUnit::ALL, position, length_unit),
                of: ReferencePoint::Front,
            },
            speed: speed(self.own?, speed_unit),
            length: length.map_or(LengthSpec::Metres(super::CAR_LENGTH_M), LengthSpec::Column),
            lane_blip_s: 0.5,
        }))
    }
}

fn speed(column: &str, unit: &str) -> SpeedSpec {
    SpeedSpec {
        column: column.to_owned(),
        unit: unit_or_default(SpeedUnit::ALL, column, unit),
        acceleration: None,
    }
}

fn relative_speed(column: &str, unit: &str, sign: Sign) -> RelativeSpeedSpec {
    RelativeSpeedSpec {
        column: column.to_owned(),
        unit: unit_or_default(SpeedUnit::ALL, column, unit),
        sign,
    }
}

fn spacing_spec(column: &str, unit: &str) -> SpacingSpec {
    SpacingSpec {
        column: column.to_owned(),
        unit: unit_or_default(LengthUnit::ALL, column, unit),
        from: Spacing::BumperToBumper,
    }
}

/// Returns the candidate maps, the likeliest first: without units, if the file states them. Of several maps that fit,
/// the first is the draft. They are in this order:
/// - by layout: `pairs`, then `tracks`; in files with lanes `tracks`, then `pairs`;
/// - maps with a vehicle behind, then others;
/// - names with `rear`, `behind` or `back` for the vehicle behind, then also those with `follow`, `tail` or `trail`;
/// - units of spacings, then of speeds, in the order of [`LengthUnit::ALL`] and [`SpeedUnit::ALL`], then
///   [`MIXED_UNITS`];
/// - speeds of follower and leader as named, then exchanged;
/// - relative speed of the leader minus the follower, then the opposite.
///
/// Of several columns with fitting names, each map has the first one of the file.
fn candidates(columns: &Columns, states_units: bool) -> Vec<RecordingMapSpec> {
    let Some(named) = NamedColumns::find(columns, BEHIND) else {
        return Vec::new();
    };
    // Epoch times need no name.
    let time_unit =
        unit_or_default(TimeUnit::ALL, named.time, "").filter(|unit| *unit != TimeUnit::Seconds);
    let mut layouts = layouts_with_units(&named, states_units);
    if let Some(named) = NamedColumns::find(columns, BEHIND_OR_FOLLOWING) {
        for layout in layouts_with_units(&named, states_units) {
            if !layouts.contains(&layout) {
                layouts.push(layout);
            }
        }
    }
    // The layout weighs more than the units: a recording of pairs may contradict a map of tracks in no unit.
    let has_tracks_first = matches!(layouts.first(), Some(LayoutSpec::Tracks(_)));
    // So do the columns of a vehicle behind.
    layouts.sort_by_key(|layout| {
        let is_other = matches!(layout, LayoutSpec::Tracks(_)) != has_tracks_first;
        (is_other, !has_vehicle_behind(layout))
    });
    let maps = layouts.into_iter().map(|layout| {
        let time = TimeSpec::Clock(ClockSpec {
            column: named.time.clone(),
            unit: time_unit,
        });
        RecordingMapSpec::new("draft".to_owned(), time, layout)
    });
    maps.collect()
}

/// Returns the candidate layouts with all default units, each once, the likeliest first.
fn layouts_with_units(named: &NamedColumns<'_>, states_units: bool) -> Vec<LayoutSpec> {
    let mut layouts: Vec<LayoutSpec> = Vec::new();
    for units in default_units(states_units) {
        for layout in named.layouts(units) {
            if !layouts.contains(&layout) {
                layouts.push(layout);
            }
        }
    }
    layouts
}

/// Units of columns whose names state none.
#[derive(Clone, Copy)]
struct DefaultUnits {
    speed: &'static str,
    /// Of relative speeds.
    relative: &'static str,
    length: &'static str,
}

/// Returns the default units, the likeliest first.
fn default_units(states_units: bool) -> Vec<DefaultUnits> {
    let mut all = Vec::new();
    for length in unit_names(LengthUnit::ALL, states_units) {
        let equal = unit_names(SpeedUnit::ALL, states_units).map(|unit| [unit, unit]);
        all.extend(
            equal
                .chain(MIXED_UNITS)
                .map(|[speed, relative]| DefaultUnits {
                    speed,
                    relative,
                    length,
                }),
        );
    }
    all
}

fn has_vehicle_behind(layout: &LayoutSpec) -> bool {
    matches!(layout, LayoutSpec::Pairs(pairs) if pairs.behind.is_some())
}

/// Returns the names of units; before them an empty one, if the file states units.
fn unit_names(
    units: &'static [(&'static str, f64)],
    states_units: bool,
) -> impl Iterator<Item = &'static str> {
    states_units
        .then_some("")
        .into_iter()
        .chain(units.iter().map(|(unit, _)| *unit))
}

/// Returns whether more than a hundredth of the speeds of pairs exceed those of traffic: their unit is probably km/h.
fn has_unusual_speeds(recording: &Recording) -> bool {
    let vehicles = || {
        recording
            .platoons
            .iter()
            .flat_map(|platoon| &platoon.vehicles)
    };
    let speeds_mps = || vehicles().flat_map(|vehicle| vehicle.speed_mps.iter().flatten());
    let unusual = speeds_mps().filter(|speed_mps| **speed_mps > MAX_USUAL_SPEED_MPS);
    100 * unusual.count() > speeds_mps().count()
}

/// Returns whether a recording fits its map: no columns contradict each other, the rows of pairs are in order of time,
/// and in tracks one vehicle follows another.
fn is_consistent(recording: &Recording) -> bool {
    let samples: usize = recording
        .platoons
        .iter()
        .map(|platoon| platoon.time_s.len())
        .sum();
    let has_followers = recording
        .traffic
        .as_ref()
        .is_none_or(RecordedTraffic::has_followers);
    let mut dropped = recording.dropped.iter();
    has_followers
        && !has_unusual_speeds(recording)
        && !dropped.any(|item| match &item.omission {
            Omission::ColumnsContradict(_) => true,
            Omission::Counted { count, after, .. } => {
                after.ends_with(SPEEDS_LEFT_OUT)
                    || after.starts_with(NOT_LATER) && *count > samples / 10
            }
            _ => false,
        })
}

/// Returns the built-in map of a recording with these columns, if its first rows can be read with it.
fn built_in_draft(path: &Path, names: &[String]) -> Option<MapDraft> {
    let name = match names.first().map(String::as_str) {
        Some("Date") => "openacc",
        _ => RecordingMap::recognise(names.iter().map(String::as_str))?,
    };
    let map = RecordingMap::built_in(name)?.ok()?;
    let recording = load_first_rows(path, &map, MAX_ROWS_READ).ok()?;
    Some(MapDraft {
        map: map.spec().clone(),
        built_in: Some(name),
        recording,
        unread: Vec::new(),
        other_readings: Vec::new(),
    })
}

/// Returns whether another candidate may name the right columns and units.
fn is_about_column(error: &RecordingError) -> bool {
    matches!(
        error,
        RecordingError::Line {
            problem: LineProblem::Column { .. },
            ..
        }
    )
}

/// Drafts a map of a recording: the first candidate whose columns do not contradict each other. Units in names of
/// columns are kept. `None` without candidates.
///
/// # Errors
/// [`RecordingError`] for a file that cannot be read with any candidate.
pub fn guess(path: &Path) -> Result<Option<MapDraft>, RecordingError> {
    let FileColumns {
        names,
        states_units,
    } = binary::read_columns(path)?;
    if let Some(draft) = built_in_draft(path, &names) {
        return Ok(Some(draft));
    }
    let columns = Columns::new(names);
    let mut second_choice = None;
    let mut contradiction = None;
    let candidates = candidates(&columns, states_units);
    let rows = MAX_ROWS_READ / candidates.len().max(1);
    let mut candidates = candidates.into_iter();
    while let Some(map) = candidates.next() {
        let Ok(checked) = RecordingMap::new(map.clone()) else {
            continue;
        };
        match load_first_rows(path, &checked, rows) {
            Ok(recording) => {
                let is_consistent = is_consistent(&recording);
                let mut draft = MapDraft::new(&columns, map, recording);
                if is_consistent {
                    draft.other_readings = other_readings((path, rows), &draft.map, candidates);
                    return Ok(Some(draft));
                }
                second_choice.get_or_insert(draft);
            }
            Err(error) if is_about_column(&error) => {
                contradiction.get_or_insert(error);
            }
            Err(error) => return Err(error),
        }
    }
    match contradiction {
        Some(error) if second_choice.is_none() => Err(error),
        _ => Ok(second_choice),
    }
}

/// Returns the columns of a recording that a draft would use, each with its meaning: what a recording without a draft
/// has.
///
/// # Errors
/// [`RecordingError`] for a file whose columns cannot be read.
pub fn recognised_columns(path: &Path) -> Result<Vec<(&'static str, String)>, RecordingError> {
    let columns = Columns::new(binary::read_columns(path)?.names);
    Ok(NamedColumns::find(&columns, BEHIND)
        .map(|named| named.recognised())
        .unwrap_or_default())
}

/// Returns whether the first rows of a recording can be read with a map, and contradict nothing.
fn fits(path: &Path, map: &RecordingMapSpec, rows: usize) -> bool {
    let Ok(map) = RecordingMap::new(map.clone()) else {
        return false;
    };
    load_first_rows(path, &map, rows).is_ok_and(|recording| is_consistent(&recording))
}

/// Returns the units and signs of the later candidates with the draft's columns that fit as well.
fn other_readings(
    (path, rows): (&Path, usize),
    draft: &RecordingMapSpec,
    later: impl Iterator<Item = RecordingMapSpec>,
) -> Vec<String> {
    let Ok(of_draft) = serde_json::to_value(&draft.layout) else {
        return Vec::new();
    };
    let mut others = Vec::new();
    for map in later {
        let mut changes = Vec::new();
        let has_same_columns = serde_json::to_value(&map.layout)
            .is_ok_and(|other| list_changes(&of_draft, &other, &mut changes));
        if has_same_columns && fits(path, &map, rows) {
            changes.sort_unstable();
            others.push(changes.join(", "));
        }
    }
    others
}

/// Adds the units and signs of columns in which a layout differs from another one. Returns false if it also differs in
/// anything else.
fn list_changes(first: &Value, second: &Value, changes: &mut Vec<String>) -> bool {
    let (Value::Object(first), Value::Object(second)) = (first, second) else {
        return first == second;
    };
    let column = first.get("column").or(first.get("name"));
    let column = column.and_then(Value::as_str).unwrap_or_default();
    first.len() == second.len()
        && first.iter().all(|(field, value)| {
            let values = second.get(field).map(|other| [value, other]);
            values.is_some_and(|values| list_change((column, field.as_str()), values, changes))
        })
}

/// Adds the change of a field of a column; looks for changes inside a field that is no unit or sign.
fn list_change(
    (column, field): (&str, &str),
    [first, second]: [&Value; 2],
    changes: &mut Vec<String>,
) -> bool {
    match (field, second.as_str()) {
        _ if first == second => {}
        ("unit", Some(unit)) => changes.push(format!("{column} in {unit}")),
        ("sign", Some(_)) => changes.push(format!("{column} with the opposite sign")),
        _ => return list_changes(first, second, changes),
    }
    true
}

#[cfg(test)]
mod tests {
    use super::super::parts::PART_ROWS;
    use super::*;

    /// The numbers of candidates and rows are known before the first row is read. Here every choice is open.
    #[test]
    fn the_work_of_a_guess_has_a_limit() {
        let names = "time,lane,id,x,gap,v,v_lead,v_rel,tail_gap,tail_v_rel,rear_gap,rear_v_rel";
        let names = names.split(',').map(str::to_owned).collect();
        let candidates = candidates(&Columns::new(names), true);
        assert!(candidates.len() > 400, "{}", candidates.len());
        assert!(MAX_ROWS_READ / candidates.len() > 5000);
    }

    /// A draft needs only the first rows, although an import sorts all rows of tracks.
    #[test]
    fn drafts_depend_on_the_first_rows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("long.csv");
        let row = |row: usize| format!("{:.1},1,1,{:.1},20\n", row as f64 / 10.0, row as f64 * 2.0);
        let rows: String = (0..PART_ROWS + 10).map(row).collect();
        std::fs::write(&path, format!("time,id,lane,x,v\n{rows}damaged\n")).unwrap();
        assert!(matches!(
            guess(&path).unwrap().expect("a draft").map.layout,
            LayoutSpec::Tracks(_)
        ));
    }

    /// Gaps that never change contradict no unit, but no traffic drives at 77 m/s.
    #[test]
    fn drafts_read_speeds_beyond_those_of_traffic_in_kilometres_per_hour() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        for (most, expected) in [(77.0, "km/h"), (45.0, "m/s")] {
            let row = |tenth: u32| {
                let speed = most - 5.0 + 5.0 * (0.02 * f64::from(tenth)).sin();
                format!("{:.1},30,{speed:.2},{speed:.2}\n", f64::from(tenth) / 10.0)
            };
            let rows: String = (0..600).map(row).collect();
            std::fs::write(&path, format!("time,gap,speed,lead_speed\n{rows}")).unwrap();
            let draft = guess(&path).unwrap().expect("a draft");
            let text = serde_json::to_string(&draft.map).unwrap();
            assert!(text.contains(&format!("\"unit\":\"{expected}\"")), "{text}");
        }
    }

    /// Units and signs follow from the consistency of gaps and speeds, unless names state them; exchanged names do not.
    #[test]
    fn drafts_read_the_speeds_of_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        for (unit, mps) in SpeedUnit::ALL {
            for sign in [1.0, -1.0] {
                let (time, per_second) = if sign > 0.0 {
                    ("Zeit [s]", 1.0)
                } else {
                    ("zeit_ms", 1000.0)
                };
                // Units in names may differ. Without them, both speeds have one unit.
                let own_name = format!("v_ego_{}", unit.replace('/', ""));
                let (own_name, name, rel_mps) = if sign > 0.0 {
                    ("v_ego", "v_rel", *mps)
                } else {
                    (&*own_name, "v_rel_fps", 0.3048)
                };
                let mut text = format!("{time};Event;Abstand [m];{own_name};{name}\n");
                let mut gap_m = 40.0;
                for tenth in 0..400 {
                    let at_s = f64::from(tenth) / 10.0;
                    let (own_mps, relative_mps) =
                        (20.0 + (0.3 * at_s).sin(), 12.0 * (0.5 * at_s).cos());
                    let (own, relative) = (own_mps / mps, sign * relative_mps / rel_mps);
                    text += &format!("{};a;{gap_m};{own};{relative}\n", at_s * per_second);
                    gap_m += 0.1 * relative_mps;
                }
                let path = folder.path().join("log.csv");
                std::fs::write(&path, text.replace('.', ",")).unwrap();
                let draft = guess(&path).unwrap().expect("a draft");
                assert!(
                    matches!(&draft.map.layout, LayoutSpec::Pairs(pairs) if pairs.event.is_some()),
                    "{:?}",
                    draft.map
                );
                let speed_mps = draft.recording.platoons[0].vehicles[1].speed_mps[50].unwrap();
                assert!(
                    (speed_mps - 20.0 - 1.5_f64.sin()).abs() < 0.3,
                    "{unit} {sign}: {speed_mps} {:?}",
                    draft.map
                );
                let again =
                    RecordingMap::from_toml(&draft.map.to_toml().unwrap(), Path::new("draft.toml"))
                        .unwrap();
                assert_eq!(*again.spec(), draft.map);
            }
        }
    }

    /// The own speed of a dashboard and the relative speed of a radar have different units, which no name states. Feet
    /// and feet per second fit as well.
    #[test]
    fn drafts_read_relative_speeds_in_another_unit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        let row = |tenth: u32| {
            let at_s = f64::from(tenth) / 10.0;
            let gap_m = 40.0 + 8.0 * (0.5 * at_s).sin();
            let relative_mps = 4.0 * (0.5 * at_s).cos();
            format!("{at_s:.1};{gap_m:.3};{:.2};{relative_mps:.3}\n", 3.6 * 20.0)
        };
        let rows: String = (0..600).map(row).collect();
        std::fs::write(
            &path,
            format!("t;Abstand;Geschwindigkeit;Relativgeschwindigkeit\n{rows}"),
        )
        .unwrap();
        let draft = guess(&path).unwrap().expect("a draft");
        let LayoutSpec::Pairs(pairs) = &draft.map.layout else {
            panic!("{:?}", draft.map)
        };
        assert_eq!(pairs.spacing.unit, Some(LengthUnit::Metres));
        assert_eq!(
            pairs.follower_speed.as_ref().unwrap().unit,
            Some(SpeedUnit::KilometresPerHour)
        );
        assert_eq!(
            pairs.relative_speed.as_ref().unwrap().unit,
            Some(SpeedUnit::MetresPerSecond)
        );
        let feet = "Abstand in ft, Geschwindigkeit in ft/s, Relativgeschwindigkeit in ft/s";
        assert!(
            draft.other_readings.contains(&feet.to_owned()),
            "{:?}",
            draft.other_readings
        );
    }

    /// A row of a vehicle and its leader has ids and positions, too, and one of traffic may describe the leader.
    #[test]
    fn drafts_distinguish_pairs_from_tracks() {
        let folder = tempfile::tempdir().unwrap();
        let draft = |text: String| {
            let path = folder.path().join("log.csv");
            std::fs::write(&path, text).unwrap();
            guess(&path).unwrap().expect("a draft").map.layout
        };
        let speeds = |at_s: f64| {
            [
                20.0 + 2.0 * (0.4 * at_s).sin(),
                20.0 + 2.0 * (0.4 * at_s - 0.8).sin(),
            ]
        };
        let position = |index: usize, tenth: usize| {
            let steps = (0..tenth).map(|step| 0.1 * speeds(step as f64 / 10.0)[index]);
            steps.sum::<f64>() - 30.0 * index as f64
        };
        let row = |tenth: usize| {
            let ([lead, own], at_s) = (speeds(tenth as f64 / 10.0), tenth as f64 / 10.0);
            (at_s, position(0, tenth), position(1, tenth), lead, own)
        };
        let pairs: String = (0..300)
            .map(row)
            .map(|(at_s, lead_m, own_m, lead, own)| {
                format!(
                    "{at_s},7,8,{own_m},{lead_m},{own},{lead},{}\n",
                    lead_m - own_m - 5.0
                )
            })
            .collect();
        let layout = draft(format!(
            "time,vehicle_id,leader_id,x,x_leader,speed,leader_speed,gap\n{pairs}"
        ));
        let LayoutSpec::Pairs(pairs) = layout else {
            panic!("{layout:?}")
        };
        assert_eq!(
            (
                pairs.follower_speed.unwrap().column,
                pairs.leader_speed.unwrap().column,
                pairs.spacing.column
            ),
            (
                "speed".to_owned(),
                "leader_speed".to_owned(),
                "gap".to_owned()
            )
        );
        let tracks: String = (0..300)
            .map(row)
            .map(|(at_s, lead_m, own_m, lead, own)| {
                let gap_m = lead_m - own_m - 5.0;
                format!("{at_s},7,1,{lead_m},{lead},,\n{at_s},8,1,{own_m},{own},{lead},{gap_m}\n")
            })
            .collect();
        let layout = draft(format!(
            "time,vehicle_id,lane,x,speed,leader_speed,gap\n{tracks}"
        ));
        assert!(matches!(layout, LayoutSpec::Tracks(_)), "{layout:?}");
    }
}
