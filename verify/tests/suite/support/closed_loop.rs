//! A short simulation of the closed loop that shares only the description of the network with the crate.

use crumple_verify::reach::{
    Activation, ControllerInput, FollowerLaw, FollowerModel, IdmLaw, LinearLayer, NetworkLayer,
    NeuralController, ReachProblem,
};
use num_traits::Float;

/// Gap ahead, gap behind, speeds of leader, ego and follower, brakes of leader and follower, onset in steps.
pub type ReachPoint = [f64; 8];

/// Returns the acceleration or action in single precision. Products are added in order and rounded separately, while
/// the engine fuses them: bounds cover either.
pub fn controller_output(controller: &NeuralController, seen: [f64; 8], is_followed: bool) -> f64 {
    let input = |input: &ControllerInput| {
        let sum = input
            .coefficients
            .iter()
            .zip(seen)
            .map(|(factor, number)| factor * number)
            .sum::<f64>()
            + input.constant;
        let value = input.absent_value.filter(|_| !is_followed).unwrap_or(sum);
        ((value - input.offset) / input.scale).clamp(input.low, input.high) as f32
    };
    let answers = network_outputs(
        &controller.layers,
        controller.inputs.iter().map(input).collect::<Vec<f32>>(),
    );
    let wanted = controller.offset_mps2
        + controller.scale_mps2 * f64::from(answers[controller.output_index]);
    if controller.is_clipped {
        wanted.clamp(
            controller.action_bounds_mps2[0],
            controller.action_bounds_mps2[1],
        )
    } else {
        wanted
    }
}

/// Evaluates a network in the precision of its inputs.
pub fn network_outputs<T: Float>(layers: &[NetworkLayer], inputs: Vec<T>) -> Vec<T> {
    layers.iter().fold(inputs, apply_layer)
}

fn apply_layer<T: Float>(mut h: Vec<T>, step: &NetworkLayer) -> Vec<T> {
    let number_from = |number: f64| T::from(number).unwrap();
    let each = match step {
        NetworkLayer::Linear(LinearLayer {
            outputs,
            weights,
            biases,
            ..
        }) => {
            let mut sums: Vec<T> = biases.iter().map(|&bias| number_from(bias)).collect();
            for (value, row) in h.iter().zip(weights.chunks(*outputs)) {
                for (sum, &weight) in sums.iter_mut().zip(row) {
                    *sum = *sum + *value * number_from(weight);
                }
            }
            return sums;
        }
        NetworkLayer::Activation(each) => each,
    };
    for (number, x) in h.iter_mut().enumerate() {
        *x = match each {
            Activation::Relu => x.max(T::zero()),
            Activation::LeakyRelu(slope) if *x < T::zero() => number_from(*slope) * *x,
            Activation::Elu(alpha) if *x < T::zero() => number_from(*alpha) * x.exp_m1(),
            Activation::LeakyRelu(_) | Activation::Elu(_) => *x,
            Activation::Tanh => x.tanh(),
            Activation::Sigmoid => T::one() / (T::one() + (-*x).exp()),
            Activation::Add(operands) => *x + number_from(operands[number]),
            Activation::Multiply(operands) => *x * number_from(operands[number]),
            Activation::Divide(operands) => *x / number_from(operands[number]),
            Activation::Clip { low, high } => x
                .max(number_from(low[number]))
                .min(number_from(high[number])),
        };
    }
    h
}

fn advance(v: f64, a: f64, h: f64) -> (f64, f64) {
    let end = v + a * h;
    if end < 0.0 {
        (v * v / (-2.0 * a), 0.0)
    } else {
        (v * h + 0.5 * a * h * h, end)
    }
}

fn idm_acceleration(idm: &IdmLaw, [gap, v, ahead]: [f64; 3]) -> f64 {
    let mean = (idm.accel_mps2 * idm.comfortable_brake_mps2).sqrt();
    let dynamic = v * idm.time_headway_s + v * (v - ahead) / (2.0 * mean);
    let share = (idm.standstill_gap_m + dynamic.max(0.0)) / gap.max(0.01);
    let free = 1.0 - (v / idm.desired_speed_mps).powi(4);
    idm.accel_mps2 * (free - share * share)
}

