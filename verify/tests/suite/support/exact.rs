//! An exact simulation of the closed loop: intervals of multiples of 2⁻³²⁰ with outward rounding.
//!
//! The simulation has no affine forms, lines or allowances. For a single initial state the ends of each number stay
//! about 10⁻⁴⁰ apart. The checker's bounds must hold for it to the last bit.

use std::ops::{Add, Mul, Neg, Sub};

use crumple_verify::Interval;
use crumple_verify::reach::{
    Activation, ControllerInput, FollowerLaw, FollowerModel, IdmLaw, LinearLayer, NetworkLayer,
    NeuralController, ReachProblem,
};
use num_bigint::BigInt;

use super::closed_loop::ReachPoint;

const BITS: usize = 320;

#[derive(Debug, Clone, PartialEq)]
pub struct FixedPointInterval {
    low: BigInt,
    high: BigInt,
}

/// A comparison that the precision does not decide.
#[derive(Debug)]
pub struct TooClose;

impl From<f64> for FixedPointInterval {
    fn from(number: f64) -> Self {
        assert!(number.is_finite());
        let bits = number.to_bits();
        let (exponent, fraction) = ((bits >> 52 & 0x7ff) as i64, bits & ((1 << 52) - 1));
        let mantissa = BigInt::from(if exponent == 0 {
            fraction
        } else {
            fraction | 1 << 52
        });
        let shift = exponent.max(1) - 1075 + BITS as i64;
        let signed = if number < 0.0 { -mantissa } else { mantissa };
        let places = shift.unsigned_abs();
        if shift >= 0 {
            Self::point(signed << places)
        } else {
            Self::point(signed).shift_right(places as usize)
        }
    }
}

impl FixedPointInterval {
    fn point(scaled: BigInt) -> Self {
        Self {
            low: scaled.clone(),
            high: scaled,
        }
    }

    fn shift_right(self, places: usize) -> Self {
        Self {
            low: self.low >> places,
            high: -(-self.high >> places),
        }
    }

    pub fn zero() -> Self {
        Self::point(BigInt::ZERO)
    }

    pub fn hull(&self, other: &Self) -> Self {
        Self {
            low: (&self.low).min(&other.low).clone(),
            high: (&self.high).max(&other.high).clone(),
        }
    }

    pub fn min(&self, other: &Self) -> Self {
        Self {
            low: (&self.low).min(&other.low).clone(),
            high: (&self.high).min(&other.high).clone(),
        }
    }

    fn max(&self, other: &Self) -> Self {
        Self {
            low: (&self.low).max(&other.low).clone(),
            high: (&self.high).max(&other.high).clone(),
        }
    }

    fn clamp(&self, low: f64, high: f64) -> Self {
        self.max(&low.into()).min(&high.into())
    }

    pub fn over(&self, by: &Self) -> Self {
        if by.high < BigInt::ZERO {
            return (-self.clone()).over(&-by.clone());
        }
        assert!(by.low > BigInt::ZERO, "divided by {by:?}");
        let down = |n: &BigInt, d: &BigInt| {
            let (n, zero) = (n << BITS, BigInt::ZERO);
            let whole = &n / d;
            if n < zero && &whole * d != n {
                whole - 1
            } else {
                whole
            }
        };
        let ends =
            |f: &dyn Fn(&BigInt, &BigInt) -> BigInt, n: &BigInt| [f(n, &by.low), f(n, &by.high)];
        let [a, b] = ends(&down, &self.low);
        let [c, d] = ends(&|n, d| -down(&-n, d), &self.high);
        Self {
            low: a.min(b),
            high: c.max(d),
        }
    }

    fn sqrt(&self) -> Self {
        let root = |scaled: &BigInt| (scaled << BITS).sqrt();
        Self {
            low: root(&self.low),
            high: root(&self.high) + 1,
        }
    }

    pub fn is_below(&self, other: &Self) -> Result<bool, TooClose> {
        if self.high < other.low {
            Ok(true)
        } else if self.low >= other.high {
            Ok(false)
        } else {
            Err(TooClose)
        }
    }

    /// True if it is certainly in an interval, without tolerance.
    pub fn is_in(&self, interval: Interval) -> bool {
        self.is_at_least(interval.low()) && (-self.clone()).is_at_least(-interval.high())
    }

    /// True if it is certainly at least `bound`.
    pub fn is_at_least(&self, bound: f64) -> bool {
        bound == f64::NEG_INFINITY || Self::from(bound).high <= self.low
    }

