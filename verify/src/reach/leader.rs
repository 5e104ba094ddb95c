//! Leaders: one that brakes as scripted, or any that brakes within a limit.
//!
//! # Within a limit
//! Over each step the leader holds any acceleration from -b to 0, at each another one, chosen by whom and for whatever reason, until it
//! stands; then it stays. It never speeds up. What its speed changes by is therefore always the integral of a rate from -b to 0, that of a
//! leader that stands included (0), and over a time T with the mean u of that rate
//!
//! ```text
//! speed    = v + u T
//! distance = x + v T + u T²/2 + e,    |e| ≤ b T²/8
//! ```
//!
//! where e says when it braked: with all of it at the begin the integral of (T - s) a(s) is -b (T τ - τ²/2), with all of it at the end
//! -b τ²/2, for τ = -u T / b, and neither is farther than b τ (T - τ)/2 from u T²/2. Each u and each e is a symbol of its own, shared by
//! whatever is said of the leader later: an ego that has seen the leader brake, and has answered, has answered that very braking.
//!
//! These forms also hold members that reverse. No leader does, so that speeds below 0 are cut off, and distances
//! below the one on which the slowest leader stops if it brakes at b from the start. What has been cut is used for what is seen at this
//! instant only: the forms that go on are those above, in which nothing is added up that cutting has made wider.
//!
//! A symbol is for a block of decisions. A block is one decision, or, where these are too many, so many that there are at most
//! `MOST_BLOCKS`; between its ends u is any number from -b to 0, without a connection to the rest. The same is true of the
//! acceleration that is observed, that of the step before.

use super::braking::{BrakingVehicle, VehicleState};
use super::ego_set::SHARED_SYMBOLS;
use super::form::AffineForm;
use super::propagate::ReachProblem;
use super::relax::relu;
use super::{InitialRanges, ReachClaim};
use crate::interval::Interval;
use crate::motion::distance_and_speed_after;

/// Most blocks into which a run is divided: a symbol for each costs time in every step.
const MAX_BLOCKS: u32 = 200;
/// Symbols of a block: u and e.
const SYMBOLS_PER_BLOCK: usize = 2;

/// Who drives ahead.
#[derive(Debug, Clone)]
pub(super) enum LeaderModel {
    /// Brakes at a rate from a time on.
    Scripted(Box<BrakingVehicle>),
    /// Brakes as it likes.
    Bounded(BoundedLeader),
}

impl LeaderModel {
    /// The leader of a scene, whose speed, rate and onset are these.
    pub(super) fn new(scene: &ReachProblem<'_>, [speed, rate, onset]: [AffineForm; 3], step: Interval) -> Self {
        match scene.leader_brakes_at_most_mps2 {
            // Who may not brake at all is one that brakes at 0, which has no symbols.
            Some(limit_mps2) if limit_mps2 != 0.0 => Self::Bounded(BoundedLeader::new(scene, speed, limit_mps2, step)),
            _ => Self::Scripted(Box::new(BrakingVehicle::new(speed, rate, onset, scene.ranges.onset_steps, step))),
        }
    }

    /// How many symbols besides those of the ranges its forms have.
    pub(super) fn symbol_count(&self) -> usize {
        match self {
            Self::Scripted(_) => 0,
            Self::Bounded(led) => SYMBOLS_PER_BLOCK * (led.block_starts.len() - 1),
        }
    }

    /// Whether all members have stood for a step at instant k: from then on nothing about them changes.
    pub(super) fn has_stood(&self, k: u32, step: Interval) -> bool {
        match self {
            Self::Scripted(braking) => braking.has_stood(k, step),
            Self::Bounded(led) => led.is_standing(),
        }
    }

    /// What its acceleration in the step before instant k may have been, each a form of its own; none if that of [`at`](Self::at) says all.
    pub(super) fn possible_accelerations(&self, k: u32, step: Interval) -> Vec<AffineForm> {
        match self {
            Self::Scripted(braking) => braking.possible_accelerations(k, step),
            Self::Bounded(_) => Vec::new(),
        }
    }

    /// At instant k; within a block of decisions with less of what it has to do with the rest.
    pub(super) fn state_at(&self, k: u32, step: Interval) -> VehicleState {
        match self {
            Self::Scripted(braking) => braking.state_at(k, step),
            Self::Bounded(led) => led.state_at(k, step),
        }
    }
}

/// A leader that brakes within a limit.
#[derive(Debug, Clone)]
pub(super) struct BoundedLeader {
    /// From -b to 0, in m/s².
    acceleration_mps2: Interval,
    /// At the start.
    speed_mps: Interval,
    block_steps: u32,
    /// Distance and speed at the begin of each block and at the end of the last, reversing included.
    block_starts: Vec<[AffineForm; 2]>,
}

