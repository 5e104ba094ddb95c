//! Models saved by Stable-Baselines3: the actor of PPO, A2C, SAC, TD3 and DDPG with fully connected layers.
//!
//! The network equals `model.predict(observation, deterministic=True)`. For PPO and A2C that is the mean, clipped to
//! the action space. For SAC it is the tanh of the mean, for TD3 and DDPG the answer, both scaled to the action space.
//!
//! A model file does not contain the wrappers of its environment. Its last observation, before and after
//! `VecNormalize`, often shows if that was used (`normalisation`).

mod normalisation;
mod saved_model;
mod space;
mod weights;

use serde::Deserialize;
use serde_json::Value;

pub use normalisation::{Normalisation, VecNormalizeStats, VecNormalizeUse};
pub use saved_model::SavedModel;
pub use space::BoxSpace;

use super::archive::Archive;
use super::error::sanitized;
use super::pickle::Pickle;
use super::{Elementwise, FeedForward, NetworkError, NetworkStep};
use weights::Weights;

const MAX_DATA_BYTES: usize = 8 << 20;

#[derive(Deserialize)]
struct Data {
    policy_class: Value,
    #[serde(default)]
    policy_kwargs: Value,
    observation_space: Value,
    action_space: Value,
    #[serde(default)]
    use_sde: bool,
    #[serde(default, rename = "_last_obs")]
    last_obs: Value,
}

/// Fields that a model can be saved without, but that reading requires.
const REQUIRED_FIELDS: [&str; 3] = ["policy_class", "observation_space", "action_space"];

/// Hint appended when a model kind is not supported.
pub(super) const PROCESS_HINT: &str = "a program that loads the model and calls `predict` can be the controller \
    instead (`exec:`, docs/controllers.md, Processes)";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ActorKind {
    /// PPO and A2C: the mean of the actions, clipped to their space.
    OnPolicy,
    /// SAC: tanh of the mean.
    SoftActorCritic,
    /// TD3 and DDPG: tanh is the last layer of the actor.
    Deterministic,
}

fn unsupported<T>(problem: impl Into<String>) -> Result<T, NetworkError> {
    Err(NetworkError::Unsupported(problem.into()))
}

fn unsupported_with_hint<T>(problem: impl std::fmt::Display) -> Result<T, NetworkError> {
    unsupported(format!("{problem}; {PROCESS_HINT}"))
}

/// A model that was read.
pub(super) struct Model {
    pub(super) network: FeedForward,
    pub(super) metadata: SavedModel,
}

pub(super) fn read(bytes: &[u8]) -> Result<Model, NetworkError> {
    if weights::is_legacy(bytes) {
        return Err(weights::legacy_error(
            "it is a file of `torch.save`, not a model of Stable-Baselines3, and",
        ));
    }
    let archive = Archive::read(bytes)?;
    let settings = read_settings(archive.member("data")?)?;
    let data = Data::deserialize(&settings).map_err(damaged_data)?;
    let PolicyClass { actor, name } = PolicyClass::read(&data.policy_class)?;
    let observations = space::read_box(&data.observation_space, "observation_space")?;
    let actions = space::read_box(&data.action_space, "action_space")?;
    let weights = Weights::read(archive.member("policy.pth")?)?;
    let mut steps = actor.steps(&weights, &data)?;
    check_output_count(&steps, &actions)?;
    steps.extend(actor.output_steps(&data, actions.clone()));
    let original = settings.get("_last_original_obs");
    Ok(Model {
        network: FeedForward::new(observations.low.len(), steps)?,
        metadata: SavedModel {
            algorithm: saved_model::algorithm(name, &settings),
            version: saved_model::sb3_version(&archive),
            vec_normalize: VecNormalizeUse::from_observations(
                &data.last_obs,
                original,
                actor == ActorKind::OnPolicy,
            ),
            observation_space: observations,
            action_space: actions,
        },
    })
}

fn damaged_data(error: serde_json::Error) -> NetworkError {
    NetworkError::damaged("member `data`", sanitized(&error.to_string()))
}

