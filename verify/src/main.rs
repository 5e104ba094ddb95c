//! `crumple-verify [--policy FILE] [--work-limit N] FILE...`: accepts or rejects certificates.
//!
//! Reads the policy that a certificate names from the certificate's folder, unless `--policy` gives it. Rejects a
//! certificate that takes more than N billion operations to check; by default 4000, about ten minutes of one core. Exit
//! code 0 if all are accepted, 1 if one is rejected, 2 if one is not a certificate.

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use crumple_verify::certificate::open_regular_file;
use crumple_verify::{Certificate, CertificateParseError, WorkLimit, check_with};

/// Maximum number of characters of an error.
const MAX_PROBLEM_CHARS: usize = 1000;

fn main() -> ExitCode {
    let mut words = std::env::args_os().skip(1).peekable();
    let mut policy = None;
    let mut limit = Some(WorkLimit::default());
    while let Some(option) = words.next_if(|word| word == "--policy" || word == "--work-limit") {
        let value = words.next();
        if option == "--policy" {
            policy = value;
        } else {
            limit = value
                .and_then(|value| value.to_str()?.parse().ok())
                .map(WorkLimit::from_billions);
        }
    }
    let policy = policy.as_ref().map(Path::new);
    let worst = limit.and_then(|limit| {
        words
            .map(|path| check_file(Path::new(&path), policy, limit))
            .max()
    });
    ExitCode::from(worst.unwrap_or_else(|| {
        eprintln!("usage: crumple-verify [--policy FILE] [--work-limit N] FILE...");
        2
    }))
}

/// Prints what an accepted certificate is about, and its assumptions.
fn print_details(certificate: &Certificate) {
    println!(
        "  {}",
        certificate.scope().to_string().replace('\n', "\n  ")
    );
    println!(
        "  version {}, SHA-256 of its canonical form {}",
        certificate.version,
        certificate.digest()
    );
    if let Some(caveat) = certificate.caveat() {
        println!("  {caveat}");
    }
    for assumption in &certificate.assumptions {
        println!("  assuming that {assumption}");
    }
}

fn check_file(path: &Path, policy: Option<&Path>, limit: WorkLimit) -> u8 {
    let name = path.display();
    let certificate = match open_regular_file(path)
        .map_err(CertificateParseError::from)
        .and_then(Certificate::from_reader)
    {
        Ok(certificate) => certificate,
        Err(error) => {
            // A token of the file may be as long as the file.
            let problem: String = error.to_string().chars().take(MAX_PROBLEM_CHARS).collect();
            let line = format!("{name}: {problem}\n");
            let _ = std::io::stderr().write_all(line.as_bytes());
            return 2;
        }
    };
    match check_with(
        &certificate,
        certificate.read_policy(path, policy).as_deref(),
        limit,
    ) {
        Ok(claim) => {
            println!("{name}: accepted: {claim}");
            print_details(&certificate);
            0
        }
        Err(rejection) => {
            println!("{name}: rejected: {rejection}");
            1
        }
    }
}
