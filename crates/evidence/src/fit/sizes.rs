//! Sizes of the vehicles of episodes.

use super::episodes::EpisodeFeature;
use super::space::median;
use crumple_exchange::recording::CAR_LENGTH_M;
use crumple_sim::scenario::VehicleClass;

/// Sizes of the vehicles at one position, over all episodes. A vehicle of a scenario is light or heavy, with the median
/// length of that class. The length has no other effect, because gaps are measured between bumpers.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleSizes {
    /// Number of vehicles shorter than 7.5 m.
    pub light: usize,
    /// Median length of light vehicles, in metres.
    pub light_m: f64,
    /// Number of longer vehicles.
    pub heavy: usize,
    /// Median length of heavy vehicles, in metres.
    pub heavy_m: f64,
    /// Number of vehicles without a recorded length, which count as light.
    pub unknown: usize,
}

impl VehicleSizes {
    pub(super) fn new(lengths_m: &[Option<f64>]) -> Self {
        let light_m = lengths_of_class(lengths_m, VehicleClass::Light);
        let heavy_m = lengths_of_class(lengths_m, VehicleClass::Heavy);
        Self {
            light: light_m.len(),
            light_m: median_or_car_length(&light_m),
            heavy: heavy_m.len(),
            heavy_m: median_or_car_length(&heavy_m),
            unknown: lengths_m
                .iter()
                .filter(|length_m| length_m.is_none())
                .count(),
        }
    }

    /// Returns the median length of the more frequent class, in metres.
    pub(super) fn typical_m(&self) -> f64 {
        if self.heavy > self.light + self.unknown {
            self.heavy_m
        } else {
            self.light_m
        }
    }

    /// Returns the size feature of vehicle `index` from the front, if both classes occur.
    pub(super) fn feature(&self, index: usize) -> Option<EpisodeFeature> {
        let is_mixed = self.heavy > 0 && self.light + self.unknown > 0;
        let name = if index == 0 {
            "lead_size_m".to_owned()
        } else {
            format!("size_{index}_m")
        };
        is_mixed.then(|| EpisodeFeature {
            choices: Some([self.light_m, self.heavy_m]),
            ..EpisodeFeature::new(
                &name,
                &format!("vehicles[{index}].size_m"),
                "m",
                [self.light_m, self.heavy_m],
            )
        })
    }

    pub(super) fn scenario_lengths_m(&self, lengths_m: &[Option<f64>]) -> Vec<f64> {
        let classes = lengths_m
            .iter()
            .map(|length_m| length_m.map(VehicleClass::from_length));
        classes
            .map(|class| match class {
                Some(VehicleClass::Heavy) => self.heavy_m,
                _ => self.light_m,
            })
            .collect()
    }

    /// Describes the sizes of vehicle `index` from the front in a sentence, for the field `about` of the fitted space.
    #[must_use]
    pub fn sentence(&self, index: usize) -> String {
        let who = if index == 0 {
            "Leaders".to_owned()
        } else {
            format!("Followers {index}")
        };
        format!("{who}: {}", self.describe())
    }

    /// Describes the sizes, without the vehicle that has them.
    pub(super) fn describe(&self) -> String {
        let Self {
            light,
            light_m,
            heavy,
            heavy_m,
            unknown,
        } = self;
        let kinds = [
            (*light > 0).then(|| format!("{light} light ones (median {light_m:.1} m)")),
            (*heavy > 0).then(|| format!("{heavy} heavy ones (median {heavy_m:.1} m)")),
            (*unknown > 0).then(|| {
                format!(
                    "{unknown} without a recorded length, assumed to be light and {light_m:.1} m long"
                )
            }),
        ];
        kinds.into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

fn lengths_of_class(lengths_m: &[Option<f64>], class: VehicleClass) -> Vec<f64> {
    lengths_m
        .iter()
        .flatten()
        .copied()
        .filter(|length_m| VehicleClass::from_length(*length_m) == class)
        .collect()
}

fn median_or_car_length(lengths_m: &[f64]) -> f64 {
    if lengths_m.is_empty() {
        CAR_LENGTH_M
    } else {
        median(lengths_m)
    }
}
