//! Speed profiles with few knots. A knot is a speed, not an acceleration, so that a change of one knot keeps the speeds
//! at all others.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::plant::{Plant, Profile};
use crumple_sim::random::Stream;

/// Times of the first speed change of a simple shape, in seconds.
const ONSETS_S: [f64; 5] = [0.0, 0.5, 1.0, 2.0, 4.0];
/// Braking of this change, as shares of the hardest braking.
const BRAKE_SHARES: [f64; 6] = [1.0, 0.8, 0.6, 0.45, 0.3, 0.15];
/// Speeds after this change, as shares of the initial speed.
const SPEED_SHARES: [f64; 8] = [0.0, 0.08, 0.15, 0.25, 0.4, 0.55, 0.7, 0.85];
/// Speeds at the end of the scenario, as shares of that speed; negative means standstill at half the time.
const FINAL_SPEED_SHARES: [f64; 4] = [1.0, 0.5, 0.0, -1.0];
/// Higher speeds reached by accelerating, as shares of the initial speed.
const HIGHER_SPEED_SHARES: [f64; 3] = [1.05, 1.15, 1.3];
/// Two brakings with an acceleration in between: speeds after the first, added speeds, shares of the last braking.
const INTERMEDIATE_SPEED_SHARES: [f64; 4] = [0.75, 0.5, 0.25, 0.1];
const ADDED_SPEED_SHARES: [f64; 2] = [0.1, 0.25];
const FINAL_BRAKE_SHARES: [f64; 3] = [1.0, 0.5, 0.1];
const MAX_KNOTS: usize = 12;

/// Knots of each vehicle under test: time in seconds and speed in m/s, with linear interpolation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SpeedShape(Vec<Vec<(f64, f64)>>);

/// Returns brakings to a lower speed, accelerations, and two brakings with an acceleration in between.
pub(super) fn simple_shapes(plant: &Plant<'_>) -> Vec<SpeedShape> {
    let mut all = vec![vec![]];
    for begins_s in ONSETS_S {
        add_brakings(&mut all, begins_s, plant.duration_s());
        add_accelerations(&mut all, begins_s);
    }
    add_double_brakings(&mut all);
    all.into_iter()
        .map(|segments| SpeedShape::new(plant, &segments))
        .collect()
}

/// Adds brakings to a lower speed, each followed by a linear change of the speed.
fn add_brakings(shapes: &mut Vec<Vec<ShapeSegment>>, begins_s: f64, duration_s: f64) {
    for brake_share in BRAKE_SHARES {
        for speed_share in SPEED_SHARES {
            let final_shares = match speed_share {
                0.0 => &FINAL_SPEED_SHARES[..1],
                _ => &FINAL_SPEED_SHARES[..],
            };
            for &final_share in final_shares {
                let last = if final_share < 0.0 {
                    ShapeSegment::Reach {
                        until_s: 0.5 * duration_s,
                        to: 0.0,
                    }
                } else {
                    ShapeSegment::Reach {
                        until_s: duration_s,
                        to: final_share * speed_share,
                    }
                };
                shapes.push(vec![
                    ShapeSegment::Hold { until_s: begins_s },
                    ShapeSegment::Change {
                        to: speed_share,
                        share: brake_share,
                    },
                    last,
                ]);
            }
        }
    }
}

fn add_accelerations(shapes: &mut Vec<Vec<ShapeSegment>>, begins_s: f64) {
    for speed_share in HIGHER_SPEED_SHARES {
        shapes.push(vec![
            ShapeSegment::Hold { until_s: begins_s },
            ShapeSegment::Change {
                to: speed_share,
                share: 1.0,
            },
        ]);
    }
}

/// Adds pairs of brakings, the second to standstill, with an acceleration in between.
fn add_double_brakings(shapes: &mut Vec<Vec<ShapeSegment>>) {
    for (slow, added) in INTERMEDIATE_SPEED_SHARES
        .into_iter()
        .flat_map(|slow| ADDED_SPEED_SHARES.map(|added| (slow, added)))
    {
        for (first, last) in BRAKE_SHARES
            .into_iter()
            .take(4)
            .flat_map(|first| FINAL_BRAKE_SHARES.map(|last| (first, last)))
        {
            let segments = [(slow, first), (slow + added, 1.0), (0.0, last)]
                .map(|(to, share)| ShapeSegment::Change { to, share });
            shapes.push(segments.into());
        }
    }
}

/// A segment of a simple shape. Speeds are shares of the initial speed.
#[derive(Debug, Clone, Copy)]
enum ShapeSegment {
    Hold {
        until_s: f64,
    },
    /// Changes the speed with a share of the hardest braking or the largest acceleration.
    Change {
        to: f64,
        share: f64,
    },
    /// Changes the speed linearly until a time.
    Reach {
        until_s: f64,
        to: f64,
    },
}

impl SpeedShape {
    fn new(plant: &Plant<'_>, segments: &[ShapeSegment]) -> Self {
        Self(
            (0..plant.ego_count())
                .map(|ego| ego_knots(plant, ego, segments))
                .collect(),
        )
    }

