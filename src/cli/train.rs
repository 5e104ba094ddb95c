//! `crumple train`: trains policies.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use clap::Args;
use indicatif::ProgressBar;

use super::global_options::GlobalOptions;
use super::output_format::OutputFormat;
use super::preset::TrainingPreset;
use super::{CliError, args, interrupt, output, progress};
use crumple_controllers::Controllers;
use crumple_core::observer::Listener;
use crumple_learn::rl::{
    EvaluationSet, SeedResult, SeedTraining, SeedTrainingState, TrainingConfig,
    TrainingConfigError, TrainingError, TrainingEvent, TrainingResult, TrainingSpace, format_table,
    learning_curve, parallel_map, read_finished_trainings, seed_folder,
};
use crumple_store::disk;
use crumple_store::output_folder::{EarlierFiles, OutputFolder};
use crumple_store::run_folder;
use crumple_store::study::StudyFolder;

/// Train a driving policy by reinforcement learning, imitation, or both
#[derive(Args)]
#[command(after_long_help = "\
Presets:
  fast       solves the paper's task within about a minute per seed (default)
  paper-net  `paper` with a penalty on saturated actions and a decision every 0.1 s: reaches the
             paper's return, but does not keep it
  paper      the paper's settings, or crumple's where it states none: takes many hours, and does not
             reach the paper's return
  road       imitates the controller `predictive`

The algorithm is DDPG, or TD3 if a preset says so (Fujimoto, van Hoof and Meger 2018): in `[td3]`, \
`twin_critic = true` uses the minimum of two critics, `actor_every = 2` updates the actor every second time, and \
`target_noise = 0.2` and `target_noise_limit = 0.5` add noise to target actions. The preset of `crumple retrain` uses \
TD3. With `[imitation]`, the policy first learns the answers of a built-in controller in the states that the policy \
reaches (DAgger, Ross et al. 2011). A preset of your own is a file like the built-in ones (schema: \
crates/learn/src/rl/training.schema.json), with rewards (`[environment]` and `[environment.costs]`), observations \
(`[environment.observation]`) and spaces (`[[spaces]]`). Policies of other algorithms can be imported \
(docs/controllers.md).

Every seed gets a folder `seed-N` with `policy.safetensors` (the best policy on the validation set, a controller for \
`simulate`, `assess` and others), `log.jsonl` and `checkpoint.safetensors`. Seeds are trained in parallel; each gives \
the same bytes for any number of threads, also after an interruption. `training.json` and `learning-curve.svg` \
describe all finished seeds in the folder, which must have the same configuration; --resume with more --episodes \
continues a finished training. Files are checked before work resumes (see crumple fsck). crumple refuses a training \
that needs more than 4 GiB of memory for a seed, as estimated from its networks, batches, replay memory and validation \
set. The exit code is 1 if a seed diverges or has no checkpoint better than the untrained network. crumple names such \
seeds, writes no policy for a seed that learned nothing, and finishes the others. docs/training.md describes the \
fields of a preset and the training.

Examples:
  crumple train --seed 7
  crumple train --seeds 30 --out runs/fast
  crumple train --preset road --space traffic=0.5 --space high-risk=0.3 --space wet.toml=0.2
  crumple train --preset road --drives drives
  crumple simulate paper-1 --controller runs/fast/seed-3/policy.safetensors")]
