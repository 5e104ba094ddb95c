//! Catalog of the scenarios, controllers, campaigns, recordings and suites that requests may name.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use crumple_controllers::Controllers;
use crumple_exchange::recording::RecordingError;
use crumple_exchange::recording::map::RecordingMap;
use crumple_search::falsify::campaign::{CampaignError, CampaignReader};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{
    Driver, FileDriver, InvalidField, Scenario, ScenarioSpec, built_in_scenario,
    built_in_scenario_names,
};
use crumple_suites::TestSuite;

use crate::campaign::CatalogCampaign;
use crate::error::RequestError;
use crate::recording::CatalogRecording;
use crate::suite::SuiteResults;

/// Configuration of the application.
#[derive(Debug, Default)]
pub struct ExploreConfig {
    /// Initial scenarios, the first of which is shown; the built-in ones follow.
    pub scenarios: Vec<CatalogScenario>,
    /// Initial controllers in the order of display; the built-in ones can be added.
    pub controllers: Vec<NamedController>,
    /// Initial estimator of the vehicles under test.
    pub estimator: EstimatorKind,
    /// Folders of complete campaigns.
    pub campaigns: Vec<PathBuf>,
    /// Recordings.
    pub recordings: Vec<PathBuf>,
    /// Meanings of the columns of the recordings; none for the formats that crumple recognises.
    pub recording_map: Option<RecordingMap>,
    /// Suites of tests.
    pub suites: Vec<CatalogSuite>,
    /// Opens the drivers that scenarios of campaigns name as files.
    pub controllers_of_files: Controllers,
}

/// Everything that requests may name, including the built-in items.
#[derive(Debug)]
pub(crate) struct Catalog {
    pub(crate) scenarios: Vec<CatalogScenario>,
    pub(crate) controllers: Vec<NamedController>,
    pub(crate) selected_controllers: usize,
    pub(crate) estimator: EstimatorKind,
    pub(crate) campaigns: Vec<CatalogCampaign>,
    pub(crate) recordings: Vec<CatalogRecording>,
    pub(crate) suites: Vec<CatalogSuite>,
    pub(crate) suite_results: SuiteResults,
    /// Drivers from files in opened scenarios of campaigns.
    opened_drivers: Mutex<Vec<FileDriver>>,
}

const DEFAULT_CONTROLLER: &str = "baseline";

/// Scenario with its name in lists.
#[derive(Debug, Clone)]
pub struct CatalogScenario {
    /// Built-in name, or path as given.
    pub name: String,
    /// The scenario.
    pub scenario: Scenario,
}

/// Suite with its name in lists.
#[derive(Debug, Clone)]
pub struct CatalogSuite {
    /// Built-in name, or path as given.
    pub name: String,
    /// The suite.
    pub suite: TestSuite,
}

/// Reason why a configuration is invalid.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExploreConfigError {
    /// There are more controllers than can be compared.
    #[error("--controller: at most {most} can be compared, found {found}", most = ExploreConfig::MAX_CONTROLLERS)]
    TooManyControllers {
        /// Number of controllers.
        found: usize,
    },
    /// Two controllers have the same name.
    #[error("--controller: `{name}` is given twice")]
    DuplicateController {
        /// Name of both.
        name: String,
    },
    /// A campaign cannot be read.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// A recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

impl ExploreConfig {
    pub(crate) const MAX_CONTROLLERS: usize = 4;

    /// Adds everything built in and checks the configuration.
    pub(crate) fn into_catalog(self) -> Result<Catalog, ExploreConfigError> {
        let Self {
            mut scenarios,
            mut controllers,
            estimator,
            campaigns,
            recordings,
            recording_map,
            suites,
            controllers_of_files,
        } = self;
        check_compared_controllers(&controllers)?;
        let campaigns = open_campaigns(campaigns, controllers_of_files)?;
        let recordings = recordings
            .iter()
            .map(|path| CatalogRecording::read(path, recording_map.as_ref()))
            .collect::<Result<Vec<_>, RecordingError>>()?;
        if controllers.is_empty() {
            controllers.extend(
                BuiltInController::from_name(DEFAULT_CONTROLLER).map(NamedController::from),
            );
        }
        let selected_controllers = controllers.len();
        add_built_in_scenarios(&mut scenarios);
        add_built_in_controllers(&mut controllers, &campaigns);
        Ok(Catalog {
            scenarios,
            controllers,
            selected_controllers,
            estimator,
            campaigns,
            recordings,
            suites,
            suite_results: SuiteResults::default(),
            opened_drivers: Mutex::default(),
        })
    }
}

fn open_campaigns(
    folders: Vec<PathBuf>,
    controllers_of_files: Controllers,
) -> Result<Vec<CatalogCampaign>, CampaignError> {
    let open = |folder: PathBuf| {
        Ok(CatalogCampaign {
            name: folder.display().to_string(),
            reader: CampaignReader::open(&folder, controllers_of_files)?,
        })
    };
    folders.into_iter().map(open).collect()
}

