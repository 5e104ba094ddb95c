//! Forged pools of counts: a seed twice, a seed left out, another configuration, changed counts.

use std::fs;
use std::ops::{Range, RangeInclusive};

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_evidence::{BlockSelection, PoolCheck, PoolError, RateConfig, RatePlan, RerunError};
use crumple_sim::control::BuiltInController;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::built_in_space;
use crumple_store::study::Study;
use crumple_verify::pool::PooledRate;
use crumple_verify::{Certificate, Pool, PoolRejection, RateClaim, WorkLimit};
use rand::rngs::Xoshiro256PlusPlus;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::rates::rate_claim;

const SEEDS: u64 = 4;
const FIRST_SEED: u64 = 7;
/// Runs of a seed: two blocks, of 100 and 10 runs.
const RUNS: u64 = 110;

/// Number of seeds of the pool whose forgeries are refused before any run is repeated.
const SHORT_SEEDS: u64 = 40;
/// Runs of each of these seeds.
const SHORT_RUNS: u64 = 10;

fn config(controller: &str, space: &str, seed: u64) -> RateConfig {
    RateConfig {
        seed,
        estimator: EstimatorKind::Truth,
        ..RateConfig::new(
            BuiltInController::from_name(controller).unwrap(),
            built_in_space(space).unwrap(),
            RUNS,
        )
    }
}

fn short_config(controller: &str, space: &str, seed: u64) -> RateConfig {
    RateConfig {
        runs: SHORT_RUNS,
        ..config(controller, space, seed)
    }
}

fn count(config: RateConfig) -> Certificate {
    let folder = tempfile::tempdir().unwrap();
    let plan = RatePlan::new(config).unwrap();
    let counted = plan.run(folder.path(), false, &Quiet).unwrap();
    counted.certificate.unwrap()
}

fn genuine_pool() -> Vec<Certificate> {
    count_seeds(FIRST_SEED..FIRST_SEED + SEEDS)
}

fn count_seeds(seeds: Range<u64>) -> Vec<Certificate> {
    seeds
        .map(|seed| count(config("baseline", "high-risk", seed)))
        .collect()
}

