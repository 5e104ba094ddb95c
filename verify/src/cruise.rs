//! The adaptive cruise control benchmark of ARCH-COMP (category AINNCS, artificial intelligence and neural network
//! control systems).
//!
//! Two cars move with x' = v, v' = γ and γ' = -2 γ + 2 a - 0.0001 v². The lead car's a is -2 m/s². The own car's a is
//! the unclipped output of a network, every 0.1 s, for (30, 1.4, v_ego, D_rel, v_rel), with D_rel = x_lead - x_ego and
//! v_rel = v_lead - v_ego. Initial set: x_lead in [90, 110], v_lead in [32, 32.2], x_ego in [10, 11], v_ego in [30,
//! 30.2], γ = 0. Requirement for 5 s: D_rel ≥ 10 + 1.4 v_ego.
//!
//! # What is claimed
//! From every initial state, at all times from 0 to 5 s, the *margin* D_rel - 10 - 1.4 v_ego is at least as large as
//! stated. All x_ego at 5 s lie in an interval that is at most as wide as stated.
//!
//! # Proof
//! - **Only D_rel matters.** The positions enter only through their difference, which starts in [90 - 11, 110 - 10] =
//!   [79, 100]. That range is cut into equal *cells*, each simulated separately. The own car's travelled distance is
//!   added to an x_ego that starts anywhere in [10, 11].
//! - **A period.** With w = 2 a - 0.0001 v², T = 0.1 s and K = (1 - e^(-2 T))/2, if w is constant,
//!   ```text
//!   γ(T) = e^(-2 T) γ + K w,   v(T) = v + K γ + (T - K)/2 w,   x(T) = x + T v + (T - K)/2 γ + (T²/2 - (T - K)/2)/2 w.
//!   ```
//!   The factors of w are integrals of positive functions, so a w that changes within an interval gives a result within
//!   that of the interval. All are [affine forms](crate::reach::form), which keep correlations.
//! - **Change of w in a period.** It is 0.0001 times the change of v². Suppose v stays in V. Then w stays in W = 2 a -
//!   0.0001 V². γ, drawn towards w/2, stays in Γ, the hull of its old value and W/2, and v in v + [0, T] Γ. If this
//!   lies strictly inside V, then v cannot have been the first to leave V, and all of it holds.
//! - **Between decisions.** The margin's second derivative is γ_lead - γ_ego - 1.4 (w_ego - 2 γ_ego). If that is at
//!   most M ≥ 0, the margin is at least the smaller of those at both ends less M T²/8.
//! - **The network** is bounded as in [reach](crate::reach::controller), rounding to single precision included; the
//!   bounds also hold for the network in real numbers.

use serde::{Deserialize, Serialize};

use crate::interval::Interval;
use crate::reach::form::AffineForm;
use crate::reach::load_controller;
use crate::reach::relax::exp_neg;
use crate::reach::{ControllerInput, NetworkFileSource, NeuralController, OBSERVATION_SIZE};
use crate::work::{OpBudget, WorkLimit};
use crate::{ProvedClaim, Rejection};

/// Time between decisions, in seconds.
pub const PERIOD_S: f64 = 0.1;
/// Number of decisions in 5 s.
pub const PERIODS: usize = 50;
/// Constant inputs of the network: set speed in m/s and time gap in seconds.
pub const SET_SPEED_AND_TIME_GAP: [f64; 2] = [30.0, 1.4];
/// Required distance in metres and time gap in seconds.
pub const SAFE_DISTANCE: [f64; 2] = [10.0, 1.4];
/// The lead car's a, in m/s².
pub const LEAD_ACCEL_MPS2: f64 = -2.0;
/// Factor of v².
pub const DRAG: f64 = 0.0001;
/// Initial set: x_lead in metres, v_lead in m/s, x_ego in metres, v_ego in m/s.
pub const INITIAL_SET: [[f64; 2]; 4] = [[90.0, 110.0], [32.0, 32.2], [10.0, 11.0], [30.0, 30.2]];
/// Clipping limit of inputs and output that is beyond all values of the benchmark.
pub const CLIP_LIMIT: f64 = 1e6;

