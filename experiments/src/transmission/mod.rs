//! Evaluations that a search method needs to falsify each specification of the automatic transmission.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- transmission 41000 100 [METHOD]        # first seed, seeds
//! ```
//! Inputs of instance 1 are arbitrary; here they have a piece for each second. Instance 2 has pieces of 5 s. AT6a to
//! AT6abc compare speeds in mph and rpm. The rows `scaled` divide each comparison by its bound, which changes no sign.

mod model;

use self::model::{DURATION_S, MAX_BRAKE, MAX_THROTTLE, STEP_S, simulate};
use crate::ExperimentError;
use crate::falsification::{Problem, print_table};
use crumple::measure::stl::Formula;
use crumple::search::falsify::UnitCube;

/// Duration of a piece of the inputs, in seconds, of each instance.
const PIECE_S: [usize; 2] = [1, 5];

/// Returns names and formulas of the ten specifications. The next sample of AT51 to AT54 is one within 0.1 s
/// here, as in the published formulas without next; comparisons of the gear with numbers are half a gear away.
fn specifications() -> Vec<(String, String)> {
    let low_rpm = "always[0,30] rpm < 3000";
    let slow =
        |until_s: u32, mph: u32| format!("({low_rpm} implies always[0,{until_s}] speed < {mph})");
    let [a, b, c] = [slow(4, 35), slow(8, 50), slow(20, 65)];
    let mut all = vec![
        ("AT1".to_owned(), "always[0,20] speed < 120".to_owned()),
        ("AT2".to_owned(), "always[0,10] rpm < 4750".to_owned()),
    ];
    for gear in 1..=4 {
        let here = format!(
            "(gear > {} and gear < {})",
            f64::from(gear) - 0.5,
            f64::from(gear) + 0.5
        );
        let shifted = format!("not {here} and eventually[0.01,0.1] {here}");
        let stays = format!("eventually[0.01,0.1] always[0,2.5] {here}");
        all.push((
            format!("AT5{gear}"),
            format!("always[0,30] ({shifted} implies {stays})"),
        ));
    }
    let all_three = format!("{a} and {b} and {c}");
    all.extend([
        ("AT6a".to_owned(), a),
        ("AT6b".to_owned(), b),
        ("AT6c".to_owned(), c),
        ("AT6abc".to_owned(), all_three),
    ]);
    all
}

/// Returns throttle and brake at a time, from a point of the unit cube with pieces of `piece_s`.
fn inputs(point: &[f64], piece_s: usize, t_s: f64) -> [f64; 2] {
    let pieces = DURATION_S / piece_s;
    // Half a step more, so that rounding does not move a border.
    let piece = (((t_s + 0.5 * STEP_S) / piece_s as f64) as usize).min(pieces - 1);
    let at = |index: usize| point.get(index).copied().unwrap_or(0.0);
    [MAX_THROTTLE * at(piece), MAX_BRAKE * at(pieces + piece)]
}

fn robustness(formula: &Formula, point: &[f64], piece_s: usize) -> Result<f64, ExperimentError> {
    Ok(formula.robustness(&simulate(|t_s| inputs(point, piece_s, t_s))?)?)
}

