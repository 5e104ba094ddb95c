//! Limits and region of an invariant set.

use std::path::Path;

use crumple_core::digest::sha256;
use crumple_core::text_file::{self, FileError};
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::{Driver, Scenario, VehicleSpec};
use crumple_verify::InvariantClaim;
use crumple_verify::invariant::table::TableAxis;
use crumple_verify::invariant::{InvariantController, MotionModel, NetworkReference};
use crumple_verify::reach::{NeuralController, controller_file_name};
use serde::{Deserialize, Serialize};

use crate::initial_set::control_law;
use crate::reach::InvalidBox;

/// Limits and region of an invariant set, as `crumple verify invariant` writes them to a certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InvariantSpec {
    /// Version of the format: 1.
    pub version: u32,
    /// Scenario, of which the second vehicle is under test.
    pub scenario: String,
    /// Model of motion.
    pub motion: MotionModel,
    /// Hardest braking, negative, and largest acceleration of the leader, in m/s².
    pub leader_mps2: [f64; 2],
    /// Largest errors of the observed gap in metres, and of own and leader's speed in m/s.
    pub observation_error: [f64; 3],
    /// Largest gap of the region, in metres.
    pub region_gap_m: f64,
    /// Gap beyond which the claim ends, in metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ends_beyond_gap_m: Option<f64>,
    /// Own speeds of the region, in m/s; closing speeds in the relative model.
    pub region_own_mps: [f64; 2],
    /// Leader's speeds of the region, in m/s.
    pub region_leader_mps: [f64; 2],
    /// Control law with its settings; absent for a policy or network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller: Option<Driver>,
}

impl InvariantSpec {
    /// Parses the text of a certificate; `path` only names it in errors.
    ///
    /// # Errors
    /// [`FileError`] if the text has another form.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, FileError> {
        text_file::parse_first_version(text, path, |spec: &Self| spec.version)
    }

    /// Returns the claim without its set, for a law of the spec or the bytes of a policy file.
    ///
    /// # Errors
    /// [`InvalidBox`] if the checker does not support the scenario or the controller.
    pub(crate) fn frame(
        &self,
        scenario: &Scenario,
        policy: Option<&[u8]>,
    ) -> Result<InvariantClaim, InvalidBox> {
        let ego = vehicle_under_test(scenario)?;
        let step_s = scenario.spec().step_s;
        let ClaimedController {
            controller,
            decision_steps,
        } = match (&self.controller, policy) {
            (Some(Driver::Controller(law)), None) => {
                ClaimedController::from_law(law, ego.max_accel_mps2())?
            }
            (None, Some(bytes)) => ClaimedController::from_policy(bytes, step_s)?,
            _ => {
                return Err(InvalidBox::Controller(
                    "must be either a law or a policy".to_owned(),
                ));
            }
        };
        Ok(InvariantClaim {
            motion: self.motion,
            controller,
            step_s,
            decision_steps,
            own_mps2: [-scenario.usable_brake_mps2(1), ego.max_accel_mps2()],
            leader_mps2: self.leader_mps2,
            observation_error: self.observation_error,
            region_gap_m: self.region_gap_m,
            ends_beyond_gap_m: self.ends_beyond_gap_m,
            region_own_mps: self.region_own_mps,
            region_leader_mps: self.region_leader_mps,
            initial_own_mps_at_most: 0.0,
            axes: [TableAxis::point(0.0); 2],
            splits: 0,
            heights: Vec::new(),
            share_at_least: 0.0,
            min_gap_m_at_least: 0.0,
        })
    }
}

/// Returns the second vehicle of a scenario, if the checker models it.
fn vehicle_under_test(scenario: &Scenario) -> Result<&VehicleSpec, InvalidBox> {
    let Some(ego) = scenario.vehicles().get(1) else {
        return Err(InvalidBox::field("scenario", "has too few vehicles"));
    };
    let is_plain = ego.acceleration_noise_mps2 == 0.0
        && ego.response().is_immediate()
        && ego.multi_body().is_none()
        && ego.keeps_lane();
    if ego.driver != Driver::UnderTest || !is_plain {
        return Err(InvalidBox::field(
            "scenario",
            "the second vehicle must be under test, stay in the lane, and have no noise, delay, lag or limited \
             jerk, and the plant `point-mass`",
        ));
    }
    Ok(ego)
}

/// Controller of a claim, and the number of simulation steps between its decisions.
struct ClaimedController {
    controller: InvariantController,
    decision_steps: u32,
}

impl ClaimedController {
    fn from_law(law: &BuiltInController, max_accel_mps2: f64) -> Result<Self, InvalidBox> {
        match control_law(law, max_accel_mps2) {
            Some(law) => Ok(Self {
                controller: InvariantController::Law(law),
                decision_steps: 1,
            }),
            None => Err(InvalidBox::Controller(format!(
                "must be idm, acc-aeb, a policy or a network, found {}",
                law.name()
            ))),
        }
    }

    fn from_policy(bytes: &[u8], step_s: f64) -> Result<Self, InvalidBox> {
        let network = NeuralController::from_bytes(bytes).map_err(InvalidBox::Controller)?;
        let digest = sha256(bytes);
        Ok(Self {
            decision_steps: (network.decision_interval_s / step_s).round() as u32,
            controller: InvariantController::Network(NetworkReference {
                policy_file: controller_file_name(&digest, network.source.is_some()),
                policy_sha256: digest,
                source: network.source,
            }),
        })
    }
}
