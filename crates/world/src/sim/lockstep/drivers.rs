//! The drivers of one vehicle position over all runs of a block.

use pulp::Arch;

use super::followers::Followers;
use super::leaders::Leaders;
use super::view::View;
use crate::control::{
    AccAeb, AnyController, Baseline, BaselineUnlatched, ConstantBrake, Controller, MatchLeader, PolicyDriver,
};
use crate::estimate::Observation;
use crate::sim::run::ActiveDriver;

/// One driver a run, sorted out by kind so that a whole block is driven by one loop without dispatch inside it.
pub(super) enum Drivers<'s> {
    Profile(Leaders<'s>),
    Baseline(Vec<Baseline>),
    BaselineUnlatched(Vec<BaselineUnlatched>),
    MatchLeader(Vec<MatchLeader>),
    ConstantBrake(Vec<ConstantBrake>),
    Idm(Followers),
    AccAeb(Vec<AccAeb>),
    Policy(Vec<PolicyDriver>),
    /// Drivers of several kinds, or from outside.
    Mixed(Vec<ActiveDriver<'s>>),
}

impl<'s> Drivers<'s> {
    pub(super) fn new(drivers: Vec<ActiveDriver<'s>>) -> Self {
        /// All of one kind, or everybody back.
        fn sorted<'s, T>(
            drivers: Vec<ActiveDriver<'s>>,
            is: impl Fn(&ActiveDriver<'s>) -> bool,
            take: impl Fn(ActiveDriver<'s>) -> Option<T>,
        ) -> Result<Vec<T>, Vec<ActiveDriver<'s>>> {
            if drivers.iter().all(is) { Ok(drivers.into_iter().filter_map(take).collect()) } else { Err(drivers) }
        }
        macro_rules! try_kind {
            ($drivers:ident, $kind:ident) => {
                match sorted(
                    $drivers,
                    |driver| matches!(driver, ActiveDriver::Controller(AnyController::$kind(_))),
                    |driver| match driver {
                        ActiveDriver::Controller(AnyController::$kind(controller)) => Some(controller),
                        _ => None,
                    },
                ) {
                    Ok(all) => return Self::$kind(all.into()),
                    Err(drivers) => drivers,
                }
            };
        }
        let drivers = match sorted(
            drivers,
            |driver| matches!(driver, ActiveDriver::Profile(_)),
            |driver| match driver {
                ActiveDriver::Profile(profile) => Some(profile),
                ActiveDriver::Controller(_) => None,
            },
        ) {
            Ok(all) => return Self::Profile(Leaders::new(all)),
            Err(drivers) => drivers,
        };
        let drivers = try_kind!(drivers, Baseline);
        let drivers = try_kind!(drivers, BaselineUnlatched);
        let drivers = try_kind!(drivers, MatchLeader);
        let drivers = try_kind!(drivers, ConstantBrake);
        let drivers = try_kind!(drivers, Idm);
        let drivers = try_kind!(drivers, AccAeb);
        let drivers = try_kind!(drivers, Policy);
        Self::Mixed(drivers)
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
            Self::Mixed(drivers) => {
                for (run, (command, driver)) in commands.iter_mut().zip(drivers).enumerate() {
                    *command = match driver {
                        ActiveDriver::Profile(profile) => {
                            profile.acceleration_mps2(span_s[0], span_s[1], speeds_mps[run])
                        }
                        ActiveDriver::Controller(controller) => controller.act(&see(run)),
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
            Self::Mixed(drivers) => match drivers.get(run) {
                Some(ActiveDriver::Controller(controller)) => Some(controller),
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
