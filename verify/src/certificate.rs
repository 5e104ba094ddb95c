//! The file: `docs/certificates.md` in crumple's repository specifies it.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::bounded;
use crate::canonical;
use crate::claim::{ConstantPiece, MAX_EGOS, MAX_STEPS, Scene};
use crate::cruise::CruiseClaim;
use crate::kernel::KernelClaim;
use crate::rate::{ComparisonClaim, RateClaim};
use crate::reach::ReachClaim;

/// The version of the format that is written.
pub const VERSION: u32 = 2;
/// The first version, which is still read. It binds a statement to nothing: see [`Certificate::is_old`].
pub const FIRST_VERSION: u32 = 1;

/// What stands beside an accepted rate or comparison whose runs were not made again.
pub const UNVERIFIED_COUNTS_CAVEAT: &str =
    "the counts are the maker's word: `crumple check --rerun` draws and simulates again";

/// Longest file that is read, in bytes.
pub const MAX_BYTES: usize = 64 << 20;

/// A statement with what it assumes and what it takes to check it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Version of the format: 2, or 1 for old files.
    pub version: u32,
    /// What the statement is about, and which program wrote it.
    pub provenance: CertificateProvenance,
    /// What is taken for granted: exactly what the statement needs, each once.
    pub assumptions: Vec<Assumption>,
    /// What is claimed, and its proof.
    pub statement: Statement,
}

/// What a statement is about: a scenario, a box around one, or a space that runs are drawn from.
///
/// In version 2 its text is part of the certificate, its hash is checked, and whoever can read such texts can compare them with the
/// numbers of the statement, as `crumple check` does. A kernel is about no one scenario: there these fields are absent. In version 1
/// nothing was concluded from any of them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificateProvenance {
    /// Version of the program that wrote it.
    pub crumple: String,
    /// Name of the scenario, or of the space.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub scenario: String,
    /// SHA-256 of `scenario_text`, in hexadecimal.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub scenario_sha256: String,
    /// The scenario or space as a file, in TOML. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenario_text: Option<String>,
    /// The ranges around the scenario as a file, in TOML, if the statement is about a box. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub box_text: Option<String>,
}

/// What a statement takes for granted about the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Assumption {
    /// Accelerations are held over each step; a vehicle whose speed reaches zero stops there and never reverses.
    ExactMotion,
    /// The leader moves as its script says and reacts to nobody.
    ScriptedLeader,
    /// The follower has the latched emergency brake described, sees the truth, and has neither lag nor noise.
    LatchedFollower,
    /// The follower does at once what the stated law asks for at each step, sees the truth, and has neither delay, lag nor noise.
    FollowerByLaw,
    /// No ego brakes or accelerates harder than stated.
    EgoWithinLimits,
    /// The egos follow the stated profile from the start, without delay, lag or noise.
    EgoOnProfile,
    /// The vehicle ahead never brakes harder than stated.
    LeaderWithinLimit,
    /// From every decision on, the own vehicle can brake at the stated rate.
    EgoCanBrake,
    /// The own vehicle does at once what the stated policy asks for, at the stated instants.
    PolicyDrives,
    /// What the policy observes is within the stated errors of the truth.
    ObservedWithin,
    /// The single-precision tanh is within 2⁻²² of the true one.
    TanhWithin,
    /// The single-precision exp and exp - 1 are within 2⁻²² of themselves of the true ones.
    ExpWithin,
    /// The file of the network says what the file that it was read from means, and its controller file.
    NetworkAsRead,
    /// Runs are independent draws, and the registration was made before the first of them.
    RegisteredDraws,
    /// Noise is that of the scenario's seed, contained in the stated accelerations. The only one that is optional.
    NoiseOfSeed,
}

impl std::fmt::Display for Assumption {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::ExactMotion => {
                "accelerations are held over each step, and a vehicle that has stopped does not reverse"
            }
            Self::ScriptedLeader => "the leader moves as scripted and reacts to nobody",
            Self::LatchedFollower => "the follower holds its speed until its latched emergency brake fires",
            Self::FollowerByLaw => "the follower does at once, at each step, what the stated law asks for",
            Self::EgoWithinLimits => "no vehicle under test brakes or accelerates harder than stated",
            Self::EgoOnProfile => "the vehicles under test follow the stated profile at once",
            Self::LeaderWithinLimit => "the vehicle ahead never brakes harder than stated",
            Self::EgoCanBrake => "from every decision on, the own vehicle can brake at the stated rate",
            Self::PolicyDrives => "the vehicle under test does at once what the stated policy asks for",
            Self::ObservedWithin => "what the policy observes is within the stated errors of the truth",
            Self::TanhWithin => "tanh in single precision is within 2^-22 of the true one",
            Self::ExpWithin => "exp and exp - 1 in single precision are within 2^-22 of themselves of the true ones",
            Self::NetworkAsRead => {
                "the network is the one of its source file, as crumple read it, with the mapping stated"
            }
            Self::RegisteredDraws => "runs are independent draws, and were registered before the first of them",
            Self::NoiseOfSeed => "noise is that of the scenario's seed",
        })
    }
}

