//! Comparison of search methods over several seeds, with exact tests.

use std::fmt::Write;

use crumple_core::digits::{format_interval, format_or_hyphen};
use crumple_core::observer::Observer;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignError, CampaignProgress, FirstFailure};
use serde::{Deserialize, Serialize};

use super::{DiscordantPairs, RateInterval};

/// Maximum number of seeds of a comparison.
pub const MAX_SEEDS: u64 = 1000;

const MAX_METHODS: u64 = 1000;

/// Confidence level of the intervals.
const CONFIDENCE: f64 = 0.95;

/// Results of search methods on the same problem with the same seeds.
///
/// Measures follow the falsification category of the ARCH competition: falsification rate, mean and median number of
/// simulations. Mean and median are those of the falsified runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodComparison {
    /// Name of the controller.
    pub controller: String,
    /// Name of the space.
    pub space: String,
    /// The specification.
    pub specification: String,
    /// Maximum number of simulations of a run.
    pub budget: u64,
    /// Seed of the first run; the following runs have the following seeds.
    pub first_seed: u64,
    /// Results of each method, in the order of the request.
    pub methods: Vec<MethodRuns>,
    /// Comparisons of all pairs of methods.
    pub pairs: Vec<MethodPair>,
}

/// Results of one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodRuns {
    /// Name of the method.
    pub method: String,
    /// Number of runs that found a failure.
    pub falsified: u64,
    /// Share of runs that found a failure.
    pub falsification_rate: f64,
    /// 95 % interval of this share (Clopper-Pearson).
    pub interval: [f64; 2],
    /// Mean number of simulations of the falsified runs.
    pub mean_simulations: Option<f64>,
    /// Median number of simulations of the falsified runs.
    pub median_simulations: Option<f64>,
    /// Each run, in order of the seeds.
    pub runs: Vec<FirstFailure>,
}

/// Comparison of two methods on the same seeds. The tests of all pairs share one correction of Holm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodPair {
    /// Names of both methods.
    pub methods: [String; 2],
    /// McNemar's exact test: seeds that only the first method falsifies, and those that only the second one does.
    pub falsified: PairedTest,
    /// Sign test: seeds for which the first method needs fewer simulations, and those for which the second one does.
    pub fewer_simulations: PairedTest,
}

/// Two-sided exact test of discordant pairs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PairedTest {
    /// Seeds in favour of the first method.
    pub first: u64,
    /// Seeds in favour of the second method.
    pub second: u64,
    /// Probability of such a difference or a larger one between equal methods.
    pub p: f64,
    /// `p` with the correction of Holm.
    pub p_corrected: f64,
}

impl PairedTest {
    fn new(first: u64, second: u64) -> Self {
        let [p_first, p_second] =
            [[first, second], [second, first]].map(|[only_second_fails, only_first_fails]| {
                let pairs = DiscordantPairs {
                    only_second_fails,
                    only_first_fails,
                };
                pairs.p_value()
            });
        let p = (2.0 * p_first.min(p_second)).min(1.0);
        Self {
            first,
            second,
            p,
            p_corrected: p,
        }
    }

    /// Tests the seeds for which one method has a better run than the other one.
    fn from_runs(
        first: &MethodRuns,
        second: &MethodRuns,
        is_better: fn(&FirstFailure, &FirstFailure) -> bool,
    ) -> Self {
        let [first_better, second_better] =
            [[first, second], [second, first]].map(|[method, rival]| {
                let pairs = method.runs.iter().zip(&rival.runs);
                pairs.filter(|(run, rival)| is_better(run, rival)).count() as u64
            });
        Self::new(first_better, second_better)
    }
}

/// Returns the number of simulations; a run without a failure needs more than any with one.
fn needed_simulations(run: &FirstFailure) -> u64 {
    run.simulations.unwrap_or(u64::MAX)
}

/// Returns the median, the mean of both middle numbers of an even number of values.
fn median(sorted: &[u64]) -> Option<f64> {
    let upper = *sorted.get(sorted.len() / 2)? as f64;
    let lower = *sorted.get(sorted.len().saturating_sub(1) / 2)? as f64;
    Some(f64::midpoint(lower, upper))
}

