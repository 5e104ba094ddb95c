//! The states from which a vehicle can still avoid the one ahead: a proof that needs no solver.
//!
//! # What is claimed
//!
//! A state is (g, v, w): bumper gap, own speed, speed of the vehicle ahead. The own vehicle can brake at b, the vehicle
//! ahead never brakes harder than c; both stop and stay, and contact is g <= 0. For a vehicle that brakes at rate β from
//! speed u to standstill let P_β(u, t) = u t - β t²/2 until t = u/β, and u²/2β from then on. With
//!
//! ```text
//! closing(t) = P_b(v, t) - P_c(w, t),         D(v, w) = the largest closing(t) over t >= 0,
//! K = { g > D(v, w) }
//! ```
//!
//! the claim is that K is *exactly* the set of states that can be kept free of contact, and that D has the closed form
//! whose coefficients the certificate states ([`Kernel::stopping`], [`Kernel::catching_up`]):
//!
//! ```text
//! D = max(0, p v² + q w²)        if b <= c or v/b >= w/c     (p = 1/2b, q = -1/2c)
//! D = r max(0, v - w)²           otherwise                   (r = 1/2(b - c))
//! ```
//!
//! # What holds for all constants
//!
//! 1. *Full braking keeps K, at every instant.* While both brake fully for a time s, whatever stops on the way, the
//!    motion from (v_s, w_s) on is the rest of the motion from (v, w): P_β(u, s + t) = P_β(u, s) + P_β(u_s, t). So
//!    D(v_s, w_s) = max over t >= s of closing(t), less closing(s), which is at most D(v, w) - closing(s). The gap after s is
//!    g - closing(s). Hence **the margin g - D never falls**; it need not be a step's end, and s may lie past any stop.
//! 2. *The worst leader stands for all.* Whoever never brakes harder than c has, after s, at least the speed
//!    max(w - c s, 0) and, as the integral of it, has covered at least P_c(w, s). P_c(w, t) does not fall in w, so D does
//!    not rise in w. Against any such leader the gap after s is therefore no smaller, and the demanded gap no larger, than
//!    against full braking. This holds whatever the own vehicle does meanwhile; so a test of one step against full braking of the
//!    vehicle ahead, its inside included, implies the same for all leaders.
//! 3. *Outside K nothing helps.* The same lower bound holds for the own vehicle: it covers at least P_b(v, t). Against full
//!    braking the gap at the t where closing(t) is largest is at most g - D(v, w) <= 0: contact.
//! 4. *Friction.* P_{μβ}(u, t) = P_β(u, μ t)/μ, so on a road that allows the share μ of both limits D is the same function
//!    divided by μ, and 1 to 3 hold again. Where limits scale unlike, the certificate is for the scaled limits.
//!
//! A margin m > 0, demanded on top of D, pays for floating-point evaluation; by 1 full braking keeps it too.
//!
//! # What is checked for the constants
//!
//! That the closed form *is* the largest closing(t). With A = v/b and B = w/c, the times to standstill, everything is a
//! polynomial; each case orders 0, t, A and B, writes the differences as variables x, y, z >= 0, and expands exactly. A
//! polynomial without negative coefficients is then nonnegative. One case needs a perfect square besides.

use num_rational::BigRational;
use num_traits::{Signed, Zero};
use serde::{Deserialize, Serialize};

use crate::polynomial::Polynomial;
use crate::rational;

/// A kernel for one pair of brake limits. Numbers are exact: `"15/2"`, `"6"` or `"7.5"`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kernel {
    /// b, what the own vehicle can brake at, in m/s².
    #[serde(with = "rational")]
    pub ego_brake_mps2: BigRational,
    /// c, what the vehicle ahead never brakes harder than, in m/s².
    #[serde(with = "rational")]
    pub leader_brake_mps2: BigRational,
    /// Time between two decisions, in seconds. The proof holds for any; a shield is built for one.
    #[serde(with = "rational")]
    pub step_s: BigRational,
    /// Demanded on top of D, in metres.
    #[serde(with = "rational")]
    pub margin_m: BigRational,
    /// Coefficients of D where the own vehicle stops last, or brakes no harder than the one ahead.
    pub stopping: Stopping,
    /// Coefficient of D elsewhere; only where the own vehicle brakes harder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub catching_up: Option<CatchingUp>,
}

/// D = max(0, p v² + q w²).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stopping {
    /// p, in s²/m.
    #[serde(with = "rational")]
    pub own_squared: BigRational,
    /// q, in s²/m.
    #[serde(with = "rational")]
    pub ahead_squared: BigRational,
}

