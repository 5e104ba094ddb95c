//! Runs and scenarios for other simulators: ASAM OpenSCENARIO XML 1.2, on a straight road in ASAM OpenDRIVE 1.7.
//!
//! [`export_trajectories`] writes the motion of every vehicle as timed polylines. [`export_actions`] writes the
//! scripted vehicles as actions with triggers, and leaves the others to the user's controllers.
//!
//! x runs along the road and y = 0 is the middle of its one lane. Positions of OpenSCENARIO refer to the point below
//! the middle of the rear axle, those of crumple to the front bumper. The distance is four fifths of the vehicle's
//! length, as the bounding box states. Widths, heights and axles are assumptions, because crumple's vehicles have none.

mod actions;
mod entities;
mod polyline;
mod report;
mod road;
mod storyboard;

use std::io;

pub use report::{ExportReport, ExportedController, ExportedScenario};

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesEnd, BytesStart, Event};

use super::{ABOUT_ACTIONS, DESCRIPTION_ABOUT, DESCRIPTION_START};
use crumple_core::quoting::strip_unprintable;
use crumple_sim::engine::Trace;
use crumple_sim::scenario::Scenario;

/// Maximum number of vertices of one file: 100 MB.
pub(crate) const MAX_VERTICES: usize = 1_000_000;

/// A scenario for other simulators.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenScenario {
    /// Content of the OpenSCENARIO file.
    pub scenario: Vec<u8>,
    /// Content of the OpenDRIVE file that it names.
    pub road: Vec<u8>,
    /// Number of vertices of polylines, or of entries of speed profiles.
    pub vertices: usize,
}

/// An error of exporting a scenario.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenScenarioError {
    /// There are more vertices than the limit.
    #[error(
        "takes {found} vertices, and an OpenSCENARIO file may have {MAX_VERTICES}: shorten the scenario"
    )]
    TooLong {
        /// Number of vertices.
        found: usize,
    },
    /// Vehicles change lanes, but the exported road has one lane.
    #[error("vehicles enter or leave the lane, and the road that is exported has one lane")]
    LaneChanges,
    /// Players of OpenSCENARIO files move vehicles as point masses.
    #[error(
        "a vehicle has the plant `multi-body`, which OpenSCENARIO files cannot state: export the trajectories"
    )]
    Plant,
    /// A script cannot be simulated alone.
    #[error("vehicle {vehicle}: cannot be driven alone: {why}")]
    Script {
        /// Index of the scripted vehicle.
        vehicle: usize,
        /// Reason in words.
        why: String,
    },
    /// The writer failed.
    #[error("cannot write XML: {0}")]
    Xml(#[from] io::Error),
}

type Xml = Writer<Vec<u8>>;

/// Rejects vehicles outside the lane: on a road of one lane they would drive through others.
fn check_single_lane(scenario: &Scenario) -> Result<(), OpenScenarioError> {
    if scenario.keeps_lanes() {
        Ok(())
    } else {
        Err(OpenScenarioError::LaneChanges)
    }
}

/// Exports the motion of every vehicle as one polyline each, in absolute time. Polylines end where the run ended; a
/// last vertex one second later holds the position, so that no simulator takes over before the scenario stops.
///
/// Read back, positions are within `POSITION_TOLERANCE_M`, and speeds over more than one step within
/// `SPEED_TOLERANCE_MPS`. `controller` names the controller of the vehicles under test, for the header. `road` is the
/// name of the OpenDRIVE file as the scenario states it.
///
/// # Errors
/// [`OpenScenarioError::TooLong`] for more than `MAX_VERTICES`, [`OpenScenarioError::LaneChanges`] if vehicles enter or
/// leave the lane.
pub fn export_trajectories(
    scenario: &Scenario,
    trace: &Trace,
    controller: Option<&str>,
    road: &str,
) -> Result<OpenScenario, OpenScenarioError> {
    check_single_lane(scenario)?;
    let end_s = trace.time_s.last().copied().unwrap_or(0.0);
    let tracks = trace.vehicles.iter().enumerate();
    let moves: Vec<_> = tracks
        .map(|(index, track)| polyline::Trajectory {
            index,
            trace,
            vertex_indices: polyline::vertex_indices(&trace.time_s, track),
            end_s,
        })
        .collect();
    let vertices = moves
        .iter()
        .map(|trajectory| trajectory.vertex_indices.len());
    let vertices = check_vertex_count(vertices.sum())?;
    let under = controller.map_or_else(String::new, |controller| format!(" under `{controller}`"));
    let about = &format!("what every vehicle did{under}, as trajectories");
    let file = storyboard::OpenScenarioFile {
        scenario,
        road,
        about,
        end_s,
        uses_controllers: false,
    };
    Ok(OpenScenario {
        scenario: write_document(|xml| file.write(xml, &moves))?,
        road: road::road_for_trace(scenario, trace)?,
        vertices,
    })
}

