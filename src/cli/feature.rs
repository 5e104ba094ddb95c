//! Optional features, which are selected when the program is compiled.

use std::path::Path;

use serde::Serialize;

use super::CliError;
use crumple_exchange::recording::{READS_MDF, READS_PARQUET};
use crumple_measure::LevelMeasures;
use crumple_report::draw::{PNG_SCALE, Svg, WRITES_PNG};
use crumple_report::export::{WRITES_PARQUET, to_parquet};
use crumple_sim::engine::Trace;

#[derive(Serialize)]
pub(super) struct Feature {
    pub(super) name: &'static str,
    pub(super) used_for: &'static str,
    pub(super) enabled: bool,
}

pub(super) const EXPLORE: Feature = Feature {
    name: "explore",
    used_for: "`crumple explore`",
    enabled: cfg!(feature = "explore"),
};
// The library's crates decide: another package of the same build may enable their features without those of this one.
pub(super) const PARQUET: Feature = Feature {
    name: "parquet",
    used_for: match (READS_PARQUET, WRITES_PARQUET) {
        (true, false) => "traces in Parquet",
        (false, true) => "recordings in Parquet",
        _ => "traces and recordings in Parquet",
    },
    enabled: READS_PARQUET && WRITES_PARQUET,
};
pub(super) const MDF: Feature = Feature {
    name: "mdf",
    used_for: "recordings in ASAM MDF 4",
    enabled: READS_MDF,
};
pub(super) const PNG: Feature = Feature {
    name: "png",
    used_for: "figures as PNG files",
    enabled: WRITES_PNG,
};

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
        "parquet" if !WRITES_PARQUET => PARQUET.require(),
        "png" => PNG.require(),
        _ => Ok(()),
    }
}

/// Encodes a figure in the format of the file's extension.
///
/// # Errors
/// [`CliError::Input`] if the figure cannot be rendered, or this build lacks the feature `png`.
pub(super) fn encode_figure(path: &Path, figure: &Svg) -> Result<Vec<u8>, CliError> {
    match path.extension() {
        Some(png) if png == "png" => render_png(figure),
        _ => Ok(figure.document().into_bytes()),
    }
}

fn render_png(figure: &Svg) -> Result<Vec<u8>, CliError> {
    PNG.require().map_err(CliError::Input)?;
    figure.to_png(PNG_SCALE).map_err(CliError::input)
}

/// Encodes a trace as Parquet.
///
/// # Errors
/// [`CliError::Input`] if the trace cannot be encoded, or this build lacks the feature `parquet`.
pub(super) fn encode_parquet(trace: &Trace, levels: &[LevelMeasures]) -> Result<Vec<u8>, CliError> {
    require_format("parquet").map_err(CliError::Input)?;
    to_parquet(trace, levels).map_err(CliError::input)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tests' build has all features, so that only this test sees a refusal; `.ci/run` tries the optimised program.
    #[test]
    fn a_missing_feature_is_named_with_the_command_that_enables_it() {
        let missing = Feature {
            name: "png",
            used_for: "figures as PNG files",
            enabled: false,
        };
        let refusal = missing.require().unwrap_err();
        assert!(
            refusal.contains("`png`") && refusal.contains("--features png"),
            "{refusal}"
        );
        assert!(
            Feature {
                enabled: true,
                ..missing
            }
            .require()
            .is_ok()
        );
    }

    #[test]
    fn the_program_has_the_features_of_its_library() {
        let enabled = FEATURES.map(|feature| (feature.name, feature.enabled));
        let expected = [READS_MDF, READS_PARQUET && WRITES_PARQUET, WRITES_PNG];
        assert_eq!(
            enabled[1..],
            [
                ("mdf", expected[0]),
                ("parquet", expected[1]),
                ("png", expected[2])
            ]
        );
    }
}
