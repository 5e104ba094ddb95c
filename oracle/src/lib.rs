//! The update of [`Learner`] on candle's tensors and automatic differentiation, with the options of TD3.
//!
//! A slow reference: `tests/updates.rs` compares the results of [`Learner`] with it, and `benches/training.rs` the
//! speeds. A separate workspace member, because candle brings 66 packages that no other crate needs.

use candle_core::{DType, Device, Result, Tensor, Var};
use candle_nn::{AdamW, Linear, Module, Optimizer, ParamsAdamW};

use rand_distr::{Distribution, StandardNormal};

use crumple_learn::rl::{Batch, Learner, LearningConfig, Losses, Td3Config, TrainableNetwork};
use crumple_sim::policy::Network;
use crumple_sim::random::Stream;

/// Actor, critics and targets on candle.
pub struct ReferenceLearner {
    actor: NetworkWithTarget,
    critics: Vec<NetworkWithTarget>,
    learning: LearningConfig,
    td3: Td3Config,
    updates: u64,
}

struct NetworkWithTarget {
    network: Mlp,
    target: Mlp,
    optimiser: AdamW,
}

impl NetworkWithTarget {
    fn new(trained: &TrainableNetwork, rate: f32) -> Result<Self> {
        let network = Mlp::new(&trained.network)?;
        let params = ParamsAdamW {
            lr: f64::from(rate),
            weight_decay: 0.0,
            ..ParamsAdamW::default()
        };
        let optimiser = AdamW::new(network.vars.clone(), params)?;
        Ok(Self {
            network,
            target: Mlp::new(&trained.target)?,
            optimiser,
        })
    }
}

/// A network with ordered variables: weights and biases alternate.
struct Mlp {
    vars: Vec<Var>,
}

impl Mlp {
    /// candle's layers have one row per output, crumple's one row per input.
    fn new(network: &Network) -> Result<Self> {
        let mut vars = Vec::new();
        let mut rest = network.parameters();
        for sizes in network.sizes().windows(2) {
            let (weights, after) = rest.split_at(sizes[0] * sizes[1]);
            let (biases, after) = after.split_at(sizes[1]);
            rest = after;
            let weights = Tensor::from_slice(weights, (sizes[0], sizes[1]), &Device::Cpu)?
                .t()?
                .contiguous()?;
            vars.push(Var::from_tensor(&weights)?);
            vars.push(Var::from_slice(biases, sizes[1], &Device::Cpu)?);
        }
        Ok(Self { vars })
    }

    /// Returns the gradient of a loss in the order of the parameters.
    fn gradient(&self, loss: &Tensor) -> Result<Vec<f32>> {
        let gradients = loss.backward()?;
        self.flatten(|var| match gradients.get(var) {
            Some(gradient) => Ok(gradient.clone()),
            None => var.zeros_like(),
        })
    }

    fn forward(&self, input: &Tensor) -> Result<Tensor> {
        let mut value = input.clone();
        let layers = self.vars.chunks_exact(2);
        let last = layers.len() - 1;
        for (index, layer) in layers.enumerate() {
            let linear = Linear::new(
                layer[0].as_tensor().clone(),
                Some(layer[1].as_tensor().clone()),
            );
            value = linear.forward(&value)?;
            if index < last {
                value = value.relu()?;
            }
        }
        Ok(value)
    }

    fn polyak_update(&self, network: &Self, share: f64) -> Result<()> {
        for (target, var) in self.vars.iter().zip(&network.vars) {
            target.set(&((target.as_tensor() * (1.0 - share))? + (var.as_tensor() * share)?)?)?;
        }
        Ok(())
    }

    /// Returns one value for each variable, in the order of [`Network::parameters`].
    fn flatten(&self, value: impl Fn(&Var) -> Result<Tensor>) -> Result<Vec<f32>> {
        let mut all = Vec::new();
        for layer in self.vars.chunks_exact(2) {
            all.extend(
                value(&layer[0])?
                    .t()?
                    .contiguous()?
                    .flatten_all()?
                    .to_vec1::<f32>()?,
            );
            all.extend(value(&layer[1])?.to_vec1::<f32>()?);
        }
        Ok(all)
    }
}

struct BatchTensors {
    states: Tensor,
    actions: Tensor,
    rewards: Tensor,
    next_states: Tensor,
    /// Privileged inputs of the critics, now and next.
    privileged: [Tensor; 2],
    continues: Tensor,
}

impl BatchTensors {
    fn new(batch: &Batch) -> Result<Self> {
        let n = batch.len();
        let rows =
            |values: &[f32]| Tensor::from_slice(values, (n, values.len() / n.max(1)), &Device::Cpu);
        Ok(Self {
            states: rows(&batch.states)?,
            actions: rows(&batch.actions)?,
            rewards: rows(&batch.rewards)?,
            next_states: rows(&batch.next_states)?,
            privileged: [rows(&batch.privileged)?, rows(&batch.next_privileged)?],
            continues: rows(&batch.continues)?,
        })
    }
}

type Gradients = (Vec<Vec<f32>>, Vec<f32>);