/// Returns the command of a law for gap, own speed and ego speed, clipped to the vehicle's limits.
fn law_acceleration(law: &FollowerLaw, brake: f64, [gap, v, ahead]: [f64; 3]) -> f64 {
    let (wanted, most) = match law {
        FollowerLaw::Idm(law) => (idm_acceleration(law, [gap, v, ahead]), law.max_accel_mps2),
        FollowerLaw::AccAeb(acc) if gap < acc.ttc_s * (v - ahead) => {
            (f64::NEG_INFINITY, acc.max_accel_mps2)
        }
        FollowerLaw::AccAeb(acc) => {
            let limit = match acc.set_speed_mps {
                Some(set_speed) => acc.speed_gain_per_s * (set_speed - v),
                None => (acc.speed_gain_per_s * (ahead + 2.0 - v)).max(0.0),
            };
            let spacing = gap - acc.standstill_gap_m - acc.time_headway_s * v;
            let follow = acc.gap_gain_per_s2 * spacing + acc.speed_gain_per_s * (ahead - v);
            let comfortable = limit
                .min(follow)
                .max(-acc.comfort_brake_mps2)
                .min(acc.comfort_accel_mps2);
            (comfortable, acc.max_accel_mps2)
        }
    };
    wanted.max(-brake).min(most)
}

/// Returns the observations at each decision, the last instant included, and the smallest gaps at any step. Goes on
/// after collisions.
pub fn simulate(scene: &ReachProblem<'_>, start: ReachPoint) -> (Vec<[f64; 8]>, [f64; 2]) {
    simulate_with_leader(scene, start, scripted_braking(&start))
}

/// Returns the scripted braking per step, with the mean over the step of the onset.
pub fn scripted_braking(&[.., brake, _, onset]: &ReachPoint) -> impl Fn(u32) -> f64 {
    move |k| brake * (f64::from(k) + 1.0 - onset.max(f64::from(k))).max(0.0)
}

pub fn simulate_with_leader(
    scene: &ReachProblem<'_>,
    start: ReachPoint,
    brake_l: impl Fn(u32) -> f64,
) -> (Vec<[f64; 8]>, [f64; 2]) {
    simulate_with_errors(scene, start, brake_l, |_| [0.0; 8])
}

/// Simulates a leader with a given braking per step, and observation errors that hold until the next decision.
pub fn simulate_with_errors(
    scene: &ReachProblem<'_>,
    start: ReachPoint,
    brake_l: impl Fn(u32) -> f64,
    error: impl Fn(u32) -> [f64; 8],
) -> (Vec<[f64; 8]>, [f64; 2]) {
    let ReachProblem {
        controller,
        follower,
        steps,
        decision_steps: every,
        step_s: h,
        ..
    } = *scene;
    let [
        mut ahead,
        mut behind,
        mut v_l,
        mut v_e,
        mut v_r,
        _,
        brake_r,
        _,
    ] = start;
    let (mut a_l, mut a_e, mut a_r, mut answer, mut fired) = (0.0, 0.0, 0.0, 0.0, false);
    let (mut trace, mut least) = (Vec::new(), [ahead, behind]);
    for k in 0..=steps {
        let seen = match follower {
            Some(_) => [ahead, behind, v_l, v_e, v_r, a_l, a_e, a_r],
            None => [ahead, controller.empty_gap_m, v_l, v_e, v_e, a_l, a_e, 0.0],
        };
        if k % every == 0 {
            trace.push(seen);
            let error = error(k / every);
            answer = controller_output(
                controller,
                std::array::from_fn(|i| seen[i] + error[i]),
                follower.is_some(),
            );
        }
        let wanted_r = match follower {
            Some(FollowerModel::Latched { ttc_s }) => {
                fired |= behind - ttc_s * (v_r - v_e) < 0.0;
                if fired { -brake_r } else { 0.0 }
            }
            Some(FollowerModel::ByLaw(law)) => law_acceleration(&law, brake_r, [behind, v_r, v_e]),
            None => 0.0,
        };
        let held = |v: f64, a: f64| if v == 0.0 && a <= 0.0 { 0.0 } else { a };
        a_l = held(v_l, -brake_l(k));
        a_e = held(v_e, answer);
        a_r = held(v_r, wanted_r);
        let (moved_l, moved_e, moved_r);
        (moved_l, v_l) = advance(v_l, a_l, h);
        (moved_e, v_e) = advance(v_e, a_e, h);
        (moved_r, v_r) = advance(v_r, a_r, h);
        ahead += moved_l - moved_e;
        behind += moved_e - moved_r;
        if k < steps {
            least = [
                least[0].min(ahead),
                if follower.is_some() {
                    least[1].min(behind)
                } else {
                    least[1]
                },
            ];
        }
    }
    (trace, least)
}

/// A pseudo-random number generator that is equal on all platforms.
pub struct XorShiftRng(pub u64);

impl XorShiftRng {
    /// Creates an independent generator for an index.
    pub fn for_index(seed: u64, index: u32) -> Self {
        let mut numbers =
            Self((seed ^ (u64::from(index) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)) | 1);
        numbers.next_unit();
        numbers
    }

    pub fn next_unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn next_signed(&mut self) -> f64 {
        2.0 * self.next_unit() - 1.0
    }
}
