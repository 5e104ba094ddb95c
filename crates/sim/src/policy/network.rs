//! A fully connected network: hidden layers with ReLU, a linear output.

use super::elementwise::Elementwise;
use super::product::{Lhs, PackedPanels, Rhs, multiply_vector};

/// Shape and parameters of a network.
///
/// Layer l maps h to max(0, h W + b), the last one to h W + b. One array holds the parameters, layer after layer: first
/// W, one row per input, then b.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    sizes: Vec<usize>,
    parameters: Vec<f32>,
}

/// Location of one layer's parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LayerLayout {
    pub inputs: usize,
    pub outputs: usize,
    /// Index of the first parameter of the layer.
    pub offset: usize,
}

impl LayerLayout {
    #[inline]
    pub fn weights(self) -> std::ops::Range<usize> {
        self.offset..self.offset + self.inputs * self.outputs
    }

    #[inline]
    pub fn biases(self) -> std::ops::Range<usize> {
        let from = self.offset + self.inputs * self.outputs;
        from..from + self.outputs
    }
}

impl Network {
    /// Creates a network of given layer sizes (inputs first, outputs last) with all parameters 0.
    #[must_use]
    pub fn zeros(sizes: &[usize]) -> Self {
        let mut network = Self {
            sizes: sizes.to_vec(),
            parameters: Vec::new(),
        };
        let count = network
            .layers()
            .last()
            .map_or(0, |layer| layer.biases().end);
        network.parameters = vec![0.0; count];
        network
    }

    /// Returns the number of values of each layer, inputs first.
    #[must_use]
    #[inline]
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// Returns all weights and biases.
    #[must_use]
    #[inline]
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Returns all weights and biases, mutable.
    #[inline]
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// Returns the layers from input to output.
    #[inline]
    pub fn layers(
        &self,
    ) -> impl DoubleEndedIterator<Item = LayerLayout> + ExactSizeIterator + use<> {
        let mut from = 0;
        let layers: Vec<LayerLayout> = self
            .sizes
            .windows(2)
            .map(|pair| {
                let layer = LayerLayout {
                    inputs: pair[0],
                    outputs: pair[1],
                    offset: from,
                };
                from = layer.biases().end;
                layer
            })
            .collect();
        layers.into_iter()
    }

    /// Returns the first layer that could overflow for inputs within ±`limit`, by |h W + b| <= |h| |W| + |b|.
    pub(crate) fn overflowing_layer(&self, limit: f64) -> Option<usize> {
        // Half of the range is reserved for rounding.
        let highest = 0.5 * f64::from(f32::MAX);
        let mut bounds = vec![limit; self.sizes.first().copied().unwrap_or_default()];
        if limit > highest {
            return Some(0);
        }
        for (index, layer) in self.layers().enumerate() {
            let biases = &self.parameters[layer.biases()];
            let mut next: Vec<f64> = biases.iter().map(|bias| f64::from(bias.abs())).collect();
            for (bound, row) in bounds
                .iter()
                .zip(self.parameters[layer.weights()].chunks_exact(layer.outputs))
            {
                next.iter_mut()
                    .zip(row)
                    .for_each(|(sum, weight)| *sum += bound * f64::from(weight.abs()));
            }
            if !next.iter().all(|&bound| bound <= highest) {
                return Some(index);
            }
            bounds = next;
        }
        None
    }

    /// Computes one layer for `batch` rows of `input` into `out`; `panels` is workspace.
    pub fn layer_forward(
        &self,
        layer: LayerLayout,
        rectified: bool,
        input: &[f32],
        batch: usize,
        out: &mut [f32],
        panels: &mut PackedPanels,
    ) {
        let weights = &self.parameters[layer.weights()];
        let biases = &self.parameters[layer.biases()];
        if layer.outputs == 1 && !rectified {
            multiply_vector(input, weights, biases[0], out);
        } else {
            panels.pack_parallel(
                Rhs::Rows(weights),
                Some(biases),
                [layer.inputs, layer.outputs],
            );
            panels.multiply_parallel(Lhs::Rows(input), batch, rectified, out);
        }
    }
}

/// A network with packed weights for fast evaluation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PackedNetwork {
    steps: Vec<PackedStep>,
}

#[derive(Debug, Clone, PartialEq)]
enum PackedStep {
    /// Product with a matrix; `rectified` replaces negative elements by 0.
    Matrix {
        panels: PackedPanels,
        outputs: usize,
        rectified: bool,
    },
    Vector {
        weights: Vec<f32>,
        bias: f32,
    },
    Elementwise(Elementwise, usize),
}

/// Workspace of a network evaluation.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    front: Vec<f32>,
    back: Vec<f32>,
}

impl PackedNetwork {
    pub(super) fn new(network: &Network) -> Self {
        let last = network.layers().len() - 1;
        let mut acting = Self::default();
        for (index, layer) in network.layers().enumerate() {
            let parameters = network.parameters();
            let (weights, biases) = (&parameters[layer.weights()], &parameters[layer.biases()]);
            acting.push_product(weights, biases, layer.inputs, index == last, index != last);
        }
        acting
    }

    /// Appends a product with a matrix of one row per input. The last product to one output cannot be `rectified`.
    pub fn push_product(
        &mut self,
        weights: &[f32],
        biases: &[f32],
        inputs: usize,
        is_last: bool,
        rectified: bool,
    ) {
        self.steps.push(match biases {
            [bias] if is_last => PackedStep::Vector {
                weights: weights.to_vec(),
                bias: *bias,
            },
            _ => {
                let outputs = biases.len();
                let panels = PackedPanels::new(Rhs::Rows(weights), Some(biases), [inputs, outputs]);
                PackedStep::Matrix {
                    panels,
                    outputs,
                    rectified,
                }
            }
        });
    }

    /// Appends an elementwise operation on `width` values.
    pub fn push_elementwise(&mut self, function: Elementwise, width: usize) {
        self.steps.push(PackedStep::Elementwise(function, width));
    }

    /// Returns the output for `batch` rows of `input`; the bits of a row do not depend on other rows.
    pub fn forward<'w>(&self, input: &[f32], batch: usize, space: &'w mut Workspace) -> &'w [f32] {
        space.front.clear();
        space.front.extend_from_slice(input);
        for step in &self.steps {
            let Workspace { front, back } = space;
            match step {
                PackedStep::Matrix {
                    panels,
                    outputs,
                    rectified,
                } => {
                    back.resize(batch * outputs, 0.0);
                    panels.multiply(Lhs::Rows(front), batch, *rectified, back);
                }
                PackedStep::Vector { weights, bias } => {
                    back.resize(batch, 0.0);
                    multiply_vector(front, weights, *bias, back);
                }
                PackedStep::Elementwise(function, width) => {
                    function.apply(front, *width);
                    continue;
                }
            }
            std::mem::swap(front, back);
        }
        &space.front
    }
}
