//! Configuration of a campaign without the controller: enough to describe results, not to search.

use std::path::Path;

use super::config::{CampaignRecord, with_reference_methods};
use super::{CAMPAIGN_VERSION, Campaign, CampaignError, EvaluatedPoint, SearchObjective};
use crate::falsify::{Method, UnitCube};
use crumple_controllers::Controllers;
use crumple_core::format_version::check_version;
use crumple_measure::{RunVerdict, Specification, harm_of_pair};
use crumple_sim::scenario::Scenario;
use crumple_spaces::ScenarioSpace;

#[derive(Debug, Clone)]
pub(in crate::falsify) struct ResolvedConfig {
    pub(in crate::falsify) record: CampaignRecord,
    /// Space with the campaign's noise.
    pub(in crate::falsify) space: ScenarioSpace,
    pub(in crate::falsify) specification: Specification,
    pub(in crate::falsify) cube: UnitCube,
    /// The nominal scenario, and its point in the cube.
    pub(in crate::falsify) nominal: Scenario,
    nominal_point: Vec<f64>,
}

impl ResolvedConfig {
    pub(super) fn from_campaign(campaign: &Campaign) -> Result<Self, CampaignError> {
        let record = CampaignRecord::from_campaign(campaign)?;
        Self::resolve(record, campaign.space.clone(), |_| {
            Ok(campaign.specification.clone())
        })
    }

    pub(super) fn from_record(
        record: CampaignRecord,
        controllers: Controllers,
    ) -> Result<Self, String> {
        check_version(record.version, CAMPAIGN_VERSION)
            .map_err(|unsupported| format!("version: {unsupported}"))?;
        let subject = &record.subject;
        // The record contains the space with its base scenario, so no folder is searched.
        let space = ScenarioSpace::new(subject.space.clone(), Path::new(""), &controllers)
            .map_err(|error| format!("space: {error}"))?;
        if *space.spec() != subject.space {
            return Err("space: differs from what crumple writes for this space".to_owned());
        }
        let text = subject.specification.clone();
        Self::resolve(record, space, |nominal| {
            Specification::parse(&text, nominal).map_err(CampaignError::from_encoding_error)
        })
        .map_err(|error| error.to_string())
    }

    fn resolve(
        record: CampaignRecord,
        space: ScenarioSpace,
        specification: impl FnOnce(&Scenario) -> Result<Specification, CampaignError>,
    ) -> Result<Self, CampaignError> {
        let space = space.with_noise_seed(record.subject.seed);
        let nominal = space.scenario(&space.nominal())?;
        let specification = specification(&nominal)?;
        let cube = UnitCube::from_space(&space).map_err(CampaignError::from_encoding_error)?;
        let nominal_point = space.point(&space.nominal());
        Ok(Self {
            record,
            space,
            specification,
            cube,
            nominal,
            nominal_point,
        })
    }

    pub(super) fn methods(&self) -> Vec<Method> {
        with_reference_methods(&self.record.search.method)
    }

    pub(super) fn evaluated_point(
        &self,
        number: u64,
        point: Vec<f64>,
        verdict: RunVerdict,
    ) -> EvaluatedPoint {
        EvaluatedPoint {
            number,
            values: self.space.values(&point),
            ln_likelihood: self.space.ln_likelihood(&point),
            distance_from_nominal: self.distance_from_nominal(&point),
            harm: self.harm(&point, &verdict),
            point,
            verdict,
        }
    }

    fn harm(&self, point: &[f64], verdict: &RunVerdict) -> f64 {
        let collision = verdict
            .collision
            .filter(|_| self.record.search.objective == SearchObjective::Harm);
        let harm = collision.and_then(|collision| {
            let scenario = self.space.scenario_at(point).ok()?;
            let vehicles = scenario.vehicles();
            let front = vehicles.get(collision.front_vehicle as usize)?;
            let rear = vehicles.get(collision.rear_vehicle as usize)?;
            let masses_kg = [front.mass_kg(), rear.mass_kg()];
            Some(harm_of_pair(collision.impact_speed_mps, masses_kg))
        });
        harm.unwrap_or(0.0)
    }

    pub(in crate::falsify) fn distance_from_nominal(&self, point: &[f64]) -> f64 {
        self.cube.distance(point, &self.nominal_point) / self.cube.blocks().len() as f64
    }
}
