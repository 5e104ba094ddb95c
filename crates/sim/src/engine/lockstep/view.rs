//! True state of a vehicle position and its neighbours, in all runs of a block.

use super::per_run::{PerRun, RunSet};
use crate::observation::{Neighbour, Observation};

#[derive(Clone, Copy)]
pub(super) struct StateSlices<'a> {
    pub(super) position_m: &'a [f64],
    pub(super) length_m: &'a [f64],
    pub(super) speed_mps: &'a [f64],
    pub(super) acceleration_mps2: &'a [f64],
}

impl<'a> StateSlices<'a> {
    #[inline(always)]
    pub(super) fn first(runs: usize, [x, l, v, a]: [&'a PerRun; 4]) -> Self {
        Self {
            position_m: &x.padded()[..runs],
            length_m: &l.padded()[..runs],
            speed_mps: &v.padded()[..runs],
            acceleration_mps2: &a.padded()[..runs],
        }
    }

    #[inline(always)]
    fn neighbour(&self, run: usize, gap_m: f64) -> Neighbour {
        Neighbour {
            gap_m,
            speed_mps: self.speed_mps[run],
            acceleration_mps2: self.acceleration_mps2[run],
        }
    }
}

#[derive(Clone, Copy)]
pub(super) struct NeighbourhoodView<'a> {
    pub(super) own: StateSlices<'a>,
    pub(super) front: Option<StateSlices<'a>>,
    pub(super) behind: Option<StateSlices<'a>>,
    /// Runs in which the vehicle does not observe its follower.
    pub(super) hides_follower: RunSet,
}

impl NeighbourhoodView<'_> {
    /// Returns the observation in one run. Inlined, so that a driver computes only the numbers that it reads.
    #[inline(always)]
    pub(super) fn observation(&self, run: usize) -> Observation {
        let own = &self.own;
        Observation {
            speed_mps: own.speed_mps[run],
            acceleration_mps2: own.acceleration_mps2[run],
            ahead: self.front.as_ref().map(
                #[inline(always)]
                |front| {
                    front.neighbour(
                        run,
                        front.position_m[run] - front.length_m[run] - own.position_m[run],
                    )
                },
            ),
            behind: self
                .behind
                .as_ref()
                .filter(|_| !self.hides_follower.contains(run))
                .map(
                    #[inline(always)]
                    |behind| {
                        behind.neighbour(
                            run,
                            own.position_m[run] - own.length_m[run] - behind.position_m[run],
                        )
                    },
                ),
        }
    }
}
