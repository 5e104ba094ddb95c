//! Proof that a collision is unavoidable: a weighted sum of the conditions of an escape is a contradiction.
//!
//! # Conditions of an escape
//! Let a be the egos' accelerations, any measurable functions of time within [-b, A]. Fix a member of the box (a value
//! in each interval of the scene) and suppose that no collision occurs. The follower's brake first fires at some
//! instant τ (N: never), which lies in exactly one branch [τ1, τ2]. A follower that brakes later is never further back.
//! So at instant k the follower is at R_k or ahead of it, where R_k is its position if the brake fires at τ1.
//!
//! An ego of length ℓ has position x_k and speed v_k at instant k. The leader's rear bumper is at F_k. Before braking,
//! the follower is at r_k = r_0 + v_r k h. Its brake has TTC threshold θ. Each of these *rows* is at most zero:
//!
//! ```text
//! front    x¹_k - F_k                               the first ego
//! between  xⁱ⁺¹_k - xⁱ_k + ℓⁱ                       each ego and the next
//! rear     R_k + ℓ - x_k                            the last ego
//! speed    -v_k                                     each ego
//! unfired  -[(x_k - ℓ - r_k) - θ (v_r - v_k)]       the last ego, k < τ1: the brake has not fired
//! fired    +[(x_τ - ℓ - r_τ) - θ (v_r - v_τ)]       the last ego, only if τ1 = τ2 = τ < N
//! ```
//!
//! # Contradiction
//! The sum of the rows, multiplied by numbers that are not negative, is at most zero. It splits into one expression for
//! each ego, where w_k and s_k are the total weights of its position and speed at t_k = k h:
//!
//! ```text
//! constant + Σ_k (w_k x_k + s_k v_k),   x_k = x_0 + v_0 t_k + ∫ (t_k - t)⁺ a dt,   v_k = v_0 + ∫ [t < t_k] a dt
//! = constant + x_0 Σ w_k + v_0 Σ (w_k t_k + s_k) + ∫ q(t) a(t) dt,   q(t) = Σ over t_k > t of (w_k (t_k - t) + s_k).
//! ```
//!
//! q is linear inside each step, and q a ≥ φ(q) = min(-b q, A q). Let L be the sum with φ(q) instead of the integrand
//! q a. The sum is at least L. If L > 0 over the whole box, this branch has no escape; if this holds in every branch,
//! no escape exists. The multipliers need not solve any equation: with unsuitable ones, L is valid but proves nothing.
//!
//! Let the collision multipliers (front, between, rear) of a branch with sum L add up to Y. Then some collision row is
//! at least L / Y: two vehicles would overlap by that many metres if they could pass through each other.
//!
//! # Gap bound
//! Let G not be negative, and suppose that every gap stays larger than G. Then each collision row is less than -G, and
//! the sum is less than -G Y, for Y > 0. This contradicts L >= -G Y over the whole box. If L >= -G Y in every branch
//! with Y > 0, and L > 0 in every other branch, some gap gets as small as G.
//!
//! # Application to the simulator and to vehicles
//! Every ego behaviour is a measurable acceleration within [-b, A], for any observation. It may be held over steps,
//! zero at standstill, delayed, lagging or limited in jerk. Delay, lag and sensor noise only restrict the behaviour.

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::bounded;
use crate::claim::{MAX_EGOS, MAX_STEPS, Scene, SceneEgo, SceneFollower};
use crate::interval::Interval;
use crate::rejection::Rejection;
use crate::scope::Scope;
use crate::work::{OPS_PER_INTERVAL_OP, OpBudget};
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

const OPS_PER_INSTANT: u64 = 20 * OPS_PER_INTERVAL_OP;

/// A proof that every profile ends in a collision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnavoidableClaim {
    /// Scene of the claim.
    pub scene: Scene,
    /// A proof for each range of firing instants of the follower's brake; a single one without a follower.
    #[serde(deserialize_with = "bounded::deserialize_list::<{ MAX_STEPS as usize + 1 }, _, _>")]
    pub branches: Vec<Branch>,
}

/// Pairs of an instant, increasing, and a multiplier that is not negative. In a file `[[instant, multiplier], …]`.
pub type MultiplierRows = Vec<(u32, f64)>;

