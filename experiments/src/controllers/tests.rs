//! A small table, and the list of controllers.

use super::*;

fn small() -> RowConfig {
    RowConfig {
        draws: 14,
        drives: None,
    }
}

/// Without a follower, no vehicle hits the one under test.
#[test]
fn each_kind_of_follower_meets_the_same_scenarios() {
    let controller = find_and_try("full-throttle", Path::new("")).unwrap();
    let counts = row::count_by_follower(&controller, 40).unwrap();
    let kinds: Vec<_> = counts
        .iter()
        .map(|counts| counts.follower.as_str())
        .collect();
    assert_eq!(
        kinds,
        [
            "baseline", "human", "idm", "acc-aeb", "late", "weak", "none"
        ]
    );
    // A vehicle at full throttle leaves its follower behind.
    assert!(counts.iter().all(|counts| counts.hits > 35), "{counts:?}");
    assert_eq!(counts[6].hit_from_behind, 0);
}

#[test]
fn a_finished_row_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let controller = find_and_try("match-leader", Path::new("")).unwrap();
    let first = finished_row(&controller, &small(), folder.path()).unwrap();
    let files = || std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(files(), 1);
    let path = std::fs::read_dir(folder.path())
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let marked = ControllerRow {
        largest_gain: Some(7.0),
        ..first.clone()
    };
    std::fs::write(&path, serde_json::to_vec(&marked).unwrap()).unwrap();
    assert_eq!(
        finished_row(&controller, &small(), folder.path()).unwrap(),
        marked
    );
    let other = RowConfig {
        draws: 7,
        drives: None,
    };
    assert_ne!(
        finished_row(&controller, &other, folder.path()).unwrap(),
        marked
    );
    let page = page::render(&[first], &small());
    assert!(
        page.contains("| match-leader | ") && page.contains("not counted"),
        "{page}"
    );
}
