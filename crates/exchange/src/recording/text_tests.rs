//! One recording in every encoding, with every separator, decimal mark and time format, is one set of values.

use std::path::Path;

use proptest::prelude::*;

use super::map::{DecimalMark, RecordingMap};
use super::number::{parse_iso_s, parse_number};
use super::*;

const MAP: &str = r#"version = 1
name = "own"
time.clock = { column = "Zeit" }

[layout.pairs]
event = "Größe"
spacing = { column = "Abstand", unit = "cm" }
follower_speed = { column = "v" }
leader_speed = { column = "v vorn" }
"#;

#[derive(Debug, Clone)]
struct Writing {
    /// UTF-8, with a mark, UTF-16 LE and BE, each with and without a mark, Latin-1.
    encoding: usize,
    delimiter: char,
    is_decimal_comma: bool,
    thousands: &'static str,
    has_quotes: bool,
    comment: Option<char>,
    /// s, ms, us, ns since 1970, ISO 8601.
    time: usize,
    line_end: &'static str,
}

fn any_writing() -> impl Strategy<Value = Writing> {
    let marks = (prop::bool::ANY, 0..4_usize, prop::bool::ANY);
    let lines = (
        prop::option::of(prop::sample::select(vec!['#', '%'])),
        prop::sample::select(vec!["\n", "\r\n"]),
    );
    (
        0..7_usize,
        prop::sample::select(vec![',', ';', '\t']),
        marks,
        lines,
        0..5_usize,
    )
        .prop_map(
            |(
                encoding,
                delimiter,
                (is_decimal_comma, thousands, has_quotes),
                (comment, line_end),
                time,
            )| {
                let thousands =
                    ["", "'", "\u{a0}", if is_decimal_comma { "." } else { "," }][thousands];
                let has_quotes =
                    has_quotes || delimiter == ',' && (is_decimal_comma || thousands == ",");
                Writing {
                    encoding,
                    delimiter,
                    is_decimal_comma,
                    thousands,
                    has_quotes,
                    comment,
                    time,
                    line_end,
                }
            },
        )
}

impl Writing {
    fn number(&self, value: f64, decimals: usize) -> String {
        let plain = format!("{value:.decimals$}");
        let (whole, fraction) = plain.split_once('.').expect("decimals");
        let (front, back) = whole.split_at(whole.len().saturating_sub(3));
        let separator = if front.is_empty() { "" } else { self.thousands };
        format!(
            "{front}{separator}{back}{}{fraction}",
            if self.is_decimal_comma { ',' } else { '.' }
        )
    }

