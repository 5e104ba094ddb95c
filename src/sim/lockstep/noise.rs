//! The noise on the accelerations of one vehicle position, in all runs of a block.

use super::per_run::PerRun;
use crate::sim::actuator::Disturbance;

/// Steps for which noise is drawn at a time: a generator's state is then fetched once for many numbers.
const AHEAD: usize = 16;

/// Noise, drawn some steps ahead. A stream has one consumer, so nobody can tell when its numbers were drawn.
pub(super) struct Noise {
    /// Empty if nobody is disturbed.
    sources: Vec<Option<Disturbance>>,
    /// An entry a step; a single one, of zeros, if nobody is disturbed.
    ahead_mps2: Vec<PerRun>,
    used: usize,
}

impl Noise {
    pub(super) fn new(sources: Vec<Option<Disturbance>>) -> Self {
        let nothing = PerRun::all(0.0, sources.len());
        if sources.iter().any(Option::is_some) {
            Self { sources, ahead_mps2: vec![nothing; AHEAD], used: AHEAD }
        } else {
            Self { sources: Vec::new(), ahead_mps2: vec![nothing], used: 0 }
        }
    }

    /// The noise of the next step; 0 for a vehicle without any.
    pub(super) fn next_mps2(&mut self) -> &PerRun {
        if self.used == self.ahead_mps2.len() {
            self.draw();
        }
        let now = self.used;
        if !self.sources.is_empty() {
            self.used += 1;
        }
        &self.ahead_mps2[now]
    }

    fn draw(&mut self) {
        for (run, source) in self.sources.iter_mut().enumerate() {
            if let Some(source) = source {
                let mut drawn = source.clone();
                for ahead_mps2 in &mut self.ahead_mps2 {
                    ahead_mps2[run] = drawn.next_mps2();
                }
                *source = drawn;
            }
        }
        self.used = 0;
    }

    /// Forgets run `run`; the last one takes its place.
    pub(super) fn swap_remove(&mut self, run: usize) {
        if !self.sources.is_empty() {
            self.sources.swap_remove(run);
        }
        for ahead_mps2 in &mut self.ahead_mps2 {
            ahead_mps2.swap_remove(run);
        }
    }
}
