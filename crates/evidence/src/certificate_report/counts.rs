//! Confirmation of the counts of a certificate.

use crumple_core::digits::format_fixed_down;
use crumple_verify::certificate::UNVERIFIED_COUNTS_CAVEAT;

use crate::Confirmation;

/// Confirmation of the counts of a certificate.
#[derive(Debug)]
pub enum CountsStatus {
    /// No run was repeated.
    Unconfirmed,
    /// Some or all runs were repeated, with the stated results.
    Confirmed {
        /// Repeated runs.
        confirmation: Confirmation,
        /// Seed of the sample, if not all runs were repeated.
        seed: Option<u64>,
    },
    /// A repeated run had another result.
    Refuted {
        /// Description of the first difference.
        reason: String,
    },
}

impl CountsStatus {
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Unconfirmed => "makers_word",
            Self::Confirmed { confirmation, .. } if confirmation.is_complete() => "confirmed",
            Self::Confirmed { .. } => "confirmed_by_sample",
            Self::Refuted { .. } => "refuted",
        }
    }

    pub(crate) fn summary(&self) -> String {
        match self {
            Self::Unconfirmed => UNVERIFIED_COUNTS_CAVEAT.to_owned(),
            Self::Refuted { reason } => format!("refuted by a new count: {reason}"),
            Self::Confirmed { confirmation, .. } if confirmation.is_complete() => format!(
                "confirmed: all {} runs were drawn and simulated again, and each has the stated result",
                confirmation.total_runs
            ),
            Self::Confirmed { confirmation, seed } => {
                summarize_sample(confirmation, seed.unwrap_or_default())
            }
        }
    }
}

fn summarize_sample(confirmation: &Confirmation, seed: u64) -> String {
    let Confirmation {
        blocks,
        total_blocks,
        runs,
        total_runs,
        ..
    } = confirmation;
    let mut probabilities = detection_probabilities(confirmation).to_vec();
    // With few runs, 1 % is one run as well.
    probabilities.dedup();
    let probabilities: Vec<String> = probabilities.into_iter().map(format_detection).collect();
    format!(
        "confirmed by a sample: {blocks} of {total_blocks} blocks, {runs} of {total_runs} runs ({} %), were \
         drawn and simulated again, and each has the stated result. If seed {seed} was chosen after the file \
         was fixed, the minimum probability of detection is, for {}",
        format_fixed_down(100.0 * *runs as f64 / *total_runs as f64, 2),
        probabilities.join(", ")
    )
}

fn format_detection((forged, probability): (u64, f64)) -> String {
    let runs = if forged == 1 { "run" } else { "runs" };
    format!(
        "{forged} forged {runs}: {} %",
        format_fixed_down(100.0 * probability, 2)
    )
}

/// Returns the probabilities of detecting one forged run, 1 % and 10 % forged runs.
pub(super) fn detection_probabilities(confirmation: &Confirmation) -> [(u64, f64); 3] {
    [
        1,
        confirmation.total_runs.div_ceil(100),
        confirmation.total_runs.div_ceil(10),
    ]
    .map(|forged| (forged, confirmation.detection_probability(forged)))
}
