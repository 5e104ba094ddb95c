//! What a training will take of memory, before it takes any.

use super::config::{ConfigError, TrainingConfig};

/// Most memory of a training with one seed: several seeds at once take that much each.
const MOST_BYTES: u64 = 4 << 30;

/// The columns of a factor of a product are filled up to a multiple of this.
const PANEL: u64 = 32;

/// Bytes of a held-out draw with the run that is made of it: 2200 to 2700 as measured.
const DRAW_BYTES: u64 = 2600;

/// Numbers of a network that is fully connected from each of these to the next.
struct Shape(Vec<u64>);

impl Shape {
    fn new(inputs: usize, hidden: &[usize]) -> Self {
        Self([&[inputs], hidden, &[1]].concat().into_iter().map(|size| size as u64).collect())
    }

    fn layers(&self) -> impl Iterator<Item = [u64; 2]> {
        self.0.windows(2).map(|pair| [pair[0], pair[1]])
    }

    fn parameters(&self) -> u64 {
        sum(self.layers().map(|[from, to]| (from + 1).saturating_mul(to)))
    }

    /// What a tape of so many rows holds: the input and every layer's output, what is handed back through one layer and on to the one below it,
    /// and the largest factor of a product.
    fn tape(&self, rows: u64, goes_back: bool) -> u64 {
        let handed = if goes_back { 2 * self.0.iter().skip(1).copied().max().unwrap_or(0) } else { 0 };
        let values = rows.saturating_mul(sum(self.0.iter().copied()) + handed);
        let packed = |[from, to]: [u64; 2]| {
            let forth = panels(from, to);
            let back = panels(rows, to).max(panels(to, from));
            if goes_back { forth.max(back) } else { forth }
        };
        values.saturating_add(self.layers().map(packed).max().unwrap_or(0))
    }
}

fn panels(rows: u64, columns: u64) -> u64 {
    (rows + 1).saturating_mul(columns.next_multiple_of(PANEL))
}

fn sum(numbers: impl Iterator<Item = u64>) -> u64 {
    numbers.fold(0, u64::saturating_add)
}

