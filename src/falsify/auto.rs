//! The portfolio: no method is the best everywhere, so several share the budget.

use rand::RngExt;

use super::climb::{Climbs, Move};
use super::cma_es::{FIRST_SIGMA, Run, default_population};
use super::edge::{Plateaus, Segment};
use super::method::rankable;
use super::shape::simple_point;
use super::{Cube, Search};
use crate::random::{Purpose, Stream, stream};

/// Simple points before anything else: problems that give in to extreme inputs end here.
const FIRST_POINTS: usize = 24;
/// Signals of the descent have at most so many pieces.
const DESCENT_PIECES: usize = 10;
/// Step of a descent that starts at a known good point.
const LOCAL_SIGMA: f64 = 0.15;
/// Generations without improvement after which a descent has met a plateau.
const PATIENCE: usize = 5;
/// What goes along with each generation of a descent.
const BESIDE_DESCENT: Share = Share { simple: 3, edges: 0, climbs: 0 };
/// A batch while no descent runs.
const EXPLORATION: Share = Share { simple: 4, edges: 6, climbs: 2 };

#[derive(Debug, Clone, Copy)]
struct Share {
    simple: usize,
    edges: usize,
    climbs: usize,
}

/// The portfolio.
///
/// It starts with simple points and goes on in turns. A *descent* is a run of CMA-ES on signals of ten pieces, for as long
/// as it improves. *Exploration* lasts for as many evaluations as the descent before it: simple points, the edges of
/// plateaus, and climbs from the best points. So at most half of the budget is ever spent on a plateau.
#[derive(Debug)]
pub(super) struct Auto {
    cube: Cube,
    coarse: Cube,
    random: Stream,
    plateaus: Plateaus,
    climbs: Climbs,
    segments: Vec<Segment>,
    good_points: Vec<(f64, Vec<f64>)>,
    descent: Option<Descent>,
    descents: usize,
    exploration_left: usize,
    asked: Vec<Asked>,
}

#[derive(Debug)]
struct Descent {
    run: Run,
    best: f64,
    evaluations: usize,
    fruitless: usize,
}

#[derive(Debug)]
enum Asked {
    Simple(Vec<f64>),
    Descent(Vec<f64>),
    Edge(Segment),
    Climb(Move),
}

impl Auto {
    pub(super) fn new(cube: &Cube, seed: u64) -> Self {
        Self {
            cube: cube.clone(),
            coarse: cube.coarse(DESCENT_PIECES),
            random: stream(seed, Purpose::Search, 0),
            plateaus: Plateaus::default(),
            climbs: Climbs::default(),
            segments: Vec::new(),
            good_points: Vec::new(),
            descent: None,
            descents: 0,
            exploration_left: 0,
            asked: Vec::new(),
        }
    }

    fn ask_share(&mut self, share: Share) {
        for _ in 0..share.edges {
            let segment = self.segments.pop().or_else(|| self.plateaus.segment(&self.cube, &mut self.random));
            let next = segment.map_or_else(|| self.simple(), Asked::Edge);
            self.asked.push(next);
        }
        for _ in 0..share.climbs {
            let proposal = self.climbs.next(&self.cube, &mut self.random);
            let next = proposal.map_or_else(|| self.simple(), Asked::Climb);
            self.asked.push(next);
        }
        for _ in 0..share.simple {
            let next = self.simple();
            self.asked.push(next);
        }
    }

    fn simple(&mut self) -> Asked {
        Asked::Simple(simple_point(&self.cube, &mut self.random))
    }

    /// The first descent starts at the centre, later ones at one of the best points.
    fn next_descent(&mut self) -> Descent {
        let population = default_population(self.coarse.dimension());
        let (start, sigma) = if self.descents == 0 || self.good_points.is_empty() {
            (vec![0.5; self.coarse.dimension()], FIRST_SIGMA)
        } else {
            self.good_points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let among = self.good_points.len().min(20);
            let chosen = self.good_points.swap_remove(self.random.random_range(0..among));
            (self.cube.coarsen(&self.coarse, &chosen.1), LOCAL_SIGMA)
        };
        self.descents += 1;
        Descent { run: Run::new(start, sigma, population), best: f64::INFINITY, evaluations: 0, fruitless: 0 }
    }
}

impl Search for Auto {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.climbs.rank();
        self.asked.clear();
        if self.good_points.len() + self.descents == 0 {
            self.ask_share(Share { simple: FIRST_POINTS, edges: 0, climbs: 0 });
        } else if self.exploration_left > 0 {
            self.ask_share(EXPLORATION);
        } else {
            let mut descent = match self.descent.take() {
                Some(descent) => descent,
                None => self.next_descent(),
            };
            let generation = descent.run.ask(&mut self.random);
            self.asked.extend(generation.into_iter().map(|point| Asked::Descent(self.cube.refine(&self.coarse, &point))));
            self.descent = Some(descent);
            self.ask_share(BESIDE_DESCENT);
        }
        let point = |asked: &Asked| match asked {
            Asked::Simple(point) | Asked::Descent(point) => point.clone(),
            Asked::Edge(segment) => segment.middle(),
            Asked::Climb(proposal) => proposal.point.clone(),
        };
        self.asked.iter().map(point).collect()
    }

    fn tell(&mut self, robustness: &[f64]) {
        self.exploration_left = self.exploration_left.saturating_sub(robustness.len());
        let mut generation = Vec::new();
        let asked = std::mem::take(&mut self.asked);
        for (asked, value) in asked.into_iter().zip(robustness.iter().map(|&value| rankable(value))) {
            match asked {
                Asked::Simple(point) => {
                    self.plateaus.add(point.clone(), value);
                    self.climbs.start(point.clone(), value);
                    self.good_points.push((value, point));
                }
                Asked::Descent(_) => generation.push(value),
                Asked::Edge(segment) => self.segments.extend(segment.halved(value)),
                Asked::Climb(proposal) => self.climbs.tell(proposal, value),
            }
        }
        if let Some(mut descent) = self.descent.take() {
            let least = generation.iter().copied().fold(f64::INFINITY, f64::min);
            descent.evaluations += generation.len();
            descent.fruitless = if least < descent.best { 0 } else { descent.fruitless + 1 };
            descent.best = descent.best.min(least);
            descent.run.tell(&generation);
            if descent.fruitless >= PATIENCE || descent.run.has_stagnated() {
                self.exploration_left = descent.evaluations;
            } else {
                self.descent = Some(descent);
            }
        }
    }
}
