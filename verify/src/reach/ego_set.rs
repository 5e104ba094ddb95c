//! Sets of egos, from one decision to the next.
//!
//! The controller decides every D steps and holds its command u. The command is affine in the symbols plus a rest,
//! which becomes a new symbol. After s seconds the free speed is w = v + u s, the speed is max(0, w), and the distance
//! is v s + u s²/2 + max(0, -w)²/(2|u|). The last term is at most max(0, -w) s/2, since v ≥ 0 gives -w ≤ |u| s. If all
//! members stop they cover at most v s/2. The added uncertainty becomes new symbols too, so that no uncertainty is
//! counted twice.
//!
//! If some members stand at the beginning of the last step before the next decision and others move, the set is split
//! into the two. Moving members observe u as their acceleration; those of them that have stopped did so within the last
//! step. Standing members observe 0. Either set keeps members of the other (a free speed below zero, for instance),
//! which is sound.
//!
//! # Order reduction
//! Old symbols have similar effects: they change distance and speed in nearly constant proportion. So two symbols with
//! vectors p and q (distance, speed, acceleration) become one with p + q: for any λ from 0 to 1
//!
//! ```text
//! p ε + q ε' = (p + q) (λ ε + (1 - λ) ε') + (p - λ (p + q)) ε + (q - (1 - λ) (p + q)) ε',
//! ```
//!
//! where the first factor is again in [-1, 1]. The rest, small if p and q are nearly parallel, becomes a new symbol for
//! each quantity.

use super::braking::VehicleState;
use super::form::{AffineForm, round_up};
use super::ranges::BoxDimension;
use super::relax::{relu, relu_above};
use crate::interval::Interval;

/// Symbols of the ranges and of the follower's firing instant. Later ones belong to a leader with bounded braking, then
/// to the ego.
pub(super) const SHARED_SYMBOLS: usize = BoxDimension::ALL.len() + 1;
/// Maximum number of the ego's own symbols, and their number after a reduction.
const MAX_SYMBOLS: usize = 160;
const REDUCED_SYMBOLS: usize = 120;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MotionMode {
    /// Moves, or has stood for at most one step.
    Moving,
    Standing,
    /// Stood before, and may have started again.
    Restarted,
}

impl MotionMode {
    pub(super) const ALL: [Self; 3] = [Self::Moving, Self::Standing, Self::Restarted];
}

pub(super) type ByMode<T> = [Option<T>; 3];

#[derive(Debug, Clone)]
pub(super) struct EgoSet {
    pub(super) mode: MotionMode,
    pub(super) ego: VehicleState,
    /// Follower of each ego, if it has a law.
    pub(super) follower: Option<VehicleState>,
    /// First of the set's own symbols.
    first_own_symbol: usize,
    pub(super) next_symbol: usize,
}

impl EgoSet {
    /// Creates egos with a speed; the first `shared` symbols are shared with other sets.
    pub(super) fn from_speed(speed: AffineForm, shared: usize) -> Self {
        let mode = if speed.is_zero() {
            MotionMode::Standing
        } else {
            MotionMode::Moving
        };
        let ego = VehicleState {
            speed,
            ..VehicleState::default()
        };
        Self {
            mode,
            ego,
            follower: None,
            first_own_symbol: shared,
            next_symbol: shared,
        }
    }

    pub(super) fn with_follower(self, follower: Option<VehicleState>) -> Self {
        Self { follower, ..self }
    }

    /// Returns all egos `steps` steps into a decision interval; their acceleration is unspecified.
    pub(super) fn ego_after(
        &self,
        wanted: &AffineForm,
        step: Interval,
        steps: u32,
    ) -> VehicleState {
        if steps == 0 {
            return VehicleState {
                acceleration: AffineForm::default(),
                ..self.ego.clone()
            };
        }
        advance_vehicle(&self.ego, wanted, Interval::point(f64::from(steps)) * step)
    }

    /// Returns the egos at the next decision: those that move at the beginning of the last step before it, and those
    /// that stand.
    pub(super) fn after_decision(
        &self,
        wanted: &AffineForm,
        step: Interval,
        decision_steps: u32,
    ) -> [Option<Self>; 2] {
        let speed = &self.ego.speed;
        let [until_last, time] = [decision_steps - 1, decision_steps]
            .map(|steps| Interval::point(f64::from(steps)) * step);
        if speed.is_zero() {
            let ego = advance_ego(&self.ego, wanted, time, step);
            let mode = if ego.acceleration.is_zero() {
                MotionMode::Standing
            } else {
                MotionMode::Restarted
            };
            return [Some(self.with_ego_in_mode(mode, ego)), None];
        }
        let before_last = speed.clone().plus(&wanted.scaled(until_last)).range();
        let command = wanted.range();
        let may_move = before_last.high() > 0.0 || command.high() > 0.0;
        let may_stand = before_last.low() <= 0.0 && command.low() <= 0.0;
        [
            may_move.then(|| {
                self.with_ego_in_mode(self.mode, advance_ego(&self.ego, wanted, time, step))
            }),
            may_stand.then(|| self.stopped_within(until_last, command)),
        ]
    }

