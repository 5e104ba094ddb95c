//! Certificates of an assessment: of kernels, of counted rates, and given ones.

use crumple_verify::reach::InitialRanges;
use crumple_verify::{Assumption, Certificate, ProvedClaim, RateClaim, ReachClaim, Registration, Statement, WorkLimit};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::rate_certificates::planned_rate_counts;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, MIN_CONFIDENCE_PERCENT, Property, Strength, Subject,
};
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, Rounded};
use crumple_core::digest::sha256;
use crumple_evidence::{
    CertificateReport, RateInterval, check_covers_scenario, checker_file, kernel_certificate, shipped_kernels,
};
use crumple_world::control::{MIN_MARGIN_M, ShieldSettings, ViabilityKernel};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::{PAPER_STEP_S, Scenario, VehicleClass, built_in_scenario, built_in_scenario_names};
use crumple_world::sim::{ControllerKind, NamedController};

/// A certificate and the result of its check.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CheckedCertificate {
    /// Name of the certificate.
    pub name: String,
    /// Kind of statement.
    pub statement: &'static str,
    /// Description of the certificate's content.
    pub about: String,
    /// Path relative to the report folder.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Claim of this report that the certificate supports.
    #[serde(rename = "speaks_of")]
    pub subject: CertificateSubject,
    /// Result of the check.
    pub status: CertificateStatus,
    /// Assumptions of the statement.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<String>"))]
    pub assumptions: Vec<Assumption>,
    #[serde(skip)]
    pub(in crate::assessment) text: String,
    /// Statement, if it is about a kernel.
    #[serde(skip)]
    kernel: Option<Statement>,
    /// Statement, if it is about a rate and counts only failures of the controller.
    #[serde(skip)]
    rate: Option<RateClaim>,
}

/// The result of checking a certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum CertificateStatus {
    /// The certificate proves its statement.
    Accepted {
        /// Proved statement in words.
        shown: String,
        /// Strength for the claim about a controller; absent if it makes none.
        strength: Option<Strength>,
    },
    /// This assessment counted the registered runs, and they do not show the claim.
    NothingShown {
        /// Counts in words.
        counted: String,
        /// Strength for the claim.
        strength: Strength,
    },
    /// The certificate proves nothing.
    Rejected {
        /// Reason in words.
        reason: String,
    },
}

/// The claim of a report that a certificate supports; decided by hashes, never by names.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum CertificateSubject {
    /// A claim about a controller of the report, with equal hashes.
    Claim(Box<AssuranceClaim>),
    /// The kernel that shields use for a pair of brake limits.
    Kernel,
    /// A scene or a profile, without any controller.
    NoController,
    /// Nothing in this report.
    #[serde(rename = "foreign")]
    Unrelated {
        /// Reason in words.
        #[serde(rename = "because")]
        reason: String,
    },
}

impl CertificateSubject {
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Claim(claim) => {
                let Subject { controller, estimator } = &claim.subject;
                format!("{}, {}", controller.name, describe_estimator(*estimator))
            }
            Self::Kernel => "shields".to_owned(),
            Self::NoController => "no controller".to_owned(),
            Self::Unrelated { reason } => format!("none: {reason}"),
        }
    }
}

pub(super) fn describe_estimator(estimator: EstimatorKind) -> &'static str {
    match estimator {
        EstimatorKind::Truth => "with the true state",
        EstimatorKind::Kalman => "with the Kalman filter",
    }
}

impl CertificateStatus {
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Accepted { shown, .. } => shown.clone(),
            Self::NothingShown { counted, .. } => format!("not shown: {counted}"),
            Self::Rejected { reason } => format!("rejected: {reason}"),
        }
    }

    fn check(certificate: &Certificate, policy: Option<&[u8]>, counts_others: bool) -> Self {
        let report = CertificateReport::check(String::new(), certificate, policy, WorkLimit::default());
        let accepted = match report.map_err(|refused| refused.to_string()).and_then(|report| report.accepted) {
            Ok(accepted) => accepted,
            Err(reason) => return Self::Rejected { reason },
        };
        Self::Accepted {
            shown: describe_accepted(&accepted),
            strength: accepted_strength(&accepted, &certificate.statement, counts_others),
        }
    }
}

