//! Lexer: text to tokens.

use super::formula::ComparisonOp;
use super::parse::{FormulaParseError, SyntaxProblem};

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Token {
    Number(f64),
    Name(String),
    Symbol(Symbol),
    End,
}

/// Keywords and operators, in any spelling.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Symbol {
    Not,
    And,
    Or,
    Implies,
    Always,
    Eventually,
    Until,
    Infinity,
    Compare(ComparisonOp),
    Plus,
    Minus,
    Times,
    Over,
    Open,
    Close,
    WindowOpen,
    WindowClose,
    Comma,
}

impl Symbol {
    /// Returns true if a formula may follow the symbol.
    pub(super) fn precedes_formula(self) -> bool {
        matches!(
            self,
            Self::Not
                | Self::And
                | Self::Or
                | Self::Implies
                | Self::Always
                | Self::Eventually
                | Self::Until
                | Self::Open
                | Self::WindowClose
        )
    }

    /// Returns true if the symbol begins an operand, or the time window before an operand.
    pub(super) fn begins_operand(self) -> bool {
        matches!(
            self,
            Self::Not | Self::Always | Self::Eventually | Self::Open | Self::WindowOpen
        )
    }
}

const KEYWORDS: [(&str, Symbol); 8] = [
    ("not", Symbol::Not),
    ("and", Symbol::And),
    ("or", Symbol::Or),
    ("implies", Symbol::Implies),
    ("always", Symbol::Always),
    ("eventually", Symbol::Eventually),
    ("until", Symbol::Until),
    ("inf", Symbol::Infinity),
];

/// Longer operators precede their prefixes.
const SIGNS: [(&str, Symbol); 26] = [
    ("<=", Symbol::Compare(ComparisonOp::AtMost)),
    (">=", Symbol::Compare(ComparisonOp::AtLeast)),
    ("->", Symbol::Implies),
    ("=>", Symbol::Implies),
    ("&&", Symbol::And),
    ("||", Symbol::Or),
    ("≤", Symbol::Compare(ComparisonOp::AtMost)),
    ("≥", Symbol::Compare(ComparisonOp::AtLeast)),
    ("→", Symbol::Implies),
    ("∧", Symbol::And),
    ("∨", Symbol::Or),
    ("¬", Symbol::Not),
    ("□", Symbol::Always),
    ("◇", Symbol::Eventually),
    ("!", Symbol::Not),
    ("<", Symbol::Compare(ComparisonOp::Below)),
    (">", Symbol::Compare(ComparisonOp::Above)),
    ("+", Symbol::Plus),
    ("-", Symbol::Minus),
    ("*", Symbol::Times),
    ("/", Symbol::Over),
    ("(", Symbol::Open),
    (")", Symbol::Close),
    ("[", Symbol::WindowOpen),
    ("]", Symbol::WindowClose),
    (",", Symbol::Comma),
];

pub(super) fn is_signal_name(text: &str) -> bool {
    let mut letters = text.chars();
    letters.next().is_some_and(is_name_start)
        && letters.all(is_name_continue)
        && find_keyword(text).is_none()
}

fn is_name_start(c: char) -> bool {
    c.is_alphabetic() || c == '_'
}

fn is_name_continue(c: char) -> bool {
    c.is_alphanumeric() || c == '_' || c == '.'
}

fn find_keyword(word: &str) -> Option<Symbol> {
    KEYWORDS
        .iter()
        .find(|(text, _)| *text == word)
        .map(|(_, symbol)| *symbol)
}

/// Splits `text` into tokens, each with its column (from 1, in characters), and [`Token::End`] last.
pub(super) fn tokenize(text: &str) -> Result<Vec<(usize, Token)>, FormulaParseError> {
    let mut tokens = Vec::new();
    let mut column = 1;
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let lexeme = if first.is_whitespace() {
            Lexeme {
                length: first.len_utf8(),
                token: None,
            }
        } else {
            lex_token(first, rest).map_err(|problem| FormulaParseError { column, problem })?
        };
        tokens.extend(lexeme.token.map(|token| (column, token)));
        let (lexed, left) = rest.split_at_checked(lexeme.length).unwrap_or((rest, ""));
        column += lexed.chars().count();
        rest = left;
    }
    tokens.push((column, Token::End));
    Ok(tokens)
}

/// A piece of the text and its token; white space has none.
struct Lexeme {
    /// Length in bytes.
    length: usize,
    token: Option<Token>,
}

/// Reads the token at the start of `text`, whose first character is `first`.
fn lex_token(first: char, text: &str) -> Result<Lexeme, SyntaxProblem> {
    if first.is_ascii_digit() || first == '.' {
        let length = number_length(text);
        let digits = text.get(..length).unwrap_or_default();
        return match digits.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Lexeme {
                length,
                token: Some(Token::Number(number)),
            }),
            _ => Err(SyntaxProblem::Number {
                found: digits.to_owned(),
            }),
        };
    }
    if is_name_start(first) {
        let length = text.find(|c| !is_name_continue(c)).unwrap_or(text.len());
        let word = text.get(..length).unwrap_or_default();
        let keyword = find_keyword(word).map(Token::Symbol);
        return Ok(Lexeme {
            length,
            token: Some(keyword.unwrap_or_else(|| Token::Name(word.to_owned()))),
        });
    }
    match SIGNS.iter().find(|(sign, _)| text.starts_with(sign)) {
        Some((sign, symbol)) => Ok(Lexeme {
            length: sign.len(),
            token: Some(Token::Symbol(*symbol)),
        }),
        None => Err(SyntaxProblem::Character { found: first }),
    }
}

/// Returns the length in bytes of the number at the start of `text`: digits, a point, digits, an exponent.
fn number_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let mut length = count_digits(bytes, 0);
    if bytes.get(length) == Some(&b'.') {
        length += 1 + count_digits(bytes, length + 1);
    }
    if matches!(bytes.get(length), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(length + 1), Some(b'+' | b'-')));
        let exponent = count_digits(bytes, length + 1 + sign);
        if exponent > 0 {
            length += 1 + sign + exponent;
        }
    }
    length
}

fn count_digits(bytes: &[u8], from: usize) -> usize {
    bytes
        .iter()
        .skip(from)
        .take_while(|b| b.is_ascii_digit())
        .count()
}

impl std::fmt::Display for Token {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(out, "{number}"),
            Self::Name(name) => write!(out, "`{name}`"),
            Self::End => write!(out, "the end"),
            Self::Symbol(symbol) => {
                let spelling = KEYWORDS.iter().chain(&SIGNS).find(|(_, s)| s == symbol);
                write!(out, "`{}`", spelling.map_or("", |(text, _)| text))
            }
        }
    }
}
