//! Many short hill climbs at once, of which the promising ones continue.

use crate::falsify::UnitCube;
use crate::falsify::simple_points::sample_neighbour;
use crumple_sim::random::Stream;

/// Number of unsuccessful moves that weigh as much as one rank.
const MOVES_PER_RANK: f64 = 8.0;
/// A change of a coordinate that does not change the value multiplies the coordinate's weight by this factor, down to a
/// minimum weight.
const NEUTRAL_DECAY: f64 = 0.3;
const MIN_WEIGHT: f64 = 0.03;
/// Maximum number of climbs; the worst are dropped.
const MAX_CLIMBS: usize = 200;

/// Hill climbs from many points.
///
/// The next move goes to the climb with the smallest sum of its rank by value and its unsuccessful moves since its last
/// improvement: the best one leads until it is on a plateau, then others catch up.
///
/// Robustness is a minimum over time, so late inputs, or those of an uninvolved vehicle, have no effect. Each climb
/// moves such coordinates less. A successful move is repeated, longer or shorter (pattern move, Hooke and Jeeves 1961).
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

/// A proposal of one climb; return it with its value.
#[derive(Debug)]
pub(super) struct ClimbMove {
    climb: usize,
    pub(super) point: Vec<f64>,
}

impl Climbs {
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

    /// Sorts the climbs. Call this once before a batch of moves, and never between a move and its value.
    pub(super) fn rank(&mut self) {
        self.climbs.sort_by(|a, b| a.value.total_cmp(&b.value));
        self.climbs.truncate(MAX_CLIMBS);
        self.climbs
            .iter_mut()
            .for_each(|climb| climb.has_pending_move = false);
    }

    /// Proposes the next move, of a climb that has none in this batch.
    pub(super) fn propose(&mut self, cube: &UnitCube, random: &mut Stream) -> Option<ClimbMove> {
        let free = self
            .climbs
            .iter_mut()
            .enumerate()
            .filter(|(_, climb)| !climb.has_pending_move);
        let (index, climb) =
            free.min_by(|(a, x), (b, y)| x.turn_cost(*a).total_cmp(&y.turn_cost(*b)))?;
        climb.has_pending_move = true;
        Some(ClimbMove {
            climb: index,
            point: climb.propose(cube, random)?,
        })
    }

    pub(super) fn tell(&mut self, proposal: ClimbMove, value: f64) {
        if let Some(climb) = self.climbs.get_mut(proposal.climb) {
            climb.learn(proposal.point, value);
        }
    }
}

impl Climb {
    /// Returns the cost of the next move, given the rank by value; the cheapest climb has its turn.
    fn turn_cost(&self, rank: usize) -> f64 {
        rank as f64 + f64::from(self.moves_without_gain) / MOVES_PER_RANK
    }

    fn propose(&mut self, cube: &UnitCube, random: &mut Stream) -> Option<Vec<f64>> {
        use rand::RngExt;
        if let Some(gain) = self.last_gain.take() {
            let longer = random.random_range(0.5..2.0);
            let point: Vec<f64> = self
                .point
                .iter()
                .zip(&gain)
                .map(|(x, gain)| (x + longer * gain).clamp(0.0, 1.0))
                .collect();
            if point != self.point {
                return Some(point);
            }
        }
        (0..100).find_map(|_| sample_neighbour(cube, &self.point, &self.weights, random))
    }

    fn learn(&mut self, point: Vec<f64>, value: f64) {
        let change: Vec<f64> = point
            .iter()
            .zip(&self.point)
            .map(|(new, old)| new - old)
            .collect();
        for (weight, _) in self
            .weights
            .iter_mut()
            .zip(&change)
            .filter(|(_, change)| **change != 0.0)
        {
            *weight = if value == self.value {
                (*weight * NEUTRAL_DECAY).max(MIN_WEIGHT)
            } else {
                1.0
            };
        }
        self.moves_without_gain += 1;
        if value < self.value {
            self.moves_without_gain = 0;
            self.last_gain = Some(change);
        }
        // Accept equal values, too, to move along a plateau.
        if value <= self.value {
            (self.point, self.value) = (point, value);
        }
    }
}
