//! Record of what a study is about, in its files and results.

use serde::{Deserialize, Deserializer, Serialize};

use crumple_core::digest::sha256;
use crumple_core::text_file::is_default;
use crumple_measure::Specification;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::{ScenarioSpace, file};

/// Subject of a study: a controller in a scenario space, with an estimator, a specification and a seed. `Space` is
/// the name of the space, or the space itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StudySubject<Space = String> {
    /// Version of crumple.
    pub crumple: String,
    /// Controller under test.
    pub controller: String,
    /// Hash of the policy; `None` for other controllers.
    pub policy_sha256: Option<String>,
    /// Identity of the controller, if its name does not determine it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller_sha256: Option<String>,
    /// True if the controller declares itself non-deterministic: the same study may have other results.
    #[serde(default, skip_serializing_if = "is_default")]
    pub nondeterministic: bool,
    /// Estimator of the vehicles under test.
    pub estimator: EstimatorKind,
    /// Specification; empty in rare-failure estimates of 0.3.0, which only describe the failure.
    #[serde(default, deserialize_with = "read_specification")]
    pub specification: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Scenario space.
    pub space: Space,
    /// SHA-256 of the space as TOML, including its base scenario, if `space` is a name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub space_sha256: Option<String>,
}

/// Reads a specification. 0.3.0 wrote `no collision` for "no collision".
fn read_specification<'de, D: Deserializer<'de>>(reader: D) -> Result<String, D::Error> {
    let text = String::deserialize(reader)?;
    match text.parse() {
        Ok(Specification::NoCollision) => Ok(Specification::NoCollision.to_string()),
        _ => Ok(text),
    }
}

impl StudySubject {
    /// Records what a study is about.
    ///
    /// # Errors
    /// [`toml::ser::Error`] in principle, if the space cannot be written.
    pub fn new(
        controller: &NamedController,
        estimator: EstimatorKind,
        specification: String,
        seed: u64,
        space: &ScenarioSpace,
    ) -> Result<Self, toml::ser::Error> {
        Ok(Self {
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            controller: controller.name.clone(),
            policy_sha256: controller.policy().map(|policy| policy.digest()),
            controller_sha256: controller.disambiguating_hash(),
            nondeterministic: !controller.source.is_deterministic(),
            estimator,
            specification,
            seed,
            space: space.name().to_owned(),
            space_sha256: Some(sha256(file::to_identity_toml(space)?)),
        })
    }

    /// Returns the record with the whole space in place of its name.
    #[must_use]
    pub fn with_space<Space>(self, space: Space) -> StudySubject<Space> {
        let Self {
            crumple,
            controller,
            policy_sha256,
            controller_sha256,
            nondeterministic,
            estimator,
            specification,
            seed,
            ..
        } = self;
        StudySubject {
            crumple,
            controller,
            policy_sha256,
            controller_sha256,
            nondeterministic,
            estimator,
            specification,
            seed,
            space,
            space_sha256: None,
        }
    }
}

impl<Space> StudySubject<Space> {
    /// Returns true if a controller is the recorded one: by its name and, where the record states one, its identity.
    #[must_use]
    pub fn is_of_controller(&self, controller: &NamedController) -> bool {
        controller.name == self.controller
            && controller.policy().map(|policy| policy.digest()) == self.policy_sha256
            && controller.disambiguating_hash() == self.controller_sha256
    }
}
