//! Proof of a gap bound: with the proof of [`unavoidable`](crate::unavoidable), no profile keeps every gap larger than
//! stated.

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::bounded;
use crate::claim::{MAX_STEPS, Scene};
use crate::rejection::Rejection;
use crate::scope::Scope;
use crate::unavoidable::{Branch, branch_overlap_m, min_overlap_m};
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

/// A proof that no profile keeps every gap larger than stated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GapBoundClaim {
    /// Scene of the claim.
    pub scene: Scene,
    /// Upper bound of the smallest gap, in metres; not negative.
    pub gap_m: f64,
    /// Branches as in [`UnavoidableClaim`](crate::UnavoidableClaim).
    #[serde(deserialize_with = "bounded::deserialize_list::<{ MAX_STEPS as usize + 1 }, _, _>")]
    pub branches: Vec<Branch>,
}

impl Claim for GapBoundClaim {
    fn name(&self) -> &'static str {
        "gap-bound"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::Scene {
            scene: &self.scene,
            profile: None,
        }
    }

    fn assumptions(&self) -> Vec<Assumption> {
        self.scene.assumptions(Assumption::EgoWithinLimits)
    }

    fn scope(&self) -> Scope {
        self.scene.scope()
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        let stated_m = self.gap_m;
        if !(stated_m >= 0.0 && stated_m.is_finite()) {
            return Err(Rejection::invalid("gap_m", "must be 0 or more"));
        }
        let overlap_m = min_overlap_m(&self.scene, &self.branches, input.work, branch_overlap_m)?;
        let gap_m = (-overlap_m).max(0.0);
        if gap_m <= stated_m {
            Ok(ProvedClaim::GapBound {
                gap_m,
                horizon_s: self.scene.horizon_s(),
            })
        } else {
            Err(Rejection::GapBound { stated_m, gap_m })
        }
    }
}
