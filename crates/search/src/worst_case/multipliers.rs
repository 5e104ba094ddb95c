//! What the multipliers of one program prove, for any firing of the follower's brake and in continuous time.
//!
//! With a multiplier for each row (none negative) the weighted sum of what the rows say is
//! L(a) = Σ y (d - front slack) + Σ p (d₂ - d₁ - pair slack) + Σ r (-d - rear slack) - Σ s (w + v₀) + φ (d + θ w - fired slack)
//! and an escape with smallest gap m has L <= -m Σ (y + p + r). Since d and w are integrals of a, so is L; its infimum over
//! every measurable a within the limits is the integral of min(-b q, a q), where q is the coefficient of a at each moment,
//! linear between the instants that carry a multiplier. The bound holds for every control grid and every controller.

use super::avoidance_problem::{AvoidanceProblem, BoundSide};

/// An instant, in steps, and its multiplier.
pub(super) type WeightedInstant = (usize, f64);

/// One for each row that a proof may use; rows that are not listed have none.
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

/// Multipliers smaller than this share of the largest one are noise of the solver.
const NEGLIGIBLE_SHARE: f64 = 1e-9;

impl Multipliers {
    /// No multipliers.
    pub(super) fn zero(situation: &AvoidanceProblem) -> Self {
        let egos = situation.egos.len();
        Self { between: vec![Vec::new(); egos.saturating_sub(1)], speed: vec![Vec::new(); egos], ..Self::default() }
    }

    /// Only that the gaps were no larger at the start: one for each of them.
    pub(super) fn for_initial_gaps(situation: &AvoidanceProblem) -> impl Iterator<Item = Self> {
        let first = || vec![(0, 1.0)];
        let none = Self::zero(situation);
        let front = Self { front: first(), ..none.clone() };
        let rear = situation.follower.as_ref().map(|_| Self { rear: first(), ..none.clone() });
        let between = (0..none.between.len()).map(move |pair| {
            let mut multipliers = none.clone();
            multipliers.between.iter_mut().skip(pair).take(1).for_each(|list| *list = first());
            multipliers
        });
        [Some(front), rear].into_iter().flatten().chain(between)
    }

    /// Only that the brake fires.
    pub(super) fn for_firing(situation: &AvoidanceProblem) -> Self {
        Self { fired: 1.0, ..Self::zero(situation) }
    }

    /// The first step at which a last ego that brakes fully stands.
    pub(super) fn standstill_step(situation: &AvoidanceProblem) -> usize {
        situation.egos.last().map_or(0, |ego| {
            let braking_s = ego.speed_mps.high() / ego.max_brake_mps2;
            ((braking_s / situation.step_s).ceil() as usize).min(situation.steps)
        })
    }

    /// That the brake fires, and that the last ego, once it stands, does not reverse to make it fire.
    ///
    /// With φ = 1 at τ the coefficient is q(t) = t_τ - t + θ; subtracting the spacing at every so many steps from standstill
    /// on keeps it near zero there, and the closer the steps, the nearer.
    pub(super) fn for_standstill(situation: &AvoidanceProblem, firing: usize, spacing: usize) -> Self {
        let mut multipliers = Self::for_firing(situation);
        let theta_s = situation.follower.as_ref().map_or(0.0, |follower| follower.ttc_s);
        let over_s = spacing as f64 * situation.step_s;
        let mut list = vec![(firing, theta_s + 0.5 * over_s)];
        let mut step = firing;
        while step > Self::standstill_step(situation) + spacing {
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
        [&self.front, &self.rear].into_iter().chain(&self.between).chain(&self.speed)
    }

    /// Drops multipliers so small that they are only noise.
    pub(super) fn without_negligible(mut self) -> Self {
        let largest = self.lists().flatten().fold(self.fired, |most, (_, value)| most.max(*value));
        let lists = [&mut self.front, &mut self.rear].into_iter().chain(&mut self.between).chain(&mut self.speed);
        for list in lists {
            list.retain(|(_, value)| *value > NEGLIGIBLE_SHARE * largest);
        }
        if self.fired <= NEGLIGIBLE_SHARE * largest {
            self.fired = 0.0;
        }
        self
    }
}

/// Multipliers prepared for asking about many firings.
#[derive(Debug, Clone)]
pub(super) struct DualProof {
    multipliers: Multipliers,
    /// For each ego what each instant adds to q, latest first: step, to its slope in time, to its value.
    kinks: Vec<Vec<(usize, f64, f64)>>,
    /// All of L that depends neither on a nor on the firing.
    constant: f64,
    /// Σ (y + p + r).
    weight: f64,
}

impl DualProof {
    /// Prepares multipliers.
    pub(super) fn new(situation: &AvoidanceProblem, multipliers: Multipliers) -> Self {
        let mut kinks: Vec<Vec<(usize, f64, f64)>> = vec![Vec::new(); situation.egos.len()];
        let mut constant = 0.0;
        let mut weight = 0.0;
        let side = BoundSide::Upper;
        let last = situation.egos.len().saturating_sub(1);
        for &(step, value) in &multipliers.front {
            kinks[0].push((step, value, 0.0));
            constant -= value * situation.front_slack_m(step, side);
            weight += value;
        }
        for (ahead, list) in multipliers.between.iter().enumerate() {
            for &(step, value) in list {
                kinks[ahead].push((step, -value, 0.0));
                kinks[ahead + 1].push((step, value, 0.0));
                constant -= value * situation.pair_slack_m(ahead, step, side);
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
                constant -= value * situation.speed_slack_mps(ego, side);
            }
        }
        for list in &mut kinks {
            list.sort_unstable_by_key(|(step, ..)| std::cmp::Reverse(*step));
        }
        Self { multipliers, kinks, constant, weight }
    }

