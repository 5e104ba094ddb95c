//! Usefulness: the behaviour of a controller in everyday traffic, compared with its failures in dangerous scenarios.

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::everyday_drives::{BrakingRate, EverydayDrive, braking_rates};
use super::first_scenarios::FirstScenarios;
use super::oscillation_gain::{OscillationGain, draw_gains, gain_introduction, gain_table};
use super::sampling::{draw_scenarios, simulate_each};
use super::share::{CONFIDENCE, PercentInterval, ShareFigure, ShareMark};
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, RandomScenario,
    Strength, Subject,
};
use crate::assessment::config::EVERYDAY_SPACES;
use crate::assessment::document::ReportDocument;
use crate::assessment::followers::{describe_followers, follower_drivers};
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::NamedSpace;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::rounded::or_dash;
use crate::assessment::run_ends::RunEnds;
use crate::assessment::table::{ReportCell, ReportColumn, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, Rounded};
use crate::draw::{Ink, Marker, Svg};
use crumple_measure::{EASY_BRAKE_MPS2, GainSurvey, HARD_BRAKE_MPS2, UNNECESSARY_MARGIN_MPS2};
use crumple_sim::engine::{FailedControllerRuns, NamedController, RecordingLevel, RunOptions};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_spaces::{ScenarioSpace, built_in_space, file as space_file};

const ANCHOR: &str = "usefulness";

/// Every controller in everyday traffic, in danger, and in a line.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct UsefulnessReport {
    /// Scenario spaces: everyday traffic, and dangerous scenarios.
    pub spaces: [ContentId; 2],
    /// Names of the drivers of the vehicles directly behind a vehicle under test, for each space.
    pub followers: [Vec<String>; 2],
    /// Number of random scenarios of each space for each controller.
    #[serde(alias = "draws")]
    pub random_scenarios: u64,
    /// Seed of the random scenarios.
    pub seed: u64,
    /// Confidence level of the bounds.
    pub confidence: f64,
    /// One entry per controller.
    pub controllers: Vec<ControllerUsefulness>,
}

/// The usefulness of one controller. Means are over the drives that have the value; pairs are everyday traffic and
/// danger.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControllerUsefulness {
    /// Name of the controller.
    pub controller: String,
    /// Everyday drives in which a vehicle under test collided or its controller failed.
    pub failures: u64,
    /// Scenarios that ended with a collision of other vehicles: no evidence about the controller.
    #[serde(alias = "cut_short")]
    pub ended_by_others: [u64; 2],
    /// Dangerous scenarios that the controller failed.
    pub high_risk_failures: u64,
    /// Scenarios in which a vehicle under test first hit its leader.
    #[serde(default)]
    pub hit: [u64; 2],
    /// Scenarios in which a vehicle under test was first hit from behind.
    #[serde(default)]
    pub was_hit: [u64; 2],
    /// Scenarios without an answer of the controller: failures, but no evidence about its driving.
    #[serde(default, skip_serializing_if = "all_answered")]
    pub unanswered: [Option<FailedControllerRuns>; 2],
    /// Everyday drives with unnecessary braking.
    #[serde(alias = "needless")]
    pub unnecessary_braking: u64,
    /// Share of these drives in percent, with exact bounds.
    #[serde(alias = "needless_percent")]
    pub unnecessary_braking_percent: PercentInterval,
    /// Mean time of unnecessary braking in a drive, in seconds.
    #[serde(alias = "needless_s")]
    pub unnecessary_braking_s: Option<Rounded<2>>,
    /// Unnecessary braking per hour of everyday driving, without and with sensor faults.
    #[serde(alias = "needless_per_hour")]
    pub unnecessary_braking_rates: Vec<BrakingRate>,
    /// Everyday drives with hard braking where little braking was required.
    #[serde(alias = "hard")]
    pub hard_braking: u64,
    /// Everyday drives at whose end the vehicle had fallen behind.
    pub left_behind: u64,
    /// Mean distance driven, relative to that of the leader.
    pub progress: Option<Rounded<2>>,
    /// Mean time gap, in seconds.
    pub time_gap_s: Option<Rounded<2>>,
    /// Mean of the time gap's standard deviation over a drive, in seconds.
    pub time_gap_deviation_s: Option<Rounded<2>>,
    /// Mean of a drive's root mean square of acceleration, in m/s².
    pub rms_acceleration_mps2: Option<Rounded<2>>,
    /// Mean of a drive's root mean square of jerk, in m/s³.
    pub rms_jerk_mps3: Option<Rounded<2>>,
    /// Mean of the hardest deceleration of the follower, in m/s².
    #[serde(alias = "imposed_brake_mps2")]
    pub induced_brake_mps2: Option<Rounded<2>>,
    /// Growth of speed oscillations in a line of these controllers.
    #[serde(alias = "gain")]
    pub oscillation_gain: OscillationGain,
    /// Share of failures in dangerous scenarios in percent, with exact bounds.
    pub high_risk_percent: PercentInterval,
    /// Unnecessary braking in every space of the report: everyday traffic, danger, and the other spaces.
    #[serde(default)]
    pub braking_by_space: Vec<SpaceBraking>,
    /// First scenarios that violate a claim.
    #[serde(default)]
    pub first: [FirstScenarios; 2],
}

