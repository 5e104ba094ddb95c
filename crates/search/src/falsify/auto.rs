//! A portfolio of methods that share the budget, because no method is best for all problems.

use rand::RngExt;

use super::climb::{ClimbMove, Climbs};
use super::cma_es::{CmaRun, INITIAL_SIGMA, default_population};
use super::leader_descent::LeaderDescent;
use super::method::nan_as_infinity;
use super::plateau_bisection::{Plateaus, Segment};
use super::simple_points::sample_simple_point;
use super::surrogate::{MetricSelection, Surrogate};
use super::{SearchAlgorithm, UnitCube};
use crumple_sim::random::{Purpose, Stream, stream};

/// Number of initial points with few pieces and many extreme values; they solve problems with extreme inputs.
const INITIAL_POINTS: usize = 16;
const DESCENT_PIECES: usize = 10;
/// Initial step size of a descent that starts at a good point, and the number of best points to choose from.
const LOCAL_SIGMA: f64 = 0.15;
const START_CANDIDATES: usize = 5;
/// A descent is on a plateau after `PATIENCE` generations without a gain of `MIN_RELATIVE_GAIN` of its best value.
const PATIENCE: usize = 4;
const MIN_RELATIVE_GAIN: f64 = 0.1;
/// Maximum ratio of exploration to the last descent's evaluations: descents get at least a quarter of the budget.
const MAX_EXPLORATION_RATIO: usize = 3;
/// A descent with less spread does not use the surrogate, which helps only while the points are far apart.
const FINE_SPREAD: f64 = 0.1;
/// Minimum population of a descent. The population is half the usual one, because a surrogate screens the points.
const MIN_POPULATION: usize = 4;
const SCREENING_CANDIDATES: usize = 16;
/// Number of recent points for the surrogate, whose cost is cubic.
const MAX_SURROGATE_POINTS: usize = 150;
const MAX_PAUSED_DESCENTS: usize = 200;
/// Maximum number of good points, to limit memory. Descents start at the best few.
const MAX_GOOD_POINTS: usize = 2000;
/// Number of other evaluations for each evaluation of a leader descent.
const OTHER_EVALUATIONS_PER_LEADER_EVALUATION: usize = 3;
const PLAN_DURING_DESCENT: BatchPlan = BatchPlan {
    screened: 2,
    simple: 0,
    edges: 0,
};
const EXPLORATION_PLAN: BatchPlan = BatchPlan {
    screened: 1,
    simple: 4,
    edges: 7,
};

#[derive(Debug, Clone, Copy)]
struct BatchPlan {
    screened: usize,
    simple: usize,
    edges: usize,
}

/// A portfolio of methods that uses only the unit cube and the values of its points.
///
/// The search starts with a few simple points, and then alternates:
///
/// - A *descent* runs CMA-ES on signals of at most ten pieces while the best value falls. A surrogate screens points.
/// - *Exploration* samples points with few pieces and extreme values, and bisects segments to find the edges of
///   plateaus (many points of equal value). Without a plateau it runs hill climbs.
///
/// After the first descent there are also *leader descents*: sequential convex programming from the best point, first
/// over the leader's script, then over all coordinates. Exploration after the k-th descent has min(k, 3) times the
/// evaluations of that descent: few at first, because descents solve easy problems early.
#[derive(Debug)]
pub(super) struct Auto {
    cube: UnitCube,
    coarse: UnitCube,
    random: Stream,
    plateaus: Plateaus,
    climbs: Climbs,
    segments: Vec<Segment>,
    good_points: Vec<(f64, Vec<f64>)>,
    descent: Option<CmaDescent>,
    descents: usize,
    paused: Vec<CmaDescent>,
    exploration_left: usize,
    /// Recent points of the cube `coarse` and their values, in the order of evaluation.
    surrogate_data: Vec<(Vec<f64>, f64)>,
    /// Number of all such points so far, including those no longer stored.
    surrogate_data_count: usize,
    surrogate: Option<Surrogate>,
    metric_selection: MetricSelection,
    leader_search: LeaderSearch,
    pending: Vec<PortfolioProposal>,
}

