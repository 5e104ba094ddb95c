//! Results of an assessment in a form that another assessment can be compared with.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::order::compare_strengths;
use crate::assessment::CertificateStatus;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, InferenceRule, Property, Strength,
};
use crumple_core::digest::sha256;
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_sim::observation::EstimatorKind;

/// The results by name and domain hash. The hash separates results of spaces and scenarios that have the same name.
pub(super) type Facts = BTreeMap<(String, String), Fact>;

/// A result with its description.
#[derive(Debug, Clone)]
pub(super) struct Fact {
    pub(super) measure: Measure,
    pub(super) description: String,
    /// True for a counterexample or a refuted claim: its presence is a failure.
    pub(super) is_failure: bool,
    /// True if the controller collides, for results about collisions.
    pub(super) collides: Option<bool>,
    /// True for a claim about a whole domain that only a refuted claim about a part refutes, which is a result of its
    /// own: the same runs, listed once.
    pub(super) is_restated: bool,
}

/// The comparable content of a result.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Measure {
    /// Strength of a claim, and the hash of the domain of the evidence behind it, if that is known.
    Claim(Strength, Option<String>),
    /// Smallest gap, in metres.
    GapM(f64),
    /// True if the checker accepted a certificate.
    Accepted(bool),
    /// A kind of failure that a search found. The claim about the search compares their numbers.
    Found,
}

impl Measure {
    /// Compares with an earlier result: greater is better. `None` if neither result is better, because the quantities
    /// are unlike or only the avoidability of failures changed.
    pub(super) fn compare(&self, before: &Self) -> Option<Ordering> {
        match (before, self) {
            (Self::Claim(before, before_domain), Self::Claim(now, now_domain)) => {
                let is_known = before_domain.is_some() && now_domain.is_some();
                compare_strengths(before, now, is_known && before_domain != now_domain)
            }
            (Self::GapM(before), Self::GapM(now)) => Some(now.total_cmp(before)),
            (Self::Accepted(before), Self::Accepted(now)) => Some(now.cmp(before)),
            (Self::Found, Self::Found) => Some(Ordering::Equal),
            _ => None,
        }
    }
}

/// Reads a field, whose path has slashes. The error names the field.
pub(super) fn read<T: DeserializeOwned>(value: &Value, field: &str) -> Result<T, String> {
    let content = value.pointer(&format!("/{field}")).unwrap_or(&Value::Null);
    T::deserialize(content).map_err(|error| format!("{field}: {error}"))
}

/// Reads the results of an `assessment.json`.
///
/// # Errors
/// A field that is missing or has another form.
pub(super) fn read_facts(evidence: &Value) -> Result<Facts, String> {
    let mut facts = Facts::new();
    let claims = add_claims(evidence, &mut facts)?;
    add_gaps(evidence, &claims, &mut facts)?;
    add_failures(evidence, &claims, &mut facts)?;
    add_certificates(evidence, &mut facts)?;
    Ok(facts)
}

fn add_certificates(evidence: &Value, facts: &mut Facts) -> Result<(), String> {
    for proof in read::<Vec<Value>>(evidence, "proofs/certificates")? {
        let status: CertificateStatus = read(&proof, "status")?;
        // A changed certificate of the same name is another result.
        let name: String = read(&proof, "name")?;
        let statement: String = read(&proof, "statement")?;
        let about: String = read(&proof, "about")?;
        facts.insert(
            (
                format!("certificate {name}: {statement}, {about}"),
                String::new(),
            ),
            Fact {
                measure: Measure::Accepted(matches!(status, CertificateStatus::Accepted { .. })),
                description: status.describe(),
                is_failure: false,
                collides: None,
                is_restated: false,
            },
        );
    }
    Ok(())
}

fn hash(domain: &Domain) -> String {
    sha256(format!("{domain:?}"))
}

