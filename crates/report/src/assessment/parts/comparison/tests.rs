use std::cmp::Ordering::{Equal, Greater, Less};

use super::fact::{Fact, Measure};
use super::order::compare_strengths;
use super::*;
use crate::assessment::Rounded;
use crate::assessment::claims::Strength;

fn earlier(facts: &[(&str, Strength)]) -> EarlierAssessment {
    EarlierAssessment {
        sha256: String::new(),
        config_sha256: String::new(),
        facts: facts_of(facts),
    }
}

fn facts_of(facts: &[(&str, Strength)]) -> Facts {
    let fact = |strength: &Strength| Fact {
        description: strength.describe(),
        is_failure: strength.is_refutation(),
        collides: Some(strength.is_refutation()),
        is_restated: false,
        measure: Measure::Claim(strength.clone(), None),
    };
    facts
        .iter()
        .map(|(what, strength)| (((*what).to_owned(), String::new()), fact(strength)))
        .collect()
}

fn tested(runs: u64) -> Strength {
    Strength::Tested { runs }
}

fn falsified(failures: usize, avoidable: usize) -> Strength {
    Strength::Falsified {
        failures,
        avoidable,
        reason: None,
    }
}

fn refuted(failures: u64, runs: u64) -> Strength {
    Strength::Refuted { failures, runs }
}

#[test]
fn each_result_is_in_exactly_one_group_of_changes() {
    let before = earlier(&[
        ("a", tested(1)),
        ("b", tested(2)),
        ("c", tested(1)),
        ("d", tested(1)),
        ("f", falsified(10, 10)),
        ("g", falsified(10, 10)),
    ]);
    let now = facts_of(&[
        ("a", tested(2)),
        ("b", tested(1)),
        ("c", tested(1)),
        ("e", tested(1)),
        ("f", falsified(11, 9)),
        ("g", falsified(10, 9)),
    ]);
    let comparison = AssessmentComparison::from_facts(&before, &now, true);
    let names = |changes: &[AssessmentChange]| {
        changes
            .iter()
            .map(|change| change.description.clone())
            .collect::<String>()
    };
    let all = [
        &comparison.better,
        &comparison.worse,
        &comparison.changed,
        &comparison.new,
        &comparison.gone,
    ]
    .map(|changes| names(changes));
    assert_eq!(
        (all, comparison.unchanged),
        (["a", "bf", "g", "e", "d"].map(str::to_owned), 1)
    );
    assert!(comparison.describe().ends_with(
        "1 better, 2 worse, 1 new, 1 gone, 1 changed without being better or worse, 1 unchanged."
    ));
    assert_eq!(
        comparison.describe_changed(),
        "; 1 changed, and neither result is better"
    );
}

/// Greater is better. Each pair is compared in both directions.
#[test]
fn more_failures_are_worse_and_unlike_quantities_are_not_compared() {
    let compared = |own, other| Strength::Compared {
        own,
        other,
        runs: 100,
    };
    let unanswered = |unanswered, failures| Strength::Unanswered {
        unanswered,
        failures,
        runs: 100,
        reason: String::new(),
        refutes: true,
    };
    let bounded = |upper: f64, confidence: f64| Strength::Bounded {
        upper_percent: Rounded::new(upper),
        confidence_percent: Rounded::new(confidence),
    };
    let undecided = |lower: f64, upper: f64| Strength::Undecided {
        lower_percent: Rounded::new(lower),
        upper_percent: Rounded::new(upper),
        confidence_percent: Rounded::new(99.9),
    };
    let proved = Strength::Proved { certificates: 1 };
    let cases = [
        (falsified(10, 10), falsified(11, 9), Some(Less), None),
        (falsified(10, 5), falsified(11, 0), Some(Less), None),
        (falsified(10, 10), falsified(10, 9), None, Some(Less)),
        (
            falsified(10, 10),
            falsified(9, 9),
            Some(Greater),
            Some(Less),
        ),
        (falsified(3, 1), falsified(3, 1), Some(Equal), Some(Equal)),
        (falsified(1, 1), tested(400), Some(Greater), Some(Less)),
        (falsified(10, 0), refuted(9, 200), None, None),
        (refuted(9, 200), refuted(10, 200), Some(Less), Some(Greater)),
        (refuted(9, 200), refuted(8, 199), Some(Greater), Some(Less)),
        (refuted(9, 200), refuted(8, 100), None, Some(Less)),
        (refuted(9, 100), unanswered(4, 6), Some(Less), Some(Greater)),
        (refuted(9, 10), refuted(1, 10), Some(Greater), Some(Less)),
        (refuted(1, 10), tested(3), Some(Greater), Some(Less)),
        (tested(3), tested(30), Some(Greater), Some(Less)),
        (tested(30), proved, Some(Greater), Some(Less)),
        (tested(30), bounded(0.2, 99.9), None, None),
        (
            bounded(0.2, 99.9),
            bounded(0.1, 99.9),
            Some(Greater),
            Some(Less),
        ),
        (bounded(0.2, 99.9), bounded(0.1, 95.0), None, None),
        (undecided(0.5, 2.0), undecided(0.6, 1.8), None, None),
        (
            undecided(0.5, 2.0),
            undecided(0.4, 1.8),
            Some(Greater),
            Some(Less),
        ),
        (
            undecided(0.5, 2.0),
            bounded(0.9, 99.9),
            Some(Greater),
            Some(Less),
        ),
        (compared(1, 20), compared(2, 90), Some(Less), Some(Greater)),
        (compared(1, 20), compared(1, 90), None, None),
        (compared(5, 20), compared(5, 5), Some(Less), Some(Greater)),
    ];
    for (before, now, order, reverse) in cases {
        assert_eq!(
            compare_strengths(&before, &now, false),
            order,
            "{before:?} to {now:?}"
        );
        assert_eq!(
            compare_strengths(&now, &before, false),
            reverse,
            "{now:?} to {before:?}"
        );
    }
    // Counts of other runs, such as those of another space, are unlike; a claim that is refuted is still worse.
    assert_eq!(
        compare_strengths(&refuted(9, 200), &refuted(10, 200), true),
        None
    );
    assert_eq!(
        compare_strengths(&tested(200), &refuted(10, 200), true),
        Some(Less)
    );
}

