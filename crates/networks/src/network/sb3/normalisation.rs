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
        let object = pickle.call(pickle.top)?;
        if pickle.global(object.callee)?.1 != "VecNormalize" {
            return None;
        }
        let fields = object.state?;
        if !pickle.boolean(pickle.entry(fields, "norm_obs")?)? {
            return Some(Self::RewardsOnly);
        }
        let running = pickle.call(pickle.entry(fields, "obs_rms")?)?.state?;
        let means = space::array_values(&pickle, pickle.entry(running, "mean")?)?;
        let variances = space::array_values(&pickle, pickle.entry(running, "var")?)?;
        let epsilon = pickle.number(pickle.entry(fields, "epsilon")?)?;
        let limit = pickle.number(pickle.entry(fields, "clip_obs")?)?;
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
        let StatisticsFolder {
            mut files,
            subfolders,
        } = StatisticsFolder::list(folder);
        if files.is_empty() {
            // RL Zoo creates a folder with the name of the model, or one with the training settings.
            let named_as_model = model.with_extension("");
            let mut of_training: Vec<PathBuf> = subfolders
                .into_iter()
                .filter(|path| *path == named_as_model || path.join("config.yml").is_file())
                .collect();
            of_training.sort();
            files = of_training
                .into_iter()
                .flat_map(|path| StatisticsFolder::list(&path).files)
                .collect();
        }
        let checkpoint_name = model
            .file_stem()
            .and_then(|stem| stem.to_str())
            .and_then(checkpoint_stats_name);
        let of_checkpoint =
            checkpoint_name.and_then(|name| files.iter().find(|path| path.ends_with(&name)));
        of_checkpoint
            .or(files.first())
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

/// Content of a folder, as far as it matters for statistics.
struct StatisticsFolder {
    /// Statistics files, in order of their names.
    files: Vec<PathBuf>,
    subfolders: Vec<PathBuf>,
}

impl StatisticsFolder {
    fn list(folder: &Path) -> Self {
        let mut files = Vec::new();
        let mut subfolders = Vec::new();
        for entry in fs::read_dir(folder)
            .into_iter()
            .flatten()
            .take(MAX_DIR_ENTRIES)
            .flatten()
        {
            let name = entry.file_name().to_string_lossy().to_lowercase();
            let is_statistics = ["vecnormalize", "vec_normalize"]
                .iter()
                .any(|part| name.contains(part));
            if is_statistics
                && [".pkl", ".pickle"]
                    .iter()
                    .any(|ending| name.ends_with(ending))
            {
                files.push(entry.path());
            } else if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                subfolders.push(entry.path());
            }
        }
        files.sort();
        Self { files, subfolders }
    }
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
        let read_back =
            VecNormalizeStats::find_for_model(&folder.path().join("rl_model_256_steps.zip"));
        assert_eq!(
            read_back,
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
