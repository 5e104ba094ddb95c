//! A human driver: the Intelligent Driver Model on what a human perceives, with a reaction time, a limited braking
//! level and glances off the road.
//!
//! Assumptions and their sources:
//! - Mean time from brake lights to braking 1.25 s, 1.5 s without brake lights: Green 2000, Transportation Human
//!   Factors 2(3), 195-216, abstract (unexpected signals, surprise).
//! - Log-normal spread of that time, shape 0.42: Fambro, Koppa, Picha and Fitzpatrick 1998, TRR 1628, 1-7, abstract
//!   (mean 1.1 s, 95th percentile 2.0 s).
//! - No closing speed is perceived below an expansion of 0.003 rad/s: Hoffmann and Mortimer 1996, Accid. Anal. Prev.
//!   28(4), abstract.
//! - Braking level normal, 5.0 ± 1.2 m/s²: Fambro et al. 2000 and Koppa et al. 1996 (TRR 1550, 8-15), abstracts (90 %
//!   brake at 3.4 m/s² or more without ABS on wet roads, 95 % at 0.32 g or more).
//! - Glances off the road 0.1 per second, log-normal, median 0.8 s, shape 0.5: chosen; see below.
//! - Without a reason to brake the driver keeps the time gap of the first observation: chosen.
//!
//! Only abstracts of these sources could be read, not their tables. The braking level reproduces both percentiles to
//! 0.1 m/s²; its mean is chosen between them and the smallest maximum of a driver, 6.9 m/s² (Fambro et al. 2000).
//! Range: 4.3 to 6.9 m/s². No table of glances could be read (Taoka 1991, TRR 1318, fits log-normal distributions;
//! Liang, Lee and Horrey 2014: glances above 1.7 s precede crashes). Ranges: 0 to 0.3 per second, median 0.5 to 1.5 s.
//! Maddox and Kiefer 2012 find thresholds of perception of 0.012 to 0.040 rad/s in accidents, Markkula et al. 2016
//! reactions below 1 s once a situation is urgent. A study must vary these values.
//!
//! The driver perceives the true state, also in a vehicle under test; only its emergency brake observes through the
//! sensors and the filter.
//!
//! Not modelled: anticipation beyond the leader, headlights and weather, evasive steering, age and impairment.

use rand::RngExt;

use super::emergency_brake::HeldBrake;
use super::reaction::whole_steps;
use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::idm::{Idm, IdmSettings};
use crate::observation::{Neighbour, Observation};
use crate::random::{NormalSampler, Purpose, Stream, stream};
use crate::settings::settings;

/// Width of a vehicle ahead, in metres, of which the driver perceives the visual angle.
const WIDTH_M: f64 = 1.8;
/// Deceleration that the brake lights show, in m/s² (UN R13-H, 5.2.22: not below 0.7, always above 1.3).
pub(super) const BRAKE_LIGHT_MPS2: f64 = 1.0;
/// Deceleration with the foot off both pedals, in m/s².
pub(super) const COASTING_MPS2: f64 = 0.5;
/// Shortest time gap that a driver keeps on purpose, in seconds.
const MIN_TIME_GAP_S: f64 = 0.3;
/// Limits of the braking level of any driver, in m/s².
const BRAKE_RANGE_MPS2: [f64; 2] = [2.0, 9.1];

