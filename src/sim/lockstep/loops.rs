//! The inner loops: one vehicle position after the other, in all runs of a block.
//!
//! They are to be inlined where they are compiled for the vector registers of the machine at hand. Every operation is rounded
//! by itself and there is no sum over runs, so the width of the registers does not change a bit. All slices of a loop have
//! one length. Slices are arguments, not fields, since only so does the compiler know that what is written is not what is read.

use super::per_run::{GROUP, Runs};
use crate::sim::actuator::{unless_at_rest, within};
use crate::sim::motion;
use crate::sim::motion::needs_care;
use crate::sim::recorder::ttc_s;

type Groups<'a> = &'a [[f64; GROUP]];
type GroupsMut<'a> = &'a mut [[f64; GROUP]];

/// Cuts commands to what the vehicles can do.
#[inline(always)]
pub(super) fn limit(decided_mps2: GroupsMut<'_>, max_brake_mps2: Groups<'_>, max_accel_mps2: Groups<'_>) {
    for ((decided, max_brake), max_accel) in decided_mps2.iter_mut().zip(max_brake_mps2).zip(max_accel_mps2) {
        for run in 0..GROUP {
            decided[run] = within(decided[run], max_brake[run], max_accel[run]);
        }
    }
}

/// Adds noise, except where a vehicle stands and is held by its brakes.
#[inline(always)]
pub(super) fn disturb(decided_mps2: GroupsMut<'_>, noise_mps2: Groups<'_>, speed_mps: Groups<'_>) {
    for ((decided, noise), speed) in decided_mps2.iter_mut().zip(noise_mps2).zip(speed_mps) {
        for run in 0..GROUP {
            decided[run] = unless_at_rest(decided[run], noise[run], speed[run]);
        }
    }
}

/// Where vehicles are after a step if nobody touches them.
#[inline(always)]
pub(super) fn advance(
    dt_s: f64,
    [position_m, speed_mps, acceleration_mps2]: [Groups<'_>; 3],
    next_position_m: GroupsMut<'_>,
    next_speed_mps: GroupsMut<'_>,
) {
    let now = position_m.iter().zip(speed_mps).zip(acceleration_mps2);
    for ((next_x, next_v), ((x, v), a)) in next_position_m.iter_mut().zip(next_speed_mps).zip(now) {
        for run in 0..GROUP {
            (next_x[run], next_v[run]) = motion::advance(x[run], v[run], a[run], dt_s);
        }
    }
}

/// Takes in how hard vehicles brake.
#[inline(always)]
pub(super) fn note_braking(hardest_brake_mps2: GroupsMut<'_>, acceleration_mps2: Groups<'_>) {
    for (hardest, a) in hardest_brake_mps2.iter_mut().zip(acceleration_mps2) {
        for run in 0..GROUP {
            hardest[run] = if -a[run] > hardest[run] { -a[run] } else { hardest[run] };
        }
    }
}

/// A vehicle and the one ahead of it, at one instant.
#[derive(Clone, Copy)]
pub(super) struct Pairs<'a> {
    pub(super) front_m: Groups<'a>,
    pub(super) front_length_m: Groups<'a>,
    pub(super) rear_m: Groups<'a>,
    pub(super) front_mps: Groups<'a>,
    pub(super) rear_mps: Groups<'a>,
}

/// The runs in which two vehicles may touch, or are closest, inside a step.
#[inline(always)]
pub(super) fn screen(dt_s: f64, now: Pairs<'_>, [next_front_mps, next_rear_mps]: [Groups<'_>; 2]) -> Runs {
    let mut found = 0;
    let distances = now.front_m.iter().zip(now.front_length_m).zip(now.rear_m);
    let speeds = now.front_mps.iter().zip(now.rear_mps).zip(next_front_mps.iter().zip(next_rear_mps));
    for (group, (((front_m, length_m), rear_m), ((front_mps, rear_mps), (next_front_mps, next_rear_mps)))) in
        distances.zip(speeds).enumerate()
    {
        let mut here = 0;
        for run in 0..GROUP {
            let gap_m = front_m[run] - length_m[run] - rear_m[run];
            let closing_mps = [rear_mps[run] - front_mps[run], next_rear_mps[run] - next_front_mps[run]];
            here |= u64::from(needs_care(gap_m, [rear_mps[run], next_rear_mps[run]], closing_mps, dt_s)) << run;
        }
        found |= here << (group * GROUP);
    }
    Runs(found)
}

/// Takes in gap and time to collision.
#[inline(always)]
pub(super) fn note_approach(now: Pairs<'_>, min_gap_m: GroupsMut<'_>, min_ttc_s: GroupsMut<'_>) {
    let distances = now.front_m.iter().zip(now.front_length_m).zip(now.rear_m);
    let speeds = now.front_mps.iter().zip(now.rear_mps);
    let least = min_gap_m.iter_mut().zip(min_ttc_s);
    for ((min_gap_m, min_ttc_s), (((front_m, length_m), rear_m), (front_mps, rear_mps))) in
        least.zip(distances.zip(speeds))
    {
        for run in 0..GROUP {
            let gap_m = front_m[run] - length_m[run] - rear_m[run];
            let ttc_s = ttc_s(gap_m, rear_mps[run] - front_mps[run]);
            // By hand, since `f64::min` spends time on NaN, of which there is none here.
            min_gap_m[run] = if gap_m < min_gap_m[run] { gap_m } else { min_gap_m[run] };
            min_ttc_s[run] = if ttc_s < min_ttc_s[run] { ttc_s } else { min_ttc_s[run] };
        }
    }
}
