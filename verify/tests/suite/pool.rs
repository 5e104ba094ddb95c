//! Pools of counts: one bound for all seeds of a range, and refusals.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crumple_verify::pool::parse_seed_range;
use crumple_verify::rate::binomial_tail_upper_bound;
use crumple_verify::{
    Assumption, Certificate, CertificateProvenance, Pool, PoolRejection, RateClaim, Registration,
    Rejection, Statement, WorkLimit,
};
use proptest::prelude::*;
use sha2::{Digest, Sha256};

const TEXT: &str = "a space";

fn sha256(text: &str) -> String {
    let digest = Sha256::digest(text);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn count(seed: u64, runs: u64, failures: u64) -> Certificate {
    let sha = sha256(TEXT);
    let entries = [
        ("controller", "policy"),
        ("controller_sha256", &sha),
        ("crumple", "0.3.0"),
        ("estimator", "kalman"),
        ("failure", "vehicles touch"),
        ("horizon_s", "14"),
        ("seed", &seed.to_string()),
        ("space", "paper"),
        ("space_sha256", &sha),
    ];
    let entries = entries.map(|(key, value)| (key.to_owned(), value.to_owned()));
    let registration = Registration {
        configuration: BTreeMap::from(entries),
        runs,
        confidence: 0.99,
        block_runs: Some(runs),
    };
    Certificate {
        version: 2,
        provenance: CertificateProvenance {
            crumple: "0.3.0".to_owned(),
            scenario: "paper".to_owned(),
            scenario_sha256: sha,
            scenario_text: Some(TEXT.to_owned()),
            box_text: None,
        },
        assumptions: vec![Assumption::RegisteredDraws],
        statement: Statement::Rate(RateClaim {
            registration_sha256: registration.digest(),
            registration,
            failures,
            rate_at_most: match failures {
                _ if runs > 1_000_000 => 1e-6,
                0..900 => 0.999,
                _ => 1.0,
            },
            blocks: vec![(failures, sha256(&format!("runs of {seed}")))],
        }),
    }
}

/// Returns a count with so many blocks of 100 runs.
fn count_in_blocks(seed: u64, blocks: usize) -> Certificate {
    let mut certificate = count(seed, 100 * blocks as u64, 0);
    if let Statement::Rate(claim) = &mut certificate.statement {
        claim.registration.block_runs = Some(100);
        claim.registration_sha256 = claim.registration.digest();
        claim.blocks = (0..blocks)
            .map(|block| (0, sha256(&format!("block {block} of {seed}"))))
            .collect();
    }
    certificate
}

fn blocks_of(certificate: &mut Certificate) -> &mut Vec<(u64, String)> {
    match &mut certificate.statement {
        Statement::Rate(claim) => &mut claim.blocks,
        other => panic!("not a rate: {other:?}"),
    }
}

fn changed(seed: u64, change: impl FnOnce(&mut RateClaim)) -> Certificate {
    let mut certificate = count(seed, 1000, 3);
    if let Statement::Rate(claim) = &mut certificate.statement {
        change(claim);
        claim.registration_sha256 = claim.registration.digest();
    }
    certificate
}

fn pool(certificates: &[Certificate]) -> Result<Pool, PoolRejection> {
    let mut pool = Pool::default();
    for certificate in certificates {
        pool.add(certificate, WorkLimit::default())?;
    }
    Ok(pool)
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(64))]

    /// The bound is that of one count of all runs, in any order: accepted, and hardly above the smallest.
    #[test]
    fn the_bound_of_a_range_is_that_of_all_runs_together(
        first in 0..1_000_000_u64,
        failures in prop::collection::vec(prop_oneof![0..40_u64, Just(1000)], 1..20),
        turn in 0..20_usize,
    ) {
        let mut certificates: Vec<Certificate> = (first..)
            .zip(&failures)
            .map(|(seed, failures)| count(seed, 1000, *failures))
            .collect();
        let turns = turn % certificates.len();
        certificates.rotate_left(turns);
        let claim = pool(&certificates).unwrap().conclude(WorkLimit::default()).unwrap();
        let [runs, sum] = [1000 * failures.len() as u64, failures.iter().sum()];
        prop_assert_eq!((claim.runs, claim.failures, claim.first_seed), (runs, sum, first));
        prop_assert_eq!(claim.last_seed, first + failures.len() as u64 - 1);
        if sum == runs {
            prop_assert_eq!(claim.max_rate, 1.0);
            return Ok(());
        }
        let tail = |rate: f64| binomial_tail_upper_bound(sum, runs, rate);
        prop_assert!(tail(claim.max_rate) <= 0.01 * (1.0 + 1e-9));
        prop_assert!(tail(claim.max_rate * (1.0 - 1e-5)) > 0.01);
    }

    /// A copy of any block is refused, in the same certificate or another one. The pool stays as it was.
    #[test]
    fn copied_blocks_are_refused(
        seeds in 1..4_u64,
        blocks in 1..5_usize,
        from in (0..4_u64, 0..5_usize),
        to in 0..5_usize,
    ) {
        let mut certificates: Vec<_> = (0..seeds).map(|seed| count_in_blocks(seed, blocks)).collect();
        let (copied_seed, copied_block) = (from.0 % seeds, from.1 % blocks);
        let last = seeds as usize - 1;
        let to = to % blocks;
        let hash = blocks_of(&mut certificates[copied_seed as usize])[copied_block].1.clone();
        blocks_of(&mut certificates[last])[to].1 = hash;
        let mut kept = pool(&certificates[..last]).unwrap();
        let added = kept.add(&certificates[last], WorkLimit::default());
        let is_itself = (copied_seed as usize, copied_block) == (last, to);
        if is_itself {
            prop_assert_eq!(added, Ok(()));
            return Ok(());
        }
        let (block, other_block) = match copied_seed as usize == last {
            true => (to.max(copied_block), to.min(copied_block)),
            false => (to, copied_block),
        };
        let other_seed = copied_seed;
        prop_assert_eq!(added, Err(PoolRejection::CopiedRuns { block, other_seed, other_block }));
        kept.add(&count_in_blocks(last as u64, blocks), WorkLimit::default()).unwrap();
        prop_assert_eq!(kept.len() as u64, seeds);
    }

    /// With an expected range, any omission is refused, and any other seed.
    #[test]
    fn pools_without_the_expected_seeds_are_refused(
        seeds in prop::collection::btree_set(0..8_u64, 1..8),
        ends in (0..8_u64, 0..8_u64),
    ) {
        let [first, last] = [ends.0.min(ends.1), ends.0.max(ends.1)];
        let mut expected = Pool::of_seeds(first..=last);
        for &seed in &seeds {
            let added = expected.add(&count(seed, 1000, 1), WorkLimit::default());
            if !(first..=last).contains(&seed) {
                prop_assert_eq!(added, Err(PoolRejection::UnexpectedSeed { seed, first, last }));
                return Ok(());
            }
            prop_assert_eq!(added, Ok(()));
        }
        let concluded = expected.conclude(WorkLimit::default());
        let missing: Vec<_> = (first..=last).filter(|seed| !seeds.contains(seed)).collect();
        match missing.first() {
            None => {
                let claim = concluded.unwrap();
                prop_assert_eq!((claim.first_seed, claim.last_seed), (first, last));
                prop_assert!(claim.is_expected_range);
            }
            Some(&gap) => prop_assert_eq!(concluded.unwrap_err(), PoolRejection::MissingSeeds {
                first, last, missing: gap, count: missing.len() as u64,
            }),
        }
    }

    /// Any omission between the ends is refused, with the first missing seed.
    #[test]
    fn gaps_are_refused(seeds in prop::collection::btree_set(0..12_u64, 1..12)) {
        let certificates: Vec<_> = seeds.iter().map(|&seed| count(seed, 1000, 1)).collect();
        let concluded = pool(&certificates).unwrap().conclude(WorkLimit::default());
        let (first, last) = (*seeds.first().unwrap(), *seeds.last().unwrap());
        let missing: Vec<_> = (first..last).filter(|seed| !seeds.contains(seed)).collect();
        match missing.first() {
            None => prop_assert!(concluded.is_ok()),
            Some(&gap) => prop_assert_eq!(concluded.unwrap_err(), PoolRejection::MissingSeeds {
                first, last, missing: gap, count: missing.len() as u64,
            }),
        }
    }
}

