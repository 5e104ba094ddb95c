//! `crumple export` and `crumple import --map` on the command line.

use crumple_exchange::recording::map::{RecordingMap, json_schema};

use super::*;
use crate::assessments::approach_space;
use crate::schema::{assert_committed, validate};

#[test]
fn the_schema_of_maps_is_committed_and_accepts_the_examples() {
    let schema = json_schema();
    assert_committed("crates/exchange/src/recording/map.schema.json", &schema);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for folder in ["examples/maps", "crates/exchange/src/recording/built_in"] {
        for name in file_names_in(&root.join(folder)) {
            let map = RecordingMap::load(&root.join(folder).join(&name))
                .unwrap_or_else(|error| panic!("{error}"));
            let stated = serde_json::to_value(map.spec()).unwrap();
            validate(&schema, &schema, &stated, &name).unwrap();
        }
    }
}

pub(super) fn logged_pair_csv(brake_mps2: f64) -> String {
    let mut text = "t;v_ego;range;closing\n".to_owned();
    for k in 0..150 {
        let lost_mps = brake_mps2 * (f64::from(k) * 0.1 - 5.0).clamp(0.0, 3.0);
        text += &format!("{};{};34.6;0\n", 100 * k, 72.0 - 3.6 * lost_mps);
    }
    text
}

#[test]
fn own_recordings_are_read_by_a_map_shown_and_turned_into_scenarios() {
    let folder = temp_folder();
    let map = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/maps/logged-pair.toml");
    let map = map.to_str().unwrap();
    fs::write(folder.path().join("hard.csv"), logged_pair_csv(3.0)).unwrap();
    fs::write(folder.path().join("soft.csv"), logged_pair_csv(1.0)).unwrap();
    let shown = run_crumple(
        folder.path(),
        &format!("import hard.csv --map '{map}' --preview hard.svg"),
    );
    let message = "hard.csv: logged-pair\n  1 vehicles that may lead, 150 samples, from 0.00 to 14.90 s, one each \
        0.100 s\n  \
                speed 11.00 to 20.00 m/s, median 12.80\n  bumper gap 30.00 to 30.00 m, median 30.00\n  \
                the hardest braking is 3.00 m/s within a second, of vehicle 1 from 5.";
    assert!(stdout(&shown).starts_with(message), "{shown:?}");
    assert!(
        fs::read_to_string(folder.path().join("hard.svg"))
            .unwrap()
            .contains("Bumper gap to the vehicle behind")
    );
    assert_eq!(
        file_names_in(folder.path()),
        ["hard.csv", "hard.svg", "soft.csv"],
        "no scenario is written"
    );
    let over = format!("import soft.csv --map '{map}' --preview hard.svg");
    assert_refused(
        &run_crumple(folder.path(), &over),
        "hard.svg: exists with other contents: use --force",
    );
    run_ok(folder.path(), &format!("{over} --force"));
    assert_refused(
        &run_crumple(folder.path(), &format!("{over} --out x")),
        "cannot be used with",
    );
    let slow: String = logged_pair_csv(3.0)
        .lines()
        .step_by(10)
        .map(|line| format!("{line}\n"))
        .collect();
    let slow = slow.replacen(
        "t;v_ego;range;closing\n",
        "t;v_ego;range;closing\n0;72;34.6;0\n",
        1,
    );
    fs::write(folder.path().join("slow.csv"), slow).unwrap();
    let shown = run_crumple(
        folder.path(),
        &format!("import slow.csv --map '{map}' --preview slow.svg"),
    );
    let message = [
        "one each 1.000 s",
        "the speeds of a vehicle are 1.000 s apart, more than the limit of 0.5 s: crumple cannot find braking",
    ];
    assert!(
        message
            .iter()
            .all(|message| stdout(&shown).contains(message)),
        "{shown:?}"
    );
    let imported = run_crumple(
        folder.path(),
        &format!("import hard.csv soft.csv --map '{map}' --out episodes"),
    );
    assert_eq!(
        stdout(&imported),
        "hard.csv: 1 scenario (logged-pair), no vehicle behind: collisions from behind cannot happen\n\
         soft.csv: 0 scenarios (logged-pair)\n"
    );
    assert_eq!(
        file_names_in(&folder.path().join("episodes")),
        ["logged-pair-hard-01.toml"]
    );
    let nothing = run_crumple(
        folder.path(),
        &format!("import soft.csv --map '{map}' --out none"),
    );
    assert_eq!(exit_code(&nothing), 1);
    let message = "error: no braking episode of at least 1.3 m/s² gives a scenario; soft.csv: the \
        hardest braking is 1.00 m/s";
    assert!(stderr(&nothing).starts_with(message), "{nothing:?}");
    assert!(!folder.path().join("none").exists());
}

