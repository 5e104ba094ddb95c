//! Response of a vehicle to commands within its limits.

use super::VehicleSpec;

/// Response of a vehicle to commands within its limits: what safety kernels, proofs and quadratic programs must know.
///
/// The plant `multi-body` and noise are not part of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VehicleResponse {
    /// Time from an observation to the begin of a response, in seconds: reaction and dead time.
    pub delay_s: f64,
    /// Time constant of a first-order lag, in seconds; 0 for none.
    pub lag_s: f64,
    /// True if it responds in a further way, which only the simulator models: a limited jerk.
    pub is_only_simulated: bool,
}

impl VehicleResponse {
    /// Returns true if the acceleration equals the command from the begin of a response on.
    #[must_use]
    pub fn is_full_at_once(self) -> bool {
        self.lag_s == 0.0 && !self.is_only_simulated
    }

    /// Returns true if the acceleration always equals the command.
    #[must_use]
    pub fn is_immediate(self) -> bool {
        self.delay_s == 0.0 && self.is_full_at_once()
    }
}

impl VehicleSpec {
    /// Returns the response to commands.
    #[must_use]
    pub fn response(&self) -> VehicleResponse {
        VehicleResponse {
            delay_s: self.reaction_delay_s + self.actuator_delay_s,
            lag_s: self.actuator_lag_s,
            is_only_simulated: self.jerk_limit_mps3.is_some(),
        }
    }

    /// Returns the fields of the response, and whether they are given: a script has none of them.
    pub(super) fn given_response_fields(&self) -> [(&'static str, bool); 4] {
        [
            ("reaction_delay_s", self.reaction_delay_s > 0.0),
            ("actuator_lag_s", self.actuator_lag_s > 0.0),
            ("actuator_delay_s", self.actuator_delay_s > 0.0),
            ("jerk_limit_mps3", self.jerk_limit_mps3.is_some()),
        ]
    }
}
