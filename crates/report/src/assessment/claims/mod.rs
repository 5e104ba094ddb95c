//! What is claimed, by what it is supported, and what follows from what.
//!
//! A claim is a subject, a property and a domain, and is compared by what these are: the subject by the hash of all that
//! decides how it drives, the domain by the hash of the scenarios or the space. Names are for readers. Evidence is a claim
//! with a strength; it speaks for the claim that it equals, and for others only by a [`Rule`]. The [`Ledger`] holds all
//! evidence of an assessment and is the only one to say how a claim stands.

mod evidence;
mod inference_rule;
mod ledger;
mod strength;

use crumple_core::digest::sha256;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Scenario;
use serde::{Deserialize, Serialize};

use super::Rounded;
pub use evidence::{Evidence, EvidenceSource};
pub use inference_rule::InferenceRule;
pub use ledger::{ClaimStatus, Ledger, SecondaryEvidence};
pub use strength::{MIN_CONFIDENCE_PERCENT, Strength};

/// Something with a name for readers and a hash to compare by.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ContentId {
    /// What readers call it.
    pub name: String,
    /// SHA-256, in hexadecimal, of everything that it is.
    pub sha256: String,
}

impl ContentId {
    /// Something whose content is known.
    pub fn new(name: impl Into<String>, content: impl AsRef<[u8]>) -> Self {
        Self { name: name.into(), sha256: sha256(content) }
    }

    /// A scenario with every field that it states, its seed among them; fields that it leaves out do not count, so that it stays
    /// what it is when the format grows.
    pub fn from_scenario(name: impl Into<String>, scenario: &Scenario) -> Self {
        let spec = scenario.spec();
        Self::new(name, serde_json::to_string(spec).unwrap_or_else(|_| format!("{spec:?}")))
    }
}

/// By hash alone: a name proves nothing.
impl PartialEq for ContentId {
    fn eq(&self, other: &Self) -> bool {
        self.sha256 == other.sha256
    }
}

impl Eq for ContentId {}

/// Who a claim is about: a controller with its parameters and its shield, and what it looks through.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Subject {
    /// The controller, by the identity of all that decides how it drives.
    pub controller: ContentId,
    /// What it looks through.
    pub estimator: EstimatorKind,
}

/// What is said of a subject in a domain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Property {
    /// No vehicle under test touches another, and its controller does not fail.
    NoContact,
    /// No vehicle under test touches the one ahead.
    NoContactAhead,
    /// The share of runs in which the first does not hold; evidence only, since it says of no number whether it is held.
    FailureRate,
    /// That share is at most this.
    RateAtMost {
        /// In percent.
        percent: Rounded<2>,
    },
    /// It fails in fewer of the same runs than another.
    FailsLessOften {
        /// The other, through the same estimator.
        than: ContentId,
    },
    /// It never brakes without a cause.
    #[serde(rename = "no_needless_braking")]
    NoUnnecessaryBraking,
    /// It is never left behind by a vehicle ahead that drives on.
    KeepsUp,
    /// It passes every test of a suite that can be run.
    PassesTests,
    /// No two vehicles touch that are both not under test.
    OthersKeepClear,
    /// A line of vehicles with it makes a disturbance no larger from one to the next.
    StringStable,
    /// It keeps a rule.
    #[serde(rename = "keeps")]
    Satisfies {
        /// The rule, as `--spec` takes it.
        rule: String,
    },
}

/// Where something is claimed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Domain {
    /// These scenarios.
    Scenarios {
        /// What they are, in words.
        #[serde(rename = "are")]
        about: UncomparedText,
        /// Each of them.
        all: Vec<ContentId>,
    },
    /// The first draws of a space under a seed.
    Draws {
        /// The space.
        space: ContentId,
        /// The seed.
        seed: u64,
        /// How many.
        draws: u64,
    },
    /// All that a space can draw; of a rate, by the law of the space.
    Space {
        /// The space.
        space: ContentId,
    },
    /// The points of a space that a search tried.
    Search {
        /// The space.
        space: ContentId,
        /// The seed.
        seed: u64,
        /// Evaluations of each method.
        budget: u64,
    },
    /// Tests after a document, at the points that a suite has and those that were searched within its ranges.
    Suite {
        /// The suite.
        suite: ContentId,
    },
    /// A box of starts and braking, with a follower and bounds on what is seen.
    Box {
        /// All of it.
        around: ContentId,
    },
    /// A scenario, with any braking of its leader within what that can do.
    AnyLeaderBraking {
        /// The scenario.
        scenario: ContentId,
    },
    /// Any start inside the kernels of these brake limits, with what a shield takes for granted.
    Kernels {
        /// Limits of the own vehicle and of the one ahead, on a dry road, each pair in m/s².
        limits_mps2: Vec<[Rounded<6>; 2]>,
    },
}

/// Words that are equal to all words: for readers only.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct UncomparedText(pub String);

