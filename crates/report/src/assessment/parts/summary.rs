//! The verdict: claims about each controller, and how strongly each is supported.

use maud::{Markup, html};
use serde::Serialize;

use super::{Distribution, PaperScenarios, Proofs, Searches, Strength, Traffic, WorstProfiles};
use crate::assessment::prose::prose;
use crate::assessment::table::{Cell, Table};
use crate::assessment::{AssessmentPlan, GateResult, Part, Rounded};
use crumple_search::falsify::counterexample::AvoidabilityClass;

/// Every claim about every controller.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The verdict in a paragraph.
    pub paragraph: String,
    /// The controller that the question is about.
    pub subject: Option<String>,
    /// Names of the controllers, in the order of each claim's strengths.
    pub controllers: Vec<String>,
    /// The claims.
    pub claims: Vec<Claim>,
    /// What had to hold, and whether it does.
    pub gates: Vec<GateResult>,
    /// The first controller, the subject, and whatever learned.
    #[serde(skip)]
    asked: Vec<usize>,
}

/// One claim, made of every controller.
#[derive(Debug, Clone, Serialize)]
pub struct Claim {
    /// What is claimed.
    pub claim: String,
    /// The part of the report with the evidence.
    pub part: &'static str,
    /// How it stands with each controller.
    pub strengths: Vec<Strength>,
}

impl Summary {
    pub(in crate::assessment) fn of(
        plan: &AssessmentPlan,
        paper: &PaperScenarios,
        distribution: &Distribution,
        traffic: Option<&Traffic>,
        worst: Option<&WorstProfiles>,
        searches: &Searches,
        proofs: &Proofs,
    ) -> Self {
        let controllers: Vec<_> = plan.controllers.iter().map(|controller| controller.name.clone()).collect();
        let claim = |part, claim: &str, strengths| Claim { claim: claim.to_owned(), part, strengths };
        let failing = distribution.controllers.iter().map(|s| Strength::of(s.collisions, distribution.draws));
        let mut claims = vec![
            claim("paper", "no contact in the paper's scenarios", no_contact(&paper.scenarios, controllers.len())),
            claim("distribution", "no contact in the paper's distribution", failing.collect()),
            claim("distribution", "contact in at most 1 % of the paper's distribution", rarely(distribution)),
        ];
        if controllers.iter().any(|name| certified(proofs, name) != Strength::Untried) {
            let certified = controllers.iter().map(|name| certified(proofs, name)).collect();
            claims.push(claim("proofs", "contact in at most 1 % of the paper's distribution, certified", certified));
        }
        if let Some(traffic) = traffic {
            let strengths = no_contact(&traffic.scenarios, controllers.len());
            claims.push(claim("traffic", "no contact in recorded traffic and other scenarios", strengths));
        }
        for space in &searches.spaces {
            let found = space.controllers.iter().map(|search| match search.total() {
                0 => Strength::of(0, search.evaluations()),
                failures => Strength::Found { failures, avoidable: search.count(AvoidabilityClass::Avoidable) },
            });
            claims.push(claim(
                "search",
                &format!("no contact that a search of `{}` finds", space.name),
                found.collect(),
            ));
        }
        if let Some(worst) = worst {
            claims.push(claim("worst", "no contact in paper-1, however its leader brakes", however(worst)));
        }
        let boxes = proofs.certificates.iter().filter(|proof| proof.statement == "reach");
        for proof in boxes {
            let share = |name: &String| match proof.shown_of(name) {
                (_, Some(share)) => Strength::ProvedIn { share_percent: Rounded::down(100.0 * share) },
                _ => Strength::Untried,
            };
            let start = proof.about.split(':').next().unwrap_or_default();
            let what = format!("no contact from {start}, with the true state");
            claims.push(claim("proofs", &what, controllers.iter().map(share).collect()));
        }
        let shielded =
            proofs.kernels_accepted().map_or(Strength::Untried, |certificates| Strength::Proved { certificates });
        let of = |name: &String| if name.starts_with("shield") { shielded.clone() } else { Strength::Untried };
        let strengths = controllers.iter().map(of).collect();
        claims.push(claim("proofs", "no contact with the vehicle ahead, from inside a shield's kernel", strengths));
        let paragraph = paragraph(plan, &controllers, &claims, distribution, searches);
        let subject = plan.subject().map(|subject| subject.name.clone());
        let is_asked = |&index: &usize| {
            index == 0 || index == plan.subject || plan.controllers.get(index).is_some_and(|one| one.policy().is_some())
        };
        let asked = (0..controllers.len()).filter(is_asked).collect();
        Self { paragraph, subject, controllers, claims, gates: Vec::new(), asked }
    }