pub(super) struct Train {
    /// Training preset: fast, paper-net, paper or road, or a TOML file of the same form
    #[arg(long, value_name = "PRESET", default_value = "fast")]
    preset: PathBuf,
    /// Draw episodes from this scenario space, built-in or a file, with a weight relative to others (1 by default); may
    /// be repeated, each space once. These spaces, each with a `cost_multiplier` of 1, replace those of the preset
    #[arg(long, value_name = "S[=WEIGHT]", value_parser = parse_space_share)]
    space: Vec<TrainingSpace>,
    /// Folder of recorded drives (see `crumple import --whole`). The best policy is chosen by its collisions,
    /// unnecessary braking, falling behind and jerk in these drives, too. The preset must have `usefulness_draws`
    #[arg(long, value_name = "DIR")]
    drives: Option<String>,
    /// Train this seed [default: 0]
    #[arg(long, value_name = "N", conflicts_with = "seeds", value_parser = args::whole_number::<u64>(0..=u64::MAX))]
    seed: Option<u64>,
    /// Train seeds 0 to N - 1: 1 to 100 000
    #[arg(long, value_name = "N", value_parser = args::whole_number::<u64>(1..=100_000))]
    seeds: Option<u64>,
    /// Folder for policies, logs and checkpoints, created if missing. `training.sha256` lists them; later commands with
    /// this folder replace only listed files
    #[arg(long, value_name = "DIR", default_value = "crumple-training")]
    out: PathBuf,
    /// Resume from the checkpoints in the folder
    #[arg(long)]
    resume: bool,
    /// Maximum number of episodes, instead of the preset's: 1 to 10 000 000
    #[arg(long, value_name = "N", value_parser = args::whole_number::<u64>(1..=10_000_000))]
    episodes: Option<u64>,
    /// Output format of the results
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

fn parse_space_share(words: &str) -> Result<TrainingSpace, String> {
    let (space, weight) = args::parse_weighted_name(words)?;
    Ok(TrainingSpace {
        space,
        weight,
        cost_multiplier: 1.0,
        uniform_share: 0.0,
    })
}

impl Train {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        let config = self.config(controllers)?;
        let seeds: Vec<u64> = match self.seeds {
            Some(count) => (0..count).collect(),
            None => vec![self.seed.unwrap_or(0)],
        };
        self.refuse_existing_seeds(&seeds)?;
        self.refuse_linked_seeds(&seeds)?;
        disk::make_folder(&self.out)?;
        let held_out = EvaluationSet::from_config(&config)?;
        self.check_folder(&config, &held_out, &seeds, quiet)?;
        let trained = self.train_all(&config, &held_out, &seeds, quiet);
        // An error of one seed does not stop the others.
        let mut done = Vec::new();
        let mut failure = None;
        for result in trained {
            match result {
                Ok(result) => done.push(result),
                Err(first) => failure = failure.or(Some(first)),
            }
        }
        let mut printed = Ok(());
        if !done.is_empty() {
            run_folder::with_folder_lock(&self.out, || {
                write_results(&self.out, &config, &held_out, quiet)
            })?;
            printed = output::print_result(self.format, &done, || {
                format_table(&done, config.evaluation.ranking_draws)
            });
        }
        CliError::verdict_first(failure.map_or_else(|| check_learned(&done), Err), printed)
    }

    fn refuse_existing_seeds(&self, seeds: &[u64]) -> Result<(), CliError> {
        if self.resume {
            return Ok(());
        }
        let mut folders = seeds.iter().map(|seed| seed_folder(&self.out, *seed));
        match folders.find(|folder| folder.exists()) {
            Some(existing) => Err(CliError::Input(format!(
                "{} exists: use --resume, or another --out",
                existing.display()
            ))),
            None => Ok(()),
        }
    }

    /// Refuses folders of seeds that are symbolic links: a training writes only inside its folder.
    fn refuse_linked_seeds(&self, seeds: &[u64]) -> Result<(), CliError> {
        let mut folders = seeds.iter().map(|seed| seed_folder(&self.out, *seed));
        match folders.find(|folder| folder.is_symlink()) {
            Some(link) => Err(CliError::at(
                &link,
                "is a symbolic link, and `train` writes only inside its folder: use another --out",
            )),
            None => Ok(()),
        }
    }

    /// Fails before the training if existing results conflict, and notes if there is nothing to resume.
    fn check_folder(
        &self,
        config: &TrainingConfig,
        held_out: &EvaluationSet,
        seeds: &[u64],
        quiet: bool,
    ) -> Result<(), CliError> {
        read_finished_trainings(&self.out, config, held_out)?;
        // Another training with the same --out may be writing them.
        check_results_folder(&self.out).or_else(|_| {
            run_folder::with_folder_lock(&self.out, || check_results_folder(&self.out))
        })?;
        interrupt::set_resume_message("the results so far are in", &self.out, quiet);
        refuse_other_work(&self.out)?;
        // Seeds may be added to existing ones; without any, a misspelt --out is likely.
        if !seeds
            .iter()
            .any(|seed| run_folder::is_run_folder(&seed_folder(&self.out, *seed)))
        {
            output::note_nothing_to_resume(self.resume, &self.out, quiet);
        }
        Ok(())
    }