#[test]
fn damaged_maps_and_files_name_file_line_and_field() {
    let folder = temp_folder();
    let map = fs::read_to_string(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/maps/logged-pair.toml"),
    )
    .unwrap();
    let file = logged_pair_csv(3.0);
    let cases = [
        (
            "length_m = 4.6",
            "length_m = 0",
            "",
            "",
            "m.toml:10: layout.pairs.length_m: must be from 0.1 to 100, found 0",
        ),
        (
            "\"km/h\"",
            "\"knots\"",
            "",
            "",
            "m.toml:11: layout.pairs.follower_speed.unit: unknown variant `knots`",
        ),
        (
            "\"v_ego\"",
            "\"v\"",
            "",
            "",
            "a.csv:1: v: there is no such column among `t, v_ego, range, closing`",
        ),
        (
            "",
            "",
            "200;72",
            "200;fast",
            "a.csv:4: v_ego: must be a finite number or empty, found `fast`",
        ),
        (
            "",
            "",
            "200;72;",
            "200;",
            "a.csv:4: closing: 3 fields in a row of 4",
        ),
        ("", "", "\n200;", "\n;", "a.csv:4: t: must not be empty"),
    ];
    for (good, bad, right, wrong, expected) in cases {
        fs::write(folder.path().join("m.toml"), map.replacen(good, bad, 1)).unwrap();
        fs::write(folder.path().join("a.csv"), file.replacen(right, wrong, 1)).unwrap();
        assert_refused(
            &run_crumple(folder.path(), "import a.csv --map m.toml"),
            expected,
        );
    }
    assert_refused(
        &run_crumple(folder.path(), "import a.csv --map none.toml"),
        "none.toml: ",
    );
    fs::write(
        folder.path().join("tracks.csv"),
        "frame;id;x;width;xVelocity;laneId\n0;1;2,5;4;20;1\n",
    )
    .unwrap();
    let message =
        "tracks.csv:1: these are the columns of the built-in map `highd`: name it (--map highd)";
    assert_refused(&run_crumple(folder.path(), "import tracks.csv"), message);
    let short = run_crumple(folder.path(), "import tracks.csv --map highd");
    let message = "tracks.csv: detected columns separated by semicolons, decimal commas";
    assert!(
        exit_code(&short) == 1 && stderr(&short).starts_with(message),
        "{short:?}"
    );
    fs::write(
        folder.path().join("m.toml"),
        format!("{map}#{}", " ".repeat(1 << 16)),
    )
    .unwrap();
    assert_refused(
        &run_crumple(folder.path(), "import a.csv --map m.toml"),
        "m.toml: holds more than 64 KiB",
    );
}

