//! No claim is shown as stronger than its evidence allows, checked by an independent implementation that reads the
//! JSON.

use crumple_report::assessment::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Ledger, Property, Rounded,
    Strength, Subject, UncomparedText,
};
use crumple_sim::observation::EstimatorKind;
use proptest::prelude::*;
use proptest::sample::select;
use serde_json::Value;

/// A few of each kind, so that claims meet: equal names with different hashes, and the reverse.
fn any_known(kind: &'static str) -> impl Strategy<Value = ContentId> {
    (0..2_u8, 0..2_u8).prop_map(move |(name, content)| {
        ContentId::new(format!("{kind} {name}"), format!("{kind} {content}"))
    })
}

fn subject() -> impl Strategy<Value = Subject> {
    (any_known("controller"), select(&EstimatorKind::ALL[..])).prop_map(
        |(controller, estimator)| Subject {
            controller,
            estimator,
        },
    )
}

fn property() -> impl Strategy<Value = Property> {
    prop_oneof![
        Just(Property::NoCollision),
        Just(Property::NoCollisionAhead),
        Just(Property::FailureRate),
        (0..3_u8).prop_map(|percent| Property::RateAtMost {
            percent: Rounded::new(f64::from(percent))
        }),
        any_known("controller").prop_map(|than| Property::FailsLessOften { than }),
        Just(Property::NoUnnecessaryBraking),
        Just(Property::KeepsUp),
        Just(Property::NoGrowingOscillation),
    ]
}

fn domain() -> impl Strategy<Value = Domain> {
    prop_oneof![
        prop::collection::vec(any_known("scenario"), 1..3).prop_map(|all| Domain::Scenarios {
            about: UncomparedText("some".to_owned()),
            all
        }),
        (any_known("space"), 0..2_u64).prop_map(|(space, seed)| Domain::Draws {
            space,
            seed,
            draws: 10
        }),
        any_known("space").prop_map(|space| Domain::Space { space }),
        (any_known("space"), 0..2_u64).prop_map(|(space, seed)| Domain::Search {
            space,
            seed,
            budget: 10
        }),
        any_known("box").prop_map(|around| Domain::Box { around }),
    ]
}

fn strength() -> impl Strategy<Value = Strength> {
    let confidence_percent = Rounded::new(99.0);
    let bounds = (0..4_u8, 0..4_u8, select(&[50.0, 97.5, 99.0][..]), 1..3_u64);
    let between = bounds.prop_map(|(a, b, confidence, runs)| Strength::Between {
        confidence_percent: Rounded::new(confidence),
        lower_percent: Rounded::new(f64::from(a.min(b))),
        upper_percent: Rounded::new(f64::from(a.max(b))),
        runs,
    });
    prop_oneof![
        Just(Strength::Proved { certificates: 1 }),
        (1..9_u64).prop_map(|runs| Strength::Tested { runs }),
        (1..9_u64).prop_map(|undecided| Strength::PartlyTested { undecided, runs: 9 }),
        between,
        (1..3_u64).prop_map(move |runs| Strength::Counted {
            confidence_percent,
            runs
        }),
        (1..3_u64).prop_map(move |runs| Strength::NotShownByCounting {
            confidence_percent,
            runs
        }),
        (1..3_u64).prop_map(move |runs| Strength::CountedAgainst {
            only_own: runs,
            only_other: 0,
            unanswered: 0,
            confidence_percent,
            runs
        }),
        (0..3_u64, 0..3_u64).prop_map(|(own, other)| Strength::Compared {
            own,
            other,
            runs: 9,
            unanswered: 0
        }),
        (1..9_u64).prop_map(|failures| Strength::Refuted { failures, runs: 9 }),
        (1..9_u64).prop_map(|failures| Strength::FailedPoints {
            failures,
            points: 9
        }),
        Just(Strength::Falsified {
            failures: 2,
            avoidable: 1,
            reason: None
        }),
        (any::<bool>(), 0..2_u64).prop_map(|(refutes, failures)| Strength::Unanswered {
            unanswered: 3,
            failures,
            runs: 9,
            reason: "at 1.00 s, it is gone".to_owned(),
            refutes,
        }),
        Just(Strength::PartlyProved {
            share_percent: Rounded::new(40.0)
        }),
        (0.9..1.1).prop_map(|largest| Strength::Gain {
            largest: Rounded::new(largest),
            points: 9
        }),
        Just(Strength::NotShown),
        Just(Strength::Untried),
    ]
}

