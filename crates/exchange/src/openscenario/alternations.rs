//! Accelerations that alternate, as those of rounded positions do.

use super::taut_path::{Point, slope};
use super::trajectory::{PathVertex, usual_step_s};

/// Rounding errors in a change of the acceleration, at most, each divided by the square of the time between vertices.
const ERRORS_IN_CHANGE: f64 = 8.0;
/// Errors of the calculation, and of times that are not equal, as a share.
const TOLERANCE: f64 = 0.05;
/// Share of the alternations that rounding must explain.
const LEAST_EXPLAINED: f64 = 0.9;
/// Number of vertices in which the acceleration increases, decreases and increases, or the reverse.
const MAX_VERTICES: usize = 8;
/// Number of vertices with the same acceleration. A speed that is constant for more segments after each step does not
/// alternate.
const MAX_EQUAL: usize = 4;
/// Number of vertices between changes that are successive.
const MAX_GAP: usize = 2;
/// Smallest change of an acceleration, in m/s².
const MIN_CHANGE_MPS2: f64 = 0.02;

/// Successive changes of the acceleration with the same sign.
#[derive(Debug, Clone, Copy)]
struct ChangeRun {
    change_mps2: f64,
    /// Indices of the first and the last change.
    first: usize,
    last: usize,
}

impl ChangeRun {
    /// Returns the middle one of three changes, by size; `None` if they do not alternate in few vertices.
    fn alternation_mps2(&self, before: &Self, after: &Self) -> Option<f64> {
        let is_opposite = before.change_mps2 * self.change_mps2 < 0.0
            && self.change_mps2 * after.change_mps2 < 0.0;
        let is_short = self.first - before.last <= MAX_EQUAL
            && after.first - self.last <= MAX_EQUAL
            && after.last - before.first < MAX_VERTICES;
        let [first, second, third] = [before, self, after].map(|run| run.change_mps2.abs());
        (is_opposite && is_short).then(|| first.min(second).max(first.max(second).min(third)))
    }
}

/// Places at which an acceleration alternates about its mean within few vertices.
pub(super) struct Alternations {
    /// Middle one of the three changes at each of them, by size, in m/s².
    changes_mps2: Vec<f64>,
    step_s: f64,
}

impl Alternations {
    pub(super) fn from_vertices(vertices: &[PathVertex]) -> Self {
        let runs = runs(&acceleration_changes_mps2(vertices));
        let changes_mps2 = runs.windows(3).filter_map(|three| match three {
            [before, run, after] => run.alternation_mps2(before, after),
            _ => None,
        });
        Self {
            changes_mps2: changes_mps2.collect(),
            step_s: usual_step_s(vertices).unwrap_or(0.0),
        }
    }

    pub(super) fn are_found(&self) -> bool {
        !self.changes_mps2.is_empty()
    }

    /// Returns true if rounding explains nearly all of them.
    pub(super) fn are_explained(&self, rounding_m: f64) -> bool {
        let limit_mps2 =
            (1.0 + TOLERANCE) * ERRORS_IN_CHANGE * rounding_m / (self.step_s * self.step_s);
        let changes = self.changes_mps2.iter();
        let explained = changes.filter(|change_mps2| **change_mps2 <= limit_mps2);
        explained.count() as f64 >= LEAST_EXPLAINED * self.changes_mps2.len() as f64
    }
}

/// Returns the changes of the acceleration from vertex to vertex.
fn acceleration_changes_mps2(vertices: &[PathVertex]) -> Vec<f64> {
    let points = vertices
        .iter()
        .map(|vertex| (vertex.time_s, vertex.position_m));
    let speeds = slopes(&points.collect::<Vec<Point>>());
    let rates = slopes(&speeds);
    let pairs = rates.iter().zip(rates.iter().skip(1));
    pairs.map(|(before, after)| after.1 - before.1).collect()
}

/// Returns the slopes between points, in the middle between their times.
fn slopes(points: &[Point]) -> Vec<Point> {
    let pairs = points.iter().zip(points.iter().skip(1));
    pairs
        .map(|(from, to)| (0.5 * (from.0 + to.0), slope(*from, *to)))
        .collect()
}

fn runs(changes_mps2: &[f64]) -> Vec<ChangeRun> {
    let mut runs: Vec<ChangeRun> = Vec::new();
    for (index, &change_mps2) in changes_mps2.iter().enumerate() {
        if change_mps2.abs() < MIN_CHANGE_MPS2 {
            continue;
        }
        let is_continued = |run: &&mut ChangeRun| run.change_mps2 * change_mps2 > 0.0;
        match runs.last_mut().filter(is_continued) {
            Some(run) if index - run.last <= MAX_GAP => {
                run.change_mps2 += change_mps2;
                run.last = index;
            }
            _ => runs.push(ChangeRun {
                change_mps2,
                first: index,
                last: index,
            }),
        }
    }
    runs
}