impl ReferenceLearner {
    /// Creates the networks of a learner before its first update.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(learner: &Learner, learning: &LearningConfig, td3: &Td3Config) -> Result<Self> {
        let critics = learner
            .critics
            .iter()
            .map(|critic| NetworkWithTarget::new(critic, learning.critic_rate));
        Ok(Self {
            actor: NetworkWithTarget::new(&learner.actor, learning.actor_rate)?,
            critics: critics.collect::<Result<_>>()?,
            learning: learning.clone(),
            td3: td3.clone(),
            updates: 0,
        })
    }

    /// Computes TD targets: the reward plus the discounted minimum over the target critics, at the target actor's
    /// action with noise.
    fn td_targets(&self, rows: &BatchTensors, noise: &mut Stream) -> Result<Tensor> {
        let mut actions = self.actor.target.forward(&rows.next_states)?.tanh()?;
        if self.td3.target_noise > 0.0 {
            let normals: Vec<f32> = (0..actions.dim(0)?)
                .map(|_| StandardNormal.sample(noise))
                .collect();
            let normals = Tensor::from_vec(normals, actions.shape(), &Device::Cpu)?;
            let limit = self.td3.target_noise_limit;
            let smoothing = (normals * f64::from(self.td3.target_noise))?.clamp(-limit, limit)?;
            actions = (actions + smoothing)?.clamp(-1_f32, 1_f32)?;
        }
        let states_and_actions =
            Tensor::cat(&[&rows.next_states, &rows.privileged[1], &actions], 1)?;
        let mut values: Option<Tensor> = None;
        for critic in &self.critics {
            let value = critic.target.forward(&states_and_actions)?;
            values = Some(match values {
                Some(least) => least.minimum(&value)?,
                None => value,
            });
        }
        let values = values
            .ok_or_else(|| candle_core::Error::Msg("the learner has no critic".to_owned()))?;
        Ok((&rows.rewards + (&rows.continues * (values * self.learning.discount)?)?)?.detach())
    }

    fn critic_loss(
        &self,
        critic: &NetworkWithTarget,
        rows: &BatchTensors,
        td_targets: &Tensor,
    ) -> Result<(Tensor, Tensor)> {
        let values = critic.network.forward(&Tensor::cat(
            &[&rows.states, &rows.privileged[0], &rows.actions],
            1,
        )?)?;
        Ok(((&values - td_targets)?.sqr()?.mean_all()?, values))
    }

    fn actor_loss(&self, rows: &BatchTensors) -> Result<Tensor> {
        let raw = self.actor.network.forward(&rows.states)?;
        let values = self.critics[0].network.forward(&Tensor::cat(
            &[&rows.states, &rows.privileged[0], &raw.tanh()?],
            1,
        )?)?;
        let beyond = (raw.abs()? - 1.0)?.relu()?.sqr()?.mean_all()?;
        let change =
            (raw.tanh()? - self.actor.network.forward(&rows.next_states)?.tanh()?)?.sqr()?;
        let change = (change * &rows.continues)?.mean_all()?;
        let penalties = (beyond * f64::from(self.learning.saturation_penalty))?
            + (change * f64::from(self.learning.smoothness_penalty))?;
        penalties? - values.mean_all()?
    }

    /// Performs one update. `noise` supplies target smoothing: one normal number per transition, in order.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn update(&mut self, batch: &Batch, noise: &mut Stream) -> Result<Losses> {
        let rows = BatchTensors::new(batch)?;
        let td_targets = self.td_targets(&rows, noise)?;
        let mut losses = Losses::default();
        for index in 0..self.critics.len() {
            let (loss, values) = self.critic_loss(&self.critics[index], &rows, &td_targets)?;
            self.critics[index].optimiser.backward_step(&loss)?;
            if index == 0 {
                losses = Losses {
                    critic_loss: loss.to_dtype(DType::F64)?.to_scalar()?,
                    mean_value: values.mean_all()?.to_dtype(DType::F64)?.to_scalar()?,
                };
            }
        }
        self.updates += 1;
        if self.updates.is_multiple_of(u64::from(self.td3.actor_every)) {
            self.actor
                .optimiser
                .backward_step(&self.actor_loss(&rows)?)?;
            let share = f64::from(self.learning.tau);
            for pair in self.trained_networks() {
                pair.target.polyak_update(&pair.network, share)?;
            }
        }
        Ok(losses)
    }

    /// Computes the gradients of each critic and of the actor at the present weights.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn gradients(&self, batch: &Batch, noise: &mut Stream) -> Result<Gradients> {
        let rows = BatchTensors::new(batch)?;
        let td_targets = self.td_targets(&rows, noise)?;
        let critics = self.critics.iter().map(|critic| {
            let loss = self.critic_loss(critic, &rows, &td_targets)?.0;
            critic.network.gradient(&loss)
        });
        Ok((
            critics.collect::<Result<_>>()?,
            self.actor.network.gradient(&self.actor_loss(&rows)?)?,
        ))
    }

    /// Returns the parameters of every network, each followed by those of its target: the actor, then the critics.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn parameters(&self) -> Result<Vec<Vec<f32>>> {
        let networks = self
            .trained_networks()
            .flat_map(|pair| [&pair.network, &pair.target]);
        networks
            .map(|network| network.flatten(|var| Ok(var.as_tensor().clone())))
            .collect()
    }

    fn trained_networks(&self) -> impl Iterator<Item = &NetworkWithTarget> {
        std::iter::once(&self.actor).chain(&self.critics)
    }
}
