//! Trainings that are interrupted, diverge, or run in parallel, and the policy of one of them.

use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

use crate::rl::*;
use crumple_core::observer::{Listener, Quiet};
use crumple_sim::scenario::built_in_scenario;
use crumple_store::program::{OTHER_BUILD_MESSAGE, identity};
use crumple_store::study::Study;

/// Returns a training that takes a second.
fn small_config() -> TrainingConfig {
    let mut config = TrainingConfig::preset("fast").unwrap();
    config.network.hidden = vec![16, 16];
    config.learning.batch = 16;
    (config.episodes, config.exploration.learning_starts_episode) = (12, 4);
    config.td3 = Td3Config {
        twin_critic: true,
        actor_every: 2,
        target_noise: 0.1,
        target_noise_limit: 0.2,
    };
    config.replay = ReplayConfig {
        capacity: 600,
        collision_fraction: 0.1,
    };
    config.evaluation.master_gap_m = 0.0;
    (
        config.evaluation.every_episodes,
        config.evaluation.screening_draws,
        config.evaluation.ranking_draws,
    ) = (3, 4, 4);
    config
}

#[test]
fn a_resumed_training_equals_one_that_was_never_interrupted() {
    let mut config = small_config();
    // Optional state of a training: history, mean of weights, privileged critics, decay of the learning rates.
    (
        config.environment.observation.history,
        config.environment.observation.history_every,
    ) = (3, 2);
    config.evaluation.weight_average_updates = 40;
    config.learning.privileged_critic = true;
    config.learning.lr_decay = Some(LrDecay {
        until_episode: 10,
        final_factor: 0.2,
    });
    let held_out = EvaluationSet::new(&config.evaluation, &config.environment);
    let mut through = Trainer::new(&config, 8);
    let diary = Mutex::new(Vec::new());
    train(
        &mut through,
        &held_out,
        &Listener(|event: &TrainingEvent| diary.lock().unwrap().push(*event)),
    )
    .unwrap();
    let diary = diary.into_inner().unwrap();
    for stop in [2, 5, 9] {
        let mut first = Trainer::new(
            &TrainingConfig {
                episodes: stop,
                ..config.clone()
            },
            8,
        );
        let result = first.evaluate(&held_out).unwrap();
        let mut events = vec![TrainingEvent::Evaluation {
            episode: 0,
            best: true,
            result,
        }];
        while first.episode() < stop {
            events.push(TrainingEvent::Episode(first.run_episode().unwrap()));
            if first.episode() > 4 && first.episode().is_multiple_of(3) {
                first.evaluate(&held_out).unwrap();
            }
        }
        let bytes = first.to_checkpoint().unwrap();
        let mut second =
            Trainer::from_checkpoint(&bytes, &config, 8, Arc::new(PaperSource)).unwrap();
        let events = Mutex::new(events);
        train(
            &mut second,
            &held_out,
            &Listener(|event: &TrainingEvent| events.lock().unwrap().push(*event)),
        )
        .unwrap();
        let events = events.into_inner().unwrap();
        assert!(
            second.to_checkpoint().unwrap() == through.to_checkpoint().unwrap(),
            "stopped after {stop}"
        );
        assert!(
            second.policy().unwrap() == through.policy().unwrap(),
            "stopped after {stop}"
        );
        assert_eq!(
            diary[0], events[0],
            "the untrained policy is evaluated first"
        );
        assert!(
            diary.ends_with(&events[1 + stop as usize..]),
            "stopped after {stop}"
        );
    }
}

