//! `crumple falsify`: searches for failures of a controller and keeps the distinct ones.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use indicatif::ProgressBar;

use super::drives::DriveCommand;
use super::global_options::GlobalOptions;
use super::output_format::OutputFormat;
use super::{CliError, args, output, progress, study, value_enums};
use crumple_controllers::Controllers;
use crumple_core::observer::Listener;
use crumple_evidence::{DriveSearch, MAX_SEEDS, MethodComparison};
use crumple_measure::Specification;
use crumple_search::falsify::campaign::{
    Campaign, CampaignProgress, CampaignReport, CampaignSummary, EvaluationLog, MAX_BUDGET,
    MAX_SEED, SearchObjective, SearchSettings,
};
use crumple_search::falsify::{FailureCriterion, Method};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::{FindSpaceError, ScenarioSpace, find_space};
use crumple_store::disk::StagedFiles;

/// Search for scenarios in which a controller fails
#[derive(Args)]
#[command(after_long_help = "\
The method and two reference searches (uniform points, a Halton sequence) get the same budget each. Failures are \
replayed at the scenario's step and at a tenth of it, shrunk, de-duplicated and ranked. The folder contains every \
evaluation as compressed CSV (`evaluations/`), each distinct failure as a scenario file (`counterexamples/`) and a \
summary. --resume continues an interrupted campaign, even after `kill -9`, and gives the same bytes. `work.json` \
lists all files with their hashes: --resume refuses a folder with a truncated, edited or moved file, or with another \
file among its results, and names the file. This does not protect against a person who changes the files and \
`work.json` together.

--compare prints, for each method, the share of seeds with a failure (falsification rate), and, over these seeds, the \
mean and median number of simulations up to the first failure. Exact tests compare all pairs of methods on the same \
seeds (McNemar and sign test, with the correction of Holm).

--spec also takes these names (docs/glossary.md defines the terms):
  - `no braking without cause`: no unnecessary braking
  - `imposed braking at most 4 m/s2`: the follower brakes by at most 4 m/s²
  - `no amplification`: each vehicle under test changes its speed by at most as much as its leader; this always holds \
if an initial speed differs from the first vehicle's by more than 0.5 m/s
With --against, both controllers drive each scenario. The robustness is max(r, -p), with r of --controller and p of \
--against: negative if only --controller fails.

Formulas for --spec use signals such as v1.gap_m, v1.ttc_s, v1.headway_s, v1.drac_mps2, v0.speed_mps, v1.accel_mps2 \
and v1.jerk_mps3; vehicles are numbered from the front. A formula may have 4000 tokens, nested 64 deep, and a space \
file 3 MiB. docs/stl.md lists all signals, operators and their precedence.

An evaluation takes about 60 to 180 bytes of disk, depending on space and method, and 40 more until the campaign \
ends; with --log summary only these 40. Memory does not grow with the budget. In the space `paper`, --budget 1000000 \
(three million evaluations) needs about 360 MB, and about six minutes on two cores.

With --drives, the domain is a folder of recorded drives. The controller drives each of them once: there is no search, \
no shrinking and no replay. The folder of --out receives the failed drives, the severest first (`counterexamples/`), \
and `drives.json`. A collision from behind with a vehicle that repeats recorded speeds is no failure. A drive that \
fails by unnecessary braking or by its formula is simulated again without the vehicle behind. If it then passes, it \
is counted separately, and is no failure.

Examples:
  crumple falsify --controller baseline --space paper --out runs/baseline
  crumple falsify --controller policy --space high-risk --budget 20000 --seed 7 \\
    --out runs/policy
  crumple falsify --controller idm --spec 'always v1.time_gap_s > 0.3' --out runs/idm
  crumple falsify --controller policy --aim likeliest --out runs/likeliest
  crumple falsify --controller my-acc.toml --space traffic --budget 5000 --expect nothing
  crumple falsify --controller idm --compare auto,cma-es,uniform --seeds 30 --budget 500
  crumple falsify --controller road --drives drives --spec 'no braking without cause' \\
    --out runs/drives
  crumple simulate runs/baseline/counterexamples/01-2-hits-1.toml --controller baseline \\
    --plot crash.svg
  crumple simulate runs/idm/counterexamples/01-violation.toml --controller idm \\
    --spec 'always v1.time_gap_s > 0.3' --expect violated")]
