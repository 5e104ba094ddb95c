//! Decision whether any driver could have avoided a collision.

use crumple_verify::{Certificate, ProvedClaim, Statement};

use super::avoidance::{Avoidance, AvoidanceVerdict, Optimality};
use super::avoidance_problem::AvoidanceProblem;
use super::certificate;
use super::closed_loop::{self, SearchEffort};
use super::escape::{Escape, step_accelerations_mps2};
use super::firing_search::{FiringSearch, ModelEscape};
use super::program::Grid;
use super::reason::UndecidedReason;
use crumple_sim::scenario::{MAX_MULTIPLE, Scenario, whole_multiple};

/// Options of the search for an escape.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AvoidOptions {
    /// Time over which the accelerations of an escape are held, in seconds: a multiple of the scenario's step. If it is
    /// too coarse to decide, the step itself is used. `None` means about a tenth of a second.
    pub grid_s: Option<f64>,
    /// True to certify, for an avoidable collision, an upper bound of the smallest gap of any profile.
    pub certify_bound: bool,
    /// Extent of the simulations if the convex programs do not model every driver.
    pub effort: SearchEffort,
}

/// An error of invalid options.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AvoidError {
    /// The grid does not fit the scenario.
    #[error(
        "a grid of {grid_s:?} s is not the scenario's step of {step_s:?} s times a whole number from 1 to \
         {MAX_MULTIPLE}"
    )]
    Grid {
        /// Requested grid, in seconds.
        grid_s: f64,
        /// Step of the scenario, in seconds.
        step_s: f64,
    },
    /// The scenario is too large to decide within minutes.
    #[error(
        "{egos} vehicles under test over {steps} steps are too many: the limits are {MAX_EGOS} vehicles and \
         {MAX_EGO_STEPS} for vehicles times steps"
    )]
    TooLarge {
        /// Vehicles under test.
        egos: usize,
        /// Steps of the scenario.
        steps: usize,
    },
}

/// Maximum number of vehicles under test in [`avoid()`].
pub const MAX_EGOS: usize = 20;

/// Maximum number of vehicles under test times steps in [`avoid()`]: undecided cases take two minutes and 150 MB.
pub const MAX_EGO_STEPS: usize = 50_000;

const MAX_FINE_PROGRAMS: usize = 64;
const MAX_COARSE_PROGRAMS: usize = 64;
/// Maximum number of firings (steps at which the follower's brake fires) that stay open after their own program on the
/// finest grid. One open firing rules out a proof. More programs may find an escape, but each takes a third of a
/// second, and with delayed vehicles under test all firings may stay open.
const MAX_OPEN_FIRINGS: usize = 8;

/// Decides whether the vehicles under test could have avoided a collision, and by how much.
///
/// # Errors
/// [`AvoidError`] if the options do not fit the scenario.
///
/// ```
/// use crumple_search::worst_case::{AvoidOptions, AvoidanceVerdict, avoid};
/// use crumple_sim::scenario::built_in_scenario;
///
/// let avoidance = avoid(&built_in_scenario("paper-1").unwrap(), AvoidOptions::default()).unwrap();
/// assert!(matches!(avoidance.verdict, AvoidanceVerdict::Avoidable(escape) if escape.min_gap_m > 8.0));
/// ```
pub fn avoid(scenario: &Scenario, options: AvoidOptions) -> Result<Avoidance, AvoidError> {
    let grids = control_grids(scenario, options)?;
    let programs = solve_programs(scenario, options, &grids)?;
    let is_open = match &programs.avoidance.verdict {
        AvoidanceVerdict::Avoidable(_) => {
            !programs.is_modelled && options.effort == SearchEffort::Optimise
        }
        AvoidanceVerdict::Undecided(reason) => reason.is_not_modelled(),
        AvoidanceVerdict::Unavoidable(_) => false,
    };
    let escape = is_open
        .then(|| {
            closed_loop::largest_gap(
                scenario,
                grids.deciding_cell(),
                programs.profile_mps2.as_deref(),
                programs.bound_m,
                options.effort,
            )
        })
        .flatten();
    let mut avoidance = match escape {
        Some(escape) => with_simulated_escape(programs.avoidance, escape),
        None => programs.avoidance,
    };
    if avoidance.verdict.escape().is_none() {
        avoidance.bound_certificate = None;
    }
    avoidance.optimality = optimality(scenario, &avoidance);
    Ok(avoidance)
}

