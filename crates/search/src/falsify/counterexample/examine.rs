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
use crumple_world::scenario::{Driver, LeadProfile, Scenario, ScenarioSpec, file};
use crumple_world::sim::{AfterContact, FailedController, RecordingLevel, Run, simulate};

/// Minimum share of the impact speed, or of the violation of a formula, that shrinking preserves.
const MIN_SEVERITY_SHARE: f64 = 0.5;

/// Simulates a scenario with its step divided by a number; `None` if the caller must simulate it itself.
type EvaluateFn<'a> =
    dyn FnMut((Scenario, u32)) -> Option<Result<RunVerdict, SpecificationError>> + 'a;

pub(in crate::falsify) struct Examiner<'a> {
    campaign: &'a Campaign,
    config: &'a ResolvedConfig,
}

impl<'a> Examiner<'a> {
    pub(in crate::falsify) fn new(campaign: &'a Campaign, terms: &'a ResolvedConfig) -> Self {
        Self {
            campaign,
            config: terms,
        }
    }

    /// Examines all candidates. Drops only those that cannot be reproduced.
    pub(in crate::falsify) fn examine_all(
        &self,
        candidates: &[&FailureCandidate],
    ) -> Result<Vec<ExaminedFailure>, CampaignError> {
        let examined = run_batched(
            candidates,
            |candidate, ask| self.examine(candidate, ask),
            |asked: &[(Scenario, u32)]| {
                let asked: Vec<_> = asked
                    .iter()
                    .map(|(scenario, parts)| (scenario, *parts))
                    .collect();
                self.campaign.evaluator().evaluate_all(&asked)
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
        examined.par_iter_mut().for_each(|one| {
            one.analysis =
                AvoidabilityAnalysis::classify(specification, &one.verdict, &one.scenario)
        });
    }

    /// Replays all failures with the multi-body plant. A failure whose controller refuses the plant has no result.
    pub(in crate::falsify) fn confirm_all(&self, examined: &mut [ExaminedFailure]) {
        let with_plant = |one: &ExaminedFailure| one.scenario.with_plant(CONFIRMING_PLANT).ok();
        let scenarios: Vec<_> = examined.iter().map(with_plant).collect();
        let asked: Vec<_> = scenarios
            .iter()
            .flatten()
            .map(|scenario| (scenario, 1))
            .collect();
        let mut verdicts = self.campaign.evaluator().evaluate_all(&asked).into_iter();
        for (one, _) in examined
            .iter_mut()
            .zip(&scenarios)
            .filter(|(_, scenario)| scenario.is_some())
        {
            one.survives = verdicts
                .next()
                .and_then(Result::ok)
                .map(|verdict| self.kind(&verdict).is_some());
        }
    }

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
        // After a collision, robustness is the negative impact speed.
        let most = MIN_SEVERITY_SHARE * original_verdict.robustness;
        let survives =
            |scenario: &Scenario, ask: &mut EvaluateFn<'_>| -> Result<bool, CampaignError> {
                let finer = self.kind(&self.evaluate(scenario, FINER_STEP_DIVISOR, ask)?);
                Ok(finer.is_some_and(|finer| finer.is_same_failure_mode(&kind)))
            };
        let dt_fragile = !survives(&original, ask)?;
        let mut values = candidate.values.clone();
        if !dt_fragile {
            let mut failed = None;
            let mut holds = |values: &[f64]| {
                let mut still = || -> Result<bool, CampaignError> {
                    if !self
                        .config
                        .space
                        .is_in_search_region(&self.config.space.point(values))
                    {
                        return Ok(false);
                    }
                    let scenario = self.tidy(values)?;
                    let verdict = self.evaluate(&scenario, 1, ask)?;
                    let as_hard = verdict.robustness <= most;
                    Ok(self.kind(&verdict) == Some(kind) && as_hard && survives(&scenario, ask)?)
                };
                still().unwrap_or_else(|error| {
                    failed.get_or_insert(error);
                    false
                })
            };
            values = shrink(&self.config.space, &values, &mut holds);
            if let Some(error) = failed {
                return Err(error);
            }
        }
        // Read the text back: the file alone must fail.
        let (scenario, original) = (
            write_and_read_back(&self.tidy(&values)?)?,
            write_and_read_back(&original)?,
        );
        let (verdict, original_verdict) = (
            self.evaluate(&scenario, 1, ask)?,
            self.evaluate(&original, 1, ask)?,
        );
        let options = self
            .campaign
            .evaluator()
            .run_options(&scenario, 1)
            .with_after_contact(AfterContact::Continue);
        let aftermath = simulate(&Run::new(&scenario, options)?, RecordingLevel::Summary);
        let failed = aftermath.outcome.failed_controller();
        // With an external controller, drop a failure that the file alone does not reproduce.
        let is_again = self.kind(&verdict) == Some(kind)
            && verdict.failure.is_some() == (verdict.contact.is_none() && failed.is_some());
        if !is_again
            && self
                .campaign
                .controllers()
                .any(|driver| driver.source.can_fail())
        {
            return Ok(None);
        }
        let vehicles = 0..scenario.vehicles().len();
        let deltas = vehicles.filter_map(|index| max_delta_v_mps(&aftermath.impacts, index));
        Ok(Some(ExaminedFailure {
            method: candidate.method.clone(),
            number: candidate.number,
            kind,
            values,
            original,
            verdict,
            original_verdict,
            dt_fragile,
            max_delta_v_mps: deltas.reduce(f64::max),
            harm: harm(&aftermath.impacts, scenario.vehicles().len()),
            vehicles_involved: aftermath.vehicles_involved(),
            because: failed
                .filter(|_| verdict.failure.is_some())
                .map(FailedController::reason),
            scenario,
            analysis: AvoidabilityAnalysis::default(),
            survives: None,
        }))
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
            let mut kept: Vec<(f64, f64)> = pieces
                .from_s
                .drain(..)
                .zip(pieces.accel_mps2.drain(..))
                .collect();
            kept.dedup_by_key(|(_, accel)| *accel);
            (pieces.from_s, pieces.accel_mps2) = kept.into_iter().unzip();
        }
    }
}
