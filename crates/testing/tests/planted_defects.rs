//! Planted defects are found, and their scenarios shrink to few changes.
#![expect(
    clippy::panic,
    clippy::unwrap_used,
    reason = "a test may panic, also in its functions"
)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crumple_measure::SpecificationError;
use crumple_testing::sim::observation::{EstimatorKind, Observation};
use crumple_testing::sim::scenario::Scenario;
use crumple_testing::{
    CheckError, MetamorphicRelation, Property, PropertyFailure, PropertyVerdict, Scenarios, check,
    stateless,
};

/// The Intelligent Driver Model, with up to 9 m/s² of braking.
fn sound(observation: &Observation) -> f64 {
    let free = 1.0 - (observation.speed_mps / 33.0).powi(4);
    let Some(ahead) = observation.ahead else {
        return free;
    };
    let closing_mps = observation.speed_mps - ahead.speed_mps;
    let wanted_m =
        2.0 + (1.2 * observation.speed_mps + observation.speed_mps * closing_mps / 2.4).max(0.0);
    (free - (wanted_m / ahead.gap_m.max(0.1)).powi(2)).clamp(-9.0, 1.5)
}

type Defect = fn(&Observation) -> f64;

fn gap_m(observation: &Observation) -> f64 {
    observation.ahead.map_or(f64::INFINITY, |ahead| ahead.gap_m)
}

fn is_closing(observation: &Observation) -> bool {
    observation
        .ahead
        .is_some_and(|ahead| ahead.speed_mps < observation.speed_mps)
}

fn failure_of(defect: Defect, space: &str, property: &Property) -> Box<PropertyFailure> {
    let folder = tempfile::tempdir().unwrap();
    let test = |decide: Defect| {
        check(stateless(decide))
            .on(space)
            .property(property.clone())
            .corpus(folder.path())
    };
    test(sound).cases(50).run().unwrap();
    let first = test(defect).cases(300).run();
    let Err(CheckError::Violated(failure)) = first else {
        panic!("{}: {first:?}", property.name())
    };
    assert!(failure.file.with_extension("svg").exists());
    // The next run evaluates the written scenario first.
    let Err(CheckError::Violated(again)) = test(defect).run() else {
        panic!("a corpus without a failure")
    };
    assert_eq!(
        (&again.file, &again.scenario, &again.finding),
        (&failure.file, &failure.scenario, &failure.finding)
    );
    failure
}

/// A test without scenarios fails. A failure that does not recur has its finding, and no file to replay.
#[test]
fn missing_scenarios_and_failures_that_do_not_recur_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let test = |decide: Defect| check(stateless(decide)).on("alone").corpus(folder.path());
    assert!(matches!(
        test(sound).cases(0).run(),
        Err(CheckError::NotTested { .. })
    ));
    let first = Arc::new(AtomicBool::new(true));
    let once = move |observation: &Observation| {
        if first.swap(false, Ordering::Relaxed) {
            f64::NAN
        } else {
            sound(observation)
        }
    };
    let failed = check(stateless(once))
        .on("alone")
        .corpus(folder.path())
        .cases(3)
        .run();
    let Err(CheckError::Violated(failure)) = failed else {
        panic!("{failed:?}")
    };
    let text = failure.to_string();
    assert!(
        text.contains("fails at 0.00 s; this does not recur") && !text.contains("replay"),
        "{text}"
    );
    assert_eq!(folder.path().read_dir().unwrap().count(), 0);
}

/// A property with an error in 99 of 100 scenarios fails the test. Only the property itself decides where it does not
/// apply: such scenarios are counted, and at least one must test it, also in a corpus.
#[test]
fn an_error_of_a_property_fails_the_test() {
    let folder = tempfile::tempdir().unwrap();
    let test = |property| {
        check(stateless(sound))
            .on("alone")
            .corpus(folder.path())
            .cases(300)
            .property(property)
    };
    let is_evaluated = |scenario: &Scenario| scenario.spec().seed.is_multiple_of(100);
    let skips = Property::new("skips most", move |_, scenario| {
        match is_evaluated(scenario) {
            true => Ok(PropertyVerdict::Holds),
            false => Ok(PropertyVerdict::NotApplicable("not evaluated".to_owned())),
        }
    });
    let summary = test(skips.clone()).run().unwrap();
    assert!((290..300).contains(&summary.not_applicable), "{summary:?}");
    let fails = Property::new("fails in most", move |_, scenario| {
        match is_evaluated(scenario) {
            true => Ok(PropertyVerdict::Holds),
            false => Err(SpecificationError::NoTrace),
        }
    });
    let Err(CheckError::Violated(failure)) = test(fails).run() else {
        panic!("errors pass")
    };
    assert_eq!(
        failure.finding,
        "the property ends with an error: the run has no trace"
    );
    assert!(
        failure
            .count
            .starts_with(&format!("{} of 300 cases", summary.not_applicable)),
        "{}",
        failure.count
    );
    // The corpus now has a scenario.
    assert!(
        matches!(test(skips).cases(0).run(), Err(CheckError::NotTested { reason, .. }) if reason == "not evaluated")
    );
    let of_five = Property::specification("always v5.speed_mps >= 0").unwrap();
    let with_fewer = check(stateless(sound))
        .cases(100)
        .property(of_five)
        .run()
        .unwrap()
        .not_applicable;
    assert!((1..100).contains(&with_fewer), "{with_fewer}");
}