/// Adds an escape of the closed-loop search to the result of the programs, whose escape remains if it is as good.
fn with_simulated_escape(mut avoidance: Avoidance, mut escape: Escape) -> Avoidance {
    let before_m = avoidance.best_min_gap_m.unwrap_or(0.0);
    avoidance.best_min_gap_m = Some(escape.min_gap_m.max(before_m));
    if let AvoidanceVerdict::Avoidable(program) = avoidance.verdict
        && program.min_gap_m >= escape.min_gap_m
    {
        escape = Escape {
            found_by: escape.found_by,
            ..*program
        };
    }
    avoidance.verdict = AvoidanceVerdict::Avoidable(Box::new(escape));
    avoidance
}

/// Gaps that differ by less are equal, in metres.
const GAP_TOLERANCE_M: f64 = 0.01;

fn optimality(scenario: &Scenario, avoidance: &Avoidance) -> Optimality {
    let best_m = avoidance.best_min_gap_m.unwrap_or(f64::NEG_INFINITY);
    if avoidance
        .min_gap_bound_m
        .is_some_and(|bound_m| best_m >= bound_m - GAP_TOLERANCE_M)
    {
        Optimality::Bound
    } else if best_m >= closed_loop::initial_gap_m(scenario) - GAP_TOLERANCE_M {
        Optimality::InitialGap
    } else {
        Optimality::BestFound
    }
}

struct ProgramResult {
    avoidance: Avoidance,
    /// Best profile of the programs, one acceleration per step.
    profile_mps2: Option<Vec<Vec<f64>>>,
    /// Upper bound of the smallest gap of any profile, in metres.
    bound_m: f64,
    is_modelled: bool,
}

impl ProgramResult {
    /// Returns the result if the programs cannot model a scenario.
    fn not_modelled(reason: UndecidedReason) -> Self {
        Self {
            avoidance: Avoidance::undecided(reason),
            profile_mps2: None,
            bound_m: f64::INFINITY,
            is_modelled: false,
        }
    }
}

fn solve_programs(
    scenario: &Scenario,
    options: AvoidOptions,
    grids: &ControlGrids,
) -> Result<ProgramResult, AvoidError> {
    check_size(scenario)?;
    let problem = match AvoidanceProblem::new(scenario) {
        Ok(problem) => problem,
        Err(reason) => return Ok(ProgramResult::not_modelled(reason)),
    };
    let mut search = FiringSearch::new(&problem);
    let avoidance = explore_grids(scenario, &problem, &mut search, options, grids);
    Ok(ProgramResult {
        // Noise may carry a vehicle beyond a bound that was computed without it.
        bound_m: if problem.proof_caveat.is_none() {
            search.bound_m()
        } else {
            f64::INFINITY
        },
        profile_mps2: search
            .best
            .as_ref()
            .map(|best| step_accelerations_mps2(&problem, best)),
        is_modelled: !problem
            .escape_caveat
            .as_ref()
            .is_some_and(UndecidedReason::is_not_modelled),
        avoidance,
    })
}

fn explore_grids(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    search: &mut FiringSearch<'_>,
    options: AvoidOptions,
    grids: &ControlGrids,
) -> Avoidance {
    let mut undecided = None;
    if problem.follower.is_none() && problem.all_may_stand_step() < problem.steps {
        search.bound_when_all_may_stand(grids.deciding_cell());
    }
    for (index, &cell) in grids.cells.iter().enumerate() {
        let grid = Grid::new(problem, cell);
        if index + 1 == grids.cells.len() {
            search.explore(&grid, MAX_FINE_PROGRAMS, MAX_OPEN_FIRINGS);
        } else {
            search.explore(&grid, MAX_COARSE_PROGRAMS, MAX_COARSE_PROGRAMS);
        }
        if index < grids.first_deciding && search.bound_m() >= 0.0 {
            continue;
        }
        undecided = match conclude(scenario, problem, search) {
            Ok(conclusion) => {
                return build_avoidance(scenario, problem, search, options, conclusion);
            }
            Err(reason) => Some(reason),
        };
    }
    let reason = undecided.unwrap_or_else(|| too_close(search));
    build_avoidance(
        scenario,
        problem,
        search,
        options,
        (AvoidanceVerdict::Undecided(reason), None),
    )
}

