//! Tests of controllers that are processes, with the feature `process`.
#![cfg(all(unix, feature = "process"))]
#![expect(
    clippy::unwrap_used,
    reason = "a test may panic, also in its functions"
)]

use crumple_controllers::{find_and_try, find_for_user};
use std::path::Path;

use crumple_testing::world::scenario::{built_in_scenario, file};
use crumple_testing::{CheckError, ControllerCheck, Property, Scenarios, check};

/// A process that always answers with the acceleration of its argument, in m/s².
const CONSTANT: &str = r#"while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *hello*) echo '{"crumple":1,"name":"constant","deterministic":true}' ;;
        *reset*) echo "{\"id\":$id,\"ready\":true}" ;;
        *) echo "{\"id\":$id,\"acceleration_mps2\":$1}" ;;
    esac
done
"#;

fn check_constant(folder: &Path, acceleration_mps2: &str) -> ControllerCheck {
    let process =
        find_and_try(&format!("exec:sh constant.sh {acceleration_mps2}"), folder).unwrap();
    let brakes = Property::specification("always v1.accel_mps2 <= 0.001").unwrap();
    check(process.source)
        .on(Scenarios::files(folder).unwrap())
        .property(brakes)
        .cases(2)
        .corpus(folder.join("corpus"))
}

#[test]
fn a_process_is_a_controller_under_test() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("constant.sh"), CONSTANT).unwrap();
    let scenario = file::to_toml(&built_in_scenario("paper-1").unwrap()).unwrap();
    std::fs::write(folder.path().join("paper-1.toml"), scenario).unwrap();
    assert_eq!(
        check_constant(folder.path(), "-2.0")
            .run()
            .unwrap()
            .evaluated,
        2
    );
    let Err(CheckError::Violated(failure)) = check_constant(folder.path(), "1.0").run() else {
        panic!("the process does not accelerate");
    };
    assert!(
        failure.finding.contains("robustness -"),
        "{}",
        failure.finding
    );
    let missing = find_for_user("exec:no-such-program", folder.path())
        .unwrap()
        .source;
    let missing = check(missing)
        .on("high-risk")
        .cases(1)
        .corpus(folder.path().join("missing"));
    let text = missing.run().unwrap_err().to_string();
    assert!(text.contains("cannot be started"), "{text}");
}
