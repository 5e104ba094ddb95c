//! The certificate file. `docs/certificates.md` in crumple's repository specifies it.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::bounded;
use crate::canonical;
use crate::claim::{ConstantPiece, MAX_EGOS, MAX_STEPS, Scene};
use crate::invariant::InvariantClaim;
use crate::kernel::KernelClaim;
use crate::rate::{ComparisonClaim, RateClaim};
use crate::reach::ReachClaim;

/// The version of the format that is written.
pub const VERSION: u32 = 2;
/// The first version, which is still read. It binds a statement to nothing: see [`Certificate::is_first_version`].
pub const FIRST_VERSION: u32 = 1;

/// Caveat of an accepted rate or comparison whose runs were not repeated.
pub const UNVERIFIED_COUNTS_CAVEAT: &str =
    "the counts are not verified: `crumple check --rerun` simulates the runs again";

/// Maximum size of a file, in bytes.
pub const MAX_BYTES: usize = 64 << 20;

/// A statement with its assumptions and its proof.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Version of the format: 2, or 1 for old files.
    pub version: u32,
    /// Subject of the statement, and the program that wrote it.
    pub provenance: CertificateProvenance,
    /// Exactly the assumptions that the statement needs, each once.
    pub assumptions: Vec<Assumption>,
    /// Claim and proof.
    pub statement: Statement,
}

/// The subject of a statement: a scenario, a box around one, or a scenario space.
///
/// In version 2 its text is part of the certificate and its hash is checked. `crumple check` compares the text with the
/// numbers of the statement. A kernel concerns no single scenario, so `crumple` is its only field. The checker
/// concludes nothing from these fields in a certificate of version 1.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificateProvenance {
    /// Version of the program that wrote the file.
    pub crumple: String,
    /// Name of the scenario or scenario space.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub scenario: String,
    /// SHA-256 of `scenario_text`, in hexadecimal.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub scenario_sha256: String,
    /// The scenario or scenario space as a file, in TOML. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenario_text: Option<String>,
    /// Ranges around the scenario as a file, in TOML, if the statement is about a box. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub box_text: Option<String>,
}

/// An assumption of a statement about the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Assumption {
    /// Vehicles are point masses. Accelerations are held over each step; a vehicle whose speed reaches zero stops there
    /// and never reverses.
    ExactMotion,
    /// The leader moves as scripted and reacts to no vehicle.
    ScriptedLeader,
    /// The follower has the stated latched emergency brake, observes the true state, and has neither lag nor noise.
    LatchedFollower,
    /// The follower applies its stated law at each step, observes the true state, and has neither delay, lag nor noise.
    FollowerByLaw,
    /// No ego brakes or accelerates harder than stated.
    EgoWithinLimits,
    /// The egos follow the stated profile from the start, without delay, lag or noise.
    EgoOnProfile,
    /// The vehicle ahead never brakes harder than stated.
    LeaderWithinLimit,
    /// From every decision on, the own vehicle can brake at the stated rate.
    EgoCanBrake,
    /// The own vehicle applies the stated policy's command at once, at the stated instants.
    PolicyDrives,
    /// Each observed quantity is within its stated error of the true state.
    ObservedWithin,
    /// The single-precision tanh is within 2⁻²² of the true one.
    TanhWithin,
    /// The single-precision exp and exp - 1 have a relative error of at most 2⁻²².
    ExpWithin,
    /// The network file has the meaning of its source file and controller file.
    NetworkAsRead,
    /// The leader's acceleration and speed stay within the stated limits, and the own speed within the stated range.
    /// The claim ends if they leave.
    SpeedsWithin,
    /// Runs are independent samples, and the registration was made before the first of them.
    RegisteredDraws,
    /// Noise is that of the scenario's seed, contained in the stated accelerations. The only optional assumption.
    NoiseOfSeed,
}