/// Certificates from which forgers make pools.
struct Material {
    /// A few seeds of two blocks each.
    genuine: Vec<Certificate>,
    /// Two seeds like them, after the last one.
    outside: Vec<Certificate>,
    /// Many seeds of few runs.
    short: Vec<Certificate>,
    /// Fields of the configuration, each with certificates of the short seeds that differ in it.
    strangers: Vec<(&'static str, Vec<Certificate>)>,
}

impl Material {
    fn count() -> Self {
        let seeds = FIRST_SEED..FIRST_SEED + SHORT_SEEDS;
        let count_all = |change: fn(RateConfig) -> RateConfig| {
            let configs = seeds.clone().into_par_iter();
            let configs = configs.map(|seed| change(short_config("idm", "high-risk", seed)));
            configs.map(count).collect()
        };
        Self {
            genuine: genuine_pool(),
            outside: count_seeds(FIRST_SEED + SEEDS..FIRST_SEED + SEEDS + 2),
            short: count_all(|config| config),
            strangers: CHANGES
                .iter()
                .map(|&(field, change)| (field, count_all(change)))
                .collect(),
        }
    }
}

/// A change of a configuration.
type ConfigChange = fn(RateConfig) -> RateConfig;

/// Changes of a configuration, each with the field of the certificate that the checker names.
const CHANGES: [(&str, ConfigChange); 5] = [
    ("registration.configuration.controller", |config| {
        short_config("predictive", "high-risk", config.seed)
    }),
    ("registration.configuration.horizon_s", |config| {
        short_config("idm", "paper", config.seed)
    }),
    ("registration.configuration.estimator", |config| {
        RateConfig {
            estimator: EstimatorKind::Kalman,
            ..config
        }
    }),
    ("registration", |config| RateConfig {
        confidence: 0.9,
        ..config
    }),
    ("registration.runs", |config| RateConfig {
        runs: SHORT_RUNS + 1,
        ..config
    }),
];

/// Checks a pool, and repeats all of its runs.
fn check_pool(certificates: &[Certificate]) -> Result<PooledRate, PoolError> {
    check_added(
        PoolCheck::new(WorkLimit::default(), Controllers::default()),
        certificates,
    )
}

fn check_added(pool: PoolCheck, certificates: &[Certificate]) -> Result<PooledRate, PoolError> {
    let mut pool = pool.with_rerun(Vec::new());
    for certificate in certificates {
        // A forger writes a file.
        let read = Certificate::from_json(&certificate.to_canonical_json()).unwrap();
        pool.add(&read)?;
    }
    let report = pool.conclude()?;
    let rerun = pool.rerun().unwrap();
    rerun.confirm(BlockSelection::All, &Quiet)?;
    Ok(report.claim)
}

/// Checks a pool with the checker alone, which repeats no runs.
fn check_alone(mut pool: Pool, certificates: &[Certificate]) -> Result<PooledRate, PoolRejection> {
    for certificate in certificates {
        pool.add(certificate, WorkLimit::default())?;
    }
    pool.conclude(WorkLimit::default())
}

fn change_claim(certificate: &mut Certificate, change: impl FnOnce(&mut RateClaim)) {
    let claim = rate_claim(&mut certificate.statement);
    change(claim);
    claim.registration_sha256 = claim.registration.digest();
    claim.failures = claim.blocks.iter().map(|(failures, _)| failures).sum();
    // Follows from any number of failures below that of runs.
    claim.rate_at_most = match claim.failures == claim.registration.runs {
        true => 1.0,
        false => 0.999_999,
    };
}

fn set_seed(certificate: &mut Certificate, seed: u64) {
    change_claim(certificate, |claim| {
        let configuration = &mut claim.registration.configuration;
        configuration.insert("seed".to_owned(), seed.to_string());
    });
}

fn random_hash(random: &mut Xoshiro256PlusPlus) -> String {
    (0..4)
        .map(|_| format!("{:016x}", random.random::<u64>()))
        .collect()
}

/// Changes the failures of a block, and repairs everything that follows from them. Fewer than all of its runs fail.
fn change_counts(certificate: &mut Certificate, block: usize, random: &mut Xoshiro256PlusPlus) {
    change_claim(certificate, |claim| {
        let runs = if block == 0 { 100 } else { RUNS - 100 };
        let (failures, _) = &mut claim.blocks[block];
        *failures = (*failures + random.random_range(1..runs)) % runs;
    });
}

/// Names the seed of a certificate anew, with other hashes of some blocks. Returns the first block whose hash stays.
fn rename_seed(
    certificate: &mut Certificate,
    seed: u64,
    random: &mut Xoshiro256PlusPlus,
) -> Option<usize> {
    set_seed(certificate, seed);
    let mut first_copy = None;
    let blocks = &mut rate_claim(&mut certificate.statement).blocks;
    for (block, (_, hash)) in blocks.iter_mut().enumerate() {
        match random.random() {
            true => *hash = random_hash(random),
            false => first_copy = first_copy.or(Some(block)),
        }
    }
    first_copy
}

/// PoolVerdict about a forged pool.
#[derive(Debug, PartialEq)]
enum PoolVerdict {
    /// The checker alone refuses it.
    Rejected(PoolRejection),
    /// Only repeated runs refute it, in this block of this seed.
    Refuted { seed: u64, block: u64 },
}

impl PoolVerdict {
    fn from_error(error: PoolError) -> Self {
        match error {
            PoolError::Rejected(rejection) => Self::Rejected(rejection),
            PoolError::Rerun(RerunError::Refuted {
                seed: Some(seed),
                block,
                ..
            }) => Self::Refuted { seed, block },
            other => panic!("{other}"),
        }
    }

    /// Returns the verdict about a renamed copy of a certificate.
    fn on_copy(first_copy: Option<usize>, other_seed: u64, seed: u64) -> Self {
        match first_copy {
            Some(block) => Self::Rejected(PoolRejection::CopiedRuns {
                block,
                other_seed,
                other_block: block,
            }),
            None => Self::Refuted { seed, block: 0 },
        }
    }
}

/// A forged pool.
struct ForgedPool {
    certificates: Vec<Certificate>,
    /// Range that the checker expects.
    seeds: Option<RangeInclusive<u64>>,
    kind: &'static str,
    expected: PoolVerdict,
}

impl ForgedPool {
    fn rejected(
        kind: &'static str,
        certificates: Vec<Certificate>,
        expected: PoolRejection,
    ) -> Self {
        Self {
            certificates,
            seeds: None,
            kind,
            expected: PoolVerdict::Rejected(expected),
        }
    }

    /// Checks the pool, and repeats all of its runs.
    fn check(&self) -> PoolVerdict {
        let mut pool = PoolCheck::new(WorkLimit::default(), Controllers::default());
        if let Some(seeds) = self.seeds.clone() {
            pool = pool.with_expected_seeds(seeds);
        }
        PoolVerdict::from_error(check_added(pool, &self.certificates).unwrap_err())
    }

