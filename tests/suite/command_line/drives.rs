//! `crumple import --whole`, and the commands that count on recorded drives.

use super::*;

/// Returns a platoon of three in the OpenACC format: all cars drive at about 20 m/s for a minute.
pub(super) fn platoon_csv() -> String {
    let mut text =
        "Date,1,1,2026\nVehicle_order,A,B,C\nNumber_of_vehicles,3\nACC,1\nDistance_setting,S\n\
        Time,Speed1,Speed2,Speed3,IVS1,IVS2\n"
            .to_owned();
    for sample in 0..=600 {
        let time_s = f64::from(sample) * 0.1;
        let speed_mps = |car: f64| 20.0 + (0.3 * time_s - 0.3 * car).sin();
        let gap_m = |car: f64| {
            let driven_m = |car: f64| -(0.3 * time_s - 0.3 * car).cos() / 0.3;
            30.0 + driven_m(car - 1.0) - driven_m(car)
        };
        let [a, b, c] = [0.0, 1.0, 2.0].map(speed_mps);
        let [ab, bc] = [1.0, 2.0].map(gap_m);
        text += &format!("{time_s:.1},{a:.3},{b:.3},{c:.3},{ab:.3},{bc:.3}\n");
    }
    text
}

#[test]
fn recorded_drives_are_imported_counted_searched_and_assessed() {
    let folder = temp_folder();
    fs::write(folder.path().join("platoon.csv"), platoon_csv()).unwrap();
    let imported = run_crumple(folder.path(), "import platoon.csv --whole --out drives");
    assert_eq!(
        stdout(&imported),
        "platoon.csv: 2 scenarios (openacc), 1 without a vehicle behind: collisions from behind cannot happen\n"
    );
    assert_eq!(
        file_names_in(&folder.path().join("drives")),
        [
            "openacc-platoon-drive-01.toml",
            "openacc-platoon-drive-02.toml"
        ]
    );
    let simulated = run_ok(folder.path(), "simulate drives --controller idm");
    assert!(
        stdout(&simulated)
            .contains("1 of 2  no vehicle behind: collisions from behind cannot happen")
    );
    for (follower, driver) in [("recorded", "recorded"), ("acc-aeb,ttc_s=2", "acc-aeb")] {
        let import =
            format!("import platoon.csv --whole --follower {follower} --out {driver}-drives");
        run_ok(folder.path(), &import);
        let drive = format!("{driver}-drives/openacc-platoon-drive-01.toml");
        let text = fs::read_to_string(folder.path().join(drive)).unwrap();
        assert!(
            text.contains(&format!("vehicles.driver.{driver}]")),
            "{follower}"
        );
    }
    let unknown = "import platoon.csv --whole --follower unknown --out x";
    assert_refused(
        &run_crumple(folder.path(), unknown),
        "--follower: unknown is neither a file, nor a built-in controller, nor one of human, idm",
    );
    let counted = run_crumple(
        folder.path(),
        "verify rate --controller idm --drives drives --format json",
    );
    let report: serde_json::Value = serde_json::from_str(stdout(&counted)).unwrap();
    assert_eq!(
        (
            &report["drives"],
            &report["failures"]["count"],
            &report["without_vehicle_behind"]
        ),
        (&2.into(), &0.into(), &1.into())
    );
    assert!(
        (report["hours"].as_f64().unwrap() * 3600.0 - 119.8).abs() < 0.5,
        "{report}"
    );
    assert!(
        report["recorded"]["rms_jerk_sampled_mps3"]
            .as_f64()
            .unwrap()
            > 0.0
    );
    assert_eq!(report["caused_by_vehicle_behind"]["count"], 0);
    let search = "falsify --controller idm --drives drives --out found";
    run_ok(folder.path(), &format!("{search} --expect nothing"));
    let slow = format!("{search} --spec 'always v1.speed_mps > 25' --expect failure");
    assert!(stdout(&run_crumple(folder.path(), &slow)).contains("failed drives"));
    assert_eq!(
        file_names_in(&folder.path().join("found/counterexamples")).len(),
        2
    );
    assert_refused(
        &run_crumple(
            folder.path(),
            "verify rate --controller idm --drives drives --runs 5",
        ),
        "cannot be used with",
    );
    assert_refused(
        &run_crumple(folder.path(), "verify rate --controller idm --drives gone"),
        "--drives: gone: is no folder",
    );
    assess(folder.path());
}

