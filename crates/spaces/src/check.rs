//! Validation of space files: a valid space holds only valid scenarios.

mod parameter;

use std::path::Path;

use super::copula::Copula;
use super::field::{FieldTarget, VehicleField};
use super::invalid::{InvalidSpace, SpaceProblem, reject};
use super::region::LikelihoodRegion;
use super::spec::{Base, ParameterValue, SPACE_VERSION, SpaceSpec};
use super::{ScenarioSpace, SpaceParameter};
use crumple_core::digits::format_compact;
use crumple_core::format_version::check_version;
use crumple_sim::control::StartRefusal;
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_sim::scenario::{
    FieldProblem, InvalidField, OpenDriver, Scenario, built_in_scenario, built_in_scenario_names,
    file,
};

/// Columns of an evaluation log before the coordinates. Parameters may not have these names.
pub const KEY_COLUMNS: [&str; 2] = ["method", "evaluation"];

/// Columns of an evaluation log after the coordinates. Parameters may not have these names.
pub const RESULT_COLUMNS: [&str; 8] = [
    "ln_likelihood",
    "robustness",
    "collision_time_s",
    "front_vehicle",
    "rear_vehicle",
    "impact_speed_mps",
    "ego_braking",
    "rear_class",
];

const MAX_PARAMETERS: usize = 200;
const MAX_COORDINATES: usize = 1000;
/// Maximum number of parameters whose corners are all checked: 2 to this power.
const MAX_CORNER_PARAMETERS: usize = 14;

impl ScenarioSpace {
    /// Creates a space if all of its points are valid scenarios. A base scenario in a file is relative to `folder`.
    ///
    /// # Errors
    /// [`InvalidSpace`] names the first invalid field.
    pub fn new(
        mut spec: SpaceSpec,
        folder: &Path,
        opener: &dyn OpenDriver,
    ) -> Result<Self, InvalidSpace> {
        check_header(&spec)?;
        let base = load_base(&spec.base, folder, opener)?;
        spec.base = Base::Inline(Box::new(base.spec().clone()));
        let count = spec.parameters.len();
        if !(1..=MAX_PARAMETERS).contains(&count) {
            let problem = format!("must be 1 to {MAX_PARAMETERS}, found {count}");
            return reject("parameters", problem);
        }
        let mut space = Self::without_parameters(spec, &base);
        let mut written = Vec::new();
        for index in 0..count {
            space.add_parameter(index, &mut written)?;
        }
        space.check_coordinates()?;
        space.order = (0..space.parameters.len()).collect();
        space
            .order
            .sort_by_key(|&index| space.parameters.get(index).map(|p| p.target.stage()));
        space.check_range_ends()?;
        space.check_corners()?;
        if let Some(dependence) = &space.spec.dependence {
            space.copula = Some(Copula::new(dependence, &space.parameters)?);
        }
        if let Some(exposure) = &space.spec.exposure {
            exposure.check()?;
        }
        if let Some(observed) = &space.spec.observed {
            observed.check(&space.spec)?;
            space.region = LikelihoodRegion::new(&space, observed);
        }
        Ok(space)
    }

    /// Creates a space whose parameters are not checked yet.
    fn without_parameters(spec: SpaceSpec, base: &Scenario) -> Self {
        let mut fields = spec.parameters.iter().map(|parameter| &parameter.field);
        let uses_gaps = !fields.any(|field| field.ends_with(".position_m"));
        let mut template = base.spec().clone();
        if uses_gaps {
            for (index, vehicle) in template.vehicles.iter_mut().enumerate() {
                vehicle.position_m = base.initial_gap_m(index).unwrap_or(vehicle.position_m);
            }
        }
        Self {
            spec,
            template,
            uses_gaps,
            parameters: Vec::new(),
            order: Vec::new(),
            copula: None,
            region: None,
        }
    }

    /// Checks the number and the names of the coordinates.
    fn check_coordinates(&self) -> Result<(), InvalidSpace> {
        let count = self.dimension();
        if count > MAX_COORDINATES {
            let problem = format!("must have at most {MAX_COORDINATES} coordinates, found {count}");
            return reject("parameters", problem);
        }
        let names = self.coordinate_names();
        let mut numbered = names.iter().enumerate();
        match numbered.find(|(index, name)| names[..*index].contains(name)) {
            Some((_, name)) => reject("parameters", format!("two coordinates are called `{name}`")),
            None => Ok(()),
        }
    }

    /// Checks both ends of each range with all else nominal: most fields are validated alone, against a range.
    fn check_range_ends(&self) -> Result<(), InvalidSpace> {
        let nominal = self.nominal();
        for (index, parameter) in self.parameters.iter().enumerate() {
            for end in parameter.ends() {
                let mut values = nominal.clone();
                parameter.set(&mut values, end);
                if let Err(invalid) = self.scenario(&values)
                    && (matches!(parameter.target, FieldTarget::Vehicle(_, VehicleField::Gap))
                        || !is_joint_problem(&invalid))
                {
                    let name = &parameter.name;
                    return reject(
                        format!("parameters[{index}].distribution"),
                        format!(
                            "with {name} = {} the scenario is invalid: {invalid}",
                            format_compact(end)
                        ),
                    );
                }
            }
        }
        Ok(())
    }

