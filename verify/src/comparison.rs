//! Proof that one controller fails less often than another, with the exact McNemar test of
//! [`rate`](crate::rate).

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::bounded;
use crate::certificate::CertificateProvenance;
use crate::rate::{OPS_PER_RUN, check_tail};
use crate::registration::{CertifiedBlock, MAX_BLOCKS, Registration};
use crate::rejection::Rejection;
use crate::scope::Scope;
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

/// The claim that the first of two controllers fails less often than the second on the same samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ComparisonClaim {
    /// Parameters that were fixed before the first run.
    pub registration: Registration,
    /// Published digest of the registration.
    pub registration_sha256: String,
    /// k, the runs in which the first fails and the second does not.
    pub only_first_failed: u64,
    /// d - k, the runs in which the second fails and the first does not.
    pub only_second_failed: u64,
    /// For each block in order: runs that only the first and only the second failed, and its hash. Since version 2.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "bounded::deserialize_list::<{ MAX_BLOCKS as usize }, _, _>"
    )]
    pub blocks: Vec<CertifiedBlock<[u64; 2]>>,
}

impl Claim for ComparisonClaim {
    fn name(&self) -> &'static str {
        "comparison"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::Runs(&self.registration)
    }

    fn assumptions(&self) -> Vec<Assumption> {
        vec![Assumption::RegisteredDraws]
    }

    fn scope(&self) -> Scope {
        self.registration.scope()
    }

    fn check_fields(&self, provenance: &CertificateProvenance) -> Result<(), Rejection> {
        self.registration.check_entries(provenance, 2)?;
        let claimed = [self.only_first_failed, self.only_second_failed];
        self.registration.check_blocks(&self.blocks, claimed)
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        let registration = &self.registration;
        registration.check(&self.registration_sha256)?;
        let differ = self
            .only_first_failed
            .saturating_add(self.only_second_failed);
        if differ > registration.runs {
            return Err(Rejection::invalid(
                "only_first_failed",
                "and `only_second_failed` must not exceed the runs",
            ));
        }
        input
            .work
            .charge_or_reject(differ.saturating_mul(OPS_PER_RUN))?;
        check_tail(self.only_first_failed, differ, 0.5, registration.confidence)?;
        Ok(ProvedClaim::FailsLessOften {
            confidence: registration.confidence,
        })
    }

    fn counted_blocks(&self) -> Option<Vec<CertifiedBlock<[u64; 2]>>> {
        Some(self.blocks.clone())
    }
}
