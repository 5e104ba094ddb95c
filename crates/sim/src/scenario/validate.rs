//! Validation of scenarios.

use super::invalid::{AllowedRange, FieldProblem, InvalidField};
use super::{Driver, LaneChange, LeadProfile, SCENARIO_VERSION, ScenarioSpec, VehicleSpec};
use crumple_core::format_version::check_version;

const fn range_from(min: f64, max: f64) -> AllowedRange {
    AllowedRange {
        min,
        max,
        excludes_min: false,
    }
}

const fn range_above(min: f64, max: f64) -> AllowedRange {
    AllowedRange {
        min,
        max,
        excludes_min: true,
    }
}

/// Maximum number of steps times vehicles: a trace of 120 MB, and about 300 MB as text.
pub(crate) const MAX_VEHICLE_STEPS: usize = 5_000_000;

pub(super) fn check(spec: &ScenarioSpec) -> Result<usize, InvalidField> {
    let root = FieldPath::ROOT;
    if let Err(unsupported) = check_version(spec.version, SCENARIO_VERSION) {
        return root.field("version").reject(unsupported.into());
    }
    root.field("name")
        .check_length(spec.name.chars().count(), 1, 200, "characters")?;
    if spec.name.chars().any(char::is_control) {
        return root.field("name").reject(FieldProblem::ControlCharacter);
    }
    root.field("step_s")
        .check_number(spec.step_s, range_from(1e-4, 1.0))?;
    root.field("duration_s")
        .check_number(spec.duration_s, range_above(0.0, 1e5))?;
    if i64::try_from(spec.seed).is_err() {
        return root
            .field("seed")
            .reject(FieldProblem::Seed { found: spec.seed });
    }
    let Some(steps) = whole_multiple(spec.duration_s, spec.step_s) else {
        let (step_s, found) = (spec.step_s, spec.duration_s);
        return root
            .field("duration_s")
            .reject(FieldProblem::NotWholeSteps { step_s, found });
    };
    let environment = root.field("environment");
    environment
        .field("friction")
        .check_number(spec.environment.friction, range_from(0.01, 1.0))?;
    let sensors = root.field("sensors");
    sensors
        .field("position_noise_m")
        .check_number(spec.sensors.position_noise_m, range_from(0.0, 10.0))?;
    sensors
        .field("gap_noise_m")
        .check_number(spec.sensors.gap_noise_m, range_from(0.0, 10.0))?;
    sensors
        .field("dropout")
        .check_number(spec.sensors.dropout, range_from(0.0, 1.0))?;
    for (path, value, [least, most]) in spec.sensors.faults.limits() {
        sensors
            .field("faults")
            .field(path)
            .check_number(value, range_from(least, most))?;
    }
    let faults = &spec.sensors.faults;
    if faults.outage_rate_per_s > 0.0 && faults.outage_length_s == 0.0 {
        return sensors
            .field("faults")
            .field("outage_length_s")
            .reject(FieldProblem::OutageWithoutLength);
    }
    root.field("vehicles")
        .check_length(spec.vehicles.len(), 2, 1000, "vehicles")?;
    let found = steps.saturating_mul(spec.vehicles.len());
    if found > MAX_VEHICLE_STEPS {
        return root.field("duration_s").reject(FieldProblem::TooLong {
            limit: MAX_VEHICLE_STEPS,
            found,
        });
    }
    let vehicles = root.field("vehicles");
    for (index, vehicle) in spec.vehicles.iter().enumerate() {
        check_vehicle(&vehicles.index(index), vehicle)?;
    }
    let mut in_lane = spec
        .vehicles
        .iter()
        .enumerate()
        .filter(|(_, vehicle)| vehicle.enters.is_none())
        .peekable();
    while let Some((ahead, front)) = in_lane.next() {
        let rear_bumper_m = front.position_m - front.length_m();
        if let Some((index, behind)) = in_lane.peek()
            && behind.position_m >= rear_bumper_m
        {
            let found = behind.position_m;
            return vehicles
                .index(*index)
                .field("position_m")
                .reject(FieldProblem::Overlap {
                    ahead,
                    rear_bumper_m,
                    found,
                });
        }
    }
    Ok(steps)
}

/// Largest result of [`whole_multiple`].
pub const MAX_MULTIPLE: u32 = 1_000_000_000;

/// Returns `whole / part` if it is a whole number up to rounding, from 1 to [`MAX_MULTIPLE`].
pub fn whole_multiple(whole: f64, part: f64) -> Option<usize> {
    let times = (whole / part).round();
    let fits = (1.0..=f64::from(MAX_MULTIPLE)).contains(&times)
        && (times * part - whole).abs() <= 1e-9 * whole;
    fits.then_some(times as usize)
}