/// Parses the settings of a model, and checks that the required ones are there.
fn read_settings(data: &[u8]) -> Result<serde_json::Map<String, Value>, NetworkError> {
    if data.len() > MAX_DATA_BYTES {
        return unsupported(format!(
            "its member `data` has more than {MAX_DATA_BYTES} bytes"
        ));
    }
    let settings: serde_json::Map<String, Value> =
        serde_json::from_slice(data).map_err(damaged_data)?;
    if let Some(missing) = REQUIRED_FIELDS
        .into_iter()
        .find(|required| !settings.contains_key(*required))
    {
        return unsupported(format!(
            "it was saved without `{missing}`, which describes its inputs or outputs: save it without excluding that \
                field"
        ));
    }
    Ok(settings)
}

/// Rejects an actor whose last layer has another number of outputs than there are actions.
fn check_output_count(steps: &[NetworkStep], actions: &BoxSpace) -> Result<(), NetworkError> {
    let last = steps.iter().rev().find_map(|step| match step {
        NetworkStep::Linear(linear) => Some(linear),
        NetworkStep::Elementwise(_) => None,
    });
    match last.map(|last| last.biases.len()) {
        Some(outputs) if outputs != actions.low.len() => {
            let problem = format!(
                "its actor has {outputs} outputs for {} actions",
                actions.low.len()
            );
            Err(NetworkError::damaged("model", problem))
        }
        _ => Ok(()),
    }
}

/// The class of a policy.
struct PolicyClass {
    actor: ActorKind,
    name: &'static str,
}

impl PolicyClass {
    fn read(class: &Value) -> Result<Self, NetworkError> {
        let bytes = space::serialized_bytes(class, "policy_class")?;
        let pickle = Pickle::read(&bytes)?;
        let Some((module, name)) = pickle.global(pickle.top) else {
            return unsupported_with_hint("its policy is a custom class, which is not supported");
        };
        match (module, name) {
            ("stable_baselines3.common.policies", "ActorCriticPolicy") => Ok(Self {
                actor: ActorKind::OnPolicy,
                name: "ActorCriticPolicy",
            }),
            ("stable_baselines3.sac.policies", "SACPolicy") => Ok(Self {
                actor: ActorKind::SoftActorCritic,
                name: "SACPolicy",
            }),
            ("stable_baselines3.td3.policies", "TD3Policy") => Ok(Self {
                actor: ActorKind::Deterministic,
                name: "TD3Policy",
            }),
            _ => unsupported_with_hint(format_args!(
                "its policy `{}.{}` is not supported: crumple reads PPO, A2C, SAC, TD3 and DDPG with MlpPolicy",
                sanitized(module),
                sanitized(name)
            )),
        }
    }
}

impl ActorKind {
    /// Builds the steps from the observation to the answer, before it is mapped to the action space.
    fn steps(self, weights: &Weights<'_>, data: &Data) -> Result<Vec<NetworkStep>, NetworkError> {
        let kwargs = &data.policy_kwargs;
        let class = kwargs
            .get("features_extractor_class")
            .and_then(Value::as_str);
        if class.is_some_and(|class| !class.contains("FlattenExtractor"))
            || weights.has_part("features_extractor")
        {
            return unsupported_with_hint(
                "it has a custom features extractor, which is not supported",
            );
        }
        let activation = activation(kwargs, self)?;
        let mut steps = Vec::new();
        for name in self.hidden_layers() {
            for layer in weights.sequential_layers(name)? {
                steps.push(NetworkStep::Linear(layer));
                steps.extend(activation.clone().map(NetworkStep::Elementwise));
            }
        }
        match self {
            Self::OnPolicy => {
                steps.push(NetworkStep::Linear(weights.linear_layer("action_net")?));
            }
            Self::SoftActorCritic => steps.extend(soft_actor_mean(weights, kwargs)?),
            Self::Deterministic => {
                // The last layer has tanh, for any activation of the others.
                if steps
                    .last()
                    .is_some_and(|step| matches!(step, NetworkStep::Elementwise(_)))
                {
                    steps.pop();
                }
            }
        }
        if steps.is_empty() {
            unsupported_with_hint("its policy has no layers with known names")
        } else {
            Ok(steps)
        }
    }

