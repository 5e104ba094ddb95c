//! Networks that drive neither calmly nor sensibly, and the files of such.

use crumple_verify::reach::{Actor, Departure, Each, Format, Input, Layer, Own, Source, Step};
use serde_json::{Value, json};

use super::closed_loop::Numbers;

fn random_layer(inputs: usize, outputs: usize, gain: f64, numbers: &mut Numbers) -> Layer {
    let mut draw = |count: usize, scale: f64| -> Vec<f64> {
        (0..count).map(|_| f64::from((numbers.signed() * scale) as f32)).collect()
    };
    let weights = draw(inputs * outputs, gain * (3.0 / inputs as f64).sqrt());
    Layer { inputs, outputs, weights, biases: draw(outputs, 0.3) }
}

/// A network of given widths, as crumple's own are; gains of order one.
pub fn native_network(widths: &[usize], gain: f64, seed: u64) -> Actor {
    departing(widths, gain, seed, None)
}

/// The same, of which the action departs from a law.
pub fn residual_network(widths: &[usize], gain: f64, seed: u64, departs_from: Option<Departure>) -> Actor {
    let mut numbers = Numbers(seed | 1);
    let sizes = [&[8], widths, &[1]].concat();
    Actor::from(Own {
        layers: sizes.windows(2).map(|pair| layer(pair[0], pair[1], gain, &mut numbers)).collect(),
        offset: [16.0, 16.0, 12.5, 12.5, 12.5, 0.0, 0.0, 0.0],
        scale: [16.0, 16.0, 12.5, 12.5, 12.5, 5.0, 5.0, 5.0],
        limit: 1.5,
        empty_gap_m: 80.0,
        action_mps2: [-7.5, 3.0],
        departs_from,
        decision_interval_s: 0.1,
    })
}

