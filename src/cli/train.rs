//! `crumple train`: learn to drive.

use std::collections::VecDeque;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use indicatif::ProgressBar;
use serde::Serialize;

use super::output;
use super::{Failure, progress};
use crumple_learn::rl::{
    Evaluation, Event, HeldOut, LearningCurve, Observer, Trainer, TrainingConfig, TrainingError, UNSEEN_DRAWS,
    side_by_side, train, unseen_contacts,
};
use crumple_search::disk::{self, DiskError, Files};

/// Train a driving policy by reinforcement learning
#[derive(Args)]
#[command(after_long_help = "\
Presets:
  fast       masters the paper's task within a minute a seed (default)
  paper-net  the paper's networks and reward, changed only where needed to converge
  paper      the paper's setting, literally: hours, and no promise

Every seed gets a folder `seed-N` with `policy.safetensors` (the best policy by evaluation on held-out scenarios, a \
controller for every other subcommand), `log.jsonl` and `checkpoint.safetensors`. Seeds are trained side by side; each \
gives the same bytes whatever the number of threads, and whether or not it was interrupted and resumed.

Examples:
  crumple train --seed 7
  crumple train --seeds 30 --out runs/fast
  crumple simulate paper-1 --controller runs/fast/seed-3/policy.safetensors")]
pub(super) struct Train {
    /// How to train: fast, paper-net or paper, or a TOML file like theirs
    #[arg(long, value_name = "PRESET", default_value = "fast")]
    preset: String,
    /// Train this seed [default: 0]
    #[arg(long, value_name = "N", conflicts_with = "seeds")]
    seed: Option<u64>,
    /// Train seeds 0 to N - 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: Option<u64>,
    /// Folder for policies, logs and checkpoints; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "crumple-training")]
    out: PathBuf,
    /// Go on from the checkpoints in the folder
    #[arg(long)]
    resume: bool,
    /// Episodes at most, instead of the preset's
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    episodes: Option<u64>,
}

/// One seed's line in `training.json` and on standard output.
#[derive(Serialize)]
struct SeedResult {
    seed: u64,
    episodes: u64,
    best_episode: Option<u64>,
    #[serde(flatten)]
    evaluation: Option<Evaluation>,
    /// Contacts among 1000 draws that took no part in training or selection.
    unseen_contacts: u64,
    policy_sha256: String,
}

#[derive(Serialize)]
struct TrainingResult<'a> {
    version: &'static str,
    config: &'a TrainingConfig,
    seeds: &'a [SeedResult],
}