/// Exports the actions of the scripted vehicles, which are independent of the others. The others have a controller that
/// the user fills: vehicles under test, and those of a built-in controller, with its name. Acceleration noise of
/// scripted vehicles is omitted.
///
/// # Errors
/// [`OpenScenarioError::TooLong`] for more than `MAX_VERTICES`, [`OpenScenarioError::LaneChanges`] if vehicles enter or
/// leave the lane, and [`OpenScenarioError::Script`] for a script that cannot be simulated alone, which no valid
/// scenario has.
pub fn export_actions(scenario: &Scenario, road: &str) -> Result<OpenScenario, OpenScenarioError> {
    if !scenario.has_only_point_masses() {
        return Err(OpenScenarioError::Plant);
    }
    check_single_lane(scenario)?;
    let scenario = &round_as_written(scenario);
    let moves = actions::scripted_vehicles(scenario)?;
    let vertices = check_vertex_count(moves.iter().map(|vehicle| vehicle.profile().len()).sum())?;
    let end_s = scenario.spec().duration_s;
    let scripts_mps = moves
        .iter()
        .flat_map(|vehicle| vehicle.profile())
        .map(|(_, mps)| *mps)
        .fold(0.0, f64::max);
    let file = storyboard::OpenScenarioFile {
        scenario,
        road,
        about: ABOUT_ACTIONS,
        end_s,
        uses_controllers: true,
    };
    Ok(OpenScenario {
        scenario: write_document(|xml| file.write(xml, &moves))?,
        road: road::road_for_scenario(scenario, scripts_mps)?,
        vertices,
    })
}

/// Rounds limits and lengths as the file states them, so that what follows from them is the same after an import.
fn round_as_written(scenario: &Scenario) -> Scenario {
    let rounded = scenario.edited(|spec| {
        spec.environment.friction = round(spec.environment.friction);
        for vehicle in &mut spec.vehicles {
            vehicle.speed_mps = round(vehicle.speed_mps);
            vehicle.length_m = Some(round(vehicle.length_m()));
            vehicle.max_brake_mps2 = Some(round(vehicle.max_brake_mps2()));
            vehicle.max_accel_mps2 = Some(round(vehicle.max_accel_mps2()));
        }
    });
    // Rounding can make only a scenario at a limit invalid.
    rounded.unwrap_or_else(|_| scenario.clone())
}

fn round(value: f64) -> f64 {
    // Adding zero turns -0 into 0.
    (value * 1e9).round() / 1e9 + 0.0
}

fn check_vertex_count(count: usize) -> Result<usize, OpenScenarioError> {
    if count > MAX_VERTICES {
        Err(OpenScenarioError::TooLong { found: count })
    } else {
        Ok(count)
    }
}

fn write_document(content: impl FnOnce(&mut Xml) -> io::Result<()>) -> io::Result<Vec<u8>> {
    let mut xml = Writer::new_with_indent(Vec::new(), b' ', 1);
    xml.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    content(&mut xml)?;
    let mut text = xml.into_inner();
    text.push(b'\n');
    Ok(text)
}

/// Writes an element. `path` is its name, after those of the elements around it that have no attributes and no other
/// content.
fn write_element(
    xml: &mut Xml,
    path: &str,
    attributes: &[(&str, &str)],
    content: impl FnOnce(&mut Xml) -> io::Result<()>,
) -> io::Result<()> {
    write_inside(xml, path, |xml, name| {
        xml.create_element(name)
            .with_attributes(attributes.iter().copied())
            .write_inner_content(content)
            .map(drop)
    })
}

/// Writes an element without content, as [`write_element`] does.
fn write_empty_element(xml: &mut Xml, path: &str, attributes: &[(&str, &str)]) -> io::Result<()> {
    write_inside(xml, path, |xml, name| {
        xml.create_element(name)
            .with_attributes(attributes.iter().copied())
            .write_empty()
            .map(drop)
    })
}

fn write_inside(
    xml: &mut Xml,
    path: &str,
    write: impl FnOnce(&mut Xml, &str) -> io::Result<()>,
) -> io::Result<()> {
    let names: Vec<&str> = path.split('/').collect();
    let Some((name, around)) = names.split_last() else {
        return Ok(());
    };
    around
        .iter()
        .try_for_each(|name| xml.write_event(Event::Start(BytesStart::new(*name))))?;
    write(xml, name)?;
    around
        .iter()
        .rev()
        .try_for_each(|name| xml.write_event(Event::End(BytesEnd::new(*name))))
}

/// Formats a number with at most nine decimals, more than any position needs.
fn format_number(value: f64) -> String {
    round(value).to_string()
}

/// Returns text as an attribute value: one line of characters that XML allows. A leading dollar sign would start a
/// parameter name in OpenSCENARIO, so a blank is put before it.
fn attribute_text(text: &str) -> String {
    let text = strip_unprintable(text);
    if text.starts_with('$') {
        format!(" {text}")
    } else {
        text
    }
}

fn entity_name(index: usize) -> String {
    format!("vehicle_{index}")
}

fn reference_point_m(front_m: f64, length_m: f64) -> f64 {
    front_m - length_m * (1.0 - entities::REAR_OVERHANG_SHARE)
}

fn describe_scenario(scenario: &Scenario, about: &str) -> String {
    let spec = scenario.spec();
    let own = if spec.about.is_empty() {
        String::new()
    } else {
        format!("{DESCRIPTION_ABOUT}{}", spec.about)
    };
    attribute_text(&format!("{DESCRIPTION_START}{}: {about}.{own}", spec.name))
        .trim_end()
        .to_owned()
}