/// Returns the reason that the search so far proves neither an escape nor that there is none.
fn too_close(search: &FiringSearch<'_>) -> UndecidedReason {
    UndecidedReason::TooClose {
        low_m: search.best.as_ref().map(|best| best.gap_m),
        high_m: search.bound_m(),
    }
}

fn check_size(scenario: &Scenario) -> Result<(), AvoidError> {
    let egos = (0..scenario.vehicles().len())
        .filter(|&index| scenario.is_under_test(index))
        .count();
    let steps = scenario.steps();
    match egos <= MAX_EGOS && egos.saturating_mul(steps) <= MAX_EGO_STEPS {
        true => Ok(()),
        false => Err(AvoidError::TooLarge { egos, steps }),
    }
}

/// A verdict, and the largest smallest gap of a replayed escape.
type Conclusion = (AvoidanceVerdict, Option<f64>);

fn build_avoidance(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    search: &FiringSearch<'_>,
    options: AvoidOptions,
    (verdict, best_min_gap_m): Conclusion,
) -> Avoidance {
    let bound_m = search.bound_m();
    let is_noisy = matches!(problem.proof_caveat, Some(UndecidedReason::Noise { .. }));
    let computed_m = (bound_m > 0.0 && !is_noisy).then_some(bound_m);
    let may_escape = match &verdict {
        AvoidanceVerdict::Avoidable(_) => true,
        AvoidanceVerdict::Undecided(reason) => reason.is_not_modelled(),
        AvoidanceVerdict::Unavoidable(_) => false,
    };
    let is_wanted = options.certify_bound && may_escape && problem.proof_caveat.is_none();
    let certified = computed_m
        .filter(|_| is_wanted)
        .and_then(|bound_m| certify_bound(scenario, problem, search, bound_m));
    Avoidance {
        verdict,
        best_min_gap_m,
        min_gap_bound_m: certified.as_ref().map(|bound| bound.gap_m).or(computed_m),
        bound_certificate: certified.map(|bound| bound.certificate),
        programs: search.programs,
        optimality: Optimality::BestFound,
    }
}

/// Allowed excess of a certified bound over the computed one, in metres, so that multipliers can be rounded to few
/// digits.
const CERTIFICATE_SLACK_M: f64 = 1e-4;

/// A bound of the smallest gap that the checker accepts.
struct CertifiedBound {
    gap_m: f64,
    certificate: Box<Certificate>,
}

/// Certifies a bound of the smallest gap.
fn certify_bound(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    search: &FiringSearch<'_>,
    computed_m: f64,
) -> Option<CertifiedBound> {
    let stated_m = computed_m + CERTIFICATE_SLACK_M;
    let mut certificate = certificate::gap_bound(scenario, problem, search, stated_m).ok()??;
    let Ok(ProvedClaim::GapBound { gap_m, .. }) = crumple_verify::check(&certificate) else {
        return None;
    };
    if let Statement::GapBound(claim) = &mut certificate.statement {
        claim.gap_m = gap_m;
    }
    crumple_verify::check(&certificate).ok()?;
    Some(CertifiedBound {
        gap_m,
        certificate: Box::new(certificate),
    })
}

/// Control grids to try, each as a number of steps, coarse (fast) before fine.
struct ControlGrids {
    cells: Vec<usize>,
    /// Index of the first grid that may decide.
    first_deciding: usize,
}

impl ControlGrids {
    fn deciding_cell(&self) -> usize {
        self.cells.get(self.first_deciding).copied().unwrap_or(1)
    }
}

