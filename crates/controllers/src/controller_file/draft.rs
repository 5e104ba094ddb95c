//! Drafts of controller files for imported networks.

use crumple_networks::network::{NetworkFile, Normalisation, VecNormalizeUse};
use crumple_networks::{Mapping, OutputMapping};
use crumple_sim::control::ObservedQuantity;

/// Default quantities of the inputs, in this order.
const DEFAULT_QUANTITIES: [ObservedQuantity; 6] = [
    ObservedQuantity::GapAheadM,
    ObservedQuantity::SpeedMps,
    ObservedQuantity::RelativeSpeedAheadMps,
    ObservedQuantity::AccelerationMps2,
    ObservedQuantity::SpeedAheadMps,
    ObservedQuantity::AccelerationAheadMps2,
];

/// A draft of a controller file for a network: the file can be loaded, and comments mark what is guessed.
///
/// No network file states which quantity each input is, in which order and unit.
#[derive(Debug, Clone, Copy)]
pub struct ControllerFileDraft<'a> {
    /// Path of the network from the folder of the controller file.
    pub path: &'a str,
    /// The network.
    pub network: &'a NetworkFile,
    /// Normalisation of the observations in training, if a file with it was found.
    pub normalisation: Option<&'a Normalisation>,
    /// True if the network has the inputs and outputs of crumple's own policies.
    pub drives_as_it_is: bool,
}

/// Scaling of an input, and the bounds of the scaled value.
struct DraftedScaling {
    offset: f64,
    scale: f64,
    bounds: [Option<f64>; 2],
}

impl ControllerFileDraft<'_> {
    /// Returns the text of the file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let own = Mapping::native();
        let mut text = self.head();
        for index in 0..self.network.network.inputs() {
            text += &self.input_section(index, &own);
        }
        text += "\n[output]\n";
        if self.network.network.outputs() > 1 {
            text += "answer = 0 # index of the output that is the acceleration, a guess\n";
        }
        text + &self.output_section(&own.output)
    }

    /// Returns the normalisation if it fits the inputs.
    fn fitting_normalisation(&self) -> Option<&Normalisation> {
        self.normalisation
            .filter(|statistics| statistics.means.len() == self.network.network.inputs())
    }

    fn head(&self) -> String {
        // A JSON string is also a valid TOML string.
        let path = serde_json::Value::from(self.path);
        let head = format!(
            "version = 1\nnetwork = {path}\ndecision_interval_s = 0.1 # a guess: use that of the training\n"
        );
        if self.fitting_normalisation().is_some() {
            return head + "normalised = true # the inputs contain the statistics\n";
        }
        let saved = self.network.saved_model();
        if saved.is_some_and(|saved| saved.vec_normalize == VecNormalizeUse::Behind) {
            // No default: crumple refuses the file until the user decides.
            return head
                + "# Write normalised = true when the inputs contain means and deviations, or false if VecNormalize \
                   changed no observation.\n";
        }
        head
    }

    fn input_section(&self, index: usize, own: &Mapping) -> String {
        let own = own.inputs.get(index).filter(|_| self.drives_as_it_is);
        let quantity = own
            .and_then(|own| own.quantity)
            .unwrap_or(DEFAULT_QUANTITIES[index % DEFAULT_QUANTITIES.len()]);
        let DraftedScaling {
            offset,
            scale,
            bounds: [low, high],
        } = match self.fitting_normalisation() {
            Some(statistics) => DraftedScaling {
                offset: statistics.means[index],
                scale: statistics.deviations[index],
                bounds: [Some(-statistics.limit), Some(statistics.limit)],
            },
            None => DraftedScaling {
                offset: own.map_or(0.0, |own| own.offset),
                scale: own.map_or(1.0, |own| own.scale),
                bounds: self.observation_bounds(index),
            },
        };
        let name = quantity.name();
        let mut text = format!("\n[[inputs]]\nquantity = \"{name}\" # a guess\n");
        text += &format!("offset = {offset:?}\nscale = {scale:?}\n");
        if let Some(low) = low {
            text += &format!("low = {low:?}\n");
        }
        if let Some(high) = high {
            text += &format!("high = {high:?}\n");
        }
        text
    }

    /// Returns the finite bounds of an input, if a saved model states any.
    fn observation_bounds(&self, index: usize) -> [Option<f64>; 2] {
        self.network
            .saved_model()
            .map(|saved| &saved.observation_space)
            .map(|space| finite_bounds(&space.low, &space.high, index))
            .unwrap_or_default()
    }

    /// Returns the finite bounds of the first output, if any are stated.
    fn answer_bounds(&self) -> Option<[Option<f64>; 2]> {
        // The action space is wider than the network's range if the network clips the mean before tanh.
        let actions = self.network.saved_model().map(|saved| &saved.action_space);
        if let Some(actions) = actions.filter(|actions| !actions.low.is_empty()) {
            return Some(finite_bounds(&actions.low, &actions.high, 0));
        }
        let bounds = self.network.network.answer_bounds().first().copied()?;
        Some(bounds.map(|bound| Some(bound).filter(|bound| bound.is_finite())))
    }

    /// Returns the rest of `[output]`. A network that limits its outputs itself, as by a final tanh, needs a scale to
    /// m/s².
    fn output_section(&self, own: &OutputMapping) -> String {
        let [least_mps2, most_mps2] = [own.low_mps2, own.high_mps2];
        let limits = format!("low_mps2 = {least_mps2:?}\nhigh_mps2 = {most_mps2:?}\n");
        match self.answer_bounds() {
            // These bounds look like accelerations.
            Some([Some(low), Some(high)]) if low < -1.5 && high <= 10.0 && low < high => {
                format!(
                    "# The limits of the network's outputs are assumed to be in m/s², a guess. Otherwise add \
                     scale_mps2 and offset_mps2.\nlow_mps2 = {low:?}\nhigh_mps2 = {high:?}\n"
                )
            }
            Some([Some(low), Some(high)]) if low < high => {
                let scale_mps2 = (most_mps2 - least_mps2) / (high - low);
                let offset_mps2 = least_mps2 - scale_mps2 * low;
                format!(
                    "# The network itself limits its outputs to {low:?} to {high:?}: scale_mps2 and offset_mps2 \
                     turn\n# them into m/s². Do not add `squash`: it is for a tanh outside the network.\nscale_mps2 = \
                     {scale_mps2:?} # a guess: the limits of a light vehicle\noffset_mps2 = {offset_mps2:?}\n{limits}"
                )
            }
            _ if self.drives_as_it_is => {
                let OutputMapping {
                    scale_mps2,
                    offset_mps2,
                    ..
                } = own;
                format!("scale_mps2 = {scale_mps2:?}\noffset_mps2 = {offset_mps2:?}\n{limits}")
            }
            _ => format!(
                "# The network does not limit its outputs, so they are assumed to be in m/s². If training applied tanh \
                 to them, write\n# squash = \"tanh\" and the scale_mps2 and offset_mps2 that turn -1 to 1 into \
                 m/s².\n{limits}"
            ),
        }
    }
}

/// Returns entry `index` of two lists of bounds; `None` for an infinite or absent bound.
fn finite_bounds(low: &[f32], high: &[f32], index: usize) -> [Option<f64>; 2] {
    [low, high].map(|bounds| {
        let bound = bounds.get(index).copied().map(f64::from);
        bound.filter(|bound| bound.is_finite())
    })
}
