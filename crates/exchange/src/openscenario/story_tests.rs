//! Stories: priorities, replaced actions, states, lanes and trajectories. The files are those of public bug reports.

use std::fmt::Write as _;
use std::path::Path;

use super::tests::{ROAD, TIME, file, lane_change, same_lane, speed_action};
use super::{OpenScenarioSource, ParameterDistributionFile};
use crumple_sim::scenario::{Driver, LaneChange, LeadProfile, Scenario, VehicleSpec};

/// Largest difference of a time from the right one, in seconds: one step.
const STEP_S: f64 = 0.01;

fn import_case(name: &str) -> Result<(Scenario, Vec<String>), String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../corpora/openscenario");
    let source = OpenScenarioSource::load(&folder.join(name));
    let imported = source.and_then(|source| source.scenario(None, &[]));
    imported
        .map(|imported| (imported.scenario, imported.notes))
        .map_err(|error| error.to_string())
}

fn import(text: &str) -> Result<(Scenario, Vec<String>), String> {
    let source = OpenScenarioSource::from_bytes(text.as_bytes(), ROAD.as_bytes());
    let imported = source.and_then(|source| source.scenario(None, &[]));
    imported
        .map(|imported| (imported.scenario, imported.notes))
        .map_err(|error| error.to_string())
}

fn time_s(change: Option<LaneChange>) -> f64 {
    match change {
        Some(LaneChange::At(time_s)) => time_s,
        other => panic!("{other:?}"),
    }
}

fn assert_near(found_s: f64, expected_s: f64) {
    assert!(
        (found_s - expected_s).abs() <= STEP_S,
        "{found_s}, not {expected_s}"
    );
}

fn scripted(scenario: &Scenario) -> Vec<&VehicleSpec> {
    let vehicles = scenario.vehicles().iter();
    vehicles
        .filter(|vehicle| vehicle.driver != Driver::UnderTest)
        .collect()
}

#[test]
fn files_of_bug_reports_have_the_motion_that_the_standard_states() {
    for name in [
        "lane-change-interrupted/s.xosc",
        "left-carriageway/s.xosc",
        "override-other-domain/s2.xosc",
    ] {
        let error = import_case(name).expect_err(name);
        assert!(
            error.contains("`Lead` is never in the lane of the vehicle under test"),
            "{name}: {error}"
        );
    }
    let (scenario, _) = import_case("override-other-domain/s.xosc").unwrap();
    let Driver::Profile(LeadProfile::BrakeToSpeed(brake)) = &scripted(&scenario)[0].driver else {
        panic!("{scenario:?}")
    };
    assert_eq!(
        (brake.onset_s, brake.rate_mps2, brake.final_speed_mps),
        (2.0, 2.0, 16.0)
    );
    // The body of 1.8 m leaves the lane of 3.5 m after 2.65 m of 3.5 m in 2 s.
    assert_near(
        time_s(scripted(&scenario)[0].leaves),
        4.0 + 2.0 * 2.65 / 3.5,
    );

    let (scenario, notes) = import_case("through-the-lane/s.xosc").unwrap();
    let [first, second] = scripted(&scenario)[..] else {
        panic!("{scenario:?}")
    };
    assert_near(time_s(first.leaves), 1.0 + 2.0 * 2.65 / 3.5);
    assert_near(time_s(second.enters), 8.0 + 6.0 * 0.85 / 7.0);
    assert_near(time_s(second.leaves), 8.0 + 6.0 * 6.15 / 7.0);
    assert!(
        notes
            .iter()
            .any(|note| note.contains("in the lane 2 times"))
    );

    let (scenario, notes) = import_case("trajectory-sawtooth/s.xosc").unwrap();
    let Driver::Profile(LeadProfile::Recorded(recorded)) = &scripted(&scenario)[0].driver else {
        panic!("{scenario:?}")
    };
    for step in 0..1500 {
        let time_s = 0.01 * f64::from(step);
        let expected_mps = if time_s < 4.0 { 20.0 } else { 18.0 };
        let speed_mps = recorded.speed_at_mps(time_s);
        let is_near = (speed_mps - expected_mps).abs() < 0.01;
        assert!(
            is_near || (time_s - 4.0).abs() < 0.11,
            "{time_s}: {speed_mps}"
        );
    }
    assert!(
        notes
            .iter()
            .any(|note| note.contains("up to 0.05 m from the polyline")),
        "{notes:?}"
    );
}

/// Returns the first scripted vehicle with a length.
fn of_length(scenario: &Scenario, length_m: f64) -> VehicleSpec {
    let mut vehicles = scripted(scenario).into_iter();
    let own = vehicles.find(|vehicle| vehicle.length_m == Some(length_m));
    own.expect("a vehicle of this length").clone()
}

/// Returns the speed of a scripted vehicle at a time.
fn scripted_mps(vehicle: &VehicleSpec, time_s: f64) -> f64 {
    match &vehicle.driver {
        Driver::Profile(LeadProfile::ConstantSpeed) => vehicle.speed_mps,
        Driver::Profile(LeadProfile::Recorded(recorded)) => recorded.speed_at_mps(time_s),
        Driver::Profile(LeadProfile::BrakeToSpeed(brake)) => {
            let braked_mps = brake.rate_mps2 * (time_s - brake.onset_s).max(0.0);
            (vehicle.speed_mps - braked_mps).max(brake.final_speed_mps)
        }
        Driver::Profile(LeadProfile::Brake(brake)) => {
            let braked_mps = brake.rate_mps2 * (time_s - brake.onset_s).max(0.0);
            (vehicle.speed_mps - braked_mps).max(0.0)
        }
        other => panic!("{other:?}"),
    }
}

