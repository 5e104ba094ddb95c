//! `crumple verify` and shields on the command line.

use std::time::Instant;

use crumple_sim::scenario::VehicleClass;

use super::*;

#[test]
fn a_shield_reports_its_braking_and_the_effect_on_the_follower() {
    let folder = temp_folder();
    let arguments = "simulate paper-1 --controller shield:full-throttle --estimator truth";
    let shielded = &json_objects(&run_crumple(
        folder.path(),
        &format!("{arguments} --format json"),
    ))[0];
    let first = &shielded["interventions"][0];
    assert_eq!(
        (&first["vehicle"], &first["outside_kernel"]),
        (&1.into(), &false.into()),
        "{shielded}"
    );
    assert!(first["to_s"].as_f64() > first["from_s"].as_f64());
    assert_eq!(shielded["outcome"]["rear_vehicle"], 2);
    let text = run_crumple(folder.path(), arguments);
    assert!(
        stdout(&text).contains("the shield of vehicle 1 braked"),
        "{}",
        stdout(&text)
    );
    let bare = "simulate paper-1 --controller full-throttle --estimator truth --format json";
    let bare = &json_objects(&run_crumple(folder.path(), bare))[0];
    assert_eq!(
        (&bare["outcome"]["rear_vehicle"], bare.get("interventions")),
        (&1.into(), None)
    );
}

#[test]
fn shields_that_are_set_wrongly_or_cannot_vouch_are_refused() {
    let folder = temp_folder();
    for (controller, message) in [
        ("shield:unknown", "there is no controller `unknown`"),
        (
            "shield,ahead=0:idm",
            "shield: ahead must be a number from 0.1 to 30, found `0`",
        ),
        (
            "shield,gap-error:idm",
            "shield: gap-error must be a number from 0 to 100, found ``",
        ),
        ("shield,ahead=3,ahead=4:idm", "shield: ahead is given twice"),
        (
            "shield,colour=1:idm",
            "`colour=1` is not a setting of a shield",
        ),
        (
            "shield2,reacts=1,ttc=2:idm",
            "shield2: reacts and ttc exclude each other",
        ),
        (
            "shield2,raise=0.5:idm",
            "shield2: raise must be 0 or 1, found 0.5",
        ),
    ] {
        assert_refused(
            &run_crumple(
                folder.path(),
                &format!("simulate paper-1 --controller {controller}"),
            ),
            message,
        );
    }
}

/// The class of followers comes first in the text.
#[test]
fn two_sided_certificates_are_written_and_accepted() {
    let folder = temp_folder();
    for more in [
        "--settings level=3",
        "--settings level=2,reacts=0.5",
        "--filter",
    ] {
        let written = run_ok(folder.path(), &format!("verify two-sided paper-1 {more}"));
        let passage = "two-sided.json: accepted: two-sided: with a follower that brakes";
        assert!(stdout(&written).contains(passage), "{}", stdout(&written));
        let checked = run_ok(folder.path(), "check two-sided.json");
        assert!(
            stdout(&checked).contains("behind: only a follower"),
            "{}",
            stdout(&checked)
        );
    }
    // The emergency brake of `paper-1` fires by the time to collision, and not when the vehicle ahead brakes.
    for (settings, driver) in [("level=3", None), ("level=2,reacts=0.5", Some("baseline"))] {
        let command = format!("verify two-sided paper-1 --settings {settings} --format json");
        let written = &json_objects(&run_ok(folder.path(), &command))[0];
        assert!(
            written["followers"]
                .as_str()
                .unwrap()
                .starts_with("brakes at"),
            "{written}"
        );
        assert_eq!(
            written["driver_outside_class"].as_str(),
            driver,
            "{written}"
        );
    }
    let too_high = run_crumple(
        folder.path(),
        "verify two-sided paper-1 --settings level=12",
    );
    assert_reports(&too_high, 1, "the highest level with a plan is");
    assert_reports(&too_high, 1, " m/s² (level=");
    let raising = run_crumple(folder.path(), "verify two-sided paper-1 --settings raise=1");
    assert_refused(&raising, "raise has no effect here");
    let delayed = run_crumple(
        folder.path(),
        "verify two-sided paper-1 --settings ,level=3",
    );
    assert_refused(&delayed, "`` is not a setting of a two-sided shield");
}

