//! Traces for tests of the measures.

use crumple_sim::engine::{Collision, Impact, Trace, Track};

/// Creates a track that holds each acceleration for its time, in steps that divide those times, and never reverses.
pub(super) fn driven_track(
    length_m: f64,
    position_m: f64,
    speed_mps: f64,
    pieces: &[(f64, f64)],
    step_s: f64,
) -> Track {
    let mut x = position_m;
    let mut v = speed_mps;
    let mut position_m = vec![x];
    let mut speed_mps = vec![v];
    let mut acceleration_mps2 = Vec::new();
    for &(duration_s, a) in pieces {
        for _ in 0..(duration_s / step_s).round() as usize {
            let moving_s = if a < 0.0 { step_s.min(v / -a) } else { step_s };
            acceleration_mps2.push(if moving_s > 0.0 { a } else { 0.0 });
            x += v * moving_s + 0.5 * a * moving_s * moving_s;
            v = if moving_s < step_s {
                0.0
            } else {
                v + a * step_s
            };
            position_m.push(x);
            speed_mps.push(v);
        }
    }
    acceleration_mps2.push(acceleration_mps2.last().copied().unwrap_or(0.0));
    Track {
        length_m,
        mass_kg: 1500.0,
        position_m,
        speed_mps,
        acceleration_mps2,
        in_lane_s: Track::THROUGHOUT_S,
    }
}

pub(super) fn trace(vehicles: Vec<Track>, step_s: f64) -> Trace {
    let samples = vehicles.first().map_or(0, |track| track.position_m.len());
    Trace {
        time_s: (0..samples).map(|k| k as f64 * step_s).collect(),
        vehicles,
    }
}

/// Creates a trace of a vehicle 2 m long and its follower, each with an initial speed and pieces as in
/// [`driven_track`].
pub(super) fn pair_trace(gap_m: f64, vehicles: [(f64, &[(f64, f64)]); 2], step_s: f64) -> Trace {
    let [(front_mps, front), (rear_mps, rear)] = vehicles;
    let front = driven_track(2.0, gap_m + 2.0, front_mps, front, step_s);
    trace(
        vec![front, driven_track(2.0, 0.0, rear_mps, rear, step_s)],
        step_s,
    )
}

/// Creates an impact of vehicle `front` with its follower; both have equal mass.
pub(super) fn impact(
    time_s: f64,
    front: usize,
    front_speed_mps: f64,
    rear_speed_mps: f64,
) -> Impact {
    let collision = Collision {
        time_s,
        front_vehicle: front,
        rear_vehicle: front + 1,
        front_speed_mps,
        rear_speed_mps,
        impact_speed_mps: rear_speed_mps - front_speed_mps,
    };
    Impact {
        collision,
        common_speed_mps: 0.5 * (front_speed_mps + rear_speed_mps),
        beside: Vec::new(),
        first_involved: front,
        last_involved: front + 1,
    }
}
