//! A valid configuration with everything that it names.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crumple_controllers::Controllers;
use crumple_sim::scenario::OpenDriver;
use crumple_verify::Certificate;
use serde_json::{Value, json};

use super::AssessmentGate;
use super::claims::{ContentId, Subject};
use super::config::{
    AssessConfig, AssessConfigError, CONFIG_VERSION, EVERYDAY_SPACES, FOLLOWER_SPACES,
};
use super::followers::{follower_drivers, follower_kinds};
use super::gate_rules::{GateName, NameRole};
use super::parts;
use super::planned_suite::PlannedSuite;
use crumple_controllers::{find_and_try, find_built_in, find_for_user};
use crumple_core::digest::sha256;
use crumple_core::field_error::FieldError;
use crumple_core::format_version::check_version;
use crumple_core::markdown::prose_name;
use crumple_core::{old_names, regular_file, text_file};
use crumple_evidence::drives::{DriveSet, DriveSetError};
use crumple_exchange::recording::{DroppedItem, ImportOptions, ImportedScenario, import};
use crumple_sim::control::{BuiltInController, ControllerSource};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{Scenario, built_in_scenario_names, file};
use crumple_spaces::{ScenarioSpace, built_in_space, file as space_file};

const MAX_DRAWS: u64 = 10_000_000;

const MAX_EVALUATIONS: u64 = 1_000_000_000;

/// Number of random scenarios whose followers represent those of a space.
const FOLLOWER_DRAWS: u64 = 100;

/// A valid configuration with everything that it names.
#[derive(Debug, Clone)]
pub struct AssessmentPlan {
    pub(super) config: AssessConfig,
    pub(super) controllers: Vec<NamedController>,
    /// Index of the controller that the safety case is about.
    pub(super) subject_index: usize,
    /// Scenarios from files, in order of their paths relative to the configuration.
    pub(super) file_scenarios: Vec<(PathBuf, Scenario)>,
    pub(super) dropped: Vec<DroppedItem>,
    pub(super) suites: Vec<PlannedSuite>,
    /// Recorded drives.
    pub(super) drives: Option<NamedDrives>,
    /// Scenario spaces whose failure rates are measured.
    pub(super) rate_spaces: Vec<NamedSpace>,
    /// Scenario spaces that are searched for failures.
    pub(super) search_spaces: Vec<NamedSpace>,
    pub(super) certificates: Vec<GivenCertificate>,
}

/// A folder of recorded drives.
#[derive(Debug, Clone)]
pub(super) struct NamedDrives {
    pub(super) drives: DriveSet,
    pub(super) content_id: ContentId,
}

impl NamedDrives {
    fn load(folder: &Path, opener: &dyn OpenDriver) -> Result<Self, DriveSetError> {
        let drives = DriveSet::load(folder, opener)?;
        let name = folder.file_name().unwrap_or(folder.as_os_str());
        Ok(Self {
            content_id: ContentId::with_sha256(
                name.to_string_lossy(),
                drives.identity().to_owned(),
            ),
            drives,
        })
    }
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
        let text = space_file::to_identity_toml(&space)?;
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
                (1..scenario.vehicles().len())
                    .any(|rear| !scenario.is_under_test(rear) && !scenario.is_under_test(rear - 1))
            })
    }
}

#[derive(Debug, Clone)]
pub(super) struct GivenCertificate {
    /// File name without extension, of plain characters.
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
        let mut loading = PlanLoader {
            path: Path::new("configuration"),
            text: "",
            folder,
            names: BTreeMap::new(),
        };
        let mut controllers = loading.load_controllers(&mut config)?;
        let first_own = controllers.len();
        for controller in own {
            name_without_backticks(&mut config.names, &controller.name);
            let entry = controller.name.clone();
            let controller = loading.give_name(&config, &entry, controller)?;
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
        let mut config: AssessConfig = text_file::parse_toml(&text, path)?;
        old_names::ASSESSMENT.warn(&text, path);
        config.controllers_of_files = controllers;
        let mut loading = PlanLoader {
            path,
            text: &text,
            folder: path.parent().unwrap_or(Path::new("")),
            names: BTreeMap::new(),
        };
        let controllers = loading.load_controllers(&mut config)?;
        loading.build_plan(config, controllers)
    }

    /// Adds the recorded drives of a folder, in place of those of the configuration.
    ///
    /// # Errors
    /// [`AssessConfigError`] for a folder without drives, and for a file that is no drive of one vehicle.
    pub fn with_drives(
        mut self,
        folder: &Path,
        controllers: Controllers,
    ) -> Result<Self, AssessConfigError> {
        self.drives = Some(NamedDrives::load(folder, &controllers)?);
        self.config.drives = Some(folder.to_owned());
        Ok(self)
    }