/// The report has the table, a claim about the drives, and none of the recordings.
fn assess(folder: &Path) {
    let config = "version = 1\ncontrollers = [\"idm\"]\npaper = false\ndraws = 0\neveryday_draws = 0\n\
        distributions = []\nsearch = { spaces = [] }\nrates = { runs = 0 }\n";
    fs::write(folder.join("a.toml"), config).unwrap();
    run_ok(folder, "assess a.toml --drives drives --out report");
    let page = fs::read_to_string(folder.join("report/assessment.md")).unwrap();
    for part in [
        "Recorded drives",
        "| recorded cars |",
        "no collision in 2 recorded drives of `drives`",
    ] {
        assert!(page.contains(part), "{part}");
    }
    let json = fs::read_to_string(folder.join("report/assessment.json")).unwrap();
    assert!(!json.contains("time_s = ["), "no recorded speeds");
    assess_undecided(folder, config);
    fs::write(
        folder.join("b.toml"),
        format!("{config}drives = \"gone\"\n"),
    )
    .unwrap();
    assert_refused(
        &run_crumple(folder, "assess b.toml --out other"),
        "b.toml:9: drives: ",
    );
}

/// A vehicle that repeats recorded speeds hits a controller that falls far behind. The claim counts that drive, too.
fn assess_undecided(folder: &Path, config: &str) {
    let slow = config.replace("\"idm\"", "\"idm,time_headway_s=5\"");
    fs::write(folder.join("slow.toml"), slow).unwrap();
    run_ok(
        folder,
        "assess slow.toml --drives recorded-drives --out undecided",
    );
    let page = fs::read_to_string(folder.join("undecided/assessment.md")).unwrap();
    for part in [
        "0 of 2, 1 undecided",
        "1 drive ended with a collision of other vehicles, or from behind",
    ] {
        assert!(page.contains(part), "{part}");
    }
    fs::copy(
        folder.join("drives/openacc-platoon-drive-01.toml"),
        folder.join("recorded-drives/copy.toml"),
    )
    .unwrap();
    assert_refused(
        &run_crumple(
            folder,
            "verify rate --controller idm --drives recorded-drives",
        ),
        "vehicles[1].recorded: is the motion in",
    );
}

/// A log of a car with a second range that no field of the draft reads. Its small changes fit several units.
#[test]
fn a_drafted_map_names_the_columns_that_it_leaves_out() {
    let folder = temp_folder();
    let mut text = "time,gap,v,v_lead,range_left\n".to_owned();
    for sample in 0..600 {
        let time_s = f64::from(sample) * 0.1;
        let gap_m = 30.0 - (0.5 * time_s).cos();
        let closing_mps = 0.5 * (0.5 * time_s).sin();
        text += &format!("{time_s:.1},{gap_m:.3},20,{:.3},7\n", 20.0 + closing_mps);
    }
    fs::write(folder.path().join("log.csv"), text).unwrap();
    let drafted = run_ok(folder.path(), "import log.csv --guess");
    let note = "note: the draft does not read these columns, which look like spacings or speeds: range_left\n";
    assert!(stderr(&drafted).contains(note), "{}", stderr(&drafted));
    assert!(!stdout(&drafted).contains("range_left"));
    let units = "note: other units or signs fit as well: ";
    assert!(stderr(&drafted).contains(units), "{}", stderr(&drafted));
    let quiet = run_ok(folder.path(), "import log.csv --guess --quiet");
    assert_eq!(stderr(&quiet), "");
}
