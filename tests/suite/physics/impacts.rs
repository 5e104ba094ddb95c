//! Impacts keep momentum, take energy away and leave vehicles stuck together.

use crumple::scenario::{LeadProfile, Scenario, ScenarioSpec};
use crumple::sim::{AfterContact, Impact, Trace};
use proptest::prelude::*;

use super::trace_of;
use crate::generate::{Setup, any_scenario, cases, script, traced};

/// A line in which some vehicles do not look and the one ahead of them is slower.
fn pile_up() -> impl Strategy<Value = Scenario> {
    let careless = prop::collection::vec((any::<bool>(), 0.0..20.0_f64), 6);
    (any_scenario(), careless).prop_map(|(scenario, careless)| {
        let crowd = |spec: &mut ScenarioSpec| {
            for (index, (vehicle, (careless, extra_mps))) in spec.vehicles.iter_mut().zip(careless).enumerate() {
                vehicle.speed_mps = 5.0 * index as f64 + extra_mps;
                if careless {
                    script(vehicle, LeadProfile::ConstantSpeed);
                }
            }
        };
        scenario.edited(crowd).expect("still valid")
    })
}

fn masses_kg(trace: &Trace, vehicles: std::ops::RangeInclusive<usize>) -> f64 {
    trace.vehicles[vehicles].iter().map(|track| track.mass_kg).sum()
}

/// The two bodies of an impact: mass and speed before it.
fn bodies(trace: &Trace, impact: &Impact) -> [(f64, f64); 2] {
    let contact = &impact.contact;
    [
        (masses_kg(trace, impact.first_involved..=contact.front_vehicle), contact.front_speed_mps),
        (masses_kg(trace, contact.rear_vehicle..=impact.last_involved), contact.rear_speed_mps),
    ]
}

proptest! {
    #![proptest_config(cases(512))]

    /// Every impact keeps the momentum of its two bodies and never adds energy; each body's change of speed is told right.
    #[test]
    fn each_impact_keeps_momentum_and_adds_no_energy(scenario in pile_up()) {
        let result = traced(&scenario, &Setup::truthful().options(scenario.spec().step_s, AfterContact::Continue));
        for impact in &result.impacts {
            let bodies = bodies(trace_of(&result), impact);
            let sum = |of: &dyn Fn(f64, f64) -> f64| bodies.iter().map(|&(mass, speed)| of(mass, speed)).sum::<f64>();
            let (mass, common) = (sum(&|mass, _| mass), impact.common_speed_mps);
            let momentum = sum(&|mass, speed| mass * speed);
            prop_assert!((momentum - mass * common).abs() <= 1e-9 * momentum.max(1.0));
            let energy = sum(&|mass, speed| 0.5 * mass * speed * speed);
            prop_assert!(0.5 * mass * common * common <= energy * (1.0 + 1e-12));
            prop_assert!(impact.contact.impact_speed_mps >= -1e-9, "nobody drives into a faster vehicle ahead");
            let [front, rear] = [impact.contact.front_vehicle, impact.contact.rear_vehicle];
            let gained = impact.delta_v_mps(front) - (common - impact.contact.front_speed_mps);
            let lost = impact.delta_v_mps(rear) - (impact.contact.rear_speed_mps - common);
            prop_assert!(gained.abs() < 1e-12 && lost.abs() < 1e-12);
        }
    }

    /// Over a step in which nobody brakes to standstill, forces alone change the momentum of the line, whatever hits
    /// whatever in it: impacts have no momentum of their own to give.
    #[test]
    fn the_motion_itself_keeps_momentum_through_impacts(scenario in pile_up()) {
        let result = traced(&scenario, &Setup::truthful().options(scenario.spec().step_s, AfterContact::Continue));
        let trace = trace_of(&result);
        for k in 0..trace.len() - 1 {
            let dt_s = trace.time_s[k + 1] - trace.time_s[k];
            let brakes_to_standstill = |track: &crumple::sim::Track| {
                let (v, a) = (track.speed_mps[k], track.acceleration_mps2[k]);
                a < 0.0 && v + a * dt_s <= 0.0 || track.speed_mps[k + 1] == 0.0 && v > 0.0
            };
            if trace.vehicles.iter().any(brakes_to_standstill) {
                continue;
            }
            let sum = |of: &dyn Fn(&crumple::sim::Track) -> f64| {
                trace.vehicles.iter().map(|track| track.mass_kg * of(track)).sum::<f64>()
            };
            let (before, after) = (sum(&|t| t.speed_mps[k]), sum(&|t| t.speed_mps[k + 1]));
            let impulse = dt_s * sum(&|t| t.acceleration_mps2[k]);
            prop_assert!((before + impulse - after).abs() <= 1e-9 * before.max(1.0), "step {k}: {before} {after}");
        }
    }

    /// Whoever touches stays together: one speed, no gap, to the end.
    #[test]
    fn vehicles_that_touched_stick_together(scenario in pile_up()) {
        let result = traced(&scenario, &Setup::truthful().options(scenario.spec().step_s, AfterContact::Continue));
        let trace = trace_of(&result);
        for contact in result.impacts.iter().map(|impact| impact.contact) {
            let pair = trace.pair(contact.rear_vehicle).unwrap();
            let after = trace.time_s.iter().position(|&t| t > contact.time_s + 1e-9).unwrap_or(trace.len());
            for (k, gap_m) in pair.gaps_m().enumerate().skip(after) {
                prop_assert!(gap_m.abs() < 1e-8, "sample {k}: {gap_m} m apart after contact");
                prop_assert_eq!(pair.front.speed_mps[k], pair.rear.speed_mps[k], "sample {}", k);
            }
        }
        let mut touched: Vec<_> = result.impacts.iter().map(|impact| impact.contact.rear_vehicle).collect();
        touched.sort_unstable();
        touched.dedup();
        prop_assert_eq!(touched.len(), result.impacts.len(), "each pair touches once");
    }
}

/// The properties above are about something.
#[test]
fn pile_ups_pile_up() {
    use proptest::strategy::ValueTree;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let strategy = pile_up();
    let options = Setup::truthful().options(0.01, AfterContact::Continue);
    let impacts: usize =
        (0..200).map(|_| traced(&strategy.new_tree(&mut runner).unwrap().current(), &options).impacts.len()).sum();
    assert!(impacts > 200, "{impacts} impacts in 200 scenarios");
}
