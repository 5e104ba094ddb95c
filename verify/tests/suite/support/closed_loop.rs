//! A simulation of the closed loop in a few lines, sharing nothing with the crate but the description of the network.

use crumple_verify::reach::{Actor, Layer, Scene};

/// Gap ahead, gap behind, speeds of leader, ego and follower, brakes of leader and follower, onset in steps.
pub type Start = [f64; 8];

/// The network as it is deployed: single precision, products added up in order.
pub fn act(actor: &Actor, seen: [f64; 8]) -> f64 {
    let mut h: Vec<f32> = (0..8)
        .map(|i| ((seen[i] - actor.offset[i]) / actor.scale[i]).clamp(-actor.limit, actor.limit) as f32)
        .collect();
    for (index, Layer { outputs, weights, biases, .. }) in actor.layers.iter().enumerate() {
        let mut sums: Vec<f32> = biases.iter().map(|&bias| bias as f32).collect();
        for (value, row) in h.iter().zip(weights.chunks(*outputs)) {
            for (sum, &weight) in sums.iter_mut().zip(row) {
                *sum += value * weight as f32;
            }
        }
        if index + 1 < actor.layers.len() {
            sums.iter_mut().for_each(|sum| *sum = sum.max(0.0));
        }
        h = sums;
    }
    let [low, high] = actor.action_mps2;
    0.5 * (low + high) + 0.5 * (high - low) * f64::from(h[0].tanh())
}

fn step(v: f64, a: f64, h: f64) -> (f64, f64) {
    let end = v + a * h;
    if end < 0.0 { (v * v / (-2.0 * a), 0.0) } else { (v * h + 0.5 * a * h * h, end) }
}

/// Everything observed at each decision, the last instant included, and the smallest gaps at any step. Nobody minds contact.
pub fn simulate(scene: &Scene<'_>, start: Start) -> (Vec<[f64; 8]>, [f64; 2]) {
    let Scene { actor, follower_ttc_s: ttc_s, steps, decision_steps: every, step_s: h, .. } = *scene;
    let [mut ahead, mut behind, mut v_l, mut v_e, mut v_r, brake_l, brake_r, onset] = start;
    let (mut a_l, mut a_e, mut a_r, mut wanted, mut fired) = (0.0, 0.0, 0.0, 0.0, false);
    let (mut trace, mut least) = (Vec::new(), [ahead, behind]);
    for k in 0..=steps {
        let seen = match ttc_s {
            Some(_) => [ahead, behind, v_l, v_e, v_r, a_l, a_e, a_r],
            None => [ahead, actor.empty_gap_m, v_l, v_e, v_e, a_l, a_e, 0.0],
        };
        if k % every == 0 {
            trace.push(seen);
            wanted = act(actor, seen);
        }
        fired |= ttc_s.is_some_and(|ttc_s| behind - ttc_s * (v_r - v_e) < 0.0);
        let share = (f64::from(k) + 1.0 - onset.max(f64::from(k))).max(0.0);
        let held = |v: f64, a: f64| if v == 0.0 && a <= 0.0 { 0.0 } else { a };
        a_l = held(v_l, -brake_l * share);
        a_e = held(v_e, wanted);
        a_r = held(v_r, if fired { -brake_r } else { 0.0 });
        let (moved_l, moved_e, moved_r);
        (moved_l, v_l) = step(v_l, a_l, h);
        (moved_e, v_e) = step(v_e, a_e, h);
        (moved_r, v_r) = step(v_r, a_r, h);
        ahead += moved_l - moved_e;
        behind += moved_e - moved_r;
        if k < steps {
            least = [least[0].min(ahead), if ttc_s.is_some() { least[1].min(behind) } else { least[1] }];
        }
    }
    (trace, least)
}

/// Pseudo-random numbers, the same everywhere.
pub struct Numbers(pub u64);

impl Numbers {
    /// From 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// From -1 to 1.
    pub fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }
}
