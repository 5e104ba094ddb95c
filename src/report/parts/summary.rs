//! The verdict: claims about each controller, and how strongly each is supported.

use maud::{Markup, html};
use serde::Serialize;

use super::{Distribution, PaperScenarios, Proofs, Traffic, WorstProfiles};
use crate::report::table::{Cell, Mark, Table};
use crate::report::{Part, Plan, Rounded};

/// Every claim about every controller.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The verdict in a paragraph.
    pub paragraph: String,
    /// Names of the controllers, in the order of each claim's strengths.
    pub controllers: Vec<String>,
    /// The claims.
    pub claims: Vec<Claim>,
}

/// One claim, made of every controller.
#[derive(Debug, Clone, Serialize)]
pub struct Claim {
    /// What is claimed.
    pub claim: &'static str,
    /// How it stands with each controller.
    pub strengths: Vec<Strength>,
}

/// How strongly a claim is supported.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "strength", rename_all = "snake_case")]
pub enum Strength {
    /// The checker accepted the certificates in this run; it holds under the assumptions that go with them.
    Proved {
        /// How many certificates.
        certificates: usize,
    },
    /// It held whenever it was tried, so many times; that is all that is known.
    Tested {
        /// How often it was tried, at least once.
        runs: u64,
    },
    /// The share of failures is at most this, with the stated confidence.
    Bounded {
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
        /// Confidence of the bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// The share of failures is more than claimed, with the stated confidence.
    Exceeded {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Confidence of the bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// The bounds lie on both sides of what is claimed.
    Undecided {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
    },
    /// It failed: there are runs to show for it.
    Refuted {
        /// How often.
        failures: u64,
        /// Out of how many.
        runs: u64,
    },
    /// A search found what makes it fail, so nothing follows about how often it does.
    Defeated {
        /// Hardest deceleration of the leader, in m/s².
        peak_brake_mps2: Rounded<2>,
    },
    /// It was never tried.
    Untried,
}

impl Strength {
    /// Of the claim that nothing fails, after `failures` in `runs`.
    fn of(failures: u64, runs: u64) -> Self {
        match (failures, runs) {
            (_, 0) => Self::Untried,
            (0, _) => Self::Tested { runs },
            _ => Self::Refuted { failures, runs },
        }
    }

    fn mark(&self) -> Mark {
        match self {
            Self::Proved { .. } | Self::Tested { .. } | Self::Bounded { .. } => Mark::Good,
            Self::Undecided { .. } | Self::Untried => Mark::None,
            Self::Exceeded { .. } | Self::Refuted { .. } | Self::Defeated { .. } => Mark::Bad,
        }
    }

    fn words(&self) -> String {
        match self {
            Self::Proved { .. } => "proved under assumptions, see Proofs".to_owned(),
            Self::Tested { runs } => format!("tested: 0 of {runs} collide"),
            Self::Bounded { upper_percent, confidence_percent } => {
                format!("bounded: at most {upper_percent} %, confidence {confidence_percent} %")
            }
            Self::Exceeded { lower_percent, confidence_percent } => {
                format!("exceeded: at least {lower_percent} %, confidence {confidence_percent} %")
            }
            Self::Undecided { lower_percent, upper_percent } => {
                format!("undecided: {lower_percent} to {upper_percent} %")
            }
            Self::Refuted { failures, runs } => format!("refuted: {failures} of {runs} collide"),
            Self::Defeated { peak_brake_mps2 } => {
                format!("refuted by a leader that brakes at up to {peak_brake_mps2} m/s²")
            }
            Self::Untried => "not tried".to_owned(),
        }
    }
}

impl Summary {
    pub(in crate::report) fn of(
        plan: &Plan,
        paper: &PaperScenarios,
        distribution: &Distribution,
        traffic: Option<&Traffic>,
        worst: Option<&WorstProfiles>,
        proofs: &Proofs,
    ) -> Self {
        let mut claims = vec![
            Claim {
                claim: "no contact in the paper's scenarios",
                strengths: no_contact(&paper.scenarios, plan.controllers.len()),
            },
            Claim {
                claim: "no contact in the paper's distribution",
                strengths: distribution
                    .controllers
                    .iter()
                    .map(|s| Strength::of(s.collisions, distribution.draws))
                    .collect(),
            },
            Claim { claim: "contact in at most 1 % of the paper's distribution", strengths: rarely(distribution) },
        ];
        if let Some(traffic) = traffic {
            claims.push(Claim {
                claim: "no contact in recorded traffic and other scenarios",
                strengths: no_contact(&traffic.scenarios, plan.controllers.len()),
            });
        }
        if let Some(worst) = worst {
            claims.push(Claim { claim: "no contact in paper-1, however its leader brakes", strengths: however(worst) });
        }
        // A kernel is about the vehicle, whoever wants to drive it.
        let shielded = proofs.accepted().map_or(Strength::Untried, |certificates| Strength::Proved { certificates });
        claims.push(Claim {
            claim: "no contact with the vehicle ahead, behind a shield",
            strengths: vec![shielded; plan.controllers.len()],
        });
        let controllers: Vec<_> = plan.controllers.iter().map(|controller| controller.name.clone()).collect();
        let paragraph = paragraph(&controllers, &claims, distribution);
        Self { paragraph, controllers, claims }
    }

    fn table(&self) -> Table {
        let header: Vec<&str> = std::iter::once("claim").chain(self.controllers.iter().map(String::as_str)).collect();
        let mut table = Table::new(&header);
        for claim in &self.claims {
            let cells = claim.strengths.iter().map(|strength| Cell::marked(strength.words(), strength.mark()));
            table.row(std::iter::once(Cell::text(claim.claim)).chain(cells).collect());
        }
        table
    }
}

/// Of the claim that no vehicle under test touches anybody in any of the scenarios. Runs in which others crash first say
/// nothing and do not count.
fn no_contact(scenarios: &[super::ScenarioCases], controllers: usize) -> Vec<Strength> {
    let of = |index: usize| {
        let verdicts = scenarios.iter().filter_map(|scenario| scenario.cases.get(index)).map(|case| case.verdict);
        let counted: Vec<_> = verdicts.filter(crate::report::Verdict::counts).collect();
        let failures = counted.iter().filter(|verdict| verdict.is_collision()).count();
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

/// A search that found nothing is as many tests.
fn however(worst: &WorstProfiles) -> Vec<Strength> {
    let strength = |profile: &super::WorstProfile| match &profile.mildest {
        Some(mildest) => Strength::Defeated { peak_brake_mps2: mildest.peak_brake_mps2 },
        None => Strength::of(0, profile.evaluations as u64),
    };
    worst.profiles.iter().map(strength).collect()
}

fn paragraph(controllers: &[String], claims: &[Claim], distribution: &Distribution) -> String {
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
    let mut text = format!("Without a collision in the scenarios and draws of this report: {}. ", named(&sound));
    text += &format!("With at least one: {}. ", named(&failing));
    if let Some(first) = distribution.controllers.first().filter(|_| distribution.draws > 0) {
        text += &format!(
            "The {} collides in {} of {} draws of the paper's distribution, in {} of them because it is hit from behind. ",
            first.controller, first.collisions, distribution.draws, first.was_hit
        );
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
    fn id(&self) -> &'static str {
        "verdict"
    }

    fn title(&self) -> String {
        "Verdict".to_owned()
    }

    fn html(&self) -> Markup {
        html! { p.lead { (self.paragraph) } (self.table().html()) }
    }

    fn markdown(&self) -> String {
        format!("{}\n\n{}", self.paragraph, self.table().markdown())
    }
}
