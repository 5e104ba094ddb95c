//! The frame of the maneuvers: header, road, initial state, triggers and end.

use std::io;

use super::{
    Xml, describe_scenario, entities, entity_name, format_number, reference_point_m, write_element,
    write_empty_element,
};
use crate::openscenario::vocabulary::{
    Priority, Rule, TransitionDimension, TransitionShape, Word as _, path,
};
use crumple_sim::scenario::{Scenario, VehicleSpec};

/// A file to which maneuvers are written.
pub(super) struct OpenScenarioFile<'a> {
    pub(super) scenario: &'a Scenario,
    pub(super) road: &'a str,
    pub(super) about: &'a str,
    /// End of the scenario, in seconds.
    pub(super) end_s: f64,
    /// True if vehicles without a script get a controller element.
    pub(super) uses_controllers: bool,
}

/// The maneuver of one vehicle.
pub(super) trait VehicleManeuver {
    fn vehicle_index(&self) -> usize;
    /// Returns the name and start time of the event, in seconds; `None` if the vehicle keeps its speed.
    fn start_event(&self) -> Option<(&'static str, f64)>;
    fn write_action(&self, xml: &mut Xml) -> io::Result<()>;
}

impl OpenScenarioFile<'_> {
    pub(super) fn write(
        &self,
        xml: &mut Xml,
        maneuvers: &[impl VehicleManeuver],
    ) -> io::Result<()> {
        write_element(xml, "OpenSCENARIO", &[], |xml| {
            let description = describe_scenario(self.scenario, self.about);
            // A fixed date: the same scenario gives the same file.
            let origin = [
                ("author", "crumple"),
                ("date", "1970-01-01T00:00:00"),
                ("description", &description),
            ];
            write_empty_element(
                xml,
                "FileHeader",
                &[&[("revMajor", "1"), ("revMinor", "2")], &origin[..]].concat(),
            )?;
            write_empty_element(xml, "ParameterDeclarations", &[])?;
            write_empty_element(xml, "CatalogLocations", &[])?;
            write_empty_element(xml, "RoadNetwork/LogicFile", &[("filepath", self.road)])?;
            entities::write_entities(xml, self.scenario, self.uses_controllers)?;
            write_element(xml, "Storyboard", &[], |xml| {
                write_element(xml, "Init/Actions", &[], |xml| self.write_init(xml))?;
                write_story(xml, maneuvers)?;
                write_time_trigger(xml, ("StopTrigger", "over"), Rule::GreaterThan, self.end_s)
            })
        })
    }

    fn write_init(&self, xml: &mut Xml) -> io::Result<()> {
        let friction = format_number(self.scenario.spec().environment.friction);
        write_element(
            xml,
            "GlobalAction/EnvironmentAction/Environment",
            &[("name", "road")],
            |xml| write_empty_element(xml, "RoadCondition", &[("frictionScaleFactor", &friction)]),
        )?;
        for (index, vehicle) in self.scenario.vehicles().iter().enumerate() {
            let entity = entity_name(index);
            write_element(xml, "Private", &[("entityRef", &entity)], |xml| {
                self.write_initial_actions(xml, vehicle)
            })?;
        }
        Ok(())
    }

    /// Writes the initial position and speed of a vehicle, and the activation of its controller.
    fn write_initial_actions(&self, xml: &mut Xml, vehicle: &VehicleSpec) -> io::Result<()> {
        let action = |path: &str| format!("PrivateAction/{path}");
        let x = format_number(reference_point_m(vehicle.position_m, vehicle.length_m()));
        let position = action(&format!(
            "{}/{}",
            path::TELEPORT_ACTION,
            path::WORLD_POSITION
        ));
        write_empty_element(xml, &position, &[("x", &x), ("y", "0")])?;
        write_element(xml, "PrivateAction", &[], |xml| {
            let at_once = (TransitionShape::Step, TransitionDimension::Time, 0.0);
            write_speed_action(xml, at_once, vehicle.speed_mps)
        })?;
        if !self.uses_controllers || entities::controller_name(vehicle).is_none() {
            return Ok(());
        }
        let activate = action(&format!("{}/{}", path::CONTROLLER_ACTION, path::ACTIVATION));
        let both = [("longitudinal", "true"), ("lateral", "true")];
        write_empty_element(xml, &activate, &both)
    }
}

