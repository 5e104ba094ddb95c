//! Escapes by trying: where the programs do not model who drives behind or who enters the lane, a script that touches nobody is an
//! escape all the same.

use std::cmp::Ordering;

use rand_distr::{Distribution, StandardNormal};

use super::situation::delay_steps;
use super::witness::{Escape, FoundBy, by_script, follow, pieces};
use crumple_world::random::{self, Purpose, Stream};
use crumple_world::scenario::Scenario;
use crumple_world::sim::{Outcome, RecordingLevel, Run, Simulated, simulate_batch};

/// When a script begins to do something else than to hold its speed, in seconds.
const BEGINS_S: [f64; 5] = [0.0, 0.5, 1.0, 2.0, 4.0];

/// How long its first acceleration lasts, in seconds.
const LASTS_S: [f64; 4] = [0.5, 1.5, 4.0, 1e3];

/// Its accelerations: shares of the hardest braking where negative, of the largest acceleration where positive.
const SHARES: [f64; 7] = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.5, 1.0];

/// Scripts next to the best one that are tried, as often and as many at a time.
const REFINEMENTS: [usize; 2] = [4, 100];

/// A script of the vehicle under test: it holds its speed, then one acceleration, then another.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Script {
    begins_s: f64,
    lasts_s: f64,
    shares: [f64; 2],
}

/// The script that keeps the largest smallest gap of those tried; none if each touches somebody, and of scenarios in which not exactly one
/// vehicle, which does what it decides without lag, is under test.
pub(super) fn escape(scenario: &Scenario) -> Option<Escape> {
    let trial = Trial::new(scenario)?;
    let grid = BEGINS_S.into_iter().flat_map(|begins_s| {
        LASTS_S.into_iter().flat_map(move |lasts_s| {
            let shares = SHARES.into_iter().flat_map(|first| SHARES.map(|then| [first, then]));
            shares.map(move |shares| Script { begins_s, lasts_s, shares })
        })
    });
    let mut best = trial.best(grid.collect())?;
    let mut stream = random::stream(scenario.spec().seed, Purpose::Search, 0);
    for round in 0..REFINEMENTS[0] {
        let width = 0.3 / (1 << round) as f64;
        let near = (0..REFINEMENTS[1]).map(|_| best.1.near(width, &mut stream));
        if let Some(better) = trial.best(near.collect()).filter(|better| better.0 > best.0) {
            best = better;
        }
    }
    let accelerations = trial.accelerations(best.1);
    Escape::of(scenario, trial.ego, vec![accelerations], FoundBy::Trial).map(|(escape, _)| escape)
}

impl Script {
    fn near(self, width: f64, stream: &mut Stream) -> Self {
        let mut normal = || -> f64 { StandardNormal.sample(stream) };
        Self {
            begins_s: (self.begins_s + 2.0 * width * normal()).max(0.0),
            lasts_s: (self.lasts_s * (width * normal()).exp()).max(0.0),
            shares: self.shares.map(|share| (share + width * normal()).clamp(-1.0, 1.0)),
        }
    }
}

struct Trial<'s> {
    scenario: &'s Scenario,
    ego: usize,
    /// Steps at the start over which nothing it commands has an effect yet.
    dead_steps: usize,
    limits_mps2: [f64; 2],
}

impl<'s> Trial<'s> {
    fn new(scenario: &'s Scenario) -> Option<Self> {
        let egos: Vec<usize> = (0..scenario.vehicles().len()).filter(|&index| scenario.is_under_test(index)).collect();
        let &[ego] = &egos[..] else { return None };
        let vehicle = scenario.vehicles().get(ego)?;
        if vehicle.actuator_lag_s > 0.0 || vehicle.jerk_limit_mps3.is_some() {
            return None;
        }
        let limits_mps2 = [scenario.usable_brake_mps2(ego), vehicle.max_accel_mps2()];
        Some(Self { scenario, ego, dead_steps: delay_steps(scenario, vehicle), limits_mps2 })
    }

    /// The acceleration of each step.
    fn accelerations(&self, script: Script) -> Vec<f64> {
        let step_s = self.scenario.spec().step_s;
        let begins = self.dead_steps as f64 + (script.begins_s / step_s).round();
        let ends = begins + (script.lasts_s / step_s).round();
        let [first_mps2, then_mps2] = script.shares.map(|share| match share < 0.0 {
            true => share * self.limits_mps2[0],
            false => share * self.limits_mps2[1],
        });
        let at = |step: usize| match step as f64 {
            step if step < begins => 0.0,
            step if step < ends => first_mps2,
            _ => then_mps2,
        };
        (0..self.scenario.steps()).map(at).collect()
    }

