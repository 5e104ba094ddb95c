//! `crumple tune`: fits the settings of a built-in controller on the closed loop.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};

use super::drives::load_drives;
use super::global_options::GlobalOptions;
use super::output_format::OutputFormat;
use super::{CliError, args, output, progress, study, value_enums};
use crumple_controllers::Controllers;
use crumple_core::observer::Listener;
use crumple_learn::tune::{
    SettingRequest, SettingSearch, TuneError, TuningConfig, TuningObjective, TuningPlan,
    TuningProgress, TuningSpace,
};
use crumple_search::falsify::Method;
use crumple_sim::observation::EstimatorKind;

/// Fit the settings of a built-in controller to scenario spaces and everyday traffic
#[derive(Args)]
#[command(after_long_help = "\
The search simulates each candidate in the same random scenarios. It varies the settings in their typical ranges, and \
starts at the defaults, or in the middle of a range that excludes them. It minimises one number. For --objective both, \
this is the sum of:
  - the weighted mean of the collision shares in the spaces of --space
  - in the built-in space `traffic`, the shares of scenarios with a collision, with hard unnecessary braking (above 4 \
m/s2 where less than 3 m/s2 was justified), and in which the vehicle falls behind
  - in the built-in space `everyday`, the share of scenarios in which the candidate has one of these faults or brakes \
unnecessarily, and `idm` does none of this
  - with --drives, the same share of the recorded drives. A collision with a vehicle behind that repeats its recorded \
speeds does not count, because that vehicle does not react
  - in `traffic`, half the relative excess of rms acceleration over 1.2 times that of `idm`, and the same of rms jerk
  - in `traffic`, half the distance of the mean time gap from the range 1.2 to 2.1 s, in seconds
  - in `everyday` and in the recorded drives, half the relative excess of rms jerk over 1.2 times that of `idm`
For --objective safety, it is the first term.

The five best candidates and the initial settings are then simulated in other random scenarios (the selection set), \
which select the tuned settings. The report compares initial settings, tuned settings and `idm` in further scenarios \
(the test set), with exact intervals. For the same --seed, every controller and method has the same random scenarios \
in the search, in the selection set and in the test set. No scenario is in two of these, or in an `assess` or \
`falsify`. Recorded drives are the same in all three.

The folder contains every candidate (candidates.jsonl) and the report (report.md, report.json). --resume continues an \
interrupted tuning, even after `kill -9`, and gives the same bytes with any number of threads.

Examples:
  crumple tune --controller predictive --space high-risk --space standing=0.5
  crumple tune --controller acc-aeb --setting ttc_s --setting time_headway_s=0.8..2.5
  crumple tune --controller acc-aeb,standstill_gap_m=3 --method cross-entropy --evaluations 1200
  crumple tune --controller idm --objective safety --out runs/idm --resume
  crumple tune --controller predictive --drives drives")]
pub(super) struct Tune {
    /// Built-in controller with settings (see `crumple list controllers`); settings given as in `acc-aeb,ttc_s=2.0`
    /// stay fixed
    #[arg(long, value_name = "C", value_parser = parse_tuned_controller)]
    controller: String,
    /// Count collisions in this scenario space, built-in or a file, with a weight relative to others (1 by default);
    /// may be repeated, each space once
    #[arg(
        long,
        value_name = "S[=WEIGHT]",
        default_value = "followers",
        value_parser = args::parse_weighted_name
    )]
    space: Vec<(String, f64)>,
    /// Tune only this setting, in its typical range or in this one; may be repeated [default: all settings]
    #[arg(long, value_name = "NAME[=LOW..HIGH]", value_parser = parse_request)]
    setting: Vec<SettingRequest>,
    /// Number to minimise
    #[arg(long, value_name = "O", default_value = "both", value_parser = value_enums::one_of(OBJECTIVES))]
    objective: TuningObjective,
    /// Search method
    #[arg(long, value_enum, value_name = "M", default_value = "cma-es")]
    method: TuningMethod,
    /// Candidates, the initial settings included: 2 to 10 000
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = args::whole_number::<u64>(2..=10_000))]
    evaluations: u64,
    /// Random scenarios of each space for each candidate: 1 to 10 000
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = args::whole_number::<u64>(1..=10_000))]
    runs: u64,
    /// Random scenarios of each space in the test set: 1 to 100 000
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = args::whole_number::<u64>(1..=100_000))]
    test_runs: u64,
    /// Seed of the search and of all scenarios
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = args::whole_number::<u64>(0..=i64::MAX as u64))]
    seed: u64,
    /// Folder of recorded drives (see `crumple import --whole`) that also count in the minimised number (see below);
    /// with `--objective safety`, only the report has them
    #[arg(long, value_name = "DIR")]
    drives: Option<PathBuf>,
    /// Estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Folder of the tuning, created if missing
    #[arg(long, value_name = "DIR", default_value = "crumple-tuning")]
    out: PathBuf,
    /// Resume the tuning in the folder
    #[arg(long)]
    resume: bool,
    /// Output format of the report: Markdown, or one JSON object
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

