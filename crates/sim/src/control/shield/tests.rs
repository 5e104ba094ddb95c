//! Tests of the shield's admission test against every instant and every behaviour of the leader.
#![allow(clippy::unwrap_used)]

use std::sync::{Arc, Mutex};

use super::*;
use crate::control::tests::{EGO, command_behind, leader_observation};
use crate::control::{BuiltInController, ControllerSource, IntoSource, ShieldKind, ShieldedSource};
use crate::observation::Neighbour;
use proptest::prelude::*;

/// Parameters of a car that brakes at 8 m/s², its truck leader at 5, with steps of a second.
fn slow_step_params() -> ShieldParams {
    ShieldParams {
        step_s: 1.0,
        brake_mps2: 8.0,
        accel_mps2: 3.0,
        noise_mps2: 0.0,
        ahead_brake_mps2: 5.0,
        delay_steps: 0,
        response_fraction: 1.0,
        errors: ErrorBounds::default(),
        behind: None,
        margin_m: MIN_MARGIN_M,
    }
}

fn state(gap_m: f64, speed_mps: f64, ahead_mps: f64) -> ShieldState {
    ShieldState {
        gap_m,
        speed_mps,
        ahead_mps,
        response_mps2: 0.0,
    }
}

/// Both are equally fast after half a second, when the gap has closed by 0.25 m, and it grows again after that.
#[test]
fn a_collision_within_a_step_is_prevented() {
    let (frame, wanted_mps2) = (slow_step_params(), -7.0);
    for (gap_m, is_admitted) in [(0.2, false), (0.25, false), (0.250_002, true)] {
        let now = state(gap_m, 11.0, 10.0);
        assert!(
            frame.spare_m(now) > frame.margin_m,
            "there is a way out: full braking"
        );
        let later = frame.after(now, wanted_mps2);
        assert!(
            frame.spare_m(later) >= frame.margin_m,
            "and the step ends in the kernel"
        );
        assert_eq!(frame.admits(now, wanted_mps2), is_admitted, "{gap_m} m");
    }
}

#[test]
fn a_command_is_admitted_if_the_step_ends_inside_the_kernel_by_the_margin() {
    let frame = slow_step_params();
    // 20 m/s are held for a second behind a leader that brakes from 20 to 15: 2.5 m less, and 5²/6 m demanded.
    let needed_m = 2.5 + 25.0 / 6.0;
    for (more, is_admitted) in [(0.0, false), (0.5, false), (1.5, true)] {
        let now = state(needed_m + more * MIN_MARGIN_M, 20.0, 20.0);
        assert_eq!(frame.admits(now, 0.0), is_admitted, "{more} margins more");
    }
}

prop_compose! {
    fn any_state_and_action()(
        step_s in prop_oneof![0.005..0.05_f64, 0.05..1.0_f64],
        (brake_mps2, ahead_brake_mps2) in (0.5..10.0_f64, 0.5..10.0_f64),
        noise_share in prop_oneof![Just(0.0), 0.0..0.3_f64],
        share in prop_oneof![Just(1.0), 0.05..1.0_f64],
        // Little spare gap, similar speeds and hard braking: gaps that are smallest inside a step.
        (spare_m, speed_mps, ahead_mps) in
            (prop_oneof![0.0..0.5_f64, 0.0..0.02_f64], 0.0..30.0_f64, prop_oneof![3 => 0.0..30.0_f64, 1 => Just(0.0)]),
        near in prop::option::of(-1.0..1.0_f64),
        (response, wanted) in (0.0..1.0_f64, prop_oneof![0.0..1.0_f64, 0.0..0.2_f64]),
    ) -> (ShieldParams, ShieldState, f64) {
        let noise_mps2 = noise_share * brake_mps2;
        let frame = ShieldParams {
            step_s, brake_mps2, ahead_brake_mps2, noise_mps2, response_fraction: share, ..slow_step_params()
        };
        let between = |part: f64| -brake_mps2 + part * (brake_mps2 + frame.accel_mps2);
        let ahead_mps = near.map_or(ahead_mps, |by| (speed_mps + by).max(0.0));
        let response_mps2 = if share < 1.0 { between(response) } else { 0.0 };
        let at_kernel = ShieldState { gap_m: 0.0, speed_mps, ahead_mps, response_mps2 };
        let gap_m = spare_m - frame.spare_m(at_kernel);
        (frame, ShieldState { gap_m, ..at_kernel }, between(wanted))
    }
}

