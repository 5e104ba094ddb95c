//! Conversion of graph nodes to network steps.

use std::collections::HashMap;
use std::rc::Rc;

use super::super::{
    Elementwise, FeedForward, Linear, MAX_LAYER_WIDTH, MAX_PARAMETERS, MAX_STEPS, NetworkError,
    NetworkStep,
};
use super::constants::{
    broadcast, constant_of_node, float_attribute, has_only, integer_attribute, is_set,
    matrix_shape, to_input_rows,
};
use super::model::{OnnxModel, OnnxNode, OnnxTensor, TensorData, is_default_domain};

/// Builds the network of a graph that is a straight chain.
pub(super) fn build_network(model: OnnxModel) -> Result<FeedForward, NetworkError> {
    let OnnxModel {
        opset,
        nodes,
        constants,
        inputs,
        outputs,
    } = model;
    let GraphInput { name, shape, count } = GraphInput::find(inputs, &constants)?;
    let mut chain = Chain {
        opset,
        constants,
        current: name,
        shape,
        parameters: 0,
        steps: Vec::new(),
    };
    for (index, node) in nodes.into_iter().enumerate() {
        let name = if node.name.is_empty() {
            index.to_string()
        } else {
            format!("`{}`", node.name)
        };
        let operator = node.operator.clone();
        chain
            .apply_node(node)
            .map_err(|problem| NetworkError::Node {
                node: name,
                operator,
                problem,
            })?;
    }
    match outputs.as_slice() {
        [output] if *output == chain.current => FeedForward::new(count, chain.steps),
        [output] => Err(NetworkError::Unsupported(format!(
            "the output of the graph is `{output}`, but its chain of nodes ends in `{}`",
            chain.current
        ))),
        outputs => {
            let problem = format!(
                "the graph has {} outputs ({}), and crumple supports one",
                outputs.len(),
                outputs.join(", ")
            );
            Err(NetworkError::Unsupported(problem))
        }
    }
}

/// The only input of a graph that is not a constant.
struct GraphInput {
    name: String,
    shape: Vec<usize>,
    /// Number of inputs of the network.
    count: usize,
}

impl GraphInput {
    fn find(
        inputs: Vec<(String, Option<Vec<usize>>)>,
        constants: &HashMap<String, Rc<OnnxTensor>>,
    ) -> Result<Self, NetworkError> {
        let inputs: Vec<_> = inputs
            .into_iter()
            .filter(|(name, _)| !constants.contains_key(name))
            .collect();
        let [(name, shape)] = inputs.as_slice() else {
            let names: Vec<_> = inputs.iter().map(|(name, _)| name.as_str()).collect();
            let problem = format!(
                "the graph has {} inputs ({}), and crumple supports one",
                names.len(),
                names.join(", ")
            );
            return Err(NetworkError::Unsupported(problem));
        };
        let Some(shape) = shape.clone() else {
            return Err(NetworkError::Unsupported(format!(
                "the graph does not state the shape of its input `{name}`"
            )));
        };
        match element_count(&shape).filter(|&count| count <= MAX_LAYER_WIDTH) {
            Some(count) => Ok(Self {
                name: name.clone(),
                shape,
                count,
            }),
            None => {
                let problem =
                    format!("the graph's input `{name}` has more than {MAX_LAYER_WIDTH} numbers");
                Err(NetworkError::Unsupported(problem))
            }
        }
    }
}

/// Returns the number of elements of a shape; `None` if it is too large.
fn element_count(shape: &[usize]) -> Option<usize> {
    shape
        .iter()
        .try_fold(1_usize, |count, &size| count.checked_mul(size))
}

struct Chain {
    opset: i64,
    constants: HashMap<String, Rc<OnnxTensor>>,
    current: String,
    /// Shape of that output, with a batch size of 1.
    shape: Vec<usize>,
    parameters: usize,
    steps: Vec<NetworkStep>,
}

/// Returns a likely reason for a shape mismatch: an axis without fixed length, or an exported batch.
fn mismatch_hint(expected: usize, count: usize) -> &'static str {
    match (expected, count) {
        (2.., 1) => {
            ": the axis of the features may have no fixed length; export it with one, and make only the batch dynamic"
        }
        (1.., _) if count > expected && count.is_multiple_of(expected) => {
            ": the network may have been exported with a batch of several; export with a batch of 1, or a dynamic one"
        }
        _ => "",
    }
}

