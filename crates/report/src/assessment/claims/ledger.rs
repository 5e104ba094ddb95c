//! All evidence of an assessment, and the resulting status of claims.

use serde::{Deserialize, Serialize};

use super::{AssuranceClaim, Domain, Evidence, InferenceRule, Property, Strength};

/// All evidence of an assessment.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct Ledger {
    evidence: Vec<Evidence>,
}

/// The status of a claim.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ClaimStatus {
    /// Strongest known support or refutation.
    #[serde(flatten)]
    pub strength: Strength,
    /// Rule that leads to the strength; absent without evidence.
    pub rule: Option<InferenceRule>,
    /// Indices in the ledger of the evidence behind the strength.
    pub evidence: Vec<usize>,
    /// Other evidence about the same claim.
    #[serde(alias = "beside")]
    pub secondary: Vec<SecondaryEvidence>,
}

/// Further evidence about a claim.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SecondaryEvidence {
    /// Strength of the evidence.
    #[serde(flatten)]
    pub strength: Strength,
    /// Rule that leads to the strength.
    pub rule: InferenceRule,
    /// Index of the evidence in the ledger.
    pub evidence: usize,
}

impl SecondaryEvidence {
    /// True for the result of a count: one of several counts must be chosen independently of its result.
    fn is_counted(&self) -> bool {
        self.rule == InferenceRule::BoundsDecide
            || matches!(
                self.strength,
                Strength::Counted { .. } | Strength::NotShownByCounting { .. }
            )
    }
}

impl Default for ClaimStatus {
    fn default() -> Self {
        Self {
            strength: Strength::Untried,
            rule: None,
            evidence: Vec::new(),
            secondary: Vec::new(),
        }
    }
}

impl ClaimStatus {
    /// Describes the status: the strongest evidence, or all evidence if it is contradictory.
    #[must_use]
    pub fn describe(&self) -> String {
        let strongest = self.strength.describe();
        if self.strength != Strength::Contradicted {
            return strongest;
        }
        let mut descriptions: Vec<String> = Vec::new();
        for one in self.secondary.iter().map(|other| other.strength.describe()) {
            if !descriptions.contains(&one) {
                descriptions.push(one);
            }
        }
        format!("{strongest}: {}", descriptions.join("; "))
    }
}

impl Ledger {
    /// Creates a ledger of this evidence.
    #[must_use]
    pub fn new(evidence: Vec<Evidence>) -> Self {
        Self { evidence }
    }

    /// Returns all evidence, in its order.
    #[must_use]
    pub fn evidence(&self) -> &[Evidence] {
        &self.evidence
    }

    /// Returns the status of a claim: the strongest evidence, with all other evidence beside it. If some evidence
    /// asserts the claim (testing alone does not) and some refutes it, the status is [`Strength::Contradicted`].
    #[must_use]
    pub fn claim_status(&self, claim: &AssuranceClaim) -> ClaimStatus {
        let read = |(place, evidence)| {
            InferenceRule::apply(evidence, claim).map(|(rule, strength)| SecondaryEvidence {
                strength,
                rule,
                evidence: place,
            })
        };
        let mut all: Vec<SecondaryEvidence> =
            self.evidence.iter().enumerate().filter_map(read).collect();
        let united = self.combine_partial_proofs(claim);
        let deciding = self.deciding_count(&all);
        let weight = |one: &SecondaryEvidence| {
            let is_free = !one.is_counted() || one.strength.is_refutation();
            if is_free || Some(one.evidence) == deciding {
                one.strength.weight()
            } else {
                -1.0
            }
        };
        // Strongest first; the sort is stable, so ties keep the order of the ledger.
        all.sort_by(|a, b| weight(b).total_cmp(&weight(a)));
        let holds = united.is_some() || all.iter().any(|one| one.strength.is_assurance());
        let refuted: Vec<_> = all
            .iter()
            .filter(|one| one.strength.is_refutation())
            .map(|one| one.evidence)
            .collect();
        if (holds && !refuted.is_empty()) || self.has_disjoint_bounds(claim) {
            let evidence = all.iter().map(|one| one.evidence).collect();
            return ClaimStatus {
                strength: Strength::Contradicted,
                rule: None,
                evidence,
                secondary: all,
            };
        }
        if let Some((strength, evidence)) = united
            && all
                .first()
                .is_none_or(|first| first.strength.weight() < strength.weight())
        {
            return ClaimStatus {
                strength,
                rule: Some(InferenceRule::ProofsOfParts),
                evidence,
                secondary: all,
            };
        }
        if all.is_empty() {
            return ClaimStatus::default();
        }
        let SecondaryEvidence {
            strength,
            rule,
            evidence,
        } = all.remove(0);
        ClaimStatus {
            strength,
            rule: Some(rule),
            evidence: vec![evidence],
            secondary: all,
        }
    }

