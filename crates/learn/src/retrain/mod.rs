//! Retraining a policy: search for failures, train on those that could have been avoided, accept what breaks nothing; again.
//!
//! A round of [`RetrainingPlan::run`]:
//!
//! 1. **Search.** A campaign ([`crumple_search::falsify::campaign`]) with a stated budget against the policy as it stands, and a number
//!    of draws of the space. If nothing avoidable is found, the retraining is over.
//! 2. **Keep.** Distinct counterexamples, and draws that ended in contact, if they were avoidable: a witness drives through
//!    without contact, or [`crumple_search::worst_case::avoid()`] finds an escape. What no driver can avoid teaches nothing.
//! 3. **Train on.** The learner goes on with its networks and its memory, on a mixture of the paper's distribution, draws of
//!    the space, and all cases kept so far. Of its checkpoints the best on a selection of avoidable draws is the candidate.
//! 4. **Judge.** The candidate drives the paper's scenarios, draws of the paper's distribution, and a corpus kept aside. It is
//!    accepted only if nothing of the paper's that was safe fails, the contacts kept aside do not rise, and in no regression
//!    space it is worse beyond chance ([`rule`]).
//!
//! Sets of draws never meet: training, selection, kept aside and of regression spaces (acceptance), and judged, which is drawn after the
//! last round and decides nothing. A rejected candidate is not taken over, but its learner goes on.
//!
//! The folder of a retraining:
//!
//! | file | what it holds |
//! |---|---|
//! | `retrain.toml` | everything that decides the results |
//! | `policy.safetensors` | the policy at the end |
//! | `retrained-on.json` | the cases it was trained on, beside draws of space and paper |
//! | `kept-aside.json`, `selection.json` | the draws that accepted rounds, and those that selected checkpoints |
//! | `judged-on.json` | the draws it was judged on, and what each controller did in them |
//! | `report.md`, `report.json`, `report.svg` | what each round found, fixed and broke, with the hashes of all these files |
//! | `rounds/NN/` | the campaign, the candidate and the record of each round |
//! | `work.json` | what the others are ([`crumple_store::work`]), and until it is complete the program at work, for no other build goes on with it |
//!
//! One seed decides everything, whatever the number of threads and whether or not it was interrupted.

mod acceptance;
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
mod run;
mod test_set;
mod training;

pub use acceptance::{Acceptance, FailureChange, RejectionReason, decide_acceptance};
pub use cases::{Cases, CollidingDraws};
pub use corpus::{CORPUS_VERSION, Corpus};
pub use error::RetrainError;
pub use plan::{RETRAIN_VERSION, RetrainingPlan, RetrainingSettings, TRAINING_PRESET_TEXT, training_preset};
pub use progress::RetrainingProgress;
pub use regression_results::RegressionResults;
pub use regression_spaces::{RegressionSpaceResult, SIGNIFICANCE};
pub use report::{FileHash, RetrainingEnding, RetrainingReport};
pub use round::{Checkpoint, Round, RoundFindings, RoundTraining};
pub use test_set::{ControllerTally, PairedOutcomes, TestSetResults};