    /// Checks all corners of fields that are validated jointly (positions and lengths; scripts and vehicle limits),
    /// since the worst case of each is an end of its range.
    fn check_corners(&self) -> Result<(), InvalidSpace> {
        for vehicle in 0..self.template.vehicles.len() {
            let parameters: Vec<&SpaceParameter> = self
                .parameters
                .iter()
                .filter(|parameter| parameter.target.affects_gap_ahead(vehicle))
                .collect();
            if parameters.len() > MAX_CORNER_PARAMETERS {
                let count = parameters.len();
                let problem = format!(
                    "at most {MAX_CORNER_PARAMETERS} may vary on two successive vehicles, found {count}"
                );
                return reject("parameters", problem);
            }
            self.check_corners_of(&parameters)?;
        }
        Ok(())
    }

    /// Checks the scenario at each combination of the ends of some parameters, with all others nominal.
    fn check_corners_of(&self, parameters: &[&SpaceParameter]) -> Result<(), InvalidSpace> {
        for corner in 0..1_usize << parameters.len() {
            let mut values = self.nominal();
            for (bit, parameter) in parameters.iter().enumerate() {
                let [low, high] = parameter.ends();
                let is_low = corner >> bit & 1 == 0;
                parameter.set(&mut values, if is_low { low } else { high });
            }
            if let Err(invalid) = self.scenario(&values) {
                let names: Vec<_> = parameters
                    .iter()
                    .map(|parameter| format!("`{}`", parameter.name))
                    .collect();
                let problem = format!("{} do not fit together: {invalid}", names.join(", "));
                return reject("parameters", problem);
            }
        }
        Ok(())
    }
}

fn check_header(spec: &SpaceSpec) -> Result<(), InvalidSpace> {
    if let Err(unsupported) = check_version(spec.version, SPACE_VERSION) {
        return reject("version", unsupported.to_string());
    }
    let has_length = (1..=100).contains(&spec.name.chars().count());
    if !has_length || spec.name.chars().any(char::is_control) {
        let problem = "must have 1 to 100 characters, none of them a control character";
        return reject("name", problem);
    }
    Ok(())
}

/// Returns true for problems that several fields cause jointly.
fn is_joint_problem(invalid: &InvalidField) -> bool {
    use crumple_sim::scenario::FieldProblem as P;
    matches!(
        invalid.problem,
        P::Overlap { .. } | P::BrakeBeyondLimit { .. } | P::AccelBeyondLimit { .. }
    )
}

fn load_base(
    base: &Base,
    folder: &Path,
    opener: &dyn OpenDriver,
) -> Result<Scenario, InvalidSpace> {
    match base {
        Base::Inline(spec) => {
            let mut spec = (**spec).clone();
            spec.read_drivers(folder, opener)
                .and_then(|()| Scenario::new(spec))
                .map_err(|InvalidField { field, problem }| {
                    InvalidSpace::new(format!("base.{field}"), problem)
                })
        }
        Base::Named(name) => match built_in_scenario(name) {
            Some(scenario) => Ok(scenario),
            None if Path::new(name).extension().is_none() => reject("base", unknown_base(name)),
            None => file::load(&folder.join(name), opener)
                .map_err(|error| InvalidSpace::new("base", base_file_problem(error))),
        },
    }
}

fn unknown_base(name: &str) -> String {
    let built_in = built_in_scenario_names();
    let names: Vec<_> = built_in.iter().map(|(name, _)| *name).collect();
    let names = names.join(", ");
    format!("`{name}` is neither a built-in scenario ({names}) nor a .toml or .json file")
}

/// Returns the problem of a base scenario in a file. A program that it names is refused with the line of its name.
fn base_file_problem(error: ScenarioFileError) -> SpaceProblem {
    match error {
        ScenarioFileError::Invalid {
            path,
            line,
            invalid:
                InvalidField {
                    field,
                    problem: FieldProblem::StartRefused(StartRefusal { location }),
                },
        } => StartRefusal {
            location: format!("{}:{line}: {field}: {location}", path.display()),
        }
        .into(),
        other => other.to_string().into(),
    }
}

impl ParameterValue {
    /// Returns the number itself, or the number of a class or a driver.
    pub(super) fn number(self) -> f64 {
        match self {
            Self::Number(number) => number,
            Self::Class(class) => f64::from(class.number()),
            Self::Driver(driver) => driver.number(),
            Self::Follower(variant) => variant.number(),
        }
    }
}

impl SpaceParameter {
    fn ends(&self) -> [f64; 2] {
        [self.marginal.low(), self.marginal.high()]
    }

    /// Sets all coordinates of the parameter in the values of a space.
    fn set(&self, values: &mut [f64], value: f64) {
        values
            .get_mut(self.coordinates.clone())
            .unwrap_or_default()
            .fill(value);
    }
}
