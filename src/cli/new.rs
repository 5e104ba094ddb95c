//! `crumple new`: projects for a user's own controller, from templates.

mod names;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::{CliError, output};
use crumple_store::disk::{self, StagedFiles};

/// Texts of the templates that a project replaces: its name, in both spellings, the dependencies on crumple, and the
/// version to install.
const NAME: &str = "my-controller";
const MODULE: &str = "my_controller";
const RUST_SIMULATOR: &str = r#"crumple-sim = { git = "https://github.com/crumple-rs/crumple" }"#;
const RUST_HARNESS: &str = r#"crumple-testing = { git = "https://github.com/crumple-rs/crumple" }"#;
const PYTHON_SOURCE: &str = "git+https://github.com/crumple-rs/crumple#subdirectory=python";
const INSTALLATION: &str = "--git https://github.com/crumple-rs/crumple crumple";
/// Tag of the release in the repository.
const TAG: &str = concat!("v", env!("CARGO_PKG_VERSION"));

/// Create a project for your own controller, with gates and, for Rust and Python, tests
#[derive(Args)]
#[command(after_long_help = "\
The Rust crate has property tests, a fuzz target, gates and a GitHub workflow; the Python project has tests with \
Hypothesis, and gates; the C project has gates. Each has a controller file, which every command that simulates accepts \
as --controller. The name of the folder is the name of the project. The README of the project lists its commands.

Examples:
  crumple new my-controller
  crumple new my-controller --template python")]
pub(super) struct New {
    /// Folder of the project, which must not exist; its name is 1 to 40 of a-z, 0-9 and -, begins with a letter, and is
    /// no name that the language or its tools reserve
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Language of the controller
    #[arg(long, value_enum, value_name = "T", default_value = "rust")]
    template: Template,
    /// Folder with the source of crumple; by default the project depends on the same release at GitHub
    #[arg(long, value_name = "DIR")]
    crumple: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Template {
    /// Rust crate
    Rust,
    /// Python project
    Python,
    /// C program
    C,
}

impl Template {
    /// Returns paths and contents of the files.
    fn files(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Rust => &[
                ("Cargo.toml", include_str!("new/rust/manifest.toml")),
                ("src/lib.rs", include_str!("new/rust/lib.rs")),
                ("src/main.rs", include_str!("new/rust/main.rs")),
                (
                    "tests/properties.rs",
                    include_str!("new/rust/properties.rs"),
                ),
                (
                    "fuzz/Cargo.toml",
                    include_str!("new/rust/fuzz_manifest.toml"),
                ),
                (
                    "fuzz/fuzz_targets/controller.rs",
                    include_str!("new/rust/fuzz_target.rs"),
                ),
                ("controller.toml", include_str!("new/rust/controller.toml")),
                ("gates.toml", include_str!("new/gates.toml")),
                (
                    ".github/workflows/tests.yml",
                    include_str!("new/rust/workflow.yml"),
                ),
                (".gitignore", include_str!("new/rust/gitignore")),
                ("README.md", include_str!("new/rust/README.md")),
            ],
            Self::Python => &[
                ("pyproject.toml", include_str!("new/python/pyproject.toml")),
                (
                    "my_controller.py",
                    include_str!("new/python/my_controller.py"),
                ),
                (
                    "test_my_controller.py",
                    include_str!("new/python/test_my_controller.py"),
                ),
                (
                    "controller.toml",
                    include_str!("new/python/controller.toml"),
                ),
                ("gates.toml", include_str!("new/gates.toml")),
                (".gitignore", include_str!("new/python/gitignore")),
                ("README.md", include_str!("new/python/README.md")),
            ],
            Self::C => &[
                (
                    "my-controller.c",
                    include_str!("../../examples/controllers/follower.c"),
                ),
                ("controller.toml", include_str!("new/c/controller.toml")),
                ("gates.toml", include_str!("new/gates.toml")),
                ("Makefile", include_str!("new/c/Makefile")),
                (".gitignore", include_str!("new/c/gitignore")),
                ("README.md", include_str!("new/c/README.md")),
            ],
        }
    }
}

impl New {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        let folder = &self.folder;
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        names::check_name(&name, self.template).map_err(|reason| {
            CliError::at(folder, format!("is not the name of a project: {reason}"))
        })?;
        if folder.symlink_metadata().is_ok() {
            return Err(CliError::at(folder, "exists: choose a new folder"));
        }
        let module = name.replace('-', "_");
        let [simulator, harness, python, installation] = self.sources()?;
        let values = [
            (NAME, &*name),
            (MODULE, &module),
            (RUST_SIMULATOR, &simulator),
            (RUST_HARNESS, &harness),
            (PYTHON_SOURCE, &python),
            (INSTALLATION, &installation),
        ];
        let mut files = StagedFiles::default();
        for (path, text) in self.template.files() {
            let path = folder.join(fill(path, &values));
            path.parent().map_or(Ok(()), disk::make_folder)?;
            files.stage(&path, fill(text, &values))?;
        }
        files.commit()?;
        output::note(
            &format!(
                "created {}: README.md there lists its commands",
                folder.display()
            ),
            quiet,
        );
        Ok(())
    }

    /// Returns the dependencies on the simulator and on the test harness in a manifest of Cargo, the dependency of a
    /// Python project, and the arguments of `cargo install`.
    fn sources(&self) -> Result<[String; 4], CliError> {
        let installation = INSTALLATION.replace(" crumple", &format!(" --tag {TAG} crumple"));
        let Some(folder) = &self.crumple else {
            let with_tag =
                |dependency: &str| dependency.replace(" }", &format!(", tag = \"{TAG}\" }}"));
            let python = PYTHON_SOURCE.replace('#', &format!("@{TAG}#"));
            return Ok([
                with_tag(RUST_SIMULATOR),
                with_tag(RUST_HARNESS),
                python,
                installation,
            ]);
        };
        let path = folder
            .canonicalize()
            .ok()
            .filter(|path| path.join("crates/testing").is_dir());
        // Manifests of Cargo quote the path in double quotes.
        let path = path
            .as_deref()
            .and_then(Path::to_str)
            .filter(|path| {
                !path.contains(|letter: char| letter.is_control() || "\"\\".contains(letter))
            })
            .ok_or_else(|| CliError::at(folder, "is not a folder with the source of crumple"))?;
        let dependency =
            |name: &str| format!("crumple-{name} = {{ path = \"{path}/crates/{name}\" }}");
        let python = format!("file://{}/python", percent_encoded(path));
        Ok([
            dependency("sim"),
            dependency("testing"),
            python,
            installation,
        ])
    }
}

/// Replaces the keys in a template by their values. The values themselves, such as a path, are not changed.
fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut text = String::new();
    let mut rest = template;
    loop {
        let occurrences = values
            .iter()
            .filter_map(|(key, value)| Some((rest.find(key)?, *key, *value)));
        let Some((at, key, value)) = occurrences.min_by_key(|(at, ..)| *at) else {
            return text + rest;
        };
        let (before, after) = rest.split_at(at);
        text += before;
        text += value;
        rest = after.strip_prefix(key).unwrap_or_default();
    }
}

/// Encodes a path for a URL.
fn percent_encoded(path: &str) -> String {
    let mut encoded = String::new();
    for byte in path.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'-' | b'.' | b'_' | b'~' => {
                encoded.push(char::from(byte))
            }
            // Writing to a string does not fail.
            other => drop(write!(encoded, "%{other:02X}")),
        }
    }
    encoded
}
