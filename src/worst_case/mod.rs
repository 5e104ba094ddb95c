//! Convex programs: could anyone have avoided it, and how little does it take to make a controller fail.
//!
//! **Could anyone have avoided it?** A leader follows its script; the vehicles under test may do what they like within
//! their limits, knowing the future; the vehicle behind them coasts until its latched emergency brake fires. For each step
//! at which that brake may fire the question is a linear program (`program`), and few of them have to be solved, since the
//! multipliers of one bound all others (`multipliers`, `branches`). [`avoid()`] ends in one of three verdicts:
//!
//! - *avoidable*, with a profile that the ordinary simulation replays without contact at two step sizes (`witness`);
//! - *unavoidable*, with multipliers that prove it about every driver and in continuous time, accepted by
//!   `crumple_verify::check` (`certificate`);
//! - *undecided*, with the [`Reason`].
//!
//! Nothing a solver says is believed: a profile is replayed, and multipliers prove what they prove.

mod avoid;
mod branches;
mod certificate;
mod cone;
mod family;
mod multipliers;
mod program;
mod reason;
mod situation;
mod witness;

pub use avoid::{AvoidError, AvoidOptions, Avoidance, Verdict, avoid, avoid_all, certify};
pub use certificate::is_about;
pub use family::{Family, FamilyError, FieldRange, Ranges};
pub use reason::Reason;
pub use witness::Escape;
