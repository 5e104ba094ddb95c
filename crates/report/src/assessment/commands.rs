//! Commands that reproduce the results of a report from its folder, and the files that they need.
//!
//! Every argument is quoted for a shell. Policies, networks, processes and scenario spaces that are not built in are
//! files of the report folder, controllers under their hashes. A controller in code has no command-line argument.

use std::collections::BTreeSet;
use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::controller_arg::{controller_arg, network_path, policy_path, process_folder};
use super::parts::scenario_path;
use super::plan::{NamedSpace, file_stem};
use super::{AssessmentPlan, CacheError};
use crumple_controllers::controller_file;
use crumple_core::digest::sha256;
use crumple_core::quoting::ShellWord;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file;
use crumple_spaces::file as space_file;

/// A command line of crumple: its arguments, and its text quoted for a shell.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct CrumpleCommand {
    arguments: Vec<String>,
}

/// A file that commands of a report need.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CommandFile {
    /// Path relative to the report folder.
    pub file: String,
    #[serde(skip)]
    pub(super) contents: Vec<u8>,
}

impl CrumpleCommand {
    pub(super) fn new<W: Into<String>>(arguments: impl IntoIterator<Item = W>) -> Self {
        Self {
            arguments: arguments.into_iter().map(Into::into).collect(),
        }
    }

    pub(super) fn with_args<W: Into<String>>(
        mut self,
        arguments: impl IntoIterator<Item = W>,
    ) -> Self {
        self.arguments.extend(arguments.into_iter().map(Into::into));
        self
    }

    pub(super) fn shell_quoted(&self) -> String {
        self.arguments
            .iter()
            .map(|word| ShellWord(word).to_string())
            .collect::<Vec<_>>()
            .join(" ")
    }
}

impl fmt::Display for CrumpleCommand {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "crumple {}", self.shell_quoted())
    }
}

impl NamedSpace {
    pub(super) fn to_arg(&self) -> String {
        if self.is_built_in() {
            self.name.clone()
        } else {
            self.path()
        }
    }

    fn is_built_in(&self) -> bool {
        crumple_spaces::built_in_space(&self.name).is_some()
    }

    fn path(&self) -> String {
        format!("spaces/{}.toml", file_stem(self.space.name()))
    }
}