/// About how many bytes each part of a training will take, with the field that decides it: networks with all that goes with them, the
/// working space of an update, the replay memory once it is full, and the draws on which policies are judged.
fn parts(config: &TrainingConfig) -> [(&'static str, u64); 4] {
    let critics = if config.td3.twin_critic { 2 } else { 1 };
    let (seen, besides) = (config.environment.observation.width(), config.learning.privileged());
    let hidden = &config.network.hidden;
    let (actor, critic) = (Shape::new(seen, hidden), Shape::new(seen + besides + 1, hidden));
    // Itself, its target and two moments, and these again in a checkpoint; gradients of one network at a time.
    let actor_copies = 4 + 4 + 1;
    let critic_copies = (4 + 4) * critics + 1;
    // The mean of weights and the best, and these again in a checkpoint; and the one that is judged, which becomes a policy, and its file.
    let judged_copies = 2 * 2 + 4;
    let networks = sum([
        actor.parameters().saturating_mul(actor_copies + judged_copies),
        critic.parameters().saturating_mul(critic_copies),
    ]
    .into_iter());
    let batch = config.learning.batch as u64;
    // The answers to what is seen next are those of an actor whose changes cost something.
    let rows = if config.learning.smoothness_penalty > 0.0 { 2 * batch } else { batch };
    let drawn = batch.saturating_mul(2 * (seen + besides) as u64 + 3);
    // Answers, what is wanted of them, and how it changes with them.
    let answers = 4 * rows;
    let space =
        sum([actor.tape(rows, true), critic.tape(batch, true), critic.tape(batch, false), drawn, answers].into_iter());
    // Itself and its checkpoint, and the places of contacts, of which there may be as many.
    let remembered = 2 * config.remembered().numbers() as u64 + 2;
    let remembered = remembered.saturating_mul(config.replay.capacity as u64);
    let evaluation = &config.evaluation;
    let draws = [
        ("evaluation.ranking_draws", evaluation.ranking_draws),
        ("evaluation.screening_draws", evaluation.screening_draws),
        ("evaluation.useful_draws", evaluation.useful_draws),
    ];
    let most_draws = draws.into_iter().max_by_key(|(_, count)| *count).map_or("evaluation", |(field, _)| field);
    let draws = sum(draws.into_iter().map(|(_, count)| count));
    let bytes = |floats: u64| floats.saturating_mul(size_of::<f32>() as u64);
    [
        ("network.hidden", bytes(networks)),
        ("learning.batch", bytes(space)),
        ("replay.capacity", bytes(remembered)),
        (most_draws, draws.saturating_mul(DRAW_BYTES)),
    ]
}

/// All of them together.
fn bytes(config: &TrainingConfig) -> u64 {
    sum(parts(config).into_iter().map(|(_, bytes)| bytes))
}

/// Whether a training takes no more than [`MOST_BYTES`]. The field that takes most of them is the one to blame.
pub(super) fn check(config: &TrainingConfig) -> Result<(), ConfigError> {
    let (found, most) = (bytes(config), MOST_BYTES);
    if found <= most {
        return Ok(());
    }
    let field = parts(config).into_iter().max_by_key(|(_, bytes)| *bytes).map_or("network.hidden", |(field, _)| field);
    let others: Vec<_> = parts(config).into_iter().map(|(other, _)| other).filter(|other| *other != field).collect();
    let (last, others) = others.split_last().map_or(("", &[][..]), |(last, others)| (*last, others));
    let problem = format!(
        "takes some {} MiB of memory with {} and {last}, and {} MiB are the most",
        found >> 20,
        others.join(", "),
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
        let judged = |config: &mut TrainingConfig| {
            (config.evaluation.screening_draws, config.evaluation.ranking_draws) = (900_000, 1_000_000);
        };
        refused("evaluation.ranking_draws", changed(&judged));
        let wide = |config: &mut TrainingConfig| {
            (config.network.hidden, config.learning.batch, config.replay.capacity) = (vec![2048; 8], 65_536, 65_536);
        };
        refused("learning.batch", changed(&wide));
        changed(&|config| config.network.hidden = vec![1024; 4]).unwrap();
    }

    /// Trainings in processes of their own, whose largest memory the system tells: `takes` is what each does.
    #[cfg(target_os = "linux")]
    mod measured {
        use std::process::Command;

        use super::super::*;
        use crate::rl::{HeldOut, TrainingFolder, Transition};

        /// Of a training whose memory is full, of few decisions and many held-out draws or none.
        fn shape(name: &str) -> TrainingConfig {
            let mut config = TrainingConfig::preset("road").unwrap();
            // An episode is a decision, and makes an update.
            (config.environment.decision_steps, config.exploration.random_episodes, config.episodes) = (1500, 1, 2);
            config.learning.decisions_per_update = 1;
            config.td3.actor_every = 1;
            config.evaluation.every_episodes = 2;
            (config.evaluation.screening_draws, config.evaluation.ranking_draws, config.evaluation.useful_draws) =
                (1, 1, 0);
            config.spaces.clear();
            (config.replay.capacity, config.learning.batch) = (1000, 100);
            match name {
                "nothing" => (config.replay.capacity, config.learning.batch) = (1, 1),
                "large-replay" => config.replay.capacity = 300_000,
                "long-history" => {
                    config.environment.observation.history = 16;
                    (config.replay.capacity, config.learning.batch) = (35_000, 1024);
                    config.learning.privileged_critic = true;
                }
                "big-batch" => {
                    (config.replay.capacity, config.learning.batch) = (12_000, 12_000);
                    config.network.hidden = vec![64; 3];
                }
                "smooth" => {
                    (config.replay.capacity, config.learning.batch) = (16_384, 16_384);
                    config.environment.observation.history = 16;
                    config.network.hidden = vec![32];
                    config.learning.smoothness_penalty = 20.0;
                }
                "wide" => {
                    config.network.hidden = vec![448; 3];
                    config.evaluation.mean_over_updates = 10;
                }
                "draws" => config.evaluation.screening_draws = 10_000,
                other => panic!("{other}"),
            }
            config.check().unwrap();
            config
        }

        #[test]
        #[ignore = "a process of its own, for the test below"]
        fn takes() {
            let mut config = shape(&std::env::var("CRUMPLE_TRAINING_SHAPE").unwrap());
            let held_out = HeldOut::of(&config).unwrap();
            let out = tempfile::tempdir().unwrap();
            // It is begun, and taken up again from its checkpoint.
            for resume in [false, true] {
                let mut folder = TrainingFolder::open(out.path(), &config, 1, resume).unwrap();
                let seen = vec![0.5; config.environment.observation.width()];
                let privileged = vec![0.5; 2 * config.learning.privileged()];
                let room = config.replay.capacity - folder.trainer.replay.len();
                for number in 0..room {
                    folder.trainer.replay.push(&Transition {
                        state: &seen,
                        next_state: &seen,
                        privileged: &privileged,
                        action: 0.0,
                        reward: 1.0,
                        continues: true,
                        contact: number % 2 == 0,
                    });
                }
                let _ = folder.train(&held_out, &mut |_| ());
                config.episodes += 2;
            }
            let status = std::fs::read_to_string("/proc/self/status").unwrap();
            println!("{}", status.lines().find(|line| line.starts_with("VmHWM:")).unwrap());
        }

        fn measured_bytes(shape: &str) -> u64 {
            let test = "rl::memory::tests::measured::takes";
            let mut command = Command::new(std::env::current_exe().unwrap());
            command.args(["--exact", test, "--ignored", "--nocapture", "--test-threads", "1"]);
            let output = command.env("CRUMPLE_TRAINING_SHAPE", shape).output().unwrap();
            let said = String::from_utf8_lossy(&output.stdout).into_owned();
            let kibibytes = said.lines().find_map(|line| line.split_once("VmHWM:")?.1.split_whitespace().next());
            kibibytes.unwrap_or_else(|| panic!("{shape}: {said}")).parse::<u64>().unwrap() << 10
        }

        /// Beyond what a training takes that has nothing to hold, the estimate is what is taken, within a third.
        #[test]
        fn the_estimate_is_what_trainings_take() {
            let nothing = measured_bytes("nothing");
            for name in ["large-replay", "long-history", "big-batch", "smooth", "wide", "draws"] {
                let (estimated, taken) = (bytes(&shape(name)), measured_bytes(name).saturating_sub(nothing));
                let times = estimated as f64 / taken as f64;
                println!("{name}: {} MiB estimated, {} MiB taken, {times:.2}", estimated >> 20, taken >> 20);
                assert!((0.8..1.33).contains(&times), "{name}: {estimated} estimated, {taken} taken");
            }
        }
    }
}
