//! `crumple check` against forged certificates.

use crumple_sim::scenario::{
    Driver, LeadProfile, PiecewiseAcceleration, PlantKind, RampBrake, built_in_scenario, file,
};
use crumple_spaces::{built_in_space, file as space_file};
use crumple_verify::reach::{FollowerLaw, PartitionCell};
use crumple_verify::{Certificate, Interval, RateClaim, Registration, Statement};

use super::*;
use crate::forgery::change_statement;
use crate::forgery::rates::{claim_rate_for_baseline, rate_claim};

fn read_certificate(folder: &Path, name: &str) -> Certificate {
    Certificate::from_json(&fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

fn write_certificate(folder: &Path, name: &str, certificate: &Certificate) {
    fs::write(folder.join(name), certificate.to_canonical_json()).unwrap();
}

/// Counts 300 runs of idm without failures, in `DIR/certificate.json`.
fn write_idm_count(folder: &Path, out: &str, more: &str) {
    let arguments =
        format!("verify rate --controller idm --estimator truth --runs 300 --out {out}");
    run_ok(folder, &format!("{arguments} --confidence 0.99 {more}"));
}

#[test]
fn the_check_of_a_rate_names_the_plant_and_convex_programs_refuse_it() {
    let folder = temp_folder();
    let text = space_file::to_toml(&built_in_space("paper").unwrap()).unwrap();
    // The name of the plant elsewhere is no plant.
    for (name, driver, plant) in [
        (
            "multi-body",
            "driver = \"under-test\"",
            "its vehicles have the plant `point-mass`",
        ),
        (
            "rich",
            "driver = \"under-test\"\nplant = \"multi-body\"",
            "vehicles have the plant `multi-body`",
        ),
    ] {
        let text = text.replace("name = \"paper\"", &format!("name = \"{name}\""));
        fs::write(
            folder.path().join("space.toml"),
            text.replace("driver = \"under-test\"", driver),
        )
        .unwrap();
        // Runs with the multi-body plant take long, and the statement needs few.
        let count = "verify rate --controller idm --estimator truth --runs 40 --space space.toml";
        run_ok(folder.path(), &format!("{count} --out {name}"));
        let message = run_crumple(folder.path(), &format!("check {name}/certificate.json"));
        assert_prints(&message, 0, &[plant]);
    }
    let rich = built_in_scenario("paper-1")
        .unwrap()
        .with_plant(PlantKind::MultiBody)
        .unwrap();
    fs::write(
        folder.path().join("rich.toml"),
        file::to_toml(&rich).unwrap(),
    )
    .unwrap();
    let message = run_crumple(folder.path(), "avoid rich.toml");
    assert_eq!(exit_code(&message), 2);
    assert!(
        stderr(&message).contains("the programs model only `point-mass`"),
        "{}",
        stderr(&message)
    );
}

/// Claims the counted failure rate of idm for the baseline, with further changes.
fn forge_rate(folder: &Path, change: impl FnOnce(&mut RateClaim)) -> Certificate {
    let genuine = read_certificate(folder, "idm/certificate.json");
    claim_rate_for_baseline(&genuine, change)
}

#[test]
fn counts_are_the_makers_word_until_they_are_counted_again() {
    let folder = temp_folder();
    write_idm_count(folder.path(), "idm", "");
    let check = |arguments: &str| run_crumple(folder.path(), &format!("check {arguments}"));
    let message = check("idm/certificate.json");
    assert!(
        stdout(&message).contains("if its counts are right"),
        "{}",
        stdout(&message)
    );
    assert!(
        stdout(&message).contains("the counts are not verified"),
        "{}",
        stdout(&message)
    );
    assert!(
        stdout(&message).contains("its vehicles have the plant `point-mass`"),
        "{}",
        stdout(&message)
    );
    let message = check("idm/certificate.json --rerun");
    assert_prints(
        &message,
        0,
        &["confirmed: all 300 runs were drawn and simulated again"],
    );
    assert!(!stdout(&message).contains("not verified"));

    // Claims idm's failure rate for the baseline, which nearly always fails: an intact file with a false claim.
    let forged = forge_rate(folder.path(), |_| {});
    write_certificate(folder.path(), "forged.json", &forged);
    assert_prints(&check("forged.json"), 0, &["the counts are not verified"]);
    for rerun in ["--rerun", "--rerun=1"] {
        let message = check(&format!("forged.json {rerun}"));
        assert_eq!(exit_code(&message), 1, "{rerun}");
        assert!(
            stdout(&message).contains("refuted by a new count: blocks["),
            "{}",
            stdout(&message)
        );
        assert!(
            stdout(&message).contains("failed when repeated, and the certificate states 0"),
            "{}",
            stdout(&message)
        );
    }
    // Correct counts with hashes of other runs.
    let genuine = read_certificate(folder.path(), "idm/certificate.json");
    let hashes = change_statement(&genuine, |statement| {
        rate_claim(statement).blocks[1].1 = sha256("another run");
    });
    write_certificate(folder.path(), "hashes.json", &hashes);
    let message = check("hashes.json --rerun --format json");
    let report = &json_objects(&message)[0];
    assert_eq!(
        (exit_code(&message), &report["accepted"], &report["counts"]),
        (1, &false.into(), &"refuted".into())
    );
    assert!(
        report["rejection"]
            .as_str()
            .unwrap()
            .contains("runs 100 to 199"),
        "{report}"
    );
}

/// An intact forged file with enough runs for the bound and invented hashes.
#[test]
fn a_bound_of_0_0002_for_the_baseline_is_the_makers_word_and_refuted_by_a_hundredth_of_its_runs() {
    let folder = temp_folder();
    write_idm_count(folder.path(), "idm", "");
    let mut forged = forge_rate(folder.path(), |rate| {
        (
            rate.registration.runs,
            rate.registration.confidence,
            rate.rate_at_most,
        ) = (69_100, 0.999_999, 0.000_2);
        rate.blocks = (0..691)
            .map(|block| (0, sha256(block.to_string())))
            .collect();
    });
    write_certificate(folder.path(), "forged.json", &forged);
    assert_prints(
        &run_crumple(folder.path(), "check forged.json"),
        0,
        &["the counts are not verified"],
    );
    assert_prints(
        &run_crumple(folder.path(), "check forged.json --rerun=1"),
        1,
        &["refuted by a new count: "],
    );
    // A certificate of version 0.1.0 has no blocks to count again.
    let Statement::Rate(rate) = &mut forged.statement else {
        panic!("a rate")
    };
    (rate.registration.block_runs, rate.blocks) = (None, Vec::new());
    rate.registration_sha256 = rate.registration.digest();
    forged.version = 1;
    (
        forged.provenance.scenario_text,
        forged.provenance.scenario_sha256,
    ) = (None, String::new());
    write_certificate(folder.path(), "old.json", &forged);
    let message = run_crumple(folder.path(), "check old.json");
    for words in ["the counts are not verified", "version 1, an old one"] {
        assert!(
            exit_code(&message) == 0 && stdout(&message).contains(words),
            "{words}: {}",
            stdout(&message)
        );
    }
    let message = run_crumple(folder.path(), "check old.json --rerun");
    assert!(
        exit_code(&message) == 2 && !stdout(&message).contains("confirmed"),
        "{} {}",
        stdout(&message),
        stderr(&message)
    );
}

/// The box of `corpora/boxes/paper-1.toml`, without a follower.
const AHEAD_ONLY: &str = "version = 1
scenario = \"paper-1\"
observation_error = [1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9]
[ranges]
gap_ahead_m = { low = 15.3, high = 16.7 }
leader_brake_mps2 = { low = 2.8, high = 3.2 }
onset_s = { low = 1.0, high = 1.5 }
";

/// The output states a duration of 4 s, and the absence of a follower.
#[test]
fn a_short_claim_reads_short_and_states_an_absent_follower() {
    let folder = temp_folder();
    let short = |duration_s: f64| {
        let paper = built_in_scenario("paper-1").unwrap().edited(|spec| {
            spec.duration_s = duration_s;
            spec.vehicles.truncate(2);
        });
        paper.unwrap()
    };
    fs::write(
        folder.path().join("short.toml"),
        file::to_toml(&short(4.0)).unwrap(),
    )
    .unwrap();
    run_ok(folder.path(), "avoid short.toml --certificate short.json");
    let message = run_crumple(folder.path(), "check short.json");
    assert_prints(
        &message,
        0,
        &[
            " m for 4 s; ",
            "for 4 s from the start\n",
            "behind: no vehicle\n",
        ],
    );

    let mut reach = read_certificate(
        Path::new(env!("CARGO_MANIFEST_DIR")),
        "corpora/certificates/reach-paper-1.json",
    );
    let Statement::Reach(claim) = &mut reach.statement else {
        panic!("reach")
    };
    (claim.steps, claim.follower_ttc_s, claim.min_gap_m_at_least) = (10, None, 0.0);
    (claim.ranges.gap_behind_m, claim.ranges.follower_speed_mps) = (Interval::ZERO, Interval::ZERO);
    claim.ranges.follower_brake_mps2 = Interval::ZERO;
    (claim.partition, claim.verified_share_at_least) = (vec![PartitionCell::Verified], 1.0);
    reach.assumptions = reach.statement.assumptions();
    // First bound to a scenario without a follower, then to none.
    let text = file::to_toml(&short(0.1)).unwrap();
    reach.provenance.box_text = Some(AHEAD_ONLY.to_owned());
    (
        reach.provenance.scenario_sha256,
        reach.provenance.scenario_text,
    ) = (sha256(&text), Some(text));
    write_certificate(folder.path(), "bound.json", &reach);
    reach.version = 1;
    (reach.provenance.scenario_text, reach.provenance.box_text) = (None, None);
    reach.provenance.scenario_sha256 = String::new();
    write_certificate(folder.path(), "old.json", &reach);
    for (name, about) in [
        (
            "bound.json",
            "this scenario is NOT the built-in one of that name",
        ),
        (
            "old.json",
            "version 1 does not bind the statement to a text",
        ),
    ] {
        let message = run_ok(folder.path(), &format!("check {name}"));
        for words in [
            "in 100.00 % of the box's volume",
            " m for 0.1 s, with no vehicle behind",
            "for 0.1 s from the start and no longer",
            "behind: no vehicle\n",
            about,
        ] {
            assert!(
                stdout(&message).contains(words),
                "{name}: {words}: {}",
                stdout(&message)
            );
        }
    }
}

#[test]
fn a_sample_is_chosen_afterwards_and_states_its_power() {
    let folder = temp_folder();
    write_idm_count(folder.path(), "idm", "");
    let sampled = |more: &str| {
        run_ok(
            folder.path(),
            &format!("check idm/certificate.json --rerun=50 {more}"),
        )
    };
    let report = &json_objects(&sampled("--rerun-seed 7 --format json"))[0];
    assert_eq!(report["counts"], "confirmed_by_sample");
    let rerun = &report["rerun"];
    let numbers = ["runs", "total_runs", "blocks", "total_blocks", "seed"]
        .map(|field| rerun[field].as_u64().unwrap());
    assert_eq!(numbers, [200, 300, 2, 3, 7]);
    // One of three blocks has a forged run, and two blocks were counted again.
    assert!(
        (rerun["detection_probabilities"][0][1].as_f64().unwrap() - 2.0 / 3.0).abs() < 1e-9,
        "{report}"
    );
    let text = sampled("");
    assert_contains(
        stdout(&text),
        &[
            "2 of 3 blocks, 200 of 300 runs (66.66 %)",
            "after the file was fixed",
            "1 forged run: 66.66 %",
        ],
    );
    assert_eq!(
        exit_code(&run_crumple(
            folder.path(),
            "check idm/certificate.json --rerun=0"
        )),
        2
    );
}

#[test]
fn several_bounds_hold_jointly() {
    let folder = temp_folder();
    write_idm_count(folder.path(), "one", "");
    write_idm_count(folder.path(), "two", "--seed 8");
    let arguments = "check one/certificate.json two/certificate.json";
    let both = run_crumple(folder.path(), arguments);
    assert!(
        stdout(&both).contains("together: all 2 bounds hold at confidence 98 %"),
        "{}",
        stdout(&both)
    );
    let reports = json_objects(&run_crumple(
        folder.path(),
        &format!("{arguments} --format json"),
    ));
    assert!(
        reports.iter().all(
            |certificate| (certificate["joint_confidence"].as_f64().unwrap() - 0.98).abs() < 1e-9
        ),
        "{reports:?}"
    );
    let alone = run_crumple(folder.path(), &arguments[..2]);
    assert!(!stdout(&alone).contains("together"));
}

#[test]
fn a_genuine_statement_cannot_carry_another_scenario() {
    let folder = temp_folder();
    for name in ["paper-1", "paper-2"] {
        run_ok(
            folder.path(),
            &format!("avoid {name} --certificate {name}.json"),
        );
    }
    let message = run_crumple(folder.path(), "check paper-1.json");
    let passages = [
        "no gap is ever smaller than",
        " m for 15 s; and a collision remains avoidable afterwards, ",
        "for 15 s from the start\n",
        "behind: front bumper",
        "this scenario is the built-in one of that name",
    ];
    assert_contains(stdout(&message), &passages);
    let [one, two] =
        ["paper-1.json", "paper-2.json"].map(|name| read_certificate(folder.path(), name));
    let swapped = Certificate {
        provenance: one.provenance.clone(),
        ..two.clone()
    };
    let mut renamed = two.clone();
    renamed.provenance.scenario = "paper-1".to_owned();
    let mut old = swapped.clone();
    old.version = 1;
    (old.provenance.scenario_text, old.provenance.box_text) = (None, None);
    let mut empty = two.clone();
    empty.provenance.scenario_sha256 = String::new();
    for (name, forged) in [
        ("swapped", swapped),
        ("renamed", renamed),
        ("old", old),
        ("empty", empty),
    ] {
        write_certificate(folder.path(), "forged.json", &forged);
        let message = run_crumple(folder.path(), "check forged.json");
        assert_eq!(exit_code(&message), 1, "{name}: {}", stdout(&message));
    }
    // A genuine certificate of version 1 is accepted, with a note about its age.
    let mut old = one;
    old.version = 1;
    (old.provenance.scenario_text, old.provenance.box_text) = (None, None);
    write_certificate(folder.path(), "old.json", &old);
    assert_prints(
        &run_crumple(folder.path(), "check old.json --scenario paper-1"),
        0,
        &["version 1, an old one"],
    );
    // The output warns of another scenario under a built-in name.
    let edited = built_in_scenario("paper-1")
        .unwrap()
        .edited(|spec| spec.vehicles[0].position_m += 1.0)
        .unwrap();
    fs::write(
        folder.path().join("mine.toml"),
        file::to_toml(&edited).unwrap(),
    )
    .unwrap();
    run_ok(folder.path(), "avoid mine.toml --certificate mine.json");
    let message = run_crumple(folder.path(), "check mine.json");
    assert!(
        stdout(&message).contains("this scenario is NOT the built-in one of that name"),
        "{}",
        stdout(&message)
    );
}

#[test]
fn a_reach_certificate_is_about_the_scenarios_in_its_box() {
    let folder = temp_folder();
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/corpora/certificates/reach-paper-1.json"
    );
    let message = run_crumple(folder.path(), &format!("check '{file}' --scenario paper-1"));
    let passages = [
        "is about paper-1",
        "with a vehicle behind",
        " m for 15 s",
        "leader: 15.3 to 16.7 m ahead",
        "of the box's volume",
    ];
    assert_prints(&message, 0, &passages);
    let other = run_crumple(folder.path(), &format!("check '{file}' --scenario paper-2"));
    assert_prints(&other, 1, &["is NOT about paper-2"]);
    // A shorter claim, one without a follower, or one of another box no longer matches the box text.
    let genuine = read_certificate(Path::new(""), file);
    let with = |change: &dyn Fn(&mut crumple_verify::ReachClaim)| {
        let mut forged = genuine.clone();
        let Statement::Reach(claim) = &mut forged.statement else {
            panic!("reach")
        };
        change(claim);
        forged.assumptions = forged.statement.assumptions();
        write_certificate(folder.path(), "forged.json", &forged);
        let message = run_crumple(folder.path(), "check forged.json");
        (exit_code(&message), stdout(&message).to_owned())
    };
    let other = crumple_verify::Interval::new(15.4, 16.7).unwrap();
    for (code, message) in [
        with(&|claim| claim.steps = 10),
        with(&|claim| claim.follower_ttc_s = None),
        with(&|claim| claim.ranges.gap_ahead_m = other),
        with(&|claim| claim.observation_error = [0.0; 8]),
    ] {
        assert!(
            code == 1 && message.contains("does not match the scenario or box of `provenance`"),
            "{message}"
        );
    }
}

/// The claim of a braking limit is printed, bound to the box file, and about scripts within the limit only.
#[test]
fn a_leader_within_a_limit_is_in_the_box_the_scope_and_the_assumptions() {
    let folder = temp_folder();
    let of_box = |field: &str, ranges: &str| {
        format!("version = 1\nscenario = \"paper-1\"\n{field}\n[ranges]\n{ranges}\n")
    };
    let gap = "gap_ahead_m = { low = 15.9, high = 16.1 }";
    let made = |limit: &str, name: &str, depth: &str| {
        let text = of_box(&format!("leader_brakes_at_most_mps2 = {limit}"), gap);
        fs::write(folder.path().join("box.toml"), text).unwrap();
        run_crumple(
            folder.path(),
            &format!("verify reach --box box.toml --depth {depth} --certificate {name}"),
        )
    };
    let message = made("0.03", "led.json", "4");
    assert_eq!(exit_code(&message), 0, "{}", stderr(&message));
    let checked = run_crumple(folder.path(), "check led.json");
    let passages = [
        "however the leader brakes at up to 0.03 m/s²",
        "never speeds up, and brakes as it likes: over each step at another rate from 0 to 0.03 m/s²",
        "the vehicle ahead never brakes harder than stated",
    ];
    assert_prints(&checked, 0, &passages);
    assert!(
        !stdout(&checked).contains("the leader moves as scripted"),
        "{}",
        stdout(&checked)
    );
    let about = run_crumple(folder.path(), "check led.json --scenario paper-1");
    assert_prints(&about, 1, &["is NOT about paper-1"]);

    // A smaller limit would follow, but does not match the box text.
    let genuine = read_certificate(folder.path(), "led.json");
    for limit in [None, Some(0.0), Some(0.02), Some(0.031)] {
        let mut forged = genuine.clone();
        let Statement::Reach(claim) = &mut forged.statement else {
            panic!("reach")
        };
        claim.leader_brakes_at_most_mps2 = limit;
        claim.min_gap_m_at_least = 0.0;
        forged.assumptions = forged.statement.assumptions();
        write_certificate(folder.path(), "forged.json", &forged);
        assert_prints(
            &run_crumple(folder.path(), "check forged.json"),
            1,
            &["does not match the scenario or box"],
        );
    }
    let mut forged = genuine;
    forged
        .assumptions
        .retain(|assumption| *assumption != crumple_verify::Assumption::LeaderWithinLimit);
    write_certificate(folder.path(), "forged.json", &forged);
    assert_prints(
        &run_crumple(folder.path(), "check forged.json"),
        1,
        &["`assumptions` must be"],
    );

    // Falsified for a leader that brakes as hard as possible, with an initial state and a profile; also about paper-1.
    let refuted = made("7.5", "refuted.json", "1");
    assert_prints(&refuted, 1, &["falsified"]);
    let about = run_crumple(folder.path(), "check refuted.json --scenario paper-1");
    assert!(
        stdout(&about).contains("is about paper-1"),
        "{}",
        stdout(&about)
    );

    // The claim covers every script within the limit; for any other script the output states the reason.
    made("3.0", "three.json", "1");
    let with_leader = |driver: Driver| {
        let paper = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| spec.vehicles[0].driver = driver)
            .unwrap();
        fs::write(
            folder.path().join("scripted.toml"),
            file::to_toml(&paper).unwrap(),
        )
        .unwrap();
        let message = run_crumple(folder.path(), "check three.json --scenario scripted.toml");
        (exit_code(&message), stdout(&message).to_owned())
    };
    let pieces = |accel_mps2: [f64; 3]| {
        Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration {
            from_s: vec![1.0, 2.0, 3.0],
            accel_mps2: accel_mps2.to_vec(),
        }))
    };
    let ramp = RampBrake {
        onset_s: 1.0,
        rate_mps2: 3.0,
        ramp_s: 0.5,
        release_s: 0.25,
    };
    for driver in [
        Driver::Profile(LeadProfile::RampBrake(ramp)),
        pieces([-3.0, 0.0, -1.0]),
    ] {
        let (_, message) = with_leader(driver);
        assert!(message.contains("is about scripted.toml"), "{message}");
    }
    for (driver, why) in [
        (
            pieces([-3.0, -3.1, 0.0]),
            "`pieces` brakes at 3.1 m/s², and the statement's leader at 3 m/s² at most",
        ),
        (
            pieces([-3.0, 0.1, 0.0]),
            "`pieces` accelerates at 0.1 m/s², and the statement's leader never speeds up",
        ),
        (
            Driver::Controller(BuiltInController::from_name("idm").unwrap()),
            "the leader must be scripted",
        ),
    ] {
        let (code, message) = with_leader(driver);
        assert!(
            code == 1 && message.contains("is NOT about scripted.toml: ") && message.contains(why),
            "{message}"
        );
    }

    for (field, ranges, line, problem) in [
        (
            "leader_brakes_at_most_mps2 = -0.1",
            gap,
            3,
            "leader_brakes_at_most_mps2: must be 0 or more, found -0.1",
        ),
        (
            "leader_brakes_at_most_mps2 = nan",
            gap,
            3,
            "leader_brakes_at_most_mps2: must be 0 or more, found NaN",
        ),
        (
            "leader_brakes_at_most_mps2 = 30",
            gap,
            3,
            "leader_brakes_at_most_mps2: exceeds the braking limit of the leader",
        ),
        (
            "leader_brakes_at_most_mps2 = 1",
            "onset_s = 1.0",
            5,
            "ranges.onset_s: has no meaning with",
        ),
        (
            "leader_brakes_at_most_mps2 = 1",
            "leader_brake_mps2 = 1.0",
            5,
            "ranges.leader_brake_mps2: has no meaning with",
        ),
        (
            "leader_brakes_at_most_mps2 = \"1\"",
            gap,
            3,
            "leader_brakes_at_most_mps2",
        ),
    ] {
        fs::write(folder.path().join("bad.toml"), of_box(field, ranges)).unwrap();
        let message = run_crumple(folder.path(), "verify reach --box bad.toml");
        let location = format!("bad.toml:{line}");
        let error = stderr(&message);
        assert!(
            exit_code(&message) == 2 && error.contains(&location) && error.contains(problem),
            "{field}: {error}"
        );
    }
}

