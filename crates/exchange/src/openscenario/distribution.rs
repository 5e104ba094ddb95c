//! Files with distributions of parameter values.

use std::collections::BTreeSet;
use std::path::Path;
use std::rc::Rc;

use super::error::ScenarioImportError;
use super::limits::ensure_at_most;
use super::parameters::{Parameters, read_assignment};
use super::source::FileCache;
use super::xml::{ElementLocation, Node, SourceElement};
use crumple_core::digits::{format_compact, format_number};
use crumple_sim::scenario::file::MAX_FILES;
use crumple_spaces::{DistributionSpec, HistogramSpec, NormalSpec, UniformSpec};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Maximum number of variations of a scenario.
pub const MAX_VARIATIONS: usize = MAX_FILES;
/// Maximum number of parameters with distributions.
const MAX_DISTRIBUTIONS: usize = 200;
/// Maximum number of bins of a histogram.
const MAX_BINS: usize = 1000;
/// Maximum number of values of all variations, and of bytes of their texts with the names of the parameters.
const MAX_VARIED_VALUES: f64 = 500_000.0;
const MAX_VARIED_BYTES: f64 = 64e6;
/// Range of a normal distribution without limits, in standard deviations.
const NORMAL_RANGE_DEVIATIONS: f64 = 6.0;

/// Values of parameters, with the names of the parameters.
pub type Variation = Vec<(String, String)>;

/// Distributions of the parameters of a scenario.
#[derive(Debug)]
pub struct ParameterDistributionFile {
    pub(super) root: Rc<SourceElement>,
    /// Values that vary together, one list for each distribution.
    axes: Vec<Vec<Variation>>,
    pub(super) random: Vec<RandomParameter>,
}

/// A parameter with random values.
#[derive(Debug)]
pub(super) struct RandomParameter {
    pub(super) name: String,
    pub(super) distribution: DistributionSpec,
    location: ElementLocation,
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
        let parsed = FileCache::new(false).parse(bytes, Path::new("d.xosc"), "OpenSCENARIO")?;
        Self::read(parsed, Path::new("f.xosc"))
    }

    fn read(root: Rc<SourceElement>, scenario: &Path) -> Result<Self> {
        let none = Parameters::default();
        let node = Node {
            element: &root,
            parameters: &none,
        };
        let holder = distribution_holder(node, scenario)?;
        let distributions = ["Deterministic", "Stochastic"]
            .iter()
            .filter_map(|kind| holder.optional(kind));
        let count = distributions.map(|list| list.children().count()).sum();
        ensure_at_most(holder, count, MAX_DISTRIBUTIONS, "distributions")?;
        let mut axes = Vec::new();
        let mut random = Vec::new();
        let mut names = DistinctNames::default();
        if let Some(list) = holder.optional("Deterministic") {
            for distribution in list.children() {
                let axis = read_deterministic(distribution)?;
                let parameters = axis.iter().flatten().map(|(name, _)| name.clone());
                names.add(distribution, parameters.collect())?;
                axes.push(axis);
            }
        }
        if let Some(list) = holder.optional("Stochastic") {
            list.only(
                &["StochasticDistribution"],
                &["numberOfTestRuns", "randomSeed"],
            )?;
            for distribution in list.children() {
                let parameter = RandomParameter::read(distribution)?;
                names.add(distribution, BTreeSet::from([parameter.name.clone()]))?;
                random.push(parameter);
            }
        }
        if axes.is_empty() == random.is_empty() {
            return Err(holder.refuse("must have either deterministic or stochastic distributions"));
        }
        Ok(Self { root, axes, random })
    }

    /// Returns true if values are random, so that the file describes a space.
    #[must_use]
    pub fn is_random(&self) -> bool {
        !self.random.is_empty()
    }

    /// Returns the number of parameters with random values.
    #[must_use]
    pub fn random_count(&self) -> usize {
        self.random.len()
    }

    /// Returns all combinations of the deterministic values.
    ///
    /// # Errors
    /// [`ScenarioImportError::Refused`] for more than [`MAX_VARIATIONS`], or for too many or too long values.
    pub fn variations(&self) -> Result<Vec<Variation>> {
        let count = self
            .axes
            .iter()
            .map(|axis| axis.len() as f64)
            .product::<f64>();
        if count > MAX_VARIATIONS as f64 {
            let problem = format!(
                "has {} combinations of values, and {MAX_VARIATIONS} are allowed",
                format_number(count)
            );
            return Err(self.root.refuse(problem));
        }
        self.check_texts(count)?;
        let mut variations: Vec<Variation> = vec![Vec::new()];
        for axis in &self.axes {
            variations = variations
                .iter()
                .flat_map(|before| axis.iter().map(|more| [&before[..], more].concat()))
                .collect();
        }
        Ok(variations)
    }

    /// Refuses more values than all variations may have together.
    fn check_texts(&self, variations: f64) -> Result<()> {
        let mut values = 0.0;
        let mut bytes = 0.0;
        for axis in &self.axes {
            let repetitions = variations / axis.len() as f64;
            let text = axis
                .iter()
                .flatten()
                .map(|(name, value)| name.len() + value.len())
                .sum::<usize>();
            values += repetitions * axis.iter().map(Vec::len).sum::<usize>() as f64;
            bytes += repetitions * text as f64;
        }
        if values > MAX_VARIED_VALUES || bytes > MAX_VARIED_BYTES {
            let problem = format!(
                "{MAX_VARIED_VALUES} values of parameters, or {MAX_VARIED_BYTES} bytes of them"
            );
            return Err(self
                .root
                .refuse(format!("the combinations have more than {problem}")));
        }
        Ok(())
    }
}

