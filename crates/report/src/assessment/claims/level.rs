//! The words for the strength of evidence, in reports and in `assessment.json`.

use serde::{Deserialize, Serialize};

/// The word for the strength of evidence for a claim, the same in all forms of a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum StrengthLevel {
    /// The checker accepted certificates that show the claim, under their assumptions.
    Proved,
    /// Registered counts bound a rate, or decide between two controllers, at a confidence level.
    Bounded,
    /// The claim held in all stated runs; others may fail.
    Tested,
    /// A run, a bound or counted runs of two controllers contradict the claim.
    Refuted,
    /// Evidence was gathered, and does not decide the claim.
    NotShown,
    /// No evidence was gathered.
    NotExamined,
}

impl StrengthLevel {
    /// Returns the word.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Proved => "proved",
            Self::Bounded => "bounded",
            Self::Tested => "tested",
            Self::Refuted => "refuted",
            Self::NotShown => "not shown",
            Self::NotExamined => "not examined",
        }
    }

    /// Returns the word, with facts after a colon if there are some.
    pub(super) fn introduce(self, facts: &str) -> String {
        match facts {
            "" => self.word().to_owned(),
            facts => format!("{}: {facts}", self.word()),
        }
    }
}

/// Adds the field `strength` to each kind of strength in a schema.
#[cfg(feature = "schema")]
pub(super) fn add_to_schema(schema: &mut schemars::Schema) {
    let field = serde_json::json!({
        "description": "Word for the strength, the same in all forms of a report.",
        "enum": ["proved", "bounded", "tested", "refuted", "not_shown", "not_examined"],
    });
    crate::assessment::tagged_schema::add_required_field(schema, "strength", &field);
}
