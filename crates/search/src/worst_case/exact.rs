//! Mildest braking of the leader that makes the baseline collide, exact for accelerations that are constant per cell.
//!
//! The first vehicle under test coasts until its brake fires. The firing step determines its further motion and that of
//! all vehicles behind it. A collision is therefore one of two cases, each a convex program in the leader's motion:
//!
//! - the brake fires at a step σ after which the vehicles behind collide, whatever the leader does;
//! - the brake fires at σ, and at a step k the leader's rear bumper is not ahead of the braking vehicle.
//!
//! The brake fires when its guard, the gap minus θ times the closing speed, is negative; θ is the TTC threshold. The
//! leader's displacement d and change of speed w from coasting enter the guard as d + θ w. While the leader brakes, a
//! negative guard decreases further, so a brake that has fired by σ₂ has a negative guard at σ₂. A vehicle that brakes
//! later is further ahead, and d only decreases. For σ in [σ₁, σ₂] and k in [k₁, k₂] this relaxation is thus valid:
//!
//! - the guard has not fired before σ₁ and has fired by σ₂;
//! - d at k₂ is at most D. D is the largest value, over all k in [k₁, k₂], of the front bumper of a vehicle that brakes
//!   from σ₂ minus the rear bumper of a coasting leader.
//!
//! Best-first search over such boxes of σ and k ends with the cheapest profile.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::attack::{Attack, AttackError, AttackMethod, AttackObjective};
use super::leader_program::{LeaderConstraint, cheapest_profile};
use super::profile_simulator::{ProfileOutcome, ProfileSimulator};
use super::sequential;
use crumple_world::control::{AebSettings, ControllerSpec};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::{Driver, LeadProfile, PiecewiseAcceleration, Scenario};
use crumple_world::sim::{RecordingLevel, Run, RunOptions, simulate_batch};

/// Returns true if the first vehicle under test executes its commands at once and without noise.
pub(super) fn is_applicable(scenario: &Scenario) -> bool {
    scenario.has_only_point_masses()
        && scenario.vehicles().get(1).is_some_and(|ego| {
            ego.driver == Driver::UnderTest
                && ego.actuator_lag_s == 0.0
                && ego.jerk_limit_mps3.is_none()
                && ego.acceleration_noise_mps2 == 0.0
        })
        && scenario.vehicles().first().is_some_and(|leader| leader.acceleration_noise_mps2 == 0.0)
}

/// Maximum number of programs; after that a local search takes over.
const MAX_PROGRAMS: usize = 1500;

/// Margins beyond the bounds of the programs, in metres. The first covers rounding, the others the error of a filter.
const MARGINS_BEYOND_BOUND_M: [f64; 5] = [1e-4, 0.02, 0.1, 0.4, 1.5];

/// Returns the cheapest profile that makes the baseline collide; `None` if there is none.
pub(super) fn find_mildest(
    bench: &mut ProfileSimulator<'_>,
    ttc_s: f64,
    aim: AttackObjective,
    budget: usize,
) -> Result<Option<Attack>, AttackError> {
    let options_see_truth = bench.options.estimator == EstimatorKind::Truth;
    let is_quiet = bench.scenario.vehicles().iter().all(|vehicle| vehicle.acceleration_noise_mps2 == 0.0);
    // The leader may not need to brake at all.
    let coasting = vec![0.0; bench.cell_count()];
    if bench.simulate(std::slice::from_ref(&coasting))?.iter().any(ProfileOutcome::collides) {
        return Ok(Some(bench.report(&coasting, 0.0, AttackMethod::Exact)?));
    }
    let hits_behind = firings_with_rear_collision(bench, ttc_s)?;
    let mut search = Enumeration { bench, ttc_s, objective: aim, beyond_m: 0.0, hits_behind: &hits_behind };
    let mut node = None;
    for (widened, beyond_m) in MARGINS_BEYOND_BOUND_M.into_iter().enumerate() {
        search.beyond_m = beyond_m;
        // The first margin selects the box. Larger margins are then tried in that box, so that the brake also fires if
        // a filter delays the observation.
        let found = match node {
            None => search.find_cheapest()?,
            Some(node) => match search.solve_relaxation(node) {
                Some(found) => Some(found),
                None => search.find_cheapest()?,
            },
        };
        let Some(RankedBox { firing_box: cheapest, profile, .. }) = found else { break };
        node = Some(cheapest);
        let method =
            if widened == 0 && options_see_truth && is_quiet { AttackMethod::Exact } else { AttackMethod::Widened };
        let attack = search.bench.report(&profile, -beyond_m, method)?;
        if attack.outcome.contact().is_some() {
            return Ok(Some(attack));
        }
    }
    // A local search takes over if there were too many boxes, or if a filter changes the observation.
    if search.bench.programs < MAX_PROGRAMS && options_see_truth {
        Ok(None)
    } else {
        sequential::attack(search.bench, aim, budget)
    }
}