/// What is claimed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Statement {
    /// With one profile of ego accelerations nobody touches.
    Avoidable(AvoidableClaim),
    /// With no profile of ego accelerations does nobody touch.
    Unavoidable(UnavoidableClaim),
    /// With no profile of ego accelerations does every gap stay larger than stated.
    GapBound(GapBoundClaim),
    /// From exactly these states contact can be avoided.
    Kernel(KernelClaim),
    /// A controller fails at no more than a rate.
    Rate(RateClaim),
    /// One controller fails less often than another.
    Comparison(ComparisonClaim),
    /// A policy keeps parts of a box free of contact.
    Reach(ReachClaim),
    /// A network keeps its distance in a public benchmark.
    AdaptiveCruise(CruiseClaim),
}

impl Statement {
    /// Its name in a file.
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
            Self::AdaptiveCruise(_) => "adaptive-cruise",
        }
    }

    /// The scene it speaks about, if it speaks about one.
    #[must_use]
    pub fn scene(&self) -> Option<&Scene> {
        match self {
            Self::Avoidable(claim) => Some(&claim.scene),
            Self::Unavoidable(claim) => Some(&claim.scene),
            Self::GapBound(claim) => Some(&claim.scene),
            Self::Kernel(_) | Self::Rate(_) | Self::Comparison(_) | Self::Reach(_) | Self::AdaptiveCruise(_) => None,
        }
    }

    /// What the statement takes for granted.
    #[must_use]
    pub fn assumptions(&self) -> Vec<Assumption> {
        let (scene, about_egos) = match self {
            Self::Avoidable(claim) => (&claim.scene, Assumption::EgoOnProfile),
            Self::Unavoidable(claim) => (&claim.scene, Assumption::EgoWithinLimits),
            Self::GapBound(claim) => (&claim.scene, Assumption::EgoWithinLimits),
            Self::Kernel(_) => {
                return vec![Assumption::ExactMotion, Assumption::LeaderWithinLimit, Assumption::EgoCanBrake];
            }
            Self::Rate(_) | Self::Comparison(_) => return vec![Assumption::RegisteredDraws],
            Self::AdaptiveCruise(_) => {
                return vec![
                    Assumption::PolicyDrives,
                    Assumption::TanhWithin,
                    Assumption::ExpWithin,
                    Assumption::NetworkAsRead,
                ];
            }
            Self::Reach(claim) => {
                let about_leader = match claim.leader_brakes_at_most_mps2 {
                    Some(_) => Assumption::LeaderWithinLimit,
                    None => Assumption::ScriptedLeader,
                };
                let needed = [Assumption::ExactMotion, about_leader, Assumption::PolicyDrives];
                let needed = needed.into_iter().chain([Assumption::ObservedWithin, Assumption::TanhWithin]);
                let of_source = [Assumption::ExpWithin, Assumption::NetworkAsRead];
                let needed = needed.chain(of_source.into_iter().filter(|_| claim.source.is_some()));
                let latched = claim.follower_ttc_s.map(|_| Assumption::LatchedFollower);
                return needed
                    .chain(latched)
                    .chain(claim.follower_law.as_ref().map(|_| Assumption::FollowerByLaw))
                    .collect();
            }
        };
        let follower = scene.follower.as_ref().map(|_| Assumption::LatchedFollower);
        [Assumption::ExactMotion, Assumption::ScriptedLeader, about_egos].into_iter().chain(follower).collect()
    }
}

/// A profile with which nobody touches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AvoidableClaim {
    /// What it speaks about.
    pub scene: Scene,
    /// Acceleration of each ego over each of the N steps, in m/s².
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub witness: Vec<Vec<ConstantPiece<f64>>>,
    /// Also claimed, if stated: no gap is ever smaller, in metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_gap_m_at_least: Option<f64>,
}

/// A proof that every profile ends in contact.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnavoidableClaim {
    /// What it speaks about.
    pub scene: Scene,
    /// A proof for each range of instants at which the follower's brake may fire; one for all if there is no follower.
    #[serde(deserialize_with = "bounded::deserialize_list::<{ MAX_STEPS as usize + 1 }, _, _>")]
    pub branches: Vec<Branch>,
}