/// Multipliers for all profiles in which the follower's brake first fires at an instant from `first` to `last`.
///
/// Instant N means never. The [module](self) defines the rows; absent ones are empty or zero.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Branch {
    /// Earliest firing instant.
    pub first: u32,
    /// Latest firing instant.
    pub last: u32,
    /// The first ego stays behind the leader, instants 0 to N.
    pub front: MultiplierRows,
    /// Ego i + 1 stays behind ego i, one list for each pair.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub between: Vec<MultiplierRows>,
    /// The last ego stays ahead of the follower, instants 0 to N.
    pub rear: MultiplierRows,
    /// No ego reverses, one list for each ego, instants 0 to N.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub speed: Vec<MultiplierRows>,
    /// The follower's brake has not fired, instants before `first`.
    pub unfired: MultiplierRows,
    /// The follower's brake fires at `first`; only if `first` = `last` < N.
    pub fired: f64,
}

impl Claim for UnavoidableClaim {
    fn name(&self) -> &'static str {
        "unavoidable"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::Scene {
            scene: &self.scene,
            profile: None,
        }
    }

    fn assumptions(&self) -> Vec<Assumption> {
        self.scene.assumptions(Assumption::EgoWithinLimits)
    }

    fn scope(&self) -> Scope {
        self.scene.scope()
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        let overlap_m = min_overlap_m(&self.scene, &self.branches, input.work, positive_overlap_m)?;
        Ok(ProvedClaim::Unavoidable {
            overlap_m,
            horizon_s: self.scene.horizon_s(),
        })
    }
}

/// Returns the least proved overlap of all branches, in metres.
pub(crate) fn min_overlap_m(
    scene: &Scene,
    branches: &[Branch],
    work: &OpBudget,
    proved_m: impl Fn(&Scene, &Branch, usize) -> Result<f64, Rejection>,
) -> Result<f64, Rejection> {
    scene.check()?;
    check_tiling(scene, branches)?;
    let a_branch = scene.instant_count() * scene.vehicle_count() * OPS_PER_INSTANT;
    let mut overlaps_m = branches.iter().enumerate().map(|(index, branch)| {
        work.charge_or_reject(a_branch)?;
        proved_m(scene, branch, index)
    });
    overlaps_m.try_fold(f64::INFINITY, |least_m, overlap_m| {
        Ok(overlap_m?.min(least_m))
    })
}

/// Returns the proved overlap of branch `index`, in metres; infinite if the brake cannot first fire there.
///
/// # Errors
/// [`Rejection`] if the scene or the branch is invalid, or the branch proves nothing.
pub fn check_branch(scene: &Scene, branch: &Branch, index: usize) -> Result<f64, Rejection> {
    scene.check()?;
    positive_overlap_m(scene, branch, index)
}

fn positive_overlap_m(scene: &Scene, branch: &Branch, index: usize) -> Result<f64, Rejection> {
    let bound = bound_branch(scene, branch, index)?;
    if bound.sum_m > 0.0 && bound.overlap_m > 0.0 {
        Ok(bound.overlap_m)
    } else {
        Err(Rejection::Unproved {
            branch: index,
            sum_m: bound.sum_m,
        })
    }
}

/// Returns the proved overlap of a branch; a negative one bounds a gap.
pub(crate) fn branch_overlap_m(
    scene: &Scene,
    branch: &Branch,
    index: usize,
) -> Result<f64, Rejection> {
    let bound = bound_branch(scene, branch, index)?;
    if bound.overlap_m > f64::NEG_INFINITY {
        Ok(bound.overlap_m)
    } else {
        Err(Rejection::Unproved {
            branch: index,
            sum_m: bound.sum_m,
        })
    }
}

/// Lower bounds of the weighted sum of a branch, and of the overlap that it proves.
struct BranchBound {
    overlap_m: f64,
    sum_m: f64,
}

fn bound_branch(scene: &Scene, branch: &Branch, index: usize) -> Result<BranchBound, Rejection> {
    if branch.last < branch.first || branch.last > scene.steps {
        return Err(Rejection::Tiling { branch: index });
    }
    check_rows(scene, branch, index)?;
    let sum = WeightedSum::new(scene, branch);
    let sum_m = sum.min_m(scene);
    let overlap_m = match sum.collision == Interval::ZERO {
        false => Interval::point(sum_m).over(sum.collision).low(),
        true if sum_m > 0.0 => f64::INFINITY,
        true => f64::NEG_INFINITY,
    };
    Ok(BranchBound { overlap_m, sum_m })
}

