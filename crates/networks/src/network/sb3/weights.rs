//! Tensors of a policy, from PyTorch's archive with a pickle and one member per storage.

use std::cell::Cell;

use super::super::archive::Archive;
use super::super::pickle::{Object, Pickle, ValueId};
use super::super::{Linear, MAX_PARAMETERS, NetworkError};

const MAX_LAYERS: usize = 64;

pub(super) struct Weights<'a> {
    archive: Archive<'a>,
    folder: String,
    pickle: Pickle<'a>,
    parameter_count: Cell<usize>,
}

struct TensorLayout<'p> {
    storage: &'p [ValueId],
    offset: usize,
    shape: Vec<usize>,
    strides: Vec<usize>,
}

/// A tensor with its numbers in row-major order.
struct Tensor {
    shape: Vec<usize>,
    numbers: Vec<f32>,
}

fn damaged(problem: impl Into<String>) -> NetworkError {
    NetworkError::damaged("member `policy.pth`", problem)
}

/// True for files of PyTorch before 1.6: pickles, the first of which is the number 0x1950a86a20f9469cfc6c.
pub(super) fn is_legacy(bytes: &[u8]) -> bool {
    /// Opcode of a long integer, its length and its bytes; protocol and perhaps a frame precede it.
    const MAGIC: [u8; 12] = *b"\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19";
    bytes.first() == Some(&0x80)
        && bytes
            .get(..32)
            .unwrap_or(bytes)
            .windows(MAGIC.len())
            .any(|window| window == MAGIC)
}

pub(super) fn legacy_error(part: &str) -> NetworkError {
    NetworkError::Unsupported(format!(
        "{part} in the format of PyTorch before 1.6, which is not a zip archive: load the model with Stable-Baselines3 \
         and PyTorch 1.6 or later, and save it again, as in `PPO.load(\"old\").save(\"new\")`"
    ))
}

impl<'a> Weights<'a> {
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, NetworkError> {
        if is_legacy(bytes) {
            return Err(legacy_error("its weights, `policy.pth`, are"));
        }
        let archive = Archive::read(bytes)?;
        let name = archive.only_member_with_suffix("/data.pkl")?.to_owned();
        let folder = name.strip_suffix("data.pkl").unwrap_or_default().to_owned();
        if archive.has_member_with_suffix("/byteorder")
            && archive.member(&format!("{folder}byteorder"))? != b"little"
        {
            return Err(NetworkError::Unsupported(
                "its numbers are big-endian, which is not supported".to_owned(),
            ));
        }
        let pickle = Pickle::read(archive.member(&name)?)?;
        if pickle.entries(pickle.top).is_none() {
            return Err(damaged("it holds no tensors by name"));
        }
        Ok(Self {
            archive,
            folder,
            pickle,
            parameter_count: Cell::new(0),
        })
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.pickle.entry(self.pickle.top, name).is_some()
    }

    /// True if a tensor name contains `part`.
    pub(super) fn has_part(&self, part: &str) -> bool {
        let names = self
            .pickle
            .entries(self.pickle.top)
            .unwrap_or_default()
            .iter();
        names
            .filter_map(|(name, _)| self.pickle.text(*name))
            .any(|name| name.contains(part))
    }

    /// Returns the layers of a sequence, with one activation after each: `NAME.0`, `NAME.2`, and so on.
    pub(super) fn sequential_layers(&self, name: &str) -> Result<Vec<Linear>, NetworkError> {
        let mut layers = Vec::new();
        while layers.len() < MAX_LAYERS && self.has(&format!("{name}.{}.weight", 2 * layers.len()))
        {
            layers.push(self.linear_layer(&format!("{name}.{}", 2 * layers.len()))?);
        }
        let prefix = format!("{name}.");
        let entries = self
            .pickle
            .entries(self.pickle.top)
            .unwrap_or_default()
            .iter();
        let tensors = entries
            .filter_map(|(name, _)| self.pickle.text(*name))
            .filter(|name| name.starts_with(&prefix))
            .count();
        if tensors == 2 * layers.len() {
            Ok(layers)
        } else {
            let problem =
                format!("`{name}` has layers that are neither fully connected nor activations");
            Err(NetworkError::Unsupported(problem))
        }
    }

    pub(super) fn linear_layer(&self, name: &str) -> Result<Linear, NetworkError> {
        let weights = self.tensor(&format!("{name}.weight"))?;
        let biases = self.tensor(&format!("{name}.bias"))?;
        let [outputs, inputs] = *weights.shape else {
            return Err(damaged(format!("`{name}` is not a fully connected layer")));
        };
        let [bias_count] = *biases.shape else {
            return Err(damaged(format!("`{name}` is not a fully connected layer")));
        };
        if outputs != bias_count {
            return Err(damaged(format!(
                "`{name}` has {bias_count} biases for {outputs} outputs"
            )));
        }
        let by_output = weights.numbers;
        let weights = (0..inputs)
            .flat_map(|input| by_output.iter().skip(input).step_by(inputs).copied())
            .collect();
        Ok(Linear {
            weights,
            biases: biases.numbers,
        })
    }

