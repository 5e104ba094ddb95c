//! Snapshots of printed text.

use super::*;

#[test]
fn printed_text_is_as_reviewed() {
    let folder = temp_folder();
    let commands = [
        ("help", "--help"),
        (
            "simulate",
            "simulate paper-1 paper-2 paper-3 --controller baseline --estimator truth",
        ),
        (
            "worst-case",
            "worst-case paper-1 --controller match-leader --estimator truth",
        ),
        ("list", "list"),
    ];
    for (name, command) in commands {
        insta::assert_snapshot!(name, stdout(&run_ok(folder.path(), command)));
    }
}
