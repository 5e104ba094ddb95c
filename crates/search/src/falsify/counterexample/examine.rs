//! From a failure that a search met to a counterexample on disk.

use std::path::Path;

use rayon::prelude::*;

use super::expected::{EXPECTED_VERSION, Expected, ExpectedFile, FINER, Replay, ReplayError};
use super::severity::Severity;
use super::shrink::shrink;
use super::{Avoidability, Changed, Counterexample};
use crate::falsify::Cube;
use crate::falsify::campaign::{Campaign, CampaignError, FailureCandidate, FailureKind};
use crate::work::Changes;
use crumple_world::measure::max_delta_v_mps;
use crumple_world::measure::{RunVerdict, Specification};
use crumple_world::scenario::space::Space;
use crumple_world::scenario::{Driver, LeadProfile, Scenario, ScenarioSpec, file};
use crumple_world::sim::{AfterContact, RecordingLevel, Run, simulate};

/// Two failures of one kind that are nearer than this are one.
pub const SAME_WITHIN: f64 = 0.1;

/// Share of the impact speed, or of the violation of a formula, that shrinking must leave.
const SEVERITY_KEPT: f64 = 0.5;

/// Examines the failures of a campaign.
pub(in crate::falsify) struct Examiner<'a> {
    campaign: &'a Campaign,
    space: &'a Space,
    cube: Cube,
    nominal: Vec<f64>,
}

/// A failure after the closer look.
struct Examined<'a> {
    candidate: &'a FailureCandidate,
    kind: FailureKind,
    values: Vec<f64>,
    scenario: Scenario,
    original: Scenario,
    verdict: RunVerdict,
    dt_fragile: bool,
    max_delta_v_mps: Option<f64>,
    vehicles_involved: usize,
}

impl<'a> Examiner<'a> {
    pub(in crate::falsify) fn new(campaign: &'a Campaign, space: &'a Space) -> Result<Self, CampaignError> {
        let cube = Cube::of(space).map_err(CampaignError::encoding)?;
        Ok(Self { campaign, space, cube, nominal: space.point(&space.nominal()) })
    }

    /// Looks at all candidates, keeps the distinct ones and has them written down.
    pub(in crate::falsify) fn examine_all(
        &self,
        candidates: &[&'a FailureCandidate],
        results: &mut Changes<'_>,
    ) -> Result<Vec<Counterexample>, CampaignError> {
        if candidates.is_empty() {
            return Ok(Vec::new());
        }
        let examined: Vec<Option<Examined<'a>>> =
            candidates.par_iter().map(|candidate| self.examine(candidate)).collect::<Result<_, _>>()?;
        let mut examined: Vec<Examined<'a>> = examined.into_iter().flatten().collect();
        examined.sort_by(|a, b| self.severity(b).compare(&self.severity(a)));
        let mut distinct: Vec<Examined<'a>> = Vec::new();
        for one in examined {
            if !distinct.iter().any(|known| self.is_same(known, &one)) {
                distinct.push(one);
            }
        }
        let mut index = ExpectedFile { version: EXPECTED_VERSION, expected: Vec::new() };
        let (mut found, mut files) = (Vec::new(), Vec::new());
        let specification = &self.campaign.specification;
        let classes: Vec<Avoidability> =
            distinct.par_iter().map(|one| Avoidability::of(specification, &one.verdict, &one.scenario)).collect();
        for (place, (one, class)) in distinct.iter().zip(classes).enumerate() {
            found.push(self.record(place + 1, one, class, &mut files, &mut index)?);
        }
        self.rank(&mut found);
        let text = toml::to_string(&index).map_err(CampaignError::encoding)?;
        results.write("counterexamples/expected.toml", text);
        for (name, text) in files {
            results.write(&name, text);
        }
        Ok(found)
    }

    fn replay(&self) -> Replay<'_> {
        Replay {
            specification: &self.campaign.specification,
            controller: &self.campaign.controller,
            estimator: self.campaign.estimator,
        }
    }