#[test]
fn certificates_that_differ_in_more_than_seed_and_counts_are_refused() {
    let entry = |key: &'static str, value: &'static str| {
        move |claim: &mut RateClaim| {
            let entries = &mut claim.registration.configuration;
            entries.insert(key.to_owned(), value.to_owned());
        }
    };
    let others = [
        (
            "registration.configuration.controller",
            changed(8, entry("controller", "idm")),
        ),
        (
            "registration.configuration.estimator",
            changed(8, entry("estimator", "truth")),
        ),
        (
            "registration.configuration.horizon_s",
            changed(8, entry("horizon_s", "15")),
        ),
        ("registration.runs", count(8, 2000, 3)),
        (
            "registration",
            changed(8, |claim| claim.registration.confidence = 0.9),
        ),
    ];
    for (field, other) in others {
        let field = field.to_owned();
        let refused = pool(&[count(7, 1000, 3), other]).unwrap_err();
        assert_eq!(refused, PoolRejection::OtherConfiguration { field });
    }
    let repeated = pool(&[count(7, 1000, 3), count(8, 1000, 2), count(7, 1000, 4)]);
    assert_eq!(
        repeated.unwrap_err(),
        PoolRejection::RepeatedSeed { seed: 7 }
    );
    let false_count = changed(8, |claim| claim.failures = 2);
    let rejected = pool(&[count(7, 1000, 3), false_count]).unwrap_err();
    assert!(matches!(
        rejected,
        PoolRejection::Certificate(Rejection::Invalid { .. })
    ));
    let mut old = count(8, 1000, 3);
    old.version = 1;
    assert_eq!(pool(&[old]).unwrap_err(), PoolRejection::FirstVersion);
    let limit = WorkLimit::default();
    assert_eq!(
        Pool::default().conclude(limit).unwrap_err(),
        PoolRejection::Empty
    );
    let million = 1_000_000_000;
    let large = pool(&[count(7, million, 0), count(8, million, 0)]).unwrap();
    let too_many = PoolRejection::TooManyRuns { runs: 2 * million };
    assert_eq!(large.conclude(limit).unwrap_err(), too_many);
}

