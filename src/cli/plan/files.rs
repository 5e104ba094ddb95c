//! Files of a plan: `plan.json`, the job files for engines, and the summary.

use std::fs;

use serde::Serialize;

use super::PlanCommand;
use super::work::PlannedCount;
use crate::cli::CliError;
use crumple_core::digits;
use crumple_core::quoting::ShellWord;
use crumple_store::disk::{self, StagedFiles};
use crumple_store::jobs::{Engine, Jobs, TASK_SCRIPT};

/// The file `plan.json`.
#[derive(Serialize)]
pub(super) struct PlanSummary {
    pub(super) version: u32,
    #[serde(flatten)]
    pub(super) wanted: PlannedCount,
    pub(super) shards: u32,
    pub(super) cores_of_a_shard: u32,
    pub(super) runs_a_core_and_second: f64,
    pub(super) core_hours: f64,
    pub(super) minutes_of_a_shard: f64,
    pub(super) bytes_of_shards: u64,
    pub(super) files_of_shards: u64,
    /// Command that does the work on one machine.
    pub(super) command: Vec<String>,
}

impl PlanCommand {
    fn engines(&self) -> Vec<Engine> {
        match self.engine.is_empty() {
            true => Engine::ALL.to_vec(),
            false => self.engine.iter().map(|name| name.engine()).collect(),
        }
    }

    /// Returns the folder for use in commands, in a form that cannot be taken for an option.
    fn folder_argument(&self) -> Result<String, CliError> {
        let name = || format!("--out: {} is not valid UTF-8, which job files require", self.out.display());
        let folder = self.out.to_str().ok_or_else(|| CliError::Input(name()))?;
        Ok(if folder.starts_with('-') { format!("./{folder}") } else { folder.to_owned() })
    }

    /// Checks that the folder is empty, or `--force` is given.
    pub(super) fn check_out_folder(&self) -> Result<(), CliError> {
        if fs::metadata(&self.out).is_ok_and(|found| !found.is_dir()) {
            return Err(CliError::Input(format!("{}: is not a folder", self.out.display())));
        }
        let has_some = fs::read_dir(&self.out).is_ok_and(|mut entries| entries.next().is_some());
        match has_some && !self.force {
            true => Err(CliError::at(&self.out, "is not empty: use --force to write a plan there, or another --out")),
            false => Ok(()),
        }
    }

    pub(super) fn write(&self, planned: &PlanSummary, words: Vec<String>) -> Result<(), CliError> {
        let jobs = Jobs {
            arguments: words,
            shards: planned.shards,
            cores: self.cores,
            // Machines differ in speed, and a job must not hit its time limit twice.
            max_minutes: (planned.minutes_of_a_shard * 3.0).ceil() as u64 + 10,
            folder: self.folder_argument()?,
        };
        disk::make_folder(&self.out)?;
        let mut files = StagedFiles::default();
        let mut stage = |name: &str, text: String| files.stage(&self.out.join(name), text);
        stage("plan.json", serde_json::to_string_pretty(planned).map_err(CliError::input)? + "\n")?;
        stage(TASK_SCRIPT, jobs.task_script())?;
        for engine in self.engines() {
            let (name, text) = jobs.engine_file(engine);
            stage(name, text)?;
        }
        Ok(files.commit()?)
    }

    pub(super) fn summary(&self, planned: &PlanSummary) -> Result<String, CliError> {
        let PlanSummary { shards, cores_of_a_shard, .. } = planned;
        let folder = self.folder_argument()?;
        let word = |rest: &str| ShellWord(&format!("{folder}/{rest}")).to_string();
        let PlannedCount { registration_sha256, runs, confidence, rate_at_most, failures } = &planned.wanted;
        let mut text = format!(
            "{runs} runs; if {failures} of them fail, a rate of at most {} at confidence {confidence}\n  {:.0} runs \
             per second on one core of this machine: {:.2} core-hours\n  {shards} shards on \
             {cores_of_a_shard} core(s) each, {:.1} minutes per shard; {} files, {:.1} MB\n  \
             registered as {registration_sha256}\n\n",
            digits::format_rounded_up(*rate_at_most, 4),
            planned.runs_a_core_and_second,
            planned.core_hours,
            planned.minutes_of_a_shard,
            planned.files_of_shards,
            planned.bytes_of_shards as f64 / 1e6,
        );
        for engine in self.engines() {
            text += &match engine {
                Engine::HyperQueue => format!("  python3 {}\n", word("hyperqueue_job.py")),
                Engine::Ray => format!("  python3 {} --address auto\n", word("ray_job.py")),
                Engine::Slurm => format!("  sbatch {}\n", word("slurm.sh")),
            };
        }
        Ok(text + &format!("  crumple merge {}/* --out {}\n", word("shards"), word("rate")))
    }
}
