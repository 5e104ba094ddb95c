//! Windows in which the follower's brake may fire.
//!
//! A window is a decision interval, so that every observed acceleration of the follower is known. A controller that
//! decides at every step could need one run per step. Neighbours are then merged into one window. Its run starts at the
//! begin of the first, and the follower's acceleration within it is any number from full braking to none.

use super::ego_set::{ByMode, EgoSet, MotionMode};
use super::propagate::ReachProblem;

/// Number of windows above which they are merged.
const TARGET_WINDOWS: usize = 10;
/// Largest distance of the first decisions of merged windows, in seconds.
const MAX_SPACING_S: f64 = 0.1;

pub(super) struct FiringWindow {
    /// The decision before the first instant, and the members at it.
    pub(super) k: u32,
    pub(super) members: ByMode<EgoSet>,
    /// For each motion mode: true if the follower of any member may fire its emergency brake in this window.
    fires_by_mode: [bool; 3],
    pub(super) instants: [f64; 2],
}

impl FiringWindow {
    pub(super) fn new(k: u32) -> Self {
        Self {
            k,
            members: ByMode::default(),
            fires_by_mode: [false; 3],
            instants: [f64::INFINITY, f64::NEG_INFINITY],
        }
    }

    pub(super) fn may_fire(&self) -> bool {
        self.fires_by_mode.contains(&true)
    }

    pub(super) fn record_firing(&mut self, mode: MotionMode, [first, last]: [f64; 2]) {
        self.instants = [self.instants[0].min(first), self.instants[1].max(last)];
        self.fires_by_mode[mode as usize] = true;
    }

    /// Adds the members that fire in a later window. Moving ones moved before; all others may have been in any mode.
    fn extend(&mut self, later: &Self) {
        let before = if later.fires_by_mode == [true, false, false] {
            &[MotionMode::Moving][..]
        } else {
            &MotionMode::ALL
        };
        before
            .iter()
            .for_each(|&mode| self.record_firing(mode, later.instants));
    }

    pub(super) fn into_firing_sets(self) -> ByMode<EgoSet> {
        let mut members = self.members;
        for (members, fires) in members.iter_mut().zip(self.fires_by_mode) {
            members.take_if(|_| !fires);
        }
        members
    }
}

/// Merges many windows into fewer, in order.
pub(super) fn merge_windows(
    windows: Vec<FiringWindow>,
    scene: &ReachProblem<'_>,
) -> Vec<FiringWindow> {
    let longest = (MAX_SPACING_S / scene.step_s).round() as u32;
    let most = longest.min(windows.len().div_ceil(TARGET_WINDOWS) as u32 * scene.decision_steps);
    windows
        .into_iter()
        .fold(Vec::new(), |mut merged: Vec<FiringWindow>, window| {
            match merged.last_mut() {
                Some(last) if window.k - last.k < most => last.extend(&window),
                _ => merged.push(window),
            }
            merged
        })
}

#[cfg(test)]
mod tests;
