//! Mixed-resolution signal search: simple inputs, and climbs from the best of them.

use rand::RngExt;

use super::climb::{ClimbMove, Climbs};
use super::method::nan_as_infinity;
use super::simple_points::sample_simple_point;
use super::{SearchAlgorithm, UnitCube};
use crumple_world::random::{Purpose, Stream, stream};

const BATCH_SIZE: usize = 8;
const INITIAL_POINTS: usize = 24;
/// Share of simple points after that.
const SIMPLE_SHARE: f64 = 0.5;

/// A search over signals with few pieces at any times, often at their extremes, changed piece by piece.
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
    Move(ClimbMove),
}

impl SignalSearch {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        let random = stream(seed, Purpose::Search, 0);
        Self { cube: cube.clone(), random, climbs: Climbs::default(), start_count: 0, pending: Vec::new() }
    }

    fn propose(&mut self) -> SignalProposal {
        if self.start_count >= INITIAL_POINTS
            && !self.random.random_bool(SIMPLE_SHARE)
            && let Some(proposal) = self.climbs.propose(&self.cube, &mut self.random)
        {
            return SignalProposal::Move(proposal);
        }
        self.start_count += 1;
        SignalProposal::Start(sample_simple_point(&self.cube, &mut self.random))
    }
}

impl SearchAlgorithm for SignalSearch {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.climbs.rank();
        self.pending = (0..BATCH_SIZE).map(|_| self.propose()).collect();
        let point = |asked: &SignalProposal| match asked {
            SignalProposal::Start(point) => point.clone(),
            SignalProposal::Move(proposal) => proposal.point.clone(),
        };
        self.pending.iter().map(point).collect()
    }

    fn tell(&mut self, robustness: &[f64]) {
        let asked = std::mem::take(&mut self.pending);
        for (asked, value) in asked.into_iter().zip(robustness.iter().map(|&value| nan_as_infinity(value))) {
            match asked {
                SignalProposal::Start(point) => self.climbs.add_start(point, value),
                SignalProposal::Move(proposal) => self.climbs.tell(proposal, value),
            }
        }
    }
}
