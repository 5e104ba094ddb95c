//! The one place that says which scenarios are valid.

use super::invalid::{InvalidField, Problem, Range};
use super::{Driver, LaneChange, LeadProfile, SCENARIO_VERSION, ScenarioSpec, VehicleSpec};
use crate::control::ControllerSpec;

const fn from(min: f64, max: f64) -> Range {
    Range { min, max, above_min: false }
}

const fn above(min: f64, max: f64) -> Range {
    Range { min, max, above_min: true }
}

/// Steps times vehicles beyond which a scenario is refused: a trace of 120 MB, and some 300 MB as text.
pub(crate) const MOST_VEHICLE_STEPS: usize = 5_000_000;

/// Checks a spec and returns its number of steps.
pub(super) fn check(spec: &ScenarioSpec) -> Result<usize, InvalidField> {
    let root = Place::ROOT;
    if spec.version != SCENARIO_VERSION {
        return root.at("version").wrong(Problem::Version { found: spec.version });
    }
    root.at("name").length(spec.name.chars().count(), 1, 200, "characters")?;
    if spec.name.chars().any(char::is_control) {
        return root.at("name").wrong(Problem::ControlCharacter);
    }
    root.at("step_s").number(spec.step_s, from(1e-4, 1.0))?;
    root.at("duration_s").number(spec.duration_s, above(0.0, 1e5))?;
    if i64::try_from(spec.seed).is_err() {
        return root.at("seed").wrong(Problem::Seed { found: spec.seed });
    }
    let steps = whole_steps(spec)?;
    let environment = root.at("environment");
    environment.at("friction").number(spec.environment.friction, from(0.01, 1.0))?;
    let sensors = root.at("sensors");
    sensors.at("position_noise_m").number(spec.sensors.position_noise_m, from(0.0, 10.0))?;
    sensors.at("gap_noise_m").number(spec.sensors.gap_noise_m, from(0.0, 10.0))?;
    sensors.at("dropout").number(spec.sensors.dropout, from(0.0, 1.0))?;
    root.at("vehicles").length(spec.vehicles.len(), 2, 1000, "vehicles")?;
    let found = steps.saturating_mul(spec.vehicles.len());
    if found > MOST_VEHICLE_STEPS {
        return root.at("duration_s").wrong(Problem::TooLong { limit: MOST_VEHICLE_STEPS, found });
    }
    let vehicles = root.at("vehicles");
    for (index, vehicle) in spec.vehicles.iter().enumerate() {
        check_vehicle(&vehicles.item(index), vehicle)?;
    }
    let mut in_lane = spec.vehicles.iter().enumerate().filter(|(_, vehicle)| vehicle.enters.is_none()).peekable();
    while let Some((ahead, front)) = in_lane.next() {
        let rear_bumper_m = front.position_m - front.length_m();
        if let Some((index, behind)) = in_lane.peek()
            && behind.position_m >= rear_bumper_m
        {
            let found = behind.position_m;
            return vehicles.item(*index).at("position_m").wrong(Problem::Overlap { ahead, rear_bumper_m, found });
        }
    }
    Ok(steps)
}

fn whole_steps(spec: &ScenarioSpec) -> Result<usize, InvalidField> {
    let problem = Problem::NotWholeSteps { step_s: spec.step_s, found: spec.duration_s };
    match whole_multiple(spec.duration_s, spec.step_s) {
        Some(steps) => Ok(steps),
        None => Place::ROOT.at("duration_s").wrong(problem),
    }
}

/// How often `part` goes into `whole`, if a whole number of times up to rounding.
pub fn whole_multiple(whole: f64, part: f64) -> Option<usize> {
    let times = (whole / part).round();
    let fits = (1.0..=1e9).contains(&times) && (times * part - whole).abs() <= 1e-9 * whole;
    fits.then_some(times as usize)
}

fn check_vehicle(place: &Place<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    place.at("position_m").number(vehicle.position_m, from(-1e6, 1e6))?;
    place.at("speed_mps").number(vehicle.speed_mps, from(0.0, 100.0))?;
    place.at("length_m").optional(vehicle.length_m, from(0.1, 100.0))?;
    place.at("mass_kg").optional(vehicle.mass_kg, from(1.0, 1e6))?;
    place.at("max_brake_mps2").optional(vehicle.max_brake_mps2, from(0.1, 30.0))?;
    place.at("max_accel_mps2").optional(vehicle.max_accel_mps2, from(0.0, 30.0))?;
    place.at("acceleration_noise_mps2").number(vehicle.acceleration_noise_mps2, from(0.0, 10.0))?;
    place.at("reaction_delay_s").number(vehicle.reaction_delay_s, from(0.0, 10.0))?;
    place.at("actuator_lag_s").number(vehicle.actuator_lag_s, from(0.0, 10.0))?;
    place.at("actuator_delay_s").number(vehicle.actuator_delay_s, from(0.0, 10.0))?;
    place.at("jerk_limit_mps3").optional(vehicle.jerk_limit_mps3, from(0.1, 1e4))?;
    check_lane_changes(place, vehicle)?;
    let driver = place.at("driver");
    let driver = driver.at(vehicle.driver.name());
    match &vehicle.driver {
        Driver::UnderTest => Ok(()),
        Driver::Profile(profile) => {
            check_profile(&driver, profile)?;
            check_within_limits(&driver, vehicle, profile)?;
            check_follows_at_once(place, vehicle)
        }
        Driver::Controller(controller) => check_controller(&driver, controller),
        Driver::File(file) if file.controller().is_none() => driver
            .at("path")
            .wrong(Problem::DriverFile { why: "was not read: read the scenario from a file".to_owned() }),
        Driver::File(_) => Ok(()),
    }
}