/// A collision where none was is called that, comes first, and is on the terminal.
#[test]
fn a_collision_where_none_was_comes_first() {
    let before = earlier(&[("a", refuted(1, 9)), ("b", tested(9)), ("c", refuted(1, 9))]);
    let now = facts_of(&[("a", refuted(2, 9)), ("b", refuted(1, 9)), ("c", tested(9))]);
    let comparison = AssessmentComparison::from_facts(&before, &now, true);
    let new: Vec<(&str, bool)> = comparison
        .worse
        .iter()
        .map(|change| (change.description.as_str(), change.is_new_collision))
        .collect();
    assert_eq!(new, [("b", true), ("a", false)]);
    assert!(!comparison.better[0].is_new_collision);
    let text = comparison.to_plain_text();
    let lines: Vec<&str> = text.lines().skip(1).collect();
    assert_eq!(
        lines,
        [
            "  NEW COLLISION  b: tested: 0 of 9 fail -> refuted: 1 of 9 fail",
            "  worse  a: refuted: 1 of 9 fail -> refuted: 2 of 9 fail",
        ]
    );
}

#[test]
fn a_file_without_evidence_is_refused_with_its_line() {
    let refused = |text: &str| {
        EarlierAssessment::from_json(text, Path::new("old.json"))
            .unwrap_err()
            .to_string()
    };
    assert!(
        refused("{}").starts_with("old.json:1: "),
        "{}",
        refused("{}")
    );
    assert!(refused("{\"version\": 0}").contains("version: 0"));
}

/// Runs that refute a claim about a part of a domain are listed once: not again for the claim about the whole, unless
/// that one was or is decided by other evidence.
#[test]
fn a_refutation_of_a_part_is_listed_once() {
    let restated = |mut facts: Facts| {
        let whole = facts
            .iter_mut()
            .filter(|((what, _), _)| what.ends_with("anywhere"));
        whole.for_each(|(_, fact)| fact.is_restated = true);
        facts
    };
    let mut before = earlier(&[
        ("search", falsified(6, 6)),
        ("search: anywhere", falsified(6, 6)),
        ("gone: anywhere", falsified(6, 6)),
    ]);
    before.facts = restated(before.facts);
    before.facts.extend(facts_of(&[(
        "proof: anywhere",
        Strength::Proved { certificates: 1 },
    )]));
    let now = restated(facts_of(&[
        ("search", falsified(8, 8)),
        ("search: anywhere", falsified(8, 8)),
        ("new: anywhere", falsified(8, 8)),
        ("proof: anywhere", falsified(8, 8)),
    ]));
    let comparison = AssessmentComparison::from_facts(&before, &now, true);
    let worse: Vec<&str> = comparison
        .worse
        .iter()
        .map(|change| change.description.as_str())
        .collect();
    assert_eq!(worse, ["proof: anywhere", "search"]);
    assert!(comparison.new.is_empty() && comparison.gone.is_empty());
}
