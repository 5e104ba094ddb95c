//! Messages of an ONNX file that a chain needs, by the field numbers of `onnx.proto3`.

use std::collections::HashMap;
use std::rc::Rc;

use super::super::protobuf::{Message, WireValue};
use super::super::{MAX_PARAMETERS, NetworkError};

const MAX_PARTS: usize = 1000;

const MAX_DIMENSIONS: usize = 8;

pub(super) struct OnnxModel {
    pub(super) opset: i64,
    pub(super) nodes: Vec<OnnxNode>,
    pub(super) constants: HashMap<String, Rc<OnnxTensor>>,
    /// Inputs with their shapes; a batch, or a dimension without size, counts as 1.
    pub(super) inputs: Vec<(String, Option<Vec<usize>>)>,
    pub(super) outputs: Vec<String>,
}

#[derive(Default)]
pub(super) struct OnnxNode {
    pub(super) name: String,
    pub(super) operator: String,
    pub(super) domain: String,
    pub(super) inputs: Vec<String>,
    pub(super) outputs: Vec<String>,
    pub(super) attributes: HashMap<String, Attribute>,
}

#[derive(Default)]
pub(super) struct Attribute {
    pub(super) float: Option<f32>,
    pub(super) integer: Option<i64>,
    pub(super) integers: Vec<i64>,
    pub(super) floats: Vec<f32>,
    pub(super) tensor: Option<OnnxTensor>,
}

#[derive(Debug, Clone)]
pub(super) struct OnnxTensor {
    pub(super) shape: Vec<usize>,
    pub(super) data: TensorData,
}

#[derive(Debug, Clone)]
pub(super) enum TensorData {
    Float(Vec<f32>),
    Integer(Vec<i64>),
    /// Unsupported data, with the reason.
    Unsupported(String),
}

impl OnnxTensor {
    pub(super) fn floats(&self) -> Result<&[f32], String> {
        match &self.data {
            TensorData::Float(numbers) => Ok(numbers),
            TensorData::Integer(_) => {
                Err("holds integers where floating-point numbers are expected".to_owned())
            }
            TensorData::Unsupported(why) => Err(why.clone()),
        }
    }
}

fn damaged(problem: impl Into<String>) -> NetworkError {
    NetworkError::damaged("ONNX file", problem)
}

impl OnnxModel {
    pub(super) fn read(bytes: &[u8]) -> Result<Self, NetworkError> {
        let (mut opset, mut graph) = (None, None);
        let mut rest = Message(bytes);
        while let Some((field, value)) = rest.next_field()? {
            match field {
                7 => graph = Some(value.bytes()?),
                8 => opset = parse_opset(value.bytes()?)?.or(opset),
                _ => {}
            }
        }
        let opset = opset.ok_or_else(|| damaged("it does not state its opset"))?;
        let graph = graph.ok_or_else(|| damaged("it holds no graph"))?;
        let mut model = Self {
            opset,
            nodes: Vec::new(),
            constants: HashMap::new(),
            inputs: Vec::new(),
            outputs: Vec::new(),
        };
        let mut numbers = 0;
        let mut rest = Message(graph);
        while let Some((field, value)) = rest.next_field()? {
            match field {
                1 => model.nodes.push(OnnxNode::read(value.bytes()?)?),
                5 => {
                    let (name, tensor) = parse_tensor(value.bytes()?)?;
                    if let TensorData::Float(held) = &tensor.data {
                        numbers += held.len();
                    }
                    if numbers > MAX_PARAMETERS {
                        return Err(NetworkError::TooManyParameters);
                    }
                    model.constants.insert(name, Rc::new(tensor));
                }
                11 => model.inputs.push(parse_value_info(value.bytes()?)?),
                12 => model.outputs.push(parse_value_info(value.bytes()?)?.0),
                15 => {
                    return Err(NetworkError::Unsupported(
                        "the graph has a sparse constant, which is not supported".to_owned(),
                    ));
                }
                _ => {}
            }
            let parts = [
                model.nodes.len(),
                model.constants.len(),
                model.inputs.len(),
                model.outputs.len(),
            ];
            if parts.iter().any(|&parts| parts > MAX_PARTS) {
                let problem = format!(
                    "the graph has more than {MAX_PARTS} nodes, constants, inputs or outputs"
                );
                return Err(NetworkError::Unsupported(problem));
            }
        }
        Ok(model)
    }
}

fn parse_opset(bytes: &[u8]) -> Result<Option<i64>, NetworkError> {
    let (mut domain, mut version) = (String::new(), 0);
    let mut rest = Message(bytes);
    while let Some((field, value)) = rest.next_field()? {
        match field {
            1 => domain = value.text()?,
            2 => version = value.integer()?,
            _ => {}
        }
    }
    Ok(is_default_domain(&domain).then_some(version))
}

pub(super) fn is_default_domain(domain: &str) -> bool {
    domain.is_empty() || domain == "ai.onnx"
}

impl OnnxNode {
    fn read(bytes: &[u8]) -> Result<Self, NetworkError> {
        let mut node = Self::default();
        let mut rest = Message(bytes);
        while let Some((field, value)) = rest.next_field()? {
            match field {
                1 => node.inputs.push(value.text()?),
                2 => node.outputs.push(value.text()?),
                3 => node.name = value.text()?,
                4 => node.operator = value.text()?,
                5 => {
                    let (name, attribute) = parse_attribute(value.bytes()?)?;
                    node.attributes.insert(name, attribute);
                }
                7 => node.domain = value.text()?,
                _ => {}
            }
            if node
                .inputs
                .len()
                .max(node.outputs.len())
                .max(node.attributes.len())
                > MAX_PARTS
            {
                return Err(damaged(format!(
                    "a node of more than {MAX_PARTS} inputs, outputs or attributes"
                )));
            }
        }
        Ok(node)
    }
}

