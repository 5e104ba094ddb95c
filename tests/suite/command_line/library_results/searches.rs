//! Results of searches: escapes, worst cases, campaigns, comparisons of methods, and failures on recorded drives.

use crumple_evidence::drives::DriveSet;
use crumple_evidence::{DriveSearch, MethodComparison};
use crumple_measure::Specification;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignReport};
use crumple_search::worst_case::{
    AttackObjective, AttackReport, AvoidOptions, AvoidReport, Envelope, SensorAttackReport, attack,
    attack_sensors, avoid,
};

use super::*;
use crate::command_line::drives::platoon_csv;

/// The verdicts of the two scenarios differ.
#[test]
fn escapes_and_their_absence() {
    let folder = temp_folder();
    let fast = find_scenario("paper-1").edited(|spec| spec.vehicles[1].speed_mps = 40.0);
    let fast = fast.unwrap();
    let text = crumple_sim::scenario::file::to_toml(&fast).unwrap();
    fs::write(folder.path().join("fast.toml"), text).unwrap();
    let cases = [("paper-1", find_scenario("paper-1")), ("fast.toml", fast)];
    let verdicts = cases.map(|(name, scenario)| {
        let options = AvoidOptions {
            certify_bound: true,
            ..AvoidOptions::default()
        };
        let avoidance = avoid(&scenario, options).unwrap();
        let report = AvoidReport::new(&scenario, &avoidance);
        assert_same(
            folder.path(),
            &format!("avoid {name}"),
            &LibraryResult::new(&report, report.to_text()),
        );
        avoidance.verdict.class()
    });
    assert_ne!(verdicts[0], verdicts[1]);
}

#[test]
fn worst_case_of_braking() {
    let folder = temp_folder();
    let scenario = find_scenario("paper-1");
    let controller = find_controller("idm");
    let envelope = Envelope {
        jerk_mps3: Envelope::DEFAULT_JERK_MPS3,
        ..Envelope::from_scenario(&scenario)
    };
    let (aim, budget) = (AttackObjective::Mildest, 200);
    let result = attack(
        &scenario,
        &run_options("idm"),
        aim,
        envelope,
        budget,
        &Quiet,
    )
    .unwrap();
    let report = AttackReport::new(
        "paper-1",
        &controller,
        EstimatorKind::Kalman,
        aim,
        budget,
        &result,
    );
    assert_same(
        folder.path(),
        "worst-case paper-1 --controller idm --budget 200",
        &LibraryResult::new(&report, report.to_text()),
    );
}

#[test]
fn worst_case_of_sensor_faults() {
    let folder = temp_folder();
    let result = attack_sensors(&find_scenario("paper-1"), &run_options("idm"), &Quiet).unwrap();
    let report = SensorAttackReport::new("paper-1", "idm", &result);
    assert_same(
        folder.path(),
        "worst-case paper-1 --controller idm --attack sensors",
        &LibraryResult::new(&report, report.to_text()),
    );
}

#[test]
fn a_campaign() {
    let folder = temp_folder();
    let mut campaign = Campaign::new(find_controller("match-leader"), find_space("high-risk"));
    campaign.search.budget = 60;
    campaign.seed = 3;
    let summary = run_study(&campaign);
    assert!(summary.falsified);
    assert_same_study(
        folder.path(),
        0,
        "falsify --controller match-leader --budget 60 --seed 3 --out found",
        &LibraryResult::new(&CampaignReport::new(&summary), summary.to_text()),
    );
}

#[test]
fn a_comparison_of_methods() {
    let folder = temp_folder();
    let mut campaign = Campaign::new(find_controller("match-leader"), find_space("high-risk"));
    campaign.search.budget = 20;
    let methods = ["uniform", "cma-es"].map(|name| name.parse::<Method>().unwrap());
    let compared = MethodComparison::run(&campaign, &methods, 2, &Quiet).unwrap();
    assert_same(
        folder.path(),
        "falsify --controller match-leader --compare uniform,cma-es --seeds 2 --budget 20",
        &LibraryResult::new(&compared, compared.to_text()),
    );
}

#[test]
fn failures_on_recorded_drives() {
    let folder = temp_folder();
    fs::write(folder.path().join("platoon.csv"), platoon_csv()).unwrap();
    run_ok(folder.path(), "import platoon.csv --whole --out drives");
    let path = folder.path().join("drives");
    let drives = DriveSet::load(&path, &crumple_controllers::Controllers::default()).unwrap();
    let formula = "always v1.speed_mps > 25";
    let specification =
        Specification::parse(formula, &drives.drives().first().unwrap().scenario).unwrap();
    let report = DriveSearch::run(
        &drives,
        ("idm", run_options("idm")),
        (formula, &specification),
        &Quiet,
    )
    .unwrap();
    assert!(!report.failures.is_empty());
    assert_same(
        folder.path(),
        &format!(
            "falsify --controller idm --drives {} --spec '{formula}' --out found",
            quote(&path)
        ),
        &LibraryResult::new(&report, report.to_text()),
    );
}
