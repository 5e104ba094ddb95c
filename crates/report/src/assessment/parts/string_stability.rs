//! String stability: the effect of a disturbance on a line of vehicles under one controller.

use serde::{Deserialize, Serialize};

use crate::assessment::Rounded;
use crate::assessment::claims::Strength;
use crate::assessment::table::{CellMark, ReportCell};
use crumple_world::measure::SpeedAmplification;
use crumple_world::scenario::{SPEED_DIP_ONSET_S, Scenario};
use crumple_world::sim::{FailedControllerRuns, RecordingLevel, Run, RunError, RunOptions, simulate};

/// The effect of a disturbance of the leader on a line of vehicles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum StringStabilityVerdict {
    /// No vehicle deviates more than its leader.
    Damps {
        /// Deviation of the last vehicle, relative to that of the leader.
        gain: Rounded<2>,
    },
    /// Some vehicle deviates more than its leader.
    Amplifies {
        /// Deviation of the last vehicle, relative to that of the leader.
        gain: Rounded<2>,
    },
    /// The line does not reach a common speed before the disturbance.
    DoesNotSettle,
    /// Vehicles collide.
    #[serde(rename = "fails")]
    Collides,
    /// A controller gave no answer.
    #[serde(rename = "no_answer")]
    Unanswered {
        /// Time and reason.
        #[serde(rename = "because")]
        reason: String,
    },
}

impl StringStabilityVerdict {
    pub(super) fn simulate(line: &Scenario, options: &RunOptions) -> Result<Self, RunError> {
        let simulated = simulate(&Run::new(line, options.clone())?, RecordingLevel::Trace);
        if let Some(failed) = simulated.outcome.failed_controller() {
            return Ok(Self::Unanswered { reason: failed.reason() });
        }
        if !simulated.outcome.is_safe() {
            return Ok(Self::Collides);
        }
        let found = simulated.trace.as_ref().and_then(|trace| SpeedAmplification::from_trace(trace, SPEED_DIP_ONSET_S));
        Ok(found.map_or(Self::DoesNotSettle, |found| {
            let gain = Rounded::new(found.overall);
            if found.has_amplification() { Self::Amplifies { gain } } else { Self::Damps { gain } }
        }))
    }

    /// Returns the strength of the claim that no disturbance grows; a line without a common speed is no evidence.
    pub(super) fn strength(&self) -> Strength {
        match self {
            Self::Damps { .. } => Strength::from_counts(0, 1),
            Self::Amplifies { .. } | Self::Collides => Strength::from_counts(1, 1),
            Self::Unanswered { reason } => {
                let unanswered = FailedControllerRuns { runs: 1, because: reason.clone() };
                Strength::from_counts_with_unanswered(0, 1, Some(&unanswered), false)
            }
            Self::DoesNotSettle => Strength::Untried,
        }
    }

    pub(in crate::assessment) fn is_string_stable(&self) -> bool {
        matches!(self, Self::Damps { .. })
    }

    pub(in crate::assessment) fn describe(&self) -> String {
        match self {
            Self::Damps { gain } => format!("the disturbance shrinks to {gain} of the leader's"),
            Self::Amplifies { gain } => {
                format!("a vehicle deviates more than its leader; the gain of the last is {gain}")
            }
            Self::DoesNotSettle => "the platoon does not reach a common speed".to_owned(),
            Self::Collides => "vehicles of the platoon collide".to_owned(),
            Self::Unanswered { reason } => format!("it gave no answer: {reason}"),
        }
    }

    pub(super) fn table_cell(&self) -> ReportCell {
        match self {
            Self::Damps { gain } => ReportCell::with_mark(gain, CellMark::Good),
            Self::Amplifies { gain } => ReportCell::with_mark(gain, CellMark::Bad),
            Self::DoesNotSettle => ReportCell::text("unsettled"),
            Self::Collides => ReportCell::with_mark("collides", CellMark::Bad),
            Self::Unanswered { .. } => ReportCell::with_mark("no answer", CellMark::Bad),
        }
    }
}
