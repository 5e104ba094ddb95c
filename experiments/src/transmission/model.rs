//! Automatic transmission: a public benchmark of falsification tools (ARCH-COMP, falsification category; Hoxha, Abbas
//! and Fainekos, Benchmarks for temporal logic requirements for automotive systems, ARCH 2014).
//!
//! A car with a torque converter and four gears. Inputs are throttle (0 to 100) and brake torque (0 to 325), piecewise
//! constant over 30 s. The model is that of the Simulink file `Autotrans_shift`: engine speed N (rpm, limited to 600
//! to 6000) and wheel speed w, `ratio = g 3.23 w / N`, in gear g:
//!
//! ```text
//! N' = (engine(throttle, N) - impeller) / 0.02199      impeller = (N / K(ratio))^2
//! w' = (3.23 g turbine - sign(v) (40 + 0.02 v^2 + brake)) / 12.09      turbine = impeller torque_ratio(ratio)
//! ```
//!
//! The speed v = 2π w 60 / 5280 is in mph. Every 0.04 s a shift logic compares v with thresholds, which depend on
//! throttle and gear, and shifts after 0.08 s beyond a threshold. Functions are tables with linear inter- and
//! extrapolation. As in Simulink, each step of 0.01 s is one of Dormand and Prince's method of order 5.

use std::f64::consts::PI;

use crumple_measure::stl::{SampledSignals, SignalsError};

pub(super) const STEP_S: f64 = 0.01;
pub(super) const DURATION_S: usize = 30;
const STEPS: usize = 100 * DURATION_S;
const STEPS_PER_SHIFT_DECISION: usize = 4;
/// Number of decisions between reaching a threshold and the shift.
const SHIFT_DELAY: usize = 2;

pub(super) const MAX_THROTTLE: f64 = 100.0;
pub(super) const MAX_BRAKE: f64 = 325.0;

const ENGINE_INERTIA: f64 = 0.021_991_488_283_555_9;
const VEHICLE_INERTIA: f64 = 12.094_147_857_312_47;
const FINAL_DRIVE: f64 = 3.23;
const ENGINE_RPM: [f64; 2] = [600.0, 6000.0];
const MPH_PER_WHEEL_SPEED: f64 = 2.0 * PI * 60.0 / 5280.0;
const GEAR_RATIOS: [f64; 4] = [2.393, 1.450, 1.000, 0.677];

/// Engine torque, one row for each speed in [`TORQUE_RPM`], one column for each throttle in [`TORQUE_THROTTLE`].
const TORQUE: [[f64; 10]; 11] = [
    [
        -40.0, 215.0, 245.0, 264.0, 264.0, 267.0, 267.0, 267.0, 267.0, 267.0,
    ],
    [
        -44.0, 117.0, 208.0, 260.0, 279.0, 290.0, 297.0, 301.0, 301.0, 301.0,
    ],
    [
        -49.0, 85.0, 178.0, 241.0, 282.0, 293.0, 305.0, 308.0, 312.0, 312.0,
    ],
    [
        -53.0, 66.0, 148.0, 219.0, 275.0, 297.0, 305.0, 312.0, 319.0, 319.0,
    ],
    [
        -57.0, 44.0, 122.0, 193.0, 260.0, 290.0, 305.0, 319.0, 327.0, 327.0,
    ],
    [
        -61.0, 29.0, 104.0, 167.0, 238.0, 275.0, 301.0, 323.0, 327.0, 334.0,
    ],
    [
        -65.0, 10.0, 85.0, 152.0, 223.0, 260.0, 293.0, 319.0, 327.0, 334.0,
    ],
    [
        -70.0, -2.0, 66.0, 133.0, 208.0, 256.0, 282.0, 316.0, 327.0, 334.0,
    ],
    [
        -74.0, -13.0, 48.0, 119.0, 189.0, 234.0, 267.0, 297.0, 312.0, 319.0,
    ],
    [
        -78.0, -22.0, 33.0, 96.0, 171.0, 212.0, 249.0, 279.0, 293.0, 305.0,
    ],
    [
        -82.0, -32.0, 18.0, 85.0, 152.0, 193.0, 226.0, 253.0, 267.0, 275.0,
    ],
];
const TORQUE_RPM: [f64; 11] = [
    800.0, 1200.0, 1600.0, 2000.0, 2400.0, 2800.0, 3200.0, 3600.0, 4000.0, 4400.0, 4800.0,
];
const TORQUE_THROTTLE: [f64; 10] = [0.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0];

