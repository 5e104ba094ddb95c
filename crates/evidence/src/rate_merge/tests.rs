use std::collections::HashMap;
use std::fs;

use rand::seq::SliceRandom;
use rand::{Rng, RngExt};

use super::*;
use crate::fixtures::{rate_plan, read_completed};
use crate::{COUNT_SHARD_KIND, RatePlan};
use crumple_core::observer::Quiet;
use crumple_store::run_folder::{RunState, read_state};
use crumple_store::shard::ShardId;
use crumple_world::random::{Purpose, stream};

const FILES: [&str; 4] = ["registration.json", "progress.json", "certificate.json", "work.json"];

fn plan(seed: u64) -> RatePlan {
    plan_with("idm", None, seed)
}

fn plan_with(controller: &str, against: Option<&str>, seed: u64) -> RatePlan {
    rate_plan(controller, against, ("high-risk", 2350), (seed, 0.9))
}

fn add_shard(merged: &mut Option<MergedCount>, folder: &Path) -> Result<(), MergeError> {
    let found = read_completed(folder);
    match merged {
        Some(merged) => merged.add_shard(folder, &found),
        None => {
            *merged = Some(MergedCount::new(folder, &found)?);
            Ok(())
        }
    }
}

fn count_whole(plan: &RatePlan) -> (tempfile::TempDir, CountTally) {
    let folder = tempfile::tempdir().unwrap();
    let mut count = plan.register_in(folder.path(), false).unwrap();
    count.certify(&Quiet).unwrap();
    let tally = count.tally().clone();
    (folder, tally)
}

struct Shards<'a> {
    plan: &'a RatePlan,
    root: tempfile::TempDir,
    counted: HashMap<ShardId, PathBuf>,
}

impl<'a> Shards<'a> {
    fn new(plan: &'a RatePlan) -> Self {
        Self { plan, root: tempfile::tempdir().unwrap(), counted: HashMap::new() }
    }

    fn folder(&mut self, shard: ShardId) -> PathBuf {
        let make = || {
            let folder = self.root.path().join(format!("{}-of-{}", shard.index(), shard.count()));
            self.plan.register_shard_in(shard, &folder, false).unwrap().count(&Quiet).unwrap();
            folder
        };
        self.counted.entry(shard).or_insert_with(make).clone()
    }
}

fn shard(index: u32, of: u32) -> ShardId {
    ShardId::new(index, of).unwrap()
}

/// Returns a random division with duplicates and gaps, sometimes mixed with shards of another division.
fn random_shards(random: &mut impl Rng) -> Vec<ShardId> {
    let of = random.random_range(1..=24);
    let keep = if random.random_bool(0.5) { 1.0 } else { random.random_range(0.3..1.0) };
    let mut shards: Vec<ShardId> =
        (1..=of).map(|index| shard(index, of)).filter(|_| random.random_bool(keep)).collect();
    let again: Vec<ShardId> = shards.iter().copied().filter(|_| random.random_bool(0.2)).collect();
    shards.extend(again);
    if random.random_bool(0.3) || shards.is_empty() {
        let other = random.random_range(1..=24);
        shards.push(shard(random.random_range(1..=other), other));
    }
    shards.shuffle(random);
    shards
}

#[test]
fn random_splits_merge_to_the_single_run_or_name_missing_shards() {
    let plan = plan(3);
    let (single, tally) = count_whole(&plan);
    assert!(tally.failures > 0 && tally.failures < tally.runs, "{}", tally.failures);
    let (mut shards, mut random) = (Shards::new(&plan), stream(25, Purpose::RareEvents, 0));
    let (mut complete, mut refused) = (0, 0);
    for _ in 0..200 {
        let (mut merged, mut owners, mut duplicates) = (None, vec![None; 24], 0);
        for shard in random_shards(&mut random) {
            let taken = add_shard(&mut merged, &shards.folder(shard));
            let blocks = plan.shard_blocks(shard).unwrap();
            let own = &mut owners[blocks.start as usize..blocks.end as usize];
            if own.iter().all(|owner| *owner == Some(shard)) {
                duplicates += 1;
                taken.unwrap();
            } else if own.iter().any(Option::is_some) {
                refused += 1;
                assert!(matches!(taken, Err(MergeError::Overlapping { .. })), "{shard}");
            } else {
                own.fill(Some(shard));
                taken.unwrap();
            }
        }
        let (merged, out) = (merged.unwrap(), tempfile::tempdir().unwrap());
        let there = || (0..24).filter(|&block| owners[block as usize].is_some());
        let so_far = merged.partial_count();
        let runs: u64 = there().map(|block| range_len(&plan.run_range(block))).sum();
        let failures: u64 = there().map(|block| tally.blocks[block as usize].failures).sum();
        assert_eq!((so_far.runs, so_far.failures, so_far.duplicates), (runs, failures, duplicates));
        let missing: u64 = so_far.missing_runs.iter().map(|[start, end]| end - start).sum();
        assert_eq!(missing, 2350 - runs);
        assert!(so_far.rate_at_most >= Some(plan.record().rate_at_most(tally.failures)));
        match merged.write_in(out.path()).unwrap() {
            None => {
                assert!(there().count() < 24);
                assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);
            }
            Some(_) => {
                complete += 1;
                assert_eq!(there().count(), 24);
                merged.write_in(out.path()).unwrap();
                for name in FILES {
                    let read = |folder: &Path| fs::read(folder.join(name)).unwrap();
                    assert_eq!(read(out.path()), read(single.path()), "{name}");
                }
            }
        }
    }
    assert!(complete > 50 && refused > 20, "{complete} {refused}");
}