fn parse_attribute(bytes: &[u8]) -> Result<(String, Attribute), NetworkError> {
    let (mut name, mut attribute) = (String::new(), Attribute::default());
    let mut rest = Message(bytes);
    while let Some((field, value)) = rest.next_field()? {
        match field {
            1 => name = value.text()?,
            2 => attribute.float = Some(value.float()?),
            3 => attribute.integer = Some(value.integer()?),
            5 => attribute.tensor = Some(parse_tensor(value.bytes()?)?.1),
            7 => value.floats(&mut attribute.floats)?,
            8 => value.integers(&mut attribute.integers)?,
            _ => {}
        }
    }
    Ok((name, attribute))
}

fn parse_tensor(bytes: &[u8]) -> Result<(String, OnnxTensor), NetworkError> {
    let (mut name, mut dims, mut kind) = (String::new(), Vec::new(), 0);
    let (mut reals, mut wholes, mut raw, mut is_elsewhere) = (Vec::new(), Vec::new(), None, false);
    let mut rest = Message(bytes);
    while let Some((field, value)) = rest.next_field()? {
        match field {
            1 => value.integers(&mut dims)?,
            2 => kind = value.integer()?,
            4 => value.floats(&mut reals)?,
            7 => value.integers(&mut wholes)?,
            8 => name = value.text()?,
            9 => raw = Some(value.bytes()?),
            10 => value.doubles(&mut reals)?,
            13 => is_elsewhere = true,
            14 => is_elsewhere |= value.integer()? != 0,
            _ => {}
        }
    }
    let shape: Option<Vec<usize>> = dims.iter().map(|&dim| usize::try_from(dim).ok()).collect();
    let shape = shape.filter(|shape| shape.len() <= MAX_DIMENSIONS);
    let count = shape.as_ref().and_then(|shape| {
        shape
            .iter()
            .try_fold(1_usize, |count, &dim| count.checked_mul(dim))
    });
    let (Some(shape), Some(count)) = (shape, count) else {
        return Err(damaged(format!("constant `{name}` has an invalid shape")));
    };
    let numbers = match (kind, raw) {
        _ if is_elsewhere => TensorData::Unsupported(
            "is stored in another file, which is not supported: save the model in one file (PyTorch: \
                external_data=False)"
                .to_owned(),
        ),
        (1 | 11, None) => TensorData::Float(reals),
        (1 | 11, Some(raw)) => {
            let append = if kind == 1 { WireValue::floats } else { WireValue::doubles };
            let mut numbers = Vec::new();
            append(WireValue::Bytes(raw), &mut numbers)?;
            TensorData::Float(numbers)
        }
        (7, None) => TensorData::Integer(wholes),
        (7, Some(raw)) => {
            let (values, _) = raw.as_chunks::<8>();
            TensorData::Integer(values.iter().map(|&bytes| i64::from_le_bytes(bytes)).collect())
        }
        (other, _) => TensorData::Unsupported(format!(
            "holds numbers of kind {other}, of which 1 (single) and 11 (double precision) are read"
        )),
    };
    let found = match &numbers {
        TensorData::Float(numbers) => numbers.len(),
        TensorData::Integer(numbers) => numbers.len(),
        TensorData::Unsupported(_) => count,
    };
    if found != count {
        let problem = format!("constant `{name}` of shape {shape:?} holds {found} numbers");
        return Err(damaged(problem));
    }
    Ok((
        name,
        OnnxTensor {
            shape,
            data: numbers,
        },
    ))
}

fn parse_value_info(bytes: &[u8]) -> Result<(String, Option<Vec<usize>>), NetworkError> {
    let (mut name, mut shape) = (String::new(), None);
    let mut rest = Message(bytes);
    while let Some((field, value)) = rest.next_field()? {
        match field {
            1 => name = value.text()?,
            // The type of a tensor, which contains its shape.
            2 => {
                let tensor = find_field(value.bytes()?, 1)?;
                let message = tensor
                    .map(|tensor| find_field(tensor, 2))
                    .transpose()?
                    .flatten();
                shape = message.map(parse_dimensions).transpose()?;
            }
            _ => {}
        }
    }
    Ok((name, shape))
}

fn find_field(bytes: &[u8], wanted: u64) -> Result<Option<&[u8]>, NetworkError> {
    let mut rest = Message(bytes);
    while let Some((field, value)) = rest.next_field()? {
        if field == wanted {
            return value.bytes().map(Some);
        }
    }
    Ok(None)
}

fn parse_dimensions(bytes: &[u8]) -> Result<Vec<usize>, NetworkError> {
    let mut all = Vec::new();
    let mut rest = Message(bytes);
    while let Some((field, value)) = rest.next_field()? {
        if field != 1 {
            continue;
        }
        let mut size = 1;
        let mut dimension = Message(value.bytes()?);
        while let Some((field, value)) = dimension.next_field()? {
            if field == 1 {
                size = usize::try_from(value.integer()?).unwrap_or(1).max(1);
            }
        }
        if all.len() == MAX_DIMENSIONS {
            return Err(damaged(format!(
                "an input of more than {MAX_DIMENSIONS} dimensions"
            )));
        }
        all.push(size);
    }
    Ok(all)
}
