//! Whose contact it is: the one decision of what a contact says of the controller under test.

use crate::scenario::Scenario;
use crate::sim::Contact;

/// The part that the vehicles under test have in a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ContactRole {
    /// A vehicle under test hits the one ahead.
    Hits,
    /// A vehicle under test is hit from behind, by a vehicle that is not under test.
    IsHit,
    /// Neither of the two is under test: the contact says nothing of the controller.
    Bystander,
}

impl ContactRole {
    /// The part of the vehicles under test in a contact of a scenario.
    #[must_use]
    pub fn new(contact: &Contact, scenario: &Scenario) -> Self {
        let under_test = |index| scenario.is_under_test(index);
        match (under_test(contact.rear_vehicle), under_test(contact.front_vehicle)) {
            (true, _) => Self::Hits,
            (false, true) => Self::IsHit,
            (false, false) => Self::Bystander,
        }
    }
}
