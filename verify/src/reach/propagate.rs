//! Propagation of a box of initial states under a controller, step by step.
//!
//! Modules: [`braking`](super::braking) for vehicles that brake to standstill, [`leader`](super::leader) for a leader
//! with bounded braking, [`follower`](super::follower) for a follower with a law, [`ego_set`](super::ego_set) for the
//! ego between decisions.
//!
//! # Sets
//! There is a set for each motion mode of the ego: moving, standing, restarted. Sets of a mode are joined at every
//! decision. So there are never more than three, at however many instants members stop.
//!
//! # The follower's emergency brake
//! It fires at the first instant with guard = gap - θ (v_r - v_e) < 0. `propagate` handles the members *whose follower
//! has not fired*. A decision interval in which some guard may be negative, first at instant j1 and last at j2, is a
//! window. The members whose follower fires from j1 to j2 are propagated separately, starting at the decision before
//! j1, with the firing instant τ as a symbol. If windows are many, neighbours are merged. A set whose guards are
//! all negative at some instant has no unfired member and is dropped. As long as all instants of a window are in one
//! decision interval, every observed acceleration of the follower is known; see [`window`](super::window). Sound
//! over-approximation: the members that fire are a subset of the propagated set; that their guard was >= 0 before is
//! not exploited.
//!
//! # Collisions
//! Gaps are evaluated at decisions. In between g'' ≤ m: the largest acceleration of the vehicle ahead (at least 0)
//! minus the smallest of the one behind (at most 0). So g ≥ min(g at begin, g at end) - m (D h)²/8 throughout; see
//! [`avoidable`](crate::avoidable). For the gap to a latched follower, "at least 0" is dropped if the ego still moves
//! at the end, because it has not stopped. A vehicle with a law may have restarted, so "at least 0" stays. The gap to a
//! standing follower never falls, although the ego's bounds contain reversing members.
//!
//! # Standstill
//! Fixed point: if all vehicles stand and the controller commands no motion, every later step is identical, and
//! propagation stops.

use super::braking::{BrakingVehicle, VehicleState};
use super::controller::{NeuralController, OBSERVATION_SIZE};
use super::ego_set::{ByMode, EgoSet, MotionMode, SHARED_SYMBOLS};
use super::follower::{FollowerLaw, FollowerModel, LawFollower};
use super::form::AffineForm;
use super::leader::LeaderModel;
use super::window::{FiringWindow, merge_windows};
use super::{BoxDimension, InitialRanges, ReachResult, Undecided};
use crate::interval::Interval;
use crate::work::{OpBudget, WorkLimit};

/// Maximum number of windows in which the follower's brake may fire, and of their decision intervals.
const MAX_WINDOWS: usize = 300;
const MAX_INTERVALS: usize = 1000;
/// Operations per decision (without the network), per leader symbol, per step, and per step and symbol of a follower
/// with a law.
const OPS_PER_DECISION: u64 = 50_000;
const OPS_PER_LEADER_SYMBOL: u64 = 1_000;
const OPS_PER_STEP: u64 = 10_000;
const OPS_PER_LAW_SYMBOL: u64 = 3_000;
/// Largest radius of speeds and commands before propagation stops.
const MAX_RADIUS_MPS: f64 = 40.0;

/// A reachability problem.
#[derive(Debug, Clone)]
pub struct ReachProblem<'a> {
    /// Controller of the ego.
    pub controller: &'a NeuralController,
    /// Initial states.
    pub ranges: InitialRanges,
    /// Follower, if there is one.
    pub follower: Option<FollowerModel>,
    /// Bound b of a leader that holds any acceleration from -b to 0 over each step until it stands, in m/s². It
    /// replaces rate and onset of `ranges`. `None` for a leader that follows these.
    pub leader_brakes_at_most_mps2: Option<f64>,
    /// Largest error of each observed number.
    pub observation_error: [f64; OBSERVATION_SIZE],
    /// h, in seconds.
    pub step_s: f64,
    /// N, a multiple of `decision_steps`.
    pub steps: u32,
    /// D, the number of steps between decisions.
    pub decision_steps: u32,
    /// True to stop as soon as a collision cannot be excluded.
    pub stop_when_undecided: bool,
}

#[derive(Debug, Clone)]
struct StateSet {
    members: EgoSet,
    observation: [AffineForm; OBSERVATION_SIZE],
    gaps: [AffineForm; 2],
}

