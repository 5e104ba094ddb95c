//! Conversion of a point of a test to a scenario.

use crumple_sim::control::{STANDARD_GRAVITY_MPS2, TestDriverSettings};
use crumple_sim::scenario::{
    Brake, Driver, Environment, GhostObject, InvalidField, LaneChange, LeadProfile, RampBrake,
    SCENARIO_VERSION, Scenario, ScenarioSpec, SensorFaults, Sensors, VehicleClass, VehicleSpec,
};

use super::parameter::ParameterKind;
use super::spec::{LeadManeuver, TestSpec};

/// Time at which the vehicle ahead brakes or a vehicle cuts in, in seconds. Any driving before would change the speed
/// and gap that the clause states.
const ONSET_S: f64 = 0.0;

/// Time at which vehicles cut out, in seconds: after one step, so that a controller has observed its leader.
const CUT_OUT_S: f64 = STEP_S;

/// Time at which a ghost appears unless the test states the approach, in seconds; the estimates are settled then.
const GHOST_ONSET_S: f64 = 2.0;

/// Deceleration from which braking without cause fails unless the test states it, in m/s²: 0.25 g.
const ALLOWED_DECELERATION_MPS2: f64 = 0.25 * STANDARD_GRAVITY_MPS2;

/// Shortest distance after which a driver brakes at a place, in metres: 0 would mean that it brakes after a warning.
const MIN_BRAKING_PLACE_M: f64 = 0.01;

/// Time that a scenario continues after the vehicles would have met or the leader stands, in seconds.
const TAIL_S: f64 = 20.0;

const STEP_S: f64 = 0.01;

/// Distance of a dummy leader that some controllers require, in metres; far enough to have no influence.
const DUMMY_LEAD_GAP_M: f64 = 300.0;

const VEHICLE_CLASS: VehicleClass = VehicleClass::Light;

/// The scenario of a point, with its driver and, if no vehicle is in the way, its limit of braking.
#[derive(Debug, Clone)]
pub(super) struct PointRun {
    pub(super) scenario: Scenario,
    pub(super) test_driver: Option<TestDriverSettings>,
    pub(super) false_braking: Option<FalseBrakingLimit>,
}

/// Limit of braking in a test without a vehicle in the way.
#[derive(Debug, Clone, Copy)]
pub(super) struct FalseBrakingLimit {
    /// Deceleration beyond manual braking from which the test fails, in m/s².
    pub(super) allowed_mps2: f64,
    /// Position of the vehicle under test at which the test ends, in metres.
    pub(super) end_m: f64,
}

impl TestSpec {
    /// Returns a point, ready to be run.
    pub(super) fn point_run(
        &self,
        name: &str,
        about: &str,
        point: &[f64],
    ) -> Result<PointRun, InvalidField> {
        Ok(PointRun {
            scenario: self.scenario(name, about, point)?,
            test_driver: self.test_driver(point),
            false_braking: self.false_braking(point),
        })
    }

    /// Returns the test driver of a point; `None` if the controller drives alone.
    #[must_use]
    pub fn test_driver(&self, point: &[f64]) -> Option<TestDriverSettings> {
        let own_mps = self.si_value(point, ParameterKind::OwnSpeed);
        let mut driver = TestDriverSettings::default();
        if self.holds_speed {
            driver.hold_mps = own_mps;
        }
        if self.parameters.manual_deceleration.is_some() {
            driver.brake_mps2 = self.si_value(point, ParameterKind::ManualDeceleration);
        }
        if self.parameters.manual_delay.is_some() {
            driver.delay_s = self.si_value(point, ParameterKind::ManualDelay);
            driver.warning_ttc_s = self.si_value(point, ParameterKind::WarningClosingTime);
        }
        if self.parameters.manual_closing_time.is_some() {
            let closing_s = self.si_value(point, ParameterKind::ManualClosingTime);
            let after_m = (self.approach_s(point) - closing_s) * own_mps;
            driver.after_m = after_m.max(MIN_BRAKING_PLACE_M);
        }
        (driver != TestDriverSettings::default()).then_some(driver)
    }