    fn gate_table(&self) -> Table {
        let mut table = Table::new(&["what must hold", "does it?"]);
        for gate in &self.gates {
            let words = format!("{}: {}", if gate.holds { "yes" } else { "no" }, gate.because);
            table.row(vec![Cell::text(&gate.gate), Cell::judged(words, gate.holds)]);
        }
        table
    }

    fn table(&self, columns: &[usize]) -> Table {
        let names = columns.iter().filter_map(|&index| self.controllers.get(index).map(String::as_str));
        let header: Vec<&str> = std::iter::once("claim").chain(names).collect();
        let mut table = Table::new(&header);
        for claim in &self.claims {
            let strengths = columns.iter().filter_map(|&index| claim.strengths.get(index));
            let cells = strengths.map(|strength| Cell::marked(strength.words(), strength.mark()));
            table.row(std::iter::once(Cell::text(&claim.claim)).chain(cells).collect());
        }
        table
    }

    /// Those the question is about, and the others.
    fn columns(&self) -> (Vec<usize>, Vec<usize>) {
        (0..self.controllers.len()).partition(|index| self.asked.contains(index))
    }
}

/// Strength of the claim that no vehicle under test touches another in any of the scenarios. Runs in which others crash
/// first say nothing and do not count.
fn no_contact(scenarios: &[super::ScenarioCases], controllers: usize) -> Vec<Strength> {
    let of = |index: usize| {
        let verdicts = scenarios.iter().filter_map(|scenario| scenario.cases.get(index)).map(|case| &case.verdict);
        let counted: Vec<_> = verdicts.filter(|verdict| verdict.counts()).collect();
        let failures = counted.iter().filter(|verdict| verdict.is_failure()).count();
        Strength::of(failures as u64, counted.len() as u64)
    };
    (0..controllers).map(of).collect()
}

/// The largest share of collisions that still counts as rare, in percent.
const RARE_PERCENT: f64 = 1.0;

fn rarely(distribution: &Distribution) -> Vec<Strength> {
    // Each end of a two-sided interval is a one-sided bound at half the risk.
    let confidence_percent = Rounded::new(50.0 + 50.0 * distribution.confidence);
    let strength = |sampled: &super::Sampled| {
        if distribution.draws == 0 {
            return Strength::Untried;
        }
        let bounds = sampled.bounds(distribution);
        let (lower_percent, upper_percent) = (Rounded::down(100.0 * bounds.lower), Rounded::up(100.0 * bounds.upper));
        if 100.0 * bounds.upper <= RARE_PERCENT {
            Strength::Bounded { upper_percent, confidence_percent }
        } else if 100.0 * bounds.lower > RARE_PERCENT {
            Strength::Exceeded { lower_percent, confidence_percent }
        } else {
            Strength::Undecided { lower_percent, upper_percent }
        }
    };
    distribution.controllers.iter().map(strength).collect()
}

/// How rarely `controller` fails by its certificate: a count of runs that was registered before the first of them.
fn certified(proofs: &Proofs, controller: &str) -> Strength {
    let rate = proofs.certificates.iter().find_map(|proof| Some((proof.shown_of(controller).0?, proof.confidence?)));
    match rate {
        None => Strength::Untried,
        Some((at_most, confidence)) => {
            let (upper_percent, confidence_percent) = (Rounded::up(100.0 * at_most), Rounded::down(100.0 * confidence));
            if 100.0 * at_most <= RARE_PERCENT {
                Strength::Bounded { upper_percent, confidence_percent }
            } else {
                Strength::Undecided { lower_percent: Rounded::new(0.0), upper_percent }
            }
        }
    }
}

