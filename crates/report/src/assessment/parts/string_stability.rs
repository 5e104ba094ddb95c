//! What a line of vehicles under one controller makes of a disturbance.

use serde::{Deserialize, Serialize};

use crate::assessment::Rounded;
use crate::assessment::claims::Strength;
use crate::assessment::table::{Cell, Mark};
use crumple_world::measure::SpeedAmplification;
use crumple_world::scenario::{SPEED_DIP_ONSET_S, Scenario};
use crumple_world::sim::{RecordingLevel, Run, RunError, RunOptions, Unanswered, simulate};

/// What a line of vehicles makes of a disturbance of its leader.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum StringStabilityVerdict {
    /// No vehicle deviates more than the one ahead.
    Damps {
        /// The last one's deviation, relative to the leader's.
        gain: Rounded<2>,
    },
    /// Some vehicle deviates more than the one ahead.
    Amplifies {
        /// The last one's deviation, relative to the leader's.
        gain: Rounded<2>,
    },
    /// The line does not drive at one speed to begin with.
    DoesNotSettle,
    /// Vehicles touch.
    #[serde(rename = "fails")]
    Collides,
    /// Its controller gave no answer.
    #[serde(rename = "no_answer")]
    Unanswered {
        /// When and why.
        because: String,
    },
}

impl StringStabilityVerdict {
    pub(super) fn simulate(line: &Scenario, options: &RunOptions) -> Result<Self, RunError> {
        let simulated = simulate(&Run::new(line, options.clone())?, RecordingLevel::Trace);
        if let Some(failed) = simulated.outcome.failed() {
            return Ok(Self::NoAnswer { because: failed.because() });
        }
        if !simulated.outcome.is_safe() {
            return Ok(Self::Fails);
        }
        let found = simulated.trace.as_ref().and_then(|trace| SpeedAmplification::of(trace, SPEED_DIP_ONSET_S));
        Ok(found.map_or(Self::DoesNotSettle, |found| {
            let gain = Rounded::new(found.overall);
            if found.grows() { Self::Amplifies { gain } } else { Self::Damps { gain } }
        }))
    }

    /// What it says of the claim that no disturbance grows: of a line that drives at no one speed nothing.
    pub(super) fn strength(&self) -> Strength {
        match self {
            Self::Damps { .. } => Strength::of(0, 1),
            Self::Amplifies { .. } | Self::Fails => Strength::of(1, 1),
            Self::NoAnswer { because } => {
                let silent = Unanswered { runs: 1, because: because.clone() };
                Strength::from_counts_with_unanswered(0, 1, Some(&silent), false)
            }
            Self::DoesNotSettle => Strength::Untried,
        }
    }

    /// Whether no disturbance grew.
    pub(in crate::assessment) fn is_string_stable(&self) -> bool {
        matches!(self, Self::Damps { .. })
    }

    pub(in crate::assessment) fn describe(&self) -> String {
        match self {
            Self::Damps { gain } => format!("it shrinks to {gain} of what it was"),
            Self::Amplifies { gain } => {
                format!("some vehicle deviates more than the one ahead, the last by {gain} of it")
            }
            Self::DoesNotSettle => "the line does not settle to one speed".to_owned(),
            Self::Fails => "vehicles of the line touch".to_owned(),
            Self::NoAnswer { because } => format!("it gave no answer: {because}"),
        }
    }

    pub(super) fn table_cell(&self) -> Cell {
        match self {
            Self::Damps { gain } => Cell::marked(gain, Mark::Good),
            Self::Amplifies { gain } => Cell::marked(gain, Mark::Bad),
            Self::DoesNotSettle => Cell::text("does not settle"),
            Self::Fails => Cell::marked("fails", Mark::Bad),
            Self::NoAnswer { .. } => Cell::marked("no answer", Mark::Bad),
        }
    }
}