    /// True if two pieces of evidence give disjoint bounds on the rate of a claim.
    fn has_disjoint_bounds(&self, claim: &AssuranceClaim) -> bool {
        if !matches!(claim.property, Property::RateAtMost { .. }) {
            return false;
        }
        let rate = AssuranceClaim {
            property: Property::FailureRate,
            ..claim.clone()
        };
        let bounds = self
            .evidence
            .iter()
            .filter(|one| one.claim == rate)
            .filter_map(|one| match one.strength {
                Strength::Between {
                    lower_percent,
                    upper_percent,
                    ..
                } => Some((lower_percent.value(), upper_percent.value())),
                _ => None,
            });
        let (lower, upper) = bounds.fold((0.0, 100.0), |(lower, upper), (low, high)| {
            (f64::max(lower, low), f64::min(upper, high))
        });
        lower > upper
    }

    /// Returns the index of the count that decides a claim. Choosing the best of several would lose its confidence
    /// level, so parameters fixed before counting decide: confidence level as shown, then runs. Ties go to the least
    /// favourable.
    fn deciding_count(&self, readings: &[SecondaryEvidence]) -> Option<usize> {
        let counts = readings.iter().filter(|one| one.is_counted());
        let counts = counts.filter_map(|one| {
            Some((
                one.evidence,
                count_priority(&self.evidence.get(one.evidence)?.strength)?,
            ))
        });
        let strongest = counts.max_by(|(_, (confidence, runs, against)), (_, other)| {
            confidence
                .total_cmp(&other.0)
                .then(runs.cmp(&other.1))
                .then(against.total_cmp(&other.2))
        });
        strongest.map(|(place, _)| place)
    }

    fn combine_partial_proofs(&self, claim: &AssuranceClaim) -> Option<(Strength, Vec<usize>)> {
        let Domain::Scenarios { about, all } = &claim.domain else {
            return None;
        };
        let proof_of = |scenario| {
            let domain = Domain::Scenarios {
                about: about.clone(),
                all: vec![scenario],
            };
            let part = AssuranceClaim {
                domain,
                ..claim.clone()
            };
            let proves = |evidence: &Evidence| {
                matches!(
                    InferenceRule::apply(evidence, &part),
                    Some((
                        InferenceRule::Direct | InferenceRule::ProofCovers,
                        Strength::Proved { .. }
                    ))
                )
            };
            self.evidence.iter().position(proves)
        };
        let proofs = all
            .iter()
            .cloned()
            .map(proof_of)
            .collect::<Option<Vec<_>>>()?;
        (proofs.len() > 1).then_some((
            Strength::Proved {
                certificates: proofs.len(),
            },
            proofs,
        ))
    }
}

/// Returns confidence level and runs of a count, and the percentage that it shows against the claim.
fn count_priority(strength: &Strength) -> Option<(f64, u64, f64)> {
    let (confidence_percent, runs, against_percent) = match *strength {
        Strength::Between {
            upper_percent,
            confidence_percent,
            runs,
            ..
        } => (confidence_percent, runs, upper_percent.value()),
        Strength::Counted {
            confidence_percent,
            runs,
        } => (confidence_percent, runs, 0.0),
        Strength::NotShownByCounting {
            confidence_percent,
            runs,
        } => (confidence_percent, runs, 100.0),
        _ => return None,
    };
    Some((confidence_percent.value(), runs, against_percent))
}
