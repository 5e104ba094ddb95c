//! Certificates that `crumple-verify` checks without the simulator and the solver.

use crumple_verify::{
    Assumption, AvoidableClaim, Branch, Certificate, CertificateProvenance, ClaimSubject,
    ConstantPiece, GapBoundClaim, Interval, Scene, SceneLeader, Statement, UnavoidableClaim,
};

use super::avoidance_problem::AvoidanceProblem;
use super::firing_search::FiringSearch;
use super::multipliers::{DualProof, Multipliers, ROUNDING_MARGIN, WeightedInstant};
use super::reason::UndecidedReason;
use crumple_core::digest::sha256;
use crumple_sim::scenario::{Scenario, file};

fn build_scene(problem: &AvoidanceProblem) -> Scene {
    let AvoidanceProblem {
        leader,
        egos,
        follower,
        ..
    } = problem;
    Scene {
        step_s: problem.step_s,
        steps: step_count(problem.steps),
        leader: SceneLeader {
            position_m: Interval::point(leader.position_m),
            length_m: leader.length_m,
            speed_mps: Interval::point(leader.speed_mps),
            acceleration_mps2: run_length_encode(&leader.acceleration_mps2)
                .into_iter()
                .map(|ConstantPiece(steps, held_mps2)| {
                    ConstantPiece(steps, Interval::point(held_mps2))
                })
                .collect(),
        },
        egos: egos.clone(),
        follower: follower.clone(),
    }
}

pub(super) fn avoidable(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    acceleration_mps2: &[Vec<f64>],
    min_gap_m_at_least: Option<f64>,
) -> Result<Certificate, UndecidedReason> {
    let witness = acceleration_mps2
        .iter()
        .map(|each| run_length_encode(each))
        .collect();
    let statement = AvoidableClaim {
        scene: build_scene(problem),
        witness,
        min_gap_m_at_least,
    };
    wrap_statement(scenario, Statement::Avoidable(statement))
}

/// Returns the certificate that there is no escape; `None` if the search has not closed every branch.
pub(super) fn unavoidable(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    search: &FiringSearch<'_>,
) -> Result<Option<Certificate>, UndecidedReason> {
    let Some(branches) = closing_branches(problem, search, 0.0) else {
        return Ok(None);
    };
    wrap_statement(
        scenario,
        Statement::Unavoidable(UnavoidableClaim {
            scene: build_scene(problem),
            branches,
        }),
    )
    .map(Some)
}

/// Returns the certificate that no profile keeps every gap at `gap_m`; `None` if some branch has no proof.
pub(super) fn gap_bound(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    search: &FiringSearch<'_>,
    gap_m: f64,
) -> Result<Option<Certificate>, UndecidedReason> {
    let Some(branches) = closing_branches(problem, search, gap_m) else {
        return Ok(None);
    };
    let statement = GapBoundClaim {
        scene: build_scene(problem),
        gap_m,
        branches,
    };
    wrap_statement(scenario, Statement::GapBound(statement)).map(Some)
}

fn wrap_statement(
    scenario: &Scenario,
    statement: Statement,
) -> Result<Certificate, UndecidedReason> {
    let unwritable = |error: toml::ser::Error| UndecidedReason::Unwritable {
        why: error.to_string(),
    };
    let text = file::to_toml(scenario).map_err(unwritable)?;
    let mut certificate =
        build_certificate(scenario.spec().name.clone(), Some(text), None, statement);
    certificate
        .assumptions
        .extend(relies_on_noise(scenario).then_some(Assumption::NoiseOfSeed));
    Ok(certificate)
}

fn relies_on_noise(scenario: &Scenario) -> bool {
    scenario
        .vehicles()
        .first()
        .is_some_and(|leader| leader.acceleration_noise_mps2 > 0.0)
}

/// Creates a certificate of a statement, with its assumptions, about a scenario or space, and perhaps a box around it.
#[must_use]
pub fn build_certificate(
    scenario: String,
    scenario_text: Option<String>,
    box_text: Option<String>,
    statement: Statement,
) -> Certificate {
    let scenario_sha256 = scenario_text.as_ref().map(sha256).unwrap_or_default();
    let crumple = env!("CARGO_PKG_VERSION").to_owned();
    Certificate {
        version: crumple_verify::certificate::VERSION,
        provenance: CertificateProvenance {
            crumple,
            scenario,
            scenario_sha256,
            scenario_text,
            box_text,
        },
        assumptions: statement.assumptions(),
        statement,
    }
}

