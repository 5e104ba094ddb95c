//! `crumple new`: projects for a user's own controller, from templates.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::{CliError, output};
use crumple_store::disk::{self, StagedFiles};

/// Text of the templates that a project replaces: its name, in both spellings, and the dependency on crumple.
const NAME: &str = "my-controller";
const MODULE: &str = "my_controller";
const RUST_SOURCE: &str = "git = \"https://github.com/crumple-rs/crumple\"";
const PYTHON_SOURCE: &str = "git+https://github.com/crumple-rs/crumple#subdirectory=python";
const MAX_NAME_LENGTH: usize = 40;

/// Create a project for your own controller: tests, gates and, for Rust, a fuzz target
#[derive(Args)]
#[command(after_long_help = "\
The Rust crate has property tests, a fuzz target, gates and a GitHub workflow; the Python project has tests with \
Hypothesis, and gates; the C project has gates. Each has a controller file, with which every command takes the \
controller. The name of the folder is the name of the project. The README of the project lists its commands.

Examples:
  crumple new my-controller
  crumple new my-controller --template python")]
pub(super) struct New {
    /// Folder of the project, which must not exist; its name is 1 to 40 of a-z, 0-9 and -, and begins with a letter
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Language of the controller
    #[arg(long, value_enum, value_name = "T", default_value = "rust")]
    template: Template,
    /// Folder with the source of crumple; by default the project depends on the repository at GitHub
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
                ("tests/properties.rs", include_str!("new/rust/properties.rs")),
                ("fuzz/Cargo.toml", include_str!("new/rust/fuzz_manifest.toml")),
                ("fuzz/fuzz_targets/controller.rs", include_str!("new/rust/fuzz_target.rs")),
                ("controller.toml", include_str!("new/rust/controller.toml")),
                ("gates.toml", include_str!("new/gates.toml")),
                (".github/workflows/tests.yml", include_str!("new/rust/workflow.yml")),
                (".gitignore", include_str!("new/rust/gitignore")),
                ("README.md", include_str!("new/rust/README.md")),
            ],
            Self::Python => &[
                ("pyproject.toml", include_str!("new/python/pyproject.toml")),
                ("my_controller.py", include_str!("new/python/my_controller.py")),
                ("test_my_controller.py", include_str!("new/python/test_my_controller.py")),
                ("controller.toml", include_str!("new/python/controller.toml")),
                ("gates.toml", include_str!("new/gates.toml")),
                (".gitignore", include_str!("new/python/gitignore")),
                ("README.md", include_str!("new/python/README.md")),
            ],
            Self::C => &[
                ("my-controller.c", include_str!("../../examples/controllers/follower.c")),
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
        let name = folder.file_name().and_then(|name| name.to_str()).filter(|name| is_project_name(name));
        let Some(name) = name else {
            let problem = "is not the name of a project: use 1 to 40 of a-z, 0-9 and -, begin with a letter, \
                           and use no keyword or name of a module";
            return Err(CliError::at(folder, problem));
        };
        if folder.symlink_metadata().is_ok() {
            return Err(CliError::at(folder, "exists: choose a new folder"));
        }
        let [rust_source, python_source] = self.sources()?;
        let mut files = StagedFiles::default();
        for (path, text) in self.template.files() {
            let adapted = |text: &str| text.replace(NAME, name).replace(MODULE, &name.replace('-', "_"));
            let path = folder.join(adapted(path));
            let text = text.replace(RUST_SOURCE, &rust_source).replace(PYTHON_SOURCE, &python_source);
            path.parent().map_or(Ok(()), disk::make_folder)?;
            files.stage(&path, adapted(&text))?;
        }
        files.commit()?;
        output::note(&format!("created {}: README.md there lists its commands", folder.display()), quiet);
        Ok(())
    }

    /// Returns the dependency of a manifest of Cargo, and that of a Python project.
    fn sources(&self) -> Result<[String; 2], CliError> {
        let Some(folder) = &self.crumple else { return Ok([RUST_SOURCE, PYTHON_SOURCE].map(str::to_owned)) };
        let path = folder.canonicalize().ok().filter(|path| path.join("crates/testing").is_dir());
        // Both manifests quote the path in double quotes.
        let is_plain = |path: &&str| !path.contains(|letter: char| letter.is_control() || "\"\\".contains(letter));
        let path = path.as_deref().and_then(Path::to_str).filter(is_plain);
        let path = path.ok_or_else(|| CliError::at(folder, "is not a folder with the source of crumple"))?;
        Ok([format!("path = \"{path}/crates/testing\""), format!("file://{path}/python")])
    }
}

/// Keywords of Rust and Python, and crates and modules that a project would shadow.
const RESERVED_NAMES: &str = "abstract and as assert async await become box break class const continue core crate \
    crumple crumple-testing def del do dyn elif else enum except extern final finally fn for from gen global \
    hypothesis if impl import in is json lambda let libfuzzer-sys loop macro match mod move mut nonlocal not numpy or \
    os override pass priv pub pytest raise random ref return self static std struct super sys test trait try type \
    typeof unsafe unsized use virtual where while with yield";

fn is_project_name(name: &str) -> bool {
    !RESERVED_NAMES.split(' ').any(|reserved| reserved == name)
        && (1..=MAX_NAME_LENGTH).contains(&name.len())
        && name.starts_with(|letter: char| letter.is_ascii_lowercase())
        && name.bytes().all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-'))
}
