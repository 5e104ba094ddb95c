//! `crumple retrain`: retrains a policy on counterexamples of a search.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use clap::Args;

mod inputs;
mod progress_line;

use inputs::{load_attacked, load_regression_spaces, load_spaces};
use progress_line::ProgressLine;

use super::global_options::GlobalOptions;
use super::output_format::OutputFormat;
use super::preset::{RETRAIN_PRESET_NAMES, TrainingPreset, replace_drives};
use super::{CliError, args, output, progress, study};
use crumple_controllers::Controllers;
use crumple_core::observer::Listener;
use crumple_learn::retrain::{
    RetrainError, RetrainingPlan, RetrainingProgress, RetrainingReport, RetrainingSettings,
    SearchedSpaces, training_preset,
};
use crumple_learn::rl::TrainingConfig;
use crumple_search::falsify::Method;
use crumple_sim::engine::NamedController;
use crumple_sim::policy::Policy;

const DEFAULTS: RetrainingSettings = RetrainingSettings::DEFAULT;

/// Retrain a policy on avoidable failures that a search finds; accept no regression
#[derive(Args)]
#[command(after_long_help = "\
Each round searches every --space for collisions of the policy, simulates every --scenario, and collects the avoidable \
collisions. It then trains the policy on these, mixed with random scenarios of the preset's spaces (if the preset has \
none, of the paper's distribution and --space), and evaluates the best checkpoint. With `[imitation]` in the preset \
(`road`), the policy imitates the expert in these scenarios. crumple accepts the checkpoint only if
  - no scenario of the paper, and none of the --nominal random ones of its distribution, has a new collision
  - collisions on the validation set do not increase, and they decrease there or in the collected scenarios
  - the policy is significantly worse than before the round in none of the --regression spaces: by collisions and, in \
