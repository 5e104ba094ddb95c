//! Conversion of examined failures to counterexamples and their files, without simulation.

use super::expected::{EXPECTED_VERSION, ExpectedFile, ExpectedVerdict};
use super::severity::Severity;
use super::{Avoidability, AvoidabilityAnalysis, ChangedParameter, Counterexample};
use crate::falsify::campaign::{CampaignError, FailureKind, ResolvedConfig};
use crate::falsify::{FailureCriterionRecord, Method};
use crumple_measure::{RunVerdict, Specification};
use crumple_sim::scenario::{Scenario, file};
use crumple_store::run_folder::FolderTransaction;

/// Failures of one kind that are closer than this count as one.
pub const SAME_FAILURE_DISTANCE: f64 = 0.1;

type FileContents = Vec<(String, String)>;

#[derive(Debug, Clone)]
pub(in crate::falsify) struct ExaminedFailure {
    /// Method that found it, and the number of its evaluation.
    pub(in crate::falsify) method: Method,
    pub(in crate::falsify) number: u64,
    pub(super) kind: FailureKind,
    pub(super) values: Vec<f64>,
    /// Scenario as its file will contain it, except for the name, and the original.
    pub(super) scenario: Scenario,
    pub(super) original: Scenario,
    pub(super) verdict: RunVerdict,
    pub(super) original_verdict: RunVerdict,
    pub(super) dt_fragile: bool,
    pub(super) max_delta_v_mps: Option<f64>,
    pub(super) harm: f64,
    pub(super) vehicles_involved: usize,
    pub(super) because: Option<String>,
    pub(super) analysis: AvoidabilityAnalysis,
    /// True if the scenario also fails with the multi-body plant.
    pub(super) survives: Option<bool>,
}

/// Selects distinct failures of a campaign and records them.
pub(in crate::falsify) struct Recorder<'a> {
    pub(in crate::falsify) config: &'a ResolvedConfig,
}