settings! {
    /// Settings of the human driver; the module documentation has the sources.
    HumanSettings {
        /// Mean time from brake lights to braking, in seconds (Green 2000: 1.25).
        reaction_s: 1.25, 0.0..=10.0, 0.5..=2.5;
        /// Mean time from a perceived closing speed to braking, without brake lights, in seconds (Green 2000: 1.5).
        surprise_s: 1.5, 0.0..=10.0, 0.5..=2.5;
        /// Shape of the log-normal distribution of both times over drivers (Fambro et al. 1998: 0.42).
        reaction_shape: 0.42, 0.0..=2.0, 0.0..=0.6;
        /// Expansion of the visual angle from which a closing speed is perceived (Hoffmann and Mortimer 1996: 0.003).
        looming_rad_per_s: 0.003, 0.0..=1.0, 0.001..=0.03;
        /// Mean braking level over drivers, in m/s², positive.
        brake_mps2: 5.0, 0.0..=30.0, 3.0..=8.0;
        /// Standard deviation of the braking level over drivers, in m/s².
        brake_deviation_mps2: 1.2, 0.0..=10.0, 0.0..=2.0;
        /// Glances off the road per second of looking at the road; chosen.
        glance_per_s: 0.1, 0.0..=10.0, 0.0..=0.3;
        /// Median duration of a glance, in seconds; chosen.
        glance_s: 0.8, 0.0..=60.0, 0.3..=1.5;
        /// Shape of the log-normal distribution of that duration; chosen.
        glance_shape: 0.5, 0.0..=2.0, 0.0..=0.8;
        /// Longest time gap that the driver keeps, in seconds: the first observed one, up to this.
        time_headway_s: 1.6, 0.3..=10.0, 0.5..=3.0;
        /// Time to collision below which an emergency brake of the vehicle fires, in seconds; 0: no emergency brake.
        aeb_ttc_s: 0.0, 0.0..=100.0, 0.0..=4.0, none 0.0;
        /// Deceleration of that emergency brake, in m/s², positive.
        aeb_brake_mps2: 7.5, 0.0..=30.0, 2.0..=9.0;
    }
}

/// A human driver, with an optional emergency brake.
#[derive(Debug, Clone)]
pub struct Human(Box<HumanState>);

/// State of the driver; boxed, because it is larger than that of most controllers.
#[derive(Debug, Clone)]
struct HumanState {
    settings: HumanSettings,
    step_s: f64,
    stream: Stream,
    idm: Option<Idm>,
    aeb: HeldBrake,
    /// Reaction time of this driver, as a share of the mean.
    reaction_share: f64,
    brake_mps2: f64,
    /// Steps until this driver may brake; `None` without a reason to brake.
    steps_to_brake: Option<u32>,
    /// Steps until the eyes are on the road again.
    glance_steps: u32,
    held_mps2: f64,
    /// True state of this step, if the observation is an estimate.
    perceived: Option<Observation>,
}

impl BuiltIn for Human {
    const NAME: &'static str = "human";
    const SUMMARY: &'static str = "human driver: IDM with reaction time, threshold of perception, braking level and \
    glances off the road, from the scenario's seed";
    type Settings = HumanSettings;
    type Driver = Self;

    fn acts_at_random(_settings: &HumanSettings) -> bool {
        true
    }

    fn start(settings: &HumanSettings, ego: &Ego, seed: u64) -> Self {
        let mut stream = stream(seed, Purpose::HumanDriver, ego.vehicle as u64);
        let level_mps2 = settings.brake_mps2
            + settings.brake_deviation_mps2 * NormalSampler::new().sample(&mut stream);
        let shape = settings.reaction_shape;
        Self(Box::new(HumanState {
            step_s: ego.step_s,
            idm: None,
            aeb: HeldBrake::new(settings.aeb_ttc_s, settings.aeb_brake_mps2),
            reaction_share: log_normal(&mut stream, shape) * libm::exp(-0.5 * shape * shape),
            brake_mps2: level_mps2.clamp(BRAKE_RANGE_MPS2[0], BRAKE_RANGE_MPS2[1]),
            steps_to_brake: None,
            glance_steps: 0,
            held_mps2: 0.0,
            perceived: None,
            settings: settings.clone(),
            stream,
        }))
    }
}

/// Draws a log-normal number with median 1.
fn log_normal(stream: &mut Stream, shape: f64) -> f64 {
    libm::exp(shape * NormalSampler::new().sample(stream))
}

