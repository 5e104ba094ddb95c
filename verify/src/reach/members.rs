//! The ego: from one decision to the next.
//!
//! The actor decides every D steps; its answer u is held. It is affine in the symbols plus a rest, which becomes a new symbol. After
//! s seconds w = v + u s, the speed is max(0, w), and the distance v s + u s²/2 + max(0, -w)²/(2|u|), the last of which is at most
//! max(-w) s/2, since -w ≤ |u| s as v ≥ 0. If all members stop they cover at most v s/2. What this adds becomes new symbols too.
//! So nothing that is uncertain is counted twice.
//!
//! Where some members stand at the beginning of the last step before the next decision and others move, the set is split in those
//! two: who moves observes u as its acceleration and has stopped, if at all, within one step; who stands observes 0. Either set
//! keeps what would belong to the other (a free speed below zero, for instance): too many members do no harm.
//!
//! # Few symbols
//! Old symbols act alike: what was uncertain long ago shows as a distance and a speed in nearly the same proportion, whenever it
//! was. So two of them with vectors p and q (distance, speed, acceleration) become one with p + q: for any λ from 0 to 1
//!
//! ```text
//! p ε + q ε' = (p + q) (λ ε + (1 - λ) ε') + (p - λ (p + q)) ε + (q - (1 - λ) (p + q)) ε',
//! ```
//!
//! where the first factor is again in [-1, 1], and the rest, small if p and q point the same way, becomes a symbol for each number.

use super::braking::Seen;
use super::form::{Form, up};
use super::ranges::Dimension;
use super::relax::{rectified, rectified_above};
use crate::interval::Interval;

/// Symbols of the ranges, and of the instant at which the follower's brake fires. Those from here on are the leader's, if it brakes as it
/// likes, and then the ego's own.
pub(super) const SHARED_SYMBOLS: usize = Dimension::ALL.len() + 1;
/// Most symbols that are the ego's own, and how many of them are left if they become more.
const MOST_SYMBOLS: usize = 160;
const FEWER_SYMBOLS: usize = 120;

/// What the members of a set have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// They have not stopped yet, or not for longer than a step.
    Moving,
    /// They stand.
    Standing,
    /// They stood, and may have started again.
    Restarted,
}

impl Kind {
    pub(super) const ALL: [Self; 3] = [Self::Moving, Self::Standing, Self::Restarted];
}

/// One place for the set of each kind.
pub(super) type ByKind<T> = [Option<T>; 3];

/// A set of egos at an instant that is a decision's.
#[derive(Debug, Clone)]
pub(super) struct Members {
    pub(super) kind: Kind,
    pub(super) ego: Seen,
    /// The first symbol that is the ego's own.
    shared: usize,
    /// The first symbol that is not in use.
    pub(super) symbols: usize,
}

impl Members {
    /// Egos that drive at some speed, where so many symbols are shared with others.
    pub(super) fn starting(speed: Form, shared: usize) -> Self {
        let kind = if speed.is_zero() { Kind::Standing } else { Kind::Moving };
        let ego = Seen { distance: Form::default(), speed, acceleration: Form::default() };
        Self { kind, ego, shared, symbols: shared }
    }

    /// All egos `steps` steps into a decision interval; what they accelerate at is left open.
    pub(super) fn moved(&self, wanted: &Form, step: Interval, steps: u32) -> Seen {
        let time = Interval::point(f64::from(steps)) * step;
        let half = Interval::point(0.5);
        let Seen { distance, speed, .. } = &self.ego;
        if steps == 0 || speed.is_zero() && wanted.range().high() <= 0.0 {
            return Seen { acceleration: Form::default(), ..self.ego.clone() };
        }
        let mut free = speed.clone();
        free.add(wanted, time);
        let mut travelled = distance.clone();
        let (least, most) = (free.range().low(), free.range().high());
        if most <= 0.0 {
            let farthest = speed.range().max(Interval::ZERO) * time * half;
            travelled.shift(farthest.hull(Interval::ZERO));
            return Seen { distance: travelled, speed: Form::default(), acceleration: wanted.clone() };
        }
        travelled.add(speed, time);
        travelled.add(wanted, time.sqr() * half);
        if least < 0.0 {
            let reversed = Interval::point(-least) * time * half;
            travelled.shift(reversed.hull(Interval::ZERO));
        }
        Seen { distance: travelled, speed: rectified(&free), acceleration: wanted.clone() }
    }

