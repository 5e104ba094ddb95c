//! Parts of `modelDescription.xml` that a controller needs.

use crate::declarations::Declarations;
use crate::unit::DeclaredUnit;
use crate::xml::XmlElement;

const MAX_VARIABLES: usize = 100_000;

/// Edition of the FMI standard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FmiVersion {
    /// FMI 2.0.
    Two,
    /// FMI 3.0.
    Three,
}

/// Content of a model description.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelDescription {
    /// Edition of the standard.
    pub version: FmiVersion,
    /// Name of the model.
    pub model_name: String,
    /// `guid` of FMI 2, `instantiationToken` of FMI 3; the library compares it.
    pub instantiation_token: String,
    /// File name of the library without its extension.
    pub model_identifier: String,
    /// True if a process can instantiate the FMU only once; each run then begins with a reset.
    pub is_once_per_process: bool,
    /// Variables of types that a controller can use, in the order of the text.
    pub variables: Vec<Variable>,
}

/// Variable of an FMU.
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Name of the variable.
    pub name: String,
    /// Identifier of the variable in calls of the library.
    pub value_reference: u32,
    /// Role of the variable.
    pub causality: Causality,
    /// Type of the variable.
    pub kind: VariableType,
    /// Default value as written.
    pub start: Option<String>,
    /// Unit of a real variable; none if it declares no unit.
    pub unit: Option<DeclaredUnit>,
    /// Description by the author of the FMU.
    pub description: Option<String>,
}

/// Role of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Causality {
    /// Input, set before each step.
    Input,
    /// Output, read after each step.
    Output,
    /// Parameter, set before the run.
    Parameter,
}

/// Type of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VariableType {
    /// `Real` of FMI 2, `Float64` of FMI 3.
    Real,
    /// `Integer` of FMI 2, `Int32` of FMI 3.
    Integer,
    /// Boolean of both editions.
    Boolean,
}

impl VariableType {
    /// Returns the name of the type.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Real => "real",
            Self::Integer => "integer",
            Self::Boolean => "boolean",
        }
    }

    /// True if `value` is a value of this type. 0 and 1 are Booleans.
    #[must_use]
    pub fn accepts(self, value: f64) -> bool {
        match self {
            Self::Real => value.is_finite(),
            Self::Integer => value.fract() == 0.0 && value.abs() <= f64::from(i32::MAX),
            Self::Boolean => value == 0.0 || value == 1.0,
        }
    }
}

/// Reason why a description cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidDescription {
    /// The FMU follows another edition of the standard, or states none.
    #[error(
        "modelDescription.xml: FMI version {found:?} is not supported; crumple reads FMI 2.0 and 3.0"
    )]
    Version {
        /// Value of `fmiVersion`.
        found: String,
    },
    /// The FMU supports only model exchange or scheduled execution.
    #[error(
        "does not support co-simulation, which crumple needs (modelDescription.xml has no element `CoSimulation`)"
    )]
    NoCoSimulation,
    /// The FMU needs a tool that crumple cannot start.
    #[error("cannot run without the tool that exported it (needsExecutionTool)")]
    NeedsTool,
    /// An element or attribute is missing or invalid.
    #[error("modelDescription.xml, line {line}: {problem}")]
    AtLine {
        /// Line, from 1.
        line: u32,
        /// Problem, as a clause.
        problem: String,
    },
}

impl FmiVersion {
    /// Returns the edition that a description states.
    fn from_description(root: &XmlElement) -> Result<Self, InvalidDescription> {
        let stated = root.attribute("fmiVersion").unwrap_or_default();
        match stated.split('.').next() {
            Some("2") => Ok(Self::Two),
            Some("3") => Ok(Self::Three),
            _ => Err(InvalidDescription::Version {
                found: stated.to_owned(),
            }),
        }
    }
}

impl ModelDescription {
    /// Reads a description.
    ///
    /// # Errors
    /// [`InvalidDescription`] for an invalid description, or one of an FMU that cannot be a controller.
    pub fn from_xml(text: &str) -> Result<Self, InvalidDescription> {
        let root = &XmlElement::parse(text)?;
        let version = FmiVersion::from_description(root)?;
        let co_simulation = root
            .child("CoSimulation")
            .ok_or(InvalidDescription::NoCoSimulation)?;
        if bool_attribute(co_simulation, "needsExecutionTool")? {
            return Err(InvalidDescription::NeedsTool);
        }
        let token = match version {
            FmiVersion::Two => "guid",
            FmiVersion::Three => "instantiationToken",
        };
        let model_identifier = read_identifier(co_simulation)?;
        let variables = read_variables(root, version)?;
        Ok(Self {
            version,
            model_name: required_attribute(root, "modelName")?.to_owned(),
            instantiation_token: required_attribute(root, token)?.to_owned(),
            model_identifier,
            is_once_per_process: bool_attribute(
                co_simulation,
                "canBeInstantiatedOnlyOncePerProcess",
            )?,
            variables,
        })
    }