/// The claim of a follower's controller is printed, bound to the box file, and about scenarios with that follower.
#[test]
fn a_modelled_follower_is_in_the_box_the_scope_and_the_assumptions() {
    let folder = temp_folder();
    let of_box = |field: &str| {
        format!(
            "version = 1\nscenario = \"paper-1\"\n{field}\n[ranges]\ngap_behind_m = {{ low = 15.9, high = 16.0 }}\n"
        )
    };
    let made = |field: &str, name: &str| {
        fs::write(folder.path().join("box.toml"), of_box(field)).unwrap();
        run_crumple(
            folder.path(),
            &format!("verify reach --box box.toml --depth 3 --certificate {name}"),
        )
    };
    let message = made("follower_drives = \"idm\"", "idm.json");
    assert_eq!(exit_code(&message), 0, "{}", stderr(&message));
    let checked = run_crumple(folder.path(), "check idm.json");
    let passages = [
        "drives idm towards 33.33 m/s with a time headway of 1.6 s",
        "the follower applies the stated controller's command at each step, without delay",
    ];
    assert_prints(&checked, 0, &passages);
    assert!(
        !stdout(&checked).contains("latched"),
        "{}",
        stdout(&checked)
    );
    // paper-1 has another follower.
    assert_prints(
        &run_crumple(folder.path(), "check idm.json --scenario paper-1"),
        1,
        &["is NOT about paper-1"],
    );
    // The edited scenario has that follower.
    let followed = built_in_scenario("paper-1").unwrap().edited(|spec| {
        spec.vehicles[2].driver = Driver::Controller(BuiltInController::from_name("idm").unwrap());
    });
    let followed = followed.unwrap();
    fs::write(
        folder.path().join("idm.toml"),
        file::to_toml(&followed).unwrap(),
    )
    .unwrap();
    let about = run_crumple(folder.path(), "check idm.json --scenario idm.toml");
    assert!(
        stdout(&about).contains("is about idm.toml"),
        "{}",
        stdout(&about)
    );

    let genuine = read_certificate(folder.path(), "idm.json");
    for headway_s in [1.5, 1.7] {
        let mut forged = genuine.clone();
        let Statement::Reach(claim) = &mut forged.statement else {
            panic!("reach")
        };
        let Some(FollowerLaw::Idm(idm)) = claim.follower_law.as_deref_mut() else {
            panic!("idm")
        };
        idm.time_headway_s = headway_s;
        claim.min_gap_m_at_least = 0.0;
        write_certificate(folder.path(), "forged.json", &forged);
        let message = run_crumple(folder.path(), "check forged.json");
        let differs = stdout(&message).contains("does not match the scenario or box");
        assert!(exit_code(&message) == 1 && differs, "{}", stdout(&message));
    }

    for (field, problem) in [
        (
            "follower_drives = \"rss\"",
            "follower_drives: must drive with baseline, idm or acc-aeb, found rss",
        ),
        ("follower_drives = \"unknown\"", "unknown"),
        (
            "follower_drives = { idm = { time_headway_s = -1.0 } }",
            "follower_drives",
        ),
    ] {
        fs::write(folder.path().join("bad.toml"), of_box(field)).unwrap();
        let message = run_crumple(folder.path(), "verify reach --box bad.toml");
        let error = stderr(&message);
        assert!(
            exit_code(&message) == 2 && error.contains("bad.toml:3") && error.contains(problem),
            "{field}: {error}"
        );
    }
}