/// A proof that no profile keeps every gap larger than stated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GapBoundClaim {
    /// What it speaks about.
    pub scene: Scene,
    /// Some gap gets as small as this, in metres; not negative.
    pub gap_m: f64,
    /// As for [`Unavoidable`].
    #[serde(deserialize_with = "bounded::deserialize_list::<{ MAX_STEPS as usize + 1 }, _, _>")]
    pub branches: Vec<Branch>,
}

/// Pairs of an instant, increasing, and a multiplier that is not negative. In a file `[[instant, multiplier], …]`.
pub type MultiplierRows = Vec<(u32, f64)>;

/// Multipliers for all profiles in which the follower's brake first fires at an instant from `first` to `last`.
///
/// Instant N means never. The rows are those of [`unavoidable`](crate::unavoidable); what is absent is empty or zero.
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
    /// The follower's brake fires at `first`; only where `first` = `last` < N.
    pub fired: f64,
}

/// Why a file is not a certificate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateParseError {
    /// It cannot be read.
    #[error("cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// It is too long.
    #[error("is longer than {MAX_BYTES} bytes")]
    TooLong,
    /// It is not JSON of the right form; says what was expected, at which line and column.
    #[error("is not a certificate: {0}")]
    Json(#[from] serde_json::Error),
    /// It has a version that is not known here.
    #[error("has version {0} in field `version`, and only versions {FIRST_VERSION} and {VERSION} are known")]
    UnknownVersion(u32),
    /// It says the same as another text: fields in another order, numbers with more digits than they need, defaults spelled out.
    #[error("is not in canonical form from line {line} column {column} on: only whitespace between tokens may differ")]
    NotCanonical {
        /// Where it departs from what this crate would write, from 1.
        line: usize,
        /// Likewise.
        column: usize,
    },
}

impl Certificate {
    /// The file of the policy or network that it speaks about: the name under which it expects it, and its SHA-256; none if it needs
    /// none.
    #[must_use]
    pub fn policy_reference(&self) -> Option<(&str, &str)> {
        match &self.statement {
            Statement::Reach(claim) => Some((&claim.policy_file, &claim.policy_sha256)),
            Statement::AdaptiveCruise(claim) => Some((&claim.policy_file, &claim.policy_sha256)),
            _ => None,
        }
    }

    /// The policy file the certificate in `path` speaks about: `policy`, or else the one it names, beside it; none if it needs
    /// none or the file cannot be read.
    #[must_use]
    pub fn read_policy(&self, path: &Path, policy: Option<&Path>) -> Option<Vec<u8>> {
        let beside = path.with_file_name(Path::new(self.policy_reference()?.0).file_name()?);
        let mut bytes = Vec::new();
        File::open(policy.unwrap_or(&beside)).ok()?.take(MAX_BYTES as u64).read_to_end(&mut bytes).ok()?;
        Some(bytes)
    }

    /// Whether the assumptions listed are those that the statement needs, noise of the seed apart.
    pub(crate) fn has_required_assumptions(&self) -> bool {
        let needed = self.statement.assumptions();
        let noise = usize::from(self.assumptions.contains(&Assumption::NoiseOfSeed));
        needed.iter().all(|assumption| self.assumptions.contains(assumption))
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
            // Its readers were lenient, and files are left that were written by hand.
            FIRST_VERSION => Ok(certificate),
            VERSION => match canonical::first_difference(text, &certificate.to_canonical_json()) {
                None => Ok(certificate),
                Some((line, column)) => Err(CertificateParseError::NotCanonical { line, column }),
            },
            other => Err(CertificateParseError::UnknownVersion(other)),
        }
    }

    /// The one text of this certificate, but for whitespace between tokens.
    #[must_use]
    pub fn to_canonical_json(&self) -> String {
        // Structs of strings and finite numbers always have a JSON form.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// SHA-256 of the canonical form, in hexadecimal: what to cite it by.
    #[must_use]
    pub fn digest(&self) -> String {
        canonical::sha256(self.to_canonical_json())
    }

    /// What acceptance by this crate alone leaves open, if it does.
    #[must_use]
    pub fn caveat(&self) -> Option<&'static str> {
        match &self.statement {
            Statement::Rate(_) | Statement::Comparison(_) => Some(UNVERIFIED_COUNTS_CAVEAT),
            _ => None,
        }
    }

    /// Whether it is of the first version, in which nothing binds the statement to a scenario, a box, a space or the runs that were
    /// counted. Its mathematics is checked all the same.
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
        std::io::Read::read_to_string(&mut std::io::Read::take(source, MAX_BYTES as u64 + 1), &mut text)?;
        Self::from_json(&text)
    }
}
