//! The same update, stated plainly on candle's tensors and automatic differentiation.
//!
//! Slow and easy to believe: what [`Learner`] computes by hand is tested against this, and its speed is
//! measured against it. Plain DDPG only, without TD3's options.

use candle_core::{DType, Device, Result, Tensor, Var};
use candle_nn::{AdamW, Linear, Module, Optimizer, ParamsAdamW};

use super::config::LearningConfig;
use super::learner::{Learner, Losses, Trained};
use super::replay::Batch;
use crate::policy::{Network, STATE};

/// Actor, critic and targets as candle sees them.
pub struct Oracle {
    actor: Mlp,
    actor_target: Mlp,
    critic: Mlp,
    critic_target: Mlp,
    actor_optimiser: AdamW,
    critic_optimiser: AdamW,
    learning: LearningConfig,
}

/// A network whose variables are kept in order, weights and biases by turns.
struct Mlp {
    vars: Vec<Var>,
}

impl Mlp {
    /// candle's layers hold one row an output, ours one row an input.
    fn new(network: &Network) -> Result<Self> {
        let mut vars = Vec::new();
        let mut rest = network.parameters();
        for sizes in network.sizes().windows(2) {
            let (weights, after) = rest.split_at(sizes[0] * sizes[1]);
            let (biases, after) = after.split_at(sizes[1]);
            rest = after;
            let weights = Tensor::from_slice(weights, (sizes[0], sizes[1]), &Device::Cpu)?.t()?.contiguous()?;
            vars.push(Var::from_tensor(&weights)?);
            vars.push(Var::from_slice(biases, sizes[1], &Device::Cpu)?);
        }
        Ok(Self { vars })
    }

    fn forward(&self, input: &Tensor) -> Result<Tensor> {
        let mut value = input.clone();
        let layers = self.vars.chunks_exact(2);
        let last = layers.len() - 1;
        for (index, layer) in layers.enumerate() {
            let linear = Linear::new(layer[0].as_tensor().clone(), Some(layer[1].as_tensor().clone()));
            value = linear.forward(&value)?;
            if index < last {
                value = value.relu()?;
            }
        }
        Ok(value)
    }

    fn follow(&self, network: &Self, share: f64) -> Result<()> {
        for (target, var) in self.vars.iter().zip(&network.vars) {
            target.set(&((target.as_tensor() * (1.0 - share))? + (var.as_tensor() * share)?)?)?;
        }
        Ok(())
    }

    /// One value for each variable, in the order of [`Network::parameters`].
    fn flat(&self, of: impl Fn(&Var) -> Result<Tensor>) -> Result<Vec<f32>> {
        let mut all = Vec::new();
        for layer in self.vars.chunks_exact(2) {
            all.extend(of(&layer[0])?.t()?.contiguous()?.flatten_all()?.to_vec1::<f32>()?);
            all.extend(of(&layer[1])?.to_vec1::<f32>()?);
        }
        Ok(all)
    }
}

/// A batch as tensors.
struct Rows {
    states: Tensor,
    actions: Tensor,
    rewards: Tensor,
    next_states: Tensor,
    continues: Tensor,
}

impl Rows {
    fn new(batch: &Batch) -> Result<Self> {
        let n = batch.len();
        let rows = |values: &[f32], width: usize| Tensor::from_slice(values, (n, width), &Device::Cpu);
        Ok(Self {
            states: rows(&batch.states, STATE)?,
            actions: rows(&batch.actions, 1)?,
            rewards: rows(&batch.rewards, 1)?,
            next_states: rows(&batch.next_states, STATE)?,
            continues: rows(&batch.continues, 1)?,
        })
    }
}