    fn false_braking(&self, point: &[f64]) -> Option<FalseBrakingLimit> {
        let lead = self.lead.filter(|lead| lead.is_false_activation())?;
        let place_m = self.approach_s(point) * self.si_value(point, ParameterKind::OwnSpeed);
        // The rear of the vehicle under test passes the front of vehicles of its class.
        let passing_m = match lead {
            LeadManeuver::PassThrough => 2.0 * VEHICLE_CLASS.length_m(),
            _ => 0.0,
        };
        Some(FalseBrakingLimit {
            allowed_mps2: match self.parameters.allowed_deceleration {
                Some(_) => self.si_value(point, ParameterKind::AllowedDeceleration),
                None => ALLOWED_DECELERATION_MPS2,
            },
            end_m: place_m + passing_m,
        })
    }

    /// Returns the time from the start to the place of a ghost at the initial speed, in seconds.
    fn approach_s(&self, point: &[f64]) -> f64 {
        match self.parameters.approach_time {
            Some(_) => self.si_value(point, ParameterKind::ApproachTime),
            None => GHOST_ONSET_S + self.si_value(point, ParameterKind::ClosingTime),
        }
    }

    /// True if the driver brakes, and the ghost appears, after the start; without a ghost always.
    pub(super) fn begins_before_events(&self, point: &[f64]) -> bool {
        let approach_s = self.approach_s(point);
        let is_later = |kind| self.si_value(point, kind) < approach_s;
        !self.lead.is_some_and(LeadManeuver::is_false_activation)
            || is_later(ParameterKind::ClosingTime) && is_later(ParameterKind::ManualClosingTime)
    }

    /// Returns the value of a parameter at a point, in SI units; 0 if it is not stated.
    pub(super) fn si_value(&self, point: &[f64], parameter: ParameterKind) -> f64 {
        self.find_parameter(parameter)
            .and_then(|(position, figure)| Some(point.get(position)? * figure.unit.si_factor()))
            .unwrap_or(0.0)
    }

    /// Returns the scenario of a point.
    ///
    /// # Errors
    /// [`InvalidField`] if the point makes no scenario; never for the grid of a valid suite.
    pub fn scenario(
        &self,
        name: &str,
        about: &str,
        point: &[f64],
    ) -> Result<Scenario, InvalidField> {
        let own_mps = self.si_value(point, ParameterKind::OwnSpeed);
        let VehiclesAhead {
            mut vehicles,
            meets_s,
        } = self.vehicles_ahead(point, own_mps);
        vehicles.push(VehicleSpec::new(
            VEHICLE_CLASS,
            0.0,
            own_mps,
            Driver::UnderTest,
        ));
        Scenario::new(ScenarioSpec {
            version: SCENARIO_VERSION,
            name: name.to_owned(),
            about: about.to_owned(),
            duration_s: (meets_s + TAIL_S).ceil(),
            step_s: STEP_S,
            seed: 0,
            environment: Environment::default(),
            sensors: Sensors {
                faults: self.sensor_faults(point, own_mps),
                ..Sensors::default()
            },
            vehicles,
        })
    }

    fn sensor_faults(&self, point: &[f64], own_mps: f64) -> SensorFaults {
        let closing_s = self.si_value(point, ParameterKind::ClosingTime);
        let has_ghost = self.lead.is_some_and(LeadManeuver::is_false_activation);
        let ghost = has_ghost.then(|| GhostObject {
            onset_s: match self.parameters.approach_time {
                Some(_) => self.approach_s(point) - closing_s,
                None => GHOST_ONSET_S,
            },
            duration_s: self.si_value(point, ParameterKind::GhostTime),
            gap_m: closing_s * own_mps,
            speed_mps: 0.0,
        });
        SensorFaults {
            ghost,
            ..SensorFaults::default()
        }
    }

    fn gap_m(&self, point: &[f64], own_mps: f64) -> f64 {
        match self.find_parameter(ParameterKind::TimeGap) {
            Some(_) => self.si_value(point, ParameterKind::TimeGap) * own_mps,
            None => self.si_value(point, ParameterKind::Gap),
        }
    }

