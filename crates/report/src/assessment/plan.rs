//! A valid configuration with everything that it names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crumple_controllers::Controllers;
use crumple_sim::scenario::OpenDriver;
use crumple_verify::Certificate;
use serde_json::{Value, json};

use super::claims::{ContentId, Subject};
use super::config::{AssessConfig, AssessConfigError, CONFIG_VERSION, EVERYDAY_SPACES};
use super::gate::AssessmentGate;
use super::parts;
use super::planned_suite::PlannedSuite;
use crumple_controllers::{find_and_try, find_for_user};
use crumple_core::digest::sha256;
use crumple_core::format_version::check_version;
use crumple_core::text_file::OldNames;
use crumple_core::{regular_file, text_file};
use crumple_exchange::recording::{DroppedItem, ImportOptions, ImportedScenario, import};
use crumple_sim::control::{BuiltInController, ControllerSource};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{Scenario, built_in_scenario_names, file};
use crumple_spaces::{ScenarioSpace, built_in_space, file as space_file};

const MAX_DRAWS: u64 = 10_000_000;

const MAX_EVALUATIONS: u64 = 1_000_000_000;

/// A valid configuration with everything that it names.
#[derive(Debug, Clone)]
pub struct AssessmentPlan {
    pub(super) config: AssessConfig,
    pub(super) controllers: Vec<NamedController>,
    /// Index of the controller that the safety case is about.
    pub(super) subject_index: usize,
    /// Scenarios from files, in order of their paths relative to the configuration.
    pub(super) file_scenarios: Vec<(PathBuf, Scenario)>,
    pub(super) left_out: Vec<DroppedItem>,
    pub(super) suites: Vec<PlannedSuite>,
    /// Scenario spaces whose failure rates are measured.
    pub(super) rate_spaces: Vec<NamedSpace>,
    /// Scenario spaces that are searched for failures.
    pub(super) search_spaces: Vec<NamedSpace>,
    pub(super) certificates: Vec<GivenCertificate>,
}

#[derive(Debug, Clone)]
pub(super) struct NamedSpace {
    /// Name in the configuration.
    pub(super) name: String,
    pub(super) space: ScenarioSpace,
    /// Text of the space file, and its hash under the space's own name.
    pub(super) text: String,
    pub(super) content_id: ContentId,
}

impl NamedSpace {
    fn new(name: &str, space: ScenarioSpace) -> Result<Self, toml::ser::Error> {
        let text = space_file::to_toml(&space)?;
        Ok(Self {
            name: name.to_owned(),
            content_id: ContentId::new(space.name(), &text),
            space,
            text,
        })
    }

    /// True if two successive vehicles of the space's scenarios are both not under test.
    pub(super) fn can_others_collide(&self) -> bool {
        // A space whose nominal scenario is invalid has no runs.
        self.space
            .scenario(&self.space.nominal())
            .is_ok_and(|scenario| {
                let is_other = |index: usize| !scenario.is_under_test(index);
                (1..scenario.vehicles().len()).any(|rear| is_other(rear) && is_other(rear - 1))
            })
    }
}

#[derive(Debug, Clone)]
pub(super) struct GivenCertificate {
    /// File name without extension.
    pub(super) name: String,
    pub(super) certificate: Certificate,
    /// Policy that the certificate is about, if found.
    pub(super) policy: Option<Vec<u8>>,
}

/// Certificates about the reference policy; `corpora/certificates/README.md` has their provenance.
const SHIPPED_CERTIFICATES: [(&str, &str); 2] = [
    ("reach-paper-1", include_str!("built_in/reach-paper-1.json")),
    ("reach-paper-2", include_str!("built_in/reach-paper-2.json")),
];

/// Names of configurations of assessments before 0.4.
const OLD_NAMES: OldNames = OldNames {
    fields: &[],
    values: &[
        (
            "no-contact-in-paper-scenarios",
            "no-collision-in-paper-scenarios",
        ),
        ("needless-braking-at-most", "unnecessary-braking-at-most"),
    ],
};

impl AssessmentPlan {
    /// Returns the plan of the built-in assessment.
    ///
    /// # Errors
    /// None in practice: the built-in configuration is valid.
    pub fn built_in() -> Result<Self, AssessConfigError> {
        Self::new(AssessConfig::default(), [], Path::new(""))
    }