impl std::fmt::Display for Assumption {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::ExactMotion => {
                "vehicles have the plant `point-mass`: accelerations are held over each step, and a vehicle that has \
                 stopped does not reverse"
            }
            Self::ScriptedLeader => "the leader moves as scripted and reacts to no vehicle",
            Self::LatchedFollower => "the follower holds its speed until its latched emergency brake fires",
            Self::FollowerByLaw => "the follower applies the stated controller's command at each step, without delay",
            Self::EgoWithinLimits => "no vehicle under test brakes or accelerates harder than stated",
            Self::EgoOnProfile => "the vehicles under test follow the stated profile at once",
            Self::LeaderWithinLimit => "the vehicle ahead never brakes harder than stated",
            Self::EgoCanBrake => "from every decision on, the own vehicle can brake at the stated rate",
            Self::PolicyDrives => "the vehicle under test does at once what the stated policy asks for",
            Self::ObservedWithin => "each observed quantity is within its stated error of the true state",
            Self::TanhWithin => "tanh in single precision is within 2^-22 of the true one",
            Self::ExpWithin => "exp and exp - 1 in single precision have a relative error of at most 2^-22",
            Self::NetworkAsRead => {
                "the network is the one of its source file, as crumple read it, with the mapping stated"
            }
            Self::SpeedsWithin => {
                "the speeds of both vehicles and the leader's acceleration stay within the stated limits"
            }
            Self::RegisteredDraws => "runs are independent samples, registered before the first run",
            Self::NoiseOfSeed => "noise is that of the scenario's seed",
        })
    }
}

/// A claim with its proof.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Statement {
    /// One profile of ego accelerations avoids a collision.
    Avoidable(AvoidableClaim),
    /// No profile of ego accelerations avoids a collision.
    Unavoidable(UnavoidableClaim),
    /// No profile of ego accelerations keeps every gap larger than stated.
    GapBound(GapBoundClaim),
    /// From exactly these states a collision can be avoided.
    Kernel(KernelClaim),
    /// A bound of a controller's failure rate.
    Rate(RateClaim),
    /// One controller fails less often than another.
    Comparison(ComparisonClaim),
    /// A policy avoids collisions from parts of a box.
    Reach(ReachClaim),
    /// A controller keeps a set of states, in which it never collides.
    Invariant(Box<InvariantClaim>),
}

impl Statement {
    /// Returns the name in a file.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Avoidable(_) => "avoidable",
            Self::Unavoidable(_) => "unavoidable",
            Self::GapBound(_) => "gap-bound",
            Self::Kernel(_) => "kernel",
            Self::Rate(_) => "rate",
            Self::Comparison(_) => "comparison",
            Self::Reach(_) => "reach",
            Self::Invariant(_) => "invariant",
        }
    }

    /// Returns the scene of the statement, if it has one.
    #[must_use]
    pub fn scene(&self) -> Option<&Scene> {
        match self {
            Self::Avoidable(claim) => Some(&claim.scene),
            Self::Unavoidable(claim) => Some(&claim.scene),
            Self::GapBound(claim) => Some(&claim.scene),
            Self::Kernel(_)
            | Self::Rate(_)
            | Self::Comparison(_)
            | Self::Reach(_)
            | Self::Invariant(_) => None,
        }
    }

    /// Returns the assumptions of the statement.
    #[must_use]
    pub fn assumptions(&self) -> Vec<Assumption> {
        let (scene, about_egos) = match self {
            Self::Avoidable(claim) => (&claim.scene, Assumption::EgoOnProfile),
            Self::Unavoidable(claim) => (&claim.scene, Assumption::EgoWithinLimits),
            Self::GapBound(claim) => (&claim.scene, Assumption::EgoWithinLimits),
            Self::Kernel(_) => {
                return vec![
                    Assumption::ExactMotion,
                    Assumption::LeaderWithinLimit,
                    Assumption::EgoCanBrake,
                ];
            }
            Self::Rate(_) | Self::Comparison(_) => return vec![Assumption::RegisteredDraws],
            Self::Invariant(claim) => {
                let always = [
                    Assumption::ExactMotion,
                    Assumption::LeaderWithinLimit,
                    Assumption::PolicyDrives,
                ];
                let network = claim.network();
                let of_source = [Assumption::ExpWithin, Assumption::NetworkAsRead];
                let of_source = of_source
                    .into_iter()
                    .filter(|_| network.is_some_and(|of| of.source.is_some()));
                return (always.into_iter().chain([Assumption::ObservedWithin]))
                    .chain(network.map(|_| Assumption::TanhWithin))
                    .chain(of_source)
                    .chain([Assumption::SpeedsWithin])
                    .collect();
            }
            Self::Reach(claim) => {
                let about_leader = match claim.leader_brakes_at_most_mps2 {
                    Some(_) => Assumption::LeaderWithinLimit,
                    None => Assumption::ScriptedLeader,
                };
                let needed = [
                    Assumption::ExactMotion,
                    about_leader,
                    Assumption::PolicyDrives,
                ];
                let needed = needed
                    .into_iter()
                    .chain([Assumption::ObservedWithin, Assumption::TanhWithin]);
                let of_source = [Assumption::ExpWithin, Assumption::NetworkAsRead];
                let needed = needed.chain(of_source.into_iter().filter(|_| claim.source.is_some()));
                let latched = claim.follower_ttc_s.map(|_| Assumption::LatchedFollower);
                return needed
                    .chain(latched)
                    .chain(
                        claim
                            .follower_law
                            .as_ref()
                            .map(|_| Assumption::FollowerByLaw),
                    )
                    .collect();
            }
        };
        let follower = scene.follower.as_ref().map(|_| Assumption::LatchedFollower);
        [
            Assumption::ExactMotion,
            Assumption::ScriptedLeader,
            about_egos,
        ]
        .into_iter()
        .chain(follower)
        .collect()
    }
}