fn control_grids(scenario: &Scenario, options: AvoidOptions) -> Result<ControlGrids, AvoidError> {
    let step_s = scenario.spec().step_s;
    let coarse = (0.1 / step_s).round().max(1.0) as usize;
    let requested = match options.grid_s {
        Some(grid_s) => {
            whole_multiple(grid_s, step_s).ok_or(AvoidError::Grid { grid_s, step_s })?
        }
        None => coarse,
    };
    let mut cells = vec![coarse.max(requested), requested, 1];
    cells.dedup();
    Ok(ControlGrids {
        first_deciding: cells
            .iter()
            .position(|&cell| cell == requested)
            .unwrap_or(0),
        cells,
    })
}

/// Returns the verdict of the search so far, or the reason why there is none yet.
fn conclude(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    search: &FiringSearch<'_>,
) -> Result<Conclusion, UndecidedReason> {
    if let Some(best) = search.best.as_ref().filter(|best| best.gap_m > 0.0) {
        return conclude_avoidable(scenario, problem, best);
    }
    if search.bound_m() >= 0.0 {
        return Err(why_open(problem, search));
    }
    if let Some(reason) = &problem.proof_caveat {
        return Err(reason.clone());
    }
    let proof = certificate::unavoidable(scenario, problem, search)?;
    let proof = proof.ok_or_else(|| too_close(search))?;
    check_certificate(&proof)?;
    Ok((AvoidanceVerdict::Unavoidable(Box::new(proof)), None))
}

/// Replays an escape of the model.
fn conclude_avoidable(
    scenario: &Scenario,
    problem: &AvoidanceProblem,
    best: &ModelEscape,
) -> Result<Conclusion, UndecidedReason> {
    if let Some(UndecidedReason::EgoResponse { vehicle }) = problem.escape_caveat {
        return Err(UndecidedReason::EgoResponse { vehicle });
    }
    let escape = Escape::replay(scenario, problem, best).ok_or_else(|| {
        problem
            .escape_caveat
            .clone()
            .unwrap_or(UndecidedReason::Replay)
    })?;
    let best_min_gap_m = Some(escape.min_gap_m);
    Ok((
        AvoidanceVerdict::Avoidable(Box::new(escape)),
        best_min_gap_m,
    ))
}

/// Returns the reason why the programs have neither an escape nor a negative bound of the smallest gap.
fn why_open(problem: &AvoidanceProblem, search: &FiringSearch<'_>) -> UndecidedReason {
    if let Some(status) = &search.solver_failure {
        return UndecidedReason::Solver {
            status: status.clone(),
        };
    }
    // With a delay, an escape and a proof may both be missing: an escape must exist with the delay, but a proof must
    // exclude escapes of egos that respond at once.
    match problem.dead_steps.iter().position(|&steps| steps > 0) {
        Some(ego) => UndecidedReason::EgoResponse { vehicle: ego + 1 },
        None => too_close(search),
    }
}

fn check_certificate(certificate: &Certificate) -> Result<ProvedClaim, UndecidedReason> {
    crumple_verify::check(certificate).map_err(|rejection| UndecidedReason::Rejected {
        why: rejection.to_string(),
    })
}

/// Certifies that an escape avoids the collision. States the smallest gap that the checker
/// confirms.
///
/// # Errors
/// [`UndecidedReason`] if there is no certificate.
pub fn certify(scenario: &Scenario, escape: &Escape) -> Result<Certificate, UndecidedReason> {
    let problem = AvoidanceProblem::new(scenario)?;
    if let Some(reason) = problem
        .escape_caveat
        .clone()
        .or_else(|| problem.proof_caveat.clone())
    {
        return Err(reason);
    }
    let build =
        |least_m| certificate::avoidable(scenario, &problem, &escape.acceleration_mps2, least_m);
    let least_m = match check_certificate(&build(None)?)? {
        ProvedClaim::Avoidable { min_gap_m, .. } => Some(min_gap_m),
        _ => None,
    };
    let certificate = build(least_m)?;
    check_certificate(&certificate)?;
    Ok(certificate)
}
