//! Attack of a round on given scenarios: as they are, and with the leader's worst-case braking.

use std::sync::Arc;

use rayon::prelude::*;

use super::RetrainError;
use super::corpus::{classify_scenarios, colliding_indices};
use super::round::RoundContext;
use super::search::RoundFindings;
use super::test_set::witnesses;
use crumple_core::observer::Quiet;
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_search::worst_case::{AttackError, AttackObjective, Envelope, attack};
use crumple_sim::control::{ControllerSource, IntoSource};
use crumple_sim::engine::RunOptions;
use crumple_sim::scenario::{Scenario, file};
use crumple_store::run_folder::RunFolderError;

/// Objectives of the attacks: a collision that is easy to avoid, and one that is not.
const OBJECTIVES: [AttackObjective; 2] = [AttackObjective::Mildest, AttackObjective::Severest];

/// Folder of the scenarios in which attacks succeeded.
const ATTACKS: &str = "attacks";

impl RoundContext<'_> {
    /// Adds the avoidable collisions in the plan's scenarios, and writes them beside the folder of the searches.
    pub(super) fn attack_scenarios(
        &self,
        findings: &mut RoundFindings,
    ) -> Result<(), RetrainError> {
        let controller = Arc::clone(self.policy).into_source();
        let attacked = self
            .plan
            .attacked
            .par_iter()
            .map(|scenario| self.worst_cases(scenario, &controller));
        let mut all = self.plan.attacked.clone();
        all.extend(
            attacked
                .collect::<Result<Vec<_>, _>>()?
                .into_iter()
                .flatten(),
        );
        let estimator = self.plan.estimator();
        let collided = colliding_indices(&all, &controller, estimator)?;
        let collided: Vec<Scenario> = collided
            .into_iter()
            .map(|index| all[index].clone())
            .collect();
        let classified = classify_scenarios(&collided, &witnesses(&[]), estimator)?;
        for (number, (scenario, (class, _))) in (1..).zip(collided.iter().zip(classified)) {
            findings.count(class);
            if class == AvoidabilityClass::Avoidable {
                let name = format!("{ATTACKS}/{number}.toml");
                let text = file::to_toml(scenario)
                    .map_err(|error| RunFolderError::encoding(ATTACKS, error))?;
                self.run_folder.write(&self.path(&name), text)?;
                findings.counterexamples.push(format!("../{name}"));
            }
        }
        Ok(())
    }

    /// Returns the scenario with worst-case profiles of its leader; none if the leader has no profile to vary.
    fn worst_cases(
        &self,
        scenario: &Scenario,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<Vec<Scenario>, RetrainError> {
        let options = RunOptions::new(controller.clone()).with_estimator(self.plan.estimator());
        let budget = usize::try_from(self.plan.settings.budget).unwrap_or(usize::MAX);
        let mut scenarios = Vec::new();
        for objective in OBJECTIVES {
            match attack(
                scenario,
                &options,
                objective,
                Envelope::from_scenario(scenario),
                budget,
                &Quiet,
            ) {
                Ok(result) => scenarios.extend(result.attack.map(|attack| attack.scenario)),
                Err(AttackError::LeaderNotScripted | AttackError::EmptyEnvelope { .. }) => {
                    return Ok(Vec::new());
                }
                Err(error) => {
                    let scenario = scenario.spec().name.clone();
                    return Err(RetrainError::Attack {
                        scenario,
                        error: Box::new(error),
                    });
                }
            }
        }
        Ok(scenarios)
    }
}
