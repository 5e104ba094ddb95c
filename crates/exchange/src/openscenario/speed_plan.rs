//! Speeds of an entity over time, and the transitions of actions.

use super::error::ScenarioImportError;
use super::limits::MAX_SAMPLES;
use super::vocabulary::{POSITION_MODE, TransitionDimension, TransitionShape};
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Interval of the samples of curved transitions, in seconds.
const SAMPLE_S: f64 = 0.01;
/// Time until which a step of the speed belongs to the initial state, in seconds.
const INITIAL_S: f64 = 1e-6;
/// Largest change that is none, in m/s or metres: that of rounding.
const NO_CHANGE: f64 = 1e-9;
/// Maximum duration of a curved transition, in seconds.
const MAX_TRANSITION_S: f64 = 3600.0;

/// Shape and extent of a transition.
#[derive(Debug, Clone, Copy)]
pub(super) struct TransitionDynamics {
    pub(super) shape: TransitionShape,
    pub(super) dimension: TransitionDimension,
    /// Seconds, units per second or metres.
    pub(super) value: f64,
}

impl TransitionDynamics {
    pub(super) fn read(node: Node<'_>) -> Result<Self> {
        node.only(
            &[],
            &[
                "dynamicsShape",
                "dynamicsDimension",
                "value",
                "followingMode",
            ],
        )?;
        node.expect("followingMode", &[POSITION_MODE])?;
        let shape = node.word("dynamicsShape")?;
        let dimension = node.word("dynamicsDimension")?;
        // The target determines the sign of a rate; some tools write it.
        let value = match dimension {
            TransitionDimension::Rate => node.number("value")?.abs(),
            _ => node.non_negative("value")?,
        };
        Ok(Self {
            shape,
            dimension,
            value,
        })
    }

    /// Returns true if the change takes no time.
    pub(super) fn is_instant(self) -> bool {
        let has_no_extent = self.dimension != TransitionDimension::Rate && self.value == 0.0;
        self.shape == TransitionShape::Step || has_no_extent
    }

    /// Limits the rate of a change by `change` to what a vehicle can drive, and returns true if that is less.
    pub(super) fn limit(&mut self, change: f64, limit: f64) -> bool {
        if self.is_instant() || change.abs() <= NO_CHANGE {
            return false;
        }
        let limited = match self.dimension {
            TransitionDimension::Rate => self.value.min(limit),
            TransitionDimension::Time => {
                let shortest_s = self.shape.steepest_slope() * change.abs() / limit;
                self.value.max(shortest_s)
            }
            TransitionDimension::Distance => self.value,
        };
        let is_limited = (limited - self.value).abs() > NO_CHANGE * limited;
        if is_limited {
            self.value = limited;
        }
        is_limited
    }

    /// Returns the time of a change by `change`, in seconds; infinite if the change never ends, and `None` for a change
    /// over a distance.
    pub(super) fn duration_s(self, change: f64) -> Option<f64> {
        if change.abs() <= NO_CHANGE || self.is_instant() {
            return Some(0.0);
        }
        match self.dimension {
            TransitionDimension::Time => Some(self.value),
            TransitionDimension::Rate => {
                Some(self.shape.steepest_slope() * change.abs() / self.value)
            }
            TransitionDimension::Distance => None,
        }
    }
}

impl TransitionShape {
    fn is_curved(self) -> bool {
        matches!(self, Self::Cubic | Self::Sinusoidal)
    }

    /// Returns the largest slope of the shape, relative to its mean.
    fn steepest_slope(self) -> f64 {
        match self {
            Self::Linear | Self::Step => 1.0,
            Self::Cubic => 1.5,
            Self::Sinusoidal => std::f64::consts::FRAC_PI_2,
        }
    }

    /// Returns the time in which the shape changes a value by `change` with a second derivative of at most `limit`.
    pub(super) fn duration_at_acceleration_s(self, change: f64, limit: f64) -> f64 {
        match self {
            Self::Step => 0.0,
            Self::Sinusoidal => std::f64::consts::PI * (0.5 * change.abs() / limit).sqrt(),
            // The acceleration of a straight line is not defined: the line takes as long as the cubic curve.
            Self::Cubic | Self::Linear => (6.0 * change.abs() / limit).sqrt(),
        }
    }

    /// Returns the share of the change after a share of the time or the distance.
    pub(super) fn progress(self, share: f64) -> f64 {
        match self {
            Self::Linear => share,
            Self::Cubic => share * share * (3.0 - 2.0 * share),
            Self::Sinusoidal => 0.5 * (1.0 - libm::cos(std::f64::consts::PI * share)),
            Self::Step => 1.0,
        }
    }

