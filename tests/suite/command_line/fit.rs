//! `crumple fit`, and failure rates in fitted spaces.

use crumple_sim::scenario::NoDriverFiles;
use std::fmt::Write;

use super::*;
use crumple_spaces::{DistributionSpec, ScenarioSpace, UniformSpec, file};

/// Returns events of 10 s in which the leader brakes once; the parameters follow no known family of distributions.
pub(super) fn events_csv(count: u32) -> String {
    let mut text =
        "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n".to_owned();
    for event in 0..count {
        let turn = |step: f64| (f64::from(event) * step).fract();
        let (speed, brake, gap_s) = (
            12.0 + 12.0 * turn(0.618),
            1.6 + 4.0 * turn(0.414) * turn(0.732),
            0.7 + 1.6 * turn(0.236),
        );
        let follower = speed * (0.95 + 0.1 * turn(0.303));
        for tenth in 0..100 {
            let at_s = f64::from(tenth) / 10.0;
            let leader = speed - brake * (at_s - 3.0).clamp(0.0, 2.0);
            let gap = gap_s * follower + 5.0;
            writeln!(
                text,
                "{event},{at_s:.1},{gap:.3},{follower:.3},{:.3},{leader:.3}",
                leader - follower
            )
            .unwrap();
        }
    }
    text
}

#[test]
fn a_space_is_fitted_and_failures_are_stated_per_hour() {
    let folder = temp_folder();
    let here = folder.path();
    fs::write(here.join("events.csv"), events_csv(40)).unwrap();
    let fitted = run_ok(
        here,
        "fit events.csv --out space.toml --plot fit.svg --samples 19",
    );
    assert!(
        stdout(&fitted).starts_with("40 braking episodes in 40 clusters, of 2 vehicles\n"),
        "{}",
        stdout(&fitted)
    );
    let drawn = fs::read_to_string(here.join("fit.svg")).unwrap();
    assert!(
        ["lead_speed_mps", "time_gap_1_s", "KS"]
            .iter()
            .all(|name| drawn.contains(name))
    );
    let text = fs::read_to_string(here.join("space.toml")).unwrap();

    let drawn_over = |more: &str| {
        let fit = "fit events.csv --out other.toml --name other --plot fit.svg --samples 19";
        run_crumple(here, &format!("{fit} {more}"))
    };
    assert_refused(
        &drawn_over(""),
        "fit.svg: exists with other contents: use --force",
    );
    assert!(!here.join("other.toml").exists());
    assert_eq!(exit_code(&drawn_over("--force")), 0);

    // Equal output is accepted; an edited file needs --force.
    let again = "fit events.csv --out space.toml --samples 19 --format json";
    let json = &json_objects(&run_crumple(here, again))[0];
    assert_eq!(
        (
            json["exposure"]["episodes"].as_u64(),
            json["features"].as_array().unwrap().len()
        ),
        (Some(40), 5)
    );
    fs::write(
        here.join("space.toml"),
        text.replace("name = \"fitted\"", "name = \"mine\""),
    )
    .unwrap();
    assert_refused(
        &run_crumple(here, again),
        "space.toml: exists with other contents",
    );
    run_ok(here, &format!("{again} --force"));
    assert_eq!(fs::read_to_string(here.join("space.toml")).unwrap(), text);

    let rate = |threads: &str, more: &str| {
        let effort = "--runs 300 --resamples 79 --resample-runs 50 --confidence 0.9";
        let asked = "verify rate --controller baseline --space space.toml --estimator truth";
        run_on_threads(here, threads, &format!("{asked} {effort} {more}"))
    };
    let first = rate("1", "--out one");
    assert_prints(
        &first,
        0,
        &["failures per hour", "with the uncertainty of the data"],
    );
    let on_the_road = |output: &Output| {
        stdout(output)
            .split_once("on the road")
            .unwrap()
            .1
            .to_owned()
    };
    for again in [rate("2", "--out two"), rate("2", "--out one --resume")] {
        assert_eq!(on_the_road(&again), on_the_road(&first));
    }

    // A space edited after the fit has rates, but no uncertainty of the data.
    let mut changed = file::from_toml(&text, Path::new("space.toml"), &NoDriverFiles)
        .unwrap()
        .spec()
        .clone();
    changed.parameters[0].distribution = DistributionSpec::Uniform(UniformSpec {
        low: 10.0,
        high: 26.0,
    });
    let changed =
        file::to_toml(&ScenarioSpace::new(changed, Path::new(""), &NoDriverFiles).unwrap())
            .unwrap();
    fs::write(here.join("changed.toml"), changed).unwrap();
    let asked = "verify rate --controller baseline --space changed.toml --runs 50 --out changed";
    let counted = run_ok(here, &format!("{asked} --confidence 0.9"));
    assert!(
        stdout(&counted)
            .contains("without the uncertainty of the data: `lead_speed_mps` was changed after the space was fitted"),
        "{counted:?}"
    );

    let rare = |more: &str| {
        let effort = "--rare --samples 50 --repetitions 5 --resamples 79 --format json";
        let asked = "verify rate --controller full-throttle --space space.toml --estimator truth";
        run_crumple(here, &format!("{asked} {effort} {more}"))
    };
    let first = rare("--out rare");
    assert_eq!(exit_code(&first), 0, "{}", stderr(&first));
    assert!(
        json_objects(&first)[0]["exposure"]["fitted"]["per_hour"]["estimate"].is_f64(),
        "{}",
        stdout(&first)
    );
    assert_eq!(stdout(&rare("--out rare --resume")), stdout(&first));
    run_ok(here, "fsck one rare");
}