fn claim() -> impl Strategy<Value = AssuranceClaim> {
    (subject(), property(), domain()).prop_map(|(subject, property, domain)| AssuranceClaim {
        subject,
        property,
        domain,
    })
}

fn evidence() -> impl Strategy<Value = Evidence> {
    (claim(), strength()).prop_map(|(claim, strength)| Evidence {
        claim,
        strength,
        first_violation: None,
        source: EvidenceSource::from_part("x", "y"),
    })
}

/// Levels of a claim: refuted, no evidence, tested, holds often, always.
fn strength_level(text: &Value) -> u8 {
    match text["basis"].as_str().expect("a basis") {
        "refuted" | "falsified" | "exceeded" | "counted_against" | "failed_points"
        | "contradicted" => 0,
        "unanswered" if text["refutes"] == true || text["failures"].as_u64() > Some(0) => 0,
        "compared" if text["own"].as_u64() > text["other"].as_u64() => 0,
        "compared" if text["own"].as_u64() < text["other"].as_u64() => 2,
        "gain" if text["largest"].as_f64() > Some(1.0) => 0,
        "tested" | "gain" => 2,
        "bounded" | "counted" | "partly_proved" => 3,
        "proved" => 4,
        _ => 1,
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(1024))]

    /// JSON has the word of each strength, and files of 0.3.0, whose `strength` is the basis, are still read.
    #[test]
    fn json_has_the_word_of_a_strength_and_reads_its_old_form(strength in strength()) {
        let json = serde_json::to_value(&strength).expect("a strength has a JSON form");
        prop_assert_eq!(&json["strength"], &serde_json::to_value(strength.level()).expect("a word"));
        let expected: &[&str] = match strength_level(&json) {
            0 => &["refuted"],
            1 if json["basis"] == "between" => &["bounded"],
            1 => &["not_shown", "not_examined"],
            2 => &["tested"],
            3 if json["basis"] == "partly_proved" => &["not_shown"],
            3 => &["bounded"],
            _ => &["proved"],
        };
        prop_assert!(expected.contains(&json["strength"].as_str().unwrap_or_default()), "{}", json);
        let mut old = json.clone();
        let fields = old.as_object_mut().expect("an object");
        let kind = fields.remove("basis").expect("a basis");
        fields.insert("strength".to_owned(), kind);
        for form in [json, old] {
            let read: Strength = serde_json::from_value(form).expect("both forms are read");
            prop_assert_eq!(&read, &strength);
        }
    }
}