/// A series of leader descents.
#[derive(Debug, Default)]
struct LeaderSearch {
    descent: Option<LeaderDescent>,
    best: Option<(f64, Vec<f64>)>,
    /// Best value at the start of the last descent.
    started_at_value: Option<f64>,
    /// Number of evaluations by leader descents, and of all evaluations.
    evaluations: [usize; 2],
}

#[derive(Debug)]
struct CmaDescent {
    run: CmaRun,
    best: f64,
    evaluations: usize,
    generations_without_gain: usize,
}

#[derive(Debug)]
enum PortfolioProposal {
    Simple(Vec<f64>),
    Screened(Vec<f64>),
    Descent(Vec<f64>),
    PlateauBisection(Segment),
    Climb(ClimbMove),
    Leader(Vec<f64>),
}

impl Auto {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        Self {
            cube: cube.clone(),
            coarse: cube.with_max_pieces(DESCENT_PIECES),
            random: stream(seed, Purpose::Search, 0),
            plateaus: Plateaus::default(),
            climbs: Climbs::default(),
            segments: Vec::new(),
            good_points: Vec::new(),
            descent: None,
            descents: 0,
            paused: Vec::new(),
            exploration_left: 0,
            surrogate_data: Vec::new(),
            surrogate_data_count: 0,
            surrogate: None,
            metric_selection: MetricSelection::default(),
            leader_search: LeaderSearch::default(),
            pending: Vec::new(),
        }
    }

    fn propose_batch(&mut self, share: BatchPlan) {
        for _ in 0..share.edges {
            let next = self.propose_edge();
            self.pending.push(next);
        }
        for _ in 0..share.screened {
            let next = self.propose_screened();
            self.pending.push(next);
        }
        for _ in 0..share.simple {
            let next = self.propose_simple();
            self.pending.push(next);
        }
    }

    fn propose_edge(&mut self) -> PortfolioProposal {
        let segment = self
            .segments
            .pop()
            .or_else(|| self.plateaus.next_segment(&self.cube, &mut self.random));
        if let Some(segment) = segment {
            return PortfolioProposal::PlateauBisection(segment);
        }
        match self.climbs.propose(&self.cube, &mut self.random) {
            Some(proposal) => PortfolioProposal::Climb(proposal),
            None => self.propose_simple(),
        }
    }

    fn propose_simple(&mut self) -> PortfolioProposal {
        PortfolioProposal::Simple(sample_simple_point(&self.cube, &mut self.random))
    }

    fn propose_screened(&mut self) -> PortfolioProposal {
        let Some(surrogate) = &self.surrogate else {
            return self.propose_simple();
        };
        let candidates =
            (0..SCREENING_CANDIDATES).map(|_| sample_simple_point(&self.cube, &mut self.random));
        let scored = candidates.map(|point| {
            (
                surrogate.score(&self.cube.coarsen(&self.coarse, &point)),
                point,
            )
        });
        let best = scored.min_by(|a, b| a.0.total_cmp(&b.0));
        PortfolioProposal::Screened(best.map(|(_, point)| point).unwrap_or_default())
    }

    /// Returns the next descent. The first two start at the centre. Later ones alternate between a new one from a good
    /// point and the best paused one, resumed.
    fn next_descent(&mut self) -> CmaDescent {
        self.descents += 1;
        let best_paused = self
            .paused
            .iter()
            .enumerate()
            .min_by(|a, b| a.1.best.total_cmp(&b.1.best));
        if self.descents > 2
            && self.descents % 2 == 1
            && let Some((index, _)) = best_paused
        {
            let paused = self.paused.swap_remove(index);
            return CmaDescent {
                evaluations: 0,
                generations_without_gain: 0,
                ..paused
            };
        }
        let population = (default_population(self.coarse.dimension()) / 2).max(MIN_POPULATION);
        let run = if self.descents <= 2 || self.good_points.is_empty() {
            let centre = vec![0.5; self.coarse.dimension()];
            CmaRun::new(centre, INITIAL_SIGMA, population)
        } else {
            self.good_points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let candidates = self.good_points.len().min(START_CANDIDATES);
            let chosen = self
                .good_points
                .swap_remove(self.random.random_range(0..candidates));
            let start = self.cube.coarsen(&self.coarse, &chosen.1);
            CmaRun::new(start, LOCAL_SIGMA, population)
        };
        CmaDescent {
            run,
            best: f64::INFINITY,
            evaluations: 0,
            generations_without_gain: 0,
        }
    }
}