impl Chain {
    fn apply_node(&mut self, node: OnnxNode) -> Result<(), String> {
        if !is_default_domain(&node.domain) {
            return Err(format!(
                "the operators of `{}` are not supported",
                node.domain
            ));
        }
        let [output] = node.outputs.as_slice() else {
            return Err(format!(
                "it has {} outputs, and crumple supports one",
                node.outputs.len()
            ));
        };
        let output = output.clone();
        if node.operator == "Constant" {
            let constant = constant_of_node(node)?;
            self.constants.insert(output, Rc::new(constant));
            return Ok(());
        }
        if node.operator == "Identity"
            && node
                .inputs
                .first()
                .is_some_and(|name| self.constants.contains_key(name))
        {
            let constant = self.constant(&node, 0)?;
            self.constants.insert(output, constant);
            return Ok(());
        }
        if self.steps.len() >= MAX_STEPS {
            return Err(format!("the network has more than {MAX_STEPS} steps"));
        }
        let uses = node.inputs.iter().filter(|name| **name == self.current);
        if uses.count() != 1 {
            return Err(format!(
                "it does not use `{}` exactly once, so the graph is not a simple chain",
                self.current
            ));
        }
        self.append_operator(&node)?;
        self.current = output;
        Ok(())
    }

    /// Appends the steps of a node that continues the chain.
    fn append_operator(&mut self, node: &OnnxNode) -> Result<(), String> {
        match node.operator.as_str() {
            "Gemm" => self.gemm(node)?,
            "MatMul" => self.product(node)?,
            "Conv" => self.full_convolution(node)?,
            "Add" => self.add(node, 1.0)?,
            "Sub" => self.subtract(node)?,
            "Mul" => self.push_elementwise(Elementwise::Multiply(self.broadcast_operand(node)?)),
            "Div" if node.inputs.first() == Some(&self.current) => {
                self.push_elementwise(Elementwise::Divide(self.broadcast_operand(node)?));
            }
            "Relu" => self.push_elementwise(Elementwise::Relu),
            "LeakyRelu" => self.push_elementwise(Elementwise::LeakyRelu {
                slope: float_attribute(node, "alpha", 0.01),
            }),
            "Elu" => self.push_elementwise(Elementwise::Elu {
                alpha: float_attribute(node, "alpha", 1.0),
            }),
            "Tanh" => self.push_elementwise(Elementwise::Tanh),
            "Sigmoid" => self.push_elementwise(Elementwise::Sigmoid),
            "Clip" => self.clip(node)?,
            "Identity" => {}
            // Single and double precision: all computations use single.
            "Cast" if matches!(integer_attribute(node, "to"), Some(1 | 11)) => {}
            "Cast" => {
                return Err("only casts to single and double precision are supported".to_owned());
            }
            "Flatten" => self.shape = vec![1, self.element_count()],
            "Reshape" => self.reshape(node)?,
            _ => return Err("this operator is not supported".to_owned()),
        }
        Ok(())
    }

    fn element_count(&self) -> usize {
        self.shape.iter().product()
    }

    fn push_elementwise(&mut self, step: Elementwise) {
        self.steps.push(NetworkStep::Elementwise(step));
    }

    fn constant(&self, node: &OnnxNode, input: usize) -> Result<Rc<OnnxTensor>, String> {
        let name = node
            .inputs
            .get(input)
            .filter(|name| !name.is_empty())
            .ok_or("it lacks an input")?;
        let constant = self.constants.get(name);
        constant.cloned().ok_or_else(|| {
            format!("its input `{name}` is not a constant, so the graph is not a simple chain")
        })
    }

    /// True if the constant operand is on the left.
    fn has_constant_left(&self, node: &OnnxNode) -> bool {
        node.inputs.first() != Some(&self.current)
    }

    fn constant_operand(&self, node: &OnnxNode) -> Result<Rc<OnnxTensor>, String> {
        self.constant(node, usize::from(!self.has_constant_left(node)))
    }

    fn broadcast_operand(&self, node: &OnnxNode) -> Result<Vec<f32>, String> {
        let constant = self.constant_operand(node)?;
        let numbers = constant.floats()?;
        let mut shape = constant.shape.clone();
        // Before opset 7, an attribute gave the axis of the constant's first dimension.
        if self.opset < 7
            && let Some(axis) =
                integer_attribute(node, "axis").and_then(|axis| usize::try_from(axis).ok())
        {
            shape.resize(self.shape.len().saturating_sub(axis).max(shape.len()), 1);
        }
        broadcast(numbers, &shape, &self.shape)
    }