/// Divides the comparisons of speeds by their bounds.
fn scaled(formula: &str) -> String {
    let bounds = [("rpm", 3000), ("speed", 35), ("speed", 50), ("speed", 65)];
    bounds
        .into_iter()
        .fold(formula.to_owned(), |text, (signal, bound)| {
            text.replace(
                &format!("{signal} < {bound}"),
                &format!("{signal} / {bound} < 1"),
            )
        })
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let mut problems = Vec::new();
    for (instance, piece_s) in PIECE_S.into_iter().enumerate() {
        let pieces = DURATION_S / piece_s;
        let published = specifications();
        let joined = published.iter().filter(|(name, _)| name.starts_with("AT6"));
        let scaled: Vec<_> = joined
            .map(|(name, text)| (format!("{name} scaled"), scaled(text)))
            .collect();
        for (name, text) in published.into_iter().chain(scaled) {
            let formula: Formula = text.parse()?;
            problems.push(Problem {
                name: format!("{name}, instance {}", instance + 1),
                cube: UnitCube::new([pieces, pieces])?,
                evaluate: Box::new(move |point| {
                    let value = robustness(&formula, point, piece_s)?;
                    Ok((value, value < 0.0))
                }),
            });
        }
    }
    print_table(&problems, arguments)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Inputs with pieces of 2 s, from the results of FalCAuN in 2024. `-` is throttle or brake 0.
    const FALSIFYING: [(&str, [&str; 2]); 5] = [
        ("AT1", ["FFFFFFFFFF------", "----------FFFFFF"]),
        ("AT2", ["FFFFFFFFFFFFFFFF", "FFFFFFFFFFFFFFFF"]),
        ("AT6a", ["HH--H--H--H-H-H-", "-FFFFFFF-F-F-F-F"]),
        ("AT6c", ["HH-HH-HHHHHH-HHH", "-------------FF-"]),
        ("AT6abc", ["HH------H-HH-H-H", "-FFF--F--FF-FFF-"]),
    ];

    fn robustness_with(name: &str, inputs: impl Fn(f64) -> [f64; 2]) -> f64 {
        let text = specifications()
            .into_iter()
            .find(|(known, _)| known == name)
            .unwrap()
            .1;
        text.parse::<Formula>()
            .unwrap()
            .robustness(&simulate(inputs).unwrap())
            .unwrap()
    }

    #[test]
    fn published_inputs_falsify_and_published_extremes_are_reached() {
        for (name, pieces) in FALSIFYING {
            let level = |text: &str, t_s: f64| match text.as_bytes()[((t_s + 0.005) / 2.0) as usize]
            {
                b'F' => 1.0,
                b'H' => 0.5,
                _ => 0.0,
            };
            let inputs = |t_s| {
                [
                    MAX_THROTTLE * level(pieces[0], t_s),
                    MAX_BRAKE * level(pieces[1], t_s),
                ]
            };
            assert!(robustness_with(name, inputs) < 0.0, "{name}");
        }
        // problems/arch-comp-2021/at/README.md of github.com/mshaheryarmalik/stgem states the largest speed and
        // engine speed at full throttle.
        let full = |_| [MAX_THROTTLE, 0.0];
        for (name, expected) in [
            ("AT1", 120.0 - 120.213_271_492_615),
            ("AT2", 4750.0 - 4_768.277_187_862_124),
        ] {
            let actual = robustness_with(name, full);
            assert!((actual - expected).abs() < 1e-9, "{name}: {actual}");
        }
    }

    /// Counts the inputs of zlscheck that falsify this model. `ZLSCHECK` is the folder `bench_results` of
    /// <https://github.com/ismailbennani/zlscheck_arch20_counterexamples>; rows have time, throttle, brake, outputs.
    #[test]
    #[ignore = "needs the results of zlscheck"]
    fn most_inputs_of_zlscheck_falsify() {
        let root = std::path::PathBuf::from(std::env::var("ZLSCHECK").expect("set ZLSCHECK"));
        let entries = |path: &std::path::Path| {
            std::fs::read_dir(path)
                .unwrap()
                .map(|entry| entry.unwrap().path())
        };
        let (mut count, mut confirmed) = (0, 0);
        for folder in ["at_inst1", "at_inst2"]
            .iter()
            .flat_map(|instance| entries(&root.join(instance)))
        {
            let name = folder
                .to_str()
                .unwrap()
                .split('_')
                .find(|part| part.starts_with("AT"))
                .unwrap()
                .to_owned();
            for file in entries(&folder)
                .filter(|file| file.extension().is_some_and(|extension| extension == "csv"))
            {
                let text = std::fs::read_to_string(&file).unwrap();
                let number = |field: &str| field.parse::<f64>().unwrap();
                let row = |line: &str| {
                    line.split(',')
                        .skip(1)
                        .take(2)
                        .map(number)
                        .collect::<Vec<_>>()
                };
                let rows: Vec<Vec<f64>> = text.lines().map(row).collect();
                let value = robustness_with(&name, |t_s| {
                    let row = &rows[((t_s / STEP_S).round() as usize).min(rows.len() - 1)];
                    [row[0], row[1]]
                });
                count += 1;
                confirmed += usize::from(value < 0.0);
                if value >= 0.0 {
                    println!("{name}: {value}");
                }
            }
        }
        println!("{confirmed} of {count}");
        assert!(count > 0 && 100 * confirmed >= 98 * count);
    }
}