/// Maximum number of cells.
pub(crate) const MAX_CELLS: u32 = 10_000;
/// Half width of V, the assumed range of the speed in a period, in m/s.
const SPEED_ENCLOSURE_RADIUS_MPS: f64 = 2.0;
const OPS_PER_PERIOD: u64 = 50_000;
/// Symbols of D_rel, v_lead and v_ego at the start; later ones belong to periods.
const SHARED_SYMBOLS: usize = 3;

/// A claim about a network in the benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CruiseClaim {
    /// File name of the network, in the certificate's folder.
    pub policy_file: String,
    /// SHA-256 of the network file, in hexadecimal.
    pub policy_sha256: String,
    /// Source file of the network.
    pub source: NetworkFileSource,
    /// Number of equal parts of the initial range of D_rel.
    pub cells: u32,
    /// Lower bound of D_rel - 10 - 1.4 v_ego, in metres.
    pub margin_m_at_least: f64,
    /// Upper bound of the width of an interval with all final x_ego, in metres.
    pub x_ego_width_m_at_most: f64,
}

/// Bounds of a network in the benchmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CruiseBounds {
    /// Lower bound of the margin over the whole box and all times, in metres.
    pub margin_m: f64,
    /// Bounds of x_ego at the end, in metres.
    pub x_ego_m: [f64; 2],
}

impl CruiseBounds {
    /// Returns the width of the final x_ego bounds, in metres; rounded up.
    #[must_use]
    pub fn x_ego_width_m(&self) -> f64 {
        (self.x_ego_m[1] - self.x_ego_m[0]).next_up()
    }
}

/// Reason for which no bounds of a network exist.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CruiseBoundsError {
    /// The inputs or the output are not those of the benchmark.
    #[error("must have the inputs 30, 1.4, v_ego, D_rel, v_rel every 0.1 s, and the output a in m/s², not limited")]
    ProblemMismatch,
    /// The bounds have become too wide.
    #[error("has bounds that are too wide at {0} s")]
    TooWide(f64),
}

fn expected_inputs() -> [ControllerInput; 5] {
    let input = |of, constant| ControllerInput {
        coefficients: of,
        constant,
        absent_value: None,
        offset: 0.0,
        scale: 1.0,
        low: -CLIP_LIMIT,
        high: CLIP_LIMIT,
    };
    // Gaps ahead and behind; speeds ahead, own, behind; accelerations ahead, own, behind.
    let own = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    let distance = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let relative = [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0];
    let nothing = [0.0; OBSERVATION_SIZE];
    [
        input(nothing, SET_SPEED_AND_TIME_GAP[0]),
        input(nothing, SET_SPEED_AND_TIME_GAP[1]),
        input(own, 0.0),
        input(distance, 0.0),
        input(relative, 0.0),
    ]
}

#[derive(Debug, Clone)]
struct CarState {
    distance: AffineForm,
    speed: AffineForm,
    gamma: AffineForm,
}

/// T, e^(-2 T), K, (T - K)/2 and (T²/2 - (T - K)/2)/2 of a period.
struct PeriodCoefficients {
    time: Interval,
    decay: Interval,
    decay_integral: Interval,
    second_decay_integral: Interval,
    third_decay_integral: Interval,
}

struct PeriodBounds {
    gamma: Interval,
    forcing: Interval,
}

impl PeriodCoefficients {
    fn new() -> Self {
        let half = Interval::point(0.5);
        // A tenth lies between the neighbours of its nearest number.
        let time = Interval::ONE.over(Interval::point(10.0));
        let doubled = time + time;
        let decay = exp_neg(doubled.low()).hull(exp_neg(doubled.high()));
        let of_speed = (Interval::ONE - decay) * half;
        let half_of_speed = (time - of_speed) * half;
        let of_way = (time.sqr() * half - half_of_speed) * half;
        Self {
            time,
            decay,
            decay_integral: of_speed,
            second_decay_integral: half_of_speed,
            third_decay_integral: of_way,
        }
    }
}

impl CarState {
    fn from_speed(speed: AffineForm) -> Self {
        Self { distance: AffineForm::default(), speed, gamma: AffineForm::default() }
    }

