//! `crumple suite`: tests after regulations.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};

use super::{Failure, choice, output, subject, suite_map};
use crumple_report::suite;
use crumple_search::disk::{DiskError, Files};
use crumple_search::suite::{Failed, SHIPPED, STATEMENT, Suite, SuiteError, SuiteResult, TestVerdict, Tested, run};
use crumple_world::observation::EstimatorKind;
use crumple_world::quoted::ShellWord;
use crumple_world::scenario::file;
use crumple_world::sim::NamedController;

/// Run tests after regulations: suites of clauses, grids of figures, verdicts and margins
#[derive(Args)]
pub(super) struct SuiteCommand {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// List the suites that are shipped
    List {
        /// How to print
        #[arg(long, value_enum, default_value = "text")]
        format: super::simulate::Format,
    },
    /// Print the file of a suite, to read or to change
    Show {
        /// A suite that is shipped, or a file
        suite: String,
    },
    Run(RunSuite),
    Table(TableOfSuites),
    Map(suite_map::MapCommand),
}

/// Run a suite: clause, test, verdict, margin
#[derive(Args)]
#[command(after_long_help = "\
A test passes if there is no contact before it ends. A margin says how far a figure can be pushed until the test fails, the others \
held; both sides of the boundary are simulated. Where a test failed it is said whether each reference driver, who sees the truth, \
would have prevented it, and, of the first three points, whether anybody could have.

A suite may have 2000 points and a file of 3 MiB. After the document, on a point-mass model in one lane: this is no certification.

Examples:
  crumple suite run fmvss-127 --controller acc-aeb --controller policy
  crumple suite run euro-ncap-2023 --controller idm --estimator truth --format junit
  crumple suite run euro-ncap-2023 --controller full-throttle --out failures --format html > euro-ncap.html
  crumple suite run my-suite.toml --controller my-acc.toml --out failures --expect passed")]
struct RunSuite {
    /// A suite that is shipped (see `crumple suite list`), or a file
    suite: String,
    /// Controller of the vehicle under test (see `crumple list controllers`); may be repeated
    #[arg(long = "controller", value_name = "C", required = true, value_parser = subject::controller)]
    controllers: Vec<NamedController>,
    /// What the vehicle under test looks through
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = choice::one_of(choice::ESTIMATORS))]
    estimator: EstimatorKind,
    /// Write the scenario of every point that failed into this folder
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Exit with 1 unless every test ends like this
    #[arg(long, value_enum)]
    expect: Option<Expectation>,
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// Run every suite that is shipped, and print one table in Markdown
#[derive(Args)]
#[command(after_long_help = "\
Example:
  crumple suite table --controller idm --controller acc-aeb --controller policy > suites.md")]
struct TableOfSuites {
    /// Controller of the vehicle under test (see `crumple list controllers`); may be repeated
    #[arg(long = "controller", value_name = "C", required = true, value_parser = subject::controller)]
    controllers: Vec<NamedController>,
    /// What the vehicle under test looks through
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = choice::one_of(choice::ESTIMATORS))]
    estimator: EstimatorKind,
}

impl TableOfSuites {
    fn run(self) -> Result<(), Failure> {
        let run =
            |(name, _): &(&str, &str)| run(&find(name)?, &self.controllers, self.estimator).map_err(Failure::input);
        let results = SHIPPED.iter().map(run).collect::<Result<Vec<_>, Failure>>()?;
        output::print(&suite::table(&results))
    }
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Expectation {
    /// No contact and no controller that fails, wherever a test can be run, and none found within the ranges that a clause allows
    Passed,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Format {
    /// For a reader
    Text,
    /// One JSON object
    Json,
    /// For a build server
    Junit,
    /// A page that needs nothing else: the matrix, and what failed, drawn
    Html,
}

impl SuiteCommand {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        match self.command {
            Command::List { format } => list(format),
            Command::Show { suite } => show(&suite),
            Command::Run(command) => command.run(quiet),
            Command::Table(command) => command.run(),
            Command::Map(command) => command.run(),
        }
    }
}

impl From<SuiteError> for Failure {
    fn from(error: SuiteError) -> Self {
        match error {
            SuiteError::File(error) => error.into(),
            other => Self::input(other),
        }
    }
}

/// The suite that is shipped under a name, or the one in a file.
fn find(name: &str) -> Result<Suite, Failure> {
    if let Some(suite) = Suite::shipped(name) {
        return Ok(suite?);
    }
    let path = Path::new(name);
    if path.extension().is_none() && !path.exists() {
        let known: Vec<_> = SHIPPED.iter().map(|(name, _)| *name).collect();
        return Err(Failure::Input(format!("`{name}` is neither a suite ({}) nor a file", known.join(", "))));
    }
    Ok(Suite::load(path)?)
}

fn list(format: super::simulate::Format) -> Result<(), Failure> {
    let mut entries = Vec::new();
    for (name, _) in SHIPPED {
        let suite = find(name)?;
        let spec = suite.spec();
        entries.push((name, spec.about.clone(), format!("{}, {}", spec.document, spec.edition)));
    }
    output::print(&match format {
        super::simulate::Format::Json => {
            let entry = |(name, about, document): &(&str, String, String)| serde_json::json!({ "name": name, "about": about, "document": document });
            let suites: Vec<_> = entries.iter().map(entry).collect();
            format!("{}\n", serde_json::json!({ "statement": STATEMENT, "suites": suites }))
        }
        super::simulate::Format::Text => {
            let mut text = String::new();
            for (name, about, document) in entries {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "  {name:<20}{about} {document}");
            }
            format!("{text}{STATEMENT}\n")
        }
    })
}

