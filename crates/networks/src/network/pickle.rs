//! Reader of pickles that calls nothing.
//!
//! A pickle is a program that may call anything. This reader only records the calls; it imports and calls nothing.
//! Values are in one list and refer to each other by index, so that nesting may be deep or circular.

use std::collections::HashMap;

use super::NetworkError;

const MAX_VALUES: usize = 200_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ValueId(usize);

#[derive(Debug, Clone)]
pub(super) enum Object<'a> {
    None,
    Bool(bool),
    Integer(i64),
    Float(f64),
    Text(&'a str),
    Bytes(&'a [u8]),
    Tuple(Vec<ValueId>),
    List(Vec<ValueId>),
    /// Dictionary, in insertion order.
    Dict(Vec<(ValueId, ValueId)>),
    /// Global name: module and name.
    Global(&'a str, &'a str),
    /// Recorded call.
    Call(Call),
    PersistentId(ValueId),
}

/// A recorded call, and the changes of its result.
#[derive(Debug, Clone)]
pub(super) struct Call {
    pub(super) callee: ValueId,
    pub(super) arguments: ValueId,
    pub(super) state: Option<ValueId>,
    pub(super) items: Vec<(ValueId, ValueId)>,
}

pub(super) struct Pickle<'a> {
    values: Vec<Object<'a>>,
    pub(super) top: ValueId,
}

impl<'a> Pickle<'a> {
    /// Reads a pickle of protocol 2 to 5.
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, NetworkError> {
        let mut machine = Machine {
            rest: bytes,
            length: bytes.len(),
            ..Machine::default()
        };
        let top = machine.run()?;
        Ok(Self {
            values: machine.values,
            top,
        })
    }

    pub(super) fn get(&self, id: ValueId) -> &Object<'a> {
        self.values.get(id.0).unwrap_or(&Object::None)
    }

    pub(super) fn text(&self, id: ValueId) -> Option<&'a str> {
        if let Object::Text(text) = self.get(id) {
            Some(text)
        } else {
            None
        }
    }

    pub(super) fn integer(&self, id: ValueId) -> Option<i64> {
        if let Object::Integer(integer) = self.get(id) {
            Some(*integer)
        } else {
            None
        }
    }

    pub(super) fn boolean(&self, id: ValueId) -> Option<bool> {
        if let Object::Bool(truth) = self.get(id) {
            Some(*truth)
        } else {
            None
        }
    }

    pub(super) fn number(&self, id: ValueId) -> Option<f64> {
        match self.get(id) {
            Object::Float(number) => Some(*number),
            Object::Integer(integer) => Some(*integer as f64),
            _ => None,
        }
    }

    pub(super) fn tuple(&self, id: ValueId) -> Option<&[ValueId]> {
        if let Object::Tuple(members) = self.get(id) {
            Some(members)
        } else {
            None
        }
    }

    pub(super) fn global(&self, id: ValueId) -> Option<(&'a str, &'a str)> {
        if let Object::Global(module, name) = self.get(id) {
            Some((module, name))
        } else {
            None
        }
    }

    pub(super) fn call(&self, id: ValueId) -> Option<&Call> {
        if let Object::Call(call) = self.get(id) {
            Some(call)
        } else {
            None
        }
    }

    /// Returns the entries of a dictionary, ordered or not.
    pub(super) fn entries(&self, id: ValueId) -> Option<&[(ValueId, ValueId)]> {
        match self.get(id) {
            Object::Dict(entries) => Some(entries),
            Object::Call(call)
                if self.global(call.callee) == Some(("collections", "OrderedDict")) =>
            {
                Some(&call.items)
            }
            _ => None,
        }
    }

    /// Returns the last entry of a dictionary under a key.
    pub(super) fn entry(&self, id: ValueId, key: &str) -> Option<ValueId> {
        self.entries(id)?
            .iter()
            .rev()
            .find(|(name, _)| self.text(*name) == Some(key))
            .map(|(_, value)| *value)
    }
}

#[derive(Default)]
struct Machine<'a> {
    rest: &'a [u8],
    length: usize,
    values: Vec<Object<'a>>,
    stack: Vec<ValueId>,
    marks: Vec<usize>,
    memo: HashMap<usize, ValueId>,
}

fn damaged(problem: impl Into<String>) -> NetworkError {
    NetworkError::damaged("pickle", problem)
}

impl<'a> Machine<'a> {
    fn run(&mut self) -> Result<ValueId, NetworkError> {
        loop {
            let at = self.length - self.rest.len();
            let [operation] = self.take_array()?;
            if operation == b'.' {
                return self.pop();
            }
            self.step(operation).map_err(|error| match error {
                NetworkError::Damaged { format, problem } => NetworkError::Damaged {
                    format,
                    problem: format!("{problem} (at byte {at})"),
                },
                other => other,
            })?;
        }
    }

