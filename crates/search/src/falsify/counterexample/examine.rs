//! Examination of failures: replay, shrinking and classification.

use std::path::Path;

use rayon::prelude::*;

use super::AvoidabilityAnalysis;
use super::batching::run_batched;
use super::expected::FINER_STEP_DIVISOR;
use super::record::ExaminedFailure;
use super::shrink::shrink;
use crate::confirmation::CONFIRMING_PLANT;
use crate::falsify::campaign::{
    Campaign, CampaignError, FailureCandidate, FailureKind, ResolvedConfig,
};
use crumple_measure::{RunVerdict, SpecificationError, harm, max_delta_v_mps};
use crumple_sim::engine::{
    AfterCollision, FailedController, RecordingLevel, Run, SimulationResult, simulate,
};
use crumple_sim::scenario::{Driver, LeadProfile, Scenario, ScenarioSpec, file};

/// Minimum share of the impact speed, or of the violation of a formula, that shrinking preserves.
const MIN_SEVERITY_SHARE: f64 = 0.5;

/// Simulates a scenario with its step divided by a number; `None` if the caller must simulate it itself.
type EvaluateFn<'a> =
    dyn FnMut((Scenario, u32)) -> Option<Result<RunVerdict, SpecificationError>> + 'a;

/// The failure that shrinking preserves.
struct PreservedFailure {
    kind: FailureKind,
    max_robustness: f64,
}

pub(in crate::falsify) struct Examiner<'a> {
    campaign: &'a Campaign,
    config: &'a ResolvedConfig,
}

impl<'a> Examiner<'a> {
    pub(in crate::falsify) fn new(campaign: &'a Campaign, config: &'a ResolvedConfig) -> Self {
        Self { campaign, config }
    }

    /// Examines all candidates. Drops only those that cannot be reproduced.
    pub(in crate::falsify) fn examine_all(
        &self,
        candidates: &[&FailureCandidate],
    ) -> Result<Vec<ExaminedFailure>, CampaignError> {
        let examined = run_batched(
            candidates,
            |candidate, ask| self.examine(candidate, ask),
            |simulations: &[(Scenario, u32)]| {
                let simulations: Vec<_> = simulations
                    .iter()
                    .map(|(scenario, parts)| (scenario, *parts))
                    .collect();
                self.campaign.evaluator().evaluate_all(&simulations)
            },
        );
        Ok(examined
            .into_iter()
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .flatten()
            .collect())
    }

    pub(in crate::falsify) fn classify_all(&self, examined: &mut [ExaminedFailure]) {
        let specification = &self.config.specification;
        examined.par_iter_mut().for_each(|failure| {
            failure.analysis =
                AvoidabilityAnalysis::classify(specification, &failure.verdict, &failure.scenario)
        });
    }

    /// Replays all failures with the multi-body plant. A failure whose controller refuses the plant has no result.
    pub(in crate::falsify) fn confirm_all(&self, examined: &mut [ExaminedFailure]) {
        let scenarios: Vec<_> = examined
            .iter()
            .map(|failure| failure.scenario.with_plant(CONFIRMING_PLANT).ok())
            .collect();
        let simulations: Vec<_> = scenarios
            .iter()
            .flatten()
            .map(|scenario| (scenario, 1))
            .collect();
        let mut verdicts = self
            .campaign
            .evaluator()
            .evaluate_all(&simulations)
            .into_iter();
        for (failure, _) in examined
            .iter_mut()
            .zip(&scenarios)
            .filter(|(_, scenario)| scenario.is_some())
        {
            failure.survives = verdicts
                .next()
                .and_then(Result::ok)
                .map(|verdict| self.kind(&verdict).is_some());
        }
    }

    /// Examines a candidate: shrinks it, and simulates what its files contain. `None` if it is not reproduced.
    fn examine(
        &self,
        candidate: &FailureCandidate,
        ask: &mut EvaluateFn<'_>,
    ) -> Result<Option<ExaminedFailure>, CampaignError> {
        let original = self.tidy(&candidate.values)?;
        let original_verdict = self.evaluate(&original, 1, ask)?;
        let Some(kind) = self.kind(&original_verdict) else {
            return Ok(None);
        };
        let dt_fragile = !self.fails_at_finer_step(&original, &kind, ask)?;
        let values = if dt_fragile {
            candidate.values.clone()
        } else {
            let preserved = PreservedFailure {
                kind,
                // After a collision, robustness is the negative impact speed.
                max_robustness: MIN_SEVERITY_SHARE * original_verdict.robustness,
            };
            self.shrink_values(&candidate.values, &preserved, ask)?
        };
        // Read the text back: the file alone must fail.
        let scenario = write_and_read_back(&self.tidy(&values)?)?;
        let original = write_and_read_back(&original)?;
        let verdict = self.evaluate(&scenario, 1, ask)?;
        let original_verdict = self.evaluate(&original, 1, ask)?;
        let aftermath = self.simulate_aftermath(&scenario)?;
        let failed = aftermath.outcome.failed_controller();
        let is_reproduced = self.kind(&verdict) == Some(kind)
            && verdict.failure.is_some() == (verdict.collision.is_none() && failed.is_some());
        // With an external controller, drop a failure that the file alone does not reproduce.
        if !is_reproduced && self.has_external_controller() {
            return Ok(None);
        }
        let deltas_mps = (0..scenario.vehicles().len())
            .filter_map(|index| max_delta_v_mps(&aftermath.impacts, index));
        Ok(Some(ExaminedFailure {
            method: candidate.method.clone(),
            number: candidate.number,
            kind,
            values,
            original,
            verdict,
            original_verdict,
            dt_fragile,
            max_delta_v_mps: deltas_mps.reduce(f64::max),
            harm: harm(&aftermath.impacts, scenario.vehicles().len()),
            vehicles_involved: aftermath.vehicles_involved(),
            reason: failed
                .filter(|_| verdict.failure.is_some())
                .map(FailedController::reason),
            scenario,
            analysis: AvoidabilityAnalysis::default(),
            survives: None,
        }))
    }

