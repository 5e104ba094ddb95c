//! What a campaign is: everything that decides its results, as a file.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{CampaignError, Specification};
use crate::estimate::EstimatorKind;
use crate::falsify::Method;
use crate::scenario::space::{Space, SpaceSpec};
use crate::sim::{Contender, RunOptions};

/// The version of the campaign file this release reads and writes.
pub const CAMPAIGN_VERSION: u32 = 1;

/// Everything that decides a campaign's results.
#[derive(Debug, Clone)]
pub struct Campaign {
    /// What is put under test.
    pub controller: Contender,
    /// What the vehicles under test look through.
    pub estimator: EstimatorKind,
    /// Where failures are looked for.
    pub space: Space,
    /// What must hold.
    pub specification: Specification,
    /// The search method.
    pub method: Method,
    /// Evaluations of the method, and of each yardstick.
    pub budget: u64,
    /// Seed of the search and of all noise.
    pub seed: u64,
}

/// The file `campaign.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CampaignFile {
    version: u32,
    crumple: String,
    controller: String,
    policy_sha256: Option<String>,
    estimator: EstimatorKind,
    specification: String,
    method: String,
    budget: u64,
    seed: u64,
    space: SpaceSpec,
}

impl Campaign {
    /// Hash of the policy under test; none for other controllers.
    #[must_use]
    pub fn policy_sha256(&self) -> Option<String> {
        self.controller.policy().map(|policy| policy.digest())
    }

    /// The methods in the order in which they run: the one asked for, then the yardsticks.
    #[must_use]
    pub fn methods(&self) -> Vec<Method> {
        let mut methods = vec![self.method];
        methods.extend([Method::Uniform, Method::Halton].into_iter().filter(|method| *method != self.method));
        methods
    }

    /// How scenarios are run to be judged.
    #[must_use]
    pub fn options(&self) -> RunOptions {
        RunOptions::new(self.controller.controller.clone())
            .with_estimator(self.estimator)
            .with_after_contact(self.specification.after_contact())
    }

    /// The text of `campaign.toml`.
    ///
    /// # Errors
    /// [`CampaignError::Encoding`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, CampaignError> {
        let file = CampaignFile {
            version: CAMPAIGN_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            controller: self.controller.name.clone(),
            policy_sha256: self.policy_sha256(),
            estimator: self.estimator,
            specification: self.specification.to_string(),
            method: self.method.name().to_owned(),
            budget: self.budget,
            seed: self.seed,
            space: self.space.spec().clone(),
        };
        toml::to_string(&file).map_err(CampaignError::encoding)
    }

    /// Says in what a campaign on disk differs from this one, if it does.
    pub(super) fn difference(&self, found: &str, path: &Path) -> Result<Option<String>, CampaignError> {
        let expected = self.to_toml()?;
        if found == expected {
            return Ok(None);
        }
        let table = |text: &str| text.parse::<toml::Table>().ok();
        let (Some(old), Some(new)) = (table(found), table(&expected)) else {
            return Ok(Some(format!("{} is no campaign", path.display())));
        };
        let field = new.iter().find(|(name, value)| old.get(*name) != Some(*value));
        let name = field.map_or("file", |(name, _)| name.as_str());
        let show = |table: &toml::Table| match table.get(name) {
            Some(toml::Value::Table(_)) | None => String::new(),
            Some(value) => format!(" {value}"),
        };
        Ok(Some(format!(
            "{}: the campaign there has another `{name}`:{} instead of{}",
            path.display(),
            show(&old),
            show(&new)
        )))
    }
}

/// SHA-256 of a text, in hexadecimal.
pub(super) fn sha256(text: &str) -> String {
    Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}
