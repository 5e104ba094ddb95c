//! Tests of a controller in many scenarios.

use std::path::{Path, PathBuf};
use std::{env, fs, io, panic, thread};

use crumple_controllers::Controllers;
use crumple_core::digest::sha256;
use crumple_core::quoting::ShellWord;
use crumple_sim::control::{BuiltInController, IntoSource};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::random::{Purpose, stream};
use crumple_sim::scenario::Scenario;
use crumple_sim::scenario::file::{load_all, to_toml};
use rayon::prelude::*;

use super::failure::{CheckError, CheckSummary, PropertyFailure};
use super::shrink::{ShrunkScenario, shrink};
use super::{ControllerUnderTest, Property, PropertyVerdict, Scenarios, ScenariosError, drawing};

const DEFAULT_CASES: u32 = 256;
/// Number of cases after which a test stops if one of them violates a property.
const BATCH_CASES: u32 = 4096;
/// Environment variables: number of cases and seed of every check, and a scenario file that replaces all cases.
const CASES: &str = "CRUMPLE_TEST_CASES";
const SEED: &str = "CRUMPLE_TEST_SEED";
const REPLAY: &str = "CRUMPLE_TEST_REPLAY";

/// A test of a controller: properties that it must have in scenarios.
///
/// One seed determines all scenarios, for any number of threads.
#[derive(Debug)]
#[must_use]
pub struct ControllerCheck {
    controller: ControllerUnderTest,
    scenarios: Result<Scenarios, ScenariosError>,
    properties: Vec<Property>,
    cases: u32,
    seed: u64,
    corpus: PathBuf,
    controllers: Controllers,
}

/// Creates a test of a controller: a built-in one, one that [`NamedController`](crumple_sim::engine::NamedController)
/// finds, an `Arc` of a [`ControllerSource`](crumple_sim::control::ControllerSource), or a function
/// ([`stateless`](super::stateless)).
///
/// The test has 256 cases in any scenarios, and by default the property [`Property::no_avoidable_collision`].
///
/// ```
/// use crumple_testing::{Property, check, stateless};
///
/// let brake = check(stateless(|_| -9.0)).on("traffic").property(Property::no_unnecessary_braking()).cases(10);
/// # let brake = brake.corpus(std::env::temp_dir().join("crumple-testing-doctest"));
/// assert!(brake.run().unwrap_err().to_string().contains("no unnecessary braking"));
/// ```
pub fn check(controller: impl IntoSource) -> ControllerCheck {
    let folder = env::var_os("CARGO_MANIFEST_DIR")
        .map(PathBuf::from)
        .unwrap_or_default();
    ControllerCheck {
        controller: ControllerUnderTest {
            source: controller.into_source(),
            estimator: EstimatorKind::default(),
        },
        scenarios: Ok(Scenarios::any()),
        properties: Vec::new(),
        cases: DEFAULT_CASES,
        seed: 0,
        corpus: folder
            .join("crumple-corpus")
            .join(test_name().replace("::", "-")),
        controllers: Controllers::default(),
    }
}

impl ControllerCheck {
    /// Sets the permission for programs that scenario files of the corpus name as drivers. Default: refused.
    pub fn controllers_of_files(mut self, controllers: Controllers) -> Self {
        self.controllers = controllers;
        self
    }

    /// Sets the scenarios: [`Scenarios`], or the name of a built-in space, the path of a space file or of a folder of
    /// scenario files, or `any`.
    pub fn on<S: TryInto<Scenarios>>(mut self, scenarios: S) -> Self
    where
        ScenariosError: From<S::Error>,
    {
        self.scenarios = scenarios.try_into().map_err(Into::into);
        self
    }

    /// Adds a property.
    pub fn property(mut self, property: Property) -> Self {
        self.properties.push(property);
        self
    }

    /// Sets the number of cases, unless the environment variable `CRUMPLE_TEST_CASES` does. A test stops after 4096
    /// cases, or a multiple of 4096, of which one violates a property.
    pub fn cases(mut self, normal: u32) -> Self {
        self.cases = normal;
        self
    }

    /// Sets the seed of all scenarios, unless the environment variable `CRUMPLE_TEST_SEED` does; by default 0.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets the estimator of the controller's observations; by default a Kalman filter of noisy sensors.
    pub fn estimator(mut self, estimator: EstimatorKind) -> Self {
        self.controller.estimator = estimator;
        self
    }

    /// Sets the folder for failures, which the next run starts with; by default `crumple-corpus/TEST` in the package.
    pub fn corpus(mut self, folder: impl Into<PathBuf>) -> Self {
        self.corpus = folder.into();
        self
    }

    /// Runs the test and panics if it fails.
    ///
    /// # Panics
    /// For a [`CheckError`].
    #[expect(clippy::panic, reason = "test programs report panics")]
    pub fn assert(self) {
        if let Err(error) = self.run() {
            panic!("{error}");
        }
    }

