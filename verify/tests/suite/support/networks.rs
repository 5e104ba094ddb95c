//! Random networks without sensible behaviour, and their files.

use crumple_verify::reach::{
    Activation, ControllerInput, LinearLayer, NativePolicy, NetworkFileFormat, NetworkFileSource,
    NetworkLayer, NeuralController,
};
use serde_json::{Value, json};

use super::closed_loop::XorShiftRng;

fn random_layer(
    inputs: usize,
    outputs: usize,
    gain: f64,
    numbers: &mut XorShiftRng,
) -> LinearLayer {
    let mut draw = |count: usize, scale: f64| -> Vec<f64> {
        (0..count)
            .map(|_| f64::from((numbers.next_signed() * scale) as f32))
            .collect()
    };
    let weights = draw(inputs * outputs, gain * (3.0 / inputs as f64).sqrt());
    LinearLayer {
        inputs,
        outputs,
        weights,
        biases: draw(outputs, 0.3),
    }
}

/// Creates a network like crumple's own, with gains of order one.
pub fn native_network(widths: &[usize], gain: f64, seed: u64) -> NeuralController {
    let mut numbers = XorShiftRng(seed | 1);
    let sizes = [&[8], widths, &[1]].concat();
    NeuralController::from(NativePolicy {
        layers: sizes
            .windows(2)
            .map(|pair| random_layer(pair[0], pair[1], gain, &mut numbers))
            .collect(),
        offset: [16.0, 16.0, 12.5, 12.5, 12.5, 0.0, 0.0, 0.0],
        scale: [16.0, 16.0, 12.5, 12.5, 12.5, 5.0, 5.0, 5.0],
        limit: 1.5,
        empty_gap_m: 80.0,
        action_bounds_mps2: [-7.5, 3.0],
        decision_interval_s: 0.1,
    })
}

