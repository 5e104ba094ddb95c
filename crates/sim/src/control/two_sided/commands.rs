//! Plans as lists of commands, for certificates.

use super::params::TwoSidedParams;
use super::state::{FollowerPhase, Plan, PlanShape, TwoSidedState};

/// Maximum number of steps after which a braking vehicle stands.
const MAX_STOP_STEPS: f64 = 20_000.0;

/// Commands of a plan, those that the actuator has not received yet first. Full braking follows.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanCommands {
    /// Phase of the follower at the first step.
    pub phase: FollowerPhase,
    /// Accelerations in m/s², each with its number of steps.
    pub commands: Vec<(usize, f64)>,
    /// Commands that replace the rest once the ego vehicle observes that the follower's brake has fired.
    pub after_firing: Option<CommandsAfterFiring>,
}

/// An acceleration, and full braking afterwards.
#[derive(Debug, Clone, PartialEq)]
pub struct CommandsAfterFiring {
    /// The acceleration, in m/s².
    pub accel_mps2: f64,
    /// Steps of the acceleration if the brake fires at step 1, 2 and so on: pairs of a number of such steps, and the
    /// steps of the acceleration. The last pair is valid for all later steps.
    pub steps: Vec<(usize, usize)>,
}

impl PlanCommands {
    /// Lists the commands of a plan from `state` on, after the pending ones. `firings` are the steps of acceleration
    /// after the firings that the test of the plan has computed, by step.
    pub(super) fn new(
        params: &TwoSidedParams,
        state: &TwoSidedState,
        pending_mps2: impl Iterator<Item = f64>,
        plan: Plan,
        firings: &[(usize, usize)],
    ) -> Self {
        let mut commands: Vec<(usize, f64)> = pending_mps2.map(|command| (1, command)).collect();
        let mut after_firing = None;
        match plan {
            Plan::Committed { accel_mps2, steps } => commands.push((steps, accel_mps2)),
            Plan::Waiting {
                shape,
                latest_steps,
                fixed_steps,
            } => {
                commands.extend(waiting_commands(params, state, shape, latest_steps));
                match fixed_steps {
                    Some(steps) => commands.push((steps, shape.accel_mps2)),
                    None => {
                        after_firing = Some(CommandsAfterFiring {
                            accel_mps2: shape.accel_mps2,
                            steps: steps_by_firing(firings),
                        });
                    }
                }
            }
        }
        commands.retain(|&(steps, _)| steps > 0);
        Self {
            phase: state
                .follower
                .map_or(FollowerPhase::Waiting, |follower| follower.phase),
            commands,
            after_firing,
        }
    }
}

/// Returns the commands of the first phase: until the latest firing, or until standstill.
fn waiting_commands(
    params: &TwoSidedParams,
    state: &TwoSidedState,
    shape: PlanShape,
    latest_steps: Option<usize>,
) -> [(usize, f64); 2] {
    let latest = latest_steps.unwrap_or_else(|| {
        let fastest_mps = state.speed_mps[1] + params.accel_mps2;
        let per_step_mps = (shape.brake_mps2 - params.noise_mps2) * params.step_s;
        (fastest_mps / per_step_mps + 2.0).clamp(0.0, MAX_STOP_STEPS) as usize
    });
    let brakes = shape.brake_steps.map_or(latest, |steps| steps.min(latest));
    [(brakes, -shape.brake_mps2), (latest - brakes, 0.0)]
}

/// Lists the steps of acceleration for each step of the firing, from 1 on.
fn steps_by_firing(firings: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    let mut listed = 0;
    for (index, &(_, steps)) in firings.iter().enumerate() {
        let until = firings
            .get(index + 1)
            .map_or(listed + 1, |(next, _)| next - 1);
        let count = until.saturating_sub(listed);
        listed = until.max(listed);
        match runs.last_mut() {
            Some((run, value)) if *value == steps => *run += count,
            _ if count > 0 => runs.push((count, steps)),
            _ => {}
        }
    }
    if runs.is_empty() {
        runs.push((1, 0));
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_after_a_firing_are_valid_until_the_next_one() {
        let runs = steps_by_firing(&[(5, 9), (6, 9), (7, 8), (9, 7), (9, 7)]);
        assert_eq!(runs, [(6, 9), (2, 8), (1, 7)]);
        assert_eq!(steps_by_firing(&[]), [(1, 0)]);
    }
}