/// Linux allows any bytes in names, such as those of Windows-1252.
#[cfg(target_os = "linux")]
#[test]
fn names_of_files_need_not_be_utf_8() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = temp_folder();
    let map = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/maps/logged-pair.toml");
    let [log, maps, plot, out] = [
        &b"Stra\xdfe.csv"[..],
        b"M\xfcll.toml",
        b"Stra\xdfe.svg",
        b"Ausfl\xfcge",
    ]
    .map(OsStr::from_bytes);
    fs::write(folder.path().join(log), logged_pair_csv(3.0)).unwrap();
    fs::copy(map, folder.path().join(maps)).unwrap();
    let run = |subcommand: &str, arguments: &[&OsStr]| {
        let output = command(folder.path(), subcommand)
            .arg(log)
            .arg("--map")
            .arg(maps)
            .args(arguments)
            .output();
        let output = output.expect("starts");
        assert_eq!(exit_code(&output), 0, "{subcommand}: {}", stderr(&output));
        stdout(&output).to_owned()
    };
    let imported = run("import", &[OsStr::new("--out"), out]);
    assert!(imported.starts_with("Stra\u{fffd}e.csv: 1 scenario (logged-pair)"));
    assert_eq!(
        file_names_in(&folder.path().join(out)),
        ["logged-pair-stra-e-01.toml"]
    );
    assert!(run("import", &[OsStr::new("--preview"), plot]).contains("1 vehicles that may lead"));
    assert!(folder.path().join(plot).exists());
    assert!(
        run("replay", &["--controller", "idm"].map(OsStr::new)).contains("1 drive behind a leader")
    );
    for (space, problem) in [
        (plot, "must end in .toml"),
        (OsStr::from_bytes(b"R\xe4.toml"), "and 20 are needed"),
    ] {
        let fitted = command(folder.path(), "fit")
            .args([log, OsStr::new("--map"), maps, OsStr::new("--out"), space])
            .output();
        assert_refused(&fitted.expect("starts"), problem);
    }
}

/// Scenarios, folders of scenarios, suites and presets may have any names.
#[cfg(target_os = "linux")]
#[test]
fn names_of_scenarios_suites_and_presets_need_not_be_utf_8() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = temp_folder();
    let [scenario, suite, preset, inner] = [
        &b"Stra\xdfe.toml"[..],
        b"Pr\xfcfung.toml",
        b"K\xfcrze.toml",
        b"\xe4",
    ]
    .map(OsStr::from_bytes);
    let write = |arguments: &str, name: &OsStr| {
        let shown = run_ok(folder.path(), arguments);
        fs::write(folder.path().join(name), stdout(&shown)).unwrap();
    };
    write("show paper-1", scenario);
    write("show un-r152", suite);
    write("show fast", preset);
    fs::create_dir(folder.path().join(inner)).unwrap();
    fs::copy(
        folder.path().join(scenario),
        folder.path().join(inner).join(scenario),
    )
    .unwrap();
    let run = |arguments: &str, name: &OsStr| {
        let output = command(folder.path(), arguments).arg(name).output();
        let output = output.expect("starts");
        assert!(exit_code(&output) <= 1, "{arguments}: {}", stderr(&output));
        stdout(&output).to_owned()
    };
    let built_in = |arguments: &str| stdout(&run_ok(folder.path(), arguments)).to_owned();
    assert_eq!(
        run("simulate --controller idm", scenario),
        built_in("simulate paper-1 --controller idm")
    );
    assert!(run("simulate --controller idm", inner).contains("1 scenario"));
    assert_eq!(run("avoid", scenario), built_in("avoid paper-1"));
    assert_eq!(
        run("suite run --controller idm", suite),
        built_in("suite run un-r152 --controller idm")
    );
    run("train --seed 1 --episodes 1 --out runs --preset", preset);
    let exported = run(
        "export --controller idm --to openscenario --out x",
        scenario,
    );
    assert!(exported.starts_with("x/paper-1.xosc: "), "{exported}");
}

/// Names of controllers and spaces become part of records, so they are text.
#[cfg(target_os = "linux")]
#[test]
fn an_argument_that_must_be_utf_8_is_named() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = temp_folder();
    let name = "must be UTF-8; if it is the name of a file, rename the file";
    for (before, argument, after, expected) in [
        (
            "simulate paper-1 --controller",
            &b"\xe4.toml"[..],
            "",
            "--controller: `\u{fffd}.toml`",
        ),
        (
            "simulate \u{fc}",
            b"--controller=\xe4.toml",
            "--estimator truth",
            "--controller: `\u{fffd}.toml`",
        ),
        (
            "falsify --controller idm --budget 1 --space",
            b"\xe4.toml",
            "",
            "--space: `\u{fffd}.toml`",
        ),
        (
            "--quiet verify rate --controller",
            b"\xe4.toml",
            "--runs 2",
            "--controller: `\u{fffd}.toml`",
        ),
        (
            "simulate paper-1 --parts --spec",
            b"\xe4 > 1",
            "",
            "--spec: `\u{fffd} > 1`",
        ),
        ("show", b"\xe4", "", "argument: `\u{fffd}`"),
    ] {
        let output = command(folder.path(), before)
            .arg(OsStr::from_bytes(argument))
            .args(after.split_whitespace())
            .output();
        let output = output.expect("starts");
        assert_eq!(exit_code(&output), 2, "{before}");
        assert_eq!(
            stderr(&output),
            format!("error: {expected} {name}\n"),
            "{before}"
        );
    }
    // The wrong argument is the second one that is not UTF-8.
    let output = command(folder.path(), "simulate")
        .arg(OsStr::from_bytes(b"\xe5.toml"))
        .arg("--controller")
        .arg(OsStr::from_bytes(b"\xe4.onnx"))
        .output();
    assert_refused(
        &output.expect("starts"),
        "--controller: `\u{fffd}.onnx` must be UTF-8",
    );
}

