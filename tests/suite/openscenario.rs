//! Exports to OpenSCENARIO reproduce the run, according to an independent reader.

use std::iter;

use crumple_exchange::openscenario::export::{
    OpenScenarioError, export_actions, export_trajectories,
};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{AfterCollision, RunOptions, Trace};
use crumple_sim::scenario::{
    Brake, BrakeToSpeed, Driver, LaneChange, LeadProfile, PiecewiseAcceleration, Scenario,
    built_in_scenario, built_in_scenario_names,
};
use proptest::prelude::*;
use roxmltree::{Document, Node};

use crate::generate::{any_scenario, simulate_traced, with_cases};

/// Tolerance: 1 cm, and 1 cm/s.
const TOLERANCE: f64 = 0.01;

fn number_attribute(node: Node<'_, '_>, attribute: &str) -> f64 {
    node.attribute(attribute)
        .expect("stated")
        .parse()
        .expect("a number")
}

fn descendants_named<'a>(
    node: Node<'a, 'a>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'a>> {
    node.descendants()
        .filter(move |element| element.has_tag_name(name))
}

fn single_descendant<'a>(node: Node<'a, 'a>, name: &'static str) -> Node<'a, 'a> {
    let mut elements = descendants_named(node, name);
    let first = elements.next().unwrap_or_else(|| panic!("no {name}"));
    assert!(elements.next().is_none(), "more than one {name}");
    first
}

fn front_offset_m(document: &Document<'_>, entity: &str, length_m: f64) -> f64 {
    let object = descendants_named(document.root_element(), "ScenarioObject")
        .find(|element| element.attribute("name") == Some(entity));
    let (middle, size) = (
        single_descendant(object.expect("declared"), "Center"),
        single_descendant(object.expect("declared"), "Dimensions"),
    );
    assert!((number_attribute(size, "length") - length_m).abs() < 1e-8);
    number_attribute(middle, "x") + length_m / 2.0
}

fn interpolate(points: &[(f64, f64)], time_s: f64) -> f64 {
    match points.partition_point(|(from_s, _)| *from_s <= time_s) {
        0 => points[0].1,
        after if after == points.len() => points[after - 1].1,
        after => {
            let ((t0, x0), (t1, x1)) = (points[after - 1], points[after]);
            x0 + (x1 - x0) * (time_s - t0) / (t1 - t0)
        }
    }
}

/// Positions agree within 1 cm, and speeds within 1 cm/s of the mean over a step.
fn assert_matches_run(scenario: &Scenario, trace: &Trace) {
    let made = export_trajectories(scenario, trace, None, "road.xodr").expect("exports");
    let text = String::from_utf8(made.scenario).expect("UTF-8");
    let document = Document::parse(&text).expect("XML");
    let groups: Vec<_> = descendants_named(document.root_element(), "ManeuverGroup").collect();
    assert_eq!(groups.len(), scenario.vehicles().len());
    assert_eq!(
        descendants_named(document.root_element(), "TrajectoryFollowingMode").count(),
        groups.len()
    );
    let [first_m, last_m] = road_extent_m(&made.road);
    for ((group, track), index) in groups.into_iter().zip(&trace.vehicles).zip(0..) {
        let entity = single_descendant(group, "EntityRef")
            .attribute("entityRef")
            .expect("stated");
        assert_eq!(entity, format!("vehicle_{index}"));
        let front_m = front_offset_m(&document, entity, track.length_m);
        let vertex = |node| {
            (
                number_attribute(node, "time"),
                number_attribute(single_descendant(node, "WorldPosition"), "x") + front_m,
            )
        };
        let mut points: Vec<(f64, f64)> = descendants_named(group, "Vertex").map(vertex).collect();
        let held = points.pop().expect("a vertex");
        assert!(
            points.windows(2).all(|pair| pair[0].0 < pair[1].0),
            "time goes on"
        );
        assert!(
            (held.1 - points.last().expect("a vertex").1).abs() < 1e-9
                && held.0 > points.last().expect("one").0
        );
        for (&time_s, &position_m) in trace.time_s.iter().zip(&track.position_m) {
            let read_m = interpolate(&points, time_s);
            assert!(
                (read_m - position_m).abs() <= TOLERANCE,
                "vehicle {index} at {time_s} s: {read_m}, not {position_m}"
            );
            assert!(
                (first_m..=last_m).contains(&read_m)
                    && (first_m..=last_m).contains(&(read_m - track.length_m))
            );
        }
        for (k, step) in trace
            .time_s
            .windows(2)
            .enumerate()
            .filter(|(_, step)| step[1] - step[0] > 1e-5)
        {
            let duration_s = step[1] - step[0];
            let read_mps =
                (interpolate(&points, step[1]) - interpolate(&points, step[0])) / duration_s;
            let true_mps = (track.position_m[k + 1] - track.position_m[k]) / duration_s;
            assert!(
                (read_mps - true_mps).abs() <= TOLERANCE,
                "vehicle {index} from {} s: {read_mps}, not {true_mps}",
                step[0]
            );
        }
    }
}

