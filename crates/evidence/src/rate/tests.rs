use super::*;
use crate::fixtures::rate_plan;

fn plan(controller: &str, against: Option<&str>, runs: u64) -> RatePlan {
    rate_plan(controller, against, ("paper", runs), (3, 0.99))
}

#[test]
fn a_registration_contains_everything_that_determines_the_count() {
    let digests: std::collections::HashSet<_> = [
        plan("match-leader", None, 10),
        plan("policy", None, 10),
        plan("idm", Some("policy"), 10),
        plan("idm", None, 11),
    ]
    .map(|plan| plan.registration().digest())
    .into();
    assert_eq!(digests.len(), 4);
    assert!(
        plan("policy", None, 10)
            .registration()
            .configuration
            .contains_key("controller_policy_sha256")
    );
}
