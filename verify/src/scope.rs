//! Scope of a claim: time, vehicles and limits. Without it a printed claim overstates: "no gap is ever smaller" may
//! cover only four seconds.

use std::fmt;

use crate::ClaimSubject;
use crate::certificate::Certificate;
use crate::number::format_number;

pub(crate) const NO_VEHICLE_BEHIND: &str = "behind: no vehicle";

/// The subject of a statement in words, without its claim.
#[derive(Debug, Clone, PartialEq)]
pub struct Scope {
    /// Covered time in seconds; infinite for an unlimited claim, `None` if unstated.
    pub horizon_s: Option<f64>,
    /// True if checking also establishes safety after that time.
    pub covers_after_horizon: bool,
    /// Scenario, box or space, and its binding to the statement.
    pub about: String,
    /// Each vehicle except those behind, front to rear, with its initial state and possible behaviour.
    pub vehicles: Vec<String>,
    /// Claim about vehicles behind the last one under test; `None` for a claim about a scenario space.
    pub behind: Option<String>,
    /// Other limits.
    pub limits: Vec<String>,
}

impl Certificate {
    /// Returns the scope of the claim.
    #[must_use]
    pub fn scope(&self) -> Scope {
        Scope {
            about: self.describe_subject(),
            ..self.statement.claim().scope()
        }
    }

    /// Returns the scope of a claim about a scenario that has `left_out` vehicles more behind than the claim.
    #[must_use]
    pub fn scope_with_uncovered_vehicles(&self, left_out: usize) -> Scope {
        let mut scope = self.scope();
        let vehicles = if left_out == 1 { "vehicle" } else { "vehicles" };
        let is_followed = self
            .statement
            .scene()
            .is_some_and(|scene| scene.follower.is_some());
        scope.behind = match (scope.behind.filter(|_| is_followed), left_out) {
            (behind, 0) => Some(behind.unwrap_or_else(|| NO_VEHICLE_BEHIND.to_owned())),
            (Some(behind), _) => Some(format!(
                "{behind}\nfarther behind: {left_out} {vehicles}, not part of the claim"
            )),
            (None, _) => Some(format!(
                "behind: {left_out} {vehicles}, not part of the claim"
            )),
        };
        scope
    }

    fn describe_subject(&self) -> String {
        // The author of the file chose the name: it must not control a terminal.
        let name = self.provenance.scenario.escape_debug();
        let sha256 = &self.provenance.scenario_sha256;
        if self.is_first_version() {
            return format!(
                "`{name}`, as the file states; version 1 does not bind the statement to a text"
            );
        }
        match self.statement.subject() {
            ClaimSubject::AnyVehicles => "any two vehicles with these limits".to_owned(),
            ClaimSubject::AnyNeighbours => {
                "any leader and any follower with these limits".to_owned()
            }
            ClaimSubject::Runs(_) => format!("space `{name}`, SHA-256 {sha256}"),
            ClaimSubject::Region(_) => {
                format!("the limits of scenario `{name}`, SHA-256 {sha256}")
            }
            ClaimSubject::Scene { .. } | ClaimSubject::InitialStates(_)
                if self.provenance.box_text.is_some() =>
            {
                format!("a box around scenario `{name}`, SHA-256 {sha256}")
            }
            ClaimSubject::Scene { .. } | ClaimSubject::InitialStates(_) => {
                format!("scenario `{name}`, SHA-256 {sha256}")
            }
        }
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            horizon_s,
            covers_after_horizon: has_afterwards,
            about,
            vehicles,
            behind,
            limits,
        } = self;
        writeln!(out, "about {about}")?;
        match horizon_s {
            Some(f64::INFINITY) => write!(out, "for ever")?,
            Some(horizon_s) if *has_afterwards => write!(out, "for {horizon_s} s from the start")?,
            Some(horizon_s) => write!(out, "for {horizon_s} s from the start and no longer")?,
            None => write!(out, "horizon not stated")?,
        }
        vehicles
            .iter()
            .chain(behind)
            .chain(limits)
            .try_for_each(|line| write!(out, "\n{line}"))
    }
}

impl Scope {
    /// Creates the scope of a claim about no later time, without a description of its subject and of vehicles behind.
    pub(crate) fn new(horizon_s: Option<f64>, vehicles: Vec<String>, limits: Vec<String>) -> Self {
        Self {
            horizon_s,
            covers_after_horizon: false,
            about: String::new(),
            vehicles,
            behind: None,
            limits,
        }
    }
}

/// Describes the largest error of each observed quantity, given as name, error and unit.
pub(crate) fn describe_errors(errors: &[(&str, f64, &str)]) -> String {
    let errors: Vec<_> = errors
        .iter()
        .map(|(quantity, error, unit)| format!("{quantity} {} {unit}", format_number(*error)))
        .collect();
    format!("largest observation errors: {}", errors.join(", "))
}
