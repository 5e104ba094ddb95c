//! The laws that hold in every scenario, whoever drives.

mod closed_forms;
mod impacts;
mod symmetry;

use crumple::estimate::EstimatorKind;
use crumple::scenario::Scenario;
use crumple::sim::{AfterContact, Outcome, Simulated, Trace};
use proptest::prelude::*;

use crate::generate::{any_after_contact, any_scenario, any_setup, cases, noise_free, traced};

/// Where rounding may put a gap that is zero, in metres: positions are of the order of 10 km.
const ROUNDING_M: f64 = 1e-9;

fn trace_of(result: &Simulated) -> &Trace {
    result.trace.as_ref().expect("kept")
}

/// Whether two vehicles came so near to touching without it that rounding may decide the verdict.
fn grazes(result: &Simulated) -> bool {
    let near = |gap_m: f64| gap_m > 0.0 && gap_m < ROUNDING_M;
    let soft = result.impacts.iter().any(|impact| impact.contact.impact_speed_mps < 1e-6);
    soft || result.vehicles.iter().filter_map(|vehicle| vehicle.min_gap_m).any(near)
}

/// Whether a vehicle was involved in an impact between two instants.
fn hit_between(result: &Simulated, vehicle: usize, from_s: f64, to_s: f64) -> bool {
    result.impacts.iter().any(|impact| {
        (impact.first_involved..=impact.last_involved).contains(&vehicle)
            && (from_s - 1e-9..=to_s + 1e-9).contains(&impact.contact.time_s)
    })
}

proptest! {
    #![proptest_config(cases(512))]

    /// No vehicle reverses; none is anywhere else than its speed can have taken it; braking never adds energy.
    #[test]
    fn vehicles_move_forward_continuously_and_braking_takes_energy_away(
        scenario in any_scenario(),
        setup in any_setup(),
        after_contact in any_after_contact(),
    ) {
        let step_s = scenario.spec().step_s;
        let result = traced(&scenario, &setup.options(step_s, after_contact));
        let trace = trace_of(&result);
        for (vehicle, track) in trace.vehicles.iter().enumerate() {
            for k in 0..trace.len() - 1 {
                let dt_s = trace.time_s[k + 1] - trace.time_s[k];
                let [v, v_next] = [track.speed_mps[k], track.speed_mps[k + 1]];
                let moved_m = track.position_m[k + 1] - track.position_m[k];
                prop_assert!(v >= 0.0 && v_next >= 0.0, "vehicle {vehicle} reverses at sample {k}");
                prop_assert!(moved_m >= 0.0, "vehicle {vehicle} moves back by {moved_m} m at sample {k}");
                if !hit_between(&result, vehicle, trace.time_s[k], trace.time_s[k + 1]) {
                    prop_assert!(moved_m <= v.max(v_next) * dt_s + ROUNDING_M, "vehicle {vehicle} leaps at sample {k}");
                    let braking = track.acceleration_mps2[k] <= 0.0;
                    prop_assert!(!braking || v_next <= v, "vehicle {vehicle} gains energy from its brakes at sample {k}");
                }
            }
        }
    }

    /// The recorded motion and the verdict tell one story, and nobody goes beyond what road and vehicle allow.
    #[test]
    fn verdict_summary_and_trace_agree(scenario in any_scenario(), setup in any_setup()) {
        let scenario = noise_free(&scenario);
        let result = traced(&scenario, &setup.options(scenario.spec().step_s, AfterContact::Stop));
        let trace = trace_of(&result);
        let end_s = trace.time_s[trace.len() - 1];
        match result.outcome {
            Outcome::Collision(contact) => prop_assert_eq!(end_s, contact.time_s),
            Outcome::NoCollision => prop_assert!((end_s - scenario.spec().duration_s).abs() < 1e-9),
        }
        for (index, (vehicle, summary)) in scenario.vehicles().iter().zip(&result.vehicles).enumerate() {
            let accelerations = &trace.vehicles[index].acceleration_mps2;
            let hardest_mps2 = accelerations.iter().fold(0.0_f64, |hardest, a| hardest.max(-a));
            prop_assert_eq!(summary.max_brake_mps2, hardest_mps2);
            prop_assert!(hardest_mps2 <= scenario.usable_brake_mps2(index) + 1e-12, "vehicle {} overbrakes", index);
            prop_assert!(accelerations.iter().all(|&a| a <= vehicle.max_accel_mps2() + 1e-12));
            prop_assert_eq!(summary.stopped, trace.vehicles[index].speed_mps.last() == Some(&0.0));
            let Some(pair) = trace.pair(index) else { continue };
            let sampled_m = pair.gaps_m().fold(f64::INFINITY, f64::min);
            let min_gap_m = summary.min_gap_m.expect("a follower has a gap");
            prop_assert!(min_gap_m <= sampled_m + ROUNDING_M, "{} m, but a sample has {} m", min_gap_m, sampled_m);
            let touches = result.outcome.contact().is_some_and(|contact| contact.rear_vehicle == index);
            prop_assert_eq!(touches, min_gap_m == 0.0);
            prop_assert!(!touches || pair.gaps_m().last().unwrap().abs() < ROUNDING_M);
            prop_assert!(touches || grazes(&result) || sampled_m > 0.0, "vehicle {} passes through another", index);
        }
    }

    /// Ten times finer integration, with controllers, sensors and noise at the same instants, is the same motion.
    #[test]
    fn the_integration_step_changes_nothing(
        scenario in any_scenario(),
        setup in any_setup(),
        after_contact in any_after_contact(),
    ) {
        let step_s = scenario.spec().step_s;
        let coarse_options = setup.options(step_s, after_contact);
        let coarse_s = coarse_options.dt_s.unwrap_or(step_s);
        let fine_options = coarse_options.clone().with_dt_s(coarse_s / 10.0);
        let (coarse, fine) = (traced(&scenario, &coarse_options), traced(&scenario, &fine_options));
        prop_assume!(!grazes(&coarse) && !grazes(&fine));
        symmetry::assert_same_impacts(&coarse, &fine, 0, 0.0)?;
        let (coarse, fine) = (trace_of(&coarse), trace_of(&fine));
        for (coarse_track, fine_track) in coarse.vehicles.iter().zip(&fine.vehicles) {
            // The last sample of either may be the instant of contact.
            for k in 0..coarse.len() - 1 {
                let apart_m = coarse_track.position_m[k] - fine_track.position_m[10 * k];
                prop_assert!(apart_m.abs() < 1e-7, "{apart_m} m apart at sample {k}");
            }
        }
    }
}

/// The paper's scenarios, which everything is compared on, are among those that do not depend on the step.
#[test]
fn the_verdicts_of_the_papers_distribution_do_not_depend_on_the_step() {
    let baseline = crumple::scenario::ControllerSpec::named("baseline").unwrap();
    for index in 0..40 {
        let scenario: Scenario = crumple::scenario::PaperDistribution { seed: 11 }.draw(index).unwrap();
        for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
            let options = crumple::sim::RunOptions::new(baseline.clone()).with_estimator(estimator);
            let [coarse, fine] = [0.01, 0.001].map(|dt_s| traced(&scenario, &options.clone().with_dt_s(dt_s)));
            symmetry::assert_same_impacts(&coarse, &fine, 0, 0.0).expect("the same verdict");
        }
    }
}
