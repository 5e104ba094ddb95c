//! Fits `idm` and `acc-aeb` to the production cars of OpenACC: the table of `reports/openacc.md` and the files of
//! `examples/controllers/openacc/`.
//!
//! ```sh
//! python3 examples/studies/openacc/fetch.py recordings
//! cargo run --release -p crumple-experiments -- openacc recordings examples/studies/openacc/files.sha256 controllers
//! ```
//! The arguments are a folder of recordings, their list, and a folder for the fitted controllers. Settings are fitted
//! to the files with an odd number in the list, and the errors are those of the other files. A drive is a car behind a
//! recorded leader for at least 30 s; it starts at the recorded gap and speed, and observes the true state.

mod drives;
mod fit;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crumple_sim::control::BuiltInController;
use rayon::prelude::*;

pub(crate) use self::drives::listed_files;
use self::drives::{DistanceSetting, Drive, Half};
use self::fit::{FAMILIES, FIT_STEP_S, FollowingModel, REPORT_STEP_S, Variant};
use crate::ExperimentError;

const REFERENCE: &str = "idm";

/// The drives of a car in each half. Only drives that follow are fitted.
#[derive(Default)]
struct CarDrives<'d> {
    fit: Vec<&'d Drive>,
    held_out: Vec<&'d Drive>,
}

/// Models of a car, in the order of [`FAMILIES`].
struct FittedCar<'d> {
    car: String,
    drives: CarDrives<'d>,
    models: Vec<FollowingModel>,
    /// Index of the plain model that has the smallest error in the fitted drives.
    chosen: usize,
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let [folder, list, out] = arguments else {
        return Err("name the recordings, their list and a folder".into());
    };
    let list = fs::read_to_string(list).map_err(|error| format!("{list}: {error}"))?;
    let read = drives::read(Path::new(folder), &list)?;
    println!(
        "{} drives; missing: {:?}; gaps differ from speeds by {:.2} m rms in 10 s\n",
        read.drives.len(),
        read.missing,
        rms_drift_m(&read.drives)
    );
    let fitted = group_by_car(&read.drives)
        .into_par_iter()
        .filter(|(_, drives)| !drives.fit.is_empty() && !drives.held_out.is_empty())
        .map(|(car, drives)| FittedCar::new(car, drives))
        .collect::<Result<Vec<_>, _>>()?;
    print_table(&fitted)?;
    fs::create_dir_all(out)?;
    for car in &fitted {
        for setting in DistanceSetting::ALL {
            let file = Path::new(out).join(car.file_name(setting));
            fs::write(file, car.controller_file(setting)?)?;
        }
    }
    Ok(())
}

/// Returns the root mean square of the changes of gaps that speeds do not explain, in metres.
fn rms_drift_m(drives: &[Drive]) -> f64 {
    let drifts_m: Vec<f64> = drives
        .iter()
        .flat_map(|drive| drive.drifts_m.iter().copied())
        .collect();
    let sum_m2: f64 = drifts_m.iter().map(|drift_m| drift_m * drift_m).sum();
    (sum_m2 / drifts_m.len() as f64).sqrt()
}

fn group_by_car(drives: &[Drive]) -> BTreeMap<String, CarDrives<'_>> {
    let mut cars: BTreeMap<String, CarDrives<'_>> = BTreeMap::new();
    for drive in drives {
        let car = cars.entry(drive.source.car.clone()).or_default();
        match drive.source.half {
            Half::Fit if drive.follows() => car.fit.push(drive),
            Half::Fit => {}
            Half::HeldOut => car.held_out.push(drive),
        }
    }
    cars
}

impl<'d> FittedCar<'d> {
    fn new(car: String, drives: CarDrives<'d>) -> Result<Self, ExperimentError> {
        let models = FAMILIES
            .iter()
            .map(|family| family.fit(&drives.fit))
            .collect::<Result<Vec<_>, _>>()?;
        let mut chosen = (0, f64::INFINITY);
        for (index, model) in models.iter().enumerate() {
            let error_m = model.error(&drives.fit, FIT_STEP_S)?.rms_m();
            if FAMILIES[index].variant == Variant::Plain && error_m < chosen.1 {
                chosen = (index, error_m);
            }
        }
        Ok(Self {
            car,
            drives,
            models,
            chosen: chosen.0,
        })
    }

