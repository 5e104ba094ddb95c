//! The edges of plateaus.
//!
//! Where nothing reacts (no guard is crossed, no brake is triggered) many different inputs have the very same robustness:
//! a plateau, on which no method sees a slope. A system with modes is often at its worst just beyond, where something is
//! barely triggered, late or half-way; and since robustness jumps there, the slope outside seldom leads to it. Halving the
//! segment from a point on a plateau to a near one outside finds the edge in a few evaluations.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use rand::RngExt;

use super::Cube;
use crumple_world::random::Stream;

/// Halvings of a segment: to half a hundredth of the way.
const HALVINGS: u32 = 8;
/// Points outside among which the nearest one is taken.
const NEAREST_OF: usize = 60;

/// Points kept: in a long search, later ones would only cost memory.
const MOST_POINTS: usize = 100_000;

/// Independent points with their values, by whether others have the same value.
#[derive(Debug, Default)]
pub(super) struct Plateaus {
    points: Vec<(Vec<f64>, f64)>,
    /// For each value, the first point that has it.
    first_with: HashMap<u64, usize>,
    /// Points that share their value with others, and all others: indices, increasing.
    flat: Vec<usize>,
    rest: Vec<usize>,
}

/// The search along one segment.
#[derive(Debug, Clone)]
pub(super) struct Segment {
    plateau: f64,
    inside: Vec<f64>,
    outside: Vec<f64>,
    halvings: u32,
}

impl Plateaus {
    pub(super) fn add(&mut self, point: Vec<f64>, value: f64) {
        let index = self.points.len();
        if index == MOST_POINTS {
            return;
        }
        self.points.push((point, value));
        match self.first_with.entry(value.to_bits()) {
            Entry::Vacant(free) => {
                free.insert(index);
                self.rest.push(index);
            }
            Entry::Occupied(first) => {
                if let Ok(place) = self.rest.binary_search(first.get()) {
                    self.rest.remove(place);
                    let place = self.flat.partition_point(|known| known < first.get());
                    self.flat.insert(place, *first.get());
                }
                self.flat.push(index);
            }
        }
    }

    /// A segment from a plateau to a near point outside, if there are both.
    pub(super) fn segment(&self, cube: &Cube, random: &mut Stream) -> Option<Segment> {
        if self.flat.is_empty() || self.rest.is_empty() {
            return None;
        }
        let (inside, plateau) = self.points.get(*self.flat.get(random.random_range(0..self.flat.len()))?)?;
        let near = (0..NEAREST_OF)
            .filter_map(|_| self.points.get(*self.rest.get(random.random_range(0..self.rest.len()))?))
            .map(|(point, _)| (cube.distance(inside, point), point))
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Segment { plateau: *plateau, inside: inside.clone(), outside: near.1.clone(), halvings: 0 })
    }
}

impl Segment {
    /// The point half-way.
    pub(super) fn middle(&self) -> Vec<f64> {
        self.inside.iter().zip(&self.outside).map(|(a, b)| 0.5 * (a + b)).collect()
    }

    /// The half that holds the edge, unless it is short enough.
    pub(super) fn halved(mut self, value: f64) -> Option<Self> {
        let middle = self.middle();
        if value == self.plateau {
            self.inside = middle;
        } else {
            self.outside = middle;
        }
        self.halvings += 1;
        (self.halvings < HALVINGS).then_some(self)
    }
}
