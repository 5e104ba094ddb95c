//! `crumple verify`: claims with certificates.

use std::path::PathBuf;

use super::global_options::GlobalOptions;
use clap::{Args, Subcommand};
use crumple_controllers::Controllers;
use crumple_core::observer::Listener;

use super::drives::DriveCommand;
use super::output;
use super::output_format::OutputFormat;
use super::{
    CliError, args, exposure, invariant, progress, rare, reach, study, two_sided, value_enums,
};
use crumple_evidence::exposure::{DEFAULT_RESAMPLES, DEFAULT_RUNS_PER_RESAMPLE};
use crumple_evidence::rare::{RarePlan, SplittingConfig};
use crumple_evidence::{
    CERTIFICATE_FILE, CertificateReport, CountProgress, CountReport, RateConfig, RateFolderError,
    RatePlan, SampleSizeError, report_json, required_runs, shipped_kernels,
};
use crumple_measure::Specification;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::ScenarioSpace;
use crumple_store::output_folder::{EarlierFiles, OutputFolder};
use crumple_store::study::Study;

/// Make claims and write certificates that `crumple check` accepts
#[derive(Args)]
pub(super) struct Verify {
    #[command(subcommand)]
    claim: VerifySubcommand,
}

#[derive(Subcommand)]
enum VerifySubcommand {
    Shield(ShieldCommand),
    TwoSided(two_sided::TwoSidedCommand),
    Rate(Box<RateCommand>),
    Reach(Box<reach::ReachCommand>),
    Invariant(Box<invariant::InvariantCommand>),
}

/// Certify the safety kernel of a shield, one certificate for each pair of vehicle classes
#[derive(Args)]
#[command(after_long_help = "\
Friction scales both brake limits by one factor, and the required gaps by its inverse, so the certificates for a dry \
road are valid for every road.