/// Imitation fits the expert's answers, is followed by reinforcement learning, and survives an interruption.
#[test]
fn an_imitation_learns_the_experts_answers() {
    let imitation = include_str!("imitation.toml")
        .split_once("[imitation]")
        .unwrap()
        .1;
    let mut config = small_config();
    config.exploration.learning_starts_episode = 2;
    let mut imitation: ImitationConfig = toml::from_str(imitation).unwrap();
    // Its answer is an input of the network, and it avoids collisions in the paper's scenarios.
    (imitation.expert, imitation.expert_if_unaware) = ("match-leader".to_owned(), None);
    (imitation.expert_estimator, imitation.passes) = (config.environment.estimator, 40);
    config.imitation = Some(imitation);
    let held_out = EvaluationSet::new(&config.evaluation, &config.environment);
    let run = |threads| {
        let mut trainer = Trainer::new(&config, 4);
        let events = Mutex::new(Vec::new());
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            train(
                &mut trainer,
                &held_out,
                &Listener(|event: &TrainingEvent| events.lock().unwrap().push(*event)),
            )
        })
        .unwrap();
        (trainer, events.into_inner().unwrap())
    };
    let (trainer, events) = run(1);
    let rounds = events.iter().map_while(|event| match event {
        TrainingEvent::Imitation(round) => Some((round.round, round.rows)),
        _ => None,
    });
    assert_eq!(rounds.collect::<Vec<_>>(), [(1, 3000), (2, 6000)]);
    let Some(TrainingEvent::Imitation(last)) = events.get(1) else {
        panic!("{events:?}")
    };
    // Actions are shares of half the range of 10.5 m/s²: the root mean square of the difference is 0.2 m/s².
    assert!(last.loss < 0.0015, "{last:?}");
    let first = events.iter().find_map(|event| match event {
        TrainingEvent::Evaluation { result, .. } => Some(result.safe_share),
        _ => None,
    });
    assert_eq!(
        first,
        Some(1.0),
        "the imitation is safe before reinforcement learning"
    );
    let (other, _) = run(3);
    assert!(
        other.to_checkpoint().unwrap() == trainer.to_checkpoint().unwrap(),
        "on three threads"
    );
    let stopped = Trainer::new(&config, 4).to_checkpoint().unwrap();
    let mut resumed =
        Trainer::from_checkpoint(&stopped, &config, 4, Arc::new(PaperSource)).unwrap();
    train(&mut resumed, &held_out, &Quiet).unwrap();
    assert!(resumed.policy().unwrap() == trainer.policy().unwrap());
    // A retraining continues from the weights that it starts from.
    let policy = trainer.policy().unwrap();
    let imitation = config.imitation.as_mut().unwrap();
    (imitation.passes, imitation.rate) = (1, 0.0);
    let mut retrained = Trainer::new(&config, 5).with_initial_policy(&policy);
    let check = |round: &ImitationRound| -> Result<(), TrainingError> {
        assert!(round.loss < 0.005, "{round:?}");
        Ok(())
    };
    retrained.imitate(check).unwrap();
    assert!(
        retrained.policy().unwrap().network() == policy.network(),
        "a rate of 0 changes nothing"
    );
    // Where costs count more than once, the policy replaces the expert.
    config.spaces = vec![TrainingSpace {
        space: "traffic".to_owned(),
        weight: 1.0,
        cost_multiplier: 2.0,
        uniform_share: 0.0,
    }];
    let everyday = config.scenario_source().unwrap();
    let check = |round: &ImitationRound| -> Result<(), TrainingError> {
        assert!(round.loss < 1e-9, "{round:?}");
        Ok(())
    };
    Trainer::with_source(&config, 5, everyday)
        .with_initial_policy(&policy)
        .imitate(check)
        .unwrap();
}

/// A training that begins with an imitation may be made longer, also if it had no episode.
#[test]
fn an_imitation_that_is_made_longer_is_repeated() {
    let imitation = include_str!("imitation.toml")
        .split_once("[imitation]")
        .unwrap()
        .1;
    let mut imitation: ImitationConfig = toml::from_str(imitation).unwrap();
    (imitation.rows, imitation.passes) = (300, 2);
    let mut config = small_config();
    config.imitation = Some(imitation);
    let held_out = EvaluationSet::new(&config.evaluation, &config.environment);
    let [whole, parts] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let train = |folder: &Path, episodes| {
        let config = TrainingConfig {
            episodes,
            ..config.clone()
        };
        let training = SeedTraining {
            config: &config,
            seed: 3,
            held_out: &held_out,
        };
        training.run(folder, true, &Quiet).unwrap()
    };
    let expected = train(whole.path(), 2);
    for episodes in [0, 1] {
        train(parts.path(), episodes);
    }
    assert_eq!(train(parts.path(), 2), expected);
    let log = |folder: &Path| fs::read(folder.join("log.jsonl")).unwrap();
    assert!(log(parts.path()) == log(whole.path()));
}