/// Returns the hash of the domain of a claim and of its estimator: results with another estimator are not compared.
fn claim_hash(claim: &AssuranceClaim) -> String {
    match claim.subject.estimator {
        EstimatorKind::Kalman => hash(&claim.domain),
        estimator => sha256(format!("{} {:?}", estimator.name(), claim.domain)),
    }
}

/// True if a claim about collisions is refuted; `None` for other claims.
fn claim_collides(claim: &AssuranceClaim, strength: &Strength) -> Option<bool> {
    let is_about_collisions = matches!(
        claim.property,
        Property::NoCollision | Property::NoCollisionAhead
    );
    is_about_collisions.then(|| strength.is_refutation())
}

/// Returns the claims of all rows.
fn read_claims(rows: &[Value]) -> Result<Vec<AssuranceClaim>, String> {
    let mut all = Vec::new();
    for row in rows {
        let claims: Vec<Option<AssuranceClaim>> = read(row, "claims")?;
        all.extend(claims.into_iter().flatten());
    }
    Ok(all)
}

/// Adds the status of each claim about each controller. Returns the claims.
fn add_claims(evidence: &Value, facts: &mut Facts) -> Result<Vec<AssuranceClaim>, String> {
    let controllers: Vec<String> = read(evidence, "summary/controllers")?;
    let rows = read::<Vec<Value>>(evidence, "summary/claims")?;
    let all_claims = read_claims(&rows)?;
    for row in &rows {
        let claim_text: String = read(row, "claim")?;
        let claims: Vec<Option<AssuranceClaim>> = read(row, "claims")?;
        let statuses: Vec<Value> = read(row, "statuses")?;
        let strengths: Vec<Strength> = read(row, "statuses")?;
        if [claims.len(), strengths.len()] != [controllers.len(); 2] {
            return Err(format!(
                "summary/claims: `{claim_text}` needs one entry per controller"
            ));
        }
        for (((controller, claim), strength), status) in
            controllers.iter().zip(claims).zip(strengths).zip(&statuses)
        {
            // A claim that nothing decides is absent: neither better nor worse.
            if !matches!(strength, Strength::Untried | Strength::NotShown) {
                let domain = claim.as_ref().map_or_else(String::new, claim_hash);
                let collides = claim
                    .as_ref()
                    .and_then(|claim| claim_collides(claim, &strength));
                facts.insert(
                    (format!("{controller}: {claim_text}"), domain),
                    Fact {
                        description: strength.describe(),
                        is_failure: strength.is_refutation(),
                        collides,
                        is_restated: is_restated(evidence, &all_claims, status),
                        measure: Measure::Claim(strength, deciding_domain(evidence, status)),
                    },
                );
            }
        }
    }
    Ok(all_claims)
}

/// Returns the hash of the domain of the first piece of evidence behind a status, and of the number of its runs if they
/// bound a rate: more runs give narrower bounds of the same rate.
fn deciding_domain(evidence: &Value, status: &Value) -> Option<String> {
    let index = status.pointer("/evidence/0")?.as_u64()?;
    let domain = evidence.pointer(&format!("/evidence/{index}/claim/domain"))?;
    let mut domain = hash(&Domain::deserialize(domain).ok()?);
    let strength: Strength = read(evidence, &format!("evidence/{index}")).ok()?;
    if let Strength::Between { runs, .. } = strength {
        domain += &format!(" {runs} runs");
    }
    Some(domain)
}

/// True if the status of a claim follows from evidence about a part of its domain, and the report also makes the claim
/// about that part.
fn is_restated(evidence: &Value, claims: &[AssuranceClaim], status: &Value) -> bool {
    let rule = status
        .get("rule")
        .and_then(|rule| InferenceRule::deserialize(rule).ok());
    let claim_of_part = status
        .pointer("/evidence/0")
        .and_then(Value::as_u64)
        .and_then(|index| evidence.pointer(&format!("/evidence/{index}/claim")))
        .and_then(|part| AssuranceClaim::deserialize(part).ok());
    rule == Some(InferenceRule::RefutedInPart)
        && claim_of_part.is_some_and(|part| claims.contains(&part))
}

