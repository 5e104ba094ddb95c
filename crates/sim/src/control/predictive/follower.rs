//! The follower: what drives it, and whether its emergency brake has fired.

use super::jitter::Jitter;
use crate::control::baseline::FIRING_TTC_S;
use crate::control::human::{BRAKE_LIGHT_MPS2, COASTING_MPS2};
use crate::control::{AccAeb, AccAebSettings, BuiltIn, Controller, Ego};
use crate::idm::{Idm, IdmSettings};
use crate::observation::BANDWIDTH_RAD_PER_S;
use crate::observation::{Neighbour, Observation};

/// Estimated time to collision below which the emergency brake has certainly fired, in seconds: lower than
/// [`FIRING_TTC_S`] by the errors of the estimate.
const FIRED_TTC_S: f64 = 1.2;
/// Deceleration that confirms the firing, in m/s².
const FIRED_BRAKE_MPS2: f64 = 1.5;
/// Time that the estimate of the acceleration needs to follow a jump, in seconds.
const SETTLING_S: f64 = 0.6;
/// Time over which the deceleration is averaged, in seconds.
const AVERAGING_S: f64 = 0.3;
/// Time for which evidence counts, in seconds.
const MEMORY_S: f64 = 1.5;
/// Time after which errors of an estimate are independent, in seconds: about 1.5 / ω of the filter.
const CORRELATION_S: f64 = 0.3;
/// Standard deviation of changes of speed that no hypothesis explains, in m/s.
const MODEL_DEVIATION_MPS: f64 = 0.2;
/// Time constant of each of two lags from demanded to estimated acceleration, in seconds: reaction, and the filter.
const LAG_S: f64 = 0.3;

/// Reaction time of a human after brake lights, in seconds.
const HUMAN_REACTION_S: f64 = 1.25;
/// Braking level of a human, in m/s².
const HUMAN_BRAKE_MPS2: f64 = 5.0;
/// Limits of the time gap that a human keeps, in seconds.
const HUMAN_TIME_GAPS_S: [f64; 2] = [0.3, 1.6];

/// Hypotheses about the driver: nothing but an emergency brake; `acc-aeb`; `idm`; `human`.
const HYPOTHESES: usize = 4;

/// State of the follower and likelihoods of the hypotheses about its driver.
///
/// Each hypothesis predicts an acceleration a_i from the present observation, and from it the change of speed w over
/// the last [`MEMORY_S`]: w' = a_i - w / [`MEMORY_S`]. The observed change is the difference between the speed and its
/// average over that time. Per [`CORRELATION_S`] the log-likelihood changes by -(error)²/(2 σ²), and it decays with
/// time constant [`MEMORY_S`]. σ includes the noise of the estimated speed, which is that of the acceleration divided
/// by the bandwidth of the filter. Speeds discriminate better than accelerations, whose noise is larger. When the
/// emergency brake is released, the evidence from before it fired still counts: to discard it fixed none of the
/// collisions in 4000 random scenarios each of five spaces, and caused more hard braking.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Follower {
    step_s: f64,
    prior: [f64; HYPOTHESES],
    acc: AccAeb,
    idm: Idm,
    /// The model of a human, who keeps the first time gap; none before the first observation.
    human: Option<Idm>,
    /// Time since the brake lights of the ego vehicle went on, in seconds; 0 while they are off.
    warned_for_s: f64,
    jitter: Jitter,
    /// Predicted accelerations after one and two lags, in m/s².
    predicted_mps2: [[f64; 2]; HYPOTHESES],
    /// Predicted changes of speed, in m/s.
    predicted_mps: [f64; HYPOTHESES],
    /// Average speed of the follower, in m/s; none before the first observation.
    average_mps: Option<f64>,
    log_likelihoods: [f64; HYPOTHESES],
    fired_for_s: Option<f64>,
    brake_mps2: f64,
}

impl Follower {
    pub(super) fn new(unaware_share: f64, ego: &Ego) -> Self {
        let aware = (1.0 - unaware_share) / 3.0;
        Self {
            step_s: ego.step_s,
            prior: [unaware_share, aware, aware, aware],
            acc: AccAeb::start(&AccAebSettings::default(), ego, 0),
            idm: Idm::from(&IdmSettings::default()),
            human: None,
            warned_for_s: 0.0,
            jitter: Jitter::new(ego.step_s),
            predicted_mps2: [[0.0; 2]; HYPOTHESES],
            predicted_mps: [0.0; HYPOTHESES],
            average_mps: None,
            log_likelihoods: [0.0; HYPOTHESES],
            fired_for_s: None,
            brake_mps2: 0.0,
        }
    }

    /// Adds an observation. `expected_mps2` is the deceleration that is expected of the emergency brake before it is
    /// observed. Returns true if the emergency brake has fired and the follower may still close in.
    pub(super) fn observe(
        &mut self,
        behind: &Neighbour,
        observation: &Observation,
        expected_mps2: f64,
    ) -> bool {
        self.warned_for_s = if observation.acceleration_mps2 < -BRAKE_LIGHT_MPS2 {
            self.warned_for_s + self.step_s
        } else {
            0.0
        };
        let closing_mps = behind.speed_mps - observation.speed_mps;
        let brakes = behind.acceleration_mps2 < -FIRED_BRAKE_MPS2;
        match self.fired_for_s {
            None => {
                self.weigh(behind, observation);
                let is_certain = behind.gap_m < FIRED_TTC_S * closing_mps;
                if is_certain || (brakes && behind.gap_m < FIRING_TTC_S * closing_mps) {
                    (self.fired_for_s, self.brake_mps2) = (Some(0.0), expected_mps2);
                }
            }
            Some(_) if closing_mps < -0.5 && behind.acceleration_mps2 > -1.0 => {
                self.fired_for_s = None
            }
            Some(fired_for_s) => {
                self.fired_for_s = Some(fired_for_s + self.step_s);
                if fired_for_s > SETTLING_S {
                    let found_mps2 = (-behind.acceleration_mps2)
                        .max(0.3 * expected_mps2)
                        .min(1.5 * expected_mps2);
                    self.brake_mps2 +=
                        (self.step_s / AVERAGING_S).min(1.0) * (found_mps2 - self.brake_mps2);
                }
            }
        }
        self.fired_for_s.is_some()
    }