#[test]
fn each_certificate_has_its_own_verdict() {
    let folder = temp_folder();
    let good = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/corpora/certificates/reach-paper-1.json"
    );
    fs::write(folder.path().join("cut.json"), "{").unwrap();
    let message = run_crumple(
        folder.path(),
        &format!("check cut.json '{good}' nowhere.json"),
    );
    assert_prints(&message, 2, &["reach-paper-1.json: accepted: reach"]);
    assert!(
        stderr(&message).contains("cut.json: is not a certificate"),
        "{}",
        stderr(&message)
    );
    assert!(
        stderr(&message).contains("nowhere.json: "),
        "{}",
        stderr(&message)
    );
    let message = run_crumple(
        folder.path(),
        &format!("check cut.json '{good}' --format json"),
    );
    let verdicts = json_objects(&message);
    assert_eq!((exit_code(&message), verdicts.len()), (2, 2));
    assert_eq!(
        (&verdicts[0]["accepted"], &verdicts[1]["accepted"]),
        (&json!(true), &json!(false))
    );
    assert!(
        verdicts[1]["error"]
            .as_str()
            .unwrap()
            .starts_with("cut.json: is not a certificate"),
        "{}",
        verdicts[1]
    );
    // Verdicts come before errors.
    let message = run_crumple(
        folder.path(),
        &format!("check cut.json '{good}' --scenario paper-2"),
    );
    assert_prints(&message, 1, &["reach-paper-1.json: is NOT about paper-2: "]);
    assert!(
        !stdout(&message).contains(".json: accepted"),
        "{}",
        stdout(&message)
    );
    let message_line = stderr(&message).lines().last().unwrap();
    assert!(
        message_line.starts_with("failed: not about the scenario of --scenario: "),
        "{message_line}"
    );
}

