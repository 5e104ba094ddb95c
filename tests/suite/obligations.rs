//! Every pair of vehicle classes has its proof obligations, and each of them a recorded proof.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crumple_world::scenario::VehicleClass;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("verify/obligations")
}

/// A limit as an exact quotient.
fn quotient(limit_mps2: f64) -> [String; 2] {
    let halvings =
        (0..40).find(|&k| (limit_mps2 * 2.0_f64.powi(k)).fract() == 0.0).expect("a limit has few binary places");
    [limit_mps2 * 2.0_f64.powi(halvings), 2.0_f64.powi(halvings)].map(|whole| format!("{whole:.0}"))
}

/// File name and contents of each obligation.
fn obligations() -> Vec<(String, String)> {
    let statement = |name: &str| fs::read_to_string(folder().join("statements").join(format!("{name}.smt2"))).unwrap();
    let mut all = Vec::new();
    for own in VehicleClass::ALL {
        for ahead in VehicleClass::ALL {
            let ([n, d], [m, e]) = (quotient(own.max_brake_mps2()), quotient(ahead.max_brake_mps2()));
            let title = format!("{} behind {}", own.name(), ahead.name());
            let filled = statement("definitions")
                .replace("{title}", &title)
                .replace("{own_numerator}", &n)
                .replace("{own_denominator}", &d)
                .replace("{ahead_numerator}", &m)
                .replace("{ahead_denominator}", &e);
            let harder = own.max_brake_mps2() > ahead.max_brake_mps2();
            for name in ["invariance", "worst-leader", "maximality"].into_iter().chain(harder.then_some("control")) {
                let file = format!("{}/{name}.smt2", title.replace(' ', "-"));
                all.push((file, filled.clone() + &statement(name)));
            }
        }
    }
    all
}

#[test]
fn obligations_are_those_of_the_shipped_limits_and_each_is_proved() {
    let results = fs::read_to_string(folder().join("results.json")).unwrap_or_else(|_| "[]".to_owned());
    let results: Vec<serde_json::Value> = serde_json::from_str(&results).unwrap();
    let updating = std::env::var_os("UPDATE_OBLIGATIONS").is_some();
    for (file, contents) in obligations() {
        let path = folder().join(&file);
        if updating {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, &contents).unwrap();
            continue;
        }
        let committed = fs::read_to_string(&path).unwrap_or_default();
        assert_eq!(committed, contents, "{file}: run with UPDATE_OBLIGATIONS=1, then verify/obligations/run.py");
        let digest = crumple_world::digest::sha256(&contents);
        let expected = if contents.contains("(set-info :status unsat)") { "unsat" } else { "sat" };
        let answers: Vec<_> =
            results.iter().filter(|r| r["file"] == file.as_str() && r["sha256"] == digest.as_str()).collect();
        assert!(
            answers.iter().any(|r| r["result"] == expected),
            "{file}: no recorded proof, run verify/obligations/run.py"
        );
        let contrary = if expected == "unsat" { "sat" } else { "unsat" };
        assert!(answers.iter().all(|r| r["result"] != contrary), "{file}: a solver contradicts");
    }
}

#[test]
fn a_solver_confirms_one_of_them_where_there_is_one() {
    let path = folder().join("light-behind-heavy/invariance.smt2");
    match Command::new("z3").arg(&path).output() {
        Ok(done) => assert_eq!(String::from_utf8_lossy(&done.stdout).trim(), "unsat"),
        Err(_) => println!("skipped: no z3 here"),
    }
}
