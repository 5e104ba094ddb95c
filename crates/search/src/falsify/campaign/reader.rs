//! Read-only view of a finished campaign. Takes no lock and writes nothing, and checks every file by its hash.

use std::path::{Path, PathBuf};

use super::config::CampaignRecord;
use super::resolved_config::ResolvedConfig;
use super::run::{CONFIGURATION_FILE, SUMMARY_FILE};
use super::{Campaign, CampaignError, CampaignSummary, EvaluatedPoint, FailureKind, table};
use crate::falsify::Method;
use crumple_controllers::Controllers;
use crumple_measure::Specification;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Scenario, file};
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::{CompletedRun, RunFolderError};
use crumple_store::study;

/// Maximum number of evaluations that are read, the first ones. Each takes about 400 bytes.
pub const MAX_READ_EVALUATIONS: usize = 200_000;

/// A view of the campaign in a folder.
#[derive(Debug)]
pub struct CampaignReader {
    folder: PathBuf,
    config: ResolvedConfig,
    evaluations: Vec<(Method, EvaluatedPoint)>,
    finished: CompletedRun,
    summary: CampaignSummary,
    controllers: Controllers,
}

impl CampaignReader {
    /// Reads the campaign in a folder. `controllers` opens the drivers that its scenarios name as files.
    ///
    /// # Errors
    /// [`CampaignError`] if there is none, it is incomplete, or it is damaged.
    pub fn open(folder: &Path, controllers: Controllers) -> Result<Self, CampaignError> {
        let finished = study::open_finished::<Campaign>(folder, "crumple falsify")?;
        let damaged =
            |problem: String| RunFolderError::damaged(&folder.join(CONFIGURATION_FILE), problem);
        let summary = CampaignSummary::from_json(&finished.read(SUMMARY_FILE)?)?;
        let record: CampaignRecord =
            toml::from_str(&finished.read_configuration(CONFIGURATION_FILE)?)
                .map_err(|error| damaged(error.message().to_owned()))?;
        let config = ResolvedConfig::from_record(record, controllers).map_err(damaged)?;
        let mut parts = finished.file_names();
        parts.retain(|name| name.starts_with("evaluations/"));
        parts.sort_unstable();
        let mut evaluations = Vec::new();
        for name in parts {
            if evaluations.len() < MAX_READ_EVALUATIONS {
                evaluations.extend(table::decode_part(
                    &name,
                    &finished.read_bytes(&name)?,
                    &config,
                )?);
            }
        }
        evaluations.truncate(MAX_READ_EVALUATIONS);
        Ok(Self {
            folder: folder.to_owned(),
            config,
            controllers,
            evaluations,
            finished,
            summary,
        })
    }

    /// Returns the first evaluations, in the order in which they were made.
    #[must_use]
    pub fn evaluations(&self) -> &[(Method, EvaluatedPoint)] {
        &self.evaluations
    }

    /// Returns the name of the controller under test.
    #[must_use]
    pub fn controller(&self) -> &str {
        &self.config.record.subject.controller
    }

    /// Returns true if a controller is the recorded one: by its name and, where the record states one, its identity.
    #[must_use]
    pub fn is_for_controller(&self, controller: &NamedController) -> bool {
        self.config.record.subject.is_of_controller(controller)
    }

    /// Returns the estimator of the vehicles under test.
    #[must_use]
    pub fn estimator(&self) -> EstimatorKind {
        self.config.record.subject.estimator
    }

    /// Returns the scenario space.
    #[must_use]
    pub fn space(&self) -> &ScenarioSpace {
        &self.config.space
    }

    /// Returns the specification.
    #[must_use]
    pub fn specification(&self) -> &Specification {
        &self.config.specification
    }

    /// Returns the methods in the order in which they run.
    #[must_use]
    pub fn methods(&self) -> Vec<Method> {
        self.config.methods()
    }

    /// Returns the number of evaluations of all methods in the complete campaign.
    #[must_use]
    pub fn total_evaluations(&self) -> u64 {
        self.config
            .record
            .search
            .budget
            .saturating_mul(self.methods().len() as u64)
    }