    fn tensor(&self, name: &str) -> Result<Tensor, NetworkError> {
        let id = self
            .pickle
            .entry(self.pickle.top, name)
            .ok_or_else(|| damaged(format!("it has no tensor `{name}`")))?;
        let layout = self
            .tensor_layout(id)
            .ok_or_else(|| damaged(format!("`{name}` is not a tensor")))?;
        let [_, kind, key, ..] = layout.storage else {
            return Err(damaged(format!("`{name}` lies nowhere")));
        };
        let precision = match self.pickle.global(*kind) {
            Some(("torch", "FloatStorage")) => Precision::Single,
            Some(("torch", "DoubleStorage")) => Precision::Double,
            _ => {
                return Err(damaged(format!(
                    "`{name}` is of neither single nor double precision"
                )));
            }
        };
        let key = self
            .pickle
            .text(*key)
            .ok_or_else(|| damaged(format!("`{name}` lies nowhere")))?;
        let count = self.reserve_parameters(&layout.shape)?;
        let bytes = self.archive.member(&format!("{}data/{key}", self.folder))?;
        let numbers: Option<Vec<f32>> = (0..count)
            .map(|index| precision.number(bytes, layout.storage_index(index)?))
            .collect();
        let numbers =
            numbers.ok_or_else(|| damaged(format!("`{name}` is larger than what it lies in")))?;
        Ok(Tensor {
            shape: layout.shape,
            numbers,
        })
    }

    /// Counts the numbers of a tensor, and returns them. All tensors together have at most `MAX_PARAMETERS`.
    fn reserve_parameters(&self, shape: &[usize]) -> Result<usize, NetworkError> {
        let count = shape
            .iter()
            .try_fold(1_usize, |count, &size| count.checked_mul(size));
        let Some(count) = count
            .filter(|count| self.parameter_count.get().saturating_add(*count) <= MAX_PARAMETERS)
        else {
            return Err(NetworkError::TooManyParameters);
        };
        self.parameter_count.set(self.parameter_count.get() + count);
        Ok(count)
    }

    /// Parses a call of PyTorch's tensor function: storage, offset, shape and strides.
    fn tensor_layout(&self, id: ValueId) -> Option<TensorLayout<'_>> {
        let call = self.pickle.call(id)?;
        if self.pickle.global(call.callee)? != ("torch._utils", "_rebuild_tensor_v2") {
            return None;
        }
        let [storage, offset, shape, strides, ..] = self.pickle.tuple(call.arguments)? else {
            return None;
        };
        let Object::PersistentId(storage) = self.pickle.get(*storage) else {
            return None;
        };
        let shape = self.sizes(*shape)?;
        let strides = self.sizes(*strides)?;
        let fits = shape.len() == strides.len();
        fits.then_some(TensorLayout {
            storage: self.pickle.tuple(*storage)?,
            offset: self.size(*offset)?,
            shape,
            strides,
        })
    }

    fn sizes(&self, tuple: ValueId) -> Option<Vec<usize>> {
        let members = self.pickle.tuple(tuple)?.iter();
        members.map(|member| self.size(*member)).collect()
    }

    fn size(&self, id: ValueId) -> Option<usize> {
        usize::try_from(self.pickle.integer(id)?).ok()
    }
}

/// Precision of the numbers of a storage.
#[derive(Clone, Copy)]
enum Precision {
    Single,
    Double,
}

impl Precision {
    /// Returns number `index` of a storage; `None` after its end.
    fn number(self, storage: &[u8], index: usize) -> Option<f32> {
        match self {
            Self::Single => {
                let bytes = number_bytes(storage, index)?;
                Some(f32::from_le_bytes(bytes))
            }
            Self::Double => {
                let bytes = number_bytes(storage, index)?;
                Some(f64::from_le_bytes(bytes) as f32)
            }
        }
    }
}

fn number_bytes<const N: usize>(storage: &[u8], index: usize) -> Option<[u8; N]> {
    let start = index.checked_mul(N)?;
    storage.get(start..start.checked_add(N)?)?.try_into().ok()
}

impl TensorLayout<'_> {
    fn storage_index(&self, mut index: usize) -> Option<usize> {
        let mut storage_index = self.offset;
        for (&size, &stride) in self.shape.iter().zip(&self.strides).rev() {
            storage_index = storage_index.checked_add((index % size).checked_mul(stride)?)?;
            index /= size;
        }
        Some(storage_index)
    }
}
