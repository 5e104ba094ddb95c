//! `crumple plan`: from what is wanted of a rate, or from the budget of a search, to runs, shards, hours and bytes, and files for engines
//! that place work on machines.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::output::rounded_up;
use super::{Failure, choice, output, subject};
use crumple_search::disk::{self, Files};
use crumple_search::evidence::{RateConfig, RatePlan, runs_for};
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Aim, Campaign};
use crumple_search::jobs::{Engine, Jobs, TASK};
use crumple_search::shard::Shard;
use crumple_world::measure::Specification;
use crumple_world::observation::EstimatorKind;
use crumple_world::quoted::ShellWord;
use crumple_world::scenario::space::Space;
use crumple_world::sim::NamedController;

/// Plan a count or a search on many machines: runs, shards, hours, bytes, and job files for HyperQueue, Ray and Slurm
#[derive(Args)]
#[command(after_long_help = "\
A rate is planned with --rate-below or --runs, a search for failures (`falsify`) with --budget. The pace is measured here, on one core, with runs of \
another seed: nothing of what will be counted is known beforehand. To evaluations of a search comes in every shard what it takes to look at its failures \
closely, seconds to minutes. DIR gets `plan.json`, \
`task.sh`, which makes a shard, and a file for each engine: `hyperqueue_job.py`, `ray_job.py` and `slurm.sh`. Begin them in the folder in which \
`plan` was run, so that relative paths lead to the same files, with the same build of crumple on all machines; \
docs/many-machines.md goes through it.

Examples:
  crumple plan --controller shield:policy --estimator truth --rate-below 1e-6 --out campaign
  crumple plan --controller policy --runs 10000000 --shards 64 --engine slurm --out campaign
  crumple plan --controller policy --space high-risk --budget 1000000 --out search")]
pub(super) struct Plan {
    /// Controller of the vehicles under test (see `crumple list controllers`), or the file of one
    #[arg(long, value_name = "C", value_parser = subject::controller)]
    controller: NamedController,
    /// Space that runs are drawn from (see `crumple list spaces`), or a space file
    #[arg(long, value_name = "S", default_value = "paper", value_parser = subject::space)]
    space: (String, Space),
    /// What is to be shown: that it fails at a rate of at most this, above 0 and below 1
    #[arg(long, value_name = "P", required_unless_present_any = ["runs", "budget"])]
    rate_below: Option<f64>,
    /// Failures among the runs with which that is still shown: 0 to 1 000 000
    #[arg(long, value_name = "K", default_value_t = 0, conflicts_with = "runs", value_parser = clap::value_parser!(u64).range(0..=1_000_000))]
    failures: u64,
    /// A budget of runs instead: 1 to 1 000 000 000
    #[arg(long, value_name = "N", conflicts_with = "rate_below")]
    runs: Option<u64>,
    /// Of a search instead: evaluations of the method, and of each reference search, 1 to 1 000 000 000
    #[arg(long, value_name = "N", conflicts_with_all = ["rate_below", "runs", "failures"], value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    budget: Option<u64>,
    /// Method of the search (see `crumple list methods`)
    #[arg(long, value_name = "M", default_value = "auto", conflicts_with_all = ["rate_below", "runs"])]
    method: Method,
    /// Which failures the search is after: severest, likeliest or nearest
    #[arg(long, value_name = "A", default_value = "severest", conflicts_with_all = ["rate_below", "runs"])]
    aim: Aim,
    /// What must hold in the search: `no contact`, or a formula of signal temporal logic
    #[arg(long, value_name = "STL", default_value = Specification::NO_CONTACT, conflicts_with_all = ["rate_below", "runs"])]
    spec: String,
    /// Confidence of the claim: above 0.5 and below 1
    #[arg(long, value_name = "c", default_value_t = 0.999, conflicts_with = "budget")]
    confidence: f64,
    /// Seed of all draws
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// What the vehicles under test look through
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = choice::one_of(choice::ESTIMATORS))]
    estimator: EstimatorKind,
    /// Number of shards, 1 to 10 000 and at most that of blocks of runs [default: of --minutes each]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    shards: Option<u32>,
    /// Minutes that a shard should take: 1 to 10 000
    #[arg(long, value_name = "N", default_value_t = 10, conflicts_with = "shards", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    minutes: u32,
    /// Cores for each shard: 1 to 1024
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    cores: u32,
    /// Engine to write a job file for; may be repeated [default: all]
    #[arg(long, value_enum, value_name = "E")]
    engine: Vec<EngineName>,
    /// Where job files go, and shards will
    #[arg(long, value_name = "DIR", default_value = "crumple-plan")]
    out: PathBuf,
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