    /// Advances by a period with constant a; the remainder becomes `symbol`. Returns `None` if the enclosure fails.
    fn advance(&self, a: &AffineForm, period: &PeriodCoefficients, symbol: usize) -> Option<(Self, PeriodBounds)> {
        let at = Interval::point;
        let (before, drag) = (self.speed.range(), Interval::ONE.over(at(10_000.0)));
        let tried = before + Interval::around_zero(SPEED_ENCLOSURE_RADIUS_MPS);
        let forcing = at(2.0) * a.range() - drag * tried.sqr();
        let gamma = self.gamma.range().hull(forcing * at(0.5));
        let since = period.time.hull(Interval::ZERO) * gamma;
        let within = before + since;
        if !(tried.low() < within.low() && within.high() < tried.high()) {
            return None;
        }
        // v² - (v at the beginning)², as a product of difference and sum.
        let changed = since * (within + before);
        let mut w = a.scaled(at(2.0)).minus(&self.speed.times(&self.speed).scaled(drag));
        w.shift(-(drag * changed));
        let w = w.with_rest_as_symbol(symbol);
        let mut after = self.clone();
        after.distance.add_scaled(&self.speed, period.time);
        after.distance.add_scaled(&self.gamma, period.second_decay_integral);
        after.distance.add_scaled(&w, period.third_decay_integral);
        after.speed.add_scaled(&self.gamma, period.decay_integral);
        after.speed.add_scaled(&w, period.second_decay_integral);
        after.gamma = self.gamma.scaled(period.decay);
        after.gamma.add_scaled(&w, period.decay_integral);
        Some((after, PeriodBounds { gamma, forcing }))
    }
}

/// Bounds the behaviour of a network in the benchmark.
///
/// # Errors
/// [`CruiseBoundsError`] if the network does not fit the benchmark, or bounds become too wide.
pub fn compute_bounds(controller: &NeuralController, cells: u32) -> Result<CruiseBounds, CruiseBoundsError> {
    compute_bounds_with_budget(controller, cells, &OpBudget::new(WorkLimit::UNLIMITED))
}

fn compute_bounds_with_budget(
    controller: &NeuralController,
    cells: u32,
    work: &OpBudget,
) -> Result<CruiseBounds, CruiseBoundsError> {
    let is_plain = controller.output_index == 0 && controller.scale_mps2 == 1.0 && controller.offset_mps2 == 0.0;
    let is_plain = is_plain && controller.residual_over.is_none();
    let is_uncut = !controller.is_clipped || controller.action_bounds_mps2 == [-CLIP_LIMIT, CLIP_LIMIT];
    if controller.inputs != expected_inputs() || !is_plain || !is_uncut || controller.decision_interval_s != PERIOD_S {
        return Err(CruiseBoundsError::ProblemMismatch);
    }
    let [[lead, lead_end], _, [ego, ego_end], _] = INITIAL_SET;
    let (nearest, farthest) = (lead - ego_end, lead_end - ego);
    let end = |cell: u32| nearest + (farthest - nearest) * (f64::from(cell) / f64::from(cells));
    let mut found = CruiseBounds { margin_m: f64::INFINITY, x_ego_m: [f64::INFINITY, f64::NEG_INFINITY] };
    for cell in 0..cells {
        let distance = Interval::new(end(cell), end(cell + 1)).ok_or(CruiseBoundsError::TooWide(0.0))?;
        let of_cell = bound_cell(controller, distance, work)?;
        found.margin_m = found.margin_m.min(of_cell.margin_m);
        let ([low, high], [cell_low, cell_high]) = (found.x_ego_m, of_cell.x_ego_m);
        found.x_ego_m = [low.min(cell_low), high.max(cell_high)];
    }
    Ok(found)
}

