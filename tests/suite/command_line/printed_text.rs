//! Snapshots of printed text.

use super::{run_ok, stdout, temp_folder};

#[test]
fn printed_text_is_as_reviewed() {
    let folder = temp_folder();
    let commands = [
        ("help", "--help"),
        ("simulate", "simulate paper-1 paper-2 paper-3 --controller baseline --estimator truth"),
        ("worst-case", "worst-case paper-1 --controller match-leader --estimator truth"),
        ("list", "list"),
    ];
    for (name, command) in commands {
        let output = run_ok(folder.path(), &command.split(' ').collect::<Vec<_>>());
        insta::assert_snapshot!(name, stdout(&output));
    }
}