/// Computes the highest level that evidence allows, from the rules that the report prints.
fn allowed_level(evidence: &[Value], claim: &Value) -> u8 {
    let same = |a: &Value, b: &Value| a["sha256"] == b["sha256"];
    let about_runs = |p: &Value| {
        [
            "no_collision",
            "no_collision_ahead",
            "no_unnecessary_braking",
        ]
        .contains(&p["kind"].as_str().unwrap())
    };
    let same_property = |a: &Value, b: &Value| {
        a["kind"] == b["kind"]
            && a["percent"] == b["percent"]
            && (a["kind"] != "fails_less_often" || same(&a["than"], &b["than"]))
    };
    let scenarios = |d: &Value| d["all"].as_array().cloned().unwrap_or_default();
    let within = |part: &Value, whole: &Value| -> bool {
        match (
            part["kind"].as_str().unwrap(),
            whole["kind"].as_str().unwrap(),
        ) {
            ("scenarios", "scenarios") => scenarios(part)
                .iter()
                .all(|p| scenarios(whole).iter().any(|w| same(p, w))),
            ("draws" | "search", "space") => same(&part["space"], &whole["space"]),
            ("box", "box") => same(&part["around"], &whole["around"]),
            (a, b) => {
                a == b && same(&part["space"], &whole["space"]) && part["seed"] == whole["seed"]
            }
        }
    };
    let equal =
        |a: &Value, b: &Value| match (a["kind"] == "scenarios") && (b["kind"] == "scenarios") {
            true => {
                let (a, b) = (scenarios(a), scenarios(b));
                a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| same(a, b))
            }
            false => a["kind"] == b["kind"] && within(a, b),
        };
    let stronger = |p: &Value, q: &Value| {
        same_property(p, q) || (p["kind"] == "no_collision" && q["kind"] == "no_collision_ahead")
    };
    // The registration of a count, and its evidence against the claim; the largest decides.
    let fixed = |one: &Value| {
        let against = match one["basis"].as_str() {
            Some("counted") => 0.0,
            Some("not_shown_by_counting") => 100.0,
            _ => one["upper_percent"].as_f64().unwrap(),
        };
        (
            one["confidence_percent"].as_f64().unwrap(),
            one["runs"].as_f64().unwrap(),
            against,
        )
    };
    let has_subject = |own: &Value| {
        same(
            &own["subject"]["controller"],
            &claim["subject"]["controller"],
        ) && own["subject"]["estimator"] == claim["subject"]["estimator"]
    };
    let counts = |one: &Value| {
        let own = &one["claim"];
        let is_rate = own["property"]["kind"] == "failure_rate"
            && claim["property"]["kind"] == "rate_at_most";
        let is_counted = match one["basis"].as_str() {
            Some("between") => is_rate,
            Some("counted" | "not_shown_by_counting") => {
                same_property(&own["property"], &claim["property"])
            }
            _ => false,
        };
        has_subject(own) && is_counted && equal(&own["domain"], &claim["domain"])
    };
    let decides = |one: &Value| {
        evidence
            .iter()
            .filter(|rival| counts(rival))
            .all(|rival| fixed(rival) <= fixed(one))
    };
    let (mut best, mut refuted) = (1, false);
    let mut proved: Vec<Value> = Vec::new();
    for part in evidence {
        let own = &part["claim"];
        let is_subjects = has_subject(own);
        let (p, q, d, e) = (
            &own["property"],
            &claim["property"],
            &own["domain"],
            &claim["domain"],
        );
        let mut says = strength_level(part);
        let applies = if same_property(p, q) && equal(d, e) {
            !counts(part) || decides(part)
        } else if p["kind"] == "failure_rate"
            && q["kind"] == "rate_at_most"
            && part["basis"] == "between"
            && equal(d, e)
        {
            let at_most = q["percent"].as_f64().unwrap();
            says = if part["confidence_percent"].as_f64().unwrap() < 95.0 {
                1
            } else if part["upper_percent"].as_f64().unwrap() <= at_most {
                3
            } else {
                u8::from(part["lower_percent"].as_f64().unwrap() <= at_most)
            };
            // Bounds that rank behind others may still refute.
            says == 0 || decides(part)
        } else if !(about_runs(p) && about_runs(q)) {
            false
        } else {
            (says == 0 && stronger(q, p) && within(d, e))
                || (says == 4 && stronger(p, q) && within(e, d))
        };
        if is_subjects && says == 4 && stronger(p, q) && d["kind"] == "scenarios" {
            // Evidence that is not about all runs is about one scenario only if it was proved for that one.
            proved.extend(
                scenarios(d)
                    .into_iter()
                    .filter(|_| about_runs(p) || scenarios(d).len() == 1),
            );
        }
        if is_subjects && applies {
            refuted |= says == 0;
            best = best.max(says);
        }
    }
    // Disjoint bounds on part rate contradict each other, regardless of what each decides.
    let mut meet = (0.0, 100.0);
    for part in evidence.iter().filter(|part| {
        part["basis"] == "between" && part["claim"]["property"]["kind"] == "failure_rate"
    }) {
        let own = &part["claim"];
        if has_subject(own) && equal(&own["domain"], &claim["domain"]) {
            meet = (
                f64::max(meet.0, part["lower_percent"].as_f64().unwrap()),
                f64::min(meet.1, part["upper_percent"].as_f64().unwrap()),
            );
        }
    }
    if claim["property"]["kind"] == "rate_at_most" && meet.0 > meet.1 {
        return 0;
    }
    let parts = scenarios(&claim["domain"]);
    let united = !parts.is_empty()
        && parts
            .iter()
            .all(|part| proved.iter().any(|other| same(other, part)));
    if refuted {
        0
    } else if united {
        4
    } else {
        best
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(4000))]
    #[test]
    fn no_claim_is_stronger_than_its_evidence(evidence in prop::collection::vec(evidence(), 0..7), claim in claim()) {
        let ledger = Ledger::new(evidence);
        let json = serde_json::to_value(&ledger).unwrap();
        let status = ledger.claim_status(&claim);
        let shown = strength_level(&serde_json::to_value(&status).unwrap());
        let allowed = allowed_level(json.as_array().unwrap(), &serde_json::to_value(&claim).unwrap());
        prop_assert!(shown <= allowed, "{shown} where {allowed} is allowed: {status:#?}");
        // All evidence for and against a claim is shown.
        prop_assert_eq!(shown, allowed, "{:#?}", status);
        let read_back: Ledger = serde_json::from_value(json).unwrap();
        prop_assert_eq!(read_back.claim_status(&claim), status);
    }
}