#[test]
fn checkpoints_of_another_training_are_refused() {
    let config = small_config();
    let bytes = Trainer::new(&config, 1).to_checkpoint().unwrap();
    assert!(Trainer::from_checkpoint(&bytes, &config, 1, Arc::new(PaperSource)).is_ok());
    let mut other = config.clone();
    other.learning.batch = 17;
    for (config, seed) in [(&config, 2), (&other, 1)] {
        let refused = Trainer::from_checkpoint(&bytes, config, seed, Arc::new(PaperSource));
        assert!(matches!(refused, Err(TrainingError::Checkpoint(_))));
    }
    assert!(
        Trainer::from_checkpoint(&bytes[..bytes.len() / 2], &config, 1, Arc::new(PaperSource))
            .is_err()
    );
    let says = |bytes: &[u8], words: &str| {
        let error = Trainer::from_checkpoint(bytes, &config, 1, Arc::new(PaperSource))
            .err()
            .unwrap()
            .to_string();
        assert!(error.contains(words), "{error}");
    };
    // Any byte of the arrays, and numbers of the header on which no array depends.
    for index in [bytes.len() - 1, bytes.len() / 2] {
        let mut changed = bytes.clone();
        changed[index] ^= 1;
        says(&changed, "does not match its SHA-256");
    }
    let edited = |from: &str, to: &str| {
        let offset = bytes
            .windows(from.len())
            .position(|window| window == from.as_bytes())
            .unwrap();
        [
            &bytes[..offset],
            to.as_bytes(),
            &bytes[offset + from.len()..],
        ]
        .concat()
    };
    says(
        &edited(r#"\"decisions\":0"#, r#"\"decisions\":7"#),
        "does not match its SHA-256",
    );
    says(
        &edited(r#"\"version\":3"#, r#"\"version\":1"#),
        OTHER_BUILD_MESSAGE,
    );
    let program = identity().unwrap();
    says(
        &edited(program, &program.replace(char::is_alphabetic, "0")),
        OTHER_BUILD_MESSAGE,
    );
}

#[test]
fn trainings_on_different_scenarios_are_distinguished() {
    let config = small_config();
    let source = |name| -> Arc<dyn ScenarioSource> {
        Arc::new(CaseMixture::new(
            vec![built_in_scenario(name).unwrap()],
            0.5,
            Arc::new(PaperSource),
        ))
    };
    let mut trainer = Trainer::with_source(&config, 1, source("paper-1"));
    trainer.run_episode().unwrap();
    assert!(
        trainer.policy().unwrap().header().training["scenarios"]
            .as_str()
            .unwrap()
            .contains("0.5 of 1 cases")
    );
    let bytes = trainer.to_checkpoint().unwrap();
    assert!(Trainer::from_checkpoint(&bytes, &config, 1, source("paper-1")).is_ok());
    for other in [source("paper-2"), Arc::new(PaperSource)] {
        let refused = Trainer::from_checkpoint(&bytes, &config, 1, other);
        assert!(
            refused
                .err()
                .unwrap()
                .to_string()
                .contains("it belongs to a training on a share of 0.5")
        );
    }
    let mut unsuited = Trainer::with_source(&config, 1, source("paper-3"));
    let error = (0..12).find_map(|_| unsuited.run_episode().err()).unwrap();
    assert!(
        error.to_string().contains("`paper-3` cannot be trained on"),
        "{error}"
    );
}

#[test]
fn a_random_action_is_held_and_then_more_episodes_end_in_collision() {
    let collisions = |hold| {
        let mut config = TrainingConfig::preset("paper").unwrap();
        config.network.hidden = vec![4];
        config.exploration.random_hold_steps = hold;
        let mut trainer = Trainer::new(&config, 3);
        (0..20)
            .filter(|_| trainer.run_episode().unwrap().ending == EpisodeEnding::Collision)
            .count()
    };
    let (each_step, each_second) = (collisions(1), collisions(100));
    assert!(
        each_step <= 5 && each_second >= 12,
        "{each_step} {each_second} of 20"
    );
}

#[test]
fn without_ranking_draws_nothing_is_mastered() {
    let mut config = TrainingConfig::preset("fast").unwrap();
    config.evaluation.screening_draws = 4;
    let master_gap_m = config.evaluation.master_gap_m;
    for (ranking_draws, collisions) in [(4, Some(0)), (0, None)] {
        config.evaluation.ranking_draws = ranking_draws;
        let held_out = EvaluationSet::new(&config.evaluation, &config.environment);
        let evaluation = held_out
            .evaluate(&crumple_sim::policy::Policy::reference())
            .unwrap();
        assert_eq!(
            (
                evaluation.ranking_collisions,
                evaluation.is_mastered(master_gap_m)
            ),
            (collisions, collisions.is_some())
        );
    }
}

#[test]
fn a_seed_gives_the_same_policy_with_any_number_of_threads() {
    let config = TrainingConfig {
        episodes: 8,
        ..small_config()
    };
    let held_out = EvaluationSet::new(&config.evaluation, &config.environment);
    let policies = |threads| {
        parallel_map(&[1, 2, 3], threads, |&seed| {
            let mut trainer = Trainer::new(&config, seed);
            train(&mut trainer, &held_out, &Quiet).unwrap();
            trainer.policy().unwrap().to_bytes().unwrap()
        })
    };
    let alone = policies(1);
    assert!(alone == policies(3));
    assert!(alone[0] != alone[1]);
}

#[test]
fn divergence_stops_with_a_message() {
    for factor in [f32::NAN, 1e6] {
        let mut trainer = Trainer::new(&small_config(), 1);
        for parameter in trainer.learner.critics[0].network.parameters_mut() {
            *parameter *= factor;
        }
        let error = loop {
            if let Err(error) = trainer.run_episode() {
                break error;
            }
            assert!(trainer.episode() < 12, "nothing was noticed");
        };
        assert!(
            error.to_string().contains("seed 1 diverged in episode"),
            "{error}"
        );
    }
}

/// The limit of divergence follows the costs of the source, not of spaces that a configuration only names.
#[test]
fn divergence_is_detected_on_the_training_scenarios() {
    let mut config = small_config();
    config.environment.costs = TrainingConfig::preset("road").unwrap().environment.costs;
    config.environment.costs.far = 1.0;
    config.spaces = vec![TrainingSpace {
        space: "traffic".to_owned(),
        weight: 1.0,
        cost_multiplier: 500.0,
        uniform_share: 0.0,
    }];
    let largest = |source: Arc<dyn ScenarioSource>| {
        let mut trainer = Trainer::with_source(&config, 1, source);
        trainer.learner.critics[0]
            .network
            .parameters_mut()
            .fill(f32::NAN);
        match (0..12).find_map(|_| trainer.run_episode().err()) {
            Some(TrainingError::Diverged { largest_value, .. }) => largest_value,
            other => panic!("{other:?}"),
        }
    };
    let spaces = config.scenario_source().unwrap();
    let (of_paper, of_spaces) = (largest(Arc::new(PaperSource)), largest(Arc::clone(&spaces)));
    assert!(
        (of_spaces / of_paper - 500.0).abs() < 1e-6,
        "{of_paper} {of_spaces}"
    );
    let mixed = CaseMixture::new(
        Vec::new(),
        0.5,
        Arc::new(SourceMixture::new(Arc::new(PaperSource), 0.5, spaces)),
    );
    assert_eq!(largest(Arc::new(mixed)), of_spaces);
}

#[test]
fn the_reference_policy_survives_the_papers_scenarios_and_unseen_draws() {
    use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunOptions, simulate_batch};
    use crumple_sim::observation::EstimatorKind;
    use crumple_sim::policy::Policy;
    use crumple_sim::scenario::{PaperDistribution, Scenario};

    let policy = Policy::reference();
    let fast = TrainingConfig::preset("fast").unwrap();
    assert_eq!(
        policy.header().training,
        fast.to_header_value().unwrap(),
        "the committed preset reproduces the committed policy"
    );
    let collisions = |scenarios: &[Scenario], estimator| {
        let options = RunOptions::new(Arc::clone(&policy)).with_estimator(estimator);
        let runs: Vec<_> = scenarios
            .iter()
            .map(|s| Run::new(s, options.clone()).unwrap())
            .collect();
        let safe = simulate_batch(&runs, RecordingLevel::Summary, |_, result| {
            result.outcome == Outcome::NoCollision
        });
        safe.into_iter().filter(|safe| !safe).count()
    };
    let paper: Vec<_> = ["paper-1", "paper-2", "paper-3"]
        .map(|name| built_in_scenario(name).unwrap())
        .into();
    for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
        assert_eq!(collisions(&paper, estimator), 0, "{estimator:?}");
    }
    let draws: Vec<_> = (0..1000)
        .map(|index| PaperDistribution { seed: 1 }.draw(index).unwrap())
        .collect();
    assert!(collisions(&draws, EstimatorKind::Kalman) <= 1);
}
