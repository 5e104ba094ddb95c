//! The largest smallest gap where the convex programs do not model every driver.
//!
//! A follower that drives `idm` or `acc-aeb`, a leader that reacts, or a vehicle that enters the lane is part of the
//! simulation only. Profiles of the vehicles under test are therefore optimised with all other drivers in the loop: simple
//! shapes and the solution of the programs are simulated, the best of them are improved by sequential convex programming
//! (`linear`), and random changes (`shapes`) of the result look for what a linearisation cannot see.

mod linear;
mod plant;
mod shapes;

use self::linear::Ascent;
use self::plant::{SimulatedProfile, Plant, Profile};
use super::witness::{Escape, FoundBy};
use crumple_world::random::{self, Purpose, Stream};
use crumple_world::scenario::Scenario;

/// Profiles from which a search starts.
const STARTS: usize = 5;
/// Two starting profiles differ by at least this much on average, in m/s².
const APART_MPS2: f64 = 0.5;
/// Cycles of a search: profiles that take part, rounds of random changes of each, and steps of the ascent of each.
const CYCLES: [[usize; 3]; 3] = [[5, 6, 5], [3, 8, 8], [2, 12, 12]];
/// Random changes in a round.
const CHANGES: usize = 25;
/// A margin that misses the bound by less than this is not improved, in metres.
const NEAR_BOUND_M: f64 = 1e-3;

/// Extent of the simulations where the programs do not model every driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Effort {
    /// Until some profile has no collision, and little more.
    Decide,
    /// Until the smallest gap no longer grows.
    #[default]
    Optimise,
}

/// Returns the profile with the largest smallest gap that was found; none if each profile ends in a collision, or if the
/// vehicles under test do not follow each other or answer with a lag.
///
/// `cell` is the number of steps over which accelerations are held, `program_mps2` the solution of the programs, and no profile
/// keeps more than `bound_m`.
pub(super) fn largest_gap(
    scenario: &Scenario,
    cell: usize,
    program_mps2: Option<&[Vec<f64>]>,
    bound_m: f64,
    effort: Effort,
) -> Option<Escape> {
    let plant = Plant::new(scenario, cell)?;
    let bound_m = initial_gap_m(scenario).min(bound_m);
    let stream = random::stream(scenario.spec().seed, Purpose::Search, 0);
    let mut search = GapSearch { plant, stream, enough_m: bound_m - NEAR_BOUND_M };
    let best = search.best(program_mps2, effort);
    let plant = search.plant;
    let found_by = FoundBy::ClosedLoop { simulations: plant.simulations };
    let replay = |candidate: SimulatedProfile| {
        Escape::of(scenario, plant.first_ego(), plant.each_step_mps2(&candidate.profile), found_by)
    };
    best.into_iter().filter(|candidate| candidate.margin_m > 0.0).find_map(replay)
}

/// Returns the smallest gap between two neighbours at the start, in metres: no profile keeps more. Infinite if vehicles change
/// lanes.
pub(super) fn initial_gap_m(scenario: &Scenario) -> f64 {
    let pairs = scenario.vehicles().iter().zip(scenario.vehicles().iter().skip(1));
    let gaps_m = pairs.map(|(front, rear)| front.position_m - front.length_m() - rear.position_m);
    if scenario.keeps_lanes() { gaps_m.fold(f64::INFINITY, f64::min) } else { f64::INFINITY }
}

struct GapSearch<'s> {
    plant: Plant<'s>,
    stream: Stream,
    /// A margin that needs no improvement, in metres.
    enough_m: f64,
}

impl GapSearch<'_> {
    /// Returns candidates, the best one first.
    fn best(&mut self, program_mps2: Option<&[Vec<f64>]>, effort: Effort) -> Vec<SimulatedProfile> {
        let mut shapes = self.plant.try_out(shapes::shapes(&self.plant));
        sort(&mut shapes);
        let program = program_mps2.map(|each_step_mps2| self.plant.profile(each_step_mps2));
        let program = self.plant.try_out(program.into_iter().collect());
        let mut best = self.starts(program, &shapes);
        sort(&mut best);
        for [profiles, rounds, steps] in CYCLES {
            best.truncate(profiles);
            for index in 0..best.len() {
                let is_decided = effort == Effort::Decide && best.iter().any(|other| other.margin_m > 0.0);
                if is_decided || best.iter().any(|other| other.margin_m >= self.enough_m) {
                    break;
                }
                if let Some(at) = best.get_mut(index) {
                    let changed = self.changed(at.clone(), rounds);
                    *at = self.ascended(changed, steps);
                }
            }
            sort(&mut best);
        }
        best
    }

    /// The solution of the programs, and the best shapes that differ from each other.
    fn starts(&self, program: Vec<SimulatedProfile>, shapes: &[SimulatedProfile]) -> Vec<SimulatedProfile> {
        let mut starts = program;
        for shape in shapes {
            if starts.len() == STARTS {
                break;
            }
            if starts.iter().all(|start| distance_mps2(&start.profile, &shape.profile) > APART_MPS2) {
                starts.push(shape.clone());
            }
        }
        starts
    }

    fn ascended(&mut self, from: SimulatedProfile, steps: usize) -> SimulatedProfile {
        let mut ascent = Ascent::new(from);
        for _ in 0..steps {
            if ascent.is_over() || ascent.at.margin_m >= self.enough_m {
                break;
            }
            ascent.step(&mut self.plant, &mut self.stream);
        }
        ascent.at
    }

    /// The best of random changes, round after round.
    fn changed(&mut self, mut at: SimulatedProfile, rounds: usize) -> SimulatedProfile {
        for _ in 0..rounds {
            if at.margin_m >= self.enough_m {
                break;
            }
            let changes = (0..CHANGES).map(|_| shapes::perturbed(&self.plant, &at.profile, &mut self.stream));
            let mut tried = self.plant.try_out(changes.collect());
            sort(&mut tried);
            if let Some(better) = tried.into_iter().next().filter(|better| better.margin_m > at.margin_m) {
                at = better;
            }
        }
        at
    }
}

/// Sorts by margin, the largest first; equals keep their order.
fn sort(candidates: &mut [SimulatedProfile]) {
    candidates.sort_by(|a, b| b.margin_m.total_cmp(&a.margin_m));
}

/// Mean absolute difference of two profiles, in m/s².
fn distance_mps2(one: &Profile, other: &Profile) -> f64 {
    let (one, other) = (one.iter().flatten(), other.iter().flatten());
    let (sum, count) = one.zip(other).fold((0.0, 0.0), |(sum, count), (a, b)| (sum + (a - b).abs(), count + 1.0));
    sum / f64::max(count, 1.0)
}