    /// Returns the egos that come to a stand within `time` at a command.
    fn stopped_within(&self, time: Interval, command: Interval) -> Self {
        let VehicleState {
            distance, speed, ..
        } = &self.ego;
        let braking = (-command).max(Interval::ZERO);
        let speed_mps = speed.range().max(Interval::ZERO).min(braking * time);
        let mut travelled = distance.clone();
        travelled.shift((speed_mps * time * Interval::point(0.5)).hull(Interval::ZERO));
        let ego = VehicleState {
            distance: travelled,
            ..VehicleState::default()
        };
        self.with_ego_in_mode(MotionMode::Standing, ego)
    }

    /// Joins two sets, which may differ in all symbols but the shared ones.
    pub(super) fn join(&self, other: &Self) -> Self {
        let symbols = self.next_symbol.max(other.next_symbol);
        let follower = self
            .follower
            .as_ref()
            .zip(other.follower.as_ref())
            .map(|(a, b)| a.join(b));
        Self {
            mode: self.mode,
            ego: self.ego.clone(),
            follower,
            first_own_symbol: self.first_own_symbol,
            next_symbol: symbols,
        }
        .with_ego_in_mode(self.mode, self.ego.join(&other.ego))
    }

    fn with_ego_in_mode(&self, mode: MotionMode, ego: VehicleState) -> Self {
        let next = Self {
            mode,
            ego,
            follower: self.follower.clone(),
            ..*self
        }
        .with_rests_as_symbols();
        if next.next_symbol > self.first_own_symbol + MAX_SYMBOLS {
            next.reduce_order().with_rests_as_symbols()
        } else {
            next
        }
    }

    fn with_rests_as_symbols(mut self) -> Self {
        let used = self.forms().map(|form| form.terms().len());
        let mut symbols = used.fold(self.next_symbol, usize::max);
        for state in [Some(&mut self.ego), self.follower.as_mut()]
            .into_iter()
            .flatten()
        {
            for form in [&mut state.distance, &mut state.speed] {
                *form = std::mem::take(form).with_rest_as_symbol(symbols);
                symbols = symbols.max(form.terms().len());
            }
        }
        Self {
            next_symbol: symbols,
            ..self
        }
    }

    fn forms(&self) -> impl Iterator<Item = &AffineForm> {
        let states = [Some(&self.ego), self.follower.as_ref()]
            .into_iter()
            .flatten();
        states.flat_map(
            |VehicleState {
                 distance,
                 speed,
                 acceleration,
             }| [distance, speed, acceleration],
        )
    }

    fn reduce_order(mut self) -> Self {
        let mut generators = self.own_generators();
        generators.sort_by(|p, q| direction_key(p).total_cmp(&direction_key(q)));
        let excess = merge_generators(&mut generators);
        let states = [Some(&mut self.ego), self.follower.as_mut()]
            .into_iter()
            .flatten();
        let forms = states.flat_map(|state| {
            [
                &mut state.distance,
                &mut state.speed,
                &mut state.acceleration,
            ]
        });
        for (i, form) in forms.enumerate() {
            form.replace_terms(
                self.first_own_symbol,
                generators.iter().map(|generator| generator[i]),
                excess[i],
            );
        }
        self.next_symbol = self.first_own_symbol + generators.len();
        self
    }

    /// Returns the generators of the symbols that no other set has.
    fn own_generators(&self) -> Vec<Generator> {
        (self.first_own_symbol..self.next_symbol)
            .map(|symbol| {
                let mut generator = Generator::default();
                for (to, form) in generator.iter_mut().zip(self.forms()) {
                    *to = form.terms().get(symbol).copied().unwrap_or(0.0);
                }
                generator
            })
            .filter(|generator| *generator != Generator::default())
            .map(normalize_sign)
            .collect()
    }
}

/// Advances all egos by `time`, in which none stops before the last step; those that stop get a speed of 0.
pub(super) fn advance_ego(
    VehicleState {
        distance, speed, ..
    }: &VehicleState,
    wanted: &AffineForm,
    time: Interval,
    step: Interval,
) -> VehicleState {
    let half = Interval::point(0.5);
    if speed.is_zero() {
        let acceleration = relu(wanted);
        let distance = distance
            .clone()
            .plus(&acceleration.scaled(time.sqr() * half));
        return VehicleState {
            distance,
            speed: acceleration.scaled(time),
            acceleration,
        };
    }
    // The unclipped update of a vehicle that stops in the last step ends at >= -b h.
    let end = speed.clone().plus(&wanted.scaled(time));
    let most_reversing = (-wanted.range()).max(Interval::ZERO) * step;
    let reversing = (-end.range())
        .max(Interval::ZERO)
        .min(most_reversing)
        .hull(Interval::ZERO);
    let mut distance = distance
        .clone()
        .plus(&speed.scaled(time))
        .plus(&wanted.scaled(time.sqr() * half));
    distance.shift((reversing * step * half).hull(Interval::ZERO));
    VehicleState {
        distance,
        speed: relu_above(&end, -most_reversing.high()),
        acceleration: wanted.clone(),
    }
}

