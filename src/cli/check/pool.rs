//! `crumple check --pool`: one failure rate from the certificates of several seeds.

use crumple_evidence::{PoolCheck, PoolReport, RejectedPool};
use crumple_verify::WorkLimit;

use super::{Check, load_certificate};
use crate::cli::global_options::GlobalOptions;
use crate::cli::output_format::OutputFormat;
use crate::cli::{CliError, interrupt, output};

impl Check {
    /// Concludes one rate from all certificates, and prints it.
    pub(super) fn run_pool(self, global: GlobalOptions) -> Result<(), CliError> {
        if self.rerun.is_some() {
            let message = "the pool was neither accepted nor rejected".to_owned();
            interrupt::set_exit_message(message, global.quiet);
        }
        let mut pool = PoolCheck::new(
            WorkLimit::from_billions(self.work_limit),
            global.controllers,
        );
        if let Some(seeds) = &self.seeds {
            pool = pool.with_expected_seeds(seeds.clone());
        }
        if self.rerun.is_some() {
            pool = pool.with_rerun(self.controller.clone());
        }
        // One after the other, so that only the counts stay in memory.
        for path in &self.certificates {
            match pool.add(&load_certificate(path)?) {
                Ok(()) => {}
                Err(error) if error.is_refusal() => {
                    return self.refuse(format!("{}: {error}", path.display()));
                }
                Err(error) => return Err(CliError::at(path, error)),
            }
        }
        let mut report = match pool.conclude() {
            Ok(report) => report,
            Err(rejection) => return self.refuse(rejection.to_string()),
        };
        if let (Some(percent), Some(rerun)) = (self.rerun, pool.rerun()) {
            report.counts = self.confirm(rerun, percent, global.quiet, CliError::input)?;
        }
        self.print_report(&report)
    }

    fn print_report(&self, report: &PoolReport) -> Result<(), CliError> {
        let text = match self.format {
            OutputFormat::Json => report.to_json().map_err(CliError::input)?,
            OutputFormat::Text => report.to_text(),
        };
        self.print_verdict(&text, report.is_refuted())
    }

    fn print_verdict(&self, text: &str, is_rejected: bool) -> Result<(), CliError> {
        let printed = output::print_coloured(self.format, text);
        let verdict = match is_rejected {
            true => Err(CliError::Unmet("rejected: the pool".to_owned())),
            false => Ok(()),
        };
        CliError::verdict_first(verdict, printed)
    }

    fn refuse(&self, rejection: String) -> Result<(), CliError> {
        let report = RejectedPool {
            certificates: self.certificates.len(),
            rejection,
        };
        let text = match self.format {
            OutputFormat::Json => report.to_json().map_err(CliError::input)?,
            OutputFormat::Text => report.to_text(),
        };
        self.print_verdict(&text, true)
    }
}