fn road_extent_m(xml: &[u8]) -> [f64; 2] {
    let text = std::str::from_utf8(xml).expect("UTF-8");
    let document = Document::parse(text).expect("XML");
    let geometry = single_descendant(document.root_element(), "geometry");
    let lane = single_descendant(single_descendant(document.root_element(), "right"), "lane");
    assert_eq!(
        (
            single_descendant(geometry, "line").attributes().count(),
            lane.attribute("type")
        ),
        (0, Some("driving"))
    );
    assert_eq!(number_attribute(geometry, "hdg"), 0.0);
    assert!(
        (number_attribute(geometry, "y")
            - number_attribute(single_descendant(lane, "width"), "a") / 2.0)
            .abs()
            < 1e-12
    );
    let from_m = number_attribute(geometry, "x");
    [from_m, from_m + number_attribute(geometry, "length")]
}

fn options(after_collision: AfterCollision) -> RunOptions {
    RunOptions::new(BuiltInController::from_name("baseline").expect("built in"))
        .with_after_collision(after_collision)
}

/// On a road of one lane, a vehicle in another lane would overlap the others.
#[test]
fn changes_of_lanes_are_refused() {
    let cut_in = built_in_scenario("paper-1")
        .expect("built in")
        .edited(|spec| {
            spec.vehicles[0].enters = Some(LaneChange::At(1.0));
        });
    let cut_in = cut_in.expect("valid");
    let trace = simulate_traced(&cut_in, &options(AfterCollision::Stop))
        .trace
        .expect("traced");
    for refused in [
        export_trajectories(&cut_in, &trace, None, "road.xodr").err(),
        export_actions(&cut_in, "road.xodr").err(),
    ] {
        assert!(
            matches!(refused, Some(OpenScenarioError::LaneChanges)),
            "{refused:?}"
        );
    }
}

proptest! {
    #![proptest_config(with_cases(200))]

    #[test]
    fn random_scenarios_are_read_back_as_they_ran(scenario in any_scenario(), goes_on: bool) {
        let after_collision = if goes_on { AfterCollision::Continue } else { AfterCollision::Stop };
        assert_matches_run(&scenario, &simulate_traced(&scenario, &options(after_collision)).trace.expect("traced"));
    }

    /// The actions alone reproduce the scripts, until a collision.
    #[test]
    fn scripts_of_random_scenarios_are_driven_from_their_actions(scenario in any_scenario()) {
        let quiet = scenario.edited(|spec| spec.vehicles.iter_mut().for_each(|car| car.acceleration_noise_mps2 = 0.0));
        assert_scripts_are_actions(&quiet.expect("valid"));
    }
}

#[test]
fn scripts_of_every_kind_are_driven_from_their_actions() {
    for (name, _) in built_in_scenario_names() {
        assert_scripts_are_actions(&built_in_scenario(name).expect("built in"));
    }
    let pieces = PiecewiseAcceleration {
        from_s: vec![0.5, 1.25, 4.0],
        accel_mps2: vec![2.0, -7.5, 1.0],
    };
    let scripts = [
        LeadProfile::Brake(Brake {
            onset_s: 1.237,
            rate_mps2: 7.5,
        }),
        LeadProfile::BrakeToSpeed(BrakeToSpeed {
            onset_s: 0.0,
            rate_mps2: 2.0,
            final_speed_mps: 7.5,
        }),
        LeadProfile::BrakeToSpeed(BrakeToSpeed {
            onset_s: 1.0,
            rate_mps2: 2.0,
            final_speed_mps: 60.0,
        }),
        LeadProfile::Brake(Brake {
            onset_s: 1.0,
            rate_mps2: 0.0,
        }),
        LeadProfile::Pieces(pieces),
        LeadProfile::ConstantSpeed,
    ];
    for script in scripts {
        let edited = built_in_scenario("paper-1")
            .expect("built in")
            .edited(|spec| {
                spec.environment.friction = 0.6;
                spec.vehicles[0].driver = Driver::Profile(script.clone());
            });
        assert_scripts_are_actions(&edited.expect("valid"));
    }
}

