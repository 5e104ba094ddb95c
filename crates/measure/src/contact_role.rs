//! Roles of the vehicles under test in a contact.

use crumple_sim::engine::Contact;
use crumple_sim::scenario::Scenario;

/// Role of the vehicles under test in a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ContactRole {
    /// A vehicle under test hits its leader.
    Hits,
    /// A vehicle under test is hit from behind by a vehicle that is not under test.
    HitFromBehind,
    /// Neither vehicle is under test.
    Bystander,
}

impl ContactRole {
    /// Determines the role of the vehicles under test in a contact of a scenario.
    #[must_use]
    pub fn new(contact: &Contact, scenario: &Scenario) -> Self {
        if scenario.is_under_test(contact.rear_vehicle) {
            Self::Hits
        } else if scenario.is_under_test(contact.front_vehicle) {
            Self::HitFromBehind
        } else {
            Self::Bystander
        }
    }
}
