//! Recorded drives: every controller drives each of them once, beside the recorded cars.

use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength, Subject,
};
use crate::assessment::document::ReportDocument;
use crate::assessment::followers::{describe_followers, follower_drivers};
use crate::assessment::gather_context::GatherContext;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::run_ends::note_unanswered;
use crate::assessment::table::{ReportCell, ReportColumn, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, Rounded};
use crumple_core::observer::Quiet;
use crumple_evidence::drives::DriveSet;
use crumple_evidence::{DriveComfort, DriveReport, EventRate};
use crumple_measure::{ACCELERATION_WINDOW_S, HARD_BRAKE_MPS2, UNNECESSARY_MARGIN_MPS2};
use crumple_sim::engine::{NamedController, RunOptions};

const ANCHOR: &str = "recorded-drives";

/// Every controller on the recorded drives of a folder, each of which it drives once.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RecordedDrives {
    /// Folder, and the hash of all its drives. The report contains none of them.
    pub drives: ContentId,
    /// Number of drives.
    pub count: u64,
    /// Hours of the drives to their ends.
    pub hours: Rounded<2>,
    /// Number of drives without a vehicle behind, in which no collision from behind can happen.
    pub without_vehicle_behind: u64,
    /// Names of the drivers of the vehicles behind.
    pub followers: Vec<String>,
    /// One entry per controller: the counts that `crumple verify rate --drives` prints, beside the recorded cars.
    pub controllers: Vec<DriveReport>,
}

/// Runs a controller on each drive, and counts.
fn count_drives(
    controller: &NamedController,
    drives: &DriveSet,
    work: &GatherContext<'_>,
) -> Result<DriveReport, AssessError> {
    let options =
        RunOptions::new(controller.source.clone()).with_estimator(work.plan.config.estimator);
    let runs = drives.run(&options, &Quiet)?;
    work.add_runs(drives.max_run_count())?;
    Ok(DriveReport::new(&controller.name, &runs, drives))
}

/// Returns the number of drives that another vehicle ended: they decide nothing about collisions of the controller.
fn ended_by_others(driven: &DriveReport) -> u64 {
    driven.hit_by_recording + driven.others_collide
}

/// Returns the strengths of the claims that no drive has a collision, and none has unnecessary braking. Of a drive that
/// a collision ended earlier, the rest is unknown.
fn strengths(driven: &DriveReport) -> [Strength; 2] {
    let strength = |failures, refutes| {
        Strength::from_counts_with_unanswered(
            failures,
            driven.comfort.drives,
            driven.unanswered.as_ref(),
            refutes,
        )
    };
    let collisions = driven.hits_leader + driven.hit_from_behind;
    // A drive without an answer is no evidence about braking.
    let braking = strength(driven.comfort.unnecessary_braking_drives, false);
    [
        strength(collisions, true).with_undecided(ended_by_others(driven)),
        braking.with_undecided(driven.ended_before_unnecessary_braking),
    ]
}

/// Returns the note about drives that decide nothing about collisions of the controller.
fn note_ended_by_others(driven: &DriveReport) -> Option<String> {
    let ended = ended_by_others(driven);
    let [drives, these] = match ended {
        0 => return None,
        1 => ["1 drive".to_owned(), "this collision does not".to_owned()],
        _ => [
            format!("{ended} drives"),
            "these collisions do not".to_owned(),
        ],
    };
    Some(format!(
        "{}: {drives} ended with a collision of other vehicles, or from behind with a vehicle that repeats recorded \
         speeds ({}). Such a vehicle cannot react, so {these} count against the controller, and the rest of \
         the drive is unknown.",
        driven.controller, driven.hit_by_recording
    ))
}

