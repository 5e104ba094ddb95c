//! A point of a test as a scenario.

use crumple_world::scenario::{
    Brake, Driver, Environment, InvalidField, LeadProfile, RampBrake, SCENARIO_VERSION, Scenario, ScenarioSpec,
    Sensors, VehicleClass, VehicleSpec,
};

use super::figure::Parameter;
use super::spec::{Lead, TestSpec};

/// When the vehicle ahead begins to brake, in seconds: the filter has settled by then.
pub(super) const ONSET_S: f64 = 1.0;

/// How long a scenario goes on after the vehicles would have met, or the one ahead stands, in seconds.
const REST_S: f64 = 20.0;

const STEP_S: f64 = 0.01;

impl TestSpec {
    /// The value of a parameter at a point, in SI units; 0 if it is not stated.
    pub(super) fn si(&self, point: &[f64], parameter: Parameter) -> f64 {
        let value = |(place, figure): (usize, &super::Figure)| Some(point.get(place)? * figure.unit.in_si());
        self.place(parameter).and_then(value).unwrap_or(0.0)
    }

    /// The scenario of a point: the vehicle ahead, and the one under test behind it.
    ///
    /// # Errors
    /// [`InvalidField`] for a point that makes none; never for one of a valid suite's grid.
    pub fn scenario(&self, name: &str, about: &str, point: &[f64]) -> Result<Scenario, InvalidField> {
        let si = |parameter| self.si(point, parameter);
        let own_mps = si(Parameter::OwnSpeed);
        let braking_mps2 = si(Parameter::Deceleration);
        let (lead_mps, profile) = match self.lead {
            Some(Lead::Decelerating) => (own_mps, braking(braking_mps2, si(Parameter::Ramp))),
            Some(Lead::Slower) => (si(Parameter::LeadSpeed), LeadProfile::ConstantSpeed),
            Some(Lead::Stopped) | None => (0.0, LeadProfile::ConstantSpeed),
        };
        let (gap_m, meets_s) = match self.lead {
            Some(Lead::Decelerating) => {
                (si(Parameter::Gap), ONSET_S + si(Parameter::Ramp) + own_mps / braking_mps2.max(0.1))
            }
            _ => (si(Parameter::ClosingTime) * (own_mps - lead_mps), si(Parameter::ClosingTime)),
        };
        let class = VehicleClass::Light;
        let mut lead = VehicleSpec::new(class, gap_m + class.length_m(), lead_mps, Driver::Profile(profile));
        if braking_mps2 > class.max_brake_mps2() {
            lead.max_brake_mps2 = Some(braking_mps2);
        }
        Scenario::new(ScenarioSpec {
            version: SCENARIO_VERSION,
            name: name.to_owned(),
            about: about.to_owned(),
            duration_s: (meets_s + REST_S).ceil(),
            step_s: STEP_S,
            seed: 0,
            environment: Environment::default(),
            sensors: Sensors::default(),
            vehicles: vec![lead, VehicleSpec::new(class, 0.0, own_mps, Driver::UnderTest)],
        })
    }
}

fn braking(rate_mps2: f64, ramp_s: f64) -> LeadProfile {
    match ramp_s > 0.0 {
        true => LeadProfile::RampBrake(RampBrake { onset_s: ONSET_S, rate_mps2, ramp_s, release_s: 0.0 }),
        false => LeadProfile::Brake(Brake { onset_s: ONSET_S, rate_mps2 }),
    }
}
