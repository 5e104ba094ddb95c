//! An ego that departs from a law of driving: what it answers is how far, not what it accelerates at.
//!
//! At every step, not only where the network decides, the ego asks for what the law says of its own speed v, that of the leader w, and the gap s
//! between them, cut to the bounds l and h of the policy's action; the law is `idm`, as for who [follows](super::follower) by one. From that
//! the action a, from -1 to 1, which is held until the next decision, departs by
//!
//! ```text
//! d = max(0, (|a| - z) / (1 - z))    towards l where a < 0 and towards h else:    (1 - d) law + d l,    (1 - d) law + d h
//! ```
//!
//! with z the dead zone. With p = max(0, (a - z) / (1 - z)) and q = max(0, (-a - z) / (1 - z)), of which one is always 0, that is
//! law + p (h - law) + q (l - law), which is evaluated in forms: two bends and two products. Where no member leaves the dead zone nothing is lost but
//! by the law, and where all depart entirely the law does not count. Bounds of what p, q and the law are by themselves give bounds as well, and where these are
//! the tighter ones they are taken: between them and l and h lies what a product of wide forms does not know.
//!
//! # What is seen
//! The law sees the gap, its own speed and that of the leader anew at every step, each within the stated error of the truth, as the network
//! does at decisions, and besides within the 10⁻⁹ that double precision is off.
//!
//! # Departures that take time
//! They come and go at r per second at most. Where r h ≥ 2 for steps of h seconds one step is enough for any of them, since none is larger
//! than from -1 to 1, and d is what the action says, but for 10⁻¹⁵ that double precision is off. Others are refused: d would be a part of the state. Who bounds
//! them all the same is told any acceleration from l to h.

use std::fmt;

use super::OBSERVATION_SIZE;
use super::follower::{IdmLaw, LawInput};
use super::form::AffineForm;
use super::relax::relu;
use crate::interval::Interval;

/// Widest dead zone, as the simulator has it.
const MAX_DEAD_ZONE: f64 = 0.99;
/// Slowest and fastest departures, likewise, in 1/s.
const RATE_RANGE_PER_S: [f64; 2] = [0.1, 1000.0];
/// The largest change of a departure: from one bound to the other.
const MAX_RESIDUAL_CHANGE: f64 = 2.0;
/// More than double precision is off by in what follows from law and action, as a share of the largest acceleration there is.
const REL_ROUNDING_ERROR: f64 = 1e-14;

/// Plain numbers have to be narrower than a form by this factor to take its place: an ego that forgets what its acceleration depends on no longer knows that it makes
/// up for what it did before.
const MAX_RELATIVE_WIDTH: f64 = 0.9;

/// How actions depart from a law, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualPolicy {
    /// z: actions up to this, either way, follow the law.
    pub dead_zone: f64,
    /// r: how fast departures come and go, in 1/s.
    pub rate_per_s: f64,
    /// The law. Most that its vehicle accelerates at is the highest acceleration of the policy's.
    pub idm: IdmLaw,
}

impl fmt::Display for ResidualPolicy {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { dead_zone, rate_per_s, idm } = self;
        let most_mps2 = idm.max_accel_mps2;
        write!(
            out,
            "it {idm}, at every step and at up to {most_mps2} m/s², and departs from that where the network's action is beyond {dead_zone}; \
             departures come and go at {rate_per_s} 1/s"
        )
    }
}

impl ResidualPolicy {
    /// # Errors
    /// The field, if a number of it is outside the range in which the simulator takes it.
    pub(super) fn check(&self) -> Result<(), String> {
        let Self { dead_zone, rate_per_s, idm } = *self;
        let numbers = [
            ("dead_zone", dead_zone, [0.0, MAX_DEAD_ZONE]),
            ("rate_per_s", rate_per_s, RATE_RANGE_PER_S),
            ("desired_speed_mps", idm.desired_speed_mps, [0.1, 100.0]),
            ("time_headway_s", idm.time_headway_s, [0.0, 10.0]),
            ("standstill_gap_m", idm.standstill_gap_m, [0.0, 100.0]),
            ("accel_mps2", idm.accel_mps2, [0.01, 30.0]),
            ("comfortable_brake_mps2", idm.comfortable_brake_mps2, [0.01, 30.0]),
        ];
        match numbers.into_iter().find(|(_, number, [low, high])| !(low..=high).contains(&number)) {
            None => Ok(()),
            Some((field, number, [low, high])) => Err(format!("{field}: {number} is not from {low} to {high}")),
        }
    }

