//! Claims, their evidence, and inference between claims.
//!
//! A claim has a subject, a property and a domain, which are compared by hashes of their content. Names are for
//! readers. Evidence is a claim with a strength. It supports the claim that it equals, and others only by an
//! [`InferenceRule`]. The [`Ledger`] holds all evidence of an assessment and alone determines the status of a claim.

mod evidence;
mod inference_rule;
mod ledger;
mod level;
mod strength;

use crumple_core::digest::sha256;
use crumple_core::markdown::prose_name;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use serde::{Deserialize, Serialize};

use super::Rounded;
pub use evidence::{Evidence, EvidenceSource, RandomScenario};
pub use inference_rule::InferenceRule;
pub use ledger::{ClaimStatus, Ledger, SecondaryEvidence};
pub use level::StrengthLevel;
pub(super) use strength::{MAX_GAIN, RateBounds};
pub use strength::{MIN_CONFIDENCE_PERCENT, Strength};

/// A name for readers and a hash for comparison.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ContentId {
    /// Name for readers, without backticks.
    pub name: String,
    /// SHA-256 of the content, in hexadecimal.
    pub sha256: String,
}

impl ContentId {
    /// Creates an identifier from the content.
    pub fn new(name: impl AsRef<str>, content: impl AsRef<[u8]>) -> Self {
        Self::with_sha256(name, sha256(content))
    }

    pub(super) fn with_sha256(name: impl AsRef<str>, sha256: String) -> Self {
        Self {
            name: prose_name(name.as_ref()),
            sha256,
        }
    }

    /// Creates an identifier from all fields that a scenario states. New optional fields of the format do not change
    /// it.
    pub fn from_scenario(name: impl AsRef<str>, scenario: &Scenario) -> Self {
        let spec = scenario.spec();
        Self::new(
            name,
            serde_json::to_string(spec).unwrap_or_else(|_| format!("{spec:?}")),
        )
    }
}

/// Compares hashes only: names are not evidence.
impl PartialEq for ContentId {
    fn eq(&self, other: &Self) -> bool {
        self.sha256 == other.sha256
    }
}

impl Eq for ContentId {}

/// The subject of a claim: a controller with its parameters and shield, and its estimator.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Subject {
    /// Controller, identified by everything that affects its driving.
    pub controller: ContentId,
    /// Estimator of the controller.
    pub estimator: EstimatorKind,
}

/// A property that a claim asserts of its subject in a domain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Property {
    /// No vehicle under test collides, and its controller does not fail.
    #[serde(alias = "no_contact")]
    NoCollision,
    /// No vehicle under test collides with its leader.
    #[serde(alias = "no_contact_ahead")]
    NoCollisionAhead,
    /// Failure rate: share of runs that violate `NoCollision`. For evidence only, because it states no limit.
    FailureRate,
    /// The failure rate is at most this.
    RateAtMost {
        /// Limit in percent.
        percent: Rounded<2>,
    },
    /// The subject fails in fewer of the same runs than another controller.
    FailsLessOften {
        /// Other controller, with the same estimator.
        than: ContentId,
    },
    /// No unnecessary braking.
    #[serde(alias = "no_needless_braking")]
    NoUnnecessaryBraking,
    /// The subject never falls behind a leader that drives on.
    KeepsUp,
    /// The subject passes every test of a suite that can be run.
    PassesTests,
    /// No collision of two vehicles that are both not under test.
    OthersKeepClear,
    /// No speed oscillation grows from vehicle to vehicle in a line of these controllers: the largest gain, rounded to
    /// three decimals, is at most 1.000.
    #[serde(alias = "string_stable")]
    NoGrowingOscillation,
}

/// The domain of a claim.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Domain {
    /// Listed scenarios.
    Scenarios {
        /// Description in words.
        #[serde(alias = "are")]
        about: UncomparedText,
        /// Scenarios of the domain.
        all: Vec<ContentId>,
    },
    /// First random scenarios of a scenario space under a seed.
    Draws {
        /// Scenario space.
        space: ContentId,
        /// Seed.
        seed: u64,
        /// Number of random scenarios.
        draws: u64,
    },
    /// All scenarios of a scenario space; for a rate, with the probability distribution of the space.
    Space {
        /// Scenario space.
        space: ContentId,
    },
    /// Points of a scenario space that a search tried.
    Search {
        /// Scenario space.
        space: ContentId,
        /// Seed.
        seed: u64,
        /// Simulations of each method.
        budget: u64,
    },
    /// Recorded drives, each once.
    RecordedDrives {
        /// Folder, and the hash of all its drives.
        drives: ContentId,
        /// Number of drives.
        count: u64,
    },
    /// Tests of a suite, at its fixed points and at those searched within its ranges.
    Suite {
        /// Suite.
        suite: ContentId,
    },
    /// A box of initial states and braking, with a follower and bounds on the observation error.
    Box {
        /// Content of the box.
        around: ContentId,
    },
    /// Oscillations of the leader's speed around mean speeds, ahead of a line of vehicles.
    Oscillations {
        /// Amplitude, in m/s.
        amplitude_mps: Rounded<2>,
        /// Lowest and highest frequency, in rad/s.
        frequencies_rad_per_s: [Rounded<2>; 2],
        /// Lowest and highest mean speed, in m/s.
        mean_speeds_mps: [Rounded<1>; 2],
    },
    /// Any initial state inside the safety kernels of these brake limits, under the assumptions of the shield.
    Kernels {
        /// Brake limits of the ego vehicle and of its leader, on a dry road, each pair in m/s².
        limits_mps2: Vec<[Rounded<6>; 2]>,
    },
}

