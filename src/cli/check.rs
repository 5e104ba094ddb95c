//! `crumple check`: accepts or rejects certificates by the checker alone, and repeats counted runs on request.

mod pool;

use std::io::ErrorKind;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use super::global_options::GlobalOptions;
use clap::Args;
use crumple_verify::pool::parse_seed_range;
use crumple_verify::{Certificate, CertificateParseError, ClaimSubject, WorkLimit};

use super::output_format::OutputFormat;
use super::{CliError, args, file_kind, interrupt, output, progress};
use crumple_controllers::NameOrigin;
use crumple_controllers::controller_file::{self, ControllerFileError};
use crumple_core::regular_file;
use crumple_evidence::{
    BlockSelection, CertificateReport, CountsStatus, Rerun, RerunError, UncheckedCertificate,
    check_covers_scenario, checker_file, report_json, report_text, unchecked_json,
};
use crumple_networks::network::NetworkFile;
use crumple_sim::engine::NamedController;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::Scenario;

/// Accept or reject certificates with a small, independent checker
#[derive(Args)]
#[command(after_long_help = "\
The checker (crate crumple-verify) uses no code of the simulator, the search or the solver: it reads the file \
and recomputes everything except counts of runs (see below) in outward-rounded interval arithmetic. Then crumple \
derives the subject of the certificate (scenario, box, space, controllers) again from the texts in the file, and \
compares it with the statement. Exit code 1 if the checker rejects a certificate, if its subject differs from its \
statement or from the scenario of --scenario, if the check exceeds --work-limit, or if --rerun finds other counts; \
else 2 if a file is no certificate or cannot be checked. An error in one certificate does not prevent the results of \
the others.

The checker cannot confirm the counts of a rate or a comparison. --rerun simulates them again, either all or a share \
of the blocks (each but the last has at least 100 consecutive runs). The selection is random by default, so that \
the author of a certificate cannot predict it.

--pool derives one rate from the certificates of `verify rate` with several seeds. They must have the same \
controller, space, estimator, number of runs, confidence level and release, and the seeds must form a range without \
gaps. Give all certificates of a range that was fixed beforehand, because a seed that is left out could hide \
failures; --seeds states this range, so that a missing first or last seed is noticed, too. Exit code 1 if a \
certificate or the pool is refused. \
A pool has at most 10 000 certificates, and 1 000 000 000 runs.

Examples:
  crumple avoid paper-1 --certificate paper-1.json
  crumple check paper-1.json --scenario paper-1
  crumple check crumple-rate/certificate.json --rerun
  crumple check crumple-rate/certificate.json --rerun=10
  crumple check --pool --seeds 0-99 rate-*/certificate.json --rerun=1")]
pub(super) struct Check {
    /// Certificates
    #[arg(required = true, value_name = "CERTIFICATE")]
    certificates: Vec<PathBuf>,
    /// Derive one failure rate from the certificates of several seeds
    #[arg(long, conflicts_with_all = ["scenario", "policy"])]
    pool: bool,
    /// Expected seeds of the pool, such as 0-99: none may be missing, and no other may occur
    #[arg(long, value_name = "RANGE", requires = "pool", value_parser = parse_seed_range)]
    seeds: Option<RangeInclusive<u64>>,
    /// Also check that the certificates are about this scenario
    #[arg(long, value_name = "S")]
    scenario: Option<PathBuf>,
    /// Policy or network file of the claim [default: the one next to the certificate], or the original file of a
    /// network (F.onnx, F.zip, or the controller file F.toml), which crumple then imports again
    #[arg(long, value_name = "F")]
    policy: Option<PathBuf>,
    /// Simulate counted runs again: all of them, or PERCENT of their blocks (consecutive runs)
    #[arg(long, value_name = "PERCENT", num_args = 0..=1, require_equals = true, default_missing_value = "100",
          value_parser = parse_percent)]
    rerun: Option<f64>,
    /// Seed that selects the blocks to repeat; must have been unknown when the certificate was made [default: random]
    #[arg(long, value_name = "N", requires = "rerun", value_parser = args::whole_number::<u64>(0..=u64::MAX))]
    rerun_seed: Option<u64>,
    /// Controller of counted runs that is not built in, for --rerun; may be given twice
    #[arg(long, value_name = "C", requires = "rerun", value_parser = args::parse_controller)]
    controller: Vec<NamedController>,
    /// Maximum number of operations to check one certificate, in billions; the default takes about ten minutes on one
    /// core
    #[arg(long, value_name = "N", default_value_t = WorkLimit::default().to_billions())]
    #[arg(value_parser = args::whole_number::<u64>(0..=u64::MAX))]
    work_limit: u64,
    /// Output format: text, or one JSON object per certificate
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

