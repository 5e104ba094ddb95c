//! Leaders: scripted braking, or any braking within a limit.
//!
//! # Bounded braking
//! The leader's acceleration is piecewise constant with arbitrary values in [-b, 0] until standstill; it never speeds
//! up. Its change of speed is the integral of a rate between -b and 0, which is 0 at standstill. Over a time T with the
//! mean u of that rate
//!
//! ```text
//! speed    = v + u T
//! distance = x + v T + u T²/2 + e,    |e| ≤ b T²/8
//! ```
//!
//! where e depends on when the leader brakes. Let τ = -u T / b. If it brakes at b for a time τ at the beginning, the
//! integral of (T - s) a(s) is -b (T τ - τ²/2). If it does so at the end, the integral is -b τ²/2. These are the
//! extremes. Both differ from u T²/2 by b τ (T - τ)/2, which is at most b T²/8. Each u and each e is a symbol of its
//! own, shared by all later states of the leader, so the ego's reaction is correlated with the observed braking.
//!
//! These forms also hold members that reverse. No leader does, so speeds below 0 are cut off, and distances below the
//! stopping distance of the slowest leader that brakes at b from the start. Cut values serve the observation at this
//! instant only; the forms above are propagated, so cutting errors do not accumulate.
//!
//! A symbol covers a block of decisions: one decision, or more so that there are at most `MAX_BLOCKS`. Inside a block u
//! is any number from -b to 0, without correlations. So is, at each decision after the first, the observed
//! acceleration, which is that of the step before.

use super::braking::{BrakingVehicle, VehicleState};
use super::ego_set::SHARED_SYMBOLS;
use super::form::AffineForm;
use super::propagate::ReachProblem;
use super::relax::relu;
use super::{InitialRanges, ReachClaim};
use crate::interval::Interval;
use crate::motion::distance_and_speed_after;

/// Maximum number of blocks of a run: a symbol for each costs time in every step.
const MAX_BLOCKS: u32 = 200;
const SYMBOLS_PER_BLOCK: usize = 2;

#[derive(Debug, Clone)]
pub(super) enum LeaderModel {
    Scripted(Box<BrakingVehicle>),
    Bounded(BoundedLeader),
}

impl LeaderModel {
    pub(super) fn new(
        scene: &ReachProblem<'_>,
        [speed, rate, onset]: [AffineForm; 3],
        step: Interval,
    ) -> Self {
        match scene.leader_brakes_at_most_mps2 {
            // A limit of 0 equals scripted braking at 0, which has no symbols.
            Some(limit_mps2) if limit_mps2 != 0.0 => {
                Self::Bounded(BoundedLeader::new(scene, speed, limit_mps2, step))
            }
            _ => Self::Scripted(Box::new(BrakingVehicle::new(
                speed,
                rate,
                onset,
                scene.ranges.onset_steps,
                step,
            ))),
        }
    }

    pub(super) fn symbol_count(&self) -> usize {
        match self {
            Self::Scripted(_) => 0,
            Self::Bounded(led) => SYMBOLS_PER_BLOCK * (led.block_starts.len() - 1),
        }
    }

    /// True if all members have stood for a step at instant k: their state no longer changes.
    pub(super) fn has_stood(&self, k: u32, step: Interval) -> bool {
        match self {
            Self::Scripted(braking) => braking.has_stood(k, step),
            Self::Bounded(led) => led.is_standing(),
        }
    }

    /// Returns the state at instant k; inside a block of decisions with fewer correlations.
    pub(super) fn state_at(&self, k: u32, step: Interval) -> VehicleState {
        match self {
            Self::Scripted(braking) => braking.state_at(k, step),
            Self::Bounded(led) => led.state_at(k, step),
        }
    }
}

/// A leader that brakes arbitrarily within a limit.
#[derive(Debug, Clone)]
pub(super) struct BoundedLeader {
    acceleration_mps2: Interval,
    /// Initial speed.
    speed_mps: Interval,
    block_steps: u32,
    /// Distance and speed at the begin of each block and at the end of the last, reversing included.
    block_starts: Vec<[AffineForm; 2]>,
}

