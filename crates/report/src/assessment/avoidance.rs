//! The best escape found from a scenario, and the regret of a controller against it.

use serde::{Deserialize, Serialize};

use super::gather_context::GatherContext;
use super::{CacheError, CaseResult, Rounded};
use crumple_search::confirmation::escape_survives;
use crumple_search::worst_case::{
    AvoidOptions, Avoidance, AvoidanceVerdict, avoid, covers_scenario,
};
use crumple_sim::scenario::{Scenario, file};
use crumple_verify::{Certificate, ProvedClaim, check};

/// Mark of an escape that collides in a replay with the multi-body plant.
pub(super) const COLLIDING_ESCAPE: &str = "multi-body: collides";

/// An avoidance verdict with rounded numbers: can any driver avoid a collision, and by how much?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum RoundedAvoidance {
    /// A replayed profile avoids a collision.
    Avoidable {
        /// Smallest gap of the escape between any two vehicles, the largest found, in metres, rounded down.
        escape_min_gap_m: Rounded<2>,
        /// Upper bound of the smallest gap of any driver, in metres, rounded up.
        min_gap_bound_m: Option<Rounded<2>>,
        /// True if the checker has accepted a certificate of that bound.
        min_gap_bound_is_certified: bool,
        /// Time at which the follower's emergency brake fires on that profile, in seconds.
        trigger_time_s: Option<Rounded<2>>,
        /// True if that profile has no collision with the multi-body plant either; absent if it cannot be run.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        escape_survives_multi_body: Option<bool>,
    },
    /// No driver avoids a collision; the checker has accepted the proof.
    Unavoidable,
    /// Neither was shown.
    Undecided {
        /// Reason in words.
        reason: String,
    },
}

impl RoundedAvoidance {
    fn from_avoidance(
        scenario: &Scenario,
        Avoidance {
            verdict,
            min_gap_bound_m,
            bound_certificate,
            ..
        }: &Avoidance,
    ) -> Self {
        match verdict {
            AvoidanceVerdict::Avoidable(escape) => Self::Avoidable {
                escape_min_gap_m: Rounded::down(escape.min_gap_m),
                min_gap_bound_m: min_gap_bound_m.map(Rounded::up),
                min_gap_bound_is_certified: bound_certificate.is_some(),
                trigger_time_s: escape.trigger_time_s().map(Rounded::new),
                escape_survives_multi_body: escape_survives(scenario, &escape.acceleration_mps2),
            },
            AvoidanceVerdict::Unavoidable(_) => Self::Unavoidable,
            AvoidanceVerdict::Undecided(reason) => Self::Undecided {
                reason: reason.to_string(),
            },
        }
    }

    /// Returns how much smaller the smallest gap of a case is than that of the best escape found, from the rounded
    /// numbers; `None` without an escape, or if other vehicles collided first. Zero for a controller that beats the
    /// escape within its grid.
    pub(super) fn regret_m(&self, case: &CaseResult) -> Option<Rounded<2>> {
        match self {
            Self::Avoidable {
                escape_min_gap_m, ..
            } if case.verdict.is_conclusive() => Some(Rounded::new(
                (escape_min_gap_m.value() - case.min_gap_m?.value()).max(0.0),
            )),
            _ => None,
        }
    }

    pub(super) fn describe(&self) -> String {
        match self {
            Self::Avoidable {
                escape_min_gap_m,
                min_gap_bound_m,
                min_gap_bound_is_certified,
                trigger_time_s,
                escape_survives_multi_body,
            } => {
                let fires = trigger_time_s
                    .map(|time_s| format!("; the follower's emergency brake fires at {time_s} s"));
                let by = if *min_gap_bound_is_certified {
                    "proved"
                } else {
                    "computed, without a certificate"
                };
                let bound = min_gap_bound_m
                    .map(|bound_m| format!("; no driver keeps more than {bound_m} m ({by})"));
                let replay = escape_survives_multi_body.map_or("", |survives| match survives {
                    true => " With the multi-body plant, this escape has no collision either.",
                    false => " With the multi-body plant, this escape collides.",
                });
                format!(
                    "Avoidable: smallest gap of the best escape found {escape_min_gap_m} m{}{}.{replay}",
                    fires.unwrap_or_default(),
                    bound.unwrap_or_default()
                )
            }
            Self::Unavoidable => {
                "Unavoidable: every driver collides; the checker has accepted the proof.".to_owned()
            }
            Self::Undecided { reason } => {
                format!("Undecided if a driver could avoid the collision: {reason}.")
            }
        }
    }

