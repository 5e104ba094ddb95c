//! The adaptive cruise control benchmark of ARCH-COMP (category AINNCS): a public problem with other dynamics.
//!
//! x' = v, v' = γ, γ' = -2 γ + 2 a - 0.0001 v² for the lead and the own car; the lead car brakes at a = -2; the own car's a comes
//! from a network of five hidden layers of twenty rectifiers that sees (30, 1.4, v_ego, D_rel, v_rel) every 0.1 s. From x_lead in
//! [90, 110], v_lead in [32, 32.2], x_ego in [10, 11], v_ego in [30, 30.2], γ = 0, show D_rel ≥ 10 + 1.4 v_ego for 5 s.
//!
//! The benchmark's network is not ours to ship: one is fitted here, by least squares on its last layer, to
//! a = 0.05 (D_rel - 30 - 1.4 v_ego) + 0.7 v_rel between -3 and 1, a calm driver with 20 m to spare.

use crumple_verify::Interval;
use crumple_verify::reach::Layer;
use crumple_verify::reach::actor::answer;
use crumple_verify::reach::form::Form;
use crumple_verify::reach::relax::exp_minus;

const DRAG: f64 = 1e-4;
const PERIODS: usize = 50;

fn law(v_ego: f64, d_rel: f64, v_rel: f64) -> f64 {
    (0.05 * (d_rel - 30.0 - 1.4 * v_ego) + 0.7 * v_rel).clamp(-3.0, 1.0)
}

fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// Outputs of the last hidden layer, or of the network.
fn forward(layers: &[Layer], seen: [f64; 8], rectified: usize) -> Vec<f64> {
    layers.iter().enumerate().fold(seen.to_vec(), |h, (index, layer)| {
        let sum = |o: usize| {
            layer.biases[o] + h.iter().enumerate().map(|(i, h)| h * layer.weights[i * layer.outputs + o]).sum::<f64>()
        };
        (0..layer.outputs).map(|o| if index < rectified { sum(o).max(0.0) } else { sum(o) }).collect()
    })
}

/// Five inputs, and three that are always zero.
fn seen(v_ego: f64, d_rel: f64, v_rel: f64) -> [f64; 8] {
    [30.0, 1.4, v_ego, d_rel, v_rel, 0.0, 0.0, 0.0]
}

/// Random hidden layers in single precision, and the last layer that fits the law best.
fn fitted() -> Vec<Layer> {
    let mut state = 7;
    let scales = [30.0, 1.4, 30.0, 60.0, 10.0, 1.0, 1.0, 1.0];
    let mut layers: Vec<Layer> = (0..5)
        .map(|index| {
            let inputs = if index == 0 { 8 } else { 20 };
            let weight = |i: usize, state: &mut u64| {
                let scale = if index == 0 { scales[i % 8] * 1.3 } else { 2.0 };
                f64::from((random(state) / scale) as f32)
            };
            let weights = (0..inputs * 20).map(|k| weight(k / 20, &mut state)).collect();
            Layer {
                inputs,
                outputs: 20,
                weights,
                biases: (0..20).map(|_| f64::from((0.3 * random(&mut state)) as f32)).collect(),
            }
        })
        .collect();
    // Normal equations with a little damping, by Gauss and Jordan.
    let mut rows = vec![[0.0; 22]; 21];
    for _ in 0..4000 {
        let (v_ego, d_rel, v_rel) =
            (25.0 + 8.0 * random(&mut state), 65.0 + 45.0 * random(&mut state), -4.0 + 8.0 * random(&mut state));
        let h = [forward(&layers, seen(v_ego, d_rel, v_rel), 5), vec![1.0]].concat();
        let target = law(v_ego, d_rel, v_rel);
        for (row, own) in rows.iter_mut().zip(&h) {
            row.iter_mut().zip(&h).for_each(|(to, other)| *to += own * other);
            row[21] += own * target;
        }
    }
    rows.iter_mut().enumerate().for_each(|(i, row)| row[i] += 1e-3);
    for i in 0..21 {
        let pivot = rows[i];
        for (j, row) in rows.iter_mut().enumerate() {
            let factor = if j == i { 1.0 - 1.0 / pivot[i] } else { row[i] / pivot[i] };
            row.iter_mut().zip(pivot).for_each(|(to, from)| *to -= factor * from);
        }
    }
    let solved: Vec<f64> = rows.iter().map(|row| f64::from(row[21] as f32)).collect();
    layers.push(Layer { inputs: 20, outputs: 1, weights: solved[..20].to_vec(), biases: vec![solved[20]] });
    layers
}

#[derive(Clone)]
struct Car {
    x: Form,
    v: Form,
    gamma: Form,
}