/// `--level` takes its settings after an equals sign only, so that a scenario may follow it.
#[test]
fn levels_are_measured_or_missing_with_a_reason() {
    let folder = temp_folder();
    let run = |more: &str| run_crumple(folder.path(), &format!("simulate {more} --controller idm"));
    let swallowed = run("--level paper-1");
    assert!(
        stdout(&swallowed).contains("vehicle 1: level"),
        "{}",
        stdout(&swallowed)
    );
    assert_refused(&run("paper-1 --level=level=4"), "level has no effect here");
    assert_refused(
        &run("paper-1 --level=drift=0.2,gap-error=5"),
        "gap-error has no effect here",
    );
    let brakes = stdout(&swallowed).contains("the level holds only for a follower that brakes at");
    assert!(brakes, "{}", stdout(&swallowed));
    let reacts = run("paper-1 --level=reacts=1");
    let note = "note: vehicle 2 (`baseline`) is not known to be such a follower";
    assert!(stdout(&reacts).contains(note) && !stdout(&swallowed).contains(note));
    let plant = run("paper-1 --level --plant multi-body");
    assert!(
        stdout(&plant).contains("vehicle 1: no level: "),
        "{}",
        stdout(&plant)
    );
    run_ok(folder.path(), "simulate paper-1 --level --trace motion.csv");
    let table = fs::read_to_string(folder.path().join("motion.csv")).unwrap();
    assert!(
        table.starts_with("time_s,vehicle,position_m,speed_mps,acceleration_mps2,gap_m,level_mps2")
    );
}

/// The first state of `paper-1` has no plan at the leader's limit.
#[test]
fn the_report_of_a_two_sided_shield_speaks_of_its_level() {
    let folder = temp_folder();
    for before in ["", "test-driver,hold_mps=20:"] {
        let command =
            format!("simulate paper-1 --controller {before}shield2:idm --estimator truth");
        let report = run_ok(folder.path(), &command);
        assert!(
            stdout(&report)
                .contains("at least once it had no plan for the level to keep (setting `level`)"),
            "{}",
            stdout(&report)
        );
    }
}