/// Returns the gap at an instant of the step after a command, if the leader holds an acceleration.
fn gap_m(
    frame: &ShieldParams,
    state: ShieldState,
    wanted_mps2: f64,
    noise_mps2: f64,
    ahead_mps2: f64,
    t: f64,
) -> f64 {
    let response_mps2 = frame.response_mps2(state.response_mps2, wanted_mps2);
    let stands = state.speed_mps == 0.0 && response_mps2 <= 0.0;
    let own_mps2 = if stands {
        0.0
    } else {
        response_mps2 + noise_mps2
    };
    state.gap_m + distance_and_speed_after(state.ahead_mps, ahead_mps2, t)[0]
        - distance_and_speed_after(state.speed_mps, own_mps2, t)[0]
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2000))]

    /// After an admitted command, for any leader and any noise, the gap is open at every instant of the step, and a
    /// collision can still be avoided at its end. A rejected command violates one of the two.
    #[test]
    fn a_command_is_admitted_exactly_if_full_braking_afterwards_avoids_a_collision(
        (frame, now, wanted_mps2) in any_state_and_action(), ahead in 0.0..1.0_f64, noise in -1.0..1.0_f64,
    ) {
        let worst = |t: f64| gap_m(&frame, now, wanted_mps2, frame.noise_mps2, -frame.ahead_brake_mps2, t);
        let grid = || (0..=400).map(|k| frame.step_s * f64::from(k) / 400.0);
        let coarse_m = 20.0 * (frame.step_s / 400.0).powi(2) + 1e-9;
        let later = frame.after(now, wanted_mps2);
        prop_assert!((later.gap_m - worst(frame.step_s)).abs() < 1e-9);
        let closest_m = grid().map(worst).fold(f64::INFINITY, f64::min);
        if frame.admits(now, wanted_mps2) {
            prop_assert!(closest_m >= frame.margin_m - 1e-9 && frame.spare_m(later) >= frame.margin_m);
            let ahead_mps2 = -frame.ahead_brake_mps2 + ahead * (frame.ahead_brake_mps2 + 4.0);
            for t in grid() {
                let gap_m = gap_m(&frame, now, wanted_mps2, noise * frame.noise_mps2, ahead_mps2, t);
                prop_assert!(gap_m >= frame.margin_m - 1e-9, "{gap_m} m after {t} s");
            }
        } else {
            prop_assert!(closest_m < frame.margin_m + coarse_m || frame.spare_m(later) < frame.margin_m);
        }
    }

    /// Full braking decreases neither the spare gap nor the gap inside the step, for any lag.
    #[test]
    fn full_braking_never_lessens_the_spare_gap((frame, now, _) in any_state_and_action()) {
        let mut state = now;
        for _ in 0..50 {
            let before_m = frame.spare_m(state);
            for k in 1..8 {
                let gap_m = gap_m(&frame, state, -frame.brake_mps2, frame.noise_mps2, -frame.ahead_brake_mps2,
                                  frame.step_s * f64::from(k) / 8.0);
                prop_assert!(gap_m >= before_m - 1e-9);
            }
            state = frame.after(state, -frame.brake_mps2);
            prop_assert!(frame.spare_m(state) >= before_m - 1e-9, "{} {before_m}", frame.spare_m(state));
        }
    }
}

fn full_throttle_shield(frame: ShieldParams) -> ShieldedController {
    let full_throttle = BuiltInController::FullThrottle(Default::default());
    ShieldedController::new(full_throttle.start(&EGO, 0).unwrap(), frame)
}

