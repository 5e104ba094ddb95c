use crumple_sim::scenario::NoDriverFiles;
use std::path::Path;

use proptest::prelude::*;

use super::*;
use crumple_measure::UsefulnessMeasures;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate_batch};
use crumple_sim::scenario::{Driver, GhostObject, LeadProfile, PaperDistribution, SensorFaults};

fn space(name: &str) -> ScenarioSpace {
    built_in_space(name).expect("built in")
}

/// Creates a space over `paper-1` with these parameters.
fn over_paper_1(parameters: &str) -> Result<ScenarioSpace, String> {
    let text = format!("version = 1\nname = \"s\"\nbase = \"paper-1\"\n{parameters}");
    file::from_toml(&text, Path::new("s.toml"), &NoDriverFiles).map_err(|error| error.to_string())
}

fn parameter(field: &str, unit: &str, distribution: &str) -> String {
    let name: String = field.chars().filter(char::is_ascii_alphanumeric).collect();
    format!(
        "[[parameters]]\nname = \"{name}\"\nfield = \"{field}\"\nunit = \"{unit}\"\n{distribution}\n"
    )
}

#[test]
fn built_in_spaces_are_valid_and_their_nominal_scenario_is_the_base() {
    for name in built_in_space_names() {
        let space = space(name);
        assert_eq!(space.name(), name);
        let Base::Inline(base) = &space.spec().base else {
            panic!("spelled out")
        };
        let nominal = space.scenario(&space.nominal()).unwrap();
        for (vehicle, expected) in nominal.vehicles().iter().zip(&base.vehicles) {
            assert!((vehicle.position_m - expected.position_m).abs() < 1e-12);
            assert_eq!(vehicle.driver.name(), expected.driver.name());
            assert!((vehicle.mass_kg() - expected.mass_kg()).abs() < 1e-9);
            assert_eq!(vehicle.max_brake_mps2(), expected.max_brake_mps2());
        }
        let text = file::to_toml(&space).unwrap();
        let restored = file::from_toml(&text, Path::new("again.toml"), &NoDriverFiles).unwrap();
        assert_eq!(restored.draw(1, 2), space.draw(1, 2), "{text}");
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Every point is a valid scenario, and values map to a point and back.
    #[test]
    fn every_point_is_a_scenario(
        point in prop::collection::vec(prop_oneof![Just(0.0), Just(1.0), 0.0..1.0f64], 20),
        (seed, index) in any::<(u64, u64)>(),
    ) {
        for name in built_in_space_names() {
            let space = space(name);
            let point = &point[..space.dimension()];
            let scenario = space.scenario_at(point).unwrap();
            prop_assert!(scenario.has_vehicle_under_test());
            let values = space.values(point);
            for (restored, value) in space.values(&space.point(&values)).iter().zip(&values) {
                prop_assert!((restored - value).abs() <= 1e-12 * (1.0 + value.abs()));
            }
            prop_assert!(space.contains(&space.values(&space.draw_point(seed, index))));
            let mut beyond = space.values(&space.draw_point(seed, index));
            beyond[0] = space.parameters()[0].range()[1] + 1.0;
            prop_assert!(!space.contains(&beyond) && !space.contains(&beyond[1..]));
            prop_assert_eq!(space.draw(seed, index).unwrap(), space.draw(seed, index).unwrap());
            prop_assert!(space.ln_likelihood(&space.draw_point(seed, index)).is_finite());
        }
    }
}

/// Returns the Kolmogorov-Smirnov distance of two samples.
fn ks_distance(mut a: Vec<f64>, mut b: Vec<f64>) -> f64 {
    a.sort_by(f64::total_cmp);
    b.sort_by(f64::total_cmp);
    let share =
        |sample: &[f64], x: f64| sample.partition_point(|y| *y <= x) as f64 / sample.len() as f64;
    a.iter()
        .chain(&b)
        .map(|&x| (share(&a, x) - share(&b, x)).abs())
        .fold(0.0, f64::max)
}

#[test]
fn the_paper_space_has_the_distribution_of_the_paper() {
    const DRAWS: u64 = 4000;
    let space = space("paper");
    let ours: Vec<_> = (0..DRAWS)
        .map(|index| space.draw(7, index).unwrap())
        .collect();
    let theirs: Vec<_> = (0..DRAWS)
        .map(|index| PaperDistribution { seed: 8 }.draw(index).unwrap())
        .collect();
    let brake = |s: &Scenario| match &s.vehicles()[0].driver {
        Driver::Profile(LeadProfile::Brake(brake)) => brake.clone(),
        other => panic!("{other:?}"),
    };
    type NamedQuantity<'a> = (&'a str, &'a dyn Fn(&Scenario) -> f64);
    let quantities: [NamedQuantity<'_>; 8] = [
        ("leader", &|s| s.vehicles()[0].position_m),
        ("gap ahead", &|s| s.initial_gap_m(1).unwrap()),
        ("gap behind", &|s| s.initial_gap_m(2).unwrap()),
        ("rate", &|s| brake(s).rate_mps2),
        ("onset", &|s| brake(s).onset_s),
        ("class", &|s| s.vehicles()[2].length_m()),
        ("follower's brake", &|s| s.vehicles()[2].max_brake_mps2()),
        ("seed", &|s| s.spec().seed as f64),
    ];
    // Two samples of one distribution exceed this distance once in about 10 000 times.
    let limit = 2.2 * (2.0 / DRAWS as f64).sqrt();
    for (name, quantity) in quantities {
        let distance = ks_distance(
            ours.iter().map(quantity).collect(),
            theirs.iter().map(quantity).collect(),
        );
        assert!(distance < limit, "{name}: {distance}");
    }
    let (ours, theirs) = (ours[0].spec(), theirs[0].spec());
    assert_eq!(
        (ours.duration_s, ours.step_s, &ours.sensors),
        (theirs.duration_s, theirs.step_s, &theirs.sensors)
    );
    for (ours, theirs) in ours.vehicles.iter().zip(&theirs.vehicles) {
        assert_eq!(ours.acceleration_noise_mps2, theirs.acceleration_noise_mps2);
        assert_eq!(
            (ours.speed_mps, ours.driver.name()),
            (theirs.speed_mps, theirs.driver.name())
        );
    }
}

#[test]
fn dependent_speeds_and_gaps_match_their_definition() {
    let number = |field: &str, unit: &str, nominal: f64| {
        let plain = parameter(
            field,
            unit,
            "distribution.uniform = { low = 0.0, high = 100.0 }",
        );
        format!("{plain}nominal = {nominal}\n")
    };
    let base = "version = 1\nname = \"s\"\n[base]\nversion = 1\nname = \"s\"\nabout = \"\"\nduration_s = 10.0\n\
        [[base.vehicles]]\nclass = \"light\"\nposition_m = 52.0\nspeed_mps = 20.0\n\
        driver.brake-to-speed = { onset_s = 1.0, rate_mps2 = 3.0, final_speed_mps = 10.0 }\n\
        [[base.vehicles]]\nclass = \"light\"\nposition_m = 0.0\nspeed_mps = 20.0\ndriver = \"under-test\"\n";
    let shares = [
        parameter(
            "vehicles[0].speed_share",
            "1",
            "distribution.uniform = { low = 0.0, high = 1.0 }",
        ),
        parameter(
            "vehicles[0].driver.brake-to-speed.final_share",
            "1",
            "distribution.uniform = { low = 0.0, high = 1.0 }",
        ),
        number("vehicles[1].closing_time_s", "s", 5.0),
        parameter(
            "vehicles[*].speed_mps",
            "m/s",
            "distribution.uniform = { low = 1.0, high = 40.0 }",
        ),
    ];
    let space = file::from_toml(
        &format!("{base}{}", shares.concat()),
        Path::new("s.toml"),
        &NoDriverFiles,
    )
    .unwrap();
    let scenario = space.scenario(&[0.5, 0.4, 3.0, 30.0]).unwrap();
    assert_eq!(
        [0, 1].map(|index| scenario.vehicles()[index].speed_mps),
        [15.0, 30.0]
    );
    assert!(
        (scenario.initial_gap_m(1).unwrap() - 45.0).abs() < 1e-9,
        "3 s at 15 m/s"
    );
    let Driver::Profile(LeadProfile::BrakeToSpeed(brake)) = &scenario.vehicles()[0].driver else {
        panic!("a script")
    };
    assert!((brake.final_speed_mps - 6.0).abs() < 1e-12);
    let alongside = space.scenario(&[1.0, 0.4, 3.0, 30.0]).unwrap();
    assert!(
        (alongside.initial_gap_m(1).unwrap() - 2.0).abs() < 1e-9,
        "no vehicle closes in"
    );
    let standing = built_in_space("standing").unwrap();
    for index in 0..50 {
        let drawn = standing.draw(1, index).unwrap();
        let [lead, ego] = [0, 1].map(|vehicle| drawn.vehicles()[vehicle].speed_mps);
        let closing_s = drawn.initial_gap_m(1).unwrap() / ego;
        assert!(
            lead == 0.0 && (2.8..=36.1).contains(&ego) && (1.999..=12.001).contains(&closing_s)
        );
    }
}

#[test]
fn sensor_faults_vary() {
    let parameters = [
        parameter(
            "sensors.faults.latency_s",
            "s",
            "distribution.uniform = { low = 0, high = 0.5 }",
        ),
        parameter(
            "sensors.faults.range_m",
            "m",
            "distribution.uniform = { low = 20, high = 200 }\nnominal = 100",
        ),
        parameter(
            "sensors.faults.ghost.duration_s",
            "s",
            "distribution.uniform = { low = 0, high = 2 }",
        ),
    ];
    let space = over_paper_1(&parameters.concat()).unwrap();
    let scenario = space.scenario(&[0.2, 80.0, 1.5]).unwrap();
    let ghost = GhostObject {
        onset_s: 0.0,
        duration_s: 1.5,
        gap_m: 50.0,
        speed_mps: 0.0,
    };
    let expected = SensorFaults {
        latency_s: 0.2,
        range_m: Some(80.0),
        ghost: Some(ghost),
        ..SensorFaults::default()
    };
    assert_eq!(scenario.spec().sensors.faults, expected);
}

#[test]
fn derived_fields_match_their_definition() {
    let parameters = [
        parameter(
            "vehicles[1].gap_m",
            "m",
            "distribution.uniform = { low = 1, high = 31 }",
        ),
        parameter(
            "vehicles[2].class",
            "",
            "distribution.choice = { values = [\"light\", \"heavy\"] }",
        ),
        parameter(
            "vehicles[2].load",
            "1",
            "distribution.uniform = { low = 0.5, high = 2.0 }",
        ),
        parameter(
            "vehicles[0].driver.brake.rate_share",
            "1",
            "distribution.uniform = { low = 0, high = 1 }",
        ),
        parameter(
            "environment.friction",
            "1",
            "distribution.uniform = { low = 0.5, high = 1.0 }",
        ),
    ];
    let space = over_paper_1(&parameters.concat()).unwrap();
    let heavy = space.scenario(&[5.0, 1.0, 1.5, 0.8, 0.5]).unwrap();
    assert_eq!(
        (heavy.initial_gap_m(1), heavy.initial_gap_m(2)),
        (Some(5.0), Some(16.0)),
        "other gaps stay"
    );
    assert_eq!(
        (
            heavy.vehicles()[2].mass_kg(),
            heavy.vehicles()[2].max_brake_mps2()
        ),
        (22_500.0, 4.0)
    );
    assert_eq!(heavy.usable_brake_mps2(2), 2.0);
    let Driver::Profile(LeadProfile::Brake(brake)) = &heavy.vehicles()[0].driver else {
        panic!("brakes")
    };
    assert_eq!(brake.rate_mps2, 0.8 * 7.5 * 0.5);
    let light = space.scenario(&[5.0, 0.0, 0.5, 0.8, 0.5]).unwrap();
    assert_eq!(
        (
            light.vehicles()[2].mass_kg(),
            light.vehicles()[2].max_brake_mps2()
        ),
        (750.0, 7.5)
    );
    let pieces = self::space("high-risk");
    let at = pieces
        .parameters()
        .iter()
        .position(|p| p.name() == "lead_brake_share")
        .unwrap();
    assert_eq!(pieces.parameters()[at].coordinates().len(), 5);
    let mut values = pieces.nominal();
    values[3] = 0.5;
    values[4] = 2.0;
    values[5..10].copy_from_slice(&[0.0, 1.0, 0.5, 0.0, 1.0]);
    let scenario = pieces.scenario(&values).unwrap();
    let Driver::Profile(LeadProfile::Pieces(lead)) = &scenario.vehicles()[0].driver else {
        panic!("pieces")
    };
    assert_eq!(lead.from_s, [2.0, 4.0, 6.0, 8.0, 10.0]);
    assert_eq!(lead.accel_mps2, [0.0, -4.5, -2.25, 0.0, -4.5]);
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Leader speeds and accelerations stay within the limits of the file, followers start at their time gaps, and the
    /// drivers are the named ones.
    #[test]
    fn everyday_traffic_matches_its_description(
        point in prop::collection::vec(prop_oneof![Just(0.0), Just(1.0), 0.0..1.0f64], 17),
    ) {
        let space = space("traffic");
        let values = space.values(&point);
        let value = |name: &str| {
            let parameter = space.parameters().iter().find(|parameter| parameter.name() == name).unwrap();
            values[parameter.coordinates().start]
        };
        let scenario = space.scenario_at(&point).unwrap();
        let [leader, _, follower] = scenario.vehicles() else { panic!("three") };
        for (index, name) in [(1, "time_gap_ahead_s"), (2, "time_gap_behind_s")] {
            let gap_m = scenario.initial_gap_m(index).unwrap();
            prop_assert!((gap_m - value(name) * value("speed_mps")).abs() < 1e-9);
        }
        let Driver::Profile(LeadProfile::Pieces(pieces)) = &leader.driver else { panic!("pieces") };
        let ends_s = pieces.from_s.iter().skip(1).chain([&40.0]);
        let mut speed_mps = leader.speed_mps;
        for ((accel_mps2, from_s), to_s) in pieces.accel_mps2.iter().zip(&pieces.from_s).zip(ends_s) {
            speed_mps += accel_mps2 * (to_s - from_s);
            prop_assert!((-2.5..=1.5).contains(accel_mps2) && (4.999..=36.112).contains(&speed_mps), "{pieces:?}");
            prop_assert!(value("lead_scale") != 0.0 || *accel_mps2 == 0.0);
        }
        let follower = follower.driver.name();
        prop_assert!(["idm", "acc-aeb"].contains(&follower));
        let parameter = space.parameters().iter().find(|parameter| parameter.name() == "follower").unwrap();
        prop_assert_eq!(parameter.format_value(value("follower")), follower);
    }
}

/// The space separates controllers: reference drivers pass without hard braking, a policy rewarded only for avoiding
/// collisions does not.
#[test]
fn everyday_traffic_reveals_unnecessary_hard_braking() {
    let space = space("traffic");
    let scenarios: Vec<_> = (0..200)
        .map(|index| space.draw(1, index).unwrap())
        .collect();
    let steady = |scenario: &&Scenario| match &scenario.vehicles()[0].driver {
        Driver::Profile(LeadProfile::Pieces(pieces)) => pieces
            .accel_mps2
            .iter()
            .all(|accel_mps2| *accel_mps2 == 0.0),
        other => panic!("{other:?}"),
    };
    assert!(
        (35..=65).contains(&scenarios.iter().filter(steady).count()),
        "a quarter keep their speed"
    );
    for (name, least, most) in [
        ("idm", 0, 0),
        ("acc-aeb", 0, 0),
        ("policy", 80, 200),
        ("retrained", 160, 200),
    ] {
        let options = RunOptions::new(BuiltInController::from_name(name).unwrap());
        let runs: Vec<_> = scenarios
            .iter()
            .map(|scenario| Run::new(scenario, options.clone()).unwrap())
            .collect();
        let needless = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
            assert!(result.outcome.is_safe(), "{name}: {:?}", result.outcome);
            !UsefulnessMeasures::from_trace(&result.trace.unwrap(), &result.impacts, 1)
                .unwrap()
                .unnecessary
                .is_empty()
        });
        let count = needless.into_iter().filter(|needless| *needless).count();
        assert!(
            (least..=most).contains(&count),
            "{name} brakes without cause in {count} of 200 draws"
        );
    }
}

