//! Brake pressure and the anti-lock braking system of a multi-body vehicle.

/// Slip above which the system releases the brake of an axle; the tyre's peak on a dry road is at 0.15.
const RELEASE_SLIP: f64 = 0.2;
/// Slip below which the pressure of an axle rises again.
const APPLY_SLIP: f64 = 0.12;
/// Time constant of the release, in seconds.
const RELEASE_LAG_S: f64 = 0.02;
/// Speed below which the system does not act, in m/s.
const MIN_ABS_SPEED_MPS: f64 = 2.0;

/// Pressure of both axles, as the deceleration that it demands, in m/s².
#[derive(Debug, Clone)]
pub(super) struct BrakePressure {
    pub(super) pressure_mps2: [f64; 2],
    lag_s: f64,
    has_abs: bool,
    is_releasing: [bool; 2],
}

impl BrakePressure {
    pub(super) fn new(lag_s: f64, has_abs: bool) -> Self {
        Self {
            pressure_mps2: [0.0; 2],
            lag_s,
            has_abs,
            is_releasing: [false; 2],
        }
    }

    /// Changes the pressure towards a demand for `dt_s`, given the slip of each axle.
    pub(super) fn advance(&mut self, demand_mps2: f64, slip: [f64; 2], speed_mps: f64, dt_s: f64) {
        for ((pressure, is_releasing), slip) in self
            .pressure_mps2
            .iter_mut()
            .zip(&mut self.is_releasing)
            .zip(slip)
        {
            let threshold = if *is_releasing {
                APPLY_SLIP
            } else {
                RELEASE_SLIP
            };
            *is_releasing = self.has_abs && speed_mps > MIN_ABS_SPEED_MPS && slip > threshold;
            let [goal, lag_s] = if *is_releasing {
                [0.0, RELEASE_LAG_S]
            } else {
                [demand_mps2, self.lag_s]
            };
            *pressure = if lag_s > 0.0 {
                goal + (*pressure - goal) * libm::exp(-dt_s / lag_s)
            } else {
                goal
            };
        }
    }
}