#[test]
fn exports_are_two_files_a_scenario() {
    let folder = temp_folder();
    let export = |more: &str| {
        run_crumple(
            folder.path(),
            &format!("export --to openscenario --out x {more}"),
        )
    };
    let done = export("paper-1 paper-2 --controller idm");
    assert_eq!(
        (exit_code(&done), stdout(&done).lines().count()),
        (0, 2),
        "{done:?}"
    );
    assert_eq!(
        file_names_in(&folder.path().join("x")),
        [
            "exported.sha256",
            "paper-1.xodr",
            "paper-1.xosc",
            "paper-2.xodr",
            "paper-2.xosc"
        ]
    );
    let read = || fs::read(folder.path().join("x/paper-1.xosc")).unwrap();
    let before = read();
    assert_eq!(
        (exit_code(&export("paper-1 --controller idm")), read()),
        (0, before),
        "the same again"
    );
    assert_eq!(exit_code(&export("paper-1 --as actions")), 0);
    assert_refused(
        &export("paper-1 paper-1"),
        "paper-1: paper-1.xosc would overwrite the file of another scenario",
    );
    assert_refused(
        &export("paper-1 --as actions --controller idm"),
        "--controller: applies only to `--as trajectories`",
    );
    assert_refused(
        &export("nowhere"),
        "`nowhere` is neither a built-in scenario",
    );
}

/// The header of the export names the recorded controller.
#[test]
fn exports_of_counterexamples_have_the_recorded_controller() {
    let folder = temp_folder();
    let search = "falsify --controller match-leader --space high-risk --budget 10 --out found";
    run_ok(folder.path(), search);
    let files = file_names_in(&folder.path().join("found/counterexamples"));
    let name = files
        .iter()
        .find(|name| name.contains("-hits-"))
        .expect("a collision");
    let file = format!("found/counterexamples/{name}");
    let export = |file: &str, more: &str| {
        run_crumple(
            folder.path(),
            &format!("export {file} --to openscenario --out x {more}"),
        )
    };
    let header = || {
        let written = file_names_in(&folder.path().join("x"));
        let scenario = written
            .iter()
            .find(|name| name.ends_with(".xosc"))
            .expect("written");
        let text = fs::read_to_string(folder.path().join("x").join(scenario)).unwrap();
        text.lines()
            .find(|line| line.contains("FileHeader"))
            .expect("a header")
            .to_owned()
    };
    let original = file.replace("counterexamples/", "counterexamples/originals/");
    for recorded in [&original, &file] {
        let done = export(recorded, "");
        assert!(
            stdout(&done).contains("under match-leader, estimator kalman"),
            "{done:?}"
        );
        assert!(
            header().contains("what every vehicle did under `match-leader`"),
            "{}",
            header()
        );
        fs::remove_dir_all(folder.path().join("x")).unwrap();
    }
    assert!(stdout(&export(&file, "--controller idm")).contains("under idm, estimator kalman"));
    assert!(
        header().contains("what every vehicle did under `idm`"),
        "{}",
        header()
    );

    let simulated = run_crumple(folder.path(), &format!("simulate {file}"));
    assert!(
        stdout(&simulated).contains(": baseline, estimator kalman"),
        "{simulated:?}"
    );
    let message =
        format!("note: {file} was recorded with `match-leader`, but is simulated with `baseline`");
    assert!(stderr(&simulated).contains(&message), "{simulated:?}");

    // A copy has no record, and a record may name several controllers.
    fs::copy(folder.path().join(&file), folder.path().join("alone.toml")).unwrap();
    assert_refused(
        &export("alone.toml", ""),
        "alone.toml: no record states the controller of this scenario: choose one",
    );
    let record = file_names_in(&folder.path().join("found/counterexamples"))
        .into_iter()
        .find(|name| name.starts_with("expected"));
    let record = folder
        .path()
        .join("found/counterexamples")
        .join(record.expect("recorded"));
    let text = fs::read_to_string(&record).unwrap();
    let entry = text
        .split("[[expected]]")
        .find(|entry| entry.contains(&format!("\"{name}\"")))
        .expect("an entry");
    fs::write(
        &record,
        format!("{text}[[expected]]{}", entry.replace("match-leader", "idm")),
    )
    .unwrap();
    assert_refused(
        &export(&file, ""),
        "recorded with several controllers (`match-leader` and `idm`): choose one with --controller",
    );
    fs::write(&record, text.replace("\"match-leader\"", "\"gone.toml\"")).unwrap();
    assert_refused(
        &export(&file, ""),
        "the record names the controller `gone.toml`: ",
    );
}

