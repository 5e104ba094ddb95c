//! Small ONNX files, written field by field: a chain of matrix products and elementwise operators.

use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;

/// A node of the chain with its constants.
pub(crate) enum TestOnnxNode {
    /// Inputs, outputs, W by rows (one per input), b.
    Gemm(usize, usize, Vec<f32>, Vec<f32>),
    /// An operator without constants, and its attributes.
    Unary(&'static str, Vec<(&'static str, f32)>),
    /// An operator with one constant per element.
    WithConstant(&'static str, Vec<f32>),
}

fn varint(mut number: usize) -> Vec<u8> {
    let mut all = Vec::new();
    while number > 127 {
        all.push(number as u8 | 128);
        number >>= 7;
    }
    all.push(number as u8);
    all
}

fn bytes_field(number: u8, bytes: &[u8]) -> Vec<u8> {
    [vec![number << 3 | 2], varint(bytes.len()), bytes.to_vec()].concat()
}

fn varint_field(number: u8, value: usize) -> Vec<u8> {
    [vec![number << 3], varint(value)].concat()
}

fn tensor(name: &str, shape: &[usize], numbers: &[f32]) -> Vec<u8> {
    let raw: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    let dims: Vec<u8> = shape.iter().flat_map(|&size| varint_field(1, size)).collect();
    [dims, varint_field(2, 1), bytes_field(8, name.as_bytes()), bytes_field(9, &raw)].concat()
}

fn value_info(name: &str, width: usize) -> Vec<u8> {
    let dims = [1, width].map(|size| bytes_field(1, &varint_field(1, size))).concat();
    [
        bytes_field(1, name.as_bytes()),
        bytes_field(2, &bytes_field(1, &[varint_field(1, 1), bytes_field(2, &dims)].concat())),
    ]
    .concat()
}

/// Returns a model (opset 9) with one row of `inputs` numbers as input.
pub(crate) fn model_bytes(inputs: usize, nodes: &[TestOnnxNode]) -> Vec<u8> {
    let (mut graph, mut constants, mut width) = (Vec::new(), Vec::new(), inputs);
    let mut add = |shape: &[usize], numbers: &[f32]| {
        let name = format!("c{}", constants.len());
        constants.push(tensor(&name, shape, numbers));
        name
    };
    for (index, node) in nodes.iter().enumerate() {
        let mut names = vec![format!("h{index}")];
        let (operator, attributes) = match node {
            TestOnnxNode::Gemm(before, after, weights, biases) => {
                names.push(add(&[*before, *after], weights));
                names.push(add(&[*after], biases));
                width = *after;
                ("Gemm", &[][..])
            }
            TestOnnxNode::Unary(operator, attributes) => (*operator, attributes.as_slice()),
            TestOnnxNode::WithConstant(operator, numbers) => {
                names.push(add(&[numbers.len()], numbers));
                (*operator, &[][..])
            }
        };
        let mut bytes = names.iter().flat_map(|name| bytes_field(1, name.as_bytes())).collect::<Vec<u8>>();
        bytes.extend(bytes_field(2, format!("h{}", index + 1).as_bytes()));
        bytes.extend(bytes_field(4, operator.as_bytes()));
        for (name, value) in attributes {
            let value = [vec![2 << 3 | 5], value.to_le_bytes().to_vec()].concat();
            bytes.extend(bytes_field(5, &[bytes_field(1, name.as_bytes()), value].concat()));
        }
        graph.extend(bytes_field(1, &bytes));
    }
    constants.iter().for_each(|constant| graph.extend(bytes_field(5, constant)));
    graph.extend(bytes_field(11, &value_info("h0", inputs)));
    graph.extend(bytes_field(12, &value_info(&format!("h{}", nodes.len()), width)));
    [varint_field(1, 4), bytes_field(8, &varint_field(2, 9)), bytes_field(7, &graph)].concat()
}

pub(crate) fn random_product(before: usize, after: usize, gain: f32, random: &mut Xoshiro256PlusPlus) -> TestOnnxNode {
    let scale = gain * (3.0 / before as f32).sqrt();
    let weights = (0..before * after).map(|_| scale * random.random_range(-1.0..1.0_f32)).collect();
    let biases = (0..after).map(|_| 0.3 * random.random_range(-1.0..1.0_f32)).collect();
    TestOnnxNode::Gemm(before, after, weights, biases)
}

pub(crate) fn any_elementwise(width: usize, random: &mut Xoshiro256PlusPlus) -> TestOnnxNode {
    let mut operands =
        |low: f32, high: f32| -> Vec<f32> { (0..width).map(|_| random.random_range(low..high)).collect() };
    let (some, away_from_0) = (operands(-1.0, 1.0), operands(0.5, 2.0));
    let number = some[0];
    match random.random_range(0..9_u32) {
        0 => TestOnnxNode::Unary("Relu", vec![]),
        1 => TestOnnxNode::Unary("LeakyRelu", vec![("alpha", 0.5 * number)]),
        2 => TestOnnxNode::Unary("Elu", vec![("alpha", number.abs())]),
        3 => TestOnnxNode::Unary("Tanh", vec![]),
        4 => TestOnnxNode::Unary("Sigmoid", vec![]),
        5 => TestOnnxNode::WithConstant("Add", some),
        6 => TestOnnxNode::WithConstant("Mul", some),
        7 => TestOnnxNode::WithConstant("Div", away_from_0),
        _ => TestOnnxNode::Unary("Clip", vec![("min", number - 0.5), ("max", number + 0.5)]),
    }
}
