use proptest::prelude::*;

use super::*;
use crate::retrain::RegressionSpaceResult;
use crate::rl::{EverydayUsefulness, RecordedUsefulness};

fn results(paper: &[&str], nominal: &[u64], kept_aside: &[u64]) -> RegressionResults {
    RegressionResults {
        paper: paper.iter().map(|&name| name.to_owned()).collect(),
        nominal: nominal.to_vec(),
        validation_set: kept_aside.to_vec(),
        ..RegressionResults::default()
    }
}

/// A round in which all cases are fixed.
const FIXED: FailureChange = FailureChange {
    before: 5,
    after: 0,
    fixed: 5,
    regressed: 0,
};

fn objections(before: &RegressionResults, after: &RegressionResults) -> Vec<RejectionReason> {
    match decide_acceptance(before, before, after, &FIXED) {
        Acceptance::Accepted => Vec::new(),
        Acceptance::Rejected { objections } => objections,
    }
}

#[test]
fn each_objection_alone_rejects_and_old_failures_do_not() {
    let before = results(&["paper-3 (truth)"], &[4], &[1, 2, 3]);
    assert_eq!(
        decide_acceptance(&before, &before, &before, &FIXED),
        Acceptance::Accepted,
        "no worse"
    );
    let nothing = vec![RejectionReason::NothingFixed];
    let unfixed = FailureChange {
        before: 5,
        after: 5,
        fixed: 1,
        regressed: 1,
    };
    assert_eq!(
        decide_acceptance(&before, &before, &before, &unfixed),
        Acceptance::Rejected {
            objections: nothing
        }
    );
    let objections = |after| objections(&before, &after);
    assert_eq!(
        objections(results(&[], &[], &[7, 8, 9])),
        [],
        "another validation set, but not a larger one"
    );
    let paper = RejectionReason::Paper {
        scenarios: vec!["paper-1 (kalman)".to_owned()],
    };
    assert_eq!(
        objections(results(&["paper-1 (kalman)"], &[4], &[])),
        [paper]
    );
    // A new failure is a regression even if the number of failures stays.
    assert_eq!(
        objections(results(&[], &[5], &[])),
        [RejectionReason::Nominal { draws: vec![5] }]
    );
    let validation_set = RejectionReason::ValidationSet {
        before: 3,
        after: 4,
    };
    assert_eq!(
        objections(results(&[], &[], &[1, 2, 3, 4])),
        [validation_set]
    );
    assert_eq!(
        objections(results(&["paper-1 (kalman)"], &[5], &[1, 2, 3, 4])).len(),
        3
    );
}

#[test]
fn one_space_cannot_be_traded_for_another() {
    let in_spaces = |high_risk: &[u64], of_no_use: &[u64]| {
        let space = |name: &str, collisions: &[u64], of_no_use| RegressionSpaceResult {
            space: name.to_owned(),
            sample_count: 100,
            collisions: collisions.to_vec(),
            not_useful: of_no_use,
        };
        let traffic = space("traffic", &[], Some(of_no_use.to_vec()));
        RegressionResults {
            regression: vec![space("high-risk", high_risk, None), traffic],
            ..results(&[], &[], &[1, 2])
        }
    };
    let before = in_spaces(&[1, 2, 3], &[5]);
    let objections = |high_risk: &[u64], of_no_use: &[u64]| {
        let after = RegressionResults {
            validation_set: vec![],
            ..in_spaces(high_risk, of_no_use)
        };
        objections(&before, &after)
    };
    assert!(
        objections(&[4, 5, 6, 7], &[5, 6]).is_empty(),
        "within chance"
    );
    let many: Vec<u64> = (10..30).collect();
    let collisions = DiscordantPairs {
        only_second_fails: 20,
        only_first_fails: 3,
    };
    let worse = RejectionReason::MoreCollisions {
        space: "high-risk".to_owned(),
        collisions,
    };
    assert_eq!(objections(&many, &[]), [worse]);
    let drives = DiscordantPairs {
        only_second_fails: 20,
        only_first_fails: 1,
    };
    assert_eq!(
        objections(&[], &many),
        [RejectionReason::LessUseful {
            space: "traffic".to_owned(),
            drives
        }]
    );
}

