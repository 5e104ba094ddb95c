//! The scenario on one lane that a replay gives.

use super::ImportedLaneScenario;
use super::entities::{Entity, MAX_LIMIT_MPS2};
use super::error::ScenarioImportError;
use super::lateral::LaneStay;
use super::limits::{MAX_VEHICLE_STEPS, WORK_PER_SAMPLE};
use super::replay::{EntityMotion, REPLAY_STEP_S, Replay};
use super::speed_plan::{SpeedKnot, SpeedPlan};
use super::trigger::Firing;
use super::vocabulary::ElementKind;
use super::xml::{ElementLocation, Node};
use crumple_core::digits::{format_fixed, format_number};
use crumple_sim::scenario::{
    Driver, InvalidField, LaneChange, LeadProfile, Scenario, ScenarioSpec, VehicleSpec,
};

use std::collections::BTreeSet;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest distance between a script and its motion within the limits of the vehicle, in metres.
const FOLLOW_TOLERANCE_M: f64 = 0.01;

/// Acceleration beyond a limit that raises none, in m/s²: that of calculations.
const NO_RAISE_MPS2: f64 = 1e-6;

/// Time after the end at which a vehicle that stays beside the lane would enter it, in seconds.
const BESIDE_S: f64 = 1.0;

/// The replay, and what the scenario takes from the rest of the file.
pub(super) struct LaneScenarioBuilder<'a, 'b> {
    pub(super) storyboard: Node<'a>,
    pub(super) replay: Replay<'a, 'b>,
    pub(super) drivers: Vec<Option<Driver>>,
    pub(super) stop: Firing,
    pub(super) name: String,
    pub(super) about: String,
}

/// The lane of the vehicle under test.
struct LaneUnderTest {
    /// Lateral positions of its edges, in metres.
    edges_m: [f64; 2],
    /// Direction of travel of the vehicle under test.
    direction: f64,
}

/// A vehicle before it has its place in the list.
#[derive(Clone)]
struct LaneVehicle {
    entity: usize,
    spec: VehicleSpec,
    /// Time of entry, in seconds of the replay; negative infinity if the vehicle is in the lane at the start.
    enters_s: f64,
    notes: Vec<String>,
}

/// Change of the speed of a script in one step.
struct SpeedStep {
    /// Time before the change, in seconds.
    time_s: f64,
    rate_mps2: f64,
}

