//! Convex programs that decide avoidability, and that find the least braking that makes a controller fail.
//!
//! **Avoidability** ([`avoid()`]). A leader follows its script; the vehicles under test move freely within their limits
//! and know the future; the vehicle behind them keeps its speed until its latched brake fires. Each firing step is a
//! linear program (`program`), whose multipliers bound all others (`multipliers`, `firing_search`). Verdicts:
//!
//! - *avoidable*, with a profile that the simulator replays without collision at two step sizes (`escape`). The
//!   programs find it, or closed-loop simulations if the programs do not model all drivers (`closed_loop`);
//! - *unavoidable*, with multipliers that prove it for every driver in continuous time, checked (`certificate`);
//! - *undecided*, with an [`UndecidedReason`].
//!
//! **Worst-case braking** ([`attack()`]). The search finds the mildest braking of the leader that makes a controller
//! collide, or the fastest impact, by pulses, ramps and sequential convex programming (`pulses`, `sequential`).
//!
//! **Sensor faults** ([`attack_sensors`]). A scan of a fine grid finds the mildest fault of each kind that makes a
//! controller collide or brake unnecessarily (`sensor_attack`).
//!
//! No solution is trusted: each profile is replayed, and each proof is checked from its multipliers.

mod attack;
mod attack_report;
mod avoid;
mod avoid_report;
mod avoidance;
mod avoidance_problem;
mod certificate;
mod closed_loop;
mod descent;
mod emergency_brake;
mod envelope_step;
mod escape;
mod firing_search;
mod multipliers;
mod profile_simulator;
mod program;
mod pulses;
mod reason;
mod scripted_leader;
mod sensor_attack;
mod sensor_report;
mod sequential;

pub use attack::{
    Attack, AttackError, AttackObjective, AttackResult, Envelope, MAX_SIMULATIONS,
    MAX_TOTAL_VEHICLE_STEPS, MAX_VEHICLE_STEPS, attack,
};
pub use attack_report::AttackReport;
pub use avoid::{AvoidError, AvoidOptions, MAX_EGO_STEPS, MAX_EGOS, avoid, certify};
pub use avoid_report::AvoidReport;
pub use avoidance::{Avoidance, AvoidanceClass, AvoidanceVerdict, Optimality};
pub use certificate::{build_certificate, covers_scenario};
pub use closed_loop::SearchEffort;
pub(crate) use descent::{StepSchedule, TrustRegionDescent, VariableBounds};
pub use emergency_brake::EmergencyBrake;
pub use escape::{Escape, EscapeMethod, FoundBy};
pub use reason::UndecidedReason;
pub use sensor_attack::{
    FaultKindResult, MildestFault, SearchedSizes, SensorAttackResult, SensorFailure,
    attack_sensors, max_sensor_simulations,
};
pub use sensor_report::SensorAttackReport;
