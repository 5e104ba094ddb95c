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
        let mut opset = None;
        let mut graph = None;
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
        model.read_graph(graph)?;
        Ok(model)
    }

    fn read_graph(&mut self, graph: &[u8]) -> Result<(), NetworkError> {
        let mut parameters = 0;
        let mut rest = Message(graph);
        while let Some((field, value)) = rest.next_field()? {
            match field {
                1 => self.nodes.push(OnnxNode::read(value.bytes()?)?),
                5 => {
                    let constant = NamedTensor::read(value.bytes()?)?;
                    if let TensorData::Float(numbers) = &constant.tensor.data {
                        parameters += numbers.len();
                    }
                    if parameters > MAX_PARAMETERS {
                        return Err(NetworkError::TooManyParameters);
                    }
                    self.constants
                        .insert(constant.name, Rc::new(constant.tensor));
                }
                11 => self.inputs.push(parse_value_info(value.bytes()?)?),
                12 => self.outputs.push(parse_value_info(value.bytes()?)?.0),
                15 => {
                    return Err(NetworkError::Unsupported(
                        "the graph has a sparse constant, which is not supported".to_owned(),
                    ));
                }
                _ => {}
            }
            self.check_size()?;
        }
        Ok(())
    }

    fn check_size(&self) -> Result<(), NetworkError> {
        let parts = [
            self.nodes.len(),
            self.constants.len(),
            self.inputs.len(),
            self.outputs.len(),
        ];
        if parts.iter().any(|&parts| parts > MAX_PARTS) {
            let problem =
                format!("the graph has more than {MAX_PARTS} nodes, constants, inputs or outputs");
            return Err(NetworkError::Unsupported(problem));
        }
        Ok(())
    }
}

fn parse_opset(bytes: &[u8]) -> Result<Option<i64>, NetworkError> {
    let mut domain = String::new();
    let mut version = 0;
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
                5 => node.attributes.extend([parse_attribute(value.bytes()?)?]),
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
    let mut name = String::new();
    let mut attribute = Attribute::default();
    let mut rest = Message(bytes);
    while let Some((field, value)) = rest.next_field()? {
        match field {
            1 => name = value.text()?,
            2 => attribute.float = Some(value.float()?),
            3 => attribute.integer = Some(value.integer()?),
            5 => attribute.tensor = Some(NamedTensor::read(value.bytes()?)?.tensor),
            7 => value.floats(&mut attribute.floats)?,
            8 => value.integers(&mut attribute.integers)?,
            _ => {}
        }
    }
    Ok((name, attribute))
}

struct NamedTensor {
    name: String,
    tensor: OnnxTensor,
}

impl NamedTensor {
    fn read(bytes: &[u8]) -> Result<Self, NetworkError> {
        let message = TensorMessage::read(bytes)?;
        let Some((shape, count)) = message.shape_and_count() else {
            let problem = format!("constant `{}` has an invalid shape", message.name);
            return Err(damaged(problem));
        };
        let name = message.name.clone();
        let data = message.into_data()?;
        let dtype = match &data {
            TensorData::Float(numbers) => numbers.len(),
            TensorData::Integer(numbers) => numbers.len(),
            TensorData::Unsupported(_) => count,
        };
        if dtype != count {
            let problem = format!("constant `{name}` of shape {shape:?} holds {dtype} numbers");
            return Err(damaged(problem));
        }
        Ok(Self {
            name,
            tensor: OnnxTensor { shape, data },
        })
    }
}

/// Fields of a tensor message, whose numbers are in one of three fields.
#[derive(Default)]
struct TensorMessage<'a> {
    name: String,
    dimensions: Vec<i64>,
    kind: i64,
    floats: Vec<f32>,
    integers: Vec<i64>,
    raw: Option<&'a [u8]>,
    is_in_other_file: bool,
}

impl<'a> TensorMessage<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, NetworkError> {
        let mut message = Self::default();
        let mut rest = Message(bytes);
        while let Some((field, value)) = rest.next_field()? {
            match field {
                1 => value.integers(&mut message.dimensions)?,
                2 => message.kind = value.integer()?,
                4 => value.floats(&mut message.floats)?,
                7 => value.integers(&mut message.integers)?,
                8 => message.name = value.text()?,
                9 => message.raw = Some(value.bytes()?),
                10 => value.doubles(&mut message.floats)?,
                13 => message.is_in_other_file = true,
                14 => message.is_in_other_file |= value.integer()? != 0,
                _ => {}
            }
        }
        Ok(message)
    }

    /// Returns the shape and its number of elements, if they are valid.
    fn shape_and_count(&self) -> Option<(Vec<usize>, usize)> {
        let sizes = self
            .dimensions
            .iter()
            .map(|&size| usize::try_from(size).ok());
        let shape = sizes.collect::<Option<Vec<usize>>>()?;
        let count = shape
            .iter()
            .try_fold(1_usize, |count, &size| count.checked_mul(size))?;
        (shape.len() <= MAX_DIMENSIONS).then_some((shape, count))
    }

    fn into_data(self) -> Result<TensorData, NetworkError> {
        if self.is_in_other_file {
            return Ok(TensorData::Unsupported(
                "is stored in another file, which is not supported: save the model in one file (PyTorch: \
                 external_data=False)"
                    .to_owned(),
            ));
        }
        Ok(match (self.kind, self.raw) {
            (1 | 11, None) => TensorData::Float(self.floats),
            (1 | 11, Some(raw)) => {
                let mut numbers = Vec::new();
                match self.kind {
                    1 => WireValue::Bytes(raw).floats(&mut numbers)?,
                    _ => WireValue::Bytes(raw).doubles(&mut numbers)?,
                }
                TensorData::Float(numbers)
            }
            (7, None) => TensorData::Integer(self.integers),
            (7, Some(raw)) => {
                let integers = raw.as_chunks::<8>().0.iter();
                TensorData::Integer(integers.map(|&bytes| i64::from_le_bytes(bytes)).collect())
            }
            (other, _) => TensorData::Unsupported(format!(
                "holds numbers of kind {other}, of which 1 (single) and 11 (double precision) are read"
            )),
        })
    }
}

fn parse_value_info(bytes: &[u8]) -> Result<(String, Option<Vec<usize>>), NetworkError> {
    let mut name = String::new();
    let mut shape = None;
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
    let mut sizes = Vec::new();
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
        if sizes.len() == MAX_DIMENSIONS {
            return Err(damaged(format!(
                "an input of more than {MAX_DIMENSIONS} dimensions"
            )));
        }
        sizes.push(size);
    }
    Ok(sizes)
}
