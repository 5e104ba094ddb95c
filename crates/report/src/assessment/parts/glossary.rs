//! The glossary of the report.

use crate::assessment::ReportPart;
use crate::assessment::document::ReportDocument;
use crate::assessment::table::{ReportCell, ReportTable};

/// The terms of the report.
#[derive(Debug, Clone, Copy)]
pub struct Glossary;

const TERMS: [(&str, &str); 23] = [
    (
        "avoidable",
        "a driver who knows the future has a way to keep everybody apart: it is shown as a profile and replayed",
    ),
    (
        "braking partly, fully",
        "the hardest that the ego braked: a tenth at least, or 95 % at least, of what it can on the road",
    ),
    ("bounded", "the share of failures is at most a number, with a stated confidence, by counted runs"),
    ("confidence", "how often, over many repetitions, a bound made this way is true"),
    ("counterexample", "a scenario in which the controller fails, kept as a file"),
    (
        "distinct failure",
        "of the failures of one search, those that differ in who hits whom, how the ego was braking and where in the space they lie",
    ),
    ("draws", "scenarios taken from a space by its law, by chance, from a seed"),
    ("ego, subject", "the vehicle with the controller under test, and the controller that the question is about"),
    ("hard braking", "a drive in which the vehicle brakes harder than 4 m/s² where less than 3 m/s² had a cause"),
    ("headway, time gap", "time to where the vehicle ahead is now, front to front, and from the own front to its rear"),
    ("imposed braking", "deceleration that the vehicle behind is forced to by the one under test"),
    ("kernel", "the states from which full braking avoids the vehicle ahead however that one brakes within its limit"),
    (
        "left behind",
        "at the end of a drive the vehicle ahead moves faster than 1 m/s, and the one under test not half as fast",
    ),
    ("progress", "distance driven, relative to that of the vehicle ahead"),
    ("proved", "a certificate says so and the checker accepted it; it holds under the assumptions that go with it"),
    ("refuted", "there is at least one run to show that it does not hold"),
    ("regret", "how much more gap the best escape found keeps"),
    ("s a drive", "how long, on average over all drives, braking without cause lasts, in seconds"),
    ("shield", "lets the controller act as long as a way out is left, and brakes fully otherwise"),
    ("space", "scenarios with parameters that vary, each by a law within a range"),
    ("tested", "it held whenever it was tried; nothing follows for what was not tried"),
    ("TTC", "time to collision: the gap over the closing speed"),
    ("undecided", "nobody's escape was found, and no proof that there is none"),
];

impl ReportPart for Glossary {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("glossary", "Glossary".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.table(&ReportTable::from_items(
            TERMS,
            &[("word", &|(word, _)| ReportCell::text(word)), ("meaning", &|(_, meaning)| ReportCell::text(meaning))],
        ));
    }
}
