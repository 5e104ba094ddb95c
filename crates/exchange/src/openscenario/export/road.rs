//! A straight road of one lane, long enough for the run.

use std::io;

use super::{
    OpenScenarioError, Xml, attribute_text, format_number, write_document, write_element,
    write_empty_element,
};
use crumple_sim::engine::Trace;
use crumple_sim::scenario::Scenario;

/// Width of the lane, in metres: that of a German motorway lane of type RQ 31 (RAA 2008).
const LANE_WIDTH_M: f64 = 3.75;
/// Length of road behind the last position and ahead of the first, in metres.
const MARGIN_M: f64 = 100.0;

pub(super) fn road_for_trace(
    scenario: &Scenario,
    trace: &Trace,
) -> Result<Vec<u8>, OpenScenarioError> {
    let tracks = &trace.vehicles;
    let rears_m = tracks
        .iter()
        .filter_map(|track| Some(track.position_m.first()? - track.length_m));
    let fronts_m = tracks
        .iter()
        .filter_map(|track| track.position_m.last().copied());
    straight_road(scenario, rears_m, fronts_m)
}

/// Returns a road for vehicles at twice the largest initial or scripted speed, and at least twice 30 m/s.
pub(super) fn road_for_scenario(
    scenario: &Scenario,
    scripts_mps: f64,
) -> Result<Vec<u8>, OpenScenarioError> {
    let duration_s = scenario.spec().duration_s;
    let vehicles = scenario.vehicles();
    let fastest_mps = vehicles
        .iter()
        .map(|vehicle| vehicle.speed_mps)
        .fold(scripts_mps.max(30.0), f64::max);
    let rears_m = vehicles
        .iter()
        .map(|vehicle| vehicle.position_m - vehicle.length_m());
    let fronts_m = vehicles
        .iter()
        .map(|vehicle| vehicle.position_m + 2.0 * fastest_mps * duration_s);
    straight_road(scenario, rears_m, fronts_m)
}

fn straight_road(
    scenario: &Scenario,
    rears_m: impl Iterator<Item = f64>,
    fronts_m: impl Iterator<Item = f64>,
) -> Result<Vec<u8>, OpenScenarioError> {
    let rearmost_m = rears_m.fold(f64::INFINITY, f64::min);
    let foremost_m = fronts_m.fold(f64::NEG_INFINITY, f64::max);
    let [rearmost_m, foremost_m] = if rearmost_m <= foremost_m {
        [rearmost_m, foremost_m]
    } else {
        [0.0, 0.0]
    };
    let from_m = (rearmost_m - MARGIN_M).floor();
    let length = format_number((foremost_m + MARGIN_M).ceil() - from_m);
    Ok(write_document(|xml| {
        write_road(xml, &attribute_text(&scenario.spec().name), from_m, &length)
    })?)
}

fn write_road(xml: &mut Xml, name: &str, from_m: f64, length: &str) -> io::Result<()> {
    write_element(xml, "OpenDRIVE", &[], |xml| {
        let header = [
            ("revMajor", "1"),
            ("revMinor", "7"),
            ("name", name),
            ("vendor", "crumple"),
        ];
        write_empty_element(xml, "header", &header)?;
        // The identifier is a number, because some tools require one.
        let road = [
            ("name", "road"),
            ("length", length),
            ("id", "1"),
            ("junction", "-1"),
            ("rule", "RHT"),
        ];
        write_element(xml, "road", &road, |xml| {
            // The right-hand lane is below the reference line, so that y = 0 is its middle.
            let [x, y] = [from_m, LANE_WIDTH_M / 2.0].map(format_number);
            let start = [
                ("s", "0"),
                ("x", &x),
                ("y", &y),
                ("hdg", "0"),
                ("length", length),
            ];
            write_element(xml, "planView/geometry", &start, |xml| {
                write_empty_element(xml, "line", &[])
            })?;
            write_element(xml, "lanes/laneSection", &[("s", "0")], write_lanes)
        })
    })
}

fn write_lanes(xml: &mut Xml) -> io::Result<()> {
    write_element(
        xml,
        "center/lane",
        &[("id", "0"), ("type", "none"), ("level", "false")],
        write_road_mark,
    )?;
    write_element(
        xml,
        "right/lane",
        &[("id", "-1"), ("type", "driving"), ("level", "false")],
        |xml| {
            let width = format_number(LANE_WIDTH_M);
            write_empty_element(
                xml,
                "width",
                &[
                    ("sOffset", "0"),
                    ("a", &width),
                    ("b", "0"),
                    ("c", "0"),
                    ("d", "0"),
                ],
            )?;
            write_road_mark(xml)
        },
    )
}

fn write_road_mark(xml: &mut Xml) -> io::Result<()> {
    let solid = [
        ("sOffset", "0"),
        ("type", "solid"),
        ("weight", "standard"),
        ("color", "standard"),
        ("width", "0.15"),
    ];
    write_empty_element(xml, "roadMark", &solid)
}
