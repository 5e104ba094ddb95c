//! Pulses and ramps of a leader's braking, within its envelope.

use super::profile_simulator::ProfileSimulator;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum BrakeForm {
    /// Built up as fast as the jerk allows, held, and released.
    Pulse,
    /// Built up linearly over the whole length, and released.
    Ramp,
    /// Built up as fast as the jerk allows, and eased off linearly over the whole length.
    Fall,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pulse {
    form: BrakeForm,
    /// Numbers of cells before it and in it, without the release.
    onset: usize,
    length: usize,
    pub(super) depth_mps2: f64,
    /// Difference to the next shallower depth of the scan, in m/s².
    spacing_mps2: f64,
}

struct ScanSize {
    depths: usize,
    lengths: usize,
    onsets: usize,
    forms: &'static [BrakeForm],
}

impl ScanSize {
    fn for_budget(budget: usize) -> Self {
        match budget {
            ..400 => Self {
                depths: 4,
                lengths: 5,
                onsets: 2,
                forms: &[BrakeForm::Pulse],
            },
            400..2000 => Self {
                depths: 4,
                lengths: 7,
                onsets: 2,
                forms: &[BrakeForm::Pulse, BrakeForm::Ramp],
            },
            2000.. => Self {
                depths: 6,
                lengths: 16,
                onsets: 3,
                forms: &[BrakeForm::Pulse, BrakeForm::Ramp, BrakeForm::Fall],
            },
        }
    }
}

/// Returns pulses and ramps of several depths, lengths and onsets: 40, 112 or 864, depending on the budget.
pub(super) fn scan(simulator: &ProfileSimulator<'_>, budget: usize) -> Vec<Pulse> {
    let ScanSize {
        depths,
        lengths,
        onsets,
        forms,
    } = ScanSize::for_budget(budget);
    let cells = simulator.cell_count();
    let spacing_mps2 = simulator.envelope.max_brake_mps2 / depths as f64;
    // From 0.4 s to the whole duration, on a logarithmic scale.
    let shortest = (0.4 / simulator.cell_s()).max(1.0);
    let longest = (cells as f64).max(shortest);
    let lengths: Vec<usize> = (0..lengths)
        .map(|index| {
            let exponent = index as f64 / (lengths - 1) as f64;
            (shortest * (longest / shortest).powf(exponent)).round() as usize
        })
        .collect();
    let mut all = Vec::new();
    for &form in forms {
        for onset in (0..onsets).map(|index| index * cells / (4 * onsets)) {
            for &length in &lengths {
                for depth in 1..=depths {
                    all.push(Pulse {
                        form,
                        onset,
                        length,
                        depth_mps2: depth as f64 * spacing_mps2,
                        spacing_mps2,
                    });
                }
            }
        }
    }
    all
}

impl Pulse {
    pub(super) fn differs_in_depth_only(&self, other: &Self) -> bool {
        (self.form, self.onset, self.length) == (other.form, other.onset, other.length)
    }

    pub(super) fn shallower_depth_mps2(&self) -> f64 {
        self.depth_mps2 - self.spacing_mps2
    }

    pub(super) fn with_depth(self, depth_mps2: f64) -> Self {
        Self { depth_mps2, ..self }
    }

    pub(super) fn cells_mps2(&self, simulator: &ProfileSimulator<'_>) -> Vec<f64> {
        let most = simulator.envelope.jerk_mps3 * simulator.cell_s();
        let mut before = 0.0_f64;
        (0..simulator.cell_count())
            .map(|cell| {
                before = self
                    .unlimited_mps2(cell)
                    .clamp(before - most, before + most);
                before
            })
            .collect()
    }

    /// Returns the acceleration in a cell without the jerk limit.
    fn unlimited_mps2(&self, cell: usize) -> f64 {
        let into = cell
            .checked_sub(self.onset)
            .filter(|into| *into < self.length);
        into.map_or(0.0, |into| {
            let share = (into + 1) as f64 / self.length as f64;
            -self.depth_mps2
                * match self.form {
                    BrakeForm::Pulse => 1.0,
                    BrakeForm::Ramp => share,
                    BrakeForm::Fall => 1.0 - share,
                }
        })
    }
}