    /// Returns the acceleration in each cell that follows the knots within the limits.
    pub(super) fn profile(&self, plant: &Plant<'_>) -> Profile {
        self.0
            .iter()
            .enumerate()
            .map(|(ego, knots)| follow_knots(plant, ego, knots))
            .collect()
    }

    pub(super) fn mutate(&self, plant: &Plant<'_>, stream: &mut Stream) -> Self {
        let mut changed = self.clone();
        for _ in 0..stream.random_range(1..=3) {
            let ego = stream.random_range(0..plant.ego_count().max(1));
            if let Some(knots) = changed.0.get_mut(ego) {
                mutate_knots(knots, plant.duration_s(), stream);
            }
        }
        changed
    }
}

/// Returns the knots of one vehicle under test: time in seconds and speed in m/s.
fn ego_knots(plant: &Plant<'_>, ego: usize, segments: &[ShapeSegment]) -> Vec<(f64, f64)> {
    let [low, high] = plant.limits_mps2(ego);
    let first_mps = plant.initial_speed_mps(ego);
    let mut knots = vec![(0.0, first_mps)];
    let mut now_s = 0.0_f64;
    let mut speed_mps = first_mps;
    for segment in segments {
        match *segment {
            ShapeSegment::Hold { until_s } => now_s = now_s.max(until_s),
            ShapeSegment::Change { to, share } => {
                let to_mps = to * first_mps;
                let most_mps2 = share * if to_mps < speed_mps { -low } else { high };
                now_s += (to_mps - speed_mps).abs() / most_mps2.max(1e-3);
                speed_mps = to_mps;
            }
            ShapeSegment::Reach { until_s, to } => {
                now_s = now_s.max(until_s);
                speed_mps = to * first_mps;
            }
        }
        knots.push((now_s, speed_mps));
    }
    knots
}

/// Returns the acceleration of one vehicle under test in each cell, in m/s².
fn follow_knots(plant: &Plant<'_>, ego: usize, knots: &[(f64, f64)]) -> Vec<f64> {
    let [low, high] = plant.limits_mps2(ego);
    let cell_s = plant.cell_s();
    let mut speed_mps = plant.initial_speed_mps(ego);
    (0..plant.cell_count())
        .map(|cell| {
            let accel_mps2 = if cell < plant.dead_cells(ego) {
                0.0
            } else {
                let target_mps = speed_at(knots, (cell + 1) as f64 * cell_s);
                ((target_mps - speed_mps) / cell_s).clamp(low, high)
            };
            speed_mps += accel_mps2 * cell_s;
            accel_mps2
        })
        .collect()
}

/// Returns the interpolated speed at a time, in m/s; constant after the last knot.
fn speed_at(knots: &[(f64, f64)], time_s: f64) -> f64 {
    let after = knots.partition_point(|(knot_s, _)| *knot_s <= time_s);
    match (
        after.checked_sub(1).and_then(|before| knots.get(before)),
        knots.get(after),
    ) {
        (Some((from_s, from_mps)), Some((to_s, to_mps))) => {
            from_mps + (to_mps - from_mps) * (time_s - from_s) / (to_s - from_s)
        }
        (Some((_, speed_mps)), None) | (None, Some((_, speed_mps))) => *speed_mps,
        (None, None) => 0.0,
    }
}

fn mutate_knots(knots: &mut Vec<(f64, f64)>, duration_s: f64, stream: &mut Stream) {
    let normal: f64 = StandardNormal.sample(stream);
    // Small changes are as frequent as large ones.
    let by = 10.0_f64.powf(stream.random_range(-2.0..0.8)) * normal;
    let at = stream.random_range(0..knots.len().max(1));
    match stream.random_range(0..8) {
        0..=2 => knots
            .iter_mut()
            .skip(at)
            .take(1)
            .for_each(|(_, mps)| *mps = (*mps + by).max(0.0)),
        3 => knots
            .iter_mut()
            .skip(at)
            .take(1)
            .for_each(|(from_s, _)| *from_s = (*from_s + 0.5 * by).clamp(0.0, duration_s)),
        4 => knots
            .iter_mut()
            .skip(at)
            .for_each(|(from_s, _)| *from_s = (*from_s + 0.5 * by).clamp(0.0, duration_s)),
        5 => knots
            .iter_mut()
            .skip(at)
            .for_each(|(_, mps)| *mps = (*mps + by).max(0.0)),
        6 if knots.len() > 2 => drop(knots.remove(at)),
        _ if knots.len() < MAX_KNOTS => {
            // Early times are more frequent.
            let from_s = duration_s * stream.random::<f64>().powi(2);
            let speed_mps = (speed_at(knots, from_s) + by).max(0.0);
            knots.push((from_s, speed_mps));
        }
        _ => {}
    }
    knots.sort_by(|a, b| a.0.total_cmp(&b.0));
}