    /// The multipliers for a firing; without that of firing for one that says nothing about it.
    pub(super) fn multipliers(&self, fired: bool) -> Multipliers {
        Multipliers { fired: if fired { self.multipliers.fired } else { 0.0 }, ..self.multipliers.clone() }
    }

    /// Whether it uses that the brake fires.
    pub(super) fn uses_firing(&self) -> bool {
        self.multipliers.fired > 0.0
    }

    /// The infimum of L if the brake fires at step `firing`, or, without `fired`, then or later.
    pub(super) fn infimum(&self, situation: &AvoidanceProblem, firing: usize, fired: bool) -> f64 {
        let mut total = self.constant;
        for &(step, value) in &self.multipliers.rear {
            total -= value * situation.rear_slack_m(firing, step, BoundSide::Upper);
        }
        let mut kink = None;
        if let Some(follower) = &situation.follower
            && fired
            && self.uses_firing()
        {
            let value = self.multipliers.fired;
            total -= value * situation.fired_slack_m(firing, BoundSide::Upper);
            kink = Some((firing, value, value * follower.ttc_s));
        }
        let last = situation.egos.len().saturating_sub(1);
        for (index, (ego, kinks)) in situation.egos.iter().zip(&self.kinks).enumerate() {
            let extra = kink.filter(|_| index == last);
            total += min_integral(kinks, extra, situation.step_s, [ego.max_brake_mps2, ego.max_accel_mps2]);
        }
        total
    }

    /// By how much the infimum exceeds what it is at most for a profile that keeps every gap at `gap_m`: where it does at all, there is
    /// none.
    pub(super) fn excess(&self, situation: &AvoidanceProblem, firing: usize, fired: bool, gap_m: f64) -> f64 {
        self.infimum(situation, firing, fired) + gap_m * self.weight
    }

    /// What the smallest gap of an escape cannot exceed, in metres; minus infinity if there is none at all.
    pub(super) fn gap_bound_m(&self, situation: &AvoidanceProblem, firing: usize, fired: bool) -> f64 {
        let infimum = self.infimum(situation, firing, fired);
        if infimum > ROUNDING_MARGIN && self.weight <= 1e-9 * infimum {
            return f64::NEG_INFINITY;
        }
        if self.weight > 0.0 { -infimum / self.weight } else { f64::INFINITY }
    }
}

/// What L must exceed for a proof to survive outward rounding: values of some hundred metres are summed.
pub(super) const ROUNDING_MARGIN: f64 = 1e-9;

/// The integral of min(-b q, a q) from 0 to the latest kink. All kinks latest first; `extra` is one more.
fn min_integral(
    kinks: &[(usize, f64, f64)],
    mut extra: Option<(usize, f64, f64)>,
    step_s: f64,
    limits: [f64; 2],
) -> f64 {
    let (mut slope, mut value, mut total) = (0.0, 0.0, 0.0);
    let mut at = usize::MAX;
    let mut kinks = kinks.iter().copied().peekable();
    loop {
        let take_extra = match (extra, kinks.peek()) {
            (Some((step, ..)), Some((next, ..))) => step >= *next,
            (Some(_), None) => true,
            (None, _) => false,
        };
        let next = if take_extra { extra.take() } else { kinks.next() };
        // From the last kink back to this one, or to the start.
        let to = next.map_or(0, |(step, ..)| step);
        if at != usize::MAX && at > to {
            let over_s = (at - to) as f64 * step_s;
            let earlier = value + slope * over_s;
            total += min_integral_linear(value, earlier, over_s, limits);
            value = earlier;
        }
        let Some((step, by_slope, by_value)) = next else { return total };
        at = step;
        slope += by_slope;
        value += by_value;
    }
}

/// The integral of min(-b q, a q) for q linear between two values.
fn min_integral_linear(one: f64, other: f64, over_s: f64, [brake, accel]: [f64; 2]) -> f64 {
    let (high, low) = (one.max(other), one.min(other));
    if low >= 0.0 {
        -brake * 0.5 * (high + low) * over_s
    } else if high <= 0.0 {
        accel * 0.5 * (high + low) * over_s
    } else {
        let share = high / (high - low);
        0.5 * over_s * (-brake * high * share + accel * low * (1.0 - share))
    }
}