#[test]
fn units_may_be_written_without_superscripts() {
    let uniform = "distribution.uniform = { low = 1.0, high = 5.0 }";
    let text = |unit: &str| {
        let space = over_paper_1(&parameter(
            "vehicles[0].driver.brake.rate_mps2",
            unit,
            uniform,
        ))
        .unwrap();
        file::to_toml(&space).unwrap()
    };
    assert_eq!(text("m/s2"), text("m/s²"));
    assert_eq!(text("m/s^2"), text("m/s²"));
    let refused = over_paper_1(&parameter(
        "vehicles[0].driver.brake.rate_mps2",
        "m/s3",
        uniform,
    ))
    .unwrap_err();
    assert!(
        refused.ends_with("is `m/s²` (or `m/s2`), found `m/s3`"),
        "{refused}"
    );
}

#[test]
fn models_of_cars_may_be_chosen_as_followers() {
    let names = ["idm", "cruise:audi-a4-short", "car:ix-2023"];
    let choice = format!("distribution.choice = {{ values = {names:?} }}\nnominal = \"idm\"");
    let space = over_paper_1(&parameter("vehicles[2].follower", "", &choice)).unwrap();
    let mut drawn = std::collections::BTreeSet::new();
    for index in 0..60 {
        let follower = space.draw(0, index).unwrap().vehicles()[2].driver.clone();
        let Driver::Controller(controller) = follower else {
            panic!("{follower:?}");
        };
        let value = space.values(&space.draw_point(0, index))[0];
        assert_eq!(
            space.parameters()[0].format_value(value),
            controller.to_arg()
        );
        drawn.insert(controller.to_arg());
    }
    assert!(names.iter().all(|name| drawn.contains(*name)), "{drawn:?}");
    let text = file::to_toml(&space).unwrap();
    let read = file::from_toml(&text, Path::new("s.toml"), &NoDriverFiles).unwrap();
    assert_eq!(read.spec(), space.spec());
}