    /// The egos at the next decision: those that move at the beginning of the last step before it, and those that stand.
    pub(super) fn after_decision(&self, wanted: &Form, step: Interval, decision_steps: u32) -> [Option<Self>; 2] {
        let Seen { distance, speed, .. } = &self.ego;
        let [until_last, time] =
            [decision_steps - 1, decision_steps].map(|steps| Interval::point(f64::from(steps)) * step);
        let half = Interval::point(0.5);
        let free = |time: Interval| speed.clone().plus(&wanted.scaled(time));
        let (before_last, acts) = (free(until_last).range(), wanted.range());
        let braking = (-acts).max(Interval::ZERO);
        if speed.is_zero() {
            // Who stands accelerates at max(0, u).
            let acceleration = rectified(wanted);
            let kind = if acceleration.is_zero() { Kind::Standing } else { Kind::Restarted };
            let travelled = distance.clone().plus(&acceleration.scaled(time.sqr() * half));
            return [Some(self.next(kind, travelled, acceleration.scaled(time), acceleration)), None];
        }
        let moving = || {
            // Who stops in the last step would have reversed at no more than b h.
            let end = free(time);
            let most_reversing = braking * step;
            let reversing = (-end.range()).max(Interval::ZERO).min(most_reversing).hull(Interval::ZERO);
            let mut travelled = distance.clone().plus(&speed.scaled(time)).plus(&wanted.scaled(time.sqr() * half));
            travelled.shift((reversing * step * half).hull(Interval::ZERO));
            self.next(self.kind, travelled, rectified_above(&end, -most_reversing.high()), wanted.clone())
        };
        let stopped = || {
            // From at most b s within at most s seconds.
            let speed_mps = speed.range().max(Interval::ZERO).min(braking * until_last);
            let mut travelled = distance.clone();
            travelled.shift((speed_mps * until_last * half).hull(Interval::ZERO));
            self.next(Kind::Standing, travelled, Form::default(), Form::default())
        };
        let may_move = before_last.high() > 0.0 || acts.high() > 0.0;
        let may_stand = before_last.low() <= 0.0 && acts.low() <= 0.0;
        [may_move.then(moving), may_stand.then(stopped)]
    }

    /// The members of both, which may have different symbols but for the shared ones.
    pub(super) fn joined(&self, other: &Self) -> Self {
        let symbols = self.symbols.max(other.symbols);
        let [a, b] = [&self.ego, &other.ego];
        let (distance, speed) = (a.distance.joined(&b.distance), a.speed.joined(&b.speed));
        let acceleration = a.acceleration.joined(&b.acceleration);
        Self { symbols, ..self.clone() }.next(self.kind, distance, speed, acceleration)
    }

    fn next(&self, kind: Kind, distance: Form, speed: Form, acceleration: Form) -> Self {
        let next = Self { kind, ego: Seen { distance, speed, acceleration }, ..*self }.settled();
        if next.symbols > self.shared + MOST_SYMBOLS { next.merged().settled() } else { next }
    }

    /// The same set with what is uncertain about distance and speed as symbols.
    fn settled(self) -> Self {
        let Seen { distance, speed, acceleration } = self.ego;
        let used = [&distance, &speed, &acceleration].map(|form| form.terms().len());
        let mut symbols = used.into_iter().fold(self.symbols, usize::max);
        let mut settle = |form: Form| {
            let settled = form.settled(symbols);
            symbols = symbols.max(settled.terms().len());
            settled
        };
        let ego = Seen { distance: settle(distance), speed: settle(speed), acceleration };
        Self { kind: self.kind, ego, shared: self.shared, symbols }
    }

    /// The same set with fewer symbols: the pairs that cost least become one each.
    fn merged(mut self) -> Self {
        let Seen { distance, speed, acceleration } = &mut self.ego;
        let mut vectors: Vec<Vector> = (self.shared..self.symbols)
            .map(|symbol| {
                [&*distance, speed, acceleration].map(|form| form.terms().get(symbol).copied().unwrap_or(0.0))
            })
            .filter(|vector| *vector != Vector::default())
            .map(upright)
            .collect();
        vectors.sort_by(|p, q| direction(p).total_cmp(&direction(q)));
        let mut pairs: Vec<(Pair, usize)> =
            vectors.as_chunks().0.iter().zip(0..).map(|([p, q], place)| (Pair::new(p, q), place)).collect();
        pairs.sort_by(|a, b| a.0.cost().total_cmp(&b.0.cost()));
        pairs.truncate(vectors.len().saturating_sub(FEWER_SYMBOLS));
        let mut beyond = Vector::default();
        for (pair, place) in pairs {
            (vectors[2 * place], vectors[2 * place + 1]) = (pair.sum, Vector::default());
            beyond = std::array::from_fn(|i| up(beyond[i] + pair.beyond[i]));
        }
        vectors.retain(|vector| *vector != Vector::default());
        for (i, form) in [distance, speed, acceleration].into_iter().enumerate() {
            form.replace(self.shared, vectors.iter().map(|vector| vector[i]), beyond[i]);
        }
        self.symbols = self.shared + vectors.len();
        self
    }
}