/// Checks that a vehicle has the speeds that are linear between pairs of a time and a speed.
fn assert_speeds(name: &str, vehicle: &VehicleSpec, knots: &[(f64, f64)], tolerance_mps: f64) {
    for pair in knots.windows(2) {
        let [(from_s, from_mps), (to_s, to_mps)] = [pair[0], pair[1]];
        for share in [0.01, 0.25, 0.5, 0.75, 0.99] {
            let time_s = from_s + share * (to_s - from_s);
            let expected_mps = from_mps + share * (to_mps - from_mps);
            let found_mps = scripted_mps(vehicle, time_s);
            assert!(
                (found_mps - expected_mps).abs() <= tolerance_mps,
                "{name} at {time_s} s: {found_mps} m/s, not {expected_mps}"
            );
        }
    }
}

/// Returns the speeds of a vehicle that brakes at 2 m/s² from 20 to 10 m/s.
fn brakes_at(start_s: f64) -> Vec<(f64, f64)> {
    vec![
        (0.0, 20.0),
        (start_s, 20.0),
        (start_s + 5.0, 10.0),
        (14.0, 10.0),
    ]
}

/// Returns files, and the speeds of their vehicle of 4.2 m at times, between which they are linear.
fn files_for_clauses() -> Vec<(&'static str, Vec<(f64, f64)>)> {
    // From front bumper to rear bumper, beside the distance of the reference points.
    let bodies_m = 4.1 / 3.0 + 4.1 / 2.0 + 4.2 / 2.0 - 4.2 / 3.0;
    let straight_s = (40.0 - bodies_m - f64::sqrt(400.0 - 1.7 * 1.7)) / 2.0;
    let leaves_s = 1.0 + 4.0 * 2.65 / 3.5;
    let knots = |inner: &[(f64, f64)]| [&[(0.0, 20.0)][..], inner].concat();
    vec![
        ("continuous-offset", knots(&[(14.0, 20.0)])),
        (
            "followed-speed",
            knots(&[(1.0, 20.0), (3.5, 15.0), (5.0, 15.0), (7.5, 10.0)]),
        ),
        (
            "stand-still",
            knots(&[(1.0, 20.0), (5.0, 0.0), (6.5, 0.0), (11.5, 10.0)]),
        ),
        ("value-set", brakes_at(2.0)),
        // The scenario begins at 3 s, and the vehicle brakes 1 s later.
        ("activation-lateral", brakes_at(1.0)),
        (
            "init-profile",
            knots(&[(2.0, 16.0), (5.0, 16.0), (7.0, 20.0), (14.0, 20.0)]),
        ),
        // The action of the vehicle under test ends at 5 s, or another one stops it at 3 s.
        ("ego-action-runs", brakes_at(5.0)),
        ("ego-action-replaced", brakes_at(3.0)),
        // The scenario begins at 3 s, and the action of the vehicle under test ends at 5 s.
        ("ego-activation", brakes_at(2.0)),
        ("far-road", brakes_at(2.0)),
        (
            "before-bend",
            knots(&[(2.0, 20.0), (12.0, 0.0), (14.0, 0.0)]),
        ),
        ("straight-distance", brakes_at(straight_s)),
        ("lateral-distance", brakes_at(leaves_s)),
    ]
}

#[test]
fn files_for_clauses_have_the_motion_that_the_standard_states() {
    for (name, knots) in files_for_clauses() {
        let (scenario, _) = import_case(&format!("clauses/{name}.xosc")).expect(name);
        // A millisecond at 5 m/s².
        assert_speeds(name, &of_length(&scenario, 4.2), &knots, 0.005);
    }
    let (scenario, _) = import_case("clauses/init-lane-change.xosc").unwrap();
    let vehicle = of_length(&scenario, 4.2);
    assert_near(time_s(vehicle.enters), 4.0 * 0.85 / 3.5);
    assert_near(time_s(vehicle.leaves), 2.0 + 2.0 * 0.9 / 1.75);
}

#[test]
fn a_range_with_too_many_values_is_refused_for_that_reason() {
    for (width, reason) in [
        ("0.001", "has 19001 values, and 10000 are allowed"),
        ("0", "stepWidth = 0 does not lead from 1 to 20"),
        ("-1", "stepWidth = -1 does not lead from 1 to 20"),
    ] {
        let text = format!(
            r#"<OpenSCENARIO><FileHeader/><ParameterValueDistribution><ScenarioFile filepath="f.xosc"/><Deterministic>
            <DeterministicSingleParameterDistribution parameterName="v"><DistributionRange stepWidth="{width}">
            <Range lowerLimit="1" upperLimit="20"/></DistributionRange></DeterministicSingleParameterDistribution>
            </Deterministic></ParameterValueDistribution></OpenSCENARIO>"#
        );
        let error = ParameterDistributionFile::from_bytes(text.as_bytes()).expect_err(width);
        assert!(error.to_string().contains(reason), "{width}: {error}");
    }
}

#[test]
fn files_for_clauses_are_refused_for_the_right_reason() {
    for (name, reason) in [
        (
            "followed-offset",
            "follows the lateral position of an entity that changes",
        ),
        (
            "trajectory-catalogue",
            "trajectories of catalogues are not supported",
        ),
        ("route-leaves", "the route leaves the lane"),
        (
            "collision-with-position",
            "is not supported as a target, only EntityRef",
        ),
        (
            "in-bend",
            "the road must be straight, or have bends with radii of 2000 m or more",
        ),
    ] {
        let error = import_case(&format!("clauses/{name}.xosc")).expect_err(name);
        assert!(error.contains(reason), "{name}: {error}");
        let file = if name == "in-bend" {
            "bend.xodr:"
        } else {
            ".xosc:"
        };
        assert!(error.contains(file), "{error}");
    }
}

