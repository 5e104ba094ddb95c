//! Safety kernel: the states from which a vehicle can avoid the one ahead, proved without a solver.
//!
//! # What is claimed
//!
//! A state is (g, v, w): bumper gap, own speed, speed of the vehicle ahead. The own vehicle can brake at b, the vehicle
//! ahead never brakes harder than c; both stop and stay, and a collision is g <= 0. For a vehicle that brakes at rate β
//! from speed u to standstill let P_β(u, t) = u t - β t²/2 until t = u/β, and u²/2β from then on. With
//!
//! ```text
//! closing(t) = P_b(v, t) - P_c(w, t),         D(v, w) = the largest closing(t) over t >= 0,
//! K = { g > D(v, w) }
//! ```
//!
//! the claim is that K is *exactly* the set of states from which a collision can be avoided, and that D has the closed
//! form whose coefficients p, q and r the certificate states:
//!
//! ```text
//! D = max(0, p v² + q w²)        if b <= c or v/b >= w/c     (p = 1/2b, q = -1/2c)
//! D = r max(0, v - w)²           otherwise                   (r = 1/2(b - c))
//! ```
//!
//! # What holds for all constants
//!
//! 1. *Full braking stays in K at every instant.* If both brake fully for a time s, stops included, the motion from
//!    (v_s, w_s) on is the rest of the motion from (v, w): P_β(u, s + t) = P_β(u, s) + P_β(u_s, t). So D(v_s, w_s) =
//!    (max over t >= s of closing(t)) - closing(s) <= D(v, w) - closing(s). The gap after s is g - closing(s). Hence
//!    **the margin g - D never falls**; s may lie inside a step and past any stop.
//! 2. *A fully braking leader is the worst.* A leader that never brakes harder than c has, after s, at least the speed
//!    max(w - c s, 0), and has covered at least P_c(w, s). P_c(w, t) is nondecreasing in w, so D is nonincreasing in w.
//!    Against any such leader the gap after s is no smaller, and the demanded gap no larger, than against full braking,
//!    whatever the own vehicle does. So a test against full braking of the leader at every instant of one step covers
//!    all leaders. The end of the step is not enough: a vehicle that brakes harder than its leader may be closest in
//!    mid-step and still end in K.
//! 3. *Outside K a collision is unavoidable.* The own vehicle covers at least P_b(v, t) likewise. Behind a fully
//!    braking leader, the gap at the instant of the largest closing(t) is at most g - D(v, w) <= 0.
//! 4. *Friction.* P_{μβ}(u, t) = P_β(u, μ t)/μ, so on a road that allows the share μ of both limits D is the same
//!    function divided by μ, and 1 to 3 hold again. If the limits scale differently, the certificate is for the scaled
//!    limits.
//!
//! A margin m > 0, demanded on top of D, covers floating-point evaluation; by 1 full braking keeps it too.
//!
//! # What is checked for the constants
//!
//! The closed form must equal the largest closing(t). With A = v/b and B = w/c, the times to standstill, everything is
//! a polynomial. Each case orders 0, t, A and B, writes the differences as variables x, y, z >= 0, and expands exactly.
//! A polynomial without negative coefficients is then nonnegative. One case needs a perfect square besides.

use num_rational::BigRational;
use num_traits::Signed;
use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::polynomial::Polynomial;
use crate::rejection::Rejection;
use crate::scope::Scope;
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

/// Cost for the longest numbers; the polynomials are always the same.
const OPS_PER_CHECK: u64 = 50_000_000;
const MAX_NUMBER_CHARS: usize = 100;

/// A kernel for one pair of brake limits. Numbers are exact quotients: `"15/2"` or `"6"`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KernelClaim {
    /// b, deceleration of which the own vehicle is capable, in m/s².
    pub ego_brake_mps2: String,
    /// c, largest deceleration of the vehicle ahead, in m/s².
    pub leader_brake_mps2: String,
    /// Time between two decisions, in seconds. The proof holds for any; a shield is built for one.
    pub step_s: String,
    /// m, demanded on top of D, in metres.
    pub margin_m: String,
    /// p, in s²/m.
    pub stopping_own_squared: String,
    /// q, in s²/m.
    pub stopping_ahead_squared: String,
    /// r, in s²/m; only if the own vehicle brakes harder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub catching_up_squared: Option<String>,
}

