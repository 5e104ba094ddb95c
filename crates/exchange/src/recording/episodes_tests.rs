//! Episodes of synthetic platoons, and their scenarios.

use super::tests::{braking_platoon, dropped_of, read_text};
use super::*;
use crumple_sim::scenario::{Driver, LeadProfile};

fn episodes_of_first(text: &str) -> FoundEpisodes {
    find_episodes(
        &read_text(text).expect("readable"),
        MinBrake::default(),
        LeaderSelection::First,
    )
}

fn only_episode(text: &str) -> BrakingEpisode {
    let mut result = episodes_of_first(text);
    assert_eq!((result.episodes.len(), &result.dropped[..]), (1, &[][..]));
    result.episodes.remove(0)
}

#[test]
fn a_braking_platoon_becomes_one_scenario() {
    let contradiction = "a.csv:87: the change of IVS1 is 0.0 m/s here, but Speed1 - Speed2 is -9.5 m/s: \
        this looks like an offset of 9.5 m/s";
    assert_eq!(
        dropped_of(&braking_platoon(3)),
        [contradiction],
        "gaps stay the same behind a braking leader"
    );
    let scenario = only_episode(&braking_platoon(3))
        .scenario("a-01".to_owned(), "a.csv", &FollowerDriver::Baseline)
        .expect("valid");
    // 4.5 s to 5.5 s loses 1.5 m/s, the second before less than 1.3; one second of lead-in precedes it.
    let Driver::Profile(LeadProfile::Recorded(lead)) = &scenario.vehicles()[0].driver else {
        panic!("no profile")
    };
    assert_eq!(lead.speed_at_mps(0.0), 20.0);
    assert!(
        (lead.speed_at_mps(1.5) - 20.0).abs() < 1e-9
            && (lead.speed_at_mps(2.5) - 17.0).abs() < 1e-9
    );
    assert_eq!(scenario.spec().duration_s, 1.0 + 4.0 + 10.0);
    let drivers: Vec<_> = scenario
        .vehicles()
        .iter()
        .map(|v| v.driver.name())
        .collect();
    assert_eq!(drivers, ["recorded", "under-test", "baseline"]);
    assert!((1..3).all(|i| (scenario.initial_gap_m(i).expect("follows") - 15.25).abs() < 1e-9));
    assert!((1..3).all(|i| scenario.vehicles()[i].speed_mps == 20.5));
    let about = &scenario.spec().about;
    assert!(
        about.contains("from 3.5 s on (line 42): vehicle 1 (A) slows from 20.0 to 11.0 m/s"),
        "{about}"
    );
    let scenario = only_episode(&braking_platoon(2))
        .scenario("a-01".to_owned(), "a.csv", &FollowerDriver::Baseline)
        .expect("valid");
    assert_eq!(scenario.vehicles()[1].driver, Driver::UnderTest);
}

/// Edits the fields of some rows of a recording; rows begin on line 7.
fn edited(text: &str, rows: std::ops::Range<usize>, edit: impl Fn(&mut Vec<String>)) -> String {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for line in &mut lines[6 + rows.start..6 + rows.end] {
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        edit(&mut fields);
        *line = fields.join(",");
    }
    lines.join("\n")
}

#[test]
fn episodes_start_where_most_followers_are_known() {
    let whole = braking_platoon(4);
    let line_at = |text: &str| {
        let episode = only_episode(text);
        (
            episode.start_s,
            episode.vehicles.len(),
            episode.not_recorded_behind,
        )
    };
    assert_eq!(line_at(&whole), (3.5, 4, None));
    // The last gap is unknown from 3.3 to 3.8 s: the nearest start with all four is at 3.9 s, not at 3.2 s.
    assert_eq!(
        line_at(&edited(&whole, 32..39, |fields| fields[7].clear())),
        (3.9, 4, None)
    );
    // Unknown throughout: three remain.
    assert_eq!(
        line_at(&edited(&whole, 0..300, |fields| fields[7] = "-1".to_owned())),
        (3.5, 3, Some(4))
    );
    // The first follower is never known: no vehicle follows.
    let result = episodes_of_first(&edited(&whole, 0..300, |fields| fields[5].clear()));
    assert_eq!(result.episodes, []);
    let output = result.dropped[0].to_string();
    assert!(output.contains(
        "vehicle 1 brakes at 4.5 s, but the episode was left out: speed of and gap to vehicle 2"
    ));
}

