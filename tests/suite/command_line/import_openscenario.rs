//! `crumple import F.xosc` on the command line.

use super::*;

#[test]
fn exports_are_imported_and_damaged_files_are_refused_with_one_line() {
    let folder = temp_folder();
    run_ok(
        folder.path(),
        "export paper-3 --to openscenario --as actions --out .",
    );
    let imported = run_ok(folder.path(), "import paper-3.xosc --out scenarios");
    assert_eq!(stdout(&imported), "scenarios/paper-3.toml\n");
    run_ok(folder.path(), "simulate scenarios/paper-3.toml");
    run_ok(
        folder.path(),
        "export scenarios/paper-3.toml --to openscenario --as actions --out again",
    );
    let read = |file: &str| fs::read_to_string(folder.path().join(file)).unwrap();
    let good = read("paper-3.xosc");
    assert_eq!(
        (&good, read("paper-3.xodr")),
        (&read("again/paper-3.xosc"), read("again/paper-3.xodr"))
    );

    let lines: Vec<&str> = good.lines().collect();
    // Cut anywhere, without a line, or with a number that is none.
    let cut = (1..=100).map(|part| good[..good.len() * part / 101].to_owned());
    let is_tag =
        |line: &&str| line.trim_start().starts_with("</") || line.trim_end().ends_with("\">");
    let without = (0..lines.len())
        .filter(|&gone| is_tag(&lines[gone]))
        .map(|gone| {
            lines
                .iter()
                .enumerate()
                .filter(|(index, _)| *index != gone)
                .map(|(_, line)| format!("{line}\n"))
                .collect()
        });
    let storyboard = good.find("<Storyboard").expect("a storyboard");
    let numbers = good
        .match_indices("value=\"")
        .filter(|(at, _)| *at > storyboard);
    let misspelt = numbers.map(|(at, found)| {
        format!(
            "{}x{}",
            &good[..at + found.len()],
            &good[at + found.len()..]
        )
    });
    let damaged: Vec<String> = cut.chain(without).chain(misspelt).collect();
    assert!(damaged.len() >= 200, "{}", damaged.len());
    for text in damaged {
        fs::write(folder.path().join("damaged.xosc"), &text).unwrap();
        assert_refused(
            &run_crumple(folder.path(), "import damaged.xosc --out damaged"),
            "damaged.xosc:",
        );
    }
    assert!(!folder.path().join("damaged").exists());

    assert_refused(
        &run_crumple(folder.path(), "import paper-3.xosc --ego Unknown"),
        "there is no entity `Unknown`",
    );
    assert_refused(
        &run_crumple(folder.path(), "import paper-3.xosc other.csv"),
        "give an OpenSCENARIO file alone",
    );
    assert_refused(
        &run_crumple(folder.path(), "import other.csv --ego a"),
        "apply only to a file F.xosc",
    );
    assert_reports(
        &run_crumple(folder.path(), "import none.xosc"),
        2,
        "none.xosc",
    );
    fs::create_dir(folder.path().join("folder.xosc")).unwrap();
    assert_refused(
        &run_crumple(folder.path(), "import folder.xosc"),
        "folder.xosc: is not a regular file",
    );
    fs::remove_file(folder.path().join("paper-3.xodr")).unwrap();
    // Without its road, the file still states a line of vehicles.
    let roadless = run_crumple(folder.path(), "import paper-3.xosc --out roadless");
    assert_reports(
        &roadless,
        0,
        "paper-3.xosc:7: LogicFile: is missing, and no position states a lane",
    );
}

#[test]
fn variations_that_violate_constraints_are_counted() {
    let folder = temp_folder();
    run_ok(
        folder.path(),
        "export paper-1 --to openscenario --as actions --out .",
    );
    let text = fs::read_to_string(folder.path().join("paper-1.xosc")).unwrap();
    let declared = r#"<ParameterDeclarations><ParameterDeclaration name="speed" parameterType="double" value="20">
<ConstraintGroup><ValueConstraint rule="lessThan" value="22"/></ConstraintGroup></ParameterDeclaration>
</ParameterDeclarations>"#;
    let first_speed = text.find("<AbsoluteTargetSpeed value=\"").expect("a speed");
    let end = first_speed + text[first_speed..].find("/>").expect("ends");
    let text = format!(
        "{}<AbsoluteTargetSpeed value=\"$speed\"{}",
        &text[..first_speed],
        &text[end..]
    );
    fs::write(
        folder.path().join("f.xosc"),
        text.replace("<ParameterDeclarations/>", declared),
    )
    .unwrap();
    let distribution = r#"<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="" author="" description=""/>
<ParameterValueDistribution><ScenarioFile filepath="f.xosc"/><Deterministic>
<DeterministicSingleParameterDistribution parameterName="speed"><DistributionRange stepWidth="0.5">
<Range lowerLimit="20" upperLimit="23"/></DistributionRange></DeterministicSingleParameterDistribution>
</Deterministic></ParameterValueDistribution></OpenSCENARIO>"#;
    fs::write(folder.path().join("d.xosc"), distribution).unwrap();
    let done = run_ok(
        folder.path(),
        "import f.xosc --distribution d.xosc --out varied",
    );
    assert_eq!(stdout(&done), "varied: 4 scenarios\n");
    assert!(
        stderr(&done).contains("f.xosc: 3 combinations of values violate the constraints"),
        "{done:?}"
    );
    assert_refused(
        &run_crumple(folder.path(), "import d.xosc"),
        "d.xosc:1: OpenSCENARIO: is a file of distributions",
    );
    let reverse = run_crumple(folder.path(), "import f.xosc --distribution f.xosc");
    assert_refused(
        &reverse,
        "f.xosc:2: OpenSCENARIO: is a scenario, not a file of distributions",
    );
    let second = fs::read_to_string(folder.path().join("varied/paper-1-00002.toml")).unwrap();
    assert!(
        second.contains("speed = 20.5") && second.contains("speed_mps = 20.5"),
        "{second}"
    );
}
