//! Stopping distances and collision times against closed forms, to 1e-9.

use crumple_fuzzing::RunSetup;
use crumple_sim::engine::SimulationResult;
use crumple_sim::scenario::{
    Brake, Driver, LeadProfile, PiecewiseAcceleration, Scenario, VehicleClass, VehicleSpec,
};
use proptest::prelude::*;

use super::trace_of;
use crate::generate::{any_profile, scenario_spec, simulate_traced, with_cases};

#[derive(Debug, Clone, Copy)]
struct AcceleratedBody {
    x: f64,
    v: f64,
    a: f64,
}

impl AcceleratedBody {
    fn stop_time_s(self) -> f64 {
        if self.a < 0.0 {
            self.v / -self.a
        } else {
            f64::INFINITY
        }
    }

    fn x_at(self, t: f64) -> f64 {
        let t = t.min(self.stop_time_s());
        self.x + self.v * t + 0.5 * self.a * t * t
    }

    fn v_at(self, t: f64) -> f64 {
        if t >= self.stop_time_s() {
            0.0
        } else {
            self.v + self.a * t
        }
    }
}

/// Returns the first collision of two bodies and their smallest gap until `end_s`, in closed form: the gap is monotone
/// between the instants at which a body stops or both speeds are equal, so bisection finds its root.
fn first_collision(
    front: AcceleratedBody,
    rear: AcceleratedBody,
    end_s: f64,
) -> (Option<f64>, f64) {
    let gap = |t: f64| front.x_at(t) - rear.x_at(t);
    let mut turns = vec![0.0, end_s, front.stop_time_s(), rear.stop_time_s()];
    turns.push((rear.v - front.v) / (front.a - rear.a));
    turns.retain(|t| (0.0..=end_s).contains(t));
    turns.sort_by(f64::total_cmp);
    let mut smallest = f64::INFINITY;
    for pair in turns.windows(2) {
        let [mut from, mut to] = [pair[0], pair[1]];
        smallest = smallest.min(gap(to));
        if gap(to) <= 0.0 {
            for _ in 0..200 {
                let middle = 0.5 * (from + to);
                if gap(middle) <= 0.0 {
                    to = middle
                } else {
                    from = middle
                }
            }
            return (Some(to), 0.0);
        }
    }
    (None, smallest)
}

fn two_vehicle_scenario(
    front: AcceleratedBody,
    rear: AcceleratedBody,
    step_s: f64,
    steps: u32,
) -> Scenario {
    let vehicle = |body: AcceleratedBody| {
        let profile = PiecewiseAcceleration {
            from_s: vec![0.0],
            accel_mps2: vec![body.a],
        };
        VehicleSpec {
            length_m: Some(4.0),
            max_brake_mps2: Some(30.0),
            max_accel_mps2: Some(30.0),
            ..VehicleSpec::new(
                VehicleClass::Light,
                body.x,
                body.v,
                Driver::Profile(LeadProfile::Pieces(profile)),
            )
        }
    };
    let mut vehicles = vec![vehicle(front), vehicle(rear)];
    vehicles[0].position_m += 4.0;
    Scenario::new(scenario_spec(
        "two bodies",
        step_s,
        f64::from(steps) * step_s,
        vehicles,
    ))
    .expect("valid")
}

fn run(scenario: &Scenario) -> SimulationResult {
    simulate_traced(
        scenario,
        &RunSetup::with_true_state().options(scenario.spec().step_s),
    )
}

/// Returns a script that a vehicle at `v` can follow: without release, and with recorded speeds that start at the
/// vehicle's speed and respect its limits.
fn make_feasible(v: f64, mut profile: LeadProfile) -> (f64, LeadProfile) {
    match &mut profile {
        LeadProfile::RampBrake(ramp) => ramp.release_s = 0.0,
        LeadProfile::BrakeToSpeed(brake) => brake.final_speed_mps = brake.final_speed_mps.min(v),
        LeadProfile::Recorded(recorded) => {
            let mut last = (0.0, v);
            for (&t, speed_mps) in recorded.time_s.iter().zip(&mut recorded.speed_mps) {
                let most = if last.0 == 0.0 {
                    0.0
                } else {
                    20.0 * (t - last.0)
                };
                *speed_mps = speed_mps.clamp(last.1 - most.min(last.1), last.1 + most);
                last = (t, *speed_mps);
            }
        }
        LeadProfile::ConstantSpeed | LeadProfile::Brake(_) | LeadProfile::Pieces(_) => {}
    }
    (v, profile)
}

