//! Every kind of resumable run folder is damaged: files are flipped, cut, emptied, removed and swapped. The folder is
//! then refused with the file's name, or the work ends with the same bytes.

use std::collections::BTreeMap;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::tiny;
use crumple_core::observer::Listener;
use crumple_evidence::rare::{RarePlan, RareProgress, SplittingConfig};
use crumple_evidence::{CountProgress, RateConfig, RatePlan};
use crumple_learn::retrain::{RetrainingPlan, RetrainingProgress, RetrainingSettings};
use crumple_learn::rl::{EvaluationSet, SeedTraining, TrainingConfig, TrainingEvent, seed_folder};
use crumple_measure::Specification;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignProgress};
use crumple_sim::control::BuiltInController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::built_in_scenario;
use crumple_spaces::built_in_space;
use crumple_store::study::Study;
use tempfile::TempDir;

/// Changed positions per file, one at a time, unless the variable `FLIPS` overrides it.
const DEFAULT_FLIPS: usize = 8;

/// Resumable work: runs in a folder with a seed, or resumes, and reports progress by a callback.
type ResumableWork = fn(&Path, u64, &(dyn Fn() + Sync)) -> Result<(), String>;

fn campaign(folder: &Path, seed: u64, tick: &(dyn Fn() + Sync)) -> Result<(), String> {
    let campaign = Campaign {
        estimator: EstimatorKind::Truth,
        seed,
        ..Campaign::new(
            BuiltInController::from_name("baseline").unwrap(),
            built_in_space("paper").unwrap(),
        )
        .with_method(Method::Uniform)
        .with_budget(60)
    };
    campaign
        .run(folder, true, &Listener(|_: &CampaignProgress| tick()))
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn count(folder: &Path, seed: u64, tick: &(dyn Fn() + Sync)) -> Result<(), String> {
    let plan = RatePlan::new(RateConfig {
        seed,
        estimator: EstimatorKind::Truth,
        confidence: 0.9,
        ..RateConfig::new(
            BuiltInController::from_name("idm").unwrap(),
            built_in_space("paper").unwrap(),
            300,
        )
    });
    let plan = plan.unwrap();
    plan.run(folder, true, &Listener(|_: &CountProgress| tick()))
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn estimate(folder: &Path, seed: u64, tick: &(dyn Fn() + Sync)) -> Result<(), String> {
    let plan = RarePlan {
        controller: BuiltInController::from_name("match-leader").unwrap().into(),
        space: built_in_space("paper").unwrap(),
        estimator: EstimatorKind::Truth,
        specification: Specification::NoCollision,
        seed,
        effort: SplittingConfig {
            samples: 50,
            repetition_count: 5,
        },
        resamples: 0,
    };
    plan.run(folder, true, &Listener(|_: &RareProgress| tick()))
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn training(folder: &Path, seed: u64, tick: &(dyn Fn() + Sync)) -> Result<(), String> {
    let mut config = TrainingConfig::parse(
        &tiny::with_small_memory(&tiny::training()),
        Path::new("tiny"),
    )
    .unwrap();
    config.episodes = 33;
    let training = SeedTraining {
        config: &config,
        seed,
        held_out: &EvaluationSet::new(&config.evaluation, &config.environment),
    };
    let observer = Listener(|_: &TrainingEvent| tick());
    training
        .run(&seed_folder(folder, seed), true, &observer)
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn retraining(folder: &Path, seed: u64, tick: &(dyn Fn() + Sync)) -> Result<(), String> {
    let plan = RetrainingPlan {
        initial_policy: Policy::reference(),
        initial_policy_name: "policy".to_owned(),
        // Collisions in this space are quickly shown to be avoidable.
        spaces: built_in_space("paper").unwrap().into(),
        attacked: vec![built_in_scenario("paper-1").unwrap()],
        regression_spaces: vec![built_in_space("traffic").unwrap()],
        training: TrainingConfig::parse(
            &tiny::with_small_memory(&tiny::retraining()),
            Path::new("tiny"),
        )
        .unwrap(),
        method: Method::Uniform,
        seed,
        settings: RetrainingSettings {
            rounds: 2,
            episodes: 22,
            budget: 5,
            draws: 5,
            validation_draws: 3,
            nominal: 3,
            regression: 3,
            test_draws: 3,
            ..RetrainingSettings::DEFAULT
        },
    };
    plan.run(folder, true, &Listener(|_: &RetrainingProgress| tick()))
        .map(|_| ())
        .map_err(|error| error.to_string())
}

/// Creates a folder, in memory if possible, since thousands of resumptions need no disk.
pub(crate) fn scratch_folder() -> TempDir {
    tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap()
}

/// Reads all files below a folder.
pub(crate) fn read_tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let (mut found, mut folders) = (BTreeMap::new(), vec![folder.to_owned()]);
    while let Some(next) = folders.pop() {
        for path in fs::read_dir(&next)
            .unwrap()
            .map(|entry| entry.unwrap().path())
        {
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path
                    .strip_prefix(folder)
                    .unwrap()
                    .to_str()
                    .unwrap()
                    .to_owned();
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Reads all files below a folder but the locks.
pub(crate) fn read_files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    read_tree(folder)
        .into_iter()
        .filter(|(name, _)| !name.ends_with("work.lock"))
        .collect()
}

fn write_files(folder: &Path, files: &BTreeMap<String, Vec<u8>>) {
    for (name, bytes) in files {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

fn files_after_stop(
    work: ResumableWork,
    seed: u64,
    stop: Option<usize>,
) -> BTreeMap<String, Vec<u8>> {
    let (folder, ticks) = (scratch_folder(), AtomicUsize::new(0));
    let tick = || {
        if stop == Some(ticks.fetch_add(1, Ordering::SeqCst) + 1) {
            resume_unwind(Box::new("stopped"));
        }
    };
    let ended = catch_unwind(AssertUnwindSafe(|| work(folder.path(), seed, &tick)));
    assert_eq!(
        ended.is_err(),
        stop.is_some(),
        "stopped at {stop:?} of {ticks:?} ticks"
    );
    let name = |name: String| name.replace(&format!("seed-{seed}"), "seed-1");
    read_files(folder.path())
        .into_iter()
        .map(|(path, bytes)| (name(path), bytes))
        .collect()
}

fn damaged_variants<'a>(
    bytes: &'a [u8],
    other: Option<&'a Vec<u8>>,
) -> impl Iterator<Item = (String, Option<Vec<u8>>)> + 'a {
    let flips = std::env::var("FLIPS")
        .ok()
        .and_then(|flips| flips.parse().ok())
        .unwrap_or(DEFAULT_FLIPS);
    let flipped = (0..flips.min(8 * bytes.len())).map(move |flip| {
        let bit = flip * (8 * bytes.len() - 1) / (flips - 1).max(1);
        let mut bytes = bytes.to_vec();
        bytes[bit / 8] ^= 1 << (bit % 8);
        (format!("bit {bit} flipped"), Some(bytes))
    });
    let cut = [bytes.len() / 2, bytes.len().saturating_sub(1), 0]
        .map(|to| (format!("cut to {to}"), Some(bytes[..to].to_vec())));
    let swapped = other.map(|other| ("swapped with another run's".to_owned(), Some(other.clone())));
    flipped
        .chain(cut)
        .chain([("lost".to_owned(), None)])
        .chain(swapped)
}

/// Damages each file of begun or complete work in every way. Returns the number of refused changes.
fn count_refused_damage(work: ResumableWork, stop: Option<usize>) -> usize {
    let genuine = files_after_stop(work, 1, None);
    let (begun, other) = (
        files_after_stop(work, 1, stop),
        files_after_stop(work, 2, stop),
    );
    let (mut refused, mut same) = (0, 0);
    let folder = scratch_folder();
    write_files(folder.path(), &begun);
    for (name, bytes) in &begun {
        let path = folder.path().join(name);
        for (what, damaged) in damaged_variants(bytes, other.get(name)) {
            match damaged {
                Some(damaged) if damaged == *bytes => continue,
                Some(damaged) => fs::write(&path, damaged).unwrap(),
                None => fs::remove_file(&path).unwrap(),
            }
            match work(folder.path(), 1, &|| {}) {
                Err(text) => {
                    let named = text.contains(name)
                        || text.contains(path.parent().unwrap().to_str().unwrap());
                    assert!(named, "{name}, {what}: refused without its name: {text}");
                    refused += 1;
                    fs::write(&path, bytes).unwrap();
                }
                Ok(()) => {
                    assert_same_contents(
                        &read_files(folder.path()),
                        &genuine,
                        &format!("{name}, {what}: believed"),
                    );
                    same += 1;
                    fs::remove_dir_all(folder.path()).unwrap();
                    write_files(folder.path(), &begun);
                }
            }
        }
    }
    assert!(
        read_files(folder.path()) == begun,
        "what is refused is not changed"
    );
    let folder = scratch_folder();
    write_files(folder.path(), &other);
    if work(folder.path(), 1, &|| {}).is_ok() {
        assert_same_contents(
            &read_files(folder.path()),
            &genuine,
            "another run's folder: believed",
        );
    }
    println!("{} files: {refused} refused, {same} the same", begun.len());
    refused
}

pub(crate) fn assert_same_contents(
    found: &BTreeMap<String, Vec<u8>>,
    expected: &BTreeMap<String, Vec<u8>>,
    what: &str,
) {
    let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(found), names(expected), "{what}");
    for (name, bytes) in found {
        assert!(
            *bytes == expected[name],
            "{what}: {name} differs in the end"
        );
    }
}

#[test]
fn no_damage_is_believed_in_a_campaign() {
    for stop in [Some(1), Some(3), None] {
        assert!(count_refused_damage(campaign, stop) > 20);
    }
}

#[test]
fn no_damage_is_believed_in_a_count() {
    for stop in [Some(1), None] {
        assert!(count_refused_damage(count, stop) > 20);
    }
}

#[test]
fn no_damage_is_believed_in_an_estimate() {
    assert!(count_refused_damage(estimate, Some(35)) > 3);
    assert!(count_refused_damage(estimate, None) > 10);
}

#[test]
fn no_damage_is_believed_in_a_training() {
    assert!(count_refused_damage(training, Some(30)) > 20);
    assert!(count_refused_damage(training, None) > 20);
}

mod tier_2 {
    use super::*;

    #[test]
    #[ignore = "tier 2: a retraining goes on some 500 times"]
    fn no_damage_is_believed_in_a_retraining() {
        assert!(count_refused_damage(retraining, Some(32)) > 20);
        assert!(count_refused_damage(retraining, None) > 20);
    }
}
