//! Searches that end at the first failure, to compare methods.

use serde::{Deserialize, Serialize};

use super::run::next_points;
use super::{Campaign, CampaignError, CampaignProgress, ResolvedConfig};
use crumple_core::non_finite;
use crumple_core::observer::Observer;

/// Result of a search that ends at its first failure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FirstFailure {
    /// Number of simulations up to the first failure; `None` if the budget ended before.
    pub simulations: Option<u64>,
    /// Smallest robustness.
    #[serde(with = "non_finite")]
    pub least_robustness: f64,
}

impl Campaign {
    /// Searches with the method alone, until the first failure or the end of the budget. Writes no files.
    ///
    /// # Errors
    /// [`CampaignError`] if a scenario cannot be run, or `observer` stops the search.
    pub fn find_first_failure(
        &self,
        observer: &dyn Observer<CampaignProgress>,
    ) -> Result<FirstFailure, CampaignError> {
        let config = ResolvedConfig::from_campaign(self)?;
        self.check_at(&config.nominal)?;
        let mut search = self.search.method.start(&config.cube, self.seed);
        let mut done = 0;
        let mut best = f64::INFINITY;
        while done < self.search.budget {
            let left = self.search.budget - done;
            let points = next_points(&mut *search, (&self.search.method, 1), &config, left)?;
            let verdicts = self.evaluate(&config.space, &points)?;
            let robustness: Vec<f64> = verdicts.iter().map(|verdict| verdict.robustness).collect();
            let first = verdicts.iter().position(|verdict| verdict.is_violation());
            let up_to = first.map_or(robustness.len(), |first| first + 1);
            best = robustness.iter().take(up_to).copied().fold(best, f64::min);
            observer.notify(&CampaignProgress {
                method: Some(self.search.method.clone()),
                examination: None,
                evaluations: done + up_to as u64,
                total: self.search.budget,
                failures: u64::from(first.is_some()),
                best_robustness: best,
            })?;
            done += up_to as u64;
            if first.is_some() {
                return Ok(FirstFailure {
                    simulations: Some(done),
                    least_robustness: best,
                });
            }
            search.tell(&robustness);
        }
        Ok(FirstFailure {
            simulations: None,
            least_robustness: best,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falsify::Method;
    use crumple_core::observer::Quiet;
    use crumple_sim::control::BuiltInController;
    use crumple_store::study::Study;

    #[test]
    fn the_first_failure_is_that_of_the_campaign() {
        for method in [Method::Halton, Method::CmaEs] {
            let controller = BuiltInController::from_name("predictive").unwrap().into();
            let campaign = Campaign {
                controller,
                ..Campaign::of_match_leader("high-risk", method, 80, 3)
            };
            let folder = tempfile::tempdir().unwrap();
            let summary = campaign.run(folder.path(), false, &Quiet).unwrap();
            let first_failure = campaign.find_first_failure(&Quiet).unwrap();
            assert_eq!(
                first_failure.simulations, summary.methods[0].first_falsification,
                "{}",
                campaign.search.method
            );
            let budget = first_failure.simulations.unwrap() - 1;
            let short = campaign
                .with_budget(budget)
                .find_first_failure(&Quiet)
                .unwrap();
            assert!(
                budget > 0 && short.simulations.is_none() && short.least_robustness >= 0.0,
                "{budget}: {short:?}"
            );
        }
    }
}
