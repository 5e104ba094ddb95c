//! Speeds of an entity over time, and the transitions of actions.

use super::error::ScenarioImportError;
use super::limits::MAX_SAMPLES;
use super::xml::Node;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Interval of the samples of curved transitions, in seconds.
const SAMPLE_S: f64 = 0.01;
/// Maximum duration of a curved transition, in seconds.
const MAX_TRANSITION_S: f64 = 3600.0;

/// Course of a transition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum TransitionShape {
    Linear,
    Cubic,
    Sinusoidal,
    Step,
}

/// Shape and extent of a transition.
#[derive(Debug, Clone, Copy)]
pub(super) struct TransitionDynamics {
    pub(super) shape: TransitionShape,
    extent: TransitionExtent,
}

#[derive(Debug, Clone, Copy)]
enum TransitionExtent {
    Time(f64),
    /// Largest rate of change, per second.
    Rate(f64),
    /// Distance along the road, in metres.
    Distance(f64),
}

impl TransitionDynamics {
    pub(super) fn read(node: Node<'_>) -> Result<Self> {
        node.only(
            &[],
            &[
                "dynamicsShape",
                "dynamicsDimension",
                "value",
                "followingMode",
            ],
        )?;
        node.expect("followingMode", &["position"])?;
        let value = node.non_negative("value")?;
        let shape = match node.text("dynamicsShape")?.as_str() {
            "linear" => TransitionShape::Linear,
            "cubic" => TransitionShape::Cubic,
            "sinusoidal" => TransitionShape::Sinusoidal,
            "step" => TransitionShape::Step,
            other => return Err(node.refuse(format!("the shape `{other}` is not supported"))),
        };
        let extent = match node.text("dynamicsDimension")?.as_str() {
            "time" => TransitionExtent::Time(value),
            "rate" => TransitionExtent::Rate(value),
            "distance" => TransitionExtent::Distance(value),
            other => return Err(node.refuse(format!("the dimension `{other}` is not supported"))),
        };
        Ok(Self { shape, extent })
    }

    /// Returns the time of a change by `change`, in seconds. `distance_s` returns the time for a distance. Infinite if
    /// the change never ends.
    pub(super) fn duration_s(self, change: f64, distance_s: impl FnOnce(f64) -> f64) -> f64 {
        let mean_rate = match self.shape {
            TransitionShape::Linear => 1.0,
            TransitionShape::Cubic => 1.5,
            TransitionShape::Sinusoidal => std::f64::consts::FRAC_PI_2,
            TransitionShape::Step => return 0.0,
        };
        match self.extent {
            _ if change == 0.0 => 0.0,
            TransitionExtent::Time(time_s) => time_s,
            TransitionExtent::Rate(rate) => mean_rate * change.abs() / rate,
            TransitionExtent::Distance(distance_m) => distance_s(distance_m),
        }
    }

    /// Returns the share of the change after a share of the time.
    pub(super) fn progress(self, share: f64) -> f64 {
        match self.shape {
            TransitionShape::Linear => share,
            TransitionShape::Cubic => share * share * (3.0 - 2.0 * share),
            TransitionShape::Sinusoidal => 0.5 * (1.0 - libm::cos(std::f64::consts::PI * share)),
            TransitionShape::Step => 1.0,
        }
    }

    /// Returns the share of the time after which a share of the change is done.
    pub(super) fn share_until(self, target_share: f64) -> f64 {
        let mut low = 0.0;
        let mut high = 1.0;
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.progress(middle) < target_share {
                low = middle
            } else {
                high = middle
            }
        }
        high
    }
}

/// Takes samples from those that a file may still have.
pub(super) fn take_samples(node: Node<'_>, samples: usize, left: &mut usize) -> Result<()> {
    *left = left.checked_sub(samples).ok_or_else(|| {
        let what =
            "samples of curved transitions, entries of speed profiles and vertices of trajectories";
        node.refuse(format!("the scenario has more than {MAX_SAMPLES} {what}"))
    })?;
    Ok(())
}

/// Piecewise linear speed over time, and the position that follows from it.
#[derive(Debug, Clone)]
pub(super) struct SpeedPlan {
    knots: Vec<SpeedKnot>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SpeedKnot {
    pub(super) time_s: f64,
    pub(super) speed_mps: f64,
    pub(super) position_m: f64,
}

impl SpeedPlan {
    pub(super) fn constant(position_m: f64, speed_mps: f64) -> Self {
        Self {
            knots: vec![SpeedKnot {
                time_s: 0.0,
                speed_mps,
                position_m,
            }],
        }
    }