impl Claim for KernelClaim {
    fn name(&self) -> &'static str {
        "kernel"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::AnyVehicles
    }

    fn assumptions(&self) -> Vec<Assumption> {
        vec![
            Assumption::ExactMotion,
            Assumption::LeaderWithinLimit,
            Assumption::EgoCanBrake,
        ]
    }

    fn scope(&self) -> Scope {
        // Texts from a file must not control a terminal.
        let [b, c, step_s, margin_m] = [
            &self.ego_brake_mps2,
            &self.leader_brake_mps2,
            &self.step_s,
            &self.margin_m,
        ]
        .map(|text| text.escape_debug());
        let vehicles = vec![
            format!("ahead: never brakes harder than {c} m/s², and does not reverse"),
            format!("own: can brake at {b} m/s² from every decision on"),
        ];
        let limits = vec![format!(
            "for any step and margin, {step_s} s and {margin_m} m among them; real numbers, the true state, neither \
             lag nor delay"
        )];
        Scope {
            behind: Some("behind: not considered".to_owned()),
            ..Scope::new(Some(f64::INFINITY), vehicles, limits)
        }
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        input.work.charge_or_reject(OPS_PER_CHECK)?;
        let b = parse_positive("ego_brake_mps2", &self.ego_brake_mps2)?;
        let c = parse_positive("leader_brake_mps2", &self.leader_brake_mps2)?;
        parse_positive("step_s", &self.step_s)?;
        parse_positive("margin_m", &self.margin_m)?;
        let p = parse_rational("stopping_own_squared", &self.stopping_own_squared)?;
        let q = parse_rational("stopping_ahead_squared", &self.stopping_ahead_squared)?;
        let r = self
            .catching_up_squared
            .as_ref()
            .map(|text| parse_rational("catching_up_squared", text))
            .transpose()?;
        let limits = BrakeLimits {
            b: &b,
            c: &c,
            stopping_coefficients: [&p, &q],
        };
        let cases = limits.cases(r.as_ref())?;
        match cases.into_iter().find(|case| !case.holds()) {
            Some(case) => Err(Rejection::invalid("kernel", case.failure_message)),
            None => Ok(ProvedClaim::Kernel),
        }
    }
}

fn parse_positive(field: &'static str, text: &str) -> Result<BigRational, Rejection> {
    match parse_rational(field, text)? {
        value if value.is_positive() => Ok(value),
        _ => Err(Rejection::invalid(field, "must be positive")),
    }
}

fn parse_rational(field: &'static str, text: &str) -> Result<BigRational, Rejection> {
    let read = if text.len() > MAX_NUMBER_CHARS {
        None
    } else {
        text.parse().ok()
    };
    read.ok_or_else(|| Rejection::invalid(field, "must be a number such as \"15/2\""))
}

/// A condition on a polynomial in x, y, z >= 0 under which the closed form is right in one case: which vehicles move or
/// stand.
#[derive(Debug, Clone)]
struct ProofCase {
    failure_message: &'static str,
    polynomial: Polynomial,
    /// True if the polynomial must be zero; otherwise it must not be negative.
    must_be_zero: bool,
}

impl ProofCase {
    fn zero(failure_message: &'static str, polynomial: Polynomial) -> Self {
        Self {
            failure_message,
            polynomial,
            must_be_zero: true,
        }
    }

    fn nonnegative(failure_message: &'static str, polynomial: Polynomial) -> Self {
        Self {
            failure_message,
            polynomial,
            must_be_zero: false,
        }
    }

    fn holds(&self) -> bool {
        if self.must_be_zero {
            self.polynomial.is_zero()
        } else {
            self.polynomial.has_no_negative_coefficient()
        }
    }
}

/// The two limits b and c, and their polynomials. In the methods, `a` and `b` are the times A and B to standstill, and
/// `t` an instant.
struct BrakeLimits<'a> {
    b: &'a BigRational,
    c: &'a BigRational,
    /// p and q.
    stopping_coefficients: [&'a BigRational; 2],
}