/// Returns the smallest gap at which full throttle is admitted, to a micrometre.
fn min_admitted_gap_m(frame: ShieldParams, speed_mps: f64, ahead_mps: f64) -> f64 {
    let (mut low_m, mut high_m) = (0.0, 1000.0);
    while high_m - low_m > 1e-7 {
        let gap_m = 0.5 * (low_m + high_m);
        let command_mps2 = full_throttle_shield(frame)
            .decide(&leader_observation(speed_mps, gap_m, ahead_mps, 0.0))
            .unwrap();
        assert!(command_mps2 == -frame.brake_mps2 || command_mps2 == frame.accel_mps2);
        if command_mps2 > 0.0 {
            high_m = gap_m
        } else {
            low_m = gap_m
        }
    }
    high_m
}

/// 20 m/s against 15, step 0.1 s: computed by hand with exact quotients.
#[test]
fn the_smallest_admitted_gap_assumes_the_worst_state() {
    let plain = ShieldParams {
        step_s: 0.1,
        ..slow_step_params()
    };
    let least_m = |frame: ShieldParams| min_admitted_gap_m(frame, 20.0, 15.0);
    let demanded_m = |v: f64, w: f64| {
        ViabilityKernel {
            own_brake_mps2: 8.0,
            ahead_brake_mps2: 5.0,
        }
        .demanded_gap_m(v, w)
    };
    let near = |found_m: f64, by_hand_m: f64| {
        assert!((found_m - by_hand_m).abs() < 3e-6, "{found_m} {by_hand_m}")
    };
    // 2.015 m against 1.475 m, then 20.3 m/s behind 14.5.
    near(least_m(plain), 0.54 + demanded_m(20.3, 14.5));
    // With observation errors: 0.3 m less, 20.2 m/s behind 14.6.
    let errors = ErrorBounds {
        gap_m: 0.3,
        speed_mps: 0.2,
        ahead_speed_mps: 0.4,
    };
    near(
        least_m(ShieldParams { errors, ..plain }),
        0.3 + 0.6 + demanded_m(20.5, 14.1),
    );
    // First two steps at 20 m/s behind a leader that brakes: 4 m against 2.9.
    near(
        least_m(ShieldParams {
            delay_steps: 2,
            ..plain
        }),
        1.1 + (2.015 - 1.375) + demanded_m(20.3, 13.5),
    );
    // Half of 3 m/s² in this step; the lag adds 0.1 s at 9.5 m/s² more than full braking.
    near(
        least_m(ShieldParams {
            response_fraction: 0.5,
            ..plain
        }),
        2.0075 - 1.475 + demanded_m(20.15 + 0.1 * 9.5, 14.5),
    );
    // Noise of 1 m/s² increases the acceleration and reduces the brake.
    let noisy = ViabilityKernel {
        own_brake_mps2: 7.0,
        ahead_brake_mps2: 5.0,
    }
    .demanded_gap_m(20.4, 14.5);
    near(
        least_m(ShieldParams {
            noise_mps2: 1.0,
            ..plain
        }),
        2.02 - 1.475 + noisy,
    );
}

/// The prediction includes delay, lag and pending commands.
#[test]
fn the_prediction_includes_pending_commands() {
    let frame = ShieldParams {
        step_s: 0.1,
        delay_steps: 1,
        response_fraction: 0.5,
        ..slow_step_params()
    };
    let observation = leader_observation(10.0, 100.0, 10.0, 0.0);
    let mut shield = full_throttle_shield(frame);
    let commands = |shield: &ShieldedController| {
        let commands = &shield.commands;
        (
            commands.response_mps2(),
            commands.pending_mps2().collect::<Vec<_>>(),
        )
    };
    assert_eq!(shield.decide(&observation).unwrap(), 3.0);
    assert_eq!(commands(&shield), (0.0, vec![3.0]));
    assert_eq!(shield.decide(&observation).unwrap(), 3.0);
    assert_eq!(commands(&shield), (1.5, vec![3.0]));
    let worst = shield.worst_state(&observation).unwrap();
    assert_eq!((worst.response_mps2, worst.ahead_mps), (2.25, 9.5));
    assert!(
        (worst.speed_mps - 10.225).abs() < 1e-12
            && (worst.gap_m - (100.0 + 0.975 - 1.01125)).abs() < 1e-12
    );
}