/// Checks that the branches cover 0 to N in order, each instant once. A scene without a follower must have one branch.
fn check_tiling(scene: &Scene, branches: &[Branch]) -> Result<(), Rejection> {
    let mut next = Some(0);
    for (index, &Branch { first, last, .. }) in branches.iter().enumerate() {
        if Some(first) != next || last < first || last > scene.steps {
            return Err(Rejection::Tiling { branch: index });
        }
        next = last.checked_add(1);
    }
    if branches
        .last()
        .is_none_or(|branch| branch.last != scene.steps)
    {
        return Err(Rejection::invalid(
            "branches",
            "must end with the last instant, N",
        ));
    }
    if scene.follower.is_none() && branches.len() != 1 {
        return Err(Rejection::invalid(
            "branches",
            "must be one branch if there is no follower",
        ));
    }
    Ok(())
}

/// Checks that every multiplier belongs to an existing row, occurs once, and is not negative.
fn check_rows(scene: &Scene, branch: &Branch, index: usize) -> Result<(), Rejection> {
    let field = |name: &str| format!("branches[{index}].{name}");
    let end = scene.steps + 1;
    // Without a follower there are no rows about it.
    let [rear_end, unfired_end, fired_end] = match &scene.follower {
        Some(_) => [end, branch.first, scene.steps],
        None => [0; 3],
    };
    check_multipliers(&branch.front, end, || field("front"))?;
    check_multipliers(&branch.rear, rear_end, || field("rear"))?;
    check_multipliers(&branch.unfired, unfired_end, || field("unfired"))?;
    let egos = scene.egos.len();
    for (name, lists, wanted) in [
        ("between", &branch.between, egos - 1),
        ("speed", &branch.speed, egos),
    ] {
        if !lists.is_empty() && lists.len() != wanted {
            return Err(Rejection::invalid(
                field(name),
                "has the wrong number of lists",
            ));
        }
        for (list, rows) in lists.iter().enumerate() {
            check_multipliers(rows, end, || format!("{}[{list}]", field(name)))?;
        }
    }
    let may_fire = fired_end > branch.first && branch.first == branch.last;
    if branch.fired == 0.0 || may_fire && branch.fired > 0.0 && branch.fired.is_finite() {
        return Ok(());
    }
    Err(Rejection::invalid(
        field("fired"),
        "must be 0 except for a single firing instant, and not negative",
    ))
}

fn check_multipliers(
    rows: &MultiplierRows,
    end: u32,
    field: impl Fn() -> String,
) -> Result<(), Rejection> {
    let mut next = 0;
    for (entry, &(k, multiplier)) in rows.iter().enumerate() {
        if k < next || k >= end {
            return Err(Rejection::invalid(
                format!("{}[{entry}]", field()),
                "is out of order, or has no such row",
            ));
        }
        if !(multiplier >= 0.0 && multiplier.is_finite()) {
            return Err(Rejection::invalid(
                format!("{}[{entry}]", field()),
                "has a negative or infinite multiplier",
            ));
        }
        next = k + 1;
    }
    Ok(())
}

/// A weighted sum of the rows of a branch, as a function of positions and speeds at all instants.
struct WeightedSum {
    /// For each ego, factors of its position and speed at each instant.
    weights: Vec<Vec<[Interval; 2]>>,
    constant: Interval,
    /// Sum of the collision multipliers.
    collision: Interval,
}

impl WeightedSum {
    fn new(scene: &Scene, branch: &Branch) -> Self {
        let egos = &scene.egos;
        let mut sum = Self {
            weights: vec![vec![[Interval::ZERO; 2]; scene.steps as usize + 1]; egos.len()],
            constant: Interval::ZERO,
            collision: Interval::ZERO,
        };
        let leader_rear_m = scene.leader_rear_m();
        for (k, y) in nonzero_multipliers(&branch.front) {
            sum.weights[0][k][POSITION] += y;
            sum.constant += -(y * leader_rear_m[k]);
            sum.collision += y;
        }
        for (ahead, rows) in branch.between.iter().enumerate() {
            for (k, y) in nonzero_multipliers(rows) {
                sum.weights[ahead + 1][k][POSITION] += y;
                sum.weights[ahead][k][POSITION] += -y;
                sum.constant += y * Interval::point(egos[ahead].length_m);
                sum.collision += y;
            }
        }
        for (ego, rows) in branch.speed.iter().enumerate() {
            for (k, y) in nonzero_multipliers(rows) {
                sum.weights[ego][k][SPEED] += -y;
            }
        }
        if let Some(follower) = &scene.follower {
            sum.add_follower(scene, branch, follower);
        }
        sum
    }