impl BrakeLimits<'_> {
    /// Returns the distance covered up to t by a vehicle that stands from the time `stop` on: rate (stop t - t²/2).
    fn distance_covered(rate: &BigRational, stop: &Polynomial, t: &Polynomial) -> Polynomial {
        let half = BigRational::new(1.into(), 2.into());
        rate * &(&(stop * t) - &(&half * &t.squared()))
    }

    /// Returns closing(t) while both move: b (A t - t²/2) - c (B t - t²/2). For a vehicle that stands, t is its own
    /// stop.
    fn closing_distance(&self, [a, ta]: [&Polynomial; 2], [b, tb]: [&Polynomial; 2]) -> Polynomial {
        &Self::distance_covered(self.b, a, ta) - &Self::distance_covered(self.c, b, tb)
    }

    /// Returns S = p v² + q w² with v = b A and w = c B.
    fn difference_of_stops(&self, a: &Polynomial, b: &Polynomial) -> Polynomial {
        let v = self.b * a;
        let w = self.c * b;
        &(self.stopping_coefficients[0] * &v.squared())
            + &(self.stopping_coefficients[1] * &w.squared())
    }

    /// Returns all cases, with the coefficient r if b > c.
    fn cases(&self, r: Option<&BigRational>) -> Result<Vec<ProofCase>, Rejection> {
        match (r, self.b > self.c) {
            (Some(r), true) => Ok([
                &self.last_stop_cases()[..],
                &[self.harder_braking_case()],
                &self.catching_up_cases(r),
            ]
            .concat()),
            (None, false) => {
                Ok([&self.last_stop_cases()[..], &self.softer_braking_cases()].concat())
            }
            _ => Err(Rejection::invalid(
                "catching_up_squared",
                "must be present exactly if b > c",
            )),
        }
    }

    /// S is the final value of closing, and bounds it from the leader's stop on; A and B in any order.
    fn last_stop_cases(&self) -> [ProofCase; 2] {
        let [x, y, z] = Polynomial::variables();

        // Both stand: A = x, B = y. For S >= 0, D = S is reached at this instant; else D = 0 at t = 0.
        let both_stand =
            &self.difference_of_stops(&x, &y) - &self.closing_distance([&x, &x], [&y, &y]);
        // Only the leader stands: B = x, t = x + y, A = x + y + z.
        let t = &x + &y;
        let a = &t + &z;
        let leader_stands =
            &self.difference_of_stops(&a, &x) - &self.closing_distance([&a, &t], [&x, &x]);
        [
            ProofCase::zero("fails where both stand", both_stand),
            ProofCase::nonnegative("fails where only the vehicle ahead stands", leader_stands),
        ]
    }

    /// b > c, and the own vehicle stops last: S also bounds closing before the leader's stop.
    fn harder_braking_case(&self) -> ProofCase {
        let [x, y, z] = Polynomial::variables();
        // t = x, B = x + y, A = x + y + z: the remaining closing is never negative.
        let b = &x + &y;
        let a = &b + &z;
        let at_end = self.closing_distance([&a, &a], [&b, &b]);
        let to_come = &at_end - &self.closing_distance([&a, &x], [&b, &x]);
        ProofCase::nonnegative(
            "fails where both move, the own vehicle brakes harder and stops last",
            to_come,
        )
    }

    /// b > c, and the own vehicle stops first: D = r (v - w)² for v > w, else 0.
    fn catching_up_cases(&self, r: &BigRational) -> [ProofCase; 4] {
        let [x, y, z] = Polynomial::variables();
        let harder = self.b - self.c;
        let half_harder = &harder / BigRational::from_integer(2.into());
        // Both move, for any order of t, A and B: D - closing = (b - c)/2 · (t - t*)², t* = (v - w)/(b - c).
        let [t, a, b] = [&x, &y, &z];
        let v = self.b * a;
        let w = self.c * b;
        let demanded = r * &(&v - &w).squared();
        let turn = &harder.recip() * &(&v - &w);
        let short_by = &demanded - &self.closing_distance([a, t], [b, t]);
        let both_move = &short_by - &(&half_harder * &(t - &turn).squared());
        // The square is 0 at t = t*, so D is reached there, if 0 <= t* <= A. The condition t* <= A, with A = x and B =
        // x + y:
        let before_stop = &x - &(&harder.recip() * &(&(self.b * &x) - &(self.c * &(&x + &y))));
        // For w = v + z, closing is never positive before the own stop: A = x, t = y, c B = b x + z.
        let ahead = &self.c.recip() * &(&(self.b * &x) + &z);
        let falling_back = -&self.closing_distance([&x, &y], [&ahead, &y]);
        // Only the own vehicle stands: A = x, t = x + y, B = x + y + z. Closing has not grown since its stop.
        let t = &x + &y;
        let b = &t + &z;
        let since_stop =
            &self.closing_distance([&x, &x], [&b, &x]) - &self.closing_distance([&x, &x], [&b, &t]);
        [
            ProofCase::zero(
                "fails where both move, the own vehicle brakes harder and stops first",
                both_move,
            ),
            ProofCase::nonnegative(
                "fails where closing turns round after the own stop",
                before_stop,
            ),
            ProofCase::nonnegative("fails where the own vehicle is slower", falling_back),
            ProofCase::nonnegative(
                "fails where only the own vehicle stands, having braked harder",
                since_stop,
            ),
        ]
    }

    /// b <= c: D = max(0, S), for any order of stops.
    fn softer_braking_cases(&self) -> [ProofCase; 4] {
        let [x, y, z] = Polynomial::variables();
        // Both move, the leader stops first: t = x, B = x + y, A = x + y + z. closing <= (t/B) S, as t S - B closing >=
        // 0.
        let b = &x + &y;
        let a = &b + &z;
        let stop_ahead = &(&x * &self.difference_of_stops(&a, &b))
            - &(&b * &self.closing_distance([&a, &x], [&b, &x]));
        // The own vehicle stops first: closing <= 0 throughout. Both move: t = x, A = x + y, B = x + y + z.
        let both_move = -&self.closing_distance([&b, &x], [&a, &x]);
        // Only the own vehicle stands: A = x, t = x + y, B = x + y + z.
        let own_stands = -&self.closing_distance([&x, &x], [&a, &b]);
        // Both stand: A = x, B = x + y.
        let both_stand = -&self.closing_distance([&x, &x], [&b, &b]);
        [
            ProofCase::nonnegative(
                "fails where both move, the own vehicle stops last",
                stop_ahead,
            ),
            ProofCase::nonnegative(
                "fails where both move, the own vehicle stops first",
                both_move,
            ),
            ProofCase::nonnegative("fails where only the own vehicle stands", own_stands),
            ProofCase::nonnegative(
                "fails where both stand, the own vehicle stopped first",
                both_stand,
            ),
        ]
    }
}

#[cfg(test)]
mod tests;