#[test]
fn noise_that_is_not_assumed_is_noticed() {
    let folder = temp_folder();
    let noisy = built_in_scenario("paper-1")
        .unwrap()
        .edited(|spec| spec.vehicles[0].acceleration_noise_mps2 = 0.05)
        .unwrap();
    fs::write(
        folder.path().join("noisy.toml"),
        file::to_toml(&noisy).unwrap(),
    )
    .unwrap();
    run_ok(folder.path(), "avoid noisy.toml --certificate noisy.json");
    let check = |name: &str| {
        exit_code(&run_crumple(
            folder.path(),
            &format!("check {name} --scenario noisy.toml"),
        ))
    };
    assert_eq!(check("noisy.json"), 0);
    let mut silent = read_certificate(folder.path(), "noisy.json");
    assert_eq!(
        silent.assumptions.pop(),
        Some(crumple_verify::Assumption::NoiseOfSeed)
    );
    write_certificate(folder.path(), "silent.json", &silent);
    assert_eq!(check("silent.json"), 1);
    assert_eq!(
        exit_code(&run_crumple(folder.path(), "check silent.json")),
        1,
        "its own text says that there is noise"
    );
    silent.version = 1;
    (
        silent.provenance.scenario_text,
        silent.provenance.scenario_sha256,
    ) = (None, String::new());
    write_certificate(folder.path(), "old.json", &silent);
    assert_eq!(check("old.json"), 1);
}

