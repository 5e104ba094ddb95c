//! Vehicles with a profile, in all runs of a block.

use pulp::Arch;

use super::loops;
use super::per_run::PerRun;
use crate::policy::SimdClosure;
use crate::scenario::LeadProfile;

pub(super) enum ScriptedLeaders<'s> {
    /// All vehicles brake at a constant rate from an onset on, as most leaders do: `[onset, rate]`.
    Brake([PerRun; 2]),
    Any(Vec<Script<'s>>),
}

/// A profile with its current acceleration, so that it is evaluated once per change instead of once per step.
pub(super) struct Script<'s> {
    profile: &'s LeadProfile,
    cached_mps2: f64,
    /// Time until which the cached acceleration holds, in seconds.
    valid_until_s: f64,
}

impl<'s> Script<'s> {
    fn new(profile: &'s LeadProfile) -> Self {
        Self {
            profile,
            cached_mps2: 0.0,
            valid_until_s: f64::NEG_INFINITY,
        }
    }

    #[inline(always)]
    fn acceleration_mps2(&mut self, span_s: [f64; 2], speed_mps: f64) -> f64 {
        if span_s[1] <= self.valid_until_s {
            self.cached_mps2
        } else {
            self.look_up_mps2(span_s, speed_mps)
        }
    }

    #[inline(never)]
    fn look_up_mps2(&mut self, [from_s, to_s]: [f64; 2], speed_mps: f64) -> f64 {
        if let Some(span) = self.profile.constant_acceleration_span(from_s) {
            [self.cached_mps2, self.valid_until_s] = span;
        }
        if to_s <= self.valid_until_s {
            self.cached_mps2
        } else {
            self.profile.acceleration_mps2(from_s, to_s, speed_mps)
        }
    }
}

impl<'s> ScriptedLeaders<'s> {
    pub(super) fn new(profiles: Vec<&'s LeadProfile>) -> Self {
        let brakes: Option<Vec<[f64; 2]>> = profiles
            .iter()
            .map(|profile| match profile {
                LeadProfile::Brake(brake) => Some([brake.onset_s, brake.rate_mps2]),
                _ => None,
            })
            .collect();
        match brakes {
            Some(brakes) => Self::Brake(
                [0, 1].map(|which| PerRun::from_values(brakes.iter().map(|brake| brake[which]))),
            ),
            None => Self::Any(profiles.into_iter().map(Script::new).collect()),
        }
    }

    pub(super) fn command(
        &mut self,
        arch: Arch,
        [from_s, to_s]: [f64; 2],
        speeds_mps: &[f64],
        decided_mps2: &mut [f64],
    ) {
        match self {
            Self::Brake(brakes) => {
                let [onset_s, rate_mps2] = brakes.each_ref().map(PerRun::padded);
                arch.dispatch(SimdClosure(
                    #[inline(always)]
                    || loops::brake([from_s, to_s], onset_s, rate_mps2, decided_mps2),
                ));
            }
            Self::Any(scripts) => {
                for ((decided_mps2, script), &speed_mps) in
                    decided_mps2.iter_mut().zip(scripts).zip(speeds_mps)
                {
                    *decided_mps2 = script.acceleration_mps2([from_s, to_s], speed_mps);
                }
            }
        }
    }

    pub(super) fn swap_remove(&mut self, run: usize) {
        match self {
            Self::Brake([onset_s, rate_mps2]) => {
                onset_s.swap_remove(run);
                rate_mps2.swap_remove(run);
            }
            Self::Any(scripts) => drop(scripts.swap_remove(run)),
        }
    }
}