    /// Creates a plan with additional controllers. The safety case is about the first of them, unless the configuration
    /// says otherwise. File names are relative to `folder`.
    ///
    /// # Errors
    /// [`AssessConfigError`] for an invalid configuration, and for a name that is taken.
    pub fn new(
        mut config: AssessConfig,
        own: impl IntoIterator<Item = NamedController>,
        folder: &Path,
    ) -> Result<Self, AssessConfigError> {
        let loading = PlanLoader {
            path: Path::new("configuration"),
            text: "",
            folder,
        };
        let mut controllers = loading.load_controllers(&config)?;
        let first_own = controllers.len();
        for controller in own {
            loading.add_controller(&mut controllers, "controllers", controller)?;
        }
        config.controllers = controllers
            .iter()
            .map(|controller| controller.name.clone())
            .collect();
        config.subject = config
            .subject
            .or_else(|| Some(controllers.get(first_own)?.name.clone()));
        loading.build_plan(config, controllers)
    }

    /// Reads a configuration file and everything that it names. `controllers` opens the controllers that the named
    /// files name.
    ///
    /// # Errors
    /// [`AssessConfigError`] for a file that cannot be read or parsed, or is invalid.
    pub fn load(path: &Path, controllers: Controllers) -> Result<Self, AssessConfigError> {
        let text = text_file::read(path)?;
        OLD_NAMES.warn(&text, path);
        let mut config: AssessConfig = text_file::parse_toml(&text, path)?;
        config.controllers_of_files = controllers;
        let loading = PlanLoader {
            path,
            text: &text,
            folder: path.parent().unwrap_or(Path::new("")),
        };
        let controllers = loading.load_controllers(&config)?;
        loading.build_plan(config, controllers)
    }

    /// Returns each scenario space of the assessment once.
    pub(super) fn all_spaces(&self) -> Vec<ScenarioSpace> {
        let everyday = EVERYDAY_SPACES
            .iter()
            .filter(|_| self.config.everyday_draws > 0);
        let own = self
            .rate_spaces
            .iter()
            .chain(&self.search_spaces)
            .map(|named| named.space.clone());
        let mut all: Vec<_> = own
            .chain(everyday.filter_map(|name| built_in_space(name)))
            .collect();
        let mut names = BTreeSet::new();
        all.retain(|space| names.insert(space.name().to_owned()));
        all
    }

    /// True if a gate needs an earlier assessment to compare with.
    #[must_use]
    pub fn needs_earlier_assessment(&self) -> bool {
        self.config
            .gates
            .iter()
            .any(|gate| matches!(gate, AssessmentGate::NothingWorse {}))
    }

    /// Returns the subject of claims about a controller. A controller without identity equals no other one.
    pub(super) fn claim_subject(&self, index: usize, estimator: EstimatorKind) -> Option<Subject> {
        let controller = self.controllers.get(index)?;
        let unknown = || {
            sha256(format!(
                "controller {index} of one report, {}",
                controller.name
            ))
        };
        let sha256 = controller.source.identity().unwrap_or_else(unknown);
        Some(Subject {
            controller: ContentId {
                name: controller.name.clone(),
                sha256,
            },
            estimator,
        })
    }

    pub(super) fn claim_subjects(&self) -> Vec<Subject> {
        (0..self.controllers.len())
            .filter_map(|index| self.claim_subject(index, self.config.estimator))
            .collect()
    }

    pub(super) fn subject(&self) -> Option<&NamedController> {
        self.controllers.get(self.subject_index)
    }

    pub(super) fn subject_name(&self) -> &str {
        self.subject().map_or("", |subject| subject.name.as_str())
    }

    pub(super) fn controller_names(&self) -> Vec<String> {
        let names = self.controllers.iter();
        names.map(|controller| controller.name.clone()).collect()
    }

    pub(super) fn identities(&self) -> Value {
        self.controllers
            .iter()
            .map(|controller| self.identity(controller))
            .collect()
    }

    /// Returns the controllers under test.
    #[must_use]
    pub fn controllers(&self) -> &[NamedController] {
        &self.controllers
    }

    /// Returns the first controller without identity. Its evidence cannot be attributed, so the assessment caches none.
    #[must_use]
    pub fn first_without_identity(&self) -> Option<&NamedController> {
        self.controllers
            .iter()
            .find(|controller| controller.source.identity().is_none())
    }

    /// Returns the inputs of evidence about one controller: name, policy and estimator.
    pub(super) fn identity(&self, controller: &NamedController) -> Value {
        let policy = controller.policy().map(|policy| policy.digest());
        let mut identity = vec![
            json!(controller.name),
            json!(policy),
            json!(self.config.estimator.name()),
        ];
        identity.extend(controller.disambiguating_hash().map(Value::from));
        identity.into()
    }

