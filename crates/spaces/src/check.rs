//! Validation of space files: a valid space holds only valid scenarios.

use std::path::Path;

use super::copula::Copula;
use super::field::{FieldTarget, ParameterField, VehicleField};
use super::marginal::CoordinateMarginal;
use super::region::LikelihoodRegion;
use super::spec::{Base, ParameterSpec, ParameterValue, SPACE_VERSION, SpaceSpec, ValueKind};
use super::{ScenarioSpace, SpaceParameter};
use crumple_core::digits::format_compact;
use crumple_world::control::StartRefusal;
use crumple_world::scenario::file::ScenarioFileError;
use crumple_world::scenario::{
    FieldProblem, InvalidField, OpenDriver, Scenario, VehicleClass, built_in_scenario,
    built_in_scenario_names, file,
};

/// An invalid field of a space, with its path and its problem.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct InvalidSpace {
    /// Path of the field in the file, such as `parameters[1].distribution`.
    pub field: String,
    /// Problem of the field.
    pub problem: String,
    /// Refusal to start a program of the base scenario, if that is the problem.
    pub start_refused: Option<StartRefusal>,
}

impl InvalidSpace {
    /// Creates an error from a field and its problem.
    pub fn new(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            field: field.into(),
            problem: problem.into(),
            start_refused: None,
        }
    }

    fn from_base(field: String, problem: FieldProblem) -> Self {
        let words = problem.to_string();
        let start_refused = if let FieldProblem::StartRefused(refused) = problem {
            Some(refused)
        } else {
            None
        };
        Self {
            field,
            problem: words,
            start_refused,
        }
    }
}

/// Columns of an evaluation log before the coordinates. Parameters may not have these names.
pub const KEY_COLUMNS: [&str; 2] = ["method", "evaluation"];

