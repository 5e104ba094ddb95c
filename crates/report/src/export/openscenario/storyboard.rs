//! What surrounds the moves: header, road, start, triggers and end.

use std::io;

use super::{Xml, described, entities, entity, leaf, number, reference_m, within};
use crumple_world::scenario::Scenario;

/// The file that moves are written into.
pub(super) struct OpenScenarioFile<'a> {
    pub(super) scenario: &'a Scenario,
    /// Name of the road's file.
    pub(super) road: &'a str,
    /// What the file says of the scenario.
    pub(super) about: &'a str,
    /// When it is over, in seconds.
    pub(super) end_s: f64,
    /// Whether who drives by a rule is left to a controller.
    pub(super) uses_controllers: bool,
}

/// What one vehicle does.
pub(super) trait VehicleManeuver {
    /// The vehicle.
    fn vehicle_index(&self) -> usize;
    /// The event's name, and when it starts, in seconds; none if the vehicle has nothing to do but to drive on.
    fn start_event(&self) -> Option<(&'static str, f64)>;
    /// The private action.
    fn write_action(&self, xml: &mut Xml) -> io::Result<()>;
}

impl OpenScenarioFile<'_> {
    pub(super) fn write(&self, xml: &mut Xml, moves: &[impl VehicleManeuver]) -> io::Result<()> {
        within(xml, "OpenSCENARIO", &[], |xml| {
            let description = described(self.scenario, self.about);
            // No clock: the same scenario makes the same file.
            let made = [("author", "crumple"), ("date", "1970-01-01T00:00:00"), ("description", &description)];
            leaf(xml, "FileHeader", &[&[("revMajor", "1"), ("revMinor", "2")], &made[..]].concat())?;
            leaf(xml, "ParameterDeclarations", &[])?;
            leaf(xml, "CatalogLocations", &[])?;
            within(xml, "RoadNetwork", &[], |xml| leaf(xml, "LogicFile", &[("filepath", self.road)]))?;
            entities::write(xml, self.scenario, self.leaves_drivers)?;
            within(xml, "Storyboard", &[], |xml| {
                within(xml, "Init", &[], |xml| within(xml, "Actions", &[], |xml| self.write_init(xml)))?;
                write_story(xml, moves)?;
                within(xml, "StopTrigger", &[], |xml| at(xml, "over", "greaterThan", self.end_s))
            })
        })
    }

    fn write_init(&self, xml: &mut Xml) -> io::Result<()> {
        let friction = number(self.scenario.spec().environment.friction);
        within(xml, "GlobalAction", &[], |xml| {
            within(xml, "EnvironmentAction", &[], |xml| {
                within(xml, "Environment", &[("name", "road")], |xml| {
                    leaf(xml, "RoadCondition", &[("frictionScaleFactor", &friction)])
                })
            })
        })?;
        for (index, vehicle) in self.scenario.vehicles().iter().enumerate() {
            within(xml, "Private", &[("entityRef", &entity(index))], |xml| {
                within(xml, "PrivateAction", &[], |xml| {
                    within(xml, "TeleportAction", &[], |xml| {
                        position(xml, reference_m(vehicle.position_m, vehicle.length_m()))
                    })
                })?;
                within(xml, "PrivateAction", &[], |xml| {
                    within(xml, "LongitudinalAction", &[], |xml| speed(xml, ("step", "time", 0.0), vehicle.speed_mps))
                })?;
                if !self.leaves_drivers || entities::controller(vehicle).is_none() {
                    return Ok(());
                }
                within(xml, "PrivateAction", &[], |xml| {
                    within(xml, "ControllerAction", &[], |xml| {
                        leaf(xml, "ActivateControllerAction", &[("longitudinal", "true"), ("lateral", "true")])
                    })
                })
            })?;
        }
        Ok(())
    }
}

fn write_story(xml: &mut Xml, moves: &[impl VehicleManeuver]) -> io::Result<()> {
    let moving = || moves.iter().filter_map(|one| Some((one, one.starts()?)));
    if moving().next().is_none() {
        return Ok(());
    }
    within(xml, "Story", &[("name", "story")], |xml| {
        within(xml, "Act", &[("name", "act")], |xml| {
            for (one, (name, from_s)) in moving() {
                let entity = entity(one.index());
                let named = |what: &str| format!("{entity}_{what}");
                within(xml, "ManeuverGroup", &[("maximumExecutionCount", "1"), ("name", &named("group"))], |xml| {
                    within(xml, "Actors", &[("selectTriggeringEntities", "false")], |xml| {
                        leaf(xml, "EntityRef", &[("entityRef", &entity)])
                    })?;
                    within(xml, "Maneuver", &[("name", &named("maneuver"))], |xml| {
                        within(xml, "Event", &[("name", &named("event")), ("priority", "override")], |xml| {
                            within(xml, "Action", &[("name", &named(name))], |xml| {
                                within(xml, "PrivateAction", &[], |xml| one.write(xml))
                            })?;
                            within(xml, "StartTrigger", &[], |xml| at(xml, &named("starts"), "greaterOrEqual", from_s))
                        })
                    })
                })?;
            }
            within(xml, "StartTrigger", &[], |xml| at(xml, "begin", "greaterOrEqual", 0.0))
        })
    })
}

/// A trigger by time.
fn write_time_trigger(xml: &mut Xml, name: &str, rule: &str, time_s: f64) -> io::Result<()> {
    within(xml, "ConditionGroup", &[], |xml| {
        within(xml, "Condition", &[("name", name), ("delay", "0"), ("conditionEdge", "none")], |xml| {
            within(xml, "ByValueCondition", &[], |xml| {
                leaf(xml, "SimulationTimeCondition", &[("value", &number(time_s)), ("rule", rule)])
            })
        })
    })
}

/// A place on the road.
fn write_position(xml: &mut Xml, x_m: f64) -> io::Result<()> {
    within(xml, "Position", &[], |xml| leaf(xml, "WorldPosition", &[("x", &number(x_m)), ("y", "0")]))
}

/// A speed to reach: how it changes, what the number says, and the number.
pub(super) fn write_speed_action(xml: &mut Xml, (shape, dimension, value): (&str, &str, f64), target_mps: f64) -> io::Result<()> {
    within(xml, "SpeedAction", &[], |xml| {
        let dynamics = [("dynamicsShape", shape), ("dynamicsDimension", dimension), ("value", &number(value))];
        leaf(xml, "SpeedActionDynamics", &dynamics)?;
        within(xml, "SpeedActionTarget", &[], |xml| leaf(xml, "AbsoluteTargetSpeed", &[("value", &number(target_mps))]))
    })
}
