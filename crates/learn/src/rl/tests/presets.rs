//! Errors of a preset name file, line and field.

use std::ops::Range;
use std::path::Path;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::retrain::training_preset;
use crate::rl::{PRESETS, TrainingConfig};

fn presets() -> impl Iterator<Item = (&'static str, String)> {
    const RETRAIN: &str = include_str!("../../retrain/preset.toml");
    assert!(training_preset().is_ok());
    let all = include_str!("every-field.toml");
    let imitating = [all, include_str!("imitation.toml")].concat();
    let presets = PRESETS.into_iter().chain([
        ("retrain", RETRAIN),
        ("all", all),
        ("imitating", &imitating),
    ]);
    presets
        .map(|(name, text)| (name, text.to_owned()))
        .collect::<Vec<_>>()
        .into_iter()
}

/// Returns the path and the position of every value of a text that is no table and no list.
fn leaf_values(text: &str) -> Vec<(String, Range<usize>)> {
    fn collect_value<'t>(
        path: &str,
        value: &Spanned<DeValue<'t>>,
        fields: &mut Vec<(String, Range<usize>)>,
    ) {
        match value.get_ref() {
            DeValue::Table(table) => collect_table(path, table, fields),
            DeValue::Array(list) => {
                let values = list.iter().enumerate();
                values.for_each(|(index, value)| {
                    collect_value(&format!("{path}[{index}]"), value, fields)
                });
            }
            _ => fields.push((path.to_owned(), value.span())),
        }
    }
    fn collect_table<'t>(
        path: &str,
        table: &DeTable<'t>,
        fields: &mut Vec<(String, Range<usize>)>,
    ) {
        let dot = if path.is_empty() { "" } else { "." };
        table.iter().for_each(|(name, value)| {
            collect_value(&format!("{path}{dot}{}", name.get_ref()), value, fields)
        });
    }
    let mut fields = Vec::new();
    collect_table(
        "",
        DeTable::parse(text).expect("a preset").get_ref(),
        &mut fields,
    );
    fields
}

fn line_number(text: &str, offset: usize) -> usize {
    text[..offset].matches('\n').count() + 1
}

fn parse_error(text: &str) -> Option<String> {
    TrainingConfig::parse(text, Path::new("own.toml"))
        .err()
        .map(|error| error.to_string())
}

/// Each value of each preset, replaced by an invalid one.
#[test]
fn invalid_values_are_named_with_their_line() {
    for (preset, text) in presets() {
        assert_eq!(parse_error(&text), None, "{preset}");
        for (field, at) in leaf_values(&text) {
            let is_number = text[at.clone()].parse::<f64>().is_ok();
            let spoils: &[&str] = match &*field {
                // Any text is a valid name, and any non-empty text names a space.
                "name" => &["3", "true", "[]", "\"\"", "\" \""],
                field if field.ends_with("].space") => &["3", "true", "[]"],
                _ if is_number => &[
                    "-1e30",
                    "1e39",
                    "nan",
                    "-inf",
                    "\"much\"",
                    "true",
                    "[]",
                    "{ is = 1 }",
                    "9000000000000000000",
                ],
                _ => &["3", "\"eyes\"", "[]"],
            };
            for spoil in spoils {
                let spoiled = format!("{}{spoil}{}", &text[..at.start], &text[at.end..]);
                let message = parse_error(&spoiled)
                    .unwrap_or_else(|| panic!("{preset}: {field} = {spoil} is accepted"));
                let expected = format!("own.toml:{}: {field}: ", line_number(&text, at.start));
                assert!(
                    message.starts_with(&expected),
                    "{preset}: {field} = {spoil}\n{message}\n{expected}"
                );
                if message.contains("must be between") {
                    assert!(
                        message.ends_with(&format!(", found {spoil}")),
                        "as it is written: {message}"
                    );
                }
            }
        }
    }
}

/// Each line of each preset, omitted; and after each line an unknown field.
#[test]
fn missing_and_unknown_fields_are_named_with_their_table() {
    for (preset, text) in presets() {
        let lines: Vec<&str> = text.lines().collect();
        let mut header = (0, String::new());
        for (index, line) in lines.iter().enumerate() {
            if line.starts_with('[') {
                header = (index, line.trim_matches(['[', ']']).to_owned());
            }
            let Some((key, _)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) else {
                continue;
            };
            let nested = |table: &str, key: &str| {
                if table.is_empty() {
                    key.to_owned()
                } else {
                    format!("{table}.{key}")
                }
            };
            // The path of a table of an array includes its index.
            let count = lines[..=header.0]
                .iter()
                .filter(|line| **line == lines[header.0])
                .count();
            let table = if lines[header.0].starts_with("[[") {
                format!("{}[{}]", header.1, count - 1)
            } else {
                header.1.clone()
            };

            let unknown = [&lines[..=index], &["colour = 3"], &lines[index + 1..]]
                .concat()
                .join("\n");
            let message = parse_error(&unknown).unwrap();
            let expected = format!(
                "own.toml:{}: {}: unknown field `colour`",
                index + 2,
                nested(&table, "colour")
            );
            assert!(
                message.starts_with(&expected),
                "{preset}: {message}\n{expected}"
            );

            let without = [&lines[..index], &["# gone"], &lines[index + 1..]]
                .concat()
                .join("\n");
            let Some(message) = parse_error(&without) else {
                continue;
            };
            if message.contains("missing field") {
                // Fields that the top level lacks have no line of their own.
                let path = if table.is_empty() {
                    String::new()
                } else {
                    format!("{table}: ")
                };
                let expected = format!("own.toml:{}: {path}missing field `{key}`", header.0 + 1);
                assert_eq!(message, expected, "{preset}");
            }
        }
    }
}

