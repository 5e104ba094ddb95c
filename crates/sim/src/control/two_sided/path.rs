//! Motions in pieces of constant acceleration, and the smallest distance between two of them.
//!
//! The distance between two such motions is piecewise quadratic, so its minimum is at an end or at the vertex of a
//! piece. Nothing is sampled.

use crate::control::{MotionSample, distance_and_speed_after, min_quadratic};

/// Position and speed at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct PathPoint {
    pub(super) time_s: f64,
    pub(super) position_m: f64,
    /// Not negative.
    pub(super) speed_mps: f64,
}

impl From<PathPoint> for MotionSample {
    fn from(instant: PathPoint) -> Self {
        Self {
            position_m: instant.position_m,
            speed_mps: instant.speed_mps,
        }
    }
}

/// A piece of a motion: constant acceleration until the next piece begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    start: PathPoint,
    acceleration_mps2: f64,
}

impl Piece {
    fn at(&self, time_s: f64) -> PathPoint {
        let dt_s = time_s - self.start.time_s;
        let half_mps = 0.5 * self.acceleration_mps2 * dt_s;
        PathPoint {
            time_s,
            position_m: self.start.position_m + (self.start.speed_mps + half_mps) * dt_s,
            speed_mps: (self.start.speed_mps + self.acceleration_mps2 * dt_s).max(0.0),
        }
    }
}

/// A motion from an instant on. Speeds are never negative, and the last piece has no end.
#[derive(Debug, Clone, Default)]
pub(super) struct Path {
    pieces: Vec<Piece>,
    /// End of the last piece that has one.
    end: PathPoint,
}

impl Path {
    /// Begins a new motion, and forgets the one before.
    pub(super) fn restart(&mut self, start: PathPoint) {
        self.pieces.clear();
        self.end = start;
    }

    pub(super) fn end(&self) -> PathPoint {
        self.end
    }

    /// Changes the speed by `change_mps` at once; the speed does not become negative.
    pub(super) fn jump(&mut self, change_mps: f64) {
        self.end.speed_mps = (self.end.speed_mps + change_mps).max(0.0);
    }

    fn push(&mut self, acceleration_mps2: f64) {
        self.pieces.push(Piece {
            start: self.end,
            acceleration_mps2,
        });
    }

    /// Appends `duration_s` of an acceleration. A vehicle that stops stays at rest.
    pub(super) fn run(&mut self, acceleration_mps2: f64, duration_s: f64) {
        self.run_until(acceleration_mps2, self.end.time_s + duration_s);
    }

    /// Appends an acceleration until an instant. A vehicle that stops stays at rest.
    pub(super) fn run_until(&mut self, acceleration_mps2: f64, until_s: f64) {
        let duration_s = until_s - self.end.time_s;
        if duration_s <= 0.0 {
            return;
        }
        let stop_s = self.stop_time_s(acceleration_mps2);
        if stop_s < until_s {
            self.stop(acceleration_mps2, stop_s);
            self.push(0.0);
        } else {
            self.push(acceleration_mps2);
            let [covered_m, speed_mps] =
                distance_and_speed_after(self.end.speed_mps, acceleration_mps2, duration_s);
            self.end.position_m += covered_m;
            self.end.speed_mps = speed_mps;
        }
        self.end.time_s = until_s;
    }

    /// Appends an acceleration for ever. A vehicle that stops stays at rest.
    pub(super) fn finish(&mut self, acceleration_mps2: f64) {
        let stop_s = self.stop_time_s(acceleration_mps2);
        if stop_s < f64::INFINITY {
            self.stop(acceleration_mps2, stop_s);
            self.push(0.0);
        } else {
            self.push(acceleration_mps2);
        }
    }

    /// Returns the time at which a vehicle with this acceleration stops, in seconds; infinite if it does not.
    fn stop_time_s(&self, acceleration_mps2: f64) -> f64 {
        if acceleration_mps2 < 0.0 {
            self.end.time_s + self.end.speed_mps / -acceleration_mps2
        } else {
            f64::INFINITY
        }
    }

    /// Appends braking to standstill.
    fn stop(&mut self, acceleration_mps2: f64, stop_s: f64) {
        if self.end.speed_mps > 0.0 {
            self.push(acceleration_mps2);
        }
        self.end = PathPoint {
            time_s: stop_s,
            position_m: self.end.position_m
                + self.end.speed_mps * self.end.speed_mps / (-2.0 * acceleration_mps2),
            speed_mps: 0.0,
        };
    }

    /// Returns the number of the piece at an instant.
    fn index_at(&self, time_s: f64) -> usize {
        self.pieces
            .partition_point(|piece| piece.start.time_s <= time_s)
            .saturating_sub(1)
    }

