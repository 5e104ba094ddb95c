//! Writes shards of `crumple verify rate --shard` with invented results, to measure the cost of merging many shards.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- synthetic_campaign /dev/shm/campaign 1000000000 10000
//! time crumple merge /dev/shm/campaign/shards/* --out /dev/shm/campaign/rate
//! ```
//!
//! `crumple check --rerun` rejects the resulting certificate, as it does every invented count.

use std::path::Path;

use crate::ExperimentError;
use crumple_core::digest::sha256;
use crumple_evidence::{COUNT_SHARD_KIND, CountedBlock, RateConfig, RatePlan};
use crumple_store::run_folder::{RunFolder, RunFolderOptions};
use crumple_store::shard::ShardId;
use crumple_world::control::ControllerSpec;
use crumple_world::scenario::space::built_in_space;
use rayon::prelude::*;

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let [folder, runs, shards] = arguments else {
        return Err(format!("{} arguments, and there must be three", arguments.len()).into());
    };
    let controller = ControllerSpec::from_name("idm").ok_or("no such controller")?;
    let plan = RatePlan::new(RateConfig {
        confidence: 0.999,
        ..RateConfig::new(controller, built_in_space("paper").ok_or("no such space")?, runs.parse()?)
    })?;
    let (of, root) = (shards.parse()?, Path::new(folder).join("shards"));
    (1..=of)
        .into_par_iter()
        .try_for_each(|index| write_shard(&plan, ShardId::new(index, of)?, &root.join(index.to_string())))
}

/// Writes a shard with a failure in every hundredth block.
fn write_shard(plan: &RatePlan, shard: ShardId, folder: &Path) -> Result<(), ExperimentError> {
    let says = serde_json::json!({ "version": 1, "shard": shard, "count": plan.record() });
    let configuration = serde_json::to_string_pretty(&says)? + "\n";
    let asked = RunFolderOptions {
        kind: COUNT_SHARD_KIND,
        configuration: &configuration,
        configuration_file: "shard.json",
        resume: false,
        outputs: &["shard.json", "progress.json"],
    };
    let mut tally = plan.empty_tally();
    for block in plan.shard_blocks(shard)? {
        let (runs, failures) = (plan.run_range(block), u64::from(block % 100 == 0));
        tally.runs += runs.end - runs.start;
        tally.failures += failures;
        let sha256 = sha256(format!("invented {block}"));
        tally.blocks.push(CountedBlock { failures, sha256, ..CountedBlock::default() });
    }
    let work = RunFolder::open(folder, asked)?;
    let progress = serde_json::to_string_pretty(&tally)? + "\n";
    work.transaction().write("shard.json", configuration.clone()).write("progress.json", progress).commit()?;
    Ok(work.finish()?)
}
