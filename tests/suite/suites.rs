//! Test suites modelled on regulations: parameters, files, verdicts and margins.

use std::path::Path;

use crumple_controllers::Controllers;
use crumple_sim::control::stateless;
use crumple_sim::engine::{NamedController, RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{LaneChange, Scenario};
use crumple_suites::{
    ControllerResult, LeadManeuver, MarginEnd, Origin, ParameterKind, ParameterUnit, Prevention,
    ReferenceRun, SHIPPED_SUITES, SweepFailure, TestParameter, TestSuite, TestVerdict,
    UNSHIPPED_DOCUMENTS, WarningOrigin, json_schema, run,
};

use crate::command_line::{
    assert_refused, exit_code, run_crumple, run_ok, run_on_threads, stdout, temp_folder,
};
use crate::schema::{assert_committed, validate};
use crate::tiny::{assert_contains, replace_passages};

/// A parameter in a document: suite, test, kind, all values or the smallest and the largest, unit.
type StatedParameter = (
    &'static str,
    &'static str,
    ParameterKind,
    &'static [f64],
    ParameterUnit,
);

/// Parameters of the documents, transcribed independently of the suites' files.
const STATED_PARAMETERS: [StatedParameter; 131] = {
    use ParameterKind::{
        AllowedDeceleration, ApproachTime, ClosingTime, Deceleration, Gap, LeadSpeed,
        ManualClosingTime, ManualDeceleration, ManualDelay, OwnSpeed, Ramp, TimeGap,
    };
    use ParameterUnit::{Gravity, Kmph, Metre, Mps2, Second};
    [
        // 49 CFR 571.127: table 1 to S7.1, S7.3.3(b), S9.1, S9.2, S9.3, S5.3 and S10.
        ("fmvss-127", "stopped-lead", OwnSpeed, &[10.0, 80.0], Kmph),
        ("fmvss-127", "stopped-lead", ClosingTime, &[5.0], Second),
        (
            "fmvss-127",
            "stopped-lead-manual",
            OwnSpeed,
            &[70.0, 100.0],
            Kmph,
        ),
        (
            "fmvss-127",
            "stopped-lead-manual",
            ClosingTime,
            &[5.0],
            Second,
        ),
        ("fmvss-127", "slower-lead", OwnSpeed, &[40.0, 80.0], Kmph),
        ("fmvss-127", "slower-lead", LeadSpeed, &[20.0], Kmph),
        ("fmvss-127", "slower-lead", ClosingTime, &[5.0], Second),
        (
            "fmvss-127",
            "slower-lead-manual",
            OwnSpeed,
            &[70.0, 100.0],
            Kmph,
        ),
        ("fmvss-127", "slower-lead-manual", LeadSpeed, &[20.0], Kmph),
        (
            "fmvss-127",
            "slower-lead-manual",
            ClosingTime,
            &[5.0],
            Second,
        ),
        ("fmvss-127", "decelerating-lead-50", OwnSpeed, &[50.0], Kmph),
        (
            "fmvss-127",
            "decelerating-lead-50",
            LeadSpeed,
            &[50.0],
            Kmph,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50",
            Gap,
            &[12.0, 40.0],
            Metre,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50",
            Deceleration,
            &[0.3, 0.5],
            Gravity,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50",
            Ramp,
            &[0.0, 1.5],
            Second,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50-manual",
            OwnSpeed,
            &[50.0],
            Kmph,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50-manual",
            LeadSpeed,
            &[50.0],
            Kmph,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50-manual",
            Gap,
            &[12.0, 40.0],
            Metre,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50-manual",
            Deceleration,
            &[0.3, 0.5],
            Gravity,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50-manual",
            Ramp,
            &[0.0, 1.5],
            Second,
        ),
        ("fmvss-127", "decelerating-lead-80", OwnSpeed, &[80.0], Kmph),
        (
            "fmvss-127",
            "decelerating-lead-80",
            LeadSpeed,
            &[80.0],
            Kmph,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80",
            Gap,
            &[12.0, 40.0],
            Metre,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80",
            Deceleration,
            &[0.3, 0.5],
            Gravity,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80",
            Ramp,
            &[0.0, 1.5],
            Second,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80-manual",
            OwnSpeed,
            &[80.0],
            Kmph,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80-manual",
            LeadSpeed,
            &[80.0],
            Kmph,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80-manual",
            Gap,
            &[12.0, 40.0],
            Metre,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80-manual",
            Deceleration,
            &[0.3, 0.5],
            Gravity,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80-manual",
            Ramp,
            &[0.0, 1.5],
            Second,
        ),
        (
            "fmvss-127",
            "stopped-lead-manual",
            ManualDeceleration,
            &[0.4],
            Gravity,
        ),
        (
            "fmvss-127",
            "stopped-lead-manual",
            ManualDelay,
            &[1.0],
            Second,
        ),
        (
            "fmvss-127",
            "slower-lead-manual",
            ManualDeceleration,
            &[0.4],
            Gravity,
        ),
        (
            "fmvss-127",
            "slower-lead-manual",
            ManualDelay,
            &[1.0],
            Second,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50-manual",
            ManualDeceleration,
            &[0.4],
            Gravity,
        ),
        (
            "fmvss-127",
            "decelerating-lead-50-manual",
            ManualDelay,
            &[1.0],
            Second,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80-manual",
            ManualDeceleration,
            &[0.4],
            Gravity,
        ),
        (
            "fmvss-127",
            "decelerating-lead-80-manual",
            ManualDelay,
            &[1.0],
            Second,
        ),
        ("fmvss-127", "steel-plate", OwnSpeed, &[80.0], Kmph),
        ("fmvss-127", "steel-plate", ApproachTime, &[5.0], Second),
        (
            "fmvss-127",
            "steel-plate",
            AllowedDeceleration,
            &[0.25],
            Gravity,
        ),
        ("fmvss-127", "steel-plate-manual", OwnSpeed, &[80.0], Kmph),
        (
            "fmvss-127",
            "steel-plate-manual",
            ApproachTime,
            &[5.0],
            Second,
        ),
        (
            "fmvss-127",
            "steel-plate-manual",
            AllowedDeceleration,
            &[0.25],
            Gravity,
        ),
        (
            "fmvss-127",
            "steel-plate-manual",
            ManualDeceleration,
            &[0.4],
            Gravity,
        ),
        (
            "fmvss-127",
            "steel-plate-manual",
            ManualClosingTime,
            &[1.1],
            Second,
        ),
        ("fmvss-127", "pass-through", OwnSpeed, &[80.0], Kmph),
        ("fmvss-127", "pass-through", ApproachTime, &[5.0], Second),
        (
            "fmvss-127",
            "pass-through",
            AllowedDeceleration,
            &[0.25],
            Gravity,
        ),
        ("fmvss-127", "pass-through-manual", OwnSpeed, &[80.0], Kmph),
        (
            "fmvss-127",
            "pass-through-manual",
            ApproachTime,
            &[5.0],
            Second,
        ),
        (
            "fmvss-127",
            "pass-through-manual",
            AllowedDeceleration,
            &[0.25],
            Gravity,
        ),
        (
            "fmvss-127",
            "pass-through-manual",
            ManualDeceleration,
            &[0.4],
            Gravity,
        ),
        (
            "fmvss-127",
            "pass-through-manual",
            ManualClosingTime,
            &[1.1],
            Second,
        ),
        // Euro NCAP AEB car-to-car, 4.3.1.
        ("euro-ncap-2023", "ccrs", OwnSpeed, &[10.0, 50.0], Kmph),
        ("euro-ncap-2023", "ccrm", OwnSpeed, &[30.0, 80.0], Kmph),
        ("euro-ncap-2023", "ccrm", LeadSpeed, &[20.0], Kmph),
        ("euro-ncap-2023", "ccrb", OwnSpeed, &[50.0], Kmph),
        ("euro-ncap-2023", "ccrb", Gap, &[12.0, 40.0], Metre),
        ("euro-ncap-2023", "ccrb", Deceleration, &[2.0, 6.0], Mps2),
        // Euro NCAP's Rating Calculator 2026, 5.4.9: sheet `FC - Car & PTW pred.`, rows 3 to 38, and
        // robustness_layer.py.
        (
            "euro-ncap-2026",
            "ccrs",
            OwnSpeed,
            &[10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0],
            Kmph,
        ),
        (
            "euro-ncap-2026",
            "ccrm",
            OwnSpeed,
            &[30.0, 40.0, 50.0, 60.0, 70.0, 80.0],
            Kmph,
        ),
        ("euro-ncap-2026", "ccrm", LeadSpeed, &[20.0], Kmph),
        ("euro-ncap-2026", "ccrm-90", OwnSpeed, &[90.0], Kmph),
        ("euro-ncap-2026", "ccrm-90", LeadSpeed, &[30.0], Kmph),
        ("euro-ncap-2026", "ccrm-100", OwnSpeed, &[100.0], Kmph),
        ("euro-ncap-2026", "ccrm-100", LeadSpeed, &[40.0], Kmph),
        ("euro-ncap-2026", "ccrm-110", OwnSpeed, &[110.0], Kmph),
        ("euro-ncap-2026", "ccrm-110", LeadSpeed, &[50.0], Kmph),
        ("euro-ncap-2026", "ccrm-120", OwnSpeed, &[120.0], Kmph),
        ("euro-ncap-2026", "ccrm-120", LeadSpeed, &[60.0], Kmph),
        ("euro-ncap-2026", "ccrm-130", OwnSpeed, &[130.0], Kmph),
        ("euro-ncap-2026", "ccrm-130", LeadSpeed, &[70.0], Kmph),
        (
            "euro-ncap-2026",
            "ccrb",
            OwnSpeed,
            &[
                30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0,
            ],
            Kmph,
        ),
        ("euro-ncap-2026", "ccrb", TimeGap, &[1.0], Second),
        ("euro-ncap-2026", "ccrb", Deceleration, &[4.0], Mps2),
        (
            "euro-ncap-2026",
            "ccrb-headway",
            OwnSpeed,
            &[30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0],
            Kmph,
        ),
        (
            "euro-ncap-2026",
            "ccrb-headway",
            TimeGap,
            &[0.5, 1.5],
            Second,
        ),
        ("euro-ncap-2026", "ccrb-headway", Deceleration, &[4.0], Mps2),
        (
            "euro-ncap-2026",
            "ccrb-deceleration",
            OwnSpeed,
            &[30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0],
            Kmph,
        ),
        (
            "euro-ncap-2026",
            "ccrb-deceleration",
            TimeGap,
            &[1.0],
            Second,
        ),
        (
            "euro-ncap-2026",
            "ccrb-deceleration",
            Deceleration,
            &[2.0, 6.0],
            Mps2,
        ),
        // Euro NCAP's Rating Calculator 2026, sheet `VA - ACC pred.`, rows 3 to 10, 25 to 39, 48, 52 and 53.
        (
            "euro-ncap-2026",
            "acc-ccrs",
            OwnSpeed,
            &[60.0, 70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0],
            Kmph,
        ),
        (
            "euro-ncap-2026",
            "acc-ccrm-20",
            OwnSpeed,
            &[60.0, 70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0],
            Kmph,
        ),
        ("euro-ncap-2026", "acc-ccrm-20", LeadSpeed, &[20.0], Kmph),
        (
            "euro-ncap-2026",
            "acc-ccrm-60",
            OwnSpeed,
            &[70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0],
            Kmph,
        ),
        ("euro-ncap-2026", "acc-ccrm-60", LeadSpeed, &[60.0], Kmph),
        ("euro-ncap-2026", "acc-cut-in-120", OwnSpeed, &[120.0], Kmph),
        ("euro-ncap-2026", "acc-cut-in-120", LeadSpeed, &[70.0], Kmph),
        (
            "euro-ncap-2026",
            "acc-cut-in-120",
            ClosingTime,
            &[1.5],
            Second,
        ),
        (
            "euro-ncap-2026",
            "acc-cut-out",
            OwnSpeed,
            &[50.0, 70.0],
            Kmph,
        ),
        ("euro-ncap-2026", "acc-cut-out", ClosingTime, &[3.0], Second),
        // UN R152, 02 series: 5.2.1.4, then the test speeds of 6.4 and 6.5 with their tolerances.
        (
            "un-r152",
            "table",
            OwnSpeed,
            &[10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 42.0],
            Kmph,
        ),
        ("un-r152", "table-45", OwnSpeed, &[45.0], Kmph),
        ("un-r152", "table-50", OwnSpeed, &[50.0], Kmph),
        ("un-r152", "table-55", OwnSpeed, &[55.0], Kmph),
        ("un-r152", "table-60", OwnSpeed, &[60.0], Kmph),
        ("un-r152", "stationary-20", OwnSpeed, &[20.0, 22.0], Kmph),
        ("un-r152", "stationary-42", OwnSpeed, &[40.0, 42.0], Kmph),
        ("un-r152", "stationary-60", OwnSpeed, &[60.0], Kmph),
        ("un-r152", "moving-30", OwnSpeed, &[30.0, 32.0], Kmph),
        ("un-r152", "moving-30", LeadSpeed, &[20.0], Kmph),
        ("un-r152", "moving-60", OwnSpeed, &[58.0, 60.0], Kmph),
        ("un-r152", "moving-60", LeadSpeed, &[20.0], Kmph),
        // UN R157, 5.2.3.3: speed in km/h, time gap in s.
        ("un-r157", "following-7", OwnSpeed, &[7.2], Kmph),
        ("un-r157", "following-7", TimeGap, &[1.0], Second),
        ("un-r157", "following-10", OwnSpeed, &[10.0], Kmph),
        ("un-r157", "following-10", TimeGap, &[1.1], Second),
        ("un-r157", "following-20", OwnSpeed, &[20.0], Kmph),
        ("un-r157", "following-20", TimeGap, &[1.2], Second),
        ("un-r157", "following-30", OwnSpeed, &[30.0], Kmph),
        ("un-r157", "following-30", TimeGap, &[1.3], Second),
        ("un-r157", "following-40", OwnSpeed, &[40.0], Kmph),
        ("un-r157", "following-40", TimeGap, &[1.4], Second),
        ("un-r157", "following-50", OwnSpeed, &[50.0], Kmph),
        ("un-r157", "following-50", TimeGap, &[1.5], Second),
        ("un-r157", "following-60", OwnSpeed, &[60.0], Kmph),
        ("un-r157", "following-60", TimeGap, &[1.6], Second),
        // UN R157, 5.2.5.2, by its formula.
        ("un-r157", "cut-in-10", ClosingTime, &[0.582], Second),
        ("un-r157", "cut-in-20", ClosingTime, &[0.813], Second),
        ("un-r157", "cut-in-30", ClosingTime, &[1.045], Second),
        ("un-r157", "cut-in-40", ClosingTime, &[1.276], Second),
        ("un-r157", "cut-in-50", ClosingTime, &[1.508], Second),
        ("un-r157", "cut-in-60", ClosingTime, &[1.739], Second),
        // UN R157, Annex 3.
        ("un-r157", "cut-out", TimeGap, &[2.0], Second),
        // AFGBV.
        ("afgbv-cut-in", "cut-in-10", ClosingTime, &[0.48], Second),
        ("afgbv-cut-in", "cut-in-20", ClosingTime, &[0.71], Second),
        ("afgbv-cut-in", "cut-in-30", ClosingTime, &[0.94], Second),
        ("afgbv-cut-in", "cut-in-40", ClosingTime, &[1.18], Second),
        ("afgbv-cut-in", "cut-in-50", ClosingTime, &[1.41], Second),
        ("afgbv-cut-in", "cut-in-60", ClosingTime, &[1.64], Second),
    ]
};

/// Allowed impact speeds in km/h: UN R152, 5.2.1.4, M1 in running order.
const ALLOWED_IMPACTS: [(&str, &str, f64); 5] = [
    ("un-r152", "table-45", 15.0),
    ("un-r152", "table-50", 25.0),
    ("un-r152", "table-55", 30.0),
    ("un-r152", "table-60", 35.0),
    ("un-r152", "stationary-60", 35.0),
];

fn shipped_suite(name: &str) -> TestSuite {
    TestSuite::shipped(name).expect("shipped").expect("valid")
}

#[test]
fn figures_that_a_document_states_are_those_of_a_second_transcription() {
    let (mut stated, mut allowed) = (0, 0);
    for (name, _) in SHIPPED_SUITES {
        for test in shipped_suite(name)
            .spec()
            .clauses
            .iter()
            .flat_map(|clause| &clause.tests)
        {
            for (parameter, figure) in test
                .parameters
                .iter()
                .filter(|(_, figure)| figure.origin != Origin::Chosen)
            {
                let rows = STATED_PARAMETERS
                    .iter()
                    .filter(|row| (row.0, row.1, row.2) == (name, test.name.as_str(), parameter));
                let rows: Vec<_> = rows.collect();
                let context = format!("{name}, {}, {parameter:?}", test.name);
                let [row] = rows[..] else {
                    panic!("{context}: {rows:?}")
                };
                assert_eq!(row.4, figure.unit, "{context}");
                match figure.origin {
                    Origin::Document => assert_eq!(row.3, figure.values, "{context}"),
                    _ => {
                        let [first, between @ .., last] = &figure.values[..] else {
                            panic!("{context}")
                        };
                        assert!(!between.is_empty() && row.3 == [*first, *last], "{context}");
                    }
                }
                stated += 1;
            }
            if let Some(limit) = &test.impact_at_most {
                let row = ALLOWED_IMPACTS
                    .iter()
                    .find(|row| (row.0, row.1) == (name, test.name.as_str()));
                assert_eq!(
                    row.map(|row| (row.2, ParameterUnit::Kmph)),
                    Some((limit.value, limit.unit)),
                    "{name}, {}",
                    test.name
                );
                allowed += 1;
            }
        }
    }
    assert_eq!(
        (stated, allowed),
        (STATED_PARAMETERS.len(), ALLOWED_IMPACTS.len()),
        "nothing is transcribed that no suite has"
    );
}

/// 49 CFR 571.127: speeds within 1.6 km/h (S7.3.2(d), S7.4.2(d), S7.5.2(b), S9.2.2(c), S9.3.2(c)), the delay of manual
/// braking within 0.1 s (S7.3.3(b)). No other value has a tolerance, and the driver holds the speed in each test.
#[test]
fn tolerances_of_fmvss_127_are_those_of_the_rule() {
    let suite = shipped_suite("fmvss-127");
    for test in suite.spec().clauses.iter().flat_map(|clause| &clause.tests) {
        assert!(test.holds_speed, "{}", test.name);
        for (parameter, figure) in test.parameters.iter() {
            let expected = match parameter {
                ParameterKind::OwnSpeed | ParameterKind::LeadSpeed => 1.6,
                ParameterKind::ManualDelay => 0.1,
                _ => 0.0,
            };
            assert_eq!(figure.tolerance, expected, "{}, {parameter:?}", test.name);
        }
    }
}

/// UN R157, 5.2.5.2: the suite has the values of the formula, to the millisecond, rounded to the stated side. The
/// AFGBV's table is 0.1 s less, to its last digit.
#[test]
fn times_of_cut_ins_are_those_of_their_formula() {
    for (suite, reaction_s, digit_s) in [("un-r157", 0.35, 1e-3), ("afgbv-cut-in", 0.25, 1e-2)] {
        let suite = shipped_suite(suite);
        let tests = suite.spec().clauses.iter().flat_map(|clause| &clause.tests);
        let cut_ins: Vec<_> = tests
            .filter(|test| test.lead == Some(LeadManeuver::CutIn))
            .collect();
        assert_eq!(cut_ins.len(), 6);
        for (test, slower_kmph) in cut_ins
            .into_iter()
            .zip([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
        {
            let first = |figure: &Option<TestParameter>| figure.as_ref().unwrap().values[0];
            let figures = &test.parameters;
            assert_eq!(
                first(&figures.own_speed) - first(&figures.lead_speed),
                slower_kmph,
                "{}",
                test.name
            );
            let over_s =
                first(&figures.closing_time) - (slower_kmph / 3.6 / (2.0 * 6.0) + reaction_s);
            match digit_s < 5e-3 {
                true => assert!((0.0..digit_s).contains(&over_s), "{}: {over_s}", test.name),
                false => assert!(over_s.abs() <= digit_s / 2.0, "{}: {over_s}", test.name),
            }
        }
    }
}

#[test]
fn the_committed_suite_schema_matches_the_types_and_accepts_shipped_suites() {
    let schema = json_schema();
    assert_committed("crates/suites/src/suite.schema.json", &schema);
    for (name, text) in SHIPPED_SUITES {
        let value: serde_json::Value = toml::from_str(text).unwrap();
        validate(&schema, &schema, &value, name).unwrap();
    }
    for nonsense in [
        serde_json::json!({}),
        serde_json::json!({ "version": 1, "speed": 3 }),
        serde_json::json!([]),
    ] {
        assert!(validate(&schema, &schema, &nonsense, "nonsense").is_err());
    }
}

pub(crate) const OWN_SUITE: &str = r#"version = 1
name = "own"
about = "A vehicle that stands."
document = "None"
edition = "First"
parameter_source = "Nothing."

[[clauses]]
clause = "1"
summary = "Touch nothing."

[[clauses.tests]]
name = "stands"
lead = "stopped"
margins = [{ parameter = "own_speed", to = 100.0 }, { parameter = "closing_time", to = 0.5 }]
parameters.own_speed = { values = [36.0, 50.0], unit = "km/h", origin = "chosen" }
parameters.closing_time = { values = [5.0], unit = "s", origin = "chosen" }
"#;

pub(crate) fn load_suite(text: &str) -> Result<TestSuite, String> {
    TestSuite::from_toml(text, Path::new("own.toml")).map_err(|error| error.to_string())
}

/// Returns the result of the first test of a suite, with true states.
pub(crate) fn first_result(suite: &TestSuite, controller: &str) -> ControllerResult {
    let result = run(suite, &[find_controller(controller)], EstimatorKind::Truth).unwrap();
    result.clauses[0].tests[0].controllers[0].clone()
}

pub(crate) fn find_controller(name: &str) -> NamedController {
    Controllers::default().find(name, Path::new("")).unwrap()
}

/// The failed seeds of a point are those with which its scenario ends in a collision.
#[test]
fn the_worst_of_several_seeds_counts_for_a_controller_that_acts_at_random() {
    let car = "emergency-brake,standing_miss_share=0.3";
    let suite = load_suite(OWN_SUITE).unwrap();
    let tested = first_result(&suite, car);
    assert_eq!((tested.seeds, tested.failed_points.len()), (10, 2));
    let options = RunOptions::new(find_controller(car).source).with_estimator(EstimatorKind::Truth);
    let collides = |scenario: &Scenario| {
        let run = Run::new(scenario, options.clone()).unwrap();
        simulate(&run, RecordingLevel::Summary)
            .outcome
            .collision()
            .is_some()
    };
    for failed in &tested.failed_points {
        let scenario = failed.scenario.as_ref().unwrap();
        assert!(collides(scenario), "{}", failed.scenario_name);
        let collisions = (0..10).filter(|&seed| {
            let seeded = scenario.edited(|spec| spec.seed = seed);
            collides(&seeded.unwrap())
        });
        assert_eq!(failed.failed_seeds, Some(collisions.count() as u32));
    }
    let idm = first_result(&suite, "idm");
    assert_eq!(idm.seeds, 1);
    assert!(!serde_json::to_string(&idm).unwrap().contains("seeds"));
    let stated = |seeds: &str| {
        load_suite(&OWN_SUITE.replace(
            "\n\n[[clauses]]",
            &format!("\nseeds = {seeds}\n\n[[clauses]]"),
        ))
    };
    assert_eq!(first_result(&stated("3").unwrap(), "idm").seeds, 3);
    for seeds in ["0", "101"] {
        let message = format!("own.toml:7: seeds: must be from 1 to 100, found {seeds}");
        assert_eq!(stated(seeds).unwrap_err(), message);
    }
}

#[test]
fn bad_suites_are_refused_by_file_line_and_field() {
    for (from, to, message) in [
        (
            "version = 1",
            "version = 2",
            "own.toml:1: version: version 2 is not supported",
        ),
        (
            "\"own\"",
            "\"../own\"",
            "own.toml:2: name: must be 1 to 60 lower-case letters",
        ),
        (
            "None",
            "a\\u001bb",
            "own.toml:4: document: must have 1 to 2000 characters",
        ),
        (
            "\"stopped\"",
            "\"flying\"",
            "own.toml:14: clauses[0].tests[0].lead: unknown variant `flying`",
        ),
        (
            "lead = \"stopped\"\n",
            "",
            "own.toml:12: clauses[0].tests[0]: a test must have either `lead` or `refusal_reason`",
        ),
        (
            "\"stopped\"",
            "\"slower\"",
            "clauses[0].tests[0].parameters.lead_speed: is missing: a test with lead = slower needs it",
        ),
        (
            "lead = \"stopped\"",
            "lead = \"stopped\"\nparameters.gap = { values = [9.0], unit = \"m\", origin = \"chosen\" }",
            "own.toml:15: clauses[0].tests[0].parameters.gap: is not allowed in a test with lead = stopped",
        ),
        (
            "[36.0, 50.0]",
            "[50.0, 36.0]",
            "own.toml:16: clauses[0].tests[0].parameters.own_speed.values[1]: must increase",
        ),
        (
            "[36.0, 50.0]",
            "[]",
            "own.toml:16: clauses[0].tests[0].parameters.own_speed.values: must have 1 to 100 entries",
        ),
        (
            "[36.0, 50.0]",
            "[nan]",
            "own_speed.values[0]: must be from 1.8 to 360 km/h, found NaN",
        ),
        (
            "unit = \"s\"",
            "unit = \"m\"",
            "own.toml:17: clauses[0].tests[0].parameters.closing_time.unit: closing time cannot",
        ),
        (
            "to = 100.0",
            "to = 40.0",
            "own.toml:15: clauses[0].tests[0].margins[0].to: must lie beyond all values of own speed",
        ),
        (
            "lead = \"stopped\"",
            "lead = \"stopped\"\nranges = [\"closing_time\"]",
            "own.toml:15: clauses[0].tests[0].ranges[0]: closing time needs two different values",
        ),
        (
            "lead = \"stopped\"",
            "lead = \"stopped\"\nimpact_at_most = { value = -1.0, unit = \"km/h\", origin = \"chosen\" }",
            "own.toml:15: clauses[0].tests[0].impact_at_most.value: must be above 0 and at most 360 km/h, found -1",
        ),
        (
            "lead = \"stopped\"",
            "lead = \"stopped\"\nimpact_at_most = { value = 9.0, unit = \"s\", origin = \"chosen\" }",
            "own.toml:15: clauses[0].tests[0].impact_at_most.unit: an impact speed cannot be stated in s",
        ),
        (
            "\"stopped\"",
            "\"decelerating\"",
            "parameters.closing_time: is not allowed in a test with lead = decelerating",
        ),
        (
            "parameter = \"own_speed\"",
            "parameter = \"gap\"",
            "own.toml:15: clauses[0].tests[0].margins[0].parameter: is not allowed",
        ),
        (
            "lead = \"stopped\"",
            "lead = \"stopped\"\nparameters.manual_delay = { values = [1.0], unit = \"s\", origin = \"chosen\" }",
            "clauses[0].tests[0].parameters.manual_deceleration: is missing: a test with `manual_delay` needs it",
        ),
        (
            "lead = \"stopped\"",
            "lead = \"ghost\"\nparameters.approach_time = { values = [5.0], unit = \"s\", origin = \"chosen\" }\n\
            parameters.ghost_time = { values = [1.0], unit = \"s\", origin = \"chosen\" }",
            "parameters: `closing_time` and `manual_closing_time` must be less than `approach_time`",
        ),
        (
            "edition",
            "editon",
            "own.toml:5: editon: unknown field `editon`",
        ),
        ("[[clauses]]", "[clauses]", ": clauses"),
    ] {
        let error = load_suite(&replace_passages(OWN_SUITE, &[(from, to)])).unwrap_err();
        assert!(error.contains(message), "{to}: {error}");
    }
    let values: Vec<_> = (0..100).map(|index| format!("{}.0", 36 + index)).collect();
    let many = replace_passages(
        OWN_SUITE,
        &[("[36.0, 50.0]", &format!("[{}]", values.join(",")))],
    );
    let times: Vec<_> = (0..100).map(|index| format!("5.{index:03}")).collect();
    let many = replace_passages(&many, &[("[5.0]", &format!("[{}]", times.join(",")))]);
    let error = load_suite(&many).unwrap_err();
    assert!(
        error.contains("makes 10000 points, and a suite may have at most 2000"),
        "{error}"
    );
}

/// The baseline brakes at 7.5 m/s² below a TTC of 1.4 s: v²/15 = 1.4 v at 75.6 km/h, and a step later at 75.06 km/h.
#[test]
fn a_margin_ends_where_its_closed_form_does() {
    let tested = first_result(&load_suite(OWN_SUITE).unwrap(), "baseline");
    assert_eq!(
        (&tested.verdict, tested.passed_points, tested.points),
        (&TestVerdict::Passed, 2, 2)
    );
    let MarginEnd::Boundary {
        passes_at,
        fails_at,
        is_monotone,
        ..
    } = tested.margins[0].end
    else {
        panic!("{:?}", tested.margins);
    };
    assert!(
        (75.0..fails_at).contains(&passes_at) && fails_at < 75.7 && is_monotone,
        "{passes_at} {fails_at}"
    );
    assert!(fails_at - passes_at < 0.03);
}

/// With collisions up to 36 km/h allowed: v² - 2 · 7.5 · 1.4 v = 10² at v = 25.0 m/s, and a step of 10 ms later at 24.9
/// m/s.
#[test]
fn an_allowed_collision_passes_and_moves_the_margin_by_its_closed_form() {
    let allowed = "lead = \"stopped\"\nimpact_at_most = { value = 36.0, unit = \"km/h\", origin = \"document\" }";
    let text = replace_passages(
        OWN_SUITE,
        &[
            ("lead = \"stopped\"", allowed),
            ("50.0]", "80.0]"),
            ("to = 100.0", "to = 110.0"),
        ],
    );
    let tested = first_result(&load_suite(&text).unwrap(), "baseline");
    assert_eq!(
        (
            &tested.verdict,
            tested.passed_points,
            tested.failed_points.len()
        ),
        (&TestVerdict::Passed, 2, 0)
    );
    assert!(
        tested.min_gap_m.unwrap() <= 0.0,
        "at 80 km/h there is a collision"
    );
    let MarginEnd::Boundary { passes_at, .. } = tested.margins[0].end else {
        panic!("{:?}", tested.margins)
    };
    let closed_form_kmph = |delay_s: f64| {
        let way_s = 1.4 - delay_s;
        3.6 * (7.5 * way_s + ((7.5 * way_s).powi(2) + 100.0).sqrt())
    };
    assert!(
        (closed_form_kmph(0.01) - 0.1..=closed_form_kmph(0.0)).contains(&passes_at),
        "{passes_at}"
    );
    let strict = replace_passages(&text, &[("value = 36.0", "value = 1.0")]);
    let tested = first_result(&load_suite(&strict).unwrap(), "baseline");
    assert!(tested.verdict.is_failure(), "it is faster than 1 km/h");
}

/// A gap is a length or a time headway; exactly one is stated.
#[test]
fn a_gap_is_stated_as_a_length_or_as_a_time_and_once() {
    let text = OWN_SUITE
        .replace("\"stopped\"", "\"decelerating\"")
        .replace("margins = ", "margins = [] # ")
        .replace(
            "parameters.closing_time = { values = [5.0], unit = \"s\", origin = \"chosen\" }",
            "parameters.deceleration = { values = [4.0], unit = \"m/s2\", origin = \"chosen\" }\n\
         parameters.ramp = { values = [0.0], unit = \"s\", origin = \"chosen\" }\nGAP",
        );
    let text = text.replace("[36.0, 50.0]", "[36.0]");
    let gap = "parameters.gap = { values = [12.0], unit = \"m\", origin = \"chosen\" }\n";
    let time = "parameters.time_gap = { values = [1.2], unit = \"s\", origin = \"chosen\" }\n";
    let load = |gap: &str| load_suite(&text.replace("GAP", gap));
    let tested = |gap: &str| first_result(&load(gap).unwrap(), "match-leader");
    let (by_length, by_time) = (tested(gap), tested(time));
    assert_eq!(by_length.verdict, by_time.verdict);
    assert!((by_length.min_gap_m.unwrap() - by_time.min_gap_m.unwrap()).abs() < 1e-9);
    for (gap, message) in [
        (
            "",
            "parameters.gap: is missing: a test with lead = decelerating needs it, or `time_gap`",
        ),
        (
            &format!("{gap}{time}"),
            "parameters.time_gap: repeats `gap`: state only one of them",
        ),
    ] {
        let error = load(gap).unwrap_err();
        assert!(error.contains(message), "{error}");
    }
}

/// Both sides of every boundary have their verdicts when simulated again.
#[test]
fn both_sides_of_a_margin_are_confirmed() {
    let suite = shipped_suite("euro-ncap-2023");
    let mut boundaries = 0;
    for controller in ["policy", "acc-aeb", "baseline"] {
        let named = [find_controller(controller)];
        let result = run(&suite, &named, EstimatorKind::Kalman).unwrap();
        for (clause, test) in result.tests() {
            for margin in &test.controllers[0].margins {
                let MarginEnd::Boundary {
                    passes_at,
                    fails_at,
                    ..
                } = margin.end
                else {
                    continue;
                };
                boundaries += 1;
                for (value, passes) in [(passes_at, true), (fails_at, false)] {
                    let mut spec = suite.spec().clone();
                    spec.clauses.retain(|other| other.clause == clause.clause);
                    let test = &mut spec.clauses[0].tests[0];
                    test.margins.clear();
                    let mut figures = serde_json::to_value(&test.parameters).unwrap();
                    figures[margin.parameter.name()]["values"] = serde_json::json!([value]);
                    for (parameter, figure) in test.parameters.iter() {
                        let held = |value: f64| {
                            margin
                                .fixed_parameters
                                .contains(&format!("{} {value} ", parameter.label()))
                        };
                        if parameter != margin.parameter {
                            let only: Vec<_> = figure
                                .values
                                .iter()
                                .copied()
                                .filter(|&value| held(value))
                                .collect();
                            assert_eq!(only.len(), 1, "{}", margin.fixed_parameters);
                            figures[parameter.name()]["values"] = serde_json::json!(only);
                        }
                    }
                    test.parameters = serde_json::from_value(figures).unwrap();
                    let again = run(
                        &TestSuite::new(spec).unwrap(),
                        &named,
                        EstimatorKind::Kalman,
                    )
                    .unwrap();
                    assert_eq!(
                        again.clauses[0].tests[0].controllers[0].verdict.is_passed(),
                        passes,
                        "{margin:?}"
                    );
                }
            }
        }
    }
    assert!(boundaries >= 6, "{boundaries}");
}

#[test]
fn failures_name_preventing_drivers_and_refusals_their_reason() {
    let mut spec = shipped_suite("fmvss-127").spec().clone();
    let used = [
        "stopped-lead",
        "decelerating-lead-80",
        "steel-plate",
        "pass-through-manual",
    ];
    spec.clauses.iter_mut().for_each(|clause| {
        clause.tests.retain(|test| used.contains(&&*test.name));
        let later = clause.tests.iter_mut().filter(|test| test.name != used[0]);
        later.for_each(|test| test.margins.clear());
    });
    spec.clauses.retain(|clause| !clause.tests.is_empty());
    let suite = TestSuite::new(spec).unwrap();
    let result = run(
        &suite,
        &[find_controller("full-throttle"), find_controller("idm")],
        EstimatorKind::Truth,
    )
    .unwrap();
    let test = |name: &str| {
        &result
            .tests()
            .find(|(_, test)| test.name == name)
            .unwrap()
            .1
            .controllers
    };
    let stopped = &test("stopped-lead")[0];
    assert!(
        matches!(stopped.verdict, TestVerdict::Failed { impact_speed_mps, .. } if impact_speed_mps > 20.0)
    );
    assert_eq!((stopped.passed_points, stopped.failed_points.len()), (0, 8));
    assert!(stopped.margins.iter().all(|margin| margin.end
        == MarginEnd::None {
            failure: SweepFailure::Fails
        }));
    let does = |index: usize, driver: &str| {
        stopped.failed_points[index]
            .references
            .iter()
            .find(|run| run.driver == driver)
            .unwrap()
            .prevention
    };
    // From 2 s on the competent human stops from 50 km/h, and not from 80 km/h.
    assert_eq!(
        [4, 7].map(|index| does(index, "competent-human")),
        [Prevention::Prevents, Prevention::Collides]
    );
    assert_eq!(
        (does(0, "r157-simple"), does(0, "rss")),
        (Prevention::Prevents, Prevention::Prevents)
    );
    assert_eq!(
        stopped.failed_points[0].avoidability.is_avoidable(),
        Some(true)
    );
    assert!(test("decelerating-lead-80")[1].verdict.is_passed(), "idm");
    for name in ["steel-plate", "pass-through-manual"] {
        for tested in test(name) {
            assert!(
                matches!(&tested.verdict, TestVerdict::Refused { reason } if reason.contains("ignores the sensors"))
            );
        }
    }
    let alone = run(&suite, &[find_controller("idm")], EstimatorKind::Truth).unwrap();
    assert_eq!(
        alone.clauses[0].tests[0].controllers[0],
        test("stopped-lead")[1],
        "for any other controller"
    );
}

#[test]
fn every_situation_is_the_one_that_its_figures_say() {
    for (name, _) in SHIPPED_SUITES {
        for test in shipped_suite(name)
            .spec()
            .clauses
            .iter()
            .flat_map(|clause| &clause.tests)
        {
            let Some(lead) = test.lead else { continue };
            for point in test.grid() {
                let scenario = test.scenario("point", "", &point).unwrap();
                let [.., ahead, own] = scenario.vehicles() else {
                    panic!("two vehicles")
                };
                let value = |parameter| {
                    let stated = test
                        .parameters
                        .iter()
                        .zip(&point)
                        .find(|((found, _), _)| *found == parameter);
                    stated
                        .map(|((_, figure), value)| value * figure.unit.si_factor())
                        .unwrap()
                };
                let gap_m = ahead.position_m - ahead.length_m() - own.position_m;
                assert!((own.speed_mps - value(ParameterKind::OwnSpeed)).abs() < 1e-12);
                let closing_mps = own.speed_mps - ahead.speed_mps;
                let gap_stated_m = || match test.parameters.gap {
                    Some(_) => value(ParameterKind::Gap),
                    None => value(ParameterKind::TimeGap) * own.speed_mps,
                };
                match lead {
                    LeadManeuver::Ghost | LeadManeuver::PassThrough => {
                        let ghost = scenario.spec().sensors.faults.ghost.unwrap();
                        let reached_s = ghost.gap_m / own.speed_mps;
                        assert!(
                            (reached_s - value(ParameterKind::ClosingTime)).abs() < 1e-12
                                && closing_mps == 0.0
                        );
                        assert_eq!(
                            (ghost.speed_mps, ghost.duration_s),
                            (0.0, value(ParameterKind::GhostTime))
                        );
                        let approach_s = value(ParameterKind::ApproachTime);
                        assert!((ghost.onset_s + reached_s - approach_s).abs() < 1e-12);
                    }
                    LeadManeuver::Decelerating => {
                        // The own speed, unless the test states another.
                        let lead_mps = match test.parameters.lead_speed {
                            Some(_) => value(ParameterKind::LeadSpeed),
                            None => own.speed_mps,
                        };
                        assert_eq!(ahead.speed_mps, lead_mps);
                        assert!((gap_m - gap_stated_m()).abs() < 1e-9, "{gap_m}");
                    }
                    LeadManeuver::CutOut => {
                        let revealed = &scenario.vehicles()[0];
                        let to_it_m = revealed.position_m - revealed.length_m() - ahead.position_m;
                        assert_eq!(
                            (closing_mps, revealed.speed_mps, ahead.leaves),
                            (0.0, 0.0, Some(LaneChange::At(0.01)))
                        );
                        assert!((gap_m - gap_stated_m()).abs() < 1e-9, "{gap_m}");
                        let leaves_m = to_it_m - 0.01 * ahead.speed_mps;
                        assert!(
                            (leaves_m / ahead.speed_mps - value(ParameterKind::ClosingTime)).abs()
                                < 1e-9,
                            "{to_it_m}"
                        );
                    }
                    LeadManeuver::CutIn => {
                        assert_eq!(
                            (ahead.speed_mps, ahead.enters),
                            (value(ParameterKind::LeadSpeed), Some(LaneChange::At(0.0)))
                        );
                        assert!(
                            (gap_m / closing_mps - value(ParameterKind::ClosingTime)).abs() < 1e-12
                        );
                    }
                    _ => assert!(
                        (gap_m / closing_mps - value(ParameterKind::ClosingTime)).abs() < 1e-12
                    ),
                }
            }
        }
    }
}

/// The worst case within the ranges of a clause is at least about as bad as its grid, and replays.
#[test]
fn the_worst_within_a_clause_is_no_better_than_its_grid() {
    let mut spec = shipped_suite("fmvss-127").spec().clone();
    spec.clauses.retain(|clause| clause.clause == "S7.5");
    spec.clauses[0]
        .tests
        .retain(|test| test.name == "decelerating-lead-80-manual");
    let suite = TestSuite::new(spec).unwrap();
    let drivers = ["match-leader", "idm", "acc-aeb", "constant-brake"].map(find_controller);
    let result = run(&suite, &drivers, EstimatorKind::Truth).unwrap();
    let test = &result.clauses[0].tests[0];
    for (tested, driver) in test.controllers.iter().zip(&drivers) {
        let within = tested
            .worst_in_tolerance
            .as_ref()
            .expect("the clause has ranges");
        assert_eq!(within.points_run, 256 + 5 * 48);
        let impact_mps = |verdict: &TestVerdict| match verdict {
            TestVerdict::Failed {
                impact_speed_mps, ..
            } => *impact_speed_mps,
            _ => 0.0,
        };
        assert!(
            impact_mps(&within.verdict) > impact_mps(&tested.verdict) - 0.3,
            "{}: {within:?}",
            tested.controller
        );
        if let (true, Some(gap_m), Some(grid_m)) =
            (tested.is_passed(), within.min_gap_m, tested.min_gap_m)
        {
            assert!(
                gap_m < grid_m + 0.3,
                "{}: {gap_m} {grid_m}",
                tested.controller
            );
        }
        if let Some(failed) = &within.failed_point {
            let scenario = failed.scenario.as_ref().unwrap();
            let driver = find_controller(&failed.with_test_driver(&driver.name));
            let options = RunOptions::new(driver.source).with_estimator(EstimatorKind::Truth);
            let again = simulate(
                &Run::new(scenario, options).unwrap(),
                RecordingLevel::Summary,
            );
            let collision = again.outcome.collision().expect("replays");
            assert_eq!(collision.impact_speed_mps, impact_mps(&within.verdict));
            let gap_m = scenario.initial_gap_m(1).unwrap();
            assert!((12.0..=40.0).contains(&gap_m));
        }
    }
    assert_eq!(
        run(&suite, &drivers[1..2], EstimatorKind::Truth)
            .unwrap()
            .clauses[0]
            .tests,
        {
            let mut alone = result.clauses[0].tests.clone();
            alone
                .iter_mut()
                .for_each(|test| test.controllers = vec![test.controllers[1].clone()]);
            alone
        }
    );
}

/// S7.5.3(a) lets the lead reach its deceleration in any time up to 1.5 s. This controller, which holds 80 km/h before
/// it brakes, collides only behind ramps shorter than that.
#[test]
fn a_ramp_within_the_clause_fails_though_the_longest_passes() {
    let verdicts = |ramp_s: &[f64]| {
        let mut spec = shipped_suite("fmvss-127").spec().clone();
        spec.clauses.retain(|clause| clause.clause == "S7.5");
        spec.clauses[0]
            .tests
            .retain(|test| test.name == "decelerating-lead-80");
        let test = &mut spec.clauses[0].tests[0];
        test.margins.clear();
        test.parameters.own_speed.as_mut().unwrap().tolerance = 0.0;
        test.parameters.lead_speed.as_mut().unwrap().tolerance = 0.0;
        test.parameters.ramp.as_mut().unwrap().values = ramp_s.to_vec();
        test.ranges
            .retain(|range| *range != ParameterKind::Ramp || ramp_s.len() > 1);
        let controller = find_controller("acc-aeb,ttc_s=1.157,set_speed_mps=22.2222");
        let result = run(
            &TestSuite::new(spec).unwrap(),
            &[controller],
            EstimatorKind::Kalman,
        )
        .unwrap();
        let tested = &result.clauses[0].tests[0].controllers[0];
        [
            tested.verdict.is_passed(),
            tested
                .worst_in_tolerance
                .as_ref()
                .unwrap()
                .verdict
                .is_passed(),
        ]
    };
    assert_eq!(verdicts(&[1.5]), [true, true]);
    assert_eq!(verdicts(&[0.0, 1.5]), [true, false]);
}

/// The competent human of UN R157 brakes for vehicles that cut in, and prevents every collision where one cuts out.
#[test]
fn the_competent_human_reacts_to_vehicles_that_change_lanes() {
    let mut spec = shipped_suite("un-r157").spec().clone();
    spec.clauses
        .iter_mut()
        .flat_map(|clause| &mut clause.tests)
        .for_each(|test| test.margins.clear());
    let suite = TestSuite::new(spec).unwrap();
    for estimator in EstimatorKind::ALL {
        let result = run(&suite, &[find_controller("competent-human")], estimator).unwrap();
        for (_, test) in result.tests() {
            let tested = &test.controllers[0];
            if test.name.starts_with("cut-in") {
                let brakes = |run: &ReferenceRun| {
                    run.driver == "competent-human" && run.prevention == Prevention::Collides
                };
                assert!(
                    tested
                        .failed_points
                        .iter()
                        .all(|failed| failed.references.iter().any(brakes)),
                    "{}",
                    test.name
                );
            } else if test.name == "cut-out" {
                assert!(
                    tested.verdict.is_passed(),
                    "{estimator:?}: {:?}",
                    tested.verdict
                );
            }
        }
    }
}

/// Delayed braking behind a vehicle that cuts in Δv slower collides within a time to collision of Δv / (2 b) + τ; the
/// driver decides at the first step after the entry, and the delay is in whole steps.
#[test]
fn a_cut_in_fails_as_the_closed_form_predicts() {
    let mut spec = shipped_suite("afgbv-cut-in").spec().clone();
    for (test, slower_mps) in spec
        .clauses
        .iter_mut()
        .flat_map(|clause| &mut clause.tests)
        .zip([10.0, 20.0, 30.0].map(|v| v / 3.6))
    {
        test.parameters.closing_time.as_mut().unwrap().values = vec![slower_mps / 12.0 + 0.5];
    }
    let result = run(
        &TestSuite::new(spec).unwrap(),
        &[find_controller("r157-simple")],
        EstimatorKind::Truth,
    )
    .unwrap();
    for ((_, test), slower_mps) in result.tests().zip([10.0, 20.0, 30.0].map(|v| v / 3.6)) {
        let tested = &test.controllers[0];
        assert!(tested.verdict.is_passed(), "{}", test.name);
        let MarginEnd::Boundary {
            passes_at,
            fails_at,
            ..
        } = tested.margins[0].end
        else {
            panic!("{}", test.name)
        };
        let needed_s = slower_mps / 12.0 + 0.35;
        assert!(
            passes_at - fails_at < 0.001 && (needed_s..needed_s + 0.011).contains(&passes_at),
            "{needed_s} {passes_at}"
        );
    }
}

/// A late cut-out reveals a standing vehicle: no driver can stop in the remaining distance.
#[test]
fn own_suites_cut_in_and_out() {
    let suite = TestSuite::load(Path::new("examples/suites/lane-changes.toml")).unwrap();
    let result = run(
        &suite,
        &[find_controller("acc-aeb"), find_controller("full-throttle")],
        EstimatorKind::Kalman,
    )
    .unwrap();
    for (_, test) in result.tests() {
        assert!(test.controllers[0].verdict.is_passed(), "{}", test.name);
        assert!(
            test.controllers[1].verdict.is_failure() && test.controllers[1].passed_points == 0,
            "{}",
            test.name
        );
    }
    // The ego vehicle has the stated speed at the event, even if its controller prefers less.
    let held_back = run(
        &suite,
        &[find_controller("idm,desired_speed_mps=5")],
        EstimatorKind::Truth,
    )
    .unwrap();
    let clauses = held_back.clauses.iter().flat_map(|clause| &clause.tests);
    assert!(
        clauses
            .flat_map(|test| &test.controllers)
            .all(|tested| tested.points > 0 && !tested.verdict.is_refusal())
    );
}

#[test]
fn a_run_is_the_same_on_one_thread_and_on_two_and_each_failure_replays() {
    let folder = temp_folder();
    let run = |threads: &str, arguments: &str| {
        let asked = "suite run euro-ncap-2023 --controller full-throttle";
        run_on_threads(folder.path(), threads, &format!("{asked} {arguments}"))
    };
    let json = run("1", "--controller policy --format json");
    assert_eq!(exit_code(&json), 0);
    assert_eq!(
        json.stdout,
        run("2", "--controller policy --format json").stdout
    );
    let message: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert!(
        message["statement"]
            .as_str()
            .unwrap()
            .contains("no certification")
    );

    let text = run("2", "--out failures --expect passed");
    assert_eq!(exit_code(&text), 1);
    let replay = stdout(&text)
        .lines()
        .find_map(|line| line.trim().strip_prefix("crumple "))
        .expect("a replay");
    run_ok(folder.path(), &format!("{replay} --expect collision"));
    let junit = run("2", "--format junit");
    assert_contains(stdout(&junit), &["<failure message=\"FAILED, collision"]);
}

#[test]
fn listed_suites_are_shown_as_valid_suites() {
    let folder = temp_folder();
    let list = run_crumple(folder.path(), "suite list");
    for (name, _) in SHIPPED_SUITES {
        assert_contains(
            stdout(&list),
            &[name, "no certification", UNSHIPPED_DOCUMENTS[0].0],
        );
        let shown = run_crumple(folder.path(), &format!("show {name} --kind suite")).stdout;
        std::fs::write(folder.path().join("copy.toml"), &shown).unwrap();
        assert_eq!(
            TestSuite::load(&folder.path().join("copy.toml")).unwrap(),
            shipped_suite(name)
        );
    }
    for (arguments, message) in [
        ("suite run no-such --controller idm", "neither a suite"),
        ("suite run no-such.toml --controller idm", "no-such.toml"),
        ("suite run fmvss-127", "--controller"),
    ] {
        assert_refused(&run_crumple(folder.path(), arguments), message);
    }
}

/// The baseline brakes for ghosts that are near for long enough, and passes where it reacts to none.
#[test]
fn false_activation_is_tested_with_ghosts() {
    let mut spec = shipped_suite("fmvss-127").spec().clone();
    spec.clauses
        .retain(|clause| clause.clause.starts_with("S9"));
    let suite = TestSuite::new(spec).unwrap();
    let result = run(
        &suite,
        &[find_controller("baseline")],
        EstimatorKind::Kalman,
    )
    .unwrap();
    for (_, test) in result.tests() {
        let tested = &test.controllers[0];
        let has_driver = test.name.ends_with("-manual");
        assert!(
            matches!(tested.verdict, TestVerdict::Braked { is_beyond_manual, .. } if is_beyond_manual == has_driver),
            "{tested:?}"
        );
        let fails = |ghost: &str| {
            let mut points = tested.failed_points.iter();
            points.any(|failed| failed.point.contains(ghost))
        };
        assert!(fails("closing time 1 s, ghost time 1 s"), "{}", test.name);
        assert!(!fails("closing time 4 s"), "{}", test.name);
    }
}

/// Commands a constant braking, with the test of the steel plate and a driver.
fn verdict_of_constant_braking(brake_mps2: f64) -> TestVerdict {
    let mut spec = shipped_suite("fmvss-127").spec().clone();
    spec.clauses.retain(|clause| clause.clause == "S9.2");
    spec.clauses[0]
        .tests
        .retain(|test| test.name == "steel-plate-manual");
    spec.clauses[0].tests[0].margins.clear();
    // The speed falls at once, so that the driver brakes later than at 3.9 s.
    let source = stateless(move |_| -brake_mps2);
    let controllers = [NamedController::from_source("constant", source)];
    let suite = TestSuite::new(spec).unwrap();
    let result = run(&suite, &controllers, EstimatorKind::Kalman).unwrap();
    result.clauses[0].tests[0].controllers[0].verdict.clone()
}

/// S5.3: 0.25 g beyond manual braking fails, whenever it occurs. Manual braking itself, 0.4 g, adds nothing.
#[test]
fn manual_braking_is_no_false_activation() {
    let g = 9.806_65;
    assert_eq!(verdict_of_constant_braking(0.0), TestVerdict::Passed);
    assert_eq!(verdict_of_constant_braking(0.249 * g), TestVerdict::Passed);
    let TestVerdict::Braked {
        max_brake_mps2,
        is_beyond_manual: true,
    } = verdict_of_constant_braking(0.251 * g)
    else {
        panic!("0.251 g");
    };
    assert!(
        (max_brake_mps2 - 0.251 * g).abs() < 1e-9,
        "{max_brake_mps2}"
    );
}

/// Manual braking from 1 s after the reference warning, alone, against its closed form: from TTC 2.1 s the vehicle
/// closes in for 1 s, then brakes at 0.4 g, reached linearly in 0.25 s.
#[test]
fn manual_braking_alone_hits_at_the_speed_of_its_closed_form() {
    let mut spec = shipped_suite("fmvss-127").spec().clone();
    spec.clauses.retain(|clause| clause.clause == "S7.3");
    spec.clauses[0]
        .tests
        .retain(|test| test.name == "stopped-lead-manual");
    spec.clauses[0].tests[0].margins.clear();
    let controllers = [NamedController::from_source("coasting", stateless(|_| 0.0))];
    let suite = TestSuite::new(spec).unwrap();
    let result = run(&suite, &controllers, EstimatorKind::Truth).unwrap();
    let tested = &result.clauses[0].tests[0].controllers[0];
    assert_eq!(tested.warning, Some(WarningOrigin::Reference));
    assert_eq!(tested.failed_points.len(), 4);
    for (failed, speed_kmph) in tested.failed_points.iter().zip([70.0, 80.0, 90.0, 100.0]) {
        let (brake_mps2, ramp_s) = (0.4 * 9.806_65, 0.25_f64);
        let speed_mps: f64 = speed_kmph / 3.6;
        let way_m = 1.1 * speed_mps;
        // During the ramp: speed v - b r / 2 and way v r - b r² / 6.
        let after_mps = speed_mps - brake_mps2 * ramp_s / 2.0;
        let rest_m = way_m - (speed_mps * ramp_s - brake_mps2 * ramp_s * ramp_s / 6.0);
        let impact_mps = (after_mps * after_mps - 2.0 * brake_mps2 * rest_m).sqrt();
        let found_mps = failed.verdict.impact_speed_mps();
        // Each of the steps of 10 ms may be one late.
        let late_mps = 3.0 * 0.01 * brake_mps2 * speed_mps / impact_mps;
        assert!(
            (impact_mps..impact_mps + late_mps).contains(&found_mps),
            "{speed_kmph}: {found_mps}, {impact_mps}"
        );
    }
}