fn accepted_strength(accepted: &ProvedClaim, statement: &Statement, counts_others: bool) -> Option<Strength> {
    match (accepted, statement) {
        (ProvedClaim::Rate { max_rate, .. }, Statement::Rate(rate)) => {
            Some(rate_strength(rate, *max_rate, counts_others))
        }
        // Below the minimum confidence level it shows nothing.
        (ProvedClaim::FailsLessOften { confidence }, Statement::Comparison(two)) => {
            let confidence_percent = Rounded::down(100.0 * confidence);
            (confidence_percent.value() >= MIN_CONFIDENCE_PERCENT)
                .then_some(Strength::Counted { confidence_percent, runs: two.registration.runs })
        }
        // The certificate contains an initial state that ends in a collision.
        (ProvedClaim::Reach { falsified_share, .. }, _) if *falsified_share > 0.0 => {
            Some(Strength::Refuted { failures: 1, runs: 1 })
        }
        (ProvedClaim::Reach { verified_share, .. }, _) if *verified_share >= 1.0 => {
            Some(Strength::Proved { certificates: 1 })
        }
        (ProvedClaim::Reach { verified_share, .. }, _) => {
            let share_percent = Rounded::down(100.0 * verified_share);
            (share_percent.value() > 0.0).then_some(Strength::PartlyProved { share_percent })
        }
        _ => None,
    }
}

/// Returns the bounds from counted runs: the upper one as certified, the lower one from the same count at the same
/// confidence level. The lower bound is 0 if the count includes collisions of other vehicles.
pub(super) fn rate_strength(rate: &RateClaim, at_most: f64, counts_others: bool) -> Strength {
    let Registration { runs, confidence, .. } = rate.registration;
    let failures = if counts_others { 0 } else { rate.failures };
    let interval = RateInterval::clopper_pearson(failures, runs, 2.0 * confidence - 1.0);
    Strength::Between {
        lower_percent: Rounded::down(100.0 * interval.lower),
        upper_percent: Rounded::up(100.0 * at_most),
        confidence_percent: Rounded::down(100.0 * confidence),
        runs,
    }
}

impl CheckedCertificate {
    /// True if the checker accepted the certificate.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        matches!(self.status, CertificateStatus::Accepted { .. })
    }

    fn evidence(&self) -> Vec<Evidence> {
        let (
            CertificateStatus::Accepted { strength: Some(strength), .. }
            | CertificateStatus::NothingShown { strength, .. },
            CertificateSubject::Claim(claim),
        ) = (&self.status, &self.subject)
        else {
            return Vec::new();
        };
        let own = Evidence { claim: (**claim).clone(), strength: strength.clone(), source: self.source() };
        std::iter::once(own).chain(self.counted_runs_evidence(claim)).collect()
    }

    /// Returns the counted runs as evidence about random scenarios, where a failure refutes the claim.
    fn counted_runs_evidence(&self, claim: &AssuranceClaim) -> Option<Evidence> {
        let (Some(rate), Domain::Space { space }) = (&self.rate, &claim.domain) else { return None };
        let (seed, draws) = (rate.registration.configuration.get("seed")?.parse().ok()?, rate.registration.runs);
        let domain = Domain::Draws { space: space.clone(), seed, draws };
        let claim = AssuranceClaim { subject: claim.subject.clone(), property: Property::NoContact, domain };
        Some(Evidence { claim, strength: Strength::from_counts(rate.failures, draws), source: self.source() })
    }

    pub(super) fn source(&self) -> EvidenceSource {
        let (file, sha256) = (Some(self.file.clone()), Some(self.sha256.clone()));
        EvidenceSource { part: "proofs".to_owned(), what: format!("certificate `{}`", self.name), file, sha256 }
    }
}

