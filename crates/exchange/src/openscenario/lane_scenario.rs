//! The scenario on one lane that a replay gives.

use super::ImportedLaneScenario;
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::{MAX_VEHICLE_STEPS, WORK_PER_SAMPLE};
use super::replay::{EntityMotion, REPLAY_STEP_S, Replay};
use super::speed_plan::SpeedPlan;
use super::xml::{ElementPlace, Node};
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
    pub(super) stop_s: f64,
    pub(super) stop_depends: bool,
    pub(super) name: String,
    pub(super) about: String,
}

/// A vehicle before it has its place in the list.
struct LaneVehicle {
    entity: usize,
    spec: VehicleSpec,
    /// Time of entry, in seconds of the replay; negative infinity if the vehicle is in the lane at the start.
    enters_s: f64,
}

impl LaneScenarioBuilder<'_, '_> {
    pub(super) fn build(mut self) -> Result<ImportedLaneScenario> {
        let start_s = self.start_s();
        self.check_duration(start_s)?;
        let reference = self
            .drivers
            .iter()
            .position(|driver| *driver == Some(Driver::UnderTest))
            .unwrap_or(0);
        let lane = self
            .replay
            .motion
            .get(reference)
            .map_or(0, |motion| motion.lane);
        if start_s > 0.0 {
            let text = format!(
                "starts when the controller is activated, at {} s, with the initial speed",
                format_number(start_s)
            );
            self.replay.notes.push(self.storyboard.note(text));
        }
        if self.stop_depends {
            let text = "the duration is that of a vehicle under test that keeps its speed";
            self.replay.notes.push(self.storyboard.note(text));
        }
        for event in self
            .replay
            .events
            .iter()
            .filter(|event| event.start_s.is_none())
        {
            let text = format!(
                "`{}` never starts within the {} s of the scenario",
                event.name,
                format_number(self.stop_s)
            );
            self.replay.notes.push(event.node.note(text));
        }
        self.check_work(start_s)?;
        let mut vehicles: Vec<LaneVehicle> = Vec::new();
        let count = self.drivers.len();
        for entity in 0..count {
            vehicles.push(self.vehicle(entity, lane, start_s)?);
        }
        let mut listed = self.order(vehicles)?;
        for place in 0..listed.len() {
            self.check_gap_trigger(&mut listed, place)?;
        }
        let steps = ((self.stop_s - start_s) / REPLAY_STEP_S - 1e-6)
            .ceil()
            .max(1.0);
        let duration_s = (steps * REPLAY_STEP_S * 1e9).round() / 1e9;
        let (entities, vehicles): (Vec<usize>, Vec<VehicleSpec>) =
            listed.into_iter().map(|one| (one.entity, one.spec)).unzip();
        let mut spec = ScenarioSpec {
            about: self.about.clone(),
            ..ScenarioSpec::new(self.name.clone(), duration_s, vehicles)
        };
        spec.environment.friction = self.friction;
        let scenario =
            Scenario::new(spec).map_err(|invalid| self.outside_ranges(invalid, &entities))?;
        Ok(ImportedLaneScenario {
            scenario,
            notes: self.replay.notes,
        })
    }

    /// Returns the error of an invalid field, at the element that states it. `entities` are those of the vehicles.
    fn outside_ranges(&self, invalid: InvalidField, entities: &[usize]) -> ScenarioImportError {
        let of_vehicle = invalid.field.strip_prefix("vehicles[");
        let index_and_field = of_vehicle.and_then(|rest| rest.split_once("]."));
        let place = index_and_field.and_then(|(index, field)| {
            let entity = *entities.get(index.parse::<usize>().ok()?)?;
            Some(self.replay.entities.get(entity)?.place_of(field))
        });
        let ElementPlace { path, line, name } = place.unwrap_or_else(|| self.storyboard.place());
        ScenarioImportError::Invalid {
            path: path.to_path_buf(),
            line,
            element: name,
            invalid: Box::new(invalid),
        }
    }

