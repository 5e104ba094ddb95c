//! Symbolic terms in place of numbers: evaluating code with them records the computation.

use std::cell::RefCell;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Sub};

use crumple_sim::control::Real;

thread_local! {
    /// Text of every term of this thread.
    static TEXTS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// A real number, or a truth value, in SMT-LIB 2.
#[derive(Debug, Clone, Copy)]
pub(super) struct Term(usize);

fn intern(text: String) -> usize {
    TEXTS.with_borrow_mut(|texts| {
        texts.push(text);
        texts.len() - 1
    })
}

impl Term {
    pub(super) fn symbol(name: &str) -> Self {
        Self(intern(name.to_owned()))
    }

    pub(super) fn text(self) -> String {
        TEXTS.with_borrow(|texts| texts[self.0].clone())
    }

    fn binary(operator: &str, first: Self, other: Self) -> Self {
        Self(intern(format!(
            "({operator} {} {})",
            first.text(),
            other.text()
        )))
    }
}

macro_rules! operators {
    ($($trait:ident $method:ident $operator:literal,)*) => {
        $(impl $trait for Term {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                Self::binary($operator, self, other)
            }
        })*
    };
}
operators!(Add add "+", Sub sub "-", Mul mul "*", Div div "/", BitAnd bitand "and", BitOr bitor "or",);

impl Neg for Term {
    type Output = Self;
    fn neg(self) -> Self {
        Self(intern(format!("(- {})", self.text())))
    }
}

impl Real for Term {
    type Truth = Self;

    fn from_f64(value: f64) -> Self {
        let size = format!("{:?}", value.abs());
        Self(intern(if value < 0.0 {
            format!("(- {size})")
        } else {
            size
        }))
    }

    fn greater_than(self, other: Self) -> Self {
        Self::binary(">", self, other)
    }

    fn at_least(self, other: Self) -> Self {
        Self::binary(">=", self, other)
    }

    fn select(truth: Self, then: impl FnOnce() -> Self, otherwise: impl FnOnce() -> Self) -> Self {
        let (then, otherwise) = (then(), otherwise());
        Self(intern(format!(
            "(ite {} {} {})",
            truth.text(),
            then.text(),
            otherwise.text()
        )))
    }
}
