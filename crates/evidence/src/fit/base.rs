//! Base scenario of a fitted space, and its description.

use super::episodes::EpisodeSample;
use super::space::median;
use crumple_exchange::recording::MAX_PLAUSIBLE_ACCEL_MPS2;
use crumple_world::control::{AebSettings, BuiltInController};
use crumple_world::scenario::{
    BrakeToSpeed, Driver, Environment, LeadProfile, SCENARIO_VERSION, ScenarioSpec, Sensors,
    VehicleClass, VehicleSpec,
};

/// Onset of the leader's braking, in seconds, as in an imported episode.
const ONSET_S: f64 = 1.0;
/// Duration after the longest braking of the space, in seconds, as in an imported episode.
const TAIL_S: f64 = 10.0;

/// Returns the base scenario; the last of three or more vehicles has the baseline controller.
pub(super) fn base_scenario(sample: &EpisodeSample, name: &str) -> ScenarioSpec {
    let values = |index: usize| {
        sample
            .observed
            .parameters
            .get(index)
            .map_or(&[][..], |one| one.values.as_slice())
    };
    let (speed_mps, brake_mps2, final_share) =
        (median(values(0)), median(values(1)), median(values(2)));
    let lead = LeadProfile::BrakeToSpeed(BrakeToSpeed {
        onset_s: ONSET_S,
        rate_mps2: brake_mps2,
        final_speed_mps: final_share * speed_mps,
    });
    let last = sample.extraction.vehicles - 1;
    let vehicle = |index: usize| {
        let driver = match index {
            0 => Driver::Profile(lead.clone()),
            _ if index == last && last > 1 => {
                Driver::Controller(BuiltInController::Baseline(AebSettings::default()))
            }
            _ => Driver::UnderTest,
        };
        // Far enough apart at any speed; gaps are parameters.
        let position_m = 200.0 * (last - index) as f64;
        let length_m = sample
            .sizes
            .get(index)
            .map_or(crumple_exchange::recording::CAR_LENGTH_M, |sizes| {
                sizes.typical_m()
            });
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
    };
    ScenarioSpec {
        version: SCENARIO_VERSION,
        name: name.to_owned(),
        about: format!("A scenario of the space `{name}`."),
        duration_s: (ONSET_S + longest_braking_s(sample) + TAIL_S).ceil(),
        step_s: 0.01,
        seed: 0,
        environment: Environment::default(),
        sensors: Sensors::default(),
        vehicles: (0..=last).map(vehicle).collect(),
    }
}

/// Returns the longest braking of the space, in seconds: from the highest speed, with the lowest deceleration and the
/// largest speed loss. No sample and no resample brakes longer.
fn longest_braking_s(sample: &EpisodeSample) -> f64 {
    let end = |index: usize, which: usize| {
        sample
            .features
            .get(index)
            .map_or(0.0, |number| number.range[which])
    };
    let (fastest_mps, softest_mps2, final_share) = (end(0, 1), end(1, 0), end(2, 0));
    fastest_mps * (1.0 - final_share) / softest_mps2
}

pub(super) fn describe_space(sample: &EpisodeSample) -> String {
    let EpisodeSample {
        extraction: taken,
        observed,
        exposure,
        exclusions: left_out,
        sizes,
        ..
    } = sample;
    let clusters = observed
        .braking_clusters
        .iter()
        .max()
        .map_or(0, |last| last + 1);
    let mut about = format!(
        "Fitted to {} braking episodes in {clusters} waves of {} vehicles each, in {:.3} h and {:.1} km of following, \
         from {} m/s² on. The leader brakes at its hardest second's deceleration down to its lowest speed; a scenario \
         lasts until the slowest braking of the space is over, and {TAIL_S} s more.",
        exposure.episodes,
        taken.vehicles,
        exposure.hours,
        exposure.kilometres,
        taken.min_brake.mps2(),
    );
    for text in left_out
        .sentences(taken.vehicles)
        .into_iter()
        .chain(sizes.iter().enumerate().map(|(at, one)| one.sentence(at)))
    {
        about += &format!(" {text}.");
    }
    about
}