struct ReachAnalysis<'a> {
    scene: &'a ReachProblem<'a>,
    budget: &'a OpBudget,
    step: Interval,
    leader: LeaderModel,
    gaps: [AffineForm; 2],
    result: ReachResult,
    window_count: usize,
    /// Reach tube, if requested and complete: a set whose members all collide leaves a hole.
    tube: Option<ReachTube>,
}

impl<'a> ReachAnalysis<'a> {
    fn new(scene: &'a ReachProblem<'a>, budget: &'a OpBudget, tube: Option<ReachTube>) -> Self {
        let step = Interval::point(scene.step_s);
        let leader = [
            BoxDimension::LeaderSpeedMps,
            BoxDimension::LeaderBrakeMps2,
            BoxDimension::OnsetSteps,
        ]
        .map(|dimension| initial_symbol(scene, dimension));
        Self {
            scene,
            budget,
            step,
            leader: LeaderModel::new(scene, leader, step),
            gaps: [BoxDimension::GapAheadM, BoxDimension::GapBehindM]
                .map(|dimension| initial_symbol(scene, dimension)),
            result: ReachResult::INITIAL,
            window_count: 0,
            tube,
        }
    }
}

fn initial_symbol(scene: &ReachProblem<'_>, dimension: BoxDimension) -> AffineForm {
    AffineForm::symbol(dimension as usize, scene.ranges.get(dimension))
}

/// Bounds of the eight observed numbers for each decision.
pub type ReachTube = Vec<[Interval; OBSERVATION_SIZE]>;

/// Bounds the motion of all members of a box.
#[must_use]
pub fn reach(scene: &ReachProblem<'_>) -> ReachResult {
    reach_with_budget(scene, &OpBudget::new(WorkLimit::UNLIMITED))
}

pub(super) fn reach_with_budget(scene: &ReachProblem<'_>, work: &OpBudget) -> ReachResult {
    analyze(scene, work, None).0
}

/// Bounds the motion and returns the reach tube up to the last instant, unless it ended early or in a sure collision.
#[must_use]
pub fn reach_with_tube(scene: &ReachProblem<'_>) -> (ReachResult, Option<ReachTube>) {
    analyze(
        scene,
        &OpBudget::new(WorkLimit::UNLIMITED),
        Some(ReachTube::new()),
    )
}

fn analyze(
    scene: &ReachProblem<'_>,
    work: &OpBudget,
    tube: Option<ReachTube>,
) -> (ReachResult, Option<ReachTube>) {
    let mut analysis = ReachAnalysis::new(scene, work, tube);
    let shared = SHARED_SYMBOLS + analysis.leader.symbol_count();
    let driven = scene.follower_law().map(|_| VehicleState {
        speed: initial_symbol(scene, BoxDimension::FollowerSpeedMps),
        ..VehicleState::default()
    });
    let ego_speed = initial_symbol(scene, BoxDimension::EgoSpeedMps);
    let members = EgoSet::from_speed(ego_speed, shared).with_follower(driven);
    let mut starts = ByMode::default();
    let mode = members.mode as usize;
    starts[mode] = Some(members);
    let never = f64::from(scene.steps);
    let latched = scene
        .latched_ttc_s()
        .map(|_| analysis.latched_follower([never, never]));
    let collides = analysis.propagate(0, starts, latched.as_ref(), true);
    analysis.result.surely_collides = collides == Some(true);
    (
        analysis.result,
        analysis.tube.filter(|_| collides.is_some()),
    )
}

impl ReachProblem<'_> {
    fn latched_ttc_s(&self) -> Option<f64> {
        match self.follower {
            Some(FollowerModel::Latched { ttc_s }) => Some(ttc_s),
            _ => None,
        }
    }

    fn follower_law(&self) -> Option<&FollowerLaw> {
        match &self.follower {
            Some(FollowerModel::ByLaw(law)) => Some(law),
            _ => None,
        }
    }
}

/// The sets after one decision.
struct DecisionOutcome {
    sets: ByMode<StateSet>,
    /// The members whose follower fires before the next decision.
    window: FiringWindow,
    /// True if all members stand, and keep standing.
    all_stand: bool,
}

/// Instants of a decision interval at which the follower's brake may fire.
#[derive(Debug, Clone, Copy, PartialEq)]
struct BrakeFiring {
    /// First and last instant, in steps.
    instants: [f64; 2],
    is_certain: bool,
}

/// A follower with a law at the next decision.
struct DrivenFollower {
    state: VehicleState,
    /// Lower bound of the gap until then, in metres.
    min_gap_m: f64,
}

