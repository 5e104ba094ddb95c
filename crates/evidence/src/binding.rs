//! Check that the statement of a certificate matches its scenario, box or space. The checker knows numbers and the hash
//! of a text. This module parses the text, derives the numbers of the statement again, and compares them. It proves
//! nothing; it refuses a proof about something else.

use std::path::Path;

use crumple_controllers::Controllers;
use crumple_verify::reach::{BoxDimension, NeuralController};
use crumple_verify::{Certificate, ClaimSubject, InvariantClaim, ReachClaim, Registration};

use super::initial_set::InitialSet;
use super::invariant::{InvariantSpec, has_frame};
use super::reach::BoxSpec;
use super::script::{self, ScriptBeyondLimit};
use super::{InvalidRate, RateConfig, RatePlan};
use crumple_controllers::find_built_in;
use crumple_core::digest::sha256;
use crumple_core::text_file::{FileError, parse_toml};
use crumple_search::worst_case::covers_scenario;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file::{self, ScenarioFileError};
use crumple_sim::scenario::{Scenario, ScenarioSpec, built_in_scenario, built_in_scenario_names};
use crumple_spaces::ScenarioSpace;

/// Reason why a statement does not match its texts.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BindingError {
    /// A required text is missing.
    #[error("`{field}` is missing")]
    Missing {
        /// Field of the text.
        field: &'static str,
    },
    /// The text is not a valid scenario, space or box.
    #[error(transparent)]
    Text(ScenarioFileError),
    /// The box allows no claim.
    #[error("provenance.box_text: {0}")]
    Box(#[from] super::InvalidBox),
    /// The registration allows no claim.
    #[error(transparent)]
    Rate(#[from] InvalidRate),
    /// The scenario or space names a program that may not be started.
    #[error(transparent)]
    StartRefused(ScenarioFileError),
    /// Statement and text differ.
    #[error("`{field}` {problem}")]
    Differs {
        /// Field that differs.
        field: &'static str,
        /// Difference.
        problem: &'static str,
    },
}

impl From<FileError> for BindingError {
    fn from(error: FileError) -> Self {
        Self::Text(error.into())
    }
}

impl From<ScenarioFileError> for BindingError {
    fn from(error: ScenarioFileError) -> Self {
        if error.is_start_refused() {
            Self::StartRefused(error)
        } else {
            Self::Text(error)
        }
    }
}

/// Reason why a claim does not cover a scenario.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioMismatch {
    /// The scene, or the vehicles outside it, differ.
    #[error("the statement has other vehicles, another duration or another space")]
    OtherScene,
    /// The scenario has vehicles or controllers that such a claim cannot cover.
    #[error(transparent)]
    Scenario(#[from] super::InvalidBox),
    /// The claim does not cover the leader's profile.
    #[error(transparent)]
    Script(#[from] ScriptBeyondLimit),
    /// Step, duration or the follower's controller differ.
    #[error(
        "the time step, the duration or the follower's driver of the scenario differs from that of the statement"
    )]
    OtherRun,
    /// The policy is missing, or exceeds the limits of the vehicle under test.
    #[error("its vehicle under test cannot execute all commands of the policy")]
    OtherLimits,
    /// A quantity of the initial state is outside the box.
    #[error("its {field} is {value}, outside {} to {}", range[0], range[1])]
    Outside {
        /// Quantity as named in the statement, with its unit.
        field: &'static str,
        /// Value in the scenario.
        value: f64,
        /// Range of the statement.
        range: [f64; 2],
    },
}

/// Checks that the numbers of a statement match its texts. A statement about a policy needs the policy's file. A
/// certificate of version 1 has no texts; only the hash of a built-in scenario is compared. `controllers` opens the
/// drivers that texts name as files.
///
/// # Errors
/// [`BindingError`] names the difference.
pub fn check_binding(
    certificate: &Certificate,
    policy: Option<&[u8]>,
    controllers: Controllers,
) -> Result<(), BindingError> {
    if certificate.is_first_version() {
        return check_first_version(certificate, policy);
    }
    match certificate.statement.subject() {
        ClaimSubject::AnyVehicles | ClaimSubject::AnyNeighbours => Ok(()),
        ClaimSubject::InitialStates(claim) => check_box(certificate, claim, policy, controllers),
        ClaimSubject::Region(claim) => check_invariant(certificate, claim, policy, controllers),
        ClaimSubject::Runs(registration) => {
            check_registration(certificate, registration, controllers)
        }
        ClaimSubject::Scene { .. } => {
            if certificate.provenance.box_text.is_some() {
                let problem = "is a box of `avoid --box`, which crumple 0.3.0 removed: version 0.2.0 checks it";
                return Err(BindingError::Differs {
                    field: BOX_TEXT_FIELD,
                    problem,
                });
            }
            let is_about = covers_scenario(certificate, &read_scenario(certificate, controllers)?);
            if is_about {
                Ok(())
            } else {
                Err(scene_mismatch())
            }
        }
    }
}