impl HumanState {
    /// Returns true if the eyes are on the road during the next step. A driver with a reason to brake looks ahead.
    fn looks_ahead(&mut self) -> bool {
        if self.glance_steps > 0 {
            self.glance_steps -= 1;
            return false;
        }
        let HumanSettings {
            glance_per_s,
            glance_s,
            glance_shape,
            ..
        } = self.settings;
        if self.steps_to_brake.is_none() && self.stream.random::<f64>() < glance_per_s * self.step_s
        {
            self.glance_steps = whole_steps(
                glance_s * log_normal(&mut self.stream, glance_shape),
                self.step_s,
            );
        }
        true
    }

    /// Returns the rate at which the visual angle of the vehicle ahead expands, in rad/s.
    fn expansion_rad_per_s(closing_mps: f64, gap_m: f64) -> f64 {
        WIDTH_M * closing_mps / (gap_m * gap_m + 0.25 * WIDTH_M * WIDTH_M)
    }

    /// Updates the reaction to the vehicle ahead. Returns its speed as perceived, in m/s.
    fn react_to(&mut self, speed_mps: f64, ahead: &Neighbour) -> f64 {
        let closing_mps = speed_mps - ahead.speed_mps;
        let expansion = Self::expansion_rad_per_s(closing_mps, ahead.gap_m);
        let threshold = self.settings.looming_rad_per_s;
        let brake_lights = ahead.acceleration_mps2 <= -BRAKE_LIGHT_MPS2;
        let reacts = brake_lights
            || expansion > threshold
            || self.steps_to_brake.is_some() && closing_mps > 0.0;
        let mean_s = if brake_lights {
            self.settings.reaction_s
        } else {
            self.settings.surprise_s
        };
        self.steps_to_brake = reacts.then(|| match self.steps_to_brake {
            Some(steps) => steps.saturating_sub(1),
            None => whole_steps(mean_s * self.reaction_share, self.step_s),
        });
        if expansion.abs() > threshold {
            ahead.speed_mps
        } else {
            speed_mps
        }
    }

    /// Returns the model of car following, which keeps the time gap and the speed of the first observation.
    fn model(&mut self, speed_mps: f64, ahead: Option<&Neighbour>) -> Idm {
        let longest_s = self.settings.time_headway_s;
        *self.idm.get_or_insert_with(|| {
            let usual = IdmSettings::default();
            let first_s = ahead.map(|ahead| (ahead.gap_m - usual.standstill_gap_m) / speed_mps);
            let time_headway_s = first_s
                .filter(|first_s| first_s.is_finite())
                .unwrap_or(longest_s);
            Idm::from(&IdmSettings {
                time_headway_s: time_headway_s.min(longest_s).max(MIN_TIME_GAP_S),
                desired_speed_mps: usual.desired_speed_mps.max(speed_mps),
                ..usual
            })
        })
    }
}