    /// Trains all seeds in parallel. Returns the result of each.
    fn train_all(
        &self,
        config: &TrainingConfig,
        held_out: &EvaluationSet,
        seeds: &[u64],
        quiet: bool,
    ) -> Vec<Result<SeedResult, CliError>> {
        let episodes = config.episodes.saturating_mul(seeds.len() as u64);
        let bar = progress::training_bar(episodes, quiet);
        let trained = parallel_map(seeds, rayon::current_num_threads(), |seed| {
            let training = SeedTraining {
                config,
                seed: *seed,
                held_out,
            };
            let result = self.train(&training, &bar);
            if let (Err(failure), true) = (&result, seeds.len() > 1) {
                bar.suspend(|| output::note(&format!("seed {seed}: {failure}"), quiet));
            }
            result
        });
        bar.finish_and_clear();
        trained
    }

    fn config(&self, controllers: Controllers) -> Result<TrainingConfig, CliError> {
        let preset = TrainingPreset::find(&self.preset)?;
        let mut config = preset.config.clone();
        config.controllers = controllers;
        config.episodes = self.episodes.unwrap_or(config.episodes);
        if !self.space.is_empty() {
            config.spaces.clone_from(&self.space);
        }
        // Check spaces and drives before a folder is created.
        match config.scenario_source() {
            Ok(_) => preset.with_drives(config, self.drives.as_deref()),
            Err(error) if self.space.is_empty() => Err(preset.error_at_line(error)),
            Err(error) => Err(self.option_error(&error)),
        }
    }

    /// Returns an error about scenario spaces that options name, in terms of the option.
    fn option_error(&self, error: &TrainingConfigError) -> CliError {
        let field = match error {
            TrainingConfigError::Field(invalid) => &invalid.field,
            TrainingConfigError::Range { field, .. } => field,
            _ => return CliError::Input(format!("--space: {error}")),
        };
        let index = field
            .strip_prefix("spaces[")
            .and_then(|rest| rest.split(']').next()?.parse::<usize>().ok());
        let message = error.to_string();
        let message = message
            .strip_prefix(&format!("{field}: "))
            .unwrap_or(&message);
        let weight = if field.ends_with(".weight") {
            "the weight "
        } else {
            ""
        };
        match index.and_then(|index| self.space.get(index)) {
            Some(share) => CliError::Input(format!("--space {}: {weight}{message}", share.space)),
            None => CliError::Input(format!("--space: {message}")),
        }
    }

    fn train(
        &self,
        training: &SeedTraining<'_>,
        bar: &ProgressBar,
    ) -> Result<SeedResult, CliError> {
        let folder = seed_folder(&self.out, training.seed);
        let study = StudyFolder::open(training, &folder, self.resume)?;
        let earlier_episodes = study.state().map(SeedTrainingState::episode);
        bar.inc(earlier_episodes.unwrap_or(0));
        let shown = Mutex::new(SeedProgress::new(training.seed, bar));
        let result = study.run(&Listener(|event: &TrainingEvent| {
            shown
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .update(event)
        }))?;
        // A finished training shows no episodes.
        let shown_episodes = earlier_episodes.map_or(0, |_| result.episodes);
        bar.inc(training.config.episodes.saturating_sub(shown_episodes));
        Ok(result)
    }
}

/// Files that every training with the same --out writes anew.
const RESULT_FILES: [&str; 3] = ["training.json", "learning-curve.json", "learning-curve.svg"];

fn refuse_other_work(out: &Path) -> Result<(), CliError> {
    if run_folder::is_run_folder(out) {
        return Err(CliError::at(
            out,
            "holds other work: trainings need an --out of their own",
        ));
    }
    Ok(())
}

fn check_results_folder(out: &Path) -> Result<(), CliError> {
    Ok(results_folder(out)?.check(&RESULT_FILES)?)
}

fn results_folder(out: &Path) -> Result<OutputFolder, CliError> {
    Ok(OutputFolder::with_listing(out, "training.sha256")?)
}