#[test]
fn a_key_that_occurs_twice_is_no_certificate() {
    let folder = temp_folder();
    write_idm_count(folder.path(), "idm", "");
    let text = fs::read_to_string(folder.path().join("idm/certificate.json")).unwrap();
    for (name, from) in [
        ("controller", "\"controller\":"),
        ("version", "\"version\":"),
        ("failures", "\"failures\":"),
    ] {
        let doubled = text.replacen(from, &format!("{from} \"policy\", {from}"), 1);
        assert_ne!(doubled, text);
        fs::write(folder.path().join("twice.json"), doubled).unwrap();
        let message = run_crumple(folder.path(), "check twice.json");
        assert_eq!(exit_code(&message), 2, "{name}");
        assert!(
            stderr(&message).contains("twice.json: is not a certificate: "),
            "{}",
            stderr(&message)
        );
    }
    // Duplicate keys in a registration would let two contents share a digest.
    let registration = fs::read_to_string(folder.path().join("idm/registration.json")).unwrap();
    let doubled = registration.replacen(
        "\"controller\":",
        "\"controller\": \"policy\", \"controller\":",
        1,
    );
    assert!(
        serde_json::from_str::<Registration>(&doubled)
            .unwrap_err()
            .to_string()
            .contains("duplicate key")
    );
    assert_eq!(
        registration.parse::<Value>().unwrap()["block_runs"],
        json!(100)
    );
}

