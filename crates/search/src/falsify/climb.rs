//! Many short climbs at once, the promising ones continued.

use crate::falsify::UnitCube;
use crate::falsify::simple_points::sample_neighbour;
use crumple_world::random::Stream;

/// Fruitless moves that weigh as much as one place in the ranking.
const MOVES_PER_RANK: f64 = 8.0;
/// What is left of a coordinate's weight when a change of it has changed nothing, and the least that stays.
const NEUTRAL_DECAY: f64 = 0.3;
const MIN_WEIGHT: f64 = 0.03;
/// Climbs kept: worse ones are forgotten.
const MAX_CLIMBS: usize = 200;

/// Climbs from many points.
///
/// The next move goes to the climb with the best sum of its rank by value and its fruitless moves since it last improved:
/// the best one leads until it sits on a plateau, then others catch up.
///
/// Robustness is a minimum over time, so inputs after the critical instant, or to a vehicle that plays no part, change
/// nothing at all. Each climb learns which coordinates those are from values that stay equal to the last bit, and moves
/// them less. A move that improved is repeated, longer or shorter (the pattern move of Hooke and Jeeves, 1961).
#[derive(Debug, Default)]
pub(super) struct Climbs {
    climbs: Vec<Climb>,
}

#[derive(Debug)]
struct Climb {
    point: Vec<f64>,
    value: f64,
    moves_without_gain: u32,
    weights: Vec<f64>,
    last_gain: Option<Vec<f64>>,
    has_pending_move: bool,
}

/// A proposal of one climb; hand it back with its value.
#[derive(Debug)]
pub(super) struct ClimbMove {
    climb: usize,
    pub(super) point: Vec<f64>,
}

impl Climbs {
    /// A new start.
    pub(super) fn add_start(&mut self, point: Vec<f64>, value: f64) {
        let weights = vec![1.0; point.len()];
        self.climbs.push(Climb {
            point,
            value,
            moves_without_gain: 0,
            weights,
            last_gain: None,
            has_pending_move: false,
        });
    }

    /// Puts the climbs in order; call it once before a batch of moves, and never between a move and its value.
    pub(super) fn rank(&mut self) {
        self.climbs.sort_by(|a, b| a.value.total_cmp(&b.value));
        self.climbs.truncate(MAX_CLIMBS);
        self.climbs.iter_mut().for_each(|climb| climb.has_pending_move = false);
    }

    /// The next move, of a climb that has none in this batch.
    pub(super) fn propose(&mut self, cube: &UnitCube, random: &mut Stream) -> Option<ClimbMove> {
        let cost =
            |(rank, climb): &(usize, &mut Climb)| *rank as f64 + f64::from(climb.moves_without_gain) / MOVES_PER_RANK;
        let free = self.climbs.iter_mut().enumerate().filter(|(_, climb)| !climb.has_pending_move);
        let (index, climb) = free.min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        climb.has_pending_move = true;
        Some(ClimbMove { climb: index, point: climb.propose(cube, random)? })
    }

    pub(super) fn tell(&mut self, proposal: ClimbMove, value: f64) {
        if let Some(climb) = self.climbs.get_mut(proposal.climb) {
            climb.learn(proposal.point, value);
        }
    }
}

impl Climb {
    fn propose(&mut self, cube: &UnitCube, random: &mut Stream) -> Option<Vec<f64>> {
        use rand::RngExt;
        if let Some(gain) = self.last_gain.take() {
            let longer = random.random_range(0.5..2.0);
            let further = |(x, d): (&f64, &f64)| (x + longer * d).clamp(0.0, 1.0);
            let point: Vec<f64> = self.point.iter().zip(&gain).map(further).collect();
            if point != self.point {
                return Some(point);
            }
        }
        (0..100).find_map(|_| sample_neighbour(cube, &self.point, &self.weights, random))
    }

    fn learn(&mut self, point: Vec<f64>, value: f64) {
        let change: Vec<f64> = point.iter().zip(&self.point).map(|(new, old)| new - old).collect();
        for (weight, _) in self.weights.iter_mut().zip(&change).filter(|(_, change)| **change != 0.0) {
            *weight = if value == self.value { (*weight * NEUTRAL_DECAY).max(MIN_WEIGHT) } else { 1.0 };
        }
        self.moves_without_gain += 1;
        if value < self.value {
            self.moves_without_gain = 0;
            self.last_gain = Some(change);
        }
        // Equals are taken, too: walking along a plateau costs nothing.
        if value <= self.value {
            (self.point, self.value) = (point, value);
        }
    }
}
