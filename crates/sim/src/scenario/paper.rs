//! The three scenarios of the paper and its training distribution.
//!
//! Fixed numbers are from the section "Design of scenarios", distributions from "Implementation", paragraph "Scenario
//! Parameters". The second number of the paper's `N(36, 0.5)` is taken as a standard deviation; the paper does not say.
//! Nor does it state the number of middle vehicles of scenario 3, which is three here.

use rand::RngExt;
use rand_distr::{Distribution, Normal};

use super::{
    Brake, Driver, InvalidField, LeadProfile, Scenario, ScenarioSpec, VehicleClass, VehicleSpec,
};
use crate::control::{AebSettings, BuiltInController};
use crate::random::{self, Purpose, Stream};

/// Time step of the paper, in seconds.
pub const PAPER_STEP_S: f64 = 0.01;
/// Duration: 1500 steps.
const DURATION_S: f64 = 15.0;
/// Initial speed: 90 km/h.
const SPEED_MPS: f64 = 25.0;
const GAP_M: f64 = 16.0;
/// Braking onset of the leader: step 100.
const ONSET_S: f64 = 1.0;
const LEAD_BRAKE_MPS2: f64 = 3.0;
/// Middle vehicles of scenario 3.
const MIDDLE_VEHICLES: usize = 3;

/// Returns name and one-line description of every built-in scenario.
#[must_use]
pub fn built_in_scenario_names() -> [(&'static str, &'static str); 3] {
    [
        (
            "paper-1",
            "Emergency brake ahead, a heavy follower behind (paper, scenario 1).",
        ),
        (
            "paper-2",
            "Emergency brake ahead, a light follower behind (paper, scenario 2).",
        ),
        (
            "paper-3",
            "Emergency brake ahead, three middle vehicles, a heavy follower behind (paper, scenario 3).",
        ),
    ]
}

/// Returns the built-in scenario `name`.
#[must_use]
pub fn built_in_scenario(name: &str) -> Option<Scenario> {
    use VehicleClass::{Heavy, Light};
    let (middle, last) = match name {
        "paper-1" => (1, Heavy),
        "paper-2" => (1, Light),
        "paper-3" => (MIDDLE_VEHICLES, Heavy),
        _ => return None,
    };
    let about = built_in_scenario_names()
        .into_iter()
        .find(|(built_in, _)| *built_in == name)?
        .1;
    let spacing_m = GAP_M + Light.length_m();
    let mut vehicles = vec![VehicleSpec::new(
        Light,
        spacing_m * (middle + 1) as f64,
        SPEED_MPS,
        Driver::Profile(LeadProfile::Brake(Brake {
            onset_s: ONSET_S,
            rate_mps2: LEAD_BRAKE_MPS2,
        })),
    )];
    for index in (1..=middle).rev() {
        vehicles.push(VehicleSpec::new(
            Light,
            spacing_m * index as f64,
            SPEED_MPS,
            Driver::UnderTest,
        ));
    }
    vehicles.push(VehicleSpec::new(last, 0.0, SPEED_MPS, baseline()));
    Scenario::new(spec(name.to_owned(), about.to_owned(), 0, vehicles)).ok()
}

fn spec(name: String, about: String, seed: u64, vehicles: Vec<VehicleSpec>) -> ScenarioSpec {
    ScenarioSpec {
        about,
        seed,
        ..ScenarioSpec::new(name, DURATION_S, vehicles)
    }
}

fn baseline() -> Driver {
    Driver::Controller(BuiltInController::Baseline(AebSettings::default()))
}

fn normal(stream: &mut Stream, mean: f64, deviation: f64) -> f64 {
    match Normal::new(mean, deviation) {
        Ok(distribution) => distribution.sample(stream),
        Err(_) => mean,
    }
}

/// The training distribution of the paper: scenario 1 or 2 with random start, lead braking and noise.
///
/// Positions N(36, 0.5), N(18, 0.5), N(0, 0.5) m; lead deceleration N(3, 0.2) m/s²; onset U(1, 1.5) s; acceleration
/// noise N(0, 0.01) m/s² each step on leader and follower. "The deceleration of the following vehicles is also normally
/// distributed": about its class value, with the leader's 0.2 m/s², since the paper gives no other number. The follower
/// is heavy or light with equal probability.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaperDistribution {
    /// Seed of all samples.
    pub seed: u64,
}

