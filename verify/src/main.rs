//! `crumple-verify [--pool] [--policy FILE] [--work-limit N] FILE...`: accepts or rejects certificates.
//!
//! With `--pool`, concludes one failure rate from the counts of several seeds ([`crumple_verify::pool`]).
//! Reads the policy that a certificate names from the certificate's folder, unless `--policy` gives it. Rejects a
//! certificate that takes more than N billion operations to check; by default 4000, about ten minutes of one core. Exit
//! code 0 if all are accepted, 1 if one is rejected, 2 if one is not a certificate or an option is unknown.

use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use crumple_verify::certificate::UNVERIFIED_COUNTS_CAVEAT;
use crumple_verify::certificate::open_regular_file;
use crumple_verify::pool::FIXED_RANGE_ASSUMPTION;
use crumple_verify::{Certificate, CertificateParseError, Pool, PooledRate, WorkLimit, check_with};

/// Maximum number of characters of an error.
const MAX_PROBLEM_CHARS: usize = 1000;

const USAGE: &str = "usage: crumple-verify [--pool] [--policy FILE] [--work-limit N] FILE...";

/// Arguments of the program.
#[derive(Default)]
struct Request {
    files: Vec<OsString>,
    is_pool: bool,
    policy: Option<OsString>,
    limit: WorkLimit,
}

fn main() -> ExitCode {
    let request = match read_arguments(std::env::args_os().skip(1)) {
        Ok(request) => request,
        Err(problem) => {
            eprintln!("{problem}\n{USAGE}");
            return ExitCode::from(2);
        }
    };
    let files = request.files.iter().map(Path::new);
    let policy = request.policy.as_ref().map(Path::new);
    ExitCode::from(match request.is_pool {
        true => check_pool(files, request.limit),
        false => {
            let codes = files.map(|path| check_file(path, policy, request.limit));
            codes.max().unwrap_or_default()
        }
    })
}

/// Reads options and files, in any order. Returns a message if they cannot be used.
fn read_arguments(mut words: impl Iterator<Item = OsString>) -> Result<Request, String> {
    let mut request = Request::default();
    while let Some(word) = words.next() {
        match word.to_str() {
            Some("--pool") => request.is_pool = true,
            Some("--policy") => {
                request.policy = Some(words.next().ok_or("--policy needs a file")?);
            }
            Some("--work-limit") => {
                let value = words.next();
                let billions = value.and_then(|value| value.to_str()?.parse().ok());
                let billions = billions.ok_or("--work-limit needs a whole number")?;
                request.limit = WorkLimit::from_billions(billions);
            }
            _ if word.as_encoded_bytes().starts_with(b"--") => {
                return Err(format!(
                    "unknown option {word:?}; write a file of that name as ./--NAME"
                ));
            }
            _ => request.files.push(word),
        }
    }
    match request.files.is_empty() {
        true => Err("no file is given".to_owned()),
        false => Ok(request),
    }
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

/// Reads a certificate; prints why a file is none.
fn read_certificate(path: &Path) -> Option<Certificate> {
    let read = open_regular_file(path)
        .map_err(CertificateParseError::from)
        .and_then(Certificate::from_reader);
    match read {
        Ok(certificate) => Some(certificate),
        Err(error) => {
            // A token of the file may be as long as the file.
            let problem: String = error.to_string().chars().take(MAX_PROBLEM_CHARS).collect();
            let line = format!("{}: {problem}\n", path.display());
            let _ = std::io::stderr().write_all(line.as_bytes());
            None
        }
    }
}

fn check_file(path: &Path, policy: Option<&Path>, limit: WorkLimit) -> u8 {
    let name = path.display();
    let Some(certificate) = read_certificate(path) else {
        return 2;
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

/// Concludes one rate from all files, and prints it. Reads one file after the other.
fn check_pool<'a>(files: impl Iterator<Item = &'a Path>, limit: WorkLimit) -> u8 {
    let mut pool = Pool::default();
    for path in files {
        let Some(certificate) = read_certificate(path) else {
            return 2;
        };
        if let Err(rejection) = pool.add(&certificate, limit) {
            println!("pool: rejected: {}: {rejection}", path.display());
            return 1;
        }
    }
    match pool.conclude(limit) {
        Ok(claim) => {
            print_pool(&claim, pool.len());
            0
        }
        Err(rejection) => {
            println!("pool: rejected: {rejection}");
            1
        }
    }
}

fn print_pool(claim: &PooledRate, certificates: usize) {
    let plural = if certificates == 1 { "" } else { "s" };
    println!("pool of {certificates} certificate{plural}: accepted: {claim}");
    println!(
        "  counted: {} failures in {} runs",
        claim.failures, claim.runs
    );
    println!("  {}", claim.scope.to_string().replace('\n', "\n  "));
    println!(
        "  SHA-256 of the digests of the certificates {}",
        claim.sha256
    );
    println!("  {UNVERIFIED_COUNTS_CAVEAT}");
    for assumption in &claim.assumptions {
        println!("  assuming that {assumption}");
    }
    println!("  assuming that {FIXED_RANGE_ASSUMPTION}");
}
