use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use proptest::prelude::*;

use super::study::PROGRESS_FILE;
use super::*;
use crate::fixtures::rare_plan;
use crumple_core::observer::{Listener, Quiet};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::scenario::NoDriverFiles;
use crumple_sim::scenario::file::load;
use crumple_store::study::{Study, StudyFolder};

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(work)
}

fn run_until(plan: &RarePlan, folder: &Path, plug: u64) -> Option<u64> {
    // A resumed step counts its runs from those of earlier repetitions.
    let before = completed_runs(plan, folder);
    let pilot_runs = AtomicU64::new(0);
    let runs = AtomicU64::new(0);
    let observer = Listener(|progress: &RareProgress| {
        let done = match progress.stage {
            RareStage::Pilot => {
                pilot_runs.fetch_max(progress.runs, Ordering::SeqCst);
                progress.runs
            }
            _ => pilot_runs.load(Ordering::SeqCst) + progress.runs - before,
        };
        assert!(done <= plug, "the plug is pulled");
        runs.fetch_max(done, Ordering::SeqCst);
    });
    let work = || plan.run(folder, true, &observer).unwrap();
    let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
    ended.ok().map(|_| runs.into_inner())
}

fn completed_runs(plan: &RarePlan, folder: &Path) -> u64 {
    let study = StudyFolder::open(plan, folder, true).unwrap();
    study.state().map_or(0, |state| state.completed_runs(plan))
}

fn assert_same(first: &Path, other: &Path) {
    for name in ["rare-estimate.json", "work.json"] {
        assert!(
            fs::read(first.join(name)).unwrap() == fs::read(other.join(name)).unwrap(),
            "{name}"
        );
    }
    assert!(!first.join(PROGRESS_FILE).exists() && !first.join("previous").exists());
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2))]

    /// Repeated interruptions, with any number of threads, do not change the bytes of the result.
    #[test]
    fn an_interrupted_estimate_resumes_to_the_same_bytes(
        seed in 0..20_u64,
        interruptions in prop::collection::vec((100..6000_u64, 1..=3_usize), 1..5),
    ) {
        let plan = rare_plan(seed, 14);
        let root = tempfile::tempdir().unwrap();
        let [through, broken] = ["through", "broken"].map(|name| root.path().join(name));
        let all = with_threads(2, || run_until(&plan, &through, u64::MAX)).unwrap();
        let interrupted = |&(runs, threads): &(u64, usize)| {
            with_threads(threads, || run_until(&plan, &broken, runs)).is_none()
        };
        let times = interruptions.iter().filter(|interruption| interrupted(interruption)).count();
        let left = with_threads(3, || run_until(&plan, &broken, u64::MAX)).unwrap();
        prop_assert!(left <= all && (times > 0 || left == 0), "{left} of {all} after {times} interruptions");
        assert_same(&through, &broken);
    }
}

#[test]
fn repetitions_are_saved_as_they_end() {
    let (plan, root) = (rare_plan(1, 14), tempfile::tempdir().unwrap());
    let [through, broken] = ["through", "broken"].map(|name| root.path().join(name));
    let all = with_threads(1, || run_until(&plan, &through, u64::MAX)).unwrap();
    assert_eq!(with_threads(1, || run_until(&plan, &broken, all - 1)), None);
    let study = StudyFolder::open(&plan, &broken, true).unwrap();
    assert!(study.state().unwrap().completed_repetitions() >= 4);
    drop(study);
    let left = with_threads(1, || run_until(&plan, &broken, u64::MAX)).unwrap();
    assert!(left > 0 && left < all / 3, "{left} of {all}");
    assert_same(&through, &broken);
}

#[test]
fn only_the_same_estimate_resumes_an_unfinished_folder() {
    let (plan, root) = (rare_plan(1, 14), tempfile::tempdir().unwrap());
    assert_eq!(
        with_threads(1, || run_until(&plan, root.path(), 3000)),
        None
    );
    assert!(root.path().join(PROGRESS_FILE).exists());
    let error = |plan: &RarePlan, resume| {
        StudyFolder::open(plan, root.path(), resume)
            .err()
            .map(|error| error.to_string())
    };
    assert!(
        error(&plan, false)
            .unwrap()
            .ends_with("already holds a rare-failure estimate: use --resume or another --out")
    );
    for other in [rare_plan(2, 14), rare_plan(1, 15)] {
        assert!(
            error(&other, true)
                .unwrap()
                .contains("the rare-failure estimate there has a different configuration: line ")
        );
    }
    let text = fs::read_to_string(root.path().join(PROGRESS_FILE)).unwrap();
    let path = root.path().join(PROGRESS_FILE);
    fs::write(&path, text.replacen("\"seed\":1", "\"seed\":2", 1)).unwrap();
    assert!(
        error(&plan, true)
            .unwrap()
            .contains("progress.json: has changed since it was written")
    );
    fs::write(&path, text).unwrap();
    assert_eq!(error(&plan, true), None);
}

#[test]
fn failures_are_kept_as_scenarios_whose_weights_add_up_to_the_estimate() {
    let (plan, root) = (rare_plan(1, 14), tempfile::tempdir().unwrap());
    let report = plan.run(root.path(), false, &Quiet).unwrap();
    let folder = root.path().join(FAILURE_FOLDER);
    let text = fs::read_to_string(root.path().join(FAILURE_LIST_FILE)).unwrap();
    let list: WeightedFailures = serde_json::from_str(&text).unwrap();
    let probability = report.estimate.probability.unwrap();
    assert!(
        (list.probability / probability - 1.0).abs() < 1e-12,
        "{}",
        list.probability
    );
    assert!(!list.failures.is_empty());
    for failure in &list.failures {
        let scenario = load(&folder.join(&failure.file), &NoDriverFiles).unwrap();
        let options =
            RunOptions::new(plan.controller.source.clone()).with_estimator(plan.estimator);
        let run = Run::new(&scenario, options).unwrap();
        let result = simulate(&run, RecordingLevel::Summary);
        assert_eq!(
            !result.outcome.is_safe(),
            failure.replays,
            "{}",
            failure.file
        );
        assert!(failure.weight > 0.0 && failure.margin < 0.0);
    }
    assert!(list.failures.iter().any(|failure| failure.replays));
}
