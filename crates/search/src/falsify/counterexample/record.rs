//! Conversion of examined failures to counterexamples and their files, without simulation.

use super::expected::{EXPECTED_VERSION, ExpectedFile, ExpectedVerdict};
use super::severity::Severity;
use super::{Avoidability, AvoidabilityAnalysis, ChangedParameter, Counterexample};
use crate::falsify::campaign::{CampaignError, FailureKind, ResolvedConfig};
use crate::falsify::{FailureCriterionRecord, Method};
use crumple_measure::{RunVerdict, Specification};
use crumple_sim::scenario::{Scenario, file};
use crumple_spaces::SpaceParameter;
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
    pub(super) reason: Option<String>,
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
        for failure in examined {
            if !distinct
                .iter()
                .any(|severer| self.is_same_failure(severer, &failure))
            {
                distinct.push(failure);
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
        let mut counterexamples = Vec::new();
        let mut files = Vec::new();
        for (number, failure) in (1..).zip(distinct) {
            counterexamples.push(self.record(number, failure, &mut files, &mut index)?);
        }
        rank_by_likelihood(&mut counterexamples);
        if !counterexamples.is_empty() {
            let text = toml::to_string(&index).map_err(CampaignError::from_encoding_error)?;
            files.insert(0, (in_folder(file::EXPECTED_FILE_NAME), text));
        }
        for (name, text) in files {
            results.write(&name, text);
        }
        Ok(counterexamples)
    }

    fn severity(&self, failure: &ExaminedFailure) -> Severity {
        let verdict = &failure.verdict;
        let goes_by_violation =
            self.config.specification != Specification::NoCollision || verdict.failure.is_some();
        Severity {
            violation: if goes_by_violation {
                -verdict.robustness
            } else {
                0.0
            },
            impact_speed_mps: verdict
                .collision
                .map_or(0.0, |collision| collision.impact_speed_mps),
            max_delta_v_mps: failure.max_delta_v_mps.unwrap_or(0.0),
            vehicles_involved: failure.vehicles_involved,
        }
    }

    fn is_same_failure(&self, first: &ExaminedFailure, second: &ExaminedFailure) -> bool {
        let ResolvedConfig { space, cube, .. } = self.config;
        let distance = cube.distance(&space.point(&first.values), &space.point(&second.values));
        first.kind == second.kind && distance <= SAME_FAILURE_DISTANCE * cube.blocks().len() as f64
    }

    /// Returns a counterexample and adds its files, without writing them.
    fn record(
        &self,
        number: usize,
        failure: &ExaminedFailure,
        files: &mut FileContents,
        index: &mut ExpectedFile,
    ) -> Result<Counterexample, CampaignError> {
        let changed = self.changed_parameters(&failure.values);
        let text = CounterexampleText::new(self.config, number, failure, &changed);
        files.extend(text.files(failure)?);
        index.expected.extend([
            expected_verdict(
                self.config,
                failure,
                (&text.file, &failure.verdict),
                &failure.analysis.avoidability,
            ),
            expected_verdict(
                self.config,
                failure,
                (&text.original_file, &failure.original_verdict),
                &Avoidability::NotAsked,
            ),
        ]);
        Ok(self.counterexample(failure, text, changed))
    }

    fn counterexample(
        &self,
        failure: &ExaminedFailure,
        text: CounterexampleText,
        changed: Vec<ChangedParameter>,
    ) -> Counterexample {
        let point = self.config.space.point(&failure.values);
        let collision = failure.verdict.collision;
        let original_collision = failure.original_verdict.collision;
        Counterexample {
            escape_file: failure.analysis.escape.as_ref().map(|_| text.escape_path()),
            file: in_folder(&text.file),
            original_file: in_folder(&text.original_file),
            kind: text.kind,
            reason: failure.reason.clone(),
            robustness: failure.verdict.robustness,
            collision_time_s: collision.map(|collision| collision.time_s),
            front_vehicle: collision.map(|collision| collision.front_vehicle),
            rear_vehicle: collision.map(|collision| collision.rear_vehicle),
            impact_speed_mps: collision.map(|collision| collision.impact_speed_mps),
            original_impact_speed_mps: original_collision
                .map(|collision| collision.impact_speed_mps),
            max_delta_v_mps: failure.max_delta_v_mps,
            harm: failure.harm,
            vehicles_involved: failure.vehicles_involved,
            ln_likelihood: self.config.space.ln_likelihood(&point),
            distance_from_nominal: self.config.distance_from_nominal(&point),
            likelihood_rank: 0,
            dt_fragile: failure.dt_fragile,
            avoidability: failure.analysis.avoidability.clone(),
            survives_multi_body: failure.survives,
            escape_survives_multi_body: failure.analysis.escape_survives,
            found_by: failure.method.name().to_owned(),
            found_at: failure.number,
            changed,
        }
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
            match own {
                [first, rest @ ..] if rest.iter().all(|value| value == first) => {
                    changed.push(self.changed_parameter(parameter, parameter.name(), *first));
                }
                _ => {
                    let pieces = names.get(parameter.coordinates()).unwrap_or_default();
                    let values = own.iter().zip(parameter.nominal());
                    for (name, (value, nominal)) in pieces.iter().zip(values) {
                        if value != nominal {
                            changed.push(self.changed_parameter(parameter, name, *value));
                        }
                    }
                }
            }
        }
        changed
    }

    fn changed_parameter(
        &self,
        parameter: &SpaceParameter,
        name: &str,
        value: f64,
    ) -> ChangedParameter {
        ChangedParameter {
            parameter: name.to_owned(),
            value: parameter.format_value(value),
            unit: parameter.unit().to_owned(),
            outside_observed: self.config.space.extrapolated_range(name, value),
        }
    }
}

