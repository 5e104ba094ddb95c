//! Small ONNX files, written field by field: a chain of matrix products and elementwise operators.

/// A node of the chain with its constants.
pub(crate) enum TestOnnxNode {
    /// Inputs, outputs, W by rows (one per input), b.
    Gemm(usize, usize, Vec<f32>, Vec<f32>),
    /// An operator without constants, and its attributes.
    Unary(&'static str, Vec<(&'static str, f32)>),
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
    let raw: Vec<u8> = numbers
        .iter()
        .flat_map(|number| number.to_le_bytes())
        .collect();
    let dims: Vec<u8> = shape
        .iter()
        .flat_map(|&size| varint_field(1, size))
        .collect();
    [
        dims,
        varint_field(2, 1),
        bytes_field(8, name.as_bytes()),
        bytes_field(9, &raw),
    ]
    .concat()
}

fn value_info(name: &str, width: usize) -> Vec<u8> {
    let dims = [1, width]
        .map(|size| bytes_field(1, &varint_field(1, size)))
        .concat();
    [
        bytes_field(1, name.as_bytes()),
        bytes_field(
            2,
            &bytes_field(1, &[varint_field(1, 1), bytes_field(2, &dims)].concat()),
        ),
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
        };
        let mut bytes = names
            .iter()
            .flat_map(|name| bytes_field(1, name.as_bytes()))
            .collect::<Vec<u8>>();
        bytes.extend(bytes_field(2, format!("h{}", index + 1).as_bytes()));
        bytes.extend(bytes_field(4, operator.as_bytes()));
        for (name, value) in attributes {
            let value = [vec![2 << 3 | 5], value.to_le_bytes().to_vec()].concat();
            bytes.extend(bytes_field(
                5,
                &[bytes_field(1, name.as_bytes()), value].concat(),
            ));
        }
        graph.extend(bytes_field(1, &bytes));
    }
    constants
        .iter()
        .for_each(|constant| graph.extend(bytes_field(5, constant)));
    graph.extend(bytes_field(11, &value_info("h0", inputs)));
    graph.extend(bytes_field(
        12,
        &value_info(&format!("h{}", nodes.len()), width),
    ));
    [
        varint_field(1, 4),
        bytes_field(8, &varint_field(2, 9)),
        bytes_field(7, &graph),
    ]
    .concat()
}
