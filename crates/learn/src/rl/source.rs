//! Sources of the scenarios of a training.

use std::fmt::Debug;
use std::sync::Arc;

use rand::RngExt;

use crumple_core::digest::{Sha256, sha256};

use crumple_sim::random::{self, Purpose};
use crumple_sim::scenario::{Driver, InvalidField, PAPER_STEP_S, PaperDistribution, Scenario};
use crumple_spaces::ScenarioSpace;

pub(super) const EGO: usize = 1;

/// Source of scenarios, one per episode.
pub trait ScenarioSource: Debug + Send + Sync {
    /// Returns the scenario of episode `index`. It depends on seed and index alone.
    ///
    /// # Errors
    /// [`InvalidField`] if the scenario is invalid.
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField>;

    /// Returns the factor on the weights of all costs in episode `index`.
    fn cost_multiplier(&self, _seed: u64, _index: u64) -> f64 {
        1.0
    }

    /// Returns the largest factor, at least 1.
    fn max_cost_multiplier(&self) -> f64 {
        1.0
    }

    /// Returns an identity for resumed trainings and policy files; none for the paper's distribution.
    ///
    /// # Errors
    /// The error of the encoder.
    fn identity(&self) -> Result<Option<String>, serde_json::Error>;
}

/// Paper's distribution, on which the presets train.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaperSource;

impl ScenarioSource for PaperSource {
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        PaperDistribution { seed }.draw(index)
    }

    fn identity(&self) -> Result<Option<String>, serde_json::Error> {
        Ok(None)
    }
}

impl ScenarioSource for ScenarioSpace {
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        Self::draw(self, seed, index)
    }

    fn identity(&self) -> Result<Option<String>, serde_json::Error> {
        let digest = sha256(crumple_spaces::file::to_identity_json(self)?);
        Ok(Some(format!(
            "the space `{}` (sha256 {digest})",
            self.name()
        )))
    }
}

/// Random mixture of two sources.
#[derive(Debug, Clone)]
pub struct SourceMixture {
    first: Arc<dyn ScenarioSource>,
    first_share: f64,
    second: Arc<dyn ScenarioSource>,
}

impl SourceMixture {
    /// Creates a mixture that draws a `share` of the episodes, clipped to `[0, 1]`, from `first`, the others from
    /// `otherwise`. Each episode equals that of its source alone.
    #[must_use]
    pub fn new(
        first: Arc<dyn ScenarioSource>,
        share: f64,
        otherwise: Arc<dyn ScenarioSource>,
    ) -> Self {
        Self {
            first,
            first_share: share.clamp(0.0, 1.0),
            second: otherwise,
        }
    }

    fn source_for(&self, seed: u64, index: u64) -> &Arc<dyn ScenarioSource> {
        let mut stream = random::stream(
            random::derived_seed(seed, MIXTURE_SEED_INDEX),
            Purpose::ScenarioSampling,
            index,
        );
        if stream.random::<f64>() < self.first_share {
            &self.first
        } else {
            &self.second
        }
    }
}

/// Separates the random stream of a mixture from that of a mixture inside it.
const MIXTURE_SEED_INDEX: u64 = u64::MAX - 2;

impl ScenarioSource for SourceMixture {
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        self.source_for(seed, index).draw(seed, index)
    }

    fn cost_multiplier(&self, seed: u64, index: u64) -> f64 {
        self.source_for(seed, index).cost_multiplier(seed, index)
    }

    fn max_cost_multiplier(&self) -> f64 {
        self.first
            .max_cost_multiplier()
            .max(self.second.max_cost_multiplier())
    }

    fn identity(&self) -> Result<Option<String>, serde_json::Error> {
        Ok(Some(format!(
            "a share of {} of {}, otherwise {}",
            self.first_share,
            source_name(&self.first)?,
            source_name(&self.second)?
        )))
    }
}

fn source_name(source: &Arc<dyn ScenarioSource>) -> Result<String, serde_json::Error> {
    Ok(source
        .identity()?
        .unwrap_or_else(|| "the paper's distribution".to_owned()))
}

/// List of scenarios, such as counterexamples, mixed into another source.
#[derive(Debug, Clone)]
pub struct CaseMixture {
    cases: Vec<Scenario>,
    case_share: f64,
    base: Arc<dyn ScenarioSource>,
}

impl CaseMixture {
    /// Creates a mixture: a `share` of the episodes are `cases`, uniformly chosen; the rest are of `otherwise`.
    #[must_use]
    pub fn new(cases: Vec<Scenario>, share: f64, otherwise: Arc<dyn ScenarioSource>) -> Self {
        Self {
            cases,
            case_share: share.clamp(0.0, 1.0),
            base: otherwise,
        }
    }

    /// Returns the case of an episode; none if the other source provides it.
    fn case_for(&self, seed: u64, index: u64) -> Option<&Scenario> {
        let mut stream = random::stream(
            random::derived_seed(seed, CASE_SEED_INDEX),
            Purpose::ScenarioSampling,
            index,
        );
        let is_turn = !self.cases.is_empty() && stream.random::<f64>() < self.case_share;
        if is_turn {
            self.cases.get(stream.random_range(0..self.cases.len()))
        } else {
            None
        }
    }
}

