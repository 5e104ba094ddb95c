//! All evidence of an assessment, and how claims stand by it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Claim, Domain, Evidence, Property, Rule, Strength};

/// All evidence of an assessment.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Ledger {
    evidence: Vec<Evidence>,
}

/// How a claim stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Standing {
    /// The strongest that is known of it.
    #[serde(flatten)]
    pub strength: Strength,
    /// How that follows; none if nothing is known.
    pub rule: Option<Rule>,
    /// Which evidence says so, by its place in the ledger.
    pub evidence: Vec<usize>,
    /// What other evidence says of the same claim.
    pub beside: Vec<Beside>,
}

/// What is known of a claim besides.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Beside {
    /// What it says.
    #[serde(flatten)]
    pub strength: Strength,
    /// How that follows.
    pub rule: Rule,
    /// Which evidence, by its place in the ledger.
    pub evidence: usize,
}

impl Default for Standing {
    /// Of what nothing is known.
    fn default() -> Self {
        Self { strength: Strength::Untried, rule: None, evidence: Vec::new(), beside: Vec::new() }
    }
}

impl Standing {
    /// How the claim stands, and what else is said of it.
    #[must_use]
    pub fn words(&self) -> String {
        let others = self.beside.iter().map(|beside| beside.strength.words());
        let mut said = vec![self.strength.words()];
        for other in others.filter(|other| self.strength == Strength::Contradicted || !other.starts_with("tested")) {
            if !said.contains(&other) {
                said.push(other);
            }
        }
        match said.as_slice() {
            [only] => only.clone(),
            [first, others @ ..] => format!("{first} (beside it: {})", others.join("; ")),
            [] => String::new(),
        }
    }
}

impl Ledger {
    /// A ledger of all this.
    #[must_use]
    pub fn new(evidence: Vec<Evidence>) -> Self {
        Self { evidence }
    }

    /// All evidence, in its order.
    #[must_use]
    pub fn evidence(&self) -> &[Evidence] {
        &self.evidence
    }

    /// How a claim stands: the strongest reading of the evidence, the others beside it. Where one reading says that the claim
    /// holds, not only that it was tried, and another that it does not, it is [`Strength::Contradicted`].
    #[must_use]
    pub fn standing(&self, claim: &Claim) -> Standing {
        let read = |(place, evidence)| {
            Rule::read(evidence, claim).map(|(rule, strength)| Beside { strength, rule, evidence: place })
        };
        let mut all: Vec<Beside> = self.evidence.iter().enumerate().filter_map(read).collect();
        let united = self.proofs_of_parts(claim);
        let deciding = self.deciding(claim);
        let weight = |one: &Beside| {
            let is_picked = one.rule != Rule::BoundsDecide || one.strength.is_refutation();
            if is_picked || Some(one.evidence) == deciding { one.strength.weight() } else { -1.0 }
        };
        // The strongest first; of equals the first in the ledger.
        all.sort_by(|a, b| weight(b).total_cmp(&weight(a)));
        let holds = united.is_some() || all.iter().any(|one| one.strength.is_assurance());
        let refuted: Vec<_> = all.iter().filter(|one| one.strength.is_refutation()).map(|one| one.evidence).collect();
        if (holds && !refuted.is_empty()) || self.bounds_part(claim) {
            let evidence = all.iter().map(|one| one.evidence).collect();
            return Standing { strength: Strength::Contradicted, rule: None, evidence, beside: all };
        }
        if let Some((strength, evidence)) = united
            && all.first().is_none_or(|first| first.strength.weight() < strength.weight())
        {
            return Standing { strength, rule: Some(Rule::ProofsOfParts), evidence, beside: all };
        }
        if all.is_empty() {
            return Standing::default();
        }
        let Beside { strength, rule, evidence } = all.remove(0);
        Standing { strength, rule: Some(rule), evidence: vec![evidence], beside: all }
    }

    /// The bounds on the rate that a claim is about, each with its place.
    fn bounds(&self, claim: &Claim) -> Vec<(usize, Bounds)> {
        if !matches!(claim.property, Property::RateAtMost { .. }) {
            return Vec::new();
        }
        let rate = Claim { property: Property::FailureRate, ..claim.clone() };
        let own = self.evidence.iter().enumerate().filter(|(_, evidence)| evidence.claim == rate);
        own.filter_map(|(place, evidence)| Some((place, Bounds::of(&evidence.strength)?))).collect()
    }

    /// Whether two pieces of evidence bound the rate that a claim is about, and their bounds do not meet.
    fn bounds_part(&self, claim: &Claim) -> bool {
        let bounds = self.bounds(claim);
        let lower = bounds.iter().map(|(_, one)| one.lower_percent).fold(0.0, f64::max);
        lower > bounds.iter().map(|(_, one)| one.upper_percent).fold(100.0, f64::min)
    }

    /// Which bounds decide a claim about a rate, where there are several: not those that happen to please, for the best of
    /// many bounds holds less often than each. What decides was fixed before anything was counted: the highest confidence,
    /// then the most runs; of equals the least favourable.
    fn deciding(&self, claim: &Claim) -> Option<usize> {
        let before = |a: &Bounds, b: &Bounds| {
            let confidence = a.confidence_percent.total_cmp(&b.confidence_percent);
            confidence.then(a.runs.cmp(&b.runs)).then(a.upper_percent.total_cmp(&b.upper_percent))
        };
        self.bounds(claim).into_iter().max_by(|(_, a), (_, b)| before(a, b)).map(|(place, _)| place)
    }

    /// The proofs that cover all scenarios of a claim together, if no single one does.
    fn proofs_of_parts(&self, claim: &Claim) -> Option<(Strength, Vec<usize>)> {
        let Domain::Scenarios { about, all } = &claim.domain else { return None };
        let proof_of = |scenario| {
            let domain = Domain::Scenarios { about: about.clone(), all: vec![scenario] };
            let part = Claim { domain, ..claim.clone() };
            let proves = |evidence: &Evidence| {
                matches!(Rule::read(evidence, &part), Some((Rule::Own | Rule::ProofCovers, Strength::Proved { .. })))
            };
            self.evidence.iter().position(proves)
        };
        let proofs = all.iter().cloned().map(proof_of).collect::<Option<Vec<_>>>()?;
        (proofs.len() > 1).then_some((Strength::Proved { certificates: proofs.len() }, proofs))
    }
}

/// Bounds on a rate.
struct Bounds {
    lower_percent: f64,
    upper_percent: f64,
    confidence_percent: f64,
    runs: u64,
}

impl Bounds {
    fn of(strength: &Strength) -> Option<Self> {
        match *strength {
            Strength::Between { lower_percent, upper_percent, confidence_percent, runs } => Some(Self {
                lower_percent: lower_percent.value(),
                upper_percent: upper_percent.value(),
                confidence_percent: confidence_percent.value(),
                runs,
            }),
            _ => None,
        }
    }
}