/// The file `plan.json`.
#[derive(Serialize)]
struct Planned {
    version: u32,
    #[serde(flatten)]
    wanted: Wanted,
    shards: u32,
    cores_of_a_shard: u32,
    /// Runs, or evaluations of a search.
    runs_a_core_and_second: f64,
    core_hours: f64,
    minutes_of_a_shard: f64,
    bytes_of_shards: u64,
    files_of_shards: u64,
    /// What makes the work on one machine.
    command: Vec<String>,
}

/// What is planned.
#[derive(Serialize)]
#[serde(untagged)]
enum Wanted {
    Rate {
        registration_sha256: String,
        runs: u64,
        confidence: f64,
        /// What is shown if `failures` runs fail.
        rate_at_most: f64,
        failures: u64,
    },
    Search {
        method: &'static str,
        /// Of the method, and of each reference search.
        budget: u64,
        /// Of all together.
        evaluations: u64,
    },
}

/// What work takes, whatever it is.
struct Measure {
    runs: u64,
    pace: f64,
    most_shards: u32,
    bytes: Box<dyn Fn(u32) -> u64>,
}

/// How long the pace is measured.
const MEASURED: Duration = Duration::from_secs(2);
/// What keeps draws of the measurement apart from those that are counted.
const OTHER_SEED: u64 = 0x9e37_79b9_7f4a_7c15;