impl BoundedLeader {
    fn new(scene: &ReachProblem<'_>, speed: AffineForm, limit_mps2: f64, step: Interval) -> Self {
        // A limit that is no number is none that anything is proved for.
        let acceleration_mps2 = (-Interval::point(limit_mps2)).hull(Interval::ZERO);
        let decisions = scene.steps.div_ceil(scene.decision_steps.max(1));
        let block_steps = scene.decision_steps.max(1).saturating_mul(decisions.div_ceil(MAX_BLOCKS).max(1));
        let time = Interval::point(f64::from(block_steps)) * step;
        let eighth = time.sqr() * Interval::point(0.125);
        let off = acceleration_mps2 * eighth;
        let off = off.hull(-off);
        let speed_mps = speed.range();
        let mut begins = vec![[AffineForm::default(), speed]];
        for block in 0..scene.steps.div_ceil(block_steps) as usize {
            let Some([distance, speed]) = begins.last() else { break };
            let symbol = SHARED_SYMBOLS + SYMBOLS_PER_BLOCK * block;
            let mean = AffineForm::symbol(symbol, acceleration_mps2);
            let [mut distance, speed] = advance_block(distance, speed, &mean, time);
            distance.add_scaled(&AffineForm::symbol(symbol + 1, off), Interval::ONE);
            begins.push([distance, speed]);
        }
        Self { acceleration_mps2, speed_mps, block_steps, block_starts: begins }
    }

    /// Whether all members stand from the start.
    fn is_standing(&self) -> bool {
        self.speed_mps.high() <= 0.0
    }

    fn state_at(&self, k: u32, step: Interval) -> VehicleState {
        let place = ((k / self.block_steps) as usize).min(self.block_starts.len() - 1);
        let [distance, speed] = &self.block_starts[place];
        if self.is_standing() || k == 0 {
            return VehicleState {
                distance: AffineForm::default(),
                speed: speed.clone(),
                acceleration: AffineForm::default(),
            };
        }
        let since_steps = k.saturating_sub(self.block_steps.saturating_mul(place as u32));
        let [mut distance, mut speed] = if since_steps == 0 {
            [distance.clone(), speed.clone()]
        } else {
            // No mean is larger than 0 or smaller than -b, and what is covered lies between what these cover.
            let any = AffineForm::constant(self.acceleration_mps2);
            advance_block(distance, speed, &any, Interval::point(f64::from(since_steps)) * step)
        };
        let slowest = Interval::point(self.speed_mps.low().max(0.0));
        let hardest = Interval::point(self.acceleration_mps2.low());
        let (least_m, _) = distance_and_speed_after(slowest, hardest, Interval::point(f64::from(k)) * step);
        let least_m = Interval::point(least_m.low());
        if distance.range().low() < least_m.low() {
            distance.shift(-least_m);
            distance = relu(&distance);
            distance.shift(least_m);
        }
        if speed.range().low() < 0.0 {
            speed = relu(&speed);
        }
        VehicleState { distance, speed, acceleration: AffineForm::constant(self.acceleration_mps2) }
    }
}

/// Distance and speed after a time at a mean acceleration, if it is held.
fn advance_block(distance: &AffineForm, speed: &AffineForm, mean: &AffineForm, time: Interval) -> [AffineForm; 2] {
    let covered = speed.scaled(time).plus(&mean.scaled(time.sqr() * Interval::point(0.5)));
    [distance.clone().plus(&covered), speed.clone().plus(&mean.scaled(time))]
}

impl ReachProblem<'_> {
    /// The starts, and the constant braking of a leader, that the scene holds: for a leader within a limit every rate up to it, from every
    /// instant on.
    #[must_use]
    pub fn scripted_ranges(&self) -> InitialRanges {
        scripted_ranges(self.ranges, self.leader_brakes_at_most_mps2, self.steps)
    }

    /// One start with one constant braking of the leader, in the order of the ranges, driven to the end; none if it is not in the scene.
    #[must_use]
    pub fn at_point(&self, point: &[f64; 8]) -> Option<Self> {
        let ranges = self.scripted_ranges().at_point(point)?;
        Some(Self { ranges, leader_brakes_at_most_mps2: None, stop_when_undecided: false, ..self.clone() })
    }
}

impl ReachClaim {
    /// The same of a claim.
    #[must_use]
    pub fn scripted_ranges(&self) -> InitialRanges {
        scripted_ranges(self.ranges, self.leader_brakes_at_most_mps2, self.steps)
    }
}

fn scripted_ranges(ranges: InitialRanges, limit_mps2: Option<f64>, steps: u32) -> InitialRanges {
    let up_to = |most: f64| Interval::new(0.0, most);
    match limit_mps2.map(|limit_mps2| (up_to(limit_mps2), up_to(f64::from(steps)))) {
        Some((Some(leader_brake_mps2), Some(onset_steps))) => {
            InitialRanges { leader_brake_mps2, onset_steps, ..ranges }
        }
        _ => ranges,
    }
}

#[cfg(test)]
mod tests;