    /// Whether each departure is complete after one step.
    #[must_use]
    pub(crate) fn is_complete_in_one_step(&self, step_s: f64) -> bool {
        self.rate_per_s * step_s >= MAX_RESIDUAL_CHANGE
    }

    /// How far actions depart upwards and downwards: p and q.
    fn residual_shares(&self, action: &AffineForm) -> [AffineForm; 2] {
        let zone = Interval::point(self.dead_zone);
        let left = Interval::ONE - zone;
        [1.0, -1.0].map(|sign| {
            let mut beyond = action.scaled(Interval::point(sign));
            beyond.shift(-zone);
            relu(&beyond.scaled(Interval::ONE.over(left)))
        })
    }

    /// What is asked for at actions and at what is seen, between two bounds, in m/s².
    pub(super) fn acceleration(&self, departs: &Residual, sight: &LawInput) -> AffineForm {
        let Residual { up, down, bounds_mps2: [low, high] } = departs;
        let [least, most] = [low, high].map(|bound| AffineForm::constant(Interval::point(*bound)));
        let (law, plain) = self.idm.acceleration_bounds(sight, &AffineForm::constant(-Interval::point(*low)));
        let law = tighter_form(law, plain);
        let mut wanted = law.clone();
        for (share, bound) in [(up, &most), (down, &least)] {
            if !share.is_zero() {
                wanted = wanted.plus(&share.times(&bound.clone().minus(&law)));
            }
        }
        let rounded = REL_ROUNDING_ERROR * low.abs().max(high.abs());
        wanted.widen(rounded);
        tighter_form(wanted, departs.interval_bounds(law.range()) + Interval::around_zero(rounded))
    }
}

/// A form, unless plain numbers say so much more that it is worth forgetting what they depend on.
fn tighter_form(form: AffineForm, plain: Interval) -> AffineForm {
    let is_worth_it = plain.high() - plain.low() < MAX_RELATIVE_WIDTH * 2.0 * form.radius();
    if is_worth_it { AffineForm::constant(plain) } else { form }
}

/// How far actions depart, for as long as they are held.
pub(super) struct Residual {
    up: AffineForm,
    down: AffineForm,
    bounds_mps2: [f64; 2],
}

impl Residual {
    pub(super) fn new(departure: &ResidualPolicy, action: &AffineForm, bounds_mps2: [f64; 2]) -> Self {
        let [up, down] = departure.residual_shares(action);
        Self { up, down, bounds_mps2 }
    }

    /// The same of numbers that have nothing to do with each other. It grows with what the law says and with p, and falls with q.
    fn interval_bounds(&self, law: Interval) -> Interval {
        let [low, high] = self.bounds_mps2.map(Interval::point);
        let law = law.max(low).min(high);
        let [least, most] = [law.low(), law.high()].map(Interval::point);
        let share = |form: &AffineForm| form.range().max(Interval::ZERO).min(Interval::ONE);
        let [up, down] = [&self.up, &self.down].map(share);
        let towards = |bound: Interval, law: Interval, share: f64| {
            let share = Interval::point(share);
            (Interval::ONE - share) * law + share * bound
        };
        let upwards = towards(high, least, up.low()).hull(towards(high, most, up.high()));
        let downwards = towards(low, least, down.high()).hull(towards(low, most, down.low()));
        // Of p and q one is always 0.
        let plain = match (self.up.is_zero(), self.down.is_zero()) {
            (true, _) => downwards,
            (false, true) => upwards,
            (false, false) => upwards.hull(downwards),
        };
        plain.max(low).min(high)
    }
}

/// By how much what the law sees may be off: gap, own speed, and the difference of speeds.
pub(super) fn law_input_errors(observation_error: &[f64; OBSERVATION_SIZE]) -> [f64; 3] {
    let [gap, _, ahead, own, ..] = *observation_error;
    [gap, own, own + ahead]
}

#[cfg(test)]
mod tests;