/// A profile that avoids a collision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AvoidableClaim {
    /// Scene of the claim.
    pub scene: Scene,
    /// Acceleration of each ego over each of the N steps, in m/s².
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub witness: Vec<Vec<ConstantPiece<f64>>>,
    /// Optional claim: lower bound of all gaps, in metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_gap_m_at_least: Option<f64>,
}

/// A proof that every profile ends in a collision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnavoidableClaim {
    /// Scene of the claim.
    pub scene: Scene,
    /// A proof for each range of firing instants of the follower's brake; a single one without a follower.
    #[serde(deserialize_with = "bounded::deserialize_list::<{ MAX_STEPS as usize + 1 }, _, _>")]
    pub branches: Vec<Branch>,
}

/// A proof that no profile keeps every gap larger than stated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GapBoundClaim {
    /// Scene of the claim.
    pub scene: Scene,
    /// Upper bound of the smallest gap, in metres; not negative.
    pub gap_m: f64,
    /// Branches as in [`UnavoidableClaim`].
    #[serde(deserialize_with = "bounded::deserialize_list::<{ MAX_STEPS as usize + 1 }, _, _>")]
    pub branches: Vec<Branch>,
}

/// Pairs of an instant, increasing, and a multiplier that is not negative. In a file `[[instant, multiplier], …]`.
pub type MultiplierRows = Vec<(u32, f64)>;

/// Multipliers for all profiles in which the follower's brake first fires at an instant from `first` to `last`.
///
/// Instant N means never. [`unavoidable`](crate::unavoidable) defines the rows; absent ones are empty or zero.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Branch {
    /// Earliest firing instant.
    pub first: u32,
    /// Latest firing instant.
    pub last: u32,
    /// The first ego stays behind the leader, instants 0 to N.
    pub front: MultiplierRows,
    /// Ego i + 1 stays behind ego i, one list for each pair.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub between: Vec<MultiplierRows>,
    /// The last ego stays ahead of the follower, instants 0 to N.
    pub rear: MultiplierRows,
    /// No ego reverses, one list for each ego, instants 0 to N.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub speed: Vec<MultiplierRows>,
    /// The follower's brake has not fired, instants before `first`.
    pub unfired: MultiplierRows,
    /// The follower's brake fires at `first`; only if `first` = `last` < N.
    pub fired: f64,
}

/// Opens a regular file. Other files are refused, because reading a pipe or a device may never end.
///
/// # Errors
/// Those of the system; [`std::io::ErrorKind::InvalidInput`] for anything but a regular file.
pub fn open_regular_file(path: &Path) -> std::io::Result<File> {
    let refuse = || {
        Err(std::io::Error::new(
            std::io::ErrorKind::InvalidInput,
            "is not a regular file",
        ))
    };
    match path.metadata() {
        Ok(found) if !found.is_file() && !found.is_dir() => refuse(),
        _ => File::open(path),
    }
}