    /// Returns the share of the time or the distance after which a share of the change is done.
    pub(super) fn share_until(self, target_share: f64) -> f64 {
        match self {
            Self::Step => return 0.0,
            Self::Linear => return target_share,
            Self::Cubic | Self::Sinusoidal => {}
        }
        let mut low = 0.0;
        let mut high = 1.0;
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.progress(middle) < target_share {
                low = middle
            } else {
                high = middle
            }
        }
        high
    }
}

/// Takes samples from those that a file may still have.
pub(super) fn take_samples(node: Node<'_>, samples: usize, left: &mut usize) -> Result<()> {
    *left = left.checked_sub(samples).ok_or_else(|| {
        let what =
            "samples of curved transitions, entries of speed profiles and vertices of trajectories";
        node.refuse(format!("the scenario has more than {MAX_SAMPLES} {what}"))
    })?;
    Ok(())
}

/// Piecewise linear speed over time, and the position that follows from it.
#[derive(Debug, Clone)]
pub(super) struct SpeedPlan {
    knots: Vec<SpeedKnot>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SpeedKnot {
    pub(super) time_s: f64,
    pub(super) speed_mps: f64,
    pub(super) position_m: f64,
}

impl SpeedPlan {
    pub(super) fn constant(position_m: f64, speed_mps: f64) -> Self {
        Self {
            knots: vec![SpeedKnot {
                time_s: 0.0,
                speed_mps,
                position_m,
            }],
        }
    }

    /// Returns the work of finding the state at a time.
    pub(super) fn state_work(&self) -> u64 {
        8 + 4 * u64::from(self.knots.len().max(1).ilog2())
    }

    pub(super) fn knots(&self) -> &[SpeedKnot] {
        &self.knots
    }

    /// Returns the state at a time; the last speed is held.
    pub(super) fn at(&self, time_s: f64) -> SpeedKnot {
        let next = self
            .knots
            .partition_point(|knot| knot.time_s <= time_s)
            .max(1);
        let Some(&from) = self.knots.get(next - 1) else {
            return SpeedKnot {
                time_s,
                speed_mps: 0.0,
                position_m: 0.0,
            };
        };
        let passed_s = time_s - from.time_s;
        let speed_mps = match self.knots.get(next) {
            Some(to) => {
                from.speed_mps
                    + (to.speed_mps - from.speed_mps) * passed_s / (to.time_s - from.time_s)
            }
            None => from.speed_mps,
        };
        SpeedKnot {
            time_s,
            speed_mps,
            position_m: from.position_m + 0.5 * (from.speed_mps + speed_mps) * passed_s,
        }
    }

    /// Returns the time from which the vehicle stands at a time; `None` if it moves then.
    pub(super) fn at_rest_since_s(&self, time_s: f64) -> Option<f64> {
        let state = self.at(time_s);
        let reached = self
            .knots
            .partition_point(|knot| knot.position_m < state.position_m);
        let stands = state.speed_mps == 0.0;
        let stop = self.knots.get(reached).filter(|_| stands)?;
        Some(stop.time_s.min(time_s))
    }

    /// Returns true if the speed differs at any knot of this plan.
    pub(super) fn differs_from(&self, other: &Self) -> bool {
        self.knots
            .iter()
            .any(|knot| other.at(knot.time_s).speed_mps != knot.speed_mps)
    }

    /// Discards the plan after a time.
    pub(super) fn cut(&mut self, time_s: f64) {
        let last = self.at(time_s);
        self.knots.retain(|knot| knot.time_s < time_s);
        self.knots.push(last);
    }

    /// Returns true if the speed changes between two times.
    pub(super) fn changes_between(&self, [from_s, to_s]: [f64; 2]) -> bool {
        let speed_mps = self.at(from_s).speed_mps;
        let knots = self.knots.iter();
        let mut inside = knots.filter(|knot| from_s < knot.time_s && knot.time_s < to_s);
        self.at(to_s.max(from_s)).speed_mps != speed_mps
            || inside.any(|knot| knot.speed_mps != speed_mps)
    }

    /// Sets the speed at the start, if the plan has no other speed.
    pub(super) fn set_initial_speed(&mut self, speed_mps: f64) {
        if let [start] = self.knots.as_mut_slice() {
            start.speed_mps = speed_mps;
        }
    }

    /// Adds a knot. A jump at one time takes the shortest time that separates knots.
    pub(super) fn push(&mut self, time_s: f64, speed_mps: f64) {
        let Some(&last) = self.knots.last() else {
            return;
        };
        let time_s = time_s.max(
            last.time_s
                + if speed_mps == last.speed_mps {
                    0.0
                } else {
                    1e-9
                },
        );
        if time_s > last.time_s {
            let position_m =
                last.position_m + 0.5 * (last.speed_mps + speed_mps) * (time_s - last.time_s);
            self.knots.push(SpeedKnot {
                time_s,
                speed_mps,
                position_m,
            });
        }
    }