/// A campaign records the path of a controller as the user gave it, from the folder of the command. With the hash of
/// its files, the controller is also found above the record; without, from the folder of the command only.
#[test]
fn exports_of_counterexamples_find_the_file_of_an_own_controller() {
    let folder = temp_folder();
    fs::create_dir(folder.path().join("own")).unwrap();
    fs::write(folder.path().join("own/constant.sh"), CONSTANT_PROCESS).unwrap();
    // A standing leader, and runs of 2.5 s: a shell takes long for an answer.
    let space = approach_space("barrier", 20.0);
    fs::write(folder.path().join("barrier.toml"), space).unwrap();
    let search = "falsify --space barrier.toml --budget 5 --controller";
    let controller = "version = 1\ncommand = [\"sh\", \"constant.sh\"]\n";
    for (name, files) in [("plain", ""), ("listed", "files = [\"constant.sh\"]\n")] {
        fs::write(
            folder.path().join(format!("own/{name}.toml")),
            format!("{controller}{files}"),
        )
        .unwrap();
        run_ok(
            folder.path(),
            &format!("{search} own/{name}.toml --out runs/{name}"),
        );
        let counterexamples = folder.path().join(format!("runs/{name}/counterexamples"));
        let file = file_names_in(&counterexamples)
            .into_iter()
            .find(|name| name.contains("-hits-"))
            .expect("a collision");
        let export = |from: &Path, file: &str, more: &str| {
            run_crumple(
                from,
                &format!("export {file} --to openscenario --out x {more}"),
            )
        };
        let in_campaign = format!("runs/{name}/counterexamples/{file}");
        assert_refused(&export(folder.path(), &in_campaign, ""), "--allow-external");
        let done = export(folder.path(), &in_campaign, "--allow-external");
        assert!(
            stdout(&done).contains(&format!("under own/{name}.toml, estimator kalman")),
            "{done:?}"
        );
        let elsewhere = export(&counterexamples, &file, "--allow-external");
        match name {
            "listed" => assert_eq!(exit_code(&elsewhere), 0, "{elsewhere:?}"),
            _ => assert_refused(&elsewhere, "own/plain.toml`: there is no such file in "),
        }
    }
    run_ok(
        folder.path(),
        &format!("{search} 'exec:sh own/constant.sh' --out runs/exec"),
    );
    let names = file_names_in(&folder.path().join("runs/exec/counterexamples"));
    let file = names
        .iter()
        .find(|name| name.contains("-hits-"))
        .expect("a collision");
    run_ok(
        folder.path(),
        &format!(
            "export runs/exec/counterexamples/{file} --to openscenario --out x --allow-external"
        ),
    );
}

/// A process that never accelerates or brakes.
const CONSTANT_PROCESS: &str = r#"while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *hello*) echo '{"crumple":1,"name":"constant","deterministic":true}' ;;
        *reset*) echo "{\"id\":$id,\"ready\":true}" ;;
        *) echo "{\"id\":$id,\"acceleration_mps2\":0.0}" ;;
    esac
done
"#;
