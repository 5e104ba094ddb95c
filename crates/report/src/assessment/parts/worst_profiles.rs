//! The mildest braking of the leader that makes each controller collide.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::worst_profiles_figure;
use crate::assessment::avoidance::RoundedAvoidance;
use crate::assessment::case::{CaseResult, CaseVerdict, MotionRetention, PileUp, run_cases};
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength, Subject,
};
use crate::assessment::commands::controller_arg;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::markdown::Inline;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand, ReportPart, Rounded};
use crumple_core::observer::Quiet;
use crumple_search::worst_case::{Attack, AttackMethod, AttackObjective, AttackResult, Envelope, attack};
use crumple_world::scenario::{Driver, LeadProfile, PiecewiseAcceleration, Scenario, built_in_scenario};
use crumple_world::sim::{NamedController, RunOptions};

const SCENARIO: &str = "paper-1";

/// Approximate maximum number of simulations per controller: the default of `crumple worst-case`.
pub(in crate::assessment) const ATTACK_BUDGET: usize = 3000;

/// The mildest braking of the leader found against every controller.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WorstProfiles {
    /// Scenario whose leader brakes.
    pub scenario: &'static str,
    /// Duration of the scenario, in seconds.
    pub duration_s: Rounded<2>,
    /// Maximum deceleration of the leader, in m/s².
    pub max_brake_mps2: Rounded<2>,
    /// Maximum jerk of the leader, in m/s³.
    pub max_jerk_mps3: Rounded<1>,
    /// One entry per controller.
    pub profiles: Vec<WorstProfile>,
    #[serde(skip)]
    content_id: ContentId,
}

/// The result of the search against one controller.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WorstProfile {
    /// Name of the controller.
    pub controller: String,
    /// Command that repeats the search; absent for an external controller.
    pub replay: Option<CrumpleCommand>,
    /// Number of simulations.
    pub evaluations: usize,
    /// Number of convex programs solved.
    pub programs: usize,
    /// Mildest braking that makes the controller collide; absent if none was found.
    pub mildest: Option<MildestAttack>,
}

/// A braking of the leader that ends in a collision.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MildestAttack {
    /// Hardest deceleration of the leader, in m/s².
    pub peak_brake_mps2: Rounded<2>,
    /// ∫ a² of the leader, in m²/s³.
    pub effort_m2ps3: Rounded<2>,
    /// Verdict on the run.
    pub verdict: CaseVerdict,
    /// Further collisions if all vehicles drive on after the first one.
    pub pile_up: Option<PileUp>,
    /// Avoidability of the collision.
    #[serde(rename = "best")]
    pub avoidance: RoundedAvoidance,
    /// Margin predicted by the last convex program, in metres: smallest gap, or minus v²/10 of an impact at v m/s.
    pub predicted_margin_m: Option<Rounded<3>>,
    /// Margin in the simulation, in metres; absent if the controller gave no answer.
    pub margin_m: Option<Rounded<3>>,
    /// Search that found it, which decides if a milder one is ruled out on this grid.
    pub method: AttackMethod,
    #[serde(skip)]
    pub(super) profile: Option<PiecewiseAcceleration>,
}

impl WorstProfiles {
    /// Returns the scenario and the limits of its leader; `None` if the plan leaves the paper out.
    pub(in crate::assessment) fn scenario(plan: &AssessmentPlan) -> Result<Option<(Scenario, Envelope)>, AssessError> {
        let Some(scenario) = built_in_scenario(SCENARIO).filter(|_| plan.config.paper) else { return Ok(None) };
        let scenario = scenario.edited(|spec| spec.seed = plan.config.seed)?;
        let envelope = Envelope::from_scenario(&scenario);
        Ok(Some((scenario, envelope)))
    }

