//! Arguments that several subcommands share, such as scenarios and controllers.

use std::collections::HashSet;
use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use super::{CliError, output};
use crumple_controllers::Controllers;
use crumple_controllers::find_for_user;
use crumple_measure::Specification;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{
    NamedController, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, Scenario, built_in_scenario, built_in_scenario_names, file};
use crumple_spaces::built_in_space;
use crumple_spaces::{ScenarioSpace, find_space};

/// Returns the built-in scenario that an argument names.
pub(super) fn find_built_in_scenario(name: &Path) -> Option<Scenario> {
    built_in_scenario(name.to_str()?)
}

fn unknown_scenario(path: &Path) -> CliError {
    let name = path.display();
    if path
        .to_str()
        .is_some_and(|name| built_in_space(name).is_some())
    {
        return CliError::Input(format!(
            "`{name}` is a scenario space: `crumple falsify --space {name}` searches it, and `crumple verify rate \
             --space {name}` simulates random scenarios of it"
        ));
    }
    let names: Vec<_> = built_in_scenario_names()
        .iter()
        .map(|(name, _)| *name)
        .collect();
    CliError::Input(format!(
        "`{name}` is neither a built-in scenario ({}) nor a file",
        names.join(", ")
    ))
}

/// Returns a built-in scenario, or loads one from a file, whose name may be any bytes.
pub(super) fn load_scenario(path: &Path, controllers: Controllers) -> Result<Scenario, CliError> {
    if let Some(scenario) = find_built_in_scenario(path) {
        return Ok(scenario);
    }
    if path.extension().is_none() && !path.exists() {
        return Err(unknown_scenario(path));
    }
    let scenario = file::load(path, &controllers)?;
    // Start the programs that drive in the scenario once, so that a missing one is an error of the scenario. Without
    // --allow-external, loading has refused them already.
    for (index, vehicle) in scenario.vehicles().iter().enumerate() {
        if let Driver::File(driver) = &vehicle.driver
            && let Some(controller) = driver.controller()
        {
            let named = NamedController {
                name: driver.path().to_owned(),
                source: controller.clone(),
            };
            named.try_start().map_err(|error| {
                CliError::Input(format!(
                    "{}: vehicles[{index}].driver: {error}",
                    path.display()
                ))
            })?;
            remember(named);
        }
    }
    Ok(scenario)
}

/// Returns a parser of whole numbers in a range, for clap.
pub(super) fn whole_number<T: TryFrom<u64>>(
    range: RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |words| {
        let number = words.parse().ok().filter(|number| range.contains(number));
        let converted = number.and_then(|number| T::try_from(number).ok());
        converted.ok_or_else(|| {
            format!(
                "must be a whole number from {} to {}",
                range.start(),
                range.end()
            )
        })
    }
}

/// Parses a number, for clap. Commands check its range.
pub(super) fn number(words: &str) -> Result<f64, String> {
    words.parse().map_err(|_| "must be a number".to_owned())
}

/// Parses a specification of runs like `nominal`. Warns if a formula is evaluated at the first instant only.
pub(super) fn parse_specification(
    text: &str,
    nominal: &Scenario,
    quiet: bool,
) -> Result<Specification, CliError> {
    let read = Specification::parse(text, nominal)
        .map_err(|error| CliError::Input(format!("--spec: {error}")))?;
    note_warning(&read, quiet);
    Ok(read)
}

/// Prints the warning of a specification, if it has one.
pub(super) fn note_warning(specification: &Specification, quiet: bool) {
    if let Some(warning) = specification.warning() {
        output::note(&format!("warning: --spec: {warning}"), quiet);
    }
}

/// An error of an argument for clap. Its sources determine the exit code.
pub(super) type ArgumentError = Box<dyn std::error::Error + Send + Sync>;

/// Finds a built-in scenario space or loads one from a file.
///
/// # Errors
/// [`CliError`] names the option.
pub(super) fn load_space(
    option: &str,
    name_or_path: &str,
    controllers: Controllers,
) -> Result<ScenarioSpace, CliError> {
    if name_or_path.trim().is_empty() {
        return Err(CliError::Input(format!(
            "{option}: the name of the scenario space is empty"
        )));
    }
    find_space(name_or_path, &controllers).map_err(|error| CliError::about(option, error))
}

