//! Invalid user input: one error that names the position, an exit code, and no partial output.

use super::*;

/// A valid scenario; every case of [`bad_scenarios_name_file_line_and_field`] changes one passage of it.
const VALID_SCENARIO: &str = r#"version = 1
name = "two cars"
duration_s = 5.0

[[vehicles]]
class = "light"
position_m = 30.0
speed_mps = 20.0
length_m = 4.5
driver.brake = { onset_s = 1.0, rate_mps2 = 3.0 }

[[vehicles]]
class = "light"
position_m = 0.0
speed_mps = 20.0
driver = "under-test"
"#;

/// Returns the first line of standard error of a command that must fail with `expected` and print no result.
fn first_error_line(folder: &Path, arguments: &str, expected: i32) -> String {
    let output = run_crumple(folder, arguments);
    let first = stderr(&output)
        .lines()
        .next()
        .unwrap_or_default()
        .to_owned();
    assert_eq!(exit_code(&output), expected, "{arguments:?}: {first}");
    assert_eq!(stdout(&output), "", "{arguments:?}: no result");
    assert!(!stderr(&output).contains("panicked"), "{}", stderr(&output));
    first
}

#[test]
fn bad_scenarios_name_file_line_and_field() {
    let cases = [
        (
            "version = 1",
            "version = 2",
            "1: version: version 2 is not supported",
        ),
        ("version = 1\n", "", "1: missing field `version`"),
        (
            "name = \"two cars\"",
            "name = \"\"",
            "2: name: must have 1 to 200 characters, found 0",
        ),
        ("name = \"two cars\"", "name = two cars", "2: "),
        (
            "name = \"two cars\"",
            "name = \"two cars\"\ncolour = \"red\"",
            "3: colour: unknown field `colour`",
        ),
        (
            "duration_s = 5.0",
            "duration_s = 0.0",
            "3: duration_s: must be above 0 and at most 100000, found 0",
        ),
        (
            "duration_s = 5.0",
            "duration_s = 5.005",
            "3: duration_s: must be a whole number of steps of 0.01 s",
        ),
        (
            "duration_s = 5.0",
            "duration_s = nan",
            "3: duration_s: must be a finite number, found NaN",
        ),
        (
            "duration_s = 5.0",
            "duration_s = \"5 s\"",
            "3: duration_s: invalid type: string \"5 s\"",
        ),
        (
            "duration_s = 5.0",
            "duration_s = 5.0\nduration_s = 6.0",
            "4: duplicate key",
        ),
        (
            "duration_s = 5.0",
            "duration_s = 5.0\nseed = -1",
            "4: seed: invalid value: integer `-1`",
        ),
        (
            "duration_s = 5.0",
            "duration_s = 5.0\nsensors.dropout = 1.5",
            "4: sensors.dropout: must be from 0 to 1",
        ),
        (
            "duration_s = 5.0",
            "duration_s = 5.0\nenvironment.friction = 0",
            "4: environment.friction: must be from 0.01",
        ),
        (
            "class = \"light\"\nposition_m = 30",
            "class = \"tank\"\nposition_m = 30",
            "6: vehicles[0].class: unknown variant",
        ),
        (
            "length_m = 4.5",
            "length_m = -4.5",
            "9: vehicles[0].length_m: must be from 0.1 to 100, found -4.5",
        ),
        (
            "speed_mps = 20.0\nlength",
            "speed_mps = -20.0\nlength",
            "8: vehicles[0].speed_mps: must be from 0 to 100",
        ),
        (
            "speed_mps = 20.0\nlength",
            "speed_mps = inf\nlength",
            "8: vehicles[0].speed_mps: must be a finite number",
        ),
        (
            "position_m = 0.0",
            "position_m = 26.0",
            "14: vehicles[1].position_m: overlaps vehicle 0",
        ),
        (
            "rate_mps2 = 3.0",
            "rate = 3.0",
            "10: vehicles[0].driver.brake.rate: unknown field `rate`",
        ),
        (
            "rate_mps2 = 3.0",
            "rate_mps2 = 9.0",
            "10: vehicles[0].driver.brake: asks for 9 m/s²",
        ),
        (
            "rate_mps2 = 3.0",
            "rate_mps2 = 31.0",
            "10: vehicles[0].driver.brake.rate_mps2: must be",
        ),
        (
            "\"under-test\"",
            "\"unknown\"",
            "16: vehicles[1].driver: unknown variant `unknown`",
        ),
        (
            "\"under-test\"",
            "\"cruise:unknown\"",
            "16: vehicles[1].driver: there is no preset `cruise:unknown`: use one of `crumple list controllers`",
        ),
        (
            "[[vehicles]]\nclass = \"light\"\nposition_m = 0.0",
            "[vehicle]",
            "12: ",
        ),
    ];
    let folder = temp_folder();
    fs::write(folder.path().join("good.toml"), VALID_SCENARIO).unwrap();
    run_ok(folder.path(), "simulate good.toml");
    for (good, bad, expected) in cases {
        let text = VALID_SCENARIO.replacen(good, bad, 1);
        assert_ne!(text, VALID_SCENARIO, "{good} is there");
        fs::write(folder.path().join("bad.toml"), text).unwrap();
        let first = first_error_line(
            folder.path(),
            "simulate good.toml bad.toml --trace t.csv",
            2,
        );
        assert!(
            first.starts_with(&format!("error: bad.toml:{expected}")),
            "{bad}: {first}"
        );
    }
    assert_eq!(
        file_names_in(folder.path()),
        ["bad.toml", "good.toml"],
        "nothing written"
    );
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let folder = temp_folder();
    fs::create_dir(folder.path().join("folder.toml")).unwrap();
    fs::write(
        folder.path().join("bytes.toml"),
        b"version = 1\nname = \"\xff\"\n",
    )
    .unwrap();
    fs::write(folder.path().join("empty.toml"), "").unwrap();
    fs::write(folder.path().join("cut.json"), "{\n  \"version\": 1,\n").unwrap();
    fs::write(folder.path().join("notes.txt"), VALID_SCENARIO).unwrap();
    let cases = [
        (
            "nowhere",
            "error: `nowhere` is neither a built-in scenario (paper-1, paper-2, paper-3) nor a file",
        ),
        ("", "error: a value is required for '<SCENARIO>...'"),
        ("missing.toml", "error: missing.toml: "),
        ("folder.toml", "error: folder.toml: "),
        (
            "bytes.toml",
            "error: bytes.toml:2: is not UTF-8 text from here on",
        ),
        ("empty.toml", "error: empty.toml:1: missing field"),
        ("cut.json", "error: cut.json:3: EOF while parsing"),
        (
            "notes.txt",
            "error: notes.txt: a scenario file ends in .toml or .json",
        ),
    ];
    for (name, expected) in cases {
        let first = first_error_line(folder.path(), &format!("simulate '{name}'"), 2);
        assert!(first.starts_with(expected), "{name}: {first}");
    }
}