#[test]
fn a_state_is_outside_the_kernel_below_half_the_margin() {
    for (spare_m, outside) in [(1e-5 * 0.4, true), (1e-5 * 0.6, false), (-0.1, true)] {
        let frame = ShieldParams {
            step_s: 0.1,
            margin_m: 1e-5,
            ..slow_step_params()
        };
        let gap_m = frame.kernel().demanded_gap_m(20.0, 15.0) + spare_m;
        let mut shield = full_throttle_shield(frame);
        assert_eq!(command_behind(&mut shield, 20.0, gap_m, 15.0, 0.0), -8.0);
        let expected = Override {
            first_step: 0,
            last_step: 0,
            outside_kernel: outside,
            rear_conflict: false,
        };
        assert_eq!(shield.overrides(), [expected]);
    }
}

/// Two vehicles stand half a margin apart, so that the spare gap is exact.
#[test]
fn half_a_margin_is_inside_the_kernel() {
    let frame = slow_step_params();
    let gap_m = 0.5 * frame.margin_m;
    assert_eq!(frame.spare_m(state(gap_m, 0.0, 0.0)), gap_m);
    let mut shield = full_throttle_shield(frame);
    assert_eq!(command_behind(&mut shield, 0.0, gap_m, 0.0, 0.0), -8.0);
    assert!(!shield.overrides()[0].outside_kernel);
}

/// Within the follower's 0.4 s at 20 m/s, the own vehicle brakes at 8 m/s² to 16.8 m/s over 7.36 m.
#[test]
fn the_vehicle_behind_is_in_danger_if_it_cannot_stop_for_full_braking() {
    let behind_it = RearVehicleParams {
        brake_mps2: 6.0,
        reaction_s: 0.4,
    };
    let conflict = |frame: ShieldParams, rear_gap_m: Option<f64>| {
        let rear = rear_gap_m.map(|gap_m| Neighbour {
            gap_m,
            speed_mps: 20.0,
            acceleration_mps2: 0.0,
        });
        let mut shield = full_throttle_shield(frame);
        let observation = Observation {
            behind: rear,
            ..leader_observation(20.0, 1.0, 10.0, 0.0)
        };
        assert_eq!(shield.decide(&observation).unwrap(), -8.0);
        shield.overrides()[0].rear_conflict
    };
    let frame = ShieldParams {
        step_s: 0.1,
        behind: Some(behind_it),
        ..slow_step_params()
    };
    let least_m = 8.0 - 7.36 + 400.0 / 12.0 - 16.8 * 16.8 / 16.0;
    assert!(conflict(frame, Some(least_m - 1e-9)) && !conflict(frame, Some(least_m + 1e-9)));
    assert!(
        !conflict(frame, None)
            && !conflict(
                ShieldParams {
                    behind: None,
                    ..frame
                },
                Some(0.1)
            )
    );
}

#[test]
fn overrides_in_successive_steps_are_one() {
    let frame = ShieldParams {
        step_s: 0.1,
        behind: Some(RearVehicleParams {
            brake_mps2: 6.0,
            reaction_s: 0.0,
        }),
        ..slow_step_params()
    };
    let mut shield = full_throttle_shield(frame);
    let near_m = frame.kernel().demanded_gap_m(20.0, 15.0) + 0.01;
    let rear = Some(Neighbour {
        gap_m: 0.1,
        speed_mps: 30.0,
        acceleration_mps2: 0.0,
    });
    let far = leader_observation(20.0, 500.0, 15.0, 0.0);
    let near = leader_observation(20.0, near_m, 15.0, 0.0);
    let outside = leader_observation(20.0, near_m - 1.0, 15.0, 0.0);
    for observation in [
        near,
        outside,
        Observation {
            behind: rear,
            ..near
        },
        far,
        near,
        Observation {
            ahead: None,
            ..near
        },
    ] {
        shield.decide(&observation).unwrap();
    }
    let first = Override {
        first_step: 0,
        last_step: 2,
        outside_kernel: true,
        rear_conflict: true,
    };
    let second = Override {
        first_step: 4,
        last_step: 4,
        outside_kernel: false,
        rear_conflict: false,
    };
    assert_eq!(shield.overrides(), [first, second]);
}