/// A route of a catalogue that stays in the lane has no influence.
#[test]
fn a_route_of_a_catalogue_that_stays_in_the_lane_is_a_note() {
    let (scenario, notes) = import_case("clauses/route-stays.xosc").unwrap();
    assert_speeds(
        "route-stays",
        &of_length(&scenario, 4.2),
        &brakes_at(2.0),
        0.005,
    );
    let note = "AssignRouteAction: has no influence: the route stays in the lane";
    assert!(notes.iter().any(|text| text.contains(note)), "{notes:?}");
}

fn place_m(road: u32, s_m: f64) -> String {
    format!(r#"<LanePosition roadId="{road}" laneId="-1" s="{s_m}"/>"#)
}

fn assign_route(closed: bool, positions: [String; 2]) -> String {
    let waypoints = positions.map(|position| {
        format!(r#"<Waypoint routeStrategy="shortest"><Position>{position}</Position></Waypoint>"#)
    });
    let waypoints = waypoints.concat();
    format!(
        r#"<AssignRouteAction><Route name="r" closed="{closed}">{waypoints}</Route></AssignRouteAction>"#
    )
}

fn acquire(position: &str) -> String {
    format!("<AcquirePositionAction><Position>{position}</Position></AcquirePositionAction>")
}

/// A vehicle that follows its lane never comes back to the start of a closed route, or to a place behind it.
#[test]
fn routes_that_lead_back_or_to_another_road_are_refused() {
    let routing = |action: String| {
        let action = format!("<RoutingAction>{action}</RoutingAction>");
        import(&two_events("parallel", &action, &after(3.0)))
    };
    let [near, far] = [place_m(7, 200.0), place_m(7, 300.0)];
    let ahead = [near.clone(), far.clone()];
    for action in [assign_route(false, ahead.clone()), acquire(&far)] {
        let (_, notes) = routing(action).unwrap();
        assert!(notes.iter().any(|note| note.contains("stays in the lane")));
    }
    let other_road = assign_route(false, [near.clone(), place_m(8, 300.0)]);
    for (action, reason) in [
        (assign_route(false, [far, near]), "leads back"),
        (acquire(&place_m(7, 100.0)), "leads back"),
        (assign_route(true, ahead), "is closed"),
        (other_road, "leads from the road `7` to the road `8`"),
    ] {
        let error = routing(action).expect_err(reason);
        assert!(error.contains(reason), "{reason}: {error}");
    }
}

/// Returns a file in which `other` starts at a position on a route from 120 m to 500 m.
fn on_route(inside: &str) -> String {
    let position = format!(
        r#"<RoutePosition><RouteRef><Route name="r" closed="false">
<Waypoint routeStrategy="shortest"><Position><LanePosition roadId="7" laneId="-1" s="120"/></Position></Waypoint>
<Waypoint routeStrategy="shortest"><Position><LanePosition roadId="7" laneId="-1" s="500"/></Position></Waypoint>
</Route></RouteRef><InRoutePosition>{inside}</InRoutePosition></RoutePosition>"#
    );
    let brake = speed_action("linear", "rate", "2", 4.0);
    file(&position, &brake, TIME)
}

/// Class `RoutePosition`: `pathS` counts from the start of the route.
#[test]
fn positions_on_a_route_count_from_its_start() {
    for inside in [
        r#"<FromLaneCoordinates pathS="20" laneId="-1"/>"#,
        r#"<FromRoadCoordinates pathS="20" t="-1.75"/>"#,
    ] {
        let (scenario, _) = import(&on_route(inside)).unwrap();
        // As at 140 m: the front is 4 m ahead.
        assert_eq!(scripted(&scenario)[0].position_m, 154.0, "{inside}");
    }
    let text = on_route(r#"<FromLaneCoordinates pathS="20" laneId="-1"/>"#);
    for (old, new, reason) in [
        (
            r#"pathS="20""#,
            r#"pathS="380.5""#,
            "is beyond the end of the route",
        ),
        (
            r#"laneId="-1" s="500""#,
            r#"laneId="-2" s="500""#,
            "the route leaves the lane",
        ),
        (r#"s="500""#, r#"s="100""#, "the route leads back"),
        (
            r#"roadId="7" laneId="-1" s="500""#,
            r#"roadId="9" laneId="-1" s="500""#,
            "the route leads from the road `7` to the road `9`: vehicles stay on one road",
        ),
    ] {
        let changed = text.replace(old, new);
        assert_ne!(changed, text, "{old}");
        let error = import(&changed).expect_err(reason);
        assert!(error.contains(reason), "{reason}: {error}");
    }
}

/// A speed or a time that passes through a value between two steps has this value once, whatever the rate.
#[test]
fn equal_to_is_true_where_a_quantity_passes_through_the_value() {
    for rate in ["2", "3", "1.7", "2.3"] {
        let passes_s = 2.0 + 5.0 / rate.parse::<f64>().unwrap();
        let at_speed =
            r#"<EntityCondition><SpeedCondition rule="equalTo" value="15"/></EntityCondition>"#;
        let at_speed = format!(
            r#"<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="other"/>
</TriggeringEntities>{at_speed}</ByEntityCondition>"#
        );
        let at_time = format!(
            r#"<ByValueCondition><SimulationTimeCondition rule="equalTo" value="{passes_s}"/></ByValueCondition>"#
        );
        for condition in [at_speed, at_time] {
            let faster = speed_action("linear", "rate", "1", 20.0);
            let text = two_events("override", &faster, &after(0.0))
                .replace(
                    &format!("<ByValueCondition>{}</ByValueCondition>", after(0.0)),
                    &condition,
                )
                .replace(
                    "dynamicsDimension=\"rate\"\nvalue=\"2\"",
                    &format!("dynamicsDimension=\"rate\"\nvalue=\"{rate}\""),
                );
            let mps = speed_mps(&text, passes_s + 2.0);
            assert!((mps - 17.0).abs() < 1e-3, "{rate}, {condition}: {mps}");
        }
    }
}

/// Before its activation, a vehicle under test does its actions: it brakes from 20 m/s at 2.5 m/s² for two seconds.
#[test]
fn the_default_controller_drives_until_the_activation() {
    let (scenario, notes) = import_case("clauses/ego-activation.xosc").unwrap();
    let speed_mps = vehicle_under_test(&scenario).speed_mps;
    assert!((speed_mps - 15.0).abs() < 1e-9, "{speed_mps}");
    assert!(
        !notes.iter().any(|note| note.contains("replaces this")),
        "{notes:?}"
    );
}

/// A pedestrian of 0.6 m walks at 1 m/s across a lane of 3.5 m, from 4 m beside its middle on.
#[test]
fn a_pedestrian_who_crosses_is_in_the_lane_while_the_body_is() {
    for (name, start_s) in [("crossing-at-times", 1.0), ("crossing-at-speed", 2.0)] {
        let (scenario, _) = import_case(&format!("clauses/{name}.xosc")).expect(name);
        let pedestrian = scripted(&scenario)[0].clone();
        assert!((pedestrian.length_m() - 0.5).abs() < 1e-6);
        assert_near(time_s(pedestrian.enters), start_s + 4.0 - 2.05);
        assert_near(time_s(pedestrian.leaves), start_s + 4.0 + 2.05);
        assert_eq!(pedestrian.speed_mps, 0.0);
        // The front is half of the width ahead of the middle.
        let under_test = vehicle_under_test(&scenario);
        let gap_m = pedestrian.position_m - 0.5 - under_test.position_m;
        let expected_m = 420.0 - 0.25 - (300.0 + 4.1 / 3.0 + 4.1 / 2.0);
        assert!((gap_m - expected_m).abs() < 0.01, "{name}: {gap_m}");
        assert!(scripted_mps(&pedestrian, 5.0).abs() < 1e-9);
    }
}

fn vehicle_under_test(scenario: &Scenario) -> VehicleSpec {
    let mut vehicles = scenario.vehicles().iter();
    let under_test = vehicles.find(|vehicle| vehicle.driver == Driver::UnderTest);
    under_test.expect("a vehicle under test").clone()
}

/// Zeros behind the last digit, and an offset of all positions, do not change the motion.
#[test]
fn the_digits_of_a_file_do_not_change_the_motion() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../corpora/openscenario/clauses");
    let road = std::fs::read(folder.join("road.xodr")).unwrap();
    let text = std::fs::read_to_string(folder.join("recording-one-decimal.xosc")).unwrap();
    let longer = text.replace("\" y=\"-5.25\" h", "00\" y=\"-5.2500\" h");
    let longer = longer.replace("x=\"34000\"", "x=\"340.00\"");
    assert_ne!(text, longer);
    let imported = [text, longer].map(|text| {
        let source = OpenScenarioSource::from_bytes(text.as_bytes(), &road).unwrap();
        source.scenario(None, &[]).unwrap().scenario
    });
    assert_eq!(imported[0], imported[1]);
}

/// Positions with two decimals at 25 Hz of a vehicle that brakes at 3 m/s² from 20.037 to 8.037 m/s, and then
/// accelerates; all are 1.234 mm farther.
#[test]
fn positions_with_two_decimals_do_not_become_hard_braking() {
    let (scenario, _) = import_case("clauses/recording-two-decimals.xosc").unwrap();
    let vehicle = of_length(&scenario, 4.2);
    let lowest_mps2 = |from: usize, to: usize| {
        (from..to)
            .map(|step| 0.01 * step as f64)
            .map(|time_s| {
                100.0 * (scripted_mps(&vehicle, time_s + 0.01) - scripted_mps(&vehicle, time_s))
            })
            .fold(0.0, f64::min)
    };
    let [before, braking, after] = [
        lowest_mps2(0, 260),
        lowest_mps2(260, 740),
        lowest_mps2(740, 1190),
    ];
    assert!(before > -0.1, "{before}");
    assert!(braking > -3.6, "{braking}");
    assert!(after > -0.1, "{after}");
}

/// Those positions at 30 Hz, with times of three decimals: the vehicle drives at 24 m/s and brakes at 4.3 m/s².
#[test]
fn rounded_times_do_not_become_hard_braking() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../corpora/openscenario/clauses");
    let road = std::fs::read(folder.join("road.xodr")).unwrap();
    let text = std::fs::read_to_string(folder.join("recording-two-decimals.xosc")).unwrap();
    let mut parts = text.split("<Vertex time=\"");
    let mut text = parts.next().unwrap().to_owned();
    for (index, part) in parts.enumerate() {
        let (_, rest) = part.split_once('"').unwrap();
        let time_s = index as f64 / 30.0;
        write!(text, "<Vertex time=\"{time_s:.3}\"{rest}").unwrap();
    }
    let source = OpenScenarioSource::from_bytes(text.as_bytes(), &road).unwrap();
    let imported = source.scenario(None, &[]).unwrap();
    assert!(
        imported
            .notes
            .iter()
            .any(|note| note.contains("those of a constant rate")),
        "{:?}",
        imported.notes
    );
    let vehicle = of_length(&imported.scenario, 4.2);
    let lowest_mps2 = |from: usize, to: usize| {
        (from..to)
            .map(|step| 0.01 * step as f64)
            .map(|time_s| {
                100.0 * (scripted_mps(&vehicle, time_s + 0.01) - scripted_mps(&vehicle, time_s))
            })
            .fold(0.0, f64::min)
    };
    let [before, braking] = [lowest_mps2(0, 210), lowest_mps2(210, 620)];
    assert!(before > -0.1, "{before}");
    assert!((-5.0..-4.2).contains(&braking), "{braking}");
}

/// A recorded vehicle brakes at 3 m/s² from 20 to 8 m/s and to standstill, and its positions have one decimal.
#[test]
fn positions_with_one_decimal_do_not_become_hard_braking() {
    let (scenario, notes) = import_case("clauses/recording-one-decimal.xosc").unwrap();
    let vehicle = of_length(&scenario, 4.2);
    let lowest_mps2 = (0..1800)
        .map(|step| 0.01 * f64::from(step))
        .map(|time_s| {
            100.0 * (scripted_mps(&vehicle, time_s + 0.01) - scripted_mps(&vehicle, time_s))
        })
        .fold(0.0, f64::min);
    assert!(lowest_mps2 > -3.6, "{lowest_mps2}");
    assert!(
        notes
            .iter()
            .any(|note| note.contains("m from the polyline")),
        "{notes:?}"
    );
}

/// Returns a file in which `other` brakes at 2 s, and a second event of the same maneuver that starts on `condition`.
fn two_events(priority: &str, action: &str, condition: &str) -> String {
    let brake = speed_action("linear", "rate", "2", 4.0);
    let text = file(same_lane(), &brake, TIME).replace(
        "delay=\"0.5\" conditionEdge=\"rising\"",
        "delay=\"0\" conditionEdge=\"none\"",
    );
    let second = format!(
        r#"<Event name="second" priority="{priority}" maximumExecutionCount="1"><Action name="act2">
<PrivateAction>{action}</PrivateAction></Action><StartTrigger><ConditionGroup>
<Condition name="c" delay="0" conditionEdge="none">
<ByValueCondition>{condition}</ByValueCondition></Condition></ConditionGroup></StartTrigger></Event></Maneuver>"#
    );
    let stop = r#"<SimulationTimeCondition value="30" rule="greaterThan"/>"#;
    let start = text.find("<StoryboardElementStateCondition").unwrap();
    let end = start + text[start..].find("/>").unwrap() + 2;
    format!("{}{stop}{}", &text[..start], &text[end..]).replace("</Maneuver>", &second)
}

fn state(reference: &str, state: &str) -> String {
    let kind = if reference.ends_with("act") {
        "action"
    } else {
        "event"
    };
    format!(
        r#"<StoryboardElementStateCondition storyboardElementType="{kind}" storyboardElementRef="{reference}"
state="{state}"/>"#
    )
}

fn after(time_s: f64) -> String {
    format!(r#"<SimulationTimeCondition value="{time_s}" rule="greaterOrEqual"/>"#)
}

/// Returns the speed of `other` at a time.
fn speed_mps(text: &str, time_s: f64) -> f64 {
    let (scenario, _) = import(text).unwrap_or_else(|error| panic!("{error}"));
    let vehicle = scripted(&scenario)[0];
    match &vehicle.driver {
        Driver::Profile(LeadProfile::ConstantSpeed) => vehicle.speed_mps,
        Driver::Profile(LeadProfile::Recorded(recorded)) => recorded.speed_at_mps(time_s),
        Driver::Profile(LeadProfile::BrakeToSpeed(brake)) => {
            let braked_s = (time_s - brake.onset_s).max(0.0);
            (vehicle.speed_mps - brake.rate_mps2 * braked_s).max(brake.final_speed_mps)
        }
        other => panic!("{other:?}"),
    }
}

/// 8.4.2.2: `override` stops the running events of the maneuver, `parallel` does not, and `skip` does not start.
#[test]
fn priorities_stop_or_keep_the_running_events() {
    let out = lane_change("-2");
    assert_eq!(
        speed_mps(&two_events("override", &out, &after(4.0)), 6.0),
        16.0
    );
    assert_eq!(
        speed_mps(&two_events("overwrite", &out, &after(4.0)), 6.0),
        16.0
    );
    assert_eq!(
        speed_mps(&two_events("parallel", &out, &after(4.0)), 6.0),
        12.0
    );
    assert_eq!(speed_mps(&two_events("skip", &out, &after(4.0)), 6.0), 12.0);
    // 7.5.1: an action of the same domain replaces the running one, whatever the priority.
    let faster = speed_action("linear", "rate", "1", 20.0);
    assert_eq!(
        speed_mps(&two_events("parallel", &faster, &after(4.0)), 6.0),
        18.0
    );
    assert_eq!(
        speed_mps(&two_events("skip", &faster, &after(4.0)), 6.0),
        12.0
    );
}

/// 8.1: transitions are visible for one step, states as long as they last.
#[test]
fn transitions_are_true_for_one_step_and_states_while_they_last() {
    let faster = speed_action("linear", "rate", "1", 20.0);
    // Braking takes from 2 to 10 s.
    let later = |condition: String, time_s: f64| {
        let both = format!(
            "{condition}</ByValueCondition></Condition><Condition name=\"d\" delay=\"0\" \
             conditionEdge=\"none\"><ByValueCondition>{}",
            after(time_s)
        );
        speed_mps(&two_events("parallel", &faster, &both), 14.0)
    };
    assert_eq!(later(state("e", "endTransition"), 0.0), 8.0);
    assert_eq!(
        later(state("e", "endTransition"), 10.5),
        4.0,
        "the transition is over"
    );
    assert_eq!(later(state("e", "startTransition"), 5.0), 4.0);
    assert_eq!(
        later(state("e", "completeState"), 12.0),
        6.0,
        "the state lasts"
    );
    assert_eq!(
        later(state("e", "runningState"), 12.0),
        4.0,
        "the element does not run"
    );
    assert_eq!(later(state("e", "runningState"), 8.0), 14.0);
    assert_eq!(later(state("e", "stopTransition"), 0.0), 4.0);
}

#[test]
fn references_are_resolved_by_their_path_and_ambiguous_ones_are_refused() {
    let faster = speed_action("linear", "rate", "1", 20.0);
    let speed_of = |reference: &str| {
        speed_mps(
            &two_events("parallel", &faster, &state(reference, "endTransition")),
            12.0,
        )
    };
    assert_eq!(speed_of("s::a::g::m::e"), 6.0);
    assert_eq!(speed_of("m::e"), 6.0);
    assert_eq!(speed_of("m::e::act"), 6.0);
    for (reference, problem) in [
        ("other::e", "there is no event `other::e` in the stories"),
        ("e", "there are several elements `e` of the kind event"),
    ] {
        let text = two_events("parallel", &faster, &state(reference, "endTransition"));
        let text = if reference == "e" {
            text.replace("<Event name=\"second\"", "<Event name=\"e\"")
        } else {
            text
        };
        let error = import(&text).expect_err(reference);
        assert!(error.contains(problem), "{error}");
    }
}

#[test]
fn lane_changes_over_a_distance_follow_the_speed() {
    // From 2 s on, the vehicle needs 35 m: at 2 m/s², from 20 m/s, 2 * (1 - sqrt(1 - 0.35)) * 5 s.
    let change = lane_change("-2").replace("\"time\"\nvalue=\"3.5\"", "\"distance\"\nvalue=\"35\"");
    let text = two_events("parallel", &change, &after(2.0));
    let (scenario, _) = import(&text).unwrap();
    // The side of the body of 1.5 m has left the lane after 2.5 of 3.5 m, 25 m on.
    let passed_s = (20.0 - (400.0 - 4.0 * 25.0_f64).sqrt()) / 2.0;
    assert_near(time_s(scripted(&scenario)[0].leaves), 2.0 + passed_s);
}

#[test]
fn content_of_other_tools_becomes_notes() {
    let text = two_events("parallel", &lane_change("-2"), &after(4.0));
    for (old, new, expected) in [
        (
            "<Axles/>",
            "<Axles/><TrailerHitch dx=\"-1\"/><Trailer><TrailerRef entityRef=\"x\"/></Trailer>",
            "TrailerRef: has no influence: vehicles have no trailers",
        ),
        (
            "f.xodr",
            "g.xodr",
            "LogicFile: is missing: the road is straight",
        ),
        (
            "<SpeedActionDynamics dynamicsShape=\"linear\" dynamicsDimension=\"rate\"\nvalue=\"2\"",
            "<SpeedActionDynamics dynamicsShape=\"linear\" dynamicsDimension=\"rate\"\nvalue=\"0\"",
            "at a rate of 0 the speed never changes",
        ),
        (
            "<SpeedActionDynamics dynamicsShape=\"linear\" dynamicsDimension=\"rate\"\nvalue=\"2\"",
            "<SpeedActionDynamics dynamicsShape=\"linear\" dynamicsDimension=\"rate\"\nvalue=\"-20\"",
            "the rate is limited to what the vehicle can drive: 8.0 m/s² of braking",
        ),
    ] {
        let changed = text.replace(old, new);
        assert_ne!(changed, text, "{old}");
        let changed = if old == "f.xodr" {
            let world = "<WorldPosition x=\"110\" y=\"-1.75\"/>";
            changed.replace(
                world,
                "<LanePosition roadId=\"7\" laneId=\"-1\" s=\"100\"/>",
            )
        } else {
            changed
        };
        let (_, notes) = import(&changed).unwrap_or_else(|error| panic!("{error}"));
        let has_note = notes.iter().any(|note| note.contains(expected));
        assert!(has_note, "{expected}: {notes:?}");
    }
    let story = "<Story name=\"s\"><ParameterDeclarations><ParameterDeclaration name=\"rate2\" \
                 parameterType=\"double\" value=\"${pi / 2}\"/></ParameterDeclarations>";
    let scoped = text.replace("<Story name=\"s\">", story).replace(
        "dynamicsDimension=\"rate\"\nvalue=\"2\"",
        "dynamicsDimension=\"rate\"\nvalue=\"$rate2\"",
    );
    let expected_mps = 20.0 - 2.0 * std::f64::consts::FRAC_PI_2;
    assert!((speed_mps(&scoped, 4.0) - expected_mps).abs() < 1e-9);
}

#[test]
fn variables_can_change_and_start_events() {
    let declared = "<CatalogLocations/><VariableDeclarations><VariableDeclaration name=\"n\" variableType=\"double\" \
                    value=\"1\"/></VariableDeclarations>";
    let condition = "<VariableCondition variableRef=\"n\" rule=\"greaterOrEqual\" value=\"3\"/>";
    let text = two_events("override", &lane_change("-2"), condition);
    let change = "<Action name=\"v\"><GlobalAction><VariableAction variableRef=\"n\"><ModifyAction><Rule><AddValue \
                  value=\"2\"/></Rule></ModifyAction></VariableAction></GlobalAction></Action>";
    let text = text.replace("<CatalogLocations/>", declared).replacen(
        "<Event name=\"e\" priority=\"override\">",
        &format!("<Event name=\"e\" priority=\"override\">{change}"),
        1,
    );
    // The variable is 3 when the braking begins at 2 s, which the lane change ends at once.
    assert_eq!(speed_mps(&text, 10.0), 20.0);
    // A truth value has two texts.
    let truth = text
        .replace(
            "variableType=\"double\" value=\"1\"",
            "variableType=\"boolean\" value=\"false\"",
        )
        .replace(
            "rule=\"greaterOrEqual\" value=\"3\"",
            "rule=\"equalTo\" value=\"true\"",
        )
        .replace(
            "<ModifyAction><Rule><AddValue value=\"2\"/></Rule></ModifyAction>",
            "<SetAction value=\"1\"/>",
        );
    assert!(truth.contains("SetAction"));
    assert_eq!(speed_mps(&truth, 10.0), 20.0);
}

/// 8.4.2.2: each step in which the trigger is true counts as one execution.
#[test]
fn a_skipped_event_counts_one_execution_in_a_step() {
    let faster = speed_action("linear", "rate", "1", 20.0);
    // The event is skipped from 4 s on, 50 times.
    let skipped = two_events("skip", &faster, &after(4.0)).replace(
        "priority=\"skip\" maximumExecutionCount=\"1\"",
        "priority=\"skip\" maximumExecutionCount=\"50\"",
    );
    let third = format!(
        r#"</Event><Event name="third" priority="override"><Action name="x"><PrivateAction>{}</PrivateAction></Action>
<StartTrigger><ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByValueCondition>{}</ByValueCondition>
</Condition></ConditionGroup></StartTrigger></Event></Maneuver>"#,
        lane_change("-2"),
        state("second", "completeState")
    );
    let text = skipped.replace("</Event></Maneuver>", &third);
    // The third event stops the braking at 2 m/s² after 49 further steps.
    let stopped_mps = speed_mps(&text, 8.0);
    assert!(
        (stopped_mps - (20.0 - 2.0 * 2.49)).abs() <= 2.1 * STEP_S,
        "{stopped_mps}"
    );
}

/// The delay of a further execution begins when the one before has ended.
#[test]
fn a_delay_of_a_repeated_event_is_not_shorter() {
    let text = two_events(
        "parallel",
        &speed_action("linear", "time", "0.503", 19.0),
        &after(20.0),
    );
    let repeated = text
        .replace(
            "name=\"e\" priority=\"override\"",
            "name=\"e\" priority=\"override\" maximumExecutionCount=\"2\"",
        )
        .replacen("delay=\"0\" conditionEdge=\"none\"", "delay=\"0.5\" conditionEdge=\"none\"", 1)
        .replace(
            "<AbsoluteTargetSpeed value=\"4\"/>",
            "<RelativeTargetSpeed entityRef=\"other\" value=\"-8\" speedTargetValueType=\"delta\"/>",
        );
    // Braking from 2.5 to 6.5 s; the next one from 7 s on.
    assert!((speed_mps(&repeated, 6.99) - 12.0).abs() < 1e-9);
    assert!((speed_mps(&repeated, 8.0) - 10.0).abs() < 1e-6);
}

/// Returns the file with a trajectory of `other` in `Init` instead of its position.
fn with_initial_trajectory(text: &str, vertices: &[(f64, f64, f64)], timing: &str) -> String {
    let vertices: String = vertices
        .iter()
        .map(|(time_s, s_m, offset_m)| {
            format!(
                r#"<Vertex time="{time_s}"><Position>
<LanePosition roadId="7" laneId="-1" s="{s_m}" offset="{offset_m}"/></Position></Vertex>"#
            )
        })
        .collect();
    with_initial_polyline(text, &vertices, timing)
}

fn with_initial_polyline(text: &str, vertices: &str, timing: &str) -> String {
    let trajectory = format!(
        r#"<RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false"><Shape><Polyline>
{vertices}</Polyline></Shape></Trajectory></TrajectoryRef><TimeReference>{timing}</TimeReference>
<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction>"#
    );
    let position = format!(
        "<TeleportAction><Position>{}</Position>\n</TeleportAction>",
        same_lane()
    );
    let changed = text.replace(&position, &trajectory);
    assert_ne!(changed, text);
    changed
}

/// Rounding of a vehicle that creeps does not lead it across the lanes, or back, whatever the direction of its road.
#[test]
fn rounded_positions_of_a_vehicle_that_stops_stay_along_the_lane() {
    let timing = r#"<Timing domainAbsoluteRelative="absolute" scale="1" offset="0"/>"#;
    let event = two_events("parallel", &lane_change("-2"), &after(100.0))
        .replace(
            "SimulationTimeCondition value=\"2\"",
            "SimulationTimeCondition value=\"100\"",
        )
        .replace(
            "<WorldPosition x=\"110\" y=\"-1.75\"/>",
            "<LanePosition roadId=\"7\" laneId=\"-1\" s=\"100\"/>",
        );
    for heading_rad in [0.4_f64, 1.0, -2.0] {
        let [cosine, sine] = [heading_rad.cos(), heading_rad.sin()];
        for (decimals, rate_hz) in [(1, 50.0), (2, 25.0), (2, 100.0)] {
            let vertex = |sample: u32| {
                let time_s = f64::from(sample) / rate_hz;
                let braked_s = (time_s - 2.0).clamp(0.0, 4.0);
                let along_m = 140.0 + 20.0 * time_s.min(6.0) - 2.5 * braked_s * braked_s;
                let [x_m, y_m] = [
                    10.0 + along_m * cosine + 1.75 * sine,
                    along_m * sine - 1.75 * cosine,
                ];
                format!(
                    r#"<Vertex time="{time_s}"><Position>
<WorldPosition x="{x_m:.decimals$}" y="{y_m:.decimals$}" h="{heading_rad}"/></Position></Vertex>"#
                )
            };
            let vertices: String = (0..(8.0 * rate_hz) as u32).map(vertex).collect();
            let text = with_initial_polyline(&event, &vertices, timing);
            let road = ROAD.replace("hdg=\"0\"", &format!("hdg=\"{heading_rad}\""));
            let source = OpenScenarioSource::from_bytes(text.as_bytes(), road.as_bytes()).unwrap();
            let imported = source.scenario(None, &[]);
            let case = format!("{heading_rad}, {decimals} decimals, {rate_hz} Hz");
            let imported = imported.unwrap_or_else(|error| panic!("{case}: {error}"));
            let vehicle = scripted(&imported.scenario)[0].clone();
            let speeds_mps = [1.0, 4.0, 7.9].map(|time_s| scripted_mps(&vehicle, time_s));
            for (found_mps, expected_mps) in speeds_mps.into_iter().zip([20.0, 10.0, 0.0]) {
                assert!(
                    (found_mps - expected_mps).abs() < 0.5,
                    "{case}: {speeds_mps:?}"
                );
            }
        }
    }
}

/// A trajectory without times leads the vehicle aside at its own speed, here braking from 2 s on.
#[test]
fn a_trajectory_without_times_follows_the_speed() {
    let text = two_events("parallel", &lane_change("-1"), &after(20.0));
    let vertices = [
        (0.0, 140.0, 0.0),
        (0.0, 190.0, 0.0),
        (0.0, 225.0, -3.5),
        (0.0, 400.0, -3.5),
    ];
    let text = with_initial_trajectory(&text, &vertices, "<None/>");
    let (scenario, notes) = import(&text).unwrap();
    // 25 m after the second vertex, the side of the body of 1.5 m has left the lane: 75 m from the start.
    let passed_s = (20.0 - (400.0 - 4.0 * 35.0_f64).sqrt()) / 2.0;
    assert_near(time_s(scripted(&scenario)[0].leaves), 2.0 + passed_s);
    assert_eq!(speed_mps(&text, 4.0), 16.0);
    assert!(
        notes
            .iter()
            .any(|note| note.contains("up to 0.17 m farther")),
        "{notes:?}"
    );
}

/// The standard leaves open how a vehicle follows a trajectory in the mode `follow`: a note states what it does.
#[test]
fn a_trajectory_in_the_mode_follow_has_a_note() {
    let text = two_events("parallel", &lane_change("-1"), &after(20.0));
    let vertices = [(0.0, 140.0, 0.0), (0.0, 400.0, 0.0)];
    let exact = with_initial_trajectory(&text, &vertices, "<None/>");
    let loose = exact.replace("followingMode=\"position\"", "followingMode=\"follow\"");
    let declared = exact
        .replace("followingMode=\"position\"", "followingMode=\"$mode\"")
        .replace(
            "</ParameterDeclarations>",
            "<ParameterDeclaration name=\"mode\" parameterType=\"string\" value=\"follow\"/></ParameterDeclarations>",
        );
    for (text, expected) in [(&exact, 0), (&loose, 1), (&declared, 1)] {
        let (_, notes) = import(text).unwrap();
        let is_noted = |note: &&String| note.contains("`follow` leaves the motion open");
        assert_eq!(notes.iter().filter(is_noted).count(), expected, "{notes:?}");
    }
    let other = exact.replace("followingMode=\"position\"", "followingMode=\"near\"");
    assert!(import(&other).unwrap_err().to_string().contains("near"));
}

/// An action of the speed stops a trajectory of `Init` with times, and the vehicle keeps its lateral position.
#[test]
fn a_trajectory_of_the_start_is_stopped_by_an_action() {
    let text = two_events("parallel", &lane_change("-1"), &after(20.0));
    let timing = r#"<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>"#;
    let vertices = [(0.0, 140.0, 0.0), (1.0, 160.0, 0.0), (9.0, 320.0, -2.8)];
    let text = with_initial_trajectory(&text, &vertices, timing);
    let (scenario, _) = import(&text).unwrap();
    assert_eq!(scripted(&scenario)[0].leaves, None);
    assert!((speed_mps(&text, 4.0) - 16.0).abs() < 1e-9);
}

/// A change by time that is faster than the vehicle takes as long as the vehicle needs.
#[test]
fn a_change_by_time_stays_within_the_limits() {
    let faster = speed_action("linear", "time", "1", 40.0);
    let text = two_events("override", &faster, &after(4.0));
    let (_, notes) = import(&text).unwrap();
    let expected = "the change takes 4.80 s, because its rate is limited to what the vehicle can drive: 8.0 m/s²";
    let has_note = notes.iter().any(|note| note.contains(expected));
    assert!(has_note, "{notes:?}");
    assert!((speed_mps(&text, 6.0) - 26.0).abs() < 1e-9);
}

/// Without any road, the vehicles drive in the direction of the first one.
#[test]
fn vehicles_without_a_road_drive_along_the_first_one() {
    let text = two_events(
        "parallel",
        &speed_action("linear", "rate", "1", 20.0),
        &after(4.0),
    )
    .replace("<LogicFile filepath=\"f.xodr\"/>", "")
    .replace(
        "<WorldPosition x=\"110\" y=\"-1.75\"/>",
        "<WorldPosition x=\"5\" y=\"7\" h=\"1\"/>",
    )
    .replace(
        same_lane(),
        "<RelativeObjectPosition entityRef=\"ego\" dx=\"30\" dy=\"0\"/>",
    );
    let (scenario, notes) = import(&text).unwrap();
    let [lead, ego] = scenario.vehicles() else {
        panic!("{scenario:?}")
    };
    assert!((lead.position_m - ego.position_m - 30.0).abs() < 1e-6);
    assert!(
        notes
            .iter()
            .any(|note| note.contains("through the first position")),
        "{notes:?}"
    );
}