    /// Returns position and speed at an instant.
    pub(super) fn at(&self, time_s: f64) -> PathPoint {
        self.pieces
            .get(self.index_at(time_s))
            .map_or(self.end, |piece| piece.at(time_s))
    }

    /// True if the vehicle stands from an instant on.
    pub(super) fn stands_from(&self, time_s: f64) -> bool {
        self.pieces.last().is_some_and(|last| {
            last.start.time_s <= time_s
                && last.start.speed_mps == 0.0
                && last.acceleration_mps2 == 0.0
        })
    }
}

/// Returns the minimum of the distance between two motions over an interval, in metres. Its end may be infinite.
pub(super) fn min_distance_m(front: &Path, rear: &Path, [from_s, to_s]: [f64; 2]) -> f64 {
    let mut indices = [front.index_at(from_s), rear.index_at(from_s)];
    let mut time_s = from_s;
    let mut min_m = f64::INFINITY;
    loop {
        let (Some(ahead), Some(behind)) =
            (front.pieces.get(indices[0]), rear.pieces.get(indices[1]))
        else {
            return f64::NEG_INFINITY;
        };
        let ends_s = [(front, indices[0]), (rear, indices[1])].map(piece_end_s);
        let end_s = ends_s[0].min(ends_s[1]).min(to_s);
        min_m = min_m.min(min_in_pieces_m(ahead, behind, [time_s, end_s]));
        if end_s >= to_s {
            return min_m;
        }
        time_s = end_s;
        for (index, own_end_s) in indices.iter_mut().zip(ends_s) {
            *index += usize::from(own_end_s <= end_s);
        }
    }
}

fn piece_end_s((path, index): (&Path, usize)) -> f64 {
    path.pieces
        .get(index + 1)
        .map_or(f64::INFINITY, |next| next.start.time_s)
}

/// Returns the minimum of the distance between two pieces, in metres; infinitely negative if they close in for ever.
fn min_in_pieces_m(front: &Piece, rear: &Piece, [from_s, to_s]: [f64; 2]) -> f64 {
    let ahead = front.at(from_s);
    let behind = rear.at(from_s);
    let gap_m = ahead.position_m - behind.position_m;
    let rate_mps = ahead.speed_mps - behind.speed_mps;
    let second_mps2 = front.acceleration_mps2 - rear.acceleration_mps2;
    if to_s < f64::INFINITY {
        return min_quadratic(gap_m, rate_mps, second_mps2, to_s - from_s);
    }
    if rate_mps < 0.0 && second_mps2 > 0.0 {
        gap_m - 0.5 * rate_mps * rate_mps / second_mps2
    } else if rate_mps < 0.0 || second_mps2 < 0.0 {
        f64::NEG_INFINITY
    } else {
        gap_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn path(position_m: f64, speed_mps: f64, pieces: &[(f64, f64)]) -> Path {
        let mut path = Path::default();
        path.restart(PathPoint {
            time_s: 0.0,
            position_m,
            speed_mps,
        });
        for &(acceleration_mps2, duration_s) in pieces {
            path.run(acceleration_mps2, duration_s);
        }
        path.finish(-5.0);
        path
    }

    fn any_path(position_m: f64) -> impl Strategy<Value = Path> {
        let pieces = prop::collection::vec((-9.0..3.0_f64, 0.0..3.0_f64), 0..4);
        (prop_oneof![0.0..30.0_f64, Just(0.0)], pieces)
            .prop_map(move |(speed_mps, pieces)| path(position_m, speed_mps, &pieces))
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(512))]

        #[test]
        fn the_minimum_is_that_of_fine_samples(front in any_path(20.0), rear in any_path(0.0), from_s in 0.0..4.0_f64) {
            let minimum_m = min_distance_m(&front, &rear, [from_s, f64::INFINITY]);
            let at_m = |t: f64| front.at(t).position_m - rear.at(t).position_m;
            let sampled_m = (0..=8000).map(|k| at_m(from_s + f64::from(k) * 0.005)).fold(f64::INFINITY, f64::min);
            prop_assert!(minimum_m <= sampled_m + 1e-9, "{minimum_m} {sampled_m}");
            prop_assert!(minimum_m >= sampled_m - 12.0 * 0.005_f64.powi(2), "{minimum_m} {sampled_m}");
        }

        #[test]
        fn positions_follow_from_speeds(path in any_path(0.0), t in 0.0..15.0_f64) {
            let [now, later] = [path.at(t), path.at(t + 1e-5)];
            prop_assert!(((later.position_m - now.position_m) / 1e-5 - now.speed_mps).abs() < 1e-2);
        }
    }
}