/// Names of parameters, each of which may have one distribution.
#[derive(Default)]
struct DistinctNames(BTreeSet<String>);

impl DistinctNames {
    /// Adds the parameters of a distribution.
    fn add(&mut self, node: Node<'_>, names: BTreeSet<String>) -> Result<()> {
        if let Some(name) = names.intersection(&self.0).next() {
            return Err(node.refuse(format!("the parameter `{name}` has two distributions")));
        }
        self.0.extend(names);
        Ok(())
    }
}

/// Returns the element with the distributions, which must be for the scenario file `scenario`.
fn distribution_holder<'a>(root: Node<'a>, scenario: &Path) -> Result<Node<'a>> {
    if root.optional("Storyboard").is_some() {
        return Err(root.refuse("is a scenario, not a file of distributions"));
    }
    root.only(&["FileHeader", "ParameterValueDistribution"], &[])?;
    let holder = root.child("ParameterValueDistribution")?;
    holder.only(&["ScenarioFile", "Deterministic", "Stochastic"], &[])?;
    let file = holder.child("ScenarioFile")?;
    let stated = file.text("filepath")?;
    if Path::new(&stated).file_name() != scenario.file_name() {
        return Err(file.refuse(format!(
            "the distributions are for `{stated}`, not for `{}`",
            scenario.display()
        )));
    }
    Ok(holder)
}

fn read_deterministic(node: Node<'_>) -> Result<Vec<Variation>> {
    let inner = node.single()?;
    let values = match (node.name(), inner.name()) {
        ("DeterministicMultiParameterDistribution", "ValueSetDistribution") => {
            inner.only(&["ParameterValueSet"], &[])?;
            ensure_at_most(
                inner,
                inner.children().count(),
                MAX_VARIATIONS,
                "sets of values",
            )?;
            inner
                .children()
                .map(|set| set.children().map(read_assignment).collect())
                .collect::<Result<Vec<Variation>>>()?
        }
        ("DeterministicSingleParameterDistribution", kind) => {
            node.only(
                &["DistributionSet", "DistributionRange"],
                &["parameterName"],
            )?;
            let name = node.text("parameterName")?;
            let values = if kind == "DistributionSet" {
                read_set(inner)?
            } else {
                read_steps(inner)?
            };
            values
                .into_iter()
                .map(|value| vec![(name.clone(), value)])
                .collect()
        }
        _ => return Err(inner.refuse(format!("is not supported in `{}`", node.name()))),
    };
    if values.is_empty() {
        Err(inner.refuse("has no values"))
    } else {
        Ok(values)
    }
}

fn read_set(node: Node<'_>) -> Result<Vec<String>> {
    node.only(&["Element"], &[])?;
    ensure_at_most(node, node.children().count(), MAX_VARIATIONS, "values")?;
    node.children()
        .map(|element| element.text("value"))
        .collect()
}

