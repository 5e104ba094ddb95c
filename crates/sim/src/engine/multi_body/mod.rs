//! Multi-body plant: the straight-line part of the CommonRoad multi-body model, with brake pressure and an anti-lock
//! braking system. `docs/mathematics.md` has equations and sources.
//!
//! On a straight road both sides of a vehicle move equally, which leaves 12 of the 29 states. z points down.

mod body;
mod brake;
#[cfg(test)]
mod tests;

use self::body::{BodyParams, TyreParams, body_params};
use self::brake::BrakePressure;
use crate::scenario::BodyKind;

const GRAVITY_MPS2: f64 = 9.81;
/// Speed below which the wheels roll without slip, as in the CommonRoad model.
const ROLLING_SPEED_MPS: f64 = 0.1;
/// Maximum integration step, in seconds; resolves the motion of the axles.
const MAX_STEP_S: f64 = 2e-3;
/// Maximum product of the integration step and the rate of a wheel; the method is stable up to 2.7.
const MAX_STEP_RATE: f64 = 2.0;

/// Position (m), speed, pitch angle (rad) and rate, then vertical position and speed of the sprung mass, of the front
/// axle and of the rear axle, then the angular speeds of the front and the rear wheels (rad/s).
type BodyState = [f64; 12];
const POSITION: usize = 0;
const SPEED: usize = 1;
const PITCH: usize = 2;
const BODY_Z: usize = 4;
const AXLE_Z: [usize; 2] = [6, 8];
const WHEEL: [usize; 2] = [10, 11];

/// A multi-body vehicle and its state.
#[derive(Debug, Clone)]
pub(super) struct MultiBody {
    body: &'static BodyParams,
    friction: f64,
    state: BodyState,
    brake: BrakePressure,
}

/// Dead time of the brake of a vehicle, in seconds.
pub(super) fn brake_delay_s(kind: BodyKind) -> f64 {
    body_params(kind).brake.delay_s
}

impl MultiBody {
    /// Creates a vehicle in its equilibrium at a constant speed.
    pub(super) fn new(kind: BodyKind, friction: f64, speed_mps: f64) -> Self {
        let body = body_params(kind);
        let [a_m, b_m] = body.axle_m;
        let axle_z = |axle: usize, lever_m: f64| {
            let load_n = body.sprung_kg * GRAVITY_MPS2 * lever_m / (a_m + b_m)
                + body.unsprung_kg[axle] * GRAVITY_MPS2;
            load_n / (2.0 * body.tyre_spring_npm[axle])
        };
        let mut state = [0.0; 12];
        state[SPEED] = speed_mps;
        let [front_m, rear_m] = [axle_z(0, b_m), axle_z(1, a_m)];
        [state[AXLE_Z[0]], state[AXLE_Z[1]]] = [front_m, rear_m];
        // In the model, the suspension carries its static load at zero compression, so the body follows the axles.
        state[PITCH] = (rear_m - front_m) / (a_m + b_m);
        state[BODY_Z] = front_m + a_m * state[PITCH];
        WHEEL
            .iter()
            .for_each(|&wheel| state[wheel] = speed_mps / body.wheel_radius_m);
        Self {
            body,
            friction,
            state,
            brake: BrakePressure::new(body.brake.lag_s, true),
        }
    }

    /// Moves the vehicle by `dt_s` under a demand, from a speed that a collision or noise may have changed. Returns the
    /// constant acceleration with the same final speed, or with the same stopping distance if the vehicle stops.
    pub(super) fn respond(&mut self, demand_mps2: f64, speed_mps: f64, dt_s: f64) -> f64 {
        let change_mps = speed_mps - self.state[SPEED];
        if change_mps != 0.0 {
            for wheel in WHEEL {
                self.state[wheel] =
                    (self.state[wheel] + change_mps / self.body.wheel_radius_m).max(0.0);
            }
        }
        (self.state[SPEED], self.state[POSITION]) = (speed_mps, 0.0);
        let mut left_s = dt_s;
        while left_s > 0.0 {
            let step_s = self.stable_step_s().min(left_s);
            left_s -= step_s;
            let before = self.state;
            // Half a step before and half after: the pressure that acts is that of the middle.
            self.change_pressure(demand_mps2, 0.5 * step_s);
            self.integrate(demand_mps2, step_s);
            self.change_pressure(demand_mps2, 0.5 * step_s);
            if self.state[SPEED] < ROLLING_SPEED_MPS {
                self.roll_or_stop(before, step_s);
            }
        }
        if self.state[SPEED] > 0.0 {
            (self.state[SPEED] - speed_mps) / dt_s
        } else if self.state[POSITION] > 0.0 {
            // The vehicle must stop inside the step, even if its brake releases.
            (-speed_mps * speed_mps / (2.0 * self.state[POSITION])).min(-speed_mps / dt_s)
        } else {
            0.0
        }
    }