    /// Returns the time since the emergency brake fired, in seconds; 0 before.
    pub(super) fn fired_for_s(&self) -> f64 {
        self.fired_for_s.unwrap_or(0.0)
    }

    /// Returns the time since the brake lights of the ego vehicle went on, in seconds; 0 while they are off.
    pub(super) fn warned_for_s(&self) -> f64 {
        self.warned_for_s
    }

    /// Returns the deceleration of the emergency brake, in m/s², positive: the expected one at first, the observed one
    /// from [`SETTLING_S`] after the firing.
    pub(super) fn brake_mps2(&self) -> f64 {
        self.brake_mps2
    }

    /// Returns the probability that the follower has nothing but an emergency brake.
    pub(super) fn unaware_probability(&self) -> f64 {
        let highest = self
            .log_likelihoods
            .iter()
            .fold(f64::NEG_INFINITY, |highest, &value| highest.max(value));
        let mut weights = self.prior;
        for (weight, log_likelihood) in weights.iter_mut().zip(self.log_likelihoods) {
            *weight *= libm::exp(log_likelihood - highest);
        }
        weights[0] / weights.iter().sum::<f64>().max(f64::MIN_POSITIVE)
    }

    /// Updates the likelihoods of the hypotheses.
    fn weigh(&mut self, behind: &Neighbour, observation: &Observation) {
        let demands_mps2 = self.demands_mps2(behind, observation);
        self.jitter.observe(behind.acceleration_mps2, 0.0);
        let bandwidth = BANDWIDTH_RAD_PER_S;
        let speed_variance = self.jitter.acceleration_variance() / (bandwidth * bandwidth);
        let variance = MODEL_DEVIATION_MPS * MODEL_DEVIATION_MPS + speed_variance;
        let [lag, forgotten, counted] =
            [LAG_S, MEMORY_S, CORRELATION_S].map(|time_s| (self.step_s / time_s).min(1.0));
        let average_mps = self.average_mps.get_or_insert(behind.speed_mps);
        *average_mps += forgotten * (behind.speed_mps - *average_mps);
        let change_mps = behind.speed_mps - *average_mps;
        for (index, demand_mps2) in demands_mps2.into_iter().enumerate() {
            let [once_mps2, twice_mps2] = &mut self.predicted_mps2[index];
            *once_mps2 += lag * (demand_mps2 - *once_mps2);
            *twice_mps2 += lag * (*once_mps2 - *twice_mps2);
            let predicted_mps = &mut self.predicted_mps[index];
            *predicted_mps += self.step_s * *twice_mps2 - forgotten * *predicted_mps;
            let error_mps = change_mps - *predicted_mps;
            let log_likelihood = &mut self.log_likelihoods[index];
            *log_likelihood -=
                forgotten * *log_likelihood + counted * error_mps * error_mps / (2.0 * variance);
        }
    }

    /// Returns the acceleration that each hypothesis demands, in m/s².
    #[expect(
        clippy::manual_clamp,
        reason = "a demand that is no number must not remain one"
    )]
    fn demands_mps2(&mut self, behind: &Neighbour, observation: &Observation) -> [f64; HYPOTHESES] {
        let ego = Neighbour {
            gap_m: behind.gap_m,
            speed_mps: observation.speed_mps,
            acceleration_mps2: observation.acceleration_mps2,
        };
        let view = Observation {
            speed_mps: behind.speed_mps,
            acceleration_mps2: behind.acceleration_mps2,
            ahead: Some(ego),
            behind: None,
        };
        let acc_mps2 = self.acc.decide(&view).unwrap_or(0.0);
        let idm_mps2 = self.idm.desired_acceleration_mps2(&view);
        let human_mps2 = self.human_mps2(&view);
        [0.0, acc_mps2, idm_mps2, human_mps2].map(|demand_mps2| demand_mps2.max(-7.5).min(3.0))
    }

    /// Returns the acceleration of a human, who does not brake before the end of the reaction time.
    fn human_mps2(&mut self, view: &Observation) -> f64 {
        let model = *self.human.get_or_insert_with(|| {
            let usual = IdmSettings::default();
            let [shortest_s, longest_s] = HUMAN_TIME_GAPS_S;
            let first_s = view.ahead.map_or(longest_s, |ahead| {
                (ahead.gap_m - usual.standstill_gap_m) / view.speed_mps.max(1.0)
            });
            Idm::from(&IdmSettings {
                time_headway_s: first_s.min(longest_s).max(shortest_s),
                desired_speed_mps: usual.desired_speed_mps.max(view.speed_mps),
                ..usual
            })
        });
        let strongest_mps2 = if self.warned_for_s > HUMAN_REACTION_S {
            HUMAN_BRAKE_MPS2
        } else {
            COASTING_MPS2
        };
        model.desired_acceleration_mps2(view).max(-strongest_mps2)
    }
}
