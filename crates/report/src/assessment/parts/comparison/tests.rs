use std::cmp::Ordering::{Equal, Greater, Less};

use super::fact::{Fact, Measure};
use super::order::compare_strengths;
use super::runs::RunOrigin;
use super::*;
use crate::assessment::Rounded;
use crate::assessment::claims::Strength;
use crumple_sim::observation::EstimatorKind;

fn earlier(facts: &[(&str, Strength)]) -> EarlierAssessment {
    EarlierAssessment {
        text: String::new(),
        sha256: String::new(),
        config_sha256: String::new(),
        facts: facts_of(facts),
        runs: Vec::new(),
    }
}

fn facts_of(facts: &[(&str, Strength)]) -> Facts {
    let fact = |strength: &Strength| Fact {
        description: strength.describe(),
        is_failure: strength.is_refutation(),
        collides: Some(strength.is_refutation()),
        is_restated: false,
        family: None,
        runs: None,
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
        unanswered: 0,
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

/// Returns a claim about random scenarios, whose name has their number, with the runs behind it.
fn in_runs(strength: Strength, seed: u64, count: u64, is_search: bool) -> Facts {
    let name = format!("in {count} of seed {seed}");
    let mut facts = facts_of(&[(name.as_str(), strength)]);
    for fact in facts.values_mut() {
        fact.family = Some("family".to_owned());
        fact.runs = Some(RandomRuns {
            origin: RunOrigin {
                controller: "own".to_owned(),
                estimator: EstimatorKind::Kalman,
                space_sha256: "space".to_owned(),
                is_search,
            },
            seed: Some(seed),
            count,
            bounds_percent: None,
        });
    }
    facts
}

fn compare_facts(before: &Facts, now: &Facts) -> AssessmentComparison {
    let mut earlier = earlier(&[]);
    earlier.facts = before.clone();
    earlier.runs = before
        .values()
        .filter_map(|fact| fact.runs.clone())
        .collect();
    AssessmentComparison::from_facts(&earlier, now, false)
}

/// Results of other runs are paired, and are better or worse only if the common runs or the intervals decide it.
#[test]
fn results_of_other_runs_are_compared_by_common_runs_or_intervals() {
    let counted = |failures, runs, seed| {
        let strength = Strength::from_counts(failures, runs);
        in_runs(strength, seed, runs, false)
    };
    let searched = |failures: usize, seed, budget| {
        let strength = match failures {
            0 => tested(budget),
            _ => falsified(failures, failures),
        };
        in_runs(strength, seed, budget, true)
    };
    let label = |before: &Facts, now: &Facts| {
        let case = compare_facts(before, now);
        assert!(case.new.is_empty() && case.gone.is_empty(), "{case:?}");
        match (&case.better[..], &case.worse[..], &case.changed[..]) {
            ([], [worse], []) if worse.is_new_collision => NEW_COLLISION,
            ([], [_], []) => WORSE,
            ([_], [], []) => "better",
            ([], [], [changed]) => changed.other_runs.expect("other runs"),
            ([], [], []) => "unchanged",
            _ => panic!("{case:?}"),
        }
    };
    let (other_seed, other_search) = ("runs of another seed", "search with another seed");
    let [more, fewer] = ["more runs", "fewer runs"];
    let [larger, smaller] = ["larger search", "smaller search"];
    let cases = [
        // At least two of the first twenty runs fail now.
        (
            counted(0, 20, 0),
            counted(3, 21, 0),
            NEW_COLLISION,
            "better",
        ),
        (counted(0, 20, 0), counted(3, 21, 1), other_seed, other_seed),
        (counted(0, 200, 0), counted(3, 2000, 0), more, fewer),
        (counted(85, 200, 0), counted(420, 1000, 0), more, fewer),
        (counted(85, 200, 0), counted(700, 1000, 1), WORSE, "better"),
        (counted(0, 200, 0), counted(0, 2000, 0), more, fewer),
        (searched(0, 0, 40), searched(2, 0, 80), larger, smaller),
        (
            searched(0, 0, 80),
            searched(2, 0, 40),
            NEW_COLLISION,
            "better",
        ),
        (searched(2, 0, 40), searched(5, 0, 80), larger, smaller),
        (
            searched(0, 0, 40),
            searched(2, 1, 40),
            other_search,
            other_search,
        ),
    ];
    for (before, now, expected, reverse) in cases {
        assert_eq!(label(&before, &now), expected, "{before:?} to {now:?}");
        assert_eq!(label(&now, &before), reverse, "{now:?} to {before:?}");
    }
}

/// Bounds of a rate from other numbers of runs decide only if they are disjoint, whatever they decide about a claim.
#[test]
fn bounds_from_other_runs_decide_if_they_are_disjoint() {
    let bounded = |strength, bounds_percent, count| {
        let mut facts = in_runs(strength, 0, count, false);
        let runs = facts.values_mut().filter_map(|fact| fact.runs.as_mut());
        runs.for_each(|runs| runs.bounds_percent = Some(bounds_percent));
        facts
    };
    let confidence_percent = Rounded::new(99.9);
    let at_most_one = Strength::Bounded {
        upper_percent: Rounded::new(0.7),
        confidence_percent,
    };
    let open = Strength::Undecided {
        lower_percent: Rounded::new(0.0),
        upper_percent: Rounded::new(9.0),
        confidence_percent,
    };
    let above = Strength::Exceeded {
        lower_percent: Rounded::new(1.5),
        confidence_percent,
    };
    let many = bounded(at_most_one, [0.0, 0.7], 1000);
    let few = bounded(open, [0.0, 9.0], 100);
    let other = bounded(above, [1.5, 30.0], 300);
    for (before, now) in [(&many, &few), (&few, &many), (&few, &other)] {
        let case = compare_facts(before, now);
        assert_eq!(
            (case.changed.len(), case.worse.len(), case.better.len()),
            (1, 0, 0)
        );
    }
    assert_eq!(compare_facts(&many, &other).worse.len(), 1);
    assert_eq!(compare_facts(&other, &many).better.len(), 1);
}

/// A failure that the earlier assessment lacks is new, unless it had fewer or other runs of the same kind.
#[test]
fn a_failure_that_only_a_larger_search_finds_is_not_new() {
    let none = |seed, budget| in_runs(tested(budget), seed, budget, true);
    let kind = |seed, budget| {
        let mut facts = facts_of(&[("a kind of failure", falsified(1, 1))]);
        let runs = none(seed, budget).into_values().find_map(|fact| fact.runs);
        facts
            .values_mut()
            .for_each(|fact| fact.runs.clone_from(&runs));
        facts
    };
    for (before, difference) in [
        (none(0, 40), Some("larger search")),
        (none(1, 80), Some("search with another seed")),
        (none(0, 80), None),
        (Facts::new(), None),
    ] {
        let case = compare_facts(&before, &kind(0, 80));
        let changed: Vec<_> = case
            .changed
            .iter()
            .map(|change| change.other_runs)
            .collect();
        assert_eq!(changed, Vec::from_iter(difference.map(Some)), "{before:?}");
        assert_eq!(
            case.new.len(),
            usize::from(difference.is_none()),
            "{before:?}"
        );
    }
}