impl RecordedDrives {
    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        let Some(named) = &plan.drives else {
            return Ok(None);
        };
        let inputs = json!([
            named.content_id,
            plan.config.estimator.name(),
            plan.identities()
        ]);
        work.get_or_gather("recorded-drives", &inputs, || {
            let drives = &named.drives;
            let controllers = plan
                .controllers
                .iter()
                .map(|controller| count_drives(controller, drives, work))
                .collect::<Result<Vec<_>, _>>()?;
            let scenarios = || drives.drives().iter().map(|drive| &drive.scenario);
            let durations_s = scenarios().map(|scenario| scenario.spec().duration_s);
            let hours = durations_s.sum::<f64>() / 3600.0;
            Ok(Some(Self {
                drives: named.content_id.clone(),
                count: drives.drives().len() as u64,
                hours: Rounded::new(hours),
                without_vehicle_behind: drives.without_vehicle_behind() as u64,
                followers: follower_drivers(scenarios()).into_iter().collect(),
                controllers,
            }))
        })
    }

    fn introduction(&self) -> String {
        let mut text = format!(
            "Each controller drives each of {} recorded drives once, {} hours in all: it starts at the recorded gap \
             and speed behind a leader that repeats its recorded speeds, and {}.",
            self.count,
            self.hours,
            describe_followers(&self.followers)
        );
        if self.without_vehicle_behind > 0 && !self.followers.is_empty() {
            text += &format!(
                " In {} drives no vehicle is behind, so that collisions from behind cannot happen.",
                self.without_vehicle_behind
            );
        }
        text += &format!(
            " Braking is unnecessary as in `traffic`, by more than {UNNECESSARY_MARGIN_MPS2} m/s². Rates have the \
             exact interval of independent events at 95 %; drives of one platoon are not independent. This report \
             contains none of the recordings."
        );
        text
    }

    /// Introduces the table of the first page.
    pub(super) fn first_page_note(&self) -> String {
        format!(
            "Recorded drives: {} drives of `{}`, {} hours, behind leaders that repeat their recorded speeds; {}. \
             Unnecessary braking that only a follower causes counts apart.",
            self.count,
            self.drives.name,
            self.hours,
            describe_followers(&self.followers)
        )
    }

    /// The main results, for the first page.
    pub(super) fn first_page_table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, &DriveReport>; 6] = [
            ("on recorded drives", &|driven| {
                ReportCell::text(&driven.controller)
            }),
            ("failed drives", &|driven| {
                let failures = driven.failures.count;
                ReportCell::with_verdict(failures, failures == 0)
            }),
            ("of them hit from behind", &|driven| {
                ReportCell::number(driven.hit_from_behind)
            }),
            ("unnecessary braking per hour", &|driven| {
                ReportCell::number(driven.comfort.unnecessary_braking.per_hour)
            }),
            ("drives with braking above 4 m/s²", &|driven| {
                ReportCell::number(driven.comfort.hard_braking_drives)
            }),
            ("rms jerk (m/s³)", &|driven| {
                two_decimals(driven.comfort.rms_jerk_mps3)
            }),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    fn failure_table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, &DriveReport>; 6] = [
            ("controller", &|driven| ReportCell::text(&driven.controller)),
            ("failed drives", &|driven| {
                let failures = driven.failures.count;
                ReportCell::with_verdict(failures, failures == 0)
            }),
            ("hits leader", &|driven| {
                ReportCell::number(driven.hits_leader)
            }),
            ("hit from behind", &|driven| {
                ReportCell::number(driven.hit_from_behind)
            }),
            ("failures per hour", &|driven| {
                ReportCell::number(driven.failures.per_hour)
            }),
            ("per 100 km", &|driven| {
                ReportCell::optional(driven.failures.per_100_km)
            }),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    fn comfort_table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, ComfortRow<'_>>; 8] = [
            ("driver", &|row| ReportCell::text(row.name)),
            ("unnecessary braking per hour", &|row| {
                ReportCell::number(row.comfort.unnecessary_braking.per_hour)
            }),
            ("per hour, only with the vehicle behind", &|row| {
                ReportCell::optional(row.caused_behind.map(|rate| rate.per_hour))
            }),
            ("rms jerk (m/s³)", &|row| {
                two_decimals(row.comfort.rms_jerk_mps3)
            }),
            ("rms jerk as recorded (m/s³)", &|row| {
                two_decimals(row.comfort.rms_jerk_sampled_mps3)
            }),
            ("drives above 4 m/s²", &|row| {
                ReportCell::number(row.comfort.hard_braking_drives)
            }),
            ("time gap (s)", &|row| two_decimals(row.comfort.time_gap_s)),
            ("spacing error (m)", &|row| {
                two_decimals(row.rms_spacing_error_m)
            }),
        ];
        let controllers = self.controllers.iter().map(|driven| ComfortRow {
            name: &driven.controller,
            comfort: &driven.comfort,
            caused_behind: Some(&driven.caused_by_vehicle_behind),
            rms_spacing_error_m: driven.rms_spacing_error_m,
        });
        let recorded = self.controllers.first().map(|driven| ComfortRow {
            name: "recorded cars",
            comfort: &driven.recorded,
            caused_behind: None,
            rms_spacing_error_m: None,
        });
        ReportTable::from_items(controllers.chain(recorded), &columns)
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = vec![format!(
            "The speeds of recorded cars are known at the recorded intervals. Their braking, and the jerk in the \
             column \"rms jerk as recorded\" of every driver, follow from accelerations averaged over \
             {ACCELERATION_WINDOW_S} s. Braking above {HARD_BRAKE_MPS2} m/s² of a controller counts at any \
             instant. Unnecessary braking that the same drive does not have without the vehicle behind has its own \
             column. The spacing error is the rms difference to the recorded gap, on average over the drives."
        )];
        for driven in &self.controllers {
            if let Some(unanswered) = &driven.unanswered {
                notes.push(note_unanswered(&driven.controller, unanswered, self.count));
            }
            notes.extend(note_ended_by_others(driven));
            let note = driven.note_vehicle_behind();
            notes.extend(note.map(|note| format!("{}: {note}.", driven.controller)));
        }
        notes
    }

    fn domain(&self) -> Domain {
        Domain::RecordedDrives {
            drives: self.drives.clone(),
            count: self.count,
        }
    }

    fn evidence_about(&self, subject: &Subject, driven: &DriveReport) -> [Evidence; 2] {
        let [collisions, braking] = strengths(driven);
        let drives = format!("{} drives", self.count);
        let noted = match driven.caused_by_vehicle_behind_drives {
            0 => drives.clone(),
            caused => {
                format!("{drives}, {caused} with braking that only the vehicle behind causes")
            }
        };
        [
            (Property::NoCollision, collisions, drives),
            (Property::NoUnnecessaryBraking, braking, noted),
        ]
        .map(|(property, strength, what)| Evidence {
            claim: AssuranceClaim {
                subject: subject.clone(),
                property,
                domain: self.domain(),
            },
            strength,
            first_violation: None,
            source: EvidenceSource::from_part(ANCHOR, what),
        })
    }
}

/// A row of the table of comfort.
struct ComfortRow<'a> {
    name: &'a str,
    comfort: &'a DriveComfort,
    caused_behind: Option<&'a EventRate>,
    rms_spacing_error_m: Option<f64>,
}

fn two_decimals(value: Option<f64>) -> ReportCell {
    ReportCell::optional(value.map(Rounded::<2>::new))
}

impl ReportPart for RecordedDrives {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::EverydayTraffic,
            anchor: ANCHOR,
            title: "Recorded drives",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        let drives = plan.drives.as_ref();
        plan.runs_of_all(drives.map_or(0, |named| named.drives.max_run_count()))
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(self.introduction());
        out.table(self.failure_table());
        out.table(self.comfort_table());
        for note in self.notes() {
            out.paragraph(note);
        }
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let subjects = plan.claim_subjects().into_iter();
        subjects
            .zip(&self.controllers)
            .flat_map(|(subject, driven)| self.evidence_about(&subject, driven))
            .collect()
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        [Property::NoCollision, Property::NoUnnecessaryBraking]
            .map(|property| ClaimDraft::about_all(plan, ANCHOR, property, self.domain()))
            .into()
    }
}
