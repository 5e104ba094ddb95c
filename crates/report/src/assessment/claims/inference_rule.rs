//! The rules that apply evidence to claims other than its own.

use serde::{Deserialize, Serialize};

use super::{AssuranceClaim, Evidence, Property, Strength};

/// An inference rule from evidence to a claim. Names play no role in any rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum InferenceRule {
    /// The evidence is about this claim.
    #[serde(rename = "own")]
    Direct,
    /// A run in a part of the domain refutes a claim about every run of the whole.
    RefutedInPart,
    /// A refutation of a weaker property refutes the stronger one.
    RefutedByWeaker,
    /// A proof holds in every part of its domain, and for weaker properties.
    ProofCovers,
    /// Proofs of all parts prove the whole.
    ProofsOfParts,
    /// Bounds on a rate decide every claim about it.
    BoundsDecide,
}

impl InferenceRule {
    /// All rules except `Direct`, in the order of the report.
    pub const DERIVED: [Self; 5] =
        [Self::RefutedInPart, Self::RefutedByWeaker, Self::ProofCovers, Self::ProofsOfParts, Self::BoundsDecide];

    /// Describes the rule in a sentence.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::Direct => {
                "Evidence speaks for the claim that it equals: the same controller by its hash, estimator, property and domain."
            }
            Self::RefutedInPart => {
                "A run that refutes a claim about every run in one part of a domain (draws of a space, points that a search tried, \
                 some of the scenarios) refutes it in the whole."
            }
            Self::RefutedByWeaker => "A contact with the vehicle ahead refutes \"no contact\" as well.",
            Self::ProofCovers => {
                "What is proved of a domain is proved of its parts; \"no contact\", proved, is proved of the vehicle ahead."
            }
            Self::ProofsOfParts => "Scenarios of which each is proved are proved together.",
            Self::BoundsDecide => {
                "Bounds on the share of failures decide a claim about that share: above it, below it, or neither. Of several the one \
                 decides that was fixed before anything was counted: the highest confidence, then the most runs; so it is with \
                 counts that show which of two fails less often. One that refutes is always shown."
            }
        }
    }

    /// Returns the strength that `evidence` gives to `claim`, and the rule; `None` if it has no bearing on the claim.
    pub(super) fn apply(evidence: &Evidence, claim: &AssuranceClaim) -> Option<(Self, Strength)> {
        let (own, strength) = (&evidence.claim, &evidence.strength);
        if own.subject != claim.subject || *strength == Strength::Untried {
            return None;
        }
        if own.domain == claim.domain && own.property == claim.property {
            return Some((Self::Direct, strength.clone()));
        }
        if let (Property::FailureRate, Property::RateAtMost { percent }) = (&own.property, &claim.property) {
            let decided = (own.domain == claim.domain).then(|| strength.decide_rate_claim(percent.value()))??;
            return Some((Self::BoundsDecide, decided));
        }
        if !own.property.is_universal() || !claim.property.is_universal() {
            return None;
        }
        if strength.is_refutation() && claim.property.implies(&own.property) && claim.domain.covers(&own.domain) {
            let rule = if own.property == claim.property { Self::RefutedInPart } else { Self::RefutedByWeaker };
            return Some((rule, strength.clone()));
        }
        let is_proof = matches!(strength, Strength::Proved { .. });
        if is_proof && own.property.implies(&claim.property) && own.domain.covers(&claim.domain) {
            return Some((Self::ProofCovers, strength.clone()));
        }
        None
    }
}