impl ReachAnalysis<'_> {
    fn latched_follower(&self, [first, last]: [f64; 2]) -> BrakingVehicle {
        let window = Interval::new(first, last).unwrap_or(Interval::ENTIRE);
        let onset = AffineForm::symbol(SHARED_SYMBOLS - 1, window);
        let mut follower = BrakingVehicle::new(
            initial_symbol(self.scene, BoxDimension::FollowerSpeedMps),
            initial_symbol(self.scene, BoxDimension::FollowerBrakeMps2),
            onset,
            window,
            self.step,
        );
        // It fires at instants only.
        follower.onset_step_error_m = Interval::ZERO;
        follower
    }

    /// Propagates to the end. Returns true if all members surely collide, `None` if it ended early.
    fn propagate(
        &mut self,
        mut k: u32,
        members: ByMode<EgoSet>,
        follower: Option<&BrakingVehicle>,
        has_not_fired: bool,
    ) -> Option<bool> {
        let every = self.scene.decision_steps;
        let mut windows = Vec::new();
        let mut sets: ByMode<StateSet> =
            members.map(|members| members.map(|members| self.observe(k, members, follower)));
        while k < self.scene.steps && sets.iter().any(Option::is_some) {
            self.record_tube(k, &sets);
            let outcome = self.propagate_decision(k, &sets, follower, has_not_fired)?;
            if outcome.window.may_fire() {
                let mut window = outcome.window;
                window.members = sets
                    .each_ref()
                    .map(|set| set.as_ref().map(|set| set.members.clone()));
                windows.push(window);
                if windows.len() > MAX_INTERVALS {
                    self.record_too_many_sets(k);
                    return None;
                }
            }
            let goes_on = outcome.sets.iter().any(Option::is_some);
            if outcome.all_stand && goes_on && self.are_others_at_rest(k, follower) {
                (k..=self.scene.steps)
                    .step_by(every as usize)
                    .for_each(|k| self.record_tube(k, &sets));
                break;
            }
            (k, sets) = (k + every, outcome.sets);
        }
        self.record_tube(k, &sets);
        let all_collide = sets.iter().all(Option::is_none);
        Some(self.propagate_fired(windows)? && all_collide)
    }

    /// Propagates sets to the next decision. Returns `None` if the analysis ended early.
    fn propagate_decision(
        &mut self,
        k: u32,
        sets: &ByMode<StateSet>,
        follower: Option<&BrakingVehicle>,
        has_not_fired: bool,
    ) -> Option<DecisionOutcome> {
        let mut outcome = DecisionOutcome {
            sets: ByMode::default(),
            window: FiringWindow::new(k),
            all_stand: true,
        };
        for set in sets.iter().flatten() {
            let wanted = self.decide(k, set)?;
            if let (Some(follower), true) = (follower, has_not_fired)
                && let Some(firing) = self.firing_instants(k, &set.members, &wanted, follower)
            {
                outcome
                    .window
                    .record_firing(set.members.mode, firing.instants);
                if firing.is_certain {
                    continue;
                }
            }
            outcome.all_stand &=
                set.members.mode == MotionMode::Standing && wanted.range().high() <= 0.0;
            self.propagate_set(k, set, &wanted, follower, &mut outcome.sets)?;
        }
        Some(outcome)
    }

    /// Propagates one set to the next decision, and joins it to `next`. Returns `None` if the analysis ended early.
    fn propagate_set(
        &mut self,
        k: u32,
        set: &StateSet,
        wanted: &AffineForm,
        follower: Option<&BrakingVehicle>,
        next: &mut ByMode<StateSet>,
    ) -> Option<()> {
        let every = self.scene.decision_steps;
        let driven = self.advance_follower(&set.members, wanted);
        let driven_m = driven.as_ref().map(|driven| driven.min_gap_m);
        let members = set.members.clone();
        for members in members
            .with_follower(driven.map(|driven| driven.state))
            .after_decision(wanted, self.step, every)
            .into_iter()
            .flatten()
        {
            let now = self.observe(k + every, members, follower);
            if self.record_gaps(k, &set.gaps, &now, wanted, follower, driven_m) {
                self.tube = None;
            } else if self.scene.stop_when_undecided && self.result.undecided.is_some() {
                return None;
            } else {
                let joined = &mut next[now.members.mode as usize];
                *joined = Some(match joined.take() {
                    Some(others) => {
                        self.observe(k + every, others.members.join(&now.members), follower)
                    }
                    None => now,
                });
            }
        }
        Some(())
    }

    fn record_too_many_sets(&mut self, k: u32) {
        self.record_undecided(Undecided::TooManySets { step: k }, &self.gaps[1].clone());
    }

    /// Propagates the members whose follower fires in some windows. Returns as [`propagate`](Self::propagate).
    fn propagate_fired(&mut self, windows: Vec<FiringWindow>) -> Option<bool> {
        let mut all_collide = true;
        for window in merge_windows(windows, self.scene) {
            self.window_count += 1;
            if self.window_count > MAX_WINDOWS {
                self.record_too_many_sets(window.k);
                return None;
            }
            let follower = self.latched_follower(window.instants);
            all_collide &=
                self.propagate(window.k, window.into_firing_sets(), Some(&follower), false)?;
        }
        Some(all_collide)
    }

    /// Returns the acceleration of a set until the next decision, or `None` if it is too wide.
    fn decide(
        &mut self,
        k: u32,
        StateSet {
            members,
            observation,
            ..
        }: &StateSet,
    ) -> Option<AffineForm> {
        let of_leader = OPS_PER_LEADER_SYMBOL * self.leader.symbol_count() as u64;
        self.budget.charge(
            OPS_PER_DECISION + of_leader + OPS_PER_STEP * u64::from(self.scene.decision_steps),
        );
        let ReachProblem {
            controller,
            observation_error,
            follower,
            ..
        } = self.scene;
        let wanted = controller.decide_with_budget(
            observation,
            observation_error,
            follower.is_some(),
            self.budget,
        );
        let wanted = wanted.with_rest_as_symbol(members.next_symbol);
        if members.ego.speed.radius() < MAX_RADIUS_MPS && wanted.radius() < MAX_RADIUS_MPS {
            return Some(wanted);
        }
        self.record_undecided(Undecided::TooWide { step: k }, &members.ego.speed);
        None
    }

    fn are_others_at_rest(&self, k: u32, follower: Option<&BrakingVehicle>) -> bool {
        // A follower with a law may creep for ever.
        let has_stood = follower.is_none_or(|follower| follower.has_stood(k, self.step))
            && self.scene.follower_law().is_none();
        has_stood && self.leader.has_stood(k, self.step)
    }

    /// Adds what sets observe at instant k to the reach tube.
    fn record_tube(&mut self, k: u32, sets: &ByMode<StateSet>) {
        let Some(tube) = &mut self.tube else { return };
        let decision = (k / self.scene.decision_steps) as usize;
        for set in sets.iter().flatten() {
            let ranges = set.observation.each_ref().map(AffineForm::range);
            match tube.get_mut(decision) {
                Some(hull) => *hull = std::array::from_fn(|i| hull[i].hull(ranges[i])),
                None => tube.push(ranges),
            }
        }
    }

    /// Returns `members` at instant k with observation and gaps.
    fn observe(&self, k: u32, members: EgoSet, follower: Option<&BrakingVehicle>) -> StateSet {
        let leader = self.leader.state_at(k, self.step);
        let ego = members.ego.clone();
        let [ahead, behind] = &self.gaps;
        let ahead = ahead.clone().plus(&leader.distance).minus(&ego.distance);
        let follower = members
            .follower
            .clone()
            .or_else(|| Some(follower?.state_at(k, self.step)));
        let behind = match &follower {
            Some(follower) => behind.clone().plus(&ego.distance).minus(&follower.distance),
            None => AffineForm::constant(Interval::point(self.scene.controller.empty_gap_m)),
        };
        let follower = follower.unwrap_or_else(|| VehicleState {
            acceleration: AffineForm::default(),
            ..ego.clone()
        });
        StateSet {
            members,
            gaps: [ahead.clone(), behind.clone()],
            observation: [
                ahead,
                behind,
                leader.speed,
                ego.speed,
                follower.speed,
                leader.acceleration,
                ego.acceleration,
                follower.acceleration,
            ],
        }
    }

    /// Returns when the brake may fire before the next decision, or `None` if it does not.
    fn firing_instants(
        &self,
        k: u32,
        members: &EgoSet,
        wanted: &AffineForm,
        follower: &BrakingVehicle,
    ) -> Option<BrakeFiring> {
        let theta = Interval::point(self.scene.latched_ttc_s()?);
        let mut first = None;
        for j in 0..self.scene.decision_steps {
            let ego = members.ego_after(wanted, self.step, j);
            let mut guard = self.gaps[1].clone().plus(&ego.distance);
            guard.add_scaled(&ego.speed, theta);
            guard.add_scaled(
                &follower.speed,
                -(theta + Interval::point(f64::from(k + j)) * self.step),
            );
            let guard = guard.range();
            let instant = f64::from(k + j);
            if guard.low() < 0.0 {
                let first = *first.get_or_insert(instant);
                if guard.high() < 0.0 {
                    return Some(BrakeFiring {
                        instants: [first, instant],
                        is_certain: true,
                    });
                }
            }
        }
        let last = f64::from(k + self.scene.decision_steps - 1);
        first.map(|first| BrakeFiring {
            instants: [first, last],
            is_certain: false,
        })
    }

    /// Returns the follower at the next decision, or `None` if no follower has a law.
    fn advance_follower(&self, members: &EgoSet, wanted: &AffineForm) -> Option<DrivenFollower> {
        let start = members.follower.as_ref()?;
        self.budget.charge(
            OPS_PER_LAW_SYMBOL * members.next_symbol as u64 * u64::from(self.scene.decision_steps),
        );
        let behind = LawFollower::new(
            self.scene.follower_law()?,
            &self.scene.ranges,
            &self.gaps[1],
            self.step,
        );
        let eighth = self.step.sqr() * Interval::point(0.125);
        let ahead = wanted.range().max(Interval::ZERO);
        let mut own = start.clone();
        let mut ego = members.ego.clone();
        let mut min_gap_m = f64::INFINITY;
        for j in 1..=self.scene.decision_steps {
            let ego_later = members.ego_after(wanted, self.step, j);
            let acceleration = behind.acceleration_behind(&ego, &own);
            let later = behind.advance(&own, &acceleration);
            let m = ahead + (-acceleration.range()).max(Interval::ZERO);
            let ends = behind
                .gap(&ego, &own)
                .range()
                .min(behind.gap(&ego_later, &later).range());
            min_gap_m = min_gap_m.min((ends - m * eighth).low());
            (own, ego) = (later, ego_later);
        }
        Some(DrivenFollower {
            state: own,
            min_gap_m,
        })
    }

    /// Records the gaps over a decision interval. `driven_m` bounds the gap to a follower with a law. Returns true if
    /// all members surely collide.
    fn record_gaps(
        &mut self,
        k: u32,
        before: &[AffineForm; 2],
        now: &StateSet,
        wanted: &AffineForm,
        follower: Option<&BrakingVehicle>,
        driven_m: Option<f64>,
    ) -> bool {
        let acts_mps2 = wanted.range();
        let ahead_m = self.min_gap_m([&before[0], &now.gaps[0]], (-acts_mps2).max(Interval::ZERO));
        // There is no follower, or one that brakes at most as hard as stated.
        let moves = now.members.ego.speed.range().low() > 0.0;
        let ahead = if moves {
            acts_mps2
        } else {
            acts_mps2.max(Interval::ZERO)
        };
        // No vehicle reverses: the gap to a standing follower never falls.
        let latched = follower.filter(|follower| !follower.has_stood(k, self.step));
        let latched_m = latched.map(|latched| {
            self.min_gap_m(
                [&before[1], &now.gaps[1]],
                (ahead + latched.rate.range()).max(Interval::ZERO),
            )
        });
        let mut collides = false;
        for (pair, gap_m) in [Some(ahead_m), latched_m.or(driven_m)]
            .into_iter()
            .flatten()
            .enumerate()
        {
            self.record_gap(k, pair, gap_m, &now.gaps[pair]);
            collides |= now.gaps[pair].range().high() < 0.0;
        }
        collides
    }

    /// Bounds a gap in metres over a decision interval from below, by its values at both `ends` and a bound of its
    /// second derivative.
    fn min_gap_m(&self, ends: [&AffineForm; 2], second_derivative: Interval) -> f64 {
        let interval = Interval::point(f64::from(self.scene.decision_steps)) * self.step;
        let eighth = interval.sqr() * Interval::point(0.125);
        let least = ends[0].range().min(ends[1].range());
        (least - second_derivative * eighth).low()
    }

    fn record_gap(&mut self, k: u32, pair: usize, gap_m: f64, gap: &AffineForm) {
        self.result.gaps_m[pair] = self.result.gaps_m[pair].min(gap_m);
        if gap_m <= 0.0 {
            let undecided = Undecided::MayCollide {
                pair,
                step: k,
                gap_m,
            };
            self.record_undecided(undecided, gap);
        }
    }

    /// Records the first undecided result, and the sensitivity to each dimension.
    fn record_undecided(&mut self, undecided: Undecided, about: &AffineForm) {
        if self.result.undecided.is_none() {
            self.result.undecided = Some(undecided);
            let terms = about.terms();
            self.result.sensitivity =
                std::array::from_fn(|i| terms.get(i).copied().unwrap_or(0.0).abs());
        }
    }
}

#[cfg(test)]
mod tests;