    fn vehicles_ahead(&self, point: &[f64], own_mps: f64) -> VehiclesAhead {
        let closing_s = self.si_value(point, ParameterKind::ClosingTime);
        let lead_mps = self.si_value(point, ParameterKind::LeadSpeed);
        match self.lead {
            Some(LeadManeuver::Decelerating) => self.decelerating_leader(point, own_mps),
            Some(LeadManeuver::CutIn) => {
                let mut lead = steady_vehicle(closing_s * (own_mps - lead_mps), lead_mps);
                lead.enters = Some(LaneChange::At(ONSET_S));
                VehiclesAhead {
                    vehicles: vec![
                        steady_vehicle(lead.position_m + DUMMY_LEAD_GAP_M, own_mps),
                        lead,
                    ],
                    meets_s: closing_s,
                }
            }
            Some(LeadManeuver::CutOut) => {
                let mut lead = steady_vehicle(self.gap_m(point, own_mps), own_mps);
                lead.leaves = Some(LaneChange::At(CUT_OUT_S));
                let meets_s = CUT_OUT_S + closing_s;
                let standing = steady_vehicle(lead.position_m + meets_s * own_mps, 0.0);
                VehiclesAhead {
                    vehicles: vec![standing, lead],
                    meets_s,
                }
            }
            Some(LeadManeuver::Slower) => VehiclesAhead {
                vehicles: vec![steady_vehicle(closing_s * (own_mps - lead_mps), lead_mps)],
                meets_s: closing_s,
            },
            Some(LeadManeuver::Ghost | LeadManeuver::PassThrough) => VehiclesAhead {
                vehicles: vec![steady_vehicle(DUMMY_LEAD_GAP_M, own_mps)],
                meets_s: self.approach_s(point),
            },
            Some(LeadManeuver::Stopped) | None => VehiclesAhead {
                vehicles: vec![steady_vehicle(closing_s * own_mps, 0.0)],
                meets_s: closing_s,
            },
        }
    }

    /// Returns a leader that brakes to standstill, if necessary harder than its class can.
    fn decelerating_leader(&self, point: &[f64], own_mps: f64) -> VehiclesAhead {
        let rate_mps2 = self.si_value(point, ParameterKind::Deceleration);
        let ramp_s = self.si_value(point, ParameterKind::Ramp);
        let lead_mps = match self.parameters.lead_speed {
            Some(_) => self.si_value(point, ParameterKind::LeadSpeed),
            None => own_mps,
        };
        let mut lead = scripted_vehicle(
            self.gap_m(point, own_mps),
            lead_mps,
            braking_profile(rate_mps2, ramp_s),
        );
        if rate_mps2 > VEHICLE_CLASS.max_brake_mps2() {
            lead.max_brake_mps2 = Some(rate_mps2);
        }
        VehiclesAhead {
            vehicles: vec![lead],
            meets_s: ramp_s + lead_mps / rate_mps2.max(0.1),
        }
    }
}

struct VehiclesAhead {
    vehicles: Vec<VehicleSpec>,
    /// Time at which the vehicle under test would reach them without braking, or at which a braking leader stands.
    meets_s: f64,
}

fn steady_vehicle(gap_m: f64, speed_mps: f64) -> VehicleSpec {
    scripted_vehicle(gap_m, speed_mps, LeadProfile::ConstantSpeed)
}

fn scripted_vehicle(gap_m: f64, speed_mps: f64, profile: LeadProfile) -> VehicleSpec {
    VehicleSpec::new(
        VEHICLE_CLASS,
        gap_m + VEHICLE_CLASS.length_m(),
        speed_mps,
        Driver::Profile(profile),
    )
}

fn braking_profile(rate_mps2: f64, ramp_s: f64) -> LeadProfile {
    match ramp_s > 0.0 {
        true => LeadProfile::RampBrake(RampBrake {
            onset_s: ONSET_S,
            rate_mps2,
            ramp_s,
            release_s: 0.0,
        }),
        false => LeadProfile::Brake(Brake {
            onset_s: ONSET_S,
            rate_mps2,
        }),
    }
}