/// Parses the name of a scenario space and its weight, 1 by default: `traffic`, or `wet.toml=0.2`.
pub(super) fn parse_weighted_name(words: &str) -> Result<(String, f64), String> {
    let (space, weight) = match words.rsplit_once('=') {
        Some((_, "")) => return Err("the weight after `=` is missing".to_owned()),
        Some((space, weight)) => (
            space,
            weight
                .parse()
                .map_err(|_| format!("`{weight}` is not a weight"))?,
        ),
        None => (words, 1.0),
    };
    if space.trim().is_empty() {
        return Err("the name of the scenario space is empty".to_owned());
    }
    Ok((space.to_owned(), weight))
}

/// Finds a built-in controller or loads one from a file, for clap. Starts no program: [`try_controllers`] does.
pub(super) fn parse_controller(name: &str) -> Result<NamedController, ArgumentError> {
    let controller = find_for_user(name, Path::new(""))?;
    remember(controller.clone());
    Ok(controller)
}

fn remember(controller: NamedController) {
    NAMED_CONTROLLERS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push(controller);
}

fn named_controllers() -> Vec<NamedController> {
    NAMED_CONTROLLERS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clone()
}

/// Fails if a controller that an argument or a scenario names contradicted itself or can no longer be started. Call
/// before results are written or printed.
///
/// # Errors
/// [`CliError::Input`] names the controller.
pub(super) fn ensure_trusted() -> Result<(), CliError> {
    named_controllers()
        .iter()
        .try_for_each(|controller| Ok(controller.ensure_trusted()?))
}

/// Ends the programs of all named controllers. Call at the end: a static variable is never dropped.
pub(super) fn release_controllers() {
    NAMED_CONTROLLERS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clear();
}

/// Loads a policy in crumple's own format, built in or from a file.
pub(super) fn parse_own_policy(name: &str) -> Result<NamedController, ArgumentError> {
    let usable = "use `policy`, `retrained`, `road`, or a policy file that `crumple train` wrote";
    match parse_controller(name) {
        Ok(controller)
            if controller.policy().is_some() && controller.source.as_shield().is_none() =>
        {
            Ok(controller)
        }
        Ok(_) => Err(format!("`{name}` cannot be retrained: {usable}").into()),
        Err(_) if !Path::new(name).exists() => {
            Err(format!("there is no policy `{name}`: {usable}").into())
        }
        Err(error) => Err(error),
    }
}

/// Controllers that arguments and scenarios name. Those of arguments start only after all arguments are read.
static NAMED_CONTROLLERS: Mutex<Vec<NamedController>> = Mutex::new(Vec::new());

/// Returns warnings about a controller, one per line.
pub(super) fn controller_notes(controller: &NamedController) -> impl Iterator<Item = String> {
    let name = controller.name.clone();
    controller
        .source
        .warnings()
        .into_iter()
        .map(move |doubt| format!("note: {name}: {doubt}"))
}

/// Starts the program of each controller that an argument names, as a trial, and prints warnings about controllers.
///
/// # Errors
/// [`CliError::Input`] for a program that does not start or fails the handshake.
pub(super) fn try_controllers(quiet: bool) -> Result<(), CliError> {
    let mut named = named_controllers();
    let mut names = HashSet::new();
    named.retain(|controller| names.insert(controller.name.clone()));
    for controller in &named {
        controller.try_start().map_err(|error| {
            CliError::Input(format!("controller `{}`: {error}", controller.name))
        })?;
    }
    named
        .iter()
        .flat_map(controller_notes)
        .for_each(|note| output::note(&note, quiet));
    Ok(())
}

/// Simulates a scenario in which only scripts and fixed controllers drive.
pub(super) fn replay(scenario: &Scenario) -> Result<SimulationResult, CliError> {
    let run = Run::new(
        scenario,
        RunOptions::new(BuiltInController::MatchLeader(Default::default()))
            .with_estimator(EstimatorKind::Truth),
    )?;
    Ok(simulate(&run, RecordingLevel::Trace))
}