    pub(in crate::assessment) fn gather(work: &GatherContext<'_>) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        let Some((scenario, envelope)) = Self::scenario(plan)? else { return Ok(None) };
        let against = |controller: &NamedController| WorstProfile::gather((&scenario, envelope), controller, work);
        let profiles = plan.controllers.par_iter().map(against).collect::<Result<Vec<_>, _>>()?;
        Ok(Some(Self {
            scenario: SCENARIO,
            content_id: ContentId::from_scenario(SCENARIO, &scenario),
            duration_s: scenario.spec().duration_s.into(),
            max_brake_mps2: envelope.max_brake_mps2.into(),
            max_jerk_mps3: envelope.jerk_mps3.into(),
            profiles,
        }))
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let of = |(subject, profile): (Subject, &WorstProfile)| {
            let strength = match &profile.mildest {
                Some(mildest) if mildest.verdict.unanswered().is_some() => {
                    Strength::from_counts_with_unanswered(0, 1, mildest.verdict.unanswered().as_ref(), true)
                }
                Some(mildest) => Strength::AttackFound { peak_brake_mps2: mildest.peak_brake_mps2 },
                // Each simulation of a search without a result counts as a test.
                None => Strength::from_counts(0, profile.evaluations as u64),
            };
            let claim = AssuranceClaim { subject, property: Property::NoContact, domain: self.domain() };
            let source = EvidenceSource::from_part("worst", format!("{} simulations", profile.evaluations));
            Evidence { claim, strength, source }
        };
        plan.claim_subjects().into_iter().zip(&self.profiles).map(of).collect()
    }

    pub(in crate::assessment) fn domain(&self) -> Domain {
        Domain::AnyLeaderBraking { scenario: self.content_id.clone() }
    }

    pub(in crate::assessment) fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.profiles.iter().filter_map(|profile| profile.replay.as_ref())
    }

    fn attacks(&self) -> impl Iterator<Item = (&str, &MildestAttack)> {
        self.profiles.iter().filter_map(|profile| Some((profile.controller.as_str(), profile.mildest.as_ref()?)))
    }

    fn table(&self) -> ReportTable {
        ReportTable::from_items(
            self.attacks(),
            &[
                ("controller", &|(controller, _)| ReportCell::text(controller)),
                ("peak braking (m/s²)", &|(_, mildest)| ReportCell::number(mildest.peak_brake_mps2)),
                ("∫a² (m²/s³)", &|(_, mildest)| ReportCell::number(mildest.effort_m2ps3)),
                ("outcome", &|(_, mildest)| ReportCell::with_mark(mildest.verdict.describe(), mildest.verdict.mark())),
                ("pile-up (vehicles)", &|(_, mildest)| {
                    ReportCell::optional(mildest.pile_up.map(|pile_up| pile_up.vehicles))
                }),
                ("best escape", &|(_, mildest)| ReportCell::text(mildest.avoidance.label())),
                ("predicted margin (m)", &|(_, mildest)| ReportCell::optional(mildest.predicted_margin_m)),
                ("simulated margin (m)", &|(_, mildest)| ReportCell::optional(mildest.margin_m)),
                ("milder braking", &|(_, mildest)| {
                    ReportCell::text(match mildest.method {
                        _ if mildest.verdict.unanswered().is_some() => "–",
                        AttackMethod::Exact => "ruled out on this grid",
                        AttackMethod::Widened => "possible, near the minimum",
                        AttackMethod::Sequential => "possible",
                    })
                }),
            ],
        )
    }

    fn introduction(&self) -> String {
        format!(
            "The mildest braking of the leader of {} that makes each controller collide: up to {} m/s², with a jerk of \
             at most {} m/s³, and the smallest ∫a². For the baseline the search enumerates the times at which its \
             brake fires. For the others it simulates pulses and ramps and improves the best by convex programs, so a \
             milder braking may exist. The margin is the smallest gap, or minus v²/10 after a collision at v m/s; a \
             program aims slightly beyond a collision.",
            self.scenario, self.max_brake_mps2, self.max_jerk_mps3
        )
    }

    fn describe_avoidable(&self) -> String {
        let touching = self.attacks().filter(|(_, mildest)| mildest.verdict.unanswered().is_none());
        let (found, avoidable) = touching.fold((0, 0), |(found, avoidable), (_, mildest)| {
            (found + 1, avoidable + usize::from(matches!(mildest.avoidance, RoundedAvoidance::Avoidable { .. })))
        });
        format!("Of these {found} collisions, {avoidable} are avoidable.")
    }

    fn describe_withstood(&self) -> Vec<String> {
        let none = self.profiles.iter().filter(|profile| profile.mildest.is_none());
        none.map(|profile| {
            format!(
                "{}: no braking found that makes it collide, in {} simulations and {} convex programs. This is no \
                 proof.",
                profile.controller, profile.evaluations, profile.programs
            )
        })
        .collect()
    }
}

