//! Inner loops over all runs of a block, for one vehicle position at a time.
//!
//! They are inlined into code for the vector registers of this machine. Each operation is rounded separately, and no
//! sum adds values of different runs. The register width therefore does not change the result. All slices of a loop
//! have the same length. They are arguments, not fields, so that the compiler can assume that inputs and outputs do not
//! alias.

use super::per_run::RunSet;
use crate::control::{Idm, clamp_command};
use crate::engine::actuator::add_noise_unless_at_rest;
use crate::engine::motion;
use crate::engine::recorder::{raise_max_brake, ttc_s};
use crate::scenario::Brake;

#[inline(always)]
pub(super) fn limit(decided_mps2: &mut [f64], max_brake_mps2: &[f64], max_accel_mps2: &[f64]) {
    let n = decided_mps2.len();
    let max_brake_mps2 = &max_brake_mps2[..n];
    let max_accel_mps2 = &max_accel_mps2[..n];
    for run in 0..n {
        decided_mps2[run] =
            clamp_command(decided_mps2[run], max_brake_mps2[run], max_accel_mps2[run]);
    }
}

#[inline(always)]
pub(super) fn brake(
    [from_s, to_s]: [f64; 2],
    onset_s: &[f64],
    rate_mps2: &[f64],
    decided_mps2: &mut [f64],
) {
    let n = decided_mps2.len();
    let onset_s = &onset_s[..n];
    let rate_mps2 = &rate_mps2[..n];
    for run in 0..n {
        let brake = Brake {
            onset_s: onset_s[run],
            rate_mps2: rate_mps2[run],
        };
        decided_mps2[run] = brake.acceleration_mps2(from_s, to_s);
    }
}

/// Computes commands of the Intelligent Driver Model; `ahead` is `[position, length, speed]` of the leader.
#[inline(always)]
pub(super) fn follow(
    models: [&[f64]; 5],
    [x, v]: [&[f64]; 2],
    ahead: [&[f64]; 3],
    decided_mps2: &mut [f64],
) {
    let n = decided_mps2.len();
    let [m0, m1, m2, m3, m4] = [
        &models[0][..n],
        &models[1][..n],
        &models[2][..n],
        &models[3][..n],
        &models[4][..n],
    ];
    let [x, v] = [&x[..n], &v[..n]];
    let [ahead_x, ahead_l, ahead_v] = [&ahead[0][..n], &ahead[1][..n], &ahead[2][..n]];
    for run in 0..n {
        let model = Idm::from_array([m0[run], m1[run], m2[run], m3[run], m4[run]]);
        let gap_m = ahead_x[run] - ahead_l[run] - x[run];
        decided_mps2[run] = model.acceleration_mps2(v[run], Some([gap_m, ahead_v[run]]));
    }
}

#[inline(always)]
pub(super) fn disturb(decided_mps2: &mut [f64], noise_mps2: &[f64], speed_mps: &[f64]) {
    let n = decided_mps2.len();
    let noise_mps2 = &noise_mps2[..n];
    let speed_mps = &speed_mps[..n];
    for run in 0..n {
        decided_mps2[run] =
            add_noise_unless_at_rest(decided_mps2[run], noise_mps2[run], speed_mps[run]);
    }
}

#[inline(always)]
pub(super) fn advance(dt_s: f64, [x, v, a]: [&[f64]; 3], next_x: &mut [f64], next_v: &mut [f64]) {
    let n = next_x.len();
    let [x, v, a] = [&x[..n], &v[..n], &a[..n]];
    let next_v = &mut next_v[..n];
    for run in 0..n {
        (next_x[run], next_v[run]) = motion::advance(x[run], v[run], a[run], dt_s);
    }
}

#[inline(always)]
pub(super) fn update_max_brake(max_mps2: &mut [f64], a: &[f64]) {
    for (max_mps2, &a) in max_mps2.iter_mut().zip(a) {
        *max_mps2 = raise_max_brake(*max_mps2, a);
    }
}

/// Position and length of the front vehicle, position of the rear one, speeds of both.
pub(super) type PairSlices<'a> = [&'a [f64]; 5];

#[inline(always)]
fn first_runs<'a>(pair: PairSlices<'a>, n: usize) -> PairSlices<'a> {
    [
        &pair[0][..n],
        &pair[1][..n],
        &pair[2][..n],
        &pair[3][..n],
        &pair[4][..n],
    ]
}

/// Finds the runs in which two vehicles may collide, or are closest, inside a step.
#[inline(always)]
pub(super) fn screen(
    dt_s: f64,
    now: PairSlices<'_>,
    [next_front_mps, next_rear_mps]: [&[f64]; 2],
) -> RunSet {
    let n = now[0].len();
    let [front_m, length_m, rear_m, front_mps, rear_mps] = first_runs(now, n);
    let next_front_mps = &next_front_mps[..n];
    let next_rear_mps = &next_rear_mps[..n];
    let mut bits = 0;
    for run in 0..n {
        let gap_m = front_m[run] - length_m[run] - rear_m[run];
        let closing_mps = [
            rear_mps[run] - front_mps[run],
            next_rear_mps[run] - next_front_mps[run],
        ];
        let is_close = motion::needs_collision_check(
            gap_m,
            [rear_mps[run], next_rear_mps[run]],
            closing_mps,
            dt_s,
        );
        bits |= u64::from(is_close) << run;
    }
    RunSet(bits)
}

#[inline(always)]
pub(super) fn update_min_gap_and_ttc(
    now: PairSlices<'_>,
    min_gap_m: &mut [f64],
    min_ttc_s: &mut [f64],
) {
    let n = min_gap_m.len();
    let [front_m, length_m, rear_m, front_mps, rear_mps] = first_runs(now, n);
    let min_ttc_s = &mut min_ttc_s[..n];
    for run in 0..n {
        let gap_m = front_m[run] - length_m[run] - rear_m[run];
        let ttc_s = ttc_s(gap_m, rear_mps[run] - front_mps[run]);
        // Plain comparison: `f64::min` also handles NaN, which cannot occur here.
        min_gap_m[run] = if gap_m < min_gap_m[run] {
            gap_m
        } else {
            min_gap_m[run]
        };
        min_ttc_s[run] = if ttc_s < min_ttc_s[run] {
            ttc_s
        } else {
            min_ttc_s[run]
        };
    }
}
