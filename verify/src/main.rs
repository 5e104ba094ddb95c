//! Accepts or rejects certificates: `crumple-verify [--pool [--seeds RANGE]] [--policy FILE] [--work-limit N] FILE...`.
//!
//! With `--pool`, concludes one failure rate from the counts of several seeds ([`crumple_verify::pool`]). `--seeds
//! 0-99` states the expected seeds, of which none may be missing. Reads the policy that a certificate names from the
//! certificate's folder, unless `--policy` gives it. Rejects a certificate that takes more than N billion operations to
//! check; by default 4000, about ten minutes of one core. Exit code 0 if all are accepted, 1 if one is rejected, 2 if
//! one is not a certificate or an option cannot be used, 3 if standard output cannot be written. A closed output pipe
//! does not change the exit code.

use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};
use std::ops::RangeInclusive;
use std::path::Path;
use std::process::ExitCode;

use crumple_verify::certificate::UNVERIFIED_COUNTS_CAVEAT;
use crumple_verify::certificate::open_regular_file;
use crumple_verify::pool::{FIXED_RANGE_ASSUMPTION, UNSTATED_RANGE_CAVEAT, parse_seed_range};
use crumple_verify::{Certificate, CertificateParseError, Pool, PooledRate, WorkLimit, check_with};

/// Maximum number of characters of an error.
const MAX_PROBLEM_CHARS: usize = 1000;

const USAGE: &str =
    "usage: crumple-verify [--pool [--seeds RANGE]] [--policy FILE] [--work-limit N] FILE...";

/// Exit code if standard output cannot be written.
const UNPRINTED: u8 = 3;

/// Arguments of the program.
#[derive(Default)]
struct Request {
    files: Vec<OsString>,
    is_pool: bool,
    /// Expected seeds of the pool.
    seeds: Option<RangeInclusive<u64>>,
    policy: Option<OsString>,
    limit: WorkLimit,
}

/// Text of `--help` below the usage.
const HELP: &str = "\
Accepts or rejects certificates of crumple, without its code. Prints what each shows, and on which assumptions.

  --pool            conclude one failure rate from the counts of several seeds
  --seeds RANGE     expected seeds of the pool, such as 0-99: none may be missing
  --policy FILE     policy of the claim [default: the one next to the certificate]
  --work-limit N    billions of operations for each certificate [default: 4000, about ten minutes]

Exit codes: 0 all accepted, 1 one rejected, 2 unusable file or option, 3 output cannot be written
";

/// Returns the text of `--help` or `--version`, if one of them is the first argument.
fn requested_text() -> Option<String> {
    match std::env::args_os().nth(1)?.to_str()? {
        "--help" | "-h" => Some(format!("{USAGE}\n\n{HELP}")),
        "--version" | "-V" => Some(format!("crumple-verify {}\n", env!("CARGO_PKG_VERSION"))),
        _ => None,
    }
}

fn main() -> ExitCode {
    if let Some(text) = requested_text() {
        return ExitCode::from(print(&text, 0));
    }
    let request = match read_arguments(std::env::args_os().skip(1)) {
        Ok(request) => request,
        Err(problem) => {
            print_problem(&format!("{problem}\n{USAGE}"));
            return ExitCode::from(2);
        }
    };
    let files = request.files.iter().map(Path::new);
    let policy = request.policy.as_ref().map(Path::new);
    ExitCode::from(match request.is_pool {
        true => check_pool(files, request.seeds, request.limit),
        false => {
            let codes = files.map(|path| check_file(path, policy, request.limit));
            codes.max().unwrap_or_default()
        }
    })
}

/// Prints a result. Returns `code`; instead of 0, [`UNPRINTED`] after an error other than a closed pipe.
fn print(text: &str, code: u8) -> u8 {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            print_problem(&format!("standard output: {error}"));
            if code == 0 { UNPRINTED } else { code }
        }
        _ => code,
    }
}

/// Prints a line to standard error, and ignores that it may be closed.
fn print_problem(problem: &str) {
    let _ = io::stderr().write_all(format!("{problem}\n").as_bytes());
}

