//! Deep deterministic policy gradient (Lillicrap et al. 2015, algorithm 1) in single precision.
//!
//! Critic: minimise the mean of (Q(s, a) - y)² with y = r + γ Q'(s', π'(s')), and y = r after a termination.
//! Actor: maximise the mean of Q(s, π(s)). The targets Q', π' follow by soft update.
//! Options of TD3 (Fujimoto, van Hoof and Meger 2018): the smaller of two critics, noise on π'(s'), delayed actor.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::adam::Adam;
use super::backprop::Tape;
use super::config::{LearningConfig, NetworkConfig, Td3Config, TrainingConfig};
use super::imitation::{ImitationBatch, ImitationConfig, ImitationLoss};
use super::replay::{Batch, NO_EXPERT_ACTION};
use crumple_sim::policy::{Network, with_workers};
use crumple_sim::random::{self, Purpose, Stream};

/// Network with its target network and its optimiser.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainableNetwork {
    /// Network that is trained.
    pub network: Network,
    /// Target network.
    pub target: Network,
    /// Optimiser of the network.
    pub adam: Adam,
}

impl TrainableNetwork {
    /// Performs a step of the optimiser. With `tau`, the target follows the network by this share.
    fn descend(&mut self, gradients: &[f32], rate: f32, tau: Option<f32>) {
        let follow = tau.map(|tau| (self.target.parameters_mut(), tau));
        self.adam
            .step(self.network.parameters_mut(), gradients, rate, follow);
    }

    /// Creates network `index` of a training, with initial weights from `seed`.
    fn from_seed(config: &NetworkConfig, inputs: usize, seed: u64, index: u64) -> Self {
        let sizes = [&[inputs], config.hidden.as_slice(), &[1]].concat();
        let mut stream = random::stream(seed, Purpose::InitialWeights, index);
        Self::new(init_network(&sizes, config.final_layer_bound, &mut stream))
    }

    fn new(network: Network) -> Self {
        Self {
            target: network.clone(),
            adam: Adam::new(network.parameters().len()),
            network,
        }
    }
}

/// Actor and critics in training.
#[derive(Debug, Clone)]
pub struct Learner {
    /// π, before its tanh.
    pub actor: TrainableNetwork,
    /// Q, or Q₁ and Q₂.
    pub critics: Vec<TrainableNetwork>,
    /// Number of updates.
    pub updates: u64,
    state_width: usize,
    pub(super) lr_factor: f32,
    /// Weight of the mean squared difference to the expert's actions in the actor's loss.
    pub(super) imitation_weight: f32,
    /// True if only the critics learn.
    pub(super) is_actor_frozen: bool,
    learning: LearningConfig,
    td3: Td3Config,
    workspace: UpdateWorkspace,
}

#[derive(Debug, Clone, Default)]
struct UpdateWorkspace {
    actor: Tape,
    critic: Tape,
    target: Tape,
    actions: Vec<f32>,
    td_targets: Vec<f32>,
    value_gradients: Vec<f32>,
    actor_gradients: Vec<f32>,
    critic_gradients: Vec<f32>,
}

/// Losses of an update.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Losses {
    /// Mean squared error of the (first) critic.
    pub critic_loss: f64,
    /// Mean value of the batch.
    pub mean_value: f64,
}

impl Learner {
    pub(super) fn networks(&self) -> impl Iterator<Item = &Network> {
        std::iter::once(&self.actor)
            .chain(&self.critics)
            .flat_map(|part| [&part.network, &part.target])
    }

    /// Creates networks with initial weights from `seed`.
    #[must_use]
    pub fn new(config: &TrainingConfig, seed: u64) -> Self {
        let TrainingConfig {
            network,
            learning,
            td3,
            ..
        } = config;
        let inputs = config.environment.observation.width();
        let critics = if td3.twin_critic { 2 } else { 1 };
        Self {
            actor: TrainableNetwork::from_seed(network, inputs, seed, 0),
            critics: (1..=critics)
                .map(|index| {
                    let inputs = inputs + learning.privileged_width() + 1;
                    TrainableNetwork::from_seed(network, inputs, seed, index)
                })
                .collect(),
            updates: 0,
            state_width: inputs,
            lr_factor: 1.0,
            imitation_weight: 0.0,
            is_actor_frozen: false,
            learning: learning.clone(),
            td3: td3.clone(),
            workspace: UpdateWorkspace::default(),
        }
    }

    /// Returns the actions, in `[-1, 1]`, for observations row after row.
    pub fn act(&mut self, states: &[f32]) -> &[f32] {
        let UpdateWorkspace { actor, actions, .. } = &mut self.workspace;
        let batch = states.len() / self.state_width;
        let raw = actor.forward(&self.actor.network, batch, |input| {
            input.extend_from_slice(states)
        });
        squash_actions(raw, actions);
        actions
    }

