//! The spaces that scenarios are drawn from and searched in, in numbers.

use maud::html;
use serde::Serialize;

use super::Usefulness;
use crate::assessment::document::Document;
use crate::assessment::markdown::Inline;
use crate::assessment::prose::prose;
use crate::assessment::table::{Cell, Table};
use crate::assessment::{AssessmentPlan, Part};
use crumple_world::scenario::space::{Space, built_in_space};

/// What varies in each space, within which range and by which law.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceDescriptions {
    /// One entry a space.
    pub spaces: Vec<SpaceDescription>,
}

/// A space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceDescription {
    /// Its name.
    pub name: String,
    /// What it covers.
    pub about: String,
    /// What varies.
    pub parameters: Vec<ParameterDescription>,
    /// Whether some parameters depend on others.
    pub has_dependence: bool,
}

/// Something that varies.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ParameterDescription {
    /// The field of the scenario.
    pub field: String,
    /// Its unit.
    pub unit: String,
    /// The range and the law within it, in words.
    #[serde(rename = "law")]
    pub distribution: String,
}

impl SpaceDescriptions {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan, usefulness: Option<&Usefulness>) -> Self {
        let mut spaces: Vec<SpaceDescription> = Vec::new();
        let everyday = usefulness.iter().flat_map(|usefulness| usefulness.abouts());
        let everyday = everyday.filter_map(|(name, _)| built_in_space(&name));
        let own = plan.distributions.iter().chain(&plan.spaces).map(|named| named.space.clone());
        for space in own.chain(everyday) {
            if !spaces.iter().any(|known| known.name == space.name()) {
                spaces.push(SpaceDescription::of(&space));
            }
        }
        Self { spaces }
    }
}

impl SpaceDescription {
    fn new(space: &Space) -> Self {
        let spec = space.spec();
        let parameters = spec.parameters.iter().map(|one| ParameterDescription {
            field: one.field.clone(),
            unit: one.unit.clone(),
            law: one.distribution.to_string(),
        });
        Self {
            name: spec.name.clone(),
            about: spec.about.clone(),
            parameters: parameters.collect(),
            has_dependence: spec.dependence.is_some(),
        }
    }

    fn table(&self) -> Table {
        Table::of(
            &self.parameters,
            &[
                ("what varies", &|one| Cell::text(&one.field)),
                ("unit", &|one| Cell::text(&one.unit)),
                ("range and law", &|one| Cell::text(&one.law)),
            ],
        )
    }

    fn describe(&self) -> String {
        let depends = if self.has_dependence {
            " Some of them depend on each other: the file of the space says how."
        } else {
            ""
        };
        format!("{}{depends}", self.about)
    }
}

const INTRODUCTION: &str = "Draws follow the law; a search moves over the whole range. Fields are those of scenario files: vehicle 0 is the \
    leader, vehicles under test follow, and what is not listed is fixed. `crumple list spaces` names the built-in spaces, and each \
    certificate of a rate holds the whole space that it was counted in.";

impl Part for SpaceDescriptions {
    fn heading(&self) -> (&'static str, String) {
        ("domain", "The domain in numbers".to_owned())
    }

    fn write(&self, out: &mut Document) {
        out.paragraph(INTRODUCTION);
        for space in &self.spaces {
            out.html(html! { h3 { "Space " (space.name) } p { (prose(&space.words())) } });
            let words = Inline::strong(&format!("Space {}.", space.name)).and(&format!(" {}", space.words()));
            out.markdown().paragraph(words);
            out.table(&space.table());
        }
    }
}
