//! Runs and scenarios for other simulators: ASAM OpenSCENARIO XML 1.2, on a straight road in ASAM OpenDRIVE 1.7.
//!
//! [`trajectories`] says what every vehicle did, as timed polylines; [`actions`] says what the scripted vehicles do, as
//! actions with triggers, and leaves all that are driven by controllers to those of the user.
//!
//! x runs along the road and y = 0 is the middle of its one lane. Positions of OpenSCENARIO are those of a vehicle's
//! reference point, under the middle of its rear axle; crumple's are those of its front bumper. Between them lie four fifths
//! of the vehicle's length, and the bounding box says so. Widths, heights and axles are ours: crumple's vehicles have none.

mod actions;
mod entities;
mod polyline;
mod road;
mod storyboard;

use std::io;

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, Event};

use crumple_world::scenario::Scenario;
use crumple_world::sim::Trace;

use crate::draw::strip_unprintable;

/// Most vertices of one file: 100 MB of them.
pub(crate) const MAX_VERTICES: usize = 1_000_000;

/// A scenario for other simulators.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenScenario {
    /// The OpenSCENARIO file.
    pub scenario: Vec<u8>,
    /// The OpenDRIVE file that it names.
    pub road: Vec<u8>,
    /// Vertices of polylines, or entries of speed profiles.
    pub vertices: usize,
}

/// Why a scenario could not be exported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenScenarioError {
    /// More vertices than any simulator should have to read.
    #[error("takes {found} vertices, and an OpenSCENARIO file may have {MAX_VERTICES}: shorten the scenario")]
    TooLong {
        /// How many it takes.
        found: usize,
    },
    /// The road has one lane.
    #[error("vehicles enter or leave the lane, and the road that is exported has one lane")]
    LaneChanges,
    /// A script that cannot be driven by itself.
    #[error("vehicle {vehicle}: cannot be driven alone: {why}")]
    Script {
        /// The scripted vehicle.
        vehicle: usize,
        /// Why.
        why: String,
    },
    /// The writer failed.
    #[error("cannot write XML: {0}")]
    Xml(#[from] io::Error),
}

type Xml = Writer<Vec<u8>>;

/// Refuses who drives beside the lane: on a road of one lane it would drive through the others.
fn check_single_lane(scenario: &Scenario) -> Result<(), OpenScenarioError> {
    if scenario.keeps_lanes() { Ok(()) } else { Err(OpenScenarioError::LaneChanges) }
}

/// What every vehicle did: one polyline each, in absolute time. Where the run ended in a contact, so do they; a second later
/// a last vertex holds the place, so that no simulator takes over before the scenario stops.
///
/// Read back, positions are within `POSITION_TOLERANCE_M`, and speeds over more than one step within `SPEED_TOLERANCE_MPS`.
/// `controller` names what drove the vehicles under test, for the header; a description of the scenario may name another one. `road`
/// is the name of the OpenDRIVE file as the scenario gives it.
///
/// # Errors
/// [`OpenScenarioError::TooLong`] for more than `MAX_VERTICES`, [`OpenScenarioError::LaneChanges`] where vehicles enter or leave the
/// lane.
pub fn export_trajectories(
    scenario: &Scenario,
    trace: &Trace,
    controller: Option<&str>,
    road: &str,
) -> Result<OpenScenario, OpenScenarioError> {
    check_single_lane(scenario)?;
    let kept: Vec<Vec<usize>> =
        trace.vehicles.iter().map(|track| polyline::vertex_indices(&trace.time_s, track)).collect();
    let vertices = check_vertex_count(kept.iter().map(Vec::len).sum())?;
    let end_s = trace.time_s.last().copied().unwrap_or(0.0);
    let moves: Vec<_> = kept
        .iter()
        .enumerate()
        .map(|(index, kept)| polyline::Trajectory { index, trace, vertex_indices: kept, end_s })
        .collect();
    let under = controller.map_or_else(String::new, |controller| format!(" under `{controller}`"));
    let about = &format!("what every vehicle did{under}, as trajectories");
    let file = storyboard::OpenScenarioFile { scenario, road, about, end_s, uses_controllers: false };
    Ok(OpenScenario {
        scenario: write_document(|xml| file.write(xml, &moves))?,
        road: road::road_for_trace(scenario, trace)?,
        vertices,
    })
}