    /// Evaluates the scenario of a fuzzer's input and panics if a property is violated.
    ///
    /// # Panics
    /// For a [`CheckError`], after shrinking; the scenario is in the corpus.
    #[expect(clippy::panic, reason = "fuzzers report panics")]
    pub fn assert_input(&self, bytes: &[u8]) {
        let scenarios = self
            .scenarios
            .as_ref()
            .unwrap_or_else(|error| panic!("{error}"));
        // libFuzzer's hook ends the program at the first panic of a controller, before shrinking.
        let hook = panic::take_hook();
        panic::set_hook(Box::new(|_| ()));
        let failure = self.properties().into_iter().find_map(|property| {
            let PropertyVerdict::Violated(finding) =
                self.evaluate(&property, &scenarios.read(bytes))
            else {
                return None;
            };
            let count = "an input of a fuzzer violates it".to_owned();
            Some(self.shrink_and_write(&property, finding, scenarios, bytes, count))
        });
        panic::set_hook(hook);
        match failure {
            Some(Ok(failure)) => panic!("{failure}"),
            Some(Err(error)) => panic!("{error}"),
            None => {}
        }
    }

    fn properties(&self) -> Vec<Property> {
        if self.properties.is_empty() {
            vec![Property::no_avoidable_collision()]
        } else {
            self.properties.clone()
        }
    }

    /// Evaluates the scenarios of the corpus and then random ones.
    ///
    /// # Errors
    /// [`CheckError`], for the first violated property of the first scenario.
    pub fn run(mut self) -> Result<CheckSummary, CheckError> {
        self.cases = number_in(CASES)?.unwrap_or(self.cases);
        self.seed = number_in(SEED)?.unwrap_or(self.seed);
        let properties = self.properties();
        let scenarios = std::mem::replace(&mut self.scenarios, Ok(Scenarios::any()))?;
        let replayed = env::var_os(REPLAY).map(PathBuf::from);
        let path = replayed.as_deref().unwrap_or(&self.corpus);
        let corpus = if path.exists() || replayed.is_some() {
            load_all(path, &self.controllers)?
        } else {
            Vec::new()
        };
        self.cases = if replayed.is_some() { 0 } else { self.cases };
        self.check_corpus(&properties, &corpus)?;
        let mut summary = CheckSummary {
            evaluated: 0,
            not_applicable: 0,
        };
        for property in &properties {
            summary.not_applicable += self.check_random(property, &scenarios)?;
            summary.evaluated += self.cases as usize;
        }
        Ok(summary)
    }

    /// Evaluates the scenarios of the corpus. Without random scenarios, one of them must test each property.
    fn check_corpus(
        &self,
        properties: &[Property],
        corpus: &[(PathBuf, Scenario)],
    ) -> Result<(), CheckError> {
        let mut reasons = vec![Some("there are no scenarios".to_owned()); properties.len()];
        for (file, scenario) in corpus {
            for (property, reason) in properties.iter().zip(&mut reasons) {
                match self.evaluate(property, scenario) {
                    PropertyVerdict::Holds => *reason = None,
                    PropertyVerdict::NotApplicable(why) => {
                        *reason = reason.is_some().then_some(why)
                    }
                    PropertyVerdict::Violated(finding) => {
                        let failure = self.corpus_failure(property, finding, scenario, file);
                        return Err(failure.into());
                    }
                }
            }
        }
        let untested = properties
            .iter()
            .zip(reasons)
            .find_map(|(property, reason)| Some((property, reason?)));
        match untested {
            Some((property, reason)) if self.cases == 0 => Err(CheckError::NotTested {
                property: property.name().to_owned(),
                reason,
            }),
            _ => Ok(()),
        }
    }

    fn corpus_failure(
        &self,
        property: &Property,
        finding: String,
        scenario: &Scenario,
        file: &Path,
    ) -> Box<PropertyFailure> {
        let unchanged = ShrunkScenario {
            scenario: scenario.clone(),
            changes: Vec::new(),
        };
        let count = "a scenario of the corpus".to_owned();
        Box::new(self.failure(property, finding, unchanged, file.to_owned(), count))
    }

    /// Evaluates random scenarios and returns the number of those that do not test the property.
    fn check_random(
        &self,
        property: &Property,
        scenarios: &Scenarios,
    ) -> Result<usize, CheckError> {
        let mut not_applicable = 0;
        let mut last_reason = String::new();
        for from in (0..self.cases).step_by(BATCH_CASES as usize) {
            let to = self.cases.min(from.saturating_add(BATCH_CASES));
            let batch: Vec<_> = (from..to)
                .into_par_iter()
                .map(|case| self.evaluate_case(property, scenarios, case))
                .collect();
            let mut failing = 0;
            let mut first = None;
            for (verdict, bytes) in batch {
                match verdict {
                    PropertyVerdict::Holds => {}
                    PropertyVerdict::NotApplicable(reason) => {
                        not_applicable += 1;
                        last_reason = reason;
                    }
                    PropertyVerdict::Violated(finding) => {
                        failing += 1;
                        first.get_or_insert((finding, bytes));
                    }
                }
            }
            if let Some((finding, bytes)) = first {
                let count = format!("{failing} of {to} cases violate it (seed {})", self.seed);
                return Err(self
                    .shrink_and_write(property, finding, scenarios, &bytes, count)?
                    .into());
            }
        }
        if not_applicable > 0 && not_applicable == self.cases as usize {
            return Err(CheckError::NotTested {
                property: property.name().to_owned(),
                reason: last_reason,
            });
        }
        Ok(not_applicable)
    }

