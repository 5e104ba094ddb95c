//! Convex programs: could any driver have avoided a collision, and how little braking makes a controller fail.
//!
//! **Could any driver have avoided it?** A leader follows its script; the vehicles under test may do what they like within
//! their limits, knowing the future; the vehicle behind them coasts until its latched emergency brake fires. For each step
//! at which that brake may fire the question is a linear program (`program`), and few of them have to be solved, since the
//! multipliers of one bound all others (`multipliers`, `branches`). [`avoid()`] ends in one of three verdicts:
//!
//! - *avoidable*, with a profile that the ordinary simulation replays without contact at two step sizes (`witness`). The
//!   programs find it, or simulations with every other driver in the loop if the programs do not model all of them
//!   (`closed_loop`);
//! - *unavoidable*, with multipliers that prove it about every driver and in continuous time, accepted by
//!   `crumple_verify::check` (`certificate`);
//! - *undecided*, with the [`Reason`].
//!
//! **How little does it take?** [`attack()`] looks for the mildest braking of the leader that makes a controller collide, or
//! the severest impact: exactly for the baseline, whose motion is known once it is known when it fires (`exact`), by
//! simulating pulses and ramps and by sequential convex programming from the best of them for every other controller
//! (`pulses`, `sequential`). What it returns has been simulated, and only the exact method shows that nothing milder exists.
//!
//! Nothing a solver says is believed: a profile is replayed, and multipliers prove what they prove.

mod attack;
mod avoid;
mod avoidance;
mod avoidance_problem;
mod certificate;
mod closed_loop;
mod descent;
mod emergency_brake;
mod envelope_step;
mod escape;
mod exact;
mod firing_search;
mod leader_program;
mod multipliers;
mod profile_simulator;
mod program;
mod pulses;
mod reason;
mod report;
mod scenario_box;
mod scripted_leader;
mod sequential;

pub use attack::{
    Attack, AttackError, AttackMethod, AttackObjective, AttackResult, Envelope, MAX_TOTAL_VEHICLE_STEPS,
    MAX_VEHICLE_STEPS, attack,
};
pub use avoid::{AvoidError, AvoidOptions, EscapeKind, MAX_EGO_STEPS, MAX_EGOS, avoid, avoid_box, certify};
pub use avoidance::{Avoidance, AvoidanceVerdict, Optimality};
pub use certificate::{build_certificate, covers_scenario, matches_box};
pub use closed_loop::SearchEffort;
pub(crate) use descent::{StepSchedule, TrustRegionDescent, VariableBounds};
pub use emergency_brake::EmergencyBrake;
pub use escape::{Escape, FoundBy};
pub use reason::UndecidedReason;
pub use report::AttackReport;
pub use scenario_box::{FieldRange, ScenarioBox, ScenarioBoxError, ScenarioRanges};