The proofs cover, in real numbers, the kernel and (in verify/obligations) the shield's own functions: the test of a \
command, and the prediction for delay, noise and observation errors. A margin covers rounding. crumple assumes, \
without proof, that noise and estimation errors stay within six standard deviations of the noise.")]
struct ShieldCommand {
    /// Folder for the certificates, created if missing; `shield.sha256` lists them. crumple replaces only files that it
    /// wrote there and that have not changed
    #[arg(long, value_name = "DIR", default_value = "crumple-shield")]
    out: PathBuf,
    /// Output format: text, or one JSON object per certificate, as in `crumple check`
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

/// Bound a controller's failure rate, or show that it is lower than another's
#[derive(Args)]
#[command(after_long_help = "\
Before the first run, crumple writes the settings that determine the count (controllers, space, seed, runs, \
confidence) to DIR/registration.json, and their digest to standard error. It counts random scenarios in order; \
--resume continues an interrupted count. A run fails if vehicles collide, or if the controller gives no answer.

With --rare, crumple uses multilevel splitting to estimate the probability of a failure that is too rare to count: \
populations of runs pass levels of decreasing smallest gap (with --spec, of decreasing robustness). A pilot \
determines the levels; the estimate is the mean of independent repetitions, with an interval from their spread. The \
result is an estimate and no bound: it has no certificate, and DIR/rare-estimate.json says so. DIR/failures gets \
scenario files of about 200 failures, and DIR/rare-failures.json the probability that each stands for: a weighted \
sample of the failures. The pilot and every repetition are written to DIR as they end; --resume continues an \
interrupted estimate, to the same bytes.

If the space states the time and distance of following in its recordings (see `crumple fit`), crumple also prints \
failures per hour and per 1000 km, each with two intervals: one that treats the space as exact, and one with the \
uncertainty of the data, from --resamples of the episodes (docs/fitting.md).

With --drives, the controller drives each recorded drive of a folder once; crumple prints the sum of \
collisions and missing answers, the unnecessary braking of the controller, and that of the recorded cars, each per \
hour and per 100 km, with exact 95 % intervals for independent events. A collision from behind with a vehicle that \
repeats recorded speeds counts separately, and not against the controller. There is no certificate, because the \
drives are not drawn at random. A folder may have 10 000 files and 64 MiB.

Examples:
  crumple verify rate --controller shield:policy --space paper --runs 138149 --confidence 0.999999
  crumple verify rate --controller policy --rate-below 1e-4 --failures 3
  crumple verify rate --controller policy --space high-risk --rare
  crumple verify rate --controller road --drives drives")]
struct RateCommand {
    /// Controller of the vehicles under test (see `crumple list controllers`), or its file
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Another controller on the same random scenarios: show that the first fails less often
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    against: Option<NamedController>,
    /// Scenario space of the runs (see `crumple list spaces`), or its file
    #[arg(long, value_name = "S", default_value = "paper")]
    space: String,
    /// Count on the recorded drives of a folder (see `crumple import --whole`) instead of random scenarios: each drive
    /// once, without certificate
    #[arg(
        long,
        value_name = "FOLDER",
        conflicts_with_all = [
            "space", "runs", "rate_below", "rare", "against", "confidence", "seed", "resamples", "resample_runs", "out",
            "resume"
        ]
    )]
    drives: Option<PathBuf>,
    /// Number of runs, fixed beforehand: 1 to 1 000 000 000
    #[arg(long, value_name = "N", required_unless_present_any = ["rate_below", "rare", "drives"])]
    #[arg(value_parser = args::whole_number::<u64>(1..=1_000_000_000))]
    runs: Option<u64>,
    /// Bound of the failure rate to show, above 0 and below 1: count the fewest runs that suffice if at most --failures
    /// of them fail
    #[arg(long, value_name = "P", conflicts_with_all = ["runs", "against"], value_parser = args::number)]
    rate_below: Option<f64>,
    /// With --rate-below: failures among the runs that the claim tolerates, 0 to 1 000 000 [default: 0]
    #[arg(long, value_name = "K", requires = "rate_below", value_parser = args::whole_number::<u64>(0..=1_000_000))]
    failures: Option<u64>,
    /// Confidence level of the claim: above 0.5 and below 1
    #[arg(long, value_name = "c", default_value_t = 0.999, value_parser = args::number)]
    confidence: f64,
    /// Estimate the probability of a rare failure by splitting instead of counting; writes no certificate
    #[arg(long, conflicts_with_all = ["runs", "rate_below", "against", "confidence"])]
    rare: bool,
    /// With --rare: specification, as in `crumple falsify` [default: no collision]
    #[arg(long, value_name = "STL", requires = "rare")]
    spec: Option<String>,
    /// With --rare: size of a population, 50 to 100 000. Each repetition takes one run per sample, and four more at
    /// each of up to 18 levels before the failure [default: 500]
    #[arg(long, value_name = "N", requires = "rare", value_parser = args::whole_number::<u32>(50..=100_000))]
    samples: Option<u32>,
    /// With --rare: independent populations, 5 to 1000 [default: 20]
    #[arg(long, value_name = "N", requires = "rare", value_parser = args::whole_number::<u32>(5..=1000))]
    repetitions: Option<u32>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
    /// In a scenario space fitted to episodes: resamples of the episodes, with a new fit for each: 0 (none) or 79 to
    /// 2000 [default: 200, with --rare 80, each of which takes about 20 000 runs: 100 samples, 5 repetitions]
    #[arg(long, value_name = "N", value_parser = exposure::parse_resamples)]
    resamples: Option<u32>,
    /// Runs in each resample, without --rare: 50 to 100 000 [default: 500]
    #[arg(long, value_name = "N", conflicts_with = "rare", value_parser = args::whole_number::<u32>(50..=100_000))]
    resample_runs: Option<u32>,
    /// Seed of all random scenarios
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = args::whole_number::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Folder for registration, progress and certificate
    #[arg(long, value_name = "DIR", default_value = "crumple-rate")]
    out: PathBuf,
    /// Resume an interrupted count or estimate, or print a complete one
    #[arg(long)]
    resume: bool,
}

