//! When the follower's brake may fire.
//!
//! A window is a decision interval, so that every acceleration of the follower that is observed is known. If the actor decides at
//! every step, and members differ in the instant by many steps, that would be a run for each of them: then some neighbours become
//! one window. A run for it starts where the first of them began, and within it the follower's acceleration is any number from
//! full braking to none.

use super::ego_set::{ByMode, EgoSet, MotionMode};
use super::propagate::ReachProblem;

/// Windows become longer if they would be more than these...
const TARGET_WINDOWS: usize = 10;
/// ... but their first instants are no further apart than this, in seconds.
const MAX_SPACING_S: f64 = 0.1;

/// Instants at which the follower's brake may fire.
pub(super) struct FiringWindow {
    /// The decision before the first of them, and the members at it.
    pub(super) k: u32,
    pub(super) members: ByMode<EgoSet>,
    /// Of which of them some may fire.
    fires_by_mode: [bool; 3],
    pub(super) instants: [f64; 2],
}

impl FiringWindow {
    /// The decision interval that begins at k, in which nobody fires yet.
    pub(super) fn new(k: u32) -> Self {
        Self { k, members: ByMode::default(), fires_by_mode: [false; 3], instants: [f64::INFINITY, f64::NEG_INFINITY] }
    }

    pub(super) fn may_fire(&self) -> bool {
        self.fires_by_mode.contains(&true)
    }

    /// Some members of a kind may fire from the first to the last of these instants.
    pub(super) fn record_firing(&mut self, kind: MotionMode, [first, last]: [f64; 2]) {
        self.instants = [self.instants[0].min(first), self.instants[1].max(last)];
        self.fires_by_mode[kind as usize] = true;
    }

    /// Adds those who fire in a later window. Who moves then moved before; all others may have been of any kind.
    fn extend(&mut self, later: &Self) {
        let before =
            if later.fires_by_mode == [true, false, false] { &[MotionMode::Moving][..] } else { &MotionMode::ALL };
        before.iter().for_each(|&kind| self.record_firing(kind, later.instants));
    }

    /// Those of whom some may fire.
    pub(super) fn into_firing_sets(self) -> ByMode<EgoSet> {
        let mut members = self.members;
        for (members, fires) in members.iter_mut().zip(self.fires_by_mode) {
            members.take_if(|_| !fires);
        }
        members
    }
}

/// Fewer windows, if they are many; in order.
pub(super) fn merge_windows(windows: Vec<FiringWindow>, scene: &ReachProblem<'_>) -> Vec<FiringWindow> {
    let longest = (MAX_SPACING_S / scene.step_s).round() as u32;
    let most = longest.min(windows.len().div_ceil(TARGET_WINDOWS) as u32 * scene.decision_steps);
    windows.into_iter().fold(Vec::new(), |mut merged: Vec<FiringWindow>, window| {
        match merged.last_mut() {
            Some(last) if window.k - last.k < most => last.extend(&window),
            _ => merged.push(window),
        }
        merged
    })
}

#[cfg(test)]
mod tests;
