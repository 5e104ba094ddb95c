//! Drivers of one vehicle position in all runs of a block.

use pulp::Arch;

use super::followers::Followers;
use super::leaders::ScriptedLeaders;
use super::view::NeighbourhoodView;
use crate::control::{
    self, AnyController, Controller, ControllerFailure, Override, PolicyDriver, with_controllers,
};
use crate::engine::run::VehicleController;
use crate::observation::Observation;
use crate::scenario::LeadProfile;

macro_rules! define {
    (rules { $($(#[$doc:meta])* $rule:ident,)* } policies { $($rest:tt)* }) => {
        pub(super) enum Drivers<'s> {
            Profile(ScriptedLeaders<'s>),
            /// The Intelligent Driver Model, in arrays for vector registers.
            Followers(Followers),
            $($(#[$doc])* $rule(Vec<control::$rule>),)*
            Policy(Vec<PolicyDriver>),
            /// Controllers that the engines do not know: networks, programs, shields, and those of users.
            Other(Vec<Box<dyn Controller>>),
            /// Drivers of several kinds.
            Mixed(Vec<VehicleController<&'s LeadProfile>>),
        }

        impl<'s> Drivers<'s> {
            pub(super) fn new(drivers: Vec<VehicleController<&'s LeadProfile>>) -> Self {
                /// Leaves the function with the drivers as one kind if all match the pattern. Otherwise evaluates to
                /// the unchanged drivers.
                macro_rules! unless_all {
                    ($drivers:ident, $pattern:pat => $driver:expr, $all:ident => $sorted:expr) => {
                        match all_of_kind(
                            $drivers,
                            #[allow(unused_variables)]
                            |driver| matches!(driver, $pattern),
                            |driver| match driver {
                                $pattern => Some($driver),
                                _ => None,
                            },
                        ) {
                            Ok($all) => return $sorted,
                            Err(drivers) => drivers,
                        }
                    };
                }
                use AnyController as Any;
                use VehicleController::{Controller as C, Profile as P};
                let drivers =
                    unless_all!(drivers, P(driver) => driver, all => Self::Profile(ScriptedLeaders::new(all)));
                let drivers = unless_all!(drivers, C(Any::Idm(driver)) => driver, all => Self::Followers(all.into()));
                $(let drivers = unless_all!(drivers, C(Any::$rule(driver)) => driver, all => Self::$rule(all));)*
                let drivers = unless_all!(drivers, C(Any::Policy(driver)) => driver, all => Self::Policy(all));
                let drivers = unless_all!(drivers, C(Any::Other(driver)) => driver, all => Self::Other(all));
                Self::Mixed(drivers)
            }

            /// Writes each run's command to `commands`, failures to `failed`. Calls `observe` once for each run, in
            /// order.
            #[inline]
            pub(super) fn command(
                &mut self,
                arch: Arch,
                span_s: [f64; 2],
                speeds_mps: &[f64],
                mut observe: impl FnMut(usize) -> Observation,
                commands: &mut [f64],
                failed: &mut Vec<(usize, ControllerFailure)>,
            ) {
                match self {
                    Self::Profile(leaders) => leaders.command(arch, span_s, speeds_mps, commands),
                    Self::Followers(followers) => {
                        for (run, command) in commands.iter_mut().enumerate() {
                            *command = followers.model(run).desired_acceleration_mps2(&observe(run));
                        }
                    }
                    $(Self::$rule(all) => Controller::decide_batch(all, observe, commands, failed),)*
                    Self::Policy(all) => Controller::decide_batch(all, observe, commands, failed),
                    Self::Other(all) => Controller::decide_batch(all, observe, commands, failed),
                    Self::Mixed(drivers) => {
                        for (run, (command, driver)) in commands.iter_mut().zip(drivers).enumerate() {
                            let observation = observe(run);
                            match driver {
                                VehicleController::Profile(profile) => {
                                    *command = profile.acceleration_mps2(span_s[0], span_s[1], speeds_mps[run]);
                                }
                                VehicleController::Controller(controller) => match controller.decide(&observation) {
                                    Ok(answer_mps2) => *command = answer_mps2,
                                    Err(failure) => failed.push((run, failure)),
                                },
                            }
                        }
                    }
                }
            }

            /// Shows the true state of each of `runs` runs to its driver, before it decides on an estimate. Inlined: a
            /// caller whose arrays have `runs` entries needs no bounds checks, and nothing remains of the loop for
            /// drivers that do not look.
            #[inline(always)]
            pub(super) fn perceive(&mut self, runs: usize, truth: impl Fn(usize) -> Observation) {
                match self {
                    Self::Profile(_) | Self::Followers(_) => {}
                    $(Self::$rule(all) => perceive_all(all, runs, truth),)*
                    Self::Policy(all) => perceive_all(all, runs, truth),
                    Self::Other(all) => perceive_all(all, runs, truth),
                    Self::Mixed(drivers) => {
                        for (run, driver) in drivers.iter_mut().enumerate().take(runs) {
                            if let VehicleController::Controller(controller) = driver {
                                controller.perceive(&truth(run));
                            }
                        }
                    }
                }
            }

            pub(super) fn swap_remove(&mut self, run: usize) {
                match self {
                    Self::Profile(leaders) => leaders.swap_remove(run),
                    Self::Followers(followers) => followers.swap_remove(run),
                    $(Self::$rule(all) => drop(all.swap_remove(run)),)*
                    Self::Policy(all) => drop(all.swap_remove(run)),
                    Self::Other(all) => drop(all.swap_remove(run)),
                    Self::Mixed(all) => drop(all.swap_remove(run)),
                }
            }
        }
    };
}
with_controllers!(define);

#[inline(always)]
fn perceive_all<C: Controller>(all: &mut [C], runs: usize, truth: impl Fn(usize) -> Observation) {
    for (run, controller) in all.iter_mut().enumerate().take(runs) {
        controller.perceive(&truth(run));
    }
}

fn all_of_kind<'s, T>(
    drivers: Vec<VehicleController<&'s LeadProfile>>,
    is: impl Fn(&VehicleController<&'s LeadProfile>) -> bool,
    take: impl Fn(VehicleController<&'s LeadProfile>) -> Option<T>,
) -> Result<Vec<T>, Vec<VehicleController<&'s LeadProfile>>> {
    if drivers.iter().all(is) {
        Ok(drivers.into_iter().filter_map(take).collect())
    } else {
        Err(drivers)
    }
}

impl Drivers<'_> {
    /// Computes the commands of a step if every driver observes the true state.
    pub(super) fn command_from_true_state(
        &mut self,
        arch: Arch,
        span_s: [f64; 2],
        view: &NeighbourhoodView<'_>,
        commands: &mut [f64],
        failed: &mut Vec<(usize, ControllerFailure)>,
    ) {
        match (&*self, &view.front) {
            (Self::Followers(followers), Some(front)) => {
                followers.command(arch, &view.own, front, commands)
            }
            _ => self.command(
                arch,
                span_s,
                view.own.speed_mps,
                #[inline(always)]
                |run| view.observation(run),
                commands,
                failed,
            ),
        }
    }

    /// Returns the periods in which a shield replaced the commands of a run.
    pub(super) fn overrides(&self, run: usize) -> &[Override] {
        match self {
            Self::Other(all) => all
                .get(run)
                .map_or(&[], |controller| controller.overrides()),
            Self::Mixed(drivers) => match drivers.get(run) {
                Some(VehicleController::Controller(controller)) => controller.overrides(),
                _ => &[],
            },
            _ => &[],
        }
    }
}