/// D = r max(0, v - w)².
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CatchingUp {
    /// r, in s²/m.
    #[serde(with = "rational")]
    pub closing_squared: BigRational,
}

/// Why a kernel is not proved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum KernelFlaw {
    /// A number that must be positive is not.
    #[error("`{0}` must be positive")]
    NotPositive(&'static str),
    /// The second piece is missing although the own vehicle brakes harder, or is there although it does not.
    #[error("`catching_up` must be there exactly where the own vehicle brakes harder than the one ahead")]
    Pieces,
    /// The closed form falls short of the closing distance, or is never reached.
    #[error("the stated form of D fails where {0}")]
    Case(&'static str),
}

impl Kernel {
    /// The closed form for a pair of limits.
    #[must_use]
    pub fn closed_form(b: &BigRational, c: &BigRational, step_s: &BigRational, margin_m: &BigRational) -> Self {
        let half = BigRational::new(1.into(), 2.into());
        let catches_up = b > c && c.is_positive();
        let over = |divisor: BigRational| if divisor.is_zero() { divisor } else { &half / divisor };
        Self {
            ego_brake_mps2: b.clone(),
            leader_brake_mps2: c.clone(),
            step_s: step_s.clone(),
            margin_m: margin_m.clone(),
            stopping: Stopping { own_squared: over(b.clone()), ahead_squared: -over(c.clone()) },
            catching_up: catches_up.then(|| CatchingUp { closing_squared: over(b - c) }),
        }
    }

    /// D(v, w) in metres as the certificate states it.
    #[must_use]
    pub fn demanded_gap_m(&self, v: &BigRational, w: &BigRational) -> BigRational {
        let zero = BigRational::zero;
        match &self.catching_up {
            Some(piece) if v * &self.leader_brake_mps2 < w * &self.ego_brake_mps2 => {
                let closing = (v - w).max(zero());
                &piece.closing_squared * &closing * &closing
            }
            _ => (&self.stopping.own_squared * v * v + &self.stopping.ahead_squared * w * w).max(zero()),
        }
    }

    /// Checks the proof.
    ///
    /// # Errors
    /// [`KernelFlaw`] names the first case in which it fails.
    pub fn check(&self) -> Result<(), KernelFlaw> {
        for (name, value) in [
            ("ego_brake_mps2", &self.ego_brake_mps2),
            ("leader_brake_mps2", &self.leader_brake_mps2),
            ("step_s", &self.step_s),
            ("margin_m", &self.margin_m),
        ] {
            if !value.is_positive() {
                return Err(KernelFlaw::NotPositive(name));
            }
        }
        let brakes_harder = self.ego_brake_mps2 > self.leader_brake_mps2;
        let pair = Pair { b: &self.ego_brake_mps2, c: &self.leader_brake_mps2 };
        let cases = match (&self.catching_up, brakes_harder) {
            (Some(piece), true) => {
                [pair.stops_last(&self.stopping), pair.brakes_harder(), pair.catches_up(piece)].concat()
            }
            (None, false) => [pair.stops_last(&self.stopping), pair.brakes_softer(&self.stopping)].concat(),
            _ => return Err(KernelFlaw::Pieces),
        };
        match cases.into_iter().find(|(_, holds)| !holds) {
            Some((case, _)) => Err(KernelFlaw::Case(case)),
            None => Ok(()),
        }
    }
}

/// What happens in a case, and whether the closed form is right there.
type Case = (&'static str, bool);

/// The two limits, and the polynomials they make. `a` and `b` are times to standstill, `t` an instant.
struct Pair<'a> {
    b: &'a BigRational,
    c: &'a BigRational,
}

impl Pair<'_> {
    /// What is covered up to t while braking at `rate` with `stop` to go: rate (stop t - t²/2).
    fn moving(rate: &BigRational, stop: &Polynomial, t: &Polynomial) -> Polynomial {
        let half = BigRational::new(1.into(), 2.into());
        rate * &(&(stop * t) - &(&half * &t.squared()))
    }

    /// closing(t) while both move: b (A t - t²/2) - c (B t - t²/2). A vehicle that stands has t = its own stop.
    fn closing(&self, [a, ta]: [&Polynomial; 2], [b, tb]: [&Polynomial; 2]) -> Polynomial {
        &Self::moving(self.b, a, ta) - &Self::moving(self.c, b, tb)
    }

    /// S = p v² + q w² with v = b A and w = c B.
    fn difference_of_stops(&self, piece: &Stopping, a: &Polynomial, b: &Polynomial) -> Polynomial {
        let (v, w) = (self.b * a, self.c * b);
        &(&piece.own_squared * &v.squared()) + &(&piece.ahead_squared * &w.squared())
    }

    /// S is what closing comes to in the end, and bounds it from the leader's stop on; A and B in any order.
    fn stops_last(&self, piece: &Stopping) -> Vec<Case> {
        let [x, y, z] = Polynomial::variables();
        let s_of = |a: &Polynomial, b: &Polynomial| self.difference_of_stops(piece, a, b);
        // Both stand: A = x, B = y. Where S >= 0 this is also the instant at which D = S is reached; else D = 0 at t = 0.
        let both_stand = &s_of(&x, &y) - &self.closing([&x, &x], [&y, &y]);
        // Only the leader stands: B = x, t = x + y, A = x + y + z.
        let (t, a) = (&x + &y, &(&x + &y) + &z);
        let leader_stands = &s_of(&a, &x) - &self.closing([&a, &t], [&x, &x]);
        vec![
            ("both stand", both_stand.is_zero()),
            ("only the vehicle ahead stands", leader_stands.has_no_negative_coefficient()),
        ]
    }

    /// b > c, and the own vehicle stops last: S also bounds what comes before the leader's stop.
    fn brakes_harder(&self) -> Vec<Case> {
        let [x, y, z] = Polynomial::variables();
        // t = x, B = x + y, A = x + y + z: what is still to come is never negative.
        let (b, a) = (&x + &y, &(&x + &y) + &z);
        let at_end = self.closing([&a, &a], [&b, &b]);
        let to_come = &at_end - &self.closing([&a, &x], [&b, &x]);
        vec![("both move, the own vehicle brakes harder and stops last", to_come.has_no_negative_coefficient())]
    }

    /// b > c, and the own vehicle stops first: D = r (v - w)² where v > w, else 0.
    fn catches_up(&self, piece: &CatchingUp) -> Vec<Case> {
        let [x, y, z] = Polynomial::variables();
        let harder = self.b - self.c;
        let half_harder = &harder / BigRational::from_integer(2.into());
        // Both move. Free of the order of t, A and B: D - closing = (b - c)/2 · (t - t*)², t* = (v - w)/(b - c).
        let (t, a, b) = (&x, &y, &z);
        let (v, w) = (self.b * a, self.c * b);
        let demanded = &piece.closing_squared * &(&v - &w).squared();
        let turn = &harder.recip() * &(&v - &w);
        let short_by = &demanded - &self.closing([a, t], [b, t]);
        let both_move = &short_by - &(&half_harder * &(t - &turn).squared());
        // The square is 0 at t = t*, so D is reached there, if 0 <= t* <= A: with A = x and B = x + y the latter is
        let before_stop = &x - &(&harder.recip() * &(&(self.b * &x) - &(self.c * &(&x + &y))));
        // Where w = v + z, closing is never positive before the own stop: A = x, t = y, c B = b x + z.
        let ahead = &self.c.recip() * &(&(self.b * &x) + &z);
        let falling_back = -&self.closing([&x, &y], [&ahead, &y]);
        // Only the own vehicle stands: A = x, t = x + y, B = x + y + z. Closing has not grown since its stop.
        let (t, b) = (&x + &y, &(&x + &y) + &z);
        let since_stop = &self.closing([&x, &x], [&b, &x]) - &self.closing([&x, &x], [&b, &t]);
        vec![
            ("both move, the own vehicle brakes harder and stops first", both_move.is_zero()),
            ("the own vehicle is as slow as the one ahead before it stops", before_stop.has_no_negative_coefficient()),
            ("the own vehicle is slower", falling_back.has_no_negative_coefficient()),
            ("only the own vehicle stands, having braked harder", since_stop.has_no_negative_coefficient()),
        ]
    }

    /// b <= c: D = max(0, S), whoever stops first.
    fn brakes_softer(&self, piece: &Stopping) -> Vec<Case> {
        let [x, y, z] = Polynomial::variables();
        // Both move, the leader stops first: t = x, B = x + y, A = x + y + z. closing <= (t/B) S, as t S - B closing >= 0.
        let (b, a) = (&x + &y, &(&x + &y) + &z);
        let stop_ahead = &(&x * &self.difference_of_stops(piece, &a, &b)) - &(&b * &self.closing([&a, &x], [&b, &x]));
        // The own vehicle stops first: closing <= 0 throughout. Both move: t = x, A = x + y, B = x + y + z.
        let both_move = -&self.closing([&b, &x], [&a, &x]);
        // Only the own vehicle stands: A = x, t = x + y, B = x + y + z.
        let own_stands = -&self.closing([&x, &x], [&a, &b]);
        // Both stand: A = x, B = x + y.
        let both_stand = -&self.closing([&x, &x], [&b, &b]);
        vec![
            ("both move, the own vehicle stops last", stop_ahead.has_no_negative_coefficient()),
            ("both move, the own vehicle stops first", both_move.has_no_negative_coefficient()),
            ("only the own vehicle stands", own_stands.has_no_negative_coefficient()),
            ("both stand, the own vehicle stopped first", both_stand.has_no_negative_coefficient()),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(text: &str) -> BigRational {
        rational::parse(text).unwrap()
    }

    fn kernel(b: &str, c: &str) -> Kernel {
        Kernel::closed_form(&number(b), &number(c), &number("1/100"), &number("1e-6"))
    }

    #[test]
    fn closed_forms_are_accepted_whatever_the_limits() {
        for (b, c) in
            [("7.5", "7.5"), ("7.5", "6"), ("6", "7.5"), ("6", "6"), ("8", "5"), ("0.075", "30"), ("30", "0.1")]
        {
            assert_eq!(kernel(b, c).check(), Ok(()), "{b} {c}");
        }
    }

    #[test]
    fn a_change_of_any_number_that_matters_is_rejected() {
        for (b, c) in [("7.5", "7.5"), ("7.5", "6"), ("6", "7.5"), ("8", "5")] {
            let json = serde_json::to_value(kernel(b, c)).unwrap();
            let mut rejected = 0;
            for path in [
                "/ego_brake_mps2",
                "/leader_brake_mps2",
                "/stopping/own_squared",
                "/stopping/ahead_squared",
                "/catching_up/closing_squared",
            ] {
                for factor in ["2", "101/100", "999999/1000000", "0", "-1"] {
                    let mut mutant = json.clone();
                    let Some(value) = mutant.pointer_mut(path) else { continue };
                    let changed = number(value.as_str().unwrap()) * number(factor);
                    *value = changed.to_string().into();
                    let mutant: Kernel = serde_json::from_value(mutant).unwrap();
                    assert!(mutant.check().is_err(), "{b} {c} {path} times {factor}");
                    rejected += 1;
                }
            }
            assert_eq!(rejected, if json.get("catching_up").is_some() { 25 } else { 20 });
        }
    }

    #[test]
    fn the_familiar_distance_alone_is_rejected_where_the_own_vehicle_brakes_harder() {
        let rss = Kernel { catching_up: None, ..kernel("8", "5") };
        assert_eq!(rss.check(), Err(KernelFlaw::Pieces));
        let needless = Kernel { catching_up: kernel("8", "5").catching_up, ..kernel("5", "8") };
        assert_eq!(needless.check(), Err(KernelFlaw::Pieces));
        let none = Kernel { margin_m: number("0"), ..kernel("8", "5") };
        assert_eq!(none.check(), Err(KernelFlaw::NotPositive("margin_m")));
    }

    /// The argument's conclusion, tried out by brute force over time with exact numbers.
    #[test]
    fn the_demanded_gap_is_the_largest_closing_distance() {
        let distance = |u: &BigRational, rate: &BigRational, t: &BigRational| {
            let until = t.clone().min(u / rate);
            u * &until - rate * &until * &until / number("2")
        };
        for (b, c) in [("7.5", "6"), ("6", "7.5"), ("6", "6"), ("8", "5")] {
            let kernel = kernel(b, c);
            let (b, c) = (number(b), number(c));
            for (v, w) in [("25", "20"), ("20", "25"), ("25", "24"), ("30", "3"), ("0", "4"), ("9", "0"), ("25", "23")]
            {
                let (v, w) = (number(v), number(w));
                let demanded = kernel.demanded_gap_m(&v, &w);
                let sixtieths = 0..60 * 60;
                let closing = sixtieths.map(|k| {
                    let t = BigRational::new(k.into(), 600.into());
                    distance(&v, &b, &t) - distance(&w, &c, &t)
                });
                let largest = closing.max().unwrap();
                assert!(largest <= demanded && demanded < &largest + number("1e-5"), "{demanded} {largest}");
            }
        }
    }

    #[test]
    fn the_note_s_example_demands_4_17_m() {
        assert_eq!(kernel("8", "5").demanded_gap_m(&number("25"), &number("20")), number("25/6"));
    }
}
