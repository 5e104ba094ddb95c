//! Search for the largest smallest gap if the convex programs do not model every driver.
//!
//! Only the simulation models a follower with `idm` or `acc-aeb`, a leader that reacts, or a vehicle that enters the
//! lane. Profiles of the vehicles under test are therefore optimised in closed loop: simple shapes and the solution of
//! the programs are simulated, then improved by sequential convex programming (`linear`) and random changes (`shapes`).

mod linear;
mod plant;
mod shapes;

use self::linear::Ascent;
use self::plant::{Plant, Profile, SimulatedProfile};
use self::shapes::SpeedShape;
use super::escape::{Escape, FoundBy};
use crumple_sim::random::{self, Purpose, Stream};
use crumple_sim::scenario::Scenario;

/// Number of shapes that are changed, and rounds of changes of each, per cycle.
const CYCLES: [[usize; 2]; 3] = [[8, 10], [4, 24], [2, 40]];
const CHANGES_PER_ROUND: usize = 25;
/// Minimum mean difference of two initial shapes, in m/s².
const MIN_DISTANCE_MPS2: f64 = 0.5;
/// Number of ascents, and steps of each, per cycle.
const ASCENTS: [[usize; 2]; 2] = [[3, 5], [2, 15]];
const DECIDING_CYCLES: usize = 2;
/// Margin at which a search that only decides avoidability ends, in metres. It is not 0, because the replay at a
/// smaller step may have a smaller margin.
const DECISIVE_MARGIN_M: f64 = 0.05;
/// Margins within this distance of the bound are not improved, in metres.
const NEAR_BOUND_M: f64 = 1e-3;

/// Extent of the simulations if the programs do not model every driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum SearchEffort {
    /// Stop soon after some profile has no collision.
    Decide,
    /// Continue until the smallest gap no longer grows.
    #[default]
    Optimise,
}

/// Returns the profile with the largest smallest gap found, at most `bound_m`; `None` if each one ends in a collision,
/// or if the vehicles under test are not neighbours or have a lag. Accelerations are held over `cell` steps.
pub(super) fn largest_gap(
    scenario: &Scenario,
    cell: usize,
    program_mps2: Option<&[Vec<f64>]>,
    bound_m: f64,
    effort: SearchEffort,
) -> Option<Escape> {
    let plant = Plant::new(scenario, cell)?;
    let bound_m = initial_gap_m(scenario).min(bound_m);
    let stream = random::stream(scenario.spec().seed, Purpose::Search, 0);
    let mut search = GapSearch {
        plant,
        stream,
        sufficient_margin_m: bound_m - NEAR_BOUND_M,
    };
    let best = search.find_best(program_mps2, effort);
    let plant = search.plant;
    let found_by = FoundBy::ClosedLoop {
        simulations: plant.simulations,
    };
    best.into_iter()
        .filter(|candidate| candidate.margin_m > 0.0)
        .find_map(|candidate| {
            Escape::from_accelerations(
                scenario,
                plant.first_ego(),
                plant.step_accelerations_mps2(&candidate.profile),
                found_by,
            )
        })
}

/// Returns the smallest initial gap, in metres, an upper bound for any profile. Infinite if vehicles change lanes.
pub(super) fn initial_gap_m(scenario: &Scenario) -> f64 {
    let pairs = scenario
        .vehicles()
        .iter()
        .zip(scenario.vehicles().iter().skip(1));
    let gaps_m = pairs.map(|(front, rear)| front.position_m - front.length_m() - rear.position_m);
    if scenario.keeps_lanes() {
        gaps_m.fold(f64::INFINITY, f64::min)
    } else {
        f64::INFINITY
    }
}

struct GapSearch<'s> {
    plant: Plant<'s>,
    stream: Stream,
    sufficient_margin_m: f64,
}

