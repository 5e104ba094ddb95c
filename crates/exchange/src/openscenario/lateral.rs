//! Lateral positions of an entity over time, and the stays of its body in a lane.

use super::speed_plan::{SpeedKnot, SpeedPlan};
use super::vocabulary::TransitionShape;
use super::xml::Node;

/// Parts of a body and a lane that overlap by less are beside each other, in metres.
const EDGE_TOLERANCE_M: f64 = 1e-6;

/// Extent of a lateral movement.
#[derive(Debug, Clone, Copy)]
pub(super) enum LateralExtent {
    /// Duration in seconds.
    Time(f64),
    /// Position at which the movement begins, and distance along the road, in metres.
    Distance { from_m: f64, length_m: f64 },
}

/// A movement from one lateral position to another.
#[derive(Debug, Clone, Copy)]
pub(super) struct LateralMove<'a> {
    pub(super) node: Node<'a>,
    /// Time from which the movement may begin; one over a distance begins at a position.
    pub(super) start_s: f64,
    pub(super) from_m: f64,
    pub(super) to_m: f64,
    pub(super) shape: TransitionShape,
    pub(super) extent: LateralExtent,
    pub(super) depends_on_controller: bool,
    /// Time at which another action or a stop ends the movement.
    pub(super) cut_s: Option<f64>,
}

impl LateralMove<'_> {
    /// Returns the lateral position at a time.
    fn at(&self, time_s: f64, plan: &SpeedPlan) -> f64 {
        let time_s = self.cut_s.map_or(time_s, |cut_s| time_s.min(cut_s));
        let share = match self.extent {
            LateralExtent::Time(duration_s) => (time_s - self.start_s) / duration_s,
            LateralExtent::Distance { from_m, length_m } => {
                (plan.at(time_s).position_m - from_m) / length_m
            }
        };
        // A movement without extent is complete at once.
        let share = if share.is_nan() { 1.0 } else { share };
        self.from_m + (self.to_m - self.from_m) * self.shape.progress(share.clamp(0.0, 1.0))
    }

    /// Returns true if the movement has begun at a time and a position.
    fn has_begun(&self, state: SpeedKnot) -> bool {
        let is_there = match self.extent {
            LateralExtent::Time(_) => true,
            LateralExtent::Distance { from_m, .. } => state.position_m >= from_m - EDGE_TOLERANCE_M,
        };
        is_there && self.start_s <= state.time_s
    }

    /// Returns the time at which the movement begins; infinite if it never does.
    fn begin_s(&self, plan: &SpeedPlan) -> f64 {
        match self.extent {
            LateralExtent::Time(_) => self.start_s,
            LateralExtent::Distance { from_m, .. } => plan.reach_s(self.start_s, from_m),
        }
    }

    /// Returns the time at which the movement is complete; `None` if it never is.
    pub(super) fn end_s(&self, plan: &SpeedPlan) -> Option<f64> {
        self.time_at_share(1.0, plan)
    }

    /// Returns true if the movement is complete at a time.
    pub(super) fn has_ended(&self, time_s: f64, plan: &SpeedPlan) -> bool {
        match self.extent {
            LateralExtent::Time(duration_s) => self.start_s + duration_s <= time_s,
            LateralExtent::Distance { from_m, length_m } => {
                plan.at(time_s).position_m >= from_m + length_m
            }
        }
    }

    fn time_at_share(&self, share: f64, plan: &SpeedPlan) -> Option<f64> {
        let time_s = match self.extent {
            LateralExtent::Time(duration_s) => self.start_s + share * duration_s,
            LateralExtent::Distance { from_m, length_m } => {
                plan.reach_s(self.start_s, from_m + share * length_m)
            }
        };
        (time_s < f64::INFINITY).then_some(time_s)
    }

    /// Returns the time at which the movement passes a lateral position between its ends.
    fn passes_s(&self, lateral_m: f64, plan: &SpeedPlan) -> Option<f64> {
        let [passed_m, whole_m] = [lateral_m - self.from_m, self.to_m - self.from_m];
        // A movement that begins at the edge passes it.
        let moved = if passed_m.abs() <= EDGE_TOLERANCE_M {
            0.0
        } else {
            passed_m / whole_m
        };
        let ends_at_edge = (lateral_m - self.to_m).abs() <= EDGE_TOLERANCE_M;
        if ends_at_edge || whole_m == 0.0 {
            return None;
        }
        if !(0.0..1.0).contains(&moved) {
            return None;
        }
        self.time_at_share(self.shape.share_until(moved), plan)
    }
}

/// Lateral positions over time, in metres to the left of the road's direction.
#[derive(Debug, Clone)]
pub(super) struct LateralPlan<'a> {
    initial_m: f64,
    moves: Vec<LateralMove<'a>>,
}

/// A change between the lane and the space beside it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing<'a> {
    pub(super) time_s: f64,
    pub(super) node: Node<'a>,
    pub(super) depends_on_controller: bool,
}

/// A time during which a body overlaps the lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneStay<'a> {
    /// `None` if the stay begins with the scenario.
    pub(super) enters: Option<Crossing<'a>>,
    /// `None` if the stay has no end.
    pub(super) leaves: Option<Crossing<'a>>,
}

