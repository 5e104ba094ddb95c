//! The best escape found from a scenario, and the regret of a controller against it.

use serde::{Deserialize, Serialize, Serializer};

use super::gather_context::GatherContext;
use super::{CacheError, CaseResult, CaseVerdict, Rounded};
use crumple_core::digits::format_fixed_down;
use crumple_search::worst_case::{
    AvoidOptions, AvoidReport, AvoidanceClass, AvoidanceVerdict, avoid, covers_scenario,
};
use crumple_sim::scenario::{Scenario, file};
use crumple_verify::{Certificate, ProvedClaim, check};

/// Mark of an escape that collides in a replay with the multi-body plant.
pub(super) const COLLIDING_ESCAPE: &str = "multi-body: collides";

/// An avoidance verdict with rounded numbers: can any driver avoid a collision, and by how much?
// The form of an `AvoidReport` in the JSON of the assessment.
#[derive(Debug, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "RoundedAvoidance")
)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub(super) enum AvoidanceJson {
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

impl AvoidanceJson {
    fn new(report: &AvoidReport) -> Self {
        match (report.verdict, report.escape_min_gap_m) {
            (AvoidanceClass::Avoidable, Some(gap_m)) => Self::Avoidable {
                escape_min_gap_m: Rounded::down(gap_m),
                min_gap_bound_m: report.min_gap_bound_m.map(Rounded::up),
                min_gap_bound_is_certified: report.min_gap_bound_is_certified,
                trigger_time_s: report.trigger_time_s.map(Rounded::new),
                escape_survives_multi_body: report.escape_survives_multi_body,
            },
            (AvoidanceClass::Unavoidable, _) => Self::Unavoidable,
            (AvoidanceClass::Avoidable | AvoidanceClass::Undecided, _) => Self::Undecided {
                reason: describe_reason(report),
            },
        }
    }
}

/// Writes a report in the form of the assessment's JSON.
#[expect(clippy::ref_option, reason = "as serde calls it")]
pub(super) fn serialize_rounded<S: Serializer>(
    report: &Option<AvoidReport>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    report
        .as_ref()
        .map(AvoidanceJson::new)
        .serialize(serializer)
}

/// Returns how much smaller the smallest gap of a case is than that of the best escape found, from the rounded numbers.
/// `None` without an escape or an answer of the controller, or if other vehicles collided first. Zero for a controller
/// that beats the escape within its grid.
pub(super) fn regret_m(report: &AvoidReport, case: &CaseResult) -> Option<Rounded<2>> {
    let is_unanswered = matches!(case.verdict, CaseVerdict::ControllerFailed { .. });
    if is_unanswered || !case.verdict.is_conclusive() {
        return None;
    }
    let escape_m = Rounded::<2>::down(report.escape_min_gap_m?);
    let regret_m = escape_m.value() - case.min_gap_m?.value();
    Some(Rounded::new(regret_m.max(0.0)))
}

/// Describes an analysis in a cell of a table.
pub(super) fn label_avoidance(report: &AvoidReport) -> String {
    match (report.verdict, report.escape_min_gap_m) {
        (AvoidanceClass::Avoidable, Some(gap_m)) => {
            let mark = match report.escape_survives_multi_body {
                Some(false) => format!("; {COLLIDING_ESCAPE}"),
                Some(true) | None => String::new(),
            };
            format!("{} m{mark}", format_fixed_down(gap_m, 2))
        }
        (class, _) => class.name().to_owned(),
    }
}

fn describe_reason(report: &AvoidReport) -> String {
    let reason = report.reason.as_ref();
    reason.map(ToString::to_string).unwrap_or_default()
}

/// The avoidance of a scenario, and the certificate of its claims about every driver.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct CertifiedAvoidance {
    pub(super) report: AvoidReport,
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
                let report = AvoidReport::new(scenario, &avoidance);
                let certificate = match avoidance.verdict {
                    AvoidanceVerdict::Unavoidable(certificate) => Some(certificate),
                    AvoidanceVerdict::Avoidable(_) | AvoidanceVerdict::Undecided(_) => {
                        avoidance.bound_certificate
                    }
                };
                Self {
                    report,
                    certificate: certificate.map(|certificate| *certificate),
                }
            }
            Err(error) => Self {
                report: AvoidReport::not_analysed(scenario, &error),
                certificate: None,
            },
        }
    }

    /// True if the certificate supports what the report claims about every driver.
    fn is_valid_for(&self, scenario: &Scenario) -> bool {
        let claim = self
            .certificate
            .as_ref()
            .map(|certificate| (check(certificate), covers_scenario(certificate, scenario)));
        let bound_m = self
            .report
            .min_gap_bound_m
            .filter(|_| self.report.min_gap_bound_is_certified);
        match (self.report.verdict, bound_m) {
            (AvoidanceClass::Unavoidable, _) => {
                matches!(claim, Some((Ok(ProvedClaim::Unavoidable { .. }), true)))
            }
            (_, Some(bound_m)) => {
                matches!(claim, Some((Ok(ProvedClaim::GapBound { gap_m, .. }), true)) if gap_m == bound_m)
            }
            (AvoidanceClass::Avoidable | AvoidanceClass::Undecided, None) => claim.is_none(),
        }
    }
}

pub(super) const REGRET_EXPLANATION: &str = "The best escape found is a simulated acceleration profile of the vehicles \
    under test from convex programming with knowledge of the future, on steps of 0.1 s or finer. Avoidable: by such a \
    profile of point masses. \"No driver keeps more than\" states a bound for every driver; where the text says \
    \"proved\", the checker has accepted its proof. `avoid --bound-certificate` also writes it.";