    /// Yields the variables of a role.
    pub fn with_causality(&self, causality: Causality) -> impl Iterator<Item = &Variable> {
        self.variables
            .iter()
            .filter(move |variable| variable.causality == causality)
    }
}

/// Returns the file name of the library, which must be an identifier.
fn read_identifier(co_simulation: &XmlElement) -> Result<String, InvalidDescription> {
    let identifier = required_attribute(co_simulation, "modelIdentifier")?;
    let mut letters = identifier.chars();
    if identifier.is_empty() || !letters.all(|c| c.is_ascii_alphanumeric() || c == '_') {
        return Err(error_at(
            co_simulation,
            format!("modelIdentifier {identifier:?} is no identifier of C"),
        ));
    }
    Ok(identifier.to_owned())
}

/// Reads the variables that a controller can use, which must have different names.
fn read_variables(
    root: &XmlElement,
    version: FmiVersion,
) -> Result<Vec<Variable>, InvalidDescription> {
    let list = root
        .child("ModelVariables")
        .ok_or_else(|| error_at(root, "there is no element `ModelVariables`"))?;
    let declarations = Declarations::read(root, version)?;
    let mut variables: Vec<Variable> = Vec::new();
    for element in &list.children {
        variables.extend(read_variable(element, version, &declarations)?);
        if variables.len() > MAX_VARIABLES {
            return Err(error_at(
                element,
                format!("there are more than {MAX_VARIABLES} variables"),
            ));
        }
    }
    let mut names: Vec<&str> = variables
        .iter()
        .map(|variable| variable.name.as_str())
        .collect();
    names.sort_unstable();
    if let Some([name, _]) = names.array_windows().find(|[name, next]| name == next) {
        return Err(error_at(list, format!("there are two variables {name:?}")));
    }
    Ok(variables)
}

/// Reads a variable; none if a controller cannot use it.
fn read_variable(
    element: &XmlElement,
    version: FmiVersion,
    declarations: &Declarations<'_>,
) -> Result<Option<Variable>, InvalidDescription> {
    let Some(typed) = typed_element(element, version) else {
        return Ok(None);
    };
    let kind = match typed.name {
        "Real" | "Float64" => VariableType::Real,
        "Integer" | "Int32" => VariableType::Integer,
        _ => VariableType::Boolean,
    };
    let causality = match element.attribute("causality") {
        Some("input") => Causality::Input,
        Some("output") => Causality::Output,
        Some("parameter") => Causality::Parameter,
        _ => return Ok(None),
    };
    let reference = required_attribute(element, "valueReference")?;
    let reference = reference.parse().map_err(|_| {
        error_at(
            element,
            format!("valueReference {reference:?} is no whole number"),
        )
    })?;
    Ok(Some(Variable {
        name: required_attribute(element, "name")?.to_owned(),
        value_reference: reference,
        causality,
        kind,
        start: typed.attribute("start").map(str::to_owned),
        unit: if kind == VariableType::Real {
            declarations.unit_of(typed)?
        } else {
            None
        },
        description: element.attribute("description").map(str::to_owned),
    }))
}

/// Returns the element with the type of a variable: a child in FMI 2, and the element itself in FMI 3. None for other
/// types and for arrays.
fn typed_element(element: &XmlElement, version: FmiVersion) -> Option<&XmlElement> {
    match version {
        FmiVersion::Two => ["Real", "Integer", "Boolean"]
            .into_iter()
            .find_map(|name| element.child(name)),
        FmiVersion::Three => {
            let is_scalar = element.child("Dimension").is_none();
            let is_typed = ["Float64", "Int32", "Boolean"].contains(&element.name);
            (is_scalar && is_typed).then_some(element)
        }
    }
}

/// Returns the value of an attribute.
///
/// # Errors
/// [`InvalidDescription`] if the element has no such attribute.
pub(crate) fn required_attribute<'a>(
    element: &'a XmlElement,
    name: &str,
) -> Result<&'a str, InvalidDescription> {
    element.attribute(name).ok_or_else(|| {
        error_at(
            element,
            format!("`{}` has no attribute `{name}`", element.name),
        )
    })
}

/// Returns the value of a Boolean attribute, which is false by default.
///
/// # Errors
/// [`InvalidDescription`] for a value that is neither true nor false.
pub(crate) fn bool_attribute(element: &XmlElement, name: &str) -> Result<bool, InvalidDescription> {
    match element.attribute(name) {
        None | Some("false" | "0") => Ok(false),
        Some("true" | "1") => Ok(true),
        Some(other) => Err(error_at(
            element,
            format!("{name}: {other:?} is neither true nor false"),
        )),
    }
}

pub(crate) fn error_at(element: &XmlElement, problem: impl Into<String>) -> InvalidDescription {
    InvalidDescription::AtLine {
        line: element.line,
        problem: problem.into(),
    }
}

#[cfg(test)]
mod tests;