/// Checks that there are few enough controllers to compare, and that their names differ.
fn check_compared_controllers(controllers: &[NamedController]) -> Result<(), ExploreConfigError> {
    if controllers.len() > ExploreConfig::MAX_CONTROLLERS {
        return Err(ExploreConfigError::TooManyControllers {
            found: controllers.len(),
        });
    }
    for (index, controller) in controllers.iter().enumerate() {
        if has_controller(controllers.iter().take(index), &controller.name) {
            return Err(ExploreConfigError::DuplicateController {
                name: controller.name.clone(),
            });
        }
    }
    Ok(())
}

fn has_controller<'c>(
    controllers: impl IntoIterator<Item = &'c NamedController>,
    name: &str,
) -> bool {
    controllers
        .into_iter()
        .any(|controller| controller.name == name)
}

fn add_built_in_scenarios(scenarios: &mut Vec<CatalogScenario>) {
    for (name, _) in built_in_scenario_names() {
        let is_listed = scenarios.iter().any(|listed| listed.name == *name);
        if let (Some(scenario), false) = (built_in_scenario(name), is_listed) {
            scenarios.push(CatalogScenario {
                name: (*name).to_owned(),
                scenario,
            });
        }
    }
}

/// Adds all built-in controllers, and those of the campaigns. A campaign must not add a command or file to the catalog.
fn add_built_in_controllers(controllers: &mut Vec<NamedController>, campaigns: &[CatalogCampaign]) {
    for built_in in BuiltInController::all()
        .into_iter()
        .map(NamedController::from)
    {
        if !has_controller(&*controllers, &built_in.name) {
            controllers.push(built_in);
        }
    }
    for campaign in campaigns {
        let name = campaign.reader.controller();
        if let (false, Some(Ok(spec))) = (
            has_controller(&*controllers, name),
            BuiltInController::parse(name),
        ) {
            controllers.push(spec.into());
        }
    }
}

impl Catalog {
    pub(crate) fn find_controllers(
        &self,
        names: &[String],
    ) -> Result<Vec<&NamedController>, RequestError> {
        if !(1..=ExploreConfig::MAX_CONTROLLERS).contains(&names.len()) {
            let problem = format!(
                "must name 1 to {} controllers, found {}",
                ExploreConfig::MAX_CONTROLLERS,
                names.len()
            );
            return Err(RequestError::invalid("controllers", problem));
        }
        names
            .iter()
            .enumerate()
            .map(|(index, name)| {
                self.controllers
                    .iter()
                    .find(|controller| controller.name == *name)
                    .ok_or_else(|| {
                        RequestError::invalid(
                            format!("controllers[{index}]"),
                            format!("`{name}` is not available: start crumple with --controller"),
                        )
                    })
            })
            .collect()
    }

    /// Registers the drivers from files in a scenario of a campaign, so that later requests with this scenario may name
    /// them.
    pub(crate) fn register_drivers(&self, scenario: &Scenario) {
        let mut opened = self
            .opened_drivers
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        for driver in file_drivers(scenario) {
            if !opened.contains(driver) {
                opened.push(driver.clone());
            }
        }
    }

    /// Replaces each driver that a scenario names by file with the same driver of a known scenario. No file is opened,
    /// so a page cannot make the server read one.
    pub(crate) fn resolve_drivers(&self, spec: &mut ScenarioSpec) -> Result<(), RequestError> {
        let opened = self
            .opened_drivers
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let listed = self
            .scenarios
            .iter()
            .flat_map(|listed| file_drivers(&listed.scenario));
        let allowed: Vec<&FileDriver> = listed.chain(opened.iter()).collect();
        for (index, vehicle) in spec.vehicles.iter_mut().enumerate() {
            if let Driver::File(file) = &mut vehicle.driver {
                let driver = allowed
                    .iter()
                    .find(|driver| **driver == file)
                    .ok_or_else(|| {
                        let field = format!("scenario.vehicles[{index}].driver.file.path");
                        let problem = "only the drivers of scenarios that were given at the start are allowed";
                        RequestError::invalid(field, problem)
                    })?;
                *file = (*driver).clone();
            }
        }
        Ok(())
    }
}

/// Returns the item at an index. The error names `field`, the field of the request with the index.
pub(crate) fn find<'a, T>(
    items: &'a [T],
    index: usize,
    field: &str,
    noun: &str,
) -> Result<&'a T, RequestError> {
    items
        .get(index)
        .ok_or_else(|| RequestError::invalid(field, format!("there are {} {noun}", items.len())))
}

fn file_drivers(scenario: &Scenario) -> impl Iterator<Item = &FileDriver> {
    scenario
        .vehicles()
        .iter()
        .filter_map(|vehicle| match &vehicle.driver {
            Driver::File(file) => Some(file),
            _ => None,
        })
}

/// Converts the error of a scenario in a request; prefixes its field.
pub(crate) fn scenario_error(invalid: InvalidField) -> RequestError {
    RequestError::invalid(format!("scenario.{}", invalid.field), invalid.problem)
}