/// Returns branches that prove, for every firing, that no profile keeps every gap at `gap_m`. One branch covers all
/// late firings: a follower that brakes later is further ahead, so a contradiction with the first of these firings
/// holds for the later ones, too.
fn closing_branches(
    problem: &AvoidanceProblem,
    search: &FiringSearch<'_>,
    gap_m: f64,
) -> Option<Vec<Branch>> {
    let never = problem.never_firing();
    let closes = |proof: &DualProof, firing: usize, fired: bool| {
        proof.excess(problem, firing, fired, gap_m) > ROUNDING_MARGIN
    };
    let earliest = |proof: &DualProof| -> Option<usize> {
        let (mut open, mut closed) = (0, never);
        if !closes(proof, never, false) {
            return None;
        }
        while open < closed {
            let middle = usize::midpoint(open, closed);
            if closes(proof, middle, false) {
                closed = middle
            } else {
                open = middle + 1
            }
        }
        Some(closed)
    };
    let merged = search
        .proofs
        .iter()
        .filter_map(|proof| Some((earliest(proof)?, proof)));
    let (first_late, late) = merged.min_by_key(|(first, _)| *first)?;
    let mut branches = Vec::new();
    let mut last_used: Option<&DualProof> = None;
    for firing in 0..first_late {
        let mut candidates = last_used.into_iter().chain(&search.proofs);
        if let Some(proof) = candidates.find(|proof| closes(proof, firing, true)) {
            branches.push(build_branch(problem, proof, [firing, firing], true, gap_m));
            last_used = Some(proof);
        } else {
            let standing = [100, 20, 5, 1]
                .map(|spacing| Multipliers::for_standstill(problem, firing, spacing));
            let mut standing = standing
                .into_iter()
                .map(|multipliers| DualProof::new(problem, multipliers));
            let proof = standing.find(|proof| closes(proof, firing, true))?;
            branches.push(build_branch(problem, &proof, [firing, firing], true, gap_m));
        }
    }
    // Without a follower one branch covers everything.
    branches.push(build_branch(
        problem,
        late,
        [first_late, problem.steps],
        false,
        gap_m,
    ));
    Some(branches)
}

fn build_branch(
    problem: &AvoidanceProblem,
    proof: &DualProof,
    [first, last]: [usize; 2],
    fired: bool,
    gap_m: f64,
) -> Branch {
    let exact = proof.multipliers(fired);
    let short = round_multipliers(&exact);
    let holds = DualProof::new(problem, short.clone()).excess(problem, first, fired, gap_m)
        > ROUNDING_MARGIN;
    let Multipliers {
        front,
        between,
        rear,
        speed,
        fired,
    } = if holds { short } else { exact };
    let rows = |list: Vec<WeightedInstant>| {
        list.into_iter()
            .map(|(step, value)| (step_count(step), value))
            .collect()
    };
    Branch {
        first: step_count(first),
        last: step_count(last),
        front: rows(front),
        between: if between.iter().all(Vec::is_empty) {
            Vec::new()
        } else {
            between.into_iter().map(rows).collect()
        },
        rear: rows(rear),
        speed: if speed.iter().all(Vec::is_empty) {
            Vec::new()
        } else {
            speed.into_iter().map(rows).collect()
        },
        unfired: Vec::new(),
        fired,
    }
}

/// Rounds multipliers to 20 bits and drops negligible ones.
fn round_multipliers(multipliers: &Multipliers) -> Multipliers {
    let mut short = multipliers.clone();
    let lists = [&mut short.front, &mut short.rear]
        .into_iter()
        .chain(&mut short.between)
        .chain(&mut short.speed);
    const UNIT: f64 = (1_u64 << 20) as f64;
    let round = |value: f64| (value * UNIT).round() / UNIT;
    for list in lists {
        for (_, value) in list.iter_mut() {
            *value = round(*value);
        }
        list.retain(|(_, value)| *value > 0.0);
    }
    short.fired = round(short.fired);
    short
}

fn run_length_encode<T: Copy + PartialEq>(each: &[T]) -> Vec<ConstantPiece<T>> {
    each.chunk_by(|a, b| a == b)
        .filter_map(|run| Some(ConstantPiece(step_count(run.len()), *run.first()?)))
        .collect()
}

/// Converts a number of steps to the type of the file; scenarios have far fewer than its maximum.
fn step_count(steps: usize) -> u32 {
    u32::try_from(steps).unwrap_or(u32::MAX)
}

/// Returns true if a certificate's claim is about the scene of a scenario, everything modelled. Noise is covered only
/// if the certificate assumes its seed. The stated origin is ignored.
#[must_use]
pub fn covers_scenario(certificate: &Certificate, scenario: &Scenario) -> bool {
    let Ok(problem) = AvoidanceProblem::new(scenario) else {
        return false;
    };
    is_modelled(certificate, scenario, &problem)
        && certificate.statement.scene() == Some(&build_scene(&problem))
}

/// Returns true if the claim models everything in a scenario.
fn is_modelled(certificate: &Certificate, scenario: &Scenario, problem: &AvoidanceProblem) -> bool {
    if relies_on_noise(scenario) && !certificate.assumptions.contains(&Assumption::NoiseOfSeed) {
        return false;
    }
    let ClaimSubject::Scene { profile, .. } = certificate.statement.subject() else {
        return false;
    };
    match profile {
        // A proof covers any follower and any delay of the vehicles under test.
        None => problem.proof_caveat.is_none(),
        Some(profile) => {
            let waits = |(&dead_steps, witness): (&usize, &Vec<ConstantPiece<f64>>)| {
                let held = witness.iter().flat_map(|ConstantPiece(steps, value)| {
                    std::iter::repeat_n(*value, *steps as usize)
                });
                held.take(dead_steps).all(|value| value == 0.0)
            };
            problem.escape_caveat.is_none()
                && problem.proof_caveat.is_none()
                && problem.dead_steps.iter().zip(profile).all(waits)
        }
    }
}