impl Car {
    /// One period with a held command: exact for a constant input w = 2 a - 0.0001 v². All kernels are positive, so the drag's change
    /// within the period, at most 2 v |γ| T 0.0001, enters as an interval.
    fn after(&self, a: &Form) -> Self {
        let at = Interval::point;
        let t = at(0.1);
        let decay = exp_minus(0.2);
        let kernel_v = (Interval::ONE - decay) * at(0.5);
        let kernel_x = t * at(0.5) - (Interval::ONE - decay) * at(0.25);
        let mut w = a.scaled(at(2.0)).minus(&self.v.times(&self.v).scaled(at(DRAG)));
        let largest = |form: &Form| form.range().low().abs().max(form.range().high().abs());
        // |γ| never exceeds the larger of what it is and |w| / 2; twice that is taken.
        let gamma = 2.0 * largest(&self.gamma).max(0.5 * largest(&w)) + 0.1;
        w.widen(DRAG * 2.0 * (largest(&self.v) + gamma * 0.1) * gamma * 0.1);
        let mut after = self.clone();
        after.x.add(&self.v, t);
        after.x.add(&self.gamma, kernel_x);
        after.x.add(&w, (t.sqr() * at(0.5) - kernel_x) * at(0.5));
        after.v.add(&self.gamma, kernel_v);
        after.v.add(&w, (t - kernel_v) * at(0.5));
        after.gamma = self.gamma.scaled(decay);
        after.gamma.add(&w, kernel_v);
        after
    }
}

/// A plain simulation with a fine step.
fn simulated_margin(layers: &[Layer], [x_lead, v_lead, x_ego, v_ego]: [f64; 4]) -> f64 {
    let (mut lead, mut ego) = ([x_lead, v_lead, 0.0], [x_ego, v_ego, 0.0]);
    let mut least = f64::INFINITY;
    let mut a = 0.0;
    for step in 0..5000 {
        least = least.min(lead[0] - ego[0] - 10.0 - 1.4 * ego[1]);
        if step % 100 == 0 {
            a = forward(layers, seen(ego[1], lead[0] - ego[0], lead[1] - ego[1]), 5)[0];
        }
        for (car, a) in [(&mut lead, -2.0), (&mut ego, a)] {
            let [x, v, gamma] = *car;
            *car = [x + 1e-3 * v, v + 1e-3 * gamma, gamma + 1e-3 * (-2.0 * gamma + 2.0 * a - DRAG * v * v)];
        }
    }
    least
}

#[test]
fn the_whole_box_is_safe_at_once() {
    let layers = fitted();
    let begin = std::time::Instant::now();
    let symbol = |i: usize, low: f64, high: f64| Form::symbol(i, Interval::new(low, high).unwrap());
    let mut lead = Car { x: symbol(0, 90.0, 110.0), v: symbol(1, 32.0, 32.2), gamma: Form::default() };
    let mut ego = Car { x: symbol(2, 10.0, 11.0), v: symbol(3, 30.0, 30.2), gamma: Form::default() };
    let mut least = f64::INFINITY;
    for symbol in 4..4 + PERIODS {
        let d_rel = lead.x.clone().minus(&ego.x);
        let v_rel = lead.v.clone().minus(&ego.v);
        let [constant, headway] = [30.0, 1.4].map(|value| Form::constant(Interval::point(value)));
        let zero = Form::default;
        let inputs = [constant, headway, ego.v.clone(), d_rel.clone(), v_rel.clone(), zero(), zero(), zero()];
        let a = answer(&layers, &inputs).settled(symbol);
        let mut margin = d_rel;
        margin.add(&ego.v, Interval::point(-1.4));
        // Between two decisions the margin changes by no more than its rate at its largest.
        let rate = v_rel.range().low().abs().max(v_rel.range().high().abs()) + 1.4 * 6.0 + 1.0;
        least = least.min(margin.range().low() - 10.0 - 0.1 * rate);
        lead = lead.after(&Form::constant(Interval::point(-2.0)));
        ego = ego.after(&a);
        assert!(ego.gamma.radius() + ego.gamma.centre().abs() < 6.0, "the rate above covers it");
    }
    println!("margin at least {least:.2} m, in {:?}", begin.elapsed());
    assert!(least > 0.0, "{least}");
    let ends = [[90.0, 110.0], [32.0, 32.2], [10.0, 11.0], [30.0, 30.2]];
    for corner in 0..16_usize {
        let found = simulated_margin(&layers, std::array::from_fn(|i| ends[i][corner >> i & 1]));
        assert!(found >= least, "{found} {least}");
    }
}