/// Advances a vehicle that holds an acceleration until it stands; the acceleration of the result is unspecified.
pub(super) fn advance_vehicle(
    VehicleState {
        distance, speed, ..
    }: &VehicleState,
    wanted: &AffineForm,
    time: Interval,
) -> VehicleState {
    let half = Interval::point(0.5);
    if speed.is_zero() && wanted.range().high() <= 0.0 {
        return VehicleState {
            distance: distance.clone(),
            speed: speed.clone(),
            ..VehicleState::default()
        };
    }
    let mut free = speed.clone();
    free.add_scaled(wanted, time);
    let mut travelled = distance.clone();
    let end_speed = free.range();
    if end_speed.high() <= 0.0 {
        let farthest = speed.range().max(Interval::ZERO) * time * half;
        travelled.shift(farthest.hull(Interval::ZERO));
        return VehicleState {
            distance: travelled,
            speed: AffineForm::default(),
            acceleration: wanted.clone(),
        };
    }
    travelled.add_scaled(speed, time);
    travelled.add_scaled(wanted, time.sqr() * half);
    if end_speed.low() < 0.0 {
        let reversed = Interval::point(-end_speed.low()) * time * half;
        travelled.shift(reversed.hull(Interval::ZERO));
    }
    VehicleState {
        distance: travelled,
        speed: relu(&free),
        acceleration: wanted.clone(),
    }
}

/// Coefficients of a symbol in distance, speed and acceleration of the ego, and of a follower with a law.
type Generator = [f64; 6];

/// Returns the vector or its negative, an equivalent generator.
fn normalize_sign(vector: Generator) -> Generator {
    let [distance, speed, _, behind, speed_behind, _] = vector;
    let first = [distance, speed, behind, speed_behind]
        .into_iter()
        .find(|&number| number != 0.0);
    if first.is_some_and(|first| first < 0.0) {
        vector.map(|number| -number)
    } else {
        vector
    }
}

/// Returns a sort key: the share of the ego's speed in its speed and distance, from -1 to 1. Generators of the follower
/// alone come last, with keys from 2 to 4.
fn direction_key(normalized: &Generator) -> f64 {
    match *normalized {
        [0.0, 0.0, _, distance, speed, _] if distance != 0.0 || speed != 0.0 => {
            3.0 + speed_share(distance, speed)
        }
        [distance, speed, ..] => speed_share(distance, speed),
    }
}

fn speed_share(distance: f64, speed: f64) -> f64 {
    if speed == 0.0 {
        0.0
    } else {
        speed / (distance.abs() + speed.abs())
    }
}

/// Replaces the neighbouring pairs that cost least by their sums, until few generators are left. Returns the total
/// excess of the sums.
fn merge_generators(generators: &mut Vec<Generator>) -> Generator {
    let mut pairs: Vec<(GeneratorPair, usize)> = generators
        .as_chunks()
        .0
        .iter()
        .zip(0..)
        .map(|([p, q], index)| (GeneratorPair::new(p, q), index))
        .collect();
    pairs.sort_by(|a, b| a.0.cost().total_cmp(&b.0.cost()));
    pairs.truncate(generators.len().saturating_sub(REDUCED_SYMBOLS));
    let mut excess = Generator::default();
    for (pair, index) in pairs {
        (generators[2 * index], generators[2 * index + 1]) = (pair.sum, Generator::default());
        excess = std::array::from_fn(|i| round_up(excess[i] + pair.excess[i]));
    }
    generators.retain(|generator| *generator != Generator::default());
    excess
}

struct GeneratorPair {
    sum: Generator,
    excess: Generator,
}

impl GeneratorPair {
    fn new(p: &Generator, q: &Generator) -> Self {
        let [smaller, larger] = if size(p) > size(q) { [q, p] } else { [p, q] };
        let sum: Generator = std::array::from_fn(|i| p[i] + q[i]);
        // At least a half, so that 1 - λ does not round.
        let share = (size(larger) / (size(larger) + size(smaller))).clamp(0.5, 1.0);
        let excess = std::array::from_fn(|i| {
            round_up(
                distance_to_part(larger[i], share * sum[i])
                    + distance_to_part(smaller[i], (1.0 - share) * sum[i]),
            )
        });
        Self { sum, excess }
    }

    fn cost(&self) -> f64 {
        self.excess.iter().sum()
    }
}

fn size(generator: &Generator) -> f64 {
    generator.iter().map(|number| number.abs()).sum()
}

/// Bounds the distance of a number from a rounded product.
fn distance_to_part(number: f64, part: f64) -> f64 {
    (number - part).abs() + (number.abs() + part.abs()) * (4.0 * f64::EPSILON)
}

#[cfg(test)]
mod tests;
