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
        let mut units = HashMap::new();
        let definitions = list_items(root, "UnitDefinitions").iter();
        for unit in definitions.filter(|child| child.name == "Unit") {
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
        for declared in list_items(root, "TypeDefinitions") {
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
        let declared = self.declared_type(variable)?;
        let name = owner_of("unit", variable, declared)
            .and_then(|owner| owner.attribute("unit"))
            .filter(|unit| !unit.is_empty());
        let Some(name) = name else {
            return Ok(None);
        };
        let mut unit = match self.units.get(name) {
            Some(conversion) => DeclaredUnit {
                name: name.to_owned(),
                conversion: Some(*conversion),
            },
            None => DeclaredUnit::undefined(name),
        };
        if let Some(owner) = owner_of("relativeQuantity", variable, declared)
            && bool_attribute(owner, "relativeQuantity")?
        {
            // An offset does not apply to differences.
            unit.conversion = unit.conversion.map(|conversion| Conversion {
                offset: 0.0,
                ..conversion
            });
        }
        Ok(Some(unit))
    }

    /// Returns the type that a variable names; none if it names none.
    fn declared_type(
        &self,
        variable: &XmlElement,
    ) -> Result<Option<&'a XmlElement>, InvalidDescription> {
        let Some(name) = variable.attribute("declaredType") else {
            return Ok(None);
        };
        match self.types.get(name) {
            Some(declared) => Ok(Some(declared)),
            None => Err(error_at(
                variable,
                format!("declaredType: there is no real type {name:?}"),
            )),
        }
    }
}

/// Returns the elements of a list; none without the list.
fn list_items<'x>(root: &'x XmlElement, name: &str) -> &'x [XmlElement] {
    root.child(name).map_or(&[], |list| &list.children)
}

/// Returns the variable if it has an attribute, otherwise its declared type if that has it.
fn owner_of<'x>(
    attribute: &str,
    variable: &'x XmlElement,
    declared: Option<&'x XmlElement>,
) -> Option<&'x XmlElement> {
    Some(variable)
        .into_iter()
        .chain(declared)
        .find(|element| element.attribute(attribute).is_some())
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
    let factor = finite_number(base, "factor", 1.0)?;
    let offset = finite_number(base, "offset", 0.0)?;
    if factor == 0.0 {
        return Err(error_at(base, "`BaseUnit`: factor: must not be 0"));
    }
    Ok(Conversion {
        dimension: UnitDimension(exponents),
        factor,
        offset,
    })
}

/// Returns the number of an attribute of a `BaseUnit`.
fn finite_number(base: &XmlElement, name: &str, default: f64) -> Result<f64, InvalidDescription> {
    let Some(text) = base.attribute(name) else {
        return Ok(default);
    };
    let number = text.trim().parse().ok();
    number
        .filter(|number: &f64| number.is_finite())
        .ok_or_else(|| {
            error_at(
                base,
                format!("`BaseUnit`: {name}: {text:?} is not a finite number"),
            )
        })
}
