//! The program as a user starts it, by the wall clock.

use std::process::{Command, Stdio};

use crate::clock::least_wall_s;
use crate::table::Figure;

fn crumple(arguments: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_crumple"));
    let status = command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    assert!(status.expect("starts").success(), "{arguments:?}");
}

pub fn figures(say: &mut dyn FnMut(Figure)) {
    let [help_s, list_s] = least_wall_s(40, [&mut || crumple(&["--help"]), &mut || crumple(&["list"])]);
    say(Figure::at_most(10.0, "ms", "`crumple --help` (wall clock)", 1e3 * help_s));
    say(Figure::at_most(10.0, "ms", "`crumple list` (wall clock)", 1e3 * list_s));
}

pub fn assessment(say: &mut dyn FnMut(Figure)) {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("report").display().to_string();
    let start_s = crate::clock::wall_s();
    crumple(&["--quiet", "assess", "--out", &out]);
    say(Figure::at_most(60.0, "s", "`crumple assess` (wall clock)", crate::clock::wall_s() - start_s));
}
