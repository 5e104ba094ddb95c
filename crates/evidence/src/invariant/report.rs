//! Report of an invariant set, as text and as JSON.

use crumple_core::digits::format_fixed_up;
use crumple_verify::ProvedClaim;
use serde::Serialize;

use super::{Defeat, InvariantSet};

/// Report of an invariant set whose certificate the checker accepted.
#[derive(Debug, Serialize)]
pub struct InvariantReport<'a> {
    /// Name of the controller.
    pub controller: &'a str,
    /// Scenario with the limits of the vehicle.
    pub scenario: &'a str,
    /// Digest of the certificate.
    pub certificate_sha256: String,
    /// Always true: crumple prints no certificate that the checker rejects.
    pub accepted: bool,
    /// Proved share of the region.
    pub share: f64,
    /// Share of the region from which no simulated leader causes a collision.
    pub simulated_share: f64,
    /// Smallest proved gap, in metres.
    pub smallest_gap_m: f64,
    /// True if the own speed stays in its range.
    pub own_speed_is_kept: bool,
    /// State outside the set with a leader that defeats the controller.
    pub defeat: Option<Defeat>,
    #[serde(skip)]
    scope: String,
    /// Conclusion of the checker.
    #[serde(skip)]
    conclusion: String,
    /// True if leaders were simulated from states outside the set.
    #[serde(skip)]
    was_defeat_searched: bool,
}

impl<'a> InvariantReport<'a> {
    /// Describes a set, with the conclusion of the checker. `None` if that is about another kind of claim.
    #[must_use]
    pub fn new(
        controller: &'a str,
        set: &'a InvariantSet,
        accepted: &ProvedClaim,
        defeat: Option<Defeat>,
    ) -> Option<Self> {
        let ProvedClaim::Invariant {
            share,
            min_gap_m,
            own_speed_is_kept,
        } = *accepted
        else {
            return None;
        };
        Some(Self {
            controller,
            scenario: &set.certificate.provenance.scenario,
            certificate_sha256: set.certificate.digest(),
            accepted: true,
            share,
            simulated_share: set.simulated_share,
            smallest_gap_m: min_gap_m,
            own_speed_is_kept,
            defeat,
            scope: set.certificate.scope().to_string(),
            conclusion: accepted.to_string(),
            was_defeat_searched: set.table.axes()[1].cells != 0,
        })
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let defeat = match &self.defeat {
            Some(defeat) => defeat.describe(),
            None if self.was_defeat_searched => {
                "no simulated leader defeats the controller".to_owned()
            }
            None => "nothing was searched".to_owned(),
        };
        format!(
            "{}\naccepted: {}\nat most {} % are possible with these cells: from the other nodes, a leader that \
             brakes, at once or after 1 s, defeats the controller in a simulation\noutside the set: {defeat}\n",
            self.scope,
            self.conclusion,
            format_fixed_up(100.0 * self.simulated_share, 2)
        )
    }
}

impl Defeat {
    fn describe(&self) -> String {
        let Self {
            gap_m,
            own_mps,
            leader_mps,
            leader_accelerates_s,
        } = self;
        let brakes = if *leader_accelerates_s == 0.0 {
            "brakes at once".to_owned()
        } else {
            format!("accelerates for {leader_accelerates_s} s and then brakes")
        };
        format!(
            "at {own_mps:.2} m/s, {gap_m:.2} m behind a leader at {leader_mps:.2} m/s that {brakes}, the controller \
             collides in a simulation"
        )
    }
}