impl MethodRuns {
    fn new(method: &str, runs: Vec<FirstFailure>) -> Self {
        let mut simulations: Vec<u64> = runs.iter().filter_map(|run| run.simulations).collect();
        simulations.sort_unstable();
        let falsified = simulations.len();
        let interval =
            RateInterval::clopper_pearson(falsified as u64, runs.len() as u64, CONFIDENCE);
        Self {
            method: method.to_owned(),
            falsified: falsified as u64,
            falsification_rate: falsified as f64 / runs.len() as f64,
            interval: [interval.lower, interval.upper],
            mean_simulations: (falsified > 0)
                .then(|| simulations.iter().sum::<u64>() as f64 / falsified as f64),
            median_simulations: median(&simulations),
            runs,
        }
    }

    fn table_row(&self) -> String {
        let share = format!("{}/{}", self.falsified, self.runs.len());
        let percent = self.interval.map(|share| 100.0 * share);
        let interval = format!("{} %", format_interval(percent, 1));
        let [mean, median] = [self.mean_simulations, self.median_simulations]
            .map(|number| format_or_hyphen(number, 1));
        format!(
            "{:<20} {share:>10} {interval:>17} {mean:>10} {median:>10}\n",
            self.method
        )
    }
}

impl MethodPair {
    fn new(first: &MethodRuns, second: &MethodRuns) -> Self {
        Self {
            methods: [first.method.clone(), second.method.clone()],
            falsified: PairedTest::from_runs(first, second, |run, rival| {
                run.simulations.is_some() && rival.simulations.is_none()
            }),
            fewer_simulations: PairedTest::from_runs(first, second, |run, rival| {
                needed_simulations(run) < needed_simulations(rival)
            }),
        }
    }

    fn sentence(&self) -> String {
        let Self {
            methods: [first, second],
            falsified,
            fewer_simulations,
        } = self;
        format!(
            "{first} against {second}: only it falsifies in {} to {} seeds (p {:.3}); it needs fewer simulations in \
             {} to {} (p {:.3})\n",
            falsified.first,
            falsified.second,
            falsified.p_corrected,
            fewer_simulations.first,
            fewer_simulations.second,
            fewer_simulations.p_corrected
        )
    }
}

/// Progress of the runs of all methods.
struct ComparisonProgress<'a> {
    observer: &'a dyn Observer<CampaignProgress>,
    total: u64,
    evaluations: u64,
    failures: u64,
}

impl ComparisonProgress<'_> {
    /// Runs a campaign up to its first failure, and reports its progress within the comparison.
    fn find_first_failure(&mut self, campaign: &Campaign) -> Result<FirstFailure, CampaignError> {
        let run = campaign.find_first_failure(&|progress: &CampaignProgress| {
            self.observer.observe(&CampaignProgress {
                evaluations: self.evaluations + progress.evaluations,
                total: self.total,
                failures: self.failures + progress.failures,
                ..progress.clone()
            })
        })?;
        self.evaluations += campaign.search.budget;
        self.failures += u64::from(run.simulations.is_some());
        Ok(run)
    }
}