/// Reason for which a file is not a certificate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateParseError {
    /// The file cannot be read.
    #[error("cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// The file is too long.
    #[error("is longer than {MAX_BYTES} bytes")]
    TooLong,
    /// The file is not JSON of the right form; names the expected token, line and column.
    #[error("is not a certificate: {0}")]
    Json(#[from] serde_json::Error),
    /// The version is unknown.
    #[error(
        "has version {0} in field `version`, and only versions {FIRST_VERSION} and {VERSION} are known"
    )]
    UnknownVersion(u32),
    /// The text is not canonical: fields in another order, numbers with superfluous digits, explicit defaults.
    #[error(
        "is not in canonical form from line {line} column {column} on: only whitespace between tokens may differ"
    )]
    NotCanonical {
        /// First line that differs from the canonical text, from 1.
        line: usize,
        /// First column that differs, from 1.
        column: usize,
    },
}

impl Certificate {
    /// Returns the file name and SHA-256 of the policy or network of the claim, if it has one.
    #[must_use]
    pub fn policy_reference(&self) -> Option<(&str, &str)> {
        match &self.statement {
            Statement::Reach(claim) => Some((&claim.policy_file, &claim.policy_sha256)),
            Statement::Invariant(claim) => claim
                .network()
                .map(|network| (network.policy_file.as_str(), network.policy_sha256.as_str())),
            _ => None,
        }
    }

    /// Reads `policy`, or else the policy file that the certificate names, in the folder of `path`. Returns `None` if
    /// the claim has no policy or the file cannot be read.
    #[must_use]
    pub fn read_policy(&self, path: &Path, policy: Option<&Path>) -> Option<Vec<u8>> {
        let beside = path.with_file_name(Path::new(self.policy_reference()?.0).file_name()?);
        let mut bytes = Vec::new();
        open_regular_file(policy.unwrap_or(&beside))
            .ok()?
            .take(MAX_BYTES as u64)
            .read_to_end(&mut bytes)
            .ok()?;
        Some(bytes)
    }

    /// True if the listed assumptions are those that the statement needs, apart from noise of the seed.
    pub(crate) fn has_required_assumptions(&self) -> bool {
        let needed = self.statement.assumptions();
        let noise = usize::from(self.assumptions.contains(&Assumption::NoiseOfSeed));
        needed
            .iter()
            .all(|assumption| self.assumptions.contains(assumption))
            && self.assumptions.len() == needed.len() + noise
    }

    /// Reads a certificate from text.
    ///
    /// # Errors
    /// [`CertificateParseError`] if the text is not a certificate. One that is read may still be rejected.
    pub fn from_json(text: &str) -> Result<Self, CertificateParseError> {
        if text.len() > MAX_BYTES {
            return Err(CertificateParseError::TooLong);
        }
        let certificate: Self = serde_json::from_str(text)?;
        match certificate.version {
            // Readers of version 1 accepted any form, and handwritten files of it exist.
            FIRST_VERSION => Ok(certificate),
            VERSION => match canonical::first_difference(text, &certificate.to_canonical_json()) {
                None => Ok(certificate),
                Some((line, column)) => Err(CertificateParseError::NotCanonical { line, column }),
            },
            other => Err(CertificateParseError::UnknownVersion(other)),
        }
    }

    /// Returns the canonical text: unique but for whitespace between tokens.
    #[must_use]
    pub fn to_canonical_json(&self) -> String {
        // Structs of strings and finite numbers always have a JSON form.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Returns the SHA-256 of the canonical form in hexadecimal, for citation.
    #[must_use]
    pub fn digest(&self) -> String {
        canonical::sha256(self.to_canonical_json())
    }

    /// Returns the condition that acceptance by this crate alone leaves open, if any.
    #[must_use]
    pub fn caveat(&self) -> Option<&'static str> {
        match &self.statement {
            Statement::Rate(_) | Statement::Comparison(_) => Some(UNVERIFIED_COUNTS_CAVEAT),
            _ => None,
        }
    }

    /// True for version 1, which binds the statement to no scenario, box, space or counted runs. Its mathematics is
    /// checked.
    #[must_use]
    pub fn is_first_version(&self) -> bool {
        self.version == FIRST_VERSION
    }

    /// Reads a certificate from a file or any other source.
    ///
    /// # Errors
    /// [`CertificateParseError`] if it cannot be read or is not a certificate.
    pub fn from_reader(source: impl std::io::Read) -> Result<Self, CertificateParseError> {
        let mut text = String::new();
        std::io::Read::read_to_string(
            &mut std::io::Read::take(source, MAX_BYTES as u64 + 1),
            &mut text,
        )?;
        Self::from_json(&text)
    }
}