    /// Returns the verdict of the random scenario of a case, and the bytes of the scenario.
    fn evaluate_case(
        &self,
        property: &Property,
        scenarios: &Scenarios,
        case: u32,
    ) -> (PropertyVerdict, Vec<u8>) {
        let mut rng = stream(self.seed, Purpose::ScenarioSampling, case.into());
        let bytes = scenarios.random_bytes(&mut rng);
        (self.evaluate(property, &scenarios.read(&bytes)), bytes)
    }

    fn evaluate(&self, property: &Property, scenario: &Scenario) -> PropertyVerdict {
        property.evaluate(&self.controller, scenario)
    }

    fn shrink_and_write(
        &self,
        property: &Property,
        first_finding: String,
        scenarios: &Scenarios,
        bytes: &[u8],
        count: String,
    ) -> Result<Box<PropertyFailure>, CheckError> {
        let mut simulated = 0;
        let mut shrunk = shrink(scenarios, bytes, &mut |scenario| {
            simulated += 1;
            matches!(
                self.evaluate(property, scenario),
                PropertyVerdict::Violated(_)
            )
        });
        shrunk.scenario = self.controller.adapt(&shrunk.scenario);
        let PropertyVerdict::Violated(finding) = self.evaluate(property, &shrunk.scenario) else {
            let finding = format!(
                "{first_finding}; this does not recur: the controller is not deterministic"
            );
            return Ok(Box::new(self.failure(
                property,
                finding,
                shrunk,
                PathBuf::new(),
                count,
            )));
        };
        let text = to_toml(&shrunk.scenario).unwrap_or_default();
        let file = self
            .corpus
            .join(corpus_file_name(property, &text))
            .with_extension("toml");
        let count = format!("{count}; shrunk by {simulated} evaluations");
        self.write_to_corpus(&file, &shrunk.scenario, &text)
            .map_err(|source| CheckError::Write {
                path: self.corpus.clone(),
                source,
            })?;
        Ok(Box::new(
            self.failure(property, finding, shrunk, file, count),
        ))
    }

    /// Writes the text of a scenario and the drawing of its run.
    fn write_to_corpus(&self, file: &Path, scenario: &Scenario, text: &str) -> io::Result<()> {
        fs::create_dir_all(&self.corpus)?;
        let curves = self.controller.curves(scenario);
        fs::write(
            file.with_extension("svg"),
            drawing::to_svg(&curves, scenario.spec().duration_s),
        )?;
        fs::write(file, text)
    }

    fn failure(
        &self,
        property: &Property,
        finding: String,
        shrunk: ShrunkScenario,
        file: PathBuf,
        count: String,
    ) -> PropertyFailure {
        let ShrunkScenario { scenario, changes } = shrunk;
        let drawing = self.controller.draw(&scenario);
        let replay = self.replay_commands(&file);
        PropertyFailure {
            property: property.name().to_owned(),
            finding,
            scenario,
            file,
            changes,
            count,
            replay,
            drawing,
        }
    }

    fn replay_commands(&self, file: &Path) -> Vec<String> {
        let file = file.to_string_lossy();
        let package =
            env::var("CARGO_PKG_NAME").map_or_else(|_| String::new(), |name| format!(" -p {name}"));
        let test = format!(
            "{REPLAY}={} cargo test{package} {} -- --exact",
            ShellWord(&file),
            test_name()
        );
        let source = &self.controller.source;
        let name = match source.downcast_ref::<BuiltInController>() {
            Some(spec) => Some(spec.to_arg()),
            None => source
                .file()
                .map(|file| file.path().to_string_lossy().into_owned()),
        };
        let simulate = name.map(|name| {
            let estimator = self.controller.estimator.name();
            let controller = ShellWord(&name);
            format!(
                "crumple simulate {} --controller {controller} --estimator {estimator}",
                ShellWord(&file)
            )
        });
        std::iter::once(test).chain(simulate).collect()
    }
}

/// Returns the name of the file of a scenario, without extension: the violated property and a digest of the text.
fn corpus_file_name(property: &Property, text: &str) -> String {
    let slug = property
        .name()
        .replace(|letter: char| !letter.is_ascii_alphanumeric(), "-");
    format!(
        "{}-{}",
        slug.get(..40).unwrap_or(&slug),
        sha256(text).get(..8).unwrap_or_default()
    )
}

/// Returns the number in an environment variable; `None` without the variable.
fn number_in<T: std::str::FromStr>(variable: &'static str) -> Result<Option<T>, CheckError> {
    let Some(value) = env::var_os(variable) else {
        return Ok(None);
    };
    let value = value.to_string_lossy().into_owned();
    value
        .parse()
        .map(Some)
        .map_err(|_| CheckError::Variable { variable, value })
}

/// Returns the path of the running test: test programs name its thread after it.
fn test_name() -> String {
    thread::current().name().unwrap_or("main").to_owned()
}