/// Returns, for each step, true if the vehicles behind collide when the first vehicle under test fires its brake there.
fn firings_with_rear_collision(bench: &mut ProfileSimulator<'_>, ttc_s: f64) -> Result<Vec<bool>, AttackError> {
    let scenario = bench.scenario;
    let step_s = scenario.spec().step_s;
    let brake_mps2 = scenario.usable_brake_mps2(1);
    let delay = ego_delay_steps(scenario);
    let firing = |step: usize| {
        scenario.edited(|spec| {
            if let Some(leader) = spec.vehicles.first_mut() {
                leader.driver = Driver::Profile(LeadProfile::ConstantSpeed);
                (leader.position_m, leader.speed_mps) = (1e6, 100.0);
            }
            if let Some(ego) = spec.vehicles.get_mut(1) {
                let from_s = vec![(step + delay) as f64 * step_s];
                ego.driver = Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration {
                    from_s,
                    accel_mps2: vec![-brake_mps2],
                }));
                (ego.reaction_delay_s, ego.actuator_delay_s) = (0.0, 0.0);
            }
        })
    };
    let scenarios = (0..scenario.steps()).map(firing).collect::<Result<Vec<_>, _>>()?;
    let baseline = ControllerSpec::Baseline(AebSettings { ttc_s });
    let options = RunOptions::new(baseline).with_estimator(EstimatorKind::Truth);
    let runs = scenarios.iter().map(|scenario| Run::new(scenario, options.clone())).collect::<Result<Vec<_>, _>>()?;
    bench.evaluations += runs.len();
    Ok(simulate_batch(&runs, RecordingLevel::Summary, |_, simulated| simulated.outcome.contact().is_some()))
}

fn ego_delay_steps(scenario: &Scenario) -> usize {
    let delay_s = scenario.vehicles().get(1).map_or(0.0, |ego| ego.reaction_delay_s + ego.actuator_delay_s);
    (delay_s / scenario.spec().step_s).round() as usize
}

/// A range of firing steps and a range of collision steps. Collisions of the vehicles behind have only the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FiringBox {
    firing_steps: [usize; 2],
    contact_steps: Option<[usize; 2]>,
}

struct RankedBox {
    cost: f64,
    firing_box: FiringBox,
    profile: Vec<f64>,
}

impl Ord for RankedBox {
    fn cmp(&self, other: &Self) -> Ordering {
        // The heap yields the greatest element: the cheapest box, or among equals the one with the latest first step.
        other.cost.total_cmp(&self.cost).then(self.firing_box.firing_steps[0].cmp(&other.firing_box.firing_steps[0]))
    }
}

impl PartialOrd for RankedBox {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for RankedBox {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for RankedBox {}

struct Enumeration<'e, 'a> {
    bench: &'e mut ProfileSimulator<'a>,
    ttc_s: f64,
    objective: AttackObjective,
    beyond_m: f64,
    hits_behind: &'e [bool],
}

impl Enumeration<'_, '_> {
    fn find_cheapest(&mut self) -> Result<Option<RankedBox>, AttackError> {
        let steps = self.bench.scenario.steps();
        let all = [0, steps.saturating_sub(1)];
        let mut open = BinaryHeap::new();
        for touches in [None, Some([1, steps])] {
            open.extend(self.solve_relaxation(FiringBox { firing_steps: all, contact_steps: touches }));
        }
        while let Some(cheapest) = open.pop().filter(|_| self.bench.programs < MAX_PROGRAMS) {
            // No open relaxation costs less, so this profile is optimal if it collides, even outside its box.
            let Some(halves) = split_box(cheapest.firing_box) else { return Ok(Some(cheapest)) };
            let tried = self.bench.simulate(std::slice::from_ref(&cheapest.profile))?;
            if tried.iter().any(ProfileOutcome::collides) {
                return Ok(Some(cheapest));
            }
            for half in halves {
                open.extend(self.solve_relaxation(half));
            }
        }
        Ok(None)
    }