    fn change_pressure(&mut self, demand_mps2: f64, step_s: f64) {
        let speed_mps = self.state[SPEED];
        let is_rolling = speed_mps < ROLLING_SPEED_MPS;
        let slip = WHEEL.map(|wheel| {
            if is_rolling {
                0.0
            } else {
                self.slip(speed_mps, self.state[wheel])
            }
        });
        self.brake
            .advance((-demand_mps2).max(0.0), slip, speed_mps, step_s);
    }

    /// Stops a vehicle whose speed became negative, and lets its wheels roll.
    fn roll_or_stop(&mut self, before: BodyState, step_s: f64) {
        let (from_mps, to_mps) = (before[SPEED], self.state[SPEED]);
        if to_mps < 0.0 {
            let share = if from_mps > 0.0 {
                from_mps / (from_mps - to_mps)
            } else {
                0.0
            };
            self.state[POSITION] = before[POSITION] + 0.5 * from_mps * share * step_s;
            self.state[SPEED] = 0.0;
        }
        WHEEL
            .iter()
            .for_each(|&wheel| self.state[wheel] = self.state[SPEED] / self.body.wheel_radius_m);
    }

    /// Returns an integration step at which the wheels are stable. Their rate rises as the vehicle slows down.
    fn stable_step_s(&self) -> f64 {
        let speed_mps = self.state[SPEED];
        if speed_mps < ROLLING_SPEED_MPS {
            return MAX_STEP_S;
        }
        let body = self.body;
        let rate_per_load = body.tyre.p_kx1 * body.wheel_radius_m * body.wheel_radius_m / speed_mps;
        [0, 1].into_iter().fold(MAX_STEP_S, |step_s, axle| {
            let load_n = body.tyre_spring_npm[axle] * self.state[AXLE_Z[axle]];
            let rate = rate_per_load * load_n.max(1.0) / body.wheel_inertia_kgm2[axle];
            step_s.min(MAX_STEP_RATE / rate)
        })
    }

    /// Integrates by the classical method of Runge and Kutta, with constant brake pressure.
    fn integrate(&mut self, demand_mps2: f64, step_s: f64) {
        let weigh = |state: &BodyState, step_s: f64, rates: &BodyState| -> BodyState {
            std::array::from_fn(|index| state[index] + step_s * rates[index])
        };
        let mut start = self.state;
        // The speed at the start decides for the whole step. With tyre forces from the middle of a step on, the stiff
        // equations of the wheels would be unstable at the step of rolling wheels.
        let is_rolling = start[SPEED] < ROLLING_SPEED_MPS;
        let rates = |state: &mut BodyState| self.rates(state, demand_mps2, is_rolling);
        let first = rates(&mut start);
        let second = rates(&mut weigh(&start, 0.5 * step_s, &first));
        let third = rates(&mut weigh(&start, 0.5 * step_s, &second));
        let fourth = rates(&mut weigh(&start, step_s, &third));
        let sum: BodyState =
            std::array::from_fn(|i| first[i] + 2.0 * second[i] + 2.0 * third[i] + fourth[i]);
        self.state = weigh(&start, step_s / 6.0, &sum);
    }

    fn slip(&self, speed_mps: f64, wheel_radps: f64) -> f64 {
        1.0 - self.body.wheel_radius_m * wheel_radps / speed_mps
    }