    /// True if it is wider than 10⁻²⁰: large gains amplify the uncertainty at each step.
    fn is_too_wide(&self) -> bool {
        (&self.high - &self.low).bits() > BITS as u64 - 66
    }

    fn is_zero(&self) -> bool {
        *self == Self::zero()
    }

    fn exp(&self) -> Self {
        // Taylor's series of x/2ᵐ below 1/2, in units of 2⁻³²⁰: x/2ᵐ is off by less than 1, each term by less than 4,
        // the rest by less than 1.
        let at = |end: &BigInt| {
            let halvings = (end.bits() as usize).saturating_sub(BITS - 1);
            let x = end >> halvings;
            let mut term = BigInt::from(1) << BITS;
            let mut sum = term.clone();
            for n in 1..60_u32 {
                term = ((term * &x) >> BITS) / n;
                sum += &term;
            }
            let off = BigInt::from(300);
            let power = Self {
                low: &sum - &off,
                high: sum + off,
            };
            (0..halvings).fold(power, |power, _| power.clone() * power)
        };
        self.map_monotone(at)
    }

    fn map_monotone(&self, at: impl Fn(&BigInt) -> Self) -> Self {
        let low = at(&self.low);
        if self.low == self.high {
            low
        } else {
            low.hull(&at(&self.high))
        }
    }

    fn tanh(&self) -> Self {
        let unit = || Self::from(1.0);
        let at = |end: &BigInt| {
            let end = Self::point(end.clone());
            if end.low < BigInt::ZERO {
                let e = (end.clone() + end).exp();
                return (e.clone() - unit()).over(&(e + unit()));
            }
            let e = (-(end.clone() + end)).exp();
            (unit() - e.clone()).over(&(unit() + e))
        };
        self.map_monotone(at)
    }
}

impl Add for FixedPointInterval {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            low: self.low + other.low,
            high: self.high + other.high,
        }
    }
}

impl Neg for FixedPointInterval {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            low: -self.high,
            high: -self.low,
        }
    }
}

impl Sub for FixedPointInterval {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for FixedPointInterval {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let mut products = [
            &self.low * &other.low,
            &self.low * &other.high,
            &self.high * &other.low,
            &self.high * &other.high,
        ];
        products.sort();
        let [low, .., high] = products;
        Self { low, high }.shift_right(BITS)
    }
}

/// Returns the command in m/s², or the action, without rounding.
fn controller_output(
    controller: &NeuralController,
    seen: &[FixedPointInterval; 8],
    is_followed: bool,
) -> FixedPointInterval {
    let input = |input: &ControllerInput| {
        let number = match input.absent_value.filter(|_| !is_followed) {
            Some(absent) => absent.into(),
            None => input.coefficients.iter().zip(seen).fold(
                input.constant.into(),
                |sum: FixedPointInterval, (&factor, number)| sum + number.clone() * factor.into(),
            ),
        };
        (number - input.offset.into())
            .over(&input.scale.into())
            .clamp(input.low, input.high)
    };
    let answers = controller.layers.iter().fold(
        controller.inputs.iter().map(input).collect::<Vec<_>>(),
        apply_layer,
    );
    let wanted = answers[controller.output_index].clone() * controller.scale_mps2.into()
        + controller.offset_mps2.into();
    let [low, high] = controller.action_bounds_mps2;
    if controller.is_clipped {
        wanted.clamp(low, high)
    } else {
        wanted
    }
}

