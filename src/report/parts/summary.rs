//! The verdict: claims about each controller, and how strongly each is supported.

use maud::{Markup, html};
use serde::Serialize;

use super::{Distribution, PaperScenarios, Traffic};
use crate::report::table::{Cell, Table};
use crate::report::{Part, Plan, Rounded};

/// Every claim about every controller.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The verdict in a paragraph.
    pub paragraph: String,
    /// Names of the controllers, in the order of each claim's strengths.
    pub controllers: Vec<&'static str>,
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
    /// It held whenever it was tried, so many times; that is all that is known.
    Tested {
        /// How often it was tried.
        runs: u64,
    },
    /// The share of failures is at most this.
    Bounded {
        /// Upper bound in percent.
        upper_percent: Rounded<2>,
        /// Confidence of the bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// The true share of failures may lie on either side of what is claimed.
    Undecided {
        /// Lower bound in percent.
        lower_percent: Rounded<2>,
        /// Upper bound in percent.
        upper_percent: Rounded<2>,
    },
    /// It failed.
    Refuted {
        /// How often.
        failures: u64,
        /// Out of how many.
        runs: u64,
    },
}

impl Strength {
    fn of(failures: u64, runs: u64) -> Self {
        if failures == 0 { Self::Tested { runs } } else { Self::Refuted { failures, runs } }
    }

    fn holds(&self) -> bool {
        matches!(self, Self::Tested { .. } | Self::Bounded { .. })
    }

    fn words(&self) -> String {
        match self {
            Self::Tested { runs } => format!("tested: 0 of {runs} collide"),
            Self::Bounded { upper_percent, confidence_percent } => {
                format!("bounded: at most {upper_percent} %, confidence {confidence_percent} %")
            }
            Self::Undecided { lower_percent, upper_percent } => {
                format!("undecided: {lower_percent} to {upper_percent} %")
            }
            Self::Refuted { failures, runs } => format!("refuted: {failures} of {runs} collide"),
        }
    }
}

impl Summary {
    pub(in crate::report) fn of(
        plan: &Plan,
        paper: &PaperScenarios,
        distribution: &Distribution,
        traffic: Option<&Traffic>,
    ) -> Self {
        let mut claims = vec![
            Claim { claim: "no contact in the paper's scenarios", strengths: in_paper(plan, paper) },
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
            let runs = traffic.scenarios.len();
            let of = |safe: usize| Strength::of((runs - safe) as u64, runs as u64);
            claims.push(Claim {
                claim: "no contact in recorded traffic and other scenarios",
                strengths: traffic.safe_counts().into_iter().map(of).collect(),
            });
        }
        let controllers: Vec<_> = plan.controllers.iter().map(|controller| controller.name()).collect();
        let paragraph = paragraph(&controllers, &claims, distribution);
        Self { paragraph, controllers, claims }
    }

    fn table(&self) -> Table {
        let header: Vec<&str> = std::iter::once("claim").chain(self.controllers.iter().copied()).collect();
        let mut table = Table::new(&header);
        for claim in &self.claims {
            let cells = claim.strengths.iter().map(|strength| Cell::judged(strength.words(), strength.holds()));
            table.row(std::iter::once(Cell::text(claim.claim)).chain(cells).collect());
        }
        table
    }
}

fn in_paper(plan: &Plan, paper: &PaperScenarios) -> Vec<Strength> {
    let runs = paper.scenarios.len() as u64;
    let failures = |index: usize| {
        let collides = |s: &&super::ScenarioCases| s.cases.get(index).is_some_and(|case| !case.verdict.is_safe());
        paper.scenarios.iter().filter(collides).count() as u64
    };
    (0..plan.controllers.len()).map(|index| Strength::of(failures(index), runs)).collect()
}

/// The largest share of collisions that still counts as rare, in percent.
const RARE_PERCENT: f64 = 1.0;

fn rarely(distribution: &Distribution) -> Vec<Strength> {
    // Each end of a two-sided interval is a one-sided bound at half the risk.
    let confidence_percent = Rounded::new(50.0 + 50.0 * distribution.confidence);
    let strength = |sampled: &super::Sampled| {
        let super::Percent { lower, upper, .. } = sampled.rate_percent;
        if upper.value() <= RARE_PERCENT {
            Strength::Bounded { upper_percent: upper, confidence_percent }
        } else if lower.value() > RARE_PERCENT {
            Strength::Refuted { failures: sampled.collisions, runs: distribution.draws }
        } else {
            Strength::Undecided { lower_percent: lower, upper_percent: upper }
        }
    };
    distribution.controllers.iter().map(strength).collect()
}

fn paragraph(controllers: &[&str], claims: &[Claim], distribution: &Distribution) -> String {
    let all_hold = |index: usize| claims.iter().all(|c| c.strengths.get(index).is_some_and(Strength::holds));
    let (sound, failing): (Vec<_>, Vec<_>) = (0..controllers.len()).partition(|&index| all_hold(index));
    let named = |indices: &[usize]| {
        let names: Vec<_> = indices.iter().filter_map(|&index| controllers.get(index).copied()).collect();
        match names.split_last() {
            None => "none".to_owned(),
            Some((last, [])) => (*last).to_owned(),
            Some((last, others)) => format!("{} and {last}", others.join(", ")),
        }
    };
    let mut text = format!("Without a collision wherever they were tried: {}. ", named(&sound));
    text += &format!("With at least one: {}. ", named(&failing));
    if let Some(first) = distribution.controllers.first() {
        text += &format!(
            "The {} collides in {} of {} draws of the paper's distribution, in {} of them because it is hit from behind. ",
            first.controller, first.collisions, distribution.draws, first.was_hit
        );
    }
    text + "No learned controller is part of this assessment yet."
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
