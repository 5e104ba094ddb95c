//! `crumple doctor`: capabilities of this build on this machine.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use clap::Args;
use serde::Serialize;

use super::feature::{FEATURES, Feature};
use super::output_format::OutputFormat;
use super::{CliError, output};

/// Show what this build can do on this machine, and what the rest requires
#[derive(Args)]
pub(super) struct Doctor {
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Serialize)]
struct DoctorReport {
    version: &'static str,
    system: &'static str,
    processor: &'static str,
    /// Width of the widest vector registers that the program and the processor share. Affects times, never results.
    register_bits: usize,
    /// True if the processor has fused multiply-add. Without it networks are slow, with the same results.
    fused_multiply_add: bool,
    threads: usize,
    /// SHA-256 of the program: only the same program can resume interrupted work.
    program_sha256: Option<&'static str>,
    features: [Feature; 4],
    needs: Vec<Dependency>,
}

/// External program that a part of crumple needs.
#[derive(Serialize)]
struct Dependency {
    name: &'static str,
    found: Option<String>,
    used_for: &'static str,
    install: &'static str,
}

impl Doctor {
    pub(super) fn run(self) -> Result<(), CliError> {
        let report = DoctorReport {
            version: env!("CARGO_PKG_VERSION"),
            system: std::env::consts::OS,
            processor: std::env::consts::ARCH,
            register_bits: 64 * crumple_sim::policy::f64_lanes(),
            fused_multiply_add: crumple_sim::policy::has_fused_multiply_add(),
            threads: rayon::current_num_threads(),
            program_sha256: crumple_store::program::identity().ok(),
            features: FEATURES,
            needs: dependencies(),
        };
        let text = match self.format {
            OutputFormat::Json => serde_json::to_string(&report).map_err(CliError::input)? + "\n",
            OutputFormat::Text => report.text(),
        };
        output::print(&text)
    }
}

impl DoctorReport {
    fn text(&self) -> String {
        let Self {
            version,
            system,
            processor,
            register_bits,
            fused_multiply_add,
            threads,
            ..
        } = self;
        let mut text = format!(
            "crumple {version} on {system}, {processor}, vector registers of {register_bits} bits, {threads} threads\n"
        );
        match &self.program_sha256 {
            Some(identity) => {
                let _ = writeln!(text, "  SHA-256 of this program: {identity}");
            }
            None => text.push_str(
                "  crumple cannot read its program file, so it cannot resume interrupted work\n",
            ),
        }
        if !fused_multiply_add {
            text += "  this processor has no fused multiply-add: networks are slower, with the same results\n";
        }
        self.features
            .iter()
            .for_each(|feature| write_feature(&mut text, feature));
        text += "  crumple needs nothing else; optional programs:\n";
        self.needs
            .iter()
            .for_each(|dependency| write_dependency(&mut text, dependency));
        text
    }
}

fn write_feature(text: &mut String, feature: &Feature) {
    let Feature {
        name,
        used_for,
        enabled,
    } = feature;
    let state = if *enabled {
        "compiled in".to_owned()
    } else {
        format!("missing: {}", feature.install_command())
    };
    let _ = writeln!(text, "  feature {name:<10}{used_for}\n{:20}{state}", "");
}

fn write_dependency(text: &mut String, dependency: &Dependency) {
    let Dependency {
        name,
        found,
        used_for,
        install,
    } = dependency;
    let path = found
        .as_ref()
        .map_or_else(|| format!("not found: {install}"), Clone::clone);
    let _ = writeln!(text, "    {name:<16}{used_for}\n{:20}{path}", "");
}

fn dependencies() -> Vec<Dependency> {
    let python = ["python3", "python"].into_iter().find_map(find_program);
    vec![
        Dependency {
            name: "crumple-fmu",
            found: crumple_process::find_fmu_host().map(display_path),
            used_for: "FMUs as controllers",
            install: "`cargo install --locked --path .` in a clone installs it; CRUMPLE_FMU can contain its path",
        },
        Dependency {
            name: "python",
            found: python.clone().map(display_path),
            used_for: "controllers in Python",
            install: "https://www.python.org",
        },
        Dependency {
            name: "crumple module",
            found: python.and_then(|python| find_module(&python, "crumple")),
            used_for: "notebooks, Gymnasium, callables as controllers",
            install: "pip install ./python",
        },
        Dependency {
            name: "cargo-fuzz",
            found: find_program("cargo-fuzz").map(display_path),
            used_for: "`cargo fuzz run scenario -s none`, in a clone",
            install: "cargo install cargo-fuzz",
        },
    ]
}

fn display_path(path: PathBuf) -> String {
    path.display().to_string()
}

/// Returns the file of a Python module, if Python finds it.
fn find_module(python: &Path, name: &str) -> Option<String> {
    let script = format!(
        "import importlib.util as u; s = u.find_spec('{name}'); print(s.origin if s else '')"
    );
    program_output(Command::new(python).args(["-I", "-c", &script]))
        .filter(|origin| !origin.is_empty())
}

fn find_program(name: &str) -> Option<PathBuf> {
    let file = format!("{name}{}", std::env::consts::EXE_SUFFIX);
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .filter(|folder| folder.is_absolute())
        .map(|folder| folder.join(&file))
        .find(|at| is_program(at))
}

#[cfg(unix)]
fn is_program(path: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    path.metadata()
        .is_ok_and(|metadata| metadata.is_file() && metadata.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn is_program(path: &Path) -> bool {
    path.is_file()
}

/// Returns the standard output of a program, if it succeeds.
fn program_output(command: &mut Command) -> Option<String> {
    let output = command
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