pub(super) struct Falsify {
    /// Controller of the vehicles under test (see `crumple list controllers`), with settings as in `acc-aeb,ttc_s=2.0`,
    /// a policy file, a network (F.onnx, F.zip of Stable-Baselines3), an FMU (F.fmu), a controller file (F.toml), or a
    /// command after `exec:`
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Scenario space to search: built-in (see `crumple list spaces`) or a file
    #[arg(long, value_name = "S", default_value = "high-risk")]
    space: String,
    /// Simulate each recorded drive of a folder once (see `crumple import --whole`), instead of a search of a space
    #[arg(
        long,
        value_name = "FOLDER",
        conflicts_with_all = ["space", "method", "aim", "budget", "seed", "against", "compare", "log", "resume"]
    )]
    drives: Option<PathBuf>,
    /// Search method (see `crumple list methods`)
    #[arg(long, value_name = "M", default_value = "auto")]
    method: Method,
    /// Failures to prefer after the first one is found: severest, likeliest, nearest (to nominal) or harm
    /// (expected number of seriously injured drivers)
    #[arg(long, value_name = "A", default_value = "severest")]
    aim: SearchObjective,
    /// Evaluations of the method, and of each reference search: 1 to 1 000 000 000
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = args::whole_number::<u64>(1..=MAX_BUDGET))]
    budget: u64,
    /// Seed of the search and of all noise
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = args::whole_number::<u64>(0..=MAX_SEED))]
    seed: u64,
    /// Specification: `no collision`, a formula of signal temporal logic, or one of the named specifications below
    #[arg(long, value_name = "STL", default_value = Specification::NO_COLLISION)]
    spec: String,
    /// Count only failures in scenarios that this other controller passes
    #[arg(long, value_name = "CONTROLLER", value_parser = args::parse_controller)]
    against: Option<NamedController>,
    /// Estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Compare methods instead of a campaign: names separated by commas, as in `auto,cma-es,uniform`. Each method runs
    /// with each of --seeds up to its first failure
    #[arg(
        long,
        value_name = "METHODS",
        value_delimiter = ',',
        conflicts_with_all = ["method", "aim", "log", "expect", "out", "resume"]
    )]
    compare: Vec<Method>,
    /// Number of seeds of --compare, from --seed on: 1 to 1000 [default: 30]
    #[arg(long, value_name = "N", value_parser = args::whole_number::<u64>(1..=MAX_SEEDS))]
    seeds: Option<u64>,
    /// Write the runs of --compare as a table, one row for each method and seed; replaces an existing file
    #[arg(long, value_name = "F.csv")]
    table: Option<PathBuf>,
    /// Detail of the log of evaluations
    #[arg(long, value_name = "L", default_value = "full", value_parser = value_enums::one_of(value_enums::LOGS))]
    log: EvaluationLog,
    /// Expected result: exit code 1 if the search ends with the other one
    #[arg(long, value_enum, value_name = "E")]
    expect: Option<SearchExpectation>,
    /// Folder of the campaign, created if missing
    #[arg(long, value_name = "DIR", default_value = "crumple-campaign")]
    out: PathBuf,
    /// Resume the campaign in the folder
    #[arg(long)]
    resume: bool,
    /// Output format of the summary
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum SearchExpectation {
    /// The method or a reference search found a failure
    Failure,
    /// None of them found a failure
    Nothing,
}

