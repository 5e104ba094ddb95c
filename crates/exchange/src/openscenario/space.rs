//! The search space of a scenario with random values of parameters.
//!
//! A space varies fields of a scenario, so each parameter must change exactly one number, in proportion. The scenarios
//! at three values of each parameter show which.

use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_world::scenario::NoDriverFiles;
use serde_json::Value;

use super::distribution::ParameterDistributionFile;
use super::error::ScenarioImportError;
use super::{ImportedLaneScenario, OpenScenarioSource};
use crumple_core::digits::format_compact;
use crumple_spaces::{
    Base, DistributionSpec, HistogramSpec, NormalSpec, ParameterSpec, SPACE_VERSION, ScenarioSpace,
    SpaceSpec, UniformSpec,
};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest deviation from proportionality, relative to the change.
const PROPORTION_TOLERANCE: f64 = 1e-6;
/// Maximum number of fields that an error lists.
const MAX_LISTED: usize = 10;

impl OpenScenarioSource {
    /// Returns the space of the random values of a file. `progress` receives the number of imported scenarios.
    ///
    /// # Errors
    /// [`ScenarioImportError`] if `progress` stops the import, for a scenario that cannot be imported, and for a
    /// parameter that does not change exactly one number of the scenario in proportion.
    pub fn space(
        &self,
        ego: Option<&str>,
        distributions: &ParameterDistributionFile,
        progress: &dyn Observer<RunProgress>,
    ) -> Result<(ScenarioSpace, Vec<String>)> {
        let refuse = |problem: String| distributions.root.refuse(problem);
        let counter =
            ProgressCounter::new(progress, Some(1 + 3 * distributions.random.len() as u64));
        let means: Vec<(String, String)> = distributions
            .random
            .iter()
            .map(|(name, of)| (name.clone(), format_compact(middle(of))))
            .collect();
        let ImportedLaneScenario { scenario, notes } = self.scenario(ego, &means)?;
        counter.add(1)?;
        let mut base = scenario.spec().clone();
        let mut parameters = Vec::new();
        for (name, distribution) in &distributions.random {
            let [low, high] = range(distribution);
            let at = |value: f64| {
                let mut assigned = means.clone();
                assigned
                    .iter_mut()
                    .filter(|(other, _)| other == name)
                    .for_each(|(_, old)| *old = format_compact(value));
                let imported = self.scenario(ego, &assigned)?;
                counter.add(1)?;
                Ok::<_, ScenarioImportError>(imported.scenario.spec().clone())
            };
            let (middle, mut first, mut last) = (0.5 * (low + high), at(low)?, at(high)?);
            let mut between = at(middle)?;
            base.duration_s = base.duration_s.max(first.duration_s).max(last.duration_s);
            for spec in [&mut first, &mut between, &mut last] {
                spec.duration_s = 0.0;
            }
            let mut changed = Vec::new();
            let values = [&first, &between, &last]
                .map(|spec| serde_json::to_value(spec).unwrap_or_default());
            find_changes(
                &values[0],
                &values[1],
                &values[2],
                String::new(),
                &mut changed,
            );
            let (field, [from, mid, to]) = match changed.as_slice() {
                [(field, Some(found))] => (field, *found),
                [] => return Err(refuse(format!("the parameter `{name}` changes nothing"))),
                several => {
                    let fields: Vec<_> = several
                        .iter()
                        .take(MAX_LISTED)
                        .map(|(field, _)| field.as_str())
                        .collect();
                    let problem = format!(
                        "the parameter `{name}` changes {}, not one number",
                        fields.join(", ")
                    );
                    return Err(refuse(problem));
                }
            };
            if (mid - 0.5 * (from + to)).abs() > PROPORTION_TOLERANCE * (to - from).abs() {
                return Err(refuse(format!(
                    "the parameter `{name}` changes {field}, but not in proportion"
                )));
            }
            let factor = (to - from) / (high - low);
            let map = |value: f64| from + factor * (value - low);
            let unit = crumple_spaces::field_unit(field, &base)
                .unwrap_or_default()
                .to_owned();
            let (name, field) = (identifier(name), field.clone());
            parameters.push(ParameterSpec {
                name,
                field,
                unit,
                nominal: None,
                distribution: mapped(distribution, &map),
            });
        }
        let spec = SpaceSpec {
            version: SPACE_VERSION,
            name: base.name.clone(),
            about: std::mem::take(&mut base.about),
            base: Base::Inline(Box::new(base)),
            parameters,
            dependence: None,
            exposure: None,
            observed: None,
        };
        let space = ScenarioSpace::new(spec, std::path::Path::new(""), &NoDriverFiles)
            .map_err(|invalid| refuse(invalid.to_string()))?;
        Ok((space, notes))
    }
}

