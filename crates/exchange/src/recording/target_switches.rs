//! Division of recorded pairs where the sensor switches to another target.

use super::dropped::Omission;
use crumple_core::digits::format_fixed;

/// Change of a gap that no noise explains, in metres.
const MIN_SWITCH_M: f64 = 1.5;
/// Change that no noise explains, relative to the median error of the event's gaps.
const MIN_SWITCH_ERRORS: f64 = 9.0;
/// Allowance for changes of the speeds between two rows, in m/s².
const SPEED_CHANGE_MPS2: f64 = 2.0;

/// Samples of a follower, its leader and, if recorded, the vehicle behind it.
#[derive(Clone, Default)]
pub(super) struct PairSamples {
    pub(super) time_s: Vec<f64>,
    pub(super) line: Vec<u64>,
    pub(super) gaps_m: Vec<Option<f64>>,
    pub(super) followers_mps: Vec<Option<f64>>,
    pub(super) leaders_mps: Vec<Option<f64>>,
    /// Gaps to the vehicle behind and its speeds; empty without such columns.
    pub(super) gaps_behind_m: Vec<Option<f64>>,
    pub(super) behind_mps: Vec<Option<f64>>,
}

/// A sample with known gap and speeds.
#[derive(Clone, Copy)]
struct ClosingSample {
    index: usize,
    time_s: f64,
    gap_m: f64,
    closing_mps: f64,
}

/// Change of the gap between two samples with known gaps and speeds.
struct GapChange {
    /// Index of the later sample.
    to: usize,
    seconds: f64,
    change_m: f64,
    /// Change by the speeds, in metres.
    driven_m: f64,
}

impl GapChange {
    fn error_m(&self) -> f64 {
        (self.change_m - self.driven_m).abs()
    }

    /// Returns the omission of which this is the first occurrence, with count 0.
    fn omission(&self) -> Omission {
        let [change_m, driven_m] =
            [self.change_m, self.driven_m].map(|metres| format_fixed(metres, 1));
        let before = format!(
            "the gap changes by {change_m} m within {} s here, but the speeds by {driven_m} m: the sensor switched to \
             another target; of ",
            format_fixed(self.seconds, 2)
        );
        Omission::counted(before, 0, " such places each begins another pair")
    }
}

impl PairSamples {
    /// Ends the samples wherever the gap changes by more than noise and closing speed explain. `switches` counts these
    /// places, with the line of the first one.
    pub(super) fn split(mut self, switches: &mut Option<(u64, Omission)>) -> Vec<Self> {
        let changes = self.switches();
        for change in &changes {
            let first = switches.get_or_insert_with(|| {
                let line = self.line.get(change.to).copied().unwrap_or(0);
                (line, change.omission())
            });
            first.1.add(1);
        }
        let mut parts = Vec::new();
        for GapChange { to, .. } in changes.into_iter().rev() {
            parts.push(self.split_off(to));
        }
        parts.push(self);
        parts.reverse();
        parts
    }

    /// Splits the samples at an index, and returns those from it on.
    pub(super) fn split_off(&mut self, at: usize) -> Self {
        Self {
            time_s: self.time_s.split_off(at),
            line: self.line.split_off(at),
            gaps_m: self.gaps_m.split_off(at),
            followers_mps: self.followers_mps.split_off(at),
            leaders_mps: self.leaders_mps.split_off(at),
            gaps_behind_m: self
                .gaps_behind_m
                .split_off(at.min(self.gaps_behind_m.len())),
            behind_mps: self.behind_mps.split_off(at.min(self.behind_mps.len())),
        }
    }

    /// Returns the changes of the gap that noise and closing speed do not explain.
    fn switches(&self) -> Vec<GapChange> {
        let speeds = self.leaders_mps.iter().zip(&self.followers_mps);
        let closing_mps =
            speeds.map(|(leader, follower)| leader.zip(*follower).map(|(a, b)| a - b));
        let samples = self
            .time_s
            .iter()
            .zip(&self.gaps_m)
            .zip(closing_mps)
            .enumerate();
        let mut samples = samples.filter_map(|(index, ((&time_s, gap_m), closing_mps))| {
            Some(ClosingSample {
                index,
                time_s,
                gap_m: (*gap_m)?,
                closing_mps: closing_mps?,
            })
        });
        let Some(mut before) = samples.next() else {
            return Vec::new();
        };
        let changes = samples.map(|now| {
            let from = std::mem::replace(&mut before, now);
            let seconds = now.time_s - from.time_s;
            GapChange {
                to: now.index,
                seconds,
                change_m: now.gap_m - from.gap_m,
                driven_m: 0.5 * (from.closing_mps + now.closing_mps) * seconds,
            }
        });
        let mut changes: Vec<GapChange> = changes.collect();
        let mut errors_m: Vec<f64> = changes.iter().map(GapChange::error_m).collect();
        errors_m.sort_unstable_by(f64::total_cmp);
        let noise_m = MIN_SWITCH_ERRORS * errors_m.get(errors_m.len() / 2).copied().unwrap_or(0.0);
        changes.retain(|change| {
            change.error_m()
                > MIN_SWITCH_M.max(noise_m) + SPEED_CHANGE_MPS2 * change.seconds * change.seconds
        });
        changes
    }
}
