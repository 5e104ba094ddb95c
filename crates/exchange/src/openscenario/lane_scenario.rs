//! The scenario on one lane that a replay gives.

use super::ImportedLaneScenario;
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::{MAX_VEHICLE_STEPS, WORK_PER_SAMPLE};
use super::replay::{EntityMotion, REPLAY_STEP_S, Replay};
use super::speed_plan::SpeedPlan;
use super::trigger::Firing;
use super::xml::{ElementLocation, Node};
use crumple_core::digits::{format_fixed, format_number};
use crumple_sim::scenario::{
    Driver, InvalidField, LaneChange, Scenario, ScenarioSpec, VehicleSpec,
};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest distance between a script and its motion within the limits of the vehicle, in metres.
const FOLLOW_TOLERANCE_M: f64 = 0.01;

/// The replay, and what the scenario takes from the rest of the file.
pub(super) struct LaneScenarioBuilder<'a, 'b> {
    pub(super) storyboard: Node<'a>,
    pub(super) replay: Replay<'a, 'b>,
    pub(super) drivers: Vec<Option<Driver>>,
    pub(super) friction: f64,
    pub(super) stop: Firing,
    pub(super) name: String,
    pub(super) about: String,
}

/// A vehicle before it has its place in the list.
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
        let lane = self.lane_under_test();
        let mut vehicles: Vec<LaneVehicle> = Vec::new();
        for entity in 0..self.drivers.len() {
            let mut vehicle = self.vehicle(entity, lane, start_s)?;
            self.replay.notes.append(&mut vehicle.notes);
            vehicles.push(vehicle);
        }
        let mut vehicles = self.order(vehicles);
        for index in 0..vehicles.len() {
            self.set_entry_gap(&mut vehicles, index)?;
        }
        let entities: Vec<usize> = vehicles.iter().map(|vehicle| vehicle.entity).collect();
        let vehicles = vehicles.into_iter().map(|vehicle| vehicle.spec).collect();
        let scenario = Scenario::new(self.scenario_spec(vehicles, start_s))
            .map_err(|invalid| self.outside_ranges(invalid, &entities))?;
        Ok(ImportedLaneScenario {
            scenario,
            notes: self.replay.notes,
        })
    }

    /// Returns the lane of the vehicle under test; without one, that of the first entity.
    fn lane_under_test(&self) -> i32 {
        let under_test = self
            .drivers
            .iter()
            .position(|driver| *driver == Some(Driver::UnderTest));
        self.replay
            .motion
            .get(under_test.unwrap_or(0))
            .map_or(0, |motion| motion.lane)
    }

    /// Notes what the scenario assumes, and events that it omits.
    fn note_assumptions(&mut self, start_s: f64) {
        let mut notes = Vec::new();
        if start_s > 0.0 {
            notes.push(self.storyboard.note(format!(
                "starts when the controller is activated, at {} s, with the initial speed",
                format_number(start_s)
            )));
        }
        if self.stop.depends_on_controller {
            let text = "the duration is that of a vehicle under test that keeps its speed";
            notes.push(self.storyboard.note(text));
        }
        let events = self.replay.events.iter();
        notes.extend(events.filter(|event| event.start_s.is_none()).map(|event| {
            event.node.note(format!(
                "`{}` never starts within the {} s of the scenario",
                event.name,
                format_number(self.stop.time_s)
            ))
        }));
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
        spec.environment.friction = self.friction;
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

    /// Returns the vehicle of an entity, which must be in `lane` at some time.
    fn vehicle(&self, entity: usize, lane: i32, start_s: f64) -> Result<LaneVehicle> {
        let motion = self.replay.motion.get(entity);
        let Some((motion, body)) = motion.zip(self.replay.entities.get(entity)) else {
            return Err(self.storyboard.refuse("has no entity"));
        };
        check_max_speed(motion, body)?;
        let mut notes = body.notes.clone();
        let driver = self.drivers.get(entity).cloned().flatten();
        if driver.is_some() {
            notes.extend(controller_notes(motion, body));
        }
        notes.extend(self.end_of_road_note(motion, body)?);
        let is_scripted = driver.is_none();
        let mut spec = self.body_and_driver(motion, body, driver, start_s);
        if is_scripted {
            if motion.follows_path {
                notes.extend(self.raise_limits(&mut spec, motion, body, start_s));
            }
            self.check_limits(&spec, motion, start_s, body)?;
        } else {
            spec.jerk_limit_mps3 = body.jerk_limit_mps3;
            [
                spec.reaction_delay_s,
                spec.actuator_lag_s,
                spec.actuator_delay_s,
            ] = body.delays_s;
        }
        let enters_s = set_lane_changes(&mut spec, motion, body, lane, start_s)?;
        Ok(LaneVehicle {
            entity,
            spec,
            enters_s,
            notes,
        })
    }

    /// Returns a note if an entity would leave the road, which is endless in a scenario.
    fn end_of_road_note(
        &self,
        motion: &EntityMotion<'_>,
        body: &Entity<'_>,
    ) -> Result<Option<String>> {
        let end_m = motion.plan.at(self.stop.time_s).position_m;
        let road = self
            .replay
            .roads
            .find(body.node, Some(&self.replay.road_id), [0.0; 2])?;
        let outside = road.place_along(body.node, motion.lane, end_m).err();
        Ok(outside
            .map(|outside| format!("{outside}, at the end; the road of the scenario is endless")))
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
        let front_m = start.position_m + body.front_m;
        let mut spec = VehicleSpec::new(body.class, front_m, start.speed_mps, driver);
        spec.length_m = Some(body.length_m);
        spec.mass_kg = body.mass_kg;
        spec.max_brake_mps2 = body.max_brake_mps2;
        spec.max_accel_mps2 = body.max_accel_mps2;
        spec
    }

    /// Raises the limits of a vehicle to what its trajectory needs, and returns a note about it.
    fn raise_limits(
        &self,
        spec: &mut VehicleSpec,
        motion: &EntityMotion<'_>,
        body: &Entity<'_>,
        start_s: f64,
    ) -> Option<String> {
        let range_mps2 = acceleration_range_mps2(&motion.plan, start_s, self.stop.time_s);
        let [lowest_mps2, highest_mps2] = range_mps2;
        let brake_mps2 = -lowest_mps2 / self.friction;
        if brake_mps2 <= spec.max_brake_mps2() && highest_mps2 <= spec.max_accel_mps2() {
            return None;
        }
        spec.max_brake_mps2 = Some(brake_mps2.max(spec.max_brake_mps2()));
        spec.max_accel_mps2 = Some(highest_mps2.max(spec.max_accel_mps2()));
        let node = motion.action(start_s).unwrap_or(body.node);
        Some(node.note(format!(
            "the trajectory of `{}` needs {} to {} m/s²: its limits are raised",
            body.name,
            format_fixed(lowest_mps2, 1),
            format_fixed(highest_mps2, 1)
        )))
    }

    /// Refuses a script that the vehicle cannot follow. The error states the largest change of the speed until then.
    fn check_limits(
        &self,
        spec: &VehicleSpec,
        motion: &EntityMotion<'_>,
        start_s: f64,
        body: &Entity<'_>,
    ) -> Result<()> {
        let brake_mps2 = spec.max_brake_mps2() * self.friction;
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

    /// Sets the gap to the vehicle behind that triggers an entry, if the entry depends on its controller.
    fn set_entry_gap(&mut self, vehicles: &mut [LaneVehicle], index: usize) -> Result<()> {
        let Some(entering) = vehicles.get(index) else {
            return Ok(());
        };
        if !matches!(entering.spec.enters, Some(LaneChange::Gap(_))) {
            return Ok(());
        }
        let node = self.controlled_change_node(entering.entity);
        let follower = controlled_follower(vehicles, index).ok_or_else(|| {
            node.refuse("depends on a vehicle with a controller, which must be the next one behind")
        })?;
        let rear_m = self.front_m(entering.entity, entering.enters_s) - entering.spec.length_m();
        let gap_m = rear_m - self.front_m(follower.entity, entering.enters_s);
        if gap_m < 0.01 {
            return Err(node.refuse(format!(
                "the gap at the lane marking would be {} m: no room to enter",
                format_fixed(gap_m, 2)
            )));
        }
        let note = node.note(format!(
            "enters at a gap of {} m, as if the vehicle under test kept its speed",
            format_fixed(gap_m, 2)
        ));
        if let Some(entering) = vehicles.get_mut(index) {
            entering.spec.enters = Some(LaneChange::Gap(gap_m));
        }
        self.replay.notes.push(note);
        Ok(())
    }

    /// Returns the element of an entity's lane change whose time depends on a controller.
    fn controlled_change_node(&self, entity: usize) -> Node<'a> {
        let motion = self.replay.motion.get(entity);
        motion
            .and_then(|motion| {
                motion
                    .lane_changes
                    .iter()
                    .find(|change| change.depends_on_controller)
            })
            .map_or(self.storyboard, |change| change.node)
    }
}