    /// Performs one update on a batch. `noise` is the source of target smoothing.
    pub fn update(&mut self, batch: &Batch, noise: &mut Stream) -> Losses {
        let widest = self
            .networks()
            .flat_map(Network::layers)
            .map(|layer| layer.inputs * layer.outputs)
            .max();
        with_workers(batch.len() * widest.unwrap_or(0), || {
            self.step(batch, noise)
        })
    }

    fn step(&mut self, batch: &Batch, noise: &mut Stream) -> Losses {
        self.compute_td_targets(batch, noise);
        let actor_is_due = (self.updates + 1).is_multiple_of(u64::from(self.td3.actor_every));
        let mut losses = Losses::default();
        for index in 0..self.critics.len() {
            let critic_losses = self.compute_critic_gradient(index, batch);
            self.critics[index].descend(
                &self.workspace.critic_gradients,
                self.lr_factor * self.learning.critic_rate,
                actor_is_due.then_some(self.learning.tau),
            );
            if index == 0 {
                losses = critic_losses;
            }
        }
        if actor_is_due && !self.is_actor_frozen {
            self.compute_actor_gradient(batch);
            self.actor.descend(
                &self.workspace.actor_gradients,
                self.lr_factor * self.learning.actor_rate,
                Some(self.learning.tau),
            );
        }
        self.updates += 1;
        losses
    }

    fn compute_td_targets(&mut self, batch: &Batch, noise: &mut Stream) {
        let UpdateWorkspace {
            target,
            actions,
            td_targets,
            ..
        } = &mut self.workspace;
        let raw = target.forward(&self.actor.target, batch.len(), |input| {
            input.extend_from_slice(&batch.next_states)
        });
        squash_actions(raw, actions);
        if self.td3.target_noise > 0.0 {
            add_target_noise(&self.td3, actions, noise);
        }
        for (index, critic) in self.critics.iter().enumerate() {
            let values = target.forward(&critic.target, batch.len(), |input| {
                fill_critic_input([&batch.next_states, &batch.next_privileged], actions, input)
            });
            if index == 0 {
                td_targets.clear();
                td_targets.extend_from_slice(values);
            } else {
                td_targets
                    .iter_mut()
                    .zip(values)
                    .for_each(|(goal, &value)| *goal = goal.min(value));
            }
        }
        let discount = self.learning.discount as f32;
        for ((goal, &reward), &continues) in td_targets
            .iter_mut()
            .zip(&batch.rewards)
            .zip(&batch.continues)
        {
            *goal = reward + discount * continues * *goal;
        }
    }

    /// Computes the gradient of the mean squared error of critic `index`, with the targets in `td_targets`.
    fn compute_critic_gradient(&mut self, index: usize, batch: &Batch) -> Losses {
        let UpdateWorkspace {
            critic: tape,
            td_targets,
            value_gradients,
            critic_gradients,
            ..
        } = &mut self.workspace;
        let network = &self.critics[index].network;
        let values = tape.forward(network, batch.len(), |input| {
            fill_critic_input([&batch.states, &batch.privileged], &batch.actions, input)
        });
        let n = batch.len() as f64;
        let mut losses = Losses::default();
        value_gradients.clear();
        for (&value, &goal) in values.iter().zip(td_targets.iter()) {
            let error = value - goal;
            losses.critic_loss += f64::from(error * error) / n;
            losses.mean_value += f64::from(value) / n;
            value_gradients.push(2.0 * error / batch.len() as f32);
        }
        critic_gradients.resize(network.parameters().len(), 0.0);
        tape.backward(network, value_gradients, critic_gradients);
        losses
    }

    /// Performs a step of the actor towards the expert's actions; returns the sum of the losses.
    pub(super) fn imitate(
        &mut self,
        batch: &ImitationBatch,
        imitation: &ImitationConfig,
        adam: &mut Adam,
        rate: f32,
    ) -> f64 {
        let sum = self.compute_imitation_gradient(batch, imitation);
        let network = &mut self.actor.network;
        adam.step(
            network.parameters_mut(),
            &self.workspace.actor_gradients,
            rate,
            None,
        );
        sum
    }

