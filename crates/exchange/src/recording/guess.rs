//! A draft of a map, from the names and units of the columns and from their consistency.

use std::path::Path;

use super::dropped::{Omission, SPEEDS_LEFT_OUT};
use super::error::RecordingError;
use super::load::load_first_rows;
use super::map::{
    ClockSpec, LayoutSpec, LengthColumnSpec, LengthSpec, LengthUnit, PairsSpec, PositionSpec, RecordingMap,
    RecordingMapSpec, ReferencePoint, RelativeSpeedSpec, Sign, Spacing, SpacingSpec, SpeedSpec, SpeedUnit, TimeSpec,
    TimeUnit, TracksSpec, plain_unit,
};
use super::{LineProblem, Recording, binary};

/// Words in the names of columns, in lower case.
const TIMES: &str = "time timestamp t zeit sec seconds";
const SPACINGS: &str = "gap spacing distance dist range clearance headway abstand d dx";
const RELATIVE: &str = "rel relative relativ closing rangerate dv deltav vrel differenz";
const SPEEDS: &str = "speed velocity vel v geschwindigkeit mps kmh kph mph xvelocity vego vl vf vlead vrel tempo";
const LEADERS: &str = "lead leader target front preceding ahead object obj tgt vl vlead vorn vorne voraus \
    vorausfahrend ziel objekt";
const VEHICLES: &str = "id vehicle track trackid vehicleid fahrzeug";
const EVENTS: &str = "event eventid episode episodeid";
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
}

/// Columns of a file with the words of their names.
struct Columns(Vec<(String, Vec<String>)>);

impl Columns {
    /// Returns the first column with one of the words, and with none of `without`.
    fn find(&self, words: &str, without: &[&str]) -> Option<&String> {
        self.find_both(words, words, without)
    }

    fn find_both(&self, words: &str, others: &str, without: &[&str]) -> Option<&String> {
        let fits = |(_, found): &&(String, Vec<String>)| {
            // Long words are also found within compounds.
            let is = |word: &str, wanted: &str| word == wanted || wanted.len() > 5 && word.contains(wanted);
            let has = |words: &str| found.iter().any(|word| words.split(' ').any(|wanted| is(word, wanted)));
            has(words) && has(others) && !without.iter().any(|not| has(not))
        };
        self.0.iter().find(fits).map(|(name, _)| name)
    }
}

