//! Measures every quantity that has a target, in one table.
//!
//! ```text
//! cargo bench --bench targets                       # the table; a minute or two
//! cargo bench --bench targets -- all                # with ten trainings and an assessment: some minutes
//! cargo bench --bench targets -- rollouts           # a part: learning, rollouts, monitors, proofs, programs, long
//! cargo bench --bench targets -- limits             # limits of the machine
//! cargo bench --bench targets -- compare            # values for benches/compare.py (SUMO, Stable-Baselines3)
//! ```
//!
//! Values are minimum processor times of one thread unless a line says wall clock. Compared pieces of work alternate.
//! The limits are explained in reports/speed.md.

#![allow(clippy::expect_used, reason = "a bench may stop at what cannot happen")]
#![allow(missing_docs, unreachable_pub, reason = "a bench is no library")]

mod campaigns;
mod clock;
mod learning;
mod limits;
mod monitors;
mod programs;
mod proofs;
mod rollouts;
mod table;

/// Shared with the other benches, none of which uses all of it.
#[allow(dead_code, reason = "see above")]
#[path = "../work"]
mod work {
    pub mod chasing_cars;
    pub mod networks;
    pub mod rollouts;
}

fn main() {
    // Cargo passes `--bench` first.
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with("--"))
        .collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    // One thread, so that parallel code stays on it and its processor time can be measured.
    let alone = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a thread");
    alone.install(|| match words[..] {
        [] => print_limits_and_table(&PARTS[..PARTS.len() - 1]),
        ["all"] => print_limits_and_table(&PARTS),
        ["limits"] => print_limits(),
        ["compare"] => print_comparison(),
        _ => match PARTS.iter().find(|part| words[..] == [part.0]) {
            Some(part) => print_table(std::slice::from_ref(part)),
            None => eprintln!("nothing, `all`, `limits`, a part of the table, or `compare`"),
        },
    });
}

type BenchmarkGroup = (&'static str, fn(&mut dyn FnMut(table::Measurement)));

/// Parts of the table; the last one takes minutes.
const PARTS: [BenchmarkGroup; 6] = [
    ("learning", learning::measure),
    ("rollouts", rollouts::measure),
    ("monitors", monitors::measure),
    ("proofs", proofs::measure),
    ("programs", programs::measure),
    ("long", |say| {
        learning::time_to_first_safe(10, say);
        programs::assessment(say);
        programs::campaign_memory(say);
        campaigns::end_to_end(say);
    }),
];

fn print_limits() {
    println!("{}\n\n{}", limits::processor_model(), table::LIMITS_HEADER);
    limits::measure(&mut |row| println!("{row}"));
    println!();
}

fn print_limits_and_table(parts: &[BenchmarkGroup]) {
    print_limits();
    print_table(parts);
}

fn print_table(parts: &[BenchmarkGroup]) {
    println!("{}", table::HEADER);
    for (_, figures) in parts {
        figures(&mut |figure| println!("{}", figure.markdown_row()));
    }
}

fn print_comparison() {
    println!("scenarios_per_s {}", rollouts::scenarios_per_second());
    println!(
        "decisions_per_s_64 {}",
        learning::decisions_per_second(64, 128)
    );
    println!(
        "decisions_per_s_256 {}",
        learning::decisions_per_second(256, 512)
    );
}