#[test]
fn the_first_recorded_vehicle_leads() {
    let second_brakes = edited(&braking_platoon(4), 0..300, |fields| {
        fields[2] = fields[1].clone();
        fields[1] = "20".to_owned();
    });
    let none = episodes_of_first(&second_brakes);
    assert_eq!(
        none,
        FoundEpisodes::default(),
        "a follower's braking is its own affair"
    );
    let first_lost = edited(&second_brakes, 0..300, |fields| fields[1].clear());
    let episode = only_episode(&first_lost);
    assert_eq!(
        (episode.vehicles[0].number, episode.ahead),
        (2, VehicleAhead::NotRecorded(1))
    );
    let scenario = episode
        .scenario("a".to_owned(), "a.csv", &FollowerDriver::Baseline)
        .expect("valid");
    assert!(
        scenario
            .spec()
            .about
            .contains("Vehicle 1, ahead of it, was not recorded at the time.")
    );
}

/// A growing wave: each car brakes a second after the one ahead, and harder.
#[test]
fn every_car_that_brakes_leads_those_behind_it() {
    let growing = edited(&braking_platoon(4), 0..300, |fields| {
        let time_s: f64 = fields[0].parse().expect("a number");
        for (index, field) in fields[1..=4].iter_mut().enumerate() {
            let onset_s = 5.0 + index as f64;
            *field = format!(
                "{:.3}",
                20.0 - (1.0 + index as f64) * (time_s - onset_s).clamp(0.0, 2.0)
            );
        }
    });
    let recording = read_text(&growing).expect("readable");
    let leads = |leaders| {
        let result = find_episodes(&recording, MinBrake::default(), leaders);
        assert_eq!(result.dropped, []);
        let numbers = result.episodes.into_iter().map(|episode| {
            (
                episode.vehicles[0].number,
                episode.vehicles.len(),
                episode.ahead,
            )
        });
        numbers.collect::<Vec<_>>()
    };
    assert_eq!(
        leads(LeaderSelection::First),
        [],
        "the first brakes at 1 m/s² only"
    );
    assert_eq!(
        leads(LeaderSelection::Any),
        [
            (2, 3, VehicleAhead::Recorded(1)),
            (3, 2, VehicleAhead::Recorded(2))
        ]
    );
}

#[test]
fn brakings_less_than_five_seconds_apart_are_one_episode() {
    // The first braking ends at 8.5 s: until then the speed drops by more than 1.3 m/s within a second.
    let again_at = |at_s: f64| {
        let text = edited(&braking_platoon(2), 0..300, |fields| {
            let number = |text: &str| text.parse::<f64>().expect("a number");
            let more = 2.0 * (number(&fields[0]) - at_s).clamp(0.0, 1.0);
            fields[1] = format!("{:.3}", number(&fields[1]) - more);
        });
        episodes_of_first(&text)
            .episodes
            .iter()
            .map(|episode| (episode.start_s, episode.duration_s))
            .collect::<Vec<_>>()
    };
    assert_eq!(again_at(13.0), [(3.5, 20.8)]);
    assert_eq!(
        again_at(15.0),
        [(3.5, 11.2), (13.7, 12.6)],
        "the first ends where the second begins"
    );
}

#[test]
fn a_jump_of_the_speed_is_no_braking() {
    let text = edited(&braking_platoon(2), 60..62, |fields| {
        fields[1] = "9".to_owned()
    });
    let result = episodes_of_first(&text);
    assert_eq!(result.episodes, []);
    let output = result.dropped[0].to_string();
    assert!(
        output.contains("its speed changes by -83.0 m/s² at 6 s, which no road vehicle can do"),
        "{output}"
    );
    // A hole of half a second is bridged; a longer one ends the run, and the last speed is held.
    let bridged = edited(&braking_platoon(2), 100..104, |fields| fields[1].clear());
    assert_eq!(
        only_episode(&bridged).leader_motion.time_s.last(),
        Some(&15.0)
    );
    let ended = edited(&braking_platoon(2), 100..105, |fields| fields[1].clear());
    let episode = only_episode(&ended);
    assert_eq!(
        (episode.leader_motion.time_s.last(), episode.duration_s),
        (Some(&6.4), 15.0)
    );
}