impl<'a> LaneScenarioBuilder<'a, '_> {
    pub(super) fn build(mut self) -> Result<ImportedLaneScenario> {
        let start_s = self.start_s();
        self.check_duration(start_s)?;
        self.note_assumptions(start_s);
        self.check_work(start_s)?;
        let lane = self.lane_under_test(start_s)?;
        let mut vehicles: Vec<LaneVehicle> = Vec::new();
        let mut absent = Vec::new();
        for entity in 0..self.drivers.len() {
            let stays = self.stays(entity, &lane, start_s)?;
            if stays.is_empty() {
                absent.push(entity);
            } else {
                self.add_vehicle(entity, stays, start_s, &mut vehicles)?;
            }
        }
        self.add_absent(&absent, start_s, &mut vehicles)?;
        if let [only] = vehicles.as_slice()
            && let Some(motion) = self.replay.motion.get(only.entity)
        {
            // No vehicle ahead keeps it on the straight part.
            self.check_road(motion)?;
        }
        self.add_second_vehicle(start_s, &mut vehicles);
        let mut vehicles = self.order(vehicles);
        for index in 0..vehicles.len() {
            self.set_entry_gap(&mut vehicles, index, start_s)?;
        }
        let entities: Vec<usize> = vehicles.iter().map(|vehicle| vehicle.entity).collect();
        let vehicles = vehicles.into_iter().map(|vehicle| vehicle.spec).collect();
        let scenario = Scenario::new(self.scenario_spec(vehicles, start_s))
            .map_err(|invalid| self.outside_ranges(invalid, &entities))?;
        Ok(ImportedLaneScenario {
            scenario,
            largest_motion: self.largest_motion(),
            notes: self.replay.notes,
        })
    }

    /// Returns file, line and name of the last action of the motion with the most samples.
    fn largest_motion(&self) -> String {
        let samples = |motion: &&EntityMotion<'a>| motion.plan.knots().len();
        let largest = self.replay.motion.iter().max_by_key(samples);
        let action = largest.and_then(|motion| motion.action(self.stop.time_s));
        let ElementLocation { path, line, name } = action.unwrap_or(self.storyboard).location();
        format!("{}:{line}: {name}", path.display())
    }

    /// Returns the lane of the vehicle under test; without one, that of the first entity.
    fn lane_under_test(&self, start_s: f64) -> Result<LaneUnderTest> {
        let under_test = self
            .drivers
            .iter()
            .position(|driver| *driver == Some(Driver::UnderTest));
        let entity = under_test.unwrap_or(0);
        let node = self.replay.entities.get(entity);
        let node = node.map_or(self.storyboard, |entity| entity.node);
        let lane = self
            .replay
            .road
            .lane_at(self.replay.lateral_m(entity, start_s));
        let lane = lane.ok_or_else(|| node.refuse("is beside the lanes of the road"))?;
        Ok(LaneUnderTest {
            edges_m: self.replay.road.lane_edges_m(node, lane)?,
            direction: self.replay.direction(entity),
        })
    }

    /// Returns the times at which the body of an entity is in the lane after the start.
    fn stays(
        &self,
        entity: usize,
        lane: &LaneUnderTest,
        start_s: f64,
    ) -> Result<Vec<LaneStay<'a>>> {
        let motion = self.replay.motion.get(entity);
        let Some((motion, body)) = motion.zip(self.replay.entities.get(entity)) else {
            return Ok(Vec::new());
        };
        let stop_s = self.stop.time_s;
        let samples = motion.lateral.moves().len() as u64;
        self.replay
            .work
            .spend(body.node, WORK_PER_SAMPLE * samples)?;
        let mut stays = motion
            .lateral
            .stays(&motion.plan, lane.edges_m, body.width_m, stop_s);
        stays.retain(|stay| {
            stay.enters.is_none_or(|enters| enters.time_s < stop_s)
                && stay.leaves.is_none_or(|leaves| leaves.time_s > start_s)
        });
        let stands = motion.plan.knots().iter().all(|knot| knot.speed_mps == 0.0);
        let stays_inside = stays.last().is_some_and(|stay| stay.leaves.is_none());
        if motion.walks_on && stays_inside {
            let problem =
                "the pedestrian walks along the lane of the vehicle under test after it crosses";
            return Err(body
                .node
                .refuse(format!("{problem}: only one of both is supported")));
        }
        let stands = stands || motion.crosses_at_m.is_some();
        if motion.direction != lane.direction && !stands && !stays.is_empty() {
            return Err(body.node.refuse(format!(
                "`{}` drives against the direction of the vehicle under test in its lane",
                body.name
            )));
        }
        Ok(stays)
    }

    /// Notes the entities that are never in the lane. Without any other vehicle, they are beside the lane, unless they
    /// move towards it in vain.
    fn add_absent(
        &mut self,
        absent: &[usize],
        start_s: f64,
        vehicles: &mut Vec<LaneVehicle>,
    ) -> Result<()> {
        let are_omitted = vehicles.len() >= 2;
        for &entity in absent {
            let bodies = self.replay.entities.get(entity);
            let Some((body, motion)) = bodies.zip(self.replay.motion.get(entity)) else {
                continue;
            };
            let node = body.node;
            let problem = format!(
                "the entity `{}` is never in the lane of the vehicle under test",
                body.name
            );
            if are_omitted {
                let note = node.note(format!("{problem}: the scenario omits it"));
                self.replay.notes.push(note);
                continue;
            }
            if !motion.lateral.moves().is_empty() {
                return Err(node.refuse(problem));
            }
            let note = node.note(format!("{problem}: it stays beside the lane"));
            self.replay.notes.push(note);
            let mut vehicle = self.vehicle(entity, start_s)?;
            vehicle.enters_s = self.stop.time_s + BESIDE_S;
            vehicle.spec.enters = Some(LaneChange::At(vehicle.enters_s - start_s));
            vehicles.push(vehicle);
        }
        Ok(())
    }

    /// Adds a vehicle that stands beside the lane to a single vehicle, because a scenario has at least two.
    fn add_second_vehicle(&mut self, start_s: f64, vehicles: &mut Vec<LaneVehicle>) {
        let [only] = vehicles.as_slice() else {
            return;
        };
        let enters_s = self.stop.time_s + BESIDE_S;
        let standing = Driver::Profile(LeadProfile::ConstantSpeed);
        let mut spec = VehicleSpec::new(only.spec.class, only.spec.position_m, 0.0, standing);
        spec.enters = Some(LaneChange::At(enters_s - start_s));
        vehicles.push(LaneVehicle {
            entity: usize::MAX,
            spec,
            enters_s,
            notes: Vec::new(),
        });
        let note = "has one vehicle: a second one, which a scenario needs, stands beside the lane";
        self.replay.notes.push(self.storyboard.note(note));
    }

    /// Adds an entity as one vehicle for each of its stays in the lane.
    fn add_vehicle(
        &mut self,
        entity: usize,
        stays: Vec<LaneStay<'a>>,
        start_s: f64,
        vehicles: &mut Vec<LaneVehicle>,
    ) -> Result<()> {
        let mut vehicle = self.vehicle(entity, start_s)?;
        self.replay.notes.append(&mut vehicle.notes);
        if let [_, second, ..] = stays.as_slice()
            && let Some(body) = self.replay.entities.get(entity)
        {
            let node = second.enters.map_or(body.node, |enters| enters.node);
            self.replay.notes.push(node.note(format!(
                "`{}` is in the lane {} times: it is a vehicle with the same motion for each of them",
                body.name,
                stays.len()
            )));
        }
        for stay in stays {
            let mut own = vehicle.clone();
            own.set_stay(&stay, start_s);
            self.replay.notes.append(&mut own.notes);
            vehicles.push(own);
        }
        Ok(())
    }

    /// Notes what the scenario assumes, and events that it omits.
    fn note_assumptions(&mut self, start_s: f64) {
        let mut notes = Vec::new();
        if start_s > 0.0 {
            notes.push(self.storyboard.note(format!(
                "starts when the controller is activated, at {} s",
                format_number(start_s)
            )));
        }
        if self.stop.depends_on_controller {
            let text =
                "the duration is that of a vehicle under test that the default controller drives";
            notes.push(self.storyboard.note(text));
        }
        let events = self.replay.elements.iter();
        let events = events.filter(|element| element.kind == ElementKind::Event);
        notes.extend(
            events
                .filter(|event| event.started_s.is_none())
                .map(|event| {
                    event.node.note(format!(
                        "`{}` never starts within the {} s of the scenario",
                        event.name,
                        format_number(self.stop.time_s)
                    ))
                }),
        );
        self.replay.notes.append(&mut notes);
    }

    fn scenario_spec(&self, vehicles: Vec<VehicleSpec>, start_s: f64) -> ScenarioSpec {
        let steps = ((self.stop.time_s - start_s) / REPLAY_STEP_S - 1e-6)
            .ceil()
            .max(1.0);
        let duration_s = (steps * REPLAY_STEP_S * 1e9).round() / 1e9;
        let mut spec = ScenarioSpec {
            about: self.about.clone(),
            ..ScenarioSpec::new(self.name.clone(), duration_s, vehicles)
        };
        spec.environment.friction = self.replay.friction;
        spec
    }

    /// Returns the error of an invalid field, at the element that states it. `entities` are those of the vehicles.
    fn outside_ranges(&self, invalid: InvalidField, entities: &[usize]) -> ScenarioImportError {
        let of_vehicle = invalid.field.strip_prefix("vehicles[");
        let index_and_field = of_vehicle.and_then(|rest| rest.split_once("]."));
        let location = index_and_field.and_then(|(index, field)| {
            let entity = *entities.get(index.parse::<usize>().ok()?)?;
            Some(self.replay.entities.get(entity)?.field_location(field))
        });
        let ElementLocation { path, line, name } =
            location.unwrap_or_else(|| self.storyboard.location());
        ScenarioImportError::Invalid {
            path: path.to_path_buf(),
            line,
            element: name,
            invalid: Box::new(invalid),
        }
    }

    /// Refuses a scenario that ends at its start.
    fn check_duration(&self, start_s: f64) -> Result<()> {
        if self.stop.time_s > start_s {
            return Ok(());
        }
        let stop = self.storyboard.optional("StopTrigger");
        Err(stop.unwrap_or(self.storyboard).refuse(format!(
            "ends the scenario at {} s, but it starts at {} s",
            format_number(self.stop.time_s),
            format_number(start_s)
        )))
    }

    /// Returns the time at which the first controller of a vehicle under test is active.
    fn start_s(&self) -> f64 {
        let under_test = self.replay.motion.iter().zip(&self.drivers);
        let active = under_test.filter(|(_, driver)| **driver == Some(Driver::UnderTest));
        active
            .map(|(motion, _)| motion.activated_s.unwrap_or(0.0))
            .reduce(f64::max)
            .unwrap_or(0.0)
    }

    /// Refuses more steps than a scenario may have, and takes the work of checking them from the budget.
    fn check_work(&self, start_s: f64) -> Result<()> {
        let duration_s = self.stop.time_s - start_s;
        let steps = (duration_s / REPLAY_STEP_S).max(0.0);
        let count = self.drivers.len() as f64;
        if steps * count > MAX_VEHICLE_STEPS {
            let problem = format!(
                "{count} vehicles for {} s have more",
                format_fixed(duration_s, 0)
            );
            return Err(self.storyboard.refuse(format!(
                "a scenario may have {MAX_VEHICLE_STEPS} steps of vehicles, and {problem}"
            )));
        }
        for motion in &self.replay.motion {
            let state_work = motion.plan.state_work() * if motion.follows_path { 3 } else { 1 };
            let samples = motion.plan.knots().len() as u64;
            self.replay.work.spend(
                self.storyboard,
                steps as u64 * (10 + state_work) + WORK_PER_SAMPLE * samples,
            )?;
        }
        Ok(())
    }

    /// Returns the vehicle of an entity, as if it were always in the lane.
    fn vehicle(&self, entity: usize, start_s: f64) -> Result<LaneVehicle> {
        let motion = self.replay.motion.get(entity);
        let Some((motion, body)) = motion.zip(self.replay.entities.get(entity)) else {
            return Err(self.storyboard.refuse("has no entity"));
        };
        let driver = self.drivers.get(entity).cloned().flatten();
        let start = [motion.plan.at(start_s)];
        let speeds = match driver {
            Some(_) => start.as_slice(),
            None => motion.plan.knots(),
        };
        check_max_speed(motion, body, speeds)?;
        let mut notes = body.notes.clone();
        if driver.is_some() {
            notes.extend(controller_notes(motion, body));
        }
        notes.extend(self.end_of_road_note(motion, body));
        let is_scripted = driver.is_none();
        let mut spec = self.body_and_driver(motion, body, driver, start_s);
        if is_scripted {
            notes.extend(self.check_script(&mut spec, motion, body, start_s)?);
        } else {
            spec.jerk_limit_mps3 = body.jerk_limit_mps3;
            [
                spec.reaction_delay_s,
                spec.actuator_lag_s,
                spec.actuator_delay_s,
            ] = body.delays_s;
        }
        Ok(LaneVehicle {
            entity,
            spec,
            enters_s: f64::NEG_INFINITY,
            notes,
        })
    }

    /// Refuses a script that the vehicle or the road does not permit, and returns a note about raised limits.
    fn check_script(
        &self,
        spec: &mut VehicleSpec,
        motion: &EntityMotion<'_>,
        body: &Entity<'_>,
        start_s: f64,
    ) -> Result<Option<String>> {
        self.check_road(motion)?;
        if motion.crosses_at_m.is_some() {
            return Ok(None);
        }
        let note = if motion.follows_path {
            self.raise_limits(spec, motion, body, start_s)?
        } else {
            None
        };
        self.check_limits(spec, motion, start_s, body)?;
        Ok(note)
    }

    /// Refuses a motion that reaches a part of the road that a scenario cannot represent.
    fn check_road(&self, motion: &EntityMotion<'_>) -> Result<()> {
        let end_m = motion.direction * motion.position_m(self.stop.time_s);
        let limit = self.replay.road.exceeded_limit(end_m);
        limit.map_or(Ok(()), |limit| Err(limit.error()))
    }

    /// Returns a note if an entity would leave the road, which is endless in a scenario.
    fn end_of_road_note(&self, motion: &EntityMotion<'_>, body: &Entity<'_>) -> Option<String> {
        let end_m = motion.direction * motion.position_m(self.stop.time_s);
        let outside = self.replay.road.outside(body.node, end_m);
        outside.map(|outside| format!("{outside}, at the end; the road of the scenario is endless"))
    }

    /// Returns the vehicle of an entity with its initial state and its limits. Without a driver, it follows a script.
    fn body_and_driver(
        &self,
        motion: &EntityMotion<'_>,
        body: &Entity<'_>,
        driver: Option<Driver>,
        start_s: f64,
    ) -> VehicleSpec {
        let start = motion.plan.at(start_s);
        let driver =
            driver.unwrap_or_else(|| Driver::Profile(motion.script(start_s, self.stop.time_s)));
        let front_m = motion.position_m(start_s) + body.front_m;
        let along_mps = match motion.crosses_at_m {
            Some(_) => 0.0,
            None => start.speed_mps,
        };
        let mut spec = VehicleSpec::new(body.class, front_m, along_mps, driver);
        spec.length_m = Some(body.length_m);
        spec.mass_kg = body.mass_kg;
        spec.max_brake_mps2 = body.max_brake_mps2;
        spec.max_accel_mps2 = body.max_accel_mps2;
        spec
    }

    /// Raises the limits of a vehicle to what its trajectory needs, and returns a note about it. Refuses a trajectory
    /// that no vehicle can drive.
    fn raise_limits(
        &self,
        spec: &mut VehicleSpec,
        motion: &EntityMotion<'_>,
        body: &Entity<'_>,
        start_s: f64,
    ) -> Result<Option<String>> {
        let [lowest, highest] = extreme_steps(&motion.plan, start_s, self.stop.time_s);
        let brake_mps2 = -lowest.rate_mps2 / self.replay.friction;
        let accel_mps2 = highest.rate_mps2;
        let exceeds_brake = brake_mps2 > spec.max_brake_mps2() + NO_RAISE_MPS2;
        if !exceeds_brake && accel_mps2 <= spec.max_accel_mps2() + NO_RAISE_MPS2 {
            return Ok(None);
        }
        let hardest = if exceeds_brake { &lowest } else { &highest };
        let node = hardest.action(motion).unwrap_or(body.node);
        let [lowest, highest] = [&lowest, &highest].map(|step| format_fixed(step.rate_mps2, 1));
        let need = format!(
            "the trajectory of `{}` needs {lowest} to {highest} m/s²",
            body.name
        );
        if brake_mps2.max(accel_mps2) > MAX_LIMIT_MPS2 {
            return Err(node.refuse(format!(
                "{need}, and vehicles can have limits of up to {MAX_LIMIT_MPS2} m/s², times the friction for braking"
            )));
        }
        spec.max_brake_mps2 = Some(brake_mps2.max(spec.max_brake_mps2()));
        spec.max_accel_mps2 = Some(accel_mps2.max(spec.max_accel_mps2()));
        Ok(Some(node.note(format!("{need}: its limits are raised"))))
    }

    /// Refuses a script that the vehicle cannot follow. The error states the largest change of the speed until then.
    fn check_limits(
        &self,
        spec: &VehicleSpec,
        motion: &EntityMotion<'_>,
        start_s: f64,
        body: &Entity<'_>,
    ) -> Result<()> {
        let brake_mps2 = spec.max_brake_mps2() * self.replay.friction;
        let accel_mps2 = spec.max_accel_mps2();
        let mut before = motion.plan.at(start_s);
        let mut speed_mps = spec.speed_mps;
        let mut position_m = before.position_m;
        let mut hardest = SpeedStep {
            time_s: start_s,
            rate_mps2: 0.0,
        };
        let steps = ((self.stop.time_s - start_s) / REPLAY_STEP_S).floor() as usize;
        for step in 1..=steps {
            let planned = motion.plan.at(start_s + step as f64 * REPLAY_STEP_S);
            let rate_mps2 = (planned.speed_mps - before.speed_mps) / REPLAY_STEP_S;
            if rate_mps2.abs() > hardest.rate_mps2.abs() {
                hardest = SpeedStep {
                    time_s: before.time_s,
                    rate_mps2,
                };
            }
            let target_mps2 = (planned.speed_mps - speed_mps) / REPLAY_STEP_S;
            let limited_mps2 = target_mps2.clamp(-brake_mps2, accel_mps2.max(0.0));
            let next_mps = (speed_mps + limited_mps2 * REPLAY_STEP_S).max(0.0);
            position_m += 0.5 * (speed_mps + next_mps) * REPLAY_STEP_S;
            speed_mps = next_mps;
            before = planned;
            if (position_m - planned.position_m).abs() > FOLLOW_TOLERANCE_M {
                return Err(hardest.refuse(motion, body, [-brake_mps2, accel_mps2]));
            }
        }
        Ok(())
    }

    /// Lists the vehicles front to rear; one that enters has its place at that time.
    fn order(&self, vehicles: Vec<LaneVehicle>) -> Vec<LaneVehicle> {
        let (mut present, mut entering): (Vec<_>, Vec<_>) = vehicles
            .into_iter()
            .partition(|vehicle| vehicle.enters_s == f64::NEG_INFINITY);
        present.sort_by(|a, b| b.spec.position_m.total_cmp(&a.spec.position_m));
        entering.sort_by(|a, b| a.enters_s.total_cmp(&b.enters_s));
        for vehicle in entering {
            let own_m = self.front_m(vehicle.entity, vehicle.enters_s);
            let index = present
                .iter()
                .position(|other| self.front_m(other.entity, vehicle.enters_s) < own_m)
                .unwrap_or(present.len());
            present.insert(index, vehicle);
        }
        present
    }

    fn front_m(&self, entity: usize, time_s: f64) -> f64 {
        self.replay.position_m(entity, time_s) + self.replay.bumpers_m(entity)[0]
    }

    /// Sets the gap to the vehicle behind that triggers an entry, if the entry depends on its controller. Without a
    /// controlled vehicle behind, the entry has a time.
    fn set_entry_gap(
        &mut self,
        vehicles: &mut [LaneVehicle],
        index: usize,
        start_s: f64,
    ) -> Result<()> {
        let entering = vehicles.get(index);
        let entering =
            entering.filter(|entering| matches!(entering.spec.enters, Some(LaneChange::Gap(_))));
        let Some(entering) = entering else {
            return Ok(());
        };
        let node = self.controlled_change_node(entering.entity);
        let time_s = entering.enters_s - start_s;
        let (enters, gap_or_time) = match controlled_follower(vehicles, index) {
            Some(follower) => {
                let gap_m = self.entry_gap_m(node, entering, follower)?;
                let gap = format!("a gap of {} m", format_fixed(gap_m, 2));
                (LaneChange::Gap(gap_m), gap)
            }
            None => {
                let time = format!("{} s", format_fixed(time_s, 2));
                (LaneChange::At(time_s), time)
            }
        };
        self.replay.notes.push(node.note(format!(
            "enters at {gap_or_time}, as if the default controller drove the vehicle under test"
        )));
        if let Some(entering) = vehicles.get_mut(index) {
            entering.spec.enters = Some(enters);
        }
        Ok(())
    }

    /// Returns the gap from the rear bumper of an entering vehicle to the vehicle behind.
    fn entry_gap_m(
        &self,
        node: Node<'_>,
        entering: &LaneVehicle,
        follower: &LaneVehicle,
    ) -> Result<f64> {
        let rear_m = self.front_m(entering.entity, entering.enters_s) - entering.spec.length_m();
        let gap_m = rear_m - self.front_m(follower.entity, entering.enters_s);
        if gap_m < 0.01 {
            return Err(node.refuse(format!(
                "the gap at the lane marking would be {} m: no room to enter",
                format_fixed(gap_m, 2)
            )));
        }
        Ok(gap_m)
    }

    /// Returns the element of an entity's lane change whose time depends on a controller.
    fn controlled_change_node(&self, entity: usize) -> Node<'a> {
        let motion = self.replay.motion.get(entity);
        motion
            .and_then(|motion| {
                let mut moves = motion.lateral.moves().iter();
                moves.find(|step| step.depends_on_controller)
            })
            .map_or(self.storyboard, |change| change.node)
    }
}

