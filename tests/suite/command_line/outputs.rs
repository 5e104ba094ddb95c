//! Destinations of results, and work that commands refuse.

use super::*;

/// A link stays and its target is written; anything but a plain file is refused.
#[cfg(unix)]
#[test]
fn single_results_go_through_links_and_into_files_only() {
    use std::os::unix::fs::symlink;
    let folder = temp_folder();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("elsewhere")).unwrap();
    fs::write(at("elsewhere/target.csv"), "old").unwrap();
    symlink("elsewhere/target.csv", at("link.csv")).unwrap();
    symlink("elsewhere/nothing.csv", at("dangling.csv")).unwrap();
    symlink("/dev/null", at("null.csv")).unwrap();
    let simulate =
        |trace: &str| run_crumple(folder.path(), &format!("simulate paper-1 --trace {trace}"));
    assert_eq!(exit_code(&simulate("link.csv")), 0);
    assert!(
        at("link.csv").is_symlink()
            && fs::read_to_string(at("elsewhere/target.csv"))
                .unwrap()
                .contains("time_s")
    );
    assert_refused(
        &simulate("dangling.csv"),
        "dangling.csv: the target of this symbolic link cannot be resolved",
    );
    assert_refused(&simulate("null.csv"), "null.csv: is not a regular file");
    assert!(at("null.csv").is_symlink() && !Path::new("/dev/null").is_file());
    assert_eq!(file_names_in(&at("elsewhere")), ["target.csv"]);
    symlink("elsewhere/escape.toml", at("escape.toml")).unwrap();
    fs::write(at("elsewhere/escape.toml"), "old").unwrap();
    run_ok(folder.path(), "avoid paper-1 --out escape.toml");
    assert!(
        at("escape.toml").is_symlink()
            && fs::read_to_string(at("elsewhere/escape.toml")).unwrap() != "old"
    );
}

fn platoon_toml(vehicles: usize, duration_s: f64) -> String {
    let vehicle = |index: usize, driver: &str| {
        let position_m = 30.0 * (vehicles - index) as f64;
        format!(
            "[[vehicles]]\nclass = \"light\"\nposition_m = {position_m}\nspeed_mps = 20.0\n{driver}\n"
        )
    };
    let leader = vehicle(0, "driver.brake = { onset_s = 1.0, rate_mps2 = 3.0 }");
    let others: String = (1..=vehicles)
        .map(|index| vehicle(index, "driver = \"under-test\""))
        .collect();
    format!("version = 1\nname = \"line\"\nduration_s = {duration_s:?}\n{leader}{others}")
}

/// Refused immediately, with the limit.
#[test]
fn excessive_work_is_refused_at_the_start() {
    let folder = temp_folder();
    let cases = [
        (
            "avoid",
            1,
            600.0,
            "1 vehicles under test over 60000 steps are too many: the limits are 20 vehicles and 50000",
        ),
        (
            "avoid",
            21,
            2.0,
            "21 vehicles under test over 200 steps are too many: the limits are 20 vehicles and 50000",
        ),
        (
            "worst-case --controller idm",
            50,
            500.0,
            "51 vehicles over 50000 steps are too many: the limit is 500000",
        ),
        (
            "worst-case --controller idm --budget 1000000",
            1,
            600.0,
            "1000000 simulations of 2 vehicles over 60000 steps are too many: the limit is 20000000000 vehicles times \
             steps in all, which allows 166666",
        ),
        ("simulate", 100, 600.0, "duration_s: asks for"),
        (
            "simulate",
            1000,
            1.0,
            "vehicles: must have 2 to 1000 vehicles, found 1001",
        ),
    ];
    for (command, vehicles, duration_s, expected) in cases {
        fs::write(
            folder.path().join("line.toml"),
            platoon_toml(vehicles, duration_s),
        )
        .unwrap();
        let begun = std::time::Instant::now();
        assert_refused(
            &run_crumple(folder.path(), &format!("{command} line.toml")),
            expected,
        );
        assert!(
            begun.elapsed().as_secs() < 20,
            "{command} took {:?}",
            begun.elapsed()
        );
    }
    let deep = format!("{}v1.gap_m > 0{}", "(".repeat(50_000), ")".repeat(50_000));
    assert_refused(
        &run_crumple(folder.path(), &format!("simulate paper-1 --spec '{deep}'")),
        "more than 4000 words and signs",
    );
    let nots = "not ".repeat(3000) + "v1.gap_m > 0";
    assert_refused(
        &run_crumple(folder.path(), &format!("simulate paper-1 --spec '{nots}'")),
        "more than 64",
    );
}

#[cfg(unix)]
#[test]
fn an_interrupted_assessment_names_the_command_to_resume() {
    let folder = temp_folder();
    let arguments = "assess --out report";
    let child = spawn(folder.path(), arguments);
    let kept = folder.path().join("report/evidence");
    // The handler is set once the folder exists.
    while !kept.exists() {
        sleep(Duration::from_millis(10));
    }
    sleep(Duration::from_millis(300));
    assert_refused(
        &run_crumple(folder.path(), arguments),
        "error: report/evidence: another assessment uses this folder",
    );
    let text =
        "interrupted: the evidence computed so far is in report/evidence: the same command resumes";
    assert_reports(&interrupt(child), 130, text);
}
