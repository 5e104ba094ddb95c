//! Sequential convex programming against any controller, network included.
//!
//! The leader's acceleration is linear between a few knots. The margin (smallest gap, or how deep an impact) is linearised
//! along the rollout by finite differences, all in one batch; a convex program inside a trust region proposes a step, a
//! rollout judges it, and the region shrinks or grows with how well the two agree. First down to a collision, then, along
//! its boundary, to the mildest one; or on down to the severest.

use super::attack::{Aim, Attack, AttackError, AttackMethod, Bench};
use super::descent::{Descent, Limits, Pace, REGION_FACTORS, slopes};
use crumple_quadratic::QuadraticProgram;

/// Knots of a profile.
const KNOTS: usize = 26;
/// Change of a knot for a finite difference, in m/s².
const NUDGE_MPS2: f64 = 0.05;
/// The trust region at first, and where a search gives up, in m/s².
const REGION_MPS2: [f64; 2] = [1.0, 0.01];

/// A profile at its knots and what it does.
#[derive(Debug, Clone)]
struct Point {
    knots_mps2: Vec<f64>,
    margin_m: f64,
    collides: bool,
}

/// The best profile found with about `budget` simulations; none if none collides.
pub(super) fn attack(bench: &mut Bench<'_>, aim: Aim, budget: usize) -> Result<Option<Attack>, AttackError> {
    let mut search = Search { bench, aim };
    let Some(mut best) = search.start()? else { return Ok(None) };
    if !best.collides || aim == Aim::Severest {
        best = search.descend(best, budget)?;
    }
    if !best.collides {
        return Ok(None);
    }
    let mut predicted_m = best.margin_m;
    if aim != Aim::Severest {
        best = search.soften(best)?;
        (best, predicted_m) = search.ease(best, budget)?;
    }
    let cells = search.cells(&best.knots_mps2);
    Ok(Some(bench.report(&cells, predicted_m, AttackMethod::Sequential)?))
}

struct Search<'s, 'a> {
    bench: &'s mut Bench<'a>,
    aim: Aim,
}

impl Search<'_, '_> {
    fn apart_s(&self) -> f64 {
        self.bench.cells() as f64 * self.bench.cell_s() / (KNOTS - 1) as f64
    }

    /// The acceleration of each cell: that of the line between the knots at its middle.
    fn cells(&self, knots_mps2: &[f64]) -> Vec<f64> {
        let at = |cell: usize| {
            let place = (cell as f64 + 0.5) * self.bench.cell_s() / self.apart_s();
            let (left, share) = (place.floor() as usize, place.fract());
            let knot = |index: usize| knots_mps2.get(index.min(KNOTS - 1)).copied().unwrap_or(0.0);
            (knot(left) * (1.0 - share) + knot(left + 1) * share).clamp(-self.bench.envelope.max_brake_mps2, 0.0)
        };
        (0..self.bench.cells()).map(at).collect()
    }

    fn try_out(&mut self, all: Vec<Vec<f64>>) -> Result<Vec<Point>, AttackError> {
        let profiles: Vec<_> = all.iter().map(|knots| self.cells(knots)).collect();
        let trials = self.bench.simulate(&profiles)?;
        let point = |(knots_mps2, trial): (Vec<f64>, super::attack::Trial)| Point {
            knots_mps2,
            margin_m: trial.margin_m,
            collides: trial.collides(),
        };
        Ok(all.into_iter().zip(trials).map(point).collect())
    }

    /// The worst of some plain brakings: several rates, onsets and lengths, built up and released as fast as the jerk allows.
    fn start(&mut self) -> Result<Option<Point>, AttackError> {
        let most = self.bench.envelope.max_brake_mps2;
        let mut plain = Vec::new();
        for rate in [1.0, 0.7, 0.4, 0.2] {
            for onset in [0, KNOTS / 8, KNOTS / 4] {
                for length in [KNOTS / 8, KNOTS / 3, KNOTS] {
                    let inside = |knot: &usize| (onset..onset + length).contains(knot);
                    let wanted = (0..KNOTS).map(|knot| if inside(&knot) { -rate * most } else { 0.0 });
                    plain.push(self.limits().ramped(wanted));
                }
            }
        }
        let tried = self.try_out(plain)?;
        Ok(tried.into_iter().min_by(|a, b| a.margin_m.total_cmp(&b.margin_m)))
    }

    /// Steps that lower the margin, until they no longer do.
    fn descend(&mut self, mut at: Point, budget: usize) -> Result<Point, AttackError> {
        let pace = Pace { nudge: NUDGE_MPS2, region: REGION_MPS2, idle: Some(0.0) };
        let mut descent = Descent::new(self.limits(), pace, at.knots_mps2.clone(), at.margin_m);
        while self.bench.evaluations < budget {
            let asked = descent.ask();
            if asked.is_empty() {
                break;
            }
            self.bench.programs += usize::from(asked.len() == 1);
            let tried = self.try_out(asked)?;
            descent.tell(&tried.iter().map(|point| point.margin_m).collect::<Vec<_>>());
            if let Some(next) = tried.into_iter().find(|point| point.knots_mps2 == descent.at()) {
                let was_open = !at.collides;
                at = next;
                if was_open && at.collides && self.aim != Aim::Severest {
                    return Ok(at);
                }
            }
        }
        Ok(at)
    }