impl CmaDescent {
    fn learn(&mut self, generation: &[f64]) {
        let least = generation.iter().copied().fold(f64::INFINITY, f64::min);
        let gained =
            self.best == f64::INFINITY || least < self.best - MIN_RELATIVE_GAIN * self.best.abs();
        self.generations_without_gain = if gained {
            0
        } else {
            self.generations_without_gain + 1
        };
        self.best = if gained { least } else { self.best };
        self.evaluations += generation.len();
        self.run.tell(generation);
    }
}

impl LeaderSearch {
    fn ask(&mut self, cube: &UnitCube) -> Vec<Vec<f64>> {
        let [own, all] = self.evaluations;
        if cube.leader_coordinates().is_empty()
            || own * (1 + OTHER_EVALUATIONS_PER_LEADER_EVALUATION) > all
        {
            return Vec::new();
        }
        let proposals = self
            .descent
            .as_mut()
            .map(LeaderDescent::ask)
            .unwrap_or_default();
        let Some((best, point)) = self.best.as_ref() else {
            return proposals;
        };
        let has_fallen = self
            .started_at_value
            .is_none_or(|start| *best < start - MIN_RELATIVE_GAIN * start.abs());
        if !proposals.is_empty() || !best.is_finite() || !has_fallen {
            return proposals;
        }
        self.started_at_value = Some(*best);
        self.descent
            .insert(LeaderDescent::new(cube, point.clone(), *best))
            .ask()
    }

    fn tell(&mut self, robustness: &[f64]) {
        self.evaluations[0] += robustness.len();
        if let Some(descent) = self.descent.as_mut().filter(|_| !robustness.is_empty()) {
            descent.tell(robustness);
        }
    }

    fn learn(&mut self, point: &[f64], value: f64) {
        self.evaluations[1] += 1;
        if self.best.as_ref().is_none_or(|(best, _)| value < *best) {
            self.best = Some((value, point.to_vec()));
        }
    }
}

impl Auto {
    fn learn(&mut self, point: &[f64], value: f64) {
        self.leader_search.learn(point, value);
        self.surrogate_data
            .push((self.cube.coarsen(&self.coarse, point), value));
        self.surrogate_data_count += 1;
    }

    /// Forgets old and bad points, and fits the surrogate to the remaining recent ones.
    fn fit_surrogate(&mut self) {
        self.surrogate_data.drain(
            ..self
                .surrogate_data
                .len()
                .saturating_sub(MAX_SURROGATE_POINTS),
        );
        self.surrogate = Surrogate::fit(
            &self.coarse,
            &self.surrogate_data,
            self.surrogate_data_count,
            &mut self.metric_selection,
        );
        if self.good_points.len() > 2 * MAX_GOOD_POINTS {
            self.good_points.sort_by(|a, b| a.0.total_cmp(&b.0));
            self.good_points.truncate(MAX_GOOD_POINTS);
        }
    }

