//! Report of a fit, as text and as JSON.

use std::fmt::{self, Write};

use serde::Serialize;

use super::base::NO_VEHICLE_BEHIND;
use super::fitted_space::describe_rejected;
use super::{
    EpisodeSample, ExclusionCounts, FamilyFit, FittedFeature, FittedSize, FittedSpace, MIN_P_VALUE,
    PointFit, format_p_value,
};
use crumple_core::digits::{format_interval, format_rounded};
use crumple_core::quoting::TerminalText;
use crumple_spaces::DrivingExposure;

/// Report of a fit.
#[derive(Debug, Clone, Copy)]
pub struct FitReport<'a> {
    sample: &'a EpisodeSample,
    fitted: &'a FittedSpace,
}

/// Fields of the report as JSON.
#[derive(Serialize)]
struct FitFields<'a> {
    space: &'a str,
    exposure: &'a DrivingExposure,
    clusters: u32,
    exclusions: &'a ExclusionCounts,
    features: &'a [FittedFeature],
    /// Parameters whose family does not fit.
    rejected: Vec<&'a str>,
    sizes: &'a [FittedSize],
    copula_parameters: &'a [String],
    correlation: &'a [Vec<f64>],
}

impl<'a> FitReport<'a> {
    /// Describes the space that was fitted to a sample.
    #[must_use]
    pub fn new(sample: &'a EpisodeSample, fitted: &'a FittedSpace) -> Self {
        Self { sample, fitted }
    }

    /// Returns the report for a program, with fields in alphabetical order.
    ///
    /// # Errors
    /// None in practice; only the serializer can fail.
    pub fn to_json(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(FitFields {
            space: self.fitted.space.name(),
            exposure: &self.sample.exposure,
            clusters: self.cluster_count(),
            exclusions: &self.sample.exclusions,
            features: &self.fitted.features,
            rejected: self.rejected(),
            sizes: &self.fitted.sizes,
            copula_parameters: &self.fitted.copula_parameters,
            correlation: &self.fitted.correlation,
        })
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text);
        text
    }

    /// Returns the names of the parameters whose family does not fit.
    fn rejected(&self) -> Vec<&'a str> {
        let features = self.fitted.features.iter();
        features
            .filter(|feature| feature.goodness.is_rejected())
            .map(|feature| feature.name.as_str())
            .collect()
    }

    fn cluster_count(&self) -> u32 {
        let clusters = &self.sample.observed.braking_clusters;
        clusters.iter().max().map_or(0, |last| last + 1)
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        self.write_episodes(out)?;
        self.write_exclusions(out)?;
        for feature in &self.fitted.features {
            feature.write(out)?;
        }
        for size in &self.fitted.sizes {
            writeln!(out, "\n{}", size.describe())?;
        }
        self.write_dependence(out)?;
        self.write_explanation(out)
    }

    fn write_episodes(&self, out: &mut String) -> fmt::Result {
        let exposure = &self.sample.exposure;
        writeln!(
            out,
            "{} braking episodes in {} clusters, of {} vehicles",
            exposure.episodes,
            self.cluster_count(),
            self.sample.extraction.vehicles
        )?;
        if self.sample.extraction.vehicles == 2 {
            writeln!(out, "  {NO_VEHICLE_BEHIND}")?;
        }
        for source in &exposure.sources {
            writeln!(
                out,
                "  {}: {} episodes in {:.4} h, {:.2} km of following",
                TerminalText(&source.name),
                source.episodes,
                source.hours,
                source.kilometres
            )?;
        }
        if exposure.undescribed_brakings > 0 {
            writeln!(
                out,
                "  of {} brakings in these hours {} could be used",
                exposure.episodes + exposure.undescribed_brakings,
                exposure.episodes
            )?;
        }
        Ok(())
    }

    fn write_exclusions(&self, out: &mut String) -> fmt::Result {
        let vehicles = self.sample.extraction.vehicles;
        for sentence in self.sample.exclusions.sentences(vehicles) {
            writeln!(out, "  {sentence}")?;
        }
        if let Some(feature) = &self.sample.most_out_of_range {
            writeln!(out, "  Most often outside the ranges: {feature}")?;
        }
        for (index, sizes) in self.sample.sizes.iter().enumerate() {
            let who = match index {
                0 => "Leaders".to_owned(),
                _ if vehicles > 2 && index + 1 == vehicles => {
                    format!("Followers (vehicle {index})")
                }
                _ => format!("Vehicles under test (vehicle {index})"),
            };
            writeln!(out, "  {who}: {}", sizes.describe())?;
        }
        Ok(())
    }

    fn write_dependence(&self, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "\ndependence of the parameters: correlations of the Gaussian copula"
        )?;
        let names = self.fitted.copula_parameters.iter();
        for (name, row) in names.zip(&self.fitted.correlation) {
            let entries: Vec<_> = row.iter().map(|entry| format!("{entry:>6.2}")).collect();
            writeln!(out, "  {name:<18} {}", entries.join(" "))?;
        }
        Ok(())
    }

    fn write_explanation(&self, out: &mut String) -> fmt::Result {
        match describe_rejected(&self.fitted.features) {
            Some(rejected) => writeln!(
                out,
                "\n{rejected} Failure rates in this space depend on these distributions, although they do not fit."
            )?,
            None => writeln!(
                out,
                "\nno family is rejected (every p is at least {MIN_P_VALUE})"
            )?,
        }
        let first = self.fitted.features.first();
        let samples = first.map_or(0, |feature| feature.goodness.samples);
        writeln!(
            out,
            "\nA p-value is the share of {samples} samples of the fitted distribution that are at least as far from \
             their own fit as the recorded values are from theirs. p-values tend to be too large, because the same \
             values chose the family, and too small where a cluster has several episodes, which depend on each other. \
             A Gaussian copula has no tail dependence."
        )
    }
}