impl WorstProfile {
    pub(in crate::assessment) fn gather(
        (scenario, envelope): (&Scenario, Envelope),
        controller: &NamedController,
        work: &GatherContext<'_>,
    ) -> Result<Self, AssessError> {
        let plan = work.plan;
        let item = format!("worst profile against {}", controller.name);
        // Cached next to the evidence, because published evidence holds only rounded numbers.
        let (mut found, profile): (Self, Option<PiecewiseAcceleration>) =
            work.get_or_gather(&item, &(plan.config.seed, plan.identity(controller)), || {
                let found = Self::search(scenario, controller, envelope, plan)?;
                let profile = found.mildest.as_ref().and_then(|mildest| mildest.profile.clone());
                Ok::<_, AssessError>((found, profile))
            })?;
        if let Some(mildest) = &mut found.mildest {
            mildest.profile = profile;
        }
        work.add_runs(ATTACK_BUDGET as u64)?;
        Ok(found)
    }

    fn search(
        scenario: &Scenario,
        controller: &NamedController,
        envelope: Envelope,
        plan: &AssessmentPlan,
    ) -> Result<Self, AssessError> {
        let options = RunOptions::new(controller.kind.clone()).with_estimator(plan.config.estimator);
        let AttackResult { attack: found, evaluations, programs } =
            attack(scenario, &options, AttackObjective::Mildest, envelope, ATTACK_BUDGET, &Quiet)?;
        let mildest = found.map(|attack| MildestAttack::from_attack(attack, controller, plan)).transpose()?.flatten();
        let replay = controller_arg(&controller.kind).map(|word| {
            let attack = CrumpleCommand::new(["worst-case", SCENARIO, "--controller", word.as_str()]);
            attack.with_args(plan.estimator_args().iter().copied())
        });
        Ok(Self { controller: controller.name.clone(), replay, evaluations, programs, mildest })
    }
}

impl MildestAttack {
    fn from_attack(
        attack: Attack,
        controller: &NamedController,
        plan: &AssessmentPlan,
    ) -> Result<Option<Self>, AssessError> {
        let one = std::slice::from_ref(controller);
        let cases = run_cases(&[&attack.scenario], one, plan.config.estimator, MotionRetention::Drop)?;
        let Some(CaseResult { verdict, pile_up, .. }) = cases.into_iter().flatten().next() else { return Ok(None) };
        let leader = attack.scenario.vehicles().first().map(|leader| &leader.driver);
        let Some(Driver::Profile(LeadProfile::Pieces(profile))) = leader.cloned() else { return Ok(None) };
        let has_answered = attack.outcome.failed_controller().is_none();
        Ok(Some(Self {
            peak_brake_mps2: attack.peak_brake_mps2.into(),
            effort_m2ps3: attack.effort_m2ps3.into(),
            verdict,
            pile_up,
            avoidance: RoundedAvoidance::compute(&attack.scenario),
            predicted_margin_m: has_answered.then(|| attack.predicted_margin_m.into()),
            margin_m: has_answered.then(|| attack.margin_m.into()),
            method: attack.method,
            profile: Some(profile),
        }))
    }
}

impl ReportPart for WorstProfiles {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("worst", "Worst-case braking of the leader".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(&self.introduction());
        if self.attacks().next().is_some() {
            out.table(&self.table());
            out.paragraph(&self.describe_avoidable());
            out.figure(worst_profiles_figure::draw_responsive(self.attacks(), self.duration_s.value()));
        }
        self.describe_withstood().iter().for_each(|line| out.paragraph(line));
        out.collapsible("commands that repeat the searches", |out| out.commands(self.commands()));
        if let Some(first) = self.commands().next() {
            out.markdown_mut().paragraph(Inline::prose("Search for the first controller: ").and_code(first));
        }
    }
}