#[test]
fn mistakes_name_line_and_field() {
    let uniform =
        |low: f64, high: f64| format!("distribution.uniform = {{ low = {low}, high = {high} }}");
    let gap = parameter("vehicles[1].gap_m", "m", &uniform(1.0, 30.0));
    for (parameters, expected) in [
        (
            gap.replace("low = 1", "low = -1"),
            "s.toml:8: parameters[0].distribution: with vehicles1gapm = -1 the scenario is invalid: \
             vehicles[1].position_m",
        ),
        (
            gap.replace("\"m\"", "\"ft\""),
            "s.toml:7: parameters[0].unit: the unit of `vehicles[1].gap_m` is `m`, found `ft`",
        ),
        (
            gap.replace("gap_m", "gap"),
            "s.toml:6: parameters[0].field: no field `vehicles[1].gap` may vary",
        ),
        (
            gap.replace("s[1]", "s[9]"),
            "s.toml:6: parameters[0].field: there is no vehicles[9]: the base scenario has 3 vehicles",
        ),
        (
            gap.replace("high = 30", "high = 0.5"),
            "s.toml:8: parameters[0].distribution.uniform: low must be below",
        ),
        (
            gap.replace("high = 30", "high = 10"),
            "s.toml:4: parameters[0].nominal: must be from 1 to 10, found 16",
        ),
        (
            "[[parameters]]\nname = \"behind\"\nfield = \"vehicles[2].follower\"\nunit = \"\"\nnominal = \"human\"\n\
             distribution.choice = { values = [\"idm\", \"late\"] }\n"
                .to_owned(),
            "s.toml:8: parameters[0].nominal: `human` is not a value of the distribution",
        ),
        (
            gap.replace("high", "hihg"),
            "s.toml:8: parameters[0].distribution.uniform.hihg: unknown field `hihg`",
        ),
        (
            gap.clone() + &gap,
            "s.toml:10: parameters[1].name: `vehicles1gapm` is the name of another",
        ),
        (
            gap.clone() + &gap.replace("vehicles1gapm", "q"),
            "s.toml:11: parameters[1].field: `vehicles[1].position_m` is set by",
        ),
        (
            parameter(
                "vehicles[0].driver.idm.accel_mps2",
                "m/s²",
                &uniform(1.0, 2.0),
            ),
            "s.toml:6: parameters[0].field: vehicle 0 of the base scenario is driven by `brake`, not by `idm`",
        ),
        (
            parameter(
                "vehicles[0].driver.brake.rate_mps2",
                "m/s²",
                &uniform(1.0, 9.0),
            ),
            "s.toml:4: parameters: `vehicles0driverbrakeratemps2` do not fit together: vehicles[0].driver.brake: asks \
             for 9",
        ),
        (
            parameter(
                "vehicles[1].driver",
                "",
                "distribution.choice = { values = [\"idm\"] }",
            ),
            "s.toml:6: parameters[0].field: vehicle 1 of the base scenario is driven by `under-test`, which is not a \
                built-in controller",
        ),
        (
            parameter(
                "vehicles[2].driver",
                "",
                "distribution.choice = { values = [\"idm\", \"light\"] }",
            ),
            "s.toml:8: parameters[0].distribution.choice.values: must be all numbers, all classes or all drivers",
        ),
        (
            parameter(
                "vehicles[2].driver",
                "",
                "distribution.choice = { values = [\"idm\", \"baseline\"] }",
            ) + &parameter("vehicles[2].driver.baseline.ttc_s", "s", &uniform(1.0, 2.0)),
            "s.toml:11: parameters[1].field: `vehicles[2].driver.baseline.ttc_s` is set by the parameter \
             `vehicles2driver`",
        ),
        (
            parameter("vehicles[1].time_gap_s", "s", &uniform(-1.0, 3.0)),
            "s.toml:4: parameters: `vehicles1timegaps` do not fit together: vehicles[1].position_m",
        ),
        (
            parameter("vehicles[2].class", "", &uniform(0.0, 1.0)),
            "s.toml:8: parameters[0].distribution: a class is a choice",
        ),
    ] {
        let message = over_paper_1(&parameters).expect_err("must be refused");
        assert!(
            message.starts_with(expected),
            "{message}\n  should start with\n{expected}"
        );
    }
    let inline =
        include_str!("built_in/paper.toml").replace("speed_mps = 25.0", "speed_mps = -25.0");
    let message = file::from_toml(&inline, Path::new("p.toml"), &NoDriverFiles)
        .expect_err("refused")
        .to_string();
    assert!(
        message.contains("base.vehicles[0].speed_mps: must be"),
        "{message}"
    );
}

/// Reports, trainings and certificates of 0.3.0 name the space `traffic` by this hash, and contain the description of
/// that version. A space with that description is the same space.
#[test]
fn a_reworded_description_keeps_the_hash_of_its_space() {
    let traffic = built_in_space("traffic").unwrap();
    let text = file::to_identity_toml(&traffic).unwrap();
    assert_eq!(
        crumple_core::digest::sha256(&text),
        "667eb0193390cc92deae841d5707a1980dc43494a203828af5cd0734e33be909"
    );
    assert_ne!(text, file::to_toml(&traffic).unwrap());
    let of_version_1 = file::from_toml(&text, Path::new("traffic.toml"), &NoDriverFiles).unwrap();
    assert_ne!(of_version_1.spec().about, traffic.spec().about);
    for identity in [file::to_identity_toml(&of_version_1).unwrap(), text] {
        assert_eq!(file::to_identity_toml(&traffic).unwrap(), identity);
    }
    let json = [&traffic, &of_version_1].map(|space| file::to_identity_json(space).unwrap());
    assert_eq!(json[0], json[1]);
}
