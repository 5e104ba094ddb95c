//! Validation of scenarios.

use super::invalid::{AllowedRange, FieldProblem, InvalidField};
use super::recorded_motion::MAX_SAMPLES;
use super::{
    Driver, LaneChange, LeadProfile, RecordedMotion, SCENARIO_VERSION, ScenarioSpec, Sensors,
    VehicleSpec,
};
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
    check_name(&root.field("name"), &spec.name)?;
    let steps = check_times(&root, spec)?;
    root.field("environment")
        .field("friction")
        .check_number(spec.environment.friction, range_from(0.01, 1.0))?;
    check_sensors(&root.field("sensors"), &spec.sensors)?;
    let vehicles = root.field("vehicles");
    vehicles.check_length(spec.vehicles.len(), 2, 1000, "vehicles")?;
    let vehicle_steps = steps.saturating_mul(spec.vehicles.len());
    if vehicle_steps > MAX_VEHICLE_STEPS {
        return root.field("duration_s").reject(FieldProblem::TooLong {
            limit: MAX_VEHICLE_STEPS,
            found: vehicle_steps,
        });
    }
    for (index, vehicle) in spec.vehicles.iter().enumerate() {
        check_vehicle(&vehicles.index(index), vehicle)?;
    }
    check_no_overlap(&vehicles, &spec.vehicles)?;
    Ok(steps)
}

fn check_name(field: &FieldPath<'_>, name: &str) -> Result<(), InvalidField> {
    field.check_length(name.chars().count(), 1, 200, "characters")?;
    if name.chars().any(char::is_control) {
        return field.reject(FieldProblem::ControlCharacter);
    }
    Ok(())
}

/// Checks step, duration and seed. Returns the number of steps.
fn check_times(root: &FieldPath<'_>, spec: &ScenarioSpec) -> Result<usize, InvalidField> {
    root.field("step_s")
        .check_number(spec.step_s, range_from(1e-4, 1.0))?;
    root.field("duration_s")
        .check_number(spec.duration_s, range_above(0.0, 1e5))?;
    if i64::try_from(spec.seed).is_err() {
        return root
            .field("seed")
            .reject(FieldProblem::Seed { found: spec.seed });
    }
    match whole_multiple(spec.duration_s, spec.step_s) {
        Some(steps) => Ok(steps),
        None => root
            .field("duration_s")
            .reject(FieldProblem::NotWholeSteps {
                step_s: spec.step_s,
                found: spec.duration_s,
            }),
    }
}

fn check_sensors(path: &FieldPath<'_>, sensors: &Sensors) -> Result<(), InvalidField> {
    path.check_numbers([
        (
            "position_noise_m",
            sensors.position_noise_m,
            range_from(0.0, 10.0),
        ),
        ("gap_noise_m", sensors.gap_noise_m, range_from(0.0, 10.0)),
        ("dropout", sensors.dropout, range_from(0.0, 1.0)),
    ])?;
    let faults = &sensors.faults;
    for (field, value, [min, max]) in faults.limits() {
        path.field("faults")
            .field(field)
            .check_number(value, range_from(min, max))?;
    }
    if faults.outage_rate_per_s > 0.0 && faults.outage_length_s == 0.0 {
        return path
            .field("faults")
            .field("outage_length_s")
            .reject(FieldProblem::OutageWithoutLength);
    }
    Ok(())
}