fn parse_percent(text: &str) -> Result<f64, String> {
    match text.trim_end_matches('%').parse::<f64>() {
        Ok(percent) if percent > 0.0 && percent <= 100.0 => Ok(percent),
        _ => Err("must be above 0 and at most 100".to_owned()),
    }
}

impl Check {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        if self.pool {
            return self.run_pool(global);
        }
        let GlobalOptions { quiet, controllers } = global;
        let scenario = self
            .scenario
            .as_deref()
            .map(|path| args::load_scenario(path, controllers))
            .transpose()?;
        if self.rerun.is_some() {
            interrupt::set_exit_message(
                "no certificate was accepted or rejected".to_owned(),
                quiet,
            );
        }
        // Check the other certificates even if one cannot be read.
        let mut certificates = Vec::new();
        let mut others = Vec::new();
        for path in &self.certificates {
            match load_certificate(path) {
                Ok(certificate) => certificates.push((path, certificate)),
                Err(failure) => others.push((path.display().to_string(), failure)),
            }
        }
        let mut all = Vec::new();
        for (path, certificate) in &certificates {
            match self.check_certificate(path, certificate, scenario.as_ref(), global) {
                Ok(checked) => all.push(checked),
                Err(failure) => others.push((path.display().to_string(), failure)),
            }
        }
        let mut counted = certificates.iter().map(|(_, certificate)| certificate);
        if self.rerun.is_some() && !counted.any(counts_runs) {
            output::note("note: --rerun: no certificate counts runs", quiet);
        }
        let printed = output::print_coloured(self.format, &self.render(&all, &others)?);
        let verdict = match refusal_message(&all) {
            Some(refusal) => Err(CliError::Unmet(refusal)),
            None => others.pop().map_or(Ok(()), |(_, failure)| Err(failure)),
        };
        others.iter().for_each(|(_, failure)| failure.print());
        CliError::verdict_first(verdict, printed)
    }

    fn render(
        &self,
        all: &[CertificateReport<'_>],
        others: &[(String, CliError)],
    ) -> Result<String, CliError> {
        match self.format {
            OutputFormat::Json => {
                let checked = report_json(all).map_err(CliError::input)?;
                Ok(checked + &unchecked_to_json(others)?)
            }
            OutputFormat::Text => {
                let scenario = self.scenario.as_deref().map(Path::to_string_lossy);
                Ok(report_text(all, scenario.as_deref()))
            }
        }
    }

    fn check_certificate<'a>(
        &self,
        path: &Path,
        certificate: &'a Certificate,
        scenario: Option<&Scenario>,
        global: GlobalOptions,
    ) -> Result<CertificateReport<'a>, CliError> {
        let policy = self.policy_bytes(certificate, path)?;
        let mut report = CertificateReport::check(
            path.display().to_string(),
            certificate,
            policy.as_deref(),
            WorkLimit::from_billions(self.work_limit),
            global.controllers,
        )
        .map_err(|refused| CliError::at(path, refused))?;
        let is_count = counts_runs(certificate) && report.accepted.is_ok();
        report.counts = match self.rerun {
            _ if !is_count => None,
            Some(percent) => Some(self.rerun_counts(path, certificate, percent, global)?),
            None => Some(CountsStatus::Unconfirmed),
        };
        report.covers_scenario = scenario.map(|scenario| {
            check_covers_scenario(certificate, scenario, policy.as_deref())
                .map_err(|elsewhere| elsewhere.to_string())
        });
        Ok(report)
    }

    fn rerun_counts(
        &self,
        path: &Path,
        certificate: &Certificate,
        percent: f64,
        global: GlobalOptions,
    ) -> Result<CountsStatus, CliError> {
        let rerun = Rerun::new(certificate, &self.controller, global.controllers)
            .map_err(|error| CliError::at(path, error))?;
        self.confirm(&rerun, percent, global.quiet, |error| {
            CliError::at(path, error)
        })
    }

    /// Repeats runs, and compares them with the stated counts.
    fn confirm(
        &self,
        rerun: &Rerun,
        percent: f64,
        quiet: bool,
        describe: impl FnOnce(RerunError) -> CliError,
    ) -> Result<CountsStatus, CliError> {
        let seed = match self.rerun_seed {
            Some(seed) => seed,
            // A random seed was unknown when the certificate was made.
            None => getrandom::u64().map_err(|error| {
                CliError::Environment(format!("no random seed for --rerun: {error}"))
            })?,
        };
        let sample = if percent < 100.0 {
            BlockSelection::Sample { percent, seed }
        } else {
            BlockSelection::All
        };
        let bar = progress::run_bar("repeating runs", rerun.run_count(sample), quiet);
        let counted = progress::show(&bar, |observer| rerun.confirm(sample, observer));
        match counted {
            Ok(confirmation) => Ok(CountsStatus::Confirmed {
                confirmation,
                seed: (percent < 100.0).then_some(seed),
            }),
            Err(refuted @ RerunError::Refuted { .. }) => Ok(CountsStatus::Refuted {
                reason: refuted.to_string(),
            }),
            Err(error) => Err(describe(error)),
        }
    }

    /// Returns the policy that the checker needs. The reference policy comes with the program; the checker computes its
    /// digest again.
    fn policy_bytes(
        &self,
        certificate: &Certificate,
        path: &Path,
    ) -> Result<Option<Vec<u8>>, CliError> {
        if certificate.policy_reference().is_some()
            && let Some(source) = self
                .policy
                .as_deref()
                .filter(|path| is_network_source(path))
        {
            return read_network(source).map(Some);
        }
        let policy = certificate.read_policy(path, self.policy.as_deref());
        // The reference policy need not be next to its certificate.
        let is_of_reference = certificate
            .policy_reference()
            .is_some_and(|(_, digest)| digest == Policy::reference().digest());
        Ok(policy.or_else(|| {
            (is_of_reference && self.policy.is_none()).then(|| Policy::reference_bytes().to_vec())
        }))
    }
}