fn apply_layer(h: Vec<FixedPointInterval>, step: &NetworkLayer) -> Vec<FixedPointInterval> {
    let each = match step {
        NetworkLayer::Linear(LinearLayer {
            outputs,
            weights,
            biases,
            ..
        }) => {
            let order = |o: usize| {
                let column = weights.iter().skip(o).step_by(*outputs);
                h.iter()
                    .zip(column)
                    .filter(|(h, _)| !h.is_zero())
                    .fold(biases[o].into(), |sum: FixedPointInterval, (h, &weight)| {
                        sum + h.clone() * weight.into()
                    })
            };
            return (0..*outputs).map(order).collect();
        }
        NetworkLayer::Activation(each) => each,
    };
    let unit = || FixedPointInterval::from(1.0);
    let zero = FixedPointInterval::zero();
    let scaled = |(number, x): (usize, FixedPointInterval)| {
        let bent = |below: &dyn Fn(&FixedPointInterval) -> FixedPointInterval| {
            let above = x.max(&zero);
            match x.is_below(&zero) {
                Ok(true) => below(&x),
                Ok(false) => above,
                Err(TooClose) => above.hull(&below(&x.min(&zero))),
            }
        };
        match each {
            Activation::Relu => bent(&|_| zero.clone()),
            Activation::LeakyRelu(slope) => bent(&|x| x.clone() * (*slope).into()),
            Activation::Elu(alpha) => bent(&|x| (x.exp() - unit()) * (*alpha).into()),
            Activation::Tanh => x.tanh(),
            // 1 / (1 + e⁻ˣ) = (1 + tanh(x/2)) / 2.
            Activation::Sigmoid => ((x * 0.5.into()).tanh() + unit()) * 0.5.into(),
            Activation::Add(operands) => x + operands[number].into(),
            Activation::Multiply(operands) => x * operands[number].into(),
            Activation::Divide(operands) => x.over(&operands[number].into()),
            Activation::Clip { low, high } => x.clamp(low[number], high[number]),
        }
    };
    h.into_iter().enumerate().map(scaled).collect()
}

fn idm_acceleration(law: &IdmLaw, [gap, v, ahead]: [&FixedPointInterval; 3]) -> FixedPointInterval {
    let fixed = |number: f64| FixedPointInterval::from(number);
    let closing = v.clone() - ahead.clone();
    let mean = (fixed(law.accel_mps2) * fixed(law.comfortable_brake_mps2)).sqrt();
    let dynamic =
        v.clone() * fixed(law.time_headway_s) + (v.clone() * closing).over(&(fixed(2.0) * mean));
    let gap_wanted = fixed(law.standstill_gap_m) + dynamic.max(&FixedPointInterval::zero());
    let share = gap_wanted.over(&gap.max(&fixed(0.01)));
    let part = v.over(&fixed(law.desired_speed_mps));
    let squared = |number: FixedPointInterval| number.clone() * number;
    fixed(law.accel_mps2) * (fixed(1.0) - squared(squared(part)) - squared(share))
}

/// Returns the command of a law for gap, own speed and ego speed, clipped to the vehicle's limits.
fn law_acceleration(
    law: &FollowerLaw,
    brake: &FixedPointInterval,
    [gap, v, ahead]: [&FixedPointInterval; 3],
) -> Result<FixedPointInterval, TooClose> {
    let fixed = |number: f64| FixedPointInterval::from(number);
    let closing = v.clone() - ahead.clone();
    let (wanted, most) = match law {
        FollowerLaw::Idm(law) => (idm_acceleration(law, [gap, v, ahead]), law.max_accel_mps2),
        FollowerLaw::AccAeb(acc) if gap.is_below(&(fixed(acc.ttc_s) * closing.clone()))? => {
            (-brake.clone(), acc.max_accel_mps2)
        }
        FollowerLaw::AccAeb(acc) => {
            let gain = fixed(acc.speed_gain_per_s);
            let limit = match acc.set_speed_mps {
                Some(set_speed) => gain.clone() * (fixed(set_speed) - v.clone()),
                None => {
                    (gain.clone() * (fixed(2.0) - closing.clone())).max(&FixedPointInterval::zero())
                }
            };
            let spacing =
                gap.clone() - fixed(acc.standstill_gap_m) - fixed(acc.time_headway_s) * v.clone();
            let follow = fixed(acc.gap_gain_per_s2) * spacing - gain * closing;
            let comfortable = limit
                .min(&follow)
                .clamp(-acc.comfort_brake_mps2, acc.comfort_accel_mps2);
            (comfortable, acc.max_accel_mps2)
        }
    };
    Ok(wanted.max(&-brake.clone()).min(&fixed(most)))
}

struct StepMotion {
    covered_m: [FixedPointInterval; 2],
    speed_mps: FixedPointInterval,
    held_mps2: FixedPointInterval,
}

fn advance(
    speed: &FixedPointInterval,
    wanted: &FixedPointInterval,
    step: &FixedPointInterval,
) -> Result<StepMotion, TooClose> {
    let is_idle = speed.is_zero() && !FixedPointInterval::zero().is_below(wanted)?;
    let held = if is_idle {
        FixedPointInterval::zero()
    } else {
        wanted.clone()
    };
    let after = |time: FixedPointInterval| {
        let end = speed.clone() + held.clone() * time.clone();
        // A vehicle that stops in time covers v²/(2b).
        let stops = !held.is_zero() && end.is_below(&FixedPointInterval::zero())?;
        let covered = if stops {
            (speed.clone() * speed.clone()).over(&(held.clone() * (-2.0).into()))
        } else {
            (speed.clone() + end.clone()) * time * 0.5.into()
        };
        Ok((
            covered,
            if stops {
                FixedPointInterval::zero()
            } else {
                end
            },
        ))
    };
    let (half, _) = after(step.clone() * 0.5.into())?;
    let (covered, speed_mps) = after(step.clone())?;
    Ok(StepMotion {
        covered_m: [half, covered],
        speed_mps,
        held_mps2: held,
    })
}

