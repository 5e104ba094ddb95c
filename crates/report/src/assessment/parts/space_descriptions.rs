//! Descriptions of the scenario spaces of an assessment.

use serde::Serialize;

use crate::assessment::AssessmentPlan;
use crate::assessment::document::ReportDocument;
use crate::assessment::report_block::ReportBlock;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};
use crumple_core::markdown::prose_name;
use crumple_spaces::{ScenarioSpace, built_in_space_summary};

/// The parameters of each scenario space, with ranges and probability distributions.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceDescriptions {
    /// One entry per scenario space.
    pub spaces: Vec<SpaceDescription>,
}

/// A scenario space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceDescription {
    /// Name of the space.
    pub name: String,
    /// Content of the space.
    pub about: String,
    /// Parameters of the space.
    pub parameters: Vec<ParameterDescription>,
    /// True if some parameters depend on others.
    pub has_dependence: bool,
}

/// A parameter of a scenario space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ParameterDescription {
    /// Field of the scenario.
    pub field: String,
    /// Unit of the parameter.
    pub unit: String,
    /// Range and probability distribution, in words.
    pub distribution: String,
}

impl SpaceDescriptions {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan) -> Self {
        Self {
            spaces: plan
                .all_spaces()
                .iter()
                .map(SpaceDescription::new)
                .collect(),
        }
    }
}

impl SpaceDescription {
    fn new(space: &ScenarioSpace) -> Self {
        let spec = space.spec();
        let parameters = spec
            .parameters
            .iter()
            .map(|parameter| ParameterDescription {
                field: parameter.field.clone(),
                unit: parameter.unit.clone(),
                distribution: parameter.distribution.to_string(),
            });
        Self {
            name: prose_name(&spec.name),
            about: built_in_space_summary(space).map_or_else(|| spec.about.clone(), sentence),
            parameters: parameters.collect(),
            has_dependence: spec.dependence.is_some(),
        }
    }

    fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.parameters,
            &[
                ("parameter", &|parameter| ReportCell::text(&parameter.field)),
                ("unit", &|parameter| ReportCell::text(&parameter.unit)),
                ("range and distribution", &|parameter| {
                    ReportCell::text(&parameter.distribution)
                }),
            ],
        )
    }

    fn describe(&self) -> String {
        let depends = if self.has_dependence {
            " Some parameters depend on each other, as the file of the space states."
        } else {
            ""
        };
        format!("{}{depends}", self.about)
    }
}

/// Returns a one-line description as a sentence.
fn sentence(summary: &str) -> String {
    let mut letters = summary.chars();
    let first = letters.next().map(char::to_uppercase).into_iter().flatten();
    first.chain(letters).chain(['.']).collect()
}

const INTRODUCTION: &str = "Random scenarios follow the distribution; a search covers the whole range. Fields are \
    those of scenario files: vehicle 0 is the leader, and parameters that are not listed are fixed. Each certificate \
    of a rate contains its whole space.";

impl ReportPart for SpaceDescriptions {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Appendix,
            anchor: "domain",
            title: "Scenario spaces",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(INTRODUCTION);
        for space in &self.spaces {
            let title = format!("Space {}", space.name);
            out.push(ReportBlock::Entry(title, space.describe().into()));
            out.table(space.table());
        }
    }
}
