//! Forged failure rates.

use crumple_sim::control::BuiltInController;
use crumple_verify::{Certificate, RateClaim, Statement};

use super::change_statement;

/// Returns the claim of a statement about a failure rate.
pub(crate) fn rate_claim(statement: &mut Statement) -> &mut RateClaim {
    let Statement::Rate(claim) = statement else {
        panic!("a rate")
    };
    claim
}

/// Claims a counted failure rate for the baseline, with further changes and a repaired digest.
pub(crate) fn claim_rate_for_baseline(
    genuine: &Certificate,
    change: impl FnOnce(&mut RateClaim),
) -> Certificate {
    change_statement(genuine, |statement| {
        let rate = rate_claim(statement);
        name_baseline(rate);
        change(rate);
        rate.registration_sha256 = rate.registration.digest();
    })
}

fn name_baseline(rate: &mut RateClaim) {
    let identity = BuiltInController::from_name("baseline").unwrap().sha256();
    let configuration = &mut rate.registration.configuration;
    configuration.insert("controller".to_owned(), "baseline".to_owned());
    configuration.insert("controller_sha256".to_owned(), identity);
}
