//! Scope of a claim: time, vehicles and limits. Without it a printed claim overstates: "no gap is ever smaller" may
//! cover only four seconds.

use std::fmt;

use crate::certificate::{Certificate, Statement};
use crate::claim::{ConstantPiece, Scene, SceneEgo};
use crate::interval::Interval;
use crate::invariant::{InvariantClaim, InvariantController, MotionModel};
use crate::kernel::KernelClaim;
use crate::rate::Registration;
use crate::reach::{BoxDimension, NetworkFileSource, ReachClaim};

const NO_VEHICLE_BEHIND: &str = "behind: no vehicle";

/// The subject of a statement in words, without its claim.
#[derive(Debug, Clone, PartialEq)]
pub struct Scope {
    /// Covered time in seconds; infinite for an unlimited claim, `None` if unstated.
    pub horizon_s: Option<f64>,
    /// True if checking also establishes safety after that time.
    pub covers_after_horizon: bool,
    /// Scenario, box or space, and its binding to the statement.
    pub about: String,
    /// Each vehicle except those behind, front to rear, with its initial state and possible behaviour.
    pub vehicles: Vec<String>,
    /// Claim about vehicles behind the last one under test; `None` for a claim about a scenario space.
    pub behind: Option<String>,
    /// Other limits.
    pub limits: Vec<String>,
}

impl Certificate {
    /// Returns the scope of the claim.
    #[must_use]
    pub fn scope(&self) -> Scope {
        let mut scope = match &self.statement {
            Statement::Avoidable(claim) => scene_scope(&claim.scene),
            Statement::Unavoidable(claim) => scene_scope(&claim.scene),
            Statement::GapBound(claim) => scene_scope(&claim.scene),
            Statement::Kernel(claim) => kernel_scope(claim),
            Statement::Rate(claim) => runs_scope(&claim.registration),
            Statement::Comparison(claim) => runs_scope(&claim.registration),
            Statement::Reach(claim) => reach_scope(claim),
            Statement::Invariant(claim) => invariant_scope(claim),
        };
        scope.about = self.describe_subject();
        scope.covers_after_horizon = matches!(self.statement, Statement::Avoidable(_));
        scope
    }

    /// Returns the scope of a claim about a scenario that has `left_out` vehicles more behind than the claim.
    #[must_use]
    pub fn scope_with_uncovered_vehicles(&self, left_out: usize) -> Scope {
        let mut scope = self.scope();
        let vehicles = if left_out == 1 { "vehicle" } else { "vehicles" };
        let is_followed = self
            .statement
            .scene()
            .is_some_and(|scene| scene.follower.is_some());
        scope.behind = match (scope.behind.filter(|_| is_followed), left_out) {
            (behind, 0) => Some(behind.unwrap_or_else(|| NO_VEHICLE_BEHIND.to_owned())),
            (Some(behind), _) => Some(format!(
                "{behind}\nfarther behind: {left_out} {vehicles}, not part of the claim"
            )),
            (None, _) => Some(format!(
                "behind: {left_out} {vehicles}, not part of the claim"
            )),
        };
        scope
    }

    fn describe_subject(&self) -> String {
        let (name, sha256) = (&self.provenance.scenario, &self.provenance.scenario_sha256);
        // The author of the file chose the name: it must not control a terminal.
        let name = name.escape_debug();
        if self.is_first_version() {
            return format!(
                "`{name}`, as the file states; version 1 does not bind the statement to a text"
            );
        }
        match &self.statement {
            Statement::Kernel(_) => "any two vehicles with these limits".to_owned(),
            Statement::Rate(_) | Statement::Comparison(_) => {
                format!("space `{name}`, SHA-256 {sha256}")
            }
            Statement::Invariant(_) => format!("the limits of scenario `{name}`, SHA-256 {sha256}"),
            _ if self.provenance.box_text.is_some() => {
                format!("a box around scenario `{name}`, SHA-256 {sha256}")
            }
            _ => format!("scenario `{name}`, SHA-256 {sha256}"),
        }
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            horizon_s,
            covers_after_horizon: has_afterwards,
            about,
            vehicles,
            behind,
            limits,
        } = self;
        writeln!(out, "about {about}")?;
        match horizon_s {
            Some(f64::INFINITY) => write!(out, "for ever")?,
            Some(horizon_s) if *has_afterwards => write!(out, "for {horizon_s} s from the start")?,
            Some(horizon_s) => write!(out, "for {horizon_s} s from the start and no longer")?,
            None => write!(out, "horizon not stated")?,
        }
        vehicles
            .iter()
            .chain(behind)
            .chain(limits)
            .try_for_each(|line| write!(out, "\n{line}"))
    }
}