impl PaperDistribution {
    /// Draws sample `index`. Equal seed and index give an equal scenario, in any order.
    ///
    /// # Errors
    /// None in practice: a normal number would have to be 15 standard deviations from its mean.
    pub fn draw(&self, index: u64) -> Result<Scenario, InvalidField> {
        let mut stream = random::stream(self.seed, Purpose::ScenarioSampling, index);
        let follower = if stream.random::<bool>() {
            VehicleClass::Heavy
        } else {
            VehicleClass::Light
        };
        let positions_m = [36.0, 18.0, 0.0].map(|mean_m| normal(&mut stream, mean_m, 0.5));
        let rate_mps2 = normal(&mut stream, LEAD_BRAKE_MPS2, 0.2);
        let follower_brake_mps2 = normal(&mut stream, follower.max_brake_mps2(), 0.2);
        let onset_s = stream.random_range(1.0..1.5);
        let brake = Driver::Profile(LeadProfile::Brake(Brake { onset_s, rate_mps2 }));
        let mut vehicles = vec![
            VehicleSpec::new(VehicleClass::Light, positions_m[0], SPEED_MPS, brake),
            VehicleSpec::new(
                VehicleClass::Light,
                positions_m[1],
                SPEED_MPS,
                Driver::UnderTest,
            ),
            VehicleSpec::new(follower, positions_m[2], SPEED_MPS, baseline()),
        ];
        vehicles[0].acceleration_noise_mps2 = 0.01;
        vehicles[2].acceleration_noise_mps2 = 0.01;
        vehicles[2].max_brake_mps2 = Some(follower_brake_mps2);
        let name = format!("paper-draw-{}-{index}", self.seed);
        let about = "A draw from the paper's training distribution.".to_owned();
        Scenario::new(spec(
            name,
            about,
            random::derived_seed(self.seed, index),
            vehicles,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_scenarios_are_the_papers() {
        let names: Vec<_> = built_in_scenario_names()
            .iter()
            .map(|(name, _)| *name)
            .collect();
        for name in names {
            let scenario = built_in_scenario(name).expect("every listed scenario is valid");
            assert_eq!(scenario.steps(), 1500);
            for index in 1..scenario.vehicles().len() {
                assert_eq!(scenario.initial_gap_m(index), Some(16.0));
            }
        }
        let positions = |name: &str| {
            built_in_scenario(name)
                .unwrap()
                .vehicles()
                .iter()
                .map(|v| v.position_m)
                .collect::<Vec<_>>()
        };
        assert_eq!(positions("paper-1"), [36.0, 18.0, 0.0]);
        assert_eq!(positions("paper-3"), [72.0, 54.0, 36.0, 18.0, 0.0]);
        assert!(built_in_scenario("paper-4").is_none());
    }

    #[test]
    fn samples_have_the_mean_and_variance_of_the_paper() {
        let draws: Vec<_> = (0..4000)
            .map(|i| PaperDistribution { seed: 3 }.draw(i).expect("valid"))
            .collect();
        let moments = |quantity: &dyn Fn(&Scenario) -> f64| {
            let n = draws.len() as f64;
            let mean = draws.iter().map(quantity).sum::<f64>() / n;
            let variance = draws
                .iter()
                .map(|d| (quantity(d) - mean).powi(2))
                .sum::<f64>()
                / n;
            (mean, variance.sqrt())
        };
        let (mean, deviation) = moments(&|d| d.vehicles()[0].position_m);
        assert!(
            (mean - 36.0).abs() < 0.04 && (deviation - 0.5).abs() < 0.03,
            "{mean} {deviation}"
        );
        let (mean, deviation) = moments(&|d| match &d.vehicles()[0].driver {
            Driver::Profile(LeadProfile::Brake(brake)) => brake.rate_mps2,
            other => panic!("leader drives by {other:?}"),
        });
        assert!(
            (mean - 3.0).abs() < 0.016 && (deviation - 0.2).abs() < 0.012,
            "{mean} {deviation}"
        );
        let (heavy, _) = moments(&|d| f64::from(d.vehicles()[2].class == VehicleClass::Heavy));
        assert!((heavy - 0.5).abs() < 0.04, "{heavy}");
    }
}
