//! From recorded episodes to a search space that draws such episodes.
//!
//! [`Sample`] holds the numbers of each episode; [`Fitted`] is the space, with what was chosen and how well it fits. Each number has a
//! family of [`Family::ALL`], the one of the greatest likelihood: all have two parameters, so that Akaike's criterion and
//! Schwarz's agree. What depends on what is a Gaussian copula. [`refitted`] does the same with other values, such as a resample.

mod dependence;
mod episodes;
mod family;
mod goodness;
mod minimum;
mod resample;
#[cfg(test)]
mod tests;

use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;

pub use episodes::{MOST_VEHICLES, Number, Sample, Taken, numbers};
pub use family::{Family, FamilyFit, NoFit};
pub use goodness::{Goodness, Tails};
pub use resample::resampled;

use crumple_world::control::{AebSettings, ControllerSpec};
use crumple_world::scenario::space::{
    Base, Dependence, Distribution, GaussianCopula, InvalidSpace, Observed, ObservedParameter, ParameterSpec,
    SPACE_VERSION, Space, SpaceSpec, Value,
};
use crumple_world::scenario::{
    BrakeToSpeed, Driver, Environment, LeadProfile, SCENARIO_VERSION, ScenarioSpec, Sensors, VehicleClass, VehicleSpec,
};

/// When the leader begins to brake, in seconds: about when it does in an imported episode.
const ONSET_S: f64 = 1.0;
/// How long a scenario goes on when the longest braking that was recorded is over, in seconds, as in an imported episode.
const TAIL_S: f64 = 10.0;
/// Length of the cars, in metres, as of imported ones.
const CAR_LENGTH_M: f64 = 4.5;
/// Episodes for each number that is fitted.
const EPISODES_A_NUMBER: usize = 4;

/// How many episodes are needed for so many numbers.
#[must_use]
pub fn least_episodes(numbers: usize) -> usize {
    EPISODES_A_NUMBER * numbers
}

/// Why no space can be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// More or fewer vehicles than can be fitted.
    #[error("vehicles: must be from 2 to {MOST_VEHICLES}, found {found}")]
    Vehicles {
        /// What was asked for.
        found: usize,
    },
    /// Too few episodes.
    #[error(
        "{found} episodes of {vehicles} vehicles, and {needed} are needed; {shorter} have fewer vehicles, {outside} have numbers that no \
         scenario of such a space may have{most}"
    )]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
        /// Vehicles of an episode.
        vehicles: usize,
        /// How many have fewer vehicles.
        shorter: usize,
        /// How many are not described by the space.
        outside: usize,
        /// By which number most of these, in words.
        most: String,
    },
    /// More than a space may keep.
    #[error("{found} {what}: at most {most} can be fitted")]
    TooMany {
        /// How many there are.
        found: usize,
        /// How many there may be.
        most: usize,
        /// Of what.
        what: &'static str,
    },
    /// A number that no family describes.
    #[error("{name}: {why}")]
    NoFamily {
        /// Its name.
        name: String,
        /// Why.
        why: NoFit,
    },
    /// What was fitted is no space.
    #[error("what was fitted is no space: {0}")]
    Space(#[from] InvalidSpace),
}

/// A number as it was fitted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedNumber {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// The family that was chosen.
    pub chosen: FamilyFit,
    /// The other families, the likeliest first, ...
    pub others: Vec<FamilyFit>,
    /// ... and those that cannot describe the values, with why.
    pub impossible: Vec<(Family, String)>,
    /// How well the chosen one fits.
    pub goodness: Goodness,
    /// What it says beyond what was seen.
    pub tails: Tails,
    /// The values, sorted.
    #[serde(skip)]
    pub sorted: Vec<f64>,
}

/// A space fitted to episodes.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// The space.
    pub space: Space,
    /// Its numbers.
    pub numbers: Vec<FittedNumber>,
    /// Correlations of the copula.
    pub correlation: Vec<Vec<f64>>,
}

/// Fits a space to a sample. `samples` are drawn for each number to judge how well it fits.
///
/// # Errors
/// [`FitError`] for numbers that no family describes.
pub fn fit(sample: &Sample, name: &str, (samples, seed): (u32, u64)) -> Result<Fitted, FitError> {
    let numbers = episodes::numbers(&sample.taken);
    let parameter = |(number, observed): (&Number, &ObservedParameter)| ParameterSpec {
        name: number.name.clone(),
        field: number.field.clone(),
        unit: number.unit.to_owned(),
        nominal: Some(Value::Number(median(&observed.values))),
        distribution: Distribution::Uniform(crumple_world::scenario::space::Uniform { low: 0.0, high: 1.0 }),
    };
    let spec = SpaceSpec {
        version: SPACE_VERSION,
        name: name.to_owned(),
        about: about(sample),
        base: Base::Inline(Box::new(base(sample, name))),
        parameters: numbers.iter().zip(&sample.observed.parameters).map(parameter).collect(),
        dependence: None,
        exposure: Some(sample.exposure.clone()),
        observed: Some(sample.observed.clone()),
    };
    let space = refitted(&spec, &sample.observed)?;
    let fitted = |(place, (number, observed)): (usize, (&Number, &ObservedParameter))| {
        let range = [observed.low, observed.high];
        let mut sorted = observed.values.clone();
        sorted.sort_by(f64::total_cmp);
        let (mut fits, impossible) = all_families(&observed.values, range);
        let chosen = fits.remove(0);
        let ready = chosen.distribution.ready()?;
        Ok(FittedNumber {
            name: number.name.clone(),
            unit: number.unit,
            goodness: Goodness::of(&sorted, range, &chosen, &ready, (samples, seed, place as u64)),
            tails: Tails::of(&sorted, &ready),
            chosen,
            others: fits,
            impossible: impossible.into_iter().map(|(family, why)| (family, why.to_string())).collect(),
            sorted,
        })
    };
    let numbers =
        numbers.iter().zip(&sample.observed.parameters).enumerate().map(fitted).collect::<Result<_, FitError>>()?;
    let correlation = match &space.spec().dependence {
        Some(Dependence::GaussianCopula(copula)) => copula.correlation.clone(),
        None => Vec::new(),
    };
    Ok(Fitted { space, numbers, correlation })
}

