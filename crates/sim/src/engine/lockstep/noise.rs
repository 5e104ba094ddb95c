//! Acceleration noise of one vehicle position, in all runs of a block.

use super::per_run::PerRun;
use crate::engine::actuator::Disturbance;

const PREFETCHED_STEPS: usize = 16;

/// Noise that is sampled some steps ahead. Each stream has one consumer, so that the time of sampling does not matter.
pub(super) struct Noise {
    sources: Vec<Option<Disturbance>>,
    /// One row per step with one entry per run; 0 without noise. A single row of zeros if no vehicle has noise.
    buffer_mps2: Vec<f64>,
    row_len: usize,
    used_rows: usize,
}

impl Noise {
    pub(super) fn new(sources: Vec<Option<Disturbance>>) -> Self {
        let row = PerRun::constant(0.0, sources.len()).padded().len();
        if sources.iter().any(Option::is_some) {
            Self {
                sources,
                buffer_mps2: vec![0.0; PREFETCHED_STEPS * row],
                row_len: row,
                used_rows: PREFETCHED_STEPS,
            }
        } else {
            Self {
                sources: Vec::new(),
                buffer_mps2: vec![0.0; row],
                row_len: row,
                used_rows: 0,
            }
        }
    }

    /// Returns the noise of the next step, one entry per run; 0 without noise.
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
                for (row, noise_mps2) in self
                    .buffer_mps2
                    .chunks_exact_mut(self.row_len)
                    .zip(drawn_mps2)
                {
                    row[run] = noise_mps2;
                }
            }
        }
        self.used_rows = 0;
    }

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
