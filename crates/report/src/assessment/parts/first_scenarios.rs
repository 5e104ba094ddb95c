//! The first random scenarios of a sample that violate a claim.

use serde::{Deserialize, Serialize};

use super::everyday_drives::EverydayDrive;
use crate::assessment::case::CaseVerdict;
use crate::assessment::claims::Property;

/// Indices of the first random scenarios of a sample that violate a claim, from 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FirstScenarios {
    /// A vehicle under test collides, or its controller gives no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<u64>,
    /// The controller fails, and the first controller of the report does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub only_this_fails: Option<u64>,
    /// Two vehicles collide that are both not under test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_by_others: Option<u64>,
    /// The vehicle under test brakes unnecessarily.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unnecessary_braking: Option<u64>,
    /// The vehicle under test has fallen behind at the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_behind: Option<u64>,
}

impl FirstScenarios {
    pub(super) fn from_drives(drives: &[EverydayDrive]) -> Self {
        let mut first = Self::default();
        for (index, drive) in (0..).zip(drives) {
            first.add_drive(index, drive);
        }
        first
    }

    pub(super) fn add_verdict(&mut self, index: u64, verdict: &CaseVerdict) {
        note(&mut self.failure, index, verdict.is_failure());
        note(&mut self.ended_by_others, index, !verdict.is_conclusive());
    }

    pub(super) fn add_drive(&mut self, index: u64, drive: &EverydayDrive) {
        self.add_verdict(index, drive.verdict());
        if let Some(measures) = drive.answered_measures() {
            let brakes = !measures.unnecessary.is_empty();
            note(&mut self.unnecessary_braking, index, brakes);
            let following = measures.following;
            let fell_behind = following.is_some_and(|following| following.fell_behind);
            note(&mut self.left_behind, index, fell_behind);
        }
    }

    /// Adds a failure in which the first controller of the report does not fail.
    pub(super) fn add_only_this(&mut self, index: u64) {
        note(&mut self.only_this_fails, index, true);
    }

    /// Returns the index of the first scenario that violates a property.
    pub(super) fn violating(&self, property: &Property) -> Option<u64> {
        match property {
            Property::NoCollision | Property::FailureRate => self.failure,
            Property::FailsLessOften { .. } => self.only_this_fails,
            Property::OthersKeepClear => self.ended_by_others,
            Property::NoUnnecessaryBraking => self.unnecessary_braking,
            Property::KeepsUp => self.left_behind,
            _ => None,
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

fn note(first: &mut Option<u64>, index: u64, happens: bool) {
    if happens {
        first.get_or_insert(index);
    }
}
