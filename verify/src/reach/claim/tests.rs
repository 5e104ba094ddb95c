use super::super::fixtures::{constant_controller, default_problem, interval, point_box};
use super::*;
use crate::reach::controller_file_name;
use crate::work::WorkLimit;

const DEFAULT_POINT: [f64; 8] = [5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0];

fn claim(partition: Vec<PartitionCell>) -> ReachClaim {
    let mut ranges = point_box(DEFAULT_POINT);
    ranges.gap_ahead_m = interval(0.0, 1.0);
    ReachClaim {
        policy_file: controller_file_name("0123456789abcdef", false),
        policy_sha256: String::new(),
        source: None,
        step_s: 0.05,
        steps: 300,
        follower_ttc_s: None,
        follower_law: None,
        leader_brakes_at_most_mps2: None,
        observation_error: [0.0; OBSERVATION_SIZE],
        ranges,
        partition,
        verified_share_at_least: 0.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 0.0,
    }
}

fn problem<T>(result: Result<T, Rejection>) -> String {
    result
        .err()
        .map(|rejection| rejection.to_string())
        .unwrap_or_default()
}

#[test]
fn a_file_name_begins_with_kind_and_digest() {
    assert_eq!(
        controller_file_name("0123456789abcdef", false),
        "policy-0123456789ab.safetensors"
    );
    assert_eq!(
        controller_file_name("0123456789abcdef", true),
        "network-0123456789ab.safetensors"
    );
}

#[test]
fn the_horizon_is_the_number_of_steps_times_the_step() {
    assert_eq!(claim(Vec::new()).horizon_s(), 15.0);
}

#[test]
fn steps_are_positive_and_divide_the_time_between_decisions() {
    let controller = constant_controller(0.0);
    let claim_with_step = |step_s: f64| {
        problem(
            ReachClaim {
                step_s,
                ..claim(vec![PartitionCell::Undecided])
            }
            .problem(&controller),
        )
    };
    for step_s in [0.0, -0.05, f64::INFINITY, f64::NAN] {
        assert!(
            claim_with_step(step_s).ends_with("must be positive"),
            "{step_s}"
        );
    }
    assert!(
        claim_with_step(0.03).ends_with("must divide the decision interval")
            && claim_with_step(0.05).is_empty()
    );
}

/// The limit holds for repeated lower and for repeated upper halves.
#[test]
fn the_limit_of_cuts_is_exact() {
    let cut = PartitionCell::Cut(BoxDimension::GapAheadM);
    for (cuts, expected) in [(MAX_CUTS, ""), (MAX_CUTS + 1, "cuts too often")] {
        let lower: Vec<PartitionCell> =
            [vec![cut; cuts], vec![PartitionCell::Undecided; cuts + 1]].concat();
        let upper: Vec<PartitionCell> = [
            [cut, PartitionCell::Undecided].repeat(cuts),
            vec![PartitionCell::Undecided],
        ]
        .concat();
        for partition in [lower, upper] {
            let leaves = claim(partition).leaves();
            assert!(
                leaves
                    .as_ref()
                    .map_or(true, |leaves| leaves.len() == cuts + 1)
            );
            assert!(problem(leaves).ends_with(expected));
        }
    }
}

#[test]
fn too_many_cells_are_refused() {
    assert!(
        problem(claim(vec![PartitionCell::Undecided; MAX_CELLS + 1]).leaves())
            .ends_with("has too many cells")
    );
    assert!(
        problem(claim(vec![PartitionCell::Undecided; 2]).leaves())
            .ends_with("is one cell more than the cuts create")
    );
}

/// A colliding point falsifies only its own cell.
#[test]
fn a_falsifying_point_must_lie_in_its_cell() {
    let controller = constant_controller(0.0);
    let mut ranges = point_box([1.0, 20.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0]);
    ranges.gap_ahead_m = interval(1.0, 2.0);
    let (scene, work) = (
        default_problem(&controller, ranges),
        OpBudget::new(WorkLimit::UNLIMITED),
    );
    let point = |gap_m: f64| PartitionCell::Falsified([gap_m, 20.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0]);
    let mut cell = ranges;
    cell.gap_ahead_m = interval(1.0, 1.5);
    assert_eq!(
        check_leaf(&scene, &point(1.25), &cell, &work),
        Ok(f64::INFINITY)
    );
    assert_eq!(
        check_leaf(&scene, &point(1.75), &cell, &work),
        Err("the point is outside the cell".to_owned())
    );
    assert_eq!(
        check_leaf(&scene, &point(1.75), &ranges, &work),
        Ok(f64::INFINITY)
    );
}