/// A scripted vehicle has an action and no controller, any other a controller and no action.
fn assert_scripts_are_actions(scenario: &Scenario) {
    let made = export_actions(scenario, "road.xodr").expect("exports");
    let text = String::from_utf8(made.scenario).expect("UTF-8");
    let document = Document::parse(&text).expect("XML");
    let trace = simulate_traced(scenario, &options(AfterCollision::Stop))
        .trace
        .expect("traced");
    for (index, vehicle) in scenario.vehicles().iter().enumerate() {
        let entity = format!("vehicle_{index}");
        let group = descendants_named(document.root_element(), "ManeuverGroup").find(|group| {
            single_descendant(*group, "EntityRef").attribute("entityRef") == Some(&entity)
        });
        let object = descendants_named(document.root_element(), "ScenarioObject")
            .find(|element| element.attribute("name") == Some(&entity));
        let profile = if let Driver::Profile(profile) = &vehicle.driver {
            Some(profile)
        } else {
            None
        };
        let is_scripted = profile.is_some();
        assert_eq!(
            descendants_named(object.expect("declared"), "Controller").count(),
            usize::from(!is_scripted)
        );
        assert!(is_scripted || group.is_none());
        if !is_scripted {
            continue;
        }
        let speeds = group.map_or_else(
            || vec![(0.0, vehicle.speed_mps)],
            |group| speed_profile(group, vehicle.speed_mps),
        );
        let track = &trace.vehicles[index];
        // In the step in which a script first exceeds the road's limit, the profile has the mean of the script, which
        // may be lower.
        let asked_mps2 = profile.map_or(0.0, |profile| -profile.acceleration_range_mps2()[0]);
        let changes = if let Some(LeadProfile::Pieces(pieces)) = profile {
            pieces.from_s.len()
        } else {
            1
        };
        let beyond_mps2 = (asked_mps2 - scenario.usable_brake_mps2(index)).max(0.0);
        let close_mps = TOLERANCE + beyond_mps2 * scenario.spec().step_s * changes as f64;
        // A collision may cut the last step short.
        for (k, &time_s) in trace.time_s.iter().enumerate().rev().skip(1) {
            let (read_mps, true_mps) = (interpolate(&speeds, time_s), track.speed_mps[k]);
            assert!(
                (read_mps - true_mps).abs() <= close_mps,
                "{entity} at {time_s} s: {read_mps}, not {true_mps}"
            );
        }
    }
}

fn speed_profile(group: Node<'_, '_>, start_mps: f64) -> Vec<(f64, f64)> {
    let from_s = number_attribute(
        single_descendant(
            single_descendant(group, "StartTrigger"),
            "SimulationTimeCondition",
        ),
        "value",
    );
    if let Some(action) = descendants_named(group, "SpeedAction").next() {
        let (rate, to_mps) = (
            number_attribute(single_descendant(action, "SpeedActionDynamics"), "value"),
            number_attribute(single_descendant(action, "AbsoluteTargetSpeed"), "value"),
        );
        assert_eq!(
            single_descendant(action, "SpeedActionDynamics").attribute("dynamicsDimension"),
            Some("rate")
        );
        return vec![
            (0.0, start_mps),
            (from_s, start_mps),
            (from_s + (start_mps - to_mps).abs() / rate, to_mps),
        ];
    }
    let mut time_s = from_s;
    let entries = descendants_named(group, "SpeedProfileEntry").map(|entry| {
        time_s += number_attribute(entry, "time");
        (time_s, number_attribute(entry, "speed"))
    });
    iter::once((0.0, start_mps)).chain(entries).collect()
}

#[test]
fn texts_of_users_stay_texts() {
    for wild in [
        "$speed",
        "<a b=\"c\">&amp;",
        "line\nbreak\u{1b}[31m\u{0}\u{fffe}",
        "]]>--",
        "'\"",
    ] {
        let name: String = wild.chars().filter(|c| !c.is_control()).collect();
        let scenario = built_in_scenario("paper-1").expect("built in");
        let scenario = scenario
            .edited(|spec| (spec.name, spec.about) = (name, wild.to_owned()))
            .expect("free texts");
        let made = export_actions(&scenario, "road.xodr").expect("exports");
        for xml in [&made.scenario, &made.road] {
            let text = std::str::from_utf8(xml).expect("UTF-8");
            let document = Document::parse(text).unwrap_or_else(|error| panic!("{error}: {text}"));
            let values = document
                .descendants()
                .flat_map(|node| node.attributes())
                .map(|attribute| attribute.value().to_owned());
            assert!(
                values.into_iter().all(|value| !value.starts_with('$')),
                "a parameter: {text}"
            );
        }
    }
}
