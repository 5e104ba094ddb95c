use super::*;

#[test]
fn steps_become_smaller_from_the_end_of_the_random_episodes_on() {
    let fall = LrDecay {
        until_episode: 300,
        final_factor: 0.2,
    };
    for (episode, share) in [
        (0, 1.0),
        (100, 1.0),
        (150, 0.8),
        (200, 0.6),
        (300, 0.2),
        (9000, 0.2),
    ] {
        assert!(
            (fall.factor(episode, 100) - share).abs() < 1e-12,
            "{episode}"
        );
    }
    assert_eq!(
        LrDecay {
            until_episode: 50,
            final_factor: 0.5
        }
        .factor(101, 100),
        0.5
    );
}

#[test]
fn presets_have_no_old_names() {
    for (name, text) in PRESETS {
        assert_eq!(old_names::TRAINING.find(text), [], "{name}");
    }
}

#[test]
fn the_paper_preset_is_the_papers() {
    let paper = TrainingConfig::preset("paper").unwrap();
    assert_eq!(paper.network.hidden, [256; 3]);
    let LearningConfig {
        actor_rate,
        critic_rate,
        discount,
        tau,
        batch,
        ..
    } = paper.learning;
    assert_eq!(
        (actor_rate, critic_rate, discount, tau, batch),
        (0.001, 0.002, 0.99999, 0.005, 512)
    );
    assert_eq!(
        (paper.replay.capacity, paper.exploration.noise_decay),
        (10_000, 0.9995)
    );
    assert_eq!(
        (
            paper.environment.step_reward,
            paper.environment.collision_reward
        ),
        (15.0, -3000.0)
    );
    assert_eq!(
        (
            paper.environment.action_repeat,
            paper.environment.reward_scale
        ),
        (1, 1.0)
    );
}