/// Text for readers only: any two values are equal.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct UncomparedText(pub String);

impl PartialEq for UncomparedText {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// A claim: a property of a subject in a domain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssuranceClaim {
    /// Subject of the claim.
    pub subject: Subject,
    /// Asserted property.
    pub property: Property,
    /// Domain of the claim.
    pub domain: Domain,
}

impl Property {
    /// Describes the property, without subject and domain.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::NoCollision => "no collision".to_owned(),
            Self::NoCollisionAhead => "no collision with the leader".to_owned(),
            Self::FailureRate => "failure rate".to_owned(),
            Self::RateAtMost { percent } => format!("failure rate at most {} %", percent.value()),
            Self::FailsLessOften { than } => format!("fewer failures than {}", than.name),
            Self::NoUnnecessaryBraking => "no unnecessary braking".to_owned(),
            Self::KeepsUp => "never falls behind".to_owned(),
            Self::PassesTests => "passes every test that can be run".to_owned(),
            Self::OthersKeepClear => "no collision of other vehicles".to_owned(),
            Self::NoGrowingOscillation => "largest gain at most 1.000".to_owned(),
        }
    }

    #[must_use]
    pub(crate) fn describe_violation(&self) -> String {
        match self {
            Self::NoCollision => "collision".to_owned(),
            Self::NoCollisionAhead => "collision with the leader".to_owned(),
            Self::FailureRate => self.describe(),
            Self::RateAtMost { percent } => format!("failure rate above {} %", percent.value()),
            Self::FailsLessOften { than } => format!("no fewer failures than {}", than.name),
            Self::NoUnnecessaryBraking => "unnecessary braking".to_owned(),
            Self::KeepsUp => "falls behind".to_owned(),
            Self::PassesTests => "failed tests".to_owned(),
            Self::OthersKeepClear => "collision of other vehicles".to_owned(),
            Self::NoGrowingOscillation => "growing oscillation".to_owned(),
        }
    }

    #[must_use]
    pub(crate) fn implies(&self, weaker: &Self) -> bool {
        self == weaker || (*self == Self::NoCollision && *weaker == Self::NoCollisionAhead)
    }

    /// True for a property of every run of a domain: one run refutes it.
    #[must_use]
    pub(crate) fn is_universal(&self) -> bool {
        matches!(
            self,
            Self::NoCollision | Self::NoCollisionAhead | Self::NoUnnecessaryBraking
        )
    }
}

impl Domain {
    /// Describes the domain, as a phrase after the description of the property.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Scenarios { about, .. } => format!("in {}", about.0),
            Self::Draws { space, seed, draws } => {
                let plural = if *draws == 1 { "" } else { "s" };
                format!(
                    "in {draws} random scenario{plural} of `{}` (seed {seed})",
                    space.name
                )
            }
            Self::Space { space } => format!("anywhere in `{}`", space.name),
            Self::Search { space, budget, .. } => {
                format!("in a search of `{}` ({budget} per method)", space.name)
            }
            Self::RecordedDrives { drives, count } => {
                format!("in {count} recorded drives of `{}`", drives.name)
            }
            Self::Suite { suite } => {
                format!("of suite `{}`, on point masses in one lane", suite.name)
            }
            Self::Box { around } => format!("from {}", around.name),
            Self::Oscillations {
                amplitude_mps,
                frequencies_rad_per_s: [low, high],
                mean_speeds_mps,
            } => {
                let [amplitude_mps, low, high] =
                    [amplitude_mps, low, high].map(|value| value.value());
                let [slowest_mps, fastest_mps] = mean_speeds_mps.map(|speed| speed.value());
                format!(
                    "from vehicle to vehicle, for oscillations of {amplitude_mps} m/s at {low} to {high} rad/s around \
                     {slowest_mps} to {fastest_mps} m/s, with the true state"
                )
            }
            Self::Kernels { limits_mps2 } => {
                let hardest = limits_mps2
                    .iter()
                    .map(|[_, ahead]| ahead.value())
                    .reduce(f64::max);
                let ahead = hardest.map_or_else(String::new, |ahead| {
                    format!(", if no leader brakes harder than {ahead} m/s²")
                });
                format!("from any state in the safety kernel of its shield{ahead}")
            }
        }
    }

    #[must_use]
    pub(crate) fn covers(&self, part: &Self) -> bool {
        match (self, part) {
            (
                Self::Space { space },
                Self::Draws { space: part, .. } | Self::Search { space: part, .. },
            ) => space == part,
            (Self::Scenarios { all, .. }, Self::Scenarios { all: part, .. }) => {
                part.iter().all(|scenario| all.contains(scenario))
            }
            _ => self == part,
        }
    }
}

impl AssuranceClaim {
    /// Describes the domain, as a phrase after the description of the property.
    #[must_use]
    pub fn describe_domain(&self) -> String {
        match (&self.property, &self.domain) {
            // A rate refers to the probability distribution, not to single points.
            (
                Property::RateAtMost { .. } | Property::FailsLessOften { .. },
                Domain::Space { space },
            ) => {
                format!("in the distribution of `{}`", space.name)
            }
            // The shield assumes a bounded estimation error.
            (Property::NoCollisionAhead, Domain::Kernels { .. })
                if self.subject.estimator == EstimatorKind::Kalman =>
            {
                format!(
                    "{}, while the estimation error of the controller stays within the bounds of the shield",
                    self.domain.describe()
                )
            }
            (_, domain) => domain.describe(),
        }
    }

    /// Describes the claim, without its subject.
    #[must_use]
    pub fn describe(&self) -> String {
        format!("{} {}", self.property.describe(), self.describe_domain())
    }
}