fn read_steps(node: Node<'_>) -> Result<Vec<String>> {
    node.only(&["Range"], &["stepWidth"])?;
    let [low, high] = read_range(node.child("Range")?)?;
    let width = node.number("stepWidth")?;
    let steps = ((high - low) / width + 1e-9).floor();
    if steps >= MAX_VARIATIONS as f64 && width > 0.0 {
        let count = format_number(steps + 1.0);
        return Err(node.refuse(format!(
            "has {count} values, and {MAX_VARIATIONS} are allowed"
        )));
    }
    if steps.is_nan() || steps < 0.0 || width <= 0.0 {
        let [width, low, high] = [width, low, high].map(format_number);
        return Err(node.refuse(format!(
            "stepWidth = {width} does not lead from {low} to {high}"
        )));
    }
    // Fifteen digits hide the rounding of the product.
    Ok((0..=steps as usize)
        .map(|step| format!("{:.14e}", low + step as f64 * width))
        .filter_map(|value| value.parse::<f64>().map(format_compact).ok())
        .collect())
}

fn read_range(node: Node<'_>) -> Result<[f64; 2]> {
    node.only(&[], &["lowerLimit", "upperLimit"])?;
    let [low, high] = [node.number("lowerLimit")?, node.number("upperLimit")?];
    if low <= high {
        Ok([low, high])
    } else {
        Err(node.refuse(format!(
            "{} is above {}",
            format_number(low),
            format_number(high)
        )))
    }
}

impl RandomParameter {
    fn read(node: Node<'_>) -> Result<Self> {
        node.only(
            &["NormalDistribution", "UniformDistribution", "Histogram"],
            &["parameterName"],
        )?;
        let inner = node.single()?;
        Ok(Self {
            name: node.text("parameterName")?,
            distribution: read_random(inner)?,
            location: inner.location(),
        })
    }

    /// Returns an error about the parameter; `problem` is a clause without subject.
    pub(super) fn refuse(&self, problem: &str) -> ScenarioImportError {
        let reason = format!("the parameter `{}` {problem}", self.name);
        self.location.refuse(&reason)
    }
}

fn read_random(node: Node<'_>) -> Result<DistributionSpec> {
    match node.name() {
        "UniformDistribution" => {
            node.only(&["Range"], &[])?;
            let [low, high] = read_range(node.child("Range")?)?;
            Ok(DistributionSpec::Uniform(UniformSpec { low, high }))
        }
        "NormalDistribution" => Ok(DistributionSpec::Normal(read_normal(node)?)),
        _ => Ok(DistributionSpec::Histogram(read_histogram(node)?)),
    }
}

fn read_normal(node: Node<'_>) -> Result<NormalSpec> {
    node.only(&["Range"], &["expectedValue", "variance"])?;
    let mean = node.number("expectedValue")?;
    let deviation = node.non_negative("variance")?.sqrt();
    let range = NORMAL_RANGE_DEVIATIONS * deviation;
    let [low, high] = node
        .optional("Range")
        .map_or(Ok([mean - range, mean + range]), read_range)?;
    Ok(NormalSpec {
        mean,
        deviation,
        low,
        high,
    })
}

/// Reads a histogram. Gaps between its bins become bins of weight 0.
fn read_histogram(node: Node<'_>) -> Result<HistogramSpec> {
    // `Bin` is the element of the standard; earlier releases of crumple read only `HistogramBin`.
    node.only(&["Bin", "HistogramBin"], &[])?;
    ensure_at_most(node, node.children().count(), MAX_BINS, "bins")?;
    let mut edges: Vec<f64> = Vec::new();
    let mut weights: Vec<f64> = Vec::new();
    for bin in node.children() {
        bin.only(&["Range"], &["weight"])?;
        let [low, high] = read_range(bin.child("Range")?)?;
        match edges.last() {
            None => edges.push(low),
            Some(end) if *end < low => {
                edges.push(low);
                weights.push(0.0);
            }
            Some(end) if *end > low => return Err(bin.refuse("bins must increase")),
            Some(_) => {}
        }
        edges.push(high);
        weights.push(bin.non_negative("weight")?);
    }
    if weights.iter().all(|weight| *weight == 0.0) {
        return Err(node.refuse("has no bin with a weight above 0"));
    }
    Ok(HistogramSpec { edges, weights })
}
