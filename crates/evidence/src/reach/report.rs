//! Report of a partition, as text and as JSON.

use std::path::Path;

use crumple_verify::ProvedClaim;
use serde::Serialize;

use super::{Partition, UndecidedCounts, VolumeShares};

/// Report of a partition whose certificate the checker accepted. Fields of the certificate have the names of
/// `crumple check`.
#[derive(Debug, Serialize)]
pub struct ReachReport<'a> {
    /// Name of the controller.
    pub controller: &'a str,
    /// Digest of the policy or network of the certificate.
    pub policy_sha256: Option<&'a str>,
    /// Box: a name, or a file.
    pub box_path: &'a Path,
    /// Scenario of the box.
    pub scenario: &'a str,
    /// File of the certificate, if it was written.
    pub certificate: Option<&'a Path>,
    /// Digest of the certificate.
    pub certificate_sha256: String,
    /// Always true: crumple prints no certificate that the checker rejects.
    pub accepted: bool,
    /// Proved share of the box.
    pub verified_share: Option<f64>,
    /// Smallest proved gap in that share, in metres; `None` if the share is 0.
    pub smallest_gap_m: Option<f64>,
    /// End of the proved time, in seconds; `None` if it has no end.
    pub horizon_s: Option<f64>,
    /// Results, one per depth.
    pub shares: &'a [VolumeShares],
    /// Reasons of the undecided boxes.
    pub undecided: UndecidedCounts,
    /// Conclusion of the checker.
    #[serde(skip)]
    conclusion: String,
}

impl<'a> ReachReport<'a> {
    /// Describes the partition of the box `box_path`, with the conclusion of the checker.
    #[must_use]
    pub fn new(
        controller: &'a str,
        box_path: &'a Path,
        partition: &'a Partition,
        accepted: &ProvedClaim,
    ) -> Self {
        let certificate = &partition.certificate;
        let [verified_share, min_gap_m] = match *accepted {
            ProvedClaim::Reach {
                min_gap_m,
                verified_share,
                ..
            } => [verified_share, min_gap_m].map(Some),
            _ => [None, None],
        };
        Self {
            controller,
            policy_sha256: certificate.policy_reference().map(|(_, digest)| digest),
            box_path,
            scenario: &certificate.provenance.scenario,
            certificate: None,
            certificate_sha256: certificate.digest(),
            accepted: true,
            verified_share,
            // JSON has no infinity, the gap without a verified initial state.
            smallest_gap_m: min_gap_m
                .filter(|gap_m| gap_m.is_finite() && verified_share > Some(0.0)),
            horizon_s: certificate
                .scope()
                .horizon_s
                .filter(|horizon_s| horizon_s.is_finite()),
            shares: &partition.shares,
            undecided: partition.undecided,
            conclusion: accepted.to_string(),
        }
    }

    /// Adds the file of the certificate.
    #[must_use]
    pub fn with_certificate(self, certificate: Option<&'a Path>) -> Self {
        Self {
            certificate,
            ..self
        }
    }

    /// True if a part of the box is verified.
    #[must_use]
    pub fn is_verified(&self) -> bool {
        self.is_positive(|last| last.verified)
    }

    /// True if a part of the box is undecided.
    #[must_use]
    pub fn is_undecided(&self) -> bool {
        self.is_positive(|last| last.undecided)
    }

    fn is_positive(&self, share: impl Fn(&VolumeShares) -> f64) -> bool {
        self.shares.last().is_some_and(|last| share(last) > 0.0)
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        if let Some((last, earlier)) = self.shares.split_last() {
            for shares in earlier {
                text += &format!("{}\n", shares.to_line());
            }
            text += &format!("{}\n", last.to_last_line());
        }
        if self.is_positive(|last| last.falsified) {
            text += "falsified: boxes in which a simulated initial state ends with a collision\n";
        }
        let UndecidedCounts {
            ahead,
            behind,
            too_wide,
        } = self.undecided;
        let verdict = if self.is_verified() {
            "accepted"
        } else {
            "nothing verified"
        };
        text + &format!(
            "undecided boxes: {ahead} with a possible collision ahead, {behind} behind, {too_wide} with bounds that \
             are too wide\n{verdict}: {}\n",
            self.conclusion
        )
    }
}

impl VolumeShares {
    /// Describes the shares at a depth before the last, at which no colliding initial states are searched for.
    #[must_use]
    pub fn to_line(&self) -> String {
        let verified = round_down_percent(self.verified);
        self.format_line(verified, "", 100.0 - verified)
    }

    /// Describes the shares at the last depth.
    fn to_last_line(self) -> String {
        let verified = round_down_percent(self.verified);
        let falsified = round_down_percent(self.falsified);
        let undecided = 100.0 - verified - falsified;
        self.format_line(
            verified,
            &format!(" {falsified:6.2} % falsified,"),
            undecided,
        )
    }

    fn format_line(&self, verified: f64, falsified: &str, undecided: f64) -> String {
        format!(
            "depth {:2}: {verified:6.2} % verified,{falsified} {undecided:6.2} % undecided; {} boxes, {:.2} s",
            self.depth, self.boxes, self.seconds
        )
    }
}

/// Returns a lower bound in percent, rounded down as in the checker.
fn round_down_percent(share: f64) -> f64 {
    (1e4 * share).floor() / 1e2
}
