//! The drivers of one vehicle position over all runs of a block.

use pulp::Arch;

use super::followers::Followers;
use super::leaders::Leaders;
use super::view::View;
use crate::control::{
    AccAeb, AnyController, Baseline, BaselineUnlatched, ConstantBrake, Controller, MatchLeader, PolicyDriver,
};
use crate::estimate::Observation;
use crate::sim::run::Pilot;

/// One driver a run, sorted out by kind so that a whole block is driven by one loop without dispatch inside it.
pub(super) enum Pilots<'s> {
    Profile(Leaders<'s>),
    Baseline(Vec<Baseline>),
    BaselineUnlatched(Vec<BaselineUnlatched>),
    MatchLeader(Vec<MatchLeader>),
    ConstantBrake(Vec<ConstantBrake>),
    Idm(Followers),
    AccAeb(Vec<AccAeb>),
    Policy(Vec<PolicyDriver>),
    /// Drivers of several kinds, or from outside.
    Mixed(Vec<Pilot<'s>>),
}

impl<'s> Pilots<'s> {
    pub(super) fn new(pilots: Vec<Pilot<'s>>) -> Self {
        /// All of one kind, or everybody back.
        fn sorted<'s, T>(
            pilots: Vec<Pilot<'s>>,
            is: impl Fn(&Pilot<'s>) -> bool,
            take: impl Fn(Pilot<'s>) -> Option<T>,
        ) -> Result<Vec<T>, Vec<Pilot<'s>>> {
            if pilots.iter().all(is) { Ok(pilots.into_iter().filter_map(take).collect()) } else { Err(pilots) }
        }
        macro_rules! try_kind {
            ($pilots:ident, $kind:ident) => {
                match sorted(
                    $pilots,
                    |pilot| matches!(pilot, Pilot::Controller(AnyController::$kind(_))),
                    |pilot| match pilot {
                        Pilot::Controller(AnyController::$kind(controller)) => Some(controller),
                        _ => None,
                    },
                ) {
                    Ok(all) => return Self::$kind(all.into()),
                    Err(pilots) => pilots,
                }
            };
        }
        let pilots = match sorted(
            pilots,
            |pilot| matches!(pilot, Pilot::Profile(_)),
            |pilot| match pilot {
                Pilot::Profile(profile) => Some(profile),
                Pilot::Controller(_) => None,
            },
        ) {
            Ok(all) => return Self::Profile(Leaders::new(all)),
            Err(pilots) => pilots,
        };
        let pilots = try_kind!(pilots, Baseline);
        let pilots = try_kind!(pilots, BaselineUnlatched);
        let pilots = try_kind!(pilots, MatchLeader);
        let pilots = try_kind!(pilots, ConstantBrake);
        let pilots = try_kind!(pilots, Idm);
        let pilots = try_kind!(pilots, AccAeb);
        let pilots = try_kind!(pilots, Policy);
        Self::Mixed(pilots)
    }

    /// Writes each run's command for a step into `commands`.
    ///
    /// `see` makes the observation of a run; it is called once for each, in order.
    #[inline]
    pub(super) fn command(
        &mut self,
        arch: Arch,
        span_s: [f64; 2],
        speeds_mps: &[f64],
        mut see: impl FnMut(usize) -> Observation,
        commands: &mut [f64],
    ) {
        match self {
            Self::Profile(leaders) => leaders.lead(arch, span_s, speeds_mps, commands),
            Self::Baseline(all) => act(all, see, commands),
            Self::BaselineUnlatched(all) => act(all, see, commands),
            Self::MatchLeader(all) => act(all, see, commands),
            Self::ConstantBrake(all) => act(all, see, commands),
            Self::Idm(followers) => {
                for (run, command) in commands.iter_mut().enumerate() {
                    *command = followers.model(run).act(&see(run));
                }
            }
            Self::AccAeb(all) => act(all, see, commands),
            Self::Policy(all) => PolicyDriver::act_together(all, see, commands),
            Self::Mixed(pilots) => {
                for (run, (command, pilot)) in commands.iter_mut().zip(pilots).enumerate() {
                    *command = match pilot {
                        Pilot::Profile(profile) => profile.acceleration_mps2(span_s[0], span_s[1], speeds_mps[run]),
                        Pilot::Controller(controller) => controller.act(&see(run)),
                    };
                }
            }
        }
    }

    /// The same if everybody sees the truth.
    pub(super) fn command_by_truth(&mut self, arch: Arch, span_s: [f64; 2], view: &View<'_>, commands: &mut [f64]) {
        match self {
            Self::Idm(followers) => followers.follow(arch, view, commands),
            _ => self.command(
                arch,
                span_s,
                view.own.speed_mps,
                #[inline(always)]
                |run| view.observation(run),
                commands,
            ),
        }
    }

    /// The driver of run `run`, if it may have a shield.
    pub(super) fn shielded(&self, run: usize) -> Option<&AnyController> {
        match self {
            Self::Mixed(pilots) => match pilots.get(run) {
                Some(Pilot::Controller(controller)) => Some(controller),
                _ => None,
            },
            _ => None,
        }
    }

    /// Forgets run `run`; the last one takes its place.
    pub(super) fn swap_remove(&mut self, run: usize) {
        match self {
            Self::Profile(leaders) => leaders.swap_remove(run),
            Self::Baseline(all) => drop(all.swap_remove(run)),
            Self::BaselineUnlatched(all) => drop(all.swap_remove(run)),
            Self::MatchLeader(all) => drop(all.swap_remove(run)),
            Self::ConstantBrake(all) => drop(all.swap_remove(run)),
            Self::Idm(followers) => followers.swap_remove(run),
            Self::AccAeb(all) => drop(all.swap_remove(run)),
            Self::Policy(all) => drop(all.swap_remove(run)),
            Self::Mixed(all) => drop(all.swap_remove(run)),
        }
    }
}

#[inline]
fn act<C: Controller>(controllers: &mut [C], mut see: impl FnMut(usize) -> Observation, commands: &mut [f64]) {
    for (run, (command, controller)) in commands.iter_mut().zip(controllers).enumerate() {
        *command = controller.act(&see(run));
    }
}
