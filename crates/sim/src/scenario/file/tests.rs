use super::super::{built_in_scenario, built_in_scenario_names};
use super::*;
use crate::scenario::NoDriverFiles;
use crumple_core::text_file::{MAX_BYTES, MAX_TOML_BYTES};

fn error_of(text: &str) -> String {
    from_toml(text, Path::new("bad.toml"), &NoDriverFiles)
        .expect_err("must be refused")
        .to_string()
}

const GOOD: &str = r#"version = 1
name = "two cars"
duration_s = 5.0

[[vehicles]]
class = "light"
position_m = 30.0
speed_mps = 20.0
driver.brake = { onset_s = 1.0, rate_mps2 = 3.0 }

[[vehicles]]
class = "light"
position_m = 0.0
speed_mps = 20.0
driver = "under-test"
"#;

/// Truncated text and text that is not UTF-8 yield errors with a line, and without an invented field.
#[test]
fn errors_name_the_line_of_invalid_or_truncated_text() {
    let json = serde_json::to_string_pretty(built_in_scenario("paper-1").unwrap().spec()).unwrap();
    for at in (1..json.len()).filter(|&at| json.is_char_boundary(at)) {
        let cut = &json[..at];
        let output = from_json(cut, Path::new("cut.json"), &NoDriverFiles)
            .unwrap_err()
            .to_string();
        let line = output
            .strip_prefix("cut.json:")
            .and_then(|rest| rest.split(':').next())
            .unwrap();
        assert!(
            line.parse::<usize>()
                .is_ok_and(|line| (1..=cut.lines().count() + 1).contains(&line)),
            "{output}"
        );
        assert!(!output.contains('?'), "{output}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("latin-1.toml");
    fs::write(&path, b"version = 1\nname = \"two\"\n# f\xfcr\n").unwrap();
    let output = load(&path, &NoDriverFiles).unwrap_err().to_string();
    assert!(
        output.ends_with("latin-1.toml:3: is not UTF-8 text from here on: save it as UTF-8"),
        "{output}"
    );
}

/// Deep or long texts yield an error, and no overflow of stack or memory.
#[test]
fn deep_and_long_texts_yield_errors() {
    let times = |text: &str| text.repeat(100_000);
    for text in [
        times("["),
        format!("{}{}", times("["), times("]")),
        times("{\"vehicles\":"),
        format!("{}1{}", times("{\"a\":"), times("}")),
        format!("{{\"vehicles\": {}", times("[")),
    ] {
        assert!(from_json(&text, Path::new("deep.json"), &NoDriverFiles).is_err());
    }
    for text in [
        format!("a = {}{}", times("["), times("]")),
        format!("vehicles = {}", times("[")),
        format!("a = {}1{}", times("{a="), times("}")),
        format!("a{} = 1\n", times(".a")),
        format!("[a{}]\n", times(".a")),
        format!("[[vehicles{}]]\n", times(".driver")),
    ] {
        assert!(from_toml(&text, Path::new("deep.toml"), &NoDriverFiles).is_err());
    }
    let long = format!("{GOOD}#{}\n", " ".repeat(MAX_TOML_BYTES as usize));
    let output = error_of(&long);
    assert!(
        output.starts_with("bad.toml:1: holds more than 3 MiB of TOML"),
        "{output}"
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.json");
    fs::write(&path, " ".repeat(MAX_BYTES as usize + 1)).unwrap();
    assert!(
        load(&path, &NoDriverFiles)
            .unwrap_err()
            .to_string()
            .ends_with("holds more than 8 MiB, too much for such a file")
    );
    let many = folder.path().join("many");
    fs::create_dir(&many).unwrap();
    (0..=MAX_FILES).for_each(|number| fs::write(many.join(format!("{number}.toml")), "").unwrap());
    assert!(
        load_all(&many, &NoDriverFiles)
            .unwrap_err()
            .to_string()
            .contains("more than 10000 scenario files")
    );
}

/// Replaces every structure of a scenario by a list of its values, one at a time: all are rejected.
#[test]
fn a_list_in_place_of_an_object_is_rejected_at_any_depth() {
    use serde_json::Value;
    fn lists(value: &Value) -> Vec<Value> {
        let mut all = Vec::new();
        match value {
            Value::Object(fields) => {
                all.push(Value::Array(fields.values().cloned().collect()));
                for (name, field) in fields {
                    for changed in lists(field) {
                        let mut fields = fields.clone();
                        fields.insert(name.clone(), changed);
                        all.push(Value::Object(fields));
                    }
                }
            }
            Value::Array(entries) => {
                for (index, entry) in entries.iter().enumerate() {
                    for changed in lists(entry) {
                        let mut entries = entries.clone();
                        entries[index] = changed;
                        all.push(Value::Array(entries));
                    }
                }
            }
            _ => {}
        }
        all
    }
    let mut tried = 0;
    for (name, _) in built_in_scenario_names() {
        let whole = serde_json::to_value(built_in_scenario(name).unwrap().spec()).unwrap();
        for (index, changed) in lists(&whole).into_iter().enumerate() {
            let parsed = from_json(&changed.to_string(), Path::new("list.json"), &NoDriverFiles);
            assert!(parsed.is_err(), "{name}, list {index} is read: {changed}");
            if let Ok(toml) = toml::to_string(&changed) {
                assert!(
                    from_toml(&toml, Path::new("list.toml"), &NoDriverFiles).is_err(),
                    "{name}, list {index}: {toml}"
                );
            }
            tried += 1;
        }
    }
    assert!(tried >= 20, "{tried}");
    let json = serde_json::to_string_pretty(built_in_scenario("paper-1").unwrap().spec()).unwrap();
    let bad = json.replacen(
        "\"vehicles\": [\n    {",
        "\"vehicles\": [\n    [1, 2], {",
        1,
    );
    let output = from_json(&bad, Path::new("bad.json"), &NoDriverFiles)
        .unwrap_err()
        .to_string();
    let line = 1 + bad
        .lines()
        .position(|line| line.contains("[1, 2]"))
        .unwrap();
    assert_eq!(
        output,
        format!("bad.json:{line}: vehicles[0]: invalid type: a list, expected fields with names")
    );
}
