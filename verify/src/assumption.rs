//! Assumptions of claims about the world.

use serde::{Deserialize, Serialize};

/// An assumption of a statement about the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Assumption {
    /// Vehicles are point masses. Accelerations are held over each step; a vehicle whose speed reaches zero stops there
    /// and never reverses.
    ExactMotion,
    /// The leader moves as scripted and reacts to no vehicle.
    ScriptedLeader,
    /// The follower has the stated latched emergency brake, observes the true state, and has neither lag nor noise.
    LatchedFollower,
    /// The follower applies its stated law at each step, observes the true state, and has neither delay, lag nor noise.
    FollowerByLaw,
    /// No ego brakes or accelerates harder than stated.
    EgoWithinLimits,
    /// The egos follow the stated profile from the start, without delay, lag or noise.
    EgoOnProfile,
    /// The vehicle ahead never brakes harder than stated.
    LeaderWithinLimit,
    /// From every decision on, the own vehicle can brake at the stated rate.
    EgoCanBrake,
    /// The own vehicle applies the stated policy's command at once, at the stated instants.
    PolicyDrives,
    /// Each observed quantity is within its stated error of the true state.
    ObservedWithin,
    /// The single-precision tanh is within 2⁻²² of the true one.
    TanhWithin,
    /// The single-precision exp and exp - 1 have a relative error of at most 2⁻²².
    ExpWithin,
    /// The network file has the meaning of its source file and controller file.
    NetworkAsRead,
    /// The leader's acceleration and speed stay within the stated limits, and the own speed within the stated range.
    /// The claim ends if they leave.
    SpeedsWithin,
    /// The own vehicle executes each command after the stated delay, up to the stated noise, and once it stands, it
    /// stands until a positive command.
    EgoOnPlan,
    /// The follower is of the stated class.
    FollowerInClass,
    /// Runs are independent samples, and the registration was made before the first of them.
    RegisteredDraws,
    /// Noise is that of the scenario's seed, contained in the stated accelerations. The only optional assumption.
    NoiseOfSeed,
}

impl std::fmt::Display for Assumption {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::ExactMotion => {
                "vehicles have the plant `point-mass`: accelerations are held over each step, and a vehicle that has \
                 stopped does not reverse"
            }
            Self::ScriptedLeader => "the leader moves as scripted and reacts to no vehicle",
            Self::LatchedFollower => "the follower holds its speed until its latched emergency brake fires",
            Self::FollowerByLaw => "the follower applies the stated controller's command at each step, without delay",
            Self::EgoWithinLimits => "no vehicle under test brakes or accelerates harder than stated",
            Self::EgoOnProfile => "the vehicles under test follow the stated profile at once",
            Self::LeaderWithinLimit => "the vehicle ahead never brakes harder than stated",
            Self::EgoCanBrake => "from every decision on, the own vehicle can brake at the stated rate",
            Self::PolicyDrives => "the vehicle under test does at once what the stated policy asks for",
            Self::ObservedWithin => "each observed quantity is within its stated error of the true state",
            Self::TanhWithin => "tanh in single precision is within 2^-22 of the true one",
            Self::ExpWithin => "exp and exp - 1 in single precision have a relative error of at most 2^-22",
            Self::NetworkAsRead => {
                "the network is the one of its source file, as crumple read it, with the mapping stated"
            }
            Self::SpeedsWithin => {
                "the speeds of both vehicles and the leader's acceleration stay within the stated limits"
            }
            Self::EgoOnPlan => {
                "the own vehicle executes each command after the stated delay, up to the stated noise, and stands \
                 until a positive command"
            }
            Self::FollowerInClass => "the follower is of the stated class",
            Self::RegisteredDraws => "runs are independent samples, registered before the first run",
            Self::NoiseOfSeed => "noise is that of the scenario's seed",
        })
    }
}