/// Describes an accepted claim with short numbers: gaps and shares rounded down, rates up.
fn describe_accepted(accepted: &ProvedClaim) -> String {
    let down = |value: f64| (100.0 * value).floor() / 100.0;
    match accepted {
        ProvedClaim::Rate { max_rate: at_most, confidence } => {
            let (percent, confidence_percent) = (100.0 * at_most + 5e-5, 100.0 * confidence);
            format!("failure rate at most {percent:.4} % (confidence {confidence_percent} %)")
        }
        // Without a verified part, no gap is bounded.
        ProvedClaim::Reach { verified_share, falsified_share, .. } if *verified_share <= 0.0 => {
            let share = down(100.0 * falsified_share);
            let falsified = if share > 0.0 {
                format!("; {share:.2} % of its volume is in cells with an initial state that ends in a collision")
            } else {
                String::new()
            };
            format!("no part of the box is verified, so no gap is bounded{falsified}")
        }
        ProvedClaim::Reach { verified_share, min_gap_m, horizon_s, leader_brakes_at_most_mps2: limit, .. } => format!(
            "{:.2} % of the box: no collision, every gap at least {:.2} m, for {horizon_s} s{}",
            down(100.0 * verified_share),
            down(*min_gap_m),
            limit.map_or_else(String::new, |limit| format!(", for any braking of the leader up to {limit} m/s²"))
        ),
        ProvedClaim::GapBound { gap_m, horizon_s } => format!(
            "for every driver some gap becomes {:.2} m or less within {horizon_s} s",
            (100.0 * gap_m).ceil() / 100.0
        ),
        ProvedClaim::Unavoidable { overlap_m, horizon_s } => {
            format!("for every driver two vehicles overlap by {:.2} m or more within {horizon_s} s", down(*overlap_m))
        }
        ProvedClaim::Kernel => "full braking avoids a collision exactly from the states of the kernel".to_owned(),
        other => other.to_string(),
    }
}

/// Returns the certificates of kernels, of `scenes`, of rates of the learned controllers, of the comparison, and the
/// given ones.
pub(super) fn gather_certificates<'a>(
    work: &GatherContext<'_>,
    scenes: impl Iterator<Item = (&'a str, &'a Certificate)>,
) -> Result<Vec<CheckedCertificate>, AssessError> {
    let plan = work.plan;
    let mut proofs = Vec::new();
    for (name, certificate) in shipped_kernels() {
        proofs.push(check_certificate(plan, name, &certificate, None)?);
    }
    for (scenario, certificate) in scenes {
        proofs.push(check_certificate(plan, format!("scene-{}", file_stem(scenario)), certificate, None)?);
    }
    for counted in planned_rate_counts(plan) {
        proofs.push(counted.gather(work)?);
    }
    let given = plan.certificates.par_iter();
    let given = given.map(|one| check_certificate(plan, one.name.clone(), &one.certificate, one.policy.as_deref()));
    proofs.extend(given.collect::<Result<Vec<_>, _>>()?);
    Ok(proofs)
}

