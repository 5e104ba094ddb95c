//! Mixed-resolution signal search: simple inputs, and climbs from the best of them.

use rand::RngExt;

use super::climb::{Climbs, Move};
use super::method::rankable;
use super::simple_points::sample_simple_point;
use super::{UnitCube, Search};
use crumple_world::random::{Purpose, Stream, stream};

const BATCH_SIZE: usize = 8;
/// Simple points before the first climb.
const INITIAL_POINTS: usize = 24;
/// Share of simple points after that.
const SIMPLE_SHARE: f64 = 0.5;

/// Signals of few pieces that switch anywhere, often between their extremes, changed piece by piece.
#[derive(Debug)]
pub(super) struct SignalSearch {
    cube: UnitCube,
    random: Stream,
    climbs: Climbs,
    start_count: usize,
    pending: Vec<SignalProposal>,
}

#[derive(Debug)]
enum SignalProposal {
    Start(Vec<f64>),
    Move(Move),
}

impl SignalSearch {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        let random = stream(seed, Purpose::Search, 0);
        Self { cube: cube.clone(), random, climbs: Climbs::default(), starts: 0, asked: Vec::new() }
    }

    fn propose(&mut self) -> SignalProposal {
        if self.starts >= FIRST_POINTS
            && !self.random.random_bool(SIMPLE_SHARE)
            && let Some(proposal) = self.climbs.next(&self.cube, &mut self.random)
        {
            return SignalProposal::Move(proposal);
        }
        self.starts += 1;
        SignalProposal::Start(sample_simple_point(&self.cube, &mut self.random))
    }
}

impl Search for SignalSearch {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.climbs.rank();
        self.asked = (0..BATCH).map(|_| self.next()).collect();
        let point = |asked: &SignalProposal| match asked {
            SignalProposal::Start(point) => point.clone(),
            SignalProposal::Move(proposal) => proposal.point.clone(),
        };
        self.asked.iter().map(point).collect()
    }

    fn tell(&mut self, robustness: &[f64]) {
        let asked = std::mem::take(&mut self.asked);
        for (asked, value) in asked.into_iter().zip(robustness.iter().map(|&value| rankable(value))) {
            match asked {
                SignalProposal::Start(point) => self.climbs.start(point, value),
                SignalProposal::Move(proposal) => self.climbs.tell(proposal, value),
            }
        }
    }
}