impl Recorder<'_> {
    /// Returns the distinct failures, the severest first. Of equally severe ones the earlier stays.
    pub(in crate::falsify) fn select_distinct(
        &self,
        mut examined: Vec<ExaminedFailure>,
    ) -> Vec<ExaminedFailure> {
        examined.sort_by(|a, b| self.severity(b).compare(&self.severity(a)));
        let mut distinct: Vec<ExaminedFailure> = Vec::new();
        for one in examined {
            if !distinct
                .iter()
                .any(|known| self.is_same_failure(known, &one))
            {
                distinct.push(one);
            }
        }
        distinct
    }

    /// Adds the files of distinct failures to the transaction.
    pub(in crate::falsify) fn record_all(
        &self,
        distinct: &[ExaminedFailure],
        results: &mut FolderTransaction<'_>,
    ) -> Result<Vec<Counterexample>, CampaignError> {
        let mut index = ExpectedFile {
            version: EXPECTED_VERSION,
            expected: Vec::new(),
        };
        let (mut found, mut files) = (Vec::new(), Vec::new());
        for (place, one) in (1..).zip(distinct) {
            found.push(self.record(place, one, &mut files, &mut index)?);
        }
        rank_by_likelihood(&mut found);
        if !found.is_empty() {
            let text = toml::to_string(&index).map_err(CampaignError::from_encoding_error)?;
            files.insert(
                0,
                (
                    format!("counterexamples/{}", file::EXPECTED_FILE_NAME),
                    text,
                ),
            );
        }
        for (name, text) in files {
            results.write(&name, text);
        }
        Ok(found)
    }

    fn severity(&self, one: &ExaminedFailure) -> Severity {
        let goes_by_violation =
            self.config.specification != Specification::NoContact || one.verdict.failure.is_some();
        Severity {
            violation: if goes_by_violation {
                -one.verdict.robustness
            } else {
                0.0
            },
            impact_speed_mps: one
                .verdict
                .contact
                .map_or(0.0, |contact| contact.impact_speed_mps),
            max_delta_v_mps: one.max_delta_v_mps.unwrap_or(0.0),
            vehicles_involved: one.vehicles_involved,
        }
    }

    fn is_same_failure(&self, one: &ExaminedFailure, other: &ExaminedFailure) -> bool {
        let ResolvedConfig { space, cube, .. } = self.config;
        let (a, b) = (space.point(&one.values), space.point(&other.values));
        one.kind == other.kind
            && cube.distance(&a, &b) <= SAME_FAILURE_DISTANCE * cube.blocks().len() as f64
    }

    /// Returns a counterexample and adds its files, without writing them.
    fn record(
        &self,
        place: usize,
        one: &ExaminedFailure,
        files: &mut FileContents,
        index: &mut ExpectedFile,
    ) -> Result<Counterexample, CampaignError> {
        let kind = one.kind.describe(&one.scenario);
        let slug = match one.kind {
            FailureKind::Contact {
                front_vehicle,
                rear_vehicle,
                ..
            } => format!("{rear_vehicle}-hits-{front_vehicle}"),
            FailureKind::ControllerFailed { vehicle } => format!("controller-{vehicle}-fails"),
            FailureKind::Violation { .. } => "violation".to_owned(),
        };
        let (file, original) = (
            format!("{place:02}-{slug}.toml"),
            format!("originals/{place:02}-{slug}.toml"),
        );
        let terms = &self.config.record;
        let subject = &terms.subject;
        let policy = subject.policy_sha256.clone();
        let driver = match &policy {
            Some(hash) => format!("`{}` (SHA-256 {hash})", subject.controller),
            None => format!("`{}`", subject.controller),
        };
        let formula = match &self.config.specification {
            Specification::NoContact => String::new(),
            Specification::Formula(formula) => format!(" The formula is `{formula}`."),
            Specification::DrivingRule(rule) => format!(" The rule is `{rule}`."),
        };
        let beside = match &terms.failure_criterion {
            None => String::new(),
            Some(FailureCriterionRecord::Differential { controller, .. }) => {
                format!(", and `{controller}` passes it")
            }
        };
        let why = one
            .because
            .as_ref()
            .map_or(String::new(), |because| format!(" {because}"));
        let found = format!(
            "Found in the space `{}` by {} at its evaluation {} (seed {}): with {driver} {kind}{why}{beside}.{formula}",
            self.config.space.name(),
            one.method,
            one.number,
            subject.seed
        );
        let how = if one.dt_fragile {
            " It disappears at a tenth of the step: kept as it was found."
        } else {
            " Shrunk."
        };
        let class = one
            .analysis
            .avoidability
            .describe()
            .map_or(String::new(), |words| format!(" {}.", capitalise(&words)));
        let changed = self.changed_parameters(&one.values);
        let outside: Vec<_> = changed
            .iter()
            .filter(|one| one.outside_observed.is_some())
            .map(ToString::to_string)
            .collect();
        let outside = match outside[..] {
            [] => String::new(),
            _ => format!(" Values beyond the recordings: {}.", outside.join(", ")),
        };
        let name = format!("{}-{}-{place:02}", self.config.space.name(), subject.seed);
        let named_file = |path: String, scenario: &Scenario, name, about| {
            let named = scenario.edited(|spec| (spec.name, spec.about) = (name, about))?;
            Ok::<_, CampaignError>((
                path,
                file::to_toml(&named).map_err(CampaignError::from_encoding_error)?,
            ))
        };
        let mut write = |file: &str,
                         (scenario, verdict): (&Scenario, &RunVerdict),
                         name,
                         about,
                         class: &Avoidability| {
            files.push(named_file(
                format!("counterexamples/{file}"),
                scenario,
                name,
                about,
            )?);
            index.expected.push(ExpectedVerdict {
                scenario: file.to_owned(),
                controller: subject.controller.clone(),
                policy_sha256: policy.clone(),
                controller_sha256: subject.controller_sha256.clone(),
                estimator: subject.estimator,
                specification: self.config.specification.to_string(),
                violated: verdict.robustness < 0.0,
                robustness: verdict.robustness,
                contact_time_s: verdict.contact.map(|contact| contact.time_s),
                front_vehicle: verdict.contact.map(|contact| contact.front_vehicle),
                rear_vehicle: verdict.contact.map(|contact| contact.rear_vehicle),
                dt_fragile: one.dt_fragile,
                avoidable: class.class(),
                best_min_gap_m: class.best_min_gap_m(),
                undecided_because: class.undecided_because().map(str::to_owned),
                failure_criterion: terms.failure_criterion.clone(),
            });
            Ok::<(), CampaignError>(())
        };
        let (verdict, as_found) = (&one.verdict, &one.original_verdict);
        write(
            &file,
            (&one.scenario, verdict),
            name.clone(),
            found.clone() + how + &class + &outside,
            &one.analysis.avoidability,
        )?;
        let original_name = format!("{name}-original");
        write(
            &original,
            (&one.original, as_found),
            original_name,
            found,
            &Avoidability::NotAsked,
        )?;
        let escape_file = one
            .analysis
            .escape
            .as_ref()
            .map(|escape| (format!("counterexamples/escapes/{file}"), escape));
        if let Some((path, escape)) = &escape_file {
            let about = format!(
                "An escape from {file}: a driver who knows the future avoids the collision like this."
            );
            files.push(named_file(
                path.clone(),
                escape,
                format!("{name}-escape"),
                about,
            )?);
        }
        let point = self.config.space.point(&one.values);
        Ok(Counterexample {
            file: format!("counterexamples/{file}"),
            original_file: format!("counterexamples/{original}"),
            escape_file: escape_file.map(|(path, _)| path),
            kind,
            because: one.because.clone(),
            robustness: verdict.robustness,
            contact_time_s: verdict.contact.map(|contact| contact.time_s),
            front_vehicle: verdict.contact.map(|contact| contact.front_vehicle),
            rear_vehicle: verdict.contact.map(|contact| contact.rear_vehicle),
            impact_speed_mps: verdict.contact.map(|contact| contact.impact_speed_mps),
            original_impact_speed_mps: as_found.contact.map(|contact| contact.impact_speed_mps),
            max_delta_v_mps: one.max_delta_v_mps,
            harm: one.harm,
            vehicles_involved: one.vehicles_involved,
            ln_likelihood: self.config.space.ln_likelihood(&point),
            distance_from_nominal: self.config.distance_from_nominal(&point),
            likelihood_rank: 0,
            dt_fragile: one.dt_fragile,
            avoidability: one.analysis.avoidability.clone(),
            survives_multi_body: one.survives,
            escape_survives_multi_body: one.analysis.escape_survives,
            found_by: one.method.name().to_owned(),
            found_at: one.number,
            changed,
        })
    }

    /// Returns the parameters that are not nominal; a constant signal counts as one.
    fn changed_parameters(&self, values: &[f64]) -> Vec<ChangedParameter> {
        let names = self.config.space.coordinate_names();
        let mut changed = Vec::new();
        for parameter in self.config.space.parameters() {
            let own = values.get(parameter.coordinates()).unwrap_or_default();
            if own == parameter.nominal() {
                continue;
            }
            let mut say = |name: &str, value: f64| {
                let unit = parameter.unit().to_owned();
                changed.push(ChangedParameter {
                    parameter: name.to_owned(),
                    value: parameter.format_value(value),
                    unit,
                    outside_observed: self.config.space.extrapolated_range(name, value),
                });
            };
            match own {
                [first, rest @ ..] if rest.iter().all(|value| value == first) => {
                    say(parameter.name(), *first)
                }
                _ => {
                    let pieces = names.get(parameter.coordinates()).unwrap_or_default();
                    let differs = pieces.iter().zip(own.iter().zip(parameter.nominal()));
                    differs
                        .filter(|(_, (a, b))| a != b)
                        .for_each(|(name, (value, _))| say(name, *value));
                }
            }
        }
        changed
    }
}

fn rank_by_likelihood(found: &mut [Counterexample]) {
    let mut order: Vec<&mut Counterexample> = found.iter_mut().collect();
    let key = |one: &Counterexample| (-one.ln_likelihood, one.distance_from_nominal);
    order.sort_by(|a, b| {
        key(a)
            .partial_cmp(&key(b))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    for (rank, one) in (1..).zip(order) {
        one.likelihood_rank = rank;
    }
}

fn capitalise(words: &str) -> String {
    let mut letters = words.chars();
    letters
        .next()
        .into_iter()
        .flat_map(char::to_uppercase)
        .chain(letters)
        .collect()
}
