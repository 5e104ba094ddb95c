//! `crumple-verify [--policy FILE] FILE...`: accepts or rejects certificates.
//!
//! A certificate about a policy names the policy file, which is expected beside it unless it is given.
//!
//! Exit code 0 if all are accepted, 1 if one is rejected, 2 if one is not a certificate.

use std::fs::File;
use std::path::Path;
use std::process::ExitCode;

use crumple_verify::{Certificate, ParseError, check_with};

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

fn judge(path: &Path, policy: Option<&Path>) -> u8 {
    let name = path.display();
    let certificate = match File::open(path).map_err(ParseError::from).and_then(Certificate::from_reader) {
        Ok(certificate) => certificate,
        Err(error) => {
            eprintln!("{name}: {error}");
            return 2;
        }
    };
    match check_with(&certificate, certificate.policy_bytes(path, policy).as_deref()) {
        Ok(accepted) => {
            println!("{name}: accepted: {accepted}");
            // Whoever wrote the file chose these words: nothing in them may steer a terminal.
            let [scenario, crumple] =
                [&certificate.provenance.scenario, &certificate.provenance.crumple].map(|text| text.escape_debug());
            println!("  scenario {scenario} of crumple {crumple}");
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