fn bound_cell(
    controller: &NeuralController,
    distance: Interval,
    work: &OpBudget,
) -> Result<CruiseBounds, CruiseBoundsError> {
    let at = Interval::point;
    let start = |symbol: usize, [low, high]: [f64; 2]| {
        AffineForm::symbol(symbol, Interval::new(low, high).unwrap_or(Interval::ENTIRE))
    };
    let [_, v_lead, x_ego, v_ego] = INITIAL_SET;
    let distance = AffineForm::symbol(0, distance);
    let (mut lead, mut ego) = (CarState::from_speed(start(1, v_lead)), CarState::from_speed(start(2, v_ego)));
    let (period, lead_mps2) = (PeriodCoefficients::new(), AffineForm::constant(at(LEAD_ACCEL_MPS2)));
    let [kept_m, kept_s] = SAFE_DISTANCE.map(at);
    // 1.4 and 0.0001 are not floating-point numbers: the true ones lie between the neighbours of the nearest.
    let kept_s = kept_s + Interval::around_zero(f64::EPSILON);
    let eighth = period.time.sqr() * at(0.125);
    let margin = |distance: &AffineForm, speed: &AffineForm| {
        let mut margin = distance.clone();
        margin.add_scaled(speed, -kept_s);
        margin.shift(-kept_m);
        margin.range()
    };
    let relative = |lead: &CarState, ego: &CarState| distance.clone().plus(&lead.distance).minus(&ego.distance);
    let mut seen_m = relative(&lead, &ego);
    let mut least = margin(&seen_m, &ego.speed);
    let mut margin_m = least.low();
    for index in 0..PERIODS {
        let too_wide = || CruiseBoundsError::TooWide(index as f64 * PERIOD_S);
        if !work.charge(OPS_PER_PERIOD) {
            return Err(too_wide());
        }
        let nothing = AffineForm::default;
        let seen =
            [seen_m, nothing(), lead.speed.clone(), ego.speed.clone(), nothing(), nothing(), nothing(), nothing()];
        let a = controller.decide_with_budget(&seen, &[0.0; OBSERVATION_SIZE], false, work);
        let symbol = SHARED_SYMBOLS + 2 * index;
        let (next_lead, of_lead) = lead.advance(&lead_mps2, &period, symbol).ok_or_else(too_wide)?;
        let (next_ego, of_ego) = ego.advance(&a, &period, symbol + 1).ok_or_else(too_wide)?;
        (lead, ego) = (next_lead, next_ego);
        seen_m = relative(&lead, &ego);
        let now = margin(&seen_m, &ego.speed);
        let bend = of_lead.gamma - of_ego.gamma - kept_s * (of_ego.forcing - at(2.0) * of_ego.gamma);
        margin_m = margin_m.min((least.min(now) - bend.max(Interval::ZERO) * eighth).low());
        least = now;
    }
    let mut end = ego.distance;
    end.shift(Interval::new(x_ego[0], x_ego[1]).unwrap_or(Interval::ENTIRE));
    let range = end.range();
    // NaN bounds compare with nothing.
    if margin_m.is_finite() && range.low().is_finite() && range.high().is_finite() {
        Ok(CruiseBounds { margin_m, x_ego_m: [range.low(), range.high()] })
    } else {
        Err(CruiseBoundsError::TooWide(PERIODS as f64 * PERIOD_S))
    }
}

pub(crate) fn check(claim: &CruiseClaim, file: Option<&[u8]>, work: &OpBudget) -> Result<ProvedClaim, Rejection> {
    let controller = load_controller(file, &claim.policy_sha256, Some(&claim.source))?;
    if !(1..=MAX_CELLS).contains(&claim.cells) {
        return Err(Rejection::invalid("cells", "must be 1 to 10 000"));
    }
    let found = compute_bounds_with_budget(&controller, claim.cells, work);
    // Reports an exceeded budget before anything else.
    work.charge_or_reject(0)?;
    let found = found.map_err(|unshown| Rejection::Policy { problem: unshown.to_string() })?;
    let is_shown = |stated: f64, margin: f64| stated.partial_cmp(&margin).is_some_and(std::cmp::Ordering::is_le);
    if !is_shown(claim.margin_m_at_least, found.margin_m) {
        return Err(Rejection::invalid("margin_m_at_least", "exceeds the proved value"));
    }
    if !is_shown(found.x_ego_width_m(), claim.x_ego_width_m_at_most) {
        return Err(Rejection::invalid("x_ego_width_m_at_most", "is below the proved value"));
    }
    Ok(ProvedClaim::Cruise { margin_m: found.margin_m, x_ego_width_m: found.x_ego_width_m() })
}

#[cfg(test)]
mod tests;
