//! Bisection towards the edges of plateaus.
//!
//! If no guard is crossed and no brake is triggered, many inputs have the same robustness: a plateau without slope. A
//! system that switches modes often has its smallest robustness just outside the edge of a plateau, where robustness
//! jumps. The slope outside the plateau seldom leads there. Bisecting a segment from a plateau point to a near outside
//! point finds the edge in a few evaluations.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};

use rand::RngExt;

use super::UnitCube;
use crumple_sim::random::Stream;

/// Maximum number of halvings of a segment, to 1/256 of its length.
const MAX_HALVINGS: u32 = 8;
/// Number of halvings after which a segment is dropped if the value beyond the edge is poor.
const PRUNING_HALVINGS: u32 = 4;
/// Number of outside points of which the nearest one is used.
const NEIGHBOUR_CANDIDATES: usize = 60;

/// Maximum number of points, to limit memory.
const MAX_POINTS: usize = 100_000;

/// Independent points with their values, grouped by shared values.
#[derive(Debug, Default)]
pub(super) struct Plateaus {
    points: Vec<(Vec<f64>, f64)>,
    first_by_value: HashMap<u64, usize>,
    /// Indices of points that share their value with others, and of all others, increasing.
    plateau_points: Vec<usize>,
    other_points: Vec<usize>,
    /// Used segments, from a point of `plateau_points` to one of `other_points`, which would yield the same edge again.
    used_segments: HashSet<(usize, usize)>,
    /// Values beyond the edge of all segments at the pruning check, increasing.
    edge_values: Vec<f64>,
}

#[derive(Debug, Clone)]
pub(super) struct Segment {
    plateau_value: f64,
    inside: Vec<f64>,
    outside: Vec<f64>,
    outside_value: f64,
    halvings: u32,
}

impl Plateaus {
    pub(super) fn add(&mut self, point: Vec<f64>, value: f64) {
        let index = self.points.len();
        if index == MAX_POINTS {
            return;
        }
        self.points.push((point, value));
        match self.first_by_value.entry(value.to_bits()) {
            Entry::Vacant(free) => {
                free.insert(index);
                self.other_points.push(index);
            }
            Entry::Occupied(first) => {
                // The first point of a value begins a plateau once the value occurs again.
                if let Ok(position) = self.other_points.binary_search(first.get()) {
                    self.other_points.remove(position);
                    let position = self
                        .plateau_points
                        .partition_point(|index| index < first.get());
                    self.plateau_points.insert(position, *first.get());
                }
                self.plateau_points.push(index);
            }
        }
    }

    /// Returns an unused segment from a plateau to a near point outside, if there is one.
    pub(super) fn next_segment(&mut self, cube: &UnitCube, random: &mut Stream) -> Option<Segment> {
        if self.plateau_points.is_empty() || self.other_points.is_empty() {
            return None;
        }
        let from = *self
            .plateau_points
            .get(random.random_range(0..self.plateau_points.len()))?;
        let (inside, plateau) = self.points.get(from)?;
        let (_, to, outside, outside_value) = (0..NEIGHBOUR_CANDIDATES)
            .filter_map(|_| {
                self.other_points
                    .get(random.random_range(0..self.other_points.len()))
                    .copied()
            })
            .filter(|to| !self.used_segments.contains(&(from, *to)))
            .filter_map(|to| {
                self.points
                    .get(to)
                    .map(|(point, value)| (cube.distance(inside, point), to, point, *value))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        self.used_segments.insert((from, to));
        Some(Segment {
            plateau_value: *plateau,
            inside: inside.clone(),
            outside: outside.clone(),
            outside_value,
            halvings: 0,
        })
    }

    /// Returns the half that contains the edge, given the value at the midpoint. `None` if it is short enough, or the
    /// value beyond the edge is worse than that of half of the segments so far.
    pub(super) fn halve(&mut self, segment: Segment, value: f64) -> Option<Segment> {
        let half = segment.halve(value)?;
        if half.halvings == PRUNING_HALVINGS {
            let better = self
                .edge_values
                .partition_point(|value| *value < half.outside_value);
            self.edge_values.insert(better, half.outside_value);
            if 2 * better > self.edge_values.len() {
                return None;
            }
        }
        Some(half)
    }
}

impl Segment {
    pub(super) fn midpoint(&self) -> Vec<f64> {
        self.inside
            .iter()
            .zip(&self.outside)
            .map(|(a, b)| 0.5 * (a + b))
            .collect()
    }

    fn halve(mut self, value: f64) -> Option<Self> {
        let middle = self.midpoint();
        if value == self.plateau_value {
            self.inside = middle;
        } else {
            (self.outside, self.outside_value) = (middle, value);
        }
        self.halvings += 1;
        (self.halvings < MAX_HALVINGS).then_some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::random::{Purpose, stream};

    #[test]
    fn no_segment_is_halved_twice() {
        let cube = UnitCube::new([1, 1]).unwrap();
        let mut plateaus = Plateaus::default();
        // Three points on a plateau and two outside give six segments.
        let points = [
            ([0.1, 0.1], 1.0),
            ([0.2, 0.9], 1.0),
            ([0.9, 0.2], 1.0),
            ([0.5, 0.5], 0.5),
            ([0.6, 0.8], 0.3),
        ];
        for (point, value) in points {
            plateaus.add(point.to_vec(), value);
        }
        let mut random = stream(3, Purpose::Search, 0);
        let segments: Vec<Segment> = (0..200)
            .filter_map(|_| plateaus.next_segment(&cube, &mut random))
            .collect();
        assert_eq!(segments.len(), 6);
        for (index, segment) in segments.iter().enumerate() {
            assert!(segments.iter().skip(index + 1).all(|later| (
                &segment.inside,
                &segment.outside
            ) != (
                &later.inside,
                &later.outside
            )));
        }
    }

    #[test]
    fn a_segment_with_a_bad_value_beyond_the_edge_is_dropped() {
        let mut plateaus = Plateaus::default();
        let mut halvings = |beyond: f64| {
            let (inside, outside) = (vec![0.0], vec![1.0]);
            let mut segment = Some(Segment {
                plateau_value: 1.0,
                inside,
                outside,
                outside_value: beyond,
                halvings: 0,
            });
            let mut halvings = 0;
            while let Some(current) = segment {
                let value = if current.midpoint() < vec![0.3] {
                    1.0
                } else {
                    beyond
                };
                segment = plateaus.halve(current, value);
                halvings += 1;
            }
            halvings
        };
        // The first segment has no comparison.
        assert_eq!(
            [0.5, 0.1, 0.9, 0.3, 0.9].map(&mut halvings),
            [8, 8, 4, 8, 4]
        );
    }
}