pub(super) fn check_certificate(
    plan: &AssessmentPlan,
    name: String,
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> Result<CheckedCertificate, AssessError> {
    let text = serde_json::to_string_pretty(certificate).map_err(CacheError::encoding)? + "\n";
    let counts_others = includes_others(plan, &certificate.statement);
    Ok(CheckedCertificate {
        statement: certificate.statement.name(),
        about: describe_statement(plan, &name, certificate, policy),
        file: format!("certificates/{name}.json"),
        sha256: sha256(&text),
        subject: certificate_subject(plan, &name, certificate, policy),
        // Checked in every run, never cached: checking is cheap, and cached results could have been edited.
        status: CertificateStatus::check(certificate, policy, counts_others),
        assumptions: certificate.assumptions.clone(),
        rate: match &certificate.statement {
            Statement::Rate(rate) if !counts_others => Some(rate.clone()),
            _ => None,
        },
        kernel: matches!(certificate.statement, Statement::Kernel(_)).then(|| certificate.statement.clone()),
        text,
        name,
    })
}

fn describe_statement(plan: &AssessmentPlan, name: &str, certificate: &Certificate, policy: Option<&[u8]>) -> String {
    match &certificate.statement {
        Statement::Rate(rate) => {
            let of = |key: &str| rate.registration.configuration.get(key).map_or("", String::as_str);
            format!("{} in {} runs of space `{}`", of("controller"), rate.registration.runs, of("space"))
        }
        Statement::Comparison(two) => {
            let of = |key: &str| two.registration.configuration.get(key).map_or("", String::as_str);
            let (first, second) = (of("controller"), of("against"));
            format!("{first} against {second} in {} runs of space `{}`", two.registration.runs, of("space"))
        }
        Statement::Reach(reach) => {
            let ranges = describe_ranges(reach).join(", ");
            format!("{}: {ranges}", initial_states_id(plan, name, (certificate, reach), policy).name)
        }
        Statement::Kernel(_) => "vehicles of these classes, dry road".to_owned(),
        _ => certificate.provenance.scenario.clone(),
    }
}

fn describe_ranges(reach: &ReachClaim) -> Vec<String> {
    let InitialRanges { gap_ahead_m, gap_behind_m, leader_speed_mps, ego_speed_mps, .. } = reach.ranges;
    let InitialRanges { follower_speed_mps, leader_brake_mps2, follower_brake_mps2, onset_steps, .. } = reach.ranges;
    let in_seconds = |steps: f64| steps * reach.step_s;
    let all = [
        ("gap ahead", "m", (gap_ahead_m.low(), gap_ahead_m.high())),
        ("gap behind", "m", (gap_behind_m.low(), gap_behind_m.high())),
        ("leader", "m/s", (leader_speed_mps.low(), leader_speed_mps.high())),
        ("ego", "m/s", (ego_speed_mps.low(), ego_speed_mps.high())),
        ("follower", "m/s", (follower_speed_mps.low(), follower_speed_mps.high())),
        ("leader brakes at", "m/s²", (leader_brake_mps2.low(), leader_brake_mps2.high())),
        ("from", "s", (in_seconds(onset_steps.low()), in_seconds(onset_steps.high()))),
        ("follower brakes at", "m/s²", (follower_brake_mps2.low(), follower_brake_mps2.high())),
    ];
    let led = reach.leader_brakes_at_most_mps2;
    // Braking rate and onset have no meaning if the leader's acceleration is arbitrary.
    let has_meaning =
        |(name, ..): &(&str, &str, (f64, f64))| led.is_none() || !["leader brakes at", "from"].contains(name);
    let words = all.into_iter().filter(has_meaning).map(|(name, unit, (low, high))| match low == high {
        true => format!("{name} {low} {unit}"),
        false => format!("{name} {low} to {high} {unit}"),
    });
    words.chain(led.map(|limit_mps2| format!("any braking of the leader up to {limit_mps2} m/s²"))).collect()
}

fn certificate_subject(
    plan: &AssessmentPlan,
    name: &str,
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> CertificateSubject {
    match &certificate.statement {
        Statement::Rate(rate) => registered_subject(plan, &rate.registration),
        Statement::Comparison(two) => registered_subject(plan, &two.registration),
        // The unshielded policy or network with the true state: a shield would make it another controller.
        Statement::Reach(reach) => {
            let digest = |one: &NamedController| Some(sha256(checker_file(&one.kind).ok()??));
            let is_it = |one: &NamedController| digest(one).as_deref() == Some(reach.policy_sha256.as_str());
            let place = plan.controllers.iter().position(is_it);
            match place.and_then(|place| plan.claim_subject(place, EstimatorKind::Truth)) {
                Some(subject) => CertificateSubject::Claim(Box::new(AssuranceClaim {
                    subject,
                    property: Property::NoContact,
                    domain: Domain::Box { around: initial_states_id(plan, name, (certificate, reach), policy) },
                })),
                None => CertificateSubject::Unrelated { reason: "its policy is not among the controllers".to_owned() },
            }
        }
        Statement::Kernel(_) => CertificateSubject::Kernel,
        _ => CertificateSubject::NoController,
    }
}

/// Returns the identifier of the box: the statement without policy and result. The certificate's own label is not
/// trusted: the name is a scenario of the report whose initial state lies in the box, or else the certificate's name.
fn initial_states_id(
    plan: &AssessmentPlan,
    certificate_name: &str,
    (certificate, reach): (&Certificate, &ReachClaim),
    policy: Option<&[u8]>,
) -> ContentId {
    let mut content = format!(
        "{:?} {:?} {:?} {:?} {:?}",
        reach.step_s, reach.steps, reach.follower_ttc_s, reach.observation_error, reach.ranges
    );
    if let Some(limit_mps2) = reach.leader_brakes_at_most_mps2 {
        content += &format!(" leader within {limit_mps2:?}");
    }
    if let Some(law) = &reach.follower_law {
        content += &format!(" follower {law:?}");
    }
    let horizon_s = reach.step_s * f64::from(reach.steps);
    let is_inside = |scenario: &Scenario| check_covers_scenario(certificate, scenario, policy).is_ok();
    let built_in = built_in_scenario_names().iter().filter_map(|(name, _)| built_in_scenario(name)).find(is_inside);
    let inside = built_in
        .or_else(|| plan.file_scenarios.iter().map(|(_, scenario)| scenario).find(|one| is_inside(one)).cloned());
    let around = match inside {
        Some(scenario) => format!("around `{}`", scenario.spec().name),
        None => format!("of certificate `{certificate_name}`"),
    };
    let any_braking = if reach.leader_brakes_at_most_mps2.is_some() { ", for any braking of the leader," } else { "" };
    ContentId {
        name: format!("the box of initial states {around}{any_braking} for {horizon_s} s"),
        sha256: sha256(&content),
    }
}

fn find_space<'a>(plan: &'a AssessmentPlan, registration: &Registration) -> Option<&'a NamedSpace> {
    let sha256 = registration.configuration.get("space_sha256")?;
    plan.rate_spaces.iter().find(|named| named.content_id.sha256 == *sha256)
}