/// Filter errors sometimes exceed their bounds, so no output calls them proved.
#[test]
fn error_bounds_are_six_standard_deviations_and_nowhere_called_proved() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = temp_folder();
    let help = run_crumple(folder.path(), "verify shield --help");
    let mut all = vec![("--help".to_owned(), stdout(&help).to_owned())];
    let pages = fs::read_dir(root.join("docs"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    for path in pages.chain(["README.md", "reports/assessment.md"].map(|name| root.join(name))) {
        if path.extension().is_some_and(|extension| extension == "md") {
            all.push((
                path.display().to_string(),
                fs::read_to_string(path).unwrap(),
            ));
        }
    }
    for (name, text) in &mut all {
        *text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(
            !text.contains("proved error bound") && !text.contains("proved bounds of the filter"),
            "{name}"
        );
    }
    let says = |name: &str, words: &str| {
        all.iter()
            .any(|(one, text)| one.ends_with(name) && text.contains(words))
    };
    assert!(says(
        "--help",
        "assumes, without proof, that noise and estimation errors stay within six standard deviations"
    ));
    assert!(says(
        "commands.md",
        "error bounds of six standard deviations"
    ));
    assert!(says(
        "limits.md",
        "its errors stay within six standard deviations at each step"
    ));
    assert!(says(
        "assessment.md",
        "six standard deviations of the noise with the Kalman filter"
    ));
}

/// Limits that the search for a leader cannot simulate are refused at once, and no certificate is written.
#[test]
fn limits_of_an_invariant_set_are_refused_before_the_search() {
    let folder = temp_folder();
    for (arguments, message) in [
        (
            "--leader-accel=-9..4",
            "--leader-accel: must be within -7.5 to 3 m/s², the limits of the leader",
        ),
        (
            "--leader-accel=-7.5..3.1",
            "--leader-accel: must be within -7.5 to 3 m/s²",
        ),
        ("--leader-accel=1..3", "--leader-accel: must contain 0"),
        (
            "--speed 0..150",
            "vehicles[1].speed_mps: must be from 0 to 100",
        ),
        (
            "--leader-speed 0..101",
            "vehicles[0].speed_mps: must be from 0 to 100",
        ),
        ("--gap 0", "--gap: must be positive"),
        ("--speed 5..5", "the speeds of the region must increase"),
        (
            "--end-beyond-gap 20",
            "--end-beyond-gap: is below the gap of the region",
        ),
        (
            "--plant relative",
            "--plant: is relative, and the controller depends on its own speed",
        ),
    ] {
        let begun = Instant::now();
        let command =
            format!("verify invariant --controller idm --certificate set.json {arguments}");
        assert_refused(&run_crumple(folder.path(), &command), message);
        // The search takes half a minute.
        assert!(
            begun.elapsed() < Duration::from_secs(20),
            "{arguments}: {:?}",
            begun.elapsed()
        );
        assert!(!folder.path().join("set.json").exists(), "{arguments}");
    }
}

/// A gap error of 0 beside a speed error of 0.5 m/s: with a gap error of 0.45 m the controller collides.
#[test]
fn the_certificate_of_a_set_states_each_observation_error() {
    let folder = temp_folder();
    let errors = "--gap-error 0 --speed-error 0.5 --speed 0..6 --leader-speed 0..6 --cells 30";
    let set = format!(
        "verify invariant --controller idm,standstill_gap_m=0.3 {errors} --certificate set.json"
    );
    let message = "largest observation errors: gap 0 m, own speed 0.5 m/s, leader's speed 0.5 m/s";
    assert_prints(&run_crumple(folder.path(), &set), 0, &[message]);
    assert_prints(
        &run_crumple(folder.path(), "check set.json"),
        0,
        &[message, "within its stated error of the true"],
    );
}

/// The JSON names the policy and the checker's verdict; errors in a box have file, line and field.
#[test]
fn a_box_is_verified_for_programs_and_refused_by_line_and_field() {
    let folder = temp_folder();
    let write = |ranges: &str| {
        let text = format!("version = 1\nscenario = \"paper-1\"\n[ranges]\n{ranges}\n");
        fs::write(folder.path().join("box.toml"), text).unwrap();
    };
    let reach = |more: &str| run_crumple(folder.path(), &format!("verify reach {more}"));
    write("follower_brake_mps2 = 25");
    let verified = reach("--box box.toml --depth 0 --certificate r.json --format json");
    assert_eq!(exit_code(&verified), 0, "{}", stderr(&verified));
    let report = json_objects(&verified).remove(0);
    let checked = json_objects(&run_crumple(folder.path(), "check r.json --format json")).remove(0);
    for (ours, theirs) in [
        ("certificate", "certificate"),
        ("certificate_sha256", "sha256"),
        ("accepted", "accepted"),
        ("verified_share", "verified_share"),
        ("smallest_gap_m", "smallest_gap_m"),
        ("horizon_s", "horizon_s"),
        ("scenario", "scenario"),
    ] {
        assert_eq!(report[ours], checked[theirs], "{ours}");
    }
    assert_eq!(
        (&report["controller"], &report["box_path"]),
        (&"policy".into(), &"box.toml".into())
    );
    assert!(
        report["smallest_gap_m"].as_f64() > Some(0.0) && report["shares"][0]["verified"] == 1.0,
        "{report}"
    );
    for (ranges, message) in [
        (
            "\ngap_ahead_m = -3",
            "box.toml:5: ranges.gap_ahead_m: contains a negative number",
        ),
        (
            "onset_s = -1",
            "box.toml:4: ranges.onset_s: contains a negative number",
        ),
        (
            "leader_speed_mps = 400",
            "box.toml:4: ranges.leader_speed_mps: contains an initial state that is not a valid scenario: must be \
             from 0 to 100",
        ),
        (
            "leader_brake_mps2 = 29",
            "box.toml:4: ranges.leader_brake_mps2: exceeds the braking limit of the leader",
        ),
        ("gap_ahead_m = nan", "box.toml:4: ranges.gap_ahead_m: "),
    ] {
        write(ranges);
        assert_refused(&reach("--box box.toml"), message);
    }
    assert_refused(
        &reach("--box paper-3"),
        "`paper-3` is neither a built-in box (paper-1, paper-2) nor a file",
    );
}

#[test]
fn a_rate_is_registered_counted_resumed_and_certified() {
    let folder = temp_folder();
    let count = |more: &str| {
        let arguments = "verify rate --controller idm --estimator truth --runs 2500";
        run_crumple(folder.path(), &format!("{arguments} {more}"))
    };
    let whole = count("--out whole");
    assert_eq!(exit_code(&whole), 0, "{}", stderr(&whole));
    assert!(
        stderr(&whole).starts_with("the settings of the count are in whole/registration.json; ")
            && stdout(&whole).starts_with("0 failures in 2500 runs")
    );
    let file = |path: &str| fs::read_to_string(folder.path().join(path)).unwrap();
    let certificate: Value = serde_json::from_str(&file("whole/certificate.json")).unwrap();
    let at_most = certificate["statement"]["rate"]["rate_at_most"]
        .as_f64()
        .unwrap();
    let exact = 1.0 - 0.001_f64.powf(1.0 / 2500.0);
    assert!((at_most / exact - 1.0).abs() < 1e-6, "{at_most} {exact}");

    assert_eq!(exit_code(&count("--out whole")), 2, "not without --resume");
    assert_refused(
        &count("--out whole --resume --seed 1"),
        "the count there has a different configuration",
    );
    let again = count("--out whole --resume");
    assert_eq!((exit_code(&again), stdout(&again)), (0, stdout(&whole)));
    let fsck = run_crumple(folder.path(), "fsck whole");
    assert_eq!(
        (exit_code(&fsck), stdout(&fsck)),
        (0, "whole: a count, complete; 3 of 3 files are intact\n")
    );
}

#[test]
fn two_controllers_are_compared_on_the_same_draws() {
    let folder = temp_folder();
    let compare = |first: &str, second: &str, out: &str| {
        run_crumple(
            folder.path(),
            &format!("verify rate --controller {first} --against {second} --runs 300 --out {out}"),
        )
    };
    let better = compare("match-leader", "baseline", "better");
    assert_prints(&better, 0, &["accepted: comparison"]);
    assert_eq!(exit_code(&compare("baseline", "match-leader", "worse")), 1);
}

#[test]
fn a_rare_failure_is_estimated_and_never_certified() {
    let folder = temp_folder();
    let estimate = |more: &str| {
        let effort = "--rare --samples 100 --repetitions 5 --seed 4";
        run_crumple(
            folder.path(),
            &format!("verify rate --controller match-leader {effort} --out rare {more}"),
        )
    };
    let output = estimate("--format json");
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    let report = json_objects(&output).remove(0);
    assert_eq!(
        (&report["certified"], &report["samples"]),
        (&false.into(), &100.into())
    );
    let [low, high] = [0, 1].map(|end| report["interval_95"][end].as_f64().unwrap());
    let probability = report["probability"].as_f64().unwrap();
    assert!(
        low < probability && probability < high && (0.002..0.04).contains(&probability),
        "{report}"
    );
    assert_eq!(
        file_names_in(&folder.path().join("rare")),
        [
            "failures",
            "rare-estimate.json",
            "rare-failures.json",
            "work.json",
            "work.lock"
        ],
        "no certificate"
    );
    let written = fs::read_to_string(folder.path().join("rare/rare-estimate.json")).unwrap();
    assert_eq!(written.parse::<Value>().unwrap(), report);
    let levels = report["levels"].as_array().unwrap();
    assert!(
        levels
            .iter()
            .all(|level| level["margin"].is_f64() && level["margin"] == level["smallest_gap_m"])
    );
    assert_refused(
        &estimate(""),
        "rare already holds a rare-failure estimate: use --resume",
    );
    assert_refused(
        &estimate("--resume --estimator truth"),
        "rare/rare-estimate.json: the rare-failure estimate there has a different configuration",
    );
    let passages = ["neither a bound nor a certificate", "smallest gap", " m "];
    assert_contains(stdout(&estimate("--resume")), &passages);
    let asked = "verify rate --controller idm --rare --samples 50 --repetitions 5 --out rule";
    let rule = run_ok(
        folder.path(),
        &format!("{asked} --spec 'imposed braking at most 4 m/s2'"),
    );
    let message = stdout(&rule);
    assert_contains(message, &["robustness", " failure "]);
    assert!(!message.contains("contact"), "{message}");
    assert!(
        !message.contains("smallest gap"),
        "margins of a rule are no gaps: {message}"
    );
    let written = fs::read_to_string(folder.path().join("rule/rare-estimate.json")).unwrap();
    assert!(
        written.contains("\"margin\"") && !written.contains("smallest_gap_m"),
        "{written}"
    );
    let fsck = || run_crumple(folder.path(), "fsck rare");
    assert_prints(
        &fsck(),
        0,
        &[
            "rare: a rare-failure estimate, complete; ",
            " files are intact",
        ],
    );
    fs::write(
        folder.path().join("rare/rare-estimate.json"),
        written.replace("\"seed\": 4", "\"seed\": 5"),
    )
    .unwrap();
    assert_refused(
        &estimate("--resume"),
        "rare/rare-estimate.json: has changed since it was written",
    );
    assert_eq!(exit_code(&fsck()), 1);
    assert_eq!(
        exit_code(&estimate("--runs 10")),
        2,
        "either counted or estimated"
    );
    assert_eq!(
        exit_code(&run_crumple(folder.path(), "verify rate --controller idm")),
        2,
        "--runs is missing"
    );
}

#[test]
fn an_estimate_killed_again_and_again_ends_with_the_same_bytes_on_any_number_of_threads() {
    let folder = temp_folder();
    let asked = "verify rate --controller match-leader --rare --samples 100 --repetitions 12";
    let after_ms = (0..8).map(|round| 100 + 100 * round..300 + 150 * round);
    let through = assert_survives_kills(folder.path(), asked, after_ms);
    assert_eq!(exit_code(&through), 0);
    let other = run_crumple(
        folder.path(),
        &format!("{asked} --out killed --resume --seed 7"),
    );
    assert_refused(
        &other,
        "the rare-failure estimate there has a different configuration",
    );
}

/// JSON and text agree, with the names of `check` and `suite run`.
#[test]
fn verification_results_are_machine_readable() {
    let folder = temp_folder();
    let message = |arguments: &str| {
        let output = run_ok(folder.path(), arguments);
        json_objects(&output)
    };
    let kernels = message("verify shield --out kernels --format json");
    let names = file_names_in(&folder.path().join("kernels"));
    assert_eq!(
        kernels.len(),
        names.iter().filter(|name| name.ends_with(".json")).count()
    );
    assert_eq!(kernels.len(), VehicleClass::ALL.len().pow(2));
    let certificate = read_json(&folder.path().join("kernels/light-behind-heavy.json"));
    assert_eq!(
        certificate["statement"]["kernel"]["catching_up_squared"],
        "1/3"
    );
    for kernel in &kernels {
        assert_eq!(kernel["accepted"], true);
        let checked = &message(&format!(
            "check {} --format json",
            kernel["certificate"].as_str().unwrap()
        ))[0];
        assert_eq!(kernel, checked);
    }
    let rate = "verify rate --controller idm --estimator truth --runs 300 --format json";
    let shown = &message(&format!("{rate} --out rate --confidence 0.99"))[0];
    assert_eq!(
        (
            shown["runs"].as_u64(),
            shown["failures"].as_u64(),
            shown["confidence"].as_f64()
        ),
        (Some(300), Some(0), Some(0.99))
    );
    // At the rate 1 - (1 - c)^(1/n), the probability of n runs without a failure is 1 - c.
    let bound = 1.0 - 0.01_f64.powf(1.0 / 300.0);
    assert!(
        (shown["rate_at_most"].as_f64().unwrap() - bound).abs() < 1e-9,
        "{shown}"
    );
    let checked = &message(&format!(
        "check {} --format json",
        shown["certificate"].as_str().unwrap()
    ))[0];
    assert_eq!(checked["rate_at_most"], shown["rate_at_most"]);
    let fewest = "verify rate --controller idm --estimator truth --rate-below 0.01 --failures 1 --confidence 0.9";
    let fewest = &message(&format!("{fewest} --out fewest --format json"))[0];
    // With no failure, 388 runs show 1 - 0.1^(1/388); with one they would show 0.01.
    let bound = 1.0 - 0.1_f64.powf(1.0 / 388.0);
    assert_eq!(
        (fewest["runs"].as_u64(), fewest["failures"].as_u64()),
        (Some(388), Some(0)),
        "{fewest}"
    );
    assert!(
        (fewest["rate_at_most"].as_f64().unwrap() - bound).abs() < 1e-9,
        "{fewest}"
    );
}

/// Options of `--rare` are refused without it. A count in which every run failed has a certificate without a bound.
#[test]
fn a_count_names_its_subject() {
    let folder = temp_folder();
    let rate = "verify rate --controller baseline --runs 100 --estimator truth --out rate";
    for (option, value) in [
        ("--spec", "always v1.speed_mps > 1000"),
        ("--samples", "100"),
        ("--repetitions", "5"),
    ] {
        let output = run_crumple(folder.path(), &format!("{rate} {option} '{value}'"));
        assert_refused(&output, &format!("{option}: requires --rare"));
    }
    let shown = run_crumple(folder.path(), &format!("{rate} --format json"));
    let report = &json_objects(&shown)[0];
    assert_eq!(
        (
            exit_code(&shown),
            report["runs"].as_u64(),
            report["rate_at_most"].as_f64()
        ),
        (0, Some(100), Some(1.0)),
        "{report}"
    );
    let unbounded = "rate: no bound below 1 at confidence 0.999, if its counts are right";
    let check = "check rate/certificate.json --rerun";
    assert_prints(
        &run_crumple(folder.path(), check),
        0,
        &[unbounded, "confirmed: all 100 runs"],
    );
    // Frequent failures are counted: all 250 runs fail, and the true rate may be 0.985.
    let rare = "verify rate --controller baseline --estimator truth --rare --samples 50";
    let rare = run_crumple(
        folder.path(),
        &format!("{rare} --repetitions 5 --out rare --format json"),
    );
    let report = &json_objects(&rare)[0];
    let [low, high] = [0, 1].map(|end| report["interval_95"][end].as_f64().unwrap());
    assert!(
        (low - 0.025_f64.powf(1.0 / 250.0)).abs() < 1e-9 && high == 1.0,
        "{report}"
    );
}