fn listed_scenarios(domain: &Domain) -> &[ContentId] {
    match domain {
        Domain::Scenarios { all, .. } => all,
        _ => &[],
    }
}

/// Returns the content of each scenario by its name: its hash, and the estimator, if it is not the usual one.
fn scenario_contents(claims: &[AssuranceClaim]) -> BTreeMap<&str, String> {
    let mut content_by_name: BTreeMap<&str, String> = BTreeMap::new();
    for claim in claims {
        for scenario in listed_scenarios(&claim.domain) {
            let content = match claim.subject.estimator {
                EstimatorKind::Kalman => scenario.sha256.clone(),
                estimator => format!("{} {}", scenario.sha256, estimator.name()),
            };
            content_by_name.insert(&scenario.name, content);
        }
    }
    content_by_name
}

/// Adds the smallest gap of each case.
fn add_gaps(evidence: &Value, claims: &[AssuranceClaim], facts: &mut Facts) -> Result<(), String> {
    let content_by_name = scenario_contents(claims);
    for part in ["paper_scenarios/scenarios", "file_scenarios/scenarios"] {
        for scenario in read::<Option<Vec<Value>>>(evidence, part)?.unwrap_or_default() {
            let name: String = read(&scenario, "scenario")?;
            let content = content_by_name
                .get(name.as_str())
                .cloned()
                .unwrap_or_default();
            for case in read::<Vec<Value>>(&scenario, "cases")? {
                let controller: String = read(&case, "controller")?;
                let Some(gap_m) = read::<Option<f64>>(&case, "min_gap_m")? else {
                    continue;
                };
                let key = (
                    format!("{controller}: smallest gap in {name}"),
                    content.clone(),
                );
                let collides = collides(&case)?;
                let description = if collides {
                    "collision".to_owned()
                } else {
                    format!("{gap_m:.2} m")
                };
                facts.insert(
                    key,
                    Fact {
                        measure: Measure::GapM(gap_m),
                        description,
                        is_failure: false,
                        collides: Some(collides),
                        is_restated: false,
                    },
                );
            }
        }
    }
    Ok(())
}

/// True if the controller collides in a case.
fn collides(case: &Value) -> Result<bool, String> {
    let kind: String = read(case, "verdict/kind")?;
    Ok(matches!(kind.as_str(), "hit" | "was_hit"))
}

/// Adds each kind of failure that a search found.
fn add_failures(
    evidence: &Value,
    claims: &[AssuranceClaim],
    facts: &mut Facts,
) -> Result<(), String> {
    for space in read::<Vec<Value>>(evidence, "searches/spaces")? {
        let name: String = read(&space, "content_id/name")?;
        let content: String = read(&space, "content_id/sha256")?;
        // A search with another budget or seed is another result.
        let domain = claims
            .iter()
            .find(|claim| {
                matches!(&claim.domain, Domain::Search { space, .. } if space.sha256 == content)
            })
            .map_or_else(|| content.clone(), claim_hash);
        for search in read::<Vec<Value>>(&space, "controllers")? {
            let controller: String = read(&search, "controller")?;
            let mut kinds: BTreeMap<String, [usize; 2]> = BTreeMap::new();
            for failure in read::<Vec<Value>>(&search, "failures")? {
                let is_avoidable =
                    read::<AvoidabilityClass>(&failure, "class")? == AvoidabilityClass::Avoidable;
                let [count, avoidable] = kinds.entry(read(&failure, "kind")?).or_default();
                *count += 1;
                *avoidable += usize::from(is_avoidable);
            }
            for (kind, [count, avoidable]) in kinds {
                let key = (
                    format!("{controller}: failure in `{name}`: {kind}"),
                    domain.clone(),
                );
                let description = format!("{count} found, {avoidable} avoidable");
                facts.insert(
                    key,
                    Fact {
                        measure: Measure::Found,
                        description,
                        is_failure: true,
                        collides: None,
                        is_restated: false,
                    },
                );
            }
        }
    }
    Ok(())
}