    /// Refuses a scenario that ends at its start.
    fn check_duration(&self, start_s: f64) -> Result<()> {
        if self.stop_s > start_s {
            return Ok(());
        }
        let stop = self.storyboard.optional("StopTrigger");
        Err(stop.unwrap_or(self.storyboard).refuse(format!(
            "ends the scenario at {} s, but it starts at {} s",
            format_number(self.stop_s),
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
        let (steps, count) = (
            ((self.stop_s - start_s) / REPLAY_STEP_S).max(0.0),
            self.drivers.len() as f64,
        );
        if steps * count > MAX_VEHICLE_STEPS {
            let problem = format!(
                "{count} vehicles for {} s have more",
                format_fixed(self.stop_s - start_s, 0)
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

    fn vehicle(&mut self, entity: usize, lane: i32, start_s: f64) -> Result<LaneVehicle> {
        let (Some(motion), Some(body)) = (
            self.replay.motion.get(entity),
            self.replay.entities.get(entity),
        ) else {
            return Err(self.storyboard.refuse("has no entity"));
        };
        let notes = &mut self.replay.notes;
        notes.extend_from_slice(&body.notes);
        let fastest = motion
            .plan
            .knots()
            .iter()
            .max_by(|a, b| a.speed_mps.total_cmp(&b.speed_mps));
        if let Some(fastest) = fastest.filter(|fastest| fastest.speed_mps > body.max_speed_mps) {
            let problem = format!(
                "`{}` exceeds its maxSpeed of {} m/s",
                body.name,
                format_number(body.max_speed_mps)
            );
            return Err(motion
                .action(fastest.time_s)
                .unwrap_or(body.node)
                .refuse(problem));
        }
        let start = motion.plan.at(start_s);
        let driver = self.drivers.get(entity).cloned().flatten();
        if driver.is_some() {
            let replaced = motion.actions.iter().map(|(_, node)| node);
            notes.extend(
                replaced.map(|node| {
                    node.note(format!("the controller of `{}` replaces this", body.name))
                }),
            );
            if motion.activated_s.is_none() {
                notes.push(
                    body.node
                        .note("the controller is never activated: it drives from the start"),
                );
            }
        }
        let end_m = motion.plan.at(self.stop_s).position_m;
        let road = self
            .replay
            .roads
            .find(body.node, Some(&self.replay.road_id), [0.0; 2])?;
        if let Err(outside) = road.place_along(body.node, motion.lane, end_m) {
            notes.push(format!(
                "{outside}, at the end; the road of the scenario is endless"
            ));
        }
        let is_scripted = driver.is_none();
        let driver = driver.unwrap_or_else(|| Driver::Profile(motion.script(start_s, self.stop_s)));
        let mut spec = VehicleSpec::new(
            body.class,
            start.position_m + body.front_m,
            start.speed_mps,
            driver,
        );
        spec.length_m = Some(body.length_m);
        spec.mass_kg = body.mass_kg;
        spec.max_brake_mps2 = body.max_brake_mps2;
        spec.max_accel_mps2 = body.max_accel_mps2;
        if is_scripted {
            if motion.follows_path {
                let raised = raise_limits(
                    &mut spec,
                    &motion.plan,
                    [start_s, self.stop_s],
                    self.friction,
                );
                let note = |needed| {
                    format!(
                        "the trajectory of `{}` needs {needed}: its limits are raised",
                        body.name
                    )
                };
                notes.extend(raised.map(|needed| {
                    motion
                        .action(start_s)
                        .unwrap_or(body.node)
                        .note(note(needed))
                }));
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
        let mut enters_s = f64::NEG_INFINITY;
        let initial_lane = motion
            .lane_changes
            .first()
            .map_or(motion.lane, |change| change.lanes[0]);
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
                    let gap = change
                        .depends_on_controller
                        .then_some(LaneChange::Gap(f64::NAN));
                    spec.enters = Some(gap.unwrap_or(LaneChange::At(enter_s - start_s)));
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
        if !is_inside {
            let problem = format!(
                "the entity `{}` is never in the lane of the vehicle under test",
                body.name
            );
            return Err(body.node.refuse(problem));
        }
        Ok(LaneVehicle {
            entity,
            spec,
            enters_s,
        })
    }

    /// Refuses a script that the vehicle cannot follow. The error states the largest change of the speed until then.
    fn check_limits(
        &self,
        spec: &VehicleSpec,
        motion: &EntityMotion<'_>,
        start_s: f64,
        body: &Entity<'_>,
    ) -> Result<()> {
        let [brake, accel] = [spec.max_brake_mps2() * self.friction, spec.max_accel_mps2()];
        let mut before = motion.plan.at(start_s);
        let (mut speed_mps, mut position_m, mut hardest) =
            (spec.speed_mps, before.position_m, (start_s, 0.0_f64));
        let steps = ((self.stop_s - start_s) / REPLAY_STEP_S).floor() as usize;
        for step in 1..=steps {
            let wanted = motion.plan.at(start_s + step as f64 * REPLAY_STEP_S);
            let rate_mps2 = (wanted.speed_mps - before.speed_mps) / REPLAY_STEP_S;
            hardest = if rate_mps2.abs() > hardest.1.abs() {
                (before.time_s, rate_mps2)
            } else {
                hardest
            };
            let wanted_mps2 = (wanted.speed_mps - speed_mps) / REPLAY_STEP_S;
            let next_mps =
                (speed_mps + wanted_mps2.clamp(-brake, accel.max(0.0)) * REPLAY_STEP_S).max(0.0);
            position_m += 0.5 * (speed_mps + next_mps) * REPLAY_STEP_S;
            (speed_mps, before) = (next_mps, wanted);
            if (position_m - wanted.position_m).abs() > FOLLOW_TOLERANCE_M {
                let (time_s, rate_mps2) = hardest;
                // The action may begin within the step.
                let node = motion.action(time_s + REPLAY_STEP_S).unwrap_or(body.node);
                return Err(node.refuse(format!(
                    "at {} s the speed of `{}` changes at {} m/s², outside its limits of {} and {} m/s²",
                    format_fixed(time_s, 2),
                    body.name,
                    format_fixed(rate_mps2, 1),
                    format_number(-brake),
                    format_number(accel)
                )));
            }
        }
        Ok(())
    }

    /// Lists the vehicles front to rear; one that enters has its place at that time.
    fn order(&self, vehicles: Vec<LaneVehicle>) -> Result<Vec<LaneVehicle>> {
        let (mut listed, mut entering): (Vec<_>, Vec<_>) = vehicles
            .into_iter()
            .partition(|one| one.enters_s == f64::NEG_INFINITY);
        listed.sort_by(|a, b| b.spec.position_m.total_cmp(&a.spec.position_m));
        entering.sort_by(|a, b| a.enters_s.total_cmp(&b.enters_s));
        for one in entering {
            let front_m = |one_of: &LaneVehicle| self.front_m(one_of.entity, one.enters_s);
            let own_m = front_m(&one);
            let place = listed
                .iter()
                .position(|other| front_m(other) < own_m)
                .unwrap_or(listed.len());
            listed.insert(place, one);
        }
        Ok(listed)
    }

    fn front_m(&self, entity: usize, time_s: f64) -> f64 {
        self.replay.position_m(entity, time_s) + self.replay.bumpers_m(entity)[0]
    }

    /// Sets the gap to the vehicle behind that triggers an entry, if the entry depends on its controller.
    fn check_gap_trigger(&mut self, listed: &mut [LaneVehicle], place: usize) -> Result<()> {
        let Some(one) = listed.get(place) else {
            return Ok(());
        };
        if !matches!(one.spec.enters, Some(LaneChange::Gap(_))) {
            return Ok(());
        }
        let (entity, at_s, length_m) = (one.entity, one.enters_s, one.spec.length_m());
        let behind = listed
            .iter()
            .skip(place + 1)
            .find(|other| other.enters_s < at_s);
        let behind = behind
            .filter(|other| matches!(other.spec.driver, Driver::UnderTest | Driver::Controller(_)));
        let change = self.replay.motion.get(entity).and_then(|motion| {
            motion
                .lane_changes
                .iter()
                .find(|change| change.depends_on_controller)
        });
        let node = change.map_or(self.storyboard, |change| change.node);
        let behind = behind.ok_or_else(|| {
            node.refuse("depends on a vehicle with a controller, which must be the next one behind")
        })?;
        let gap_m = self.front_m(entity, at_s) - length_m - self.front_m(behind.entity, at_s);
        if gap_m < 0.01 {
            return Err(node.refuse(format!(
                "the gap at the lane marking would be {} m: no room to enter",
                format_fixed(gap_m, 2)
            )));
        }
        if let Some(one) = listed.get_mut(place) {
            one.spec.enters = Some(LaneChange::Gap(gap_m));
        }
        let text = format!(
            "enters at a gap of {} m, as if the vehicle under test kept its speed",
            format_fixed(gap_m, 2)
        );
        self.replay.notes.push(node.note(text));
        Ok(())
    }
}

/// Raises the limits of a vehicle to what its trajectory needs, and returns this in words.
fn raise_limits(
    spec: &mut VehicleSpec,
    plan: &SpeedPlan,
    [start_s, stop_s]: [f64; 2],
    friction: f64,
) -> Option<String> {
    let steps = ((stop_s - start_s) / REPLAY_STEP_S).floor() as usize;
    let speed_mps = |step: usize| plan.at(start_s + step as f64 * REPLAY_STEP_S).speed_mps;
    let rates = (0..steps).map(|step| (speed_mps(step + 1) - speed_mps(step)) / REPLAY_STEP_S);
    let [lowest, highest] = rates.fold([0.0_f64; 2], |[low, high], rate| {
        [low.min(rate), high.max(rate)]
    });
    let (brake_mps2, accel_mps2) = (-lowest / friction, highest);
    if brake_mps2 <= spec.max_brake_mps2() && accel_mps2 <= spec.max_accel_mps2() {
        return None;
    }
    spec.max_brake_mps2 = Some(brake_mps2.max(spec.max_brake_mps2()));
    spec.max_accel_mps2 = Some(accel_mps2.max(spec.max_accel_mps2()));
    Some(format!(
        "{} to {} m/s²",
        format_fixed(lowest, 1),
        format_fixed(highest, 1)
    ))
}