/// Who decides by what is seen would have to see both lanes.
fn check_lane_changes(place: &Place<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    for (field, change) in [("enters", vehicle.enters), ("leaves", vehicle.leaves)] {
        let Some(change) = change else { continue };
        let place = place.at(field);
        if !matches!(vehicle.driver, Driver::Profile(_)) {
            return place.wrong(Problem::NotScripted { driver: vehicle.driver.name() });
        }
        let range = match change {
            LaneChange::At(_) => TIME_S,
            LaneChange::Gap(_) => from(0.01, 1e5),
            LaneChange::TimeToCollision(_) => from(0.01, 1e3),
        };
        place.at(change.field()).number(change.value(), range)?;
    }
    if let (Some(LaneChange::At(enters_s)), Some(LaneChange::At(found))) = (vehicle.enters, vehicle.leaves)
        && found <= enters_s
    {
        return place.at("leaves").at("at_s").wrong(Problem::LeavesBefore { enters_s, found });
    }
    Ok(())
}

/// A script that the vehicle could not follow on a dry road is a mistake, not a scenario.
fn check_within_limits(driver: &Place<'_>, vehicle: &VehicleSpec, profile: &LeadProfile) -> Result<(), InvalidField> {
    let [lowest_mps2, highest_mps2] = profile.acceleration_range_mps2();
    let (max_brake_mps2, max_accel_mps2) = (vehicle.max_brake_mps2(), vehicle.max_accel_mps2());
    if -lowest_mps2 > max_brake_mps2 {
        return driver.wrong(Problem::BrakeBeyondLimit { limit: max_brake_mps2, found: -lowest_mps2 });
    }
    if highest_mps2 > max_accel_mps2 {
        return driver.wrong(Problem::AccelBeyondLimit { limit: max_accel_mps2, found: highest_mps2 });
    }
    Ok(())
}

/// A script says when a vehicle does what: a delay or lag on top would make the script untrue.
fn check_follows_at_once(place: &Place<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    let delays = [
        ("reaction_delay_s", vehicle.reaction_delay_s > 0.0),
        ("actuator_lag_s", vehicle.actuator_lag_s > 0.0),
        ("actuator_delay_s", vehicle.actuator_delay_s > 0.0),
        ("jerk_limit_mps3", vehicle.jerk_limit_mps3.is_some()),
    ];
    match delays.into_iter().find(|(_, given)| *given) {
        Some((field, _)) => place.at(field).wrong(Problem::Scripted),
        None => Ok(()),
    }
}

const TIME_S: Range = from(0.0, 1e5);
const RATE_MPS2: Range = from(0.0, 30.0);
const SPEED_MPS: Range = from(0.0, 100.0);

fn check_profile(place: &Place<'_>, profile: &LeadProfile) -> Result<(), InvalidField> {
    match profile {
        LeadProfile::ConstantSpeed => Ok(()),
        LeadProfile::Brake(brake) => {
            place.at("onset_s").number(brake.onset_s, TIME_S)?;
            place.at("rate_mps2").number(brake.rate_mps2, RATE_MPS2)
        }
        LeadProfile::RampBrake(ramp) => {
            place.at("onset_s").number(ramp.onset_s, TIME_S)?;
            place.at("rate_mps2").number(ramp.rate_mps2, RATE_MPS2)?;
            place.at("ramp_s").number(ramp.ramp_s, from(0.0, 100.0))?;
            place.at("release_s").number(ramp.release_s, from(0.0, 100.0))
        }
        LeadProfile::BrakeToSpeed(brake) => {
            place.at("onset_s").number(brake.onset_s, TIME_S)?;
            place.at("rate_mps2").number(brake.rate_mps2, RATE_MPS2)?;
            place.at("final_speed_mps").number(brake.final_speed_mps, SPEED_MPS)
        }
        LeadProfile::Pieces(pieces) => {
            place.series(("from_s", &pieces.from_s), ("accel_mps2", &pieces.accel_mps2), from(-30.0, 30.0))
        }
        LeadProfile::Recorded(recorded) => {
            place.series(("time_s", &recorded.time_s), ("speed_mps", &recorded.speed_mps), SPEED_MPS)
        }
    }
}

fn check_controller(place: &Place<'_>, controller: &ControllerSpec) -> Result<(), InvalidField> {
    controller.values().try_for_each(|(field, value)| {
        let [least, most] = field.range;
        place.at(field.name).number(value, from(least, most))
    })
}

