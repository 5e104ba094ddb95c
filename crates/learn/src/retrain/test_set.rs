//! What controllers did in the draws on which the result is judged.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::RetrainError;
use super::corpus::Corpus;
use super::files::{read_json, write_json};
use super::plan::{RetrainingPlan, TEST_SET_SEED};
use super::progress::{RetrainingObserver, RetrainingProgress};
use crumple_evidence::RateInterval;
use crumple_store::run_folder::RunFolder;
use crumple_world::sim::{Contact, NamedController};

/// Confidence of the intervals in reports.
pub(super) const CONFIDENCE: f64 = 0.95;

/// A corpus and what each controller did in it: the file `judged-on.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TestSetResults {
    /// The draws.
    pub corpus: Corpus,
    /// One entry a controller: the first policy, the retrained one, and others to compare with.
    pub tallies: Vec<ControllerTally>,
    /// The first policy and the retrained one on the same draws.
    pub pairs: PairedOutcomes,
}

/// Contacts of one controller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerTally {
    /// Its name.
    pub controller: String,
    /// SHA-256 of the policy file, if it is a policy.
    pub policy_sha256: Option<String>,
    /// Draws that ended in contact.
    pub contacts: u64,
    /// Those in which the vehicle under test ran into the one ahead; in the others it was hit from behind.
    pub into_the_leader: u64,
}

/// Draws by what happened with each of two policies.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairedOutcomes {
    /// Contact with both.
    pub both: u64,
    /// Contact with the first policy alone: fixed.
    pub first_only: u64,
    /// Contact with the retrained policy alone: new.
    pub retrained_only: u64,
    /// Contact with neither.
    pub neither: u64,
}

impl ControllerTally {
    /// The exact interval of its collision rate over `runs` draws.
    #[must_use]
    pub fn interval(&self, runs: u64) -> RateInterval {
        RateInterval::clopper_pearson(self.contacts, runs, CONFIDENCE)
    }
}

/// Names of those that are compared with the two policies.
const BASELINES: [&str; 5] = ["idm", "acc-aeb", "match-leader", "constant-brake", "baseline"];

/// The built-in controllers that may show that a scenario can be avoided, beside some policies.
pub(super) fn witnesses(policies: &[NamedController]) -> Vec<NamedController> {
    let others = BASELINES.iter().filter_map(|name| NamedController::find(name, Path::new("")).ok());
    policies.iter().cloned().chain(others).collect()
}

impl TestSetResults {
    /// The judgement in a file, made first if it is not there or not complete. The first two contenders are compared.
    pub(super) fn load_or_evaluate(
        (work, name): (&RunFolder, &'static str),
        plan: &RetrainingPlan,
        contenders: &[NamedController],
        watch: &RetrainingObserver<'_>,
    ) -> Result<Self, RetrainError> {
        let (space, wanted) = (&plan.space, plan.settings.test_draws);
        let mut judged = match read_json(work, name)? {
            Some(judged) => judged,
            None => Self {
                corpus: Corpus::empty(space, TEST_SET_SEED)?,
                tallies: contenders.iter().map(ControllerTally::new).collect(),
                pairs: PairedOutcomes::default(),
            },
        };
        while judged.corpus.scenarios_sha256.is_empty() {
            let Self { corpus, tallies, pairs } = &mut judged;
            watch.notify(&RetrainingProgress::Gathering { file: name, done: corpus.avoidable, wanted })?;
            if corpus.avoidable < wanted {
                let count = |contacts: &[Option<Contact>]| {
                    tallies.iter_mut().zip(contacts).for_each(|(tally, contact)| tally.add(contact.as_ref()));
                    pairs.add(contacts);
                };
                corpus.classify_next(space, wanted, contenders, plan.estimator(), count)?;
            } else {
                corpus.seal(space)?;
            }
            write_json(work, name, &judged)?;
        }
        Ok(judged)
    }
}

impl ControllerTally {
    fn new(contender: &NamedController) -> Self {
        let policy_sha256 = contender.policy().map(|policy| policy.digest());
        Self { controller: contender.name.clone(), policy_sha256, contacts: 0, into_the_leader: 0 }
    }

    fn add(&mut self, contact: Option<&Contact>) {
        if let Some(contact) = contact {
            self.contacts += 1;
            self.into_the_leader += u64::from(contact.front_vehicle == 0);
        }
    }
}

impl PairedOutcomes {
    fn add(&mut self, contacts: &[Option<Contact>]) {
        let touched = |index: usize| contacts.get(index).is_some_and(Option::is_some);
        *match (touched(0), touched(1)) {
            (true, true) => &mut self.both,
            (true, false) => &mut self.first_only,
            (false, true) => &mut self.retrained_only,
            (false, false) => &mut self.neither,
        } += 1;
    }
}