    /// Returns each scenario space of the assessment once.
    pub(super) fn all_spaces(&self) -> Vec<ScenarioSpace> {
        let everyday = EVERYDAY_SPACES
            .iter()
            .chain(&FOLLOWER_SPACES)
            .filter(|_| self.config.everyday_draws > 0);
        let own = self
            .rate_spaces
            .iter()
            .chain(&self.search_spaces)
            .map(|named| named.space.clone());
        let mut spaces: Vec<_> = own
            .chain(everyday.filter_map(|name| built_in_space(name)))
            .collect();
        let mut names = BTreeSet::new();
        spaces.retain(|space| names.insert(space.name().to_owned()));
        spaces
    }

    /// Returns the space of the assessment with the name of an identifier.
    pub(super) fn find_space(&self, id: &ContentId) -> Option<ScenarioSpace> {
        let mut spaces = self.all_spaces().into_iter();
        spaces.find(|space| prose_name(space.name()) == id.name)
    }

    /// Returns the kinds of follower of a space of this assessment, or the drivers of the vehicles directly behind a
    /// vehicle under test in its random scenarios; `None` for another space, and if a scenario cannot be drawn.
    pub(super) fn followers_in(&self, space: &ContentId) -> Option<Vec<String>> {
        let space = self.find_space(space)?;
        let kinds = follower_kinds(&space);
        if !kinds.is_empty() {
            return Some(kinds);
        }
        let scenarios: Vec<Scenario> = (0..FOLLOWER_DRAWS)
            .filter_map(|index| space.draw(self.config.seed, index).ok())
            .collect();
        (!scenarios.is_empty()).then(|| follower_drivers(&scenarios).into_iter().collect())
    }

    /// True if a gate needs an earlier assessment to compare with.
    #[must_use]
    pub fn needs_earlier_assessment(&self) -> bool {
        self.config
            .gates
            .iter()
            .any(|config| matches!(config.gate, AssessmentGate::NothingWorse {}))
    }

    /// Returns the subject of claims about a controller. A controller without identity equals no other one.
    pub(super) fn claim_subject(&self, index: usize, estimator: EstimatorKind) -> Option<Subject> {
        let controller = self.controllers.get(index)?;
        let sha256 = controller.source.identity().unwrap_or_else(|| {
            sha256(format!(
                "controller {index} of one report, {}",
                controller.name
            ))
        });
        Some(Subject {
            controller: ContentId::with_sha256(&controller.name, sha256),
            estimator,
        })
    }

    pub(super) fn claim_subjects(&self) -> Vec<Subject> {
        (0..self.controllers.len())
            .filter_map(|index| self.claim_subject(index, self.config.estimator))
            .collect()
    }

    /// Returns the entry of a controller in `controllers`, which the configuration may have given another name.
    pub(super) fn controller_entry<'a>(&'a self, controller: &'a NamedController) -> &'a str {
        let mut names = self.config.names.iter();
        let named = names.find(|(_, name)| **name == controller.name);
        named.map_or(&controller.name, |(entry, _)| entry)
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
        let Some(own) = self.controllers.get(index).map(|own| slug(&own.name)) else {
            return String::new();
        };
        let mut before = self.controllers.iter().take(index);
        let is_taken = before.any(|controller| slug(&controller.name) == own);
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

/// Returns the name of a certificate: that of its file, or a plain one if this has characters other than ASCII letters,
/// digits, `-`, `_` and `.`.
fn certificate_name(path: &Path) -> String {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    if name.chars().all(is_plain) {
        name.into_owned()
    } else {
        file_stem(&name)
    }
}

/// Names a controller without the backticks of its entry.
fn name_without_backticks(names: &mut BTreeMap<String, String>, entry: &str) {
    let name = names.get(entry).map_or(entry, String::as_str);
    if name.contains('`') {
        names.insert(entry.to_owned(), prose_name(name));
    }
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
    let road = controllers
        .iter()
        .position(|controller| controller.name == "road");
    let unshielded_policy = controllers.iter().position(|controller| {
        controller.source.is_learned() && controller.source.as_shield().is_none()
    });
    road.or(unshielded_policy)
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
    SHIPPED_CERTIFICATES
        .iter()
        .filter_map(|(name, text)| {
            Some(GivenCertificate {
                name: (*name).to_owned(),
                certificate: Certificate::from_json(text).ok()?,
                policy: Some(Policy::reference_bytes().to_vec()),
            })
        })
        .collect()
}

pub(super) fn not_among_controllers(name: &str) -> String {
    format!("`{name}` is not among `controllers`")
}

/// Scenarios of the recordings, and the parts that are left out.
struct ImportedRecordings {
    scenarios: Vec<ImportedScenario>,
    dropped: Vec<DroppedItem>,
}

struct PlanLoader<'a> {
    path: &'a Path,
    text: &'a str,
    folder: &'a Path,
    /// Names that the configuration gives to controllers, by their own names.
    names: BTreeMap<String, String>,
}

impl PlanLoader<'_> {
    fn field_error(&self, field: &str, problem: String) -> AssessConfigError {
        self.locate(FieldError::new(field, problem))
    }

