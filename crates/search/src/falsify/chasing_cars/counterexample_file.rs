//! Self-contained counterexample files of the benchmark.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{
    Benchmark, ChasingCarsError, ChasingCarsInputs, MARGIN_M, PIECES, SPECIFICATIONS, finer_robustness,
    replayed_robustness,
};
use crumple_world::scenario::file::{self, FileError};

/// Version of the file format.
pub const COUNTEREXAMPLE_VERSION: u32 = 1;

/// Inputs of Chasing Cars that violate a specification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CounterexampleFile {
    /// Version of the format: 1.
    pub version: u32,
    /// Always `chasing-cars`.
    pub problem: String,
    /// Name of the specification.
    pub spec: String,
    /// Formula of the specification over y1 to y5.
    pub formula: String,
    /// Method that found the counterexample.
    pub method: String,
    /// Seed of the run.
    pub seed: u64,
    /// Number of the evaluation, from 1.
    pub evaluation: usize,
    /// Robustness by the model and monitor of the search.
    pub robustness: f64,
    /// Robustness by the independent replay at a fifth of the step; missing in files of version 0.1.0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finer_robustness: Option<f64>,
    /// Throttle of each 5 s.
    pub throttle: [f64; PIECES],
    /// Brake of each 5 s.
    pub brake: [f64; PIECES],
}

impl Benchmark {
    /// Returns every counterexample as a file.
    #[must_use]
    pub fn counterexample_files(&self) -> Vec<CounterexampleFile> {
        let mut files = Vec::new();
        for row in &self.rows {
            let formula = SPECIFICATIONS.iter().find(|(name, _)| *name == row.spec).map_or("", |(_, text)| text);
            for run in &row.runs {
                let Some(found) = &run.counterexample else { continue };
                let inputs = [&found.throttle, &found.brake].map(|input| input.as_slice().try_into());
                let [Ok(throttle), Ok(brake)] = inputs else { continue };
                files.push(CounterexampleFile {
                    version: COUNTEREXAMPLE_VERSION,
                    problem: "chasing-cars".to_owned(),
                    spec: row.spec.clone(),
                    formula: formula.to_owned(),
                    method: self.method.clone(),
                    seed: run.seed,
                    evaluation: run.evaluations,
                    robustness: found.robustness,
                    finer_robustness: Some(found.finer_robustness),
                    throttle,
                    brake,
                });
            }
        }
        files
    }
}

impl CounterexampleFile {
    /// Returns a file name that is unique in a benchmark.
    #[must_use]
    pub fn file_name(&self) -> String {
        format!("{}-seed-{}.toml", self.spec, self.seed)
    }

    /// Returns the file as TOML.
    ///
    /// # Errors
    /// [`toml::ser::Error`] in principle; does not occur in practice.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`FileError`] for a file that cannot be read or parsed.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let text = file::read(path)?;
        file::parse_toml(&text, path)
    }

    /// Returns the robustness by the independent replay, from the content of the file alone.
    ///
    /// # Errors
    /// [`ChasingCarsError`] if the formula does not fit the model.
    pub fn replayed_robustness(&self) -> Result<f64, ChasingCarsError> {
        let inputs = ChasingCarsInputs { throttle: self.throttle, brake: self.brake };
        replayed_robustness(&self.formula.parse()?, &inputs)
    }

    /// Returns true if the replay violates the specification by more than `MARGIN_M`, at its step and at a fifth of it.
    ///
    /// # Errors
    /// [`ChasingCarsError`] if the formula does not fit the model.
    pub fn is_confirmed(&self) -> Result<bool, ChasingCarsError> {
        let inputs = ChasingCarsInputs { throttle: self.throttle, brake: self.brake };
        let finer_robustness = finer_robustness(&self.formula.parse()?, &inputs)?;
        Ok(self.replayed_robustness()?.max(finer_robustness) < -MARGIN_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falsify::Method;

    #[test]
    fn counterexamples_survive_their_files() {
        let measured = super::super::benchmark::run_benchmark(&Method::Auto, 30, 0, 1).unwrap();
        let files = measured.counterexample_files();
        assert!(files.len() >= 3, "{}", files.len());
        for file in files {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(file.file_name());
            std::fs::write(&path, file.to_toml().unwrap()).unwrap();
            let again = CounterexampleFile::load(&path).unwrap();
            assert_eq!(again, file);
            assert!(again.is_confirmed().unwrap());
            assert!((again.replayed_robustness().unwrap() - file.robustness).abs() < 1e-3);
        }
    }
}