/// A space fitted to other values of its parameters: their families, estimates and dependence are found anew, all else stays.
///
/// # Errors
/// [`FitError`] for values that no family describes, or that are no space.
pub fn refitted(spec: &SpaceSpec, observed: &Observed) -> Result<Space, FitError> {
    let mut spec = spec.clone();
    let chosen = observed.parameters.par_iter().map(|parameter| {
        let ObservedParameter { name, low, high, values } = parameter;
        let (fits, impossible) = all_families(values, [*low, *high]);
        let why = impossible.first().map_or(NoFit::NoMaximum, |(_, why)| *why);
        fits.into_iter().next().ok_or_else(|| FitError::NoFamily { name: name.clone(), why })
    });
    let chosen = chosen.collect::<Result<Vec<_>, _>>()?;
    for (fit, values) in chosen.into_iter().zip(&observed.parameters) {
        if let Some(parameter) = spec.parameters.iter_mut().find(|parameter| parameter.name == values.name) {
            parameter.distribution = fit.distribution;
            parameter.nominal = Some(Value::Number(median(&values.values)));
        }
    }
    let columns: Vec<&[f64]> = observed.parameters.iter().map(|parameter| parameter.values.as_slice()).collect();
    spec.dependence = (columns.len() > 1).then(|| {
        Dependence::GaussianCopula(GaussianCopula {
            parameters: observed.parameters.iter().map(|parameter| parameter.name.clone()).collect(),
            correlation: dependence::correlation(&columns),
        })
    });
    Ok(Space::new(spec, Path::new(""))?)
}

/// Every family, the likeliest first, and those that do not describe the values.
fn all_families(values: &[f64], range: [f64; 2]) -> (Vec<FamilyFit>, Vec<(Family, NoFit)>) {
    let (mut fits, mut impossible) = (Vec::new(), Vec::new());
    for family in Family::ALL {
        match family.fit(values, range) {
            Ok(fit) => fits.push(fit),
            Err(why) => impossible.push((family, why)),
        }
    }
    fits.sort_by(|a, b| b.ln_likelihood.total_cmp(&a.ln_likelihood));
    (fits, impossible)
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The scenario in which the numbers vary: cars, of which the last of three or more keeps the baseline, as of imported episodes.
fn base(sample: &Sample, name: &str) -> ScenarioSpec {
    let values = |index: usize| sample.observed.parameters.get(index).map_or(&[][..], |one| one.values.as_slice());
    let (speeds, brakes, shares) = (values(0), values(1), values(2));
    let lasts_s = speeds.iter().zip(brakes).zip(shares).map(|((speed, brake), share)| speed * (1.0 - share) / brake);
    let longest_s = lasts_s.fold(0.0, f64::max);
    let speed_mps = median(speeds);
    let lead = LeadProfile::BrakeToSpeed(BrakeToSpeed {
        onset_s: ONSET_S,
        rate_mps2: median(brakes),
        final_speed_mps: median(shares) * speed_mps,
    });
    let last = sample.taken.vehicles - 1;
    let vehicle = |index: usize| {
        let driver = match index {
            0 => Driver::Profile(lead.clone()),
            _ if index == last && last > 1 => Driver::Controller(ControllerSpec::Baseline(AebSettings::default())),
            _ => Driver::UnderTest,
        };
        // Far enough apart at any speed; gaps are parameters.
        let position_m = 100.0 * (last - index) as f64;
        let mut vehicle = VehicleSpec::new(VehicleClass::Light, position_m, speed_mps, driver);
        vehicle.length_m = Some(CAR_LENGTH_M);
        if index == 0 {
            vehicle.max_brake_mps2 = Some(crumple_world::recording::HARDEST_CHANGE_MPS2);
        }
        vehicle
    };
    ScenarioSpec {
        version: SCENARIO_VERSION,
        name: name.to_owned(),
        about: format!("A scenario of the space `{name}`."),
        duration_s: (ONSET_S + longest_s + TAIL_S).ceil(),
        step_s: 0.01,
        seed: 0,
        environment: Environment::default(),
        sensors: Sensors::default(),
        vehicles: (0..=last).map(vehicle).collect(),
    }
}

fn about(sample: &Sample) -> String {
    let Sample { taken, observed, exposure, shorter, outside, .. } = sample;
    let waves = observed.waves.iter().max().map_or(0, |last| last + 1);
    format!(
        "Fitted to {} braking episodes in {waves} waves of {} vehicles each, in {:.3} h and {:.1} km of following, from {} m/s² on. The leader \
         brakes at its hardest second's deceleration down to its lowest speed. Left out: {shorter} episodes of fewer vehicles, {outside} with \
         numbers outside the ranges.",
        exposure.episodes,
        taken.vehicles,
        exposure.hours,
        exposure.kilometres,
        taken.min_brake.mps2(),
    )
}