    /// The best of some scripts and how good it is; none if all touch somebody.
    fn best(&self, scripts: Vec<Script>) -> Option<(f64, Script)> {
        let step_s = self.scenario.spec().step_s;
        let scripted = |script: &Script| {
            let pieces = pieces(&self.accelerations(*script), step_s);
            let changed = self.scenario.edited(|spec| {
                if let Some(vehicle) = spec.vehicles.get_mut(self.ego) {
                    follow(vehicle, pieces);
                }
            });
            Some((*script, changed.ok()?))
        };
        let scenarios: Vec<(Script, Scenario)> = scripts.iter().filter_map(scripted).collect();
        let runs =
            scenarios.iter().filter_map(|(script, scenario)| Some((*script, Run::new(scenario, by_script()).ok()?)));
        let (scripts, runs): (Vec<Script>, Vec<Run<'_>>) = runs.unzip();
        let gaps_m = simulate_batch(&runs, RecordingLevel::Summary, |_, simulated| kept_m(&simulated));
        let kept = gaps_m.into_iter().zip(scripts).filter_map(|(gap_m, script)| Some((gap_m?, script)));
        // The first of equals.
        kept.reduce(|best, next| if next.0.total_cmp(&best.0) == Ordering::Greater { next } else { best })
    }
}

/// The smallest gap in a run without contact, in metres.
fn kept_m(simulated: &Simulated) -> Option<f64> {
    let gaps_m = simulated.vehicles.iter().filter_map(|vehicle| vehicle.min_gap_m);
    (simulated.outcome == Outcome::NoCollision).then(|| gaps_m.fold(f64::INFINITY, f64::min))
}

#[cfg(test)]
mod tests {
    use super::super::{AvoidOptions, AvoidanceVerdict, Reason, avoid};
    use crumple_world::control::ControllerSpec;
    use crumple_world::scenario::{Driver, LaneChange, Scenario, VehicleClass, VehicleSpec, built_in};

    /// A vehicle that cuts in 20 m/s slower, with so much time to collision.
    fn cut_in(ttc_s: f64) -> Scenario {
        let paper = built_in("paper-1").unwrap();
        let changed = paper.edited(|spec| {
            let profile = Driver::Profile(crumple_world::scenario::LeadProfile::ConstantSpeed);
            let mut lead = VehicleSpec::new(VehicleClass::Light, 62.0, 10.0, profile);
            lead.enters = Some(LaneChange::TimeToCollision(ttc_s));
            spec.vehicles = vec![lead, VehicleSpec::new(VehicleClass::Light, 0.0, 30.0, Driver::UnderTest)];
        });
        changed.unwrap()
    }

    #[test]
    fn a_cut_in_is_avoided_where_that_can_be() {
        let found = avoid(&cut_in(2.0), AvoidOptions::default()).unwrap();
        let escape = found.verdict.escape().expect("20 m/s take 53 of 40 m and what is driven meanwhile");
        assert!(escape.min_gap_m > 1.0 && found.min_gap_bound_m.is_none());
        assert!(escape.scenario.vehicles()[0].enters.is_some());
        // Knowing the future, somebody who brakes at once never comes to it; a wall of time does not help.
        assert!(avoid(&cut_in(0.2), AvoidOptions::default()).unwrap().verdict.escape().is_some());
    }

    /// Behind a follower that no program models an escape is still one; where none is found, nothing is said.
    #[test]
    fn any_follower_will_do_for_an_escape() {
        let paper = built_in("paper-1").unwrap();
        for follower in ["idm", "acc-aeb"] {
            let behind = |gap_m: f64| {
                let changed = paper.edited(|spec| {
                    spec.vehicles[2].driver = Driver::Controller(ControllerSpec::named(follower).unwrap());
                    spec.vehicles[1].position_m = spec.vehicles[0].position_m - 2.0 - gap_m;
                    spec.vehicles[2].position_m = spec.vehicles[1].position_m - 20.0;
                });
                avoid(&changed.unwrap(), AvoidOptions::default()).unwrap().verdict
            };
            let verdict = behind(20.0);
            assert!(verdict.escape().is_some_and(|escape| escape.min_gap_m > 0.0), "{follower}: {verdict:?}");
            assert!(!matches!(behind(0.01), AvoidanceVerdict::Undecided(Reason::Replay)));
        }
    }
}