/// Returns the speed at time t in closed form for an initial speed v; not valid after a stop.
fn scripted_speed_mps(profile: &LeadProfile, v: f64, t: f64) -> f64 {
    match profile {
        LeadProfile::ConstantSpeed => v,
        LeadProfile::Brake(brake) => v - brake.rate_mps2 * (t - brake.onset_s).max(0.0),
        LeadProfile::RampBrake(ramp) => {
            let since = (t - ramp.onset_s).max(0.0);
            let ramping = since.min(ramp.ramp_s);
            v - ramp.rate_mps2 * (0.5 * ramping * ramping / ramp.ramp_s + (since - ramping))
        }
        LeadProfile::BrakeToSpeed(brake) => {
            (v - brake.rate_mps2 * (t - brake.onset_s).max(0.0)).max(brake.final_speed_mps)
        }
        LeadProfile::Pieces(pieces) => {
            let ends = pieces.from_s.iter().skip(1).copied().chain([f64::INFINITY]);
            let pieces = pieces.from_s.iter().zip(ends).zip(&pieces.accel_mps2);
            v + pieces
                .map(|((&from, to), a)| a * (t.min(to) - from).max(0.0))
                .sum::<f64>()
        }
        LeadProfile::Recorded(recorded) => {
            let samples: Vec<_> = recorded.time_s.iter().zip(&recorded.speed_mps).collect();
            let between = samples
                .windows(2)
                .find(|pair| (*pair[0].0..*pair[1].0).contains(&t));
            match between {
                Some(pair) => {
                    pair[0].1 + (pair[1].1 - pair[0].1) * (t - pair[0].0) / (pair[1].0 - pair[0].0)
                }
                None if t < *samples[0].0 => *samples[0].1,
                None => *samples[samples.len() - 1].1,
            }
        }
    }
}

fn any_step_s() -> impl Strategy<Value = f64> {
    prop::sample::select(vec![0.01, 0.05, 0.1, 1.0])
}

fn any_acceleration_mps2() -> impl Strategy<Value = f64> {
    prop_oneof![1 => Just(0.0), 3 => -10.0..4.0_f64]
}

