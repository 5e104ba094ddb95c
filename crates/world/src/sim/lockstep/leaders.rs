//! Vehicles that follow a script, in all runs of a block.

use pulp::Arch;

use super::loops;
use super::per_run::PerRun;
use crate::policy::InSimd;
use crate::scenario::LeadProfile;

/// One script a run.
pub(super) enum Leaders<'s> {
    /// Everybody brakes at a constant rate from some time on, as leaders nearly always do: `[onset, rate]`.
    Brake([PerRun; 2]),
    Any(Vec<&'s LeadProfile>),
}

impl<'s> Leaders<'s> {
    pub(super) fn new(profiles: Vec<&'s LeadProfile>) -> Self {
        let brakes: Option<Vec<[f64; 2]>> = profiles
            .iter()
            .map(|profile| match profile {
                LeadProfile::Brake(brake) => Some([brake.onset_s, brake.rate_mps2]),
                _ => None,
            })
            .collect();
        match brakes {
            Some(brakes) => Self::Brake([0, 1].map(|which| PerRun::of(brakes.iter().map(|brake| brake[which])))),
            None => Self::Any(profiles),
        }
    }

    /// Accelerations to hold over a step.
    pub(super) fn lead(&self, arch: Arch, [from_s, to_s]: [f64; 2], speeds_mps: &[f64], decided_mps2: &mut [f64]) {
        match self {
            Self::Brake(brakes) => {
                let [onset_s, rate_mps2] = brakes.each_ref().map(PerRun::filled);
                arch.dispatch(InSimd(
                    #[inline(always)]
                    || loops::brake([from_s, to_s], onset_s, rate_mps2, decided_mps2),
                ));
            }
            Self::Any(profiles) => {
                for ((decided_mps2, profile), &speed_mps) in decided_mps2.iter_mut().zip(profiles).zip(speeds_mps) {
                    *decided_mps2 = profile.acceleration_mps2(from_s, to_s, speed_mps);
                }
            }
        }
    }

    /// Forgets run `run`; the last one takes its place.
    pub(super) fn swap_remove(&mut self, run: usize) {
        match self {
            Self::Brake([onset_s, rate_mps2]) => {
                onset_s.swap_remove(run);
                rate_mps2.swap_remove(run);
            }
            Self::Any(profiles) => drop(profiles.swap_remove(run)),
        }
    }
}