    /// The mildest multiple of a colliding profile that still collides.
    fn soften(&mut self, at: Point) -> Result<Point, AttackError> {
        let scaled = |share: f64| at.knots_mps2.iter().map(|knot| knot * share).collect::<Vec<_>>();
        let tried = self.try_out((1..32).map(|part| scaled(f64::from(part) / 32.0)).collect())?;
        Ok(tried.into_iter().find(|point| point.collides).unwrap_or(at))
    }

    /// Steps that cost less and still collide, with what the last of them was predicted to do.
    fn ease(&mut self, mut at: Point, budget: usize) -> Result<(Point, f64), AttackError> {
        let mut region = REGION_MPS2[0];
        let [success, failure] = REGION_FACTORS;
        let mut predicted_m = at.margin_m;
        let mut slope = self.slope(&at)?;
        while region > REGION_MPS2[1] && self.bench.evaluations < budget {
            // Several depths beyond contact at once: the linear prediction is not exact.
            let aims_m = [-1e-3, -0.05, -0.3, -1.0];
            let steps: Vec<_> =
                aims_m.iter().filter_map(|&m| Some((m, self.cheapest(&at, &slope, region, m)?))).collect();
            let tried = self.try_out(steps.iter().map(|(_, knots)| knots.clone()).collect())?;
            let cost = |point: &Point| self.cost(&point.knots_mps2);
            let good =
                tried.iter().zip(&steps).filter(|(point, _)| point.collides && cost(point) < cost(&at) * (1.0 - 1e-4));
            let best = good.min_by(|(a, _), (b, _)| cost(a).total_cmp(&cost(b)));
            match best.map(|(point, (aim_m, _))| (point.clone(), *aim_m)) {
                Some((point, aim_m)) => {
                    predicted_m = aim_m;
                    at = point;
                    region *= success;
                    slope = self.slope(&at)?;
                }
                None => region *= failure,
            }
        }
        Ok((at, predicted_m))
    }

    fn cost(&self, knots_mps2: &[f64]) -> f64 {
        let cells = self.cells(knots_mps2);
        match self.aim {
            Aim::LeastPeak => cells.iter().fold(0.0, |most, a| most.max(-a)),
            Aim::Mildest | Aim::Severest => cells.iter().map(|a| a * a * self.bench.cell_s()).sum(),
        }
    }

    /// The change of the margin with each knot, in s².
    fn slope(&mut self, at: &Point) -> Result<Vec<f64>, AttackError> {
        let (by, nudged) = self.limits().nudged(&at.knots_mps2, NUDGE_MPS2);
        let margins_m: Vec<f64> = self.try_out(nudged)?.iter().map(|point| point.margin_m).collect();
        Ok(slopes(at.margin_m, &margins_m, &by))
    }

    fn limits(&self) -> Limits {
        let envelope = self.bench.envelope;
        // Half a cell before the middle of the first one.
        let first = 0.5 * envelope.jerk_mps3 * self.bench.cell_s();
        let next = envelope.jerk_mps3 * self.apart_s();
        let ramp = Some([first, next]).filter(|_| first < envelope.max_brake_mps2);
        Limits { low: -envelope.max_brake_mps2, high: 0.0, ramp }
    }

    /// The step inside the trust region that brings the linearised margin to `aim_m`, or near it, at the least cost.
    fn cheapest(&mut self, at: &Point, slope: &[f64], region: f64, aim_m: f64) -> Option<Vec<f64>> {
        self.bench.programs += 1;
        // One variable a knot, its new value; the last ones are the peak and the shortfall of the aim.
        let mut cone = QuadraticProgram::new(KNOTS + 2);
        let (peak, short) = (KNOTS, KNOTS + 1);
        let limits = self.limits();
        limits.rows(&mut cone, &at.knots_mps2, region);
        let here: f64 = slope.iter().zip(&at.knots_mps2).map(|(slope, now)| slope * now).sum();
        let mut falls: Vec<_> = slope.iter().copied().enumerate().collect();
        falls.push((short, -1.0));
        cone.at_most(&falls, aim_m - at.margin_m + here);
        cone.at_most(&[(short, -1.0)], 0.0);
        cone.cost(short, 1e3);
        let by_peak = self.aim == Aim::LeastPeak;
        let weight = if by_peak { 1e-4 } else { self.apart_s() };
        for knot in 0..KNOTS {
            cone.at_most(&[(knot, -1.0), (peak, -1.0)], 0.0);
            cone.square(&[(knot, 1.0)], weight);
        }
        if by_peak {
            cone.cost(peak, 1.0);
        }
        limits.solution(&cone, KNOTS)
    }
}
