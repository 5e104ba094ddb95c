//! Privileged information of a critic: scenario, the leader's next accelerations, cost multiplier.
//!
//! Only training needs critics. A privileged critic values an action by its result in the present scenario, not by the
//! mean over all scenarios with the same observation. The actor still learns from the mean of these values (asymmetric
//! actor-critic: Pinto, Andrychowicz, Welinder, Zaremba and Abbeel, 2018).

use super::config::PRIVILEGED_WIDTH;
use super::environment::TrainingEpisode;
use super::reward::FULL_BRAKE_MPS2;
use super::source::EGO;
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::{Driver, PAPER_STEP_S, Scenario};

/// Times ahead at which the leader's acceleration is known, in seconds.
const LOOKAHEAD_S: [f64; 2] = [1.0, 3.0];
/// Floor of the cost multiplier before log10.
const MIN_COST_MULTIPLIER: f64 = 0.01;

/// True if the follower holds its speed until its emergency brake fires: `baseline`. All other controllers react to
/// their leader.
pub(super) fn has_unaware_follower(scenario: &Scenario) -> bool {
    let behind = scenario.vehicles().get(EGO + 1);
    behind.is_some_and(|vehicle| {
        matches!(
            vehicle.driver,
            Driver::Controller(BuiltInController::Baseline(_))
        )
    })
}

/// Constants of an episode, and the scenario with the leader's script.
#[derive(Debug)]
pub(super) struct PrivilegedInfo<'s> {
    scenario: &'s Scenario,
    episode_constants: [f32; PRIVILEGED_WIDTH - LOOKAHEAD_S.len()],
}

impl<'s> PrivilegedInfo<'s> {
    pub(super) fn new(scenario: &'s Scenario, costs_times: f64) -> Self {
        let behind = scenario.vehicles().get(EGO + 1);
        let relative_brake = |index| scenario.usable_brake_mps2(index) / FULL_BRAKE_MPS2;
        let [has_follower, is_unaware] = [behind.is_some(), has_unaware_follower(scenario)]
            .map(|flag| f64::from(u8::from(flag)));
        let of_episode = [
            costs_times.max(MIN_COST_MULTIPLIER).log10(),
            scenario.spec().environment.friction,
            relative_brake(EGO - 1),
            relative_brake(EGO),
            behind.map_or(0.0, |_| relative_brake(EGO + 1)),
            behind.map_or(0.0, |vehicle| vehicle.reaction_delay_s),
            has_follower,
            is_unaware,
        ];
        Self {
            scenario,
            episode_constants: of_episode.map(|number| number as f32),
        }
    }

    /// Returns the inputs of the critic at the present step of an episode.
    pub(super) fn observe(&self, episode: &TrainingEpisode) -> [f32; PRIVILEGED_WIDTH] {
        let time_s = episode.steps_made() as f64 * PAPER_STEP_S;
        let leader = self.scenario.vehicles().iter().zip(episode.motion()).next();
        let [soon, later] = LOOKAHEAD_S.map(|ahead_s| {
            match leader.map(|(leader, now)| (&leader.driver, now.speed_mps)) {
                Some((Driver::Profile(script), speed_mps)) => {
                    (script.acceleration_mps2(time_s, time_s + ahead_s, speed_mps)
                        / FULL_BRAKE_MPS2) as f32
                }
                _ => 0.0,
            }
        });
        let [costs, friction, ahead, own, behind, delay, is_there, holds] = self.episode_constants;
        [
            costs, friction, ahead, own, behind, delay, is_there, holds, soon, later,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::{EpisodeConstants, TrainingConfig};
    use crumple_sim::engine::{Run, RunOptions};
    use crumple_sim::scenario::built_in_scenario;
    use crumple_spaces::built_in_space;

    #[test]
    fn a_critic_observes_road_drivers_and_future_leader_motion() {
        let config = TrainingConfig::preset("fast").unwrap().environment;
        // Speed 25 m/s, a leader that brakes at 3 m/s² from 1 s on, and a lorry that can brake at 6 m/s².
        let scenario = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| spec.environment.friction = 0.5)
            .unwrap();
        let run = Run::new(
            &scenario,
            RunOptions::new(BuiltInController::MatchLeader(Default::default())),
        )
        .unwrap();
        let mut episode = TrainingEpisode::new(&run, &EpisodeConstants::new(config.clone(), 0.99));
        let privileged = PrivilegedInfo::new(&scenario, 10.0);
        let expected = |soon: f64, later: f64| {
            [
                1.0,
                0.5,
                0.5,
                0.5,
                0.4,
                0.0,
                1.0,
                1.0,
                soon / 7.5,
                later / 7.5,
            ]
            .map(|number| number as f32)
        };
        assert_eq!(
            privileged.observe(&episode),
            expected(0.0, -3.0 * 2.0 / 3.0)
        );
        (0..5).for_each(|_| _ = episode.step(0.0));
        assert_eq!(
            privileged.observe(&episode),
            expected(-1.5, -3.0 * 2.5 / 3.0)
        );
        (0..5).for_each(|_| _ = episode.step(0.0));
        assert_eq!(privileged.observe(&episode), expected(-3.0, -3.0));
    }

    #[test]
    fn an_absent_follower_has_no_brake_no_delay_and_no_driver() {
        let scenario = built_in_space("alone").unwrap().draw(1, 2).unwrap();
        let [costs, .., behind, delay, is_there, holds] =
            PrivilegedInfo::new(&scenario, 0.0).episode_constants;
        assert_eq!(
            [costs, behind, delay, is_there, holds],
            [-2.0, 0.0, 0.0, 0.0, 0.0]
        );
        let followed = built_in_space("assisted").unwrap().draw(1, 2).unwrap();
        let [.., behind, _, is_there, holds] =
            PrivilegedInfo::new(&followed, 1.0).episode_constants;
        assert!(behind > 0.0);
        assert_eq!([is_there, holds], [1.0, 0.0]);
    }
}