impl Verify {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        match self.claim {
            VerifySubcommand::Shield(shield) => shield.run(),
            VerifySubcommand::TwoSided(command) => command.run(global),
            VerifySubcommand::Rate(rate) => rate.run(global),
            VerifySubcommand::Reach(reach) => reach.run(global.quiet),
            VerifySubcommand::Invariant(invariant) => invariant.run(global),
        }
    }
}

impl ShieldCommand {
    fn run(self) -> Result<(), CliError> {
        let mut text = String::new();
        let mut reports = Vec::new();
        let mut files = Vec::new();
        let kernels = shipped_kernels();
        for (name, certificate) in &kernels {
            let file = format!("{name}.json");
            let report = CertificateReport::new(
                self.out.join(&file).display().to_string(),
                certificate,
                Controllers::default(),
            );
            text += &accepted_line(&report)?;
            reports.push(report);
            let contents = serde_json::to_string_pretty(certificate).map_err(CliError::input)?;
            files.push((file, (contents + "\n").into_bytes()));
        }
        OutputFolder::with_listing(&self.out, "shield.sha256")?
            .write(&files, EarlierFiles::Replace)?;
        match self.format {
            OutputFormat::Json => output::print(&report_json(&reports).map_err(CliError::input)?),
            OutputFormat::Text => output::print_coloured(OutputFormat::Text, &text),
        }
    }
}