/// Checks that a report has the same assumptions as its text, and at least one.
fn assert_same_assumptions(report: &serde_json::Value, text: &str) {
    let lines = text.lines();
    let stated: Vec<&str> = lines
        .filter_map(|line| line.strip_prefix("  assuming that "))
        .collect();
    assert!(!stated.is_empty(), "{text}");
    assert_eq!(report["assumptions"], serde_json::json!(stated), "{report}");
}

#[test]
fn check_pools_counts_of_several_seeds() {
    let folder = temp_folder();
    for seed in 3..6 {
        let count = "verify rate --controller baseline --space high-risk --estimator truth --runs 200 --confidence 0.9";
        run_ok(
            folder.path(),
            &format!("{count} --seed {seed} --out rate-{seed}"),
        );
    }
    let pool =
        "check --pool rate-4/certificate.json rate-3/certificate.json rate-5/certificate.json";
    assert_prints(
        &run_crumple(folder.path(), &format!("{pool} --rerun")),
        0,
        &[
            "pool of 3 certificates: accepted: rate: at most ",
            "for the seeds 3 to 5 together",
            "in 600 runs",
            "confirmed: all 600 runs were drawn and simulated again",
            "600 random scenarios, seed 3 to 5",
            "this space is the built-in one of that name",
            "assuming that the range of seeds was fixed before the first run",
        ],
    );
    let sampled = run_ok(
        folder.path(),
        &format!("{pool} --rerun=30 --rerun-seed 1 --format json"),
    );
    let report = &json_objects(&sampled)[0];
    assert_eq!(
        (
            &report["seeds"],
            &report["runs"],
            &report["rerun"]["blocks"]
        ),
        (&serde_json::json!([3, 5]), &600.into(), &2.into()),
        "{report}"
    );
    assert_same_assumptions(report, stdout(&run_ok(folder.path(), pool)));
    let single = "check rate-3/certificate.json";
    let json = run_ok(folder.path(), &format!("{single} --format json"));
    assert_same_assumptions(
        &json_objects(&json)[0],
        stdout(&run_ok(folder.path(), single)),
    );
    assert_prints(
        &run_crumple(folder.path(), "check --pool rate-3/certificate.json"),
        0,
        &[
            "pool of 1 certificate: accepted: rate: at most ",
            " for seed 3, if",
        ],
    );
    let refused = "check --pool rate-3/certificate.json rate-5/certificate.json";
    assert_prints(
        &run_crumple(folder.path(), refused),
        1,
        &[
            "pool: rejected: the seeds 3 to 5 are incomplete: 1 seed is missing, the first of them is 4",
        ],
    );
    let twice = "check --pool rate-3/certificate.json rate-3/certificate.json --format json";
    let refused = run_crumple(folder.path(), twice);
    assert_eq!(exit_code(&refused), 1);
    let report = &json_objects(&refused)[0];
    assert_eq!(
        report["rejection"],
        "rate-3/certificate.json: seed 3 occurs twice"
    );
    // Other counts, whose sums and bound follow from them.
    let path = folder.path().join("rate-4/certificate.json");
    let mut forged = Certificate::from_json(&fs::read_to_string(&path).unwrap()).unwrap();
    let Statement::Rate(claim) = &mut forged.statement else {
        panic!("a rate")
    };
    claim.blocks[1].0 = 0;
    claim.failures = claim.blocks[0].0;
    claim.rate_at_most = 0.99;
    fs::write(&path, forged.to_canonical_json()).unwrap();
    assert_prints(
        &run_crumple(folder.path(), &format!("{pool} --rerun")),
        1,
        &["REFUTED", "blocks[1], runs 100 to 199 of seed 4: "],
    );
}