/// Unnecessary braking of a controller in random scenarios of a space.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceBraking {
    /// Name of the space.
    pub space: String,
    /// Number of random scenarios.
    pub random_scenarios: u64,
    /// Scenarios with unnecessary braking.
    pub unnecessary: u64,
    /// Scenarios with hard braking where little braking was required.
    pub hard: u64,
}

fn all_answered(unanswered: &[Option<FailedControllerRuns>; 2]) -> bool {
    unanswered.iter().all(Option::is_none)
}

/// Returns the spaces of the report other than those of everyday traffic and danger, each once.
fn other_spaces(plan: &AssessmentPlan) -> impl Iterator<Item = &NamedSpace> {
    let searched = plan.search_spaces.iter().filter(|searched| {
        let mut counted = plan.rate_spaces.iter();
        counted.all(|named| named.space.name() != searched.space.name())
    });
    plan.rate_spaces
        .iter()
        .chain(searched)
        .filter(|named| !EVERYDAY_SPACES.contains(&named.space.name()))
}

pub(super) fn space_id(space: &ScenarioSpace) -> Result<ContentId, CacheError> {
    let text = space_file::to_identity_toml(space).map_err(CacheError::encoding)?;
    Ok(ContentId::new(space.name(), text))
}

impl UsefulnessReport {
    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if plan.config.everyday_draws == 0 {
            return Ok(None);
        }
        let inputs = json!([
            plan.config.everyday_draws,
            plan.config.seed,
            plan.config.estimator.name(),
            plan.identities(),
            other_spaces(plan)
                .map(|named| &named.content_id.sha256)
                .collect::<Vec<_>>()
        ]);
        work.get_or_gather("usefulness", &inputs, || Self::run(work))
    }

    fn run(work: &GatherContext<'_>) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        let seed = plan.config.seed;
        let count = plan.config.everyday_draws;
        let [Some(traffic), Some(high_risk)] = EVERYDAY_SPACES.map(built_in_space) else {
            return Ok(None);
        };
        let spaces = [space_id(&traffic)?, space_id(&high_risk)?];
        let traffic = draw_scenarios(&traffic, seed, 0..count)?;
        let high_risk = draw_scenarios(&high_risk, seed, 0..count)?;
        let followers = [&traffic, &high_risk]
            .map(|scenarios| follower_drivers(scenarios).into_iter().collect());
        let others = other_spaces(plan)
            .map(|named| {
                let scenarios = draw_scenarios(&named.space, seed, 0..count)?;
                Ok((named.content_id.name.clone(), scenarios))
            })
            .collect::<Result<Vec<_>, AssessError>>()?;
        let controllers = plan
            .controllers
            .iter()
            .map(|controller| {
                ControllerUsefulness::run(controller, [&traffic, &high_risk], &others, work)
            })
            .collect::<Result<_, _>>()?;
        Ok(Some(Self {
            spaces,
            followers,
            random_scenarios: count,
            seed,
            confidence: CONFIDENCE,
            controllers,
        }))
    }

    /// Returns the heading of the column with the scenarios of each space in which hard braking was unnecessary.
    fn hard_braking_heading(&self) -> String {
        let spaces = self
            .controllers
            .first()
            .map(|useful| &useful.braking_by_space);
        let names: Vec<&str> = spaces
            .into_iter()
            .flatten()
            .map(|braking| braking.space.as_str())
            .collect();
        format!("hard unnecessary braking ({})", names.join("; "))
    }

    pub(in crate::assessment) fn domains(&self) -> [Domain; 2] {
        self.spaces.clone().map(|space| Domain::Draws {
            space,
            seed: self.seed,
            draws: self.random_scenarios,
        })
    }

    pub(in crate::assessment) fn find(&self, controller: &str) -> Option<&ControllerUsefulness> {
        self.controllers
            .iter()
            .find(|useful| useful.controller == controller)
    }

    fn introduction(&self) -> String {
        format!(
            "A controller that stands still never collides, so the report also measures usefulness. Every controller \
             drives the same {} random scenarios of `traffic` (seed {}), ordinary driving without hard braking, and as \
             many of `high-risk`. {}. Columns without a space are about `traffic`. Braking is unnecessary if \
             it is more than {UNNECESSARY_MARGIN_MPS2} m/s² harder, for 0.2 s and above 3 m/s, than the largest of \
             these decelerations within the last 0.5 s: that of the Intelligent Driver Model at the true state, that \
             which avoids the leader, and, within a time gap of 3 s, that of the leader. Bounds are exact \
             (Clopper–Pearson, {} %).",
            self.random_scenarios,
            self.seed,
            self.describe_followers(),
            100.0 * self.confidence
        )
    }

    fn table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 13] = [
            ("controller", &|useful| ReportCell::text(&useful.controller)),
            ("failures", &|useful| {
                ReportCell::with_verdict(useful.failures, useful.failures == 0)
            }),
            ("unnecessary braking (%)", &|useful| match (
                useful.unnecessary_braking,
                useful.unanswered_runs(),
            ) {
                // A drive without an answer is no evidence for the absence of unnecessary braking.
                (0, [unanswered, _]) if unanswered > 0 => {
                    ReportCell::number(useful.unnecessary_braking_percent.observed)
                }
                (needless, _) => ReportCell::with_verdict(
                    useful.unnecessary_braking_percent.observed,
                    needless == 0,
                ),
            }),
            ("bounds (%)", &|useful| {
                ReportCell::number(useful.unnecessary_braking_percent.format_bounds())
            }),
            ("per drive (s)", &|useful| {
                ReportCell::optional(useful.unnecessary_braking_s)
            }),
            ("hard braking", &|useful| {
                ReportCell::number(useful.hard_braking)
            }),
            ("falls behind", &|useful| {
                ReportCell::number(useful.left_behind)
            }),
            ("progress", &|useful| ReportCell::optional(useful.progress)),
            ("time gap (s)", &|useful| {
                ReportCell::number(format!(
                    "{} ± {}",
                    or_dash(useful.time_gap_s),
                    or_dash(useful.time_gap_deviation_s)
                ))
            }),
            ("rms acceleration (m/s²)", &|useful| {
                ReportCell::optional(useful.rms_acceleration_mps2)
            }),
            ("rms jerk (m/s³)", &|useful| {
                ReportCell::optional(useful.rms_jerk_mps3)
            }),
            ("induced braking (m/s²)", &|useful| {
                ReportCell::optional(useful.induced_brake_mps2)
            }),
            ("failures in high-risk (%)", &|useful| {
                ReportCell::number(useful.high_risk_percent.observed)
            }),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    /// The main results of both sides, for the first page.
    pub(super) fn both_sides_table(&self) -> ReportTable {
        let hard = self.hard_braking_heading();
        let failures = format!("failures in traffic (of {})", self.random_scenarios);
        // A controller that answers in no drive shows nothing about its driving.
        let answered = |useful: &ControllerUsefulness, number: String| {
            let [unanswered, _] = useful.unanswered_runs();
            ReportCell::optional((unanswered < self.random_scenarios).then_some(number))
        };
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 9] = [
            ("controller", &|useful| ReportCell::text(&useful.controller)),
            ("failures in high-risk (%)", &|useful| {
                ReportCell::number(useful.high_risk_percent.observed)
            }),
            (&failures, &|useful| {
                ReportCell::with_verdict(useful.failures, useful.failures == 0)
            }),
            ("unnecessary braking in traffic (%)", &|useful| {
                answered(
                    useful,
                    useful.unnecessary_braking_percent.observed.to_string(),
                )
            }),
            (&hard, &|useful| {
                answered(useful, useful.format_hard_braking())
            }),
            ("falls behind in traffic", &|useful| {
                answered(useful, useful.left_behind.to_string())
            }),
            ("rms jerk in traffic (m/s³)", &|useful| {
                ReportCell::optional(useful.rms_jerk_mps3)
            }),
            ("time gap in traffic (s)", &|useful| {
                ReportCell::optional(useful.time_gap_s)
            }),
            ("largest gain in a line", &|useful| {
                let largest = useful.oscillation_gain.largest;
                ReportCell::optional(largest.map(|largest| largest.gain))
            }),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    /// Explains the table of the first page.
    pub(super) fn both_sides_note(&self) -> String {
        format!(
            "Counts are of {} random scenarios of each space (seed {}). {}. Hard: harder than {HARD_BRAKE_MPS2} m/s² \
             where less than {EASY_BRAKE_MPS2} m/s² was required. Gain: amplitude of a vehicle's speed divided by \
             that of the vehicle ahead. Above 1, oscillations grow from vehicle to vehicle. A dash: no gain was found, \
             for example because the vehicles do not settle.",
            self.random_scenarios,
            self.seed,
            self.describe_followers()
        )
    }

    /// Names the drivers of the followers in both spaces, as a sentence without a full stop.
    pub(super) fn describe_followers(&self) -> String {
        let described = EVERYDAY_SPACES.into_iter().zip(&self.followers);
        let described: Vec<_> = described
            .map(|(space, drivers)| format!("`{space}`, {}", describe_followers(drivers)))
            .collect();
        format!("In {}", described.join("; in "))
    }

    /// The failures of both spaces by their kind.
    fn failure_table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 4] = [
            ("controller", &|useful| ReportCell::text(&useful.controller)),
            ("no answer (traffic, high-risk)", &|useful| {
                ReportCell::with_verdict(
                    format_traffic_and_danger(useful.unanswered_runs()),
                    useful.unanswered_runs() == [0, 0],
                )
            }),
            ("hits leader (traffic, high-risk)", &|useful| {
                ReportCell::number(format_traffic_and_danger(useful.hit))
            }),
            ("hit from behind (traffic, high-risk)", &|useful| {
                ReportCell::number(format_traffic_and_danger(useful.was_hit))
            }),
        ];
        let all_answered = self
            .controllers
            .iter()
            .all(|useful| all_answered(&useful.unanswered));
        ReportTable::from_items(&self.controllers, &columns)
            .without_column(all_answered.then_some(1))
    }

    /// Unnecessary braking per hour, without and with sensor faults.
    fn braking_rate_table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 4] = [
            ("unnecessary braking per hour", &|useful| {
                ReportCell::text(&useful.controller)
            }),
            ("no fault", &|useful| useful.braking_rate_cell("no fault")),
            ("degraded", &|useful| useful.braking_rate_cell("degraded")),
            ("ghost", &|useful| useful.braking_rate_cell("ghost")),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    fn unanswered_notes(&self) -> Vec<String> {
        self.controllers
            .iter()
            .flat_map(|useful| useful.unanswered_notes(self.random_scenarios))
            .collect()
    }

    /// Draws both shares: one row per controller, 0 at the left, lower is better.
    pub(super) fn figure(&self, id: &str) -> Svg {
        let rows = self.controllers.iter().map(|useful| {
            let failures = ShareMark {
                share: useful.high_risk_percent,
                offset: 0.15,
                ink: Ink::Alert,
                marker: Marker::Cross,
            };
            let braking = ShareMark {
                share: useful.unnecessary_braking_percent,
                offset: -0.15,
                ink: Ink::Series(0),
                marker: Marker::Ring,
            };
            (useful.controller.as_str(), vec![failures, braking])
        });
        let descriptions: Vec<_> = self
            .controllers
            .iter()
            .map(ControllerUsefulness::describe_shares)
            .collect();
        let figure = ShareFigure {
            heading: "Failures in high-risk (×), unnecessary braking (○)",
            axis: "Share of random scenarios (%)",
            title: "Safety and usefulness",
            description: &descriptions.join("; "),
            row_height: 36.0,
        };
        figure.draw(id, &rows.collect::<Vec<_>>())
    }
}

