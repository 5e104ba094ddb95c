//! Checks that `tests/findings.md` names existing tests and proofs for every finding.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

fn is_test(text: &str, name: &str) -> bool {
    let Some((before, _)) = text.split_once(&format!("fn {name}(")) else {
        return false;
    };
    let attributes: Vec<&str> = before
        .lines()
        .rev()
        .map(str::trim)
        .take_while(|line| line.is_empty() || line.starts_with(['#', '/']))
        .collect();
    attributes.contains(&"#[test]") && !attributes.iter().any(|line| line.starts_with("#[ignore"))
}

#[test]
fn every_finding_names_tests_and_proofs_that_there_are() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |file: &str| {
        fs::read_to_string(root.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
    };
    let proved = read("verify/coq/output.txt");
    let page = read("tests/findings.md");
    let sections: Vec<_> = page.split("\n## ").skip(1).collect();
    for (section, (findings, least_tests)) in sections.iter().zip([(8, 40), (26, 40), (36, 34)]) {
        let (mut found, mut tests) = (BTreeSet::new(), 0);
        for row in section.lines().filter(|line| line.starts_with("| ")) {
            let cells: Vec<&str> = row.split(" | ").collect();
            let Ok(finding) = cells[0].trim_start_matches("| ").parse::<u32>() else {
                continue;
            };
            found.insert(finding);
            let named = cells[cells.len() - 1].split('`').skip(1).step_by(2);
            let mut of_row = 0;
            for (file, name) in named.filter_map(|name| name.split_once("::")) {
                match file.rsplit_once('.') {
                    Some((_, "py")) => assert!(
                        read(file).contains(&format!("def {name}(")),
                        "{file} has no {name}"
                    ),
                    Some((_, "rs")) => {
                        assert!(is_test(&read(file), name), "{file} has no test {name}")
                    }
                    Some((_, "v")) => assert!(
                        read(file).contains(&format!("Theorem {name} "))
                            && proved.contains(&format!("proved: {name}\n")),
                        "{file}: {name}"
                    ),
                    _ => panic!("{file} is neither a file of tests nor one of theorems"),
                }
                of_row += usize::from(file.ends_with(".rs") || file.ends_with(".py"));
            }
            assert!(of_row > 0, "no test: {row}");
            tests += of_row;
        }
        // The rows of a commit are added together, when all of its faults are fixed.
        if !found.is_empty() || findings != 36 {
            assert!(
                found.into_iter().eq(1..=findings) && tests > least_tests,
                "{tests}"
            );
        }
    }
    assert_eq!(sections.len(), 3);
}

#[test]
fn a_name_that_is_mentioned_is_no_test() {
    let text = "/// Says `fn told(`.\n#[test]\n#[cfg(unix)]\nfn one() {}\nfn two() {}\n#[test]\n#[ignore \
        = \"long\"]\nfn three() {}\n";
    let results = ["one", "two", "three", "told", "none"].map(|name| is_test(text, name));
    assert_eq!(results, [true, false, false, false, false]);
}