impl Controller for Human {
    #[inline]
    fn perceive(&mut self, truth: &Observation) {
        self.0.perceived = Some(*truth);
    }

    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let driver = &mut *self.0;
        let emergency_mps2 = driver.aeb.demand_mps2(observation);
        let road = driver.perceived.take().unwrap_or(*observation);
        let model = driver.model(road.speed_mps, road.ahead.as_ref());
        if driver.looks_ahead() {
            let ahead = road
                .ahead
                .map(|ahead| [ahead.gap_m, driver.react_to(road.speed_mps, &ahead)]);
            if ahead.is_none() {
                driver.steps_to_brake = None;
            }
            let strongest_mps2 = if driver.steps_to_brake == Some(0) {
                driver.brake_mps2
            } else {
                COASTING_MPS2
            };
            driver.held_mps2 = model
                .acceleration_mps2(road.speed_mps, ahead)
                .max(-strongest_mps2);
        }
        Ok(emergency_mps2.map_or(driver.held_mps2, |brake_mps2| {
            driver.held_mps2.min(-brake_mps2)
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind};
    use super::*;

    /// Every driver alike, and eyes on the road.
    const ALIKE: HumanSettings = HumanSettings {
        reaction_s: 1.25,
        surprise_s: 1.5,
        reaction_shape: 0.0,
        looming_rad_per_s: 0.003,
        brake_mps2: 5.0,
        brake_deviation_mps2: 0.0,
        glance_per_s: 0.0,
        glance_s: 0.8,
        glance_shape: 0.5,
        time_headway_s: 1.6,
        aeb_ttc_s: 0.0,
        aeb_brake_mps2: 7.5,
    };

    /// Returns the number of steps without braking behind a vehicle at `gap_m`, from 25 m/s.
    fn steps_before_braking(
        settings: &HumanSettings,
        gap_m: f64,
        ahead_mps: f64,
        ahead_mps2: f64,
    ) -> usize {
        let mut driver = Human::start(settings, &EGO, 0);
        (0..1000)
            .take_while(|_| {
                command_behind(&mut driver, 25.0, gap_m, ahead_mps, ahead_mps2) >= -COASTING_MPS2
            })
            .count()
    }

    #[test]
    fn reacts_after_its_reaction_time_and_not_below_the_threshold() {
        assert_eq!(
            steps_before_braking(&ALIKE, 20.0, 20.0, -4.0),
            125,
            "brake lights"
        );
        assert_eq!(
            steps_before_braking(&ALIKE, 20.0, 20.0, 0.0),
            150,
            "no brake lights"
        );
        // 1.8 · 5 / (54.77² + 0.81) = 0.003 rad/s at 54.77 m.
        assert_eq!(steps_before_braking(&ALIKE, 54.6, 20.0, 0.0), 150);
        assert_eq!(
            steps_before_braking(&ALIKE, 54.9, 20.0, 0.0),
            1000,
            "the closing speed is not perceived"
        );
        let assisted = HumanSettings {
            aeb_ttc_s: 4.1,
            ..ALIKE
        };
        assert_eq!(
            steps_before_braking(&assisted, 20.0, 20.0, -4.0),
            0,
            "the emergency brake does not wait"
        );
    }

    #[test]
    fn brakes_at_most_at_its_level() {
        let mut driver = Human::start(&ALIKE, &EGO, 0);
        let hardest = (0..300)
            .map(|_| command_behind(&mut driver, 25.0, 8.0, 5.0, -7.5))
            .fold(0.0, f64::min);
        assert_eq!(hardest, -5.0);
    }

    /// 4000 drivers have the means and the percentiles of the sources; a glance delays the reaction.
    #[test]
    fn drivers_are_distributed_as_their_sources_say() {
        let drivers: Vec<_> = (0..4000)
            .map(|seed| Human::start(&HumanSettings::default(), &EGO, seed))
            .collect();
        let sorted = |quantity: fn(&Human) -> f64| {
            let mut all: Vec<f64> = drivers.iter().map(quantity).collect();
            all.sort_by(f64::total_cmp);
            all
        };
        let (shares, levels) = (
            sorted(|driver| driver.0.reaction_share),
            sorted(|driver| driver.0.brake_mps2),
        );
        assert!((shares.iter().sum::<f64>() / 4000.0 - 1.0).abs() < 0.03);
        assert!(
            (shares[3800] - 2.0 / 1.1).abs() < 0.1,
            "95th percentile over mean: {}",
            shares[3800]
        );
        assert!(
            (levels[400] - 3.4).abs() < 0.15 && (levels[200] - 0.32 * 9.81).abs() < 0.2,
            "{}",
            levels[400]
        );

        let distracted = HumanSettings {
            glance_per_s: 0.5,
            ..ALIKE
        };
        let mean = (0..400).map(|seed| {
            let mut driver = Human::start(&distracted, &EGO, seed);
            for _ in 0..200 {
                let _ = command_behind(&mut driver, 25.0, 20.0, 25.0, 0.0);
            }
            let waits =
                |_: &usize| command_behind(&mut driver, 25.0, 20.0, 20.0, -4.0) >= -COASTING_MPS2;
            (0..1000).take_while(waits).count() as f64
        });
        // Eyes are off for a share of 0.5 · 0.91 / (1 + 0.5 · 0.91) = 31 %, for half a second more on average.
        let mean = mean.sum::<f64>() / 400.0;
        assert!((130.0..160.0).contains(&mean), "{mean} steps");
    }
}