/// Writes the results of all seeds in the folder, including those of earlier commands.
fn write_results(
    out: &Path,
    config: &TrainingConfig,
    held_out: &EvaluationSet,
    quiet: bool,
) -> Result<(), CliError> {
    let (results, logs): (Vec<_>, Vec<_>) = read_finished_trainings(out, config, held_out)?
        .into_iter()
        .unzip();
    let all = TrainingResult::new(config, &results);
    let curve = learning_curve(&config.name, &logs);
    let contents = [
        serde_json::to_string_pretty(&all).map_err(CliError::input)? + "\n",
        serde_json::to_string_pretty(&curve).map_err(CliError::input)? + "\n",
        crumple_report::figures::draw_learning_curve(&curve).document(),
    ];
    let files: Vec<_> = RESULT_FILES
        .iter()
        .map(|name| (*name).to_owned())
        .zip(contents.map(String::into_bytes))
        .collect();
    results_folder(out)?.write(&files, EarlierFiles::Keep)?;
    let picture = out.join("learning-curve.svg");
    let seeds = if results.len() == 1 {
        "1 seed".to_owned()
    } else {
        format!("{} seeds", results.len())
    };
    output::note(
        &format!("wrote {} (and training.json) of {seeds}", picture.display()),
        quiet,
    );
    Ok(())
}

/// Checks that every seed has a checkpoint better than the untrained network.
fn check_learned(results: &[SeedResult]) -> Result<(), CliError> {
    let unlearned = results.iter().filter(|result| !result.has_learned());
    let seeds: Vec<_> = unlearned.map(|result| result.seed.to_string()).collect();
    if seeds.is_empty() {
        return Ok(());
    }
    let seeds = seeds.join(", ");
    Err(CliError::Unmet(format!(
        "no checkpoint was better than the untrained network, so no policy was written: seed {seeds}"
    )))
}

struct SeedProgress<'a> {
    seed: u64,
    bar: &'a ProgressBar,
    rewards: VecDeque<f64>,
    safe_share: Option<f64>,
    begin: Instant,
}

const REWARD_WINDOW: usize = 20;

impl<'a> SeedProgress<'a> {
    fn new(seed: u64, bar: &'a ProgressBar) -> Self {
        Self {
            seed,
            bar,
            rewards: VecDeque::new(),
            safe_share: None,
            begin: Instant::now(),
        }
    }

    fn update(&mut self, event: &TrainingEvent) {
        match event {
            TrainingEvent::Episode(record) => {
                self.rewards.push_back(record.reward);
                if self.rewards.len() > REWARD_WINDOW {
                    self.rewards.pop_front();
                }
                let mean = self.rewards.iter().sum::<f64>() / self.rewards.len() as f64;
                let safe = self
                    .safe_share
                    .map_or("-".to_owned(), |share| format!("{:.0} %", 100.0 * share));
                self.bar.set_message(format!(
                    "seed {} episode {}, mean reward {mean:.0}, safe {safe}",
                    self.seed, record.episode
                ));
                self.bar.inc(1);
            }
            TrainingEvent::Imitation(done) => {
                // A round fits all rows so far, so its time is about proportional to its number.
                let [work_done, work] = [done.round, done.rounds]
                    .map(|rounds| 0.5 * f64::from(rounds) * (f64::from(rounds) + 1.0));
                let left = progress::format_time_left(self.begin.elapsed(), work_done, work);
                self.bar.set_message(format!(
                    "seed {} imitation {} of {}, {} decisions, {:.1} % of the drives collided{left}",
                    self.seed,
                    done.round,
                    done.rounds,
                    done.rows,
                    100.0 * done.collision_share
                ));
            }
            TrainingEvent::Evaluation { result, .. } => self.safe_share = Some(result.safe_share),
            // Shown in the log only.
            _ => {}
        }
    }
}

impl From<TrainingError> for CliError {
    fn from(error: TrainingError) -> Self {
        match error {
            diverged @ TrainingError::Diverged { .. } => Self::Unmet(diverged.to_string()),
            TrainingError::Disk(error) => error.into(),
            TrainingError::RunFolder(error) => error.into(),
            other => Self::input(other),
        }
    }
}