/// Returns the true state at each decision, the last instant included, and the smallest gaps at any half step. Fails
/// with [`TooClose`] if the precision does not decide a comparison or falls below 10⁻²⁰. Observations are off by
/// `error(decision)`; the leader brakes at `brake(k)` of its script, or as scripted.
pub fn simulate_exactly(
    scene: &ReachProblem<'_>,
    start: ReachPoint,
    error: impl Fn(usize) -> [f64; 8],
    brake: Option<&dyn Fn(u32) -> f64>,
) -> Result<(Vec<[FixedPointInterval; 8]>, [FixedPointInterval; 2]), TooClose> {
    let ReachProblem {
        controller,
        follower,
        steps,
        decision_steps: every,
        ..
    } = *scene;
    let [
        mut ahead,
        mut behind,
        mut v_l,
        mut v_e,
        mut v_r,
        brake_l,
        brake_r,
        onset,
    ] = start.map(FixedPointInterval::from);
    let step = FixedPointInterval::from(scene.step_s);
    let zero = FixedPointInterval::zero;
    let (mut a_l, mut a_e, mut a_r, mut answer, mut fired) =
        (zero(), zero(), zero(), zero(), false);
    let (mut trace, mut least) = (Vec::new(), [ahead.clone(), behind.clone()]);
    for k in 0..=steps {
        let seen = match follower {
            Some(_) => {
                [&ahead, &behind, &v_l, &v_e, &v_r, &a_l, &a_e, &a_r].map(FixedPointInterval::clone)
            }
            None => [
                ahead.clone(),
                controller.empty_gap_m.into(),
                v_l.clone(),
                v_e.clone(),
                v_e.clone(),
                a_l.clone(),
                a_e.clone(),
                zero(),
            ],
        };
        if seen.iter().any(FixedPointInterval::is_too_wide) {
            return Err(TooClose);
        }
        if k % every == 0 {
            let error = error(trace.len());
            let observed = std::array::from_fn(|i| seen[i].clone() + error[i].into());
            answer = controller_output(controller, &observed, follower.is_some());
            trace.push(seen.clone());
        }
        let wants_r = match follower {
            Some(FollowerModel::Latched { ttc_s }) => {
                fired = fired || behind.is_below(&((v_r.clone() - v_e.clone()) * ttc_s.into()))?;
                if fired { -brake_r.clone() } else { zero() }
            }
            Some(FollowerModel::ByLaw(law)) => {
                law_acceleration(&law, &brake_r, [&behind, &v_r, &v_e])?
            }
            None => zero(),
        };
        let brakes = match brake {
            Some(brake) => brake(k).into(),
            // The mean over the step of the onset.
            None => {
                brake_l.clone()
                    * (FixedPointInterval::from(f64::from(k) + 1.0)
                        - onset.max(&f64::from(k).into()))
                    .max(&zero())
            }
        };
        let leader = advance(&v_l, &-brakes, &step)?;
        let ego = advance(&v_e, &answer, &step)?;
        let behind_it = advance(&v_r, &wants_r, &step)?;
        if k < steps {
            for index in [0, 1] {
                let [l, e, r] =
                    [&leader, &ego, &behind_it].map(|moved| moved.covered_m[index].clone());
                let gaps = [ahead.clone() + l - e.clone(), behind.clone() + e - r];
                least = std::array::from_fn(|pair| least[pair].min(&gaps[pair]));
            }
        }
        let [covered_l, covered_e, covered_r] =
            [&leader, &ego, &behind_it].map(|moved| moved.covered_m[1].clone());
        ahead = ahead + covered_l - covered_e.clone();
        behind = behind + covered_e - covered_r;
        (v_l, v_e, v_r) = (leader.speed_mps, ego.speed_mps, behind_it.speed_mps);
        (a_l, a_e, a_r) = (leader.held_mps2, ego.held_mps2, behind_it.held_mps2);
    }
    Ok((trace, least))
}