impl<'a> LateralPlan<'a> {
    pub(super) fn constant(initial_m: f64) -> Self {
        Self {
            initial_m,
            moves: Vec::new(),
        }
    }

    pub(super) fn moves(&self) -> &[LateralMove<'a>] {
        &self.moves
    }

    /// Returns the lateral position at a time.
    pub(super) fn at(&self, time_s: f64, plan: &SpeedPlan) -> f64 {
        let state = plan.at(time_s);
        let next = self.moves.partition_point(|step| step.has_begun(state));
        match next.checked_sub(1).and_then(|last| self.moves.get(last)) {
            Some(step) => step.at(time_s, plan),
            None => self.initial_m,
        }
    }

    /// Returns true if the lateral position changes between two times.
    pub(super) fn changes_between(&self, plan: &SpeedPlan, [from_s, to_s]: [f64; 2]) -> bool {
        self.moves.iter().any(|step| {
            let end_s = step.cut_s.or_else(|| step.end_s(plan));
            let moves = step.from_m != step.to_m;
            moves && step.begin_s(plan) < to_s && end_s.is_none_or(|end_s| end_s > from_s)
        })
    }

    /// Ends the movement at a time.
    pub(super) fn cut(&mut self, time_s: f64, plan: &SpeedPlan) {
        let state = plan.at(time_s);
        let is_later =
            |step: &mut LateralMove<'_>| step.start_s >= time_s || !step.has_begun(state);
        while self.moves.pop_if(is_later).is_some() {}
        if let Some(last) = self.moves.last_mut() {
            last.cut_s = Some(last.cut_s.map_or(time_s, |cut_s| cut_s.min(time_s)));
        }
    }

    /// Ends the movement at a time, and adds others.
    pub(super) fn replace(
        &mut self,
        time_s: f64,
        moves: impl Iterator<Item = LateralMove<'a>>,
        plan: &SpeedPlan,
    ) {
        self.cut(time_s, plan);
        self.moves.extend(moves);
    }

    /// Returns the stays of a body of a width in the lane between two lateral positions, until a time.
    pub(super) fn stays(
        &self,
        plan: &SpeedPlan,
        [low_m, high_m]: [f64; 2],
        width_m: f64,
        stop_s: f64,
    ) -> Vec<LaneStay<'a>> {
        let levels_m = [low_m - width_m / 2.0, high_m + width_m / 2.0];
        let mut stays = LaneStays {
            levels_m,
            stays: Vec::new(),
            is_inside: false,
        };
        stays.begin(self.initial_m);
        for (index, step) in self.moves.iter().enumerate() {
            let next_s = self
                .moves
                .get(index + 1)
                .map_or(stop_s, |next| next.begin_s(plan));
            stays.add_move(
                step,
                plan,
                step.cut_s.unwrap_or(stop_s).min(next_s).min(stop_s),
            );
        }
        stays.stays
    }
}

/// Stays that are being found.
struct LaneStays<'a> {
    /// Lateral positions of the middle of the body between which it overlaps the lane.
    levels_m: [f64; 2],
    stays: Vec<LaneStay<'a>>,
    is_inside: bool,
}

impl<'a> LaneStays<'a> {
    fn contains(&self, lateral_m: f64) -> bool {
        let [low_m, high_m] = self.levels_m;
        low_m + EDGE_TOLERANCE_M < lateral_m && lateral_m < high_m - EDGE_TOLERANCE_M
    }

    fn begin(&mut self, lateral_m: f64) {
        self.is_inside = self.contains(lateral_m);
        if self.is_inside {
            self.stays.push(LaneStay {
                enters: None,
                leaves: None,
            });
        }
    }

    /// Adds the crossings of a movement until a time.
    fn add_move(&mut self, step: &LateralMove<'a>, plan: &SpeedPlan, until_s: f64) {
        let begin_s = step.begin_s(plan);
        if begin_s > until_s {
            return;
        }
        if step.shape == TransitionShape::Step {
            let is_inside = self.contains(step.to_m);
            self.cross(step, begin_s, is_inside);
            return;
        }
        let mut passes: Vec<(f64, bool)> = self
            .levels_m
            .iter()
            .enumerate()
            .filter_map(|(index, level_m)| {
                // Inside is above the lower level and below the upper one.
                let is_inside = (step.to_m > step.from_m) == (index == 0);
                Some((step.passes_s(*level_m, plan)?, is_inside))
            })
            .filter(|(time_s, _)| *time_s <= until_s)
            .collect();
        passes.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (time_s, is_inside) in passes {
            self.cross(step, time_s, is_inside);
        }
    }

    fn cross(&mut self, step: &LateralMove<'a>, time_s: f64, is_inside: bool) {
        if self.is_inside == is_inside {
            return;
        }
        self.is_inside = is_inside;
        let crossing = Some(Crossing {
            time_s,
            node: step.node,
            depends_on_controller: step.depends_on_controller,
        });
        match self.stays.last_mut().filter(|_| !is_inside) {
            Some(last) => last.leaves = crossing,
            None => self.stays.push(LaneStay {
                enters: crossing,
                leaves: None,
            }),
        }
    }
}