/// Names and descriptions of the scenario files of a counterexample.
struct CounterexampleText {
    /// Kind of failure, as a clause.
    kind: String,
    /// Paths in the folder of counterexamples.
    file: String,
    original_file: String,
    /// Name of the scenario.
    name: String,
    /// Description of the scenario and of the original.
    about: String,
    about_original: String,
}

impl CounterexampleText {
    fn new(
        config: &ResolvedConfig,
        number: usize,
        failure: &ExaminedFailure,
        changed: &[ChangedParameter],
    ) -> Self {
        let slug = match failure.kind {
            FailureKind::Collision {
                front_vehicle,
                rear_vehicle,
                ..
            } => format!("{rear_vehicle}-hits-{front_vehicle}"),
            FailureKind::ControllerFailed { vehicle } => format!("controller-{vehicle}-fails"),
            FailureKind::Violation { .. } => "violation".to_owned(),
        };
        let kind = failure.kind.describe(&failure.scenario);
        let about_original = describe_finding(config, failure, &kind);
        Self {
            file: format!("{number:02}-{slug}.toml"),
            original_file: format!("originals/{number:02}-{slug}.toml"),
            name: format!(
                "{}-{}-{number:02}",
                config.space.name(),
                config.record.subject.seed
            ),
            about: about_original.clone() + &describe_result(failure, changed),
            about_original,
            kind,
        }
    }

    fn escape_path(&self) -> String {
        in_folder(&format!("escapes/{}", self.file))
    }

    /// Returns the scenario, the original and, if there is one, the escape.
    fn files(&self, failure: &ExaminedFailure) -> Result<FileContents, CampaignError> {
        let mut files = vec![
            named_file(
                in_folder(&self.file),
                &failure.scenario,
                self.name.clone(),
                self.about.clone(),
            )?,
            named_file(
                in_folder(&self.original_file),
                &failure.original,
                format!("{}-original", self.name),
                self.about_original.clone(),
            )?,
        ];
        if let Some(escape) = &failure.analysis.escape {
            let about = format!(
                "An escape from {}: a driver who knows the future avoids the collision like this.",
                self.file
            );
            let name = format!("{}-escape", self.name);
            files.push(named_file(self.escape_path(), escape, name, about)?);
        }
        Ok(files)
    }
}

fn in_folder(file: &str) -> String {
    format!("counterexamples/{file}")
}