/// Every run of the seeds 1, 2, 4 and 5 fails. Without their certificates, the pool would end with seed 3.
#[test]
fn seeds_in_which_every_run_fails_are_pooled() {
    let folder = temp_folder();
    let count = "verify rate --controller baseline --space high-risk --estimator truth --runs 30 --confidence 0.9";
    let failures: Vec<u64> = (0..6)
        .map(|seed| {
            let count = format!("{count} --seed {seed} --out rate-{seed} --format json");
            let report = json_objects(&run_ok(folder.path(), &count)).remove(0);
            report["failures"].as_u64().unwrap()
        })
        .collect();
    assert_eq!(failures, [29, 30, 30, 29, 30, 30]);
    let files = |seeds: std::ops::Range<u64>| -> String {
        seeds
            .map(|seed| format!(" rate-{seed}/certificate.json"))
            .collect()
    };
    let pooled = format!(
        "check --pool --seeds 0-5 --rerun --format json{}",
        files(0..6)
    );
    let report = json_objects(&run_ok(folder.path(), &pooled)).remove(0);
    assert_eq!(report["failures"], 178, "{report}");
    assert_eq!(report["is_expected_range"], true, "{report}");
    // Root p of 1 - p¹⁸⁰ - 180 p¹⁷⁹ (1 - p) = 0.1.
    let bound = report["rate_at_most"].as_f64().unwrap();
    assert!((bound - 0.997041632322).abs() < 1e-8, "{report}");
    assert_prints(
        &run_crumple(folder.path(), &format!("check --pool{}", files(4..6))),
        0,
        &[
            "rate: no bound below 1 at confidence 0.9, for the seeds 4 to 5 together",
            "a first or last seed that was left out is noticed only if the expected range is given (--seeds)",
        ],
    );
    let missing = "pool: rejected: the seeds 0 to 5 are incomplete: 2 seeds are missing, the first of them is 4";
    let shorter = format!("check --pool --seeds 0-5{}", files(0..4));
    assert_prints(&run_crumple(folder.path(), &shorter), 1, &[missing]);
    let other = "rate-5/certificate.json: seed 5 is outside the expected range 0-4";
    let longer = format!("check --pool --seeds 0-4{}", files(0..6));
    assert_prints(&run_crumple(folder.path(), &longer), 1, &[other]);
    for (seeds, problem) in [
        ("5-0", "must be a range of seeds, such as 0-99"),
        ("x", "0-99"),
    ] {
        let refused = format!("check --pool --seeds {seeds}{}", files(0..1));
        assert_refused(&run_crumple(folder.path(), &refused), problem);
    }
    let alone = run_crumple(folder.path(), &format!("check --seeds 0-5{}", files(0..6)));
    assert_refused(&alone, "--pool");
}

