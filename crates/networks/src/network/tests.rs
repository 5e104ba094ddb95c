//! Tests of ONNX graphs of a few bytes: results of supported graphs, errors of others.

use super::*;
use crumple_sim::policy::Workspace;

fn bytes_field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut all = vec![number << 3 | 2];
    let mut length = bytes.len();
    while length > 127 {
        all.push(length as u8 | 128);
        length >>= 7;
    }
    all.push(length as u8);
    all.extend(bytes);
    all
}

fn varint_field(number: u8, value: u8) -> Vec<u8> {
    vec![number << 3, value]
}

fn constant(name: &str, shape: &[u8], numbers: &[f32]) -> Vec<u8> {
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

/// Encodes a node whose name is its operator in lower case.
fn node(operator: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
    let inputs: Vec<u8> = inputs
        .iter()
        .flat_map(|name| bytes_field(1, name.as_bytes()))
        .collect();
    let attributes: Vec<u8> = attributes
        .iter()
        .flat_map(|attribute| bytes_field(5, attribute))
        .collect();
    let name = operator.to_lowercase();
    [
        inputs,
        bytes_field(2, output.as_bytes()),
        bytes_field(3, name.as_bytes()),
        bytes_field(4, operator.as_bytes()),
        attributes,
    ]
    .concat()
}

fn integer_attribute(name: &str, value: u8) -> Vec<u8> {
    [bytes_field(1, name.as_bytes()), varint_field(3, value)].concat()
}

fn value_info(name: &str, shape: &[u8]) -> Vec<u8> {
    let dims: Vec<u8> = shape
        .iter()
        .flat_map(|&size| bytes_field(1, &varint_field(1, size)))
        .collect();
    [
        bytes_field(1, name.as_bytes()),
        bytes_field(2, &bytes_field(1, &bytes_field(2, &dims))),
    ]
    .concat()
}

/// Encodes a model that computes `y` from `x`.
fn model(opset: u8, shape: &[u8], nodes: &[Vec<u8>], constants: &[Vec<u8>]) -> Vec<u8> {
    let nodes: Vec<u8> = nodes.iter().flat_map(|node| bytes_field(1, node)).collect();
    let constants: Vec<u8> = constants
        .iter()
        .flat_map(|constant| bytes_field(5, constant))
        .collect();
    let graph = [
        nodes,
        constants,
        bytes_field(11, &value_info("x", shape)),
        bytes_field(12, &value_info("y", &[1])),
    ]
    .concat();
    [
        bytes_field(8, &varint_field(2, opset)),
        bytes_field(7, &graph),
    ]
    .concat()
}

fn refusal(bytes: &[u8]) -> String {
    NetworkFile::from_onnx(bytes)
        .expect_err("refused")
        .to_string()
}

fn answer(bytes: &[u8], inputs: &[f32]) -> Vec<f32> {
    let file = NetworkFile::from_onnx(bytes).unwrap_or_else(|error| panic!("{error}"));
    file.network
        .forward(inputs, 1, &mut Workspace::default())
        .to_vec()
}

/// The official network of the ARCH benchmark has this form: opset 6, four dimensions into Gemm, 1 subtracted.
#[test]
fn an_old_gemm_takes_four_dimensions_and_subtraction_is_kept() {
    let nodes = [
        node("Sub", &["x", "ones"], "a", &[]),
        node(
            "Gemm",
            &["a", "w", "b"],
            "c",
            &[integer_attribute("broadcast", 1)],
        ),
        node("Relu", &["c"], "y", &[]),
    ];
    let constants = [
        constant("ones", &[1, 1, 1, 3], &[1.0; 3]),
        constant("w", &[3, 2], &[1.0, -1.0, 10.0, -10.0, 100.0, -100.0]),
        constant("b", &[2], &[0.5, 0.25]),
    ];
    assert_eq!(
        answer(
            &model(6, &[1, 1, 1, 3], &nodes, &constants),
            &[2.0, 3.0, 4.0]
        ),
        [321.5, 0.0]
    );
}

/// MATLAB exports a fully connected layer as a convolution, too.
#[test]
fn a_convolution_over_the_whole_input_is_a_product() {
    let convolved = |shape: &[u8], pads: u8| {
        let pads = [
            bytes_field(1, b"pads"),
            varint_field(8, pads),
            varint_field(8, 0),
        ]
        .concat();
        let nodes = [
            node("Conv", &["x", "w", "b"], "a", &[pads]),
            node("Flatten", &["a"], "y", &[]),
        ];
        let w = constant("w", &[2, 1, 1, 3], &[1.0, 10.0, 100.0, -1.0, -2.0, -3.0]);
        model(8, shape, &nodes, &[w, constant("b", &[2], &[0.5, 0.25])])
    };
    assert_eq!(
        answer(&convolved(&[1, 1, 1, 3], 0), &[1.0, 2.0, 3.0]),
        [321.5, -13.75]
    );
    for refused in [convolved(&[1, 1, 1, 4], 0), convolved(&[1, 1, 1, 3], 1)] {
        assert!(
            refusal(&refused).starts_with("node `conv` (Conv): only a kernel over the whole input")
        );
    }
}

#[test]
fn a_constant_is_broadcast_as_in_numpy_or_refused() {
    let add = |constant_shape: &[u8], count: usize| {
        let numbers: Vec<f32> = (1..=count).map(|number| number as f32).collect();
        let nodes = [node("Add", &["c", "x"], "y", &[])];
        model(
            13,
            &[2, 3],
            &nodes,
            &[constant("c", constant_shape, &numbers)],
        )
    };
    let zeros = [0.0; 6];
    assert_eq!(
        answer(&add(&[2, 1], 2), &zeros),
        [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    );
    assert_eq!(
        answer(&add(&[3], 3), &zeros),
        [1.0, 2.0, 3.0, 1.0, 2.0, 3.0]
    );
    assert_eq!(answer(&add(&[1, 1, 1], 1), &zeros), [1.0; 6]);
    for (shape, count) in [(&[2_u8][..], 2), (&[2, 2, 3], 12), (&[4, 3], 12)] {
        let text = refusal(&add(shape, count));
        assert!(
            text.starts_with("node `add` (Add): a constant of shape"),
            "{text}"
        );
    }
}

#[test]
fn unsupported_operators_are_refused_by_operator_and_node() {
    let w = || constant("w", &[2, 2], &[1.0; 4]);
    let single_node = |operator: &str, inputs: &[&str]| {
        model(13, &[2], &[node(operator, inputs, "y", &[])], &[w()])
    };
    assert_eq!(
        refusal(&single_node("Softmax", &["x"])),
        "node `softmax` (Softmax): this operator is not supported"
    );
    let text = refusal(&single_node("Mul", &["x", "x"]));
    assert_eq!(
        text,
        "node `mul` (Mul): it does not use `x` exactly once, so the graph is not a simple chain"
    );
    let text = refusal(&single_node("MatMul", &["x", "z"]));
    assert_eq!(
        text,
        "node `matmul` (MatMul): its input `z` is not a constant, so the graph is not a simple chain"
    );
    let text = refusal(&single_node("Div", &["w", "x"]));
    assert_eq!(text, "node `div` (Div): this operator is not supported");
    let skip = [
        node("Relu", &["x"], "a", &[]),
        node("Tanh", &["x"], "y", &[]),
    ];
    assert!(
        refusal(&model(13, &[2], &skip, &[]))
            .contains("node `tanh` (Tanh): it does not use `a` exactly once")
    );
    let text = refusal(&model(
        13,
        &[3],
        &[node("MatMul", &["x", "w"], "y", &[])],
        &[w()],
    ));
    assert_eq!(
        text,
        "node `matmul` (MatMul): a matrix of 2 by 2 against numbers of shape [3]"
    );
    let gemm = |shape: &[u8]| {
        refusal(&model(
            13,
            shape,
            &[node("Gemm", &["x", "w"], "y", &[])],
            &[w()],
        ))
    };
    let text = gemm(&[2, 2]);
    assert!(
        text.contains("a matrix of 2 by 2 against 4 numbers: ")
            && text.contains("a batch of several"),
        "{text}"
    );
    let text = gemm(&[1]);
    assert!(
        text.contains("against 1 number: the axis of the features may have no fixed length"),
        "{text}"
    );
    let unfinished = model(13, &[2], &[node("Relu", &["x"], "z", &[])], &[]);
    assert_eq!(
        refusal(&unfinished),
        "the output of the graph is `y`, but its chain of nodes ends in `z`"
    );
    assert!(
        refusal(&model(5, &[2], &[node("Relu", &["x"], "y", &[])], &[]))
            .starts_with("opset 5 is too old")
    );
}

/// Exporters insert such casts before networks that are called in another precision.
#[test]
fn a_cast_between_real_numbers_changes_nothing() {
    let cast = |to: u8| {
        let nodes = [
            node("Cast", &["x"], "a", &[integer_attribute("to", to)]),
            node("Relu", &["a"], "y", &[]),
        ];
        model(13, &[2], &nodes, &[])
    };
    assert_eq!(answer(&cast(1), &[2.5, -1.0]), [2.5, 0.0]);
    assert_eq!(answer(&cast(11), &[2.5, -1.0]), [2.5, 0.0]);
    assert!(refusal(&cast(7)).contains("only casts to single and double precision"));
}

#[test]
fn numbers_that_are_not_finite_overflow_or_divide_by_zero_are_refused() {
    let with = |numbers: [f32; 4]| {
        let nodes = [node("MatMul", &["x", "w"], "y", &[])];
        NetworkFile::from_onnx(&model(
            13,
            &[2],
            &nodes,
            &[constant("w", &[2, 2], &numbers)],
        ))
    };
    assert!(
        with([1.0, f32::NAN, 0.0, 0.0])
            .unwrap_err()
            .to_string()
            .contains("not finite")
    );
    let large = with([1e37, 0.0, 1e37, 0.0]).unwrap().network;
    assert!(large.answer_ranges(&[[-1.0, 1.0]; 2]).is_ok());
    assert!(matches!(
        large.answer_ranges(&[[-10.0, 10.0]; 2]),
        Err(NetworkError::Overflow { step: 0 })
    ));
    let divided = [node("Div", &["x", "w"], "y", &[])];
    let text = refusal(&model(
        13,
        &[2],
        &divided,
        &[constant("w", &[2], &[1.0, 0.0])],
    ));
    assert_eq!(text, "step 0: divides by 0");
}

#[test]
fn answers_lie_in_their_ranges() {
    use proptest::prelude::*;
    let functions = [
        Elementwise::Relu,
        Elementwise::LeakyRelu { slope: 0.2 },
        Elementwise::LeakyRelu { slope: -0.5 },
        Elementwise::Elu { alpha: 0.7 },
        Elementwise::Elu { alpha: -2.0 },
        Elementwise::Tanh,
        Elementwise::Sigmoid,
        Elementwise::Clip {
            low: vec![-0.5; 3],
            high: vec![0.25; 3],
        },
        Elementwise::Multiply(vec![-2.0, 0.0, 3.0]),
        Elementwise::Divide(vec![-2.0, 0.5, 3.0]),
        Elementwise::Add(vec![-2.0, 0.5, 3.0]),
    ];
    let numbers = |count| prop::collection::vec(-2.0..2.0_f32, count);
    let question = (
        0..functions.len(),
        numbers(6),
        numbers(3),
        numbers(2),
        numbers(2),
        0.0..1.0_f32,
    );
    proptest!(crumple_cases::with_cases(256), |((pick, weights, biases, low, width, share) in question)| {
        let function = NetworkStep::Elementwise(functions[pick].clone());
        let steps = vec![NetworkStep::Linear(Linear { weights, biases }), function];
        let network = FeedForward::new(2, steps).unwrap();
        let limits: Vec<[f64; 2]> =
            low.iter().zip(&width).map(|(&low, width)| [f64::from(low), f64::from(low + width.abs())]).collect();
        let at: Vec<f32> = low.iter().zip(&width).map(|(low, width)| low + share * width.abs()).collect();
        let ranges = network.answer_ranges(&limits).unwrap();
        for (answer, [low, high]) in network.forward(&at, 1, &mut Workspace::default()).iter().zip(ranges) {
            prop_assert!((low - 1e-5..=high + 1e-5).contains(&f64::from(*answer)), "{answer} {low} {high}");
        }
    });
}

/// One pickle is nested a million deep, another calls a function, a third is circular.
#[test]
fn pickles_are_read_and_not_run() {
    let deep = [b"\x80\x02)".to_vec(), vec![0x85; 1_000_000], b".".to_vec()].concat();
    assert!(
        pickle::Pickle::read(&deep)
            .is_err_and(|error| error.to_string().contains("more than 200000 values"))
    );
    let evil = b"\x80\x02cos\nsystem\nX\x04\x00\x00\x00echo\x85R.";
    let read = pickle::Pickle::read(evil).unwrap();
    let call = read.call(read.top).unwrap();
    assert_eq!(read.global(call.callee), Some(("os", "system")));
    let circle = b"\x80\x02]q\x00h\x00a.";
    assert!(pickle::Pickle::read(circle).is_ok());
}
