//! The search space of a scenario with random values of parameters.
//!
//! A space varies fields of a scenario, so each parameter must change exactly one number, in proportion. The scenarios
//! at three values of each parameter show which.

use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_sim::scenario::{NoDriverFiles, ScenarioSpec};
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
        let random = &distributions.random;
        let counter = ProgressCounter::new(progress, Some(1 + 3 * random.len() as u64));
        let middles: Vec<(String, String)> = random
            .iter()
            .map(|parameter| {
                let middle = middle(&parameter.distribution);
                (parameter.name.clone(), format_compact(middle))
            })
            .collect();
        let ImportedLaneScenario {
            scenario, notes, ..
        } = self.scenario(ego, &middles)?;
        counter.add(1)?;
        let mut base = scenario.spec().clone();
        let mut parameters = Vec::new();
        for random in random {
            let importer = ParameterImporter {
                source: self,
                ego,
                middles: &middles,
                parameter: &random.name,
                counter: &counter,
            };
            let samples = importer.samples(range(&random.distribution))?;
            for sample in [&samples.at_low, &samples.at_high] {
                base.duration_s = base.duration_s.max(sample.duration_s);
            }
            let effect = samples.effect();
            let effect = effect.map_err(|problem| random.refuse(&problem))?;
            parameters.push(effect.parameter(&random.name, &random.distribution, &base));
        }
        let spec = space_spec(base, parameters);
        let space = ScenarioSpace::new(spec, std::path::Path::new(""), &NoDriverFiles)
            .map_err(|invalid| distributions.root.refuse(invalid.to_string()))?;
        Ok((space, notes))
    }
}

/// Imports scenarios that differ in the value of one parameter.
struct ParameterImporter<'a> {
    source: &'a OpenScenarioSource,
    ego: Option<&'a str>,
    /// Values of all random parameters in the middle of their distributions.
    middles: &'a [(String, String)],
    parameter: &'a str,
    counter: &'a ProgressCounter<'a>,
}

impl ParameterImporter<'_> {
    /// Imports the scenario with a value of the parameter.
    fn spec_at(&self, value: f64) -> Result<ScenarioSpec> {
        let mut assigned = self.middles.to_vec();
        assigned
            .iter_mut()
            .filter(|(name, _)| name == self.parameter)
            .for_each(|(_, text)| *text = format_compact(value));
        let imported = self.source.scenario(self.ego, &assigned)?;
        self.counter.add(1)?;
        Ok(imported.scenario.spec().clone())
    }

    /// Imports the scenarios at the ends and in the middle of the range of the parameter.
    fn samples(&self, [low, high]: [f64; 2]) -> Result<ParameterSamples> {
        Ok(ParameterSamples {
            low,
            high,
            at_low: self.spec_at(low)?,
            at_high: self.spec_at(high)?,
            at_middle: self.spec_at(0.5 * (low + high))?,
        })
    }
}

/// Scenarios at three values of a parameter.
struct ParameterSamples {
    low: f64,
    high: f64,
    at_low: ScenarioSpec,
    at_high: ScenarioSpec,
    at_middle: ScenarioSpec,
}

impl ParameterSamples {
    /// Returns the effect of the parameter on the scenario, apart from its duration. The error is a clause without
    /// subject.
    fn effect(mut self) -> std::result::Result<ParameterEffect, String> {
        let specs = [&mut self.at_low, &mut self.at_middle, &mut self.at_high];
        let [at_low, at_middle, at_high] = specs.map(|spec| {
            spec.duration_s = 0.0;
            serde_json::to_value(spec).unwrap_or_default()
        });
        let mut changes = Vec::new();
        find_changes(&at_low, &at_middle, &at_high, String::new(), &mut changes);
        match changes.as_slice() {
            [
                FieldChange {
                    field,
                    numbers: Some([from, middle, to]),
                },
            ] => {
                if (middle - 0.5 * (from + to)).abs() > PROPORTION_TOLERANCE * (to - from).abs() {
                    return Err(format!("changes {field}, but not in proportion"));
                }
                Ok(ParameterEffect {
                    field: field.clone(),
                    low: self.low,
                    from: *from,
                    factor: (to - from) / (self.high - self.low),
                })
            }
            [] => Err("changes nothing".to_owned()),
            several => {
                let fields = several
                    .iter()
                    .take(MAX_LISTED)
                    .map(|change| change.field.as_str());
                let fields: Vec<_> = fields.collect();
                Err(format!("changes {}, not one number", fields.join(", ")))
            }
        }
    }
}

