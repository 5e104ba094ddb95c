//! Metadata of a model.

use serde_json::Value;

use super::super::archive::Archive;
use super::super::error::sanitized;
use super::normalisation::VecNormalizeUse;
use super::space::BoxSpace;

/// Metadata of a Stable-Baselines3 model.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SavedModel {
    /// Algorithm, as far as the file shows it: `PPO`.
    pub algorithm: &'static str,
    /// Version of Stable-Baselines3 that wrote the file, if stated.
    pub version: Option<String>,
    /// Observation space of the training.
    pub observation_space: BoxSpace,
    /// Action space of the training.
    pub action_space: BoxSpace,
    /// Use of `VecNormalize`.
    pub vec_normalize: VecNormalizeUse,
}

pub(super) fn sb3_version(archive: &Archive<'_>) -> Option<String> {
    let text = archive.member("_stable_baselines3_version").ok()?;
    std::str::from_utf8(text)
        .ok()
        .map(|text| sanitized(text.trim()))
        .filter(|text| !text.is_empty())
}

pub(super) fn algorithm(class: &str, settings: &serde_json::Map<String, Value>) -> &'static str {
    match class {
        "SACPolicy" => "SAC",
        "TD3Policy" if settings.get("target_noise_clip").and_then(Value::as_f64) == Some(0.0) => {
            "DDPG"
        }
        "TD3Policy" => "TD3",
        _ if settings.contains_key("clip_range") => "PPO",
        _ if settings.contains_key("cg_max_steps") => "TRPO",
        _ if settings.contains_key("gae_lambda") => "A2C",
        _ => "on-policy",
    }
}