    /// Changes the speed from a time on, and returns the end of the change, which is infinite if the speed never
    /// changes. Takes the samples of a curved change from `samples_left`.
    pub(super) fn change_speed(
        &mut self,
        node: Node<'_>,
        from_s: f64,
        to_mps: f64,
        dynamics: TransitionDynamics,
        samples_left: &mut usize,
    ) -> Result<f64> {
        self.cut(from_s);
        if dynamics.is_instant() && from_s <= INITIAL_S && self.knots.len() == 1 {
            self.set_initial_speed(to_mps);
            return Ok(from_s);
        }
        let from_mps = self.at(from_s).speed_mps;
        let duration_s = match dynamics.duration_s(to_mps - from_mps) {
            Some(duration_s) => duration_s,
            None if from_mps > 0.0 && to_mps > 0.0 => {
                return self.change_over_distance(node, from_s, to_mps, dynamics, samples_left);
            }
            // A speed that is a function of the distance would never leave 0, and never reach it.
            None => 2.0 * dynamics.value / (from_mps + to_mps),
        };
        if duration_s == f64::INFINITY {
            return Ok(f64::INFINITY);
        }
        let is_curved = dynamics.shape.is_curved();
        if duration_s.is_nan() || is_curved && duration_s > MAX_TRANSITION_S {
            return Err(refuse_long_change(node));
        }
        if is_curved {
            let samples = (duration_s / SAMPLE_S).ceil() as usize;
            take_samples(node, samples, samples_left)?;
            self.push_samples([from_s, duration_s], to_mps, dynamics.shape, samples);
        }
        self.push(from_s + duration_s, to_mps);
        Ok(from_s + duration_s)
    }

    /// Adds the samples within a curved change of the speed.
    fn push_samples(
        &mut self,
        [from_s, duration_s]: [f64; 2],
        to_mps: f64,
        shape: TransitionShape,
        samples: usize,
    ) {
        let from_mps = self.at(from_s).speed_mps;
        for sample in 1..samples {
            let share = sample as f64 / samples as f64;
            let speed_mps = from_mps + (to_mps - from_mps) * shape.progress(share);
            self.push(from_s + share * duration_s, speed_mps);
        }
    }

    /// Changes the speed as a function of the distance (class `TransitionDynamics`), and returns the end of the change.
    /// Between the samples the speed is linear in time, so that each sample is at its distance.
    fn change_over_distance(
        &mut self,
        node: Node<'_>,
        from_s: f64,
        to_mps: f64,
        dynamics: TransitionDynamics,
        samples_left: &mut usize,
    ) -> Result<f64> {
        let from_mps = self.at(from_s).speed_mps;
        let longest_s = dynamics.value / from_mps.min(to_mps);
        if longest_s > MAX_TRANSITION_S {
            return Err(refuse_long_change(node));
        }
        let samples = (longest_s / SAMPLE_S).ceil().max(1.0);
        take_samples(node, samples as usize, samples_left)?;
        let step_m = dynamics.value / samples;
        let mut time_s = from_s;
        let mut before_mps = from_mps;
        for sample in 1..=samples as usize {
            let progress = dynamics.shape.progress(sample as f64 / samples);
            let speed_mps = from_mps + (to_mps - from_mps) * progress;
            time_s += 2.0 * step_m / (before_mps + speed_mps);
            self.push(time_s, speed_mps);
            before_mps = speed_mps;
        }
        Ok(time_s)
    }

    /// Returns the time from `from_s` on at which a position is reached; infinite if it never is.
    pub(super) fn reach_s(&self, from_s: f64, goal_m: f64) -> f64 {
        if self.at(from_s).position_m >= goal_m {
            return from_s;
        }
        if self.at(from_s + MAX_TRANSITION_S).position_m < goal_m {
            return f64::INFINITY;
        }
        let mut low_s = 0.0;
        let mut high_s = MAX_TRANSITION_S;
        for _ in 0..60 {
            let middle_s = 0.5 * (low_s + high_s);
            if self.at(from_s + middle_s).position_m < goal_m {
                low_s = middle_s
            } else {
                high_s = middle_s
            }
        }
        from_s + high_s
    }
}

fn refuse_long_change(node: Node<'_>) -> ScenarioImportError {
    node.refuse(format!("the change takes longer than {MAX_TRANSITION_S} s"))
}