#[test]
fn one_measure_of_usability_cannot_be_traded_for_another() {
    let useful = TrafficUsefulness {
        scenario_count: 1000,
        collisions: 0,
        hard_braking: 3,
        fell_behind: 0,
        acceleration_times_idm: 1.1,
        jerk_times_idm: 0.9,
        mean_time_gap_s: 1.9,
        line_gain: Some(0.3),
        everyday: Some(EverydayUsefulness {
            faults: 5,
            jerk_times_idm: 1.2,
        }),
        recorded: Some(RecordedUsefulness {
            drive_count: 9,
            faults: 1,
            jerk_times_idm: 1.1,
        }),
    };
    let before = RegressionResults {
        usefulness: Some(useful),
        ..results(&[], &[], &[])
    };
    let worse = |usefulness| {
        let after = RegressionResults {
            usefulness: Some(usefulness),
            ..before.clone()
        };
        objections(&before, &after)
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
    };
    assert!(
        worse(TrafficUsefulness {
            acceleration_times_idm: 1.109,
            jerk_times_idm: 1.0,
            ..useful
        })
        .is_empty()
    );
    assert!(
        worse(TrafficUsefulness {
            hard_braking: 2,
            mean_time_gap_s: 2.1,
            ..useful
        })
        .is_empty()
    );
    assert_eq!(
        worse(TrafficUsefulness {
            mean_time_gap_s: 1.1,
            ..useful
        })
        .len(),
        1
    );
    // The second round may not use the tolerance again.
    let [second, third] = [1.109, 1.115].map(|acceleration_times_idm| RegressionResults {
        usefulness: Some(TrafficUsefulness {
            acceleration_times_idm,
            ..useful
        }),
        ..before.clone()
    });
    assert!(decide_acceptance(&before, &before, &second, &FIXED).is_accepted());
    assert!(!decide_acceptance(&before, &second, &third, &FIXED).is_accepted());
    assert!(
        worse(TrafficUsefulness {
            line_gain: Some(0.9),
            ..useful
        })
        .is_empty()
    );
    for line_gain in [Some(1.1), None] {
        assert_eq!(
            worse(TrafficUsefulness {
                line_gain,
                ..useful
            })
            .len(),
            1
        );
    }
    let hard = worse(TrafficUsefulness {
        hard_braking: 4,
        jerk_times_idm: 0.5,
        ..useful
    });
    assert_eq!(hard, ["in traffic hard unnecessary braking 4 instead of 3"]);
    let everyday = worse(TrafficUsefulness {
        everyday: Some(EverydayUsefulness {
            faults: 6,
            jerk_times_idm: 1.0,
        }),
        ..useful
    });
    assert_eq!(everyday, ["in traffic faults in everyday 6 instead of 5"]);
    let recorded = worse(TrafficUsefulness {
        recorded: Some(RecordedUsefulness {
            drive_count: 9,
            faults: 2,
            jerk_times_idm: 1.2,
        }),
        ..useful
    });
    assert_eq!(
        recorded,
        ["in traffic faults in recorded drives 2 instead of 1, \
             rms jerk in recorded drives, times idm 1.2 instead of 1.1"]
    );
    let jerk = worse(TrafficUsefulness {
        hard_braking: 0,
        jerk_times_idm: 1.1,
        ..useful
    });
    assert_eq!(jerk, ["in traffic rms jerk, times idm 1.1 instead of 0.9"]);
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn changes_add_up(
        before in proptest::collection::btree_set(0..40_u64, 0..20),
        after in proptest::collection::btree_set(0..40_u64, 0..20),
    ) {
        let lists = [before, after].map(|set| set.into_iter().collect::<Vec<_>>());
        let change = FailureChange::between(&lists[0], &lists[1]);
        prop_assert_eq!(change.before - change.fixed, change.after - change.regressed);
        let first = results(&[], &lists[0], &[]);
        let passed = decide_acceptance(&first, &first, &results(&[], &lists[1], &[]), &FIXED).is_accepted();
        prop_assert_eq!(passed, change.regressed == 0);
    }
}
