//! The rules that apply evidence to claims other than its own.

use serde::{Deserialize, Serialize};

use super::{AssuranceClaim, Evidence, Property, Strength};

/// An inference rule from evidence to a claim. Names play no role in any rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum InferenceRule {
    /// The evidence is about this claim.
    #[serde(alias = "own")]
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
    pub const DERIVED: [Self; 5] = [
        Self::RefutedInPart,
        Self::RefutedByWeaker,
        Self::ProofCovers,
        Self::ProofsOfParts,
        Self::BoundsDecide,
    ];

    /// Describes the rule in a sentence.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::Direct => {
                "Evidence supports the claim with the same controller hash, estimator, property and domain."
            }
            Self::RefutedInPart => {
                "A run that refutes a claim about a part of a domain (random scenarios, points of a search, some of \
                 the scenarios) also refutes the claim about the whole domain."
            }
            Self::RefutedByWeaker => "A collision with the leader also refutes \"no collision\".",
            Self::ProofCovers => {
                "A proof for a domain holds for its parts. A proof of \"no collision\" also proves \"no collision \
                 with the leader\"."
            }
            Self::ProofsOfParts => {
                "Proofs for each of several scenarios prove the claim about all of them."
            }
            Self::BoundsDecide => {
                "Bounds on a rate decide a claim about that rate: it holds, does not hold, or is undecided. Of several \
                 counts, that with the highest confidence level decides; of several with this level, that with the \
                 most runs. Level and number of runs were fixed before counting. A count that refutes the claim is \
                 always shown."
            }
        }
    }

    /// Returns the strength that `evidence` gives to `claim`, and the rule; `None` if it has no bearing on the claim.
    pub(super) fn apply(evidence: &Evidence, claim: &AssuranceClaim) -> Option<(Self, Strength)> {
        let own = &evidence.claim;
        let strength = &evidence.strength;
        if own.subject != claim.subject || *strength == Strength::Untried {
            return None;
        }
        if own.domain == claim.domain && own.property == claim.property {
            return Some((Self::Direct, strength.clone()));
        }
        if let (Property::FailureRate, Property::RateAtMost { percent }) =
            (&own.property, &claim.property)
        {
            let decided = (own.domain == claim.domain)
                .then(|| strength.decide_rate_claim(percent.value()))??;
            return Some((Self::BoundsDecide, decided));
        }
        if !own.property.is_universal() || !claim.property.is_universal() {
            return None;
        }
        if strength.is_refutation()
            && claim.property.implies(&own.property)
            && claim.domain.covers(&own.domain)
        {
            let rule = if own.property == claim.property {
                Self::RefutedInPart
            } else {
                Self::RefutedByWeaker
            };
            return Some((rule, strength.clone()));
        }
        let is_proof = matches!(strength, Strength::Proved { .. });
        if is_proof && own.property.implies(&claim.property) && own.domain.covers(&claim.domain) {
            return Some((Self::ProofCovers, strength.clone()));
        }
        None
    }
}