    /// Proposes a generation of the current descent or of the next one, and a few other points.
    fn propose_generation(&mut self) {
        let mut descent = match self.descent.take() {
            Some(descent) => descent,
            None => self.next_descent(),
        };
        let generation = match &self.surrogate {
            Some(surrogate) if descent.run.spread() > FINE_SPREAD => {
                descent
                    .run
                    .ask_screened(&mut self.random, SCREENING_CANDIDATES, |point| {
                        surrogate.score(point)
                    })
            }
            _ => descent.run.ask(&mut self.random),
        };
        self.pending.extend(
            generation
                .into_iter()
                .map(|point| PortfolioProposal::Descent(self.cube.refine(&self.coarse, &point))),
        );
        self.descent = Some(descent);
        self.propose_batch(PLAN_DURING_DESCENT);
    }

    /// Passes a generation to the descent. One that is on a plateau pauses for exploration, or ends.
    fn advance_descent(&mut self, generation: &[f64]) {
        let Some(mut descent) = self.descent.take() else {
            return;
        };
        descent.learn(generation);
        let stagnated = descent.run.has_stagnated();
        if descent.generations_without_gain < PATIENCE && !stagnated {
            self.descent = Some(descent);
            return;
        }
        self.exploration_left = self.descents.min(MAX_EXPLORATION_RATIO) * descent.evaluations;
        self.paused.extend((!stagnated).then_some(descent));
        if self.paused.len() > MAX_PAUSED_DESCENTS {
            self.paused.sort_by(|a, b| a.best.total_cmp(&b.best));
            self.paused.truncate(MAX_PAUSED_DESCENTS / 2);
        }
    }
}

impl PortfolioProposal {
    fn point(&self) -> Vec<f64> {
        match self {
            Self::Simple(point)
            | Self::Screened(point)
            | Self::Descent(point)
            | Self::Leader(point) => point.clone(),
            Self::PlateauBisection(segment) => segment.midpoint(),
            Self::Climb(proposal) => proposal.point.clone(),
        }
    }
}

impl SearchAlgorithm for Auto {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.climbs.rank();
        self.pending.clear();
        self.fit_surrogate();
        if self.good_points.len() + self.descents == 0 {
            self.propose_batch(BatchPlan {
                screened: 0,
                simple: INITIAL_POINTS,
                edges: 0,
            });
        } else if self.exploration_left > 0 {
            self.propose_batch(EXPLORATION_PLAN);
        } else {
            self.propose_generation();
        }
        // The first descent solves easy problems, so leader descents start after it ends.
        if self.descents > 1 || self.exploration_left > 0 {
            self.pending.extend(
                self.leader_search
                    .ask(&self.cube)
                    .into_iter()
                    .map(PortfolioProposal::Leader),
            );
        }
        self.pending.iter().map(PortfolioProposal::point).collect()
    }

    fn tell(&mut self, robustness: &[f64]) {
        self.exploration_left = self.exploration_left.saturating_sub(robustness.len());
        let mut generation = Vec::new();
        let mut leader_values = Vec::new();
        let proposals = std::mem::take(&mut self.pending);
        let values = robustness.iter().map(|&value| nan_as_infinity(value));
        for (proposal, value) in proposals.into_iter().zip(values) {
            match proposal {
                PortfolioProposal::Screened(point) => {
                    self.learn(&point, value);
                    self.good_points.push((value, point));
                }
                PortfolioProposal::Simple(point) => {
                    self.learn(&point, value);
                    self.plateaus.add(point.clone(), value);
                    self.climbs.add_start(point.clone(), value);
                    self.good_points.push((value, point));
                }
                PortfolioProposal::Descent(point) => {
                    self.learn(&point, value);
                    generation.push(value);
                }
                PortfolioProposal::PlateauBisection(segment) => {
                    self.segments.extend(self.plateaus.halve(segment, value))
                }
                PortfolioProposal::Climb(proposal) => self.climbs.tell(proposal, value),
                PortfolioProposal::Leader(point) => {
                    leader_values.push(value);
                    self.learn(&point, value);
                    self.good_points.push((value, point));
                }
            }
        }
        self.leader_search.tell(&leader_values);
        self.advance_descent(&generation);
    }
}