/// Full braking by the controller is no override, but is recorded outside the kernel. Commands are clipped.
#[test]
fn only_changed_commands_are_overrides() {
    let frame = ShieldParams {
        step_s: 0.1,
        brake_mps2: 2.0,
        accel_mps2: 1.0,
        ..slow_step_params()
    };
    let mut shield = full_throttle_shield(frame);
    assert_eq!(
        command_behind(&mut shield, 20.0, 900.0, 20.0, 0.0),
        1.0,
        "cut to what there is"
    );
    let full_brake = ShieldParams {
        accel_mps2: -2.0,
        ..frame
    };
    let mut braking = self::full_throttle_shield(full_brake);
    let near_m = full_brake.kernel().demanded_gap_m(20.0, 20.0) + 0.01;
    assert_eq!(command_behind(&mut braking, 20.0, near_m, 20.0, 0.0), -2.0);
    assert_eq!(braking.overrides(), []);
    assert_eq!(
        command_behind(&mut braking, 20.0, near_m - 1.0, 20.0, 0.0),
        -2.0
    );
    let expected = Override {
        first_step: 1,
        last_step: 1,
        outside_kernel: true,
        rear_conflict: false,
    };
    assert_eq!(braking.overrides(), [expected]);
}

/// Always commands the same, and stores the commands that replace its own.
struct Constant {
    wanted_mps2: f64,
    is_warning: bool,
    replaced_mps2: Arc<Mutex<Vec<f64>>>,
}

impl Controller for Constant {
    fn decide(&mut self, _: &Observation) -> Result<f64, ControllerFailure> {
        Ok(self.wanted_mps2)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.replaced_mps2.lock().unwrap().push(command_mps2);
    }

    fn is_warning(&self) -> bool {
        self.is_warning
    }
}

/// The controller learns of other commands than its own, from the shield and from outside, and the shield warns if it
/// does. Full braking on its own, inside the kernel by less than the margin, is not reported at all.
#[test]
fn a_shield_passes_on_warnings_and_other_commands() {
    let frame = ShieldParams {
        delay_steps: 1,
        ..slow_step_params()
    };
    let replaced_mps2 = Arc::<Mutex<Vec<f64>>>::default();
    let shield = |wanted_mps2: f64, is_warning: bool| {
        let controller = Constant {
            wanted_mps2,
            is_warning,
            replaced_mps2: Arc::clone(&replaced_mps2),
        };
        ShieldedController::new(Box::new(controller), frame)
    };
    let replaced = || std::mem::take(&mut *replaced_mps2.lock().unwrap());
    let mut throttle = shield(3.0, true);
    let mut braking = shield(-8.0, false);
    assert!(throttle.is_warning() && !braking.is_warning());

    let near_m = 0.75 * frame.margin_m;
    assert_eq!(command_behind(&mut throttle, 0.0, near_m, 0.0, 0.0), -8.0);
    assert_eq!(replaced(), [-8.0]);
    assert_eq!(command_behind(&mut braking, 0.0, near_m, 0.0, 0.0), -8.0);
    assert!(!frame.admits(state(near_m, 0.0, 0.0), -8.0));
    assert!(replaced().is_empty() && braking.overrides().is_empty());

    throttle.record_command(-1.0);
    assert_eq!(replaced(), [-1.0]);
    assert!(throttle.commands.pending_mps2().eq([-1.0]));
}

/// Suites run several seeds of a controller that acts at random, also behind a shield.
#[test]
fn a_shield_acts_at_random_if_its_controller_does() {
    for (name, acts_at_random) in [("human", true), ("car:ix-2023", true), ("idm", false)] {
        let shielded = |settings: &str| ShieldedSource {
            controller: BuiltInController::from_name_or_preset(name)
                .unwrap()
                .into_source(),
            settings: ShieldKind::parse(settings).unwrap(),
        };
        for settings in ["", "2"] {
            assert_eq!(
                shielded(settings).acts_at_random(),
                acts_at_random,
                "{settings}:{name}"
            );
        }
    }
}