    /// Returns the summary.
    #[must_use]
    pub fn summary(&self) -> &CampaignSummary {
        &self.summary
    }

    /// Describes the failure of an evaluation; `None` if it did not fail.
    #[must_use]
    pub fn describe_failure(&self, evaluated: &EvaluatedPoint) -> Option<String> {
        let verdict = &evaluated.verdict;
        // A table does not state which controller failed.
        if verdict.robustness == f64::NEG_INFINITY
            && verdict.collision.is_none()
            && verdict.failure.is_none()
        {
            return Some("a controller fails".to_owned());
        }
        FailureKind::from_verdict(verdict, &self.config.specification)
            .map(|kind| kind.describe(&self.config.nominal))
    }

    /// Returns the scenario of these values, with the campaign's noise.
    ///
    /// # Errors
    /// [`CampaignError::Scenario`] for values outside the space.
    pub fn scenario(&self, values: &[f64]) -> Result<Scenario, CampaignError> {
        Ok(self.config.space.scenario(values)?)
    }

    /// Reads the file of a distinct failure, by its index in the summary; `None` if there is no such failure.
    ///
    /// # Errors
    /// [`CampaignError`] if it is not as it was written.
    pub fn counterexample(&self, index: usize) -> Result<Option<Scenario>, CampaignError> {
        let Some(counterexample) = self.summary.counterexamples.get(index) else {
            return Ok(None);
        };
        let text = self.finished.read(&counterexample.file)?;
        let path = self.folder.join(&counterexample.file);
        let scenario = file::from_toml(&text, &path, &self.controllers);
        Ok(Some(scenario.map_err(|error| {
            CampaignError::Encoding(error.to_string())
        })?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falsify::campaign::CampaignProgress;
    use crumple_core::observer::Quiet;
    use crumple_sim::scenario::NoDriverFiles;
    use crumple_store::study::Study;
    use std::fs;
    use std::ops::ControlFlow;

    #[test]
    fn only_complete_and_undamaged_campaigns_are_opened() {
        let campaign = Campaign::of_match_leader("high-risk", Method::Auto, 300, 7);
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("campaign");
        let refused_in = |folder: &Path| {
            CampaignReader::open(folder, Controllers::default())
                .unwrap_err()
                .to_string()
        };
        let refused = || refused_in(&folder);
        assert!(refused_in(parent.path()).ends_with("the folder holds no campaign"));
        let stop = |progress: &CampaignProgress| match progress.evaluations {
            ..200 => ControlFlow::Continue(()),
            _ => ControlFlow::Break(()),
        };
        campaign.run(&folder, false, &stop).unwrap_err();
        assert!(
            refused().contains("the campaign is not complete"),
            "{}",
            refused()
        );
        let summary = campaign.run(&folder, true, &Quiet).unwrap();
        let reader = CampaignReader::open(&folder, Controllers::default()).unwrap();
        assert_eq!(
            (reader.summary(), reader.evaluations().len() as u64),
            (&summary, reader.total_evaluations())
        );
        let failing = |method: &str| {
            let own = reader
                .evaluations()
                .iter()
                .filter(|(searched, _)| searched.name() == method);
            own.filter(|(_, evaluated)| reader.describe_failure(evaluated).is_some())
                .count() as u64
        };
        assert!(
            summary
                .methods
                .iter()
                .all(|method| failing(&method.method) == method.failures)
        );
        for (index, counterexample) in summary.counterexamples.iter().enumerate() {
            let expected = file::load(&folder.join(&counterexample.file), &NoDriverFiles).unwrap();
            assert_eq!(reader.counterexample(index).unwrap(), Some(expected));
        }
        assert!(
            reader
                .counterexample(summary.counterexamples.len())
                .unwrap()
                .is_none()
        );

        let table = fs::read_dir(folder.join("evaluations"))
            .unwrap()
            .next()
            .unwrap()
            .unwrap()
            .path();
        let mut damaged = fs::read(&table).unwrap();
        let middle = damaged.len() / 2;
        damaged[middle] ^= 1;
        fs::write(&table, damaged).unwrap();
        assert!(
            refused().ends_with("has changed since it was written"),
            "{}",
            refused()
        );
    }
}