/// A search that found nothing is as many tests.
fn however(worst: &WorstProfiles) -> Vec<Strength> {
    let strength = |profile: &super::WorstProfile| match &profile.mildest {
        Some(mildest) => Strength::Defeated { peak_brake_mps2: mildest.peak_brake_mps2 },
        None => Strength::of(0, profile.evaluations as u64),
    };
    worst.profiles.iter().map(strength).collect()
}

fn paragraph(
    plan: &AssessmentPlan,
    controllers: &[String],
    claims: &[Claim],
    distribution: &Distribution,
    searches: &Searches,
) -> String {
    let collides = |&index: &usize| {
        claims.iter().any(|claim| matches!(claim.strengths.get(index), Some(Strength::Refuted { .. })))
    };
    let (failing, sound): (Vec<_>, Vec<_>) = (0..controllers.len()).partition(collides);
    let named = |indices: &[usize]| {
        let names: Vec<_> = indices.iter().filter_map(|&index| controllers.get(index).map(String::as_str)).collect();
        match names.split_last() {
            None => "none".to_owned(),
            Some((last, [])) => (*last).to_owned(),
            Some((last, others)) => format!("{} and {last}", others.join(", ")),
        }
    };
    let mut text = String::new();
    if let Some(first) = distribution.controllers.first().filter(|_| distribution.draws > 0) {
        text += &format!(
            "The {} collides in {} of {} draws of the paper's distribution",
            first.controller, first.collisions, distribution.draws
        );
        if first.was_hit > 0 {
            text += &format!(", in {} of them because it is hit from behind", first.was_hit);
        }
        text += &match distribution.controllers.get(plan.subject).filter(|_| plan.subject != 0) {
            Some(own) => format!("; {} collides in {} of the same draws. ", own.controller, own.collisions),
            None => ". ".to_owned(),
        };
    }
    text +=
        &format!("In the scenarios and draws of this report, its searches apart, no collision: {}; ", named(&sound));
    text += &format!("at least one: {}. ", named(&failing));
    if let Some(subject) = plan.subject() {
        for space in &searches.spaces {
            let Some(search) = space.of(&subject.name) else { continue };
            text += &match search.total() {
                0 => format!("A search of `{}` found no failure of {}. ", space.name, subject.name),
                1 => format!("A search of `{}` makes {} collide in one way. ", space.name, subject.name),
                total => format!(
                    "A search of `{}` makes {} collide in {total} distinct ways, {} of which another driver would have avoided. ",
                    space.name,
                    subject.name,
                    search.count(AvoidabilityClass::Avoidable)
                ),
            };
        }
    }
    let defeated = |&index: &usize| {
        claims.iter().any(|claim| matches!(claim.strengths.get(index), Some(Strength::Defeated { .. })))
    };
    let (defeated, withstood): (Vec<_>, Vec<_>) = (0..controllers.len()).partition(defeated);
    if !defeated.is_empty() {
        text += &match withstood.as_slice() {
            [] => "In paper-1 a search for the mildest lead braking made every controller collide. ".to_owned(),
            _ => format!("In paper-1 a search for the mildest lead braking made these collide: {}. ", named(&defeated)),
        };
    }
    text.trim_end().to_owned()
}

impl Part for Summary {
    fn heading(&self) -> (&'static str, String) {
        ("verdict", "Verdict".to_owned())
    }

    fn html(&self) -> Markup {
        let (asked, others) = self.columns();
        html! {
            p.lead { (prose(&self.paragraph)) }
            (self.table(&asked).html())
            @if !others.is_empty() {
                details { summary { "the other controllers" } (self.table(&others).html()) }
            }
            @if !self.gates.is_empty() {
                h3 { "Gates" }
                (self.gate_table().html())
            }
        }
    }

    fn markdown(&self) -> String {
        let gates = match self.gates.is_empty() {
            true => String::new(),
            false => format!("\n### Gates\n\n{}", self.gate_table().markdown()),
        };
        let (asked, others) = self.columns();
        let others = match others.is_empty() {
            true => String::new(),
            false => format!("\nThe other controllers:\n\n{}", self.table(&others).markdown()),
        };
        format!("{}\n\n{}{others}{gates}", self.paragraph, self.table(&asked).markdown())
    }
}
