//! Units and types that a description declares.

use std::collections::HashMap;

use crate::FmiVersion;
use crate::description::{InvalidDescription, bool_attribute, error_at, required_attribute};
use crate::unit::{BASE_UNITS, Conversion, DeclaredUnit, UnitDimension};
use crate::xml::XmlElement;

/// Units by name, and the attributes of real types by the name of the type.
pub(crate) struct Declarations<'a> {
    units: HashMap<&'a str, Conversion>,
    types: HashMap<&'a str, &'a XmlElement>,
}

impl<'a> Declarations<'a> {
    /// Reads `UnitDefinitions` and `TypeDefinitions`.
    ///
    /// # Errors
    /// [`InvalidDescription`] for a missing name, a duplicate unit, or an invalid number.
    pub(crate) fn read(
        root: &'a XmlElement,
        version: FmiVersion,
    ) -> Result<Self, InvalidDescription> {
        let listed = |name: &str| root.child(name).into_iter().flat_map(|list| &list.children);
        let mut units = HashMap::new();
        for unit in listed("UnitDefinitions").filter(|child| child.name == "Unit") {
            let name = required_attribute(unit, "name")?;
            // A unit without a base unit has a name only.
            let Some(base) = unit.child("BaseUnit") else {
                continue;
            };
            if units.insert(name, read_conversion(base)?).is_some() {
                return Err(error_at(unit, format!("there are two units {name:?}")));
            }
        }
        let mut types = HashMap::new();
        for declared in listed("TypeDefinitions") {
            let attributes = match version {
                FmiVersion::Two => declared.child("Real"),
                FmiVersion::Three => {
                    Some(declared).filter(|declared| declared.name == "Float64Type")
                }
            };
            if let Some(attributes) = attributes {
                types.insert(required_attribute(declared, "name")?, attributes);
            }
        }
        Ok(Self { units, types })
    }

    /// Returns the unit of a real variable: its own, otherwise that of its declared type.
    ///
    /// # Errors
    /// [`InvalidDescription`] if the type is not declared.
    pub(crate) fn unit_of(
        &self,
        variable: &XmlElement,
    ) -> Result<Option<DeclaredUnit>, InvalidDescription> {
        let declared = match variable.attribute("declaredType") {
            None => None,
            Some(name) => {
                let missing = || {
                    error_at(
                        variable,
                        format!("declaredType: there is no real type {name:?}"),
                    )
                };
                Some(*self.types.get(name).ok_or_else(missing)?)
            }
        };
        let owner_of = |name: &str| {
            Some(variable)
                .into_iter()
                .chain(declared)
                .find(|e| e.attribute(name).is_some())
        };
        let Some(name) = owner_of("unit")
            .and_then(|owner| owner.attribute("unit"))
            .filter(|unit| !unit.is_empty())
        else {
            return Ok(None);
        };
        let mut unit = match self.units.get(name) {
            Some(conversion) => DeclaredUnit {
                name: name.to_owned(),
                conversion: Some(*conversion),
            },
            None => DeclaredUnit::undefined(name),
        };
        if owner_of("relativeQuantity")
            .map_or(Ok(false), |owner| bool_attribute(owner, "relativeQuantity"))?
        {
            // An offset does not apply to differences.
            unit.conversion = unit.conversion.map(|conversion| Conversion {
                offset: 0.0,
                ..conversion
            });
        }
        Ok(Some(unit))
    }
}

/// Reads a `BaseUnit`. By default exponents are 0, the factor 1 and the offset 0.
fn read_conversion(base: &XmlElement) -> Result<Conversion, InvalidDescription> {
    let mut exponents = [0; 8];
    for (exponent, name) in exponents.iter_mut().zip(BASE_UNITS) {
        let Some(text) = base.attribute(name) else {
            continue;
        };
        *exponent = text.trim().parse().map_err(|_| {
            error_at(
                base,
                format!("`BaseUnit`: {name}: {text:?} is not a whole number"),
            )
        })?;
    }
    let number = |name: &str, default: f64| match base.attribute(name) {
        None => Ok(default),
        Some(text) => {
            let number = text
                .trim()
                .parse()
                .ok()
                .filter(|number: &f64| number.is_finite());
            number.ok_or_else(|| {
                error_at(
                    base,
                    format!("`BaseUnit`: {name}: {text:?} is not a finite number"),
                )
            })
        }
    };
    let (factor, offset) = (number("factor", 1.0)?, number("offset", 0.0)?);
    if factor == 0.0 {
        return Err(error_at(base, "`BaseUnit`: factor: must not be 0"));
    }
    Ok(Conversion {
        dimension: UnitDimension(exponents),
        factor,
        offset,
    })
}