impl Train {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        let config = self.config()?;
        let seeds: Vec<u64> = match self.seeds {
            Some(count) => (0..count).collect(),
            None => vec![self.seed.unwrap_or(0)],
        };
        let folder = |seed: &u64| self.out.join(format!("seed-{seed}"));
        if let Some(taken) = seeds.iter().map(folder).find(|folder| !self.resume && folder.exists()) {
            let taken = taken.display();
            return Err(Failure::Input(format!("{taken} is there already: use --resume, or another --out")));
        }
        let held_out = HeldOut::new(&config.evaluation, &config.environment);
        let bar = progress::training_bar(config.episodes.saturating_mul(seeds.len() as u64), quiet);
        let results = side_by_side(&seeds, rayon::current_num_threads(), |seed| {
            let folder = folder(seed);
            fs::create_dir_all(&folder).map_err(DiskError::at(&folder))?;
            let result = train_seed(&config, *seed, &held_out, &folder, self.resume, &bar);
            if let (Err(failure), true) = (&result, seeds.len() > 1) {
                bar.suspend(|| output::note(&format!("seed {seed}: {failure}"), quiet));
            }
            result
        });
        bar.finish_and_clear();
        // A seed that failed takes nothing from the others.
        let (mut done, mut failure) = (Vec::new(), None);
        for result in results {
            match result {
                Ok(result) => done.push(result),
                Err(first) => failure = failure.or(Some(first)),
            }
        }
        if !done.is_empty() {
            self.write_results(&config, &done, quiet)?;
        }
        failure.map_or(Ok(()), Err)
    }

    fn config(&self) -> Result<TrainingConfig, Failure> {
        let path = Path::new(&self.preset);
        let mut config = if path.extension().is_some() {
            let text = crumple_world::scenario::file::read(path)?;
            TrainingConfig::parse(&text).map_err(|error| Failure::Input(format!("{}: {error}", path.display())))?
        } else {
            TrainingConfig::preset(&self.preset).map_err(Failure::input)?
        };
        config.episodes = self.episodes.unwrap_or(config.episodes);
        Ok(config)
    }

    fn write_results(&self, config: &TrainingConfig, results: &[SeedResult], quiet: bool) -> Result<(), Failure> {
        let mut files = Files::default();
        let all = TrainingResult { version: env!("CARGO_PKG_VERSION"), config, seeds: results };
        let json = serde_json::to_string_pretty(&all).map_err(Failure::input)?;
        files.stage(&self.out.join("training.json"), format!("{json}\n").as_bytes())?;
        let logs = results
            .iter()
            .map(|result| {
                let path = self.out.join(format!("seed-{}", result.seed)).join(LOG);
                fs::read_to_string(&path).map_err(DiskError::at(&path))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let curve = LearningCurve::from_logs(&config.name, &logs);
        let json = serde_json::to_string_pretty(&curve).map_err(Failure::input)?;
        files.stage(&self.out.join("learning-curve.json"), format!("{json}\n").as_bytes())?;
        files.stage(
            &self.out.join("learning-curve.svg"),
            crumple_report::figures::learning_curve(&curve).document().as_bytes(),
        )?;
        files.commit()?;
        let curve = self.out.join("learning-curve.svg");
        output::note(&format!("wrote {} (and training.json)", curve.display()), quiet);
        output::print(&table(results, config.evaluation.ranking_draws))
    }
}

const LOG: &str = "log.jsonl";
const CHECKPOINT: &str = "checkpoint.safetensors";
const POLICY: &str = "policy.safetensors";

fn train_seed(
    config: &TrainingConfig,
    seed: u64,
    held_out: &HeldOut,
    folder: &Path,
    resume: bool,
    bar: &ProgressBar,
) -> Result<SeedResult, Failure> {
    let path = folder.join(CHECKPOINT);
    let earlier = if resume { disk::read(&path)? } else { None };
    let mut trainer = match earlier {
        Some(bytes) => Trainer::from_checkpoint(&bytes, config, seed).map_err(|error| match error {
            TrainingError::Checkpoint(_) => Failure::Input(format!("{}: {error}", path.display())),
            other => other.into(),
        })?,
        None => Trainer::new(config, seed),
    };
    let mut scribe = CheckpointWriter::new(folder, &trainer, bar)?;
    train::<Failure>(&mut trainer, held_out, &mut scribe)?;
    bar.inc(config.episodes.saturating_sub(trainer.episode()));
    let policy = Arc::new(trainer.policy()?);
    Ok(SeedResult {
        seed,
        episodes: trainer.episode(),
        best_episode: trainer.best().map(|best| best.episode),
        evaluation: trainer.best().map(|best| best.evaluation),
        unseen_contacts: unseen_contacts(&policy, config.environment.estimator)?,
        policy_sha256: policy.digest(),
    })
}

/// Writes one seed's log and checkpoints, and tells the progress bar.
struct CheckpointWriter<'a> {
    seed: u64,
    folder: &'a Path,
    log: File,
    bar: &'a ProgressBar,
    rewards: VecDeque<f64>,
    safe_share: Option<f64>,
}

/// Episodes whose mean reward the progress bar shows.
const RECENT: usize = 20;