/// Checks that no two successive vehicles that start in the lane overlap.
fn check_no_overlap(path: &FieldPath<'_>, vehicles: &[VehicleSpec]) -> Result<(), InvalidField> {
    let mut in_lane = vehicles
        .iter()
        .enumerate()
        .filter(|(_, vehicle)| vehicle.enters.is_none())
        .peekable();
    while let Some((ahead, front)) = in_lane.next() {
        let rear_bumper_m = front.position_m - front.length_m();
        if let Some((index, behind)) = in_lane.peek()
            && behind.position_m >= rear_bumper_m
        {
            let position_m = behind.position_m;
            return path
                .index(*index)
                .field("position_m")
                .reject(FieldProblem::Overlap {
                    ahead,
                    rear_bumper_m,
                    found: position_m,
                });
        }
    }
    Ok(())
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

fn check_vehicle(path: &FieldPath<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    let v = vehicle;
    path.check_numbers([
        ("position_m", v.position_m, range_from(-1e6, 1e6)),
        ("speed_mps", v.speed_mps, range_from(0.0, 100.0)),
    ])?;
    path.check_given_numbers([
        ("length_m", v.length_m, range_from(0.1, 100.0)),
        ("mass_kg", v.mass_kg, range_from(1.0, 1e6)),
        ("max_brake_mps2", v.max_brake_mps2, range_from(0.1, 30.0)),
        ("max_accel_mps2", v.max_accel_mps2, range_from(0.0, 30.0)),
    ])?;
    let up_to_ten = range_from(0.0, 10.0);
    path.check_numbers([
        (
            "acceleration_noise_mps2",
            v.acceleration_noise_mps2,
            up_to_ten,
        ),
        ("reaction_delay_s", v.reaction_delay_s, up_to_ten),
        ("actuator_lag_s", v.actuator_lag_s, up_to_ten),
        ("actuator_delay_s", v.actuator_delay_s, up_to_ten),
    ])?;
    path.check_given_numbers([("jerk_limit_mps3", v.jerk_limit_mps3, range_from(0.1, 1e4))])?;
    if vehicle.body.is_some() && vehicle.multi_body().is_none() {
        return path.field("body").reject(FieldProblem::BodyOfPointMass);
    }
    check_lane_changes(path, vehicle)?;
    if let Some(recorded) = &vehicle.recorded {
        check_recorded_motion(&path.field("recorded"), recorded)?;
    }
    check_driver(path, vehicle)
}

fn check_recorded_motion(
    path: &FieldPath<'_>,
    recorded: &RecordedMotion,
) -> Result<(), InvalidField> {
    let RecordedMotion {
        interval_s,
        gap_m,
        speed_mps,
    } = recorded;
    path.field("interval_s")
        .check_number(*interval_s, range_from(0.01, 10.0))?;
    let gaps_at = path.field("gap_m");
    let speeds_at = path.field("speed_mps");
    gaps_at.check_length(gap_m.len(), 1, MAX_SAMPLES, "entries")?;
    if speed_mps.len() != gap_m.len() {
        return speeds_at.reject(FieldProblem::LengthMismatch {
            other: "gap_m",
            expected: gap_m.len(),
            found: speed_mps.len(),
        });
    }
    for (index, (&gap_m, &speed_mps)) in gap_m.iter().zip(speed_mps).enumerate() {
        gaps_at
            .index(index)
            .check_number(gap_m, range_from(0.0, 1e6))?;
        speeds_at
            .index(index)
            .check_number(speed_mps, SPEED_RANGE_MPS)?;
    }
    Ok(())
}

fn check_driver(path: &FieldPath<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    let driver = path.field("driver");
    let driver = driver.field(vehicle.driver.name());
    match &vehicle.driver {
        Driver::UnderTest => Ok(()),
        Driver::Profile(profile) => {
            check_profile(&driver, profile)?;
            check_within_limits(&driver, vehicle, profile)?;
            check_no_delays(path, vehicle)
        }
        Driver::Controller(controller) => controller.values().try_for_each(|(field, value)| {
            let [min, max] = field.range;
            driver
                .field(field.name)
                .check_number(value, range_from(min, max))
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
fn check_lane_changes(path: &FieldPath<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    for (field, change) in [("enters", vehicle.enters), ("leaves", vehicle.leaves)] {
        let Some(change) = change else { continue };
        let path = path.field(field);
        if !matches!(vehicle.driver, Driver::Profile(_)) {
            return path.reject(FieldProblem::LaneChangeNotScripted {
                driver: vehicle.driver.name(),
            });
        }
        let range = match change {
            LaneChange::At(_) => TIME_RANGE_S,
            LaneChange::Gap(_) => range_from(0.01, 1e5),
            LaneChange::TimeToCollision(_) => range_from(0.01, 1e3),
        };
        path.field(change.field())
            .check_number(change.value(), range)?;
    }
    if let (Some(LaneChange::At(enters_s)), Some(LaneChange::At(found))) =
        (vehicle.enters, vehicle.leaves)
        && found <= enters_s
    {
        return path
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
    let max_brake_mps2 = vehicle.max_brake_mps2();
    let max_accel_mps2 = vehicle.max_accel_mps2();
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
fn check_no_delays(path: &FieldPath<'_>, vehicle: &VehicleSpec) -> Result<(), InvalidField> {
    let plant = ("plant", vehicle.multi_body().is_some());
    let mut fields = vehicle.given_response_fields().into_iter().chain([plant]);
    match fields.find(|(_, given)| *given) {
        Some((field, _)) => path.field(field).reject(FieldProblem::DelayedScript),
        None => Ok(()),
    }
}

const TIME_RANGE_S: AllowedRange = range_from(0.0, 1e5);
const RATE_RANGE_MPS2: AllowedRange = range_from(0.0, 30.0);
const SPEED_RANGE_MPS: AllowedRange = range_from(0.0, 100.0);

fn check_profile(path: &FieldPath<'_>, profile: &LeadProfile) -> Result<(), InvalidField> {
    match profile {
        LeadProfile::ConstantSpeed => Ok(()),
        LeadProfile::Brake(brake) => path.check_numbers([
            ("onset_s", brake.onset_s, TIME_RANGE_S),
            ("rate_mps2", brake.rate_mps2, RATE_RANGE_MPS2),
        ]),
        LeadProfile::RampBrake(ramp) => path.check_numbers([
            ("onset_s", ramp.onset_s, TIME_RANGE_S),
            ("rate_mps2", ramp.rate_mps2, RATE_RANGE_MPS2),
            ("ramp_s", ramp.ramp_s, range_from(0.0, 100.0)),
            ("release_s", ramp.release_s, range_from(0.0, 100.0)),
        ]),
        LeadProfile::BrakeToSpeed(brake) => path.check_numbers([
            ("onset_s", brake.onset_s, TIME_RANGE_S),
            ("rate_mps2", brake.rate_mps2, RATE_RANGE_MPS2),
            ("final_speed_mps", brake.final_speed_mps, SPEED_RANGE_MPS),
        ]),
        LeadProfile::Pieces(pieces) => path.check_series(
            ("from_s", &pieces.from_s),
            ("accel_mps2", &pieces.accel_mps2),
            range_from(-30.0, 30.0),
        ),
        LeadProfile::Recorded(recorded) => path.check_series(
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

    fn check_number(&self, value: f64, range: AllowedRange) -> Result<(), InvalidField> {
        if !value.is_finite() {
            return self.reject(FieldProblem::NotFinite { found: value });
        }
        let too_low = if range.excludes_min {
            value <= range.min
        } else {
            value < range.min
        };
        if too_low || value > range.max {
            self.reject(FieldProblem::OutOfRange {
                range,
                found: value,
            })
        } else {
            Ok(())
        }
    }

    /// Checks fields of this object, in order: name, value and range.
    fn check_numbers<const N: usize>(
        &self,
        fields: [(&str, f64, AllowedRange); N],
    ) -> Result<(), InvalidField> {
        fields
            .into_iter()
            .try_for_each(|(name, value, range)| self.field(name).check_number(value, range))
    }

    /// Checks optional fields as [`check_numbers`](Self::check_numbers) does.
    fn check_given_numbers<const N: usize>(
        &self,
        fields: [(&str, Option<f64>, AllowedRange); N],
    ) -> Result<(), InvalidField> {
        fields.into_iter().try_for_each(|(name, value, range)| {
            value.map_or(Ok(()), |value| self.field(name).check_number(value, range))
        })
    }

    fn check_length(
        &self,
        found: usize,
        min: usize,
        max: usize,
        what: &'static str,
    ) -> Result<(), InvalidField> {
        if (min..=max).contains(&found) {
            Ok(())
        } else {
            self.reject(FieldProblem::Length {
                min,
                max,
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
        let times_at = self.field(times_name);
        let values_at = self.field(values_name);
        times_at.check_length(times.len(), 1, 1_000_000, "entries")?;
        if values.len() != times.len() {
            return values_at.reject(FieldProblem::LengthMismatch {
                other: times_name,
                expected: times.len(),
                found: values.len(),
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