/// Returns the unit in the name of a column, or `other`.
fn unit_of<U: serde::de::DeserializeOwned>(all: &[(&'static str, f64)], column: &str, other: &str) -> Option<U> {
    let words = words(column);
    let is_named = |(unit, _): &&(&str, f64)| {
        let joined = unit.replace('/', "");
        words.iter().any(|word| *word == joined || plain_unit(word) == *unit)
    };
    // Longer units contain shorter ones.
    let named = all.iter().filter(is_named).max_by_key(|(unit, _)| unit.len());
    serde_json::from_value(named.map_or(other, |(unit, _)| unit).into()).ok()
}

/// Splits a name into words in lower case, at punctuation and where capitals begin; also the words joined in pairs.
fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut is_open = false;
    let mut was_lower = false;
    for letter in name.chars() {
        if !letter.is_alphanumeric() {
            is_open = false;
        } else {
            if !is_open || (letter.is_uppercase() && was_lower) {
                words.push(String::new());
            }
            is_open = true;
            words.iter_mut().last().into_iter().for_each(|word| word.extend(letter.to_lowercase()));
        }
        was_lower = letter.is_lowercase();
    }
    let joined: Vec<String> = words.windows(2).map(|pair| pair.concat()).collect();
    words.extend(joined);
    words
}

/// Returns the candidate maps, the likeliest first: without units, if the file states them.
fn candidates(columns: &Columns, states_units: bool) -> Vec<RecordingMapSpec> {
    let Some(time) = columns.find(TIMES, &[SPACINGS]) else { return Vec::new() };
    let spacing = columns.find(SPACINGS, &[RELATIVE, TIMES]);
    let relative = columns.find(RELATIVE, &[]);
    let leader = columns.find_both(SPEEDS, LEADERS, &[RELATIVE, SPACINGS]);
    let own = columns.find(SPEEDS, &[RELATIVE, LEADERS, TIMES, SPACINGS]);
    let position = columns.find(POSITIONS, &[SPEEDS]);
    let event = columns.find(EVENTS, &[TIMES]);
    let mut maps = Vec::new();
    // Epoch times need no name.
    let time_unit = unit_of(TimeUnit::ALL, time, "").filter(|unit| *unit != TimeUnit::Seconds);
    let with_stated = |units: &[(&'static str, f64)]| {
        states_units.then_some("").into_iter().chain(units.iter().map(|(unit, _)| *unit)).collect::<Vec<_>>()
    };
    for speed_unit in with_stated(SpeedUnit::ALL) {
        for length_unit in with_stated(LengthUnit::ALL) {
            let speed_unit = |column: &str| unit_of(SpeedUnit::ALL, column, speed_unit);
            let length_unit = |column: &str| unit_of(LengthUnit::ALL, column, length_unit);
            let speed =
                |column: &String| SpeedSpec { column: column.clone(), unit: speed_unit(column), acceleration: None };
            let from = Spacing::BumperToBumper;
            let mut add = |layout| {
                let time = TimeSpec::Clock(ClockSpec { column: time.clone(), unit: time_unit });
                let map = RecordingMapSpec::new("draft".to_owned(), time, layout);
                if !maps.contains(&map) {
                    maps.push(map);
                }
            };
            let vehicle = columns.find(VEHICLES, &[LANES, TIMES, SPEEDS, SPACINGS, LENGTHS, POSITIONS]);
            if let (Some(vehicle), Some(position), Some(own)) = (vehicle, position, own) {
                let length = columns.find(LENGTHS, &[]);
                let length = length.map(|name| LengthColumnSpec { name: name.clone(), unit: length_unit(name) });
                add(LayoutSpec::Tracks(TracksSpec {
                    vehicle: vehicle.clone(),
                    lane: columns.find(LANES, &[]).cloned(),
                    position: PositionSpec {
                        column: position.clone(),
                        unit: length_unit(position),
                        of: ReferencePoint::Front,
                    },
                    speed: speed(own),
                    length: length.map_or(LengthSpec::Metres(super::CAR_LENGTH_M), LengthSpec::Column),
                    lane_blip_s: 0.5,
                }));
                continue;
            }
            let Some(spacing) = spacing else { continue };
            for (own, leader, sign) in [
                (own, leader, Sign::LeaderMinusFollower),
                (own, leader, Sign::FollowerMinusLeader),
                (leader, own, Sign::LeaderMinusFollower),
                (leader, own, Sign::FollowerMinusLeader),
            ] {
                add(LayoutSpec::Pairs(PairsSpec {
                    event: event.cloned(),
                    spacing: SpacingSpec { column: spacing.clone(), unit: length_unit(spacing), from },
                    length_m: None,
                    follower_speed: own.map(speed),
                    leader_speed: leader.map(speed),
                    relative_speed: relative.map(|name| RelativeSpeedSpec {
                        column: name.clone(),
                        unit: speed_unit(name),
                        sign,
                    }),
                }));
            }
        }
    }
    maps
}

/// Drafts a map of a recording: the first candidate whose columns do not contradict each other. Units in names of
/// columns are kept. `None` without candidates.
///
/// # Errors
/// [`RecordingError`] for a file that cannot be read with any candidate.
pub fn guess(path: &Path) -> Result<Option<MapDraft>, RecordingError> {
    let (names, states_units) = binary::column_names(path)?;
    let built_in = match names.first().map(String::as_str) {
        Some("Date") => Some("openacc"),
        _ => RecordingMap::recognise(names.iter().map(String::as_str)),
    };
    if let Some(Ok(map)) = built_in.and_then(RecordingMap::built_in)
        && let Ok(recording) = load_first_rows(path, &map)
    {
        return Ok(Some(MapDraft { map: map.spec().clone(), built_in, recording }));
    }
    let columns = Columns(names.into_iter().map(|name| (name.clone(), words(&name))).collect());
    let (mut second_choice, mut contradiction) = (None, None);
    for map in candidates(&columns, states_units) {
        let Ok(checked) = RecordingMap::new(map.clone()) else { continue };
        match load_first_rows(path, &checked) {
            Ok(recording) => {
                let contradicts = |what: &Omission| {
                    matches!(what, Omission::ColumnsContradict(_))
                        || matches!(what, Omission::Counted { after, .. } if after.ends_with(SPEEDS_LEFT_OUT))
                };
                let is_consistent = !recording.dropped.iter().any(|dropped| contradicts(&dropped.omission));
                let draft = MapDraft { map, built_in: None, recording };
                if is_consistent {
                    return Ok(Some(draft));
                }
                second_choice.get_or_insert(draft);
            }
            Err(error @ RecordingError::Line { problem: LineProblem::Column { .. }, .. }) => {
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
        assert!(matches!(guess(&path).unwrap().expect("a draft").map.layout, LayoutSpec::Tracks(_)));
    }

    /// Units and signs follow from the consistency of gaps and speeds, unless names state them; exchanged names do not.
    #[test]
    fn drafts_read_the_speeds_of_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        for (unit, mps) in SpeedUnit::ALL {
            for sign in [1.0, -1.0] {
                let (time, per_second) = if sign > 0.0 { ("Zeit [s]", 1.0) } else { ("zeit_ms", 1000.0) };
                // Units in names may differ. Without them, both speeds have one unit.
                let own_name = format!("v_ego_{}", unit.replace('/', ""));
                let (own_name, name, rel_mps) =
                    if sign > 0.0 { ("v_ego", "v_rel", *mps) } else { (&*own_name, "v_rel_fps", 0.3048) };
                let mut text = format!("{time};Event;Abstand [m];{own_name};{name}\n");
                let mut gap_m = 40.0;
                for tenth in 0..400 {
                    let at_s = f64::from(tenth) / 10.0;
                    let (own_mps, relative_mps) = (20.0 + (0.3 * at_s).sin(), 12.0 * (0.5 * at_s).cos());
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
                assert!((speed_mps - 20.0 - 1.5_f64.sin()).abs() < 0.3, "{unit} {sign}: {speed_mps} {:?}", draft.map);
                let again = RecordingMap::from_toml(&draft.map.to_toml().unwrap(), Path::new("draft.toml")).unwrap();
                assert_eq!(*again.spec(), draft.map);
            }
        }
    }
}