fn check_first_version(
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> Result<(), BindingError> {
    let claimed = built_in_scenario_names()
        .iter()
        .filter_map(|(name, _)| built_in_scenario(name))
        .find(|scenario| {
            let sha256 = file::to_toml(scenario).map(sha256).unwrap_or_default();
            sha256 == certificate.provenance.scenario_sha256
        });
    match claimed {
        Some(scenario) if check_covers_scenario(certificate, &scenario, policy).is_err() => {
            Err(scene_mismatch())
        }
        _ => Ok(()),
    }
}

/// Checks that a claim covers a scenario. For a box, the initial state must be inside and all else equal. The profile
/// of a leader with free braking must stay within the limit.
///
/// # Errors
/// [`ScenarioMismatch`] names the difference.
pub fn check_covers_scenario(
    certificate: &Certificate,
    scenario: &Scenario,
    policy: Option<&[u8]>,
) -> Result<(), ScenarioMismatch> {
    let ClaimSubject::InitialStates(claim) = certificate.statement.subject() else {
        return if covers_scenario(certificate, scenario) {
            Ok(())
        } else {
            Err(ScenarioMismatch::OtherScene)
        };
    };
    let limit_mps2 = claim.leader_brakes_at_most_mps2;
    let starts = InitialSet::from_scenario(scenario, limit_mps2)?;
    if let (Some(limit_mps2), Some(leader)) = (limit_mps2, scenario.vehicles().first()) {
        let horizon_s = scenario.spec().step_s * scenario.steps() as f64;
        script::check_script_limits(leader, limit_mps2, horizon_s)?;
    }
    if !is_same_run(claim, &starts) {
        return Err(ScenarioMismatch::OtherRun);
    }
    if !can_execute_policy(policy, &starts) {
        return Err(ScenarioMismatch::OtherLimits);
    }
    let outside = BoxDimension::ALL.into_iter().find_map(|dimension| {
        let (outer, inner) = (claim.ranges.get(dimension), starts.ranges.get(dimension));
        let is_inside = outer.contains(inner.low()) && outer.contains(inner.high());
        let field = dimension.field_name();
        (!is_inside).then(|| ScenarioMismatch::Outside {
            field,
            value: inner.low(),
            range: [outer.low(), outer.high()],
        })
    });
    outside.map_or(Ok(()), Err)
}

/// Counts the last vehicles of a certificate's scenario that its scene leaves out; `None` without scene or scenario.
#[must_use]
pub fn count_omitted_vehicles(certificate: &Certificate) -> Option<usize> {
    let scene = certificate.statement.scene()?;
    let in_scene = 1 + scene.egos.len() + usize::from(scene.follower.is_some());
    let text = scenario_text(certificate).ok()?;
    let spec: ScenarioSpec = parse_toml(text, Path::new(SCENARIO_TEXT_FIELD)).ok()?;
    spec.vehicles.len().checked_sub(in_scene)
}

fn mismatch(field: &'static str, problem: &'static str) -> BindingError {
    BindingError::Differs { field, problem }
}

fn scene_mismatch() -> BindingError {
    mismatch(
        "statement",
        "does not match the scenario or box of `provenance`",
    )
}

fn scenario_text(certificate: &Certificate) -> Result<&String, BindingError> {
    certificate
        .provenance
        .scenario_text
        .as_ref()
        .ok_or(BindingError::Missing {
            field: SCENARIO_TEXT_FIELD,
        })
}

fn check_name(certificate: &Certificate, name: &str) -> Result<(), BindingError> {
    match name == certificate.provenance.scenario {
        true => Ok(()),
        false => Err(mismatch(
            "provenance.scenario",
            "differs from the name in `scenario_text`",
        )),
    }
}

fn read_scenario(
    certificate: &Certificate,
    controllers: Controllers,
) -> Result<Scenario, BindingError> {
    let scenario = file::from_toml(
        scenario_text(certificate)?,
        Path::new(SCENARIO_TEXT_FIELD),
        &controllers,
    )?;
    check_name(certificate, &scenario.spec().name)?;
    Ok(scenario)
}

fn is_same_run(claim: &ReachClaim, starts: &InitialSet) -> bool {
    (claim.step_s, claim.steps) == (starts.step_s, starts.steps)
        && (claim.follower_ttc_s, claim.follower_law.as_deref())
            == (starts.follower_ttc_s, starts.follower_law.as_ref())
}

const SCENARIO_TEXT_FIELD: &str = "provenance.scenario_text";
const BOX_TEXT_FIELD: &str = "provenance.box_text";

/// True if the vehicle can execute all commands of the policy, which the checker has validated.
fn can_execute_policy(policy: Option<&[u8]>, starts: &InitialSet) -> bool {
    policy
        .and_then(|bytes| NeuralController::from_bytes(bytes).ok())
        .is_some_and(|actor| starts.can_execute(actor.action_bounds_mps2))
}

/// Parses the text of a box or region, which must name the scenario of the certificate.
fn read_box<T>(
    certificate: &Certificate,
    parse: fn(&str, &Path) -> Result<T, FileError>,
    scenario: fn(&T) -> &String,
) -> Result<T, BindingError> {
    let text = certificate.provenance.box_text.as_ref();
    let text = text.ok_or(BindingError::Missing {
        field: BOX_TEXT_FIELD,
    })?;
    let spec = parse(text, Path::new(BOX_TEXT_FIELD))?;
    if *scenario(&spec) != certificate.provenance.scenario {
        return Err(mismatch(BOX_TEXT_FIELD, "belongs to another scenario"));
    }
    Ok(spec)
}

fn check_box(
    certificate: &Certificate,
    claim: &ReachClaim,
    policy: Option<&[u8]>,
    controllers: Controllers,
) -> Result<(), BindingError> {
    let scenario = read_scenario(certificate, controllers)?;
    let spec = read_box(certificate, BoxSpec::from_toml, |spec| &spec.scenario)?;
    let starts = InitialSet::new(&scenario, &spec)?;
    if !is_same_run(claim, &starts)
        || claim.ranges != starts.ranges
        || claim.observation_error != spec.observation_error
        || claim.leader_brakes_at_most_mps2 != starts.leader_brakes_at_most_mps2
    {
        return Err(scene_mismatch());
    }
    if can_execute_policy(policy, &starts) {
        Ok(())
    } else {
        Err(mismatch(
            "policy_file",
            "commands accelerations that the vehicle cannot execute",
        ))
    }
}

fn check_invariant(
    certificate: &Certificate,
    claim: &InvariantClaim,
    policy: Option<&[u8]>,
    controllers: Controllers,
) -> Result<(), BindingError> {
    let scenario = read_scenario(certificate, controllers)?;
    let spec = read_box(certificate, InvariantSpec::from_toml, |spec| &spec.scenario)?;
    // The checker has compared the digest of the policy.
    let frame = spec.frame(&scenario, claim.network().and(policy))?;
    if has_frame(claim, frame) {
        Ok(())
    } else {
        Err(scene_mismatch())
    }
}

pub(super) fn read_space(
    certificate: &Certificate,
    controllers: Controllers,
) -> Result<ScenarioSpace, BindingError> {
    let space = crumple_spaces::file::from_toml(
        scenario_text(certificate)?,
        Path::new(SCENARIO_TEXT_FIELD),
        &controllers,
    )?;
    check_name(certificate, space.name())?;
    Ok(space)
}

pub(super) fn rebuild_plan(
    space: ScenarioSpace,
    registration: &Registration,
    (controller, second_controller): (NamedController, Option<NamedController>),
) -> Result<RatePlan, BindingError> {
    let estimator = EstimatorKind::ALL
        .into_iter()
        .find(|kind| kind.name() == configuration_value(registration, "estimator"));
    let estimator = estimator.ok_or_else(|| {
        mismatch(
            "registration.configuration.estimator",
            "is not a known estimator",
        )
    })?;
    let seed = configuration_value(registration, "seed")
        .parse()
        .map_err(|_| mismatch("registration.configuration.seed", "must be a whole number"))?;
    Ok(RatePlan::new(RateConfig {
        controller,
        second_controller,
        space,
        seed,
        estimator,
        runs: registration.runs,
        confidence: registration.confidence,
    })?)
}

/// Returns a value of the registered configuration; empty if it has none.
pub(super) fn configuration_value<'a>(registration: &'a Registration, key: &str) -> &'a str {
    registration
        .configuration
        .get(key)
        .map_or("", String::as_str)
}

