//! Random platoon motion, written as a recording, read back and turned into scenarios.

use proptest::prelude::*;

use super::tests::{HEADER, read_text};
use super::*;
use crumple_sim::scenario::{Driver, LeadProfile, RecordedSpeeds};

/// Motion of a platoon: number of its first vehicle, and speeds and gaps of each row, some missing.
#[derive(Debug, Clone)]
pub(super) struct PlatoonMotion {
    pub(super) first: usize,
    pub(super) speeds: Vec<Vec<Option<f64>>>,
    pub(super) gaps: Vec<Vec<Option<f64>>>,
}

pub(super) fn any_motion(share_missing: f64) -> impl Strategy<Value = PlatoonMotion> {
    let pieces = prop::collection::vec((-8.0..3.0_f64, 1..40_usize), 2..12);
    (1..4_usize, 2..5_usize, pieces).prop_flat_map(move |(first, vehicles, pieces)| {
        let mut speed = 25.0_f64;
        let lead: Vec<f64> = pieces
            .iter()
            .flat_map(|&(accel, count)| std::iter::repeat_n(accel, count))
            .map(|accel| {
                speed = (speed + 0.1 * accel).clamp(0.0, 60.0);
                speed
            })
            .collect();
        let rows = lead.len();
        let cells = |range: std::ops::Range<f64>, columns: usize| {
            let cell = (0.0..1.0, range)
                .prop_map(move |(draw, value)| (draw >= share_missing).then_some(value));
            prop::collection::vec(prop::collection::vec(cell, columns), rows)
        };
        let lead_known =
            prop::collection::vec((0.0..1.0).prop_map(move |draw| draw >= share_missing), rows);
        (
            lead_known,
            cells(0.0..50.0, vehicles - 1),
            cells(0.5..200.0, vehicles - 1),
        )
            .prop_map(move |(is_known, followers, gaps)| {
                let leads = lead
                    .iter()
                    .zip(is_known)
                    .map(|(&speed, is_known)| is_known.then_some(speed));
                let speeds = leads
                    .zip(followers)
                    .map(|(lead, rest)| [vec![lead], rest].concat())
                    .collect();
                PlatoonMotion {
                    first,
                    speeds,
                    gaps,
                }
            })
    })
}

impl PlatoonMotion {
    /// Writes a file with carriage returns and a blank line; samples begin on line 8.
    pub(super) fn to_csv(&self) -> String {
        let vehicles = self.speeds[0].len();
        let numbers = self.first..self.first + vehicles;
        let mut text = format!("{HEADER}Time");
        numbers
            .clone()
            .for_each(|k| text += &format!(",Speed{k},E{k}"));
        numbers
            .take(vehicles - 1)
            .for_each(|k| text += &format!(",IVS{k}"));
        let field =
            |value: &Option<f64>| value.map(|value| format!("{value:?}")).unwrap_or_default();
        text += "\r\n";
        for (k, (speeds, gaps)) in self.speeds.iter().zip(&self.gaps).enumerate() {
            text += &format!("\r\n{:?}", 480.0 + 0.1 * k as f64);
            speeds
                .iter()
                .for_each(|speed| text += &format!(",{},1.5", field(speed)));
            gaps.iter()
                .for_each(|gap| text += &format!(",{}", field(gap)));
        }
        // Without a line end, a last row with fewer decimals than all others would count as cut off.
        text + "\r\n"
    }
}

/// Returns the largest loss of speed over one second that starts at a sample.
fn largest_drop_mps(lead: &RecordedSpeeds) -> f64 {
    let drop = |&t: &f64| lead.speed_at_mps(t) - lead.speed_at_mps(t + 1.0);
    lead.time_s
        .iter()
        .map(drop)
        .fold(f64::NEG_INFINITY, f64::max)
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(96))]

    /// Files are read as written. Every episode is a valid scenario that starts as recorded; its leader loses speed
    /// faster than the threshold and within its limits.
    #[test]
    fn scenarios_contain_the_recorded_braking(motion in any_motion(0.05), threshold in 0.5..5.0_f64) {
        let recording = read_text(&motion.to_csv()).expect("well formed");
        let platoon = &recording.platoons[0];
        for (index, vehicle) in platoon.vehicles.iter().enumerate() {
            prop_assert_eq!(vehicle.number, motion.first + index);
            let written: Vec<_> = motion.speeds.iter().map(|row| row[index]).collect();
            prop_assert_eq!(&vehicle.speed_mps, &written);
            if index > 0 {
                let written: Vec<_> = motion.gaps.iter().map(|row| row[index - 1]).collect();
                prop_assert_eq!(platoon.gap_ahead_m(index), written);
            }
        }
        let min_brake = MinBrake::new(threshold).expect("in range");
        for episode in find_episodes(&recording, min_brake, LeaderSelection::Any).episodes {
            let scenario = episode.scenario("drawn".to_owned(), "a.csv", &FollowerDriver::Human).expect("valid");
            let row = usize::try_from(episode.line).expect("small") - 8;
            for (index, vehicle) in scenario.vehicles().iter().enumerate() {
                let column = episode.vehicles[0].number - motion.first + index;
                prop_assert!((vehicle.speed_mps - motion.speeds[row][column].expect("known")).abs() <= 0.000_501);
                if index > 0 {
                    let gap_m = scenario.initial_gap_m(index).expect("follows");
                    prop_assert!((gap_m - motion.gaps[row][column - 1].expect("known")).abs() <= 0.000_501);
                }
            }
            let leader = &scenario.vehicles()[0];
            let Driver::Profile(profile @ LeadProfile::Recorded(lead)) = &leader.driver else { panic!("no profile") };
            prop_assert!(largest_drop_mps(lead) > threshold);
            let mut speed_mps = leader.speed_mps;
            for k in 0..scenario.steps() {
                let (from_s, to_s) = (k as f64 * 0.01, (k + 1) as f64 * 0.01);
                let wanted = profile.acceleration_mps2(from_s, to_s, speed_mps);
                prop_assert!(-wanted <= leader.max_brake_mps2() + 1e-6 && wanted <= leader.max_accel_mps2() + 1e-6);
                speed_mps += wanted * 0.01;
            }
        }
    }

    /// Every second of braking of a fully recorded leader is in exactly one episode, and no episode is empty.
    #[test]
    fn every_braking_is_in_one_episode(motion in any_motion(0.0), threshold in 0.5..5.0_f64) {
        let recording = read_text(&motion.to_csv()).expect("well formed");
        let result = find_episodes(&recording, MinBrake::new(threshold).expect("in range"), LeaderSelection::First);
        prop_assert_eq!(&result.dropped, &[]);
        let lead: Vec<f64> = motion.speeds.iter().map(|row| row[0].expect("known")).collect();
        for (k, pair) in lead.windows(11).enumerate() {
            let at_s = 480.0 + 0.1 * k as f64;
            let holding = result.episodes.iter().filter(|episode| {
                let from_s = episode.start_s + episode.onset_s;
                let to_s = episode.start_s + episode.braking_end_s;
                from_s < at_s + 1e-3 && at_s + 1.0 < to_s + 1e-3
            });
            let holding = holding.count();
            // Speeds are rounded to 1 mm/s, which may decide a difference this close to the threshold.
            if pair[0] - pair[10] > threshold + 0.001_1 {
                prop_assert_eq!(holding, 1, "at {} s", at_s);
            }
            prop_assert!(holding <= 1);
        }
    }
}