impl PartialEq for UncomparedText {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// What is said of whom, and where.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssuranceClaim {
    /// Who.
    pub subject: Subject,
    /// What.
    pub property: Property,
    /// Where.
    pub domain: Domain,
}

impl Property {
    /// What is claimed, without of whom and where.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::NoContact => "no contact".to_owned(),
            Self::NoContactAhead => "no contact with the vehicle ahead".to_owned(),
            Self::FailureRate => "the share of runs with contact".to_owned(),
            Self::RateAtMost { percent } => format!("contact in at most {} % of runs", percent.value()),
            Self::FailsLessOften { than } => format!("fewer failures than {}", than.name),
            Self::NoUnnecessaryBraking => "no braking without cause".to_owned(),
            Self::KeepsUp => "never left behind".to_owned(),
            Self::PassesTests => "every test passes that can be run".to_owned(),
            Self::OthersKeepClear => "no contact among the others".to_owned(),
            Self::StringStable => "no disturbance grows".to_owned(),
            Self::Satisfies { rule } => rule.clone(),
        }
    }

    /// What it means that it does not hold, without of whom and where.
    #[must_use]
    pub(crate) fn describe_violation(&self) -> String {
        match self {
            Self::NoContact => "contact".to_owned(),
            Self::NoContactAhead => "contact with the vehicle ahead".to_owned(),
            Self::FailureRate => self.describe(),
            Self::RateAtMost { percent } => format!("contact in more than {} % of runs", percent.value()),
            Self::FailsLessOften { than } => format!("no fewer failures than {}", than.name),
            Self::NoUnnecessaryBraking => "braking without cause".to_owned(),
            Self::KeepsUp => "left behind".to_owned(),
            Self::PassesTests => "tests that fail".to_owned(),
            Self::OthersKeepClear => "contact among the others".to_owned(),
            Self::StringStable => "a disturbance that grows".to_owned(),
            Self::Satisfies { rule } => format!("violation of `{rule}`"),
        }
    }

    /// Whether what holds of this holds of `weaker`.
    #[must_use]
    pub(crate) fn implies(&self, weaker: &Self) -> bool {
        self == weaker || (*self == Self::NoContact && *weaker == Self::NoContactAhead)
    }

    /// Whether it is said of every run of a domain, so that one run refutes it.
    #[must_use]
    pub(crate) fn is_universal(&self) -> bool {
        matches!(self, Self::NoContact | Self::NoContactAhead | Self::NoUnnecessaryBraking | Self::Satisfies { .. })
    }
}

impl Domain {
    /// Where something is claimed, as it follows the property.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Scenarios { about, .. } => format!("in {}", about.0),
            Self::Draws { space, seed, draws } => {
                let plural = if *draws == 1 { "" } else { "s" };
                format!("in {draws} draw{plural} of `{}` (seed {seed})", space.name)
            }
            Self::Space { space } => format!("anywhere in `{}`", space.name),
            Self::Search { space, budget, .. } => {
                format!("that a search of `{}` finds ({budget} a method)", space.name)
            }
            Self::Suite { suite } => format!("of suite `{}`, on point masses in one lane", suite.name),
            Self::Box { around } => format!("from {}", around.name),
            Self::AnyLeaderBraking { scenario, .. } => format!("in {}, however its leader brakes", scenario.name),
            Self::Kernels { limits_mps2 } => {
                let hardest = limits_mps2.iter().map(|[_, ahead]| ahead.value()).reduce(f64::max);
                let ahead = hardest.map_or_else(String::new, |ahead| {
                    format!(", where nobody ahead can brake harder than {ahead} m/s²")
                });
                format!("from any start inside the kernel of its shield{ahead}")
            }
        }
    }

    /// Whether `part` lies in this one, all of it.
    #[must_use]
    pub(crate) fn covers(&self, part: &Self) -> bool {
        match (self, part) {
            (Self::Space { space }, Self::Draws { space: of, .. } | Self::Search { space: of, .. }) => space == of,
            (Self::Scenarios { all, .. }, Self::Scenarios { all: some, .. }) => {
                some.iter().all(|one| all.contains(one))
            }
            _ => self == part,
        }
    }
}

impl AssuranceClaim {
    /// Where, as it follows the property.
    #[must_use]
    pub fn describe_domain(&self) -> String {
        match (&self.property, &self.domain) {
            // A rate is that of the law, not of single points.
            (Property::RateAtMost { .. } | Property::FailsLessOften { .. }, Domain::Space { space }) => {
                format!("by the law of `{}`", space.name)
            }
            // Through a filter a shield takes for granted that the truth is near.
            (Property::NoContactAhead, Domain::Kernels { .. }) if self.subject.estimator == EstimatorKind::Kalman => {
                format!("{}, while its filter is off by no more than the shield allows for", self.domain.describe())
            }
            (_, domain) => domain.describe(),
        }
    }

    /// The claim without its subject.
    #[must_use]
    pub fn describe(&self) -> String {
        format!("{} {}", self.property.describe(), self.describe_domain())
    }
}