#[test]
fn arguments_that_make_no_sense_are_named() {
    let cases = [
        (
            "falsify --controller idm --table runs.csv",
            "error: --table: requires --compare",
        ),
        (
            "falsify --controller idm --seeds 3",
            "error: --seeds: requires --compare",
        ),
        (
            "verify rate --controller idm --failures 3 --runs 10",
            "error: --failures: requires --rate-below",
        ),
        (
            "simulate paper-1 --controller hal",
            "error: invalid value 'hal' for '--controller <C>'",
        ),
        (
            "simulate paper-1 --dt 0.003",
            "error: paper-1: an integration step of 0.003 s does not divide",
        ),
        (
            "simulate paper-1 --dt 0.02",
            "error: paper-1: an integration step of 0.02 s does not divide",
        ),
        (
            "simulate paper-1 --dt 0",
            "error: invalid value '0' for '--dt <S>': must be a positive",
        ),
        (
            "simulate paper-1 --dt -0.01",
            "error: invalid value '-0.01' for '--dt <S>': must be a positive",
        ),
        (
            "simulate paper-1 --dt nan",
            "error: invalid value 'nan' for '--dt <S>': must be a positive",
        ),
        (
            "simulate paper-1 --dt 1e-9",
            "error: paper-1: an integration step of 0.000000001 s makes",
        ),
        (
            "simulate paper-1 --dt fast",
            "error: invalid value 'fast' for '--dt <S>'",
        ),
        (
            "simulate paper-1 --seed 9223372036854775808",
            "error: invalid value '9223372036854775808' for '--seed <N>': must be a whole number from 0 to \
             9223372036854775807",
        ),
        (
            "simulate paper-1 --seed 99999999999999999999",
            "error: invalid value '99999999999999999999'",
        ),
        (
            "simulate paper-1 --seed -1",
            "error: invalid value '-1' for '--seed <N>'",
        ),
        (
            "simulate paper-1 --trace t.txt",
            "error: invalid value 't.txt' for '--trace",
        ),
        (
            "simulate paper-1 --trace t",
            "error: invalid value 't' for '--trace",
        ),
        (
            "simulate paper-1 --plot p.pdf",
            "error: invalid value 'p.pdf' for '--plot",
        ),
        (
            "simulate paper-1 --plot p.svg --trace t.txt",
            "error: invalid value 't.txt' for '--trace",
        ),
        (
            "simulate paper-1 paper-1 --trace t.csv",
            "error: t-paper-1.csv: two results would have this path",
        ),
        (
            "simulate paper-1 --expect luck",
            "error: invalid value 'luck' for '--expect <EXPECT>'",
        ),
        (
            "simulate",
            "error: the following required arguments were not provided",
        ),
        (
            "avoid paper-1 --grid 0.015",
            "error: --grid: a grid of 0.015 s is not the scenario's step of 0.01 s times a whole number",
        ),
        (
            "avoid paper-1 --grid 1e9",
            "error: --grid: a grid of 1000000000.0 s is not the scenario's step",
        ),
        (
            "worst-case paper-1 --controller idm --max-brake 0",
            "error: --max-brake: an envelope of 0 m/s²",
        ),
        (
            "worst-case paper-1 --controller idm --jerk nan",
            "error: --jerk: must be above 0, found NaN",
        ),
        (
            "worst-case paper-1 --controller idm --jerk -1",
            "error: --jerk: must be above 0, found -1",
        ),
        (
            "verify rate --controller idm --runs 0",
            "error: invalid value '0' for '--runs <N>': must be a whole number from 1 to 1000000000",
        ),
        (
            "falsify --controller idm --budget ten",
            "error: invalid value 'ten' for '--budget <N>': must be a whole number from 1 to 1000000000",
        ),
        (
            "verify rate --controller idm --runs 1e6",
            "error: invalid value '1e6' for '--runs <N>': must be a whole number",
        ),
        (
            "worst-case paper-1 --controller idm --jerk ten",
            "error: invalid value 'ten' for '--jerk <J>': must be a number",
        ),
        (
            "verify reach --depth deep",
            "error: invalid value 'deep' for '--depth <N>': must be a whole number from 0 to 40",
        ),
        (
            "verify rate --controller idm --rate-below 1e-300",
            "error: --rate-below: a rate of 1e-300 with 0 failures would take more than",
        ),
        (
            "train --seed -1",
            "error: invalid value '-1' for '--seed <N>': must be a whole number from 0 to 184",
        ),
        (
            "train --seed 1.5",
            "error: invalid value '1.5' for '--seed <N>': must be a whole number from 0 to",
        ),
        (
            "train --seeds -1",
            "error: invalid value '-1' for '--seeds <N>': must be a whole number from 1 to",
        ),
        (
            "train --seeds 0",
            "error: invalid value '0' for '--seeds <N>': must be a whole number from 1 to",
        ),
        (
            "train --episodes -3",
            "error: invalid value '-3' for '--episodes <N>': must be a whole number",
        ),
        (
            "train --space steady=-1",
            "error: --space steady: the weight must be between 0.000001 and 1000000",
        ),
        (
            "retrain --seed -1",
            "error: invalid value '-1' for '--seed <N>': must be a whole number from 0 to",
        ),
        (
            "falsify --controller idm --seed -1",
            "error: invalid value '-1' for '--seed <N>'",
        ),
        (
            "verify rate --controller idm --seed -1",
            "error: invalid value '-1' for '--seed <N>'",
        ),
        (
            "describe p.toml",
            "error: p.toml: `describe` takes a network (.onnx, or .zip for a model of Stable-Baselines3) or an FMU",
        ),
        ("list colours", "error: invalid value 'colours'"),
        ("drive", "error: unrecognized subcommand 'drive'"),
    ];
    let folder = temp_folder();
    for (arguments, expected) in cases {
        let first = first_error_line(folder.path(), arguments, 2);
        assert!(first.starts_with(expected), "{arguments:?}: {first}");
    }
    assert_eq!(file_names_in(folder.path()), [""; 0], "nothing written");
}