fn format_range(of: Interval) -> String {
    if of.low() == of.high() {
        of.low().to_string()
    } else {
        format!("{} to {}", of.low(), of.high())
    }
}

fn partial_scope(horizon_s: Option<f64>, vehicles: Vec<String>, limits: Vec<String>) -> Scope {
    Scope {
        horizon_s,
        covers_after_horizon: false,
        about: String::new(),
        vehicles,
        behind: None,
        limits,
    }
}

fn scene_scope(scene: &Scene) -> Scope {
    let leader = &scene.leader;
    let script = &leader.acceleration_mps2;
    let ends = |held: &ConstantPiece<Interval>| [held.1.low(), held.1.high()];
    let hull = script
        .iter()
        .map(ends)
        .reduce(|hull, ends| [hull[0].min(ends[0]), hull[1].max(ends[1])]);
    let script = match hull.and_then(|[low, high]| Interval::new(low, high)) {
        Some(accelerations) => format!(
            "a script of {} pieces at {} m/s²",
            script.len(),
            format_range(accelerations)
        ),
        None => "no script".to_owned(),
    };
    let start = |position_m: Interval, speed_mps: Interval| {
        format!(
            "front bumper at {} m, {} m/s",
            format_range(position_m),
            format_range(speed_mps)
        )
    };
    let mut vehicles = vec![format!(
        "leader: {}, {} m long, {script}",
        start(leader.position_m, leader.speed_mps),
        leader.length_m
    )];
    vehicles.extend(scene.egos.iter().map(|ego| {
        let SceneEgo { position_m, length_m, speed_mps, max_brake_mps2, max_accel_mps2 } = ego;
        format!(
            "under test: {}, {length_m} m long, brakes at up to {max_brake_mps2} and accelerates at up to \
             {max_accel_mps2} m/s²",
            start(*position_m, *speed_mps)
        )
    }));
    let behind = match &scene.follower {
        Some(follower) => format!(
            "behind: {}, brakes at {} m/s² from {} steps after its time to collision falls below {} s",
            start(follower.position_m, follower.speed_mps),
            format_range(follower.brake_mps2),
            follower.reaction_steps,
            follower.ttc_s
        ),
        None => "behind: no vehicle is part of the claim".to_owned(),
    };
    let limits = vec![format!("{} steps of {} s", scene.steps, scene.step_s)];
    Scope {
        behind: Some(behind),
        ..partial_scope(Some(scene.horizon_s()), vehicles, limits)
    }
}

fn kernel_scope(kernel: &KernelClaim) -> Scope {
    // Texts from a file must not control a terminal.
    let [b, c, step_s, margin_m] = [
        &kernel.ego_brake_mps2,
        &kernel.leader_brake_mps2,
        &kernel.step_s,
        &kernel.margin_m,
    ]
    .map(|text| text.escape_debug());
    let vehicles = vec![
        format!("ahead: never brakes harder than {c} m/s², and does not reverse"),
        format!("own: can brake at {b} m/s² from every decision on"),
    ];
    let limits = vec![format!(
        "for any step and margin, {step_s} s and {margin_m} m among them; real numbers, the true state, neither lag \
         nor delay"
    )];
    let behind = Some("behind: not considered".to_owned());
    Scope {
        behind,
        ..partial_scope(Some(f64::INFINITY), vehicles, limits)
    }
}

fn runs_scope(registration: &Registration) -> Scope {
    let of = |key: &str| {
        registration
            .configuration
            .get(key)
            .map_or("", String::as_str)
            .escape_debug()
    };
    let horizon_s = registration
        .configuration
        .get("horizon_s")
        .and_then(|text| text.parse().ok());
    let controller = |place: &str| {
        format!(
            "under test: {}, SHA-256 {}, with estimator {}",
            of(place),
            of(&format!("{place}_sha256")),
            of("estimator")
        )
    };
    let mut vehicles = vec![controller("controller")];
    if registration.configuration.contains_key("against") {
        vehicles.push(controller("against"));
    }
    let (runs, seed) = (registration.runs, of("seed"));
    // Registrations are hashed, so they keep the earlier wording.
    let failure = of("failure")
        .to_string()
        .replacen("vehicles touch", "collision", 1);
    let limits = vec![format!(
        "{runs} random scenarios, seed {seed}; a failure is: {failure}"
    )];
    partial_scope(horizon_s, vehicles, limits)
}