fn check_vehicle(place: &FieldPath<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    place
        .field("position_m")
        .check_number(vehicle.position_m, range_from(-1e6, 1e6))?;
    place
        .field("speed_mps")
        .check_number(vehicle.speed_mps, range_from(0.0, 100.0))?;
    place
        .field("length_m")
        .check_optional(vehicle.length_m, range_from(0.1, 100.0))?;
    place
        .field("mass_kg")
        .check_optional(vehicle.mass_kg, range_from(1.0, 1e6))?;
    place
        .field("max_brake_mps2")
        .check_optional(vehicle.max_brake_mps2, range_from(0.1, 30.0))?;
    place
        .field("max_accel_mps2")
        .check_optional(vehicle.max_accel_mps2, range_from(0.0, 30.0))?;
    place
        .field("acceleration_noise_mps2")
        .check_number(vehicle.acceleration_noise_mps2, range_from(0.0, 10.0))?;
    place
        .field("reaction_delay_s")
        .check_number(vehicle.reaction_delay_s, range_from(0.0, 10.0))?;
    place
        .field("actuator_lag_s")
        .check_number(vehicle.actuator_lag_s, range_from(0.0, 10.0))?;
    place
        .field("actuator_delay_s")
        .check_number(vehicle.actuator_delay_s, range_from(0.0, 10.0))?;
    place
        .field("jerk_limit_mps3")
        .check_optional(vehicle.jerk_limit_mps3, range_from(0.1, 1e4))?;
    if vehicle.body.is_some() && vehicle.multi_body().is_none() {
        return place.field("body").reject(FieldProblem::BodyOfPointMass);
    }
    check_lane_changes(place, vehicle)?;
    let driver = place.field("driver");
    let driver = driver.field(vehicle.driver.name());
    match &vehicle.driver {
        Driver::UnderTest => Ok(()),
        Driver::Profile(profile) => {
            check_profile(&driver, profile)?;
            check_within_limits(&driver, vehicle, profile)?;
            check_no_delays(place, vehicle)
        }
        Driver::Controller(controller) => controller.values().try_for_each(|(field, value)| {
            let [least, most] = field.range;
            driver
                .field(field.name)
                .check_number(value, range_from(least, most))
        }),
        Driver::File(file) if file.controller().is_none() => {
            driver.field("path").reject(FieldProblem::DriverFile {
                reason: "was not read: read the scenario from a file".to_owned(),
            })
        }
        Driver::File(_) => Ok(()),
    }
}

/// Rejects lane changes of vehicles that are not scripted: their controllers would have to observe both lanes.
fn check_lane_changes(place: &FieldPath<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    for (field, change) in [("enters", vehicle.enters), ("leaves", vehicle.leaves)] {
        let Some(change) = change else { continue };
        let place = place.field(field);
        if !matches!(vehicle.driver, Driver::Profile(_)) {
            return place.reject(FieldProblem::LaneChangeNotScripted {
                driver: vehicle.driver.name(),
            });
        }
        let range = match change {
            LaneChange::At(_) => TIME_RANGE_S,
            LaneChange::Gap(_) => range_from(0.01, 1e5),
            LaneChange::TimeToCollision(_) => range_from(0.01, 1e3),
        };
        place
            .field(change.field())
            .check_number(change.value(), range)?;
    }
    if let (Some(LaneChange::At(enters_s)), Some(LaneChange::At(found))) =
        (vehicle.enters, vehicle.leaves)
        && found <= enters_s
    {
        return place
            .field("leaves")
            .field("at_s")
            .reject(FieldProblem::LeavesBeforeEntering { enters_s, found });
    }
    Ok(())
}

/// Rejects scripts that the vehicle cannot follow on a dry road.
fn check_within_limits(
    driver: &FieldPath<'_>,
    vehicle: &VehicleSpec,
    profile: &LeadProfile,
) -> Result<(), InvalidField> {
    let [lowest_mps2, highest_mps2] = profile.acceleration_range_mps2();
    let (max_brake_mps2, max_accel_mps2) = (vehicle.max_brake_mps2(), vehicle.max_accel_mps2());
    if -lowest_mps2 > max_brake_mps2 {
        return driver.reject(FieldProblem::BrakeBeyondLimit {
            limit: max_brake_mps2,
            found: -lowest_mps2,
        });
    }
    if highest_mps2 > max_accel_mps2 {
        return driver.reject(FieldProblem::AccelBeyondLimit {
            limit: max_accel_mps2,
            found: highest_mps2,
        });
    }
    Ok(())
}

/// Rejects delays and lags of scripted vehicles, which would contradict the script.
fn check_no_delays(place: &FieldPath<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    let plant = ("plant", vehicle.multi_body().is_some());
    let mut fields = vehicle.given_response_fields().into_iter().chain([plant]);
    match fields.find(|(_, given)| *given) {
        Some((field, _)) => place.field(field).reject(FieldProblem::DelayedScript),
        None => Ok(()),
    }
}

const TIME_RANGE_S: AllowedRange = range_from(0.0, 1e5);
const RATE_RANGE_MPS2: AllowedRange = range_from(0.0, 30.0);
const SPEED_RANGE_MPS: AllowedRange = range_from(0.0, 100.0);

