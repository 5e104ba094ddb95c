//! `crumple suite`: tests modelled on regulations.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};

use super::output_format::OutputFormat;
use super::{CliError, args, output, suite_folder, value_enums};
use crumple_controllers::find_built_in;
use crumple_report::suite;
use crumple_sim::control::{BuiltInController, Role};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_suites::{
    ControllerResult, FailedPoint, SHIPPED_SUITES, SuiteList, SuiteResult, TestSuite, run,
};

/// Run suites of tests that are modelled on regulations
#[derive(Args)]
pub(super) struct SuiteCommand {
    #[command(subcommand)]
    command: SuiteSubcommand,
}

#[derive(Subcommand)]
enum SuiteSubcommand {
    /// List the built-in suites
    List {
        /// Output format
        #[arg(long, value_enum, default_value = "text")]
        format: OutputFormat,
    },
    Run(RunSuite),
    Table(SuiteTable),
}

/// Run a suite, and print clause, test, verdict and margin
#[derive(Args)]
#[command(after_long_help = "\
A test passes if it ends without a collision, or without one that is faster than the test allows. A margin states how \
far one quantity can be changed until the test fails, with all others fixed; crumple simulates both sides of the \
boundary. For a failed test, crumple states whether each reference driver, who observes the true state, would have \
prevented the collision. For the first three failed points, it also states whether any driver could have done so.

In tests with manual braking, a test driver brakes after a warning of the controller, or after the reference warning \
of the suite; the result states which. Replay commands name the test driver.

The folder of --out also contains `failures.sha256`, which lists the files of a run (`sha256sum -c` checks it). The \
next run there replaces these files. All other files stay: those that crumple did not write, those that have changed \
since, and symbolic links. A run that would have to overwrite such a file writes nothing, and ends with exit code 2.

A suite may have 2000 points and a file of 3 MiB. Suites are modelled on the documents and use a point-mass model in \
one lane: a result is no certification.

Examples:
  crumple suite run fmvss-127 --controller acc-aeb --controller policy
  crumple suite run euro-ncap-2023 --controller idm --estimator truth --format junit
  crumple suite run euro-ncap-2023 --controller full-throttle --out failures
  crumple suite run my-suite.toml --controller my-acc.toml --out failures --expect passed")]
struct RunSuite {
    /// Built-in suite (see `crumple suite list`), or a file
    suite: PathBuf,
    /// Controller of the vehicle under test (see `crumple list controllers`); may be repeated
    #[arg(long = "controller", value_name = "C", required = true, value_parser = args::parse_controller)]
    controllers: Vec<NamedController>,
    /// Estimator of the vehicle under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Write the scenario of every failed point into this folder, and replace those of the previous run
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Exit with 1 unless every test ends like this
    #[arg(long, value_enum)]
    expect: Option<SuiteExpectation>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: SuiteFormat,
}

/// Run every built-in suite, and print one table
#[derive(Args)]
#[command(after_long_help = "\
Examples:
  crumple suite table > suites.md
  crumple suite table --controller idm --controller acc-aeb --controller policy")]