/// What a symbol is multiplied by in distance, speed and acceleration.
type Vector = [f64; 3];

/// The vector or its negative, which says the same of a symbol.
fn upright(vector: Vector) -> Vector {
    let is_upright = vector[0] > 0.0 || vector[0] == 0.0 && vector[1] >= 0.0;
    if is_upright { vector } else { vector.map(|number| -number) }
}

/// From -1 to 1, by how much of it is speed.
fn direction(upright: &Vector) -> f64 {
    let [distance, speed, _] = *upright;
    if speed == 0.0 { 0.0 } else { speed / (distance.abs() + speed.abs()) }
}

/// Two vectors as one.
struct Pair {
    sum: Vector,
    beyond: Vector,
}

impl Pair {
    fn new(p: &Vector, q: &Vector) -> Self {
        let size = |vector: &Vector| vector.iter().map(|number| number.abs()).sum::<f64>();
        let (smaller, larger) = if size(p) > size(q) { (q, p) } else { (p, q) };
        let sum: Vector = std::array::from_fn(|i| p[i] + q[i]);
        // At least a half, so that 1 - λ does not round.
        let share = (size(larger) / (size(larger) + size(smaller))).clamp(0.5, 1.0);
        let beyond = std::array::from_fn(|i| {
            let off = |number: f64, share: f64| {
                let part = share * sum[i];
                (number - part).abs() + (number.abs() + part.abs()) * (4.0 * f64::EPSILON)
            };
            up(off(larger[i], share) + off(smaller[i], 1.0 - share))
        });
        Self { sum, beyond }
    }

    fn cost(&self) -> f64 {
        self.beyond.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// How far a set reaches along a direction, up to its middle: Σ |w · vector| for its symbols, and what belongs to no symbol.
    fn reaches(members: &Members, along: &[f64; 3]) -> f64 {
        let Seen { distance, speed, acceleration } = &members.ego;
        let forms = [distance, speed, acceleration];
        let term = |symbol: usize| {
            forms.iter().zip(along).map(|(form, w)| form.terms().get(symbol).unwrap_or(&0.0) * w).sum::<f64>().abs()
        };
        let rests = forms.iter().zip(along).map(|(form, w)| form.rest() * w.abs()).sum::<f64>();
        (0..members.symbols).map(term).sum::<f64>() + rests
    }

    proptest! {
        /// A set that reaches as far in every direction, from the same middle, holds all members; and it reaches hardly farther.
        #[test]
        fn fewer_symbols_hold_the_same_members(
            decay in 0.9..1.1_f64,
            noise in prop::collection::vec(prop::array::uniform3(-1e-4..1e-4_f64), MOST_SYMBOLS + 10),
            along in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let forms: Vec<Form> = (0..3)
                .map(|i| {
                    let mut form = Form::constant(Interval::point(i as f64));
                    for (symbol, noise) in noise.iter().enumerate() {
                        let [distance, age] = [1.0, decay.powi(symbol as i32)];
                        let term = [distance * age, 0.1 * age, -0.01 * age][i] + noise[i];
                        form.add(&Form::symbol(SHARED_SYMBOLS + symbol, Interval::around_zero(1.0)), Interval::point(term));
                    }
                    form
                })
                .collect();
            let [distance, speed, acceleration] = forms.try_into().unwrap();
            let symbols = SHARED_SYMBOLS + MOST_SYMBOLS + 10;
            let all = Members { kind: Kind::Moving, ego: Seen { distance, speed, acceleration }, shared: SHARED_SYMBOLS, symbols };
            let fewer = all.clone().merged();
            prop_assert!(fewer.symbols <= SHARED_SYMBOLS + FEWER_SYMBOLS);
            prop_assert_eq!(fewer.ego.speed.centre(), all.ego.speed.centre());
            let (before, after) = (reaches(&all, &along), reaches(&fewer, &along));
            prop_assert!(after >= before * (1.0 - 1e-12), "{before} {after}");
            let largest = reaches(&all, &[1.0, 1.0, 1.0]);
            prop_assert!(after <= before + 0.05 * largest, "{before} {after}");
        }
    }
}
