//! What the page may speak of: what it was started with, and what is built in.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use crumple_search::falsify::campaign::{CampaignError, CampaignReader};
use crumple_world::control::ControllerSpec;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::{
    Driver, FileDriver, InvalidField, Scenario, ScenarioSpec, built_in_scenario, built_in_scenario_names,
};
use crumple_world::sim::NamedController;

use crate::campaign::CatalogCampaign;
use crate::error::RequestError;

/// What an application is started with.
#[derive(Debug, Default)]
pub struct ExploreConfig {
    /// The scenarios it begins with, the first one shown; the built-in ones follow.
    pub scenarios: Vec<CatalogScenario>,
    /// The controllers it begins with, side by side; the built-in ones can be chosen besides.
    pub controllers: Vec<NamedController>,
    /// What the vehicles under test look through at first.
    pub estimator: EstimatorKind,
    /// The folder in which scenarios are saved; none to have them downloaded only.
    pub save_folder: Option<PathBuf>,
    /// Folders of campaigns, finished or under way.
    pub campaigns: Vec<PathBuf>,
}

/// What is offered, everything built in included.
#[derive(Debug)]
pub(crate) struct Catalog {
    pub(crate) scenarios: Vec<CatalogScenario>,
    pub(crate) controllers: Vec<NamedController>,
    /// How many of the controllers run at first.
    pub(crate) selected_controllers: usize,
    pub(crate) estimator: EstimatorKind,
    pub(crate) save_folder: Option<PathBuf>,
    pub(crate) campaigns: Vec<CatalogCampaign>,
    /// Drivers from files of the scenarios of campaigns that were opened.
    opened_drivers: Mutex<Vec<FileDriver>>,
}

/// Who drives at first where nobody was chosen.
const DEFAULT_CONTROLLER: &str = "baseline";

/// A scenario, and what it is called in a list.
#[derive(Debug, Clone)]
pub struct CatalogScenario {
    /// A built-in name, or the path as it was given.
    pub name: String,
    /// The scenario.
    pub scenario: Scenario,
}

/// Why an application cannot be started with something.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExploreConfigError {
    /// More controllers than can be looked at side by side.
    #[error("--controller: at most {most} can be seen side by side, found {found}", most = ExploreConfig::MAX_CONTROLLERS)]
    TooManyControllers {
        /// How many there are.
        found: usize,
    },
    /// Two controllers of one name.
    #[error("--controller: `{name}` is given twice")]
    DuplicateController {
        /// Its name.
        name: String,
    },
    /// The place for saved scenarios is no folder.
    #[error("{}: there is no such folder to save scenarios in", path.display())]
    SaveFolder {
        /// What was given.
        path: PathBuf,
    },
    /// A campaign that cannot be looked at.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
}

impl ExploreConfig {
    /// Most controllers that run side by side.
    pub(crate) const MAX_CONTROLLERS: usize = 4;

