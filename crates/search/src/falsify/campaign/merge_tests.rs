use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use proptest::prelude::*;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::super::shard::ShardedCampaign;
use super::super::{Campaign, CampaignError, CampaignOptions, CampaignProgress, CampaignSummary, EvaluationLog};
use super::MergedCampaign;
use crate::falsify::Method;
use crumple_core::observer::{Observer, Quiet};
use crumple_store::run_folder::{RunState, read_state};
use crumple_store::shard::{MergeError, ShardId, open_shard};

const BUDGET: u64 = 40;
const MAX_TEST_SHARDS: u32 = 4;

fn campaign(method: Method, seed: u64) -> Campaign {
    Campaign::of_match_leader("high-risk", method, BUDGET, seed)
}

fn summary_only(resume: bool) -> CampaignOptions {
    CampaignOptions { log: EvaluationLog::Summary, resume }
}

fn stop_immediately() -> impl Observer<CampaignProgress> {
    |_: &CampaignProgress| ControlFlow::Break(())
}

fn run_all_shards(campaign: &Campaign, root: &Path) {
    for of in 1..=MAX_TEST_SHARDS {
        for index in 1..=of {
            let shard = ShardId::new(index, of).unwrap();
            campaign.run_shard(shard, &shard_folder(root, shard), false, &Quiet).unwrap();
        }
    }
}

fn shard_folder(root: &Path, shard: ShardId) -> PathBuf {
    root.join(format!("{}-of-{}", shard.index(), shard.count()))
}

fn merge(folders: &[PathBuf]) -> Result<MergedCampaign, MergeError> {
    let mut merged: Option<MergedCampaign> = None;
    for folder in folders {
        let RunState::Complete(found) = read_state(folder)? else { panic!("{} is not finished", folder.display()) };
        match &mut merged {
            None => merged = Some(MergedCampaign::from_shard(folder, &found)?),
            Some(merged) => merged.add_shard(folder, &found)?,
        }
    }
    Ok(merged.unwrap())
}

fn read_files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(read_files(&path));
        } else {
            found.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    found
        .into_iter()
        .map(|(path, bytes)| (path.strip_prefix(folder).map_or(path.clone(), Path::to_owned), bytes))
        .collect()
}

fn run_unsharded(campaign: &Campaign) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    campaign.run(folder.path(), summary_only(false), &Quiet).unwrap();
    folder
}

/// Generates a random division, with some shards divided again, in random order, and with duplicates.
fn divisions() -> impl Strategy<Value = Vec<ShardId>> {
    let halves = |shard: ShardId| {
        [2 * shard.index() - 1, 2 * shard.index()].map(|index| ShardId::new(index, 2 * shard.count()).unwrap())
    };
    let divided = (1..=MAX_TEST_SHARDS).prop_flat_map(move |of| {
        prop::collection::vec((any::<bool>(), 1..3_usize), of as usize).prop_map(move |choices| {
            let mut shards = Vec::new();
            for (index, (again, times)) in (1..=of).zip(choices) {
                let shard = ShardId::new(index, of).unwrap();
                let parts = if again && 2 * of <= MAX_TEST_SHARDS { halves(shard).to_vec() } else { vec![shard] };
                shards.extend(parts.iter().flat_map(|part| vec![*part; times]));
            }
            shards
        })
    });
    divided.prop_shuffle()
}

/// A merged reference search equals the undivided one byte for byte, also if missing shards were added later.
#[test]
fn a_divided_reference_search_is_that_of_one_machine() {
    for (method, seed) in [(Method::Uniform, 3), (Method::Halton, 4)] {
        let (campaign, root) = (campaign(method, seed), tempfile::tempdir().unwrap());
        run_all_shards(&campaign, root.path());
        let single = run_unsharded(&campaign);
        let expected = read_files(single.path());
        assert!(expected.len() > 8, "it finds failures: {:?}", expected.keys());
        proptest!(crumple_cases::with_cases(2), |(shards in divisions())| {
            let folders: Vec<PathBuf> = shards.iter().map(|shard| shard_folder(root.path(), *shard)).collect();
            let out = tempfile::tempdir().unwrap();
            let merged = merge(&folders).unwrap();
            for _ in 0..2 {
                merged.write_to(out.path()).unwrap();
                prop_assert!(read_files(out.path()) == expected);
            }
        });
        // The result is a complete folder of the campaign.
        assert!(campaign.run(single.path(), summary_only(true), &stop_immediately()).is_ok());
    }
}