/// Reads options and files, in any order. Returns a message if they cannot be used.
fn read_arguments(mut words: impl Iterator<Item = OsString>) -> Result<Request, String> {
    let mut request = Request::default();
    while let Some(word) = words.next() {
        match word.to_str() {
            Some("--pool") => request.is_pool = true,
            Some("--seeds") if request.seeds.is_some() => {
                return Err("--seeds is given twice".to_owned());
            }
            Some("--seeds") => {
                let value = words.next();
                let seeds = value
                    .as_ref()
                    .and_then(|value| value.to_str())
                    .unwrap_or_default();
                let seeds = parse_seed_range(seeds).map_err(|error| format!("--seeds {error}"))?;
                request.seeds = Some(seeds);
            }
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
    match request {
        Request { files, .. } if files.is_empty() => Err("no file is given".to_owned()),
        Request {
            is_pool: false,
            seeds: Some(_),
            ..
        } => Err("--seeds needs --pool".to_owned()),
        request => Ok(request),
    }
}

/// Describes the scope of an accepted certificate, and its assumptions.
fn describe_details(certificate: &Certificate) -> String {
    let own = [
        certificate.scope().to_string().replace('\n', "\n  "),
        format!(
            "version {}, SHA-256 of its canonical form {}",
            certificate.version,
            certificate.digest()
        ),
    ];
    let assumptions = describe_assumptions(&certificate.assumptions);
    indent(
        own.into_iter()
            .chain(certificate.caveat().map(str::to_owned))
            .chain(assumptions),
    )
}

fn describe_assumptions(assumptions: &[impl Display]) -> impl Iterator<Item = String> {
    assumptions
        .iter()
        .map(|assumption| format!("assuming that {assumption}"))
}

fn indent(lines: impl Iterator<Item = String>) -> String {
    lines.map(|line| format!("  {line}\n")).collect()
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
            print_problem(&format!("{}: {problem}", path.display()));
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
            let details = describe_details(&certificate);
            print(&format!("{name}: accepted: {claim}\n{details}"), 0)
        }
        Err(rejection) => print(&format!("{name}: rejected: {rejection}\n"), 1),
    }
}

/// Concludes one rate from all files, and prints it. Reads one file after the other.
fn check_pool<'a>(
    files: impl Iterator<Item = &'a Path>,
    seeds: Option<RangeInclusive<u64>>,
    limit: WorkLimit,
) -> u8 {
    let mut pool = seeds.map_or_else(Pool::default, Pool::of_seeds);
    for path in files {
        let Some(certificate) = read_certificate(path) else {
            return 2;
        };
        if let Err(rejection) = pool.add(&certificate, limit) {
            let line = format!("pool: rejected: {}: {rejection}\n", path.display());
            return print(&line, 1);
        }
    }
    match pool.conclude(limit) {
        Ok(claim) => print(&describe_pool(&claim, pool.len()), 0),
        Err(rejection) => print(&format!("pool: rejected: {rejection}\n"), 1),
    }
}

fn describe_pool(claim: &PooledRate, certificates: usize) -> String {
    let plural = if certificates == 1 { "" } else { "s" };
    let own = [
        format!(
            "counted: {} failures in {} runs",
            claim.failures, claim.runs
        ),
        claim.scope.to_string().replace('\n', "\n  "),
        format!(
            "SHA-256 of the digests of the certificates {}",
            claim.sha256
        ),
        UNVERIFIED_COUNTS_CAVEAT.to_owned(),
    ];
    let caveat = (!claim.is_expected_range).then(|| UNSTATED_RANGE_CAVEAT.to_owned());
    let assumptions = describe_assumptions(&claim.assumptions)
        .chain(describe_assumptions(&[FIXED_RANGE_ASSUMPTION]));
    format!(
        "pool of {certificates} certificate{plural}: accepted: {claim}\n{}",
        indent(own.into_iter().chain(caveat).chain(assumptions))
    )
}