/// A linear dependence of a number of a scenario on a parameter.
struct ParameterEffect {
    /// Field of the number.
    field: String,
    /// Lower end of the range of the parameter, and the number there.
    low: f64,
    from: f64,
    /// Change of the number by that of the parameter.
    factor: f64,
}

impl ParameterEffect {
    /// Returns the number at a value of the parameter.
    fn number(&self, value: f64) -> f64 {
        self.from + self.factor * (value - self.low)
    }

    /// Returns the parameter of the space that varies the number as the distribution of `name` does.
    fn parameter(
        &self,
        name: &str,
        distribution: &DistributionSpec,
        base: &ScenarioSpec,
    ) -> ParameterSpec {
        ParameterSpec {
            name: identifier(name),
            field: self.field.clone(),
            unit: crumple_spaces::field_unit(&self.field, base)
                .unwrap_or_default()
                .to_owned(),
            nominal: None,
            distribution: self.map(distribution),
        }
    }

    /// Returns the distribution of the number, given that of the parameter.
    fn map(&self, distribution: &DistributionSpec) -> DistributionSpec {
        let [low, high] = range(distribution).map(|value| self.number(value));
        let [low, high] = [low.min(high), low.max(high)];
        match distribution {
            DistributionSpec::Normal(normal) => {
                let mean = self.number(normal.mean);
                DistributionSpec::Normal(NormalSpec {
                    mean,
                    deviation: (self.number(normal.mean + normal.deviation) - mean).abs(),
                    low,
                    high,
                })
            }
            DistributionSpec::Histogram(histogram) => {
                let edges = histogram.edges.iter().map(|edge| self.number(*edge));
                let mut edges: Vec<f64> = edges.collect();
                let mut weights = histogram.weights.clone();
                if edges.first() > edges.last() {
                    edges.reverse();
                    weights.reverse();
                }
                DistributionSpec::Histogram(HistogramSpec { edges, weights })
            }
            _ => DistributionSpec::Uniform(UniformSpec { low, high }),
        }
    }
}

/// Returns the specification of a space that varies `parameters` of `base`.
fn space_spec(mut base: ScenarioSpec, parameters: Vec<ParameterSpec>) -> SpaceSpec {
    SpaceSpec {
        version: SPACE_VERSION,
        name: base.name.clone(),
        about: std::mem::take(&mut base.about),
        base: Base::Inline(Box::new(base)),
        parameters,
        dependence: None,
        exposure: None,
        observed: None,
    }
}

/// A field that differs between three scenarios.
struct FieldChange {
    field: String,
    /// Values in the three scenarios; `None` if they are no numbers.
    numbers: Option<[f64; 3]>,
}

/// Lists the fields that differ between three scenarios.
fn find_changes(a: &Value, b: &Value, c: &Value, field: String, changes: &mut Vec<FieldChange>) {
    match (a, b, c) {
        (Value::Object(a), Value::Object(b), Value::Object(c))
            if a.keys().eq(b.keys()) && a.keys().eq(c.keys()) =>
        {
            for ((key, a), (b, c)) in a.iter().zip(b.values().zip(c.values())) {
                let dot = if field.is_empty() { "" } else { "." };
                find_changes(a, b, c, format!("{field}{dot}{key}"), changes);
            }
        }
        (Value::Array(a), Value::Array(b), Value::Array(c))
            if a.len() == b.len() && a.len() == c.len() =>
        {
            for (index, (a, (b, c))) in a.iter().zip(b.iter().zip(c)).enumerate() {
                find_changes(a, b, c, format!("{field}[{index}]"), changes);
            }
        }
        _ if a == b && b == c => {}
        _ => changes.push(FieldChange {
            field,
            numbers: a
                .as_f64()
                .zip(b.as_f64())
                .zip(c.as_f64())
                .map(|((a, b), c)| [a, b, c]),
        }),
    }
}

fn range(distribution: &DistributionSpec) -> [f64; 2] {
    match distribution {
        DistributionSpec::Uniform(uniform) => [uniform.low, uniform.high],
        DistributionSpec::Normal(normal) => [normal.low, normal.high],
        DistributionSpec::Histogram(histogram) => {
            let ends = [histogram.edges.first(), histogram.edges.last()];
            ends.map(|edge| edge.copied().unwrap_or(0.0))
        }
        _ => [0.0, 0.0],
    }
}

fn middle(distribution: &DistributionSpec) -> f64 {
    let [low, high] = range(distribution);
    match distribution {
        DistributionSpec::Normal(normal) => normal.mean.clamp(low, high),
        _ => 0.5 * (low + high),
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
