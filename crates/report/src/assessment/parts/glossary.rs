//! The glossary of the report.

use crate::assessment::document::ReportDocument;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};

/// The terms of the report.
#[derive(Debug, Clone, Copy)]
pub struct Glossary;

const TERMS: [(&str, &str); 25] = [
    (
        "avoidable",
        "some allowed command of the ego vehicle prevents the collision; the report has such a profile, simulated",
    ),
    (
        "braking partly, fully",
        "the hardest braking is at least 10 %, or at least 95 %, of what the road allows",
    ),
    (
        "confidence",
        "the probability that a bound of this method is true",
    ),
    (
        "counterexample",
        "a scenario in which the controller fails, stored as a file",
    ),
    (
        "delta-v",
        "change of speed in an impact of vehicles that stick together, by mass",
    ),
    (
        "distinct failures",
        "failures of one search with other vehicles, other braking or another region of the space",
    ),
    (
        "DRAC",
        "constant deceleration that would just avoid the collision: closing speed squared over twice the gap",
    ),
    ("ego vehicle", "the vehicle with the controller under test"),
    (
        "falls behind",
        "at the end of a drive, the leader moves faster than 1 m/s, and the ego vehicle has less than half the \
         leader's speed, or a gap above both the initial gap and 20 m plus 6 s times the leader's speed",
    ),
    (
        "hard braking",
        "braking above 4 m/s² where less than 3 m/s² was required",
    ),
    (
        "headway, time gap",
        "time to the leader's position, from front bumper to front bumper, or from front to rear bumper",
    ),
    (
        "induced braking",
        "braking that the ego vehicle causes its follower to do",
    ),
    (
        "level",
        "hardest braking of the leader for which a plan avoids a collision on both sides, for one class of followers",
    ),
    (
        "peak jerk",
        "largest change of acceleration within 0.1 s, divided by 0.1 s",
    ),
    (
        "progress",
        "distance driven, relative to that of the leader",
    ),
    (
        "random scenarios",
        "scenarios drawn from the distribution of a space, from a seed",
    ),
    (
        "regret",
        "smallest gap of the best escape found, minus that of the controller",
    ),
    (
        "required brake",
        "deceleration that stops behind a leader that keeps its braking until standstill",
    ),
    (
        "safety kernel",
        "states from which full braking avoids the leader, for any braking of the leader within its limit",
    ),
    (
        "shield",
        "passes the controller's command on while the state stays in the kernel, and otherwise brakes fully",
    ),
    (
        "space",
        "scenarios whose parameters vary within ranges, each with a probability distribution",
    ),
    (
        "TET, TIT",
        "time with a TTC below 3 s, and the integral of the shortfall",
    ),
    ("TTC", "time to collision: gap divided by closing speed"),
    (
        "undecided",
        "neither an escape nor a proof that there is none was found",
    ),
    (
        "unnecessary braking",
        "for 0.2 s and above 3 m/s, braking more than 2 m/s² harder than the largest of these decelerations within \
         the last 0.5 s: that of the Intelligent Driver Model at the true state, that which avoids the leader, and, \
         within a time gap of 3 s, that of the leader",
    ),
];

impl ReportPart for Glossary {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Appendix,
            anchor: "glossary",
            title: "Glossary",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        out.table(ReportTable::from_items(
            TERMS,
            &[
                ("term", &|(word, _)| ReportCell::text(word)),
                ("meaning", &|(_, meaning)| ReportCell::text(meaning)),
            ],
        ));
    }
}
