//! Retraining of a policy in rounds: search, training on avoidable counterexamples, and acceptance without regressions.
//!
//! A round of the [`Study`](crumple_store::study::Study) of a [`RetrainingPlan`]:
//!
//! 1. **Search.** A campaign ([`crumple_search::falsify::campaign`]) with a fixed budget searches the present policy
//!    for counterexamples; random scenarios of the space are simulated too, and given scenarios as they are and with
//!    the leader's worst-case braking. If there is no avoidable collision, the retraining ends.
//! 2. **Selection of cases.** Distinct counterexamples and random scenarios that ended in a collision become cases if
//!    they are avoidable: another controller (a witness) passes them, or [`crumple_search::worst_case::avoid()`] finds
//!    an escape.
//! 3. **Training.** The learner continues on a mixture of the paper's distribution, random scenarios of the space, and
//!    all cases so far. Its best checkpoint on the selection set is the candidate.
//! 4. **Acceptance.** The candidate is simulated in the paper's scenarios, its distribution, the validation set and the
//!    regression spaces. [`decide_acceptance`] accepts it if it is not worse.
//!
//! The scenarios for training, selection of checkpoints, validation, regression and test are disjoint. The test set is
//! drawn last and decides nothing. After a rejection, the learner continues with its weights, and the policy stays the
//! previous one.
//!
//! Files of a retraining:
//!
//! | file | content |
//! |---|---|
//! | `retrain.toml` | everything that determines the results |
//! | `policy.safetensors` | final policy |
//! | `retrained-on.json` | cases of the training: counterexamples, and random scenarios by seed and index |
//! | `validation-set.json`, `selection.json` | validation set, and the set that selects checkpoints |
//! | `test-set.json` | test set, and the result of each controller |
//! | `report.md`, `report.json` | results of each round, with the hashes of all these files |
//! | `rounds/NN/` | campaign, candidate and record of each round |
//! | `work.json` | manifest ([`crumple_store::run_folder`]); records the build until the retraining is complete |
//!
//! One seed determines everything, on any number of threads and after any interruption.

mod acceptance;
mod attack;
mod cases;
mod corpus;
mod error;
mod files;
mod plan;
mod progress;
mod regression_results;
mod regression_spaces;
mod report;
mod round;
mod search;
mod spaces;
mod study;
mod test_set;
mod training;

pub use acceptance::{Acceptance, FailureChange, RejectionReason, decide_acceptance};
pub use cases::{Cases, CollidingDraws};
pub use corpus::Corpus;
pub use error::RetrainError;
pub use plan::{RetrainingPlan, RetrainingSettings, TRAINING_PRESET_TEXT, training_preset};
pub use progress::RetrainingProgress;
pub use regression_results::RegressionResults;
pub use regression_spaces::{RegressionSpaceResult, SIGNIFICANCE};
pub use report::{FileHash, RetrainingEnding, RetrainingReport};
pub use round::{Checkpoint, Round, RoundTraining};
pub use search::RoundFindings;
pub use spaces::SearchedSpaces;
pub use study::RetrainingState;
pub use test_set::{ControllerTally, PairedOutcomes, TestSetResults};