    /// Returns the work of finding the state at a time.
    pub(super) fn state_work(&self) -> u64 {
        8 + 4 * u64::from(self.knots.len().max(1).ilog2())
    }

    pub(super) fn knots(&self) -> &[SpeedKnot] {
        &self.knots
    }

    /// Returns the state at a time; the last speed is held.
    pub(super) fn at(&self, time_s: f64) -> SpeedKnot {
        let next = self
            .knots
            .partition_point(|knot| knot.time_s <= time_s)
            .max(1);
        let Some(&from) = self.knots.get(next - 1) else {
            return SpeedKnot {
                time_s,
                speed_mps: 0.0,
                position_m: 0.0,
            };
        };
        let passed_s = time_s - from.time_s;
        let speed_mps = match self.knots.get(next) {
            Some(to) => {
                from.speed_mps
                    + (to.speed_mps - from.speed_mps) * passed_s / (to.time_s - from.time_s)
            }
            None => from.speed_mps,
        };
        SpeedKnot {
            time_s,
            speed_mps,
            position_m: from.position_m + 0.5 * (from.speed_mps + speed_mps) * passed_s,
        }
    }

    /// Returns true if the speed differs at any knot of this plan.
    pub(super) fn differs_from(&self, other: &Self) -> bool {
        self.knots
            .iter()
            .any(|knot| other.at(knot.time_s).speed_mps != knot.speed_mps)
    }

    /// Discards the plan after a time.
    pub(super) fn cut(&mut self, time_s: f64) {
        let last = self.at(time_s);
        self.knots.retain(|knot| knot.time_s < time_s);
        self.knots.push(last);
    }

    /// Adds a knot. A jump at one time takes the shortest time that separates knots.
    pub(super) fn push(&mut self, time_s: f64, speed_mps: f64) {
        let Some(&last) = self.knots.last() else {
            return;
        };
        let time_s = time_s.max(
            last.time_s
                + if speed_mps == last.speed_mps {
                    0.0
                } else {
                    1e-9
                },
        );
        if time_s > last.time_s {
            let position_m =
                last.position_m + 0.5 * (last.speed_mps + speed_mps) * (time_s - last.time_s);
            self.knots.push(SpeedKnot {
                time_s,
                speed_mps,
                position_m,
            });
        }
    }

    /// Changes the speed from a time on, and returns the end of the change. Takes the samples of a curved change from
    /// `samples_left`.
    pub(super) fn change_speed(
        &mut self,
        node: Node<'_>,
        from_s: f64,
        to_mps: f64,
        dynamics: TransitionDynamics,
        samples_left: &mut usize,
    ) -> Result<f64> {
        self.cut(from_s);
        let from_mps = self.at(from_s).speed_mps;
        let duration_s = dynamics.duration_s(to_mps - from_mps, |distance_m| {
            2.0 * distance_m / (from_mps + to_mps)
        });
        if duration_s == f64::INFINITY {
            let [from_mps, to_mps] = [from_mps, to_mps].map(format_number);
            return Err(node.refuse(format!(
                "at this rate the speed would never change from {from_mps} to {to_mps} m/s"
            )));
        }
        let is_straight = matches!(
            dynamics.shape,
            TransitionShape::Linear | TransitionShape::Step
        );
        if duration_s.is_nan() || !is_straight && duration_s > MAX_TRANSITION_S {
            return Err(node.refuse(format!("the change takes longer than {MAX_TRANSITION_S} s")));
        }
        if !is_straight {
            let samples = (duration_s / SAMPLE_S).ceil();
            take_samples(node, samples as usize, samples_left)?;
            for sample in 1..samples as usize {
                let share = sample as f64 / samples;
                let speed_mps = from_mps + (to_mps - from_mps) * dynamics.progress(share);
                self.push(from_s + share * duration_s, speed_mps);
            }
        }
        self.push(from_s + duration_s, to_mps);
        Ok(from_s + duration_s)
    }

    /// Returns the time after `from_s` within which a distance is travelled; infinite if it is never reached.
    pub(super) fn travel_time_s(&self, from_s: f64, distance_m: f64) -> f64 {
        let goal_m = self.at(from_s).position_m + distance_m;
        if self.at(from_s + MAX_TRANSITION_S).position_m < goal_m {
            return f64::INFINITY;
        }
        let mut low_s = 0.0;
        let mut high_s = MAX_TRANSITION_S;
        for _ in 0..60 {
            let middle_s = 0.5 * (low_s + high_s);
            if self.at(from_s + middle_s).position_m < goal_m {
                low_s = middle_s
            } else {
                high_s = middle_s
            }
        }
        high_s
    }