    /// The same with everything built in, if it can be offered.
    pub(crate) fn into_catalog(self) -> Result<Catalog, ExploreConfigError> {
        let Self { mut scenarios, mut controllers, estimator, save_folder: out, campaigns } = self;
        if controllers.len() > Self::MAX_CONTROLLERS {
            return Err(ExploreConfigError::TooManyControllers { found: controllers.len() });
        }
        let names: Vec<&str> = controllers.iter().map(|controller| controller.name.as_str()).collect();
        if let Some(name) = (1..names.len())
            .find_map(|index| names.get(index).filter(|name| names.iter().take(index).any(|known| known == *name)))
        {
            return Err(ExploreConfigError::DuplicateController { name: (*name).to_owned() });
        }
        if let Some(path) = out.as_ref().filter(|path| !path.is_dir()) {
            return Err(ExploreConfigError::SaveFolder { path: path.clone() });
        }
        let campaigns = campaigns
            .into_iter()
            .map(|folder| Ok(CatalogCampaign::new(folder.display().to_string(), CampaignReader::open(&folder)?)));
        let campaigns = campaigns.collect::<Result<Vec<_>, CampaignError>>()?;
        if controllers.is_empty() {
            controllers.extend(ControllerSpec::from_name(DEFAULT_CONTROLLER).map(NamedController::from));
        }
        let chosen = controllers.len();
        for (name, _) in built_in_scenario_names() {
            if let (Some(scenario), false) =
                (built_in_scenario(name), scenarios.iter().any(|offered| offered.name == *name))
            {
                scenarios.push(CatalogScenario { name: (*name).to_owned(), scenario });
            }
        }
        for built_in in ControllerSpec::all().into_iter().map(NamedController::from) {
            if !controllers.iter().any(|offered| offered.name == built_in.name) {
                controllers.push(built_in);
            }
        }
        // A campaign's controller with settings is built in as well. Commands and files it may name are nobody's wish here.
        for campaign in &campaigns {
            let name = campaign.lock_reader().controller().to_owned();
            if let (false, Some(Ok(spec))) =
                (controllers.iter().any(|offered| offered.name == name), ControllerSpec::parse(&name))
            {
                controllers.push(spec.into());
            }
        }
        Ok(Catalog {
            scenarios,
            controllers,
            selected_controllers: chosen,
            estimator,
            save_folder: out,
            campaigns,
            opened_drivers: Mutex::default(),
        })
    }
}

impl Catalog {
    /// The controllers that were offered by these names.
    pub(crate) fn find_controllers(&self, names: &[String]) -> Result<Vec<&NamedController>, RequestError> {
        if !(1..=ExploreConfig::MAX_CONTROLLERS).contains(&names.len()) {
            let problem = format!("1 to {} run side by side, found {}", ExploreConfig::MAX_CONTROLLERS, names.len());
            return Err(RequestError::invalid("controllers", problem));
        }
        let offered = |(index, name): (usize, &String)| {
            let found = self.controllers.iter().find(|offered| offered.name == *name);
            found.ok_or_else(|| {
                RequestError::invalid(
                    format!("controllers[{index}]"),
                    format!("no `{name}` was offered: start with --controller"),
                )
            })
        };
        names.iter().enumerate().map(offered).collect()
    }

    /// Remembers the files that drive in a scenario of a campaign, which the page may send back.
    pub(crate) fn register_drivers(&self, scenario: &Scenario) {
        let mut opened = self.opened_drivers.lock().unwrap_or_else(PoisonError::into_inner);
        for driver in file_drivers(scenario) {
            if !opened.contains(driver) {
                opened.push(driver.clone());
            }
        }
    }

    /// Puts what was read from files in the places where a scenario names the same files. Nothing is read: a page cannot have a file
    /// opened by naming it.
    pub(crate) fn resolve_drivers(&self, spec: &mut ScenarioSpec) -> Result<(), RequestError> {
        let opened = self.opened_drivers.lock().unwrap_or_else(PoisonError::into_inner);
        let offered = self.scenarios.iter().flat_map(|offered| file_drivers(&offered.scenario));
        let known: Vec<&FileDriver> = offered.chain(opened.iter()).collect();
        for (index, vehicle) in spec.vehicles.iter_mut().enumerate() {
            if let Driver::File(file) = &mut vehicle.driver {
                match known.iter().find(|known| **known == file) {
                    Some(known) => *file = (*known).clone(),
                    None => {
                        let field = format!("scenario.vehicles[{index}].driver.file.path");
                        return Err(RequestError::invalid(
                            field,
                            "only files of scenarios that this was started with may drive",
                        ));
                    }
                }
            }
        }
        Ok(())
    }
}

fn file_drivers(scenario: &Scenario) -> impl Iterator<Item = &FileDriver> {
    scenario.vehicles().iter().filter_map(|vehicle| match &vehicle.driver {
        Driver::File(file) => Some(file),
        _ => None,
    })
}

/// The field of a scenario that was sent, as the page knows it.
pub(crate) fn scenario_error(invalid: InvalidField) -> RequestError {
    RequestError::invalid(format!("scenario.{}", invalid.field), invalid.problem)
}
