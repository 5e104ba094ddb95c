//! Base scenario of a fitted space, and its description.

use super::episodes::EpisodeSample;
use super::fitted_space::FitOptions;
use super::sizes::VehicleSizes;
use super::space::median;
use crumple_exchange::recording::{CAR_LENGTH_M, MAX_PLAUSIBLE_ACCEL_MPS2};
use crumple_sim::control::{AebSettings, BuiltInController};
use crumple_sim::scenario::{
    BrakeToSpeed, Driver, Environment, LeadProfile, SCENARIO_VERSION, ScenarioSpec, Sensors,
    VehicleClass, VehicleSpec,
};

/// Onset of the leader's braking, in seconds, as in an imported episode.
const ONSET_S: f64 = 1.0;
/// Duration after the longest braking of the space, in seconds, as in an imported episode.
const TAIL_S: f64 = 10.0;

/// Statement about a space without a vehicle behind the one under test.
pub(super) const NO_VEHICLE_BEHIND: &str =
    "No vehicle is behind the one under test: collisions from behind cannot happen.";

/// Returns the base scenario.
pub(super) fn base_scenario(sample: &EpisodeSample, options: &FitOptions) -> ScenarioSpec {
    let FitOptions { name, follower, .. } = options;
    let [speed_mps, brake_mps2, final_share] =
        [0, 1, 2].map(|feature| median(sample.observed_values(feature)));
    let lead = LeadProfile::BrakeToSpeed(BrakeToSpeed {
        onset_s: ONSET_S,
        rate_mps2: brake_mps2,
        final_speed_mps: final_share * speed_mps,
    });
    let last = sample.extraction.vehicles - 1;
    let vehicles = (0..=last).map(|index| {
        let driver = match index {
            0 => Driver::Profile(lead.clone()),
            _ if index == last && last > 1 => Driver::Controller(follower.clone()),
            _ => Driver::UnderTest,
        };
        base_vehicle(sample, index, speed_mps, driver)
    });
    ScenarioSpec {
        version: SCENARIO_VERSION,
        name: name.clone(),
        about: format!("A scenario of the space `{name}`."),
        duration_s: (ONSET_S + longest_braking_s(sample) + TAIL_S).ceil(),
        step_s: 0.01,
        seed: 0,
        environment: Environment::default(),
        sensors: Sensors::default(),
        vehicles: vehicles.collect(),
    }
}

fn base_vehicle(
    sample: &EpisodeSample,
    index: usize,
    speed_mps: f64,
    driver: Driver,
) -> VehicleSpec {
    // Far enough apart at any speed; gaps are parameters.
    let position_m = 200.0 * (sample.extraction.vehicles - 1 - index) as f64;
    let sizes = sample.sizes.get(index);
    let length_m = sizes.map_or(CAR_LENGTH_M, VehicleSizes::typical_m);
    let mut vehicle = VehicleSpec::new(
        VehicleClass::from_length(length_m),
        position_m,
        speed_mps,
        driver,
    );
    vehicle.length_m = Some(length_m);
    if index == 0 {
        vehicle.max_brake_mps2 = Some(MAX_PLAUSIBLE_ACCEL_MPS2);
    }
    vehicle
}

/// Returns the longest braking of the space, in seconds: from the highest speed, with the lowest deceleration and the
/// largest speed loss. No sample and no resample brakes longer.
fn longest_braking_s(sample: &EpisodeSample) -> f64 {
    let [speed_mps, brake_mps2, final_share] = [0, 1, 2].map(|index| {
        let feature = sample.features.get(index);
        feature.map_or([0.0, 0.0], |feature| feature.range)
    });
    speed_mps[1] * (1.0 - final_share[0]) / brake_mps2[0]
}

pub(super) fn describe_space(sample: &EpisodeSample, follower: &BuiltInController) -> String {
    let EpisodeSample {
        extraction,
        observed,
        exposure,
        exclusions,
        sizes,
        ..
    } = sample;
    let clusters = observed
        .braking_clusters
        .iter()
        .max()
        .map_or(0, |last| last + 1);
    let mut about = format!(
        "Fitted to {} braking episodes in {clusters} clusters, of {} vehicles each, in {:.3} h and {:.1} km of \
         following, from {} m/s² on. The leader brakes at its hardest second's deceleration down to its lowest speed; \
         a scenario lasts until the slowest braking of the space is over, and {TAIL_S} s more.",
        exposure.episodes,
        extraction.vehicles,
        exposure.hours,
        exposure.kilometres,
        extraction.min_brake.mps2(),
    );
    if extraction.vehicles == 2 {
        about += &format!(" {NO_VEHICLE_BEHIND}");
    } else if *follower != BuiltInController::Baseline(AebSettings::default()) {
        about += &format!(" `{}` drives the last vehicle.", follower.to_arg());
    }
    let size_sentences = sizes.iter().enumerate();
    for text in exclusions
        .sentences(extraction.vehicles)
        .into_iter()
        .chain(size_sentences.map(|(index, sizes)| sizes.sentence(index)))
    {
        about += &format!(" {text}.");
    }
    about
}