    /// Follows vertices from the first on.
    ///
    /// The shortest segment is the step of the simulation, except at the end, where a collision may cut it. Positions
    /// determine only mean speeds. Over segments of more than a step the speed is constant up to one step from each
    /// end. In shorter segments the speed at the end follows from that at the start; errors of the speed alternate and
    /// decay, and errors of the position are corrected in the next segment.
    pub(super) fn follow(&mut self, vertices: &[PathVertex]) {
        let [start, later @ ..] = vertices else {
            return;
        };
        self.cut(start.time_s);
        let step_s = shortest_step_s(vertices);
        for (index, to) in later.iter().enumerate() {
            let Some(segment) = PathSegment::starting_at(vertices, index) else {
                return;
            };
            if segment.span_s <= 1.5 * step_s {
                self.follow_step(to, segment.span_s);
                continue;
            }
            // After a step, the next mean speed says nothing about the speed at the vertex.
            let next_mps = PathSegment::starting_at(vertices, index + 1)
                .filter(|next| next.span_s > 1.5 * step_s)
                .map(|next| next.mean_mps);
            self.follow_long_segment(to, segment, next_mps, step_s);
        }
    }

    /// Follows a segment of at most one step to a vertex. The speed at its end corrects the error of the position.
    fn follow_step(&mut self, to: &PathVertex, span_s: f64) {
        /// Share of an alternating error that remains after a segment.
        const REMAINING_RIPPLE: f64 = 0.99;
        let from = self.at(to.time_s - span_s);
        let covered_m = to.position_m - from.position_m;
        let wanted_mps =
            (1.0 + REMAINING_RIPPLE) * covered_m / span_s - REMAINING_RIPPLE * from.speed_mps;
        self.push(to.time_s, wanted_mps.max(0.0));
    }

    /// Follows a segment of more than one step to a vertex, at a constant speed between two ramps of one step.
    fn follow_long_segment(
        &mut self,
        to: &PathVertex,
        segment: PathSegment,
        next_mps: Option<f64>,
        step_s: f64,
    ) {
        /// Largest difference of the speed at the end of a segment from its mean in crumple's export, in m/s.
        const SPEED_TOLERANCE_MPS: f64 = 0.005;
        let PathSegment { mean_mps, span_s } = segment;
        let from = self.at(to.time_s - span_s);
        let covered_m = to.position_m - from.position_m;
        // A larger change is a jump, which begins at the vertex.
        let smooth_mps =
            next_mps.filter(|next_mps| (next_mps - mean_mps).abs() <= 2.0 * SPEED_TOLERANCE_MPS);
        let to_mps = 0.5 * (mean_mps + smooth_mps.unwrap_or(mean_mps));
        let ramp_s = step_s.min(span_s / 2.0);
        let constant_mps =
            ((covered_m - ramp_s * 0.5 * (from.speed_mps + to_mps)) / (span_s - ramp_s)).max(0.0);
        self.push(to.time_s - span_s + ramp_s, constant_mps);
        self.push(to.time_s - ramp_s, constant_mps);
        self.push(to.time_s, to_mps.max(0.0));
    }
}

/// A vertex of a trajectory.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathVertex {
    pub(super) time_s: f64,
    pub(super) position_m: f64,
}

/// Mean speed and duration between two vertices.
#[derive(Debug, Clone, Copy)]
struct PathSegment {
    mean_mps: f64,
    span_s: f64,
}

impl PathSegment {
    /// Returns the segment from a vertex to the next one.
    fn starting_at(vertices: &[PathVertex], index: usize) -> Option<Self> {
        let [from, to] = vertices.get(index..index + 2)? else {
            return None;
        };
        let span_s = to.time_s - from.time_s;
        Some(Self {
            mean_mps: (to.position_m - from.position_m) / span_s,
            span_s,
        })
    }
}

/// Returns the shortest time between vertices, without the last two, which a collision may move.
fn shortest_step_s(vertices: &[PathVertex]) -> f64 {
    vertices
        .windows(2)
        .rev()
        .skip(2)
        .filter_map(|pair| Some(pair.last()?.time_s - pair.first()?.time_s))
        .fold(f64::INFINITY, f64::min)
}