impl AssessmentPlan {
    pub(super) fn estimator_args(&self) -> &'static [&'static str] {
        match self.config.estimator {
            EstimatorKind::Kalman => &[],
            EstimatorKind::Truth => &["--estimator", "truth"],
        }
    }

    /// Returns the files that commands of the report need, with paths relative to the report folder.
    ///
    /// # Errors
    /// [`CacheError::Encoding`] if one of them cannot be encoded.
    pub(super) fn command_files(&self) -> Result<Vec<CommandFile>, CacheError> {
        let mut files = self.policy_files()?;
        files.extend(self.network_files()?);
        files.extend(self.process_files()?);
        files.extend(self.space_files()?);
        files.extend(self.certificate_policy_files());
        files.extend(self.scenario_files()?);
        files.extend(self.suite_files()?);
        let mut paths = BTreeSet::new();
        files.retain(|file| paths.insert(file.file.clone()));
        Ok(files)
    }

    /// Returns the policies that were read from files; others need no file.
    fn policy_files(&self) -> Result<Vec<CommandFile>, CacheError> {
        let mut files = Vec::new();
        for controller in &self.controllers {
            if let Some(argument) = controller_arg(&*controller.source)
                && let Some(policy) = controller.policy()
                && argument.ends_with(&policy_path(&policy))
            {
                files.push(CommandFile {
                    file: policy_path(&policy),
                    contents: policy.to_bytes().map_err(CacheError::encoding)?,
                });
            }
        }
        Ok(files)
    }

    fn network_files(&self) -> Result<Vec<CommandFile>, CacheError> {
        let mut files = Vec::new();
        for controller in &self.controllers {
            let Some(network) = controller.source.unshielded().downcast_ref() else {
                continue;
            };
            let contents_by_name =
                controller_file::to_files(network).map_err(CacheError::encoding)?;
            files.extend(contents_by_name.map(|(name, contents)| CommandFile {
                file: network_path(&name),
                contents,
            }));
        }
        Ok(files)
    }

    fn process_files(&self) -> Result<Vec<CommandFile>, CacheError> {
        let mut files = Vec::new();
        for controller in &self.controllers {
            let Some(process) = controller.source.unshielded().downcast_ref() else {
                continue;
            };
            let Some(folder) = process_folder(process) else {
                continue;
            };
            let copies = process
                .portable_files()
                .map_err(|problem| CacheError::Copy {
                    controller: controller.name.clone(),
                    problem,
                })?;
            files.extend(copies.into_iter().map(|(name, contents)| CommandFile {
                file: format!("{folder}/{name}"),
                contents,
            }));
        }
        Ok(files)
    }

    /// Returns the spaces that are not built in, with the present names of fields.
    fn space_files(&self) -> Result<Vec<CommandFile>, CacheError> {
        let spaces = self.rate_spaces.iter().chain(&self.search_spaces);
        spaces
            .filter(|named| !named.is_built_in())
            .map(|named| {
                let text = space_file::to_toml(&named.space).map_err(CacheError::encoding)?;
                Ok(CommandFile {
                    file: named.path(),
                    contents: text.into_bytes(),
                })
            })
            .collect()
    }

    /// Returns the policies of certificates. A certificate may name any file, and the checker looks for one of that
    /// name in the certificate's folder.
    fn certificate_policy_files(&self) -> impl Iterator<Item = CommandFile> {
        self.certificates.iter().filter_map(|given| {
            let (file, digest) = given.certificate.policy_reference()?;
            let policy = given.policy.as_ref()?;
            let name = Path::new(file).file_name()?;
            (sha256(policy) == digest).then(|| CommandFile {
                file: format!("certificates/{}", name.to_string_lossy()),
                contents: policy.clone(),
            })
        })
    }

    fn scenario_files(&self) -> Result<Vec<CommandFile>, CacheError> {
        let mut files = Vec::new();
        for (_, scenario) in &self.file_scenarios {
            let text = file::to_toml(scenario).map_err(CacheError::encoding)?;
            files.push(CommandFile {
                file: scenario_path(scenario),
                contents: text.into_bytes(),
            });
        }
        Ok(files)
    }
}

/// Arguments that check all certificates of a report in its folder; a shell expands them.
pub(super) const CHECK_ARGUMENTS: &str = "check certificates/*.json";

/// Returns a shell script that checks files and certificates, repeats counts (`recount`), and runs the commands. It
/// reports each unexpected result.
pub(super) fn replay_script<'a>(
    recount: Option<&'a CrumpleCommand>,
    commands: impl Iterator<Item = &'a CrumpleCommand>,
) -> String {
    let mut script = String::from(
        "#!/bin/sh\n\
         # Shows again what this report shows; every command may also be run by itself, in this folder. CRUMPLE names \
         the program.\n\
         cd \"$(dirname \"$0\")\" || exit 2\n\
         crumple=${CRUMPLE:-crumple}\n\
         \"$crumple\" --version > /dev/null || \
         { echo \"crumple not found; use CRUMPLE=/path/to/crumple sh replay.sh\" >&2; exit 2; }\n\
         failed=0\n\
         run() { \"$crumple\" \"$@\" || { echo \"result differs from the report: crumple $*\" >&2; failed=1; }; }\n",
    );
    // A command on an edited file may fail for another reason than reported.
    script += &format!("run fsck .\nrun {CHECK_ARGUMENTS}\n");
    // Controllers that fail at the same point of a suite share the command of its escape.
    let mut written = BTreeSet::new();
    for command in recount
        .into_iter()
        .chain(commands)
        .map(CrumpleCommand::shell_quoted)
        .filter(|command| written.insert(command.clone()))
    {
        script += &format!("run {command}\n");
    }
    script + "exit $failed\n"
}