impl Plan {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        let (wanted, command, measure) = match self.budget {
            Some(budget) => self.search(budget, quiet)?,
            None => self.rate(quiet)?,
        };
        let seconds = measure.runs as f64 / measure.pace;
        let each = seconds / f64::from(self.cores) / (60.0 * f64::from(self.minutes));
        let shards = match self.shards {
            // As many as minutes make; the quotient is clamped before it is a number of shards.
            None => each.ceil().clamp(1.0, f64::from(measure.most_shards)) as u32,
            Some(shards) => shards,
        };
        let planned = Planned {
            version: 1,
            wanted,
            shards,
            cores_of_a_shard: self.cores,
            runs_a_core_and_second: measure.pace,
            core_hours: seconds / 3600.0,
            minutes_of_a_shard: seconds / 60.0 / f64::from(shards) / f64::from(self.cores),
            bytes_of_shards: (measure.bytes)(shards),
            files_of_shards: u64::from(shards) * 4,
            command: std::iter::once("crumple".to_owned()).chain(command.clone()).collect(),
        };
        self.write(&planned, command)?;
        output::print(&self.told(&planned))
    }

    fn rate(&self, quiet: bool) -> Result<(Wanted, Vec<String>, Measure), Failure> {
        let runs = match (self.runs, self.rate_below) {
            (Some(runs), _) => runs,
            (None, rate) => {
                runs_for(rate.unwrap_or_default(), self.confidence, self.failures).map_err(Failure::input)?
            }
        };
        let plan = self.count(self.seed, runs)?;
        if let Some(shards) = self.shards {
            plan.blocks_of(Shard::new(shards, shards).map_err(Failure::input)?).map_err(Failure::input)?;
        }
        output::note("measuring the pace", quiet);
        let pace = self.count(self.seed ^ OTHER_SEED, runs.min(100_000))?.pace(MEASURED).map_err(Failure::input)?;
        let wanted = Wanted::Rate {
            registration_sha256: plan.registration().digest(),
            runs,
            confidence: self.confidence,
            rate_at_most: plan.record().rate_at_most(self.failures),
            failures: self.failures,
        };
        let most_shards = plan.most_shards();
        let measure = Measure { runs, pace, most_shards, bytes: Box::new(move |shards| plan.bytes_of(shards)) };
        Ok((wanted, self.command(runs), measure))
    }

    fn search(&self, budget: u64, quiet: bool) -> Result<(Wanted, Vec<String>, Measure), Failure> {
        if self.seed > i64::MAX as u64 {
            return Err(Failure::Input(format!("--seed: of a search at most {}, found {}", i64::MAX, self.seed)));
        }
        if self.controller.kind.identity().is_none() {
            let problem = "states no identity: nobody could tell whether shards of it go together";
            return Err(Failure::Input(format!("the controller `{}` {problem}", self.controller.name)));
        }
        let space = &self.space.1;
        let nominal = space.scenario(&space.nominal()).map_err(Failure::input)?;
        let specification =
            Specification::parse(&self.spec, &nominal).map_err(|error| Failure::Input(format!("--spec: {error}")))?;
        let campaign = Campaign {
            controller: self.controller.clone(),
            estimator: self.estimator,
            space: space.clone(),
            specification,
            method: self.method,
            aim: self.aim,
            budget,
            seed: self.seed,
        };
        if let Some(shards) = self.shards {
            let last = Shard::new(shards, shards).map_err(Failure::input)?;
            last.range(budget, "evaluations of each method").map_err(Failure::input)?;
        }
        output::note("measuring the pace", quiet);
        let elsewhere = Campaign { seed: (self.seed ^ OTHER_SEED) & i64::MAX as u64, ..campaign.clone() };
        let pace = elsewhere.pace(MEASURED)?;
        let evaluations = budget.saturating_mul(campaign.methods().len() as u64);
        let mut words = self.words(&["falsify"]);
        words.extend([
            format!("--method={}", self.method),
            format!("--aim={}", self.aim),
            format!("--budget={budget}"),
            format!("--spec={}", self.spec),
        ]);
        let wanted = Wanted::Search { method: self.method.name(), budget, evaluations };
        let most_shards = campaign.most_shards();
        let bytes = Box::new(move |shards| campaign.bytes_of(shards));
        Ok((wanted, words, Measure { runs: evaluations, pace, most_shards, bytes }))
    }

    fn count(&self, seed: u64, runs: u64) -> Result<RatePlan, Failure> {
        RatePlan::new(RateConfig {
            controllers: (self.controller.clone(), None),
            space: self.space.1.clone(),
            seed,
            estimator: self.estimator,
            runs,
            confidence: self.confidence,
        })
        .map_err(Failure::input)
    }

    /// The words that every command has.
    fn words(&self, command: &[&str]) -> Vec<String> {
        let mut words: Vec<String> = command.iter().map(|word| (*word).to_owned()).collect();
        words.extend([
            format!("--controller={}", self.controller.name),
            format!("--space={}", self.space.0),
            format!("--estimator={}", self.estimator.name()),
            format!("--seed={}", self.seed),
        ]);
        words
    }

    /// The words that make the whole of a count.
    fn command(&self, runs: u64) -> Vec<String> {
        let mut words = self.words(&["verify", "rate"]);
        words.extend([format!("--runs={runs}"), format!("--confidence={}", self.confidence)]);
        words
    }

    fn engines(&self) -> Vec<Engine> {
        match self.engine.is_empty() {
            true => Engine::ALL.to_vec(),
            false => self.engine.iter().map(|name| name.engine()).collect(),
        }
    }

    fn folder(&self) -> Result<&str, Failure> {
        let name = || format!("--out: {} is not text, and job files are", self.out.display());
        self.out.to_str().ok_or_else(|| Failure::Input(name()))
    }

    fn write(&self, planned: &Planned, words: Vec<String>) -> Result<(), Failure> {
        let jobs = Jobs {
            words,
            shards: planned.shards,
            cores: self.cores,
            // Machines differ, and what was interrupted should not be so again.
            most_minutes: (planned.minutes_of_a_shard * 3.0).ceil() as u64 + 10,
            folder: self.folder()?.to_owned(),
        };
        disk::make_folder(&self.out)?;
        let mut files = Files::default();
        let mut stage = |name: &str, text: String| files.stage(&self.out.join(name), text);
        stage("plan.json", serde_json::to_string_pretty(planned).map_err(Failure::input)? + "\n")?;
        stage(TASK, jobs.task())?;
        for engine in self.engines() {
            let (name, text) = jobs.file(engine);
            stage(name, text)?;
        }
        Ok(files.commit()?)
    }

    fn told(&self, planned: &Planned) -> String {
        let Planned { shards, cores_of_a_shard, .. } = planned;
        let folder = self.out.to_string_lossy();
        let word = |rest: &str| ShellWord(&format!("{folder}/{rest}")).to_string();
        let (first, last, whole) = match &planned.wanted {
            Wanted::Rate { registration_sha256, runs, confidence, rate_at_most, failures } => (
                format!(
                    "{runs} runs; if {failures} of them fail, a rate of at most {} at confidence {confidence}",
                    rounded_up(*rate_at_most)
                ),
                format!("  registered as {registration_sha256}\n"),
                "rate",
            ),
            Wanted::Search { method, budget, evaluations } => (
                format!("{evaluations} evaluations: {budget} by {method}, and as many by each reference search"),
                match self.method.is_blind() {
                    true => String::new(),
                    false => format!("  {shards} searches by {method}, each with its share of the budget\n"),
                },
                "campaign",
            ),
        };
        let what = if self.budget.is_some() { "evaluations" } else { "runs" };
        let mut text = format!(
            "{first}\n  \
             {:.0} {what} a second on a core here: {:.2} core-hours\n  \
             {shards} shards on {cores_of_a_shard} core(s) each, {:.1} minutes a shard; {} files, {:.1} MB\n\
             {last}\n",
            planned.runs_a_core_and_second,
            planned.core_hours,
            planned.minutes_of_a_shard,
            planned.files_of_shards,
            planned.bytes_of_shards as f64 / 1e6,
        );
        for engine in self.engines() {
            text += &match engine {
                Engine::HyperQueue => format!("  python3 {}\n", word("hyperqueue_job.py")),
                Engine::Ray => format!("  python3 {}\n", word("ray_job.py")),
                Engine::Slurm => format!("  sbatch {}\n", word("slurm.sh")),
            };
        }
        text + &format!("  crumple merge {}/* --out {}\n", word("shards"), word(whole))
    }
}
