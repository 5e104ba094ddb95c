//! Conversion between SI units and the units that an FMU declares for its variables.
//!
//! Controller files use SI units. Scale and offset of inputs and outputs include the conversion to the FMU's units.

use crumple_fmu::{Conversion, UnitDimension, Variable};

use crumple_networks::{InputMapping, OutputMapping};
use crumple_sim::control::ObservedQuantity;

/// Returns an input whose values are in the unit of its variable.
///
/// # Errors
/// The problem, with the unit's name: no definition, another dimension, or a second conversion by `scale`.
pub(super) fn convert_input(
    input: InputMapping,
    variable: &Variable,
) -> Result<InputMapping, String> {
    let Some(Conversion {
        dimension,
        factor,
        offset,
    }) = conversion_of(variable)?
    else {
        return Ok(input);
    };
    if let Some(quantity) = input.quantity {
        check_dimension(
            variable,
            dimension,
            dimension_of(quantity),
            quantity.name(),
            ("scale", input.scale),
        )?;
    }
    if (factor, offset) == (1.0, 0.0) {
        return Ok(input);
    }
    check_scale(variable, dimension, ("scale", input.scale))?;
    let [low, high] = [input.low, input.high].map(|limit| (limit - offset) / factor);
    // A negative factor swaps the limits.
    let [low, high] = if factor < 0.0 {
        [high, low]
    } else {
        [low, high]
    };
    Ok(InputMapping {
        offset: input.offset + input.scale * offset,
        scale: input.scale * factor,
        low,
        high,
        ..input
    })
}

/// Returns an output that takes answers in the unit of its variable.
///
/// # Errors
/// The problem, with the unit's name, as for [`convert_input`].
pub(super) fn convert_output(
    output: OutputMapping,
    variable: &Variable,
) -> Result<OutputMapping, String> {
    let Some(Conversion {
        dimension,
        factor,
        offset,
    }) = conversion_of(variable)?
    else {
        return Ok(output);
    };
    let scale = ("scale_mps2", output.scale_mps2);
    if output.squash.is_none() {
        check_dimension(
            variable,
            dimension,
            UnitDimension::metres_seconds(1, -2),
            "the answer",
            scale,
        )?;
    }
    if (factor, offset) == (1.0, 0.0) {
        return Ok(output);
    }
    if output.squash.is_some() {
        return Err(format!(
            "{}, and `squash` is allowed only for outputs without a unit",
            variable_with_unit(variable)
        ));
    }
    check_scale(variable, dimension, scale)?;
    Ok(OutputMapping {
        scale_mps2: output.scale_mps2 * factor,
        offset_mps2: output.offset_mps2 + output.scale_mps2 * offset,
        ..output
    })
}

/// Returns the value of a parameter in its unit.
///
/// # Errors
/// The problem, with the unit's name, for a unit without a definition.
pub(super) fn convert_parameter(value: f64, variable: &Variable) -> Result<f64, String> {
    Ok(conversion_of(variable)?.map_or(value, |conversion| conversion.from_si(value)))
}

fn conversion_of(variable: &Variable) -> Result<Option<Conversion>, String> {
    match &variable.unit {
        None => Ok(None),
        Some(unit) => unit.conversion.map(Some).ok_or_else(|| {
            format!(
                "{}, which the FMU does not define (no `BaseUnit` in its modelDescription.xml), so that values cannot \
                 be converted to it",
                variable_with_unit(variable)
            )
        }),
    }
}

/// Checks the dimension of a unit. A dimensionless variable fits any quantity if its scale is not 1.
fn check_dimension(
    variable: &Variable,
    unit: UnitDimension,
    expected: UnitDimension,
    what: &str,
    (field, scale): (&str, f64),
) -> Result<(), String> {
    if unit == expected || (unit == UnitDimension::NONE && scale != 1.0) {
        return Ok(());
    }
    let hint = if unit == UnitDimension::NONE {
        format!("a plain number needs a `{field}`")
    } else {
        "choose another variable, or correct its unit in modelDescription.xml".to_owned()
    };
    Err(format!(
        "{} ({unit} in SI units), and {what} is in {expected}; {hint}",
        variable_with_unit(variable)
    ))
}

fn check_scale(
    variable: &Variable,
    unit: UnitDimension,
    (field, scale): (&str, f64),
) -> Result<(), String> {
    if unit == UnitDimension::NONE || scale.abs() == 1.0 {
        return Ok(());
    }
    Err(format!(
        "{}, and crumple converts between it and SI units: `{field}` must be 1 or -1, found {scale}",
        variable_with_unit(variable)
    ))
}

/// Returns the beginning of each message: the variable and its unit.
fn variable_with_unit(variable: &Variable) -> String {
    let unit = variable.unit.as_ref().map_or("", |unit| unit.name.as_str());
    format!("the FMU's `{}` has the unit `{unit}`", variable.name)
}

/// Returns the dimension of a quantity by the end of its name.
fn dimension_of(quantity: ObservedQuantity) -> UnitDimension {
    match quantity.name().rsplit('_').next() {
        Some("m") => UnitDimension::metres_seconds(1, 0),
        Some("s") => UnitDimension::metres_seconds(0, 1),
        Some("mps") => UnitDimension::metres_seconds(1, -1),
        Some("mps2") => UnitDimension::metres_seconds(1, -2),
        _ => UnitDimension::NONE,
    }
}
