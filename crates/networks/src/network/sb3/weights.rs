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

pub(super) fn legacy_error(what: &str) -> NetworkError {
    NetworkError::Unsupported(format!(
        "{what} in the format of PyTorch before 1.6, which is not a zip archive: load the model with Stable-Baselines3 \
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
        let own = self
            .pickle
            .entries(self.pickle.top)
            .unwrap_or_default()
            .iter();
        let found = own
            .filter_map(|(name, _)| self.pickle.text(*name))
            .filter(|name| name.starts_with(&prefix))
            .count();
        if found == 2 * layers.len() {
            Ok(layers)
        } else {
            let problem =
                format!("`{name}` has layers that are neither fully connected nor activations");
            Err(NetworkError::Unsupported(problem))
        }
    }

    pub(super) fn linear_layer(&self, name: &str) -> Result<Linear, NetworkError> {
        let (shape, by_output) = self.tensor(&format!("{name}.weight"))?;
        let (bias_shape, biases) = self.tensor(&format!("{name}.bias"))?;
        let ([outputs, inputs], [bias_count]) = (shape.as_slice(), bias_shape.as_slice()) else {
            return Err(damaged(format!("`{name}` is not a fully connected layer")));
        };
        if outputs != bias_count {
            return Err(damaged(format!(
                "`{name}` has {bias_count} biases for {outputs} outputs"
            )));
        }
        let weights = (0..*inputs)
            .flat_map(|input| by_output.iter().skip(input).step_by(*inputs).copied())
            .collect();
        Ok(Linear { weights, biases })
    }

    /// Returns a tensor's shape, and its numbers in row-major order.
    fn tensor(&self, name: &str) -> Result<(Vec<usize>, Vec<f32>), NetworkError> {
        let missing = || damaged(format!("it has no tensor `{name}`"));
        let id = self
            .pickle
            .entry(self.pickle.top, name)
            .ok_or_else(missing)?;
        let tensor = self
            .tensor_layout(id)
            .ok_or_else(|| damaged(format!("`{name}` is not a tensor")))?;
        let [_, kind, key, ..] = tensor.storage else {
            return Err(damaged(format!("`{name}` lies nowhere")));
        };
        let size = match self.pickle.global(*kind) {
            Some(("torch", "FloatStorage")) => 4,
            Some(("torch", "DoubleStorage")) => 8,
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
        let count = tensor
            .shape
            .iter()
            .try_fold(1_usize, |count, &size| count.checked_mul(size));
        let Some(count) = count
            .filter(|count| self.parameter_count.get().saturating_add(*count) <= MAX_PARAMETERS)
        else {
            return Err(NetworkError::TooManyParameters);
        };
        self.parameter_count.set(self.parameter_count.get() + count);
        let bytes = self.archive.member(&format!("{}data/{key}", self.folder))?;
        let number = |index: usize| {
            let at = tensor.storage_index(index)?.checked_mul(size)?;
            let bytes = bytes.get(at..at.checked_add(size)?)?;
            Some(match size {
                4 => f32::from_le_bytes(bytes.try_into().ok()?),
                _ => f64::from_le_bytes(bytes.try_into().ok()?) as f32,
            })
        };
        let numbers: Option<Vec<f32>> = (0..count).map(number).collect();
        let numbers =
            numbers.ok_or_else(|| damaged(format!("`{name}` is larger than what it lies in")))?;
        Ok((tensor.shape, numbers))
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
        let size = |id: &ValueId| usize::try_from(self.pickle.integer(*id)?).ok();
        let shape: Vec<usize> = self
            .pickle
            .tuple(*shape)?
            .iter()
            .map(size)
            .collect::<Option<_>>()?;
        let strides: Vec<usize> = self
            .pickle
            .tuple(*strides)?
            .iter()
            .map(size)
            .collect::<Option<_>>()?;
        let fits = shape.len() == strides.len();
        fits.then_some(TensorLayout {
            storage: self.pickle.tuple(*storage)?,
            offset: size(offset)?,
            shape,
            strides,
        })
    }
}

impl TensorLayout<'_> {
    fn storage_index(&self, mut index: usize) -> Option<usize> {
        let mut place = self.offset;
        for (&size, &stride) in self.shape.iter().zip(&self.strides).rev() {
            place = place.checked_add((index % size).checked_mul(stride)?)?;
            index /= size;
        }
        Some(place)
    }
}
