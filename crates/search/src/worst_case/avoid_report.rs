//! Report of an analysis of avoidability, as text and as JSON.

use serde::Serialize;

use super::avoidance::{Avoidance, AvoidanceVerdict, Optimality};
use super::emergency_brake::EmergencyBrake;
use super::escape::{Escape, FoundBy};
use super::reason::UndecidedReason;
use crate::confirmation::escape_survives;
use crumple_core::quoting::TerminalText;
use crumple_sim::scenario::Scenario;

/// Optimality of an escape of the programs.
const LARGEST_GAP: &str = "no larger smallest gap was found on this grid, over all trigger times of the follower's \
    emergency brake";

/// Report of an analysis of avoidability.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AvoidReport<'a> {
    /// Name of the scenario.
    pub scenario: &'a str,
    /// Name of the verdict.
    pub verdict: &'static str,
    /// Largest smallest gap of all replayed escapes, in metres.
    pub best_min_gap_m: Option<f64>,
    /// Smallest gap of the escape, in metres.
    pub escape_min_gap_m: Option<f64>,
    /// Upper bound of the smallest gap over every driver, in metres.
    pub min_gap_bound_m: Option<f64>,
    /// True if a certificate proves the bound.
    pub min_gap_bound_is_certified: bool,
    /// Reason why no driver keeps a larger gap: `bound` or `initial-gap`; `best-found` if that is not shown.
    pub optimality: Option<&'static str>,
    /// Time at which the follower's emergency brake fires in the replay, in seconds.
    pub trigger_time_s: Option<f64>,
    /// True if the follower's emergency brake fires in the replay; `None` if a driver behind is unknown.
    pub emergency_brake_fires: Option<bool>,
    /// ∫ a² of the escape, in m²/s³.
    pub effort_m2ps3: Option<f64>,
    /// Criterion by which the escape is the best one.
    pub escape_is_best_for: Option<String>,
    /// `programs`, or `closed-loop` if the programs do not model every driver.
    pub escape_found_by: Option<&'static str>,
    /// Number of convex programs solved.
    pub programs: usize,
    /// Number of simulations in closed loop.
    pub simulations: usize,
    /// True if the escape has no collision with the multi-body plant either.
    pub escape_survives_multi_body: Option<bool>,
    /// Reason why the analysis decides nothing.
    pub reason: Option<&'a UndecidedReason>,
}

impl<'a> AvoidReport<'a> {
    /// Creates the report of an analysis, and replays an escape with the multi-body plant.
    #[must_use]
    pub fn new(scenario: &'a Scenario, avoidance: &'a Avoidance) -> Self {
        let escape = avoidance.verdict.escape();
        let reason = match &avoidance.verdict {
            AvoidanceVerdict::Undecided(reason) => Some(reason),
            AvoidanceVerdict::Avoidable(_) | AvoidanceVerdict::Unavoidable(_) => None,
        };
        let survives =
            escape.and_then(|escape| escape_survives(scenario, &escape.acceleration_mps2));
        Self {
            scenario: &scenario.spec().name,
            verdict: avoidance.verdict.name(),
            best_min_gap_m: avoidance.best_min_gap_m,
            escape_min_gap_m: escape.map(|escape| escape.min_gap_m),
            min_gap_bound_m: avoidance.min_gap_bound_m,
            min_gap_bound_is_certified: avoidance.bound_certificate.is_some(),
            optimality: escape.map(|_| avoidance.optimality.name()),
            trigger_time_s: escape.and_then(Escape::trigger_time_s),
            emergency_brake_fires: escape.and_then(emergency_brake_fires),
            effort_m2ps3: escape.map(Escape::effort_m2ps3),
            escape_is_best_for: escape.map(|escape| criterion(escape.found_by)),
            escape_found_by: escape.map(|escape| escape.found_by.name()),
            programs: avoidance.programs,
            simulations: escape.map_or(0, |escape| simulations(escape.found_by)),
            escape_survives_multi_body: survives,
            reason,
        }
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let heading = format!("{}: {}\n", TerminalText(self.scenario), self.verdict);
        let lines = [
            self.gap_line(),
            self.bound_line(),
            self.emergency_brake_line(),
            self.effort_line(),
            self.escape_is_best_for.clone(),
            self.multi_body_line(),
            self.reason.map(ToString::to_string),
            Some(format!("{} convex programs", self.programs)),
        ];
        let indented = lines
            .into_iter()
            .flatten()
            .map(|line| format!("  {line}\n"));
        heading + &indented.collect::<String>()
    }

    fn gap_line(&self) -> Option<String> {
        let gap_m = (100.0 * self.escape_min_gap_m?).floor() / 100.0;
        let optimality = match self.optimality {
            Some(name) if name == Optimality::BestFound.name() => "best found",
            Some(name) if name == Optimality::InitialGap.name() => {
                "optimal: equals the initial gap"
            }
            _ => "optimal: equals the bound",
        };
        Some(format!(
            "smallest gap of the escape {gap_m:.2} m, {optimality}"
        ))
    }

    fn bound_line(&self) -> Option<String> {
        let bound_m = (100.0 * self.min_gap_bound_m?).ceil() / 100.0;
        let proof = if self.min_gap_bound_is_certified {
            "proved"
        } else {
            "computed, without a certificate"
        };
        Some(format!("no driver keeps more than {bound_m:.2} m, {proof}"))
    }

    fn emergency_brake_line(&self) -> Option<String> {
        match (self.trigger_time_s, self.emergency_brake_fires) {
            (Some(time_s), _) => Some(format!(
                "the follower's emergency brake fires at {time_s:.2} s"
            )),
            (None, Some(false)) => Some("no emergency brake behind fires".to_owned()),
            (None, _) => None,
        }
    }

    fn effort_line(&self) -> Option<String> {
        let effort = self.effort_m2ps3?;
        Some(format!("effort of the escape: ∫a² {effort:.1} m²/s³"))
    }

    fn multi_body_line(&self) -> Option<String> {
        let replay = if self.escape_survives_multi_body? {
            "no collision either"
        } else {
            "a COLLISION: it depends on the point mass"
        };
        Some(format!(
            "with the multi-body plant, this escape has {replay}"
        ))
    }
}

fn emergency_brake_fires(escape: &Escape) -> Option<bool> {
    match escape.emergency_brake {
        EmergencyBrake::Fires { .. } => Some(true),
        EmergencyBrake::NeverFires => Some(false),
        EmergencyBrake::Unknown => None,
    }
}

/// Describes the criterion by which a search found the best escape.
fn criterion(found_by: FoundBy) -> String {
    match found_by {
        FoundBy::Programs => LARGEST_GAP.to_owned(),
        FoundBy::ClosedLoop { simulations } => format!(
            "no larger smallest gap was found in {simulations} simulated profiles, with the drivers of all other \
             vehicles in the loop"
        ),
    }
}

fn simulations(found_by: FoundBy) -> usize {
    match found_by {
        FoundBy::Programs => 0,
        FoundBy::ClosedLoop { simulations } => simulations,
    }
}