/// Columns of an evaluation log after the coordinates. Parameters may not have these names.
pub const RESULT_COLUMNS: [&str; 8] = [
    "ln_likelihood",
    "robustness",
    "contact_time_s",
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

/// Returns a unit with the exponents of this crate's units: `m/s2` and `m/s^2` are `m/s²`.
fn with_superscripts(unit: &str) -> String {
    unit.replace('^', "").replace('2', "²").replace('3', "³")
}

fn class_names(between: &str) -> String {
    VehicleClass::ALL
        .iter()
        .map(|class| format!("`{}`", class.name()))
        .collect::<Vec<_>>()
        .join(between)
}

pub(super) fn reject<T>(
    field: impl Into<String>,
    problem: impl Into<String>,
) -> Result<T, InvalidSpace> {
    Err(InvalidSpace::new(field, problem))
}

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
        if spec.version != SPACE_VERSION {
            let found = spec.version;
            return reject(
                "version",
                format!(
                    "version {found} is not supported: this release reads version {SPACE_VERSION}"
                ),
            );
        }
        if spec.name.is_empty()
            || spec.name.chars().count() > 100
            || spec.name.chars().any(char::is_control)
        {
            return reject(
                "name",
                "must have 1 to 100 characters, none of them a control character",
            );
        }
        let base = load_base(&spec.base, folder, opener)?;
        spec.base = Base::Inline(Box::new(base.spec().clone()));
        if !(1..=MAX_PARAMETERS).contains(&spec.parameters.len()) {
            let found = spec.parameters.len();
            return reject(
                "parameters",
                format!("must be 1 to {MAX_PARAMETERS}, found {found}"),
            );
        }
        let is_place = |parameter: &ParameterSpec| parameter.field.ends_with(".position_m");
        let lines_up = !spec.parameters.iter().any(is_place);
        let mut template = base.spec().clone();
        if lines_up {
            for (index, vehicle) in template.vehicles.iter_mut().enumerate() {
                vehicle.position_m = base.initial_gap_m(index).unwrap_or(vehicle.position_m);
            }
        }
        let (parameters, order) = (Vec::new(), Vec::new());
        let mut space = Self {
            spec,
            template,
            uses_gaps: lines_up,
            parameters,
            order,
            copula: None,
            region: None,
        };
        let mut written: Vec<(String, String)> = Vec::new();
        for index in 0..space.spec.parameters.len() {
            space.add_parameter(index, &mut written)?;
        }
        if space.dimension() > MAX_COORDINATES {
            let found = space.dimension();
            return reject(
                "parameters",
                format!("must have at most {MAX_COORDINATES} coordinates, found {found}"),
            );
        }
        let names = space.coordinate_names();
        if let Some(doubled) = names
            .iter()
            .enumerate()
            .find(|(index, name)| names[..*index].contains(name))
        {
            return reject(
                "parameters",
                format!("two coordinates are called `{}`", doubled.1),
            );
        }
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

    fn add_parameter(
        &mut self,
        index: usize,
        written: &mut Vec<(String, String)>,
    ) -> Result<(), InvalidSpace> {
        let at = |field: &str| format!("parameters[{index}].{field}");
        let Some(spec) = self.spec.parameters.get(index) else {
            return Ok(());
        };
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if !(1..=60).contains(&spec.name.len()) || !spec.name.chars().all(is_plain) {
            return reject(
                at("name"),
                "must be 1 to 60 letters, digits and underscores",
            );
        }
        if KEY_COLUMNS
            .iter()
            .chain(&RESULT_COLUMNS)
            .any(|column| *column == spec.name)
        {
            return reject(
                at("name"),
                format!("`{}` is a column of every table of evaluations", spec.name),
            );
        }
        if self.parameters.iter().any(|known| known.name == spec.name) {
            return reject(
                at("name"),
                format!("`{}` is the name of another parameter", spec.name),
            );
        }
        let field = ParameterField::resolve(&spec.field, &self.template)
            .map_err(|problem| InvalidSpace::new(at("field"), problem))?;
        let is_gap = |field| {
            matches!(
                field,
                VehicleField::Gap | VehicleField::TimeGap | VehicleField::ClosingTime
            )
        };
        if matches!(field.target, FieldTarget::Vehicle(_, target) if is_gap(target))
            && !self.uses_gaps
        {
            return reject(at("field"), "a space has gaps or positions, not both");
        }
        if with_superscripts(&spec.unit) != field.unit {
            let expected = match field.unit {
                "" => format!("`{}` has no unit", spec.field),
                unit => {
                    let plain = unit.replace('²', "2").replace('³', "3");
                    let or_plain = if plain == unit {
                        String::new()
                    } else {
                        format!(" (or `{plain}`)")
                    };
                    format!("the unit of `{}` is `{unit}`{or_plain}", spec.field)
                }
            };
            let found = if spec.unit.is_empty() {
                "none is given".to_owned()
            } else {
                format!("found `{}`", spec.unit)
            };
            let problem = format!("{expected}, {found}");
            return reject(at("unit"), problem);
        }
        for write in &field.written_paths {
            if let Some((_, other)) = written
                .iter()
                .find(|(known, _)| is_overlapping(known, write))
            {
                return reject(
                    at("field"),
                    format!("`{write}` is set by the parameter `{other}` already"),
                );
            }
        }
        written.extend(
            field
                .written_paths
                .iter()
                .map(|write| (write.clone(), spec.name.clone())),
        );
        let kind = field.target.kind();
        let marginal = spec.distribution.marginal().map_err(|(field, problem)| {
            InvalidSpace::new(at(&format!("distribution{field}")), problem)
        })?;
        if kind != spec.distribution.kind() {
            let problem = match kind {
                ValueKind::Number => "a number is expected".to_owned(),
                ValueKind::Class => format!("a class is a choice of {}", class_names(" and ")),
                ValueKind::Driver => "a driver is a choice of built-in controllers".to_owned(),
            };
            return reject(at("distribution"), problem);
        }
        let nominal = match spec.nominal {
            None => field.target.get(&self.template),
            Some(value) if value.kind() != kind => {
                let problem = match kind {
                    ValueKind::Number => "must be a number".to_owned(),
                    ValueKind::Class => format!("must be {}", class_names(" or ")),
                    ValueKind::Driver => "must be a built-in controller".to_owned(),
                };
                return reject(at("nominal"), format!("{problem}, found {value}"));
            }
            Some(value) => vec![value.number(); field.length],
        };
        let fits = |value: &f64| marginal.value(marginal.coordinate(*value)) - value;
        let is_off =
            |value: &&f64| !value.is_finite() || fits(value).abs() > 1e-9 * (1.0 + value.abs());
        if let Some(value) = nominal.iter().find(is_off) {
            let found = format_compact(*value);
            let problem = match marginal {
                CoordinateMarginal::Choice { .. } => {
                    format!("{found} is not a value of the distribution")
                }
                _ => format!(
                    "must be from {} to {}, found {found}",
                    format_compact(marginal.low()),
                    format_compact(marginal.high())
                ),
            };
            let from = if spec.nominal.is_some() {
                ""
            } else {
                " in the base scenario"
            };
            return reject(at("nominal"), problem + from);
        }
        let start = self.dimension();
        self.parameters.push(SpaceParameter {
            name: spec.name.clone(),
            unit: field.unit,
            target: field.target,
            marginal,
            coordinates: start..start + field.length,
            nominal,
        });
        // However a file writes the unit, equal spaces have equal texts.
        if let Some(spec) = self.spec.parameters.get_mut(index) {
            spec.unit = field.unit.to_owned();
        }
        Ok(())
    }

    /// Checks both ends of each range with all else nominal: most fields are validated alone, against a range.
    fn check_range_ends(&self) -> Result<(), InvalidSpace> {
        let nominal = self.nominal();
        for (index, parameter) in self.parameters.iter().enumerate() {
            for end in parameter.ends() {
                let mut values = nominal.clone();
                values
                    .get_mut(parameter.coordinates.clone())
                    .unwrap_or_default()
                    .fill(end);
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
            let near = |parameter: &&SpaceParameter| {
                let collided = parameter.target.affected_vehicle();
                let of_all = matches!(parameter.target, FieldTarget::AllVehicles(_));
                of_all
                    || collided
                        .is_some_and(|collided| collided == vehicle || collided + 1 == vehicle)
            };
            let parameters: Vec<&SpaceParameter> = self.parameters.iter().filter(near).collect();
            if parameters.len() > MAX_CORNER_PARAMETERS {
                let found = parameters.len();
                let problem = format!(
                    "at most {MAX_CORNER_PARAMETERS} may vary on two successive vehicles, found {found}"
                );
                return reject("parameters", problem);
            }
            for corner in 0..1_usize << parameters.len() {
                let mut values = self.nominal();
                for (bit, parameter) in parameters.iter().enumerate() {
                    let [low, high] = parameter.ends();
                    let end = if corner >> bit & 1 == 0 { low } else { high };
                    values
                        .get_mut(parameter.coordinates.clone())
                        .unwrap_or_default()
                        .fill(end);
                }
                if let Err(invalid) = self.scenario(&values) {
                    let names: Vec<_> =
                        parameters.iter().map(|p| format!("`{}`", p.name)).collect();
                    return reject(
                        "parameters",
                        format!("{} do not fit together: {invalid}", names.join(", ")),
                    );
                }
            }
        }
        Ok(())
    }
}

/// Returns true if the paths are equal or one contains the other.
fn is_overlapping(a: &str, b: &str) -> bool {
    let is_part = |part: &str, of: &str| {
        part.strip_prefix(of)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    };
    is_part(a, b) || is_part(b, a)
}

/// Returns true for problems that several fields cause jointly.
fn is_joint_problem(invalid: &InvalidField) -> bool {
    use crumple_world::scenario::FieldProblem as P;
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
            let in_base = |InvalidField { field, problem }| {
                InvalidSpace::from_base(format!("base.{field}"), problem)
            };
            spec.read_drivers(folder, opener)
                .and_then(|()| Scenario::new(spec))
                .map_err(in_base)
        }
        Base::Named(name) => match built_in_scenario(name) {
            Some(scenario) => Ok(scenario),
            None if Path::new(name).extension().is_none() => {
                let known: Vec<_> = built_in_scenario_names()
                    .iter()
                    .map(|(name, _)| *name)
                    .collect();
                let known = known.join(", ");
                reject(
                    "base",
                    format!(
                        "`{name}` is neither a built-in scenario ({known}) nor a .toml or .json file"
                    ),
                )
            }
            None => file::load(&folder.join(name), opener).map_err(|error| match error {
                ScenarioFileError::Invalid {
                    path,
                    line,
                    invalid:
                        InvalidField {
                            field,
                            problem: FieldProblem::StartRefused(StartRefusal { location: place }),
                        },
                } => {
                    let place = format!("{}:{line}: {field}: {place}", path.display());
                    InvalidSpace::from_base(
                        "base".to_owned(),
                        StartRefusal { location: place }.into(),
                    )
                }
                other => InvalidSpace::new("base", other.to_string()),
            }),
        },
    }
}

impl ParameterValue {
    /// Returns the number itself, or the number of a class or a driver.
    pub(super) fn number(self) -> f64 {
        match self {
            Self::Number(number) => number,
            Self::Class(class) => f64::from(class.number()),
            Self::Driver(driver) => driver.number(),
        }
    }
}

impl SpaceParameter {
    fn ends(&self) -> [f64; 2] {
        [self.marginal.low(), self.marginal.high()]
    }
}
