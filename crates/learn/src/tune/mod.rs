//! Tuning of the settings of a built-in controller on the closed loop.
//!
//! The [`Study`](crumple_store::study::Study) of a [`TuningPlan`] minimises one number, the objective
//! ([`TuningObjective`]), over typical ranges of the settings ([`SettingSearch`]) with a search method of
//! [`crumple_search::falsify`].
//!
//! 1. **Search.** Every candidate is simulated in the same random scenarios, the tuning set. Candidate 0 has the
//!    initial settings: the defaults, and the settings that the user fixed.
//! 2. **Selection.** The best candidates and the initial settings are simulated in the selection set. The best one
//!    there has the tuned settings. They are never worse than the initial settings on either set.
//! 3. **Test.** Initial settings, tuned settings and `idm` are simulated in the test set, which decides nothing.
//!
//! The random scenarios of the three sets are disjoint, and the same for every controller and method; recorded drives
//! are the same in all three. Neither the number of threads nor an interruption changes a result: `candidates.jsonl`
//! has the result of every candidate, and a resumed search replays it.
//!
//! | file | content |
//! |---|---|
//! | `tune.toml` | everything that determines the results |
//! | `candidates.jsonl` | results of every candidate in the tuning set, one per line |
//! | `report.md`, `report.json` | settings, and results in the test set |
//! | `work.json` | manifest ([`crumple_store::run_folder`]) |

mod candidates;
mod error;
mod objective;
mod plan;
mod report;
mod settings;
mod study;
#[cfg(test)]
mod tests;

pub use error::TuneError;
pub use objective::{ControllerScore, TuningObjective, TuningSpace};
pub use plan::{TuningConfig, TuningPlan};
pub use report::{TunedSetting, TuningFinalist, TuningReport};
pub use settings::{SearchedSetting, SettingRequest, SettingSearch};
pub use study::{TuningProgress, TuningState};
