//! Every pair of vehicle classes has proof obligations, each with a recorded proof.
//!
//! They are about the code that drives: evaluating it with symbolic terms writes down the demanded gap, the motion, the
//! bound of a step and the shield's test. Changing this code changes the files.

mod term;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crumple_sim::control::{
    ErrorBounds, FiringRule, MotionSample, ShieldParams, ShieldState, ViabilityKernel,
    distance_and_speed_after, max_closing_m, min_quadratic,
};
use crumple_sim::scenario::VehicleClass;

use term::Term;

fn obligations_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("verify/obligations")
}

fn exact_quotient(limit_mps2: f64) -> [String; 2] {
    let halvings = (0..40)
        .find(|&k| (limit_mps2 * 2.0_f64.powi(k)).fract() == 0.0)
        .expect("a limit has few binary places");
    [limit_mps2 * 2.0_f64.powi(halvings), 2.0_f64.powi(halvings)].map(|whole| format!("{whole:.0}"))
}

fn code_terms() -> [(&'static str, String); 13] {
    let [b, c, v, w, a, h, zero] = ["b", "c", "v", "w", "a", "h", "0.0"].map(Term::symbol);
    let demanded = ViabilityKernel {
        own_brake_mps2: b,
        ahead_brake_mps2: c,
    }
    .demanded_gap_m(v, w);
    let [covered, speed] = distance_and_speed_after(v, a, h);
    let frame = |share: &str, noise_mps2: Term| ShieldParams {
        step_s: h,
        brake_mps2: b,
        accel_mps2: Term::symbol("most"),
        noise_mps2,
        ahead_brake_mps2: c,
        delay_steps: 0,
        response_fraction: Term::symbol(share),
        errors: ErrorBounds::default(),
        behind: None,
        margin_m: Term::symbol("m"),
    };
    let state = ShieldState {
        gap_m: Term::symbol("g"),
        speed_mps: v,
        ahead_mps: w,
        response_mps2: Term::symbol("r"),
    };
    let [seen_gap_m, seen_mps, seen_ahead_mps] = ["seen-g", "seen-v", "seen-w"].map(Term::symbol);
    let seen = ShieldState {
        gap_m: seen_gap_m,
        speed_mps: seen_mps,
        ahead_mps: seen_ahead_mps,
        ..state
    };
    let sluggish = frame("share", zero);
    let predicted = frame("share", Term::symbol("n")).after(seen, a);
    let own = Term::symbol("own");
    [
        ("{demanded}", demanded.text()),
        ("{moved-covered}", covered.text()),
        ("{moved-speed}", speed.text()),
        ("{largest-closing}", max_closing_m(v, own, w, c, h).text()),
        ("{admits}", frame("1.0", zero).admits(state, a).text()),
        ("{to-lose}", sluggish.speed_to_lose_mps(state).text()),
        (
            "{to-lose-after-braking}",
            sluggish.speed_to_lose_mps(sluggish.after(state, -b)).text(),
        ),
        ("{predicted-gap}", predicted.gap_m.text()),
        ("{predicted-speed}", predicted.speed_mps.text()),
        ("{predicted-ahead}", predicted.ahead_mps.text()),
        ("{predicted-response}", predicted.response_mps2.text()),
        ("{spare}", sluggish.spare_m(state).text()),
        ("{seen-spare}", sluggish.spare_m(seen).text()),
    ]
}

/// Terms of the code about followers whose brake fires.
fn follower_terms() -> [(&'static str, String); 13] {
    let rule = FiringRule {
        step_s: Term::symbol("h"),
        ttc_s: Term::symbol("T"),
        drift_mps2: Term::symbol("e"),
    };
    let sample = |position: &str, speed: &str| MotionSample {
        position_m: Term::symbol(position),
        speed_mps: Term::symbol(speed),
    };
    let [own, own_before] = [sample("p", "v"), sample("p0", "v0")];
    let [fastest, slowest] = [sample("pf", "uf"), sample("ps", "us")];
    let speeds = rule.firing_speeds_mps([own, own_before], [fastest, slowest]);
    let unfired = |speed: &str| {
        let position_m = rule.unfired_position_m(own_before, Term::symbol(speed));
        position_m.text()
    };
    let [deceleration, low, value] = ["d", "low", "value"].map(Term::symbol);
    let waiting_gap_m = rule.waiting_gap_m(own, deceleration, fastest.position_m, low);
    let [rate, second] = ["rate", "k"].map(Term::symbol);
    let spare = |own, follower| rule.spare_m(own, follower).text();
    [
        (
            "{follower-spare-before}",
            spare(own_before, sample("y0", "u0")),
        ),
        ("{follower-spare}", spare(own, sample("y", "u"))),
        ("{fastest-spare}", spare(own, fastest)),
        ("{slowest-spare}", spare(own, slowest)),
        ("{unfired-position}", unfired("u")),
        ("{unfired-position-at-kink}", unfired("kink")),
        ("{unfired-position-at-high}", unfired("high")),
        ("{unfired-position-at-low}", unfired("low")),
        ("{low-speed}", speeds.min_mps.text()),
        ("{kink-speed}", speeds.kink_mps.text()),
        ("{high-speed}", speeds.max_mps.text()),
        ("{waiting-gap}", waiting_gap_m.text()),
        (
            "{minimum}",
            min_quadratic(value, rate, second, deceleration).text(),
        ),
    ]
}

/// Statements about followers whose brake fires, for all parameters.
const FOLLOWER_STATEMENTS: [&str; 10] = [
    "unfired",
    "speeds",
    "kink",
    "ends",
    "certain",
    "motion",
    "waiting",
    "minimum",
    "acceleration",
    "control",
];

/// Statements for a pair; the last one only if the ego brakes harder than the leader.
const STATEMENTS: [&str; 11] = [
    "invariance",
    "worst-leader",
    "maximality",
    "motion",
    "closing",
    "admission-inside",
    "admission-end",
    "lag",
    "prediction",
    "estimation",
    "control",
];

/// Returns a statement with the terms of the code.
fn filled_statement(name: &str, terms: &[(&'static str, String)]) -> String {
    let path = obligations_folder()
        .join("statements")
        .join(format!("{name}.smt2"));
    let text = fs::read_to_string(path).unwrap();
    terms
        .iter()
        .fold(text, |text, (place, term)| text.replace(place, term))
}

fn follower_obligations() -> Vec<(String, String)> {
    let terms = follower_terms();
    let definitions = filled_statement("follower-definitions", &terms);
    FOLLOWER_STATEMENTS
        .iter()
        .map(|name| {
            let statement = filled_statement(&format!("follower-{name}"), &terms);
            let file = format!("follower/{name}.smt2");
            (file, definitions.clone() + &statement)
        })
        .collect()
}

fn obligations() -> Vec<(String, String)> {
    let of_code = code_terms();
    let statement = |name: &str| filled_statement(name, &of_code);
    let mut all = follower_obligations();
    for own in VehicleClass::ALL {
        for ahead in VehicleClass::ALL {
            let ([n, d], [m, e]) = (
                exact_quotient(own.max_brake_mps2()),
                exact_quotient(ahead.max_brake_mps2()),
            );
            let title = format!("{} behind {}", own.name(), ahead.name());
            let filled = statement("definitions")
                .replace("{title}", &title)
                .replace("{own_numerator}", &n)
                .replace("{own_denominator}", &d)
                .replace("{ahead_numerator}", &m)
                .replace("{ahead_denominator}", &e);
            let harder = own.max_brake_mps2() > ahead.max_brake_mps2();
            for name in STATEMENTS
                .into_iter()
                .filter(|name| *name != "control" || harder)
            {
                let file = format!("{}/{name}.smt2", title.replace(' ', "-"));
                all.push((file, filled.clone() + &statement(name)));
            }
        }
    }
    all
}

#[test]
fn obligations_are_those_of_the_shipped_limits_and_each_is_proved() {
    let results = fs::read_to_string(obligations_folder().join("results.json"))
        .unwrap_or_else(|_| "[]".to_owned());
    let results: Vec<serde_json::Value> = serde_json::from_str(&results).unwrap();
    let updating = std::env::var_os("UPDATE_OBLIGATIONS").is_some();
    for (file, contents) in obligations() {
        let path = obligations_folder().join(&file);
        if updating {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, &contents).unwrap();
            continue;
        }
        let committed = fs::read_to_string(&path).unwrap_or_default();
        assert_eq!(
            committed, contents,
            "{file}: run with UPDATE_OBLIGATIONS=1, then verify/obligations/run.py"
        );
        let digest = crumple_core::digest::sha256(&contents);
        let expected = if contents.contains("(set-info :status unsat)") {
            "unsat"
        } else {
            "sat"
        };
        let answers: Vec<_> = results
            .iter()
            .filter(|r| r["file"] == file.as_str() && r["sha256"] == digest.as_str())
            .collect();
        assert!(
            answers.iter().any(|r| r["result"] == expected),
            "{file}: no recorded proof, run verify/obligations/run.py"
        );
        let contrary = if expected == "unsat" { "sat" } else { "unsat" };
        assert!(
            answers.iter().all(|r| r["result"] != contrary),
            "{file}: a solver contradicts"
        );
    }
}

#[test]
fn a_solver_confirms_one_of_them_where_there_is_one() {
    let path = obligations_folder().join("light-behind-heavy/invariance.smt2");
    match Command::new("z3").arg(&path).output() {
        Ok(done) => assert_eq!(String::from_utf8_lossy(&done.stdout).trim(), "unsat"),
        Err(_) => println!("skipped: no z3 here"),
    }
}

/// The documentation shows statements and definitions as in the files, and Coq has accepted those files.
#[test]
fn theorems_in_the_docs_are_those_that_coq_has_checked() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |file: &str| fs::read_to_string(root.join(file)).unwrap();
    let message = read("verify/coq/output.txt");
    let theories = ["Kernel.v", "Rounding.v", "TwoSided.v", "Vehicles.v"].map(|file| {
        let theory = read(&format!("verify/coq/{file}"));
        let recorded = format!("{file} {}", crumple_core::digest::sha256(&theory));
        assert!(
            message.lines().any(|line| line == recorded),
            "run verify/coq/run: {file}"
        );
        for gap in ["Admitted.", "admit.", "Axiom ", "Parameter ", "Hypothesis "] {
            assert!(!theory.contains(gap), "{file}: {gap}");
        }
        theory
    });
    let pages = read("docs/kernel-theorems.md") + &read("docs/two-sided.md");
    let shown: Vec<_> = pages
        .split("```coq\n")
        .skip(1)
        .filter_map(|rest| rest.split("\n```").next())
        .collect();
    let shown: Vec<_> = shown.iter().flat_map(|block| block.split("\n\n")).collect();
    assert!(shown.len() > 10);
    for statement in shown {
        let is_there = theories
            .iter()
            .any(|theory| theory.contains(&format!("\n{statement}\n")));
        assert!(is_there, "in none of the files: {statement}");
        if let Some(theorem) = statement
            .strip_prefix("Theorem ")
            .and_then(|rest| rest.split(' ').next())
        {
            assert!(
                message.contains(&format!("proved: {theorem}\n")),
                "{theorem}"
            );
        }
    }
    // Theorems that the derivation of the margin uses. Other names are shorter.
    let derivation = read("crates/sim/src/control/shield/rounding.rs");
    let names = derivation
        .split('`')
        .skip(1)
        .step_by(2)
        .filter(|name| name.matches('_').count() >= 3);
    let missing: Vec<_> = names
        .clone()
        .filter(|name| !message.contains(&format!("proved: {name}\n")))
        .collect();
    assert!(names.count() > 10 && missing.is_empty(), "{missing:?}");
}