/// True if other vehicles may collide in the runs of a rate. The rate counts them, but they are no evidence here.
pub(super) fn includes_others(plan: &AssessmentPlan, statement: &Statement) -> bool {
    match statement {
        Statement::Rate(rate) => find_space(plan, &rate.registration).is_some_and(NamedSpace::can_others_collide),
        _ => false,
    }
}

/// Returns the claim of a registration with the hashes of this report's controllers and space, and the same release.
fn registered_subject(plan: &AssessmentPlan, registration: &Registration) -> CertificateSubject {
    let foreign = |reason: String| CertificateSubject::Unrelated { reason };
    let of = |key: &str| registration.configuration.get(key).map_or("", String::as_str);
    if of("crumple") != env!("CARGO_PKG_VERSION") {
        return foreign(format!("crumple {} counted its runs", of("crumple")));
    }
    let Some(named) = find_space(plan, registration) else {
        return foreign(format!("its space `{}` is not among `distributions`", of("space")));
    };
    let Some(&estimator) = EstimatorKind::ALL.iter().find(|one| one.name() == of("estimator")) else {
        return foreign("it names no known estimator".to_owned());
    };
    let find = |place: &str| {
        let identity = of(&format!("{place}_sha256"));
        let is_it = |one: &NamedController| one.kind.identity().as_deref() == Some(identity);
        // Both must define a failure alike.
        let place = plan.controllers.iter().position(is_it)?;
        let counts = plan.controllers.get(place).is_some_and(|one| {
            [one.failure_description(), "vehicles touch, or a controller fails"].contains(&of("failure"))
        });
        plan.claim_subject(place, estimator).filter(|_| counts)
    };
    let Some(subject) = find("controller") else {
        return foreign(format!("its `{}` is not among the controllers", of("controller")));
    };
    let domain = Domain::Space { space: named.content_id.clone() };
    let property = match registration.configuration.get("against") {
        None => Property::FailureRate,
        Some(_) if named.can_others_collide() => {
            return foreign("it counts collisions of vehicles that are not under test".to_owned());
        }
        Some(other) => match find("against") {
            Some(than) => Property::FailsLessOften { than: than.controller },
            None => return foreign(format!("its `{other}` is not among the controllers")),
        },
    };
    CertificateSubject::Claim(Box::new(AssuranceClaim { subject, property, domain }))
}