#[test]
fn jobs_set_the_number_of_threads() {
    let folder = temp_folder();
    let threads = |arguments: &str, variables: &[(&str, &str)]| {
        let mut command = command(folder.path(), arguments);
        for name in ["RAYON_NUM_THREADS", "OMP_NUM_THREADS"] {
            command.env_remove(name);
        }
        let output = command.envs(variables.iter().copied()).output().unwrap();
        json_objects(&output)[0]["threads"].as_u64().unwrap()
    };
    let (rayon, open_mp) = (("RAYON_NUM_THREADS", "5"), ("OMP_NUM_THREADS", "4,2"));
    assert_eq!(
        threads("doctor --format json --jobs 3", &[rayon, open_mp]),
        3
    );
    assert_eq!(threads("doctor --format json", &[rayon, open_mp]), 5);
    assert_eq!(threads("doctor --format json", &[open_mp]), 4);
    let cores = std::thread::available_parallelism().unwrap().get() as u64;
    assert_eq!(threads("doctor --format json", &[]), cores);
    assert_refused(
        &run_crumple(folder.path(), "doctor --jobs 0"),
        "must be a whole number from 1 to 1024",
    );
    for (value, shown) in [("x\u{1b}", "x\\u001b"), ("1025", "1025")] {
        let mut unusable = command(folder.path(), "doctor");
        unusable.env("RAYON_NUM_THREADS", value);
        let problem =
            format!("RAYON_NUM_THREADS: must be a whole number from 0 to 1024, found `{shown}`");
        assert_refused(&unusable.output().unwrap(), &problem);
    }
}
