//! Search of a round for avoidable failures.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::RetrainError;
use super::cases::{Cases, CollidingDraws};
use super::corpus::{classify_scenarios, colliding_indices};
use super::progress::{RetrainingObserver, RetrainingProgress};
use super::round::{RoundContext, named_policy};
use super::test_set::witnesses;
use crate::rl::ScenarioSource;
use crumple_search::falsify::campaign::{Campaign, CampaignProgress};
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_sim::control::IntoSource;
use crumple_sim::engine::NamedController;
use crumple_sim::scenario::{Scenario, file};
use crumple_store::run_folder::encode_json;
use crumple_store::study::Study;

const FINDINGS: &str = "found.json";
const SEARCH: &str = "search";

/// Results of a search.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundFindings {
    /// Evaluations of the campaign, by all its methods.
    pub evaluations: u64,
    /// Evaluations that ended in a collision.
    pub failures: u64,
    /// Distinct avoidable counterexamples.
    pub avoidable: usize,
    /// Counterexamples that are proved unavoidable.
    pub unavoidable: usize,
    /// Undecided counterexamples.
    pub undecided: usize,
    /// Random scenarios of the space that were simulated besides.
    pub draws: u64,
    /// Random scenarios that ended in a collision.
    #[serde(alias = "draws_touched")]
    pub colliding_draws: usize,
    /// Avoidable random scenarios among them.
    #[serde(alias = "draws_avoidable")]
    pub avoidable_draws: CollidingDraws,
    /// Avoidable counterexamples, by the file of the scenario.
    pub counterexamples: Vec<String>,
}

impl RoundFindings {
    /// Returns true if nothing that was found is avoidable.
    pub(super) fn is_empty(&self) -> bool {
        self.avoidable == 0 && self.avoidable_draws.indices.is_empty()
    }

    pub(super) fn count(&mut self, class: AvoidabilityClass) {
        match class {
            AvoidabilityClass::Avoidable => self.avoidable += 1,
            AvoidabilityClass::Unavoidable => self.unavoidable += 1,
            AvoidabilityClass::Undecided => self.undecided += 1,
            AvoidabilityClass::NotAsked => {}
        }
    }
}

impl RoundContext<'_> {
    /// Searches for counterexamples, or returns the stored result.
    pub(super) fn search(
        &self,
        watch: &RetrainingObserver<'_>,
    ) -> Result<RoundFindings, RetrainError> {
        if let Some(findings) = self.run_folder.read_json(&self.path(FINDINGS))? {
            return Ok(findings);
        }
        self.run_folder
            .write(&self.path("before.safetensors"), self.policy.to_bytes()?)?;
        let plan = self.plan;
        let mut findings = RoundFindings {
            draws: plan.spaces.total(plan.settings.draws),
            ..self.find_colliding_draws(watch)?
        };
        for index in 0..plan.spaces.as_slice().len() {
            self.search_space(index, &mut findings, watch)?;
        }
        watch.notify(&RetrainingProgress::Attacking {
            round: self.round_number(),
            scenarios: plan.attacked.len(),
        })?;
        self.attack_scenarios(&mut findings)?;
        self.run_folder
            .write(&self.path(FINDINGS), encode_json(FINDINGS, &findings)?)?;
        Ok(findings)
    }

    /// Runs the campaign in one of the spaces, and adds its results.
    fn search_space(
        &self,
        index: usize,
        findings: &mut RoundFindings,
        watch: &RetrainingObserver<'_>,
    ) -> Result<(), RetrainError> {
        let plan = self.plan;
        let round = self.round_number();
        let spaces = plan.spaces.as_slice();
        let Some(space) = spaces.get(index) else {
            return Ok(());
        };
        // The search of a single space has no folder of its own.
        let folder = if spaces.len() == 1 {
            String::new()
        } else {
            format!("{}/", index + 1)
        };
        let path = self.path(&format!("{SEARCH}/{folder}"));
        let path = path.trim_end_matches('/');
        let campaign = Campaign {
            estimator: plan.estimator(),
            seed: plan.search_seed(round),
            ..Campaign::new(self.policy_before(!folder.is_empty()), space.clone())
                .with_method(plan.method.clone())
                .with_budget(plan.settings.budget)
        };
        let summary = campaign.run(
            &self.run_folder.path(path),
            true,
            &|state: &CampaignProgress| {
                watch.observe(&RetrainingProgress::Searching {
                    round,
                    space: space.name().to_owned(),
                    space_index: [index, spaces.len()],
                    progress: state.clone(),
                })
            },
        )?;
        self.run_folder.include(path)?;
        for method in &summary.methods {
            findings.evaluations += method.evaluations;
            findings.failures += method.failures;
        }
        for counterexample in &summary.counterexamples {
            let class = counterexample.avoidability.class();
            findings.count(class);
            if class == AvoidabilityClass::Avoidable {
                findings
                    .counterexamples
                    .push(format!("{folder}{}", counterexample.file));
            }
        }
        Ok(())
    }

    /// Returns the policy before the round, named by its path relative to the counterexamples, so that their recorded
    /// verdicts can be replayed.
    fn policy_before(&self, is_in_subfolder: bool) -> NamedController {
        let up = if is_in_subfolder { "../" } else { "" };
        named_policy(&format!("../../{up}before.safetensors"), self.policy)
    }

    /// Returns findings with the random scenarios that end in a collision.
    fn find_colliding_draws(
        &self,
        watch: &RetrainingObserver<'_>,
    ) -> Result<RoundFindings, RetrainError> {
        let plan = self.plan;
        let round = self.round_number();
        let seed = plan.search_seed(round);
        let draws = plan.spaces.total(plan.settings.draws);
        watch.notify(&RetrainingProgress::SimulatingDraws { round, draws })?;
        let all = (0..draws)
            .map(|index| plan.spaces.draw(seed, index))
            .collect::<Result<Vec<_>, _>>()?;
        let indices = colliding_indices(
            &all,
            &Arc::clone(self.policy).into_source(),
            plan.estimator(),
        )?;
        let collided: Vec<Scenario> = indices.iter().map(|&index| all[index].clone()).collect();
        let classed = classify_scenarios(&collided, &witnesses(&[]), plan.estimator())?;
        let avoidable = indices
            .into_iter()
            .zip(classed)
            .filter(|(_, (class, _))| *class == AvoidabilityClass::Avoidable);
        let indices = avoidable.map(|(index, _)| index as u64).collect();
        Ok(RoundFindings {
            colliding_draws: collided.len(),
            avoidable_draws: CollidingDraws {
                round,
                seed,
                indices,
            },
            ..RoundFindings::default()
        })
    }

    pub(super) fn extended_cases(&self, findings: &RoundFindings) -> Result<Cases, RetrainError> {
        let search = self.run_folder.path(&self.path(SEARCH));
        let counterexamples = findings
            .counterexamples
            .iter()
            .map(|name| {
                file::load(&search.join(name), &self.plan.spaces)
                    .map(|scenario| scenario.spec().clone())
            })
            .collect::<Result<_, _>>()?;
        self.cases.clone().with_round(
            &self.plan.spaces,
            findings.avoidable_draws.clone(),
            counterexamples,
        )
    }
}
