//! Scenario files: written scenarios are read back, invalid ones are refused with their line, and the schema is
//! correct.

use crumple_fuzzing::ScenarioFormat;
use crumple_fuzzing::targets::error_line;
use crumple_sim::scenario::{Scenario, built_in_scenario, built_in_scenario_names, json_schema};
use proptest::prelude::*;

use crate::generate::{any_scenario, with_cases};
use crate::schema::{assert_committed, validate};

fn any_format() -> impl Strategy<Value = ScenarioFormat> {
    prop::sample::select(ScenarioFormat::ALL.to_vec())
}

/// A scenario with arbitrary texts; a name has no control characters.
fn any_file() -> impl Strategy<Value = Scenario> {
    (any_scenario(), "\\PC{1,40}", any::<String>()).prop_map(|(scenario, name, about)| {
        scenario
            .edited(|spec| (spec.name, spec.about) = (name, about))
            .expect("texts are free")
    })
}

/// Checks that reading does not panic, and that an error names an existing line.
fn check_error_line(format: ScenarioFormat, text: &str) -> Result<(), TestCaseError> {
    if let Err(error) = format.read(text) {
        let message = error.to_string();
        let lines = text.bytes().filter(|&byte| byte == b'\n').count() + 1;
        let line = error_line(&message);
        prop_assert!(
            line.is_some_and(|line| (1..=lines).contains(&line)),
            "{message}\n{text}"
        );
    }
    Ok(())
}

fn replace_range(text: &str, at: std::ops::Range<usize>, with: &str) -> String {
    format!("{}{with}{}", &text[..at.start], &text[at.end..])
}

/// Returns the ranges of numbers in a text: after an equals sign, a colon, a bracket or a blank.
fn number_ranges(text: &str) -> Vec<std::ops::Range<usize>> {
    let mut paths = Vec::new();
    let mut start = None;
    let mut before = ' ';
    for (index, c) in text.char_indices() {
        match start {
            None if (c.is_ascii_digit() || c == '-') && " [".contains(before) => {
                start = Some(index)
            }
            Some(from) if !(c.is_ascii_alphanumeric() || "+-._".contains(c)) => {
                paths.push(from..index);
                start = None;
            }
            _ => {}
        }
        before = c;
    }
    paths
}

proptest! {
    #![proptest_config(with_cases(512))]

    /// Every valid scenario survives both formats, to the last bit of every number.
    #[test]
    fn files_round_trip_exactly(scenario in any_file(), format in any_format()) {
        let text = format.to_text(&scenario);
        let back = format.read(&text).map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
        prop_assert_eq!(back.spec(), scenario.spec(), "{}", text);
    }

    #[test]
    fn any_text_is_read_or_refused(text in any::<String>(), format in any_format()) {
        check_error_line(format, &text)?;
    }

    /// Cut files, lost or doubled lines, and changed characters.
    #[test]
    fn damaged_files_are_read_or_refused(
        scenario in any_scenario(),
        format in any_format(),
        damage in 0..4_u8,
        (place, other) in (any::<prop::sample::Index>(), any::<char>()),
    ) {
        let text = format.to_text(&scenario);
        let at = place.index(text.len());
        let at = (0..=at).rev().find(|&at| text.is_char_boundary(at)).unwrap();
        let line_end = text[at..].find('\n').map_or(text.len(), |end| at + end + 1);
        let line_start = text[..at].rfind('\n').map_or(0, |end| end + 1);
        let damaged = match damage {
            0 => text[..at].to_owned(),
            1 => replace_range(&text, line_start..line_end, ""),
            2 => replace_range(&text, line_end..line_end, &text[line_start..line_end]),
            _ => replace_range(&text, at..at, &other.to_string()),
        };
        check_error_line(format, &damaged)?;
    }

    /// The error names the line of a number that no field accepts.
    #[test]
    fn one_bad_number_is_found(
        scenario in any_scenario(),
        format in any_format(),
        place in any::<prop::sample::Index>(),
        bad in prop::sample::select(vec!["nan", "inf", "-inf", "\"text\"", "1e300", "-1e300", "[[]]", "1e999"]),
    ) {
        // JSON has no NaN or infinity: they would be a different error on the same line.
        let text = format.to_text(&scenario);
        let numbers = number_ranges(&text);
        let at = numbers[place.index(numbers.len())].clone();
        let line = text[..at.start].matches('\n').count() + 1;
        let damaged = replace_range(&text, at, bad);
        let message = format.read(&damaged).expect_err("must be refused").to_string();
        prop_assert_eq!(error_line(&message), Some(line), "{}\n{}", message, damaged);
    }

    #[test]
    fn valid_scenarios_satisfy_the_schema(scenario in any_file()) {
        let (schema, value) = (json_schema(), serde_json::to_value(scenario.spec()).unwrap());
        validate(&schema, &schema, &value, "scenario").map_err(TestCaseError::fail)?;
    }
}

/// `UPDATE_SCHEMA=1 cargo test --test suite schema` updates the committed schema. The schema refuses what the program
/// refuses, as far as a schema can express it.
#[test]
fn the_committed_schema_accepts_the_built_in_scenarios_and_refuses_nonsense() {
    let schema = json_schema();
    assert_committed("crates/sim/src/scenario/scenario.schema.json", &schema);
    let check = |value: &serde_json::Value| validate(&schema, &schema, value, "scenario");
    for (name, _) in built_in_scenario_names() {
        check(&serde_json::to_value(built_in_scenario(name).unwrap().spec()).unwrap()).unwrap();
    }
    let paper_1 = serde_json::to_value(built_in_scenario("paper-1").unwrap().spec()).unwrap();
    let nonsense = [
        ("/version", serde_json::json!("one")),
        ("/duration_s", serde_json::json!(-1.0)),
        ("/vehicles", serde_json::json!([])),
        ("/vehicles/0/speed_mps", serde_json::json!(-1.0)),
        ("/vehicles/0/class", serde_json::json!("tank")),
        ("/vehicles/0/driver", serde_json::json!("unknown")),
        (
            "/vehicles/0/driver",
            serde_json::json!({ "brake": { "onset_s": 1.0 } }),
        ),
        (
            "/vehicles/0/driver",
            serde_json::json!({ "brake": { "onset_s": 1.0, "rate_mps2": 31.0 } }),
        ),
        (
            "/vehicles/0/driver",
            serde_json::json!({ "idm": { "politeness": 1.0 } }),
        ),
        ("/vehicles/0", serde_json::json!({ "class": "light" })),
    ];
    for (place, value) in nonsense {
        let mut changed = paper_1.clone();
        *changed.pointer_mut(place).expect("there") = value;
        assert!(
            check(&changed).is_err(),
            "{place}: the schema accepts {}",
            changed.pointer(place).unwrap()
        );
        let text = serde_json::to_string(&changed).unwrap();
        assert!(
            ScenarioFormat::Json.read(&text).is_err(),
            "{place}: the program accepts it"
        );
    }
    let mut unknown = paper_1.clone();
    unknown["colour"] = serde_json::json!(3);
    assert!(check(&unknown).is_err());
}
