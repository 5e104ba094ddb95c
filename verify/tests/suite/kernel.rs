//! A kernel is accepted exactly if its closed form is right.

use crumple_verify::polynomial::Polynomial;
use crumple_verify::{
    Assumption, Certificate, KernelClaim, ProvedClaim, Rejection, Statement, check,
};
use num_rational::BigRational;

use crate::support::certificate;

fn check_kernel(kernel: &KernelClaim) -> Result<ProvedClaim, Rejection> {
    let mut certificate = certificate(Statement::Kernel(kernel.clone()));
    let text = serde_json::to_string(&certificate).unwrap();
    assert_eq!(Certificate::from_json(&text).unwrap(), certificate);
    let result = check(&certificate);
    certificate
        .assumptions
        .retain(|assumption| *assumption != Assumption::LeaderWithinLimit);
    assert!(check(&certificate).is_err());
    result
}

fn parse_rational(text: &str) -> BigRational {
    text.parse().unwrap()
}

pub fn kernel(b: &str, c: &str) -> KernelClaim {
    let (b, c, half) = (parse_rational(b), parse_rational(c), parse_rational("1/2"));
    KernelClaim {
        ego_brake_mps2: b.to_string(),
        leader_brake_mps2: c.to_string(),
        step_s: "1/100".to_owned(),
        margin_m: "1/1000000".to_owned(),
        stopping_own_squared: (&half / &b).to_string(),
        stopping_ahead_squared: (-&half / &c).to_string(),
        catching_up_squared: (b > c).then(|| (half / (b - c)).to_string()),
    }
}

fn demanded_gap_m(kernel: &KernelClaim, v: &BigRational, w: &BigRational) -> BigRational {
    let zero = parse_rational("0");
    match &kernel.catching_up_squared {
        Some(r)
            if v * parse_rational(&kernel.leader_brake_mps2)
                < w * parse_rational(&kernel.ego_brake_mps2) =>
        {
            let closing = (v - w).max(zero);
            parse_rational(r) * &closing * &closing
        }
        _ => {
            let [p, q] = [&kernel.stopping_own_squared, &kernel.stopping_ahead_squared]
                .map(|text| parse_rational(text));
            (p * v * v + q * w * w).max(zero)
        }
    }
}

#[test]
fn closed_forms_are_accepted_for_any_limits() {
    for (b, c) in [
        ("15/2", "15/2"),
        ("15/2", "6"),
        ("6", "15/2"),
        ("6", "6"),
        ("8", "5"),
        ("3/40", "30"),
        ("30", "1/10"),
    ] {
        assert_eq!(
            check_kernel(&kernel(b, c)),
            Ok(ProvedClaim::Kernel),
            "{b} {c}"
        );
    }
}

#[test]
fn a_change_of_any_number_that_matters_is_rejected() {
    for (b, c) in [("15/2", "15/2"), ("15/2", "6"), ("6", "15/2"), ("8", "5")] {
        let json = serde_json::to_value(kernel(b, c)).unwrap();
        let mut rejected = 0;
        for path in [
            "/ego_brake_mps2",
            "/leader_brake_mps2",
            "/stopping_own_squared",
            "/stopping_ahead_squared",
            "/catching_up_squared",
        ] {
            for factor in ["2", "101/100", "999999/1000000", "0", "-1"] {
                let mut mutant = json.clone();
                let Some(value) = mutant.pointer_mut(path) else {
                    continue;
                };
                let changed = parse_rational(value.as_str().unwrap()) * parse_rational(factor);
                *value = changed.to_string().into();
                let mutant: KernelClaim = serde_json::from_value(mutant).unwrap();
                assert!(
                    check_kernel(&mutant).is_err(),
                    "{b} {c} {path} times {factor}"
                );
                rejected += 1;
            }
        }
        assert_eq!(
            rejected,
            if json.get("catching_up_squared").is_some() {
                25
            } else {
                20
            }
        );
    }
}

#[test]
fn the_stopping_distance_alone_is_rejected_where_the_own_vehicle_brakes_harder() {
    let rss = KernelClaim {
        catching_up_squared: None,
        ..kernel("8", "5")
    };
    assert!(
        check_kernel(&rss)
            .unwrap_err()
            .to_string()
            .contains("catching_up_squared")
    );
    let unnecessary = KernelClaim {
        catching_up_squared: kernel("8", "5").catching_up_squared,
        ..kernel("5", "8")
    };
    assert!(
        check_kernel(&unnecessary)
            .unwrap_err()
            .to_string()
            .contains("catching_up_squared")
    );
    let none = KernelClaim {
        margin_m: "0".to_owned(),
        ..kernel("8", "5")
    };
    assert_eq!(
        check_kernel(&none).unwrap_err().to_string(),
        "`margin_m` must be positive"
    );
}

/// The length limit bounds the time for untrusted files.
#[test]
fn numbers_of_a_hundred_characters_are_read_and_longer_ones_refused() {
    for (zeros, is_read) in [(96, true), (97, true), (98, false)] {
        let padded = |text: &str| format!("{}{text}", "0".repeat(zeros));
        let long = KernelClaim {
            ego_brake_mps2: padded("6/1"),
            ..kernel("6", "6")
        };
        let result = check_kernel(&long);
        assert_eq!(result.is_ok(), is_read, "{zeros}: {result:?}");
    }
}

/// Tests the conclusion by brute force over time with exact numbers.
#[test]
fn the_demanded_gap_is_the_largest_closing_distance() {
    let distance = |u: &BigRational, rate: &BigRational, t: &BigRational| {
        let until = t.clone().min(u / rate);
        u * &until - rate * &until * &until / parse_rational("2")
    };
    for (b, c) in [("15/2", "6"), ("6", "15/2"), ("6", "6"), ("8", "5")] {
        let kernel = kernel(b, c);
        let (b, c) = (parse_rational(b), parse_rational(c));
        for (v, w) in [
            ("25", "20"),
            ("20", "25"),
            ("25", "24"),
            ("30", "3"),
            ("0", "4"),
            ("9", "0"),
            ("25", "23"),
        ] {
            let (v, w) = (parse_rational(v), parse_rational(w));
            let demanded = demanded_gap_m(&kernel, &v, &w);
            let sixtieths = 0..60 * 60;
            let closing = sixtieths.map(|k| {
                let t = BigRational::new(k.into(), 600.into());
                distance(&v, &b, &t) - distance(&w, &c, &t)
            });
            let largest = closing.max().unwrap();
            assert!(
                largest <= demanded && demanded < &largest + parse_rational("1/100000"),
                "{demanded} {largest}"
            );
        }
    }
}

#[test]
fn the_note_s_example_demands_4_17_m() {
    assert_eq!(
        demanded_gap_m(
            &kernel("8", "5"),
            &parse_rational("25"),
            &parse_rational("20")
        ),
        parse_rational("25/6")
    );
}

#[test]
fn the_binomial_formula() {
    let [x, y, z] = Polynomial::variables();
    let two = BigRational::from_integer(2.into());
    let expanded = &(&x.squared() - &(&two * &(&x * &y))) + &y.squared();
    assert_eq!((&x - &y).squared(), expanded);
    assert!(!expanded.has_no_negative_coefficient());
    assert!((&(&x + &z).squared() - &x.squared()).has_no_negative_coefficient());
    assert!((&expanded - &expanded).is_zero());
}