/// A panic of a property is a finding, and its name one line. Only formulas that parse are properties.
#[test]
fn findings_name_their_reason() {
    let folder = tempfile::tempdir().unwrap();
    let test = |decide: Defect, property| {
        let test = check(stateless(decide))
            .on("alone")
            .corpus(folder.path())
            .cases(5000)
            .property(property);
        test.run().unwrap_err().to_string()
    };
    let text = test(
        sound,
        Property::new("one\nline", |_, _| panic!("a table ends here")),
    );
    for expected in [
        "violated: one line\n",
        "property panics: a table ends here\n",
        "4096 of 4096 cases",
        "replay: ",
    ] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let text = test(|_| f64::INFINITY, Property::no_avoidable_collision());
    assert!(
        text.contains("vehicle 1 failed at 0.00 s: it answered with a number that is not finite"),
        "{text}"
    );
    assert!(Property::specification("always v1.speed_mps >").is_err());
}

#[test]
fn metamorphic_relations_and_amplification_find_defects() {
    let relation = Property::metamorphic(MetamorphicRelation::LargerGap { by_m: 5.0 });
    let blind: Defect = |observation| {
        if gap_m(observation) > 30.0 {
            0.0
        } else {
            sound(observation).max(-4.0)
        }
    };
    failure_of(blind, "alone", &relation);

    let line = |gain: f64| {
        let folder = tempfile::tempdir().unwrap();
        let follower = move |observation: &Observation| {
            let spacing_error_m = gap_m(observation) - 2.0 - 1.5 * observation.speed_mps;
            observation.ahead.map_or(0.0, |ahead| {
                0.1 * spacing_error_m + gain * (ahead.speed_mps - observation.speed_mps)
            })
        };
        let test = check(stateless(follower))
            .on(Scenarios::line_of_five().unwrap())
            .corpus(folder.path());
        test.property(Property::no_amplification())
            .estimator(EstimatorKind::Truth)
            .cases(20)
            .run()
    };
    line(1.5).unwrap();
    assert!(matches!(line(0.0), Err(CheckError::Violated(_))));
}

#[test]
fn ten_planted_defects_shrink_to_few_changes() {
    let not_worse = || Property::not_worse_than(stateless(sound));
    let planted: [(&str, Property, Defect); 10] = [
        ("high-risk", not_worse(), |observation| {
            if observation.speed_mps > 30.0 {
                0.0
            } else {
                sound(observation)
            }
        }),
        ("high-risk", not_worse(), |observation| {
            if gap_m(observation) > 40.0 {
                0.0
            } else {
                sound(observation)
            }
        }),
        ("high-risk", not_worse(), |observation| {
            sound(observation).max(if observation.speed_mps > 28.0 {
                -2.5
            } else {
                -9.0
            })
        }),
        ("high-risk", not_worse(), |observation| {
            if is_closing(observation) {
                0.5 * sound(observation)
            } else {
                sound(observation)
            }
        }),
        ("high-risk", Property::deterministic(), |observation| {
            if gap_m(observation) > 50.0 {
                f64::NAN
            } else {
                sound(observation)
            }
        }),
        ("high-risk", Property::deterministic(), |observation| {
            assert!(observation.speed_mps < 35.0, "a table ends at 35 m/s");
            sound(observation)
        }),
        (
            "traffic",
            Property::no_unnecessary_braking(),
            |observation| {
                if observation.behind.is_some_and(|behind| behind.gap_m < 15.0) {
                    -6.0
                } else {
                    sound(observation)
                }
            },
        ),
        ("traffic", Property::bounded_jerk(25.0), |observation| {
            if observation.speed_mps < 12.0 {
                -4.0
            } else {
                sound(observation)
            }
        }),
        (
            "traffic",
            Property::specification("always v1.speed_mps < 36").unwrap(),
            |observation| {
                if gap_m(observation) > 50.0 {
                    1.5
                } else {
                    sound(observation)
                }
            },
        ),
        ("alone", not_worse(), |observation| {
            if observation.ahead.is_some_and(|ahead| ahead.speed_mps < 1.0) {
                0.0
            } else {
                sound(observation)
            }
        }),
    ];
    let failures = planted.map(|(space, property, defect)| failure_of(defect, space, &property));
    let few = failures
        .iter()
        .filter(|failure| failure.changes.len() <= 2)
        .count();
    let changes: Vec<_> = failures.iter().map(|failure| &failure.changes).collect();
    assert!(
        changes.iter().all(|changes| !changes.is_empty()),
        "nominal scenarios pass: {changes:#?}"
    );
    assert!(few >= 8, "{few} of 10: {changes:#?}");
}