proptest! {
    #![proptest_config(with_cases(1024))]

    /// Stopping takes v / b and v² / 2b, for any step size and any onset.
    #[test]
    fn a_braking_vehicle_stops_in_v_squared_over_2b(
        v in 0.0..60.0_f64,
        b in 1.0..10.0_f64,
        onset_steps in 0..50_u32,
        step_s in any_step_s(),
    ) {
        let onset_s = f64::from(onset_steps) * step_s;
        let steps = onset_steps + (v / b / step_s).ceil() as u32 + 2;
        let front = AcceleratedBody { x: 100.0, v, a: 0.0 };
        let rear = AcceleratedBody { x: 0.0, v: 0.0, a: 0.0 };
        let braking = two_vehicle_scenario(front, rear, step_s, steps).edited(|spec| {
            let brake = Brake { onset_s, rate_mps2: b };
            spec.vehicles[0].driver = Driver::Profile(LeadProfile::Brake(brake));
        }).unwrap();
        let result = run(&braking);
        let track = &trace_of(&result).vehicles[0];
        let covered_m = track.position_m.last().unwrap() - track.position_m[0];
        prop_assert!((covered_m - (v * onset_s + v * v / (2.0 * b))).abs() < 1e-9, "{covered_m} m");
        prop_assert_eq!(*track.speed_mps.last().unwrap(), 0.0);
        let moving_s = step_s * (track.speed_mps.iter().filter(|&&v| v > 0.0).count() as f64 - 1.0);
        prop_assert!(v == 0.0 || moving_s <= onset_s + v / b && onset_s + v / b <= moving_s + step_s + 1e-9);
    }

    /// A scripted vehicle has the speed of its script at every step boundary, even if the script changes within a step.
    #[test]
    fn scripts_are_kept_at_every_step_boundary(
        v in 0.0..40.0_f64,
        profile in (1..6_u8).prop_flat_map(any_profile),
        step_s in prop::sample::select(vec![0.01, 0.05, 0.1]),
    ) {
        let (v, profile) = make_feasible(v, profile);
        let bodies = [AcceleratedBody { x: 100.0, v, a: 0.0 }, AcceleratedBody { x: 0.0, v: 0.0, a: 0.0 }];
        let scripted = two_vehicle_scenario(bodies[0], bodies[1], step_s, 100).edited(|spec| {
            spec.vehicles[0].driver = Driver::Profile(profile.clone());
        }).unwrap();
        let result = run(&scripted);
        let trace = trace_of(&result);
        for (&t, &speed_mps) in trace.time_s.iter().zip(&trace.vehicles[0].speed_mps) {
            let scripted_mps = scripted_speed_mps(&profile, v, t);
            if scripted_mps <= 0.0 {
                break;
            }
            prop_assert!((speed_mps - scripted_mps).abs() < 1e-9, "{speed_mps} at {t}, script {scripted_mps}");
        }
    }

    /// Any two constant accelerations: collision, impact speed and smallest gap match the closed forms.
    #[test]
    fn any_two_bodies_meet_where_their_parabolas_do(
        (g, v_f, v_r) in (0.01..40.0_f64, prop_oneof![1 => Just(0.0), 3 => 0.0..40.0_f64], 0.0..40.0_f64),
        (a_f, a_r) in (any_acceleration_mps2(), any_acceleration_mps2()),
        (steps, step_s) in (1..120_u32, any_step_s()),
    ) {
        let (front, rear) = (AcceleratedBody { x: g, v: v_f, a: a_f }, AcceleratedBody { x: 0.0, v: v_r, a: a_r });
        let steps = steps.min((12.0 / step_s) as u32);
        let (meeting_s, smallest_m) = first_collision(front, rear, f64::from(steps) * step_s);
        prop_assume!(meeting_s.is_some() || smallest_m > 1e-6);
        let result = run(&two_vehicle_scenario(front, rear, step_s, steps));
        match (result.outcome.collision(), meeting_s) {
            (None, None) => {
                let min_gap_m = result.vehicles[1].min_gap_m.unwrap();
                prop_assert!((min_gap_m - smallest_m.min(g)).abs() < 1e-9, "{min_gap_m} m, closed form {smallest_m} m");
            }
            (Some(collision), Some(time_s)) => {
                let impact_mps = rear.v_at(time_s) - front.v_at(time_s);
                prop_assume!(impact_mps > 0.1);
                let error_s = (collision.time_s - time_s).abs();
                prop_assert!(error_s < 1e-9, "{} s, closed form {time_s} s", collision.time_s);
                prop_assert!((collision.impact_speed_mps - impact_mps).abs() < 1e-8);
            }
            (found, expected) => prop_assert!(false, "found {found:?}, closed form {expected:?}"),
        }
    }
}

/// Acceleration noise is normal, with the stated standard deviation and without memory.
#[test]
fn noise_is_as_large_as_stated() {
    let deviation_mps2 = 0.3;
    let body = |x: f64| AcceleratedBody { x, v: 30.0, a: 0.0 };
    let scenario = two_vehicle_scenario(body(1000.0), body(0.0), 0.01, 2000).edited(|spec| {
        spec.vehicles[0].acceleration_noise_mps2 = deviation_mps2;
    });
    let result = run(&scenario.expect("valid"));
    let trace = trace_of(&result);
    let noise = &trace.vehicles[0].acceleration_mps2[..2000];
    let mean = |of: &dyn Fn(usize) -> f64| (0..1999).map(of).sum::<f64>() / 1999.0;
    // Each bound fails by chance once in ten thousand runs.
    assert!(mean(&|k| noise[k]).abs() < 4.0 * deviation_mps2 / 2000.0_f64.sqrt());
    assert!(
        (mean(&|k| noise[k].powi(2)).sqrt() / deviation_mps2 - 1.0).abs() < 4.0 / 4000.0_f64.sqrt()
    );
    assert!(
        (mean(&|k| noise[k] * noise[k + 1]) / deviation_mps2.powi(2)).abs()
            < 4.0 / 2000.0_f64.sqrt()
    );
    assert!(
        trace.vehicles[1]
            .acceleration_mps2
            .iter()
            .all(|a| *a == 0.0),
        "no other vehicle has noise"
    );
}