const OBJECTIVES: &[(TuningObjective, &str, &str)] = &[
    (
        TuningObjective::Both,
        "both",
        "Collisions, and usability in everyday traffic",
    ),
    (TuningObjective::Safety, "safety", "Collisions only"),
];

#[derive(Clone, Copy, ValueEnum)]
enum TuningMethod {
    /// Covariance matrix adaptation: good with few candidates
    CmaEs,
    /// Cross-entropy with independent normal coordinates: 60 candidates per generation
    CrossEntropy,
}

/// Checks that the text is a built-in controller with settings.
fn parse_tuned_controller(text: &str) -> Result<String, String> {
    SettingSearch::parse(text, &[])
        .map(|_| text.to_owned())
        .map_err(|error| error.to_string())
}

/// Parses `ttc_s`, or `ttc_s=0.5..3`.
fn parse_request(words: &str) -> Result<SettingRequest, String> {
    let Some((name, range)) = words.split_once('=') else {
        return Ok(SettingRequest {
            name: words.to_owned(),
            range: None,
        });
    };
    let range = range
        .split_once("..")
        .and_then(|(low, high)| Some([low.parse().ok()?, high.parse().ok()?]));
    let range = range.ok_or("a range is written as LOW..HIGH, for example ttc_s=0.5..3")?;
    Ok(SettingRequest {
        name: name.to_owned(),
        range: Some(range),
    })
}

/// Adds the option to an error about its value.
fn with_option(error: TuneError) -> CliError {
    match error {
        TuneError::Setting { .. } => CliError::Input(format!("--setting {error}")),
        TuneError::Space { .. } => CliError::Input(format!("--space {error}")),
        other => other.into(),
    }
}

impl Tune {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        let plan = self.plan(controllers)?;
        let out = self.out.display();
        let study = study::open(&plan, &self.out, self.resume, quiet).map_err(with_option)?;
        let bar = progress::campaign_bar(0, quiet);
        let report = study.run(&Listener(|state: &TuningProgress| {
            bar.set_length(state.total);
            bar.set_position(state.done);
            bar.set_message(format!(
                "{} candidates, best objective {:.4};",
                state.candidates, state.best
            ));
        }));
        bar.finish_and_clear();
        let report = report.map_err(with_option)?;
        output::note(
            &format!("wrote {out} (candidates.jsonl, report.md, report.json)"),
            quiet,
        );
        output::print_result(self.format, &report, || report.to_markdown())
    }

    fn plan(&self, controllers: Controllers) -> Result<TuningPlan, CliError> {
        let mut spaces = Vec::new();
        for (name, weight) in &self.space {
            spaces.push(TuningSpace {
                space: args::load_space("--space", name, controllers)?,
                weight: *weight,
            });
        }
        let drives = self.drives.as_deref();
        let drives = drives.map(|folder| load_drives(folder, controllers));
        Ok(TuningPlan {
            search: SettingSearch::parse(&self.controller, &self.setting).map_err(with_option)?,
            spaces,
            drives: drives.transpose()?.map(Arc::new),
            config: TuningConfig {
                objective: self.objective,
                method: match self.method {
                    TuningMethod::CmaEs => Method::CmaEs,
                    TuningMethod::CrossEntropy => Method::CrossEntropy,
                },
                seed: self.seed,
                evaluations: self.evaluations,
                runs: self.runs,
                test_runs: self.test_runs,
                estimator: self.estimator,
            },
        })
    }
}