fn counts_runs(certificate: &Certificate) -> bool {
    matches!(certificate.statement.subject(), ClaimSubject::Runs(_))
}

fn unchecked_to_json(others: &[(String, CliError)]) -> Result<String, CliError> {
    let files: Vec<_> = others
        .iter()
        .map(|(path, failure)| UncheckedCertificate::new(path.clone(), failure.to_string()))
        .collect();
    unchecked_json(&files).map_err(CliError::input)
}

fn refusal_message(all: &[CertificateReport<'_>]) -> Option<String> {
    let mut rejected = Vec::new();
    let mut elsewhere = Vec::new();
    for report in all {
        if report.is_rejected() {
            rejected.push(report.path.as_str());
        } else if report.is_refused() {
            elsewhere.push(report.path.as_str());
        }
    }
    let parts: Vec<_> = [
        ("rejected", rejected),
        ("not about the scenario of --scenario", elsewhere),
    ]
    .iter()
    .filter(|(_, paths)| !paths.is_empty())
    .map(|(reason, paths)| format!("{reason}: {}", paths.join(", ")))
    .collect();
    (!parts.is_empty()).then(|| parts.join("; "))
}

/// Returns the source of a network in the form for the checker.
fn read_network(source: &Path) -> Result<Vec<u8>, CliError> {
    let file = source.display();
    let read = controller_file::load(source, NameOrigin::User).map_err(|error| match error {
        ControllerFileError::NeedsMapping { .. } | ControllerFileError::Normalised { .. } => {
            CliError::Input(format!(
                "{file}: is a network that needs a controller file; give the controller file of the certificate with \
                 --policy"
            ))
        }
        other => CliError::from_cause(other),
    })?;
    checker_file(&read)
        .map_err(|invalid| CliError::Input(format!("{file}: {invalid}")))?
        .ok_or_else(|| CliError::Input(format!("{file}: is not a network")))
}

/// Returns true if a file is the source of a network, which the checker does not read.
fn is_network_source(path: &Path) -> bool {
    NetworkFile::is_network(path)
        || path
            .extension()
            .is_some_and(|extension| extension == "toml")
}

fn load_certificate(path: &Path) -> Result<Certificate, CliError> {
    if let Some(what) = file_kind::detect(path) {
        return Err(CliError::at(
            path,
            format!("is not a certificate, but {what}"),
        ));
    }
    let file = regular_file::open(path)
        .map_err(|source| CliError::from_read_error(path.to_owned(), source))?;
    Certificate::from_reader(file).map_err(|error| match error {
        CertificateParseError::Read(source) if source.kind() == ErrorKind::InvalidData => {
            CliError::at(path, "is not a certificate: it is not UTF-8 text")
        }
        CertificateParseError::Read(source) => CliError::from_read_error(path.to_owned(), source),
        other => CliError::at(path, other),
    })
}