impl MethodComparison {
    /// Runs each method with the campaign's seed and the following ones (1 to [`MAX_SEEDS`]), each run up to its first
    /// failure.
    ///
    /// # Errors
    /// [`CampaignError`] if a number is out of range, there is no method or one twice, a scenario cannot be run, or
    /// `observer` stops the comparison.
    pub fn run(
        campaign: &Campaign,
        methods: &[Method],
        seeds: u64,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<Self, CampaignError> {
        CampaignError::check_range("seeds", seeds, 1..=MAX_SEEDS)?;
        CampaignError::check_range("methods", methods.len() as u64, 1..=MAX_METHODS)?;
        let mut indexed = methods.iter().enumerate();
        if let Some((_, repeated)) = indexed.find(|(i, method)| methods[..*i].contains(method)) {
            return Err(CampaignError::RepeatedMethod(repeated.clone()));
        }
        let budget = campaign.search.budget;
        let mut progress = ComparisonProgress {
            observer,
            total: budget
                .saturating_mul(seeds)
                .saturating_mul(methods.len() as u64),
            evaluations: 0,
            failures: 0,
        };
        let mut results = Vec::new();
        for method in methods {
            let mut runs = Vec::new();
            for seed in campaign.seed..campaign.seed.saturating_add(seeds) {
                runs.push(progress.find_first_failure(&Campaign {
                    seed,
                    ..campaign.clone().with_method(method.clone())
                })?);
            }
            results.push(MethodRuns::new(method.name(), runs));
        }
        Ok(Self {
            controller: campaign.controller.name.clone(),
            space: campaign.space.name().to_owned(),
            specification: campaign.specification.to_string(),
            budget,
            first_seed: campaign.seed,
            pairs: compare_pairs(&results),
            methods: results,
        })
    }

    /// Joins comparisons of the same methods with consecutive seeds, in this order. Returns `None` without a part, or
    /// if the parts do not fit each other.
    #[must_use]
    pub fn join(parts: &[Self]) -> Option<Self> {
        let first = parts.first()?;
        let mut results = Vec::with_capacity(first.methods.len());
        for (index, method) in first.methods.iter().enumerate() {
            let mut runs = Vec::new();
            for part in parts {
                let seed = first.first_seed.checked_add(runs.len() as u64)?;
                let same = part.methods.get(index)?;
                if part.first_seed != seed
                    || !part.has_problem_of(first)
                    || same.method != method.method
                {
                    return None;
                }
                runs.extend(same.runs.iter().cloned());
            }
            results.push(MethodRuns::new(&method.method, runs));
        }
        Some(Self {
            pairs: compare_pairs(&results),
            methods: results,
            ..first.clone()
        })
    }

    /// True if both comparisons have the same problem and number of methods.
    fn has_problem_of(&self, other: &Self) -> bool {
        self.controller == other.controller
            && self.space == other.space
            && self.specification == other.specification
            && self.budget == other.budget
            && self.methods.len() == other.methods.len()
    }

    /// Returns a table of the methods, and one of their pairs.
    #[must_use]
    pub fn to_text(&self) -> String {
        let Self {
            controller,
            space,
            specification,
            budget,
            methods,
            pairs,
            ..
        } = self;
        let seeds = methods.first().map_or(0, |method| method.runs.len());
        let mut text = format!(
            "{controller} in {space}, `{specification}`: {seeds} {}, at most {budget} simulations each; \
             mean and median number of simulations in the falsified ones\n\n\
             {:<20} {:>10} {:>17} {:>10} {:>10}\n",
            if seeds == 1 { "seed" } else { "seeds" },
            "method",
            "falsified",
            "95 % interval",
            "mean",
            "median"
        );
        text.extend(methods.iter().map(MethodRuns::table_row));
        if !pairs.is_empty() {
            text += "\nOn the same seeds (p: exact, two-sided, with the correction of Holm):\n";
        }
        text.extend(pairs.iter().map(MethodPair::sentence));
        text
    }

    /// Returns a row for each run: method, seed, number of simulations (empty without a failure), least robustness.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = "method,seed,simulations,least_robustness\n".to_owned();
        for MethodRuns { method, runs, .. } in &self.methods {
            for (seed, run) in (self.first_seed..).zip(runs) {
                let simulations = run
                    .simulations
                    .map_or_else(String::new, |number| number.to_string());
                // Writing to a string does not fail.
                let _ = writeln!(
                    text,
                    "{method},{seed},{simulations},{}",
                    run.least_robustness
                );
            }
        }
        text
    }
}

/// Compares all pairs of methods.
fn compare_pairs(results: &[MethodRuns]) -> Vec<MethodPair> {
    let pairs = results.iter().enumerate().flat_map(|(index, first)| {
        let later = results.iter().skip(index + 1);
        later.map(move |second| MethodPair::new(first, second))
    });
    let mut pairs: Vec<MethodPair> = pairs.collect();
    let tests = pairs
        .iter_mut()
        .flat_map(|pair| [&mut pair.falsified, &mut pair.fewer_simulations]);
    correct_by_holm(tests.collect());
    pairs
}