fn check_profile(place: &FieldPath<'_>, profile: &LeadProfile) -> Result<(), InvalidField> {
    match profile {
        LeadProfile::ConstantSpeed => Ok(()),
        LeadProfile::Brake(brake) => {
            place
                .field("onset_s")
                .check_number(brake.onset_s, TIME_RANGE_S)?;
            place
                .field("rate_mps2")
                .check_number(brake.rate_mps2, RATE_RANGE_MPS2)
        }
        LeadProfile::RampBrake(ramp) => {
            place
                .field("onset_s")
                .check_number(ramp.onset_s, TIME_RANGE_S)?;
            place
                .field("rate_mps2")
                .check_number(ramp.rate_mps2, RATE_RANGE_MPS2)?;
            place
                .field("ramp_s")
                .check_number(ramp.ramp_s, range_from(0.0, 100.0))?;
            place
                .field("release_s")
                .check_number(ramp.release_s, range_from(0.0, 100.0))
        }
        LeadProfile::BrakeToSpeed(brake) => {
            place
                .field("onset_s")
                .check_number(brake.onset_s, TIME_RANGE_S)?;
            place
                .field("rate_mps2")
                .check_number(brake.rate_mps2, RATE_RANGE_MPS2)?;
            place
                .field("final_speed_mps")
                .check_number(brake.final_speed_mps, SPEED_RANGE_MPS)
        }
        LeadProfile::Pieces(pieces) => place.check_series(
            ("from_s", &pieces.from_s),
            ("accel_mps2", &pieces.accel_mps2),
            range_from(-30.0, 30.0),
        ),
        LeadProfile::Recorded(recorded) => place.check_series(
            ("time_s", &recorded.time_s),
            ("speed_mps", &recorded.speed_mps),
            SPEED_RANGE_MPS,
        ),
    }
}

/// A location in the file. Its path is formatted only for errors: searches check millions of valid scenarios.
#[derive(Clone, Copy)]
struct FieldPath<'a> {
    parent: Option<&'a Self>,
    step: FieldPathStep<'a>,
}

#[derive(Clone, Copy)]
enum FieldPathStep<'a> {
    Field(&'a str),
    Index(usize),
}

impl<'a> FieldPath<'a> {
    const ROOT: Self = Self {
        parent: None,
        step: FieldPathStep::Field(""),
    };

    fn field(&'a self, field: &'a str) -> Self {
        Self {
            parent: Some(self),
            step: FieldPathStep::Field(field),
        }
    }

    fn index(&'a self, index: usize) -> Self {
        Self {
            parent: Some(self),
            step: FieldPathStep::Index(index),
        }
    }

    fn full_path(&self) -> String {
        let before = self.parent.map(Self::full_path).unwrap_or_default();
        match self.step {
            FieldPathStep::Field(field) if before.is_empty() => field.to_owned(),
            FieldPathStep::Field(field) => format!("{before}.{field}"),
            FieldPathStep::Index(index) => format!("{before}[{index}]"),
        }
    }

    fn reject<T>(&self, problem: FieldProblem) -> Result<T, InvalidField> {
        Err(InvalidField {
            field: self.full_path(),
            problem,
        })
    }

    fn check_number(&self, found: f64, range: AllowedRange) -> Result<(), InvalidField> {
        if !found.is_finite() {
            return self.reject(FieldProblem::NotFinite { found });
        }
        let too_low = if range.excludes_min {
            found <= range.min
        } else {
            found < range.min
        };
        if too_low || found > range.max {
            self.reject(FieldProblem::OutOfRange { range, found })
        } else {
            Ok(())
        }
    }

    fn check_optional(&self, found: Option<f64>, range: AllowedRange) -> Result<(), InvalidField> {
        found.map_or(Ok(()), |found| self.check_number(found, range))
    }

    fn check_length(
        &self,
        found: usize,
        least: usize,
        most: usize,
        what: &'static str,
    ) -> Result<(), InvalidField> {
        if (least..=most).contains(&found) {
            Ok(())
        } else {
            self.reject(FieldProblem::Length {
                min: least,
                max: most,
                what,
                found,
            })
        }
    }

    /// Checks two lists of equal length: increasing times, and values in a range.
    fn check_series(
        &self,
        (times_name, times): (&'static str, &[f64]),
        (values_name, values): (&str, &[f64]),
        range: AllowedRange,
    ) -> Result<(), InvalidField> {
        let (times_at, values_at) = (self.field(times_name), self.field(values_name));
        times_at.check_length(times.len(), 1, 1_000_000, "entries")?;
        if values.len() != times.len() {
            let (expected, found) = (times.len(), values.len());
            return values_at.reject(FieldProblem::LengthMismatch {
                other: times_name,
                expected,
                found,
            });
        }
        for (index, (&time, &value)) in times.iter().zip(values).enumerate() {
            times_at.index(index).check_number(time, TIME_RANGE_S)?;
            values_at.index(index).check_number(value, range)?;
        }
        for (index, pair) in times.windows(2).enumerate() {
            if let [before, found] = *pair
                && found <= before
            {
                return times_at
                    .index(index + 1)
                    .reject(FieldProblem::NotIncreasing { before, found });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