    fn add_follower(&mut self, scene: &Scene, branch: &Branch, follower: &SceneFollower) {
        let last = scene.egos.len() - 1;
        let length_m = Interval::point(scene.egos[last].length_m);
        for (k, y) in nonzero_multipliers(&branch.rear) {
            self.weights[last][k][POSITION] += -y;
            self.constant +=
                y * (scene.follower_position_m(follower, branch.first, k as u32) + length_m);
            self.collision += y;
        }
        // The row `fired` is the negative of what `unfired` would be at that instant.
        let ttc_s = Interval::point(follower.ttc_s);
        let fired = nonzero_multipliers(&[(branch.first, branch.fired)])
            .map(|(k, y)| (k, -y))
            .next();
        for (k, y) in nonzero_multipliers(&branch.unfired).chain(fired) {
            self.weights[last][k][POSITION] += -y;
            self.weights[last][k][SPEED] += -(y * ttc_s);
            let coasting_m = scene.follower_position_m(follower, scene.steps, k as u32);
            self.constant += y * (coasting_m + length_m + ttc_s * follower.speed_mps);
        }
    }

    /// Returns a lower bound in metres over the box and all profiles.
    fn min_m(&self, scene: &Scene) -> f64 {
        let step_s = Interval::point(scene.step_s);
        scene
            .egos
            .iter()
            .zip(&self.weights)
            .fold(self.constant, |sum, (ego, weights)| {
                sum + min_ego_sum(ego, weights, step_s)
            })
            .low()
    }
}

const POSITION: usize = 0;
const SPEED: usize = 1;

fn nonzero_multipliers(rows: &[(u32, f64)]) -> impl Iterator<Item = (usize, Interval)> {
    rows.iter()
        .filter(|row| row.1 != 0.0)
        .map(|&(k, multiplier)| (k as usize, Interval::point(multiplier)))
}

/// Bounds x_0 Σ w_k + v_0 Σ (w_k t_k + s_k) + ∫ φ(q) from below; only the lower end is meaningful.
///
/// The loop runs backwards from the last instant. `slope` is the sum of the w so far, and `q` is the value of q just
/// before the instant. At time 0 they are the factors of x_0 and v_0.
fn min_ego_sum(ego: &SceneEgo, weights: &[[Interval; 2]], step_s: Interval) -> Interval {
    let Some(end) = weights
        .iter()
        .rposition(|weight| *weight != [Interval::ZERO; 2])
    else {
        return Interval::ZERO;
    };
    let [mut slope, mut q, mut sum] = [Interval::ZERO; 3];
    for (k, &[on_position, on_speed]) in weights.iter().enumerate().take(end + 1).rev() {
        slope += on_position;
        q += on_speed;
        if k > 0 {
            let begin = q + slope * step_s;
            sum += min_step_integral(ego, begin, q, step_s);
            q = begin;
        }
    }
    sum + slope * ego.position_m + q * ego.speed_mps
}

/// Bounds ∫ φ(q) from below over a step in which q is linear from `begin` to `end`.
///
/// If q surely changes sign, between the values p > 0 and -n < 0, the integral is that of two triangles:
/// p² b / (p + n) and n² A / (p + n), times -h/2. Otherwise the trapezoid is a lower bound, because φ(q(t)) is concave.
/// The trapezoid is exact if q does not change sign.
fn min_step_integral(ego: &SceneEgo, begin: Interval, end: Interval, step_s: Interval) -> Interval {
    let brake = Interval::point(ego.max_brake_mps2);
    let accel = Interval::point(ego.max_accel_mps2);
    let half = step_s * Interval::point(0.5);
    let triangles =
        |p: Interval, n: Interval| -half * (brake * p.sqr() + accel * n.sqr()).over(p + n);

    if begin.low() > 0.0 && end.high() < 0.0 {
        triangles(begin, -end)
    } else if begin.high() < 0.0 && end.low() > 0.0 {
        triangles(end, -begin)
    } else {
        let [at_begin, at_end] = [begin, end].map(|q| (-brake * q).min(accel * q));
        half * (at_begin + at_end)
    }
}

#[cfg(test)]
mod tests;