/// Corrects p-values for their number. Source: Holm 1979, "A simple sequentially rejective multiple test procedure",
/// Scandinavian Journal of Statistics 6, 65-70.
fn correct_by_holm(mut tests: Vec<&mut PairedTest>) {
    tests.sort_by(|a, b| a.p.total_cmp(&b.p));
    let count = tests.len();
    let mut smallest = 0.0_f64;
    for (rank, test) in tests.into_iter().enumerate() {
        smallest = smallest.max(((count - rank) as f64 * test.p).min(1.0));
        test.p_corrected = smallest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_core::observer::Quiet;
    use crumple_sim::control::BuiltInController;
    use crumple_spaces::built_in_space;

    fn result(name: &str, simulations: &[Option<u64>]) -> MethodRuns {
        let run = |&simulations: &Option<u64>| FirstFailure {
            simulations,
            least_robustness: 1.0,
        };
        MethodRuns::new(name, simulations.iter().map(run).collect())
    }

    #[test]
    fn measures_and_tests_match_those_by_hand() {
        let first = result(
            "first",
            &[Some(4), Some(2), Some(9), Some(1), None, Some(5)],
        );
        let second = result("second", &[Some(5), None, Some(9), None, None, Some(7)]);
        assert_eq!(
            (
                first.falsified,
                first.mean_simulations,
                first.median_simulations
            ),
            (5, Some(4.2), Some(4.0))
        );
        assert_eq!(
            (second.mean_simulations, second.median_simulations),
            (Some(7.0), Some(7.0))
        );
        assert_eq!(result("none", &[None]).median_simulations, None);
        let MethodPair {
            falsified,
            fewer_simulations,
            ..
        } = MethodPair::new(&first, &second);
        for (test, first, p) in [(falsified, 2, 0.5), (fewer_simulations, 4, 0.125)] {
            assert!(
                (test.first, test.second) == (first, 0) && (test.p - p).abs() < 1e-12,
                "{test:?}"
            );
        }
        let mut tests = [0.01, 0.04, 0.03, 0.5].map(|p| PairedTest {
            first: 0,
            second: 0,
            p,
            p_corrected: p,
        });
        correct_by_holm(tests.iter_mut().collect());
        assert_eq!(tests.map(|test| test.p_corrected), [0.04, 0.09, 0.09, 0.5]);
    }

    #[test]
    fn a_comparison_needs_seeds_and_methods() {
        let controller = BuiltInController::from_name("match-leader").unwrap();
        let campaign =
            Campaign::new(controller, built_in_space("high-risk").unwrap()).with_budget(1);
        let refused = |methods: &[Method], seeds| {
            MethodComparison::run(&campaign, methods, seeds, &Quiet)
                .unwrap_err()
                .to_string()
        };
        assert_eq!(
            refused(&[Method::Uniform], 0),
            "seeds: must be from 1 to 1000, found 0"
        );
        assert_eq!(
            refused(&[Method::Uniform], 1001),
            "seeds: must be from 1 to 1000, found 1001"
        );
        assert_eq!(refused(&[], 1), "methods: must be from 1 to 1000, found 0");
    }

    #[test]
    fn each_run_has_its_seed_and_a_repeated_method_is_refused() {
        let controller = BuiltInController::from_name("match-leader").unwrap();
        let campaign =
            Campaign::new(controller, built_in_space("high-risk").unwrap()).with_budget(60);
        let repeated = [Method::Uniform, Method::Halton, Method::Uniform];
        let refused = MethodComparison::run(&campaign, &repeated, 4, &Quiet).unwrap_err();
        assert!(
            matches!(refused, CampaignError::RepeatedMethod(Method::Uniform)),
            "{refused}"
        );
        let methods = [Method::Uniform, Method::Halton];
        let compared = MethodComparison::run(&campaign, &methods, 4, &Quiet).unwrap();
        assert_eq!(compared.pairs.len(), 1);
        assert_eq!(compared.to_csv().lines().count(), 9);
        let third = Campaign {
            seed: 2,
            ..campaign.with_method(Method::Uniform)
        }
        .find_first_failure(&Quiet)
        .unwrap();
        assert_eq!(third, compared.methods[0].runs[2]);
        assert_ne!(third, compared.methods[0].runs[0]);
    }

    #[test]
    fn comparisons_of_single_seeds_join_to_the_comparison_of_all() {
        let controller = BuiltInController::from_name("match-leader").unwrap();
        let campaign =
            Campaign::new(controller, built_in_space("high-risk").unwrap()).with_budget(40);
        let methods = [Method::Uniform, Method::Halton];
        let compare = |seed: u64, seeds: u64| {
            let campaign = Campaign {
                seed,
                ..campaign.clone()
            };
            MethodComparison::run(&campaign, &methods, seeds, &Quiet).unwrap()
        };
        // As a worker sends them.
        let parts: Vec<MethodComparison> = (5..8)
            .map(|seed| {
                serde_json::from_value(serde_json::to_value(compare(seed, 1)).unwrap()).unwrap()
            })
            .collect();
        assert_eq!(MethodComparison::join(&parts), Some(compare(5, 3)));
        assert_eq!(MethodComparison::join(&[]), None);
        assert_eq!(
            MethodComparison::join(&[parts[0].clone(), parts[2].clone()]),
            None
        );
    }
}