impl ControllerUsefulness {
    /// Simulates everyday traffic, danger, lines of vehicles, and the scenarios of other spaces.
    fn run(
        controller: &NamedController,
        [traffic, high_risk]: [&[Scenario]; 2],
        others: &[(String, Vec<Scenario>)],
        work: &GatherContext<'_>,
    ) -> Result<Self, AssessError> {
        let options =
            RunOptions::new(controller.source.clone()).with_estimator(work.plan.config.estimator);
        let drives = drive_each(traffic, &options, work)?;
        let danger = drive_each(high_risk, &options, work)?;
        let gain = OscillationGain::new(&GainSurvey::new(&controller.source)?);
        let rates = braking_rates(traffic, &drives, &options)?;
        let mut useful = Self::new(controller, &drives, &danger, rates, gain);
        for (space, scenarios) in others {
            let drives = drive_each(scenarios, &options, work)?;
            let braking = SpaceBraking::new(space, &drives);
            useful.braking_by_space.push(braking);
        }
        Ok(useful)
    }

    fn format_hard_braking(&self) -> String {
        let counts = self.braking_by_space.iter();
        let counts: Vec<_> = counts.map(|braking| braking.hard.to_string()).collect();
        counts.join("; ")
    }

    /// Returns the number of everyday drives and of dangerous scenarios in which the controller gave no answer.
    #[must_use]
    pub fn unanswered_runs(&self) -> [u64; 2] {
        self.unanswered
            .each_ref()
            .map(|unanswered| unanswered.as_ref().map_or(0, |unanswered| unanswered.runs))
    }