/// Separates the random stream of the mixture from those of its sources.
const CASE_SEED_INDEX: u64 = u64::MAX - 1;

impl ScenarioSource for CaseMixture {
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        self.case_for(seed, index)
            .map_or_else(|| self.base.draw(seed, index), |case| Ok(case.clone()))
    }

    fn cost_multiplier(&self, seed: u64, index: u64) -> f64 {
        self.case_for(seed, index)
            .map_or_else(|| self.base.cost_multiplier(seed, index), |_| 1.0)
    }

    fn max_cost_multiplier(&self) -> f64 {
        self.base.max_cost_multiplier()
    }

    fn identity(&self) -> Result<Option<String>, serde_json::Error> {
        let mut digest = Sha256::default();
        for case in &self.cases {
            digest.update(serde_json::to_string(case.spec())?);
        }
        Ok(Some(format!(
            "a share of {} of {} cases (sha256 {}), otherwise {}",
            self.case_share,
            self.cases.len(),
            digest.hexadecimal(),
            source_name(&self.base)?
        )))
    }
}

/// Returns the reason why the agent cannot be trained on a scenario; none if it can.
#[must_use]
pub fn unsuitability(scenario: &Scenario) -> Option<String> {
    let vehicles = scenario.vehicles().iter().enumerate();
    let agents: Vec<usize> = vehicles
        .filter(|(_, vehicle)| vehicle.driver == Driver::UnderTest)
        .map(|(index, _)| index)
        .collect();
    if agents != [EGO] {
        return Some(format!(
            "only vehicle {EGO} must be under test, found {agents:?}"
        ));
    }
    if !scenario.keeps_lanes() {
        return Some("every vehicle must stay in the lane".to_owned());
    }
    let step_s = scenario.spec().step_s;
    (step_s != PAPER_STEP_S).then(|| format!("the step must be {PAPER_STEP_S} s, found {step_s}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::scenario::built_in_scenario;

    #[test]
    fn cases_get_their_share_and_other_episodes_are_unchanged() {
        let cases = vec![
            built_in_scenario("paper-1").unwrap(),
            built_in_scenario("paper-2").unwrap(),
        ];
        let mixed = CaseMixture::new(cases.clone(), 0.3, Arc::new(PaperSource));
        let mut counts = [0_u32; 2];
        for index in 0..4000 {
            let drawn = mixed.draw(7, index).unwrap();
            match cases.iter().position(|case| *case == drawn) {
                Some(case) => counts[case] += 1,
                None => assert_eq!(drawn, PaperSource.draw(7, index).unwrap()),
            }
        }
        // Four standard deviations of a count of mean 600.
        assert!(
            counts.iter().all(|count| count.abs_diff(600) < 4 * 23),
            "{counts:?}"
        );
        let none = CaseMixture::new(Vec::new(), 1.0, Arc::new(PaperSource));
        assert_eq!(none.draw(7, 0).unwrap(), PaperSource.draw(7, 0).unwrap());
    }

    #[test]
    fn a_source_mixture_takes_its_share_of_each_source_unchanged() {
        let space = crumple_spaces::built_in_space("high-risk").unwrap();
        let blend = SourceMixture::new(Arc::new(PaperSource), 0.25, Arc::new(space.clone()));
        let nominal = (0..2000).filter(|&index| {
            let drawn = blend.draw(7, index).unwrap();
            let is_nominal = drawn == PaperSource.draw(7, index).unwrap();
            assert!(is_nominal || drawn == space.draw(7, index).unwrap());
            is_nominal
        });
        // Four standard deviations of a count of mean 500.
        assert!(nominal.count().abs_diff(500) < 4 * 20);
        let identity = blend.identity().unwrap().unwrap();
        let expected =
            "a share of 0.25 of the paper's distribution, otherwise the space `high-risk`";
        assert!(identity.starts_with(expected), "{identity}");
    }

    #[test]
    fn a_source_is_known_by_its_cases_and_their_share() {
        let draws_of = |name: &str, share| {
            CaseMixture::new(
                vec![built_in_scenario(name).unwrap()],
                share,
                Arc::new(PaperSource),
            )
            .identity()
            .unwrap()
        };
        assert_eq!(draws_of("paper-1", 0.5), draws_of("paper-1", 0.5));
        assert_ne!(draws_of("paper-1", 0.5), draws_of("paper-2", 0.5));
        assert_ne!(draws_of("paper-1", 0.5), draws_of("paper-1", 0.6));
    }

    #[test]
    fn scenarios_that_the_agent_cannot_drive_are_known() {
        assert_eq!(unsuitability(&PaperSource.draw(0, 0).unwrap()), None);
        assert!(
            unsuitability(&built_in_scenario("paper-3").unwrap())
                .unwrap()
                .contains("found [1, 2, 3]")
        );
        let coarse = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| spec.step_s = 0.02)
            .unwrap();
        assert!(unsuitability(&coarse).unwrap().contains("found 0.02"));
    }
}