    fn reserve_parameters(&mut self, weights: usize, outputs: usize) -> Result<(), String> {
        self.parameters = self
            .parameters
            .saturating_add(weights)
            .saturating_add(outputs);
        if self.parameters > MAX_PARAMETERS || outputs > MAX_LAYER_WIDTH {
            return Err(format!(
                "more than {MAX_PARAMETERS} weights and biases, or more than {MAX_LAYER_WIDTH} outputs"
            ));
        }
        Ok(())
    }

    fn push_linear(&mut self, weights: Vec<f32>, biases: Vec<f32>, shape: Vec<usize>) {
        self.steps
            .push(NetworkStep::Linear(Linear { weights, biases }));
        self.shape = shape;
    }

    fn product(&mut self, node: &OnnxNode) -> Result<(), String> {
        let constant = self.constant_operand(node)?;
        let transposed = self.has_constant_left(node);
        let [rows, columns] = matrix_shape(&constant.shape)?;
        let inputs = if transposed { columns } else { rows };
        // The current values must be one row, or one column for a constant on the left.
        let is_vector = match (transposed, self.shape.as_slice()) {
            (false, [.., last]) => *last == self.element_count(),
            (true, [.., before, _]) => *before == self.element_count(),
            (true, [_]) => true,
            (_, []) => false,
        };
        if !is_vector || inputs != self.element_count() {
            let problem = format!(
                "a matrix of {rows} by {columns} against numbers of shape {:?}",
                self.shape
            );
            return Err(problem + mismatch_hint(inputs, self.element_count()));
        }
        let outputs = if transposed { rows } else { columns };
        let numbers = constant.floats()?;
        self.reserve_parameters(numbers.len(), outputs)?;
        let weights = to_input_rows(numbers, [rows, columns], transposed).into_owned();
        let rank = self.shape.len();
        let mut shape = vec![1; rank.max(1)];
        let at = if transposed && rank > 1 {
            rank - 2
        } else {
            shape.len() - 1
        };
        shape[at] = outputs;
        self.push_linear(weights, vec![0.0; outputs], shape);
        Ok(())
    }

    /// Appends α A B + β C. Before opset 7, a four-dimensional A counts as a row.
    fn gemm(&mut self, node: &OnnxNode) -> Result<(), String> {
        let alpha = float_attribute(node, "alpha", 1.0);
        let constant = self.constant_operand(node)?;
        let is_left = self.has_constant_left(node);
        let shape @ [rows, columns] = matrix_shape(&constant.shape)?;
        // With the constant on the left, its rows are the outputs.
        let transposed = is_set(node, if is_left { "transA" } else { "transB" }) != is_left;
        let [inputs, outputs] = if transposed {
            [columns, rows]
        } else {
            [rows, columns]
        };
        let count = self.element_count();
        if inputs != count {
            let noun = if count == 1 { "number" } else { "numbers" };
            return Err(format!(
                "a matrix of {rows} by {columns} against {count} {noun}{}",
                mismatch_hint(inputs, count)
            ));
        }
        let numbers = constant.floats()?;
        self.reserve_parameters(numbers.len(), outputs)?;
        let mut weights = to_input_rows(numbers, shape, transposed).into_owned();
        if alpha != 1.0 {
            weights.iter_mut().for_each(|weight| *weight *= alpha);
        }
        let biases = self.gemm_biases(node, outputs)?;
        let shape = if is_left {
            vec![outputs, 1]
        } else {
            vec![1, outputs]
        };
        self.push_linear(weights, biases, shape);
        Ok(())
    }

    /// Returns β C, which may be one number for all outputs, or missing.
    fn gemm_biases(&self, node: &OnnxNode, outputs: usize) -> Result<Vec<f32>, String> {
        let mut biases = vec![0.0; outputs];
        if node.inputs.get(2).is_none_or(String::is_empty) {
            return Ok(biases);
        }
        let beta = float_attribute(node, "beta", 1.0);
        let constant = self.constant(node, 2)?;
        let numbers = constant.floats()?;
        if numbers.len() != outputs && numbers.len() != 1 {
            return Err(format!("{} numbers are added to {outputs}", numbers.len()));
        }
        for (index, bias) in biases.iter_mut().enumerate() {
            let number = numbers
                .get(if numbers.len() == 1 { 0 } else { index })
                .copied()
                .unwrap_or_default();
            *bias = if beta == 1.0 { number } else { beta * number };
        }
        Ok(biases)
    }