    /// Describes the drives without an answer of the controller, in each space and in a line.
    fn unanswered_notes(&self, random_scenarios: u64) -> Vec<String> {
        let mut notes = Vec::new();
        for (space, unanswered) in EVERYDAY_SPACES.into_iter().zip(&self.unanswered) {
            if let Some(unanswered) = unanswered {
                let description = unanswered.describe(random_scenarios);
                notes.push(format!("{} in `{space}`: {description}", self.controller));
            }
        }
        let gain = &self.oscillation_gain;
        if let Some(unanswered) = &gain.unanswered {
            notes.push(format!(
                "{} behind an oscillating leader: {}",
                self.controller,
                unanswered.describe(gain.points)
            ));
        }
        notes
    }

    fn describe_shares(&self) -> String {
        format!(
            "{} fails in {} % of high-risk, brakes unnecessarily in {} % of traffic",
            self.controller,
            self.high_risk_percent.observed,
            self.unnecessary_braking_percent.observed
        )
    }

    fn braking_rate_cell(&self, sensors: &str) -> ReportCell {
        let rate = self
            .unnecessary_braking_rates
            .iter()
            .find(|rate| rate.sensors == sensors);
        ReportCell::optional(rate.map(|rate| {
            let [low, high] = rate.interval;
            format!("{} ({low} to {high})", rate.per_hour)
        }))
    }

