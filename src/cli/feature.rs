//! Optional features, which are selected when the program is compiled.

use serde::Serialize;

use super::CliError;
use crumple_exchange::recording::{READS_MDF, READS_PARQUET};
use crumple_report::draw::Svg;
use crumple_world::sim::Trace;

#[derive(Serialize)]
pub(super) struct Feature {
    pub(super) name: &'static str,
    pub(super) used_for: &'static str,
    pub(super) enabled: bool,
}

pub(super) const EXPLORE: Feature =
    Feature { name: "explore", used_for: "`crumple explore`", enabled: cfg!(feature = "explore") };
pub(super) const PARQUET: Feature = Feature {
    name: "parquet",
    // Another package of the workspace may enable the recordings only.
    used_for: if READS_PARQUET && !cfg!(feature = "parquet") {
        "traces in Parquet"
    } else {
        "traces and recordings in Parquet"
    },
    enabled: cfg!(feature = "parquet"),
};
pub(super) const MDF: Feature = Feature { name: "mdf", used_for: "recordings in ASAM MDF 4", enabled: READS_MDF };
pub(super) const PNG: Feature =
    Feature { name: "png", used_for: "figures as PNG files", enabled: cfg!(feature = "png") };

pub(super) const FEATURES: [Feature; 4] = [EXPLORE, MDF, PARQUET, PNG];

impl Feature {
    /// Returns the command that installs crumple with the feature, from a clone.
    pub(super) fn install_command(&self) -> String {
        format!("cargo install --locked --path . --features {}", self.name)
    }

    /// Checks that this build has the feature.
    ///
    /// # Errors
    /// A text that explains how to enable the feature.
    pub(super) fn require(&self) -> Result<(), String> {
        if self.enabled {
            return Ok(());
        }
        let Self { name, used_for, .. } = self;
        Err(format!(
            "this build of crumple lacks the feature `{name}` ({used_for}): install it with `{}` in a clone",
            self.install_command()
        ))
    }
}

/// Checks that this build writes files with this extension.
///
/// # Errors
/// Returns the text of [`Feature::require`] for a feature that this build lacks.
pub(super) fn require_format(extension: &str) -> Result<(), String> {
    match extension {
        "parquet" => PARQUET.require(),
        "png" => PNG.require(),
        _ => Ok(()),
    }
}

/// Renders a figure as PNG.
///
/// # Errors
/// [`CliError::Input`] if the figure cannot be rendered, or this build lacks the feature `png`.
#[cfg(feature = "png")]
pub(super) fn render_png(figure: &Svg) -> Result<Vec<u8>, CliError> {
    figure.to_png(crumple_report::draw::PNG_SCALE).map_err(CliError::input)
}

#[cfg(not(feature = "png"))]
pub(super) fn render_png(_: &Svg) -> Result<Vec<u8>, CliError> {
    PNG.require().map_err(CliError::Input).map(|()| Vec::new())
}

/// Encodes a trace as Parquet.
///
/// # Errors
/// [`CliError::Input`] if the trace cannot be encoded, or this build lacks the feature `parquet`.
#[cfg(feature = "parquet")]
pub(super) fn encode_parquet(trace: &Trace) -> Result<Vec<u8>, CliError> {
    crumple_report::export::to_parquet(trace).map_err(CliError::input)
}

#[cfg(not(feature = "parquet"))]
pub(super) fn encode_parquet(_: &Trace) -> Result<Vec<u8>, CliError> {
    PARQUET.require().map_err(CliError::Input).map(|()| Vec::new())
}