fn named_file(
    path: String,
    scenario: &Scenario,
    name: String,
    about: String,
) -> Result<(String, String), CampaignError> {
    let named = scenario.edited(|spec| (spec.name, spec.about) = (name, about))?;
    let text = file::to_toml(&named).map_err(CampaignError::from_encoding_error)?;
    Ok((path, text))
}

/// Describes where and with which controller a failure was found.
fn describe_finding(config: &ResolvedConfig, failure: &ExaminedFailure, kind: &str) -> String {
    let record = &config.record;
    let controller = match &record.subject.policy_sha256 {
        Some(hash) => format!("`{}` (SHA-256 {hash})", record.subject.controller),
        None => format!("`{}`", record.subject.controller),
    };
    let formula = match &config.specification {
        Specification::NoCollision => String::new(),
        Specification::Formula(formula) => format!(" The formula is `{formula}`."),
        Specification::DrivingRule(rule) => format!(" The rule is `{rule}`."),
    };
    let criterion = match &record.failure_criterion {
        None => String::new(),
        Some(FailureCriterionRecord::Differential { controller, .. }) => {
            format!(", and `{controller}` passes it")
        }
    };
    let reason = failure.reason.as_ref();
    let reason = reason.map_or(String::new(), |reason| format!(" {reason}"));
    format!(
        "Found in the space `{}` by {} at its evaluation {} (seed {}): with {controller} {kind}{reason}{criterion}.\
        {formula}",
        config.space.name(),
        failure.method,
        failure.number,
        record.subject.seed
    )
}

/// Describes what became of a failure since it was found.
fn describe_result(failure: &ExaminedFailure, changed: &[ChangedParameter]) -> String {
    let shrinking = if failure.dt_fragile {
        " It disappears at a tenth of the step: kept as it was found."
    } else {
        " Shrunk."
    };
    let class = failure.analysis.avoidability.describe();
    let class = class.map_or(String::new(), |words| format!(" {}.", capitalise(&words)));
    let outside: Vec<_> = changed
        .iter()
        .filter(|parameter| parameter.outside_observed.is_some())
        .map(ToString::to_string)
        .collect();
    let outside = if outside.is_empty() {
        String::new()
    } else {
        format!(" Values beyond the recordings: {}.", outside.join(", "))
    };
    format!("{shrinking}{class}{outside}")
}

/// Returns the entry of a scenario file in the index.
fn expected_verdict(
    config: &ResolvedConfig,
    failure: &ExaminedFailure,
    (file, verdict): (&str, &RunVerdict),
    class: &Avoidability,
) -> ExpectedVerdict {
    let record = &config.record;
    ExpectedVerdict {
        scenario: file.to_owned(),
        controller: record.subject.controller.clone(),
        policy_sha256: record.subject.policy_sha256.clone(),
        controller_sha256: record.subject.controller_sha256.clone(),
        estimator: record.subject.estimator,
        specification: config.specification.to_string(),
        violated: verdict.robustness < 0.0,
        robustness: verdict.robustness,
        collision_time_s: verdict.collision.map(|collision| collision.time_s),
        front_vehicle: verdict.collision.map(|collision| collision.front_vehicle),
        rear_vehicle: verdict.collision.map(|collision| collision.rear_vehicle),
        dt_fragile: failure.dt_fragile,
        avoidable: class.class(),
        best_min_gap_m: class.best_min_gap_m(),
        undecided_because: class.undecided_because().map(str::to_owned),
        failure_criterion: record.failure_criterion.clone(),
    }
}

fn rank_by_likelihood(counterexamples: &mut [Counterexample]) {
    let mut order: Vec<&mut Counterexample> = counterexamples.iter_mut().collect();
    order.sort_by(|a, b| {
        unlikelihood_key(a)
            .partial_cmp(&unlikelihood_key(b))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    for (rank, counterexample) in (1..).zip(order) {
        counterexample.likelihood_rank = rank;
    }
}

fn unlikelihood_key(counterexample: &Counterexample) -> (f64, f64) {
    (
        -counterexample.ln_likelihood,
        counterexample.distance_from_nominal,
    )
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
