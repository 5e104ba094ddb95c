//! Presets of fast trainings, with tiny networks and a checkpoint every ten episodes, and passages of texts.

/// Checks that a text contains some passages.
#[track_caller]
pub(crate) fn assert_contains(text: &str, passages: &[&str]) {
    for passage in passages {
        assert!(text.contains(passage), "{passage} is missing in: {text}");
    }
}

pub(crate) fn replace_passages(text: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    })
}

pub(crate) fn training() -> String {
    replace_passages(
        include_str!("../../crates/learn/src/rl/presets/fast.toml"),
        &[
            ("hidden = [64, 64, 64]", "hidden = [8, 8]"),
            ("batch = 128", "batch = 8"),
            (
                "learning_starts_episode = 20",
                "learning_starts_episode = 3",
            ),
            ("every_episodes = 5", "every_episodes = 1"),
            ("screening_draws = 60", "screening_draws = 2"),
            ("ranking_draws = 2000", "ranking_draws = 2"),
            ("master_gap_m = 1.0", "master_gap_m = 0.0"),
            // The untrained network does not brake, so an improvement comes soon.
            ("max_accel_mps2 = 3.0", "max_accel_mps2 = 7.5"),
        ],
    )
}

/// Returns the preset of `retrain`, with learning from the start.
pub(crate) fn retraining() -> String {
    replace_passages(
        include_str!("../../crates/learn/src/retrain/preset.toml"),
        &[
            ("hidden = [64, 64, 64]", "hidden = [8, 8]"),
            ("batch = 256", "batch = 8"),
            (
                "learning_starts_episode = 200",
                "learning_starts_episode = 3",
            ),
            ("every_episodes = 25", "every_episodes = 1"),
            ("screening_draws = 200", "screening_draws = 2"),
            ("ranking_draws = 1000", "ranking_draws = 6"),
        ],
    )
}

/// Reduces the replay memory, so that checkpoints are small.
pub(crate) fn with_small_memory(preset: &str) -> String {
    let capacity = preset
        .lines()
        .find(|line| line.starts_with("capacity = "))
        .expect("every preset has one");
    replace_passages(preset, &[(capacity, "capacity = 200")])
}