    fn step(&mut self, operation: u8) -> Result<(), NetworkError> {
        match operation {
            // Protocol and frame headers.
            0x80 => self.take_array::<1>().map(drop),
            0x95 => self.take_array::<8>().map(drop),
            b'(' => {
                self.marks.push(self.stack.len());
                Ok(())
            }
            b'0' => self.pop().map(drop),
            b'N' => self.push(Object::None),
            0x88 | 0x89 => self.push(Object::Bool(operation == 0x88)),
            b'J' => {
                let bytes = self.take_array()?;
                self.push(Object::Integer(i32::from_le_bytes(bytes).into()))
            }
            b'K' => self.unsigned(1),
            b'M' => self.unsigned(2),
            0x8a => self.long(),
            b'G' => {
                let bytes = self.take_array()?;
                self.push(Object::Float(f64::from_be_bytes(bytes)))
            }
            b'X' => self.text(4),
            0x8c => self.text(1),
            0x8d => self.text(8),
            b'B' => self.bytes(4),
            b'C' => self.bytes(1),
            0x8e | 0x96 => self.bytes(8),
            b'}' => self.push(Object::Dict(Vec::new())),
            b']' => self.push(Object::List(Vec::new())),
            b')' => self.push(Object::Tuple(Vec::new())),
            b't' => self.collect_to_mark(Object::Tuple),
            b'l' => self.collect_to_mark(Object::List),
            0x85..=0x87 => self.tuple(usize::from(operation - 0x84)),
            b'c' => self.global(),
            0x93 => self.global_from_stack(),
            b'R' | 0x81 => self.record_call(),
            b'b' => self.set_state(),
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.set_items(&[key, value])
            }
            b'u' => {
                let members = self.pop_to_mark()?;
                self.set_items(&members)
            }
            b'a' => {
                let member = self.pop()?;
                self.append(&[member])
            }
            b'e' => {
                let members = self.pop_to_mark()?;
                self.append(&members)
            }
            b'q' => self.memoize_under_argument(1),
            b'r' => self.memoize_under_argument(4),
            0x94 => self.memoize(self.memo.len()),
            b'h' => self.get_memo(1),
            b'j' => self.get_memo(4),
            b'Q' => {
                let description = self.pop()?;
                self.push(Object::PersistentId(description))
            }
            other => Err(damaged(format!(
                "the operation {other:#04x}, which is not supported"
            ))),
        }
    }

    /// Pushes an unsigned integer of some bytes.
    fn unsigned(&mut self, bytes: usize) -> Result<(), NetworkError> {
        let number = self.take_uint(bytes)?;
        self.push(Object::Integer(number.cast_signed()))
    }

    /// Pushes a tuple or list of the values after the last mark.
    fn collect_to_mark(
        &mut self,
        collection: fn(Vec<ValueId>) -> Object<'a>,
    ) -> Result<(), NetworkError> {
        let members = self.pop_to_mark()?;
        self.push(collection(members))
    }

    /// Pushes a tuple of the topmost values.
    fn tuple(&mut self, count: usize) -> Result<(), NetworkError> {
        let from = self
            .stack
            .len()
            .checked_sub(count)
            .ok_or_else(|| damaged("an empty stack"))?;
        let members = self.stack.split_off(from);
        self.push(Object::Tuple(members))
    }

    fn global(&mut self) -> Result<(), NetworkError> {
        let module = self.take_line()?;
        let name = self.take_line()?;
        self.push(Object::Global(module, name))
    }

    fn global_from_stack(&mut self) -> Result<(), NetworkError> {
        let name = self.pop()?;
        let module = self.pop()?;
        match (self.values.get(module.0), self.values.get(name.0)) {
            (Some(Object::Text(module)), Some(Object::Text(name))) => {
                let global = Object::Global(module, name);
                self.push(global)
            }
            _ => Err(damaged("a name that is not text")),
        }
    }

    /// Records a call instead of executing it.
    fn record_call(&mut self) -> Result<(), NetworkError> {
        let arguments = self.pop()?;
        let callee = self.pop()?;
        self.push(Object::Call(Call {
            callee,
            arguments,
            state: None,
            items: Vec::new(),
        }))
    }

    fn set_state(&mut self) -> Result<(), NetworkError> {
        let state = self.pop()?;
        let top = self.top()?;
        match self.values.get_mut(top.0) {
            Some(Object::Call(call)) => {
                call.state = Some(state);
                Ok(())
            }
            _ => Err(damaged("a state for an object without one")),
        }
    }

    fn take_array<const N: usize>(&mut self) -> Result<[u8; N], NetworkError> {
        let (bytes, rest) = self
            .rest
            .split_first_chunk()
            .ok_or_else(|| damaged("it is cut off"))?;
        self.rest = rest;
        Ok(*bytes)
    }

    fn take_uint(&mut self, bytes: usize) -> Result<u64, NetworkError> {
        let (number, rest) = self
            .rest
            .split_at_checked(bytes)
            .ok_or_else(|| damaged("it is cut off"))?;
        self.rest = rest;
        Ok(number
            .iter()
            .rev()
            .fold(0, |number, &byte| number << 8 | u64::from(byte)))
    }

    fn take_length_prefixed(&mut self, bytes: usize) -> Result<&'a [u8], NetworkError> {
        let count = usize::try_from(self.take_uint(bytes)?).unwrap_or(usize::MAX);
        let (content, rest) = self
            .rest
            .split_at_checked(count)
            .ok_or_else(|| damaged("a part longer than the whole"))?;
        self.rest = rest;
        Ok(content)
    }

    fn text(&mut self, bytes: usize) -> Result<(), NetworkError> {
        let text = std::str::from_utf8(self.take_length_prefixed(bytes)?)
            .map_err(|_| damaged("text that is not UTF-8"))?;
        self.push(Object::Text(text))
    }

    fn bytes(&mut self, bytes: usize) -> Result<(), NetworkError> {
        let bytes = self.take_length_prefixed(bytes)?;
        self.push(Object::Bytes(bytes))
    }

    /// Pushes an integer of up to eight bytes; a longer one becomes bytes, since no reader uses it.
    fn long(&mut self) -> Result<(), NetworkError> {
        let bytes = self.take_length_prefixed(1)?;
        let mut eight = if bytes.last().is_some_and(|byte| byte & 0x80 != 0) {
            [0xff; 8]
        } else {
            [0; 8]
        };
        let value = match eight.get_mut(..bytes.len()) {
            Some(low) => {
                low.copy_from_slice(bytes);
                Object::Integer(i64::from_le_bytes(eight))
            }
            None => Object::Bytes(bytes),
        };
        self.push(value)
    }

    fn take_line(&mut self) -> Result<&'a str, NetworkError> {
        let end = self
            .rest
            .iter()
            .position(|&byte| byte == b'\n')
            .ok_or_else(|| damaged("a line without end"))?;
        let line = std::str::from_utf8(&self.rest[..end])
            .map_err(|_| damaged("a name that is not UTF-8"))?;
        self.rest = &self.rest[end + 1..];
        Ok(line)
    }

    fn push(&mut self, value: Object<'a>) -> Result<(), NetworkError> {
        if self.values.len() >= MAX_VALUES {
            return Err(damaged(format!("more than {MAX_VALUES} values")));
        }
        self.stack.push(ValueId(self.values.len()));
        self.values.push(value);
        Ok(())
    }

    fn pop(&mut self) -> Result<ValueId, NetworkError> {
        self.stack.pop().ok_or_else(|| damaged("an empty stack"))
    }

    fn top(&self) -> Result<ValueId, NetworkError> {
        self.stack
            .last()
            .copied()
            .ok_or_else(|| damaged("an empty stack"))
    }

    fn pop_to_mark(&mut self) -> Result<Vec<ValueId>, NetworkError> {
        let mark = self
            .marks
            .pop()
            .filter(|&mark| mark <= self.stack.len())
            .ok_or_else(|| damaged("a lost mark"))?;
        Ok(self.stack.split_off(mark))
    }

    fn set_items(&mut self, members: &[ValueId]) -> Result<(), NetworkError> {
        let (pairs, rest) = members.as_chunks::<2>();
        let top = self.top()?;
        match self.values.get_mut(top.0) {
            Some(Object::Dict(items) | Object::Call(Call { items, .. })) if rest.is_empty() => {
                items.extend(pairs.iter().map(|[key, value]| (*key, *value)));
                Ok(())
            }
            _ => Err(damaged("entries for an object that is not a dictionary")),
        }
    }

    fn append(&mut self, members: &[ValueId]) -> Result<(), NetworkError> {
        let top = self.top()?;
        match self.values.get_mut(top.0) {
            Some(Object::List(list)) => list.extend(members),
            // A subclass of list; no reader uses it.
            Some(Object::Call(_)) => {}
            _ => return Err(damaged("members for an object that is not a list")),
        }
        Ok(())
    }

    /// Remembers the topmost value under the number that follows, of some bytes.
    fn memoize_under_argument(&mut self, bytes: usize) -> Result<(), NetworkError> {
        let key = self.take_uint(bytes)?;
        self.memoize(key as usize)
    }

    fn memoize(&mut self, key: usize) -> Result<(), NetworkError> {
        let top = self.top()?;
        if self.memo.len() >= MAX_VALUES {
            return Err(damaged(format!("more than {MAX_VALUES} values")));
        }
        self.memo.insert(key, top);
        Ok(())
    }

    /// Pushes the value that is remembered under the number that follows, of some bytes.
    fn get_memo(&mut self, bytes: usize) -> Result<(), NetworkError> {
        let key = self.take_uint(bytes)? as usize;
        let value = *self
            .memo
            .get(&key)
            .ok_or_else(|| damaged("a value that was not remembered"))?;
        // The stack grows without new values.
        if self.stack.len() >= MAX_VALUES {
            return Err(damaged(format!("more than {MAX_VALUES} values")));
        }
        self.stack.push(value);
        Ok(())
    }
}