/// Returns the controllers of a registration if all are built in. A name in a certificate never opens a file or starts
/// a program.
pub(super) fn built_in_controllers(
    registration: &Registration,
) -> Option<(NamedController, Option<NamedController>)> {
    let first = find_built_in(registration.configuration.get("controller")?)?;
    let second = registration.configuration.get("against");
    match second {
        None => Some((first, None)),
        Some(name) => Some((first, Some(find_built_in(name)?))),
    }
}

fn check_registration(
    certificate: &Certificate,
    registration: &Registration,
    opener: Controllers,
) -> Result<(), BindingError> {
    let space = read_space(certificate, opener)?;
    let text = crumple_spaces::file::to_identity_toml(&space).unwrap_or_default();
    if sha256(text) != configuration_value(registration, "space_sha256") {
        return Err(mismatch(
            "provenance.scenario_text",
            "differs from what this program writes for the space",
        ));
    }
    // Other releases may use these names for other controllers.
    if configuration_value(registration, "crumple") != env!("CARGO_PKG_VERSION") {
        return Ok(());
    }
    let Some(controllers) = built_in_controllers(registration) else {
        return Ok(());
    };
    let plan = rebuild_plan(space, registration, controllers)?;
    match plan.registration() == registration {
        true => Ok(()),
        false => Err(mismatch(
            "registration",
            "does not match the controllers and space that it names",
        )),
    }
}