/// Refuses an entity that exceeds its maximum speed.
fn check_max_speed(motion: &EntityMotion<'_>, body: &Entity<'_>) -> Result<()> {
    let fastest = motion
        .plan
        .knots()
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
    let replaced = motion.actions.iter().map(|(_, node)| node);
    let mut notes: Vec<String> = replaced
        .map(|node| node.note(format!("the controller of `{}` replaces this", body.name)))
        .collect();
    if motion.activated_s.is_none() {
        notes.push(
            body.node
                .note("the controller is never activated: it drives from the start"),
        );
    }
    notes
}

/// Sets when a vehicle enters and leaves `lane`, which it must be in at some time. Returns the time of the entry in
/// seconds of the replay; negative infinity if the vehicle is in the lane at the start.
fn set_lane_changes(
    spec: &mut VehicleSpec,
    motion: &EntityMotion<'_>,
    body: &Entity<'_>,
    lane: i32,
    start_s: f64,
) -> Result<f64> {
    let mut enters_s = f64::NEG_INFINITY;
    let first_change = motion.lane_changes.first();
    let initial_lane = first_change.map_or(motion.lane, |change| change.lanes[0]);
    let mut is_inside = initial_lane == lane;
    for change in &motion.lane_changes {
        let [from, to] = change.lanes;
        let [enter_s, leave_s] = change.crossings_s;
        if to == lane {
            if spec.leaves.is_some() {
                return Err(change.node.refuse("a vehicle can enter the lane only once"));
            }
            is_inside = true;
            if enter_s > start_s {
                enters_s = enter_s;
                spec.enters = Some(if change.depends_on_controller {
                    LaneChange::Gap(f64::NAN)
                } else {
                    LaneChange::At(enter_s - start_s)
                });
            }
        } else if from == lane {
            if change.depends_on_controller || leave_s <= start_s {
                return Err(change.node.refuse(
                    "a vehicle can leave the lane only after the start, at a time that depends on no controller",
                ));
            }
            spec.leaves = Some(LaneChange::At(leave_s - start_s));
        }
    }
    if is_inside {
        Ok(enters_s)
    } else {
        Err(body.node.refuse(format!(
            "the entity `{}` is never in the lane of the vehicle under test",
            body.name
        )))
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
    /// Returns the error of a script that exceeds the limits of its vehicle with this change.
    fn refuse(
        &self,
        motion: &EntityMotion<'_>,
        body: &Entity<'_>,
        limits_mps2: [f64; 2],
    ) -> ScenarioImportError {
        // The action may begin within the step.
        let action = motion.action(self.time_s + REPLAY_STEP_S);
        let [lowest_mps2, highest_mps2] = limits_mps2.map(format_number);
        action.unwrap_or(body.node).refuse(format!(
            "at {} s the speed of `{}` changes at {} m/s², outside its limits of {lowest_mps2} and {highest_mps2} m/s²",
            format_fixed(self.time_s, 2),
            body.name,
            format_fixed(self.rate_mps2, 1),
        ))
    }
}

/// Returns the lowest and the highest acceleration of a plan over the steps of the replay, and 0 within them.
fn acceleration_range_mps2(plan: &SpeedPlan, start_s: f64, stop_s: f64) -> [f64; 2] {
    let steps = ((stop_s - start_s) / REPLAY_STEP_S).floor() as usize;
    (0..steps)
        .map(|step| {
            let [before_mps, after_mps] = [step, step + 1]
                .map(|step| plan.at(start_s + step as f64 * REPLAY_STEP_S).speed_mps);
            (after_mps - before_mps) / REPLAY_STEP_S
        })
        .fold([0.0_f64; 2], |[lowest, highest], rate_mps2| {
            [lowest.min(rate_mps2), highest.max(rate_mps2)]
        })
}
