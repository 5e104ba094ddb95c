//! Gates as a configuration states them, each with the requirements that it verifies.

use std::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Error, IntoDeserializer, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::AssessmentGate;
use crumple_core::requirement::check_requirements;

/// A gate of a configuration, and the requirements that it verifies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GateConfig {
    /// Condition.
    #[serde(flatten)]
    pub gate: AssessmentGate,
    /// Names of the requirements, for example those of a requirements tool. The field of the file is `requirement`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub requirement: Vec<String>,
}

impl From<AssessmentGate> for GateConfig {
    fn from(gate: AssessmentGate) -> Self {
        Self {
            gate,
            requirement: Vec::new(),
        }
    }
}

impl<'de> Deserialize<'de> for GateConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(GateVisitor)
    }
}

/// Reads the fields of a gate one by one, so that an error has the line of its field.
struct GateVisitor;

impl<'de> Visitor<'de> for GateVisitor {
    type Value = GateConfig;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a gate: a table of `require` and its fields")
    }

    fn visit_map<A: MapAccess<'de>>(self, fields: A) -> Result<GateConfig, A::Error> {
        let mut requirement = Vec::new();
        let fields = WithoutRequirement {
            fields,
            requirement: &mut requirement,
        };
        let gate = AssessmentGate::deserialize(MapAccessDeserializer::new(fields))?;
        Ok(GateConfig { gate, requirement })
    }
}

/// The fields of a gate other than `requirement`, which it keeps.
struct WithoutRequirement<'a, A> {
    fields: A,
    requirement: &'a mut Vec<String>,
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for WithoutRequirement<'_, A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, A::Error> {
        while let Some(key) = self.fields.next_key::<String>()? {
            if key != "requirement" {
                return seed.deserialize(key.into_deserializer()).map(Some);
            }
            let RequirementNames(names) = self.fields.next_value()?;
            *self.requirement = names;
        }
        Ok(None)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, A::Error> {
        self.fields.next_value_seed(seed)
    }
}

/// Checked names of requirements.
struct RequirementNames(Vec<String>);

impl<'de> Deserialize<'de> for RequirementNames {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let names = Vec::<String>::deserialize(deserializer)?;
        check_requirements(&names).map_err(D::Error::custom)?;
        Ok(Self(names))
    }
}

/// Adds the field `requirement` to the schema of each gate.
#[cfg(feature = "schema")]
pub(super) fn add_requirement_to_schema(schema: &mut schemars::Schema) {
    let field = serde_json::json!({
        "description": "Names of the requirements that the gate verifies. Default none.",
        "type": "array",
        "items": { "type": "string" },
    });
    super::tagged_schema::add_field(schema, "requirement", &field);
}
