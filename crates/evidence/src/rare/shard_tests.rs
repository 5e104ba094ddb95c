use std::fs;
use std::path::PathBuf;

use rand::RngExt;
use rand::seq::SliceRandom;

use super::*;
use crate::fixtures::{rare_plan, read_completed};
use crumple_core::observer::Quiet;
use crumple_store::shard::{MergeError, ShardId};
use crumple_world::random::{Purpose, stream};

fn plan(seed: u64) -> RarePlan {
    let method = if seed.is_multiple_of(2) { RareMethod::Splitting } else { RareMethod::Importance };
    rare_plan(method, seed, 7)
}

#[test]
fn shards_of_an_estimate_come_to_the_estimate_of_one_machine() {
    [2, 5].into_iter().for_each(check_merge);
}

fn check_merge(seed: u64) {
    let (plan, root) = (plan(seed), tempfile::tempdir().unwrap());
    let single = root.path().join("single");
    let pilot = {
        let mut folder = plan.open_folder(&single, false).unwrap();
        let pilot = folder.run_pilot(&plan, &Quiet).unwrap();
        folder.estimate(&plan, &pilot, 0, &Quiet).unwrap();
        pilot
    };
    let made = |index: u32, of: u32| -> PathBuf {
        let folder = root.path().join(format!("{index}-of-{of}"));
        let mut part = plan.open_shard_folder(ShardId::new(index, of).unwrap(), 0, &folder, true).unwrap();
        if !part.is_complete() {
            part.run_repetitions(&pilot, &Quiet).unwrap();
        }
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 4);
        folder
    };
    let mut random = stream(25, Purpose::RareEvents, 1);
    let mut complete = 0;
    for _ in 0..20 {
        let of = random.random_range(1..=7);
        let mut folders: Vec<PathBuf> =
            (1..=of).filter(|_| random.random_bool(0.9)).map(|index| made(index, of)).collect();
        folders.extend(folders.first().cloned());
        let Some(first) = folders.first().cloned() else { continue };
        let is_whole = folders.len() as u32 == of + 1;
        folders.shuffle(&mut random);
        let mut merged = MergedEstimate::new(&first, &read_completed(&first)).unwrap();
        folders.iter().for_each(|folder| merged.add_shard(folder, &read_completed(folder)).unwrap());
        let out = root.path().join("merged");
        assert_eq!(merged.write_in(&out).unwrap().is_some(), is_whole);
        assert_eq!((merged.missing_part_count() == 0), is_whole);
        if is_whole {
            complete += 1;
            for name in ["rare-estimate.json", "work.json"] {
                assert_eq!(fs::read(out.join(name)).unwrap(), fs::read(single.join(name)).unwrap(), "{name}");
            }
        }
    }
    assert!(complete > 5, "{complete}");

    let mut merged = MergedEstimate::new(&made(1, 2), &read_completed(&made(1, 2))).unwrap();
    let overlapping = merged.add_shard(&made(2, 7), &read_completed(&made(2, 7))).unwrap_err();
    assert!(matches!(overlapping, MergeError::Overlapping { .. }), "{overlapping}");
    let (other, folder) = (self::plan(3), root.path().join("other"));
    let mut part = other.open_shard_folder(ShardId::new(2, 2).unwrap(), 0, &folder, false).unwrap();
    let pilot = part.run_pilot(&Quiet).unwrap();
    part.run_repetitions(&pilot, &Quiet).unwrap();
    assert!(matches!(merged.add_shard(&folder, &read_completed(&folder)), Err(MergeError::Foreign { .. })));
    assert!(plan.open_shard_folder(ShardId::new(1, 8).unwrap(), 0, &folder, false).is_err());
}
