//! `crumple verify rate --rare`: estimates of rare failure rates, and their limits.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use indicatif::ProgressBar;

use super::output_format::OutputFormat;
use super::{CliError, output, progress, study};
use crumple_core::observer::Listener;
use crumple_evidence::rare::{ESTIMATE_FILE, RarePlan, RareProgress, RareStage};

/// Estimates a rate, writes the estimate to `folder` and prints it. With `resume` it continues from the existing
/// results.
pub(super) fn estimate(
    plan: &RarePlan,
    folder: &Path,
    resume: bool,
    format: OutputFormat,
    quiet: bool,
) -> Result<(), CliError> {
    let study = study::open(plan, folder, resume, quiet)?;
    let path = study.path(ESTIMATE_FILE);
    let is_unfinished = study.state().is_some();
    let bar = StageBar::new(quiet);
    let report = study.run(&Listener(|progress: &RareProgress| bar.show(progress)));
    bar.clear();
    let report = report?;
    if is_unfinished {
        output::note(&format!("wrote {}", path.display()), quiet);
    }
    output::print_result(format, &report, || report.to_text())
}

/// Progress bar of the current stage.
struct StageBar {
    quiet: bool,
    current: Mutex<Option<(RareStage, ProgressBar)>>,
}

impl StageBar {
    fn new(quiet: bool) -> Self {
        Self {
            quiet,
            current: Mutex::new(None),
        }
    }

    fn show(&self, progress: &RareProgress) {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        match &*current {
            Some((stage, bar)) if *stage == progress.stage => bar.set_position(progress.runs),
            earlier => {
                if let Some((_, bar)) = earlier {
                    bar.finish_and_clear();
                }
                let bar = self.start(progress);
                bar.set_position(progress.runs);
                *current = Some((progress.stage, bar));
            }
        }
    }

    fn start(&self, progress: &RareProgress) -> ProgressBar {
        match progress.stage {
            RareStage::Pilot => progress::counter("placing levels", self.quiet),
            RareStage::Repetitions => {
                progress::run_bar("climbing", progress.total.unwrap_or_default(), self.quiet)
            }
            RareStage::Resamples => progress::counter("resampling", self.quiet),
        }
    }

    fn clear(&self) {
        let current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, bar)) = &*current {
            bar.finish_and_clear();
        }
    }
}
