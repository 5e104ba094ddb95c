//! Impacts conserve momentum, dissipate energy and leave vehicles stuck together.

use crumple_fuzzing::oracle::impacts_are_inelastic;
use crumple_fuzzing::{RunSetup, TestCase};
use crumple_sim::engine::AfterCollision;
use crumple_sim::scenario::{LeadProfile, Scenario, ScenarioSpec};
use crumple_testing::generator::make_scripted;
use proptest::prelude::*;

use super::trace_of;
use crate::generate::{any_scenario, check_oracle, first_values, simulate_traced, with_cases};

/// A line in which some vehicles never brake and the one ahead of them is slower.
fn any_pile_up() -> impl Strategy<Value = Scenario> {
    let careless = prop::collection::vec((any::<bool>(), 0.0..20.0_f64), 6);
    (any_scenario(), careless).prop_map(|(scenario, careless)| {
        let crowd = |spec: &mut ScenarioSpec| {
            for (index, (vehicle, (careless, extra_mps))) in
                spec.vehicles.iter_mut().zip(careless).enumerate()
            {
                vehicle.speed_mps = 5.0 * index as f64 + extra_mps;
                if careless {
                    make_scripted(vehicle, LeadProfile::ConstantSpeed);
                }
            }
        };
        scenario.edited(crowd).expect("still valid")
    })
}

fn continuing_setup() -> RunSetup {
    RunSetup {
        after_collision: AfterCollision::Continue,
        ..RunSetup::with_true_state()
    }
}

proptest! {
    #![proptest_config(with_cases(512))]

    /// Every impact conserves the momentum of its two bodies, adds no energy, and reports each change of speed
    /// correctly. Vehicles that collide stay together to the end, with one speed and no gap.
    #[test]
    fn each_impact_keeps_momentum_and_leaves_vehicles_stuck_together(scenario in any_pile_up()) {
        check_oracle(&TestCase { scenario, setup: continuing_setup() }, impacts_are_inelastic)?;
    }

    /// In a step in which no vehicle brakes to standstill, only forces change the momentum of the line; impacts do not.
    #[test]
    fn the_motion_itself_keeps_momentum_through_impacts(scenario in any_pile_up()) {
        let result = simulate_traced(&scenario, &continuing_setup().options(scenario.spec().step_s));
        let trace = trace_of(&result);
        for k in 0..trace.len() - 1 {
            let dt_s = trace.time_s[k + 1] - trace.time_s[k];
            let brakes_to_standstill = |track: &crumple_sim::engine::Track| {
                let (v, a) = (track.speed_mps[k], track.acceleration_mps2[k]);
                a < 0.0 && v + a * dt_s <= 0.0 || track.speed_mps[k + 1] == 0.0 && v > 0.0
            };
            if trace.vehicles.iter().any(brakes_to_standstill) {
                continue;
            }
            let sum = |of: &dyn Fn(&crumple_sim::engine::Track) -> f64| {
                trace.vehicles.iter().map(|track| track.mass_kg * of(track)).sum::<f64>()
            };
            let (before, after) = (sum(&|t| t.speed_mps[k]), sum(&|t| t.speed_mps[k + 1]));
            let impulse = dt_s * sum(&|t| t.acceleration_mps2[k]);
            prop_assert!((before + impulse - after).abs() <= 1e-9 * before.max(1.0), "step {k}: {before} {after}");
        }
    }

    /// A standing vehicle is held whatever it and the vehicles stuck to it command: it is never braked.
    #[test]
    fn standing_vehicles_do_not_brake(scenario in any_pile_up()) {
        let result = simulate_traced(&scenario, &continuing_setup().options(scenario.spec().step_s));
        for (index, track) in trace_of(&result).vehicles.iter().enumerate() {
            let standing = (0..track.speed_mps.len() - 1).filter(|&k| track.speed_mps[k] == 0.0);
            for (k, a) in standing.map(|k| (k, track.acceleration_mps2[k])) {
                prop_assert!(a >= 0.0, "vehicle {index} stands at sample {k} and has {a} m/s²");
            }
        }
    }
}

#[test]
fn pile_ups_pile_up() {
    let options = continuing_setup().options(0.01);
    let strategy = any_pile_up();
    let scenarios = first_values(200, &strategy);
    let impacts: usize = scenarios
        .map(|scenario| simulate_traced(&scenario, &options).impacts.len())
        .sum();
    assert!(impacts > 200, "{impacts} impacts in 200 scenarios");
}