    /// Returns the controller's name as part of a path, unique in the plan.
    pub(super) fn controller_slug(&self, index: usize) -> String {
        let of = |index: usize| {
            self.controllers
                .get(index)
                .map(|controller| slug(&controller.name))
        };
        let own = of(index).unwrap_or_default();
        let is_taken = (0..index).any(|other| of(other).as_deref() == Some(own.as_str()));
        if is_taken {
            format!("{own}-{index}")
        } else {
            own
        }
    }
}

/// Replaces every character of a name that is not ASCII alphanumeric by a hyphen.
pub(super) fn slug(name: &str) -> String {
    name.chars()
        .map(|letter| {
            if letter.is_ascii_alphanumeric() {
                letter
            } else {
                '-'
            }
        })
        .collect()
}

/// Returns a name as a file name; different names have different file names.
pub(super) fn file_stem(name: &str) -> String {
    let slug = slug(name);
    if slug == name {
        slug
    } else {
        format!("{slug}-{}", sha256(name).get(..8).unwrap_or_default())
    }
}

fn default_subject(controllers: &[NamedController]) -> usize {
    let is_bare = |controller: &NamedController| {
        controller.source.is_learned() && controller.source.as_shield().is_none()
    };
    let road = controllers
        .iter()
        .position(|controller| controller.name == "road");
    road.or_else(|| controllers.iter().position(is_bare))
        .unwrap_or(controllers.len().saturating_sub(1))
}

fn shipped_certificates(controllers: &[NamedController]) -> Vec<GivenCertificate> {
    let reference = BuiltInController::Policy(Default::default()).identity();
    if !controllers
        .iter()
        .any(|controller| controller.source.identity().as_deref() == reference.as_deref())
    {
        return Vec::new();
    }
    let given = |(name, text): &(&str, &str)| {
        let policy = Some(Policy::reference_bytes().to_vec());
        Some(GivenCertificate {
            name: (*name).to_owned(),
            certificate: Certificate::from_json(text).ok()?,
            policy,
        })
    };
    SHIPPED_CERTIFICATES.iter().filter_map(given).collect()
}

pub(super) fn not_among_controllers(name: &str) -> String {
    format!("`{name}` is not among `controllers`")
}

struct PlanLoader<'a> {
    path: &'a Path,
    text: &'a str,
    folder: &'a Path,
}