fn describe_network(digest: &str, source: Option<&NetworkFileSource>) -> String {
    let digest = digest.escape_debug();
    match source {
        None => format!("policy with SHA-256 {digest}"),
        Some(NetworkFileSource { format, sha256 }) => format!(
            "network with SHA-256 {digest}, read from a file in the format {} with SHA-256 {}",
            format.name(),
            sha256.escape_debug()
        ),
    }
}

fn reach_scope(claim: &ReachClaim) -> Scope {
    let of = |dimension| format_range(claim.ranges.get(dimension));
    let onset = claim.ranges.onset_steps;
    let onset_s = match Interval::new(onset.low() * claim.step_s, onset.high() * claim.step_s) {
        Some(onset_s) => format_range(onset_s),
        None => "no time".to_owned(),
    };
    let leader_brakes = match claim.leader_brakes_at_most_mps2 {
        Some(limit_mps2) => {
            format!(
                "never speeds up, and brakes as it likes: over each step at another rate from 0 to {limit_mps2} m/s²"
            )
        }
        None => format!(
            "brakes at {} m/s² from {onset_s} s on",
            of(BoxDimension::LeaderBrakeMps2)
        ),
    };
    let vehicles = vec![
        format!(
            "leader: {} m ahead, {} m/s, {leader_brakes}",
            of(BoxDimension::GapAheadM),
            of(BoxDimension::LeaderSpeedMps)
        ),
        format!(
            "under test: {} m/s, driven by the {}",
            of(BoxDimension::EgoSpeedMps),
            describe_network(&claim.policy_sha256, claim.source.as_ref())
        ),
    ];
    let followed = |how: String| {
        let [gap_m, speed_mps] = [BoxDimension::GapBehindM, BoxDimension::FollowerSpeedMps].map(of);
        format!("behind: {gap_m} m behind, {speed_mps} m/s, {how}")
    };
    let brake_mps2 = of(BoxDimension::FollowerBrakeMps2);
    let behind = match (claim.follower_ttc_s, &claim.follower_law) {
        (Some(ttc_s), _) => followed(format!(
            "brakes at {brake_mps2} m/s² once its time to collision falls below {ttc_s} s"
        )),
        (None, Some(law)) => {
            let accel_mps2 = law.max_accel_mps2();
            followed(format!(
                "{law}; it brakes at up to {brake_mps2} and accelerates at up to {accel_mps2} m/s²"
            ))
        }
        (None, None) => NO_VEHICLE_BEHIND.to_owned(),
    };
    let limits = vec![
        format!("{} steps of {} s", claim.steps, claim.step_s),
        reach_errors(claim),
    ];
    Scope {
        behind: Some(behind),
        ..partial_scope(Some(claim.horizon_s()), vehicles, limits)
    }
}

/// Describes the observation errors of a reach claim; those of a follower only if there is one.
fn reach_errors(claim: &ReachClaim) -> String {
    let [
        gap,
        gap_behind,
        leader,
        own,
        follower,
        leader_mps2,
        own_mps2,
        follower_mps2,
    ] = claim.observation_error;
    let mut errors = vec![
        ("gap ahead", gap, "m"),
        ("leader's speed", leader, "m/s"),
        ("own speed", own, "m/s"),
        ("leader's acceleration", leader_mps2, "m/s²"),
        ("own acceleration", own_mps2, "m/s²"),
    ];
    if claim.follower_ttc_s.is_some() || claim.follower_law.is_some() {
        errors.extend([
            ("gap behind", gap_behind, "m"),
            ("follower's speed", follower, "m/s"),
            ("follower's acceleration", follower_mps2, "m/s²"),
        ]);
    }
    describe_errors(&errors)
}