    /// Returns the cheapest profile of a relaxed box; `None` if the box contains no profile.
    fn solve_relaxation(&mut self, node: FiringBox) -> Option<RankedBox> {
        let [first, last] = node.firing_steps;
        let mut asked = Vec::new();
        match node.contact_steps {
            None => {
                let hits = self.hits_behind.get(first..=last)?;
                let (from, to) = (hits.iter().position(|hit| *hit)?, hits.iter().rposition(|hit| *hit)?);
                if (from, to) != (0, last - first) {
                    return self
                        .solve_relaxation(FiringBox { firing_steps: [first + from, first + to], contact_steps: None });
                }
            }
            Some([earliest, latest]) => {
                let touches = earliest.max(first)..=latest;
                let reach_m = touches.map(|at| self.braking_ego_front_m(last, at) - self.leader_rear_m(at));
                let reach_m = reach_m.reduce(f64::max)?;
                asked.push(LeaderConstraint {
                    step: latest,
                    theta_s: 0.0,
                    bound_m: reach_m - self.beyond_m,
                    is_upper_bound: true,
                });
            }
        }
        asked.push(self.guard_constraint(last, true));
        asked.extend((self.bench.cell..first).step_by(self.bench.cell).map(|step| self.guard_constraint(step, false)));
        let (cost, profile) = cheapest_profile(self.bench, self.objective, &asked)?;
        Some(RankedBox { cost, firing_box: node, profile })
    }

    /// Returns the constraint that the brake has fired by a step, or has not, as a bound on d + θ w of the leader.
    fn guard_constraint(&self, step: usize, fired: bool) -> LeaderConstraint {
        let ego = &self.bench.scenario.vehicles()[1];
        let t = step as f64 * self.bench.scenario.spec().step_s;
        let gap_m = self.leader_rear_m(step) - (ego.position_m + ego.speed_mps * t);
        let closing_mps = ego.speed_mps - self.bench.scenario.vehicles()[0].speed_mps;
        let bound_m = self.ttc_s * closing_mps - gap_m - if fired { self.beyond_m } else { 0.0 };
        LeaderConstraint { step, theta_s: self.ttc_s, bound_m, is_upper_bound: fired }
    }

    fn leader_rear_m(&self, step: usize) -> f64 {
        let leader = &self.bench.scenario.vehicles()[0];
        leader.position_m - leader.length_m() + leader.speed_mps * step as f64 * self.bench.scenario.spec().step_s
    }

    /// Returns the front bumper at step `at` of the first vehicle under test if its brake fires at step `fires`.
    fn braking_ego_front_m(&self, fires: usize, at: usize) -> f64 {
        let scenario = self.bench.scenario;
        let ego = &scenario.vehicles()[1];
        let step_s = scenario.spec().step_s;
        let brakes_from = (fires + ego_delay_steps(scenario)).min(at);
        let brake_mps2 = scenario.usable_brake_mps2(1);
        let braking_s = ((at - brakes_from) as f64 * step_s).min(ego.speed_mps / brake_mps2);
        let coasted_m = ego.speed_mps * brakes_from as f64 * step_s;
        ego.position_m + coasted_m + (ego.speed_mps - 0.5 * brake_mps2 * braking_s) * braking_s
    }
}

/// Returns the two halves of a box across its longer side; `None` for a single firing and collision step.
fn split_box(node: FiringBox) -> Option<[FiringBox; 2]> {
    let split = |[first, last]: [usize; 2]| {
        let middle = usize::midpoint(first, last);
        [[first, middle], [middle + 1, last]]
    };
    let width = |[first, last]: [usize; 2]| last - first;
    match node.contact_steps {
        Some(touches) if width(touches) > width(node.firing_steps) => {
            Some(split(touches).map(|touches| FiringBox { contact_steps: Some(touches), ..node }))
        }
        _ if width(node.firing_steps) > 0 => {
            Some(split(node.firing_steps).map(|fires| FiringBox { firing_steps: fires, ..node }))
        }
        _ => None,
    }
}