impl BoundedLeader {
    fn new(scene: &ReachProblem<'_>, speed: AffineForm, limit_mps2: f64, step: Interval) -> Self {
        // A limit that is NaN or infinite gives the whole line.
        let acceleration_mps2 = (-Interval::point(limit_mps2)).hull(Interval::ZERO);
        let decisions = scene.steps.div_ceil(scene.decision_steps.max(1));
        let block_steps = scene
            .decision_steps
            .max(1)
            .saturating_mul(decisions.div_ceil(MAX_BLOCKS).max(1));
        let time = Interval::point(f64::from(block_steps)) * step;
        let eighth = time.sqr() * Interval::point(0.125);
        let off = acceleration_mps2 * eighth;
        let off = off.hull(-off);
        let speed_mps = speed.range();
        let mut begins = vec![[AffineForm::default(), speed]];
        for block in 0..scene.steps.div_ceil(block_steps) as usize {
            let Some([distance, speed]) = begins.last() else {
                break;
            };
            let symbol = SHARED_SYMBOLS + SYMBOLS_PER_BLOCK * block;
            let mean = AffineForm::symbol(symbol, acceleration_mps2);
            let [mut distance, speed] = advance_block(distance, speed, &mean, time);
            distance.add_scaled(&AffineForm::symbol(symbol + 1, off), Interval::ONE);
            begins.push([distance, speed]);
        }
        Self {
            acceleration_mps2,
            speed_mps,
            block_steps,
            block_starts: begins,
        }
    }

    fn is_standing(&self) -> bool {
        self.speed_mps.high() <= 0.0
    }

    /// Returns a lower bound of the distance after a time, as a point.
    fn min_distance_m(&self, time: Interval) -> Interval {
        let slowest = Interval::point(self.speed_mps.low().max(0.0));
        let hardest = Interval::point(self.acceleration_mps2.low());
        let distance_m = distance_and_speed_after(slowest, hardest, time).0;
        Interval::point(distance_m.low())
    }

    fn state_at(&self, k: u32, step: Interval) -> VehicleState {
        let block = ((k / self.block_steps) as usize).min(self.block_starts.len() - 1);
        let [distance, speed] = &self.block_starts[block];
        if self.is_standing() || k == 0 {
            return VehicleState {
                speed: speed.clone(),
                ..VehicleState::default()
            };
        }
        let since_steps = k.saturating_sub(self.block_steps.saturating_mul(block as u32));
        let [mut distance, mut speed] = if since_steps == 0 {
            [distance.clone(), speed.clone()]
        } else {
            // The mean lies in [-b, 0], and the distance between those of its ends.
            let any = AffineForm::constant(self.acceleration_mps2);
            advance_block(
                distance,
                speed,
                &any,
                Interval::point(f64::from(since_steps)) * step,
            )
        };
        let least_m = self.min_distance_m(Interval::point(f64::from(k)) * step);
        if distance.range().low() < least_m.low() {
            distance.shift(-least_m);
            distance = relu(&distance);
            distance.shift(least_m);
        }
        if speed.range().low() < 0.0 {
            speed = relu(&speed);
        }
        VehicleState {
            distance,
            speed,
            acceleration: AffineForm::constant(self.acceleration_mps2),
        }
    }
}

/// Returns distance and speed after a time at a constant mean acceleration.
fn advance_block(
    distance: &AffineForm,
    speed: &AffineForm,
    mean: &AffineForm,
    time: Interval,
) -> [AffineForm; 2] {
    let covered = speed
        .scaled(time)
        .plus(&mean.scaled(time.sqr() * Interval::point(0.5)));
    [
        distance.clone().plus(&covered),
        speed.clone().plus(&mean.scaled(time)),
    ]
}

impl ReachProblem<'_> {
    /// Returns the ranges with constant braking that the problem covers: for bounded braking every rate up to the
    /// limit, from every instant on.
    #[must_use]
    pub fn scripted_ranges(&self) -> InitialRanges {
        scripted_ranges(self.ranges, self.leader_brakes_at_most_mps2, self.steps)
    }

    /// Returns the problem of one initial state with constant braking, in the order of the ranges; `None` if it is not
    /// covered.
    #[must_use]
    pub fn at_point(&self, point: &[f64; 8]) -> Option<Self> {
        let ranges = self.scripted_ranges().at_point(point)?;
        Some(Self {
            ranges,
            leader_brakes_at_most_mps2: None,
            stop_when_undecided: false,
            ..self.clone()
        })
    }
}

impl ReachClaim {
    /// Returns the ranges with constant braking that the claim covers.
    #[must_use]
    pub fn scripted_ranges(&self) -> InitialRanges {
        scripted_ranges(self.ranges, self.leader_brakes_at_most_mps2, self.steps)
    }
}

fn scripted_ranges(ranges: InitialRanges, limit_mps2: Option<f64>, steps: u32) -> InitialRanges {
    let brake_mps2 = limit_mps2.and_then(|limit_mps2| Interval::new(0.0, limit_mps2));
    match (brake_mps2, Interval::new(0.0, f64::from(steps))) {
        (Some(leader_brake_mps2), Some(onset_steps)) => InitialRanges {
            leader_brake_mps2,
            onset_steps,
            ..ranges
        },
        _ => ranges,
    }
}

#[cfg(test)]
mod tests;