#[test]
fn unsuitable_data_are_refused() {
    let folder = temp_folder();
    let here = folder.path();
    fs::write(here.join("few.csv"), events_csv(19)).unwrap();
    fs::write(here.join("enough.csv"), events_csv(20)).unwrap();
    let fit = |recording: &str, more: &str| {
        run_crumple(here, &format!("fit {recording} --out s.toml {more}"))
    };
    assert_refused(
        &fit("few.csv", ""),
        "found 19 episodes of 2 vehicles, and 20 are needed",
    );
    assert_refused(
        &fit("enough.csv", "--vehicles 3"),
        "found 0 episodes of 3 vehicles, and 28 are needed; 20 have fewer vehicles",
    );
    assert_refused(
        &fit("enough.csv", "--vehicles 6"),
        "must be a whole number from 2 to 5",
    );
    assert_refused(
        &fit("enough.csv", "--follower human"),
        "--follower: needs --vehicles 3 or more",
    );
    assert_refused(&fit("enough.csv", "--min-brake -1"), "--min-brake");
    assert_refused(
        &fit("enough.csv", "--min-brake 12"),
        "--min-brake: the deceleration of braking must be above 0 and below 12 m/s²",
    );
    assert_refused(
        &fit("enough.csv", "--name ''"),
        "name: must have 1 to 100 characters",
    );
    assert_refused(&fit("nothing.csv", ""), "nothing.csv");
    fs::copy(
        folder.path().join("enough.csv"),
        folder.path().join("copy.csv"),
    )
    .unwrap();
    for again in ["./enough.csv", "copy.csv"] {
        assert_refused(
            &fit("enough.csv", again),
            &format!("{again}: this recording is given twice"),
        );
    }
    assert_refused(
        &run_crumple(here, "fit enough.csv --out s.json"),
        "must end in .toml",
    );
    let events: String = events_csv(1)
        .lines()
        .skip(1)
        .map(|line| format!("{line}\n"))
        .collect();
    let same = (0..25).map(|event| {
        events
            .replace("\n0,", &format!("\n{event},"))
            .replacen("0,", &format!("{event},"), 1)
    });
    let header = events_csv(0);
    fs::write(here.join("same.csv"), header + &same.collect::<String>()).unwrap();
    assert_refused(&fit("same.csv", ""), "all values are");
    assert!(!here.join("s.toml").exists());
    assert_refused(
        &run_crumple(here, "verify rate --controller idm --runs 10 --resamples 5"),
        "must be 0 or from 79 to 2000, found 5",
    );
    // A space without episodes cannot be resampled.
    for (option, value) in [("--resamples", "100"), ("--resample-runs", "60")] {
        assert_refused(
            &run_crumple(
                here,
                &format!("verify rate --controller idm --runs 10 {option} {value}"),
            ),
            &format!("{option}: the space `paper` was not fitted to episodes"),
        );
    }
}
