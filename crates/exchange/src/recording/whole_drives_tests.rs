//! Whole drives, and the driver of the vehicle behind.

use super::drive::DriveInstant;
use super::motion::SpeedSample;
use super::tests::read_text;
use super::whole_drives::split_at_jumps;
use super::*;
use crumple_measure::is_far_behind;
use crumple_sim::scenario::{Driver, LeadProfile, Scenario};

/// Speed of a car of the platoon at a time, in m/s.
fn speed_mps(car: usize, time_s: f64) -> f64 {
    18.0 + 2.0 * (0.2 * time_s - 0.3 * car as f64).sin()
}

/// Gap ahead of a car, in metres, whose change is the difference of the speeds.
fn gap_m(car: usize, time_s: f64) -> f64 {
    let integral = |car: usize| -10.0 * (0.2 * time_s - 0.3 * car as f64).cos();
    40.0 + integral(car - 1) - integral(car)
}

/// A platoon of cars at 10 Hz; `edit` may change the fields of a row: time, speeds, gaps.
fn platoon(cars: usize, seconds: usize, edit: impl Fn(f64, &mut Vec<String>)) -> Recording {
    platoon_each(1, cars, seconds, edit)
}

/// A platoon of cars with a row each so many tenths of a second.
fn platoon_each(
    tenths: usize,
    cars: usize,
    seconds: usize,
    edit: impl Fn(f64, &mut Vec<String>),
) -> Recording {
    let header =
        format!("Date,1\nVehicle_order\nNumber_of_vehicles,{cars}\nACC,1\nDistance_setting,S\n");
    let names = |name: &str, count: usize| -> Vec<String> {
        (1..=count)
            .map(|number| format!("{name}{number}"))
            .collect()
    };
    let columns = [
        vec!["Time".to_owned()],
        names("Speed", cars),
        names("IVS", cars - 1),
    ];
    let mut text = header + &columns.concat().join(",") + "\n";
    for tenth in (0..=10 * seconds).step_by(tenths) {
        let time_s = tenth as f64 / 10.0;
        let speeds = (0..cars).map(|car| format!("{:.4}", speed_mps(car, time_s)));
        let gaps = (1..cars).map(|car| format!("{:.4}", gap_m(car, time_s)));
        let mut fields: Vec<String> = std::iter::once(format!("{time_s:.1}"))
            .chain(speeds)
            .chain(gaps)
            .collect();
        edit(time_s, &mut fields);
        text += &(fields.join(",") + "\n");
    }
    read_text(&text).expect("readable")
}

fn scenarios(drives: &[WholeDrive], follower: &FollowerDriver) -> Vec<Scenario> {
    let scenarios = drives.iter().zip(1..).map(|(drive, number)| {
        drive
            .scenario(format!("drive-{number}"), "a.csv", follower)
            .expect("valid")
    });
    scenarios.collect()
}

fn drivers(scenario: &Scenario) -> Vec<&str> {
    let vehicles = scenario.vehicles().iter();
    vehicles.map(|vehicle| vehicle.driver.name()).collect()
}

#[test]
fn each_vehicle_behind_its_leader_makes_a_drive() {
    let drives = find_drives(&platoon(4, 60, |_, _| ()), LeaderSelection::Any);
    let numbers: Vec<Vec<_>> = drives
        .iter()
        .map(|drive| {
            drive
                .vehicles
                .iter()
                .map(|vehicle| vehicle.number)
                .collect()
        })
        .collect();
    assert_eq!(numbers, [vec![1, 2, 3], vec![2, 3, 4], vec![3, 4]]);
    for name in FollowerDriver::NAMES {
        let follower = FollowerDriver::from_name(name).expect("a name");
        let scenarios = scenarios(&drives, &follower);
        let alone = vec!["recorded", "under-test"];
        let behind = match follower {
            FollowerDriver::None => alone.clone(),
            _ => vec!["recorded", "under-test", name],
        };
        assert_eq!(
            scenarios.iter().map(drivers).collect::<Vec<_>>(),
            [behind.clone(), behind, alone]
        );
        let says = |scenario: &Scenario| {
            let about = &scenario.spec().about;
            about.contains("collisions from behind cannot happen")
        };
        let is_none = follower == FollowerDriver::None;
        assert_eq!(
            scenarios.iter().map(says).collect::<Vec<_>>(),
            [is_none, is_none, true]
        );
    }
    let first = find_drives(&platoon(4, 60, |_, _| ()), LeaderSelection::First);
    assert_eq!((first.len(), first[0].vehicles[0].number), (1, 1));
}

