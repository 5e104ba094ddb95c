//! What a training will take of memory, before it takes any.

use super::config::{ConfigError, TrainingConfig};

/// Most memory of a training with one seed: several seeds at once take that much each.
const MOST_BYTES: u64 = 4 << 30;

/// Copies of a network's parameters: itself, its target, two moments, the gradients; and once more what a checkpoint holds.
const COPIES: u64 = 9;
/// Numbers a layer and sample: activations and what is handed back, in each of three working spaces.
const TAPES: u64 = 6;

/// About how many bytes each part of a training will take, with the field that decides it: networks with all that goes with them, the
/// working space of an update, and the replay memory once it is full.
fn parts(config: &TrainingConfig) -> [(&'static str, u64); 3] {
    let parameters = |inputs: usize| {
        let sizes = [&[inputs], config.network.hidden.as_slice(), &[1]].concat();
        sizes.windows(2).fold(0, |sum: u64, pair| {
            let [from, to] = [0, 1].map(|side| pair.get(side).map_or(0, |&size| size as u64));
            sum.saturating_add(from.saturating_add(1).saturating_mul(to))
        })
    };
    let critics = if config.td3.twin_critic { 2 } else { 1 };
    let seen = config.environment.observation.width();
    let known = seen + config.learning.privileged() + 1;
    let networks = parameters(seen).saturating_add(parameters(known).saturating_mul(critics));
    let widths = config.network.hidden.iter().fold(0, |sum: u64, &width| sum.saturating_add(width as u64));
    let space = widths.saturating_mul(config.learning.batch as u64).saturating_mul(TAPES);
    let remembered = config.remembered().numbers() as u64;
    let remembered = remembered.saturating_mul(config.replay.capacity as u64);
    let bytes = |floats: u64| floats.saturating_mul(size_of::<f32>() as u64);
    [
        ("network.hidden", bytes(networks.saturating_mul(COPIES))),
        ("learning.batch", bytes(space)),
        ("replay.capacity", bytes(remembered)),
    ]
}

/// All of them together.
fn bytes(config: &TrainingConfig) -> u64 {
    parts(config).into_iter().fold(0, |sum, (_, bytes)| sum.saturating_add(bytes))
}

/// Whether a training takes no more than [`MOST_BYTES`]. The field that takes most of them is the one to blame.
pub(super) fn check(config: &TrainingConfig) -> Result<(), ConfigError> {
    let (found, most) = (bytes(config), MOST_BYTES);
    if found <= most {
        return Ok(());
    }
    let field = parts(config).into_iter().max_by_key(|(_, bytes)| *bytes).map_or("network.hidden", |(field, _)| field);
    let others: Vec<_> = parts(config).into_iter().map(|(other, _)| other).filter(|other| *other != field).collect();
    let problem = format!(
        "takes some {} MiB of memory with {}, and {} MiB are the most",
        found >> 20,
        others.join(" and "),
        most >> 20
    );
    Err(ConfigError::Field { field: field.to_owned(), problem })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::config::PRESETS;

    #[test]
    fn what_would_not_fit_is_refused_before_anything_is_allocated() {
        for (name, _) in PRESETS {
            let preset = TrainingConfig::preset(name).unwrap();
            assert!(bytes(&preset) < MOST_BYTES / 16, "{name}: {}", bytes(&preset));
        }
        let changed = |change: &dyn Fn(&mut TrainingConfig)| {
            let mut config = TrainingConfig::preset("paper").unwrap();
            change(&mut config);
            config.check()
        };
        let refused = |field: &str, result: Result<(), ConfigError>| {
            let said = result.unwrap_err().to_string();
            let begins = format!("{field}: takes some ");
            assert!(said.starts_with(&begins) && said.ends_with("and 4096 MiB are the most"), "{said}");
        };
        refused("network.hidden", changed(&|config| config.network.hidden = vec![4096; 16]));
        refused("replay.capacity", changed(&|config| config.replay.capacity = 100_000_000));
        let wide = |config: &mut TrainingConfig| {
            (config.network.hidden, config.learning.batch, config.replay.capacity) = (vec![2048; 8], 65_536, 65_536);
        };
        refused("learning.batch", changed(&wide));
        changed(&|config| config.network.hidden = vec![1024; 4]).unwrap();
    }
}