/// With other methods, evaluations and failures are sums, in any order, and the summary names missing parts.
#[test]
fn merged_shards_form_one_campaign_and_list_missing_shards() {
    let (campaign, root) = (campaign(Method::Auto, 5), tempfile::tempdir().unwrap());
    run_all_shards(&campaign, root.path());
    let single = run_unsharded(&campaign);
    let one = merge(&[shard_folder(root.path(), ShardId::new(1, 1).unwrap())]).unwrap();
    let out = tempfile::tempdir().unwrap();
    one.write_to(out.path()).unwrap();
    assert!(read_files(out.path()) == read_files(single.path()), "shard 1/1 is the campaign");
    let of_one = one.summary().unwrap();
    proptest!(crumple_cases::with_cases(2), |(shards in divisions(), keep in 1..20_usize)| {
        let mut parts = shards.clone();
        parts.truncate(keep);
        let folders: Vec<PathBuf> = parts.iter().map(|shard| shard_folder(root.path(), *shard)).collect();
        let merged = merge(&folders).unwrap();
        let summary = merged.summary().unwrap();
        let missing: u64 = merged.missing_ranges().iter().map(|range| range.end - range.start).sum();
        let made = BUDGET - missing;
        prop_assert!(summary.methods.iter().all(|method| method.evaluations == made));
        let mut sorted = parts.clone();
        sorted.sort_by_key(|shard| shard.range(BUDGET, "").unwrap().start);
        sorted.dedup();
        let alone = |shard: &ShardId| -> CampaignSummary {
            self::merge(&[shard_folder(root.path(), *shard)]).unwrap().summary().unwrap()
        };
        let alone: Vec<CampaignSummary> = sorted.iter().map(alone).collect();
        for (place, method) in summary.methods.iter().enumerate() {
            prop_assert_eq!(method.failures, alone.iter().map(|one| one.methods[place].failures).sum::<u64>());
            let best = alone.iter().filter_map(|one| one.methods[place].best_robustness).fold(f64::INFINITY, f64::min);
            prop_assert_eq!(method.best_robustness, Some(best));
        }
        prop_assert_eq!(summary.failures.iter().map(|kind| kind.count).sum::<u64>(),
            summary.methods.iter().map(|method| method.failures).sum::<u64>());
        // No failure of any shard dominates one on the front.
        for found in alone.iter().flat_map(|one| &one.front) {
            let key = |p: &super::super::FrontPoint| (-p.robustness, p.ln_likelihood, -p.distance_from_nominal);
            let is_dominated = summary.front.iter().any(|kept| {
                key(found).0 > key(kept).0 && (key(found).1, key(found).2) > (key(kept).1, key(kept).2)
            });
            prop_assert!(!is_dominated);
            prop_assert!(summary.front.contains(found) || summary.front.iter().any(|kept| key(kept).0 >= key(found).0));
        }
        let divided = summary.sharding.clone();
        prop_assert_eq!(divided.is_some(), sorted.len() > 1 || missing > 0);
        if missing == 0 {
            prop_assert_eq!(&summary.methods[1..], &of_one.methods[1..]);
            prop_assert_eq!(&summary.regions, &of_one.regions);
        }
        // Another order and duplicates give the same folder.
        let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        merged.write_to(here.path()).unwrap();
        let again: Vec<PathBuf> = folders.iter().rev().chain(&folders).cloned().collect();
        self::merge(&again).unwrap().write_to(there.path()).unwrap();
        prop_assert!(read_files(here.path()) == read_files(there.path()));
        for found in &summary.counterexamples {
            prop_assert!(here.path().join(&found.file).is_file() && here.path().join(&found.original_file).is_file());
        }
    });
}

#[test]
fn shards_of_other_campaigns_and_damaged_ones_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let make = |campaign: &Campaign, index, of, name: &str| {
        let folder = root.path().join(name);
        campaign.run_shard(ShardId::new(index, of).unwrap(), &folder, false, &Quiet).unwrap();
        folder
    };
    let own = campaign(Method::Halton, 1);
    let a = make(&own, 1, 2, "a");
    let refused = |other: &PathBuf| merge(&[a.clone(), other.clone()]).unwrap_err().to_string();
    let b = make(&campaign(Method::Halton, 2), 2, 2, "b");
    assert!(refused(&b).ends_with("campaign.seed differs"), "{}", refused(&b));
    let c = make(&own, 1, 3, "c");
    assert!(refused(&c).contains("shard 1/3 repeats work of shard 1/2"), "{}", refused(&c));
    let error = own.run_shard(ShardId::new(1, BUDGET as u32 + 1).unwrap(), &root.path().join("x"), false, &Quiet);
    assert!(error.unwrap_err().to_string().contains("there are 40 evaluations of each method"));
    // Any change of a file is detected, and the error names the file.
    let d = make(&own, 2, 2, "d");
    for name in ["shard.json", "findings.json", "work.json"] {
        let path = d.join(name);
        let genuine = fs::read(&path).unwrap();
        for place in (0..genuine.len()).step_by(1 + genuine.len() / 40) {
            let mut changed = genuine.clone();
            changed[place] ^= 1;
            fs::write(&path, changed).unwrap();
            let error = refused(&d);
            assert!(error.contains(name) || name == "work.json", "{error}");
        }
        fs::write(&path, genuine).unwrap();
    }
    assert!(merge(&[a.clone(), d]).is_ok());
}