/// Returns the evidence of accepted certificates, about controllers and about shields whose kernels they prove.
pub(super) fn evidence(plan: &AssessmentPlan, proofs: &[CheckedCertificate]) -> Vec<Evidence> {
    let mut all: Vec<_> = proofs.iter().flat_map(CheckedCertificate::evidence).collect();
    for (place, controller) in plan.controllers.iter().enumerate() {
        let kernels = shield_kernels(controller);
        let proved = |kernel: &ViabilityKernel| {
            let expected = kernel_certificate(kernel, PAPER_STEP_S, MIN_MARGIN_M)?.statement;
            let is_it = |proof: &&CheckedCertificate| proof.is_accepted() && proof.kernel.as_ref() == Some(&expected);
            proofs.iter().find(is_it)
        };
        let certificates: Option<Vec<&CheckedCertificate>> = kernels.iter().map(proved).collect();
        if let (Some(certificates), Some(subject)) = (certificates, plan.claim_subject(place, plan.config.estimator))
            && let Some(first) = certificates.first()
        {
            let claim = AssuranceClaim { subject, property: Property::NoContactAhead, domain: kernel_domain(&kernels) };
            let mut source = first.source();
            source.what = format!("{} certificates of safety kernels", certificates.len());
            all.push(Evidence { claim, strength: Strength::Proved { certificates: certificates.len() }, source });
        }
    }
    all
}

/// Returns the kernels of a controller's shield, for all pairs of vehicle classes. Empty without a shield, or if a user
/// set its error bounds, which this report cannot verify.
pub(super) fn shield_kernels(controller: &NamedController) -> Vec<ViabilityKernel> {
    let ControllerKind::Shielded(shielded) = &controller.kind else { return Vec::new() };
    let ShieldSettings { ahead_brake_mps2, errors } = shielded.settings;
    if errors.is_some() {
        return Vec::new();
    }
    let limits = VehicleClass::ALL.iter().map(|class| class.max_brake_mps2());
    let ahead: Vec<f64> = ahead_brake_mps2.map_or_else(|| limits.clone().collect(), |limit| vec![limit]);
    let of = |own_brake_mps2| {
        ahead.iter().map(move |&ahead_brake_mps2| ViabilityKernel { own_brake_mps2, ahead_brake_mps2 })
    };
    limits.flat_map(of).collect()
}

pub(super) fn kernel_domain(kernels: &[ViabilityKernel]) -> Domain {
    let limits = |kernel: &ViabilityKernel| [kernel.own_brake_mps2, kernel.ahead_brake_mps2].map(Rounded::new);
    Domain::Kernels { limits_mps2: kernels.iter().map(limits).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_nothing_is_verified_nothing_is_bounded() {
        let reach = |verified_share, falsified_share, smallest_gap_m| {
            describe_accepted(&ProvedClaim::Reach {
                verified_share,
                falsified_share,
                min_gap_m: smallest_gap_m,
                horizon_s: 15.0,
                has_follower: true,
                leader_brakes_at_most_mps2: None,
            })
        };
        let nothing = "no part of the box is verified, so no gap is bounded";
        assert_eq!(reach(0.0, 0.0, f64::INFINITY), nothing);
        let falsified = "; 1.56 % of its volume is in cells with an initial state that ends in a collision";
        assert_eq!(reach(0.0, 0.015_625, f64::INFINITY), format!("{nothing}{falsified}"));
        assert!(reach(0.5, 0.0, 1.999).contains("50.00 %") && reach(0.5, 0.0, 1.999).contains("1.99 m"));
    }
}
