//! Drivers of the followers in the domains of claims about collisions.

use crate::assessment::AssessmentPlan;
use crate::assessment::claims::{AssuranceClaim, ContentId, Domain, Property};
use crate::assessment::followers::{describe_followers, follower_drivers};
use crumple_sim::scenario::{Scenario, built_in_scenario, built_in_scenario_names};

/// Returns the drivers of the followers in the domain of a claim about collisions or failures. `None` for other claims,
/// and for domains other than spaces, listed scenarios and recorded drives.
pub(super) fn followers_of_claim(
    plan: &AssessmentPlan,
    claim: &AssuranceClaim,
) -> Option<Vec<String>> {
    let is_about_collisions = matches!(
        claim.property,
        Property::NoCollision | Property::RateAtMost { .. } | Property::FailsLessOften { .. }
    );
    if !is_about_collisions {
        return None;
    }
    match &claim.domain {
        Domain::Draws { space, .. } | Domain::Space { space } | Domain::Search { space, .. } => {
            plan.followers_in(space)
        }
        Domain::Scenarios { all, .. } => Some(followers_in_listed(plan, all)),
        Domain::RecordedDrives { .. } => {
            let drives = plan.drives.as_ref()?.drives.drives();
            let scenarios = drives.iter().map(|drive| &drive.scenario);
            Some(follower_drivers(scenarios).into_iter().collect())
        }
        _ => None,
    }
}

/// Returns the drivers of the followers in these scenarios, which are the paper's or files of the assessment.
fn followers_in_listed(plan: &AssessmentPlan, listed: &[ContentId]) -> Vec<String> {
    let built_in = built_in_scenario_names()
        .into_iter()
        .filter_map(|(name, _)| built_in_scenario(name));
    let files = plan.file_scenarios.iter().map(|(_, scenario)| scenario);
    let scenarios: Vec<Scenario> = built_in
        .chain(files.cloned())
        .filter(|scenario| {
            let name = scenario.spec().name.as_str();
            listed.contains(&ContentId::from_scenario(name, scenario))
        })
        .collect();
    follower_drivers(&scenarios).into_iter().collect()
}

/// Names the followers in the domains of claims about collisions: "In `paper` and `high-risk`, `baseline` drives the
/// follower." Empty without such claims.
pub(super) fn describe_followers_of_claims<'c>(
    plan: &AssessmentPlan,
    claims: impl Iterator<Item = &'c AssuranceClaim>,
) -> String {
    let mut domains_by_followers: Vec<(Vec<String>, Vec<String>)> = Vec::new();
    for claim in claims {
        let Some(followers) = followers_of_claim(plan, claim) else {
            continue;
        };
        let domain = domain_name(&claim.domain);
        match domains_by_followers
            .iter_mut()
            .find(|(drivers, _)| *drivers == followers)
        {
            Some((_, domains)) if domains.contains(&domain) => {}
            Some((_, domains)) => domains.push(domain),
            None => domains_by_followers.push((followers, vec![domain])),
        }
    }
    let described: Vec<String> = domains_by_followers
        .iter()
        .map(|(drivers, domains)| {
            let domains = enumerate_words(domains);
            format!("in {domains}, {}", describe_followers(drivers))
        })
        .collect();
    if described.is_empty() {
        return String::new();
    }
    format!("Followers: {}.", described.join("; "))
}

/// Joins words as in "a, b and c".
fn enumerate_words(words: &[String]) -> String {
    match words.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} and {last}", others.join(", ")),
        None => String::new(),
    }
}

fn domain_name(domain: &Domain) -> String {
    match domain {
        Domain::Draws { space, .. } | Domain::Space { space } | Domain::Search { space, .. } => {
            format!("`{}`", space.name)
        }
        Domain::Scenarios { about, .. } => about.0.clone(),
        Domain::RecordedDrives { drives, .. } => format!("the recorded drives `{}`", drives.name),
        other => other.describe(),
    }
}
