//! How large the vehicles of episodes were.

use super::episodes::EpisodeFeature;
use super::space::median;
use crumple_world::recording::CAR_LENGTH_M;
use crumple_world::scenario::VehicleClass;

/// The vehicles in one place of a line, over all episodes.
///
/// A scenario's vehicle is a light or a heavy one, of the median length of these. Lengths beside their class decide nothing: gaps are between
/// bumpers.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleSizes {
    /// How many are shorter than 7.5 m, ...
    pub light: usize,
    /// ... and their median length, in metres.
    pub light_m: f64,
    /// How many are as long or longer, ...
    pub heavy: usize,
    /// ... and their median length, in metres.
    pub heavy_m: f64,
    /// Of how many no length was recorded: they are taken for light ones.
    pub unknown: usize,
}

impl VehicleSizes {
    pub(super) fn new(lengths_m: &[Option<f64>]) -> Self {
        let of_class = |class: VehicleClass| -> Vec<f64> {
            let known = lengths_m.iter().flatten().copied();
            known.filter(|length_m| VehicleClass::from_length(*length_m) == class).collect()
        };
        let (light, heavy) = (of_class(VehicleClass::Light), of_class(VehicleClass::Heavy));
        let usual_m = |known: &[f64]| if known.is_empty() { CAR_LENGTH_M } else { median(known) };
        Self {
            light: light.len(),
            light_m: usual_m(&light),
            heavy: heavy.len(),
            heavy_m: usual_m(&heavy),
            unknown: lengths_m.iter().filter(|length_m| length_m.is_none()).count(),
        }
    }

    /// The length of most of them, in metres.
    pub(super) fn typical_m(&self) -> f64 {
        if self.heavy > self.light + self.unknown { self.heavy_m } else { self.light_m }
    }

    /// The number that a scenario has of it, where there are both light and heavy ones, of vehicle `index` from the front.
    pub(super) fn feature(&self, index: usize) -> Option<EpisodeFeature> {
        let is_mixed = self.heavy > 0 && self.light + self.unknown > 0;
        let name = if index == 0 { "lead_size_m".to_owned() } else { format!("size_{index}_m") };
        is_mixed.then(|| EpisodeFeature {
            choices: Some([self.light_m, self.heavy_m]),
            ..EpisodeFeature::new(&name, &format!("vehicles[{index}].size_m"), "m", [self.light_m, self.heavy_m])
        })
    }

    /// What a scenario has of each.
    pub(super) fn scenario_lengths_m(&self, lengths_m: &[Option<f64>]) -> Vec<f64> {
        let is_heavy = |length_m: f64| VehicleClass::from_length(length_m) == VehicleClass::Heavy;
        let size_m = |length_m: &Option<f64>| if length_m.is_some_and(is_heavy) { self.heavy_m } else { self.light_m };
        lengths_m.iter().map(size_m).collect()
    }

    /// Who they are, in a sentence, of vehicle `index` from the front.
    #[must_use]
    pub fn sentence(&self, index: usize) -> String {
        let who = if index == 0 { "Leaders".to_owned() } else { format!("Followers {index}") };
        let Self { light, light_m, heavy, heavy_m, unknown } = self;
        let kinds = [
            (*light > 0).then(|| format!("{light} light ones (median {light_m:.1} m)")),
            (*heavy > 0).then(|| format!("{heavy} heavy ones (median {heavy_m:.1} m)")),
            (*unknown > 0)
                .then(|| format!("{unknown} of unrecorded length, assumed to be light ones of {light_m:.1} m")),
        ];
        format!("{who}: {}", kinds.into_iter().flatten().collect::<Vec<_>>().join(", "))
    }
}
