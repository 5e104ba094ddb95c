//! Validation of one parameter.

use super::super::field::{FieldTarget, ParameterField, VehicleField};
use super::super::invalid::{InvalidSpace, reject};
use super::super::marginal::CoordinateMarginal;
use super::super::spec::{ParameterSpec, ValueKind};
use super::super::{ScenarioSpace, SpaceParameter};
use super::{KEY_COLUMNS, RESULT_COLUMNS};
use crumple_core::digits::format_compact;
use crumple_sim::scenario::VehicleClass;

/// A path that a parameter sets.
pub(super) struct WrittenPath {
    path: String,
    parameter: String,
}

impl ScenarioSpace {
    /// Checks the parameter with an index and adds it. `written` has the paths that the parameters before it set.
    pub(super) fn add_parameter(
        &mut self,
        index: usize,
        written: &mut Vec<WrittenPath>,
    ) -> Result<(), InvalidSpace> {
        let Some(spec) = self.spec.parameters.get(index) else {
            return Ok(());
        };
        let parameter = self
            .check_parameter(spec, written)
            .map_err(|invalid| invalid.within(&format!("parameters[{index}].")))?;
        // However a file writes the unit, equal spaces have equal texts.
        if let Some(spec) = self.spec.parameters.get_mut(index) {
            spec.unit = parameter.unit.to_owned();
        }
        self.parameters.push(parameter);
        Ok(())
    }

    /// Returns the parameter, and adds the paths that it sets to `written`. Paths in errors begin in the parameter.
    fn check_parameter(
        &self,
        spec: &ParameterSpec,
        written: &mut Vec<WrittenPath>,
    ) -> Result<SpaceParameter, InvalidSpace> {
        self.check_name(&spec.name)?;
        let field = self.resolve_field(&spec.field)?;
        check_unit(spec, field.unit)?;
        check_overlap(&field, written)?;
        written.extend(field.written_paths.iter().map(|path| WrittenPath {
            path: path.clone(),
            parameter: spec.name.clone(),
        }));
        let marginal = spec
            .distribution
            .marginal()
            .map_err(|invalid| invalid.within("distribution"))?;
        check_kind(spec, field.target.kind())?;
        let nominal = self.resolve_nominal(spec, &field)?;
        check_nominal(spec, field.target, &nominal, &marginal)?;
        let start = self.dimension();
        Ok(SpaceParameter {
            name: spec.name.clone(),
            unit: field.unit,
            target: field.target,
            marginal,
            coordinates: start..start + field.length,
            nominal,
        })
    }

    fn check_name(&self, name: &str) -> Result<(), InvalidSpace> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if !(1..=60).contains(&name.len()) || !name.chars().all(is_plain) {
            return reject("name", "must be 1 to 60 letters, digits and underscores");
        }
        if KEY_COLUMNS.contains(&name) || RESULT_COLUMNS.contains(&name) {
            let problem = format!("`{name}` is a column of every table of evaluations");
            return reject("name", problem);
        }
        if self.parameters.iter().any(|earlier| earlier.name == name) {
            let problem = format!("`{name}` is the name of another parameter");
            return reject("name", problem);
        }
        Ok(())
    }

    fn resolve_field(&self, path: &str) -> Result<ParameterField, InvalidSpace> {
        let field = ParameterField::resolve(path, &self.template)
            .map_err(|problem| InvalidSpace::new("field", problem))?;
        let is_gap = matches!(
            field.target,
            FieldTarget::Vehicle(
                _,
                VehicleField::Gap | VehicleField::TimeGap | VehicleField::ClosingTime
            )
        );
        if is_gap && !self.uses_gaps {
            return reject("field", "a space has gaps or positions, not both");
        }
        Ok(field)
    }

    /// Returns the nominal value of each coordinate: that of the file, or those of the base scenario.
    fn resolve_nominal(
        &self,
        spec: &ParameterSpec,
        field: &ParameterField,
    ) -> Result<Vec<f64>, InvalidSpace> {
        let Some(value) = spec.nominal else {
            return Ok(field.target.get(&self.template));
        };
        let kind = field.target.kind();
        let is_driver_behind = kind == ValueKind::Follower && value.kind() == ValueKind::Driver;
        if value.kind() == kind || is_driver_behind {
            return Ok(vec![value.number(); field.length]);
        }
        let problem = match kind {
            ValueKind::Number => "must be a number".to_owned(),
            ValueKind::Class => format!("must be {}", class_names(" or ")),
            ValueKind::Driver => "must be a built-in controller or a preset".to_owned(),
            ValueKind::Follower => {
                "must be a built-in controller, a preset, `late`, `weak` or `none`".to_owned()
            }
        };
        reject("nominal", format!("{problem}, found {value}"))
    }
}

