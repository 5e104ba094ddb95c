//! Bounds from the multipliers of one program, for any firing of the follower's brake and in continuous time.
//!
//! With a nonnegative multiplier for each row, the weighted sum of the rows is
//!
//! ```text
//! L(a) = Σ y (d - front slack) + Σ p (d₂ - d₁ - pair slack) + Σ r (-d - rear slack) - Σ s (w + v₀)
//!        + φ (d + θ w - fired slack)
//! ```
//!
//! An escape with smallest gap m has L <= -m Σ (y + p + r). Since d and w are integrals of a, so is L. Its infimum over
//! every measurable a within the limits is the integral of min(-b q, a q), where q is the coefficient of a at each
//! time, piecewise linear between instants with a multiplier. The bound holds for every control grid and every
//! controller.

use super::avoidance_problem::AvoidanceProblem;

/// An instant, in steps, and its multiplier.
pub(super) type WeightedInstant = (usize, f64);

/// Multipliers of the rows that a proof may use; unlisted rows have multiplier 0.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Multipliers {
    pub(super) front: Vec<WeightedInstant>,
    /// One list for each pair of egos.
    pub(super) between: Vec<Vec<WeightedInstant>>,
    pub(super) rear: Vec<WeightedInstant>,
    /// One list for each ego.
    pub(super) speed: Vec<Vec<WeightedInstant>>,
    pub(super) fired: f64,
}

/// Multipliers below this share of the largest one are noise of the solver.
const NEGLIGIBLE_SHARE: f64 = 1e-9;

impl Multipliers {
    pub(super) fn zero(problem: &AvoidanceProblem) -> Self {
        let egos = problem.egos.len();
        Self {
            between: vec![Vec::new(); egos.saturating_sub(1)],
            speed: vec![Vec::new(); egos],
            ..Self::default()
        }
    }

    /// Returns one set of multipliers for each initial gap, in which only the row of that gap has a multiplier.
    pub(super) fn for_initial_gaps(problem: &AvoidanceProblem) -> impl Iterator<Item = Self> {
        const AT_FIRST_INSTANT: WeightedInstant = (0, 1.0);
        let none = Self::zero(problem);
        let front = Self {
            front: vec![AT_FIRST_INSTANT],
            ..none.clone()
        };
        let rear = problem.follower.as_ref().map(|_| Self {
            rear: vec![AT_FIRST_INSTANT],
            ..none.clone()
        });
        let between = (0..none.between.len()).map(move |pair| {
            let mut multipliers = none.clone();
            multipliers
                .between
                .iter_mut()
                .skip(pair)
                .take(1)
                .for_each(|list| list.push(AT_FIRST_INSTANT));
            multipliers
        });
        [Some(front), rear].into_iter().flatten().chain(between)
    }

    /// Returns multipliers in which only the firing row has one.
    pub(super) fn for_firing(problem: &AvoidanceProblem) -> Self {
        Self {
            fired: 1.0,
            ..Self::zero(problem)
        }
    }

    /// Returns the first step at which a fully braking last ego stands.
    pub(super) fn standstill_step(problem: &AvoidanceProblem) -> usize {
        problem.egos.last().map_or(0, |ego| {
            let braking_s = ego.speed_mps.high() / ego.max_brake_mps2;
            ((braking_s / problem.step_s).ceil() as usize).min(problem.steps)
        })
    }

    /// Returns multipliers of two kinds of rows: the brake fires at step τ, and the last ego does not reverse once it
    /// stands. With φ = 1, the firing row gives q(t) = t_τ - t + θ. After standstill, a speed row every `spacing` steps
    /// reduces q by the time of `spacing` steps, so that q stays near 0.
    pub(super) fn for_standstill(
        problem: &AvoidanceProblem,
        firing: usize,
        spacing: usize,
    ) -> Self {
        let mut multipliers = Self::for_firing(problem);
        let theta_s = problem
            .follower
            .as_ref()
            .map_or(0.0, |follower| follower.ttc_s);
        let over_s = spacing as f64 * problem.step_s;
        let mut list = vec![(firing, theta_s + 0.5 * over_s)];
        let mut step = firing;
        while step > Self::standstill_step(problem) + spacing {
            step -= spacing;
            list.push((step, over_s));
        }
        list.reverse();
        if let Some(last) = multipliers.speed.last_mut() {
            *last = list;
        }
        multipliers
    }

    fn lists(&self) -> impl Iterator<Item = &Vec<WeightedInstant>> {
        [&self.front, &self.rear]
            .into_iter()
            .chain(&self.between)
            .chain(&self.speed)
    }

    pub(super) fn without_negligible(mut self) -> Self {
        let largest = self
            .lists()
            .flatten()
            .fold(self.fired, |most, (_, value)| most.max(*value));
        let lists = [&mut self.front, &mut self.rear]
            .into_iter()
            .chain(&mut self.between)
            .chain(&mut self.speed);
        for list in lists {
            list.retain(|(_, value)| *value > NEGLIGIBLE_SHARE * largest);
        }
        if self.fired <= NEGLIGIBLE_SHARE * largest {
            self.fired = 0.0;
        }
        self
    }
}

#[derive(Debug, Clone)]
pub(super) struct DualProof {
    multipliers: Multipliers,
    /// Contribution of each instant to q for each ego, latest first: step, change of the slope, change of the value.
    kinks: Vec<Vec<(usize, f64, f64)>>,
    /// Part of L that depends neither on a nor on the firing.
    constant: f64,
    /// Σ (y + p + r).
    weight: f64,
}

