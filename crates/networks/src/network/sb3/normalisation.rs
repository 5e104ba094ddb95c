//! Use of `VecNormalize` in training, from the model file and from the statistics file.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;

use super::super::pickle::Pickle;
use super::space;
use crumple_core::regular_file;

const MAX_BYTES: u64 = 16 << 20;

const MAX_DIR_ENTRIES: usize = 10_000;

/// Use of `VecNormalize`, from the model file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum VecNormalizeUse {
    /// Trained without `VecNormalize`, or with one that changed no observation.
    None,
    /// Trained with `VecNormalize`; the file does not show if it normalised observations or only rewards.
    Behind,
    /// The file does not show it.
    Unknown,
}

impl VecNormalizeUse {
    /// Compares the last observation before and after `VecNormalize`. On-policy algorithms store the original one only
    /// with `VecNormalize`. The others always store one; without `VecNormalize` it is that of the previous step.
    pub(super) fn from_observations(
        last: &Value,
        original: Option<&Value>,
        is_on_policy: bool,
    ) -> Self {
        let Some(original) = original else {
            return Self::Unknown;
        };
        if original.is_null() {
            return if is_on_policy && !last.is_null() {
                Self::None
            } else {
                Self::Unknown
            };
        }
        match (observation_values(last), observation_values(original)) {
            (Some(last), Some(original)) if last == original => Self::None,
            _ if is_on_policy => Self::Behind,
            _ => Self::Unknown,
        }
    }
}

fn observation_values(array: &Value) -> Option<Vec<f64>> {
    let bytes = space::serialized_bytes(array, "_last_obs").ok()?;
    let pickle = Pickle::read(&bytes).ok()?;
    space::array_values(&pickle, pickle.top)
}

/// Normalisation of observations by `VecNormalize`, from the statistics file.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Normalisation {
    /// Mean of each number, which was subtracted.
    pub means: Vec<f64>,
    /// Square root of each variance plus epsilon, the divisor.
    pub deviations: Vec<f64>,
    /// Clipping limit.
    pub limit: f64,
}

/// Content of a statistics file.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum VecNormalizeStats {
    /// At most the rewards were normalised.
    RewardsOnly,
    /// Observations were normalised.
    Observations(Normalisation),
    /// The file cannot be read, or has another form.
    Unreadable,
}

impl VecNormalizeStats {
    /// Reads a pickle of `VecNormalize` without calling anything in it.
    #[must_use]
    pub fn load(path: &Path) -> Self {
        let mut bytes = Vec::new();
        let read = regular_file::open(path)
            .and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes));
        match read {
            Ok(_) if bytes.len() as u64 <= MAX_BYTES => {
                Self::read(&bytes).unwrap_or(Self::Unreadable)
            }
            _ => Self::Unreadable,
        }
    }

    fn read(bytes: &[u8]) -> Option<Self> {
        let pickle = Pickle::read(bytes).ok()?;
        let whole = pickle.call(pickle.top)?;
        if pickle.global(whole.callee)?.1 != "VecNormalize" {
            return None;
        }
        let field = |name| pickle.entry(whole.state?, name);
        if !pickle.boolean(field("norm_obs")?)? {
            return Some(Self::RewardsOnly);
        }
        let running = pickle.call(field("obs_rms")?)?;
        let numbers = |name| space::array_values(&pickle, pickle.entry(running.state?, name)?);
        let (means, variances) = (numbers("mean")?, numbers("var")?);
        let (epsilon, limit) = (
            pickle.number(field("epsilon")?)?,
            pickle.number(field("clip_obs")?)?,
        );
        let deviations: Vec<f64> = variances
            .iter()
            .map(|variance| (variance + epsilon).sqrt())
            .collect();
        let is_usable = means.len() == deviations.len()
            && means.iter().all(|mean| mean.is_finite())
            && deviations
                .iter()
                .all(|deviation| deviation.is_finite() && *deviation > 0.0)
            && limit.is_finite()
            && limit > 0.0;
        is_usable.then_some(Self::Observations(Normalisation {
            means,
            deviations,
            limit,
        }))
    }

    /// Finds the statistics file of a model: beside it, under the names of Stable-Baselines3
    /// (`rl_model_vecnormalize_128_steps.pkl` for `rl_model_128_steps.zip`), or in a subfolder of RL Zoo.
    #[must_use]
    pub fn find_for_model(model: &Path) -> Option<PathBuf> {
        let folder = match model.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let (mut found, folders) = list_statistics(folder);
        if found.is_empty() {
            // RL Zoo creates a folder with the name of the model, or one with the training settings.
            let own = model.with_extension("");
            let is_of_training =
                |below: &PathBuf| *below == own || below.join("config.yml").is_file();
            let mut below: Vec<PathBuf> = folders.into_iter().filter(is_of_training).collect();
            below.sort();
            found = below
                .into_iter()
                .flat_map(|below| list_statistics(&below).0)
                .collect();
        }
        let of_checkpoint = model
            .file_stem()
            .and_then(|stem| stem.to_str())
            .and_then(checkpoint_stats_name);
        let is_own = |path: &&PathBuf| {
            of_checkpoint
                .as_ref()
                .is_some_and(|name| path.ends_with(name))
        };
        found
            .iter()
            .find(is_own)
            .or(found.first())
            .map(|path| match path.strip_prefix("./") {
                Ok(path) => path.to_owned(),
                Err(_) => path.clone(),
            })
    }
}