struct SuiteTable {
    /// Controller of the vehicle under test (see `crumple list controllers`); may be repeated [default: every built-in
    /// one, and the learned ones also behind the shield]
    #[arg(long = "controller", value_name = "C", value_parser = args::parse_controller)]
    controllers: Vec<NamedController>,
    /// Estimator of the vehicle under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Output format: a Markdown table, or one JSON object per suite, as in `crumple suite run`
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl SuiteTable {
    fn run(self) -> Result<(), CliError> {
        let controllers = if self.controllers.is_empty() {
            default_controllers()?
        } else {
            self.controllers
        };
        check_unique_names(&controllers)?;
        let results = SHIPPED_SUITES
            .iter()
            .map(|(name, _)| {
                run(&find_suite(Path::new(name))?, &controllers, self.estimator)
                    .map_err(CliError::input)
            })
            .collect::<Result<Vec<_>, CliError>>()?;
        match self.format {
            OutputFormat::Json => results.iter().try_for_each(output::print_json),
            OutputFormat::Text => output::print(&suite::render_markdown_table(&results)),
        }
    }
}

fn check_unique_names(controllers: &[NamedController]) -> Result<(), CliError> {
    let names = || {
        controllers
            .iter()
            .map(|controller| controller.name.as_str())
    };
    match names()
        .enumerate()
        .find(|(index, name)| names().take(*index).any(|before| before == *name))
    {
        Some((_, name)) => Err(CliError::Input(format!(
            "--controller: `{name}` is named twice"
        ))),
        None => Ok(()),
    }
}

/// Returns every built-in controller, and the learned ones also behind the shield.
fn default_controllers() -> Result<Vec<NamedController>, CliError> {
    let all = BuiltInController::all();
    let learned = all.iter().filter(|spec| spec.role() == Role::Learned);
    let shielded = learned.map(|spec| format!("shield:{}", spec.name()));
    let names = all
        .iter()
        .map(|spec| spec.name().to_owned())
        .chain(shielded);
    names
        .map(|name| {
            find_built_in(&name).ok_or_else(|| CliError::Input(format!("{name} is not built in")))
        })
        .collect()
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum SuiteExpectation {
    /// Every test that can be run is passed, also at the points that a search finds within the ranges of a clause, and
    /// every controller answers
    Passed,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
pub(super) enum SuiteFormat {
    /// Text
    Text,
    /// One JSON object
    Json,
    /// JUnit XML for a build server
    Junit,
}

impl SuiteCommand {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        match self.command {
            SuiteSubcommand::List { format } => list_suites(format),
            SuiteSubcommand::Run(command) => command.run(quiet),
            SuiteSubcommand::Table(command) => command.run(),
        }
    }
}

pub(super) fn find_suite(path: &Path) -> Result<TestSuite, CliError> {
    if let Some(suite) = path.to_str().and_then(TestSuite::shipped) {
        return Ok(suite?);
    }
    if path.extension().is_none() && !path.exists() {
        let names: Vec<_> = SHIPPED_SUITES.iter().map(|(name, _)| *name).collect();
        return Err(CliError::Input(format!(
            "`{}` is neither a suite ({}) nor a file",
            path.display(),
            names.join(", ")
        )));
    }
    Ok(TestSuite::load(path)?)
}

fn list_suites(format: OutputFormat) -> Result<(), CliError> {
    let list = SuiteList::load()?;
    output::print_result(format, &list, || list.to_text())
}

impl RunSuite {
    fn run(self, quiet: bool) -> Result<(), CliError> {
        let suite = find_suite(&self.suite)?;
        check_unique_names(&self.controllers)?;
        // Fail before the simulations if the folder cannot be used.
        self.out.as_deref().map(suite_folder::open).transpose()?;
        let result = run(&suite, &self.controllers, self.estimator).map_err(CliError::input)?;
        if let Some(folder) = &self.out {
            suite_folder::write(&result, folder, quiet)?;
        }
        let text = render(&result, self.out.as_deref(), self.format)?;
        if self.out.is_none() && result.has_failures() {
            output::note(
                "note: --out FOLDER writes the failed scenarios, for replay",
                quiet,
            );
        }
        let printed = match self.format {
            SuiteFormat::Text => output::print_coloured(OutputFormat::Text, &text),
            SuiteFormat::Json | SuiteFormat::Junit => output::print(&text),
        };
        CliError::verdict_first(self.check_expectation(&result), printed)
    }

    fn check_expectation(&self, result: &SuiteResult) -> Result<(), CliError> {
        let unpassed = result.unpassed_tests();
        match self.expect {
            Some(SuiteExpectation::Passed) if !unpassed.is_empty() => {
                Err(CliError::Unmet(format!(
                    "expected every test to pass, but these fail: {}",
                    unpassed.join(", ")
                )))
            }
            _ => Ok(()),
        }
    }
}

fn render(
    result: &SuiteResult,
    out: Option<&Path>,
    format: SuiteFormat,
) -> Result<String, CliError> {
    Ok(match format {
        SuiteFormat::Json => serde_json::to_string(result).map_err(CliError::input)? + "\n",
        SuiteFormat::Junit => suite::render_junit(result),
        SuiteFormat::Text => {
            suite::render_text(result, |failed: &FailedPoint, tested: &ControllerResult| {
                failed.replay_command(out?, &tested.controller, result.estimator)
            })
        }
    })
}