/// Returns the definition of a parameter that is a ratio, in brackets; empty for other parameters.
fn describe_share(name: &str) -> String {
    if name == "lead_final_share" {
        return " (lowest speed of the leader while braking, relative to that at the start)"
            .to_owned();
    }
    match name.strip_prefix("speed_share_") {
        Some(vehicle) => {
            format!(" (speed of vehicle {vehicle} at the start, relative to that of the leader)")
        }
        None => String::new(),
    }
}

impl FittedSize {
    fn describe(&self) -> String {
        let values: Vec<_> = self
            .values
            .iter()
            .map(|value| {
                let interval = format_interval(value.interval_95, 4);
                format!("{:.1} m in {:.4} ({interval})", value.at, value.probability)
            })
            .collect();
        format!("{}: {}", self.name, values.join(", "))
    }
}

impl FittedFeature {
    fn write(&self, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "\n{}{}: {}, {}",
            self.name,
            describe_share(&self.name),
            self.chosen.family.name(),
            self.chosen.format_estimates()
        )?;
        if let Some(point) = &self.point_mass {
            self.write_point_mass(point, out)?;
        }
        writeln!(
            out,
            "  Kolmogorov-Smirnov {:.3}, p {}; Cramér-von Mises {:.3}, p {}",
            self.goodness.kolmogorov_smirnov,
            format_p_value(self.goodness.kolmogorov_smirnov_p),
            self.goodness.cramer_von_mises,
            format_p_value(self.goodness.cramer_von_mises_p)
        )?;
        self.write_tails(out)?;
        let fits: Vec<_> = std::iter::once(&self.chosen)
            .chain(&self.others)
            .map(|fit| format!("{} {:.1} / {:.1}", fit.family.name(), fit.aic, fit.bic))
            .collect();
        writeln!(out, "  AIC / BIC: {}", fits.join(", "))?;
        for (family, why) in &self.impossible {
            writeln!(out, "  not {}: {why}", family.name())?;
        }
        Ok(())
    }

    /// Returns the unit with a space before it; empty for a number without a unit.
    fn printed_unit(&self) -> String {
        if self.unit == "1" {
            String::new()
        } else {
            format!(" {}", self.unit)
        }
    }

    fn write_point_mass(&self, point: &PointFit, out: &mut String) -> fmt::Result {
        let interval = format_interval(point.interval_95, 4);
        writeln!(
            out,
            "  exactly {}{} in {} of {} episodes: probability {:.4} ({interval}); the distribution is fitted to the \
             others",
            point.at,
            self.printed_unit(),
            point.count,
            self.sorted.len(),
            point.probability
        )
    }

    fn write_tails(&self, out: &mut String) -> fmt::Result {
        let tails = &self.tails;
        let unit = self.printed_unit();
        let point_count = self.point_mass.map_or(0, |point| point.count);
        writeln!(
            out,
            "  tails: probability {} below the smallest of {} values, {:.3}{unit} ({} of them below the 10 % quantile \
             of the fit); {} above the largest, {:.3}{unit} ({} above the 90 % quantile)",
            format_rounded(tails.below_smallest, 3),
            self.sorted.len() as u64 - point_count,
            tails.smallest,
            tails.in_lower_tenth,
            format_rounded(tails.beyond_largest, 3),
            tails.largest,
            tails.in_upper_tenth
        )
    }
}

impl FamilyFit {
    fn format_estimates(&self) -> String {
        [0, 1].map(|index| self.format_estimate(index)).join(", ")
    }

    fn format_estimate(&self, index: usize) -> String {
        let estimate = format!(
            "{} {:.4}",
            self.parameter_names[index], self.estimates[index]
        );
        match self.intervals_95.map(|intervals| intervals[index]) {
            Some(interval) => format!("{estimate} ({})", format_interval(interval, 4)),
            None => format!("{estimate} (no interval: the likelihood is flat, or at its limit)"),
        }
    }
}