/// Returns `PREFIX_vecnormalize_N_steps.pkl` for `PREFIX_N_steps`, as `CheckpointCallback` names them.
fn checkpoint_stats_name(stem: &str) -> Option<String> {
    let (prefix, count) = stem.strip_suffix("_steps")?.rsplit_once('_')?;
    Some(format!("{prefix}_vecnormalize_{count}_steps.pkl"))
}

/// Lists the statistics files of a folder in order of their names, and its subfolders.
fn list_statistics(folder: &Path) -> (Vec<PathBuf>, Vec<PathBuf>) {
    let (mut found, mut folders) = (Vec::new(), Vec::new());
    for entry in fs::read_dir(folder)
        .into_iter()
        .flatten()
        .take(MAX_DIR_ENTRIES)
        .flatten()
    {
        let name = entry.file_name().to_string_lossy().to_lowercase();
        let is_theirs = ["vecnormalize", "vec_normalize"]
            .iter()
            .any(|theirs| name.contains(theirs));
        if is_theirs
            && [".pkl", ".pickle"]
                .iter()
                .any(|ending| name.ends_with(ending))
        {
            found.push(entry.path());
        } else if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            folders.push(entry.path());
        }
    }
    found.sort();
    (found, folders)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_found_under_the_names_that_are_written() {
        for (model, statistics) in [
            ("m.zip", Some("vecnormalize.pkl")),
            ("m.zip", Some("vec_normalize.pkl")),
            ("m.zip", Some("m_VecNormalize.pkl")),
            (
                "rl_model_128_steps.zip",
                Some("rl_model_vecnormalize_128_steps.pkl"),
            ),
            ("Env-v1.zip", Some("Env-v1/vecnormalize.pkl")),
            ("m.zip", Some("Env-v1/vecnormalize.pkl")),
            ("m.zip", None),
        ] {
            let folder = tempfile::tempdir().unwrap();
            fs::create_dir(folder.path().join("Env-v1")).unwrap();
            fs::write(folder.path().join("Env-v1/config.yml"), "").unwrap();
            for other in ["replay_buffer.pkl", "vecnormalize.txt"] {
                fs::write(folder.path().join(other), "").unwrap();
            }
            let wanted = statistics.map(|name| folder.path().join(name));
            if let Some(wanted) = &wanted {
                fs::write(wanted, "").unwrap();
            }
            assert_eq!(
                VecNormalizeStats::find_for_model(&folder.path().join(model)),
                wanted,
                "{model}"
            );
        }
        let folder = tempfile::tempdir().unwrap();
        for steps in [128, 256] {
            fs::write(
                folder
                    .path()
                    .join(format!("rl_model_vecnormalize_{steps}_steps.pkl")),
                "",
            )
            .unwrap();
        }
        let found =
            VecNormalizeStats::find_for_model(&folder.path().join("rl_model_256_steps.zip"));
        assert_eq!(
            found,
            Some(folder.path().join("rl_model_vecnormalize_256_steps.pkl"))
        );
    }

    #[test]
    fn other_pickles_are_unreadable() {
        assert_eq!(
            VecNormalizeStats::load(Path::new("there/is/none.pkl")),
            VecNormalizeStats::Unreadable
        );
        for bytes in [&b""[..], b"\x80\x04N.", b"\x80\x04)."] {
            assert_eq!(VecNormalizeStats::read(bytes), None);
        }
    }
}
