//! Results of controllers in the test set.

use serde::{Deserialize, Serialize};

use super::RetrainError;
use super::SearchedSpaces;
use super::corpus::Corpus;
use super::plan::{RetrainingPlan, TEST_SET_SEED};
use super::progress::{RetrainingObserver, RetrainingProgress};
use crumple_controllers::find_built_in;
use crumple_evidence::RateInterval;
use crumple_sim::engine::{Collision, NamedController};
use crumple_store::run_folder::RunFolder;

pub(super) const CONFIDENCE: f64 = 0.95;

/// Test set and the results of all controllers in it: the file `test-set.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TestSetResults {
    /// Scenarios of the test set.
    pub corpus: Corpus,
    /// One entry per controller: initial policy, retrained policy, and baselines.
    pub tallies: Vec<ControllerTally>,
    /// Paired results of initial and retrained policy.
    pub pairs: PairedOutcomes,
}

/// Collisions of one controller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerTally {
    /// Name of the controller.
    pub controller: String,
    /// SHA-256 of the policy file, if it is a policy.
    pub policy_sha256: Option<String>,
    /// Scenarios that ended in a collision.
    #[serde(alias = "contacts")]
    pub collisions: u64,
    /// Collisions of the vehicle under test with its leader; in the others the follower hits it.
    pub into_the_leader: u64,
}

/// Paired results of two policies.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairedOutcomes {
    /// Collisions of both.
    pub both: u64,
    /// Collisions of the initial policy only: fixed.
    pub first_only: u64,
    /// Collisions of the retrained policy only: new.
    pub retrained_only: u64,
    /// Scenarios without a collision of either.
    pub neither: u64,
}

impl ControllerTally {
    /// Returns the exact interval of the collision rate over `runs` scenarios.
    #[must_use]
    pub fn interval(&self, runs: u64) -> RateInterval {
        RateInterval::clopper_pearson(self.collisions, runs, CONFIDENCE)
    }
}

const BASELINES: [&str; 5] = [
    "idm",
    "acc-aeb",
    "match-leader",
    "constant-brake",
    "baseline",
];

/// Returns the controllers that can show that a scenario is avoidable: some policies and the baselines.
pub(super) fn witnesses(policies: &[NamedController]) -> Vec<NamedController> {
    let others = BASELINES.iter().filter_map(|name| find_built_in(name));
    policies.iter().cloned().chain(others).collect()
}

impl TestSetResults {
    fn empty(space: &SearchedSpaces, contenders: &[NamedController]) -> Result<Self, RetrainError> {
        Ok(Self {
            corpus: Corpus::empty(space, TEST_SET_SEED)?,
            tallies: contenders.iter().map(ControllerTally::new).collect(),
            pairs: PairedOutcomes::default(),
        })
    }

    /// Reads the results from a file, or completes them first. Compares the first two contenders.
    pub(super) fn load_or_evaluate(
        (work, name): (&RunFolder, &'static str),
        plan: &RetrainingPlan,
        contenders: &[NamedController],
        watch: &RetrainingObserver<'_>,
    ) -> Result<Self, RetrainError> {
        let space = &plan.spaces;
        let wanted = space.total(plan.settings.test_draws);
        let mut evaluated = match work.read_json(name)? {
            Some(evaluated) => evaluated,
            None => Self::empty(space, contenders)?,
        };
        while evaluated.corpus.scenarios_sha256.is_empty() {
            let Self {
                corpus,
                tallies,
                pairs,
            } = &mut evaluated;
            watch.notify(&RetrainingProgress::Gathering {
                file: name,
                done: corpus.avoidable,
                wanted,
            })?;
            if corpus.avoidable < wanted {
                corpus.classify_next(
                    space,
                    wanted,
                    contenders,
                    plan.estimator(),
                    |collisions| {
                        for (tally, collision) in tallies.iter_mut().zip(collisions) {
                            tally.add(collision.as_ref());
                        }
                        pairs.add(collisions);
                    },
                )?;
            } else {
                corpus.seal(space)?;
            }
            work.write_json(name, &evaluated)?;
        }
        Ok(evaluated)
    }
}

impl ControllerTally {
    fn new(contender: &NamedController) -> Self {
        let policy_sha256 = contender.policy().map(|policy| policy.digest());
        Self {
            controller: contender.name.clone(),
            policy_sha256,
            collisions: 0,
            into_the_leader: 0,
        }
    }

    fn add(&mut self, collision: Option<&Collision>) {
        if let Some(collision) = collision {
            self.collisions += 1;
            self.into_the_leader += u64::from(collision.front_vehicle == 0);
        }
    }
}

impl PairedOutcomes {
    fn add(&mut self, collisions: &[Option<Collision>]) {
        let collided = [0, 1].map(|index| collisions.get(index).is_some_and(Option::is_some));
        *match collided {
            [true, true] => &mut self.both,
            [true, false] => &mut self.first_only,
            [false, true] => &mut self.retrained_only,
            [false, false] => &mut self.neither,
        } += 1;
    }
}
