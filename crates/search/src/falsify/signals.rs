//! Mixed-resolution signal search: simple inputs, and climbs from the best of them.

use rand::RngExt;

use super::climb::{Climbs, Move};
use super::method::rankable;
use super::shape::simple_point;
use super::{Cube, Search};
use crumple_world::random::{Purpose, Stream, stream};

const BATCH: usize = 8;
/// Simple points before the first climb.
const FIRST_POINTS: usize = 24;
/// Share of simple points after that.
const SIMPLE: f64 = 0.5;

/// Signals of few pieces that switch anywhere, often between their extremes, changed piece by piece.
#[derive(Debug)]
pub(super) struct Signals {
    cube: Cube,
    random: Stream,
    climbs: Climbs,
    starts: usize,
    asked: Vec<Asked>,
}

#[derive(Debug)]
enum Asked {
    Start(Vec<f64>),
    Move(Move),
}

impl Signals {
    pub(super) fn new(cube: &Cube, seed: u64) -> Self {
        let random = stream(seed, Purpose::Search, 0);
        Self { cube: cube.clone(), random, climbs: Climbs::default(), starts: 0, asked: Vec::new() }
    }

    fn next(&mut self) -> Asked {
        if self.starts >= FIRST_POINTS
            && !self.random.random_bool(SIMPLE)
            && let Some(proposal) = self.climbs.next(&self.cube, &mut self.random)
        {
            return Asked::Move(proposal);
        }
        self.starts += 1;
        Asked::Start(simple_point(&self.cube, &mut self.random))
    }
}

impl Search for Signals {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.climbs.rank();
        self.asked = (0..BATCH).map(|_| self.next()).collect();
        let point = |asked: &Asked| match asked {
            Asked::Start(point) => point.clone(),
            Asked::Move(proposal) => proposal.point.clone(),
        };
        self.asked.iter().map(point).collect()
    }

    fn tell(&mut self, robustness: &[f64]) {
        let asked = std::mem::take(&mut self.asked);
        for (asked, value) in asked.into_iter().zip(robustness.iter().map(|&value| rankable(value))) {
            match asked {
                Asked::Start(point) => self.climbs.start(point, value),
                Asked::Move(proposal) => self.climbs.tell(proposal, value),
            }
        }
    }
}