    fn locate(&self, invalid: FieldError) -> AssessConfigError {
        AssessConfigError::Field {
            path: self.path.to_owned(),
            line: text_file::line_in_toml(self.text, &invalid.field),
            invalid,
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
        let subject_index = match &mut config.subject {
            None => default_subject(&controllers),
            Some(name) => self
                .find_controller(&controllers, name)
                .ok_or_else(|| self.field_error("subject", not_among_controllers(name)))?,
        };
        let folder = self.folder;
        let suites = PlannedSuite::from_config(&mut config, folder, &controllers, |name| {
            self.find_controller(&controllers, name)
        })
        .map_err(|invalid| self.locate(invalid))?;
        self.check_gates(&mut config, &controllers)?;
        let recordings = self.import_recordings(&config)?;
        let file_scenarios = self.load_scenarios(&config, recordings.scenarios)?;
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
        self.check_space_names(&rate_spaces, &search_spaces)?;
        let drives = self.load_drives(&config)?;
        let given = config.certificates.clone();
        let mut plan = AssessmentPlan {
            config,
            controllers,
            subject_index,
            file_scenarios,
            dropped: recordings.dropped,
            suites,
            drives,
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

    /// Returns the index of a controller, and makes its name canonical: controllers have one name, however the
    /// configuration spells it.
    fn find_controller(&self, controllers: &[NamedController], name: &mut String) -> Option<usize> {
        let is_named = controllers
            .iter()
            .any(|controller| controller.name == *name);
        if !is_named && let Some(given) = self.names.get(name.as_str()) {
            name.clone_from(given);
        } else if !is_named && let Ok(controller) = find_for_user(name, self.folder) {
            let given = self.names.get(&controller.name).cloned();
            *name = given.unwrap_or(controller.name);
        }
        controllers
            .iter()
            .position(|controller| controller.name == *name)
    }

    /// Gives a controller the name that the configuration states for its entry in `controllers`, if it states one.
    fn give_name(
        &mut self,
        config: &AssessConfig,
        entry: &str,
        controller: NamedController,
    ) -> Result<NamedController, AssessConfigError> {
        let Some(name) = config.names.get(entry) else {
            return Ok(controller);
        };
        self.ensure(!name.trim().is_empty(), "names", || {
            format!("the name of `{entry}` must not be empty")
        })?;
        // A reader would take it for that controller.
        let is_taken = controller.name != *name && find_built_in(name).is_some();
        self.ensure(!is_taken, "names", || {
            format!("`{name}` is a built-in controller; give `{entry}` another name")
        })?;
        self.names.insert(controller.name, name.clone());
        Ok(NamedController {
            name: name.clone(),
            source: controller.source,
        })
    }

    /// Makes the controllers' names of all gates canonical, and checks the gates.
    fn check_gates(
        &self,
        config: &mut AssessConfig,
        controllers: &[NamedController],
    ) -> Result<(), AssessConfigError> {
        for (index, gate) in config.gates.iter_mut().enumerate() {
            for GateName { role, field, name } in gate.gate.names_mut() {
                if role == NameRole::Controller && self.find_controller(controllers, name).is_none()
                {
                    let field = format!("gates[{index}].{field}");
                    return Err(self.field_error(&field, not_among_controllers(name)));
                }
            }
        }
        for (index, gate) in config.gates.iter().enumerate() {
            if let Some(problem) = gate.gate.config_problem(config) {
                return Err(self.locate(problem.within(&format!("gates[{index}]."))));
            }
        }
        Ok(())
    }

    /// Checks that no space for rates has the name of another space that is searched.
    fn check_space_names(
        &self,
        rate_spaces: &[NamedSpace],
        search_spaces: &[NamedSpace],
    ) -> Result<(), AssessConfigError> {
        let clash = rate_spaces.iter().find(|rate| {
            search_spaces.iter().any(|search| {
                rate.content_id.name == search.content_id.name
                    && rate.content_id != search.content_id
            })
        });
        let Some(clash) = clash else {
            return Ok(());
        };
        let name = clash.space.name();
        let problem = format!(
            "the name `{name}` belongs to another space in `search.spaces`; rename one of them"
        );
        Err(self.field_error("distributions", problem))
    }

    fn add_controller(
        &self,
        controllers: &mut Vec<NamedController>,
        field: &str,
        controller: NamedController,
    ) -> Result<(), AssessConfigError> {
        let is_new = controllers
            .iter()
            .all(|other| other.name != controller.name);
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
        let budget = config.search.budget;
        let runs = config.rates.runs;
        self.ensure(
            (1..=MAX_EVALUATIONS).contains(&budget),
            "search.budget",
            || format!("must be from 1 to {MAX_EVALUATIONS}, found {budget}"),
        )?;
        self.ensure(runs <= MAX_DRAWS, "rates.runs", || {
            format!("must be at most {MAX_DRAWS}, found {runs}")
        })?;
        self.check_harm(config)?;
        let confidence = config.rates.confidence;
        self.ensure(
            confidence > 0.5 && confidence < 1.0,
            "rates.confidence",
            || format!("must be between 0.5 and 1, found {confidence}"),
        )
    }

    fn check_harm(&self, config: &AssessConfig) -> Result<(), AssessConfigError> {
        let Some(harm) = &config.harm else {
            return Ok(());
        };
        self.ensure(config.draws > 0, "harm", || {
            "needs random scenarios; `draws` is 0".to_owned()
        })?;
        let rate = harm.emergencies_per_hour;
        self.ensure(
            (0.0..=3600.0).contains(&rate),
            "harm.emergencies_per_hour",
            || format!("must be from 0 to 3600, found {rate}"),
        )
    }

    fn load_controllers(
        &mut self,
        config: &mut AssessConfig,
    ) -> Result<Vec<NamedController>, AssessConfigError> {
        self.ensure(!config.controllers.is_empty(), "controllers", || {
            "must name at least one controller".to_owned()
        })?;
        let mut named = config.names.keys();
        if let Some(unknown) = named.find(|entry| !config.controllers.contains(entry)) {
            return Err(self.field_error("names", not_among_controllers(unknown)));
        }
        for entry in &config.controllers {
            name_without_backticks(&mut config.names, entry);
        }
        let mut controllers = Vec::new();
        for (index, name) in config.controllers.iter().enumerate() {
            let field = format!("controllers[{index}]");
            let controller = find_and_try(name, self.folder)
                .map_err(|error| self.field_error(&field, error.to_string()))?;
            let controller = self.give_name(config, name, controller)?;
            self.add_controller(&mut controllers, &field, controller)?;
        }
        Ok(controllers)
    }

    fn import_recordings(
        &self,
        config: &AssessConfig,
    ) -> Result<ImportedRecordings, AssessConfigError> {
        let paths: Vec<_> = config
            .recordings
            .iter()
            .map(|named| self.folder.join(named))
            .collect();
        let mut scenarios = Vec::new();
        let imported = import(
            &paths,
            None,
            &ImportOptions::default(),
            None,
            &mut |scenario| {
                scenarios.push(scenario);
                true
            },
        )
        .map_err(|error| self.field_error("recordings", error.to_string()))?;
        match imported.sources.iter().find(|source| source.scenarios == 0) {
            Some(empty) => Err(self.field_error(
                "recordings",
                format!(
                    "{}: the recording has no braking episode that fits a scenario",
                    empty.path.display()
                ),
            )),
            None => Ok(ImportedRecordings {
                scenarios,
                dropped: imported.dropped,
            }),
        }
    }

    fn load_drives(&self, config: &AssessConfig) -> Result<Option<NamedDrives>, AssessConfigError> {
        let Some(folder) = &config.drives else {
            return Ok(None);
        };
        NamedDrives::load(&self.folder.join(folder), &config.controllers_of_files)
            .map(Some)
            .map_err(|error| self.field_error("drives", error.to_string()))
    }

    fn load_scenarios(
        &self,
        config: &AssessConfig,
        recorded: Vec<ImportedScenario>,
    ) -> Result<Vec<(PathBuf, Scenario)>, AssessConfigError> {
        let mut scenarios = Vec::new();
        for (index, path) in config.scenarios.iter().enumerate() {
            let field = format!("scenarios[{index}]");
            scenarios.extend(self.load_scenario_files(
                &field,
                path,
                &config.controllers_of_files,
            )?);
        }
        scenarios.extend(
            recorded
                .into_iter()
                .map(|imported| (PathBuf::from(imported.file_name), imported.scenario)),
        );
        self.check_scenario_names(&scenarios)?;
        Ok(scenarios)
    }

    /// Loads a scenario file, or all scenario files of a folder.
    fn load_scenario_files(
        &self,
        field: &str,
        relative_path: &Path,
        opener: &dyn OpenDriver,
    ) -> Result<Vec<(PathBuf, Scenario)>, AssessConfigError> {
        let path = self.folder.join(relative_path);
        self.ensure(path.exists(), field, || {
            format!("{} does not exist", path.display())
        })?;
        let scenarios = file::load_all(&path, opener)?;
        self.ensure(!scenarios.is_empty(), field, || {
            format!(
                "the folder {} has no scenario file",
                relative_path.display()
            )
        })?;
        let untested = scenarios
            .iter()
            .find(|(_, scenario)| !scenario.has_vehicle_under_test());
        if let Some((path, _)) = untested {
            let problem = format!("{}: no vehicle is under test", path.display());
            return Err(self.field_error(field, problem));
        }
        Ok(scenarios)
    }

    /// Checks that each name of a scenario is unique, also among built-in scenarios.
    fn check_scenario_names(
        &self,
        scenarios: &[(PathBuf, Scenario)],
    ) -> Result<(), AssessConfigError> {
        let mut names: Vec<_> = built_in_scenario_names()
            .iter()
            .map(|(name, _)| (*name).to_owned())
            .collect();
        for (path, scenario) in scenarios {
            let name = &scenario.spec().name;
            self.ensure(!names.contains(name), "scenarios", || {
                format!(
                    "{}: another scenario has the name `{name}`; rename one of them",
                    path.display()
                )
            })?;
            names.push(name.clone());
        }
        Ok(())
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
            let space = self.load_space(&field, name, opener)?;
            let own_name = prose_name(space.name());
            let is_new = spaces.iter().all(|other| other.content_id.name != own_name);
            self.ensure(is_new, &field, || {
                format!(
                    "another space has the name `{}`; rename one of them",
                    space.name()
                )
            })?;
            let named = NamedSpace::new(name, space)
                .map_err(|error| self.field_error(&field, error.to_string()))?;
            let own_name = named.space.name();
            let built_in = built_in_space(own_name)
                .and_then(|space| space_file::to_identity_toml(&space).ok());
            let is_same = built_in.is_none_or(|built_in| built_in == named.text);
            self.ensure(is_same, &field, || {
                format!(
                    "a built-in space with other contents has the name `{own_name}`; rename this one"
                )
            })?;
            spaces.push(named);
        }
        Ok(spaces)
    }

    /// Loads a space with a valid nominal scenario that tests a vehicle.
    fn load_space(
        &self,
        field: &str,
        name: &str,
        opener: &dyn OpenDriver,
    ) -> Result<ScenarioSpace, AssessConfigError> {
        let space = match built_in_space(name) {
            Some(space) => space,
            None if name.ends_with(".toml") => space_file::load(&self.folder.join(name), opener)
                .map_err(|error| self.field_error(field, error.to_string()))?,
            None => {
                let problem = format!("`{name}` is neither a built-in space nor a .toml file");
                return Err(self.field_error(field, problem));
            }
        };
        let nominal = space.scenario(&space.nominal()).map_err(|error| {
            let problem = format!("{name}: the nominal scenario is invalid: {error}");
            self.field_error(field, problem)
        })?;
        self.ensure(nominal.has_vehicle_under_test(), field, || {
            format!("{name}: no vehicle is under test")
        })?;
        Ok(space)
    }

    fn load_certificates(
        &self,
        paths: &[PathBuf],
        generated_names: &[String],
    ) -> Result<Vec<GivenCertificate>, AssessConfigError> {
        let mut given: Vec<GivenCertificate> = Vec::new();
        for (index, path) in paths.iter().enumerate() {
            let field = format!("certificates[{index}]");
            let path = self.folder.join(path);
            let certificate = regular_file::open(&path)
                .map_err(|error| error.to_string())
                .and_then(|file| Certificate::from_reader(file).map_err(|error| error.to_string()))
                .map_err(|error| {
                    self.field_error(&field, format!("{}: {error}", path.display()))
                })?;
            let name = certificate_name(&path);
            self.ensure(!generated_names.contains(&name), &field, || {
                format!(
                    "this assessment writes a certificate with the name `{name}`; rename the file"
                )
            })?;
            self.ensure(given.iter().all(|other| other.name != name), &field, || {
                format!("another certificate has the name `{name}`; rename the file")
            })?;
            let policy = certificate
                .read_policy(&path, None)
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