/// The scenario repeats the recorded speeds of the leader, keeps those of the vehicle itself, and starts all vehicles
/// at their recorded gaps.
#[test]
fn drives_hold_the_recorded_motion() {
    let drives = find_drives(&platoon(3, 60, |_, _| ()), LeaderSelection::Any);
    let scenario = &scenarios(&drives, &FollowerDriver::Recorded)[0];
    // The last instant only ends the interpolation.
    assert!((scenario.spec().duration_s - 59.9).abs() < 0.15);
    for (index, car) in [(0, 0), (2, 2)] {
        let Driver::Profile(LeadProfile::Recorded(recorded)) = &scenario.vehicles()[index].driver
        else {
            panic!("{index}")
        };
        for tenth in 0..590 {
            let time_s = f64::from(tenth) / 10.0;
            let error_mps = recorded.speed_at_mps(time_s) - speed_mps(car, time_s);
            assert!(error_mps.abs() < 1e-3, "{index} {time_s}: {error_mps}");
        }
    }
    for car in [1, 2] {
        let initial_m = scenario.initial_gap_m(car).expect("follows");
        assert!((initial_m - gap_m(car, 0.0)).abs() < 1e-3, "{initial_m}");
    }
    let motion = scenario.vehicles()[1].recorded.as_ref().expect("recorded");
    assert_eq!(motion.interval_s, 0.1);
    for (index, (gap, speed)) in motion.gap_m.iter().zip(&motion.speed_mps).enumerate() {
        let time_s = index as f64 * 0.1;
        assert!((gap - gap_m(1, time_s)).abs() < 1e-3);
        assert!((speed - speed_mps(1, time_s)).abs() < 1e-3);
    }
}

#[test]
fn human_drivers_differ_between_drives() {
    let drives = find_drives(&platoon(4, 60, |_, _| ()), LeaderSelection::Any);
    let seeds = |follower| -> Vec<u64> {
        let scenarios = scenarios(&drives, &follower);
        scenarios
            .iter()
            .map(|scenario| scenario.spec().seed)
            .collect()
    };
    let humans = seeds(FollowerDriver::Human);
    assert!(
        humans[0] != humans[1] && humans[1] != humans[2],
        "{humans:?}"
    );
    assert_eq!(seeds(FollowerDriver::Idm), [0, 0, 0]);
}

/// Starts and durations of the drives behind the first vehicle, in seconds.
fn drives_of_first(recording: &Recording) -> Vec<[f64; 2]> {
    find_drives(recording, LeaderSelection::Any)
        .iter()
        .filter(|drive| drive.vehicles[0].number == 1)
        .map(|drive| [drive.start_s, drive.duration_s])
        .collect()
}

#[test]
fn drives_end_where_the_recording_has_a_hole_or_a_jump() {
    let near = |found: &[[f64; 2]], expected: &[[f64; 2]]| {
        let equal = found.len() == expected.len()
            && found
                .iter()
                .flatten()
                .zip(expected.iter().flatten())
                .all(|(a, b)| (a - b).abs() < 0.25);
        assert!(equal, "{found:?}, expected {expected:?}");
    };
    near(&drives_of_first(&platoon(2, 29, |_, _| ())), &[]);
    // The gap is unknown from 40 to 41 s; the rest of 19 s is too short.
    let hole = platoon(2, 60, |time_s, fields| {
        if (40.0..41.0).contains(&time_s) {
            fields[3].clear();
        }
    });
    near(&drives_of_first(&hole), &[[0.0, 39.8]]);
    // The speed of the vehicle itself jumps by 3 m/s at 50 s.
    let jump = platoon(2, 90, |time_s, fields| {
        if time_s >= 50.0 {
            fields[2] = format!("{:.4}", speed_mps(1, time_s) + 3.0);
        }
    });
    near(&drives_of_first(&jump), &[[0.0, 49.8], [50.0, 39.8]]);
    let long = platoon_each(4, 2, 3700, |_, _| ());
    near(
        &drives_of_first(&long),
        &[[0.0, MAX_DRIVE_S], [3600.4, 99.5]],
    );
}