impl<'a> CheckpointWriter<'a> {
    /// A log that begins empty, or goes on after the entries of the episodes that the training has done.
    fn new(folder: &'a Path, trainer: &Trainer, bar: &'a ProgressBar) -> Result<Self, Failure> {
        let (path, episode) = (folder.join(LOG), trainer.episode());
        let before = if episode > 0 { disk::read(&path)?.unwrap_or_default() } else { Vec::new() };
        let before = String::from_utf8_lossy(&before);
        let kept: String = before
            .split_inclusive('\n')
            .take_while(|line| {
                line.ends_with('\n') && crumple_learn::rl::episode_of(line).is_some_and(|e| e <= episode)
            })
            .collect();
        disk::write(&path, kept)?;
        bar.inc(episode);
        let log = OpenOptions::new().append(true).open(&path).map_err(DiskError::at(&path))?;
        Ok(Self { seed: trainer.seed(), folder, log, bar, rewards: VecDeque::new(), safe_share: None })
    }
}

impl Observer<Failure> for CheckpointWriter<'_> {
    fn event(&mut self, event: &Event) -> Result<(), Failure> {
        let line = serde_json::to_string(event).map_err(Failure::input)?;
        writeln!(self.log, "{line}").map_err(DiskError::at(&self.folder.join(LOG)))?;
        match event {
            Event::Episode(record) => {
                self.rewards.push_back(record.reward);
                if self.rewards.len() > RECENT {
                    self.rewards.pop_front();
                }
                let mean = self.rewards.iter().sum::<f64>() / self.rewards.len() as f64;
                let safe = self.safe_share.map_or("-".to_owned(), |share| format!("{:.0} %", 100.0 * share));
                self.bar.set_message(format!(
                    "seed {} episode {}, mean reward {mean:.0}, safe {safe}",
                    self.seed, record.episode
                ));
                self.bar.inc(1);
            }
            Event::Evaluation { result, .. } => self.safe_share = Some(result.safe_share),
            // The log has it; the bar has no place for it.
            _ => {}
        }
        Ok(())
    }

    fn checkpoint(&mut self, trainer: &Trainer) -> Result<(), Failure> {
        let mut files = Files::default();
        let policy = trainer.policy()?.to_bytes().map_err(TrainingError::from)?;
        files.stage(&self.folder.join(POLICY), &policy)?;
        files.stage(&self.folder.join(CHECKPOINT), &trainer.to_checkpoint()?)?;
        Ok(files.commit()?)
    }
}

/// The result for a reader.
fn table(results: &[SeedResult], ranking_draws: u64) -> String {
    let mut text = format!(
        "{:>6} {:>8} {:>6}  {:<8} {:<8} {:<8} {:>10} {:>10} {:>7}  {}\n",
        "seed", "episodes", "best", "paper-1", "paper-2", "paper-3", "held out", "unseen", "gap m", "policy"
    );
    for result in results {
        let Some(found) = &result.evaluation else { continue };
        let paper = found.paper_safe.map(|safe| if safe { "safe" } else { "CONTACT" });
        let held_out = match found.ranking_contacts {
            Some(contacts) => format!("{contacts}/{ranking_draws}"),
            None => format!("{:.0} % safe", 100.0 * found.safe_share),
        };
        text += &format!(
            "{:>6} {:>8} {:>6}  {:<8} {:<8} {:<8} {held_out:>10} {:>10} {:>7.2}  {}\n",
            result.seed,
            result.episodes,
            result.best_episode.unwrap_or_default(),
            paper[0],
            paper[1],
            paper[2],
            format!("{}/{UNSEEN_DRAWS}", result.unseen_contacts),
            found.smallest_gap_m,
            result.policy_sha256.get(..12).unwrap_or_default()
        );
    }
    text + "held out, unseen: contacts in draws that select the policy, and in draws that had no part in it; gap: smallest \
            over all but the unseen\n"
}

impl From<TrainingError> for Failure {
    fn from(error: TrainingError) -> Self {
        match error {
            diverged @ TrainingError::Diverged { .. } => Self::Gate(diverged.to_string()),
            TrainingError::Disk(error) => error.into(),
            other => Self::input(other),
        }
    }
}