    /// Appends a convolution whose kernel covers the whole input: a product with a matrix, as MATLAB exports it.
    fn full_convolution(&mut self, node: &OnnxNode) -> Result<(), String> {
        let constant = self.constant(node, 1)?;
        let is_whole = match (constant.shape.as_slice(), self.shape.as_slice()) {
            ([_, kernel @ ..], [1, image @ ..]) => kernel == image && !kernel.is_empty(),
            _ => false,
        };
        let is_plain = has_only(node, "pads", 0)
            && has_only(node, "dilations", 1)
            && integer_attribute(node, "group").is_none_or(|group| group == 1);
        if !is_whole
            || !is_plain
            || node.attributes.contains_key("auto_pad")
            || node.inputs.first() != Some(&self.current)
        {
            return Err(
                "only a kernel over the whole input, without padding, is supported".to_owned(),
            );
        }
        let [outputs, inputs] = matrix_shape(&constant.shape)?;
        let numbers = constant.floats()?;
        self.reserve_parameters(numbers.len(), outputs)?;
        let weights = to_input_rows(numbers, [outputs, inputs], true).into_owned();
        let biases = match node.inputs.get(2).filter(|name| !name.is_empty()) {
            Some(_) => self.constant(node, 2)?.floats()?.to_vec(),
            None => vec![0.0; outputs],
        };
        let mut shape = vec![1; self.shape.len()];
        if let Some(channels) = shape.get_mut(1) {
            *channels = outputs;
        }
        self.push_linear(weights, biases, shape);
        Ok(())
    }

    /// Adds `sign` times a constant: to the biases of the previous product, or as a step.
    fn add(&mut self, node: &OnnxNode, sign: f32) -> Result<(), String> {
        let operands: Vec<f32> = self
            .broadcast_operand(node)?
            .into_iter()
            .map(|number| sign * number)
            .collect();
        match self.steps.last_mut() {
            Some(NetworkStep::Linear(Linear { biases, .. }))
                if biases.iter().all(|bias| *bias == 0.0) =>
            {
                *biases = operands
            }
            _ => self.push_elementwise(Elementwise::Add(operands)),
        }
        Ok(())
    }

    fn subtract(&mut self, node: &OnnxNode) -> Result<(), String> {
        if node.inputs.first() == Some(&self.current) {
            return self.add(node, -1.0);
        }
        let operands = self.broadcast_operand(node)?;
        self.push_elementwise(Elementwise::Multiply(vec![-1.0; operands.len()]));
        self.push_elementwise(Elementwise::Add(operands));
        Ok(())
    }

    /// Appends a clip. Limits are attributes before opset 11, inputs since.
    fn clip(&mut self, node: &OnnxNode) -> Result<(), String> {
        let low = self.clip_limit(node, 1, "min", f32::NEG_INFINITY)?;
        let high = self.clip_limit(node, 2, "max", f32::INFINITY)?;
        let count = self.element_count();
        self.push_elementwise(Elementwise::Clip {
            low: vec![low; count],
            high: vec![high; count],
        });
        Ok(())
    }

    /// Returns a limit of a clip: an input, or before opset 11 an attribute; `open` if it is missing.
    fn clip_limit(
        &self,
        node: &OnnxNode,
        input: usize,
        attribute: &str,
        open: f32,
    ) -> Result<f32, String> {
        if self.opset < 11 {
            return Ok(float_attribute(node, attribute, open));
        }
        if node.inputs.get(input).is_none_or(String::is_empty) {
            return Ok(open);
        }
        let constant = self.constant(node, input)?;
        let [limit] = constant.floats()? else {
            return Err("a limit that is not one number".to_owned());
        };
        Ok(*limit)
    }

    fn reshape(&mut self, node: &OnnxNode) -> Result<(), String> {
        let constant = self.constant(node, 1)?;
        let TensorData::Integer(wanted) = &constant.data else {
            return Err("a shape that is not whole".to_owned());
        };
        let keeps_zero = is_set(node, "allowzero");
        let sizes = wanted.iter().enumerate().map(|(index, &size)| match size {
            0 if !keeps_zero => self.shape.get(index).copied(),
            -1 => Some(1),
            size => usize::try_from(size).ok(),
        });
        let shape: Option<Vec<usize>> = sizes.collect();
        let mut shape = shape.ok_or_else(|| format!("to shape {wanted:?}"))?;
        if let Some(open) = wanted.iter().position(|&size| size == -1) {
            shape[open] = element_count(&shape)
                .and_then(|count| self.element_count().checked_div(count))
                .unwrap_or(0);
        }
        if element_count(&shape) != Some(self.element_count()) || wanted.len() > 8 {
            return Err(format!(
                "{} numbers to shape {wanted:?}",
                self.element_count()
            ));
        }
        self.shape = shape;
        Ok(())
    }
}