/// Refuses an entity that exceeds its maximum speed.
fn check_max_speed(
    motion: &EntityMotion<'_>,
    body: &Entity<'_>,
    speeds: &[SpeedKnot],
) -> Result<()> {
    let fastest = speeds
        .iter()
        .max_by(|a, b| a.speed_mps.total_cmp(&b.speed_mps))
        .filter(|fastest| fastest.speed_mps > body.max_speed_mps);
    let Some(fastest) = fastest else {
        return Ok(());
    };
    let node = motion.action(fastest.time_s).unwrap_or(body.node);
    Err(node.refuse(format!(
        "`{}` exceeds its maxSpeed of {} m/s",
        body.name,
        format_number(body.max_speed_mps)
    )))
}

/// Returns notes about the actions that the controller of an entity replaces, and about its activation.
fn controller_notes(motion: &EntityMotion<'_>, body: &Entity<'_>) -> Vec<String> {
    let replaced = motion.replaced.iter();
    let replaced: BTreeSet<String> = replaced
        .map(|node| node.note(format!("the controller of `{}` replaces this", body.name)))
        .collect();
    let mut notes: Vec<String> = replaced.into_iter().collect();
    if motion.activated_s.is_none() {
        notes.push(
            body.node
                .note("the controller is never activated: it drives from the start"),
        );
    }
    notes
}