    pub(super) fn label(&self) -> String {
        match self {
            Self::Avoidable {
                escape_min_gap_m,
                escape_survives_multi_body: Some(false),
                ..
            } => {
                format!("{escape_min_gap_m} m; {COLLIDING_ESCAPE}")
            }
            Self::Avoidable {
                escape_min_gap_m, ..
            } => format!("{escape_min_gap_m} m"),
            Self::Unavoidable => "unavoidable".to_owned(),
            Self::Undecided { .. } => "undecided".to_owned(),
        }
    }
}

/// The avoidance of a scenario, and the certificate of its claims about every driver.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct CertifiedAvoidance {
    #[serde(alias = "best")]
    pub(super) avoidance: RoundedAvoidance,
    pub(super) certificate: Option<Certificate>,
}

impl CertifiedAvoidance {
    /// Loads the avoidance of a scenario from the cache and checks its certificate again, or computes it.
    pub(super) fn load_or_compute(
        scenario: &Scenario,
        work: &GatherContext<'_>,
    ) -> Result<Self, CacheError> {
        let text = file::to_toml(scenario).map_err(CacheError::encoding)?;
        let cached: Self = work.cache.get_or_gather(
            &format!("best of {}", scenario.spec().name),
            &text,
            || Ok::<_, CacheError>(Self::compute(scenario)),
        )?;
        Ok(if cached.is_valid_for(scenario) {
            cached
        } else {
            Self::compute(scenario)
        })
    }

    fn compute(scenario: &Scenario) -> Self {
        let options = AvoidOptions {
            certify_bound: true,
            ..AvoidOptions::default()
        };
        match avoid(scenario, options) {
            Ok(avoidance) => {
                let best = RoundedAvoidance::from_avoidance(scenario, &avoidance);
                let certificate = match avoidance.verdict {
                    AvoidanceVerdict::Unavoidable(certificate) => Some(certificate),
                    AvoidanceVerdict::Avoidable(_) | AvoidanceVerdict::Undecided(_) => {
                        avoidance.bound_certificate
                    }
                };
                Self {
                    avoidance: best,
                    certificate: certificate.map(|certificate| *certificate),
                }
            }
            Err(error) => Self {
                avoidance: RoundedAvoidance::Undecided {
                    reason: error.to_string(),
                },
                certificate: None,
            },
        }
    }

    /// True if the certificate supports what the avoidance claims about every driver.
    fn is_valid_for(&self, scenario: &Scenario) -> bool {
        let shown = self
            .certificate
            .as_ref()
            .map(|certificate| (check(certificate), covers_scenario(certificate, scenario)));
        match (&self.avoidance, shown) {
            (RoundedAvoidance::Unavoidable, shown) => {
                matches!(shown, Some((Ok(ProvedClaim::Unavoidable { .. }), true)))
            }
            (
                RoundedAvoidance::Avoidable {
                    min_gap_bound_m: Some(bound_m),
                    min_gap_bound_is_certified: true,
                    ..
                },
                shown,
            ) => {
                matches!(shown, Some((Ok(ProvedClaim::GapBound { gap_m, .. }), true)) if Rounded::up(gap_m) == *bound_m)
            }
            (RoundedAvoidance::Avoidable { .. } | RoundedAvoidance::Undecided { .. }, shown) => {
                shown.is_none()
            }
        }
    }
}

pub(super) const REGRET_EXPLANATION: &str = "The best escape found is a simulated acceleration profile of the vehicles \
    under test from convex programming with knowledge of the future, on steps of 0.1 s or finer. Avoidable: by such a \
    profile of point masses. \"No driver keeps more than\" states a bound for every driver; where the text says \
    \"proved\", the checker has accepted its proof. `avoid --bound-certificate` also writes it.";