/// What is seen: quantities by their names in files, what they are of the eight numbers, and a size that they usually have.
const QUANTITIES: [(&str, [f64; 8], f64); 10] = [
    ("gap_ahead_m", [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 16.0),
    ("gap_behind_m", [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 16.0),
    ("speed_ahead_mps", [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 12.5),
    ("speed_mps", [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 12.5),
    ("speed_behind_mps", [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 12.5),
    ("acceleration_ahead_mps2", [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0], 5.0),
    ("acceleration_mps2", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], 5.0),
    ("acceleration_behind_mps2", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 5.0),
    ("relative_speed_ahead_mps", [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0], 5.0),
    ("relative_speed_behind_mps", [0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0], 5.0),
];

/// A network of any shape, functions and mapping.
pub fn any_network(seed: u64) -> Actor {
    any_with_file(seed).0
}

/// The same, and its file.
pub fn any_network_with_file(seed: u64) -> (Actor, Vec<u8>) {
    let mut numbers = Numbers(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
    let numbers = &mut numbers;
    let (inputs, described): (Vec<Input>, Vec<Value>) = (0..2 + below(8, numbers)).map(|_| input(numbers)).unzip();
    let (mut steps, width) = steps(inputs.len(), numbers);
    let is_bounded = below(2, numbers) == 0;
    if is_bounded {
        let bounded = [Each::Tanh, Each::Sigmoid, Each::Clip { low: vec![-1.0; width], high: vec![1.0; width] }];
        steps.push(Step::Each(bounded[below(3, numbers)].clone()));
    }
    // A network that is bounded may need no cut.
    let low = if below(2, numbers) == 0 { -7.5 } else { -4.0 };
    let actor = Actor {
        inputs,
        steps,
        answer: below(width, numbers),
        scale_mps2: 5.25,
        offset_mps2: -2.25,
        action_mps2: [low, 3.0],
        is_cut: !is_bounded || low > -7.5,
        departs_from: None,
        empty_gap_m: 80.0,
        decision_interval_s: 0.1,
        source: Some(Source { format: Format::Onnx, sha256: "0".repeat(64) }),
    };
    let file = file(&actor, described);
    (actor, file)
}

/// Any functions between layers, and one answer at least.
pub fn any_layers(inputs: usize, seed: u64) -> Vec<Step> {
    steps(inputs, &mut Numbers(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)).0
}

fn random_layers(inputs: usize, numbers: &mut Numbers) -> (Vec<Step>, usize) {
    let (mut steps, mut width) = (Vec::new(), inputs);
    for depth in 0..1 + below(3, numbers) {
        if depth > 0 {
            // Two in a row, sometimes.
            for _ in 0..1 + below(6, numbers) / 5 {
                steps.push(Step::Each(each(width, numbers)));
            }
        }
        let outputs = 1 + below(12, numbers);
        let gain = 0.2 + numbers.unit();
        steps.push(Step::Linear(layer(width, outputs, gain, numbers)));
        width = outputs;
    }
    (steps, width)
}

fn random_below(count: usize, numbers: &mut Numbers) -> usize {
    ((numbers.unit() * count as f64) as usize).min(count - 1)
}

fn random_input(numbers: &mut Numbers) -> (Input, Value) {
    let place = below(QUANTITIES.len() + 3, numbers);
    let low = if below(2, numbers) == 0 { -1e6 } else { -1.5 };
    let high = if below(2, numbers) == 0 { 1e6 } else { 1.2 };
    let Some(&(name, of, size)) = QUANTITIES.get(place) else {
        let nothing = [0.0; 8];
        let plain = |constant, absent| Input { of: nothing, constant, absent, offset: 0.5, scale: 2.0, low, high };
        let described =
            |key: &str, value: Value| json!({ (key): value, "offset": 0.5, "scale": 2.0, "low": low, "high": high });
        return match place - QUANTITIES.len() {
            0 => (plain(1.4, None), described("constant", json!(1.4))),
            1 => (plain(1.0, None), described("quantity", json!("is_ahead"))),
            _ => (plain(1.0, Some(0.0)), described("quantity", json!("is_behind"))),
        };
    };
    let offset = size * numbers.unit();
    // Upside down, sometimes.
    let scale = if below(4, numbers) == 0 { -size } else { size };
    let absent = (name.contains("behind") && below(2, numbers) == 0).then(|| size * numbers.unit());
    let mut described = json!({ "quantity": name, "offset": offset, "scale": scale, "low": low, "high": high });
    if let Some(absent) = absent {
        described["absent"] = json!(absent);
    }
    (Input { of, constant: 0.0, absent, offset, scale, low, high }, described)
}

fn random_activation(width: usize, numbers: &mut Numbers) -> Each {
    let kind = below(9, numbers);
    let single = |number: f64| f64::from(number as f32);
    let mut operands = || -> Vec<f64> { (0..width).map(|_| single(numbers.signed())).collect() };
    match kind {
        0 => Each::Relu,
        1 => Each::LeakyRelu(single(operands()[0] * 0.5)),
        2 => Each::Elu(single(operands()[0].abs() + 0.1)),
        3 => Each::Tanh,
        4 => Each::Sigmoid,
        5 => Each::Add(operands()),
        6 => Each::Multiply(operands()),
        7 => Each::Divide(operands().into_iter().map(|operand| single(operand + 1.5)).collect()),
        _ => {
            let low = operands();
            Each::Clip { high: low.iter().map(|low| single(low + 0.7)).collect(), low }
        }
    }
}

fn network_file(actor: &Actor, inputs: Vec<Value>) -> Vec<u8> {
    let mut tensors: Vec<(String, Vec<usize>, &[f64])> = Vec::new();
    let mut steps = Vec::new();
    for (index, step) in actor.steps.iter().enumerate() {
        let mut add = |name: &str, shape: &[usize], numbers: _| {
            tensors.push((format!("steps.{index}.{name}"), shape.to_vec(), numbers));
        };
        steps.push(match step {
            Step::Linear(layer) => {
                add("weight", &[layer.inputs, layer.outputs], &layer.weights);
                add("bias", &[layer.outputs], &layer.biases);
                json!({ "linear": layer.outputs })
            }
            Step::Each(each) => match each {
                Each::Relu => json!("relu"),
                Each::LeakyRelu(slope) => json!({ "leaky-relu": slope }),
                Each::Elu(alpha) => json!({ "elu": alpha }),
                Each::Tanh => json!("tanh"),
                Each::Sigmoid => json!("sigmoid"),
                Each::Add(operands) => {
                    add("operand", &[operands.len()], operands);
                    json!("add")
                }
                Each::Multiply(operands) => {
                    add("operand", &[operands.len()], operands);
                    json!("multiply")
                }
                Each::Divide(operands) => {
                    add("operand", &[operands.len()], operands);
                    json!("divide")
                }
                Each::Clip { low, high } => {
                    add("low", &[low.len()], low);
                    add("high", &[high.len()], high);
                    json!("clip")
                }
            },
        });
    }
    let [low_mps2, high_mps2] = actor.action_mps2;
    let text = json!({
        "version": 1, "source": actor.source, "inputs": inputs, "steps": steps,
        "output": {
            "answer": actor.answer, "scale_mps2": actor.scale_mps2, "offset_mps2": actor.offset_mps2,
            "low_mps2": low_mps2, "high_mps2": high_mps2,
        },
        "empty_gap_m": actor.empty_gap_m, "decision_interval_s": actor.decision_interval_s,
    });
    file_of(&text, &tensors)
}

/// A file of a text and tensors: name, shape, numbers.
pub fn encode_file(text: &Value, tensors: &[(String, Vec<usize>, &[f64])]) -> Vec<u8> {
    let mut header = json!({ "__metadata__": { "crumple_network": text.to_string() } });
    let mut data = Vec::new();
    for &(ref name, ref shape, numbers) in tensors {
        let from = data.len();
        data.extend(numbers.iter().flat_map(|&number| (number as f32).to_le_bytes()));
        header[name] = json!({ "dtype": "F32", "shape": shape, "data_offsets": [from, data.len()] });
    }
    let header = header.to_string();
    [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &data].concat()
}
