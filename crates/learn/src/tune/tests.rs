//! Tests of whole tunings.

use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use super::*;
use crumple_core::observer::Quiet;
use crumple_search::falsify::Method;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::built_in_space;
use crumple_store::study::Study;

fn plan(controller: &str, settings: &[&str], method: Method) -> TuningPlan {
    let request = |name: &&str| SettingRequest {
        name: (*name).to_owned(),
        range: None,
    };
    let requests: Vec<_> = settings.iter().map(request).collect();
    let space = |(name, weight)| TuningSpace {
        space: built_in_space(name).unwrap(),
        weight,
    };
    TuningPlan {
        search: SettingSearch::parse(controller, &requests).unwrap(),
        spaces: [("high-risk", 2.0), ("paper", 1.0)].map(space).into(),
        drives: None,
        config: TuningConfig {
            objective: TuningObjective::Both,
            method,
            seed: 5,
            evaluations: 11,
            runs: 5,
            test_runs: 6,
            estimator: EstimatorKind::Kalman,
        },
    }
}

fn read_files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries
        .map(|entry| {
            (
                entry.file_name().into_string().unwrap(),
                fs::read(entry.path()).unwrap(),
            )
        })
        .collect()
}

/// A tuning that stops after every single step and resumes, on another number of threads, writes the same files.
#[test]
fn interruptions_and_threads_change_no_byte() {
    let plan = plan("acc-aeb", &["ttc_s", "time_headway_s"], Method::CmaEs);
    let [whole, parts] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let on_threads = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
    };
    let expected = on_threads(1)
        .install(|| plan.run(whole.path(), false, &Quiet))
        .unwrap();
    let (pool, reached) = (on_threads(2), AtomicU64::new(0));
    let stop_at_progress =
        |progress: &TuningProgress| match progress.done > reached.load(Ordering::Relaxed) {
            true => {
                assert!(progress.done <= progress.total);
                reached.store(progress.done, Ordering::Relaxed);
                ControlFlow::Break(())
            }
            false => ControlFlow::Continue(()),
        };
    let mut stops = 0;
    let report = loop {
        match pool.install(|| plan.run(parts.path(), true, &stop_at_progress)) {
            Err(TuneError::Stopped(_)) => stops += 1,
            done => break done.unwrap(),
        }
    };
    assert!(stops > plan.config.evaluations, "{stops}");
    assert_eq!(report, expected);
    assert_eq!(
        plan.run(parts.path(), true, &Quiet).unwrap(),
        expected,
        "a complete tuning is read"
    );
    let files = read_files(whole.path());
    let names = [
        "candidates.jsonl",
        "report.json",
        "report.md",
        "tune.toml",
        "work.json",
        "work.lock",
    ];
    assert!(files.keys().eq(names.iter()), "{:?}", files.keys());
    assert!(files == read_files(parts.path()), "the files are the same");
    let mut other = plan.clone();
    other.config.seed = 6;
    let refused = other
        .run(parts.path(), true, &Quiet)
        .unwrap_err()
        .to_string();
    assert!(
        refused.ends_with("configuration: line 6 is `seed = 5` there, and `seed = 6` now"),
        "{refused}"
    );
}

/// Both methods improve a brake that is too late, and the tuned settings are never worse on the sets that decide.
#[test]
fn a_late_emergency_brake_is_tuned_to_brake_earlier() {
    for method in [Method::CmaEs, Method::CrossEntropy] {
        let request = SettingRequest {
            name: "ttc_s".to_owned(),
            range: Some([0.0, 3.0]),
        };
        let plan = TuningPlan {
            search: SettingSearch::parse("baseline", &[request]).unwrap(),
            spaces: vec![TuningSpace {
                space: built_in_space("standing").unwrap(),
                weight: 1.0,
            }],
            drives: None,
            config: TuningConfig {
                objective: TuningObjective::Safety,
                runs: 20,
                ..plan("baseline", &[], method).config
            },
        };
        let folder = tempfile::tempdir().unwrap();
        let report = plan.run(folder.path(), false, &Quiet).unwrap();
        let (initial, best) = (&report.finalists[0], report.finalists.last().unwrap());
        assert_eq!(initial.tuning.controller, "baseline");
        assert!(
            report.finalists.len() > 1 && best.tuning.objective <= initial.tuning.objective,
            "{report:?}"
        );
        let tuned = report
            .finalists
            .iter()
            .find(|finalist| finalist.tuning.controller == report.tuned)
            .unwrap();
        assert!(tuned.selection.objective <= initial.selection.objective);
        assert!(report.to_markdown().contains(&report.tuned) && report.test.len() == 3);
        assert!(
            report.test[1].traffic.is_some(),
            "the report has both sides"
        );
    }
}
