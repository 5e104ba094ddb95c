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
                .map(|ConstantPiece(steps, accel_mps2)| {
                    ConstantPiece(steps, Interval::point(accel_mps2))
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
        .map(|steps_mps2| run_length_encode(steps_mps2))
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
    let text = file::to_toml(scenario).map_err(|error| UndecidedReason::Unwritable {
        why: error.to_string(),
    })?;
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
    let gap_claim = GapClaim { problem, gap_m };
    let late_branches = search
        .proofs
        .iter()
        .filter_map(|proof| Some((gap_claim.first_closed(proof)?, proof)));
    let (first_late, late) = late_branches.min_by_key(|(first, _)| *first)?;
    let mut branches = Vec::new();
    let mut last_used: Option<&DualProof> = None;
    for firing in 0..first_late {
        let mut candidates = last_used.into_iter().chain(&search.proofs);
        if let Some(proof) = candidates.find(|proof| gap_claim.is_closed(proof, firing, true)) {
            branches.push(build_branch(problem, proof, [firing, firing], true, gap_m));
            last_used = Some(proof);
        } else {
            let proof = gap_claim.standstill_proof(firing)?;
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

/// The claim that no profile keeps every gap at `gap_m`.
struct GapClaim<'p> {
    problem: &'p AvoidanceProblem,
    gap_m: f64,
}

impl GapClaim<'_> {
    /// Returns true if a proof holds for a firing, with some margin; `fired` states that the guard has fired by then.
    fn is_closed(&self, proof: &DualProof, firing: usize, fired: bool) -> bool {
        proof.excess(self.problem, firing, fired, self.gap_m) > ROUNDING_MARGIN
    }

    /// Returns the first firing from which a proof holds for all; `None` if it holds for none.
    fn first_closed(&self, proof: &DualProof) -> Option<usize> {
        let never = self.problem.never_firing();
        if !self.is_closed(proof, never, false) {
            return None;
        }
        let mut open = 0;
        let mut closed = never;
        while open < closed {
            let middle = usize::midpoint(open, closed);
            if self.is_closed(proof, middle, false) {
                closed = middle
            } else {
                open = middle + 1
            }
        }
        Some(closed)
    }

    /// Returns a proof from the standstill of all vehicles, with as few instants as suffice.
    fn standstill_proof(&self, firing: usize) -> Option<DualProof> {
        [100, 20, 5, 1]
            .into_iter()
            .map(|spacing| {
                let multipliers = Multipliers::for_standstill(self.problem, firing, spacing);
                DualProof::new(self.problem, multipliers)
            })
            .find(|proof| self.is_closed(proof, firing, true))
    }
}

fn build_branch(
    problem: &AvoidanceProblem,
    proof: &DualProof,
    [first, last]: [usize; 2],
    fired: bool,
    gap_m: f64,
) -> Branch {
    let exact = proof.multipliers(fired);
    let rounded = round_multipliers(&exact);
    let holds = DualProof::new(problem, rounded.clone()).excess(problem, first, fired, gap_m)
        > ROUNDING_MARGIN;
    let Multipliers {
        front,
        between,
        rear,
        speed,
        fired,
    } = if holds { rounded } else { exact };
    Branch {
        first: step_count(first),
        last: step_count(last),
        front: branch_rows(front),
        between: branch_row_lists(between),
        rear: branch_rows(rear),
        speed: branch_row_lists(speed),
        unfired: Vec::new(),
        fired,
    }
}

/// Converts multipliers to rows of a branch: step and value.
fn branch_rows(list: Vec<WeightedInstant>) -> Vec<(u32, f64)> {
    list.into_iter()
        .map(|(step, value)| (step_count(step), value))
        .collect()
}

/// Converts one list per ego; none if all are empty.
fn branch_row_lists(lists: Vec<Vec<WeightedInstant>>) -> Vec<Vec<(u32, f64)>> {
    if lists.iter().all(Vec::is_empty) {
        return Vec::new();
    }
    lists.into_iter().map(branch_rows).collect()
}

/// Rounds multipliers to 20 bits and drops negligible ones.
fn round_multipliers(multipliers: &Multipliers) -> Multipliers {
    let mut rounded = multipliers.clone();
    let lists = [&mut rounded.front, &mut rounded.rear]
        .into_iter()
        .chain(&mut rounded.between)
        .chain(&mut rounded.speed);
    for list in lists {
        for (_, value) in list.iter_mut() {
            *value = round_to_20_bits(*value);
        }
        list.retain(|(_, value)| *value > 0.0);
    }
    rounded.fired = round_to_20_bits(rounded.fired);
    rounded
}

fn round_to_20_bits(value: f64) -> f64 {
    const UNIT: f64 = (1_u64 << 20) as f64;
    (value * UNIT).round() / UNIT
}

fn run_length_encode<T: Copy + PartialEq>(values: &[T]) -> Vec<ConstantPiece<T>> {
    values
        .chunk_by(|a, b| a == b)
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
            problem.escape_caveat.is_none()
                && problem.proof_caveat.is_none()
                && problem
                    .dead_steps
                    .iter()
                    .zip(profile)
                    .all(|(&dead_steps, witness)| begins_with_coasting(witness, dead_steps))
        }
    }
}

fn begins_with_coasting(witness: &[ConstantPiece<f64>], steps: usize) -> bool {
    witness
        .iter()
        .flat_map(|ConstantPiece(steps, value)| std::iter::repeat_n(*value, *steps as usize))
        .take(steps)
        .all(|value| value == 0.0)
}
