//! Networks for benches of inference and training, and their matrix products.

use crumple_learn::rl::{Batch, Learner, Td3Config, TrainingConfig, Transition};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::{
    ActionBounds, Network, ObservationScaling, POLICY_VERSION, Policy, PolicyHeader, STATE_LEN,
};
use crumple_sim::random::{Purpose, stream};
use crumple_sim::scenario::PAPER_STEP_S;
use rand::RngExt;

/// Side of the matrix product that measures the machine's limit.
pub const LARGE_PRODUCT_SIZE: usize = 1024;

pub fn config(width: usize, batch: usize) -> TrainingConfig {
    let mut config = TrainingConfig::preset("paper-net").expect("a preset");
    config.network.hidden = vec![width; 3];
    config.learning.batch = batch;
    config
}

/// Returns a TD3 configuration: two critics, target smoothing, and an actor update in every update.
pub fn td3(width: usize, batch: usize) -> TrainingConfig {
    let mut config = config(width, batch);
    config.td3 = Td3Config {
        twin_critic: true,
        actor_every: 1,
        target_noise: 0.2,
        target_noise_limit: 0.5,
    };
    config
}

pub fn learner(config: &TrainingConfig) -> Learner {
    Learner::new(config, 1)
}

pub fn batch(count: usize) -> Batch {
    let mut stream = stream(1, Purpose::ReplaySampling, 0);
    let mut batch = Batch::default();
    for _ in 0..count {
        let mut seen =
            || -> [f32; STATE_LEN] { std::array::from_fn(|_| stream.random_range(-1.0..1.0)) };
        let (state, next_state) = (seen(), seen());
        let (action, reward) = (
            stream.random_range(-1.0..1.0),
            stream.random_range(-1.0..1.0),
        );
        batch.push(&Transition {
            state: &state,
            next_state: &next_state,
            privileged: &[],
            action,
            reward,
            continues: true,
            collision: false,
            expert_action: None,
        });
    }
    batch
}

/// Returns the matrix products of one update as (rows, inner, columns).
///
/// Forward: target actor, each target critic and critic, actor, first critic again. Backward: inputs and weights of
/// critics and actor, and the inputs of the first critic for the actor's gradient; the inputs of the first layers need
/// none. Output layers are matrix-vector products and not counted.
pub fn products(width: usize, count: usize, critics: usize) -> Vec<[usize; 3]> {
    let forward = |inputs: usize| {
        vec![
            [count, inputs, width],
            [count, width, width],
            [count, width, width],
        ]
    };
    let hidden_inputs = vec![[count, width, width]; 2];
    let weights = |inputs: usize| {
        vec![
            [inputs, count, width],
            [width, count, width],
            [width, count, width],
        ]
    };
    let (actor, critic) = (STATE_LEN, STATE_LEN + 1);
    let mut all = [
        forward(actor),
        forward(actor),
        forward(critic),
        hidden_inputs.clone(),
    ]
    .concat();
    all.extend([hidden_inputs.clone(), weights(actor)].concat());
    for _ in 0..critics {
        all.extend(
            [
                forward(critic),
                forward(critic),
                hidden_inputs.clone(),
                weights(critic),
            ]
            .concat(),
        );
    }
    all
}

pub fn operations(products: &[[usize; 3]]) -> usize {
    products.iter().map(|[m, k, n]| 2 * m * k * n).sum()
}

pub fn acting_operations(width: usize) -> usize {
    2 * (STATE_LEN * width + 2 * width * width)
}

/// Returns a learner whose actor computes little but one large product for [`LARGE_PRODUCT_SIZE`] states, with those
/// states and the number of operations.
pub fn large_product() -> (Learner, Vec<f32>, usize) {
    let mut config = config(LARGE_PRODUCT_SIZE, LARGE_PRODUCT_SIZE);
    config.network.hidden = vec![LARGE_PRODUCT_SIZE; 2];
    (
        learner(&config),
        vec![0.5; LARGE_PRODUCT_SIZE * STATE_LEN],
        operations(&[
            [LARGE_PRODUCT_SIZE, STATE_LEN, LARGE_PRODUCT_SIZE],
            [LARGE_PRODUCT_SIZE; 3],
        ]),
    )
}

pub fn random_policy(width: usize) -> Policy {
    let hidden = vec![width; 3];
    let mut network = Network::zeros(&[&[STATE_LEN], hidden.as_slice(), &[1]].concat());
    let mut stream = stream(1, Purpose::InitialWeights, 0);
    network
        .parameters_mut()
        .iter_mut()
        .for_each(|parameter| *parameter = stream.random_range(-0.1..0.1));
    let header = PolicyHeader {
        version: POLICY_VERSION,
        crumple: "bench".to_owned(),
        hidden,
        observation: ObservationScaling::default(),
        action: ActionBounds::default(),
        decision_interval_s: PAPER_STEP_S,
        estimator: EstimatorKind::Kalman,
        seed: 1,
        episode: 0,
        training: serde_json::Value::Null,
    };
    Policy::new(header, network).expect("valid")
}

/// Returns the reference policy (3 x 64) at four times the width: four copies of each hidden unit, each with a quarter
/// of the weight.
pub fn widened_reference(interval_s: f64) -> Policy {
    const COPIES: usize = 4;
    let reference = Policy::reference();
    let narrow = reference.network();
    let mut header = reference.header().clone();
    header.decision_interval_s = interval_s;
    header.hidden.iter_mut().for_each(|width| *width *= COPIES);
    let sizes = [&[STATE_LEN], header.hidden.as_slice(), &[1]].concat();
    let mut wide = Network::zeros(&sizes);
    let (mut from, mut to) = (0, 0);
    for (layer, pair) in narrow.sizes().windows(2).enumerate() {
        let (inputs, outputs) = (pair[0], pair[1]);
        let (wide_inputs, wide_outputs) = (sizes[layer], sizes[layer + 1]);
        let (in_copies, out_copies) = (wide_inputs / inputs, wide_outputs / outputs);
        for row in 0..wide_inputs {
            for column in 0..wide_outputs {
                let weight =
                    narrow.parameters()[from + row / in_copies * outputs + column / out_copies];
                wide.parameters_mut()[to + row * wide_outputs + column] = weight / in_copies as f32;
            }
        }
        (from, to) = (from + inputs * outputs, to + wide_inputs * wide_outputs);
        for column in 0..wide_outputs {
            wide.parameters_mut()[to + column] = narrow.parameters()[from + column / out_copies];
        }
        (from, to) = (from + outputs, to + wide_outputs);
    }
    Policy::new(header, wide).expect("valid")
}
