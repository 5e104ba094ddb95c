//! Files with distributions of parameter values.

use std::collections::BTreeSet;
use std::path::Path;
use std::rc::Rc;

use super::error::ScenarioImportError;
use super::parameters::{Parameters, read_assignment};
use super::source::FileCache;
use super::xml::{Node, SourceElement};
use crate::scenario::file::MAX_FILES;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Maximum number of variations of a scenario.
pub const MAX_VARIATIONS: usize = MAX_FILES;

/// Values of parameters, with the names of the parameters.
pub type Variation = Vec<(String, String)>;

/// Distributions of the parameters of a scenario.
#[derive(Debug)]
pub struct ParameterDistributionFile {
    root: Rc<SourceElement>,
    /// Values that vary together, one list for each distribution.
    axes: Vec<Vec<Variation>>,
}

impl ParameterDistributionFile {
    /// Reads the distributions of a file for the scenario file `scenario`.
    ///
    /// # Errors
    /// [`ScenarioImportError`] for a file that cannot be read, and for distributions that are not supported.
    pub fn load(path: &Path, scenario: &Path) -> Result<Self> {
        Self::read(FileCache::new(true).load(path, "OpenSCENARIO")?, scenario)
    }

    /// Parses distributions for the scenario `f.xosc`.
    ///
    /// # Errors
    /// [`ScenarioImportError`] for distributions that are not supported.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let parsed = SourceElement::parse(bytes, Path::new("d.xosc"), "OpenSCENARIO")?;
        Self::read(Rc::new(parsed), Path::new("f.xosc"))
    }

    fn read(root: Rc<SourceElement>, scenario: &Path) -> Result<Self> {
        let none = Parameters::default();
        let node = Node { element: &root, parameters: &none };
        if node.optional("Storyboard").is_some() {
            return Err(node.refuse("is a scenario, not a file of distributions"));
        }
        node.only(&["FileHeader", "ParameterValueDistribution"], &[])?;
        let holder = node.child("ParameterValueDistribution")?;
        holder.only(&["ScenarioFile", "Deterministic"], &[])?;
        let file = holder.child("ScenarioFile")?;
        let stated = file.text("filepath")?;
        if Path::new(&stated).file_name() != scenario.file_name() {
            return Err(file.refuse(format!("the distributions are for `{stated}`, not for `{}`", scenario.display())));
        }
        let mut axes = Vec::new();
        let mut known = BTreeSet::new();
        for one in holder.child("Deterministic")?.children() {
            let axis = read_deterministic(one)?;
            let names: BTreeSet<String> = axis.iter().flatten().map(|(name, _)| name.clone()).collect();
            if let Some(name) = names.intersection(&known).next() {
                return Err(one.refuse(format!("the parameter `{name}` has two distributions")));
            }
            known.extend(names);
            axes.push(axis);
        }
        Ok(Self { root, axes })
    }

    /// Returns all combinations of the deterministic values.
    ///
    /// # Errors
    /// [`ScenarioImportError::Refused`] for more than [`MAX_VARIATIONS`].
    pub fn variations(&self) -> Result<Vec<Variation>> {
        let count = self.axes.iter().map(|axis| axis.len() as f64).product::<f64>();
        if count > MAX_VARIATIONS as f64 {
            let problem = format!("has {count} combinations of values, and {MAX_VARIATIONS} are allowed");
            return Err(self.root.refuse(problem));
        }
        let mut found: Vec<Variation> = vec![Vec::new()];
        for axis in &self.axes {
            found = found.iter().flat_map(|before| axis.iter().map(|more| [&before[..], more].concat())).collect();
        }
        Ok(found)
    }
}

fn read_deterministic(node: Node<'_>) -> Result<Vec<Variation>> {
    let inner = node.single()?;
    let values = match (node.name(), inner.name()) {
        ("DeterministicMultiParameterDistribution", "ValueSetDistribution") => {
            inner.only(&["ParameterValueSet"], &[])?;
            inner
                .children()
                .map(|set| set.children().map(read_assignment).collect())
                .collect::<Result<Vec<Variation>>>()?
        }
        ("DeterministicSingleParameterDistribution", kind) => {
            node.only(&["DistributionSet", "DistributionRange"], &["parameterName"])?;
            let name = node.text("parameterName")?;
            let values = if kind == "DistributionSet" { read_set(inner)? } else { read_steps(inner)? };
            values.into_iter().map(|value| vec![(name.clone(), value)]).collect()
        }
        _ => return Err(inner.refuse(format!("is not supported in `{}`", node.name()))),
    };
    if values.is_empty() { Err(inner.refuse("has no values")) } else { Ok(values) }
}

fn read_set(node: Node<'_>) -> Result<Vec<String>> {
    node.only(&["Element"], &[])?;
    node.children().map(|element| element.text("value")).collect()
}

fn read_steps(node: Node<'_>) -> Result<Vec<String>> {
    node.only(&["Range"], &["stepWidth"])?;
    let ([low, high], width) = (read_range(node.child("Range")?)?, node.number("stepWidth")?);
    let steps = ((high - low) / width + 1e-9).floor();
    if !(0.0..=MAX_VARIATIONS as f64).contains(&steps) {
        return Err(node.refuse(format!("stepWidth = {width} does not divide the range from {low} to {high}")));
    }
    // Fifteen digits hide the rounding of the product.
    let value =
        |step: usize| format!("{:.14e}", low + step as f64 * width).parse::<f64>().map(|value| value.to_string());
    Ok((0..=steps as usize).filter_map(|step| value(step).ok()).collect())
}

fn read_range(node: Node<'_>) -> Result<[f64; 2]> {
    node.only(&[], &["lowerLimit", "upperLimit"])?;
    let [low, high] = [node.number("lowerLimit")?, node.number("upperLimit")?];
    if low <= high { Ok([low, high]) } else { Err(node.refuse(format!("{low} is above {high}"))) }
}
