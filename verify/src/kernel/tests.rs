//! Checks that each case describes the intended motion.
#![allow(clippy::unwrap_used)]

use super::*;

fn rational(text: &str) -> BigRational {
    text.parse().unwrap()
}

fn distance_covered(rate: &BigRational, stop: &BigRational, t: &BigRational) -> BigRational {
    let moving = t.min(stop);
    rate * (stop * moving - moving * moving / rational("2"))
}

/// Returns the polynomials for a pair of limits and given coefficients, with their expected values from the motion
/// itself.
fn cases_with_values(
    b: &str,
    c: &str,
    at: [&BigRational; 3],
    [p, q, r]: [&str; 3],
) -> Vec<(ProofCase, BigRational)> {
    let [b, c, p, q, r] = [b, c, p, q, r].map(rational);
    let [x, y, z] = at;
    let (xy, xyz) = (x + y, x + y + z);
    let closing = |a: &BigRational, stop_ahead: &BigRational, t: &BigRational| {
        distance_covered(&b, a, t) - distance_covered(&c, stop_ahead, t)
    };
    let s_of = |a: &BigRational, stop_ahead: &BigRational| {
        let (v, w) = (&b * a, &c * stop_ahead);
        &p * &v * &v + &q * &w * &w
    };
    let pair = BrakeLimits {
        b: &b,
        c: &c,
        stopping_coefficients: [&p, &q],
    };
    let mut worth = vec![
        s_of(x, y) - closing(x, y, x.max(y)),
        s_of(&xyz, x) - closing(&xyz, x, &xy),
    ];
    let mut all = pair.last_stop_cases().to_vec();
    if b > c {
        all.push(pair.harder_braking_case());
        worth.push(closing(&xyz, &xy, &xyz) - closing(&xyz, &xy, x));
        all.extend(pair.catching_up_cases(&r));
        let harder = &b - &c;
        // t = x, A = y, B = z, even after a stop: an identity.
        let two = rational("2");
        let moving = |rate: &BigRational, stop: &BigRational, t: &BigRational| {
            rate * (stop * t - t * t / &two)
        };
        let (v, w) = (&b * y, &c * z);
        let from_turn = x - (&v - &w) / &harder;
        let demanded = &r * (&v - &w) * (&v - &w);
        worth.push(
            demanded
                - (moving(&b, y, x) - moving(&c, z, x))
                - &harder / &two * &from_turn * &from_turn,
        );
        worth.push(x - (&b * x - &c * &xy) / &harder);
        let stop_ahead = (&b * x + z) / &c;
        worth.push(moving(&c, &stop_ahead, y) - moving(&b, x, y));
        worth.push(closing(x, &xyz, x) - closing(x, &xyz, &xy));
    } else {
        all.extend(pair.softer_braking_cases());
        worth.push(x * s_of(&xyz, &xy) - &xy * closing(&xyz, &xy, x));
        worth.push(-closing(&xy, &xyz, x));
        worth.push(-closing(x, &xyz, &xy));
        worth.push(-closing(x, &xy, &xy));
    }
    assert_eq!(all.len(), worth.len());
    all.into_iter().zip(worth).collect()
}

#[test]
fn each_proof_case_equals_the_shortfall_of_the_motion() {
    let values = ["0", "1/3", "1", "7/4", "5"].map(rational);
    for (b, c) in [
        ("15/2", "6"),
        ("8", "5"),
        ("6", "15/2"),
        ("6", "6"),
        ("1/2", "9"),
    ] {
        for x in &values {
            for y in &values {
                for z in &values {
                    // The claimed coefficients are arbitrary: the case shows the shortfall.
                    for claimed in [["1/15", "-1/12", "1/3"], ["2/7", "-3/11", "5/13"]] {
                        for (case, worth) in cases_with_values(b, c, [x, y, z], claimed) {
                            let value = case.polynomial.evaluate([x, y, z]);
                            assert_eq!(
                                value, worth,
                                "{}: {b} {c}, x = {x}, y = {y}, z = {z}",
                                case.failure_message
                            );
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn terms_that_must_be_zero_are_not_only_nonnegative() {
    let unit = Polynomial::constant(&rational("1"));
    let nothing = &unit - &unit;
    assert!(
        !ProofCase::zero("", unit.clone()).holds() && ProofCase::zero("", nothing.clone()).holds()
    );
    assert!(
        ProofCase::nonnegative("", unit.clone()).holds()
            && ProofCase::nonnegative("", nothing).holds()
    );
    assert!(!ProofCase::nonnegative("", -&unit).holds());
}
