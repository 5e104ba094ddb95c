//! `crumple plan`: derives runs, shards, hours, bytes and job files from a failure rate to show.

mod files;
mod work;

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::simulate::OutputFormat;
use super::{CliError, args, output, value_enums};
use crumple_store::jobs::Engine;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::space::ScenarioSpace;
use crumple_world::sim::NamedController;
use files::PlanSummary;

/// Plan a count on many machines, with job files for HyperQueue, Ray, Slurm
#[derive(Args)]
#[command(after_long_help = "\
--rate-below or --runs is required. `plan` measures the pace on one core of this machine, with runs of another seed, \
so that no counted run is known in advance. DIR gets `plan.json`, `task.sh`, which runs one shard, and a file for \
each engine: `hyperqueue_job.py`, `ray_job.py` and `slurm.sh`. Start them in the folder in which `plan` was \
run, so that relative paths refer to the same files, with the same build of crumple on all machines \
(docs/many-machines.md).

Other work needs no plan: run searches and trainings with other seeds, suites with fewer tests, and assessments with \
fewer controllers on each machine.

Examples:
  crumple plan --controller shield:policy --estimator truth --rate-below 1e-6 --out campaign
  crumple plan --controller policy --runs 10000000 --shards 64 --engine slurm --out campaign")]
pub(super) struct PlanCommand {
    /// Controller of the vehicles under test (see `crumple list controllers`), or its file
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Scenario space of the runs (see `crumple list spaces`), or its file
    #[arg(long, value_name = "S", default_value = "paper", value_parser = args::parse_space)]
    space: (String, ScenarioSpace),
    /// Failure rate to stay below, above 0 and below 1
    #[arg(long, value_name = "P")]
    rate_below: Option<f64>,
    /// Failures among the runs that the claim tolerates: 0 to 1 000 000
    #[arg(
        long,
        value_name = "K",
        default_value_t = 0,
        conflicts_with = "runs",
        value_parser = clap::value_parser!(u64).range(0..=1_000_000)
    )]
    failures: u64,
    /// Number of runs instead of a rate: 1 to 1 000 000 000
    #[arg(long, value_name = "N", conflicts_with = "rate_below")]
    runs: Option<u64>,
    /// Confidence level of the claim: above 0.5 and below 1
    #[arg(long, value_name = "c", default_value_t = 0.999)]
    confidence: f64,
    /// Seed of all random scenarios
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Number of shards, 1 to 10 000 and at most the number of blocks of runs [default: of --minutes each]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    shards: Option<u32>,
    /// Target duration of a shard in minutes: 1 to 10 000
    #[arg(
        long,
        value_name = "N",
        default_value_t = 10,
        conflicts_with = "shards",
        value_parser = clap::value_parser!(u32).range(1..=10_000)
    )]
    minutes: u32,
    /// Cores for each shard: 1 to 1024
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    cores: u32,
    /// Engine to write a job file for; may be repeated [default: all]
    #[arg(long, value_enum, value_name = "E")]
    engine: Vec<EngineName>,
    /// Folder for job files and shards; new or empty
    #[arg(long, value_name = "DIR", default_value = "crumple-plan")]
    out: PathBuf,
    /// Write into a folder that is not empty and replace an earlier plan; existing shards of other work stay, and are
    /// rejected when the new ones are made
    #[arg(long)]
    force: bool,
    /// Output format of the plan; json is the content of `plan.json`
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum EngineName {
    /// HyperQueue
    Hyperqueue,
    /// Ray
    Ray,
    /// Slurm
    Slurm,
}

impl EngineName {
    fn engine(self) -> Engine {
        match self {
            Self::Hyperqueue => Engine::HyperQueue,
            Self::Ray => Engine::Ray,
            Self::Slurm => Engine::Slurm,
        }
    }
}

impl PlanCommand {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        if self.rate_below.is_none() && self.runs.is_none() {
            return Err(CliError::Input("--rate-below or --runs is required".to_owned()));
        }
        self.check_out_folder()?;
        let (wanted, command, measure) = self.plan_rate(quiet)?;
        let seconds = measure.runs as f64 / measure.runs_per_second;
        let each = seconds / f64::from(self.cores) / (60.0 * f64::from(self.minutes));
        let shards = match self.shards {
            // Clamp before the conversion to a number of shards.
            None => each.ceil().clamp(1.0, f64::from(measure.max_shards)) as u32,
            Some(shards) => shards,
        };
        let planned = PlanSummary {
            version: 1,
            wanted,
            shards,
            cores_of_a_shard: self.cores,
            runs_a_core_and_second: measure.runs_per_second,
            core_hours: seconds / 3600.0,
            minutes_of_a_shard: seconds / 60.0 / f64::from(shards) / f64::from(self.cores),
            bytes_of_shards: (measure.bytes_of_shards)(shards),
            files_of_shards: u64::from(shards) * 4,
            command: std::iter::once("crumple".to_owned()).chain(command.clone()).collect(),
        };
        self.write(&planned, command)?;
        let text = match self.format {
            OutputFormat::Json => serde_json::to_string(&planned).map_err(CliError::input)? + "\n",
            OutputFormat::Text => self.summary(&planned)?,
        };
        output::print(&text)
    }
}