spaces in which `idm` has none of three faults (collision, hard unnecessary braking, falling behind), also by \
scenarios in which the policy has one (McNemar's exact one-sided test on the same random scenarios, p below 0.01)
  - with `usefulness_draws` in the preset, drives of `traffic` have no more collisions, hard unnecessary braking or \
vehicles that fall behind than before the round; rms jerk and rms acceleration exceed the larger value of the initial \
policy and of `idm` by at most 1 % of that of `idm`; and the mean time gap is further outside 1.2 to 2.1 s than that \
of the initial policy by at most 1 % of the nearer limit
  - with `usefulness_draws`, the number of drives of `everyday` in which the policy has a fault (collision, \
unnecessary or hard unnecessary braking, falling behind) and `idm` has none does not increase, and the rms jerk there \
has the same limit; with --drives, also in the recorded drives
  - with `usefulness_draws`, behind a leader that slows down and recovers, the last of five vehicles changes its speed \
at most as much as the leader, or as with the policy before the round
The retraining ends after --rounds, or when a round finds no avoidable collision, and then evaluates the result on the \
test set.

The folder contains the policy, the training, validation and test sets, a report (report.md, report.json) with their \
hashes, and each round. --resume continues an interrupted retraining, even after `kill -9`, and gives the same bytes \
with any number of threads. The exit code is 1 if rounds were made and none was accepted, or if the \
policy collides in a scenario of the paper.

Examples:
  crumple retrain --out runs/retrained
  crumple retrain --policy road
  crumple retrain --regression none
  crumple retrain --policy runs/seed-3/policy.safetensors --space wet.toml --rounds 3 \\
    --test-draws 20000
  crumple simulate paper-1 --controller runs/retrained/policy.safetensors --expect safe")]
pub(super) struct Retrain {
    /// Initial policy: `policy`, `retrained` (see `crumple list controllers --all`), `road`, or a policy file
    #[arg(long, value_name = "P", default_value = "policy", value_parser = args::parse_own_policy)]
    policy: NamedController,
    /// Scenario space for searches and random scenarios: built-in (see `crumple list spaces`) or a file; may be
    /// repeated [default: the spaces of the preset, or `high-risk` if it has none]
    #[arg(long, value_name = "S")]
    space: Vec<String>,
    /// Scenario that each round also simulates, as it is and, if its leader follows a script, with that leader's
    /// worst-case braking: built-in, a file, or a folder, for example of collisions that a fuzz target wrote; may be
    /// repeated, `none` for none [default: if the preset has `[imitation]`, paper-1 and paper-2, otherwise none]
    #[arg(long, value_name = "F")]
    scenario: Vec<PathBuf>,
    /// Training preset: `retrain`, a preset of `crumple train`, or a TOML file of the same form
    /// [default: `road` for a policy made by imitation, otherwise `retrain`]
    #[arg(long, value_name = "PRESET")]
    preset: Option<PathBuf>,
    /// Maximum number of rounds: 1 to 99
    #[arg(long, value_name = "N", default_value_t = DEFAULTS.rounds, value_parser = args::whole_number::<u64>(1..=99))]
    rounds: u64,
    /// Episodes of reinforcement learning per round: 1 to 1 000 000, or 0 with an imitation
    /// [default: 1000; with an imitation, those of the preset]
    #[arg(long, value_name = "N", value_parser = args::whole_number::<u64>(0..=1_000_000))]
    episodes: Option<u64>,
    /// Search method (see `crumple list methods`)
    #[arg(long, value_name = "M", default_value = "auto")]
    method: Method,
    /// Evaluations per round and space of the search method, and of each of two reference searches (uniform points, a
    /// Halton sequence): 1 to 1 000 000
    #[arg(long, value_name = "N", default_value_t = DEFAULTS.budget)]
    #[arg(value_parser = args::whole_number::<u64>(1..=1_000_000))]
    budget: u64,
    /// Random scenarios of each space that a round simulates in addition: up to 1 000 000
    #[arg(long, value_name = "N", default_value_t = DEFAULTS.draws)]
    #[arg(value_parser = args::whole_number::<u64>(0..=1_000_000))]
    draws: u64,
    /// Avoidable random scenarios per space of the validation set, which accepts or rejects a round: 1 to 1 000 000
    #[arg(long, alias = "kept-aside", value_name = "N", default_value_t = DEFAULTS.validation_draws)]
    #[arg(value_parser = args::whole_number::<u64>(1..=1_000_000))]
    validation_draws: u64,
    /// Further random scenarios that accept or reject a round: this number of the paper's distribution and, with
    /// `usefulness_draws` in the preset, of each of the spaces `traffic` and `everyday`; 1 to 1 000 000
    #[arg(long, value_name = "N", default_value_t = DEFAULTS.nominal)]
    #[arg(value_parser = args::whole_number::<u64>(1..=1_000_000))]
    nominal: u64,
    /// Scenario space in which no round may make the policy worse, built-in or a file; may be repeated, `none` for none
    /// [default: all built-in spaces except high-risk-human and traffic-human]
    #[arg(long, value_name = "S")]
    regression: Vec<String>,
    /// Random scenarios of each of these spaces: 1 to 10 000
    #[arg(long, value_name = "N", default_value_t = DEFAULTS.regression)]
    #[arg(value_parser = args::whole_number::<u64>(1..=10_000))]
    regression_draws: u64,
    /// Avoidable random scenarios per space of the test set, which evaluates the result: 1 to 10 000 000
    #[arg(long, alias = "judge", value_name = "N", default_value_t = DEFAULTS.test_draws)]
    #[arg(value_parser = args::whole_number::<u64>(1..=10_000_000))]
    test_draws: u64,
    /// Folder of recorded drives (see `crumple import --whole`), in which no round may make the policy less useful; the
    /// preset needs `usefulness_draws` (docs/training.md), as `road` has
    #[arg(long, value_name = "DIR")]
    drives: Option<String>,
    /// Seed of searches and trainings
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = args::whole_number::<u64>(0..=i64::MAX as u64))]
    seed: u64,
    /// Folder of the retraining, created if missing
    #[arg(long, value_name = "DIR", default_value = "crumple-retrain")]
    out: PathBuf,
    /// Resume the retraining in the folder
    #[arg(long)]
    resume: bool,
    /// Output format of the report: Markdown, or one JSON object
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl Retrain {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let quiet = global.quiet;
        let policy = self.policy.policy().ok_or_else(|| {
            CliError::Input(format!("--policy: `{}` is no policy", self.policy.name))
        })?;
        let imitates = policy.header().training.get("imitation").is_some();
        let default_preset = if imitates {
            "road"
        } else {
            RETRAIN_PRESET_NAMES[0]
        };
        let preset = self.preset.as_deref().unwrap_or(Path::new(default_preset));
        let plan = self.plan(policy, preset, global)?;
        let study = study::open(&plan, &self.out, self.resume, quiet)
            .map_err(|error| with_preset_name(error, preset))?;
        let bar = progress::status_line(quiet);
        let line = Mutex::new(ProgressLine {
            bar: &bar,
            rounds: self.rounds,
            step: None,
        });
        let report = study.run(&Listener(|state: &RetrainingProgress| {
            line.lock()
                .unwrap_or_else(PoisonError::into_inner)
                .show(state)
        }));
        bar.finish_and_clear();
        let report = report.map_err(|error| with_preset_name(error, preset))?;
        output::note(&report.ending_sentence(), quiet);
        output::note(
            &format!(
                "wrote {} (policy.safetensors, corpora, report.md, report.json)",
                self.out.display()
            ),
            quiet,
        );
        let printed = output::print_result(self.format, &report, || report.to_markdown());
        CliError::verdict_first(check_accepted(&report), printed)
    }

    fn plan(
        &self,
        policy: Arc<Policy>,
        preset: &Path,
        global: GlobalOptions,
    ) -> Result<RetrainingPlan, CliError> {
        let controllers = global.controllers;
        let training = load_training_config(preset, self.drives.as_deref(), controllers)?;
        let settings = self.settings(&training, preset)?;
        let spaces = self.searched_spaces(&training, controllers)?;
        let regression_spaces = load_regression_spaces(&self.regression, controllers)?;
        let regression = if regression_spaces.is_empty() {
            0
        } else {
            self.regression_draws
        };
        Ok(RetrainingPlan {
            initial_policy: policy,
            initial_policy_name: self.policy.name.clone(),
            spaces,
            attacked: load_attacked(&self.scenario, training.imitation.is_some(), global)?,
            regression_spaces,
            training,
            method: self.method.clone(),
            seed: self.seed,
            settings: RetrainingSettings {
                regression,
                ..settings
            },
        })
    }

    /// Returns the settings, without the number of scenarios of each regression space.
    fn settings(
        &self,
        training: &TrainingConfig,
        preset: &Path,
    ) -> Result<RetrainingSettings, CliError> {
        let imitates = training.imitation.is_some();
        if self.episodes == Some(0) && !imitates {
            return Err(CliError::Input(format!(
                "--episodes: the preset `{}` has no imitation and needs at least 1",
                preset.display()
            )));
        }
        let default_episodes = if imitates {
            training.episodes
        } else {
            DEFAULTS.episodes
        };
        Ok(RetrainingSettings {
            rounds: self.rounds,
            episodes: self.episodes.unwrap_or(default_episodes),
            budget: self.budget,
            draws: self.draws,
            validation_draws: self.validation_draws,
            nominal: self.nominal,
            test_draws: self.test_draws,
            // The spaces of the preset replace the paper's distribution.
            nominal_share: if training.spaces.is_empty() {
                DEFAULTS.nominal_share
            } else {
                0.0
            },
            ..DEFAULTS
        })
    }

    /// Loads the spaces of `--space`, by default those of the preset.
    fn searched_spaces(
        &self,
        training: &TrainingConfig,
        controllers: Controllers,
    ) -> Result<SearchedSpaces, CliError> {
        let mut names = self.space.clone();
        if names.is_empty() {
            names.extend(training.spaces.iter().map(|space| space.space.clone()));
        }
        if names.is_empty() {
            names.push("high-risk".to_owned());
        }
        SearchedSpaces::new(load_spaces("--space", &names, controllers)?)
            .ok_or_else(|| CliError::Input("--space: there is no space".to_owned()))
    }
}

