//! Report of a search for the mildest sensor fault, as text and as JSON.

use serde::Serialize;

use super::sensor_attack::{FaultKindResult, MildestFault, SensorAttackResult, SensorFailure};
use crumple_core::quoting::TerminalText;

/// Report of a search for the mildest sensor fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorAttackReport<'a> {
    /// Name of the scenario.
    pub scenario: &'a str,
    /// Name of the controller.
    pub controller: &'a str,
    /// Mildest fault of all kinds that causes a collision.
    pub mildest_collision: Option<&'a MildestFault>,
    /// Mildest fault of all kinds that causes unnecessary braking.
    pub mildest_unnecessary_braking: Option<&'a MildestFault>,
    /// Result of the search.
    #[serde(flatten)]
    pub result: &'a SensorAttackResult,
}

impl<'a> SensorAttackReport<'a> {
    /// Creates the report of a search with the scenario and the controller of these names.
    #[must_use]
    pub fn new(scenario: &'a str, controller: &'a str, result: &'a SensorAttackResult) -> Self {
        Self {
            scenario,
            controller,
            mildest_collision: result.mildest(SensorFailure::Collision),
            mildest_unnecessary_braking: result.mildest(SensorFailure::UnnecessaryBraking),
            result,
        }
    }

    /// Returns the mildest fault that causes a collision, or else unnecessary braking.
    #[must_use]
    pub fn mildest(&self) -> Option<&'a MildestFault> {
        self.mildest_collision.or(self.mildest_unnecessary_braking)
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{}: {}, faults of sensors\n",
            TerminalText(self.scenario),
            TerminalText(self.controller)
        );
        let simulations = self.result.evaluations;
        if let Some(missing) = &self.result.missing_answers {
            text += &format!(
                "  CONTROLLER FAILED and gave no answer in {} of {simulations} simulations; the first: {}\n",
                missing.runs,
                TerminalText(&missing.reason)
            );
        }
        if self.result.fails_without_fault {
            return text + "  so it does without a further fault, and no fault was simulated\n";
        }
        text += &describe_mildest(
            "a collision",
            self.mildest_collision,
            self.result.collides_without_fault,
        );
        text += &describe_mildest(
            "unnecessary braking",
            self.mildest_unnecessary_braking,
            self.result.brakes_unnecessarily_without_fault,
        );
        text += &format!(
            "  {:<16} {:<26} {:<16} {:>16} {:>20}\n",
            "fault", "limit", "sizes searched", "collision", "unnecessary braking"
        );
        text.extend(self.result.kinds.iter().map(|kind| self.row(kind)));
        text + &format!("  mildest faults found; {simulations} simulations\n")
    }

    /// Returns the row of a kind of fault in the table.
    fn row(&self, result: &FaultKindResult) -> String {
        let kind = result.kind;
        let limit = result.limit;
        let sizes = &result.sizes;
        let range = format!("{} to {} {}", sizes.smallest, sizes.largest, sizes.unit);
        let collision = describe_size(
            result.collision.as_ref(),
            self.result.collides_without_fault,
            sizes.count,
        );
        let braking = describe_size(
            result.unnecessary_braking.as_ref(),
            self.result.brakes_unnecessarily_without_fault,
            sizes.count,
        );
        format!("  {kind:<16} {limit:<26} {range:<16} {collision:>16} {braking:>20}\n")
    }
}

fn describe_mildest(failure: &str, mildest: Option<&MildestFault>, happens_anyway: bool) -> String {
    match mildest {
        _ if happens_anyway => format!("  {failure} happens without a further fault\n"),
        None => format!("  no simulated fault causes {failure}\n"),
        Some(fault) => format!(
            "  mildest fault that causes {failure}: {}, {} {}, {:.1} % of its limit\n",
            fault.kind,
            fault.amount,
            fault.unit,
            100.0 * fault.share
        ),
    }
}

fn describe_size(
    mildest: Option<&MildestFault>,
    happens_anyway: bool,
    simulated_sizes: u32,
) -> String {
    match mildest {
        Some(fault) => format!("{} {}", fault.amount, fault.unit),
        None if happens_anyway => "not searched".to_owned(),
        None => format!("none of {simulated_sizes}"),
    }
}