impl GapSearch<'_> {
    fn find_best(
        &mut self,
        program_mps2: Option<&[Vec<f64>]>,
        effort: SearchEffort,
    ) -> Vec<SimulatedProfile> {
        let enough_m = match effort {
            SearchEffort::Decide => DECISIVE_MARGIN_M.min(self.sufficient_margin_m),
            SearchEffort::Optimise => self.sufficient_margin_m,
        };
        let cycles = match effort {
            SearchEffort::Decide => DECIDING_CYCLES,
            SearchEffort::Optimise => CYCLES.len(),
        };
        let program = program_mps2.map(|each_step_mps2| self.plant.cell_profile(each_step_mps2));
        let mut best = self.plant.simulate_profiles(program.into_iter().collect());
        if best.iter().all(|at| at.margin_m < enough_m) {
            best.extend(
                self.improve_shapes(enough_m, cycles)
                    .into_iter()
                    .map(|(_, at)| at),
            );
        }
        sort_by_margin(&mut best);
        for [ascents, steps] in ASCENTS {
            best.truncate(ascents);
            for index in 0..best.len() {
                if best.iter().any(|at| at.margin_m >= enough_m) {
                    break;
                }
                if let Some(at) = best.get_mut(index) {
                    *at = self.ascend(at.clone(), steps, enough_m);
                }
            }
            sort_by_margin(&mut best);
        }
        best
    }

    /// Returns the best distinct simple shapes, after random changes.
    fn improve_shapes(
        &mut self,
        enough_m: f64,
        cycles: usize,
    ) -> Vec<(SpeedShape, SimulatedProfile)> {
        let mut best = self.distinct_simple_shapes();
        for [shapes, rounds] in CYCLES.into_iter().take(cycles) {
            best.truncate(shapes);
            for index in (0..best.len()).flat_map(|index| std::iter::repeat_n(index, rounds)) {
                if best.iter().any(|(_, at)| at.margin_m >= enough_m) {
                    break;
                }
                if let Some(current) = best.get_mut(index) {
                    self.try_changes(current);
                }
            }
            best.sort_by(|(_, a), (_, b)| b.margin_m.total_cmp(&a.margin_m));
        }
        best
    }

    /// Returns the best simple shapes whose profiles are not almost equal, the best first.
    fn distinct_simple_shapes(&mut self) -> Vec<(SpeedShape, SimulatedProfile)> {
        let mut simulated = self.simulate_shapes(shapes::simple_shapes(&self.plant));
        simulated.sort_by(|(_, a), (_, b)| b.margin_m.total_cmp(&a.margin_m));
        let mut best: Vec<(SpeedShape, SimulatedProfile)> = Vec::new();
        for (shape, at) in simulated {
            let is_new = best
                .iter()
                .all(|(_, better)| distance_mps2(&better.profile, &at.profile) > MIN_DISTANCE_MPS2);
            if is_new && best.len() < CYCLES[0][0] {
                best.push((shape, at));
            }
        }
        best
    }

    /// Replaces a shape by the best of its random changes, if that one is better.
    fn try_changes(&mut self, current: &mut (SpeedShape, SimulatedProfile)) {
        let changes = (0..CHANGES_PER_ROUND)
            .map(|_| current.0.mutate(&self.plant, &mut self.stream))
            .collect();
        let best = self
            .simulate_shapes(changes)
            .into_iter()
            .max_by(|(_, a), (_, b)| a.margin_m.total_cmp(&b.margin_m));
        if let Some(best) = best
            && best.1.margin_m > current.1.margin_m
        {
            *current = best;
        }
    }

    fn simulate_shapes(&mut self, shapes: Vec<SpeedShape>) -> Vec<(SpeedShape, SimulatedProfile)> {
        let profiles = shapes
            .iter()
            .map(|shape| shape.profile(&self.plant))
            .collect();
        let simulated = self.plant.simulate_profiles(profiles);
        shapes.into_iter().zip(simulated).collect()
    }

    fn ascend(&mut self, from: SimulatedProfile, steps: usize, enough_m: f64) -> SimulatedProfile {
        let mut ascent = Ascent::new(from);
        for _ in 0..steps {
            if ascent.is_over() || ascent.current.margin_m >= enough_m {
                break;
            }
            ascent.step(&mut self.plant, &mut self.stream);
        }
        ascent.current
    }
}

fn sort_by_margin(candidates: &mut [SimulatedProfile]) {
    candidates.sort_by(|a, b| b.margin_m.total_cmp(&a.margin_m));
}

fn distance_mps2(first: &Profile, second: &Profile) -> f64 {
    let cells = first.iter().flatten().zip(second.iter().flatten());
    let count = cells.clone().count() as f64;
    let sum = cells.fold(0.0, |sum, (a, b)| sum + (a - b).abs());
    sum / f64::max(count, 1.0)
}

#[cfg(test)]
mod tests {
    use super::super::{AvoidOptions, AvoidanceVerdict, UndecidedReason, avoid};
    use crumple_sim::control::BuiltInController;
    use crumple_sim::scenario::{
        Driver, LaneChange, Scenario, VehicleClass, VehicleSpec, built_in_scenario,
    };

    fn cut_in(ttc_s: f64) -> Scenario {
        let paper = built_in_scenario("paper-1").unwrap();
        let changed = paper.edited(|spec| {
            let profile = Driver::Profile(crumple_sim::scenario::LeadProfile::ConstantSpeed);
            let mut lead = VehicleSpec::new(VehicleClass::Light, 62.0, 10.0, profile);
            lead.enters = Some(LaneChange::TimeToCollision(ttc_s));
            spec.vehicles = vec![
                lead,
                VehicleSpec::new(VehicleClass::Light, 0.0, 30.0, Driver::UnderTest),
            ];
        });
        changed.unwrap()
    }

    #[test]
    fn an_avoidable_cut_in_has_an_escape() {
        let avoidance = avoid(&cut_in(2.0), AvoidOptions::default()).unwrap();
        let escape = avoidance
            .verdict
            .escape()
            .expect("20 m/s take 53 of 40 m and what is driven meanwhile");
        assert!(escape.min_gap_m > 1.0 && avoidance.min_gap_bound_m.is_none());
        assert!(escape.scenario.vehicles()[0].enters.is_some());
        // A driver that brakes at once avoids the cut-in.
        assert!(
            avoid(&cut_in(0.2), AvoidOptions::default())
                .unwrap()
                .verdict
                .escape()
                .is_some()
        );
    }

    #[test]
    fn escapes_exist_ahead_of_followers_that_no_program_models() {
        let paper = built_in_scenario("paper-1").unwrap();
        for follower in ["idm", "acc-aeb"] {
            let behind = |gap_m: f64| {
                let changed = paper.edited(|spec| {
                    spec.vehicles[2].driver =
                        Driver::Controller(BuiltInController::from_name(follower).unwrap());
                    spec.vehicles[1].position_m = spec.vehicles[0].position_m - 2.0 - gap_m;
                    spec.vehicles[2].position_m = spec.vehicles[1].position_m - 20.0;
                });
                avoid(&changed.unwrap(), AvoidOptions::default())
                    .unwrap()
                    .verdict
            };
            let verdict = behind(20.0);
            assert!(
                verdict
                    .escape()
                    .is_some_and(|escape| escape.min_gap_m > 0.0),
                "{follower}: {verdict:?}"
            );
            assert!(!matches!(
                behind(0.01),
                AvoidanceVerdict::Undecided(UndecidedReason::Replay)
            ));
        }
    }
}