fn show(name: &str) -> Result<(), Failure> {
    find(name)?;
    let text = match SHIPPED.iter().find(|(shipped, _)| *shipped == name) {
        Some((_, text)) => (*text).to_owned(),
        None => file::read(Path::new(name))?,
    };
    output::print(&format!("# {STATEMENT}\n{text}"))
}

impl RunSuite {
    fn run(self, quiet: bool) -> Result<(), Failure> {
        let suite = find(&self.suite)?;
        let result = run(&suite, &self.controllers, self.estimator).map_err(Failure::input)?;
        self.write(&result)?;
        let text = match self.format {
            Format::Json => serde_json::to_string(&result).map_err(Failure::input)? + "\n",
            Format::Junit => suite::xml(&result).map_err(Failure::input)?,
            Format::Html => suite::html(&result, &self.controllers, |failed, tested| self.replay(failed, tested)),
            Format::Text => suite::text(&result, |failed, tested| self.replay(failed, tested)),
        };
        let has_failed =
            result.tests().any(|(_, test)| test.controllers.iter().any(|one| one.failures().next().is_some()));
        if has_failed && self.out.is_none() {
            output::note("note: --out FOLDER writes the scenarios that failed, to be replayed", quiet);
        }
        Failure::gate_first(self.check(&result), output::print(&text))
    }

    /// Writes the scenario of every point that failed, once.
    fn write(&self, result: &SuiteResult) -> Result<(), Failure> {
        let Some(folder) = &self.out else { return Ok(()) };
        std::fs::create_dir_all(folder).map_err(DiskError::at(folder))?;
        let tested = result.tests().flat_map(|(_, test)| &test.controllers);
        let failed: BTreeMap<&str, &Failed> =
            tested.flat_map(Tested::failures).map(|one| (one.scenario_name.as_str(), one)).collect();
        let mut files = Files::default();
        for (name, failed) in failed {
            let text = file::to_toml(&failed.scenario).map_err(Failure::input)?;
            files.stage(&output::place(&folder.join(format!("{name}.toml")))?, text)?;
        }
        Ok(files.commit()?)
    }

    /// The command that shows a failure.
    fn replay(&self, failed: &Failed, tested: &Tested) -> Option<String> {
        let path = self.out.as_ref()?.join(format!("{}.toml", failed.scenario_name));
        let path = path.to_str()?;
        let estimator = self.estimator.name();
        let words = ["simulate", path, "--controller", &tested.controller, "--estimator", estimator];
        let words: Vec<_> = words.iter().map(|word| ShellWord(word).to_string()).collect();
        Some(format!("crumple {}", words.join(" ")))
    }

    fn check(&self, result: &SuiteResult) -> Result<(), Failure> {
        let missed = result.tests().flat_map(|(_, test)| {
            let missed = test.controllers.iter().filter(|tested| {
                !tested.is_passed() && !matches!(tested.verdict, TestVerdict::Refused { .. } if tested.points == 0)
            });
            missed.map(move |tested| format!("{} ({})", test.name, tested.controller))
        });
        let missed: Vec<_> = missed.collect();
        match self.expect {
            Some(Expectation::Passed) if !missed.is_empty() => {
                Err(Failure::Gate(format!("expected every test to pass, and these do not: {}", missed.join(", "))))
            }
            _ => Ok(()),
        }
    }
}