impl SearchExpectation {
    /// Checks the expectation. The message states the number of evaluations, since a search without failures proves
    /// nothing.
    fn check(self, summary: &CampaignSummary) -> Result<(), CliError> {
        let evaluations: u64 = summary
            .methods
            .iter()
            .map(|method| method.evaluations)
            .sum();
        match (self, summary.falsified) {
            (Self::Failure, false) => Err(CliError::Unmet(format!(
                "expected a failure, but found none in {evaluations} evaluations"
            ))),
            (Self::Nothing, true) => {
                let kinds = summary.counterexamples.len();
                let failures = if kinds == 1 {
                    "1 distinct failure"
                } else {
                    &format!("{kinds} distinct failures")
                };
                Err(CliError::Unmet(format!(
                    "expected no failure, but found {failures} in {evaluations} evaluations"
                )))
            }
            // Runs without a verdict are no evidence for the controller.
            (Self::Nothing, false) => {
                match summary
                    .methods
                    .iter()
                    .find_map(|method| method.second_missing_answers.as_ref())
                {
                    Some(unanswered) => Err(CliError::Unmet(format!(
                        "expected no failure, but some evaluations have no verdict, because the other controller gave \
                         no answer: {}",
                        unanswered.reason
                    ))),
                    None => Ok(()),
                }
            }
            (Self::Failure, true) => Ok(()),
        }
    }
}

/// Seeds of a comparison, unless the user gives their number.
const DEFAULT_SEEDS: u64 = 30;

impl Falsify {
    /// Refuses options that apply to a comparison only. clap does not check this, because `--compare` conflicts with
    /// options that have defaults.
    fn check_options_of_comparison(&self) -> Result<(), CliError> {
        let given = [
            ("--seeds", self.seeds.is_some()),
            ("--table", self.table.is_some()),
        ];
        match given.iter().find(|(_, is_given)| *is_given) {
            Some((option, _)) if self.compare.is_empty() => {
                Err(CliError::Input(format!("{option}: requires --compare")))
            }
            _ => Ok(()),
        }
    }

    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        self.check_options_of_comparison()?;
        if let Some(folder) = &self.drives {
            return self.search_drives(folder, global);
        }
        let space = load_space(&self.space, controllers)?;
        let nominal = space.scenario(&space.nominal()).map_err(CliError::input)?;
        let specification = args::parse_specification(&self.spec, &nominal, quiet)?;
        let campaign = Campaign {
            controller: self.controller,
            estimator: self.estimator,
            space,
            specification,
            failure_criterion: self.against.map(FailureCriterion::Differential),
            seed: self.seed,
            search: SearchSettings {
                method: self.method,
                objective: self.aim,
                budget: self.budget,
                log: self.log,
            },
        };
        if !self.compare.is_empty() {
            return compare(
                &campaign,
                &self.compare,
                self.seeds.unwrap_or(DEFAULT_SEEDS),
                self.table.as_deref(),
                self.format,
                quiet,
            );
        }
        let study = study::open(&campaign, &self.out, self.resume, quiet)?;
        let bar = progress::campaign_bar(
            self.budget.saturating_mul(campaign.methods().len() as u64),
            quiet,
        );
        let summary = study.run(&Listener(|state: &CampaignProgress| {
            show_progress(&bar, state)
        }));
        bar.finish_and_clear();
        let summary = summary?;
        note_files(&summary, self.log, &self.out, quiet);
        let expected = self
            .expect
            .map_or(Ok(()), |expected| expected.check(&summary));
        CliError::verdict_first(expected, print_summary(&summary, self.format))
    }
}

impl Falsify {
    /// Lets the controller drive each recorded drive once.
    fn search_drives(&self, folder: &Path, global: GlobalOptions) -> Result<(), CliError> {
        let command = DriveCommand {
            folder,
            controller: self.controller.clone(),
            estimator: self.estimator,
            format: self.format,
            quiet: global.quiet,
        };
        let report = command.search(global.controllers, &self.spec, &self.out)?;
        let expected = self
            .expect
            .map_or(Ok(()), |expected| check_drives(expected, &report));
        let printed = output::print_result(self.format, &report, || report.to_text());
        CliError::verdict_first(expected, printed)
    }
}