/// A drive with many jumps: if each piece kept the rest of the drive, memory would grow with the square of its length.
#[test]
fn the_pieces_of_a_drive_hold_memory_for_their_own_instants_only() {
    let instant = |index: usize| {
        let speed_mps = if index % 200 < 100 { 10.0 } else { 20.0 };
        let sample = SpeedSample {
            index,
            time_ms: 100 * index as i64,
            speed_mps: 15.0,
        };
        DriveInstant {
            sample,
            time_s: 0.1 * index as f64,
            vehicle: EpisodeVehicle {
                number: 2,
                name: None,
                gap_ahead_m: 50.0,
                speed_mps,
                length_m: None,
            },
            behind: None,
        }
    };
    let drive: Vec<_> = (0..20_000).map(instant).collect();
    let pieces = split_at_jumps(drive);
    let capacity: usize = pieces.iter().map(Vec::capacity).sum();
    assert!(pieces.len() >= 200, "{}", pieces.len());
    assert_eq!(pieces.iter().map(Vec::len).sum::<usize>(), 20_000);
    assert!(capacity < 21_000, "{capacity}");
}

/// The vehicle behind need not be recorded for the whole drive.
#[test]
fn a_recorded_follower_holds_its_last_speed_after_the_recording() {
    let lost = platoon(3, 60, |time_s, fields| {
        if time_s > 20.0 {
            fields[3].clear();
        }
    });
    let drives = find_drives(&lost, LeaderSelection::First);
    let scenario = &scenarios(&drives, &FollowerDriver::Recorded)[0];
    let Driver::Profile(LeadProfile::Recorded(recorded)) = &scenario.vehicles()[2].driver else {
        panic!("no profile")
    };
    assert_eq!(recorded.time_s.last(), Some(&20.0));
    let about = &scenario.spec().about;
    assert!(
        about.contains("The recording of its speed ends after 20.0 s"),
        "{about}"
    );
    assert!(scenario.spec().duration_s > 59.0);
}

/// Noise at standstill makes speeds negative by less than half a millimetre per second.
#[test]
fn a_car_that_stands_at_the_start_has_no_negative_speed() {
    let standing = platoon(2, 60, |_, fields| {
        fields[1] = "-0.0001".to_owned();
        fields[2] = "-0.0001".to_owned();
        fields[3] = "10".to_owned();
    });
    let drives = find_drives(&standing, LeaderSelection::First);
    let scenario = &scenarios(&drives, &FollowerDriver::None)[0];
    assert_eq!(scenario.vehicles()[1].speed_mps.to_bits(), 0);
    let motion = scenario.vehicles()[1].recorded.as_ref().unwrap();
    assert!(
        motion
            .speed_mps
            .iter()
            .all(|speed_mps| speed_mps.to_bits() == 0)
    );
}

/// Another vehicle, which is not recorded, may be between.
#[test]
fn drives_far_behind_the_leader_are_counted() {
    let far = |gap_m: f64| {
        let recording = platoon(2, 60, |_, fields| fields[3] = gap_m.to_string());
        let drives = find_drives(&recording, LeaderSelection::First);
        let scenario = &scenarios(&drives, &FollowerDriver::None)[0];
        is_far_behind(scenario.vehicles()[1].recorded.as_ref().unwrap())
    };
    // The median speed is 18 m/s.
    assert!(far(4.6 * 18.0) && !far(4.4 * 18.0));
}