/// Lists the fields that differ, with their numbers; `None` for a field that is no number.
fn find_changes(
    a: &Value,
    b: &Value,
    c: &Value,
    path: String,
    found: &mut Vec<(String, Option<[f64; 3]>)>,
) {
    match (a, b, c) {
        (Value::Object(a), Value::Object(b), Value::Object(c))
            if a.keys().eq(b.keys()) && a.keys().eq(c.keys()) =>
        {
            for ((key, a), (b, c)) in a.iter().zip(b.values().zip(c.values())) {
                let dot = if path.is_empty() { "" } else { "." };
                find_changes(a, b, c, format!("{path}{dot}{key}"), found);
            }
        }
        (Value::Array(a), Value::Array(b), Value::Array(c))
            if a.len() == b.len() && a.len() == c.len() =>
        {
            for (index, (a, (b, c))) in a.iter().zip(b.iter().zip(c)).enumerate() {
                find_changes(a, b, c, format!("{path}[{index}]"), found);
            }
        }
        _ if a == b && b == c => {}
        _ => found.push((
            path,
            a.as_f64()
                .zip(b.as_f64())
                .zip(c.as_f64())
                .map(|((a, b), c)| [a, b, c]),
        )),
    }
}

fn range(distribution: &DistributionSpec) -> [f64; 2] {
    match distribution {
        DistributionSpec::Uniform(of) => [of.low, of.high],
        DistributionSpec::Normal(of) => [of.low, of.high],
        DistributionSpec::Histogram(of) => {
            [of.edges.first(), of.edges.last()].map(|edge| edge.copied().unwrap_or(0.0))
        }
        _ => [0.0, 0.0],
    }
}

fn middle(distribution: &DistributionSpec) -> f64 {
    let [low, high] = range(distribution);
    match distribution {
        DistributionSpec::Normal(of) => of.mean.clamp(low, high),
        _ => 0.5 * (low + high),
    }
}

/// Returns the distribution of `map(value)`, which is linear.
fn mapped(distribution: &DistributionSpec, map: &impl Fn(f64) -> f64) -> DistributionSpec {
    let [low, high] = range(distribution).map(map);
    let [low, high] = [low.min(high), low.max(high)];
    match distribution {
        DistributionSpec::Normal(of) => {
            let deviation = (map(of.mean + of.deviation) - map(of.mean)).abs();
            DistributionSpec::Normal(NormalSpec {
                mean: map(of.mean),
                deviation,
                low,
                high,
            })
        }
        DistributionSpec::Histogram(of) => {
            let (mut edges, mut weights): (Vec<f64>, _) = (
                of.edges.iter().map(|edge| map(*edge)).collect(),
                of.weights.clone(),
            );
            if edges.first() > edges.last() {
                edges.reverse();
                weights.reverse();
            }
            DistributionSpec::Histogram(HistogramSpec { edges, weights })
        }
        _ => DistributionSpec::Uniform(UniformSpec { low, high }),
    }
}

/// Returns a name of letters, digits and underscores.
fn identifier(name: &str) -> String {
    name.chars()
        .map(|letter| {
            if letter.is_ascii_alphanumeric() {
                letter
            } else {
                '_'
            }
        })
        .collect()
}