    /// Returns the names of the sequences of hidden layers, in order.
    fn hidden_layers(self) -> &'static [&'static str] {
        match self {
            Self::OnPolicy => &["mlp_extractor.shared_net", "mlp_extractor.policy_net"],
            Self::SoftActorCritic => &["actor.latent_pi"],
            Self::Deterministic => &["actor.mu"],
        }
    }

    /// Builds the steps from the answer to the action space.
    fn output_steps(self, data: &Data, actions: BoxSpace) -> Vec<NetworkStep> {
        let squash_output = data
            .policy_kwargs
            .get("squash_output")
            .and_then(Value::as_bool)
            == Some(true);
        let is_squashed = self != Self::OnPolicy || (data.use_sde && squash_output);
        let BoxSpace { low, high } = actions;
        if !is_squashed {
            return vec![NetworkStep::Elementwise(Elementwise::Clip { low, high })];
        }
        let bounds: Vec<[f64; 2]> = low
            .iter()
            .zip(&high)
            .map(|(&low, &high)| [f64::from(low), f64::from(high)])
            .collect();
        let half: Vec<f32> = bounds
            .iter()
            .map(|[low, high]| (0.5 * (high - low)) as f32)
            .collect();
        let middle: Vec<f32> = bounds
            .iter()
            .map(|[low, high]| (0.5 * (high + low)) as f32)
            .collect();
        let mut steps = vec![NetworkStep::Elementwise(Elementwise::Tanh)];
        if half.iter().any(|&half| half != 1.0) {
            steps.push(NetworkStep::Elementwise(Elementwise::Multiply(half)));
        }
        if middle.iter().any(|&middle| middle != 0.0) {
            steps.push(NetworkStep::Elementwise(Elementwise::Add(middle)));
        }
        steps
    }
}

/// Builds the last layer of SAC: the mean of the actions, which is clipped with state-dependent noise.
fn soft_actor_mean(
    weights: &Weights<'_>,
    kwargs: &Value,
) -> Result<Vec<NetworkStep>, NetworkError> {
    let is_clipped = weights.has("actor.mu.0.weight");
    let mean = weights.linear_layer(if is_clipped { "actor.mu.0" } else { "actor.mu" })?;
    let width = mean.biases.len();
    let mut steps = vec![NetworkStep::Linear(mean)];
    if is_clipped {
        let limit = kwargs
            .get("clip_mean")
            .and_then(Value::as_f64)
            .unwrap_or(2.0) as f32;
        steps.push(NetworkStep::Elementwise(Elementwise::Clip {
            low: vec![-limit; width],
            high: vec![limit; width],
        }));
    }
    Ok(steps)
}

/// Returns the activation of hidden layers; `None` for the identity.
fn activation(kwargs: &Value, actor: ActorKind) -> Result<Option<Elementwise>, NetworkError> {
    let Some(text) = kwargs.get("activation_fn") else {
        return Ok(Some(if actor == ActorKind::OnPolicy {
            Elementwise::Tanh
        } else {
            Elementwise::Relu
        }));
    };
    let text = text.as_str().unwrap_or_default();
    let name = text
        .trim_end_matches("'>")
        .rsplit('.')
        .next()
        .unwrap_or_default();
    if !text.contains("torch.nn.modules.") {
        return unsupported_with_hint(format_args!(
            "its activation function `{}` is not one of PyTorch's",
            sanitized(text)
        ));
    }
    Ok(Some(match name {
        "Tanh" => Elementwise::Tanh,
        "ReLU" => Elementwise::Relu,
        "Sigmoid" => Elementwise::Sigmoid,
        "LeakyReLU" => Elementwise::LeakyRelu { slope: 0.01 },
        "ELU" => Elementwise::Elu { alpha: 1.0 },
        "Identity" => return Ok(None),
        _ => {
            return unsupported_with_hint(format_args!(
                "its activation function `{}` is not supported",
                sanitized(name)
            ));
        }
    }))
}
