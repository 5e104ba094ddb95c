//! Trials of cars on a test track, read from a table.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::ExperimentError;

const MAX_TRIALS: usize = 10_000;

/// Manoeuvre of the leader (49 CFR 571.127, S7.3 to S7.5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum TestKind {
    Stopped,
    Slower,
    Decelerating,
}

/// Conditions of a test, without its results.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TestCell {
    pub(super) kind: TestKind,
    pub(super) own_speed_kmh: f64,
    pub(super) lead_speed_kmh: f64,
    pub(super) lead_deceleration_g: Option<f64>,
    pub(super) headway_m: Option<f64>,
}

impl TestCell {
    /// Returns the conditions in words, for tables.
    pub(super) fn name(&self) -> String {
        let Self {
            kind,
            own_speed_kmh: own,
            lead_speed_kmh: lead,
            ..
        } = self;
        match kind {
            TestKind::Stopped => format!("stopped, {own} km/h"),
            TestKind::Slower => format!("slower, {own} behind {lead} km/h"),
            TestKind::Decelerating => format!("decelerating, {own} km/h"),
        }
    }
}

/// A trial of a car.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TrackTrial {
    pub(super) car: String,
    pub(super) cell: TestCell,
    /// Relative speed at the collision, in km/h; `None` without one.
    pub(super) impact_kmh: Option<f64>,
}

#[derive(Deserialize)]
struct TrialRow {
    test: TestKind,
    own_speed_kmh: f64,
    lead_speed_kmh: f64,
    lead_deceleration_g: Option<f64>,
    headway_m: Option<f64>,
    car: String,
    /// NHTSA's word for a collision.
    contact: YesOrNo,
    impact_kmh: Option<f64>,
}

#[derive(Deserialize, PartialEq)]
#[serde(rename_all = "kebab-case")]
enum YesOrNo {
    Yes,
    No,
}

impl TrialRow {
    fn into_trial(self) -> Result<TrackTrial, &'static str> {
        if (self.contact == YesOrNo::Yes) != self.impact_kmh.is_some() {
            return Err("impact_kmh must be given with contact `yes` only");
        }
        let is_decelerating = self.test == TestKind::Decelerating;
        if is_decelerating != self.lead_deceleration_g.is_some()
            || is_decelerating != self.headway_m.is_some()
        {
            return Err(
                "lead_deceleration_g and headway_m must be given in test `decelerating` only",
            );
        }
        Ok(TrackTrial {
            car: self.car,
            cell: TestCell {
                kind: self.test,
                own_speed_kmh: self.own_speed_kmh,
                lead_speed_kmh: self.lead_speed_kmh,
                lead_deceleration_g: self.lead_deceleration_g,
                headway_m: self.headway_m,
            },
            impact_kmh: self.impact_kmh,
        })
    }
}

/// Reads a table of at most 10 000 trials. Lines that begin with `#` are comments.
pub(super) fn read(path: &Path) -> Result<Vec<TrackTrial>, ExperimentError> {
    let in_file = |problem: &dyn std::fmt::Display| format!("{}: {problem}", path.display());
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .from_path(path)
        .map_err(|error| in_file(&error))?;
    let mut trials = Vec::new();
    for (row, number) in reader.deserialize::<TrialRow>().zip(1..) {
        if number > MAX_TRIALS {
            return Err(in_file(&"more than 10 000 trials").into());
        }
        let row = row.map_err(|error| in_file(&error))?;
        let trial = row
            .into_trial()
            .map_err(|problem| in_file(&format!("trial {number}: {problem}")))?;
        trials.push(trial);
    }
    Ok(trials)
}

/// Returns each car and conditions of these trials once, in order.
pub(super) fn conditions(trials: &[TrackTrial]) -> Vec<(String, TestCell)> {
    let mut conditions: Vec<(String, TestCell)> = Vec::new();
    for trial in trials {
        let tested = (trial.car.clone(), trial.cell);
        if !conditions.contains(&tested) {
            conditions.push(tested);
        }
    }
    conditions
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_trials_are_read() {
        let tests = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../corpora/vehicle-tests/nhtsa-2023-aeb.csv");
        let trials = read(&tests).unwrap();
        assert!(trials.iter().any(|trial| trial.impact_kmh.is_some()));
        assert!(trials.iter().any(|trial| trial.impact_kmh.is_none()));
    }
}