    /// Checks the pool with the checker alone.
    fn check_alone(&self) -> Result<PooledRate, PoolRejection> {
        let pool = self
            .seeds
            .clone()
            .map_or_else(Pool::default, Pool::of_seeds);
        check_alone(pool, &self.certificates)
    }
}

fn repeat_seed(short: &[Certificate], random: &mut Xoshiro256PlusPlus) -> ForgedPool {
    let mut certificates = short.to_vec();
    let chosen = random.random_range(0..short.len());
    let index = random.random_range(0..=short.len());
    certificates.insert(index, short[chosen].clone());
    let seed = FIRST_SEED + chosen as u64;
    ForgedPool::rejected(
        "a seed twice",
        certificates,
        PoolRejection::RepeatedSeed { seed },
    )
}

/// Leaves seeds out. Only a checker that expects the range notices that the first or the last one is missing.
fn leave_seeds_out(short: &[Certificate], random: &mut Xoshiro256PlusPlus) -> ForgedPool {
    let last = short.len() - 1;
    let is_range_expected: bool = random.random();
    let candidates = match is_range_expected {
        true => 0..last + 1,
        false => 1..last,
    };
    let mut left_out: Vec<usize> = candidates
        .clone()
        .filter(|_| random.random_bool(0.1))
        .collect();
    if left_out.is_empty() {
        left_out.push(match random.random() {
            true => candidates.end - 1,
            false => random.random_range(candidates),
        });
    }
    let kept = (0..=last).filter(|index| !left_out.contains(index));
    let mut certificates: Vec<Certificate> = kept.map(|index| short[index].clone()).collect();
    certificates.shuffle(random);
    let [first, last] = [FIRST_SEED, FIRST_SEED + last as u64];
    let expected = PoolRejection::MissingSeeds {
        first,
        last,
        missing: FIRST_SEED + left_out[0] as u64,
        count: left_out.len() as u64,
    };
    ForgedPool {
        seeds: is_range_expected.then_some(first..=last),
        ..ForgedPool::rejected("seeds left out", certificates, expected)
    }
}

/// Replaces up to three certificates by those of the same seeds with another configuration.
fn mix_configurations(material: &Material, random: &mut Xoshiro256PlusPlus) -> ForgedPool {
    let mut certificates = material.short.clone();
    let (field, strangers) = &material.strangers[random.random_range(0..CHANGES.len())];
    for _ in 0..random.random_range(1..=3) {
        let chosen = random.random_range(0..strangers.len());
        certificates[chosen] = strangers[chosen].clone();
    }
    certificates.shuffle(random);
    let field = (*field).to_owned();
    ForgedPool::rejected(
        "another configuration",
        certificates,
        PoolRejection::OtherConfiguration { field },
    )
}

/// Makes a pool from genuine certificates of two blocks, of which one certificate is changed, copied or replaced.
fn forge_counts(material: &Material, random: &mut Xoshiro256PlusPlus) -> ForgedPool {
    let genuine = &material.genuine;
    let mut certificates = genuine.clone();
    let chosen = random.random_range(0..genuine.len());
    let seed = FIRST_SEED + chosen as u64;
    let block = random.random_range(0..2);
    let changed = PoolVerdict::Refuted {
        seed,
        block: block as u64,
    };
    let (kind, expected) = match random.random_range(0..5) {
        0 => {
            let mut copy = genuine[chosen].clone();
            let renamed = FIRST_SEED + SEEDS;
            let first_copy = rename_seed(&mut copy, renamed, random);
            certificates.push(copy);
            let expected = PoolVerdict::on_copy(first_copy, seed, renamed);
            ("a seed again under another number", expected)
        }
        1 => {
            change_counts(&mut certificates[chosen], block, random);
            ("changed counts", changed)
        }
        2 => {
            rate_claim(&mut certificates[chosen].statement).blocks[block].1 = random_hash(random);
            ("changed hashes", changed)
        }
        3 => {
            certificates[chosen] = material.outside[block].clone();
            set_seed(&mut certificates[chosen], seed);
            let expected = PoolVerdict::Refuted { seed, block: 0 };
            ("a seed replaced by one outside the range", expected)
        }
        _ => {
            let other = if chosen == 1 { 0 } else { chosen };
            certificates[1] = genuine[other].clone();
            let renamed = FIRST_SEED + 1;
            let first_copy = rename_seed(&mut certificates[1], renamed, random);
            // The later one of two equal blocks is refused.
            let earlier = FIRST_SEED + other.min(1) as u64;
            let expected = PoolVerdict::on_copy(first_copy, earlier, renamed);
            ("a seed replaced by another", expected)
        }
    };
    ForgedPool {
        certificates,
        seeds: None,
        kind,
        expected,
    }
}

fn forge(material: &Material, random: &mut Xoshiro256PlusPlus) -> ForgedPool {
    match random.random_range(0..7) {
        0 => repeat_seed(&material.short, random),
        1 => leave_seeds_out(&material.short, random),
        2 => mix_configurations(material, random),
        _ => forge_counts(material, random),
    }
}

#[test]
fn every_forged_pool_is_refused() {
    let wanted: u64 = std::env::var("FORGERIES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(1000);
    let material = Material::count();
    let accepted = check_pool(&material.genuine).unwrap();
    assert_eq!(
        (accepted.first_seed, accepted.last_seed),
        (FIRST_SEED, FIRST_SEED + SEEDS - 1)
    );
    assert_eq!(accepted.runs, RUNS * SEEDS);
    let short = check_pool(&material.short).unwrap();
    assert_eq!(short.runs, SHORT_RUNS * SHORT_SEEDS);
    (0..wanted).into_par_iter().for_each(|index| {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(index);
        let forged = forge(&material, &mut random);
        let kind = forged.kind;
        assert_eq!(forged.check(), forged.expected, "{index}: {kind}");
        let alone = forged.check_alone().map_err(PoolVerdict::Rejected);
        match forged.expected {
            PoolVerdict::Rejected(_) => assert_eq!(alone, Err(forged.expected), "{index}: {kind}"),
            PoolVerdict::Refuted { .. } => assert!(alone.is_ok(), "{index}: {kind}: {alone:?}"),
        }
    });
}

/// Checks the committed pools, and repeats some of their 10 000 blocks if this release made them.
#[test]
fn the_committed_pools_are_accepted() {
    let pools = [
        CommittedPool {
            folder: "baseline",
            seeds: 100,
            runs: 1_000_000,
            blocks: 10_000,
            failures: 980_532,
            rerun_percent: 1.0,
        },
        CommittedPool {
            folder: "road",
            seeds: 100,
            runs: 1_000_000,
            blocks: 10_000,
            failures: 89_446,
            rerun_percent: 0.1,
        },
        CommittedPool {
            folder: "baseline-large",
            seeds: 100,
            runs: 100_000_000,
            blocks: 100_000,
            failures: 98_054_660,
            rerun_percent: 0.01,
        },
        CommittedPool {
            folder: "road-large",
            seeds: 100,
            runs: 20_000_000,
            blocks: 100_000,
            failures: 1_785_907,
            rerun_percent: 0.01,
        },
    ];
    pools.iter().for_each(assert_accepted);
}

struct CommittedPool {
    folder: &'static str,
    seeds: u64,
    runs: u64,
    /// Blocks of runs in all certificates.
    blocks: u64,
    failures: u64,
    /// Share of the blocks that are simulated again, in %.
    rerun_percent: f64,
}

fn assert_accepted(committed: &CommittedPool) {
    let folder = committed.folder;
    let mut pool =
        PoolCheck::new(WorkLimit::default(), Controllers::default()).with_rerun(Vec::new());
    let mut alone = Pool::default();
    for seed in 0..committed.seeds {
        let path = format!(
            "{}/corpora/pools/{folder}/seed-{seed:02}.json",
            env!("CARGO_MANIFEST_DIR")
        );
        let certificate = Certificate::from_json(&fs::read_to_string(path).unwrap()).unwrap();
        alone.add(&certificate, WorkLimit::default()).unwrap();
        if let Err(error) = pool.add(&certificate) {
            panic!("seed {seed}: {error}");
        }
    }
    let claim = pool.conclude().unwrap().claim;
    assert_eq!(claim, alone.conclude(WorkLimit::default()).unwrap());
    assert_eq!(
        (claim.first_seed, claim.last_seed),
        (0, committed.seeds - 1)
    );
    assert_eq!(
        (claim.runs, claim.failures),
        (committed.runs, committed.failures)
    );
    let percent = committed.rerun_percent;
    let sample = BlockSelection::Sample { percent, seed: 5 };
    let confirmation = pool.rerun().unwrap().confirm(sample, &Quiet).unwrap();
    let expected = committed.blocks as f64 * percent / 100.0;
    assert_eq!(confirmation.blocks as f64, expected.round());
}

/// Compares the bound with that of one certificate with as many runs, which another solver finds.
#[test]
fn the_pooled_bound_is_that_of_one_count_with_as_many_runs() {
    let genuine = genuine_pool();
    let pooled = check_pool(&genuine).unwrap();
    let config = RateConfig {
        runs: RUNS * SEEDS,
        ..config("baseline", "high-risk", 0)
    };
    let single = RatePlan::new(config)
        .unwrap()
        .record()
        .rate_at_most(pooled.failures);
    assert!(
        (pooled.max_rate / single - 1.0).abs() < 1e-6,
        "{} {single}",
        pooled.max_rate
    );
    let mut reversed = genuine.clone();
    reversed.reverse();
    assert_eq!(check_pool(&reversed).unwrap(), pooled);
    // The claim without the last seed is about a smaller range.
    let fewer = check_pool(&genuine[..SEEDS as usize - 1]).unwrap();
    assert_eq!(fewer.last_seed, FIRST_SEED + SEEDS - 2);
}