impl LaneVehicle {
    /// Sets when the vehicle enters and leaves the lane.
    fn set_stay(&mut self, stay: &LaneStay<'_>, start_s: f64) {
        if let Some(enters) = stay.enters.filter(|enters| enters.time_s > start_s) {
            self.enters_s = enters.time_s;
            self.spec.enters = Some(if enters.depends_on_controller {
                LaneChange::Gap(f64::NAN)
            } else {
                LaneChange::At(enters.time_s - start_s)
            });
        }
        if let Some(leaves) = stay.leaves {
            if leaves.depends_on_controller {
                self.notes.push(leaves.node.note(
                    "depends on an entity with a controller: the vehicle leaves at the time that results if the \
                     default controller drove that entity",
                ));
            }
            self.spec.leaves = Some(LaneChange::At(leaves.time_s - start_s));
        }
    }
}

/// Returns the next vehicle behind that is in the lane when the vehicle at `index` enters, if a controller drives it.
fn controlled_follower(vehicles: &[LaneVehicle], index: usize) -> Option<&LaneVehicle> {
    let enters_s = vehicles.get(index)?.enters_s;
    vehicles
        .iter()
        .skip(index + 1)
        .find(|vehicle| vehicle.enters_s < enters_s)
        .filter(|vehicle| {
            matches!(
                vehicle.spec.driver,
                Driver::UnderTest | Driver::Controller(_)
            )
        })
}

