//! Results of an assessment in a form that another assessment can be compared with.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::order::compare_strengths;
use super::runs::{RandomRuns, compare_other_runs, family};
use crate::assessment::CertificateStatus;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, InferenceRule, Property, Strength,
};
use crumple_core::digest::sha256;
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_sim::observation::EstimatorKind;

/// The results by name and domain hash. The hash separates results of spaces and scenarios that have the same name.
pub(super) type Facts = BTreeMap<FactKey, Fact>;

/// Name of a result, and hash of its domain.
pub(super) type FactKey = (String, String);

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
    /// Text that is equal for results which differ in their random runs only.
    pub(super) family: Option<String>,
    /// Random runs behind the result.
    pub(super) runs: Option<RandomRuns>,
}

impl Fact {
    fn new(measure: Measure, description: String) -> Self {
        Self {
            measure,
            description,
            is_failure: false,
            collides: None,
            is_restated: false,
            family: None,
            runs: None,
        }
    }

    /// Compares with an earlier result: greater is better. `None` if neither result is better, because the quantities
    /// are unlike, only the avoidability of failures changed, or the difference may be that of the runs.
    pub(super) fn compare(&self, before: &Self) -> Option<Ordering> {
        let other_runs = self.runs.as_ref().zip(before.runs.as_ref());
        let other_runs = other_runs.filter(|(now, before)| now.difference(before).is_some());
        match (&before.measure, &self.measure, other_runs) {
            (Measure::Claim(before, _), Measure::Claim(now, _), Some((now_runs, before_runs))) => {
                compare_other_runs((before, before_runs), (now, now_runs))
            }
            (before, now, _) => now.compare(before),
        }
    }
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
    /// True if the checker accepted a certificate of counted runs, and the description of these runs.
    AcceptedCount(bool, String),
    /// A kind of failure that a search found. The claim about the search compares their numbers.
    Found,
}

impl Measure {
    /// Compares with an earlier result of the same runs.
    fn compare(&self, before: &Self) -> Option<Ordering> {
        match (before, self) {
            (Self::Claim(before, before_domain), Self::Claim(now, now_domain)) => {
                let is_known = before_domain.is_some() && now_domain.is_some();
                compare_strengths(before, now, is_known && before_domain != now_domain)
            }
            (Self::GapM(before), Self::GapM(now)) => Some(now.total_cmp(before)),
            (Self::Accepted(before), Self::Accepted(now)) => Some(now.cmp(before)),
            (Self::AcceptedCount(before, earlier_runs), Self::AcceptedCount(now, runs)) => {
                (before == now || earlier_runs == runs).then(|| now.cmp(before))
            }
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
    add_failures(evidence, &claims, &RandomRuns::all(evidence), &mut facts)?;
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
        let is_accepted = matches!(status, CertificateStatus::Accepted { .. });
        let is_count = matches!(statement.as_str(), "rate" | "comparison");
        let key = format!("certificate {name}: {statement}, {about}");
        let measure = match is_count {
            true => Measure::AcceptedCount(is_accepted, about),
            false => Measure::Accepted(is_accepted),
        };
        let fact = Fact {
            // More runs are another certificate of the same name.
            family: is_count.then(|| format!("certificate {name}: {statement}")),
            ..Fact::new(measure, status.describe())
        };
        facts.insert((key, String::new()), fact);
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
        let part: String = read(row, "part")?;
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
                let fact = Fact {
                    is_restated: is_restated(evidence, &all_claims, status),
                    family: claim
                        .as_ref()
                        .and_then(|claim| family(claim, &part))
                        .map(|family| format!("{controller} {family}")),
                    ..claim_fact(evidence, claim.as_ref(), strength, status)
                };
                facts.insert((format!("{controller}: {claim_text}"), domain), fact);
            }
        }
    }
    Ok(all_claims)
}

/// Returns the status of a claim as a result.
fn claim_fact(
    evidence: &Value,
    claim: Option<&AssuranceClaim>,
    strength: Strength,
    status: &Value,
) -> Fact {
    let description = strength.describe();
    Fact {
        is_failure: strength.is_refutation(),
        collides: claim.and_then(|claim| claim_collides(claim, &strength)),
        runs: deciding_evidence(evidence, status).and_then(RandomRuns::from_evidence),
        ..Fact::new(
            Measure::Claim(strength, deciding_domain(evidence, status)),
            description,
        )
    }
}

/// Returns the first piece of evidence behind a status.
fn deciding_evidence<'a>(evidence: &'a Value, status: &Value) -> Option<&'a Value> {
    let index = status.pointer("/evidence/0")?.as_u64()?;
    evidence.pointer(&format!("/evidence/{index}"))
}

/// Returns the hash of the domain of the first piece of evidence behind a status.
fn deciding_domain(evidence: &Value, status: &Value) -> Option<String> {
    let domain = deciding_evidence(evidence, status)?.pointer("/claim/domain")?;
    Some(hash(&Domain::deserialize(domain).ok()?))
}

/// True if the status of a claim follows from evidence about a part of its domain, and the report also makes the claim
/// about that part.
fn is_restated(evidence: &Value, claims: &[AssuranceClaim], status: &Value) -> bool {
    let rule = status
        .get("rule")
        .and_then(|rule| InferenceRule::deserialize(rule).ok());
    let claim_of_part = deciding_evidence(evidence, status)
        .and_then(|piece| piece.get("claim"))
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
                        collides: Some(collides),
                        ..Fact::new(Measure::GapM(gap_m), description)
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
    all_runs: &[RandomRuns],
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
            let mut runs = all_runs.iter();
            let runs = runs.find(|runs| runs.is_search_of(&controller, &content));
            let kinds = count_kinds(read(&search, "failures")?)?;
            for (kind, [count, avoidable]) in kinds {
                let what = format!("{controller}: failure in `{name}`: {kind}");
                let key = (what, domain.clone());
                let description = format!("{count} found, {avoidable} avoidable");
                facts.insert(
                    key,
                    Fact {
                        is_failure: true,
                        family: Some(format!("{controller} failure in {content}: {kind}")),
                        runs: runs.cloned(),
                        ..Fact::new(Measure::Found, description)
                    },
                );
            }
        }
    }
    Ok(())
}

/// Counts the failures of each kind, all and avoidable ones.
fn count_kinds(failures: Vec<Value>) -> Result<BTreeMap<String, [usize; 2]>, String> {
    let mut kinds: BTreeMap<String, [usize; 2]> = BTreeMap::new();
    for failure in failures {
        let is_avoidable =
            read::<AvoidabilityClass>(&failure, "class")? == AvoidabilityClass::Avoidable;
        let [count, avoidable] = kinds.entry(read(&failure, "kind")?).or_default();
        *count += 1;
        *avoidable += usize::from(is_avoidable);
    }
    Ok(kinds)
}