    /// Returns the derivative of a state with rolling or slipping wheels. Wheels that would turn backwards are set to
    /// rest in the state.
    fn rates(&self, state: &mut BodyState, demand_mps2: f64, is_rolling: bool) -> BodyState {
        let body = self.body;
        let [
            _,
            speed,
            pitch,
            pitch_rate,
            z,
            z_rate,
            front_z,
            front_rate,
            rear_z,
            rear_rate,
            front_wheel,
            rear_wheel,
        ] = *state;
        let [a_m, b_m] = body.axle_m;
        let load_n = [
            front_z * body.tyre_spring_npm[0],
            rear_z * body.tyre_spring_npm[1],
        ];
        let slips = [front_wheel, rear_wheel].map(|wheel| {
            if is_rolling {
                0.0
            } else {
                self.slip(speed, wheel)
            }
        });
        let force_n =
            [0, 1].map(|axle| body.tyre.force_n(slips[axle], load_n[axle], self.friction));
        let pressure = self.brake.pressure_mps2;
        let shares = |front: f64| [front, 1.0 - front];
        let (brake_shares, engine_shares) = (
            shares(body.brake_front_share),
            shares(body.engine_front_share),
        );
        let engine_mps2 = demand_mps2.max(0.0);
        let acceleration_mps2 = if is_rolling {
            let demand_mps2 =
                engine_mps2 - brake_shares[0] * pressure[0] - brake_shares[1] * pressure[1];
            let peak_mps2 = body.tyre.p_dx1 * self.friction * GRAVITY_MPS2;
            let demand_mps2 = demand_mps2.clamp(-peak_mps2, peak_mps2);
            // The brake holds a vehicle at rest.
            if speed > 0.0 {
                demand_mps2
            } else {
                demand_mps2.max(0.0)
            }
        } else {
            (2.0 * force_n[1] + 2.0 * force_n[0]) / body.mass_kg
        };
        let drag_n = body.mass_kg * acceleration_mps2;

        let static_n = body.sprung_kg * GRAVITY_MPS2 / (2.0 * (a_m + b_m));
        let suspension_n =
            |axle: usize, lever_m: f64, arm_m: f64, [axle_z, axle_rate]: [f64; 2]| {
                let compression_m = axle_z - z + arm_m * pitch;
                let compression_rate_mps = axle_rate - z_rate + arm_m * pitch_rate;
                static_n * lever_m
                    - compression_m * body.spring_npm[axle]
                    - compression_rate_mps * body.damper_nspm[axle]
            };
        let front_n = suspension_n(0, b_m, a_m, [front_z, front_rate]);
        let rear_n = suspension_n(1, a_m, -b_m, [rear_z, rear_rate]);
        let moment_nm = 2.0 * a_m * front_n - 2.0 * b_m * rear_n + drag_n * (body.cg_height_m - z);
        let mut wheel_rate = [0, 1].map(|axle| {
            let share_mps2 =
                engine_shares[axle] * engine_mps2 - brake_shares[axle] * pressure[axle];
            let torque_nm = 0.5 * body.mass_kg * body.wheel_radius_m * share_mps2;
            (torque_nm - body.wheel_radius_m * force_n[axle]) / body.wheel_inertia_kgm2[axle]
        });
        for (rate, wheel) in wheel_rate.iter_mut().zip(WHEEL) {
            if is_rolling {
                *rate = acceleration_mps2 / body.wheel_radius_m;
            } else if state[wheel] < 0.0 {
                (state[wheel], *rate) = (0.0, 0.0);
            }
        }
        let axle_acceleration = |axle: usize, suspension_n: f64| {
            GRAVITY_MPS2 - (2.0 * load_n[axle] - 2.0 * suspension_n) / body.unsprung_kg[axle]
        };
        [
            speed,
            acceleration_mps2,
            pitch_rate,
            moment_nm / body.pitch_inertia_kgm2,
            z_rate,
            GRAVITY_MPS2 - (2.0 * front_n + 2.0 * rear_n) / body.sprung_kg,
            front_rate,
            axle_acceleration(0, front_n),
            rear_rate,
            axle_acceleration(1, rear_n),
            wheel_rate[0],
            wheel_rate[1],
        ]
    }
}

impl TyreParams {
    /// Returns the longitudinal force of one tyre by Pacejka's formula, in N, positive if it drives the vehicle.
    /// Friction scales the peak, not the stiffness. The CommonRoad package adds the vertical shift inside the sine.
    fn force_n(&self, slip: f64, load_n: f64, friction: f64) -> f64 {
        let peak = self.p_dx1 * friction;
        let scaled = self.p_kx1 / (self.p_cx1 * peak) * (self.p_hx1 - slip);
        let bent = scaled - self.p_ex1 * (scaled - libm::atan(scaled));
        peak * load_n * libm::sin(self.p_cx1 * libm::atan(bent) + load_n * self.p_vx1)
    }
}
