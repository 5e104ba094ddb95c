//! Reports on pools as text.

use crumple_core::quoting::TerminalText;
use crumple_verify::pool::UNSTATED_RANGE_CAVEAT;

use super::{PoolReport, RejectedPool};
use crate::certificate_report::scope_lines;
use crate::replay_report::plural;

impl PoolReport {
    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let claim = &self.claim;
        let verdict = if self.is_refuted() {
            "REFUTED: its counts are wrong, although the claim follows from them"
        } else {
            "accepted"
        };
        let plural = plural(self.certificates as u64);
        let mut text = format!(
            "pool of {} certificate{plural}: {verdict}: {claim}\n",
            self.certificates
        );
        text += &format!(
            "  counted: {} failures in {} runs\n",
            claim.failures, claim.runs
        );
        text += &format!("  {}\n", TerminalText(&self.counts.summary()));
        text += &scope_lines(&claim.scope, "space", self.is_built_in);
        if !claim.is_expected_range {
            text += &format!("  {UNSTATED_RANGE_CAVEAT}\n");
        }
        for assumption in self.assumptions() {
            text += &format!("  assuming that {assumption}\n");
        }
        if let Some(plants) = self.plants {
            text += &format!("  {plants}\n");
        }
        text += &format!(
            "  SHA-256 of the digests of the certificates: {}\n",
            claim.sha256
        );
        text
    }
}

impl RejectedPool {
    /// Returns the report for a reader, as a line.
    #[must_use]
    pub fn to_text(&self) -> String {
        format!("pool: rejected: {}\n", TerminalText(&self.rejection))
    }
}
