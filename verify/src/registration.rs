//! Registration of counted runs: the parameters that were fixed before the first run.

use std::collections::BTreeMap;
use std::str::EscapeDebug;

use serde::{Deserialize, Serialize};

use crate::bounded;
use crate::canonical;
use crate::certificate::CertificateProvenance;
use crate::rejection::Rejection;
use crate::scope::Scope;

/// Maximum number of runs of a certificate.
pub const MAX_RUNS: u64 = 1_000_000_000;
/// Maximum number of blocks of runs.
pub const MAX_BLOCKS: u64 = 10_000;

const MAX_ENTRIES: usize = 10_000;

/// Entries of every registration, and those of a second controller.
const REQUIRED_ENTRIES: [&str; 9] = [
    "controller",
    "controller_sha256",
    "crumple",
    "estimator",
    "failure",
    "horizon_s",
    "seed",
    "space",
    "space_sha256",
];
const COMPARISON_ENTRIES: [&str; 2] = ["against", "against_sha256"];
const POLICY_ENTRIES: [&str; 2] = ["controller_policy_sha256", "against_policy_sha256"];

/// Parameters that were fixed before the first run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registration {
    /// Controllers, scenario space, seed and version of the runs. Nothing is concluded from them.
    #[serde(deserialize_with = "bounded::deserialize_map::<MAX_ENTRIES, _>")]
    pub configuration: BTreeMap<String, String>,
    /// n, the number of runs.
    pub runs: u64,
    /// γ, above 1/2, read as the nearest floating-point number.
    pub confidence: f64,
    /// Runs per hashed block; the last block may be shorter. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub block_runs: Option<u64>,
}

/// Counts of a block of runs, and a hash that only the author of the runs can know.
pub type CertifiedBlock<T> = (T, String);

impl Registration {
    /// Returns the SHA-256 in hexadecimal of the registration as compact JSON with fields in the order of this type.
    #[must_use]
    pub fn digest(&self) -> String {
        // A struct of strings and numbers always has a JSON form.
        canonical::sha256(serde_json::to_vec(self).unwrap_or_default())
    }

    /// Checks runs, confidence level and the published digest.
    pub(crate) fn check(&self, published: &str) -> Result<(), Rejection> {
        if self.digest() != published {
            return Err(Rejection::invalid(
                "registration_sha256",
                "is not the digest of `registration`",
            ));
        }
        if !(1..=MAX_RUNS).contains(&self.runs) {
            return Err(Rejection::invalid(
                "registration.runs",
                "must be from 1 to 1000 million",
            ));
        }
        // For γ between 1/2 and 1 the subtraction 1 - γ does not round.
        if !(self.confidence > 0.5 && self.confidence < 1.0) {
            return Err(Rejection::invalid(
                "registration.confidence",
                "must be between 1/2 and 1",
            ));
        }
        Ok(())
    }

    /// Checks that the blocks cover the runs and that their counts add up to the claimed ones, each of the first and
    /// the second controller.
    pub(crate) fn check_blocks(
        &self,
        blocks: &[CertifiedBlock<[u64; 2]>],
        claimed: [u64; 2],
    ) -> Result<(), Rejection> {
        let block_runs = self.block_runs.filter(|&block_runs| block_runs > 0);
        let block_runs = block_runs
            .ok_or_else(|| Rejection::invalid("registration.block_runs", "must be positive"))?;
        if blocks.len() as u64 != self.runs.div_ceil(block_runs) {
            return Err(Rejection::invalid("blocks", "must cover all runs"));
        }
        let mut sums = [0_u64; 2];
        let mut left = self.runs;
        for (index, ([first, second], sha256)) in blocks.iter().enumerate() {
            let runs = left.min(block_runs);
            if first.saturating_add(*second) > runs {
                return Err(Rejection::invalid(
                    format!("blocks[{index}]"),
                    "counts more runs than it has",
                ));
            }
            if !canonical::is_sha256(sha256) {
                return Err(Rejection::invalid(
                    format!("blocks[{index}]"),
                    "must have a SHA-256",
                ));
            }
            sums[0] = sums[0].saturating_add(*first);
            sums[1] = sums[1].saturating_add(*second);
            left -= runs;
        }
        if sums == claimed {
            Ok(())
        } else {
            Err(Rejection::invalid(
                "blocks",
                "do not add up to the claimed counts",
            ))
        }
    }