/// Checked before anything is written, by both commands that take a preset; `rl::tests::presets` tries every field.
#[test]
fn presets_that_cannot_be_used_are_named() {
    let folder = temp_folder();
    fs::create_dir(folder.path().join("folder")).unwrap();
    fs::create_dir(folder.path().join("folder.toml")).unwrap();
    for (name, bytes) in [
        ("empty", &b""[..]),
        ("empty.toml", b""),
        ("bytes.toml", b"version = 1\n\xff\n"),
    ] {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    let road = include_str!("../../../crates/learn/src/rl/presets/road.toml");
    let line_of = |words: &str| road.lines().position(|line| line == words).unwrap() + 1;
    let changed = |name: &str, from: &str, to: &str| {
        fs::write(
            folder.path().join(name),
            replace_passages(road, &[(from, to)]),
        )
        .unwrap();
    };
    changed("no-space.toml", "space = \"paper\"", "space = \"nowhere\"");
    changed(
        "no-file.toml",
        "space = \"paper\"",
        "space = \"nowhere.toml\"",
    );
    let at = line_of("space = \"paper\"");
    let no_space = format!(
        "error: no-space.toml:{at}: spaces[4].space: `nowhere` is neither a built-in space"
    );
    let no_file = format!("error: no-file.toml:{at}: spaces[4].space: nowhere.toml: ");
    let of_both = [
        ("folder", "error: folder: "),
        ("folder.toml", "error: folder.toml: "),
        ("empty", "error: empty:1: missing field `version`"),
        ("empty.toml", "error: empty.toml:1: missing field `version`"),
        (
            "bytes.toml",
            "error: bytes.toml:2: is not UTF-8 text from here on",
        ),
        ("missing.toml", "error: missing.toml: "),
        ("no-space.toml", &*no_space),
        ("no-file.toml", &*no_file),
        ("", "error: a value is required for '--preset <PRESET>'"),
    ];
    let names = "there are fast, paper, paper-net, road";
    let slow = format!("error: there is no preset `slow`, and no such file; {names}");
    let retrain = "error: `retrain` is the preset of `crumple retrain`; `train` has fast, paper, paper-net, road. ";
    let of_one = [
        ("train", ("slow", &*slow)),
        ("train", ("retrain", retrain)),
        (
            "retrain",
            ("slow", &slow.replace("are fast", "are retrain, fast")),
        ),
    ];
    let cases = of_both
        .iter()
        .flat_map(|case| [("train", *case), ("retrain", *case)]);
    for (command, (preset, expected)) in cases.chain(of_one) {
        let first = first_error_line(
            folder.path(),
            &format!("{command} --preset '{preset}' --out out"),
            2,
        );
        assert!(first.starts_with(expected), "{command} {preset}: {first}");
        assert!(
            !folder.path().join("out").exists(),
            "{command} {preset}: nothing written"
        );
    }
}

/// Neither a partial nor a temporary file.
#[test]
fn output_that_cannot_be_written_leaves_nothing_behind() {
    let folder = temp_folder();
    fs::create_dir(folder.path().join("t-paper-2.csv")).unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    let cases = [
        (
            "simulate paper-1 --trace missing/t.csv",
            2,
            "error: missing/t.csv: there is no folder missing",
        ),
        (
            "simulate paper-1 --plot missing/x.svg",
            2,
            "error: missing/x.svg: there is no folder missing",
        ),
        (
            "simulate paper-1 --trace file/t.csv",
            2,
            "error: file/t.csv: there is no folder file",
        ),
        (
            "simulate paper-1 --trace t-paper-2.csv",
            2,
            "error: t-paper-2.csv: ",
        ),
        (
            "simulate paper-1 paper-2 --trace t.csv",
            2,
            "error: t-paper-2.csv: ",
        ),
    ];
    for (arguments, code, expected) in cases {
        let first = first_error_line(folder.path(), arguments, code);
        assert!(first.starts_with(expected), "{arguments:?}: {first}");
        assert_eq!(
            file_names_in(folder.path()),
            ["file", "t-paper-2.csv"],
            "{arguments:?}"
        );
    }
    assert_eq!(file_names_in(&folder.path().join("t-paper-2.csv")), [""; 0]);
}

#[test]
#[cfg(unix)]
fn a_file_beyond_its_size_limit_is_an_error() {
    let folder = temp_folder();
    let mut limited = Command::new("sh");
    limited
        .args([
            "-c",
            "ulimit -f 8; exec \"$0\" \"$@\"",
            env!("CARGO_BIN_EXE_crumple"),
        ])
        .current_dir(folder.path());
    let output = limited
        .args(["simulate", "paper-1", "--trace", "t.csv"])
        .output()
        .unwrap();
    assert_eq!(exit_code(&output), 3, "{output:?}");
    assert!(stderr(&output).starts_with("error: t.csv: "), "{output:?}");
    assert_eq!(file_names_in(folder.path()), [""; 0]);
}

#[test]
fn names_and_lists_that_mean_something_else_are_refused() {
    let folder = temp_folder();
    let deep = format!("{}policy", "shield:".repeat(10_000));
    let refused = run_crumple(
        folder.path(),
        &format!("simulate paper-1 --controller {deep}"),
    );
    assert_refused(&refused, "only one shield may stand before a controller");
    fs::write(folder.path().join("list.json"), "[1, \"list\", [], 15.0]").unwrap();
    let refused = run_crumple(folder.path(), "simulate list.json");
    assert_refused(
        &refused,
        "list.json:1: invalid type: a list, expected fields with names",
    );
    let space = include_str!("../../../crates/spaces/src/built_in/paper.toml");
    let first =
        space.find("[[parameters]]\nname = \"").unwrap() + "[[parameters]]\nname = \"".len();
    let end = first + space[first..].find('"').unwrap();
    let named = format!("{}method{}", &space[..first], &space[end..]);
    fs::write(
        folder.path().join("own.toml"),
        named.replacen("name = \"paper\"", "name = \"own\"", 1),
    )
    .unwrap();
    let refused = run_crumple(folder.path(), "falsify --controller idm --space own.toml");
    assert_refused(
        &refused,
        "`method` is a column of every table of evaluations",
    );
}

/// No command replaces a file that it reads, whatever the spelling of its path.
#[test]
fn no_output_replaces_an_input() {
    let folder = temp_folder();
    for (name, shown) in [
        ("s.toml", "show paper-1"),
        ("b.toml", "show paper-1 --kind box"),
        ("space.toml", "show high-risk"),
        ("map.toml", "show car-following"),
    ] {
        let output = run_crumple(folder.path(), shown);
        fs::write(folder.path().join(name), stdout(&output)).expect("written");
    }
    let name = folder.path().file_name().expect("a name").to_string_lossy();
    for (arguments, input) in [
        ("avoid s.toml --out ./s.toml".to_owned(), "s.toml"),
        (format!("avoid s.toml --certificate ../{name}/s.toml"), "s.toml"),
        ("worst-case s.toml --controller idm --out s.toml".to_owned(), "s.toml"),
        ("verify two-sided s.toml --settings level=3 --certificate s.toml".to_owned(), "s.toml"),
        ("verify reach --controller policy --box b.toml --certificate b.toml".to_owned(), "b.toml"),
        (
            "falsify --controller idm --space space.toml --compare uniform --seeds 1 --table space.toml".to_owned(),
            "space.toml",
        ),
        ("fit e.csv --map map.toml --out map.toml --force".to_owned(), "map.toml"),
    ] {
        let path = folder.path().join(input);
        let before = fs::read(&path).expect("a file");
        let error = first_error_line(folder.path(), &arguments, 2);
        assert!(error.contains("is an input of this command"), "{arguments}: {error}");
        assert_eq!(fs::read(&path).expect("kept"), before, "{arguments}");
    }
    for (name, text) in [
        ("drive.py", "print()\n"),
        (
            "own.toml",
            "version = 1\ncommand = [\"sh\", \"drive.py\"]\nfiles = [\"drive.py\"]\n",
        ),
    ] {
        fs::write(folder.path().join(name), text).expect("written");
    }
    for controller in ["own.toml", "exec:sh drive.py", "shield:own.toml"] {
        let arguments = format!("worst-case s.toml --controller '{controller}' --out drive.py");
        let error = first_error_line(folder.path(), &arguments, 2);
        assert!(
            error.contains("is an input of this command"),
            "{controller}: {error}"
        );
    }
    let twice = format!("avoid s.toml --certificate c.json --bound-certificate ../{name}/c.json");
    let error = first_error_line(folder.path(), &twice, 2);
    assert!(
        error.contains("two results would have this path"),
        "{error}"
    );
    let error = first_error_line(folder.path(), "avoid s.toml --certificate none/c.json", 2);
    assert!(error.contains("there is no folder none"), "{error}");
    let error = first_error_line(folder.path(), "avoid s.toml --certificate .", 2);
    assert!(error.contains("is a directory"), "{error}");
}