impl Oracle {
    /// The networks of a learner that has made no update.
    ///
    /// # Errors
    /// candle's, in principle.
    pub fn new(learner: &Learner, learning: &LearningConfig) -> Result<Self> {
        let critic = |of: fn(&Trained) -> &Network| match learner.critics.first() {
            Some(critic) => Mlp::new(of(critic)),
            None => Err(candle_core::Error::Msg("the learner has no critic".to_owned())),
        };
        let (actor, critic_network) = (Mlp::new(&learner.actor.network)?, critic(|c| &c.network)?);
        let optimiser = |vars: &[Var], rate: f32| {
            let params = ParamsAdamW { lr: f64::from(rate), weight_decay: 0.0, ..ParamsAdamW::default() };
            AdamW::new(vars.to_vec(), params)
        };
        Ok(Self {
            actor_optimiser: optimiser(&actor.vars, learning.actor_rate)?,
            critic_optimiser: optimiser(&critic_network.vars, learning.critic_rate)?,
            actor,
            actor_target: Mlp::new(&learner.actor.target)?,
            critic: critic_network,
            critic_target: critic(|c| &c.target)?,
            learning: learning.clone(),
        })
    }

    fn critic_loss(&self, rows: &Rows) -> Result<(Tensor, Tensor)> {
        let next_actions = self.actor_target.forward(&rows.next_states)?.tanh()?;
        let next_values = self.critic_target.forward(&Tensor::cat(&[&rows.next_states, &next_actions], 1)?)?;
        let goals = (&rows.rewards + (&rows.continues * (next_values * self.learning.discount)?)?)?.detach();
        let values = self.critic.forward(&Tensor::cat(&[&rows.states, &rows.actions], 1)?)?;
        Ok(((&values - goals)?.sqr()?.mean_all()?, values))
    }

    fn actor_loss(&self, rows: &Rows) -> Result<Tensor> {
        let raw = self.actor.forward(&rows.states)?;
        let values = self.critic.forward(&Tensor::cat(&[&rows.states, &raw.tanh()?], 1)?)?;
        let beyond = (raw.abs()? - 1.0)?.relu()?.sqr()?.mean_all()?;
        (beyond * f64::from(self.learning.saturation_penalty))? - values.mean_all()?
    }

    /// One update.
    ///
    /// # Errors
    /// candle's, in principle.
    pub fn update(&mut self, batch: &Batch) -> Result<Losses> {
        let rows = Rows::new(batch)?;
        let (loss, values) = self.critic_loss(&rows)?;
        self.critic_optimiser.backward_step(&loss)?;
        self.actor_optimiser.backward_step(&self.actor_loss(&rows)?)?;
        let share = f64::from(self.learning.soft_update);
        self.critic_target.follow(&self.critic, share)?;
        self.actor_target.follow(&self.actor, share)?;
        let number = |tensor: Tensor| tensor.to_dtype(DType::F64)?.to_scalar::<f64>();
        Ok(Losses { critic: number(loss)?, mean_value: number(values.mean_all()?)? })
    }

    /// Gradients of critic and actor at the present weights.
    ///
    /// # Errors
    /// candle's, in principle.
    pub fn gradients(&self, batch: &Batch) -> Result<(Vec<f32>, Vec<f32>)> {
        let rows = Rows::new(batch)?;
        let of = |network: &Mlp, loss: Tensor| {
            let found = loss.backward()?;
            network.flat(|var| match found.get(var) {
                Some(gradient) => Ok(gradient.clone()),
                None => var.zeros_like(),
            })
        };
        Ok((of(&self.critic, self.critic_loss(&rows)?.0)?, of(&self.actor, self.actor_loss(&rows)?)?))
    }

    /// Parameters of critic, critic target, actor and actor target.
    ///
    /// # Errors
    /// candle's, in principle.
    pub fn parameters(&self) -> Result<[Vec<f32>; 4]> {
        let of = |network: &Mlp| network.flat(|var| Ok(var.as_tensor().clone()));
        Ok([of(&self.critic)?, of(&self.critic_target)?, of(&self.actor)?, of(&self.actor_target)?])
    }
}
