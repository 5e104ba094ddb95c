//! Families of scenarios: a strategy of proptest, and scenarios from the bytes of a fuzzer.

use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arbitrary::Unstructured;
use crumple_controllers::Controllers;
use crumple_sim::scenario::file::{ScenarioFileError, load_all};
use crumple_sim::scenario::{Scenario, speed_dip};
use crumple_spaces::{FindSpaceError, InvalidSpace, ScenarioSpace, find_space};
use proptest::strategy::{NewTree, Strategy, ValueTree};
use proptest::test_runner::TestRunner;
use rand::Rng;

use super::generator::{Choices, SCENARIO_BYTES, read_scenario};
use super::near::space_near;
use super::shrink;

/// Bytes of the noise seed of a scenario.
const SEED_BYTES: usize = 8;

/// A family of scenarios. Bytes determine a scenario, and no bytes or zero bytes give the nominal one, in property
/// tests and in fuzzers.
///
/// ```
/// use crumple_testing::Scenarios;
///
/// let scenarios = Scenarios::space("high-risk").unwrap();
/// assert_eq!(scenarios.read(&[]), scenarios.read(&[0; 100]));
/// ```
#[derive(Debug, Clone)]
pub struct Scenarios(pub(super) Arc<Family>);

#[derive(Debug)]
pub(super) enum Family {
    Any,
    Space(Box<ScenarioSpace>),
    Files(Vec<Scenario>),
}

/// Reason why there is no such family of scenarios.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenariosError {
    /// There is no such space.
    #[error(transparent)]
    Space(#[from] FindSpaceError),
    /// A scenario has no space around it.
    #[error(transparent)]
    Near(#[from] InvalidSpace),
    /// A scenario file cannot be read.
    #[error(transparent)]
    File(#[from] ScenarioFileError),
    /// A folder has no scenario files.
    #[error("{} has no scenario files", .0.display())]
    Empty(PathBuf),
}

impl From<Infallible> for ScenariosError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}

impl Scenarios {
    /// Variations of the paper's scenario 1 in every field, with two to six vehicles and any drivers.
    #[must_use]
    pub fn any() -> Self {
        Self(Arc::new(Family::Any))
    }

    /// Variations of a scenario: gaps, speeds and the leader's script change by up to a quarter; friction falls by up
    /// to a quarter; reaction delays of vehicles under test grow by up to 0.3 s.
    ///
    /// # Errors
    /// [`ScenariosError::Near`] if no number of the scenario can vary.
    pub fn near(scenario: &Scenario) -> Result<Self, ScenariosError> {
        Ok(Self::from(space_near(scenario)?))
    }

    /// Scenarios of a built-in space, or of a space file. All parameters vary over their ranges, more densely near the
    /// nominal values; in a fitted space, within its likelihood region. Drivers of its traffic may not be programs:
    /// otherwise open the space with [`find_space`] and use `Scenarios::from`.
    ///
    /// # Errors
    /// [`ScenariosError::Space`] if there is no such space.
    pub fn space(name: &str) -> Result<Self, ScenariosError> {
        Ok(Self::from(find_space(name, &Controllers::default())?))
    }

    /// The scenario files of a folder, such as the episodes of a recording, as they are.
    ///
    /// # Errors
    /// [`ScenariosError`] if a file cannot be read, or there is none.
    pub fn files(folder: &Path) -> Result<Self, ScenariosError> {
        let all: Vec<_> = load_all(folder, &Controllers::default())?
            .into_iter()
            .map(|(_, scenario)| scenario)
            .collect();
        if all.is_empty() {
            Err(ScenariosError::Empty(folder.to_owned()))
        } else {
            Ok(Self(Arc::new(Family::Files(all))))
        }
    }

    /// Lines of five vehicles under test, which settle behind a leader that then slows down and recovers
    /// ([`speed_dip`]).
    ///
    /// # Errors
    /// None: the scenario is valid. Passes on the error.
    pub fn line_of_five() -> Result<Self, ScenariosError> {
        Self::near(
            &speed_dip(5, 1.5).map_err(|error| InvalidSpace::new("base", error.to_string()))?,
        )
    }

    /// Returns the number of bytes that determine a scenario.
    #[must_use]
    pub fn byte_count(&self) -> usize {
        match self.0.as_ref() {
            Family::Any => SCENARIO_BYTES,
            Family::Space(space) => SEED_BYTES + 2 * space.dimension(),
            Family::Files(_) => 2,
        }
    }

    /// Reads a scenario from bytes. Missing bytes are zero, and further bytes have no effect.
    #[must_use]
    pub fn read(&self, bytes: &[u8]) -> Scenario {
        match self.0.as_ref() {
            Family::Any => read_scenario(&mut Unstructured::new(bytes)),
            Family::Space(space) => read_point(space, bytes).scenario(space),
            Family::Files(all) => {
                let index = bytes
                    .iter()
                    .take(2)
                    .rev()
                    .fold(0, |index, &byte| 256 * index + usize::from(byte));
                all[index % all.len()].clone()
            }
        }
    }

    pub(super) fn random_bytes(&self, rng: &mut impl Rng) -> Vec<u8> {
        let mut bytes = vec![0; self.byte_count()];
        rng.fill_bytes(&mut bytes);
        bytes
    }
}

/// Reads the noise seed and the values of a space.
pub(super) fn read_point(space: &ScenarioSpace, bytes: &[u8]) -> SeededValues {
    let mut choices = Choices::new(bytes);
    let seed = choices.seed();
    let nominal = space.nominal();
    let centre = space.point(&nominal);
    let mut point: Vec<f64> = centre
        .iter()
        .map(|&at| choices.around(at, [0.0, 1.0]))
        .collect();
    while !space.is_in_search_region(&point) && point != centre {
        point
            .iter_mut()
            .zip(&centre)
            .for_each(|(at, centre)| *at = 0.5 * (*at + centre));
    }
    let values = space
        .values(&point)
        .into_iter()
        .zip(nominal)
        .zip(point.iter().zip(&centre));
    // The value at the nominal coordinate may differ from the nominal one by rounding.
    SeededValues {
        seed,
        values: values
            .map(|((value, nominal), (at, centre))| if at == centre { nominal } else { value })
            .collect(),
    }
}

/// The noise seed and the values of the parameters of a space.
#[derive(Debug, Clone)]
pub(super) struct SeededValues {
    pub(super) seed: u64,
    pub(super) values: Vec<f64>,
}

impl SeededValues {
    #[expect(
        clippy::expect_used,
        reason = "a space is valid at all points: a failure is a defect of crumple"
    )]
    pub(super) fn scenario(&self, space: &ScenarioSpace) -> Scenario {
        let scenario = space.scenario(&self.values).expect("valid at all points");
        scenario
            .edited(|spec| spec.seed = self.seed)
            .expect("any seed is valid")
    }
}