/// Input quantities: name in files, coefficients of the eight numbers, and a typical magnitude.
const QUANTITIES: [(&str, [f64; 8], f64); 10] = [
    (
        "gap_ahead_m",
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        16.0,
    ),
    (
        "gap_behind_m",
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        16.0,
    ),
    (
        "speed_ahead_mps",
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        12.5,
    ),
    ("speed_mps", [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 12.5),
    (
        "speed_behind_mps",
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        12.5,
    ),
    (
        "acceleration_ahead_mps2",
        [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        5.0,
    ),
    (
        "acceleration_mps2",
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        5.0,
    ),
    (
        "acceleration_behind_mps2",
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        5.0,
    ),
    (
        "relative_speed_ahead_mps",
        [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0],
        5.0,
    ),
    (
        "relative_speed_behind_mps",
        [0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0],
        5.0,
    ),
];

/// Creates a network of random shape, activations and mapping.
pub fn any_network(seed: u64) -> NeuralController {
    any_network_with_file(seed).0
}

pub fn any_network_with_file(seed: u64) -> (NeuralController, Vec<u8>) {
    let mut numbers = XorShiftRng(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
    let numbers = &mut numbers;
    let (inputs, described): (Vec<ControllerInput>, Vec<Value>) = (0..2 + random_below(8, numbers))
        .map(|_| random_input(numbers))
        .unzip();
    let (mut steps, width) = random_layers(inputs.len(), numbers);
    let is_bounded = random_below(2, numbers) == 0;
    if is_bounded {
        let bounded = [
            Activation::Tanh,
            Activation::Sigmoid,
            Activation::Clip {
                low: vec![-1.0; width],
                high: vec![1.0; width],
            },
        ];
        steps.push(NetworkLayer::Activation(
            bounded[random_below(3, numbers)].clone(),
        ));
    }
    let low = if random_below(2, numbers) == 0 {
        -7.5
    } else {
        -4.0
    };
    let controller = NeuralController {
        inputs,
        layers: steps,
        output_index: random_below(width, numbers),
        scale_mps2: 5.25,
        offset_mps2: -2.25,
        action_bounds_mps2: [low, 3.0],
        is_clipped: !is_bounded || low > -7.5,
        empty_gap_m: 80.0,
        decision_interval_s: 0.1,
        source: Some(NetworkFileSource {
            format: NetworkFileFormat::Onnx,
            sha256: "0".repeat(64),
        }),
    };
    let file = network_file(&controller, described);
    (controller, file)
}

fn random_layers(inputs: usize, numbers: &mut XorShiftRng) -> (Vec<NetworkLayer>, usize) {
    let (mut steps, mut width) = (Vec::new(), inputs);
    for depth in 0..1 + random_below(3, numbers) {
        if depth > 0 {
            for _ in 0..1 + random_below(6, numbers) / 5 {
                steps.push(NetworkLayer::Activation(random_activation(width, numbers)));
            }
        }
        let outputs = 1 + random_below(12, numbers);
        let gain = 0.2 + numbers.next_unit();
        steps.push(NetworkLayer::Linear(random_layer(
            width, outputs, gain, numbers,
        )));
        width = outputs;
    }
    (steps, width)
}

fn random_below(count: usize, numbers: &mut XorShiftRng) -> usize {
    ((numbers.next_unit() * count as f64) as usize).min(count - 1)
}

fn random_input(numbers: &mut XorShiftRng) -> (ControllerInput, Value) {
    let index = random_below(QUANTITIES.len() + 3, numbers);
    let low = if random_below(2, numbers) == 0 {
        -1e6
    } else {
        -1.5
    };
    let high = if random_below(2, numbers) == 0 {
        1e6
    } else {
        1.2
    };
    let Some(&(name, of, size)) = QUANTITIES.get(index) else {
        let nothing = [0.0; 8];
        let plain = |constant, absent| ControllerInput {
            coefficients: nothing,
            constant,
            absent_value: absent,
            offset: 0.5,
            scale: 2.0,
            low,
            high,
        };
        let described = |key: &str, value: Value| {
            json!({
                (key): value, "offset": 0.5, "scale": 2.0, "low": low, "high": high
            })
        };
        return match index - QUANTITIES.len() {
            0 => (plain(1.4, None), described("constant", json!(1.4))),
            1 => (plain(1.0, None), described("quantity", json!("is_ahead"))),
            _ => (
                plain(1.0, Some(0.0)),
                described("quantity", json!("is_behind")),
            ),
        };
    };
    let offset = size * numbers.next_unit();
    let scale = if random_below(4, numbers) == 0 {
        -size
    } else {
        size
    };
    let absent = (name.contains("behind") && random_below(2, numbers) == 0)
        .then(|| size * numbers.next_unit());
    let mut described =
        json!({ "quantity": name, "offset": offset, "scale": scale, "low": low, "high": high });
    if let Some(absent) = absent {
        described["absent"] = json!(absent);
    }
    (
        ControllerInput {
            coefficients: of,
            constant: 0.0,
            absent_value: absent,
            offset,
            scale,
            low,
            high,
        },
        described,
    )
}

fn random_activation(width: usize, numbers: &mut XorShiftRng) -> Activation {
    let kind = random_below(9, numbers);
    let single = |number: f64| f64::from(number as f32);
    let mut operands =
        || -> Vec<f64> { (0..width).map(|_| single(numbers.next_signed())).collect() };
    match kind {
        0 => Activation::Relu,
        1 => Activation::LeakyRelu(single(operands()[0] * 0.5)),
        2 => Activation::Elu(single(operands()[0].abs() + 0.1)),
        3 => Activation::Tanh,
        4 => Activation::Sigmoid,
        5 => Activation::Add(operands()),
        6 => Activation::Multiply(operands()),
        7 => Activation::Divide(
            operands()
                .into_iter()
                .map(|operand| single(operand + 1.5))
                .collect(),
        ),
        _ => {
            let low = operands();
            Activation::Clip {
                high: low.iter().map(|low| single(low + 0.7)).collect(),
                low,
            }
        }
    }
}

fn network_file(controller: &NeuralController, inputs: Vec<Value>) -> Vec<u8> {
    let mut tensors: Vec<(String, Vec<usize>, &[f64])> = Vec::new();
    let mut steps = Vec::new();
    for (index, step) in controller.layers.iter().enumerate() {
        let mut add = |name: &str, shape: &[usize], numbers: _| {
            tensors.push((format!("steps.{index}.{name}"), shape.to_vec(), numbers));
        };
        steps.push(match step {
            NetworkLayer::Linear(layer) => {
                add("weight", &[layer.inputs, layer.outputs], &layer.weights);
                add("bias", &[layer.outputs], &layer.biases);
                json!({ "linear": layer.outputs })
            }
            NetworkLayer::Activation(each) => match each {
                Activation::Relu => json!("relu"),
                Activation::LeakyRelu(slope) => json!({ "leaky-relu": slope }),
                Activation::Elu(alpha) => json!({ "elu": alpha }),
                Activation::Tanh => json!("tanh"),
                Activation::Sigmoid => json!("sigmoid"),
                Activation::Add(operands)
                | Activation::Multiply(operands)
                | Activation::Divide(operands) => {
                    add("operand", &[operands.len()], operands);
                    match each {
                        Activation::Add(_) => json!("add"),
                        Activation::Multiply(_) => json!("multiply"),
                        _ => json!("divide"),
                    }
                }
                Activation::Clip { low, high } => {
                    add("low", &[low.len()], low);
                    add("high", &[high.len()], high);
                    json!("clip")
                }
            },
        });
    }
    let [low_mps2, high_mps2] = controller.action_bounds_mps2;
    let text = json!({
        "version": 1, "source": controller.source, "inputs": inputs, "steps": steps,
        "output": {
            "answer": controller.output_index, "scale_mps2": controller.scale_mps2,
            "offset_mps2": controller.offset_mps2, "low_mps2": low_mps2, "high_mps2": high_mps2,
        },
        "empty_gap_m": controller.empty_gap_m, "decision_interval_s": controller.decision_interval_s,
    });
    encode_file(&text, &tensors)
}

pub fn encode_file(text: &Value, tensors: &[(String, Vec<usize>, &[f64])]) -> Vec<u8> {
    let mut header = json!({ "__metadata__": { "crumple_network": text.to_string() } });
    let mut data = Vec::new();
    for &(ref name, ref shape, numbers) in tensors {
        let from = data.len();
        data.extend(
            numbers
                .iter()
                .flat_map(|&number| (number as f32).to_le_bytes()),
        );
        header[name] =
            json!({ "dtype": "F32", "shape": shape, "data_offsets": [from, data.len()] });
    }
    let header = header.to_string();
    [
        &(header.len() as u64).to_le_bytes(),
        header.as_bytes(),
        &data,
    ]
    .concat()
}