/// What the scripted vehicles do, whatever the others do. The others keep a controller that the user fills: those under test,
/// and those that crumple drives by a rule, whose name the controller then has.
///
/// Noise of a scripted vehicle's acceleration is left out.
///
/// # Errors
/// [`OpenScenarioError::TooLong`] for more than `MAX_VERTICES`, [`OpenScenarioError::LaneChanges`] where vehicles enter or leave the
/// lane, and [`OpenScenarioError::Script`] for a script that cannot be driven alone, which no valid scenario has.
pub fn export_actions(scenario: &Scenario, road: &str) -> Result<OpenScenario, OpenScenarioError> {
    check_single_lane(scenario)?;
    let moves = actions::scripted_vehicles(scenario)?;
    let vertices = check_vertex_count(moves.iter().map(actions::ScriptedVehicle::profile_entry_count).sum())?;
    let end_s = scenario.spec().duration_s;
    let scripts_mps = moves.iter().map(actions::ScriptedVehicle::max_speed_mps).fold(0.0, f64::max);
    let about = "what the scripted vehicles do; the others are left to controllers";
    let file = storyboard::OpenScenarioFile { scenario, road, about, end_s, uses_controllers: true };
    Ok(OpenScenario {
        scenario: write_document(|xml| file.write(xml, &moves))?,
        road: road::road_for_scenario(scenario, scripts_mps)?,
        vertices,
    })
}

fn check_vertex_count(found: usize) -> Result<usize, OpenScenarioError> {
    if found > MAX_VERTICES { Err(OpenScenarioError::TooLong { found }) } else { Ok(found) }
}

fn write_document(content: impl FnOnce(&mut Xml) -> io::Result<()>) -> io::Result<Vec<u8>> {
    let mut xml = Writer::new_with_indent(Vec::new(), b' ', 1);
    xml.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    content(&mut xml)?;
    let mut text = xml.into_inner();
    text.push(b'\n');
    Ok(text)
}

/// An element with others in it.
fn write_element(
    xml: &mut Xml,
    name: &str,
    attributes: &[(&str, &str)],
    content: impl FnOnce(&mut Xml) -> io::Result<()>,
) -> io::Result<()> {
    xml.create_element(name).with_attributes(attributes.iter().copied()).write_inner_content(content)?;
    Ok(())
}

/// An element without others in it.
fn write_empty_element(xml: &mut Xml, name: &str, attributes: &[(&str, &str)]) -> io::Result<()> {
    xml.create_element(name).with_attributes(attributes.iter().copied()).write_empty()?;
    Ok(())
}

/// A number to a billionth, which no place on a road is known to.
fn format_number(value: f64) -> String {
    // Adding zero turns -0 into 0.
    ((value * 1e9).round() / 1e9 + 0.0).to_string()
}

/// What a user wrote, as the value of an attribute: one line of what XML allows. What begins with a dollar sign is a
/// parameter's name in OpenSCENARIO, so it gets a blank before it.
fn attribute_text(written: &str) -> String {
    let text = strip_unprintable(written);
    if text.starts_with('$') { format!(" {text}") } else { text }
}

/// The name of a vehicle among the entities.
fn entity_name(index: usize) -> String {
    format!("vehicle_{index}")
}

/// Where the reference point is when the front bumper is at `front_m`.
fn reference_point_m(front_m: f64, length_m: f64) -> f64 {
    front_m - length_m * (1.0 - entities::REAR_OVERHANG_SHARE)
}

/// A scenario's name and what it is about, as a description.
fn describe_scenario(scenario: &Scenario, about: &str) -> String {
    let spec = scenario.spec();
    let own = if spec.about.is_empty() { String::new() } else { format!(" The scenario: {}", spec.about) };
    attribute_text(&format!("crumple scenario {}: {about}.{own}", spec.name)).trim_end().to_owned()
}
