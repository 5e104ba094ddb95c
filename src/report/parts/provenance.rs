//! Where the evidence comes from.

use maud::{Markup, html};
use serde::Serialize;

use crate::report::{AssessConfig, Part, Plan, sha256};
use crate::scenario::file;

/// What it takes to get the same evidence again.
#[derive(Debug, Clone, Serialize)]
pub struct Provenance {
    /// Version of crumple.
    pub crumple: &'static str,
    /// The configuration, defaults filled in.
    pub config: AssessConfig,
    /// SHA-256 of the configuration and of every scenario it names.
    pub config_sha256: String,
}

impl Provenance {
    pub(in crate::report) fn of(plan: &Plan) -> Self {
        let config = toml::to_string(&plan.config).unwrap_or_default();
        let scenarios = plan.traffic.iter().map(|(_, scenario)| file::to_toml(scenario).unwrap_or_default());
        let all = std::iter::once(config).chain(scenarios).collect::<Vec<_>>().join("\n");
        Self { crumple: env!("CARGO_PKG_VERSION"), config: plan.config.clone(), config_sha256: sha256(&all) }
    }

    fn lines(&self) -> Vec<(&'static str, String)> {
        vec![
            ("crumple", self.crumple.to_owned()),
            ("estimator of the vehicles under test", self.config.estimator.name().to_owned()),
            ("seed", self.config.seed.to_string()),
            ("configuration, SHA-256", self.config_sha256.clone()),
        ]
    }
}

impl Part for Provenance {
    fn id(&self) -> &'static str {
        "provenance"
    }

    fn title(&self) -> String {
        "Provenance".to_owned()
    }

    fn html(&self) -> Markup {
        html! { dl { @for (name, value) in self.lines() { dt { (name) } dd { (value) } } } }
    }

    fn markdown(&self) -> String {
        self.lines().into_iter().map(|(name, value)| format!("- {name}: `{value}`\n")).collect()
    }
}
