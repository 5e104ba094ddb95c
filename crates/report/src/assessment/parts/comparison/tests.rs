use super::*;

fn earlier(facts: &[(&str, f64)]) -> EarlierAssessment {
    EarlierAssessment { sha256: String::new(), config_sha256: String::new(), facts: facts_of(facts) }
}

fn facts_of(facts: &[(&str, f64)]) -> Facts {
    let fact = |score: f64| Fact { score, description: score.to_string(), is_failure: false };
    facts.iter().map(|(what, score)| (((*what).to_owned(), String::new()), fact(*score))).collect()
}

#[test]
fn everything_falls_into_one_place() {
    let before = earlier(&[("a", 1.0), ("b", 1.0), ("c", 1.0), ("d", 1.0)]);
    let found = AssessmentComparison::from_facts(&before, &facts_of(&[("a", 2.0), ("b", 0.0), ("c", 1.0), ("e", 1.0)]));
    let names =
        |changes: &[AssessmentChange]| changes.iter().map(|change| change.description.clone()).collect::<String>();
    let all = [&found.better, &found.worse, &found.new, &found.gone].map(|changes| names(changes));
    assert_eq!((all, found.unchanged), (["a", "b", "e", "d"].map(str::to_owned), 1));
}

#[test]
fn stronger_support_scores_higher() {
    let in_order = [
        Strength::Refuted { failures: 9, runs: 10 },
        Strength::Refuted { failures: 1, runs: 10 },
        Strength::Tested { runs: 3 },
        Strength::Tested { runs: 30 },
        Strength::Proved { certificates: 1 },
    ];
    assert!(in_order.windows(2).all(|pair| score(&pair[0]) < score(&pair[1])));
}

#[test]
fn what_is_no_evidence_is_refused_with_its_line() {
    let refused = |text: &str| EarlierAssessment::from_json(text, Path::new("old.json")).unwrap_err().to_string();
    assert!(refused("{}").starts_with("old.json:1: "), "{}", refused("{}"));
    assert!(refused("{\"version\": 0}").contains("version: 0"));
}