    /// Checks that the registration of one or two controllers names the space of the provenance and has only known
    /// entries.
    pub(crate) fn check_entries(
        &self,
        provenance: &CertificateProvenance,
        controllers: usize,
    ) -> Result<(), Rejection> {
        self.check_keys(controllers)?;
        self.check_values()?;
        let repeated = [
            ("crumple", &provenance.crumple, "differs from `provenance`"),
            (
                "space",
                &provenance.scenario,
                "differs from `provenance.scenario`",
            ),
            (
                "space_sha256",
                &provenance.scenario_sha256,
                "differs from `provenance.scenario_sha256`",
            ),
        ];
        match repeated
            .into_iter()
            .find(|(key, value, _)| self.configuration.get(*key) != Some(*value))
        {
            Some((key, _, problem)) => Err(invalid_entry(key, problem)),
            None => Ok(()),
        }
    }

    /// Checks that all entries for one or two controllers are present, and no others.
    fn check_keys(&self, controllers: usize) -> Result<(), Rejection> {
        let entries = &self.configuration;
        let of_second = COMPARISON_ENTRIES.iter().filter(|_| controllers == 2);
        let mut needed = REQUIRED_ENTRIES.iter().chain(of_second);
        let optional = POLICY_ENTRIES.iter().take(controllers);
        let allowed: Vec<_> = needed.clone().chain(optional).collect();
        if let Some(key) = needed.find(|key| entries.get(**key).is_none_or(String::is_empty)) {
            return Err(invalid_entry(key, "is missing"));
        }
        match entries.keys().find(|key| !allowed.contains(&&key.as_str())) {
            Some(key) => Err(invalid_entry(key, "is not known")),
            None => Ok(()),
        }
    }

    /// Checks the form of hashes and numbers.
    fn check_values(&self) -> Result<(), Rejection> {
        let entries = &self.configuration;
        if let Some((key, _)) = entries
            .iter()
            .find(|(key, value)| key.ends_with("_sha256") && !canonical::is_sha256(value))
        {
            return Err(invalid_entry(key, "is not a SHA-256"));
        }
        if entries.get("seed").is_none_or(|seed| {
            seed.parse::<u64>().map(|read| read.to_string()).as_ref() != Ok(seed)
        }) {
            return Err(invalid_entry("seed", "must be a whole number"));
        }
        let horizon_s: Option<f64> = entries.get("horizon_s").and_then(|text| text.parse().ok());
        if !horizon_s.is_some_and(|value| value > 0.0 && value.is_finite()) {
            return Err(invalid_entry("horizon_s", "must be a positive number"));
        }
        Ok(())
    }

    /// Returns an entry without characters that control a terminal.
    fn escaped(&self, key: &str) -> EscapeDebug<'_> {
        self.configuration
            .get(key)
            .map_or("", String::as_str)
            .escape_debug()
    }

    fn describe_controller(&self, key: &str) -> String {
        format!(
            "under test: {}, SHA-256 {}, with estimator {}",
            self.escaped(key),
            self.escaped(&format!("{key}_sha256")),
            self.escaped("estimator")
        )
    }

    /// Returns the scope of a claim about the runs.
    pub(crate) fn scope(&self) -> Scope {
        let horizon_s = self
            .configuration
            .get("horizon_s")
            .and_then(|text| text.parse().ok());
        let mut vehicles = vec![self.describe_controller("controller")];
        if self.configuration.contains_key("against") {
            vehicles.push(self.describe_controller("against"));
        }
        let runs = self.runs;
        let seed = self.escaped("seed");
        // Registrations are hashed, so they keep the earlier wording.
        let failure =
            self.escaped("failure")
                .to_string()
                .replacen("vehicles touch", "collision", 1);
        let limits = vec![format!(
            "{runs} random scenarios, seed {seed}; a failure is: {failure}"
        )];
        Scope::new(horizon_s, vehicles, limits)
    }
}

fn invalid_entry(key: &str, problem: &'static str) -> Rejection {
    Rejection::invalid(format!("registration.configuration.{key}"), problem)
}