impl RateCommand {
    fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        if let Some(folder) = &self.drives {
            self.check_options_of_count()?;
            let command = DriveCommand {
                folder,
                controller: self.controller,
                estimator: self.estimator,
                format: self.format,
                quiet,
            };
            return command.count(controllers);
        }
        let space = args::load_space("--space", &self.space, controllers)?;
        self.check_resampling(&space)?;
        let Some(runs) = self.requested_runs()? else {
            return self.estimate(space, quiet);
        };
        self.check_options_of_count()?;
        self.count(space, runs, quiet)
    }

    /// Counts failures, and writes a certificate.
    fn count(&self, space: ScenarioSpace, runs: u64, quiet: bool) -> Result<(), CliError> {
        let plan = self.rate_plan(space, runs)?;
        let plan = match self.resume {
            true => plan.with_release_of(&self.out),
            false => plan,
        };
        let study = study::open(&plan, &self.out, self.resume, quiet)?;
        let path = study.path(CERTIFICATE_FILE);
        output::note(
            &format!(
                "the settings of the count are in {}; registration_sha256: {}",
                study.path(RatePlan::CONFIGURATION_FILE).display(),
                plan.registration().digest()
            ),
            quiet,
        );
        let bar = progress::run_bar("counting", runs, quiet);
        let counted = study.run(&Listener(|done: &CountProgress| {
            bar.set_position(done.runs)
        }));
        bar.finish_and_clear();
        let counted = counted?;
        let report = CountReport::new(&plan, &counted, self.out.clone(), path);
        // Print the counts even if the claim was rejected.
        if let Err(rejection) = &counted.certificate {
            let rejected = CliError::Unmet(report.describe_rejection(rejection));
            let printed = output::print_result(self.format, &report, || report.to_text());
            return CliError::verdict_first(Err(rejected), printed);
        }
        let bar = progress::counter("resampling", quiet);
        let exposed = progress::show(&bar, |observer| {
            plan.rate_per_exposure(&counted.tally, observer)
        });
        let report = report.with_exposure(exposed.map_err(CliError::input)?);
        output::print_result(self.format, &report, || report.to_text())
    }

    fn rate_plan(&self, space: ScenarioSpace, runs: u64) -> Result<RatePlan, CliError> {
        let plan = RatePlan::new(RateConfig {
            second_controller: self.against.clone(),
            seed: self.seed,
            estimator: self.estimator,
            confidence: self.confidence,
            ..RateConfig::new(self.controller.clone(), space, runs)
        })?;
        Ok(plan.with_resampling(
            self.resamples.unwrap_or(DEFAULT_RESAMPLES),
            self.resample_runs.unwrap_or(DEFAULT_RUNS_PER_RESAMPLE),
        ))
    }

    /// Returns the number of runs to count, or `None` if the rate is to be estimated by splitting.
    fn requested_runs(&self) -> Result<Option<u64>, CliError> {
        match (self.runs, self.rate_below) {
            (Some(runs), _) => Ok(Some(runs)),
            (None, Some(rate)) => required_runs(rate, self.confidence, self.failures.unwrap_or(0))
                .map(Some)
                .map_err(|error| {
                    let message = error.to_string();
                    CliError::Input(match error {
                        SampleSizeError::Confidence { .. } => format!("--{message}"),
                        _ => {
                            let problem = message.strip_prefix("rate: ").unwrap_or(&message);
                            format!("--rate-below: {problem}")
                        }
                    })
                }),
            (None, None) => Ok(None),
        }
    }

    /// Refuses options that do not apply to a count. clap requires no option that conflicts with a given one, and
    /// `--rare` conflicts with `--runs`.
    fn check_options_of_count(&self) -> Result<(), CliError> {
        let of_rare = [
            ("--spec", self.spec.is_some()),
            ("--samples", self.samples.is_some()),
            ("--repetitions", self.repetitions.is_some()),
        ];
        if let Some((name, _)) = of_rare.iter().find(|(_, is_given)| *is_given) {
            return Err(CliError::Input(format!(
                "{name}: requires --rare; a count only distinguishes runs with and without a collision"
            )));
        }
        if self.failures.is_some() && self.rate_below.is_none() {
            return Err(CliError::Input(
                "--failures: requires --rate-below".to_owned(),
            ));
        }
        Ok(())
    }

    fn estimate(self, space: ScenarioSpace, quiet: bool) -> Result<(), CliError> {
        let specification = match &self.spec {
            None => Specification::NoCollision,
            Some(text) => {
                let nominal = space.scenario(&space.nominal()).map_err(CliError::input)?;
                args::parse_specification(text, &nominal, quiet)?
            }
        };
        let plan = RarePlan {
            controller: self.controller.clone(),
            space,
            estimator: self.estimator,
            specification,
            seed: self.seed,
            effort: SplittingConfig {
                samples: self.samples.unwrap_or(500) as usize,
                repetition_count: self.repetitions.unwrap_or(20) as usize,
            },
            resamples: self.resamples.unwrap_or(80),
        };
        rare::estimate(&plan, &self.out, self.resume, self.format, quiet)
    }

    /// Checks that the scenario space can be resampled, if the user asks for resamples.
    fn check_resampling(&self, space: &ScenarioSpace) -> Result<(), CliError> {
        // `--resamples 0` asks for nothing, so it is valid everywhere.
        let asked = [
            (
                "--resamples",
                self.resamples.is_some_and(|resamples| resamples > 0),
            ),
            ("--resample-runs", self.resample_runs.is_some()),
        ];
        let Some((option, _)) = asked.into_iter().find(|(_, is_asked)| *is_asked) else {
            return Ok(());
        };
        if space.spec().exposure.is_none() {
            let problem = "was not fitted to episodes, so there are none to resample";
            return Err(CliError::Input(format!(
                "{option}: the space `{}` {problem}",
                self.space
            )));
        }
        if self.against.is_some() {
            let problem = "applies to the rate of one controller; omit it with --against";
            return Err(CliError::Input(format!("{option}: {problem}")));
        }
        Ok(())
    }
}

/// Formats the accepted claim in a line; a rejection is an error.
pub(super) fn accepted_line(report: &CertificateReport<'_>) -> Result<String, CliError> {
    let verdict = report.verdict_line(None);
    match report.accepted {
        Ok(_) => Ok(verdict),
        Err(_) => Err(CliError::Unmet(verdict.trim_end().to_owned())),
    }
}

impl From<RateFolderError> for CliError {
    fn from(error: RateFolderError) -> Self {
        match error {
            RateFolderError::RunFolder(error) => error.into(),
            other => Self::input(other),
        }
    }
}
