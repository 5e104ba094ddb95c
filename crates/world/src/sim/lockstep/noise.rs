//! The noise on the accelerations of one vehicle position, in all runs of a block.

use super::per_run::PerRun;
use crate::sim::actuator::Disturbance;

/// Steps for which noise is drawn at a time: a generator's state is then fetched once for many numbers.
const PREFETCHED_STEPS: usize = 16;

/// Noise, drawn some steps ahead. A stream has one consumer, so nobody can tell when its numbers were drawn.
pub(super) struct Noise {
    /// Empty if nobody is disturbed.
    sources: Vec<Option<Disturbance>>,
    /// One row a step, with an entry a run; 0 for vehicles without noise. A single row of zeros if nobody is disturbed.
    buffer_mps2: Vec<f64>,
    /// Length of a row.
    row_len: usize,
    used_rows: usize,
}

impl Noise {
    pub(super) fn new(sources: Vec<Option<Disturbance>>) -> Self {
        let row = PerRun::constant(0.0, sources.len()).padded().len();
        if sources.iter().any(Option::is_some) {
            Self { sources, buffer_mps2: vec![0.0; PREFETCHED_STEPS * row], row_len: row, used_rows: PREFETCHED_STEPS }
        } else {
            Self { sources: Vec::new(), buffer_mps2: vec![0.0; row], row_len: row, used_rows: 0 }
        }
    }

    /// The noise of the next step, a row; 0 for a vehicle without any.
    pub(super) fn next_mps2(&mut self) -> &[f64] {
        if !self.sources.is_empty() {
            if self.used_rows == PREFETCHED_STEPS {
                self.refill();
            }
            self.used_rows += 1;
        }
        let now = self.used_rows.saturating_sub(1) * self.row_len;
        &self.buffer_mps2[now..now + self.row_len]
    }

    #[inline(never)]
    fn refill(&mut self) {
        for (run, source) in self.sources.iter_mut().enumerate() {
            if let Some(source) = source {
                let drawn_mps2: [f64; PREFETCHED_STEPS] = source.next_n_mps2();
                for (row, noise_mps2) in self.buffer_mps2.chunks_exact_mut(self.row_len).zip(drawn_mps2) {
                    row[run] = noise_mps2;
                }
            }
        }
        self.used_rows = 0;
    }

    /// Forgets run `run`; the last one takes its place.
    pub(super) fn swap_remove(&mut self, run: usize) {
        if !self.sources.is_empty() {
            self.sources.swap_remove(run);
            let last = self.sources.len();
            for row in self.buffer_mps2.chunks_exact_mut(self.row_len) {
                row[run] = row[last];
            }
        }
    }
}