fn check_unit(spec: &ParameterSpec, unit: &str) -> Result<(), InvalidSpace> {
    if with_superscripts(&spec.unit) == unit {
        return Ok(());
    }
    let given = if spec.unit.is_empty() {
        "none is given".to_owned()
    } else {
        format!("found `{}`", spec.unit)
    };
    if unit.is_empty() {
        return reject("unit", format!("`{}` has no unit, {given}", spec.field));
    }
    let plain = unit.replace('²', "2").replace('³', "3");
    let or_plain = if plain == unit {
        String::new()
    } else {
        format!(" (or `{plain}`)")
    };
    let problem = format!(
        "the unit of `{}` is `{unit}`{or_plain}, {given}",
        spec.field
    );
    reject("unit", problem)
}

/// Returns a unit with the exponents of this crate's units: `m/s2` and `m/s^2` are `m/s²`.
fn with_superscripts(unit: &str) -> String {
    unit.replace('^', "").replace('2', "²").replace('3', "³")
}

fn check_overlap(field: &ParameterField, written: &[WrittenPath]) -> Result<(), InvalidSpace> {
    for path in &field.written_paths {
        let mut earlier = written.iter();
        if let Some(overlapping) = earlier.find(|earlier| is_overlapping(&earlier.path, path)) {
            let parameter = &overlapping.parameter;
            let problem = format!("`{path}` is set by the parameter `{parameter}` already");
            return reject("field", problem);
        }
    }
    Ok(())
}

/// Returns true if the paths are equal or one contains the other.
fn is_overlapping(a: &str, b: &str) -> bool {
    is_part(a, b) || is_part(b, a)
}

fn is_part(part: &str, whole: &str) -> bool {
    part.strip_prefix(whole)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

fn check_kind(spec: &ParameterSpec, kind: ValueKind) -> Result<(), InvalidSpace> {
    let given = spec.distribution.kind();
    if kind == given || (kind == ValueKind::Follower && given == ValueKind::Driver) {
        return Ok(());
    }
    let problem = match kind {
        ValueKind::Number => "a number is expected".to_owned(),
        ValueKind::Class => format!("a class is a choice of {}", class_names(" and ")),
        ValueKind::Driver => "a driver is a choice of built-in controllers and presets".to_owned(),
        ValueKind::Follower => {
            "a follower is a choice of built-in controllers, presets, `late`, `weak` and `none`"
                .to_owned()
        }
    };
    reject("distribution", problem)
}

fn class_names(between: &str) -> String {
    VehicleClass::ALL
        .iter()
        .map(|class| format!("`{}`", class.name()))
        .collect::<Vec<_>>()
        .join(between)
}

/// Checks that the distribution has the nominal values.
fn check_nominal(
    spec: &ParameterSpec,
    target: FieldTarget,
    nominal: &[f64],
    marginal: &CoordinateMarginal,
) -> Result<(), InvalidSpace> {
    let Some(value) = nominal.iter().find(|&&value| {
        let deviation = marginal.value(marginal.coordinate(value)) - value;
        !value.is_finite() || deviation.abs() > 1e-9 * (1.0 + value.abs())
    }) else {
        return Ok(());
    };
    let problem = if matches!(marginal, CoordinateMarginal::Choice { .. }) {
        let value = match target.kind().value_name(*value) {
            Some(name) => format!("`{name}`"),
            None => format_compact(*value),
        };
        format!("{value} is not a value of the distribution")
    } else {
        let [low, high] = [marginal.low(), marginal.high()].map(format_compact);
        let value = format_compact(*value);
        format!("must be from {low} to {high}, found {value}")
    };
    let origin = if spec.nominal.is_some() {
        ""
    } else {
        " in the base scenario"
    };
    reject("nominal", problem + origin)
}