/// A shard that is interrupted at any time ends with the same bytes, in four files.
#[test]
fn an_interrupted_shard_ends_with_the_same_files() {
    let (campaign, root) = (campaign(Method::CmaEs, 6), tempfile::tempdir().unwrap());
    let shard = ShardId::new(2, 3).unwrap();
    let [whole, part] = ["whole", "part"].map(|name| root.path().join(name));
    campaign.run_shard(shard, &whole, false, &Quiet).unwrap();
    assert_eq!(read_files(&whole).len(), 4, "{:?}", read_files(&whole).keys());
    for most in [0, 1, 2, 5, 7, 100] {
        let reports = AtomicU64::new(0);
        let ended = campaign.run_shard(shard, &part, true, &|_: &CampaignProgress| {
            if reports.fetch_add(1, Relaxed) < most { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        assert!(matches!(ended, Err(CampaignError::Stopped(_))) == (most < 100), "{most}: {ended:?}");
    }
    assert!(read_files(&part) == read_files(&whole));
}

/// A merge into the folder of the interrupted campaign replaces it.
#[test]
fn shards_are_put_together_over_a_campaign_that_was_broken_off() {
    let (campaign, root) = (campaign(Method::Halton, 6), tempfile::tempdir().unwrap());
    let shards = [1, 2].map(|index| ShardId::new(index, 2).unwrap());
    for shard in shards {
        campaign.run_shard(shard, &shard_folder(root.path(), shard), false, &Quiet).unwrap();
    }
    let broken_off = root.path().join("broken-off");
    let ended = campaign.run(&broken_off, summary_only(false), &stop_immediately());
    assert!(matches!(ended, Err(CampaignError::Stopped(_))) && broken_off.join("evaluations.journal").exists());
    merge(&shards.map(|shard| shard_folder(root.path(), shard))).unwrap().write_to(&broken_off).unwrap();
    assert!(read_files(&broken_off) == read_files(run_unsharded(&campaign).path()));
}

/// Impossible findings are refused, although files and manifest are consistent.
#[test]
fn findings_that_cannot_be_are_refused() {
    let campaign = campaign(Method::Halton, 4);
    let root = tempfile::tempdir().unwrap();
    let shard = ShardId::new(1, 2).unwrap();
    type FindingsMutation = fn(&mut Value);
    let changes: [(FindingsMutation, &str); 11] = [
        (|_| (), ""),
        (|found| found["examined"] = json!([]), "examined: differ from the failures"),
        (|found| drop(found["examined"].as_array_mut().unwrap().pop()), "examined: differ from the failures"),
        (|found| found["examined"][0]["values"][0] = json!(1e9), "is not a failure, or belongs to another space"),
        (
            |found| found["kinds"][0]["severest"]["values"][0] = json!(1e9),
            "kinds: contain failures of another campaign",
        ),
        (|found| found["front"][0]["values"][0] = json!(-1e9), "front: contains failures of another campaign"),
        (|found| found["front"] = json!([]), "front: contains failures of another campaign"),
        (
            |found| {
                let first = found["kinds"][0]["by_method"][0].clone();
                let most = json!([first[0], u64::MAX, first[2]]);
                found["kinds"][0]["by_method"] = json!([first, most, most]);
            },
            "kinds: counts are inconsistent with this part",
        ),
        (
            |found| found["methods"][0]["failures"] = json!(found["methods"][0]["failures"].as_u64().unwrap() + 1),
            "kinds: differ from the failures that",
        ),
        (
            |found| {
                let doubled = found["kinds"][0].clone();
                found["kinds"].as_array_mut().unwrap().push(doubled);
            },
            "kinds: a kind is listed twice",
        ),
        (|found| found["methods"][0]["evaluations"] = json!(u64::MAX), "methods: inconsistent with this part"),
    ];
    let genuine = root.path().join("genuine");
    campaign.run_shard(shard, &genuine, false, &Quiet).unwrap();
    for (place, (change, text)) in changes.into_iter().enumerate() {
        let folder = root.path().join(place.to_string());
        for (path, bytes) in read_files(&genuine) {
            let path = folder.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, bytes).unwrap();
        }
        let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
        let mut findings: Value = serde_json::from_str(&read("findings.json")).unwrap();
        change(&mut findings);
        let sharded: ShardedCampaign = serde_json::from_str(&read("shard.json")).unwrap();
        let work = open_shard(&sharded, shard, &folder, true).unwrap();
        work.write("findings.json", findings.to_string()).unwrap();
        work.finish().unwrap();
        drop(work);
        match merge(&[folder]) {
            Ok(_) => assert_eq!(text, ""),
            Err(error) => assert!(!text.is_empty() && error.to_string().contains(text), "{place}: {error}"),
        }
    }
}