    /// Computes the gradient of the mean over the batch of
    ///
    /// w (loss(π(s) - e) + hard · max(0, h - π(s))² + change · ((π(s') - π(s)) - (e' - e))²),
    ///
    /// with the row's weight w, the expert's actions e, and the row's least action h that is not hard braking. Returns
    /// the sum over the rows of the batch instead of the mean.
    fn compute_imitation_gradient(
        &mut self,
        batch: &ImitationBatch,
        imitation: &ImitationConfig,
    ) -> f64 {
        let n = batch.actions.len() as f32;
        self.act(&batch.states);
        let UpdateWorkspace {
            actor,
            actions,
            value_gradients,
            actor_gradients,
            ..
        } = &mut self.workspace;
        let (actions, next_actions) = actions.split_at(batch.actions.len());
        value_gradients.clear();
        let mut sum = 0.0;
        let hard_weight = imitation.hard_brake_weight;
        let wanted = batch
            .actions
            .iter()
            .zip(&batch.weights)
            .zip(&batch.hard_actions);
        for (&action, ((&wanted, &weight), &hard)) in actions.iter().zip(wanted) {
            let off = action - wanted;
            let (mut cost, mut slope) = match imitation.loss {
                ImitationLoss::Squared => (off * off, 2.0 * off),
                ImitationLoss::Absolute => (off.abs(), if off == 0.0 { 0.0 } else { off.signum() }),
            };
            let excess = (hard - action).max(0.0);
            cost += hard_weight * excess * excess;
            slope -= 2.0 * hard_weight * excess;
            sum += f64::from(weight * cost);
            value_gradients.push(weight * slope / n * (1.0 - action * action));
        }
        for (row, (&next, &next_wanted)) in next_actions.iter().zip(&batch.next_actions).enumerate()
        {
            let action = actions[row];
            let error = (next - action) - (next_wanted - batch.actions[row]);
            let weight = imitation.change_weight * batch.weights[row];
            sum += f64::from(weight * error * error);
            let slope = 2.0 * weight * error / n;
            value_gradients[row] -= slope * (1.0 - action * action);
            value_gradients.push(slope * (1.0 - next * next));
        }
        actor_gradients.resize(self.actor.network.parameters().len(), 0.0);
        actor.backward(&self.actor.network, value_gradients, actor_gradients);
        sum
    }

    /// Computes the gradient of the actor's loss, -mean Q(s, π(s)) + penalty · mean max(0, |z| - 1)² + smoothness ·
    /// mean (π(s) - π(s'))² + imitation · mean (π(s) - e)², with the expert's actions e.
    fn compute_actor_gradient(&mut self, batch: &Batch) {
        let n = batch.len() as f32;
        // The actor is evaluated on the states, then on the next states.
        let smoothness = 2.0 * self.learning.smoothness_penalty / n;
        let next_states = if smoothness > 0.0 {
            batch.next_states.as_slice()
        } else {
            &[]
        };
        let UpdateWorkspace {
            actor,
            critic: tape,
            actions,
            value_gradients,
            actor_gradients,
            ..
        } = &mut self.workspace;
        let rows = (batch.states.len() + next_states.len()) / self.state_width;
        let raw = actor.forward(&self.actor.network, rows, |input| {
            input.extend_from_slice(&batch.states);
            input.extend_from_slice(next_states);
        });
        squash_actions(raw, actions);
        let (actions, next_actions) = actions.split_at(batch.len());
        let critic = &self.critics[0].network;
        tape.forward(critic, batch.len(), |input| {
            fill_critic_input([&batch.states, &batch.privileged], actions, input)
        });
        value_gradients.clear();
        value_gradients.resize(batch.len(), -1.0 / n);
        let mut by_action = vec![0.0; batch.len()];
        tape.backward_to_last_input(critic, value_gradients, &mut by_action);
        let penalty = 2.0 * self.learning.saturation_penalty / n;
        let outputs = actions.iter().zip(actor.output()).zip(&by_action);
        value_gradients.clear();
        value_gradients.extend(outputs.map(|((&action, &raw), &slope)| {
            slope * (1.0 - action * action) + penalty * (raw - raw.clamp(-1.0, 1.0))
        }));
        let imitation = 2.0 * self.imitation_weight / n;
        if imitation > 0.0 {
            add_imitation_gradient(value_gradients, actions, &batch.expert_actions, imitation);
        }
        let changes = actions.iter().zip(next_actions).zip(&batch.continues);
        for (row, ((&action, &next), &continues)) in changes.enumerate() {
            let pull = smoothness * continues * (action - next);
            value_gradients[row] += pull * (1.0 - action * action);
            value_gradients.push(-pull * (1.0 - next * next));
        }
        actor_gradients.resize(self.actor.network.parameters().len(), 0.0);
        actor.backward(&self.actor.network, value_gradients, actor_gradients);
    }