    /// None only if the failure cannot be reproduced, which the engines' agreement rules out.
    fn examine(&self, candidate: &'a FailureCandidate) -> Result<Option<Examined<'a>>, CampaignError> {
        let original = self.tidy(&candidate.values)?;
        let verdict = self.judge(&original, 1)?;
        let Some(kind) = self.kind(&verdict) else { return Ok(None) };
        // After a contact that is the impact speed.
        let most = SEVERITY_KEPT * verdict.robustness;
        let survives = |scenario: &Scenario| -> Result<bool, CampaignError> {
            let finer = self.kind(&self.judge(scenario, FINER)?);
            Ok(finer.is_some_and(|finer| finer.same_pair(&kind)))
        };
        let dt_fragile = !survives(&original)?;
        let mut values = candidate.values.clone();
        if !dt_fragile {
            let mut failed = None;
            let mut holds = |values: &[f64]| {
                let still = || -> Result<bool, CampaignError> {
                    let scenario = self.tidy(values)?;
                    let verdict = self.judge(&scenario, 1)?;
                    let as_hard = verdict.robustness <= most;
                    Ok(self.kind(&verdict) == Some(kind) && as_hard && survives(&scenario)?)
                };
                still().unwrap_or_else(|error| {
                    failed.get_or_insert(error);
                    false
                })
            };
            values = shrink(self.space, &values, &mut holds);
            if let Some(error) = failed {
                return Err(error);
            }
        }
        let scenario = self.tidy(&values)?;
        let verdict = self.judge(&scenario, 1)?;
        let options = self.replay().options(&scenario, 1).with_after_contact(AfterContact::Continue);
        let aftermath = simulate(&Run::new(&scenario, options)?, RecordingLevel::Summary);
        let vehicles = 0..scenario.vehicles().len();
        let deltas = vehicles.filter_map(|index| max_delta_v_mps(&aftermath.impacts, index));
        Ok(Some(Examined {
            candidate,
            kind,
            values,
            original,
            verdict,
            dt_fragile,
            max_delta_v_mps: deltas.reduce(f64::max),
            vehicles_involved: aftermath.vehicles_involved(),
            scenario,
        }))
    }

    fn kind(&self, verdict: &RunVerdict) -> Option<FailureKind> {
        FailureKind::of(verdict, &self.campaign.specification)
    }

    fn severity(&self, one: &Examined<'_>) -> Severity {
        let goes_by_violation = self.campaign.specification != Specification::NoContact || one.verdict.failed.is_some();
        Severity {
            violation: goes_by_violation.then_some(-one.verdict.robustness),
            impact_speed_mps: one.verdict.contact.map_or(0.0, |contact| contact.impact_speed_mps),
            max_delta_v_mps: one.max_delta_v_mps.unwrap_or(0.0),
            vehicles_involved: one.vehicles_involved,
        }
    }

    fn judge(&self, scenario: &Scenario, parts: u32) -> Result<RunVerdict, CampaignError> {
        self.replay().at(scenario, parts).map_err(|error| match error {
            ReplayError::Run(run) => run.into(),
            ReplayError::Specification(specification) => specification.into(),
            other => CampaignError::encoding(other),
        })
    }

    /// The scenario of values as it will stand in its file: no trailing digits of rounding, no piece twice in a row.
    fn tidy(&self, values: &[f64]) -> Result<Scenario, CampaignError> {
        let scenario = self.space.scenario(values)?;
        // What tidying would make invalid, at the very edge of a range, stays as it is.
        Ok(scenario.edited(tidy).unwrap_or(scenario))
    }

    fn is_same(&self, one: &Examined<'_>, other: &Examined<'_>) -> bool {
        let (a, b) = (self.space.point(&one.values), self.space.point(&other.values));
        one.kind == other.kind && self.cube.distance(&a, &b) <= SAME_WITHIN * self.cube.blocks().len() as f64
    }

    /// A failure with its files, not yet written.
    fn record(
        &self,
        place: usize,
        one: &Examined<'_>,
        avoidability: Avoidability,
        files: &mut Vec<(String, String)>,
        index: &mut ExpectedFile,
    ) -> Result<Counterexample, CampaignError> {
        let kind = one.kind.describe(&one.scenario);
        let slug = match one.kind {
            FailureKind::Contact { front_vehicle, rear_vehicle, .. } => format!("{rear_vehicle}-hits-{front_vehicle}"),
            FailureKind::ControllerFailed { vehicle } => format!("controller-{vehicle}-fails"),
            FailureKind::Violation { .. } => "violation".to_owned(),
        };
        let (file, original) = (format!("{place:02}-{slug}.toml"), format!("originals/{place:02}-{slug}.toml"));
        let campaign = self.campaign;
        let policy = campaign.policy_sha256();
        let driver = match &policy {
            Some(hash) => format!("`{}` (SHA-256 {hash})", campaign.controller.name),
            None => format!("`{}`", campaign.controller.name),
        };
        let candidate = one.candidate;
        let formula = match &campaign.specification {
            Specification::NoContact => String::new(),
            Specification::Formula(formula) => format!(" The formula is `{formula}`."),
        };
        let found = format!(
            "Found in the space `{}` by {} at its evaluation {} (seed {}): with {driver} {kind}.{formula}",
            self.space.name(),
            candidate.method,
            candidate.number,
            campaign.seed
        );
        let how =
            if one.dt_fragile { " It disappears at a tenth of the step: kept as it was found." } else { " Shrunk." };
        let class = avoidability.describe().map_or(String::new(), |words| format!(" {}.", sentence(&words)));
        let name = format!("{}-{}-{place:02}", self.space.name(), campaign.seed);
        let mut record = |file: &str, scenario: &Scenario, name: String, about: String, class: &Avoidability| {
            let named = scenario.edited(|spec| (spec.name, spec.about) = (name, about))?;
            let text = file::to_toml(&named).map_err(CampaignError::encoding)?;
            // From the text, not from memory: the file alone must fail.
            let again = file::from_toml(&text, Path::new(file)).map_err(CampaignError::encoding)?;
            files.push((format!("counterexamples/{file}"), text));
            let verdict = self.judge(&again, 1)?;
            index.expected.push(Expected {
                scenario: file.to_owned(),
                controller: campaign.controller.name.clone(),
                policy_sha256: policy.clone(),
                estimator: campaign.estimator,
                specification: campaign.specification.to_string(),
                violated: verdict.robustness < 0.0,
                robustness: verdict.robustness,
                contact_time_s: verdict.contact.map(|contact| contact.time_s),
                front_vehicle: verdict.contact.map(|contact| contact.front_vehicle),
                rear_vehicle: verdict.contact.map(|contact| contact.rear_vehicle),
                dt_fragile: one.dt_fragile,
                avoidable: class.class(),
                best_min_gap_m: class.best_min_gap_m(),
                undecided_because: class.undecided_because().map(str::to_owned),
            });
            Ok::<RunVerdict, CampaignError>(verdict)
        };
        let verdict = record(&file, &one.scenario, name.clone(), found.clone() + how + &class, &avoidability)?;
        let original_name = format!("{name}-original");
        let as_found = record(&original, &one.original, original_name, found, &Avoidability::NotAsked)?;
        let point = self.space.point(&one.values);
        Ok(Counterexample {
            file: format!("counterexamples/{file}"),
            original_file: format!("counterexamples/{original}"),
            kind,
            robustness: verdict.robustness,
            contact_time_s: verdict.contact.map(|contact| contact.time_s),
            front_vehicle: verdict.contact.map(|contact| contact.front_vehicle),
            rear_vehicle: verdict.contact.map(|contact| contact.rear_vehicle),
            impact_speed_mps: verdict.contact.map(|contact| contact.impact_speed_mps),
            original_impact_speed_mps: as_found.contact.map(|contact| contact.impact_speed_mps),
            max_delta_v_mps: one.max_delta_v_mps,
            vehicles_involved: one.vehicles_involved,
            ln_likelihood: self.space.ln_likelihood(&point),
            departure: self.cube.distance(&point, &self.nominal) / self.cube.blocks().len() as f64,
            likelihood_rank: 0,
            dt_fragile: one.dt_fragile,
            avoidability,
            found_by: candidate.method.name().to_owned(),
            found_at: candidate.number,
            changed: self.changed(&one.values),
        })
    }

    /// What is not nominal; a signal with one value throughout counts as one.
    fn changed(&self, values: &[f64]) -> Vec<Changed> {
        let names = self.space.coordinate_names();
        let mut changed = Vec::new();
        for parameter in self.space.parameters() {
            let own = values.get(parameter.coordinates()).unwrap_or_default();
            if own == parameter.nominal() {
                continue;
            }
            let mut say = |name: &str, value: f64| {
                let unit = parameter.unit().to_owned();
                changed.push(Changed { parameter: name.to_owned(), value: parameter.show(value), unit });
            };
            match own {
                [first, rest @ ..] if rest.iter().all(|value| value == first) => say(parameter.name(), *first),
                _ => {
                    let pieces = names.get(parameter.coordinates()).unwrap_or_default();
                    let differs = pieces.iter().zip(own.iter().zip(parameter.nominal()));
                    differs.filter(|(_, (a, b))| a != b).for_each(|(name, (value, _))| say(name, *value));
                }
            }
        }
        changed
    }

    fn rank(&self, found: &mut [Counterexample]) {
        let mut order: Vec<usize> = (0..found.len()).collect();
        let key = |index: &usize| found.get(*index).map_or((0.0, 0.0), |one| (-one.ln_likelihood, one.departure));
        order.sort_by(|a, b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal));
        for (rank, index) in order.into_iter().enumerate() {
            if let Some(one) = found.get_mut(index) {
                one.likelihood_rank = rank + 1;
            }
        }
    }
}

/// With a capital.
fn sentence(words: &str) -> String {
    let mut letters = words.chars();
    letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect()
}

fn tidy(spec: &mut ScenarioSpec) {
    /// To a billionth: far below any sensor, and enough to get rid of trailing digits. No negative zero.
    fn rounded(number: &mut f64) {
        *number = (*number * 1e9).round() / 1e9 + 0.0;
    }
    for vehicle in &mut spec.vehicles {
        rounded(&mut vehicle.position_m);
        vehicle.mass_kg.iter_mut().chain(&mut vehicle.max_brake_mps2).for_each(rounded);
        if let Driver::Profile(LeadProfile::Pieces(pieces)) = &mut vehicle.driver {
            pieces.from_s.iter_mut().chain(&mut pieces.accel_mps2).for_each(rounded);
            let mut before = None;
            let keep: Vec<bool> = pieces.accel_mps2.iter().map(|&accel| before.replace(accel) != Some(accel)).collect();
            let mut kept = keep.iter();
            pieces.from_s.retain(|_| kept.next().copied().unwrap_or(true));
            let mut kept = keep.iter();
            pieces.accel_mps2.retain(|_| kept.next().copied().unwrap_or(true));
        }
    }
}