/// Torque converter by speed ratio: K factor and torque ratio.
const SPEED_RATIO: [f64; 21] = [
    0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.81, 0.82, 0.83, 0.84, 0.85, 0.86, 0.87, 0.88,
    0.89, 0.9, 0.92, 0.94,
];
const K_FACTOR: [f64; 21] = [
    137.465_208_993_806,
    137.065_019_156_852,
    135.864_449_645_989,
    135.664_354_727_512,
    137.565_256_453_045,
    140.366_585_311_725,
    145.268_910_814_415,
    152.872_517_716_547,
    162.977_311_099_644,
    164.277_928_069_745,
    166.178_829_795_278,
    167.979_684_061_573,
    170.080_680_705_583,
    172.781_962_105_024,
    175.383_196_045_227,
    179.585_189_333_248,
    183.587_087_702_791,
    189.890_077_634_821,
    197.693_779_455_430,
    215.902_417_036_852,
    244.515_990_379_085,
];
const TORQUE_RATIO: [f64; 21] = [
    2.232, 2.075, 1.975, 1.846, 1.72, 1.564, 1.409, 1.254, 1.096, 1.08, 1.061, 1.043, 1.028, 1.012,
    1.002, 1.002, 1.001, 0.998, 0.999, 1.001, 1.002,
];

/// Speeds in mph above which each gear but the last is left upwards, and below which each is left downwards.
const UP_THROTTLE: [f64; 6] = [0.0, 25.0, 35.0, 50.0, 90.0, 100.0];
const UP_MPH: [[f64; 6]; 3] = [
    [10.0, 10.0, 15.0, 23.0, 40.0, 40.0],
    [30.0, 30.0, 30.0, 41.0, 70.0, 70.0],
    [50.0, 50.0, 50.0, 60.0, 100.0, 100.0],
];
const DOWN_THROTTLE: [f64; 6] = [0.0, 5.0, 40.0, 50.0, 90.0, 100.0];
const DOWN_MPH: [[f64; 6]; 4] = [
    [0.0; 6],
    [5.0, 5.0, 5.0, 5.0, 30.0, 30.0],
    [20.0, 20.0, 25.0, 30.0, 50.0, 50.0],
    [35.0, 35.0, 40.0, 50.0, 80.0, 80.0],
];

/// Returns the index of the interval of increasing `knots` that contains x or is next to it, and x within it.
fn interval(knots: &[f64], x: f64) -> (usize, f64) {
    let index = knots
        .partition_point(|knot| *knot <= x)
        .clamp(1, knots.len() - 1)
        - 1;
    (
        index,
        (x - knots[index]) / (knots[index + 1] - knots[index]),
    )
}

fn blend(values: &[f64], (index, part): (usize, f64)) -> f64 {
    values[index] + part * (values[index + 1] - values[index])
}

fn lookup(knots: &[f64], values: &[f64], x: f64) -> f64 {
    blend(values, interval(knots, x))
}

fn engine_torque(throttle: f64, rpm: f64) -> f64 {
    let row = interval(&TORQUE_RPM, rpm);
    let column = interval(&TORQUE_THROTTLE, throttle);
    blend(
        &[
            blend(&TORQUE[row.0], column),
            blend(&TORQUE[row.0 + 1], column),
        ],
        (0, row.1),
    )
}

/// Engine speed in rpm and wheel speed.
type State = [f64; 2];

/// Returns the derivatives of a state in a gear, from 0.
fn derivatives([rpm, wheel]: State, gear: usize, throttle: f64, brake: f64) -> State {
    let rpm = rpm.clamp(ENGINE_RPM[0], ENGINE_RPM[1]);
    let ratio = interval(&SPEED_RATIO, GEAR_RATIOS[gear] * FINAL_DRIVE * wheel / rpm);
    let impeller = (rpm / blend(&K_FACTOR, ratio)).powi(2);
    let engine = (engine_torque(throttle, rpm) - impeller) / ENGINE_INERTIA;
    let is_limited = rpm <= ENGINE_RPM[0] && engine < 0.0 || rpm >= ENGINE_RPM[1] && engine > 0.0;
    let output = impeller * blend(&TORQUE_RATIO, ratio) * GEAR_RATIOS[gear];
    let mph = wheel * MPH_PER_WHEEL_SPEED;
    let load = if mph == 0.0 {
        0.0
    } else {
        (40.0 + 0.02 * mph * mph + brake) * mph.signum()
    };
    [
        if is_limited { 0.0 } else { engine },
        (FINAL_DRIVE * output - load) / VEHICLE_INERTIA,
    ]
}

