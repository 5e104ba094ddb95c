//! A draft of a map, from the names and units of the columns and from their consistency.

use std::path::Path;

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
const BEHIND_OR_FOLLOWING: &str = "rear behind back hinten hinter heck follow";
const VEHICLES: &str = "id vehicle track trackid vehicleid fahrzeug";
const EVENTS: &str = "event eventid episode episodeid pair pairid";
const LANES: &str = "lane laneid spur fahrstreifen";
const POSITIONS: &str = "x y pos position s station localy";
const LENGTHS: &str = "length len";

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
}

/// Columns of a file with the words of their names.
struct Columns(Vec<(String, Vec<String>)>);

impl Columns {
    /// Splits names into words.
    fn new(names: Vec<String>) -> Self {
        let columns = names.into_iter().map(|name| {
            let words = words(&name);
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
            leader: columns.find_both(SPEEDS, LEADERS, &[RELATIVE, SPACINGS, behind]),
            own: columns.find(SPEEDS, &[RELATIVE, LEADERS, TIMES, SPACINGS, behind]),
            position: columns.find(POSITIONS, &[SPEEDS, LEADERS]),
            event: columns.find(EVENTS, &[TIMES]),
            vehicle: columns.find(VEHICLES, &not_vehicle),
            lane: columns.find(LANES, &[LEADERS]),
            length: columns.find(LENGTHS, &[LEADERS, behind]),
            spacing_behind: columns.find_both(SPACINGS, behind, &[RELATIVE, TIMES]),
            speed_behind: columns.find_both(SPEEDS, behind, &[RELATIVE, TIMES, SPACINGS]),
            relative_behind: columns.find_both(RELATIVE, behind, &[]),
        })
    }

    /// Returns the candidate layouts with default units, the likeliest first. A row of a recording of traffic, which
    /// has lanes, may also describe the leader.
    fn layouts(&self, speed_unit: &str, length_unit: &str) -> Vec<LayoutSpec> {
        let pairs = self.pairs(speed_unit, length_unit);
        let tracks = self.tracks(speed_unit, length_unit);
        if self.lane.is_some() {
            tracks.into_iter().chain(pairs).collect()
        } else {
            pairs.into_iter().chain(tracks).collect()
        }
    }

    /// Returns the layouts of pairs with each sign of the relative speed, also with exchanged speeds.
    fn pairs(&self, speed_unit: &str, length_unit: &str) -> Vec<LayoutSpec> {
        let Some(spacing) = self.spacing else {
            return Vec::new();
        };
        let speeds = [self.relative, self.leader, self.own];
        if speeds.into_iter().flatten().count() < 2 {
            return Vec::new();
        }
        let spacing = spacing_spec(spacing, length_unit);
        let mut layouts = Vec::new();
        for [follower, leader] in [[self.own, self.leader], [self.leader, self.own]] {
            for sign in [Sign::LeaderMinusFollower, Sign::FollowerMinusLeader] {
                let pairs = PairsSpec {
                    event: self.event.cloned(),
                    spacing: spacing.clone(),
                    length_m: None,
                    follower_speed: follower.map(|name| speed(name, speed_unit)),
                    leader_speed: leader.map(|name| speed(name, speed_unit)),
                    relative_speed: self
                        .relative
                        .map(|name| relative_speed(name, speed_unit, sign)),
                    behind: None,
                };
                let behind = self.behind(speed_unit, length_unit);
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
    fn behind(&self, speed_unit: &str, length_unit: &str) -> Vec<BehindSpec> {
        let Some(spacing) = self.spacing_behind else {
            return Vec::new();
        };
        let spacing = spacing_spec(spacing, length_unit);
        let behind = |speed, relative_speed| BehindSpec {
            spacing: spacing.clone(),
            length_m: None,
            speed,
            relative_speed,
        };
        match (self.speed_behind, self.relative_behind) {
            (Some(name), _) => vec![behind(Some(speed(name, speed_unit)), None)],
            (None, Some(name)) => [Sign::LeaderMinusFollower, Sign::FollowerMinusLeader]
                .map(|sign| behind(None, Some(relative_speed(name, speed_unit, sign))))
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

/// Returns the candidate maps, the likeliest first: without units, if the file states them.
fn candidates(columns: &Columns, states_units: bool) -> Vec<RecordingMapSpec> {
    let Some(named) = NamedColumns::find(columns, BEHIND) else {
        return Vec::new();
    };
    // Epoch times need no name.
    let time_unit =
        unit_or_default(TimeUnit::ALL, named.time, "").filter(|unit| *unit != TimeUnit::Seconds);
    let mut layouts = layouts_with_units(&named, states_units);
    if let Some(named) = NamedColumns::find(columns, BEHIND_OR_FOLLOWING) {
        layouts.extend(
            layouts_with_units(&named, states_units)
                .into_iter()
                .filter(has_vehicle_behind),
        );
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
    for speed_unit in unit_names(SpeedUnit::ALL, states_units) {
        for length_unit in unit_names(LengthUnit::ALL, states_units) {
            for layout in named.layouts(speed_unit, length_unit) {
                if !layouts.contains(&layout) {
                    layouts.push(layout);
                }
            }
        }
    }
    layouts
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
    let recording = load_first_rows(path, &map).ok()?;
    Some(MapDraft {
        map: map.spec().clone(),
        built_in: Some(name),
        recording,
        unread: Vec::new(),
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
    for map in candidates(&columns, states_units) {
        let Ok(checked) = RecordingMap::new(map.clone()) else {
            continue;
        };
        match load_first_rows(path, &checked) {
            Ok(recording) => {
                let is_consistent = is_consistent(&recording);
                let draft = MapDraft {
                    unread: columns.unread(&map),
                    map,
                    built_in: None,
                    recording,
                };
                if is_consistent {
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

#[cfg(test)]
mod tests {
    use super::super::parts::PART_ROWS;
    use super::*;

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
