use std::path::Path;
use std::sync::{Arc, Mutex};

use super::read;
use super::replay::replay;
use crumple_sim::control::{Controller, ControllerFailure, ControllerSource, Ego};
use crumple_sim::engine::RunOptions;
use crumple_sim::observation::Observation;

/// Brakes at a rate while the leader brakes, as the recorded driver does a second later.
struct BrakesWithLeader(f64);

impl Controller for BrakesWithLeader {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        Ok(
            if seen
                .ahead
                .is_some_and(|ahead| ahead.acceleration_mps2 < -1.5)
            {
                -self.0
            } else {
                0.0
            },
        )
    }
}

impl ControllerSource for BrakesWithLeader {
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, _: &Ego, _: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(BrakesWithLeader(self.0)))
    }
}

#[test]
fn replayed_brakings_state_the_braking_of_the_driver() {
    let mut text =
        "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n".to_owned();
    let mut gap_m = 40.0;
    for tenth in 0..200 {
        let at_s = f64::from(tenth) / 10.0;
        let speed_mps = |from_s: f64| 20.0 - 2.0 * (at_s - from_s).clamp(0.0, 3.0);
        let (leader_mps, own_mps) = (speed_mps(8.0), speed_mps(9.0));
        text += &format!(
            "a,{at_s:.1},{gap_m:.3},{own_mps:.3},{:.3},{leader_mps:.3}\n",
            leader_mps - own_mps
        );
        gap_m += 0.1 * (leader_mps - own_mps);
    }
    let recording = read(text.as_bytes(), Path::new("a.csv"), None).unwrap();
    for (brake_mps2, unnecessary) in [(3.0, 0), (7.0, 1)] {
        let options = RunOptions::new(Arc::new(BrakesWithLeader(brake_mps2)));
        let drives = replay(&recording, &options, 1.3, &|_, _| {}).unwrap();
        let [drive] = &drives[..] else {
            panic!("{drives:?}")
        };
        let [braking] = drive.brakings[..] else {
            panic!("{drive:?}")
        };
        assert!(
            (drive.duration_s - 19.9).abs() < 0.06 && (drive.distance_m - 341.75).abs() < 1.0,
            "{drive:?}"
        );
        assert!(
            (braking.from_s - 8.5).abs() < 0.3 && braking.brake_mps2 == brake_mps2,
            "{braking:?}"
        );
        assert!(
            (braking.driver_brake_mps2 - 2.0).abs() < 0.05,
            "{braking:?}"
        );
        assert_eq!(
            drive.unnecessary.map(|braking| braking.count),
            [unnecessary, 0],
            "{drive:?}"
        );
    }
}

/// Stores the accelerations that it observes, and those that were executed in place of its commands.
#[derive(Clone, Default)]
struct ExecutedLog(Arc<Mutex<[Vec<f64>; 2]>>);

impl Controller for ExecutedLog {
    fn decide(&mut self, observed: &Observation) -> Result<f64, ControllerFailure> {
        self.0.lock().unwrap()[0].push(observed.acceleration_mps2);
        Ok(-5.0)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.0.lock().unwrap()[1].push(command_mps2);
    }
}

impl ControllerSource for ExecutedLog {
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, _: &Ego, _: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(self.clone()))
    }
}

/// A controller that estimates friction from its commands would otherwise find ice.
#[test]
fn the_controller_learns_that_the_recorded_acceleration_was_executed() {
    let mut text =
        "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n".to_owned();
    for tenth in 0..100 {
        let at_s = f64::from(tenth) / 10.0;
        text += &format!(
            "a,{at_s:.1},40.0,{:.3},0.0,{:.3}\n",
            20.0 - 0.5 * at_s,
            20.0 - 0.5 * at_s
        );
    }
    let recording = read(text.as_bytes(), Path::new("a.csv"), None).unwrap();
    let log = ExecutedLog::default();
    replay(
        &recording,
        &RunOptions::new(Arc::new(log.clone())),
        1.3,
        &|_, _| {},
    )
    .unwrap();
    let [observed, executed] = &*log.0.lock().unwrap();
    assert!(observed.len() > 100 && executed.len() + 1 == observed.len());
    assert_eq!(executed[..], observed[1..]);
    assert!((executed[executed.len() - 1] + 0.5).abs() < 1e-6);
}