#[test]
fn ranges_of_seeds_are_read() {
    assert_eq!(parse_seed_range("0-99"), Ok(0..=99));
    assert_eq!(parse_seed_range("7"), Ok(7..=7));
    for text in [
        "", "-", "5-", "-5", "9-3", "0-9-9", "a-b", "0..9", "1.0", " 1",
    ] {
        assert!(parse_seed_range(text).is_err(), "{text}");
    }
}

/// Writes the certificates of the seeds 4, 5 and 6 in a folder; all runs of seed 6 fail.
fn write_three_files(folder: &Path) -> [PathBuf; 3] {
    std::fs::create_dir_all(folder).unwrap();
    [(4, 4), (5, 5), (6, 1000)].map(|(seed, failures)| {
        let path = folder.join(format!("{seed}.json"));
        std::fs::write(&path, count(seed, 1000, failures).to_canonical_json()).unwrap();
        path
    })
}

#[cfg(target_os = "linux")]
#[test]
fn the_program_ends_quietly_if_its_output_is_closed() {
    let folder = std::env::temp_dir().join(format!("crumple-pipe-{}", std::process::id()));
    let [path, ..] = write_three_files(&folder);
    let run = |options: &[&str], output: Stdio| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_crumple-verify"));
        let run = command.args(options).arg(&path).stdout(output).output();
        let run = run.unwrap();
        (
            run.status.code().unwrap(),
            String::from_utf8(run.stderr).unwrap(),
        )
    };
    let closed_pipe = || {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        Stdio::from(writer)
    };
    for options in [&["--pool"][..], &["--pool", "--seeds", "4"], &[]] {
        assert_eq!(run(options, closed_pipe()), (0, String::new()));
    }
    assert_eq!(
        run(&["--pool", "--seeds", "5"], closed_pipe()),
        (1, String::new())
    );
    let full = std::fs::File::create("/dev/full").unwrap();
    let (code, problem) = run(&[], full.into());
    assert!(
        code == 3 && problem.starts_with("standard output: "),
        "{code} {problem}"
    );
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_program_pools_files() {
    let folder = std::env::temp_dir().join(format!("crumple-pool-{}", std::process::id()));
    let paths = write_three_files(&folder);
    let run_with = |options: &[&str], paths: &[&PathBuf]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_crumple-verify"));
        let output = command.args(options).args(paths).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        (output.status.code().unwrap(), text)
    };
    let run = |paths: &[&PathBuf]| run_with(&["--pool"], paths);
    let (code, text) = run(&[&paths[1], &paths[2], &paths[0]]);
    let begin = "pool of 3 certificates: accepted: rate: at most 0.35";
    assert!(code == 0 && text.starts_with(begin), "{text}");
    assert!(text.contains("for the seeds 4 to 6 together"), "{text}");
    assert!(
        text.contains("counted: 1009 failures in 3000 runs"),
        "{text}"
    );
    assert!(text.contains("(--seeds)"), "{text}");
    assert!(
        text.contains("assuming that the range of seeds was fixed"),
        "{text}"
    );
    let (code, text) = run(&[&paths[0], &paths[2]]);
    let gap = "pool: rejected: the seeds 4 to 6 are incomplete: 1 seed is missing, the first of them is 5\n";
    assert_eq!((code, text.as_str()), (1, gap));
    let (code, text) = run(&[&paths[1]]);
    let begin = "pool of 1 certificate: accepted: rate: at most 0.0";
    assert!(code == 0 && text.starts_with(begin), "{text}");
    assert!(text.contains("for seed 5, if"), "{text}");
    let (code, text) = run(&[&paths[2]]);
    let begin =
        "pool of 1 certificate: accepted: rate: no bound below 1 at confidence 0.99, for seed 6";
    assert!(code == 0 && text.starts_with(begin), "{text}");
    let run_expecting = |seeds: &str| {
        let options = ["--pool", "--seeds", seeds];
        run_with(&options, &[&paths[0], &paths[1], &paths[2]])
    };
    let (code, text) = run_expecting("4-6");
    assert!(code == 0 && !text.contains("--seeds"), "{text}");
    let missing = "pool: rejected: the seeds 4 to 8 are incomplete: 2 seeds are missing, the first of them is 7\n";
    assert_eq!(run_expecting("4-8"), (1, missing.to_owned()));
    let (code, text) = run_expecting("4-5");
    let other = "6.json: seed 6 is outside the expected range 4-5\n";
    assert!(code == 1 && text.ends_with(other), "{text}");
    assert_eq!(run_expecting("6-4").0, 2);
    assert_eq!(run_with(&["--seeds", "4-6"], &[&paths[0]]).0, 2);
    assert_eq!(run(&[]).0, 2);
    assert_eq!(run(&[&folder.join("absent.json")]).0, 2);
    std::fs::remove_dir_all(&folder).unwrap();
}