/// Returns an error about the preset under the given name: its file still contains the former name.
fn with_preset_name(error: RetrainError, preset: &Path) -> RetrainError {
    match error {
        RetrainError::PolicyMismatch { policy, what, .. } => RetrainError::PolicyMismatch {
            policy,
            preset: preset.display().to_string(),
            what,
        },
        other => other,
    }
}

fn check_accepted(report: &RetrainingReport) -> Result<(), CliError> {
    let collisions = &report.retrained_results.paper;
    if !collisions.is_empty() {
        return Err(CliError::Unmet(format!(
            "seed {}: the policy collides in {}",
            report.seed,
            collisions.join(", ")
        )));
    }
    if report.rounds.is_empty() || report.is_retrained() {
        return Ok(());
    }
    Err(CliError::Unmet(format!(
        "no round was accepted: `{}` is unchanged",
        report.first
    )))
}

fn load_training_config(
    name: &Path,
    drives: Option<&str>,
    controllers: Controllers,
) -> Result<TrainingConfig, CliError> {
    if RETRAIN_PRESET_NAMES.map(Path::new).contains(&name) {
        let mut config = training_preset().map_err(CliError::input)?;
        config.controllers = controllers;
        return match drives {
            Some(folder) => replace_drives(config, folder),
            None => Ok(config),
        };
    }
    let preset = TrainingPreset::find_with_own(RETRAIN_PRESET_NAMES[0], name)?;
    preset.into_checked_config(controllers, drives)
}