/// Coefficients of Dormand and Prince: each row has the weights of the derivatives so far; the last one is the step.
const DORMAND_PRINCE: [&[f64]; 6] = [
    &[1.0 / 5.0],
    &[3.0 / 40.0, 9.0 / 40.0],
    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
    &[
        19372.0 / 6561.0,
        -25360.0 / 2187.0,
        64448.0 / 6561.0,
        -212.0 / 729.0,
    ],
    &[
        9017.0 / 3168.0,
        -355.0 / 33.0,
        46732.0 / 5247.0,
        49.0 / 176.0,
        -5103.0 / 18656.0,
    ],
    &[
        35.0 / 384.0,
        0.0,
        500.0 / 1113.0,
        125.0 / 192.0,
        -2187.0 / 6784.0,
        11.0 / 84.0,
    ],
];

fn step(state: State, gear: usize, throttle: f64, brake: f64) -> State {
    let mut slopes = [[0.0; 2]; 6];
    let mut at = state;
    for (stage, weights) in DORMAND_PRINCE.iter().enumerate() {
        slopes[stage] = derivatives(at, gear, throttle, brake);
        at = std::array::from_fn(|i| {
            let slope: f64 = weights
                .iter()
                .zip(&slopes)
                .map(|(w, slope)| w * slope[i])
                .sum();
            state[i] + STEP_S * slope
        });
    }
    [at[0].clamp(ENGINE_RPM[0], ENGINE_RPM[1]), at[1]]
}

/// Shift that the logic considers, with the number of decisions since its threshold was reached.
#[derive(Clone, Copy)]
enum Selection {
    Steady,
    Up(usize),
    Down(usize),
}

/// Returns the next gear, from 0, and selection at a decision.
fn decide(gear: usize, selection: Selection, mph: f64, throttle: f64) -> (usize, Selection) {
    let up = UP_MPH
        .get(gear)
        .map_or(f64::INFINITY, |row| lookup(&UP_THROTTLE, row, throttle));
    let down = lookup(&DOWN_THROTTLE, &DOWN_MPH[gear], throttle);
    match selection {
        Selection::Steady if mph > up => (gear, Selection::Up(0)),
        Selection::Steady if mph < down => (gear, Selection::Down(0)),
        Selection::Up(waited) if mph >= up && waited + 1 >= SHIFT_DELAY => {
            ((gear + 1).min(3), Selection::Steady)
        }
        Selection::Up(waited) if mph >= up => (gear, Selection::Up(waited + 1)),
        Selection::Down(waited) if mph <= down && waited + 1 >= SHIFT_DELAY => {
            (gear.saturating_sub(1), Selection::Steady)
        }
        Selection::Down(waited) if mph <= down => (gear, Selection::Down(waited + 1)),
        _ => (gear, Selection::Steady),
    }
}

/// Simulates the car and returns the signals `speed` (mph), `rpm` and `gear` (1 to 4). Throttle and brake are functions
/// of the time in seconds.
///
/// # Errors
/// [`SignalsError`] if a value is not a number.
pub(super) fn simulate(
    inputs: impl Fn(f64) -> [f64; 2],
) -> Result<SampledSignals<'static>, SignalsError> {
    let mut traces: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(STEPS + 1));
    let mut state = [1000.0, 0.0];
    let mut gear = 0;
    let mut selection = Selection::Steady;
    for k in 0..=STEPS {
        let [throttle, brake] = inputs(k as f64 * STEP_S);
        let mph = state[1] * MPH_PER_WHEEL_SPEED;
        // At the first decision the logic only starts.
        if k > 0 && k % STEPS_PER_SHIFT_DECISION == 0 {
            (gear, selection) = decide(gear, selection, mph, throttle);
        }
        for (trace, value) in traces.iter_mut().zip([mph, state[0], gear as f64 + 1.0]) {
            trace.push(value);
        }
        state = step(state, gear, throttle, brake);
    }
    let mut signals = SampledSignals::new(STEP_S, STEPS + 1)?;
    for (name, trace) in ["speed", "rpm", "gear"].into_iter().zip(traces) {
        signals.insert(name, trace)?;
    }
    Ok(signals)
}
