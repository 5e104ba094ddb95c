//! All evidence of an assessment, and the resulting status of claims.

use std::cmp::Ordering;

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
    /// Rule that leads to the strength; absent if no evidence decides the claim.
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
                Strength::Counted { .. }
                    | Strength::NotShownByCounting { .. }
                    | Strength::CountedAgainst { .. }
            )
    }

    /// Returns the rank among evidence of one claim, where one of several counts decides.
    fn weight(&self, deciding_count: Option<usize>) -> f64 {
        let is_free = !self.is_counted() || self.strength.is_refutation();
        if is_free || Some(self.evidence) == deciding_count {
            self.strength.weight()
        } else {
            -1.0
        }
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
        for evidence in &self.secondary {
            let description = evidence.strength.describe();
            if !descriptions.contains(&description) {
                descriptions.push(description);
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
        let mut readings = self.readings_by_weight(claim);
        let united = self.combine_partial_proofs(claim);
        let is_asserted = united.is_some()
            || readings
                .iter()
                .any(|reading| reading.strength.is_assurance());
        let is_refuted = readings
            .iter()
            .any(|reading| reading.strength.is_refutation());
        if (is_asserted && is_refuted) || self.has_disjoint_bounds(claim) {
            return ClaimStatus {
                strength: Strength::Contradicted,
                rule: None,
                evidence: readings.iter().map(|reading| reading.evidence).collect(),
                secondary: readings,
            };
        }
        if let Some((strength, evidence)) = united
            && readings
                .first()
                .is_none_or(|first| first.strength.weight() < strength.weight())
        {
            return ClaimStatus {
                strength,
                rule: Some(InferenceRule::ProofsOfParts),
                evidence,
                secondary: readings,
            };
        }
        if readings.is_empty() {
            return self.undecided_status(claim);
        }
        let SecondaryEvidence {
            strength,
            rule,
            evidence,
        } = readings.remove(0);
        ClaimStatus {
            strength,
            rule: Some(rule),
            evidence: vec![evidence],
            secondary: readings,
        }
    }

    /// Returns the status of a claim that no evidence decides: not shown if it is about every run of its domain, and
    /// evidence is about a part. Random scenarios are no part of a count: a rate that was not counted is not examined.
    fn undecided_status(&self, claim: &AssuranceClaim) -> ClaimStatus {
        let about_part = self.evidence.iter().enumerate().filter(|(_, evidence)| {
            let own = &evidence.claim;
            evidence.strength != Strength::Untried
                && claim.property.is_universal()
                && own.subject == claim.subject
                && own.property.implies(&claim.property)
                && claim.domain.covers(&own.domain)
        });
        let evidence: Vec<usize> = about_part.map(|(index, _)| index).collect();
        let strength = if evidence.is_empty() {
            Strength::Untried
        } else {
            Strength::NotShown
        };
        ClaimStatus {
            strength,
            evidence,
            ..ClaimStatus::default()
        }
    }

    /// Returns the evidence about a claim, strongest first. Counts other than the deciding one are last, unless they
    /// refute the claim.
    fn readings_by_weight(&self, claim: &AssuranceClaim) -> Vec<SecondaryEvidence> {
        let mut readings = Vec::new();
        for (index, evidence) in self.evidence.iter().enumerate() {
            if let Some((rule, strength)) = InferenceRule::apply(evidence, claim) {
                readings.push(SecondaryEvidence {
                    strength,
                    rule,
                    evidence: index,
                });
            }
        }
        let deciding = self.deciding_count(&readings);
        // The sort is stable, so ties keep the order of the ledger.
        readings.sort_by(|a, b| b.weight(deciding).total_cmp(&a.weight(deciding)));
        readings
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
        let mut lower = 0.0;
        let mut upper = 100.0;
        for evidence in self
            .evidence
            .iter()
            .filter(|evidence| evidence.claim == rate)
        {
            if let Strength::Between {
                lower_percent,
                upper_percent,
                ..
            } = evidence.strength
            {
                lower = f64::max(lower, lower_percent.value());
                upper = f64::min(upper, upper_percent.value());
            }
        }
        lower > upper
    }

    /// Returns the index of the count that decides a claim. Choosing the best of several would lose its confidence
    /// level, so parameters fixed before counting decide: confidence level as shown, then runs. Ties go to the least
    /// favourable.
    fn deciding_count(&self, readings: &[SecondaryEvidence]) -> Option<usize> {
        readings
            .iter()
            .filter(|reading| reading.is_counted())
            .filter_map(|reading| {
                let counted = self.evidence.get(reading.evidence)?;
                Some((
                    reading.evidence,
                    CountPriority::from_strength(&counted.strength)?,
                ))
            })
            .max_by(|(_, a), (_, b)| a.compare(b))
            .map(|(index, _)| index)
    }

    /// Returns the index of the first proof that covers a claim.
    fn find_proof(&self, claim: &AssuranceClaim) -> Option<usize> {
        self.evidence.iter().position(|evidence| {
            matches!(
                InferenceRule::apply(evidence, claim),
                Some((
                    InferenceRule::Direct | InferenceRule::ProofCovers,
                    Strength::Proved { .. }
                ))
            )
        })
    }

    fn combine_partial_proofs(&self, claim: &AssuranceClaim) -> Option<(Strength, Vec<usize>)> {
        let Domain::Scenarios { about, all } = &claim.domain else {
            return None;
        };
        let proofs = all
            .iter()
            .map(|scenario| {
                self.find_proof(&AssuranceClaim {
                    domain: Domain::Scenarios {
                        about: about.clone(),
                        all: vec![scenario.clone()],
                    },
                    ..claim.clone()
                })
            })
            .collect::<Option<Vec<_>>>()?;
        (proofs.len() > 1).then_some((
            Strength::Proved {
                certificates: proofs.len(),
            },
            proofs,
        ))
    }
}

/// The order in which one of several counts decides a claim.
struct CountPriority {
    confidence_percent: f64,
    runs: u64,
    /// Percentage that the count shows against the claim.
    against_percent: f64,
}

impl CountPriority {
    /// Returns the priority of a count; `None` for other evidence.
    fn from_strength(strength: &Strength) -> Option<Self> {
        match *strength {
            Strength::Between {
                upper_percent,
                confidence_percent,
                runs,
                ..
            } => Some(Self {
                confidence_percent: confidence_percent.value(),
                runs,
                against_percent: upper_percent.value(),
            }),
            Strength::Counted {
                confidence_percent,
                runs,
            } => Some(Self {
                confidence_percent: confidence_percent.value(),
                runs,
                against_percent: 0.0,
            }),
            Strength::NotShownByCounting {
                confidence_percent,
                runs,
            }
            | Strength::CountedAgainst {
                confidence_percent,
                runs,
                ..
            } => Some(Self {
                confidence_percent: confidence_percent.value(),
                runs,
                against_percent: 100.0,
            }),
            _ => None,
        }
    }

    fn compare(&self, other: &Self) -> Ordering {
        self.confidence_percent
            .total_cmp(&other.confidence_percent)
            .then(self.runs.cmp(&other.runs))
            .then(self.against_percent.total_cmp(&other.against_percent))
    }
}