#[test]
fn a_comparison_is_put_together_and_a_shard_that_was_interrupted_goes_on() {
    let plan = plan_with("idm", Some("baseline"), 3);
    let ((single, _), mut shards) = (count_whole(&plan), Shards::new(&plan));
    let folder = shards.root.path().join("2-of-2");
    let half = tempfile::tempdir().unwrap();
    plan.register_shard_in(shard(2, 2), half.path(), false).unwrap();
    assert!(matches!(read_state(half.path()).unwrap(), RunState::InProgress(kind) if kind == COUNT_SHARD_KIND));
    plan.register_shard_in(shard(2, 2), half.path(), true).unwrap().count(&Quiet).unwrap();
    let mut merged = None;
    add_shard(&mut merged, half.path()).unwrap();
    add_shard(&mut merged, &shards.folder(shard(1, 2))).unwrap();
    add_shard(&mut merged, &shards.folder(shard(2, 2))).unwrap();
    assert_eq!(fs::read(folder.join("work.json")).unwrap(), fs::read(half.path().join("work.json")).unwrap());
    let (merged, out) = (merged.unwrap(), tempfile::tempdir().unwrap());
    assert_eq!(merged.partial_count().duplicates, 1);
    merged.write_in(out.path()).unwrap().unwrap();
    for name in FILES {
        assert_eq!(fs::read(out.path().join(name)).unwrap(), fs::read(single.path().join(name)).unwrap(), "{name}");
    }
    assert!(plan.register_shard_in(shard(1, 25), &folder, false).is_err(), "24 blocks make no 25 shards");
    assert_eq!(fs::read_dir(half.path()).unwrap().count(), 4, "a shard leaves four files");
}

#[test]
fn foreign_changed_or_contradictory_shards_are_refused() {
    let (mine, other) = (plan(3), plan(4));
    let (mut own, mut foreign) = (Shards::new(&mine), Shards::new(&other));
    let mut merged = None;
    add_shard(&mut merged, &own.folder(shard(1, 3))).unwrap();
    let error = add_shard(&mut merged, &foreign.folder(shard(2, 3))).unwrap_err().to_string();
    assert!(error.ends_with("configuration.seed differs"), "{error}");

    let second = own.folder(shard(2, 3));
    let is_refused = |merged: &mut Option<MergedCount>| match read_state(&second) {
        Ok(RunState::Complete(found)) => merged.as_mut().unwrap().add_shard(&second, &found).is_err(),
        Ok(_) => false,
        Err(_) => true,
    };
    for name in [SHARD_FILE, "progress.json", "work.json"] {
        let path = second.join(name);
        let bytes = fs::read(&path).unwrap();
        for place in (0..bytes.len()).step_by(bytes.len() / 40 + 1) {
            let mut changed = bytes.clone();
            changed[place] ^= 1;
            fs::write(&path, changed).unwrap();
            assert!(is_refused(&mut merged), "{name} {place}");
        }
        fs::remove_file(&path).unwrap();
        assert!(is_refused(&mut merged), "{name}");
        fs::write(&path, bytes).unwrap();
    }
    add_shard(&mut merged, &second).unwrap();

    let forged = tempfile::tempdir().unwrap();
    let progress = fs::read_to_string(second.join("progress.json")).unwrap();
    let hash = progress.rfind("\"sha256\": \"").unwrap() + 11;
    let digit = if progress.as_bytes()[hash] == b'0' { "1" } else { "0" };
    let forge = |work: &crumple_store::run_folder::RunFolder| {
        let changed = format!("{}{digit}{}", &progress[..hash], &progress[hash + 1..]);
        work.write("progress.json", changed).unwrap();
        work.finish().unwrap();
    };
    let begun = mine.register_shard_in(shard(2, 3), forged.path(), false).unwrap();
    forge(&begun.run_folder);
    drop(begun);
    let error = add_shard(&mut merged, forged.path()).unwrap_err();
    assert!(matches!(error, MergeError::Contradicting { .. }), "{error}");
    assert_eq!(merged.unwrap().partial_count().missing_shards, [3]);
}
