//! `crumple-verify FILE...`: accepts or rejects certificates.
//!
//! Exit code 0 if all are accepted, 1 if one is rejected, 2 if one is not a certificate.

use std::fs::File;
use std::path::Path;
use std::process::ExitCode;

use crumple_verify::{Certificate, ParseError, check};

fn main() -> ExitCode {
    let paths: Vec<_> = std::env::args_os().skip(1).collect();
    if paths.is_empty() {
        eprintln!("usage: crumple-verify FILE...");
        return ExitCode::from(2);
    }
    ExitCode::from(paths.iter().map(|path| judge(Path::new(path))).max().unwrap_or(2))
}

fn judge(path: &Path) -> u8 {
    let name = path.display();
    let certificate = match File::open(path).map_err(ParseError::from).and_then(Certificate::from_reader) {
        Ok(certificate) => certificate,
        Err(error) => {
            eprintln!("{name}: {error}");
            return 2;
        }
    };
    match check(&certificate) {
        Ok(accepted) => {
            println!("{name}: accepted: {accepted}");
            println!("  scenario {} of crumple {}", certificate.provenance.scenario, certificate.provenance.crumple);
            for assumption in &certificate.assumptions {
                println!("  assuming that {assumption}");
            }
            0
        }
        Err(rejection) => {
            println!("{name}: rejected: {rejection}");
            1
        }
    }
}
