//! Sequential convex programming against any controller, network included.
//!
//! The leader's acceleration is linear between a few knots. The margin (smallest gap, or how deep an impact) is linearised
//! along the rollout by finite differences, all in one batch; a convex program inside a trust region proposes a step, a
//! rollout judges it, and the region shrinks or grows with how well the two agree. First down to a collision, then, along
//! its boundary, to the mildest one; or on down to the severest.

use super::attack::{Aim, Attack, AttackError, Bench, Way};
use super::cone::{Cone, Solved};

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
    Ok(Some(bench.report(&cells, predicted_m, Way::Sequential)?))
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

    /// The worst of some plain brakings: several rates, onsets and lengths, built up as fast as the jerk allows.
    fn start(&mut self) -> Result<Option<Point>, AttackError> {
        let most = self.bench.envelope.max_brake_mps2;
        let ramp = self.bench.envelope.jerk_mps3 * self.apart_s();
        let mut plain = Vec::new();
        for rate in [1.0, 0.7, 0.4, 0.2] {
            for onset in [0, KNOTS / 8, KNOTS / 4] {
                for length in [KNOTS / 8, KNOTS / 3, KNOTS] {
                    let rate = rate * most;
                    let at = |knot: usize| {
                        let inside = (onset..onset + length).contains(&knot);
                        let built_up = ramp * (knot + 1).saturating_sub(onset) as f64;
                        if inside { -rate.min(built_up) } else { 0.0 }
                    };
                    plain.push((0..KNOTS).map(at).collect());
                }
            }
        }
        let tried = self.try_out(plain)?;
        Ok(tried.into_iter().min_by(|a, b| a.margin_m.total_cmp(&b.margin_m)))
    }

    /// Steps that lower the margin, until they no longer do.
    fn descend(&mut self, mut at: Point, budget: usize) -> Result<Point, AttackError> {
        let mut region = REGION_MPS2[0];
        let mut slope = self.slope(&at)?;
        while region > REGION_MPS2[1] && self.bench.evaluations < budget {
            let Some(knots) = self.step(&at, &slope, region, None) else { break };
            let Some(next) = self.try_out(vec![knots])?.pop() else { break };
            if next.margin_m < at.margin_m - 1e-6 {
                let was_open = !at.collides;
                at = next;
                if was_open && at.collides && self.aim != Aim::Severest {
                    return Ok(at);
                }
                region *= 1.5;
                slope = self.slope(&at)?;
            } else {
                region *= 0.4;
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
        let mut predicted_m = at.margin_m;
        let mut slope = self.slope(&at)?;
        while region > REGION_MPS2[1] && self.bench.evaluations < budget {
            // Several depths beyond contact at once: the linear prediction is not exact.
            let aims_m = [-1e-3, -0.05, -0.3, -1.0];
            let steps: Vec<_> =
                aims_m.iter().filter_map(|&m| Some((m, self.step(&at, &slope, region, Some(m))?))).collect();
            let tried = self.try_out(steps.iter().map(|(_, knots)| knots.clone()).collect())?;
            let cost = |point: &Point| self.cost(&point.knots_mps2);
            let good =
                tried.iter().zip(&steps).filter(|(point, _)| point.collides && cost(point) < cost(&at) * (1.0 - 1e-4));
            let best = good.min_by(|(a, _), (b, _)| cost(a).total_cmp(&cost(b)));
            match best.map(|(point, (aim_m, _))| (point.clone(), *aim_m)) {
                Some((point, aim_m)) => {
                    predicted_m = aim_m;
                    at = point;
                    region *= 1.5;
                    slope = self.slope(&at)?;
                }
                None => region *= 0.4,
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
        // Towards the middle of the envelope, so that every nudge has an effect.
        let middle = -0.5 * self.bench.envelope.max_brake_mps2;
        let nudge = |knot: usize| {
            let by = if at.knots_mps2[knot] > middle { -NUDGE_MPS2 } else { NUDGE_MPS2 };
            let mut knots = at.knots_mps2.clone();
            knots[knot] += by;
            (by, knots)
        };
        let (by, nudged): (Vec<_>, Vec<_>) = (0..KNOTS).map(nudge).unzip();
        let tried = self.try_out(nudged)?;
        Ok(tried.iter().zip(by).map(|(point, by)| (point.margin_m - at.margin_m) / by).collect())
    }

    /// The step inside the trust region that lowers the linearised margin most or, given an aim, that reaches it at the least
    /// cost.
    fn step(&mut self, at: &Point, slope: &[f64], region: f64, aim_m: Option<f64>) -> Option<Vec<f64>> {
        self.bench.programs += 1;
        let envelope = self.bench.envelope;
        let ramp = envelope.jerk_mps3 * self.apart_s();
        // One variable a knot, its new value; the last one is the peak or the shortfall of the aim.
        let mut cone = Cone::new(KNOTS + 2);
        let (peak, short) = (KNOTS, KNOTS + 1);
        for (knot, &now) in at.knots_mps2.iter().enumerate() {
            cone.at_most(&[(knot, 1.0)], (now + region).min(0.0));
            cone.at_most(&[(knot, -1.0)], (region - now).min(envelope.max_brake_mps2));
            let first = if knot == 0 { vec![(0, 1.0)] } else { vec![(knot, 1.0), (knot - 1, -1.0)] };
            let back: Vec<_> = first.iter().map(|&(i, c)| (i, -c)).collect();
            cone.at_most(&first, ramp);
            cone.at_most(&back, ramp);
            cone.at_most(&[(knot, -1.0), (peak, -1.0)], 0.0);
        }
        let falls: Vec<_> = slope.iter().copied().enumerate().collect();
        let here: f64 = slope.iter().zip(&at.knots_mps2).map(|(slope, now)| slope * now).sum();
        match aim_m {
            None => falls.iter().for_each(|&(knot, slope)| cone.cost(knot, slope)),
            Some(aim_m) => {
                let mut terms = falls;
                terms.push((short, -1.0));
                cone.at_most(&terms, aim_m - at.margin_m + here);
                cone.at_most(&[(short, -1.0)], 0.0);
                cone.cost(short, 1e3);
                if self.aim == Aim::LeastPeak {
                    cone.cost(peak, 1.0);
                }
            }
        }
        let weight = if aim_m.is_some() && self.aim != Aim::LeastPeak { self.apart_s() } else { 1e-4 };
        for knot in 0..KNOTS {
            cone.square(&[(knot, 1.0)], weight);
        }
        match cone.solve() {
            Solved::Optimal { at, .. } => {
                Some(at.iter().take(KNOTS).map(|knot| knot.clamp(-envelope.max_brake_mps2, 0.0)).collect())
            }
            _ => None,
        }
    }
}
