//! The configuration of a report as a file of its folder: every file that it names is in that folder, too.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::controller_arg::controller_arg;
use super::gate_rules::{GateName, NameRole};
use super::identity::CONFIGURATION_FILE;
use super::parts::{Proofs, SCENARIO_FOLDER};
use super::plan::{NamedSpace, file_stem};
use super::planned_suite::PlannedSuite;
use super::{
    AssessConfig, AssessmentGate, AssessmentPlan, CacheError, CommandFile, CrumpleCommand,
    GateConfig,
};
use crumple_controllers::Controllers;
use crumple_sim::engine::NamedController;
use crumple_suites::TestSuite;

/// Copy of the earlier assessment in the report folder, which the gate `nothing-worse` needs.
pub(super) const EARLIER_FILE: &str = "earlier.json";

const HEAD: &str = "# The configuration of this report, with all defaults. In this folder:\n";

impl AssessmentPlan {
    /// Returns the configuration as a file of the report folder, whose paths lead into that folder.
    ///
    /// # Errors
    /// [`CacheError::Encoding`] if it cannot be encoded.
    pub(super) fn configuration_file(&self, proofs: &Proofs) -> Result<CommandFile, CacheError> {
        let config = self.portable_config(proofs);
        let text = toml::to_string(&config).map_err(CacheError::encoding)?;
        let absent = self.files_outside_report(proofs);
        let absent = if absent.is_empty() {
            String::new()
        } else {
            format!("# It also needs: {}\n", absent.join("; "))
        };
        let command = self.repeat_command();
        Ok(CommandFile {
            file: CONFIGURATION_FILE.to_owned(),
            contents: format!("{HEAD}# {command}\n{absent}\n{text}").into_bytes(),
        })
    }

    /// Returns the command that repeats the assessment in the folder of its report.
    pub(super) fn repeat_command(&self) -> CrumpleCommand {
        let command = CrumpleCommand::new(["assess", CONFIGURATION_FILE, "--out", "../repeated"]);
        if self.needs_earlier_assessment() {
            command.with_args(["--against", EARLIER_FILE])
        } else {
            command
        }
    }

    /// Returns the copy of the earlier assessment that [`Self::repeat_command`] names; `None` if it names none.
    pub(super) fn earlier_file(&self, earlier: Option<&str>) -> Option<CommandFile> {
        let earlier = earlier.filter(|_| self.needs_earlier_assessment())?;
        Some(CommandFile {
            file: EARLIER_FILE.to_owned(),
            contents: earlier.as_bytes().to_vec(),
        })
    }

    /// Returns what the configuration names and the report folder lacks, in words.
    fn files_outside_report(&self, proofs: &Proofs) -> Vec<String> {
        let controllers = self.controllers_outside_report().map(|controller| {
            let name = self.portable_name(controller);
            format!("the controller `{name}` with its files")
        });
        let drives = self.config.drives.as_deref().map(|folder| {
            let name = folder_name(folder);
            format!("the recorded drives, as the folder `{}`", name.display())
        });
        let given = self.certificates.iter().map(|given| given.name.as_str());
        let rejected = given
            .filter(|name| proofs.certificate_file(name).is_none())
            .map(|name| format!("the certificate `{name}`, which the checker rejected"));
        controllers.chain(drives).chain(rejected).collect()
    }

    /// Returns the controllers whose files are not in the report folder.
    pub(super) fn controllers_outside_report(&self) -> impl Iterator<Item = &NamedController> {
        self.controllers
            .iter()
            .filter(|controller| controller_arg(&*controller.source).is_none())
    }

    fn portable_config(&self, proofs: &Proofs) -> AssessConfig {
        let config = &self.config;
        let mut controllers = self
            .controllers
            .iter()
            .map(|controller| self.portable_name(controller))
            .collect::<Vec<_>>();
        let subject = controllers.get(self.subject_index).cloned();
        let mut seen: Vec<String> = Vec::new();
        // Two controllers with the same files are one.
        controllers.retain(|name| {
            let is_new = !seen.contains(name);
            seen.push(name.clone());
            is_new
        });
        let mut suites = config.suites.clone();
        for (suite, planned) in suites.iter_mut().zip(&self.suites) {
            suite.suite = planned.to_arg();
            for name in suite.controllers.iter_mut().flatten() {
                self.make_controller_portable(name);
            }
        }
        let mut portable = AssessConfig {
            controllers,
            names: self.portable_names(),
            subject,
            distributions: Some(space_args(&self.rate_spaces)),
            scenarios: self.portable_scenarios(),
            recordings: Vec::new(),
            drives: config.drives.as_deref().map(folder_name),
            suites,
            certificates: self.portable_certificates(proofs),
            gates: self.portable_gates(),
            ..config.clone()
        };
        portable.search.spaces = Some(space_args(&self.search_spaces));
        portable
    }

    /// Returns the configuration that a comparison with another report compares: with the names of controllers instead
    /// of their files, which may have changed, and without the folders of scenarios and spaces.
    pub(super) fn compared_config(&self, proofs: &Proofs) -> AssessConfig {
        let mut compared = AssessConfig {
            controllers: self.controller_names(),
            names: BTreeMap::new(),
            subject: Some(self.subject_name().to_owned()),
            // A permission determines no result.
            controllers_of_files: Controllers::default(),
            ..self.portable_config(proofs)
        };
        for (suite, named) in compared.suites.iter_mut().zip(&self.config.suites) {
            suite.controllers.clone_from(&named.controllers);
        }
        for (config, named) in compared.gates.iter_mut().zip(&self.config.gates) {
            let mut gate = named.gate.clone();
            for (portable, own) in config.gate.names_mut().into_iter().zip(gate.names_mut()) {
                if own.role == NameRole::Controller {
                    portable.name.clone_from(own.name);
                }
            }
        }
        compared
    }