impl From<ScenarioSpace> for Scenarios {
    fn from(space: ScenarioSpace) -> Self {
        Self(Arc::new(Family::Space(Box::new(space))))
    }
}

/// A built-in space, a space file, a folder of scenario files, or `any`.
impl TryFrom<&str> for Scenarios {
    type Error = ScenariosError;

    fn try_from(name: &str) -> Result<Self, ScenariosError> {
        match name {
            "any" => Ok(Self::any()),
            folder if Path::new(folder).is_dir() => Self::files(Path::new(folder)),
            space => Self::space(space),
        }
    }
}

impl Strategy for Scenarios {
    type Tree = ScenarioTree;
    type Value = Scenario;

    fn new_tree(&self, runner: &mut TestRunner) -> NewTree<Self> {
        let bytes = self.random_bytes(runner.rng());
        Ok(ScenarioTree {
            current: self.read(&bytes),
            scenarios: self.clone(),
            bytes,
            answers: Vec::new(),
            asks: false,
        })
    }
}

/// A scenario that shrinks: to few changes from the nominal one, then to round numbers.
#[derive(Debug, Clone)]
pub struct ScenarioTree {
    scenarios: Scenarios,
    bytes: Vec<u8>,
    /// True for each candidate so far that failed, too.
    answers: Vec<bool>,
    /// True if `current` is a candidate without an answer.
    asks: bool,
    current: Scenario,
}

impl ScenarioTree {
    /// Repeats the shrinking with the answers so far, up to the next candidate. Returns false at the end.
    fn advance(&mut self) -> bool {
        let mut answers = self.answers.iter();
        let mut candidate = None;
        let simplest = shrink::shrink(&self.scenarios, &self.bytes, &mut |scenario| {
            answers.next().copied().unwrap_or_else(|| {
                candidate.get_or_insert_with(|| scenario.clone());
                false
            })
        });
        self.asks = candidate.is_some();
        self.current = candidate.unwrap_or(simplest.scenario);
        self.asks
    }
}

impl ValueTree for ScenarioTree {
    type Value = Scenario;

    fn current(&self) -> Scenario {
        self.current.clone()
    }

    fn simplify(&mut self) -> bool {
        self.answers.extend(self.asks.then_some(true));
        self.advance()
    }

    fn complicate(&mut self) -> bool {
        let asked = self.asks;
        self.answers.extend(asked.then_some(false));
        asked && self.advance()
    }
}