    fn chosen(&self) -> &FollowingModel {
        &self.models[self.chosen]
    }

    /// Returns the row of the table.
    fn row(&self) -> Result<String, ExperimentError> {
        let held_out = &self.drives.held_out;
        let reference = FollowingModel::from_arg(REFERENCE)?;
        let reference_error = reference.error(held_out, REPORT_STEP_S)?;
        let mut row = format!(
            "| {} | {:.0} / {:.0} | {:.1} |",
            self.car,
            reference.error(&self.drives.fit, FIT_STEP_S)?.minutes(),
            reference_error.minutes(),
            reference_error.rms_m(),
        );
        for model in &self.models {
            let error_m = model.error(held_out, REPORT_STEP_S)?.rms_m();
            row += &format!(" {error_m:.1} |");
        }
        let mut following = held_out.clone();
        following.retain(|drive| drive.follows());
        Ok(row
            + &format!(
                " `{}` | {:.2} | {:.2} |",
                FAMILIES[self.chosen].controller,
                self.ratio(held_out)?,
                self.ratio(&following)?,
            ))
    }

    /// Returns the spacing error of the chosen model, relative to that of the reference.
    fn ratio(&self, drives: &[&Drive]) -> Result<f64, ExperimentError> {
        let reference = FollowingModel::from_arg(REFERENCE)?.error(drives, REPORT_STEP_S)?;
        Ok(self.chosen().error(drives, REPORT_STEP_S)?.rms_m() / reference.rms_m())
    }

    fn file_name(&self, setting: DistanceSetting) -> String {
        let car = self.car.to_lowercase().replace('_', "-");
        format!("{car}-{}.toml", setting.name())
    }

    /// Returns the controller file of a distance setting.
    fn controller_file(&self, setting: DistanceSetting) -> Result<String, ExperimentError> {
        let controller = self.chosen().controller(setting);
        Ok(self.comment(setting)? + &controller_toml(controller))
    }

    fn comment(&self, setting: DistanceSetting) -> Result<String, ExperimentError> {
        let mut drives = self.drives.held_out.clone();
        drives.retain(|drive| drive.source.setting == setting);
        let [own, reference] = [self.chosen().clone(), FollowingModel::from_arg(REFERENCE)?]
            .map(|model| model.error(&drives, REPORT_STEP_S));
        let [own, reference] = [own?, reference?];
        Ok(format!(
            "# {} with the {} distance setting, October 2019.\n\
             # Source: recordings of OpenACC's ZalaZONE campaign (Joint Research Centre, doi:10.2905/JRC.KMH3D00).\n\
             # Spacing error in {:.0} minutes of other drives: {:.1} m rms; idm with its defaults: {:.1} m.\n\
             # Fitted by the experiment `openacc`: reports/openacc.md.\n",
            self.car.replace('_', " "),
            setting.name(),
            own.minutes(),
            own.rms_m(),
            reference.rms_m(),
        ))
    }
}

/// Returns a controller file without comments: the settings that differ from their defaults. The text for the command
/// line has no settings if they are those of a model `cruise:...`.
fn controller_toml(controller: &BuiltInController) -> String {
    let name = controller.name();
    let mut text = format!("version = 1\nbuilt_in = \"{name}\"\n\n[settings]\n");
    let default = BuiltInController::from_name(name);
    let defaults = default.iter().flat_map(BuiltInController::values);
    for ((field, value), (_, default)) in controller.values().zip(defaults) {
        if value != default {
            text += &format!("{} = {value}\n", field.name);
        }
    }
    text
}

fn print_table(fitted: &[FittedCar<'_>]) -> Result<(), ExperimentError> {
    println!(
        "| car | minutes | `idm`, defaults | `idm` | `acc-aeb` | `idm`, delays | `acc-aeb`, delays | `idm`, one gap | \
         chosen | ratio | following |\n|---|---|---|---|---|---|---|---|---|---|---|"
    );
    let rows = fitted.par_iter().map(FittedCar::row);
    for row in rows.collect::<Result<Vec<_>, _>>()? {
        println!("{row}");
    }
    let mut collisions = 0;
    for car in fitted {
        let error = car.chosen().error(&car.drives.held_out, REPORT_STEP_S)?;
        collisions += error.collisions;
    }
    println!("\nThe chosen controllers collide in {collisions} held-out drives.");
    Ok(())
}