impl SpeedStep {
    /// Returns the action that changes the speed, which may begin within the step.
    fn action<'a>(&self, motion: &EntityMotion<'a>) -> Option<Node<'a>> {
        motion.action(self.time_s + REPLAY_STEP_S)
    }

    /// Returns the error of a script that exceeds the limits of its vehicle with this change.
    fn refuse(
        &self,
        motion: &EntityMotion<'_>,
        body: &Entity<'_>,
        limits_mps2: [f64; 2],
    ) -> ScenarioImportError {
        let node = self.action(motion).unwrap_or(body.node);
        let [lowest_mps2, highest_mps2] = limits_mps2;
        if (lowest_mps2..=highest_mps2).contains(&self.rate_mps2) {
            return node.refuse(format!(
                "the speed of `{}` changes so often that steps of {REPLAY_STEP_S} s miss its position by more than \
                 {FOLLOW_TOLERANCE_M} m",
                body.name
            ));
        }
        let [lowest_mps2, highest_mps2] = limits_mps2.map(format_number);
        node.refuse(format!(
            "at {} s the speed of `{}` changes at {} m/s², outside its limits of {lowest_mps2} and {highest_mps2} m/s²",
            format_fixed(self.time_s, 2),
            body.name,
            format_fixed(self.rate_mps2, 1),
        ))
    }
}

/// Returns the steps of the replay with the lowest and with the highest acceleration of a plan, or 0 within them.
fn extreme_steps(plan: &SpeedPlan, start_s: f64, stop_s: f64) -> [SpeedStep; 2] {
    let mut extremes = [0.0, 0.0].map(|rate_mps2| SpeedStep {
        time_s: start_s,
        rate_mps2,
    });
    let steps = ((stop_s - start_s) / REPLAY_STEP_S).floor() as usize;
    let mut before = plan.at(start_s);
    for step in 1..=steps {
        let after = plan.at(start_s + step as f64 * REPLAY_STEP_S);
        let rate_mps2 = (after.speed_mps - before.speed_mps) / REPLAY_STEP_S;
        let time_s = before.time_s;
        let [lowest, highest] = &mut extremes;
        if rate_mps2 < lowest.rate_mps2 {
            *lowest = SpeedStep { time_s, rate_mps2 };
        } else if rate_mps2 > highest.rate_mps2 {
            *highest = SpeedStep { time_s, rate_mps2 };
        }
        before = after;
    }
    extremes
}