    /// Shrinks the values of a candidate as far as the failure survives.
    fn shrink_values(
        &self,
        values: &[f64],
        preserved: &PreservedFailure,
        ask: &mut EvaluateFn<'_>,
    ) -> Result<Vec<f64>, CampaignError> {
        let mut first_error = None;
        let shrunk = shrink(&self.config.space, values, &mut |changed: &[f64]| {
            self.is_preserved(preserved, changed, ask)
                .unwrap_or_else(|error| {
                    first_error.get_or_insert(error);
                    false
                })
        });
        match first_error {
            Some(error) => Err(error),
            None => Ok(shrunk),
        }
    }

    /// Returns whether values in the search region fail in the same way, as severely, and also at the finer step.
    fn is_preserved(
        &self,
        preserved: &PreservedFailure,
        values: &[f64],
        ask: &mut EvaluateFn<'_>,
    ) -> Result<bool, CampaignError> {
        let space = &self.config.space;
        if !space.is_in_search_region(&space.point(values)) {
            return Ok(false);
        }
        let scenario = self.tidy(values)?;
        let verdict = self.evaluate(&scenario, 1, ask)?;
        Ok(self.kind(&verdict) == Some(preserved.kind)
            && verdict.robustness <= preserved.max_robustness
            && self.fails_at_finer_step(&scenario, &preserved.kind, ask)?)
    }

    fn fails_at_finer_step(
        &self,
        scenario: &Scenario,
        kind: &FailureKind,
        ask: &mut EvaluateFn<'_>,
    ) -> Result<bool, CampaignError> {
        let finer = self.kind(&self.evaluate(scenario, FINER_STEP_DIVISOR, ask)?);
        Ok(finer.is_some_and(|finer| finer.is_same_failure_mode(kind)))
    }

    /// Simulates a scenario beyond its first collision.
    fn simulate_aftermath(&self, scenario: &Scenario) -> Result<SimulationResult, CampaignError> {
        let options = self
            .campaign
            .evaluator()
            .run_options(scenario, 1)
            .with_after_collision(AfterCollision::Continue);
        let run = Run::new(scenario, options)?;
        Ok(simulate(&run, RecordingLevel::Summary))
    }

    fn has_external_controller(&self) -> bool {
        self.campaign
            .controllers()
            .any(|controller| controller.source.can_fail())
    }

    fn kind(&self, verdict: &RunVerdict) -> Option<FailureKind> {
        FailureKind::from_verdict(verdict, &self.config.specification)
    }

    fn evaluate(
        &self,
        scenario: &Scenario,
        parts: u32,
        ask: &mut EvaluateFn<'_>,
    ) -> Result<RunVerdict, CampaignError> {
        Ok(ask((scenario.clone(), parts))
            .unwrap_or_else(|| self.campaign.evaluator().evaluate(scenario, parts))?)
    }

    /// Returns the scenario of values as its file will contain it: rounded, and without repeated pieces.
    fn tidy(&self, values: &[f64]) -> Result<Scenario, CampaignError> {
        let scenario = self.config.space.scenario(values)?;
        // Keep the original if rounding at the edge of a range makes it invalid.
        Ok(scenario.edited(tidy).unwrap_or(scenario))
    }
}

fn write_and_read_back(scenario: &Scenario) -> Result<Scenario, CampaignError> {
    let text = file::to_toml(scenario).map_err(CampaignError::from_encoding_error)?;
    file::from_toml(&text, Path::new("counterexample"), scenario)
        .map_err(CampaignError::from_encoding_error)
}

fn tidy(spec: &mut ScenarioSpec) {
    /// Rounds to 1e-9, far below the accuracy of any sensor. Removes a negative zero.
    fn round(number: &mut f64) {
        *number = (*number * 1e9).round() / 1e9 + 0.0;
    }
    for vehicle in &mut spec.vehicles {
        round(&mut vehicle.position_m);
        vehicle
            .mass_kg
            .iter_mut()
            .chain(&mut vehicle.max_brake_mps2)
            .for_each(round);
        if let Driver::Profile(LeadProfile::Pieces(pieces)) = &mut vehicle.driver {
            pieces
                .from_s
                .iter_mut()
                .chain(&mut pieces.accel_mps2)
                .for_each(round);
            let mut distinct: Vec<(f64, f64)> = pieces
                .from_s
                .drain(..)
                .zip(pieces.accel_mps2.drain(..))
                .collect();
            distinct.dedup_by_key(|(_, accel_mps2)| *accel_mps2);
            (pieces.from_s, pieces.accel_mps2) = distinct.into_iter().unzip();
        }
    }
}
