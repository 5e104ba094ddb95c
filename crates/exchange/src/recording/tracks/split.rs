//! Division of the rows of a vehicle id into tracks, and their direction of travel.

use super::TrackPoint;

/// Longest time without a row within a track, in milliseconds; after it, the id belongs to another vehicle.
const MAX_ABSENCE_MS: i64 = 300_000;
/// Largest error of a position that is no jump, in metres.
const POSITION_ERROR_M: f64 = 3.0;
/// Coefficient of t² in the distance error at mean speed, in m/s², for braking at 8 m/s² and then accelerating as hard.
const SPEED_CHANGE_MPS2: f64 = 2.0;
/// Largest speed of a vehicle, in m/s.
const MAX_SPEED_MPS: f64 = 100.0;
/// Movement that shows a direction, in metres; noise of standing vehicles is smaller.
const MIN_MOVEMENT_M: f64 = 2.0;

/// Movement between two rows with known positions.
#[derive(Debug, Clone, Copy)]
struct Movement {
    /// Index of the later row.
    to: usize,
    moved_m: f64,
    /// Distance by the recorded speeds, if known.
    driven_m: Option<f64>,
    seconds: f64,
    changes_lane: bool,
}

impl Movement {
    /// Returns whether the movement, forwards if positive, fits the recorded speeds.
    fn is_plausible(&self, moved_m: f64) -> bool {
        let slack_m = POSITION_ERROR_M + SPEED_CHANGE_MPS2 * self.seconds * self.seconds;
        let [low_m, high_m] = match self.driven_m {
            Some(driven_m) => [
                (driven_m - slack_m).max(-POSITION_ERROR_M),
                driven_m + slack_m,
            ],
            None => [
                -POSITION_ERROR_M,
                MAX_SPEED_MPS * self.seconds + POSITION_ERROR_M,
            ],
        };
        (low_m..=high_m).contains(&moved_m)
    }
}

/// Numbers of movements of 2 m towards larger and smaller positions.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct DirectionVotes {
    pub(super) up: usize,
    pub(super) down: usize,
}

impl DirectionVotes {
    /// Returns whether positions decrease; `None` without a clear majority.
    pub(super) fn decreases(self) -> Option<bool> {
        match self {
            Self { up, down } if up > 2 * down => Some(false),
            Self { up, down } if down > 2 * up => Some(true),
            _ => None,
        }
    }

    /// Returns whether positions decrease in most movements; `None` for equally many.
    pub(super) fn majority_decreases(self) -> Option<bool> {
        (self.up != self.down).then_some(self.down > self.up)
    }

    pub(super) fn add(&mut self, other: Self) {
        self.up += other.up;
        self.down += other.down;
    }
}

/// Numbers the tracks of points that are sorted by vehicle and time. Returns the first point of the first track that
/// begins within a vehicle's rows, and the number of such tracks.
pub(super) fn split(points: &mut [TrackPoint], speeds_agree: bool) -> Option<(TrackPoint, usize)> {
    let mut track = 0;
    let mut splits = None;
    for vehicle in points.chunk_by_mut(|a, b| a.vehicle == b.vehicle) {
        let movements = movements(vehicle, speeds_agree);
        let mut starts = visible_starts(vehicle, &movements);
        let mut backward_jumps = backward_jumps(vehicle, &movements, &starts);
        starts.append(&mut backward_jumps);
        starts.sort_unstable();
        for &start in &starts {
            if let Some(point) = vehicle.get(start).filter(|point| !point.is_margin) {
                splits.get_or_insert((*point, 0)).1 += 1;
            }
        }
        let mut next = starts.into_iter().peekable();
        for (index, point) in vehicle.iter_mut().enumerate() {
            if next.next_if_eq(&index).is_some() {
                track += 1;
            }
            point.track = track;
        }
        track += 1;
    }
    splits
}

/// Returns the first row of each track after a jump or a long absence of a vehicle.
fn visible_starts(vehicle: &[TrackPoint], movements: &[Movement]) -> Vec<usize> {
    let jumps = movements
        .iter()
        .filter(|movement| !movement.is_plausible(movement.moved_m.abs()));
    let mut starts: Vec<usize> = jumps.map(|movement| movement.to).collect();
    let long_absences = vehicle
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| match pair {
            [a, b] => b.time_ms - a.time_ms > MAX_ABSENCE_MS,
            _ => false,
        });
    starts.extend(long_absences.map(|(index, _)| index + 1));
    starts.sort_unstable();
    starts.dedup();
    starts
}

/// Returns the rows behind backward jumps that are shorter than the distance driven, such as on short edges, between
/// the starts of tracks.
fn backward_jumps(vehicle: &[TrackPoint], movements: &[Movement], starts: &[usize]) -> Vec<usize> {
    let mut jumps = Vec::new();
    let bounds = [0].into_iter().chain(starts.iter().copied());
    for (from, to) in bounds.zip(starts.iter().copied().chain([vehicle.len()])) {
        let piece = movements
            .iter()
            .filter(|movement| movement.to > from && movement.to < to);
        let Some(decreases) = votes(piece.clone()).decreases() else {
            continue;
        };
        let forwards = if decreases { -1.0 } else { 1.0 };
        let backwards =
            piece.filter(|movement| !movement.is_plausible(forwards * movement.moved_m));
        jumps.extend(backwards.map(|movement| movement.to));
    }
    jumps
}

/// Returns the votes of a track, with the current lane of each row.
pub(super) fn track_votes(track: &[TrackPoint], speeds_agree: bool) -> DirectionVotes {
    votes(movements(track, speeds_agree).iter())
}

fn movements(rows: &[TrackPoint], speeds_agree: bool) -> Vec<Movement> {
    let mut positions = rows
        .iter()
        .enumerate()
        .filter_map(|(index, row)| Some((index, row, row.position_m?)));
    let Some((_, mut from, mut from_m)) = positions.next() else {
        return Vec::new();
    };
    positions
        .map(|(to, row, to_m)| {
            let seconds = (row.time_ms - from.time_ms) as f64 / 1000.0;
            let speeds = from.speed_mps.zip(row.speed_mps).filter(|_| speeds_agree);
            let driven_m = speeds.map(|(a, b)| 0.5 * (a.abs() + b.abs()) * seconds);
            let changes_lane = from.lane != row.lane;
            let movement = Movement {
                to,
                moved_m: to_m - from_m,
                driven_m,
                seconds,
                changes_lane,
            };
            from = row;
            from_m = to_m;
            movement
        })
        .collect()
}

/// Counts movements of 2 m within one lane that fit the speeds.
fn votes<'m>(movements: impl Iterator<Item = &'m Movement>) -> DirectionVotes {
    let mut votes = DirectionVotes::default();
    let none = Movement {
        to: 0,
        moved_m: 0.0,
        driven_m: Some(0.0),
        seconds: 0.0,
        changes_lane: false,
    };
    let mut since = none;
    for movement in movements {
        if movement.changes_lane {
            since = none;
            continue;
        }
        since.moved_m += movement.moved_m;
        since.driven_m = since.driven_m.zip(movement.driven_m).map(|(a, b)| a + b);
        since.seconds += movement.seconds;
        if since.moved_m.abs() >= MIN_MOVEMENT_M {
            let is_real = since.is_plausible(since.moved_m.abs())
                && movement.is_plausible(movement.moved_m.abs());
            if is_real {
                *(if since.moved_m > 0.0 {
                    &mut votes.up
                } else {
                    &mut votes.down
                }) += 1;
            }
            since = none;
        }
    }
    votes
}
