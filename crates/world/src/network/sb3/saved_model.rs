//! What a model says of itself beside its weights.

use serde_json::Value;

use super::super::archive::Archive;
use super::super::error::sanitized;
use super::normalisation::VecNormalizeUse;
use super::space::BoxSpace;

/// What a model of Stable-Baselines3 says of itself beside its weights.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SavedModel {
    /// The algorithm, as far as the file tells it: `PPO`.
    pub algorithm: &'static str,
    /// The version of Stable-Baselines3 that wrote it, if it says so.
    pub version: Option<String>,
    /// What it was trained to see.
    pub observation_space: BoxSpace,
    /// What it was trained to answer with.
    pub action_space: BoxSpace,
    /// What is known of `VecNormalize`.
    pub vec_normalize: VecNormalizeUse,
}

/// The version that wrote an archive.
pub(super) fn sb3_version(archive: &Archive<'_>) -> Option<String> {
    let text = archive.member("_stable_baselines3_version").ok()?;
    std::str::from_utf8(text).ok().map(|text| sanitized(text.trim())).filter(|text| !text.is_empty())
}

/// The algorithm, by the settings that only it has.
pub(super) fn algorithm(class: &str, settings: &serde_json::Map<String, Value>) -> &'static str {
    let has = |name: &str| settings.contains_key(name);
    match class {
        "SACPolicy" => "SAC",
        "TD3Policy" if settings.get("target_noise_clip").and_then(Value::as_f64) == Some(0.0) => "DDPG",
        "TD3Policy" => "TD3",
        _ if has("clip_range") => "PPO",
        _ if has("cg_max_steps") => "TRPO",
        _ if has("gae_lambda") => "A2C",
        _ => "on-policy",
    }
}