impl PlanLoader<'_> {
    fn field_error(&self, field: &str, problem: String) -> AssessConfigError {
        AssessConfigError::Field {
            path: self.path.to_owned(),
            line: text_file::line_in_toml(self.text, field),
            field: field.to_owned(),
            problem,
        }
    }

    fn ensure(
        &self,
        holds: bool,
        field: &str,
        problem: impl FnOnce() -> String,
    ) -> Result<(), AssessConfigError> {
        if holds {
            Ok(())
        } else {
            Err(self.field_error(field, problem()))
        }
    }

    fn build_plan(
        &self,
        mut config: AssessConfig,
        controllers: Vec<NamedController>,
    ) -> Result<AssessmentPlan, AssessConfigError> {
        self.check_numbers(&config)?;
        // Controllers have one name, however the configuration spells it.
        let place_of = |name: &mut String| {
            if let Ok(found) = find_for_user(name, self.folder) {
                *name = found.name;
            }
            controllers
                .iter()
                .position(|controller| controller.name == *name)
        };
        let subject_index = match &mut config.subject {
            None => default_subject(&controllers),
            Some(name) => place_of(name)
                .ok_or_else(|| self.field_error("subject", not_among_controllers(name)))?,
        };
        let suites = PlannedSuite::from_config(&mut config, self.folder, &controllers, place_of)
            .map_err(|(field, problem)| self.field_error(&field, problem))?;
        for (index, gate) in config.gates.iter_mut().enumerate() {
            for (field, name) in gate.controllers_mut() {
                place_of(name).ok_or_else(|| {
                    self.field_error(
                        &format!("gates[{index}].{field}"),
                        not_among_controllers(name),
                    )
                })?;
            }
        }
        for (index, gate) in config.gates.iter().enumerate() {
            if let Some((field, problem)) = gate.config_problem(&config) {
                return Err(self.field_error(&format!("gates[{index}].{field}"), problem));
            }
        }
        let (recorded, left_out) = self.import_recordings(&config)?;
        let file_scenarios = self.load_scenarios(&config, recorded)?;
        let search_spaces = self.load_spaces(
            "search.spaces",
            &config.search_spaces(),
            &config.controllers_of_files,
        )?;
        let rate_spaces = self.load_spaces(
            "distributions",
            &config.rate_spaces(),
            &config.controllers_of_files,
        )?;
        let clash = rate_spaces.iter().find(|one| {
            search_spaces.iter().any(|other| {
                one.space.name() == other.space.name() && one.content_id != other.content_id
            })
        });
        if let Some(one) = clash.map(|one| one.space.name()) {
            let problem = format!(
                "the name `{one}` belongs to another space in `search.spaces`; rename one of them"
            );
            return Err(self.field_error("distributions", problem));
        }
        let given = config.certificates.clone();
        let mut plan = AssessmentPlan {
            config,
            controllers,
            subject_index,
            file_scenarios,
            left_out,
            suites,
            rate_spaces,
            search_spaces,
            certificates: Vec::new(),
        };
        plan.certificates = match given {
            None if plan.config.paper => shipped_certificates(&plan.controllers),
            None => Vec::new(),
            Some(paths) => {
                self.load_certificates(&paths, &parts::generated_certificate_names(&plan))?
            }
        };
        Ok(plan)
    }

    fn add_controller(
        &self,
        controllers: &mut Vec<NamedController>,
        field: &str,
        controller: NamedController,
    ) -> Result<(), AssessConfigError> {
        let is_new = controllers
            .iter()
            .all(|known| known.name != controller.name);
        self.ensure(is_new, field, || {
            format!("`{}` appears twice; remove one", controller.name)
        })?;
        controllers.push(controller);
        Ok(())
    }

    fn check_numbers(&self, config: &AssessConfig) -> Result<(), AssessConfigError> {
        let version = check_version(config.version, CONFIG_VERSION);
        self.ensure(version.is_ok(), "version", || {
            version.map_or_else(|unsupported| unsupported.to_string(), |()| String::new())
        })?;
        for (field, draws) in [
            ("draws", config.draws),
            ("everyday_draws", config.everyday_draws),
        ] {
            self.ensure(draws <= MAX_DRAWS, field, || {
                format!("must be at most {MAX_DRAWS}, found {draws}")
            })?;
        }
        let (budget, runs) = (config.search.budget, config.rates.runs);
        self.ensure(
            (1..=MAX_EVALUATIONS).contains(&budget),
            "search.budget",
            || format!("must be from 1 to {MAX_EVALUATIONS}, found {budget}"),
        )?;
        self.ensure(runs <= MAX_DRAWS, "rates.runs", || {
            format!("must be at most {MAX_DRAWS}, found {runs}")
        })?;
        if let Some(harm) = &config.harm {
            let rate = harm.emergencies_per_hour;
            self.ensure(
                (0.0..=3600.0).contains(&rate),
                "harm.emergencies_per_hour",
                || format!("must be from 0 to 3600, found {rate}"),
            )?;
        }
        let confidence = config.rates.confidence;
        self.ensure(
            confidence > 0.5 && confidence < 1.0,
            "rates.confidence",
            || format!("must be between 0.5 and 1, found {confidence}"),
        )
    }

    fn load_controllers(
        &self,
        config: &AssessConfig,
    ) -> Result<Vec<NamedController>, AssessConfigError> {
        self.ensure(!config.controllers.is_empty(), "controllers", || {
            "must name at least one controller".to_owned()
        })?;
        let mut controllers = Vec::new();
        for (index, name) in config.controllers.iter().enumerate() {
            let field = format!("controllers[{index}]");
            let controller = find_and_try(name, self.folder)
                .map_err(|error| self.field_error(&field, error.to_string()))?;
            self.add_controller(&mut controllers, &field, controller)?;
        }
        Ok(controllers)
    }

    /// Returns the scenarios of the recordings and the dropped parts.
    fn import_recordings(
        &self,
        config: &AssessConfig,
    ) -> Result<(Vec<ImportedScenario>, Vec<DroppedItem>), AssessConfigError> {
        let wrong = |problem: String| self.field_error("recordings", problem);
        let paths: Vec<_> = config
            .recordings
            .iter()
            .map(|named| self.folder.join(named))
            .collect();
        let mut scenarios = Vec::new();
        let mut take = |scenario| {
            scenarios.push(scenario);
            true
        };
        let imported = import(&paths, None, &ImportOptions::default(), None, &mut take)
            .map_err(|error| wrong(error.to_string()))?;
        match imported.sources.iter().find(|source| source.scenarios == 0) {
            Some(empty) => Err(wrong(format!(
                "{}: the recording has no braking episode that fits a scenario",
                empty.path.display()
            ))),
            None => Ok((scenarios, imported.dropped)),
        }
    }

    fn load_scenarios(
        &self,
        config: &AssessConfig,
        recorded: Vec<ImportedScenario>,
    ) -> Result<Vec<(PathBuf, Scenario)>, AssessConfigError> {
        let mut traffic = Vec::new();
        for (index, named) in config.scenarios.iter().enumerate() {
            let field = format!("scenarios[{index}]");
            let at = self.folder.join(named);
            self.ensure(at.exists(), &field, || {
                format!("{} does not exist", at.display())
            })?;
            let found = file::load_all(&at, &config.controllers_of_files)?;
            self.ensure(!found.is_empty(), &field, || {
                format!("the folder {} has no scenario file", named.display())
            })?;
            let untested = found
                .iter()
                .find(|(_, scenario)| !scenario.has_vehicle_under_test());
            if let Some((path, _)) = untested {
                return Err(self.field_error(
                    &field,
                    format!("{}: no vehicle is under test", path.display()),
                ));
            }
            traffic.extend(found);
        }
        traffic.extend(
            recorded
                .into_iter()
                .map(|found| (PathBuf::from(found.file_name), found.scenario)),
        );
        let mut names: Vec<_> = built_in_scenario_names()
            .iter()
            .map(|(name, _)| (*name).to_owned())
            .collect();
        for (found_at, scenario) in &traffic {
            let name = &scenario.spec().name;
            self.ensure(!names.contains(name), "scenarios", || {
                format!(
                    "{}: another scenario has the name `{name}`; rename one of them",
                    found_at.display()
                )
            })?;
            names.push(name.clone());
        }
        Ok(traffic)
    }

    fn load_spaces(
        &self,
        list: &str,
        names: &[String],
        opener: &dyn OpenDriver,
    ) -> Result<Vec<NamedSpace>, AssessConfigError> {
        let mut spaces: Vec<NamedSpace> = Vec::new();
        for (index, name) in names.iter().enumerate() {
            let field = format!("{list}[{index}]");
            let wrong = |problem: String| self.field_error(&field, problem);
            let space = match built_in_space(name) {
                Some(space) => space,
                None if name.ends_with(".toml") => {
                    space_file::load(&self.folder.join(name), opener)
                        .map_err(|error| wrong(error.to_string()))?
                }
                None => {
                    return Err(wrong(format!(
                        "`{name}` is neither a built-in space nor a .toml file"
                    )));
                }
            };
            let nominal = space.scenario(&space.nominal());
            let nominal = nominal.map_err(|error| {
                wrong(format!("{name}: the nominal scenario is invalid: {error}"))
            })?;
            let is_tested = nominal.has_vehicle_under_test();
            self.ensure(is_tested, &field, || {
                format!("{name}: no vehicle is under test")
            })?;
            let is_new = spaces
                .iter()
                .all(|known| known.space.name() != space.name());
            self.ensure(is_new, &field, || {
                format!(
                    "another space has the name `{}`; rename one of them",
                    space.name()
                )
            })?;
            let named = NamedSpace::new(name, space).map_err(|error| wrong(error.to_string()))?;
            let own = named.space.name();
            let built_in = built_in_space(own).and_then(|known| space_file::to_toml(&known).ok());
            self.ensure(
                built_in.is_none_or(|built_in| built_in == named.text),
                &field,
                || {
                    format!(
                        "a built-in space with other contents has the name `{own}`; rename this one"
                    )
                },
            )?;
            spaces.push(named);
        }
        Ok(spaces)
    }

    fn load_certificates(
        &self,
        paths: &[PathBuf],
        made_here: &[String],
    ) -> Result<Vec<GivenCertificate>, AssessConfigError> {
        let mut given: Vec<GivenCertificate> = Vec::new();
        for (index, path) in paths.iter().enumerate() {
            let field = format!("certificates[{index}]");
            let at = self.folder.join(path);
            let wrong =
                |error: String| self.field_error(&field, format!("{}: {error}", at.display()));
            let file = regular_file::open(&at).map_err(|error| wrong(error.to_string()))?;
            let certificate =
                Certificate::from_reader(file).map_err(|error| wrong(error.to_string()))?;
            let name = at
                .file_stem()
                .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
            self.ensure(!made_here.contains(&name), &field, || {
                format!(
                    "this assessment writes a certificate with the name `{name}`; rename the file"
                )
            })?;
            self.ensure(given.iter().all(|known| known.name != name), &field, || {
                format!("another certificate has the name `{name}`; rename the file")
            })?;
            let policy = certificate
                .read_policy(&at, None)
                .or_else(|| Some(Policy::reference_bytes().to_vec()));
            given.push(GivenCertificate {
                name,
                certificate,
                policy,
            });
        }
        Ok(given)
    }
}
