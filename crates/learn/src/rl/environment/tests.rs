use super::*;
use crate::rl::TrainingConfig;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::RunOptions;
use crumple_sim::scenario::{Driver, LeadProfile, built_in_scenario};

/// Simulates paper-2 with a constant action; returns the total reward and all outcomes.
fn drive_paper_2(config: &EnvironmentConfig, action: f32) -> (f64, Vec<StepOutcome>) {
    let scenario = built_in_scenario("paper-2").unwrap();
    let run = Run::new(
        &scenario,
        RunOptions::new(BuiltInController::MatchLeader(Default::default())),
    )
    .unwrap();
    let mut episode = TrainingEpisode::new(&run, &EpisodeConstants::new(config.clone(), 0.99));
    let mut all = vec![episode.step(action)];
    while all.last().unwrap().ending == EpisodeEnding::None {
        all.push(episode.step(action));
    }
    (episode.total_reward(), all)
}

fn config() -> EnvironmentConfig {
    TrainingConfig::preset("fast").unwrap().environment
}

#[test]
fn a_safe_episode_returns_22_500_and_credits_standstill() {
    // At -2.9 m/s² the ego vehicle, and then its follower by emergency braking, stops without a collision.
    let action = (-2.9 + 2.25) / 5.25;
    let (total, all) = drive_paper_2(&config(), action as f32);
    let last = all.last().unwrap();
    assert_eq!(
        (last.ending, last.continues, total),
        (EpisodeEnding::AtRest, false, 22_500.0)
    );
    assert!(all.len() < 150, "ended early");
    assert!(
        (f64::from(last.reward) - (1.0 + 0.99 * 100.0)).abs() < 1.0,
        "{}",
        last.reward
    );
    let end = EnvironmentConfig {
        time_limit: TimeLimit::Termination,
        ..config()
    };
    let left = 150.0 - all.len() as f64;
    let credit = f64::from(drive_paper_2(&end, action as f32).1.last().unwrap().reward);
    assert!(
        (credit - (1.0 - 0.99_f64.powf(left + 1.0)) / 0.01).abs() < 1.0,
        "{credit}"
    );
}

#[test]
fn a_collision_costs_its_harm_in_addition() {
    let with = |harm_reward: f64| {
        drive_paper_2(
            &EnvironmentConfig {
                harm_reward,
                ..config()
            },
            1.0,
        )
        .0
    };
    let cost = with(0.0) - with(-1000.0);
    assert!(cost > 0.3 && cost < 2000.0, "{cost}");
    assert!((with(0.0) - with(-2000.0) - 2.0 * cost).abs() < 1e-6);
}

#[test]
fn a_collision_costs_3000_and_ends_the_episode() {
    let (total, all) = drive_paper_2(&config(), 1.0);
    let last = all.last().unwrap();
    assert_eq!(
        (last.ending, last.continues),
        (EpisodeEnding::Collision, false)
    );
    assert_eq!((total + 3000.0) % 15.0, 0.0);
    assert!(last.reward < -19.0 && all[0].reward == 1.0);
}

#[test]
fn the_time_limit_is_terminal_only_if_configured() {
    // At 0 m/s² behind a leader of constant speed no vehicle stops.
    let scenario = built_in_scenario("paper-2").unwrap();
    let hold = Driver::Profile(LeadProfile::ConstantSpeed);
    let scenario = scenario
        .edited(|spec| spec.vehicles[0].driver = hold)
        .unwrap();
    let run = Run::new(
        &scenario,
        RunOptions::new(BuiltInController::MatchLeader(Default::default())),
    )
    .unwrap();
    for (time_limit, continues) in [
        (TimeLimit::Truncation, true),
        (TimeLimit::Termination, false),
    ] {
        let config = EnvironmentConfig {
            time_limit,
            ..config()
        };
        let mut episode = TrainingEpisode::new(&run, &EpisodeConstants::new(config.clone(), 0.99));
        let last = (0..150)
            .map(|_| episode.step((2.25 / 5.25) as f32))
            .last()
            .unwrap();
        assert_eq!(
            (last.ending, last.continues),
            (EpisodeEnding::TimeLimit, continues)
        );
    }
}
