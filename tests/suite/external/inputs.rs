//! Files that name a program: scenarios, spaces, a campaign and a certificate. The program leaves a marker
//! when it starts.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use crumple_sim::scenario::{built_in_scenario, file};
use tempfile::TempDir;

use crate::command_line::{exit_code, run_crumple, temp_folder};
use crate::fmus::{library_member, zip_archive};
use crate::suite_pages::standing_suite;
use crate::tiny::replace_passages;

pub(super) const MARKER_FILE: &str = "started";

/// The program as a command, with the length of `evil.toml`.
pub(super) const EXEC_CONTROLLER: &str = "exec:./ev";

/// A controller that keeps accelerating.
const PROGRAM: &str = r#"#!/bin/sh
: > started
while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *hello*) echo '{"crumple":1,"name":"marker","deterministic":true}' ;;
        *reset*) echo "{\"id\":$id,\"ready\":true}" ;;
        *) echo "{\"id\":$id,\"acceleration_mps2\":2}" ;;
    esac
done
"#;

const FMU: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="evil" instantiationToken="evil">
  <CoSimulation modelIdentifier="evil"/>
  <ModelVariables>
    <Float64 name="gap_ahead_m" valueReference="1" causality="input" start="80"/>
    <Float64 name="acceleration_mps2" valueReference="2" causality="output"/>
  </ModelVariables>
</fmiModelDescription>
"#;

pub(super) fn space_toml(name: &str, base: &str) -> String {
    format!(
        "version = 1\nname = \"{name}\"\nbase = \"{base}\"\n\n[[parameters]]\nname = \"gap_m\"\nfield \
         = \"vehicles[1].gap_m\"\n\
         unit = \"m\"\ndistribution.uniform = {{ low = 15.0, high = 40.0 }}\n"
    )
}

pub(super) fn assessment_toml(controllers: &str, more: &str) -> String {
    format!(
        "version = 1\npaper = false\n{controllers}\n{more}\ndistributions = [\"plain.toml\"]\ndraws = \
         4\neveryday_draws = 1\n\
         certificates = []\nsearch = {{ spaces = [\"plain.toml\"], budget = 4 }}\nrates = {{ runs = 0 }}\n"
    )
}

pub(super) struct CommandOutput {
    pub(super) code: i32,
    pub(super) stdout: String,
    pub(super) stderr: String,
}

pub(super) struct InputFolder {
    folder: TempDir,
}

/// Folders and files that commands may write; removed before each command.
const OUTPUTS: [&str; 3] = ["o", "o.toml", "pages"];

impl InputFolder {
    pub(super) fn new() -> Self {
        let inputs = Self {
            folder: temp_folder(),
        };
        inputs.write_files();
        inputs.make_run_folders();
        assert!(inputs.has_started(), "the work was made with the program");
        inputs
    }

    pub(super) fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub(super) fn run(&self, words: &str) -> CommandOutput {
        for output in OUTPUTS {
            let path = self.folder().join(output);
            let _ = if path.is_dir() {
                fs::remove_dir_all(path)
            } else {
                fs::remove_file(path)
            };
        }
        let output = run_crumple(self.folder(), words);
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        CommandOutput {
            code: exit_code(&output),
            stdout: text(&output.stdout),
            stderr: text(&output.stderr),
        }
    }

    pub(super) fn has_started(&self) -> bool {
        fs::remove_file(self.folder().join(MARKER_FILE)).is_ok()
    }

    fn write(&self, name: &str, contents: impl AsRef<[u8]>) {
        fs::write(self.folder().join(name), contents).unwrap();
    }

    fn write_files(&self) {
        self.write("ev", PROGRAM);
        fs::set_permissions(self.folder().join("ev"), fs::Permissions::from_mode(0o755)).unwrap();
        self.write(
            "evil.toml",
            "version = 1\ncommand = [\"./ev\"]\nfiles = [\"ev\"]\n",
        );
        let library = library_member(3, "evil");
        self.write(
            "evil.fmu",
            zip_archive(&[
                ("modelDescription.xml", FMU.as_bytes()),
                (&library, b"no library"),
            ]),
        );
        let short = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| spec.duration_s = 0.5)
            .unwrap();
        let text = file::to_toml(&short).unwrap();
        self.write("plain-base.toml", &text);
        for (name, path) in [
            ("driven.toml", "evil.toml"),
            ("driven-fmu.toml", "evil.fmu"),
        ] {
            assert!(text.contains("\"baseline\""), "{text}");
            self.write(
                name,
                text.replace(
                    "\"baseline\"",
                    &format!("{{ file = {{ path = \"{path}\" }} }}"),
                ),
            );
        }
        let mut json = serde_json::to_value(short.spec()).unwrap();
        json["vehicles"][2]["driver"] = serde_json::json!({ "file": { "path": "evil.toml" } });
        self.write("driven.json", json.to_string());
        self.write("space.toml", space_toml("driven", "driven.toml"));
        self.write("plain.toml", space_toml("plain", "plain-base.toml"));
        self.write(
            "suite.toml",
            replace_passages(
                &standing_suite(),
                &[("[60.0, 75.0]", "[60.0]"), (", tolerance = 2.0", "")],
            ),
        );
        let idm = "controllers = [\"idm\"]";
        self.write(
            "scenarios.toml",
            assessment_toml(idm, "scenarios = [\"driven.toml\"]"),
        );
        let spaces = assessment_toml(idm, "")
            .replace("spaces = [\"plain.toml\"]", "spaces = [\"space.toml\"]");
        self.write("spaces.toml", spaces);
        let preset = crate::tiny::training();
        self.write(
            "preset.toml",
            format!("{preset}\n[[spaces]]\nspace = \"space.toml\"\nweight = 1.0\n"),
        );
    }

    /// Makes a campaign and a certificate, with permission to start the program.
    fn make_run_folders(&self) {
        let search = "falsify --controller idm --space space.toml --budget 2 --allow-external";
        let count = "verify rate --controller idm --space space.toml --runs 2 --allow-external --confidence 0.6";
        for (command, more) in [(search, "--out campaign"), (count, "--out rate")] {
            let message = self.run(&format!("{command} {more}"));
            assert_eq!(message.code, 0, "{command:?}: {}", message.stderr);
        }
    }
}