    /// Returns the gradients of each critic and of the actor without an update, for tests against other formulations.
    pub fn gradients(&mut self, batch: &Batch, noise: &mut Stream) -> (Vec<Vec<f32>>, Vec<f32>) {
        self.compute_td_targets(batch, noise);
        let mut critics = Vec::new();
        for index in 0..self.critics.len() {
            self.compute_critic_gradient(index, batch);
            critics.push(self.workspace.critic_gradients.clone());
        }
        self.compute_actor_gradient(batch);
        (critics, self.workspace.actor_gradients.clone())
    }
}

/// Adds target smoothing noise to actions.
fn add_target_noise(td3: &Td3Config, actions: &mut [f32], noise: &mut Stream) {
    let limit = td3.target_noise_limit;
    for action in actions {
        let normal: f32 = StandardNormal.sample(noise);
        *action = (*action + (td3.target_noise * normal).clamp(-limit, limit)).clamp(-1.0, 1.0);
    }
}

/// Adds the gradient of `weight`/2 (π(s) - e)² to that of the rows, with the expert's actions e.
fn add_imitation_gradient(
    gradients: &mut [f32],
    actions: &[f32],
    expert_actions: &[f32],
    weight: f32,
) {
    for ((slope, &action), &wanted) in gradients.iter_mut().zip(actions).zip(expert_actions) {
        // A row without an answer of the expert has no imitation gradient.
        let error = if wanted == NO_EXPERT_ACTION {
            0.0
        } else {
            action - wanted
        };
        *slope += weight * error * (1.0 - action * action);
    }
}

/// Maps outputs of an actor to actions in `[-1, 1]`.
fn squash_actions(raw: &[f32], actions: &mut Vec<f32>) {
    actions.clear();
    actions.extend(raw.iter().map(|&raw| libm::tanhf(raw)));
}

/// Writes the rows of states, privileged numbers and actions side by side.
fn fill_critic_input(states: [&[f32]; 2], actions: &[f32], input: &mut Vec<f32>) {
    let widths = states.map(|rows| rows.len() / actions.len().max(1));
    for (row, &action) in actions.iter().enumerate() {
        for (rows, width) in states.iter().zip(widths) {
            input.extend_from_slice(&rows[row * width..(row + 1) * width]);
        }
        input.push(action);
    }
}

/// Creates a network, uniform within 1/√(inputs); its last layer within `final_bound` unless that is 0.
fn init_network(sizes: &[usize], final_bound: f32, stream: &mut Stream) -> Network {
    let mut network = Network::zeros(sizes);
    let layers = network.layers();
    let last = layers.len() - 1;
    for (index, layer) in layers.enumerate() {
        let fan_in = (layer.inputs as f32).sqrt().recip();
        let bound = if index == last && final_bound > 0.0 {
            final_bound
        } else {
            fan_in
        };
        for parameter in &mut network.parameters_mut()[layer.offset..layer.biases().end] {
            *parameter = stream.random_range(-bound..=bound);
        }
    }
    network
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The gradient of imitation equals differences of its loss.
    #[test]
    fn imitation_follows_the_slope_of_its_loss() {
        let mut config = TrainingConfig::preset("fast").unwrap();
        config.network.hidden = vec![6, 5];
        config.network.final_layer_bound = 0.5;
        let imitation: &str = include_str!("tests/imitation.toml")
            .split_once("[imitation]")
            .unwrap()
            .1;
        let imitation: ImitationConfig = toml::from_str(imitation).unwrap();
        let mut learner = Learner::new(&config, 3);
        let mut stream = random::stream(5, Purpose::Exploration, 0);
        let mut numbers = |count: usize| -> Vec<f32> {
            (0..count).map(|_| stream.random_range(-1.0..1.0)).collect()
        };
        let batch = ImitationBatch {
            states: numbers(2 * 4 * learner.state_width),
            actions: numbers(4),
            next_actions: numbers(4),
            weights: vec![1.0, 3.0, 0.5, 2.0],
            hard_actions: vec![-1.0, 0.9, 0.8, 0.9],
        };
        for loss in [ImitationLoss::Squared, ImitationLoss::Absolute] {
            let imitation = ImitationConfig {
                loss,
                ..imitation.clone()
            };
            learner.compute_imitation_gradient(&batch, &imitation);
            let gradients = learner.workspace.actor_gradients.clone();
            for (index, &gradient) in gradients.iter().enumerate().step_by(7) {
                let mut at = |offset: f32| {
                    learner.actor.network.parameters_mut()[index] += offset;
                    let sum = learner.compute_imitation_gradient(&batch, &imitation);
                    learner.actor.network.parameters_mut()[index] -= offset;
                    sum / 4.0
                };
                let slope = (at(2e-3) - at(-2e-3)) / 4e-3;
                assert!(
                    (slope - f64::from(gradient)).abs() < 2e-3 * (1.0 + slope.abs()),
                    "{index}: {slope} {gradient}"
                );
            }
        }
    }
}