    fn write(&self, rows: &[[f64; 4]]) -> Vec<u8> {
        let mut text = String::new();
        let mut line = |fields: [String; 5]| {
            let quoted = |field: String| {
                if self.has_quotes {
                    format!("\"{field}\"")
                } else {
                    field
                }
            };
            text += &fields.map(quoted).join(&self.delimiter.to_string());
            text += self.line_end;
            if let Some(letter) = self.comment {
                text += &format!(
                    "{letter} \"measured\", with 1,5 {}{}",
                    self.delimiter, self.line_end
                );
            }
        };
        line(["Zeit", "Größe", "Abstand", "v", "v vorn"].map(str::to_owned));
        for [time_s, values @ ..] in rows {
            // 1 March 2024, 12:00 UTC.
            let ms = 1_709_294_400_000 + (time_s * 1000.0).round() as u64;
            let time = match self.time {
                0 => format!("{}.{:03}", ms / 1000, ms % 1000),
                1 => ms.to_string(),
                2 => format!("{ms}000"),
                3 => format!("{ms}000000"),
                _ => format!(
                    "2024-03-01T13:00:{:02}.{:03}+01:00",
                    ms / 1000 % 60,
                    ms % 1000
                ),
            };
            let time = if self.is_decimal_comma && self.time == 0 {
                time.replace('.', ",")
            } else {
                time
            };
            let [gap, follower, leader] = values;
            line([
                time,
                "ä1".to_owned(),
                self.number(100.0 * gap, 1),
                self.number(*follower, 3),
                self.number(*leader, 3),
            ]);
        }
        let marked = format!("\u{feff}{text}");
        match self.encoding {
            0 => text.into_bytes(),
            1 => marked.into_bytes(),
            2 => marked.encode_utf16().flat_map(u16::to_le_bytes).collect(),
            3 => marked.encode_utf16().flat_map(u16::to_be_bytes).collect(),
            4 => text.encode_utf16().flat_map(u16::to_le_bytes).collect(),
            5 => text.encode_utf16().flat_map(u16::to_be_bytes).collect(),
            _ => text
                .chars()
                .map(|letter| u8::try_from(u32::from(letter)).expect("Latin-1"))
                .collect(),
        }
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn the_text_format_changes_no_value(
        writing in any_writing(),
        speeds in prop::collection::vec(0.0..40.0_f64, 2..40),
        step in 1..9_u32,
    ) {
        // The gap stays the same between vehicles of the same speed.
        let rows = speeds.iter().enumerate().map(|(index, &speed)| {
            let speed_mps = (speed * 1000.0).round() / 1000.0;
            [0.1 * index as f64, f64::from(step) * 4.001, speed_mps, speed_mps]
        });
        let rows: Vec<[f64; 4]> = rows.collect();
        let map = RecordingMap::from_toml(MAP, Path::new("m.toml")).expect("a map");
        let recording = read(&writing.write(&rows)[..], Path::new("a.csv"), Some(&map));
        let recording = recording.map_err(|error| TestCaseError::fail(error.to_string()))?;
        let text = &recording.text;
        prop_assert!(recording.platoons.iter().all(|part| part.event.as_deref() == Some("ä1")), "{text:?}");
        let samples = recording.platoons.iter().flat_map(|part| {
            let [leader, follower] = &part.vehicles[..] else { panic!("not a pair") };
            let values = part.gap_ahead_m(1).iter().zip(&follower.speed_mps).zip(&leader.speed_mps);
            part.time_s.iter().zip(values).map(|(time, ((gap, follower), leader))| {
                [*time - 1_709_294_400.0, gap.expect("known"), follower.expect("known"), leader.expect("known")]
            })
        });
        let samples: Vec<[f64; 4]> = samples.collect();
        prop_assert_eq!(samples.len(), rows.len());
        for (sample, written) in samples.iter().zip(&rows) {
            // Gaps are written to a millimetre.
            let is_equal = sample.iter().zip(written).all(|(a, b)| (a - b).abs() < 1.1e-3);
            prop_assert!(is_equal, "{sample:?} {written:?} {text:?}");
        }
        let shown = text.to_string();
        prop_assert_eq!(shown.contains("ISO 8601"), writing.time == 4);
        prop_assert_eq!(shown.contains("windows-1252"), writing.encoding == 6);
    }

    #[test]
    fn numbers_are_never_misread(text in "[-+0-9.,' e]{0,9}") {
        for decimal in [DecimalMark::Point, DecimalMark::Comma] {
            let Some(number) = parse_number(&text, decimal) else { continue };
            let mark = if decimal == DecimalMark::Point { '.' } else { ',' };
            let plain: String = text.chars().filter(|letter| !".,' ".contains(*letter) || *letter == mark).collect();
            prop_assert_eq!(Some(number), plain.replace(',', ".").parse().ok());
        }
    }
}

#[test]
fn numbers_and_times_are_read_as_written() {
    let [point, comma] =
        [DecimalMark::Point, DecimalMark::Comma].map(|mark| move |text| parse_number(text, mark));
    assert_eq!(
        ["1,234.5", "1'234.5", "1,23", "0,123", "12,34,567"].map(&point),
        [Some(1234.5), Some(1234.5), None, None, None]
    );
    assert_eq!(
        ["1.234,5", "-0,5e-1", "1.5", "7", "1.234"].map(&comma),
        [Some(1234.5), Some(-0.05), None, Some(7.0), Some(1234.0)]
    );
    let times = [
        "1970-01-01T00:00:00Z",
        "2024-02-29 12:00:00,25",
        "2000-03-01T00:00+01:00",
        "00:01:02.5",
    ];
    assert_eq!(
        times.map(parse_iso_s),
        [
            Some(0.0),
            Some(1_709_208_000.25),
            Some(951_865_200.0),
            Some(62.5)
        ]
    );
    for wrong in [
        "",
        "2024",
        "2024-13-01T00:00",
        "2026-02-30T00:00",
        "2024-01-01T00:60",
        "2024-01-01Tx",
        "12:00:00.",
        "1.5",
        "é:00:00",
    ] {
        assert_eq!(parse_iso_s(wrong), None, "{wrong}");
    }
}

fn pairs_map() -> RecordingMap {
    let text = MAP.replace(", unit = \"cm\"", "");
    RecordingMap::from_toml(&text, Path::new("m.toml")).expect("a map")
}

fn events_of(text: &str) -> Vec<String> {
    let recording =
        read(text.as_bytes(), Path::new("a.csv"), Some(&pairs_map())).expect("readable");
    recording
        .platoons
        .into_iter()
        .map(|platoon| platoon.event.expect("named"))
        .collect()
}

/// RFC 4180: a quotation mark in a field is doubled. `a""b` and `a""""b` are two events.
#[test]
fn doubled_quotation_marks_are_single_ones_and_no_row_is_lost() {
    let rows = |event: &str| format!("0,{event},50,20,20\n1,{event},50,20,20\n");
    let text = format!(
        "Zeit,Größe,Abstand,v,v vorn\n{}{}{}",
        rows("\"a\"\"\"\"b\""),
        rows("\"a\"\"b\""),
        rows("\"line\nend, and \"\"mark\"\"\"")
    );
    assert_eq!(
        events_of(&text),
        ["a\"\"b", "a\"b", "line\u{fffd}end, and \"mark\""]
    );
    // Blanks before quotation marks, as many programs write them.
    let text = "\"Zeit\", \"Größe\", \"Abstand\", \"v\", \"v vorn\"\n\"0\", \"a, b\", \"50\", \"20\", \"20\"\n";
    assert_eq!(events_of(text), ["a, b"]);
}

/// Each doubled mark once copied the whole row.
#[test]
fn doubled_quotation_marks_need_linear_memory_and_time() {
    let field = format!("\"{}\"", "a\"\"".repeat(300_000));
    let text =
        format!("Zeit,Größe,Abstand,v,v vorn,text\n0,e,50,20,20,{field}\n1,e,50,20,20,short\n");
    assert_eq!(events_of(&text), ["e"]);
    let open = format!(
        "Zeit,Größe,Abstand,v,v vorn\n0,\"{}",
        "e,50,20,20\n".repeat(200_000)
    );
    let message = read(open.as_bytes(), Path::new("a.csv"), Some(&pairs_map()))
        .expect_err("not closed")
        .to_string();
    assert!(
        message.starts_with("a.csv:2: a quotation mark in this row is not closed"),
        "{message}"
    );
    let long = format!(
        "Zeit,Größe,Abstand,v,v vorn\n0,\"{}",
        "e,50,20,20\n".repeat(2_000_000)
    );
    let message = read(long.as_bytes(), Path::new("a.csv"), Some(&pairs_map()))
        .expect_err("not closed")
        .to_string();
    assert!(
        message.starts_with("a.csv:2: a row of more than 16777216 bytes"),
        "{message}"
    );
    let blank = format!(
        "Zeit,Größe,Abstand,v,v vorn\n{}0,e,50,20,20\n1,e,50,20,20\n",
        "\n".repeat(2 << 20)
    );
    assert_eq!(events_of(&blank), ["e"]);
}

/// Lines of errors count blank lines, comments and line ends within fields.
#[test]
fn errors_name_the_line_at_which_a_row_begins() {
    for line_end in ["\n", "\r\n", "\r"] {
        let text = "# comment\n\nZeit,Größe,Abstand,v,v vorn\n# \
            \"comment\n0,\"a\nb\",50,20,20\n\n1,\"a\nb\",fast,20,20\n";
        let text = text.replace('\n', line_end);
        let message = read(text.as_bytes(), Path::new("a.csv"), Some(&pairs_map()))
            .expect_err("no number")
            .to_string();
        assert!(
            message.starts_with("a.csv:8: Abstand: must be a finite number"),
            "{line_end:?}: {message}"
        );
    }
}

/// Spreadsheets read the separator from a first line.
#[test]
fn a_first_line_may_state_the_separator() {
    let rows = "Zeit;Größe;Abstand;v;v vorn\n0;e;50,5;20;20\n1;e;50,5;20;20\n";
    for first in ["sep=;\r\n", "SEP=;\n", "\"sep=;\"\n", "\u{feff}sep=;\n"] {
        let text = format!("{first}{rows}");
        assert_eq!(events_of(&text), ["e"], "{first:?}");
        let wrong = text.replace("1;e;50,5", "1;e;x");
        let message = read(wrong.as_bytes(), Path::new("a.csv"), Some(&pairs_map()))
            .expect_err("wrong")
            .to_string();
        assert!(message.starts_with("a.csv:4: "), "{message}");
    }
    assert_eq!(
        events_of(&format!(
            "sep=,\n{}",
            "Zeit,Größe,Abstand,v,v vorn\n0,e,50,20,20\n"
        )),
        ["e"]
    );
}

/// crumple reads no other separator, so it names the one that the file states.
#[test]
fn a_separator_that_crumple_does_not_read_is_named() {
    for (first, found) in [
        ("sep=|", "|"),
        ("SEP=:", ":"),
        ("\"sep= \"", " "),
        ("sep=", ""),
    ] {
        let text = format!("{first}\r\nZeit|v\r\n0|5\r\n");
        let message = read(text.as_bytes(), Path::new("a.csv"), Some(&pairs_map()))
            .expect_err("wrong")
            .to_string();
        assert_eq!(
            message,
            format!(
                "a.csv:1: the first line states the separator `{found}`, but crumple reads only comma, semicolon \
                 and tab"
            )
        );
    }
    // A spreadsheet that saves the file again fills the line.
    let rows = "Zeit;Größe;Abstand;v;v vorn\n0;e;50,5;20;20\n";
    assert_eq!(events_of(&format!("sep=;;;;;\n{rows}")), ["e"]);
}

/// Columns have the units of their quantity under several names.
#[test]
fn units_in_column_names_have_several_spellings() {
    use super::map::{SpeedUnit, TimeUnit, unit_in_name, unknown_unit_in_name};
    for (name, expected) in [
        ("v [km/hr]", "km/h"),
        ("v km/hr", "km/h"),
        ("v_kph", "km/h"),
        ("v (Miles/Hour)", "mph"),
        ("v [m / sec]", "m/s"),
        ("v_ms", "m/s"),
    ] {
        let unit = unit_in_name(SpeedUnit::ALL, name).map(|(unit, _)| unit);
        assert_eq!(unit, Some(expected), "{name}");
    }
    let unknown = |units, name| unknown_unit_in_name(units, name).map(|unit| unit.text);
    for (name, expected) in [
        ("t [min]", Some("min")),
        ("t_h", Some("h")),
        ("t [fortnight]", Some("fortnight")),
        ("Time (UTC)", None),
        ("time [hh:mm:ss]", None),
        ("t [µs]", None),
    ] {
        assert_eq!(unknown(TimeUnit::ALL, name).as_deref(), expected, "{name}");
    }
    assert_eq!(unknown(SpeedUnit::ALL, "v_kn").as_deref(), Some("kn"));
}

/// The unit in a name holds unless the map states another one, which is an error.
#[test]
fn units_in_column_names_apply_and_must_not_contradict_the_map() {
    let read_with = |header: &str, unit: &str| {
        let columns = format!("spacing = {{ column = \"{header}\"{unit} }}\n");
        let text = format!(
            "version = 1\nname = \"own\"\ntime.clock = {{ column = \"t\" }}\n[layout.pairs]\n{columns}\
             follower_speed = {{ column = \"v\" }}\nleader_speed = {{ column = \"lead\" }}\n"
        );
        let map = RecordingMap::from_toml(&text, Path::new("m.toml")).expect("a map");
        let rows = format!("t,{header},v,lead\n0,100,20,20\n1,100,20,20\n");
        read(rows.as_bytes(), Path::new("a.csv"), Some(&map))
            .map(|recording| recording.platoons[0].gap_ahead_m(1)[0])
    };
    for (header, unit, expected_m) in [
        ("gap [ft]", "", 30.48),
        ("gap_cm", "", 1.0),
        ("gap (m)", ", unit = \"m\"", 100.0),
        ("gap", ", unit = \"ft\"", 30.48),
        ("gap [feet] (ego)", "", 30.48),
        ("gap (ego)", ", unit = \"ft\"", 30.48),
        ("gap[0]", "", 100.0),
        ("gap_min", "", 100.0),
        ("abstand", "", 100.0),
    ] {
        let gap_m = read_with(header, unit)
            .unwrap_or_else(|error| panic!("{header}: {error}"))
            .expect("known");
        assert!((gap_m - expected_m).abs() < 1e-9, "{header}: {gap_m}");
    }
    for (header, unit, expected) in [
        (
            "gap [ft]",
            ", unit = \"m\"",
            "a.csv:1: gap [ft]: its name states the unit `ft`, but the map states `m`",
        ),
        (
            "gap_m",
            ", unit = \"cm\"",
            "a.csv:1: gap_m: its name states the unit `m`, but the map states `cm`",
        ),
        (
            "gap [mm]",
            ", unit = \"m\"",
            "a.csv:1: gap [mm]: its name states the unit `mm`, but the map states `m`",
        ),
        (
            "gap [mm]",
            "",
            "a.csv:1: gap [mm]: the file states the unit `mm`, which is not one of m, ft, cm",
        ),
        (
            "gap [furlong]",
            "",
            "a.csv:1: gap [furlong]: the file states the unit `furlong`, which is not one of m, ft, cm",
        ),
        (
            "gap [ftt]",
            ", unit = \"ft\"",
            "a.csv:1: gap [ftt]: its name states the unit `ftt`, but the map states `ft`: crumple knows m, ft, cm",
        ),
        (
            "gap [m/s]",
            "",
            "a.csv:1: gap [m/s]: the file states the unit `m/s`, which is not one of m, ft, cm",
        ),
        (
            "gap_km",
            "",
            "a.csv:1: gap_km: the file states the unit `km`, which is not one of m, ft, cm",
        ),
        (
            "gap_km",
            ", unit = \"m\"",
            "a.csv:1: gap_km: its name states the unit `km`, but the map states `m`",
        ),
        (
            "gap (ego)",
            "",
            "a.csv:1: gap (ego): the file states the unit `ego`, which is not one of m, ft, cm: state \
             the unit in the map",
        ),
    ] {
        let message = read_with(header, unit)
            .expect_err("contradicts")
            .to_string();
        assert!(message.starts_with(expected), "{message}");
    }
}

/// Published files of NGSIM have `v_length` and `v_Length`.
#[test]
fn capital_letters_of_columns_matter_only_between_two_equal_names() {
    let header = "Vehicle_ID,Global_Time,Local_Y,v_length,v_Width,v_Vel,Lane_ID\n";
    let rows = "1,1113433135300,100,14.5,6,30,1\n1,1113433135400,103,14.5,6,30,1\n";
    let map = RecordingMap::built_in("ngsim")
        .expect("built in")
        .expect("a map");
    let read_with = |header: &str| {
        read(
            format!("{header}{rows}").as_bytes(),
            Path::new("a.csv"),
            Some(&map),
        )
    };
    for header in [
        header.to_owned(),
        header.replace("v_length", "v_Length"),
        header.to_lowercase(),
    ] {
        assert!(read_with(&header).is_ok(), "{header}");
    }
    // The exact name counts where there are two.
    assert!(
        read_with(
            &header
                .replace("v_Width", "V_LENGTH")
                .replace("v_length", "v_Length")
        )
        .is_ok()
    );
    let twice = read_with(&header.replace("v_Width", "V_LENGTH"))
        .expect_err("two names")
        .to_string();
    assert_eq!(twice, "a.csv:1: v_Length: named twice");
    let unnamed = read(
        format!("{header}{rows}").as_bytes(),
        Path::new("a.csv"),
        None,
    )
    .expect_err("no map")
    .to_string();
    assert!(unnamed.contains("--map ngsim"), "{unnamed}");
}
