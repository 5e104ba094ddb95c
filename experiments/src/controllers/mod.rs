//! Compares all controllers in one table: `reports/controllers.md`.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- controllers target/controllers recordings=FOLDER > controllers.md
//! ```
//! The first argument is a folder of finished rows. A second run of the same build computes only the missing ones.
//! FOLDER has the recordings of `examples/studies/openacc/files.sha256`; without it, the columns of recorded drives say
//! "not counted". `draws=N` sets the random scenarios with each kind of follower (default 1000), and `controller=NAME`,
//! which may be repeated, replaces the list of controllers.

mod drives;
mod page;
mod row;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::time::Instant;

use self::drives::ImportedDrives;
use self::row::{ControllerRow, RowConfig};
use crate::ExperimentError;
use crumple::controllers::find_and_try;
use crumple::sim::control::{BuiltInController, Role};
use crumple::sim::engine::NamedController;
use crumple_core::digest::sha256;
use crumple_store::{disk, program};

/// Settings of Autoware's emergency brake: the values of its documentation, which differ from those of its parameter
/// file (offset 2 m, deceleration of the object 3 m/s²), and two stop margins and the response time that users of
/// Autoware discuss for its cruise planner (autoware_launch, pull request 1166: 4 or 6 m, 2 s).
const AUTOWARE: [&str; 4] = [
    "autoware-aeb,object_brake_mps2=3,offset_m=2",
    "autoware-aeb,offset_m=4",
    "autoware-aeb,offset_m=6",
    "autoware-aeb,response_s=2",
];

const DEFAULT_DRAWS: u64 = 1000;
const MAX_DRAWS: u64 = 1_000_000;
/// Largest file of a row, in bytes.
const MAX_ROW_BYTES: u64 = 1 << 20;

/// Arguments of the command.
struct TableArgs {
    /// Folder of finished rows.
    work: PathBuf,
    draws: u64,
    recordings: Option<PathBuf>,
    controllers: Vec<String>,
}

impl TableArgs {
    fn parse(arguments: &[String]) -> Result<Self, ExperimentError> {
        let [work, options @ ..] = arguments else {
            return Err("name a folder for the rows".into());
        };
        let mut parsed = Self {
            work: work.into(),
            draws: DEFAULT_DRAWS,
            recordings: None,
            controllers: Vec::new(),
        };
        for option in options {
            match option.split_once('=') {
                Some(("draws", number)) => parsed.draws = parse_draws(number)?,
                Some(("recordings", folder)) => parsed.recordings = Some(folder.into()),
                Some(("controller", name)) => parsed.controllers.push(name.to_owned()),
                _ => return Err(format!("`{option}` is no option").into()),
            }
        }
        if parsed.controllers.is_empty() {
            parsed.controllers = compared_controllers();
        }
        Ok(parsed)
    }
}

fn parse_draws(number: &str) -> Result<u64, ExperimentError> {
    match number.parse() {
        Ok(draws) if (1..=MAX_DRAWS).contains(&draws) => Ok(draws),
        _ => Err(format!("`{number}` is no number of draws from 1 to {MAX_DRAWS}").into()),
    }
}

/// Returns the names of the compared controllers: all built-in ones that drive, learned ones also behind the shields,
/// Autoware's brake with other settings, and the brakes and cruise controls of cars.
fn compared_controllers() -> Vec<String> {
    let built_in = BuiltInController::all_that_drive();
    let names = built_in.iter().map(|controller| controller.name());
    let mut names: Vec<String> = names.map(str::to_owned).collect();
    let learned = built_in
        .iter()
        .filter(|controller| controller.role() == Role::Learned);
    for controller in learned {
        let name = controller.name();
        names.extend(["shield", "shield2"].map(|shield| format!("{shield}:{name}")));
    }
    names.extend(AUTOWARE.map(str::to_owned));
    names.extend(BuiltInController::presets().map(|preset| preset.name.to_owned()));
    names
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let arguments = TableArgs::parse(arguments)?;
    let controllers = arguments
        .controllers
        .iter()
        .map(|name| find_and_try(name, Path::new("")))
        .collect::<Result<Vec<_>, _>>()?;
    let config = RowConfig {
        draws: arguments.draws,
        drives: arguments
            .recordings
            .as_deref()
            .map(ImportedDrives::import)
            .transpose()?,
    };
    disk::make_folder(&arguments.work)?;
    let mut rows = Vec::new();
    for (controller, number) in controllers.iter().zip(1..) {
        let begin = Instant::now();
        rows.push(finished_row(controller, &config, &arguments.work)?);
        let seconds = begin.elapsed().as_secs_f64();
        eprintln!(
            "{number} of {}: {} ({seconds:.0} s)",
            controllers.len(),
            controller.name
        );
    }
    print!("{}", page::render(&rows, &config));
    Ok(())
}

/// Returns the row of a controller: the finished one of this build in a folder, or a new one.
fn finished_row(
    controller: &NamedController,
    config: &RowConfig,
    work: &Path,
) -> Result<ControllerRow, ExperimentError> {
    let Some(identity) = controller.source.identity() else {
        return ControllerRow::measure(controller, config);
    };
    let key = sha256(format!(
        "{} {identity} {}",
        program::identity()?,
        config.identity()
    ));
    let path = work.join(format!("{key}.json"));
    if let Some(bytes) = disk::read(&path, MAX_ROW_BYTES)? {
        let row: ControllerRow = serde_json::from_slice(&bytes)
            .map_err(|error| format!("{}: {error}", path.display()))?;
        return Ok(ControllerRow {
            controller: controller.name.clone(),
            ..row
        });
    }
    let row = ControllerRow::measure(controller, config)?;
    disk::write(&path, serde_json::to_vec_pretty(&row)?)?;
    Ok(row)
}
