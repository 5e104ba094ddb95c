//! `crumple-verify [--policy FILE] FILE...`: accepts or rejects certificates.
//!
//! A certificate about a policy names the policy file, which is expected beside it unless it is given.
//!
//! Exit code 0 if all are accepted, 1 if one is rejected, 2 if one is not a certificate.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::ExitCode;

use crumple_verify::certificate::MOST_BYTES;
use crumple_verify::{Certificate, ParseError, Statement, check_with};

fn main() -> ExitCode {
    let mut paths: Vec<_> = std::env::args_os().skip(1).collect();
    let policy = if paths.first().is_some_and(|first| first == "--policy") {
        paths.drain(..paths.len().min(2)).nth(1)
    } else {
        None
    };
    if paths.is_empty() {
        eprintln!("usage: crumple-verify [--policy FILE] FILE...");
        return ExitCode::from(2);
    }
    let policy = policy.as_ref().map(Path::new);
    ExitCode::from(paths.iter().map(|path| judge(Path::new(path), policy)).max().unwrap_or(2))
}

/// The policy file of a certificate; none if it needs none or the file cannot be read.
fn policy_of(certificate: &Certificate, path: &Path, policy: Option<&Path>) -> Option<Vec<u8>> {
    let Statement::Reach(claim) = &certificate.statement else { return None };
    let beside = path.with_file_name(Path::new(&claim.policy_file).file_name()?);
    let mut bytes = Vec::new();
    File::open(policy.unwrap_or(&beside)).ok()?.take(MOST_BYTES as u64).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

fn judge(path: &Path, policy: Option<&Path>) -> u8 {
    let name = path.display();
    let certificate = match File::open(path).map_err(ParseError::from).and_then(Certificate::from_reader) {
        Ok(certificate) => certificate,
        Err(error) => {
            eprintln!("{name}: {error}");
            return 2;
        }
    };
    match check_with(&certificate, policy_of(&certificate, path, policy).as_deref()) {
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
