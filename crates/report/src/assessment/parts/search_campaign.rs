//! The campaign of a failure search, and its files.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::ScenarioCases;
use super::distinct_failure::DistinctFailure;
use crate::assessment::case::{MotionRetention, run_cases};
use crate::assessment::gather_context::GatherContext;
use crate::assessment::{AssessError, AssessmentPlan, CacheError, CrumpleCommand};
use crumple_search::falsify::campaign::{Campaign, CampaignProgress, CampaignSummary};
use crumple_sim::engine::NamedController;
use crumple_sim::scenario::file;
use crumple_store::disk::DiskError;
use crumple_store::study::Study;

const MAX_DRAWN: usize = 3;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::assessment) struct CounterexampleFiles {
    pub(super) counterexample: String,
    pub(super) escape: Option<String>,
}

/// Runs a campaign, or resumes it; returns its summary and the files of its severest failures, which are cached.
pub(super) fn run_campaign(
    campaign: &Campaign,
    (item, inputs): (&str, &Value),
    max_shown: usize,
    work: &GatherContext<'_>,
) -> Result<(CampaignSummary, Vec<CounterexampleFiles>), AssessError> {
    work.get_or_gather(item, inputs, || {
        let folder = work.cache.scratch_folder(item, inputs)?;
        let resume = campaign.controller.source.identity().is_some();
        let done = AtomicU64::new(0);
        let summary = campaign.run(folder.path(), resume, &|progress: &CampaignProgress| {
            let more = progress.evaluations - done.swap(progress.evaluations, Ordering::Relaxed);
            if work.add_runs(more).is_ok() {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        })?;
        let shown = summary.counterexamples.iter().take(max_shown);
        let texts = shown.map(|counterexample| {
            let escape = counterexample.escape_file.as_ref();
            Ok::<_, AssessError>(CounterexampleFiles {
                escape: escape
                    .map(|name| read_file(&folder.path().join(name)))
                    .transpose()?,
                counterexample: read_file(&folder.path().join(&counterexample.file))?,
            })
        });
        let texts = texts.collect::<Result<Vec<_>, _>>()?;
        folder.remove()?;
        Ok((summary, texts))
    })
}

/// Simulates the severest failures for figures.
pub(super) fn simulate_failures(
    plan: &AssessmentPlan,
    controller: &NamedController,
    failures: &[DistinctFailure],
) -> Result<Vec<ScenarioCases>, AssessError> {
    let mut drawn = Vec::new();
    for failure in failures.iter().take(MAX_DRAWN) {
        // A file that a campaign wrote and read back can be read again.
        let Ok(scenario) = file::from_toml(
            &failure.text,
            Path::new(&failure.file),
            &plan.config.controllers_of_files,
        ) else {
            continue;
        };
        // Add the failure's name, to be unique on the page: scenarios are named after their space.
        let named = scenario
            .edited(|spec| spec.name = format!("{} {}", spec.name, failure.short_name()))?;
        let cases = run_cases(
            &[&named],
            std::slice::from_ref(controller),
            plan.config.estimator,
            MotionRetention::Keep,
        )?;
        let replay = CrumpleCommand::new(["simulate", failure.file.as_str()])
            .with_args(plan.estimator_args().iter().copied());
        drawn.extend(
            cases
                .into_iter()
                .map(|cases| ScenarioCases::new(&named, replay.clone(), cases)),
        );
    }
    Ok(drawn)
}

fn read_file(path: &Path) -> Result<String, AssessError> {
    Ok(std::fs::read_to_string(path)
        .map_err(DiskError::at(path))
        .map_err(CacheError::from)?)
}
