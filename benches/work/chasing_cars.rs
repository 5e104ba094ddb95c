//! Chasing Cars: a public benchmark of falsification tools (ARCH-COMP, falsification category; first posed by Hu,
//! Lygeros and Sastry, Towards a theory of stochastic hybrid systems, HSCC 2000).
//!
//! Five cars follow one another for 100 s. Inputs are throttle and brake of the first, each in [0, 1] and constant over
//! 20 pieces of 5 s (instance 2). Car 1 has `v' = -throttle - brake v` and `y' = v`. The others observe the gap `g =
//! y_i - y_(i-1)` and switch between three modes, checked at the start of every step of 0.01 s:
//!
//! | mode | motion | switches |
//! |---|---|---|
//! | keeping (first) | `v' = 0, y' = v` | to chasing if `g >= 15`, else to braking if `g <= 5` |
//! | chasing | `v' = 1, y' = -v` | to keeping if `g <= 10` |
//! | braking | `v' = -v, y' = -v` | to chasing if `g >= 20` |
//!
//! The sign of y' in the last two is as published. Each step is the exact solution of its mode.

use std::error::Error;

use crumple_measure::stl::{Formula, SampledSignals, SignalsError};

pub const STEP_S: f64 = 0.01;
/// Number of steps: 100 s.
const STEPS: usize = 10_000;
/// Number of pieces of each input.
pub const PIECES: usize = 20;
const STEPS_PER_PIECE: usize = STEPS / PIECES;

/// Names and formulas of the six specifications, over y1 to y5.
///
/// Published versions differ: CC4 has an innermost window of 5 s, as here, or of 20 s; CC3 has `y5 - y4 >= 40`, as
/// here, or `<=`. Results of one version do not apply to the other.
pub const SPECIFICATIONS: [(&str, &str); 6] = [
    ("CC1", "always[0,100] y5 - y4 <= 40"),
    ("CC2", "always[0,70] eventually[0,30] y5 - y4 >= 15"),
    (
        "CC3",
        "always[0,80] (always[0,20] y2 - y1 <= 20 or eventually[0,20] y5 - y4 >= 40)",
    ),
    (
        "CC4",
        "always[0,65] eventually[0,30] always[0,5] y5 - y4 >= 8",
    ),
    (
        "CC5",
        "always[0,72] eventually[0,8] (always[0,5] y2 - y1 >= 9 implies always[5,20] y5 - y4 >= 9)",
    ),
    (
        "CCx",
        "always[0,50] y2 - y1 > 7.5 and always[0,50] y3 - y2 > 7.5 and always[0,50] y4 - y3 > 7.5 \
         and always[0,50] y5 - y4 > 7.5",
    ),
];

/// Throttle and brake over each piece, in [0, 1].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChasingCarsInputs {
    /// Throttle over each 5 s.
    pub throttle: [f64; PIECES],
    /// Brake over each 5 s.
    pub brake: [f64; PIECES],
}

impl ChasingCarsInputs {
    /// Converts a point of the unit cube, first throttle, then brake; missing coordinates are 0.
    #[must_use]
    pub fn from_unit(point: &[f64]) -> Self {
        let at = |index: usize| point.get(index).copied().unwrap_or(0.0);
        Self {
            throttle: std::array::from_fn(at),
            brake: std::array::from_fn(|piece| at(PIECES + piece)),
        }
    }
}

/// Positions of the five cars at each of the 10 001 samples.
#[derive(Debug, Clone, PartialEq)]
pub struct CarTrajectories {
    /// Positions y1 to y5.
    pub position: [Vec<f64>; 5],
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Mode {
    Keeping,
    Chasing,
    Braking,
}

impl Mode {
    #[inline]
    fn after_guards(self, gap: f64) -> Self {
        match self {
            Self::Keeping if gap >= 15.0 => Self::Chasing,
            Self::Keeping if gap <= 5.0 => Self::Braking,
            Self::Chasing if gap <= 10.0 => Self::Keeping,
            Self::Braking if gap >= 20.0 => Self::Chasing,
            same => same,
        }
    }
}

/// Exact step of car 1: `v(t) = v e^(-bt) - a k1(t)`, `y(t) = y + v k1(t) - a k2(t)`, k1 = ∫ e^(-bt), k2 = ∫ k1.
struct LeaderStep {
    decay: f64,
    k1: f64,
    k2: f64,
    throttle: f64,
}

impl LeaderStep {
    fn new(throttle: f64, brake: f64) -> Self {
        let x = brake * STEP_S;
        let k1 = if x == 0.0 {
            STEP_S
        } else {
            -(-x).exp_m1() / brake
        };
        // (x - 1 + e^-x) / b² cancels at small x; its series does not.
        let k2 =
            STEP_S * STEP_S * (0.5 - x / 6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0))));
        Self {
            decay: (-x).exp(),
            k1,
            k2,
            throttle,
        }
    }

    #[inline]
    fn advance(&self, y: &mut f64, v: &mut f64) {
        *y += *v * self.k1 - self.throttle * self.k2;
        *v = *v * self.decay - self.throttle * self.k1;
    }
}

/// Simulates the model.
#[must_use]
pub fn simulate(inputs: &ChasingCarsInputs) -> CarTrajectories {
    let (decay, lost) = ((-STEP_S).exp(), -(-STEP_S).exp_m1());
    let mut y = [0.0, 10.0, 20.0, 30.0, 40.0];
    let mut v = [0.0_f64; 5];
    let mut mode = [Mode::Keeping; 5];
    let mut position: [Vec<f64>; 5] = y.map(|start| vec![start; STEPS + 1]);
    for piece in 0..PIECES {
        let lead = LeaderStep::new(inputs.throttle[piece], inputs.brake[piece]);
        for step in 1..=STEPS_PER_PIECE {
            let gaps: [f64; 4] = std::array::from_fn(|i| y[i + 1] - y[i]);
            lead.advance(&mut y[0], &mut v[0]);
            for i in 1..5 {
                mode[i] = mode[i].after_guards(gaps[i - 1]);
                match mode[i] {
                    Mode::Keeping => y[i] += v[i] * STEP_S,
                    Mode::Chasing => {
                        y[i] -= v[i] * STEP_S + 0.5 * STEP_S * STEP_S;
                        v[i] += STEP_S;
                    }
                    Mode::Braking => {
                        y[i] -= v[i] * lost;
                        v[i] *= decay;
                    }
                }
            }
            position
                .iter_mut()
                .zip(y)
                .for_each(|(track, y)| track[piece * STEPS_PER_PIECE + step] = y);
        }
    }
    CarTrajectories { position }
}

impl CarTrajectories {
    /// Returns the positions as signals y1 to y5.
    ///
    /// # Errors
    /// [`SignalsError`] if a position is not a number.
    pub fn signals(&self) -> Result<SampledSignals<'_>, SignalsError> {
        let mut signals = SampledSignals::new(STEP_S, self.position[0].len())?;
        for (name, track) in ["y1", "y2", "y3", "y4", "y5"]
            .into_iter()
            .zip(&self.position)
        {
            signals.insert(name, track.as_slice())?;
        }
        Ok(signals)
    }
}

/// Returns the robustness of a specification for given inputs.
///
/// # Errors
/// An error if the formula does not fit the model.
pub fn robustness(
    formula: &Formula,
    inputs: &ChasingCarsInputs,
) -> Result<f64, Box<dyn Error + Send + Sync>> {
    Ok(formula.robustness(&simulate(inputs).signals()?)?)
}