/// Describes the observation errors of an invariant claim. A network may observe any acceleration within the limits.
fn invariant_errors(claim: &InvariantClaim) -> String {
    let [gap, own, leader] = claim.observation_error;
    let errors = describe_errors(&[
        ("gap", gap, "m"),
        ("own speed", own, "m/s"),
        ("leader's speed", leader, "m/s"),
    ]);
    match &claim.controller {
        InvariantController::Law(_) => errors,
        InvariantController::Network(_) => {
            format!("{errors}; observed accelerations are any within the limits of the vehicles")
        }
    }
}

/// Describes the largest error of each observed quantity, given as name, error and unit.
fn describe_errors(errors: &[(&str, f64, &str)]) -> String {
    let errors: Vec<_> = errors
        .iter()
        .map(|(quantity, error, unit)| format!("{quantity} {} {unit}", format_number(*error)))
        .collect();
    format!("largest observation errors: {}", errors.join(", "))
}

fn invariant_scope(claim: &InvariantClaim) -> Scope {
    let [own, leader] = claim.axes;
    let driver = match &claim.controller {
        InvariantController::Law(law) => law.to_string(),
        InvariantController::Network(network) => {
            format!(
                "driven by the {}",
                describe_network(&network.policy_sha256, network.source.as_ref())
            )
        }
    };
    let [brake, accel] = claim.own_mps2;
    let accelerates = match claim.leader_mps2 {
        [0.0, 0.0] => "constant".to_owned(),
        [least, most] => format!("accelerates as it likes from {least} to {most} m/s²"),
    };
    let (leader, speed) = match claim.motion {
        MotionModel::Absolute => (
            format!(
                "leader: {} to {} m/s, {accelerates}",
                round_up(leader.low),
                round_down(leader.high)
            ),
            "speed",
        ),
        MotionModel::Relative => (
            format!("leader: any speed, {accelerates}; no standstill"),
            "closing speed",
        ),
    };
    let own = format!(
        "under test: {speed} up to {} m/s (at the start up to {}), from {brake} to {accel} m/s², {driver}",
        round_down(own.high),
        round_down(claim.initial_own_mps_at_most)
    );
    let ends = claim
        .ends_beyond_gap_m
        .map(|gap_m| format!("until a gap exceeds {gap_m} m"));
    let decides = match claim.decision_steps {
        1 => format!("a decision in each step of {} s", claim.step_s),
        steps => format!("a decision every {steps} steps of {} s", claim.step_s),
    };
    let limits = [decides, invariant_errors(claim)]
        .into_iter()
        .chain(ends)
        .collect();
    let behind = match &claim.controller {
        InvariantController::Law(_) => "behind: not considered",
        InvariantController::Network(_) => NO_VEHICLE_BEHIND,
    };
    Scope {
        behind: Some(behind.to_owned()),
        ..partial_scope(Some(f64::INFINITY), vec![leader, own], limits)
    }
}

/// Rounds a lower bound down to four significant digits.
pub(crate) fn round_down(bound: f64) -> f64 {
    round_towards(bound, -1)
}

/// Rounds an upper bound up to four significant digits.
pub(crate) fn round_up(bound: f64) -> f64 {
    round_towards(bound, 1)
}

/// Rounds to four significant digits, up for a `direction` of 1 and down for -1. Returns a shorter number unchanged.
fn round_towards(bound: f64, direction: i64) -> f64 {
    let shortest = format!("{bound:e}");
    let Some((mantissa, exponent)) = shortest.split_once('e') else {
        return bound;
    };
    let digits = mantissa.replace('.', "");
    let most = 4 + usize::from(bound < 0.0);
    let kept: Option<i64> = digits.get(..most).and_then(|kept| kept.parse().ok());
    let (Some(kept), Ok(exponent), true) = (kept, exponent.parse::<i32>(), digits.len() > most)
    else {
        return bound;
    };
    // Dropping digits rounds towards zero.
    let is_outward = (bound > 0.0) == (direction > 0);
    let kept = if is_outward { kept + direction } else { kept };
    format!("{kept}e{}", exponent - 3).parse().unwrap_or(bound)
}

/// Formats a number; with an exponent only where it would have many zeros.
pub(crate) fn format_number(number: f64) -> String {
    match number == 0.0 || (1e-4..1e7).contains(&number.abs()) {
        true => number.to_string(),
        false => format!("{number:e}"),
    }
}
