//! Forward and backward pass of a network, with explicit gradients.
//!
//! For a loss L, layer inputs x, outputs z = x W + b and δ = ∂L/∂z for every row of a batch: ∂L/∂W = xᵀ δ, ∂L/∂b = Σ δ
//! and ∂L/∂x = δ Wᵀ. A ReLU layer below passes ∂L/∂x on where its output is positive.

use pulp::Arch;

use crumple_sim::policy::{Lhs, Network, PackedPanels, Rhs, SimdClosure, multiply_vector};

/// Activations of a forward pass for the backward pass, and working memory of both.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tape {
    activations: Vec<Vec<f32>>,
    delta: Vec<f32>,
    delta_below: Vec<f32>,
    panels: PackedPanels,
}

impl Tape {
    pub(crate) fn forward(
        &mut self,
        network: &Network,
        batch: usize,
        fill: impl FnOnce(&mut Vec<f32>),
    ) -> &[f32] {
        let layers = network.layers();
        let count = layers.len();
        self.activations.resize_with(count + 1, Vec::new);
        self.activations[0].clear();
        fill(&mut self.activations[0]);
        for (index, layer) in layers.enumerate() {
            let (before, after) = self.activations.split_at_mut(index + 1);
            let out = &mut after[0];
            out.resize(batch * layer.outputs, 0.0);
            network.layer_forward(
                layer,
                index + 1 < count,
                &before[index],
                batch,
                out,
                &mut self.panels,
            );
        }
        &self.activations[count]
    }

    pub(crate) fn output(&self) -> &[f32] {
        self.activations.last().map_or(&[], Vec::as_slice)
    }

    /// Computes the gradients of all parameters from ∂L/∂output of the last forward pass.
    pub(crate) fn backward(
        &mut self,
        network: &Network,
        output_gradient: &[f32],
        gradients: &mut [f32],
    ) {
        self.backpropagate(network, output_gradient, Some(gradients));
    }

    /// Computes ∂L/∂(last input) of every row from ∂L/∂output of the last forward pass.
    pub(crate) fn backward_to_last_input(
        &mut self,
        network: &Network,
        output_gradient: &[f32],
        out: &mut [f32],
    ) {
        self.backpropagate(network, output_gradient, None);
        if let Some(first) = network.layers().next() {
            let weights = &network.parameters()[first.weights()];
            multiply_vector(
                &self.delta,
                &weights[(first.inputs - 1) * first.outputs..],
                0.0,
                out,
            );
        }
    }

    /// Propagates δ from the output to the outputs of the first layer.
    fn backpropagate(
        &mut self,
        network: &Network,
        output_gradient: &[f32],
        mut gradients: Option<&mut [f32]>,
    ) {
        let Self {
            activations: values,
            delta,
            delta_below: below,
            panels,
        } = self;
        delta.clear();
        delta.extend_from_slice(output_gradient);
        for (index, layer) in network.layers().enumerate().rev() {
            let m = layer.inputs;
            let n = layer.outputs;
            let batch = delta.len() / n;
            let input = &values[index];
            if let Some(gradients) = gradients.as_deref_mut() {
                if n == 1 {
                    weighted_row_sum(input, delta, &mut gradients[layer.weights()]);
                } else {
                    panels.pack_parallel(Rhs::Rows(delta), None, [batch, n]);
                    panels.multiply_parallel(
                        Lhs::Columns(input),
                        m,
                        false,
                        &mut gradients[layer.weights()],
                    );
                }
                row_sum(delta, &mut gradients[layer.biases()]);
            }
            if index > 0 {
                let weights = &network.parameters()[layer.weights()];
                below.resize(batch * m, 0.0);
                if n == 1 {
                    outer_product_relu_backward(delta, weights, input, below);
                } else {
                    panels.pack_parallel(Rhs::Columns(weights), None, [n, m]);
                    panels.multiply_parallel(Lhs::Rows(delta), batch, false, below);
                    relu_backward(input, below);
                }
                std::mem::swap(delta, below);
            }
        }
    }
}

/// Computes Σ over rows of factor · row.
fn weighted_row_sum(rows: &[f32], factors: &[f32], out: &mut [f32]) {
    Arch::new().dispatch(SimdClosure(
        #[inline(always)]
        || {
            out.fill(0.0);
            for (row, &factor) in rows.chunks_exact(out.len()).zip(factors) {
                for (sum, &value) in out.iter_mut().zip(row) {
                    *sum += factor * value;
                }
            }
        },
    ));
}

fn row_sum(rows: &[f32], out: &mut [f32]) {
    Arch::new().dispatch(SimdClosure(
        #[inline(always)]
        || {
            out.fill(0.0);
            for row in rows.chunks_exact(out.len()) {
                for (sum, &value) in out.iter_mut().zip(row) {
                    *sum += value;
                }
            }
        },
    ));
}

/// Sets row b of `out` to factor b times `row`, and to 0 where `gate` is not positive.
fn outer_product_relu_backward(factors: &[f32], row: &[f32], gate: &[f32], out: &mut [f32]) {
    Arch::new().dispatch(SimdClosure(
        #[inline(always)]
        || {
            let rows = out
                .chunks_exact_mut(row.len())
                .zip(gate.chunks_exact(row.len()));
            for ((out, gate), &factor) in rows.zip(factors) {
                for ((out, &gate), &value) in out.iter_mut().zip(gate).zip(row) {
                    *out = if gate > 0.0 { factor * value } else { 0.0 };
                }
            }
        },
    ));
}

fn relu_backward(gate: &[f32], out: &mut [f32]) {
    Arch::new().dispatch(SimdClosure(
        #[inline(always)]
        || {
            for (out, &gate) in out.iter_mut().zip(gate) {
                *out = if gate > 0.0 { *out } else { 0.0 };
            }
        },
    ));
}