/// Checks the expectation of failures on drives.
fn check_drives(expected: SearchExpectation, report: &DriveSearch) -> Result<(), CliError> {
    let drives = report.counts.comfort.drives;
    match (expected, report.failures.len()) {
        (SearchExpectation::Failure, 0) => Err(CliError::Unmet(format!(
            "expected a failure, but found none on {drives} drives"
        ))),
        (SearchExpectation::Nothing, failures) if failures > 0 => Err(CliError::Unmet(format!(
            "expected no failure, but {failures} of {drives} drives fail"
        ))),
        _ => Ok(()),
    }
}

/// Shows the method and its best result, or the examination of counterexamples.
fn show_progress(bar: &ProgressBar, state: &CampaignProgress) {
    let failures = format_failure_count(state.failures);
    match (&state.method, state.examination) {
        (Some(method), _) => {
            bar.set_position(state.evaluations);
            bar.set_message(format!(
                "{method}: {failures}, lowest robustness {:.2};",
                state.best_robustness
            ));
        }
        (None, Some(step)) => {
            progress::show_uncounted_step(bar, format!("{failures}; {}", step.describe()))
        }
        (None, None) => {
            progress::show_uncounted_step(bar, format!("{failures}; writing the results"))
        }
    }
}

fn note_files(summary: &CampaignSummary, log: EvaluationLog, out: &Path, quiet: bool) {
    let evaluations = if log == EvaluationLog::Full {
        ", evaluations"
    } else {
        ""
    };
    let counterexamples = if summary.counterexamples.is_empty() {
        ""
    } else {
        ", counterexamples"
    };
    output::note(
        &format!(
            "wrote {} (summary{counterexamples}{evaluations})",
            out.display()
        ),
        quiet,
    );
}

/// Compares methods and prints the result.
fn compare(
    campaign: &Campaign,
    methods: &[Method],
    seeds: u64,
    table: Option<&Path>,
    format: OutputFormat,
    quiet: bool,
) -> Result<(), CliError> {
    let total = campaign
        .search
        .budget
        .saturating_mul(seeds)
        .saturating_mul(methods.len() as u64);
    let bar = progress::campaign_bar(total, quiet);
    let observer = Listener(|state: &CampaignProgress| {
        bar.set_position(state.evaluations);
        let method = state.method.as_ref().map_or("", Method::name);
        bar.set_message(format!(
            "{method}: {};",
            format_failure_count(state.failures)
        ));
    });
    let comparison = MethodComparison::run(campaign, methods, seeds, &observer);
    bar.finish_and_clear();
    let comparison = comparison?;
    if let Some(path) = table {
        let mut files = StagedFiles::default();
        files.stage(&output::resolve_output_path(path)?, comparison.to_csv())?;
        files.commit()?;
    }
    output::print_result(format, &comparison, || comparison.to_text())
}

fn print_summary(summary: &CampaignSummary, format: OutputFormat) -> Result<(), CliError> {
    output::print_result(format, &CampaignReport::new(summary), || summary.to_text())
}

fn format_failure_count(count: u64) -> String {
    format!("{count} failure{}", if count == 1 { "" } else { "s" })
}

fn load_space(name: &str, controllers: Controllers) -> Result<ScenarioSpace, CliError> {
    if Path::new(name)
        .extension()
        .is_some_and(|extension| extension != "toml")
    {
        return Err(CliError::Input(format!(
            "{name}: the name of a space file must end in .toml"
        )));
    }
    find_space(name, &controllers).map_err(|error| match error {
        FindSpaceError::File(error) => error.into(),
        other => CliError::input(other),
    })
}