    /// Returns the names that the report gives to controllers, by those in the report folder where these differ. Of
    /// two controllers with the same files, the subject or the first has the name.
    fn portable_names(&self) -> BTreeMap<String, String> {
        let mut names = BTreeMap::new();
        for controller in self.subject().into_iter().chain(&self.controllers) {
            let portable = self.portable_name(controller);
            names.entry(portable).or_insert(controller.name.clone());
        }
        names.retain(|portable, name| portable != name);
        names
    }

    fn portable_scenarios(&self) -> Vec<PathBuf> {
        let has_files = !self.file_scenarios.is_empty();
        has_files
            .then(|| PathBuf::from(SCENARIO_FOLDER))
            .into_iter()
            .collect()
    }

    /// Returns the paths of the given certificates that the checker accepted; `None` for the default ones.
    fn portable_certificates(&self, proofs: &Proofs) -> Option<Vec<PathBuf>> {
        self.config.certificates.as_ref()?;
        let given = self.certificates.iter();
        let files = given.filter_map(|given| proofs.certificate_file(&given.name));
        Some(files.map(PathBuf::from).collect())
    }

    /// Returns the name with which a configuration in the report folder opens a controller. One that must be copied
    /// there has its file name, unless another one has the same.
    fn portable_name(&self, controller: &NamedController) -> String {
        if let Some(arg) = controller_arg(&*controller.source) {
            return arg;
        }
        let copied = self.copied_name(controller);
        let mut others = self.controllers.iter();
        let is_taken =
            others.any(|other| other.name != controller.name && self.copied_name(other) == copied);
        match is_taken {
            true => self.controller_entry(controller).to_owned(),
            false => copied,
        }
    }

    /// Returns the name of a controller file after its copy into the report folder: the file name, behind the settings
    /// of a shield. Commands keep their names.
    fn copied_name(&self, controller: &NamedController) -> String {
        let entry = self.controller_entry(controller);
        let shield = controller
            .source
            .as_shield()
            .map_or_else(String::new, |shield| shield.settings.name_prefix());
        match entry.strip_prefix(&shield) {
            Some(inner) if !inner.starts_with("exec:") => {
                let file = folder_name(Path::new(inner));
                format!("{shield}{}", file.display())
            }
            _ => entry.to_owned(),
        }
    }

    fn make_controller_portable(&self, name: &mut String) {
        let mut controllers = self.controllers.iter();
        if let Some(controller) = controllers.find(|controller| controller.name == *name) {
            *name = self.portable_name(controller);
        }
    }

    fn portable_gates(&self) -> Vec<GateConfig> {
        let gates = self.config.gates.iter();
        gates
            .map(|config| GateConfig {
                gate: self.portable_gate(&config.gate),
                requirement: config.requirement.clone(),
            })
            .collect()
    }

    fn portable_gate(&self, gate: &AssessmentGate) -> AssessmentGate {
        let mut gate = gate.clone();
        for GateName { role, name, .. } in gate.names_mut() {
            match role {
                NameRole::Controller => self.make_controller_portable(name),
                NameRole::Space => self.make_space_portable(name),
                NameRole::Suite => self.make_suite_portable(name),
            }
        }
        gate
    }

    fn make_space_portable(&self, name: &mut String) {
        if let Some(space) = self.find_named_space(name) {
            *name = space.to_arg();
        }
    }

    fn make_suite_portable(&self, name: &mut String) {
        if let Some(planned) = self.find_suite(name) {
            *name = planned.to_arg();
        }
    }

    /// Returns the suite with that name in the configuration.
    pub(super) fn find_suite(&self, name: &str) -> Option<&PlannedSuite> {
        let mut suites = self.suites.iter();
        suites.find(|planned| planned.config_name == name)
    }

    /// Returns the space with that name in the configuration.
    pub(super) fn find_named_space(&self, name: &str) -> Option<&NamedSpace> {
        let mut spaces = self.rate_spaces.iter().chain(&self.search_spaces);
        spaces.find(|named| named.name == name)
    }

    /// Returns the suites that are not shipped, as files of the report folder.
    pub(super) fn suite_files(&self) -> Result<Vec<CommandFile>, CacheError> {
        let own = self.suites.iter().filter(|planned| !planned.is_shipped());
        own.map(|planned| {
            let text = toml::to_string(planned.suite.spec()).map_err(CacheError::encoding)?;
            Ok(CommandFile {
                file: planned.to_arg(),
                contents: text.into_bytes(),
            })
        })
        .collect()
    }
}

impl PlannedSuite {
    fn is_shipped(&self) -> bool {
        TestSuite::shipped(&self.suite.spec().name).is_some()
    }

    /// Returns the name of a shipped suite, or the path of its file in the report folder.
    fn to_arg(&self) -> String {
        let name = &self.suite.spec().name;
        if self.is_shipped() {
            name.clone()
        } else {
            format!("suites/{}.toml", file_stem(name))
        }
    }
}

fn space_args(spaces: &[NamedSpace]) -> Vec<String> {
    spaces.iter().map(NamedSpace::to_arg).collect()
}

fn folder_name(folder: &Path) -> PathBuf {
    PathBuf::from(folder.file_name().unwrap_or(folder.as_os_str()))
}