fn write_story(xml: &mut Xml, maneuvers: &[impl VehicleManeuver]) -> io::Result<()> {
    if maneuvers
        .iter()
        .all(|maneuver| maneuver.start_event().is_none())
    {
        return Ok(());
    }
    write_element(xml, "Story", &[("name", "story")], |xml| {
        write_element(xml, "Act", &[("name", "act")], |xml| {
            for maneuver in maneuvers {
                write_maneuver_group(xml, maneuver)?;
            }
            write_time_trigger(xml, ("StartTrigger", "begin"), Rule::GreaterOrEqual, 0.0)
        })
    })
}

/// Writes the maneuver of a vehicle, unless the vehicle keeps its speed.
fn write_maneuver_group(xml: &mut Xml, maneuver: &impl VehicleManeuver) -> io::Result<()> {
    let Some((event, start_s)) = maneuver.start_event() else {
        return Ok(());
    };
    let entity = entity_name(maneuver.vehicle_index());
    let [
        group_name,
        maneuver_name,
        event_name,
        action_name,
        trigger_name,
    ] = ["group", "maneuver", "event", event, "starts"].map(|part| format!("{entity}_{part}"));
    let group = [("maximumExecutionCount", "1"), ("name", &*group_name)];
    write_element(xml, "ManeuverGroup", &group, |xml| {
        let actors = [("selectTriggeringEntities", "false")];
        write_element(xml, "Actors", &actors, |xml| {
            write_empty_element(xml, "EntityRef", &[("entityRef", &entity)])
        })?;
        write_element(xml, "Maneuver", &[("name", &maneuver_name)], |xml| {
            let event = [
                ("name", &*event_name),
                ("priority", Priority::Override.name()),
            ];
            write_element(xml, "Event", &event, |xml| {
                write_element(xml, "Action", &[("name", &action_name)], |xml| {
                    write_element(xml, "PrivateAction", &[], |xml| maneuver.write_action(xml))
                })?;
                let trigger = ("StartTrigger", &*trigger_name);
                write_time_trigger(xml, trigger, Rule::GreaterOrEqual, start_s)
            })
        })
    })
}

fn write_time_trigger(
    xml: &mut Xml,
    (trigger, name): (&str, &str),
    rule: Rule,
    time_s: f64,
) -> io::Result<()> {
    let condition = [("name", name), ("delay", "0"), ("conditionEdge", "none")];
    write_element(
        xml,
        &format!("{trigger}/ConditionGroup/Condition"),
        &condition,
        |xml| {
            let time = [("value", &*format_number(time_s)), ("rule", rule.name())];
            write_empty_element(xml, path::SIMULATION_TIME, &time)
        },
    )
}

/// Writes a speed action. Arguments of the dynamics: shape, dimension, and value.
pub(super) fn write_speed_action(
    xml: &mut Xml,
    (shape, dimension, value): (TransitionShape, TransitionDimension, f64),
    target_mps: f64,
) -> io::Result<()> {
    write_element(xml, path::SPEED_ACTION, &[], |xml| {
        let dynamics = [
            ("dynamicsShape", shape.name()),
            ("dynamicsDimension", dimension.name()),
            ("value", &format_number(value)),
        ];
        write_empty_element(xml, "SpeedActionDynamics", &dynamics)?;
        let target = format_number(target_mps);
        write_empty_element(
            xml,
            "SpeedActionTarget/AbsoluteTargetSpeed",
            &[("value", &target)],
        )
    })
}