/// A place in the file, from which its fields are checked. Its path is put together only if something is wrong there:
/// searches check millions of scenarios that are right.
#[derive(Clone, Copy)]
struct Place<'a> {
    within: Option<&'a Self>,
    step: Step<'a>,
}

#[derive(Clone, Copy)]
enum Step<'a> {
    Field(&'a str),
    Item(usize),
}

impl<'a> Place<'a> {
    const ROOT: Self = Self { within: None, step: Step::Field("") };

    fn at(&'a self, field: &'a str) -> Self {
        Self { within: Some(self), step: Step::Field(field) }
    }

    fn item(&'a self, index: usize) -> Self {
        Self { within: Some(self), step: Step::Item(index) }
    }

    fn path(&self) -> String {
        let before = self.within.map(Self::path).unwrap_or_default();
        match self.step {
            Step::Field(field) if before.is_empty() => field.to_owned(),
            Step::Field(field) => format!("{before}.{field}"),
            Step::Item(index) => format!("{before}[{index}]"),
        }
    }

    fn wrong<T>(&self, problem: Problem) -> Result<T, InvalidField> {
        Err(InvalidField { field: self.path(), problem })
    }

    fn number(&self, found: f64, range: Range) -> Result<(), InvalidField> {
        if !found.is_finite() {
            return self.wrong(Problem::NotFinite { found });
        }
        let too_low = if range.above_min { found <= range.min } else { found < range.min };
        if too_low || found > range.max { self.wrong(Problem::OutOfRange { range, found }) } else { Ok(()) }
    }

    fn optional(&self, found: Option<f64>, range: Range) -> Result<(), InvalidField> {
        found.map_or(Ok(()), |found| self.number(found, range))
    }

    fn length(&self, found: usize, least: usize, most: usize, what: &'static str) -> Result<(), InvalidField> {
        if (least..=most).contains(&found) { Ok(()) } else { self.wrong(Problem::Length { least, most, what, found }) }
    }

    /// Two lists of one length: increasing times, and values in a range.
    fn series(
        &self,
        (times_name, times): (&'static str, &[f64]),
        (values_name, values): (&str, &[f64]),
        range: Range,
    ) -> Result<(), InvalidField> {
        let (times_at, values_at) = (self.at(times_name), self.at(values_name));
        times_at.length(times.len(), 1, 1_000_000, "entries")?;
        if values.len() != times.len() {
            let (expected, found) = (times.len(), values.len());
            return values_at.wrong(Problem::LengthMismatch { other: times_name, expected, found });
        }
        for (index, (&time, &value)) in times.iter().zip(values).enumerate() {
            times_at.item(index).number(time, TIME_S)?;
            values_at.item(index).number(value, range)?;
        }
        for (index, pair) in times.windows(2).enumerate() {
            if let [before, found] = *pair
                && found <= before
            {
                return times_at.item(index + 1).wrong(Problem::NotIncreasing { before, found });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Scenario, built_in};

    fn field_of(change: impl FnOnce(&mut super::ScenarioSpec)) -> String {
        let paper_1 = built_in("paper-1").expect("built in");
        paper_1.edited(change).expect_err("must be refused").field
    }

    #[test]
    fn each_kind_of_nonsense_names_its_field() {
        assert_eq!(field_of(|s| s.version = 7), "version");
        assert_eq!(field_of(|s| s.name.clear()), "name");
        assert_eq!(field_of(|s| s.duration_s = 0.0), "duration_s");
        assert_eq!(field_of(|s| s.duration_s = 1.005), "duration_s");
        assert_eq!(field_of(|s| s.duration_s = 99_999.0), "duration_s");
        assert_eq!(field_of(|s| s.step_s = f64::NAN), "step_s");
        assert_eq!(field_of(|s| s.seed = u64::MAX), "seed");
        assert_eq!(field_of(|s| s.environment.friction = 0.0), "environment.friction");
        assert_eq!(field_of(|s| s.sensors.dropout = 1.5), "sensors.dropout");
        assert_eq!(field_of(|s| s.vehicles.truncate(1)), "vehicles");
        assert_eq!(field_of(|s| s.vehicles[1].position_m = 35.0), "vehicles[1].position_m");
        assert_eq!(field_of(|s| s.vehicles[2].length_m = Some(-2.0)), "vehicles[2].length_m");
        assert_eq!(field_of(|s| s.vehicles[0].speed_mps = f64::INFINITY), "vehicles[0].speed_mps");
        assert_eq!(field_of(|s| s.vehicles[0].max_brake_mps2 = Some(2.0)), "vehicles[0].driver.brake");
    }

    #[test]
    fn a_scenario_within_rounding_of_whole_steps_is_accepted() {
        let paper_1 = built_in("paper-1").expect("built in");
        let third = paper_1.edited(|s| s.duration_s = 0.1 + 0.2).expect("0.30000000000000004 s is 30 steps");
        assert_eq!(Scenario::steps(&third), 30);
    }
}