#[test]
fn a_table_that_is_missing_is_named() {
    let fast = PRESETS[0].1;
    for table in [
        "environment",
        "network",
        "learning",
        "exploration",
        "replay",
        "td3",
        "evaluation",
    ] {
        let mut is_in = false;
        let without = fast.lines().filter(|line| {
            if line.starts_with('[') {
                let header = line.trim_matches(['[', ']']);
                is_in = header == table || header.starts_with(&format!("{table}."));
            }
            !is_in
        });
        let text: Vec<&str> = without.collect();
        assert_eq!(
            parse_error(&text.join("\n")).unwrap(),
            format!("own.toml:1: missing field `{table}`")
        );
    }
    assert_eq!(
        parse_error("").unwrap(),
        "own.toml:1: missing field `version`"
    );
}

#[test]
fn contradictory_settings_are_named() {
    let fast = PRESETS[0].1;
    let road = PRESETS[3].1;
    let all = include_str!("every-field.toml");
    let without_inputs = |line: &&str| !line.contains("{ offset");
    let without_history = road.replace("history = 5\n", "");
    let nothing_seen = fast
        .lines()
        .filter(without_inputs)
        .collect::<Vec<_>>()
        .join("\n");
    // In the first line that begins with the key, the value is replaced.
    for (text, key, value, expected) in [
        (fast, "version", "2", "version: version 2 is not supported"),
        (
            fast,
            "hidden",
            "[]",
            "network.hidden: must have 1 to 16 layers, found 0",
        ),
        (
            fast,
            "hidden",
            "[64, 0]",
            "network.hidden[1]: must be between 1 and 4096, found 0",
        ),
        (
            fast,
            "capacity",
            "127",
            "replay.capacity: holds 127 transitions, less than learning.batch",
        ),
        (
            fast,
            "capacity",
            "100000000",
            "replay.capacity: training takes about ",
        ),
        (
            &nothing_seen,
            "[environment.observation.inputs]",
            "",
            "environment.observation.inputs: the observation is empty",
        ),
        (
            fast,
            "actor_rate",
            "1.3000000001",
            "learning.actor_rate: must be between 0 and 1, found 1.3000000001",
        ),
        // Values that would silently become 0 or have no effect.
        (
            fast,
            "actor_rate",
            "1e-50",
            "learning.actor_rate: 1e-50 is so small that it would count as 0",
        ),
        (
            all,
            "smoothness_penalty",
            "1e-50",
            "learning.smoothness_penalty: 1e-50 is so small that it would count as 0",
        ),
        (
            all,
            "smoothness_penalty",
            "1e-20",
            "learning.smoothness_penalty: must be 0, for none, or",
        ),
        (
            fast,
            "saturation_penalty",
            "1e-7",
            "learning.saturation_penalty: must be 0, for none, or",
        ),
        (
            &without_history,
            "history_every",
            "5",
            "environment.observation.history_every: is the interval between past decisions",
        ),
        (
            all,
            "lr_decay",
            "{ until_episode = 200, final_factor = 0.1 }",
            "learning.lr_decay.until_episode: must be above exploration.learning_starts_episode",
        ),
        (
            fast,
            "max_accel_mps2",
            "3.0\ndeparts_from = {}",
            "environment.departs_from: unknown field `departs_from`",
        ),
        (
            road,
            "space = \"high-risk\"",
            "\"traffic\"",
            "spaces[3].space: `traffic` is named twice",
        ),
    ] {
        let at = text.lines().position(|line| line.starts_with(key)).unwrap();
        let changed = text
            .lines()
            .enumerate()
            .map(|(index, line)| match line.split_once(" = ") {
                Some((name, _)) if index == at => format!("{name} = {value}"),
                _ => line.to_owned(),
            });
        let message = parse_error(&changed.collect::<Vec<_>>().join("\n")).expect(value);
        let line = at + 1 + value.matches('\n').count();
        assert!(
            message.starts_with(&format!("own.toml:{line}: {expected}")),
            "{message}, line {line}"
        );
    }
}