    /// Returns the ends of the everyday drives (0) or of the dangerous scenarios (1).
    pub(in crate::assessment) fn ends(&self, space_index: usize) -> RunEnds {
        RunEnds {
            collisions: self.hit[space_index] + self.was_hit[space_index],
            unanswered: self.unanswered[space_index].clone(),
            ended_by_others: self.ended_by_others[space_index],
            hit: self.hit[space_index],
            was_hit: self.was_hit[space_index],
        }
    }
}

pub(super) fn drive_each(
    scenarios: &[Scenario],
    options: &RunOptions,
    work: &GatherContext<'_>,
) -> Result<Vec<EverydayDrive>, AssessError> {
    let drives = simulate_each(
        scenarios,
        options,
        RecordingLevel::Trace,
        EverydayDrive::new,
    )?;
    work.add_runs(scenarios.len() as u64)?;
    Ok(drives)
}

fn format_traffic_and_danger([traffic, danger]: [u64; 2]) -> String {
    format!("{traffic}, {danger}")
}

const SENSOR_CONDITIONS: &str = "Number of unnecessary brakings per hour of `traffic`. Brackets have the 95 % \
    interval, which is exact if the brakings are independent. Degraded sensors: latency 0.2 s, resolution 0.5 m, \
    outages of 0.5 s, one per 2 s. Ghost: one standing object per drive, reported 20 m ahead for 0.5 s. A dash: the \
    controller refuses sensor faults.";