impl DualProof {
    pub(super) fn new(problem: &AvoidanceProblem, multipliers: Multipliers) -> Self {
        let mut kinks: Vec<Vec<(usize, f64, f64)>> = vec![Vec::new(); problem.egos.len()];
        let mut constant = 0.0;
        let mut weight = 0.0;
        let last = problem.egos.len().saturating_sub(1);
        for &(step, value) in &multipliers.front {
            kinks[0].push((step, value, 0.0));
            constant -= value * problem.front_slack_m(step);
            weight += value;
        }
        for (ahead, list) in multipliers.between.iter().enumerate() {
            for &(step, value) in list {
                kinks[ahead].push((step, -value, 0.0));
                kinks[ahead + 1].push((step, value, 0.0));
                constant -= value * problem.pair_slack_m(ahead, step);
                weight += value;
            }
        }
        for &(step, value) in &multipliers.rear {
            kinks[last].push((step, -value, 0.0));
            weight += value;
        }
        for (ego, list) in multipliers.speed.iter().enumerate() {
            for &(step, value) in list {
                kinks[ego].push((step, 0.0, -value));
                constant -= value * problem.speed_slack_mps(ego);
            }
        }
        for list in &mut kinks {
            list.sort_unstable_by_key(|(step, ..)| std::cmp::Reverse(*step));
        }
        Self {
            multipliers,
            kinks,
            constant,
            weight,
        }
    }

    /// Returns the multipliers for a firing; without `fired`, the multiplier of the firing row is 0.
    pub(super) fn multipliers(&self, fired: bool) -> Multipliers {
        Multipliers {
            fired: if fired { self.multipliers.fired } else { 0.0 },
            ..self.multipliers.clone()
        }
    }

    pub(super) fn uses_firing(&self) -> bool {
        self.multipliers.fired > 0.0
    }

    /// Returns the infimum of L. With `fired`, the brake fires at step `firing`; without it, at this step or later.
    pub(super) fn infimum(&self, problem: &AvoidanceProblem, firing: usize, fired: bool) -> f64 {
        let mut total = self.constant;
        for &(step, value) in &self.multipliers.rear {
            total -= value * problem.rear_slack_m(firing, step);
        }
        let mut kink = None;
        if let Some(follower) = &problem.follower
            && fired
            && self.uses_firing()
        {
            let value = self.multipliers.fired;
            total -= value * problem.fired_slack_m(firing);
            kink = Some((firing, value, value * follower.ttc_s));
        }
        let last = problem.egos.len().saturating_sub(1);
        for (index, (ego, kinks)) in problem.egos.iter().zip(&self.kinks).enumerate() {
            let extra = kink.filter(|_| index == last);
            total += min_integral(
                kinks,
                extra,
                problem.step_s,
                [ego.max_brake_mps2, ego.max_accel_mps2],
            );
        }
        total
    }

    /// Returns the infimum of L minus the largest L that a profile with all gaps at least `gap_m` can have. If the
    /// result is positive, there is no such profile.
    pub(super) fn excess(
        &self,
        problem: &AvoidanceProblem,
        firing: usize,
        fired: bool,
        gap_m: f64,
    ) -> f64 {
        self.infimum(problem, firing, fired) + gap_m * self.weight
    }

    /// Returns the upper bound of the smallest gap of an escape, in metres; minus infinity if there is no escape.
    pub(super) fn gap_bound_m(
        &self,
        problem: &AvoidanceProblem,
        firing: usize,
        fired: bool,
    ) -> f64 {
        let infimum = self.infimum(problem, firing, fired);
        if infimum > ROUNDING_MARGIN && self.weight <= 1e-9 * infimum {
            return f64::NEG_INFINITY;
        }
        if self.weight > 0.0 {
            -infimum / self.weight
        } else {
            f64::INFINITY
        }
    }
}

/// Minimum of L for a proof to survive outward rounding: it sums values of some hundred metres.
pub(super) const ROUNDING_MARGIN: f64 = 1e-9;

/// Returns the integral of min(-b q, a q) from 0 to the latest kink; kinks are sorted latest first, except `extra`.
fn min_integral(
    kinks: &[(usize, f64, f64)],
    mut extra: Option<(usize, f64, f64)>,
    step_s: f64,
    limits: [f64; 2],
) -> f64 {
    let mut slope = 0.0;
    let mut value = 0.0;
    let mut total = 0.0;
    let mut at = usize::MAX;
    let mut kinks = kinks.iter().copied().peekable();
    loop {
        let take_extra = match (extra, kinks.peek()) {
            (Some((step, ..)), Some((next, ..))) => step >= *next,
            (Some(_), None) => true,
            (None, _) => false,
        };
        let next = if take_extra {
            extra.take()
        } else {
            kinks.next()
        };
        // From the last kink back to this one, or to the start.
        let to = next.map_or(0, |(step, ..)| step);
        if at != usize::MAX && at > to {
            let over_s = (at - to) as f64 * step_s;
            let earlier = value + slope * over_s;
            total += min_integral_linear(value, earlier, over_s, limits);
            value = earlier;
        }
        let Some((step, by_slope, by_value)) = next else {
            return total;
        };
        at = step;
        slope += by_slope;
        value += by_value;
    }
}

/// Returns the integral of min(-b q, a q) for q linear between two values.
fn min_integral_linear(first: f64, last: f64, over_s: f64, [brake, accel]: [f64; 2]) -> f64 {
    let high = first.max(last);
    let low = first.min(last);
    if low >= 0.0 {
        -brake * 0.5 * (high + low) * over_s
    } else if high <= 0.0 {
        accel * 0.5 * (high + low) * over_s
    } else {
        let share = high / (high - low);
        0.5 * over_s * (-brake * high * share + accel * low * (1.0 - share))
    }
}