impl ReportPart for UsefulnessReport {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::EverydayTraffic,
            anchor: ANCHOR,
            title: "Comfort and unnecessary braking",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        let spaces = 2 + other_spaces(plan).count() as u64;
        plan.runs_of_all(spaces * plan.config.everyday_draws)
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(self.introduction());
        out.table(self.table());
        out.paragraph(SENSOR_CONDITIONS);
        out.table(self.braking_rate_table());
        out.table(self.failure_table());
        for note in self.unanswered_notes() {
            out.paragraph(note);
        }
        out.figure(self.figure(ANCHOR));
        out.paragraph(gain_introduction());
        out.table(gain_table(&self.controllers));
        out.figure(draw_gains("gains", &self.controllers));
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let subjects = plan.claim_subjects().into_iter();
        subjects
            .zip(&self.controllers)
            .flat_map(|(subject, useful)| self.evidence_about(subject, useful))
            .collect()
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        let [traffic, danger] = self.domains();
        vec![
            ClaimDraft::about_all(
                plan,
                ANCHOR,
                Property::NoUnnecessaryBraking,
                traffic.clone(),
            ),
            ClaimDraft::about_all(plan, ANCHOR, Property::KeepsUp, traffic.clone()),
            ClaimDraft::with_estimator(
                plan,
                EstimatorKind::Truth,
                ANCHOR,
                Property::NoGrowingOscillation,
                OscillationGain::domain(),
            ),
            ClaimDraft::about_all(plan, ANCHOR, Property::NoCollision, traffic),
            ClaimDraft::about_all(plan, ANCHOR, Property::NoCollision, danger),
        ]
    }
}

impl UsefulnessReport {
    fn evidence_about(&self, subject: Subject, useful: &ControllerUsefulness) -> Vec<Evidence> {
        let runs = self.random_scenarios;
        let [traffic, danger] = self.domains();
        let in_traffic = useful.ends(0);
        // A drive without an answer is no evidence about driving.
        let [first_in_traffic, first_in_danger] = &useful.first;
        let [unnecessary, keeps_up] =
            [useful.unnecessary_braking, useful.left_behind].map(|failures| {
                let unanswered = in_traffic.unanswered.as_ref();
                Strength::from_counts_with_unanswered(failures, runs, unanswered, false)
            });
        let no_collision = in_traffic.strength(runs);
        let no_collision_in_danger = useful.ends(1).strength(runs);
        let in_traffic = [
            (Property::NoCollision, no_collision),
            (Property::NoUnnecessaryBraking, unnecessary),
            (Property::KeepsUp, keeps_up),
        ];
        let mut evidence = vec![useful.oscillation_gain.evidence_about(&subject)];
        evidence.extend(in_traffic.map(|(property, strength)| {
            self.piece_of_evidence(&subject, (property, &traffic), strength, first_in_traffic)
        }));
        evidence.push(self.piece_of_evidence(
            &subject,
            (Property::NoCollision, &danger),
            no_collision_in_danger,
            first_in_danger,
        ));
        evidence
    }

    fn piece_of_evidence(
        &self,
        subject: &Subject,
        (property, domain): (Property, &Domain),
        strength: Strength,
        first: &FirstScenarios,
    ) -> Evidence {
        let description = format!("{} drives, seed {}", self.random_scenarios, self.seed);
        Evidence {
            first_violation: RandomScenario::new(self.seed, first.violating(&property)),
            claim: AssuranceClaim {
                subject: subject.clone(),
                property,
                domain: domain.clone(),
            },
            strength,
            source: EvidenceSource::from_part(ANCHOR, description),
        }
    }
}

impl OscillationGain {
    fn evidence_about(&self, subject: &Subject) -> Evidence {
        let claim = AssuranceClaim {
            subject: Subject {
                estimator: EstimatorKind::Truth,
                ..subject.clone()
            },
            property: Property::NoGrowingOscillation,
            domain: Self::domain(),
        };
        let description = format!("{} operating points", self.points);
        Evidence {
            claim,
            strength: self.strength(),
            first_violation: None,
            source: EvidenceSource::from_part(ANCHOR, description),
        }
    }
}

#[cfg(test)]
mod tests;
