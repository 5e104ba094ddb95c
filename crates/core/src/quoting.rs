//! User-supplied text, quoted for its output format.
//!
//! A name may contain control sequences, bidirectional overrides, HTML, a backtick or a semicolon. Each type quotes for
//! one format:
//!
//! | type | output format |
//! |---|---|
//! | [`TerminalText`] | one line of a terminal, log or list |
//! | [`TerminalMessage`] | an error or a note in one line, of limited length |
//! | [`TerminalLines`] | a whole text (also JSON, XML or HTML); line breaks and tabs stay |
//! | [`MarkdownText`] | text in a Markdown paragraph, heading or table cell |
//! | [`MarkdownCode`] | inline code in Markdown |
//! | [`ShellWord`] | one argument of a command in a POSIX shell |

use std::borrow::Cow;
use std::fmt::{self, Display, Formatter, Write};

/// Maximum number of characters of a message.
pub const MAX_MESSAGE_CHARS: usize = 2000;
/// Maximum number of characters of a text that a message quotes in backticks.
pub const MAX_QUOTED_CHARS: usize = 200;
/// Number of characters that a shortened message keeps at its end, where the reason often is.
const MESSAGE_END_CHARS: usize = 600;

/// Text in one line for a reader. Hidden characters, line breaks and tabs are escaped, as in `\u001b`.
#[derive(Debug, Clone, Copy)]
pub struct TerminalText<'a>(pub &'a str);

/// An error or a note: [`TerminalText`] that [`shorten_message`] has shortened.
#[derive(Debug, Clone, Copy)]
pub struct TerminalMessage<'a>(pub &'a str);

/// Text of several lines. Differs from [`TerminalText`] in that line feeds and tabs stay. Hidden characters are escaped
/// as in JSON (`\u001b`). A JSON parser restores them. XML forbids most of them, so there the escapes stay as text.
#[derive(Debug, Clone, Copy)]
pub struct TerminalLines<'a>(pub &'a str);

/// Plain text in one line of Markdown: no HTML, link, emphasis, code or cell border.
#[derive(Debug, Clone, Copy)]
pub struct MarkdownText<'a>(pub &'a str);

/// Inline code in Markdown. In a table cell, the caller also has to escape `|`, because Markdown splits cells first.
#[derive(Debug, Clone, Copy)]
pub struct MarkdownCode<'a>(pub &'a str);

/// One argument of a command for a POSIX shell. A command that is displayed must also be quoted by the type of its
/// output format, such as [`MarkdownCode`].
#[derive(Debug, Clone, Copy)]
pub struct ShellWord<'a>(pub &'a str);

/// Returns `text` in one line, without the characters that XML 1.0 (section 2.2) does not allow.
#[must_use]
pub fn strip_unprintable(text: &str) -> String {
    let allowed =
        |letter: &char| !letter.is_control() && !matches!(letter, '\u{fffe}' | '\u{ffff}');
    text.chars()
        .map(|letter| if letter.is_whitespace() { ' ' } else { letter })
        .filter(allowed)
        .collect()
}

/// Returns true if a character is invisible or changes how others appear: control characters, line and paragraph
/// separators, bidirectional controls, zero-width characters and tags.
#[must_use]
pub fn is_hidden(letter: char) -> bool {
    letter.is_control()
        || matches!(letter,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{fffe}' | '\u{ffff}'
            | '\u{e0000}'..='\u{e007f}')
}

/// Shortens a message to [`MAX_MESSAGE_CHARS`], and each text in backticks to [`MAX_QUOTED_CHARS`]. An ellipsis
/// replaces what is left out.
#[must_use]
pub fn shorten_message(text: &str) -> Cow<'_, str> {
    // A character has at least one byte.
    if text.len() <= MAX_QUOTED_CHARS {
        return Cow::Borrowed(text);
    }
    let last = text.matches('`').count();
    let mut short = String::new();
    for (index, part) in text.split('`').enumerate() {
        short.push_str(if index > 0 { "`" } else { "" });
        // Text after an opening backtick without a closing one is no quotation.
        let is_quoted = index % 2 == 1 && index < last;
        short.push_str(&if is_quoted {
            keep_ends(part, MAX_QUOTED_CHARS, 0)
        } else {
            Cow::Borrowed(part)
        });
    }
    Cow::Owned(keep_ends(&short, MAX_MESSAGE_CHARS, MESSAGE_END_CHARS).into_owned())
}

/// Shortens a text to `most` characters, of which `end` are those at its end.
fn keep_ends(text: &str, most: usize, end: usize) -> Cow<'_, str> {
    let count = text.chars().count();
    if count <= most {
        return Cow::Borrowed(text);
    }
    let [begin_end, end_start] = [most.saturating_sub(end + 1), count - end].map(|index| {
        let mut bytes = text.char_indices().map(|(byte, _)| byte);
        bytes.nth(index).unwrap_or(text.len())
    });
    let begin = text.get(..begin_end).unwrap_or_default();
    let end = text.get(end_start..).unwrap_or_default();
    Cow::Owned(format!("{begin}…{end}"))
}

fn write_escaped(letter: char, out: &mut Formatter<'_>) -> fmt::Result {
    if !is_hidden(letter) {
        return out.write_char(letter);
    }
    // JSON writes characters beyond 16 bits as surrogate pairs.
    letter
        .encode_utf16(&mut [0; 2])
        .iter()
        .try_for_each(|half| write!(out, "\\u{half:04x}"))
}

impl Display for TerminalText<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        self.0
            .chars()
            .try_for_each(|letter| write_escaped(letter, out))
    }
}

impl Display for TerminalMessage<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        TerminalText(&shorten_message(self.0)).fmt(out)
    }
}

impl Display for TerminalLines<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        self.0.chars().try_for_each(|letter| match letter {
            '\n' | '\t' => out.write_char(letter),
            other => write_escaped(other, out),
        })
    }
}

fn is_in_word(letter: Option<char>) -> bool {
    letter.is_some_and(char::is_alphanumeric)
}

impl Display for MarkdownText<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let text = self.0.trim_start_matches(char::is_whitespace);
        let number = text.len()
            - text
                .trim_start_matches(|letter: char| letter.is_ascii_digit())
                .len();
        let mut before = None;
        for (index, letter) in text.char_indices() {
            let after = text
                .get(index + letter.len_utf8()..)
                .and_then(|rest| rest.chars().next());
            let ends_word = after.is_none_or(char::is_whitespace);
            // At the start of a block, these begin headings, quotations, rules and lists.
            let begins_block = match letter {
                '#' | '>' | '=' => index == 0,
                '-' | '+' => index == 0 && (ends_word || after == Some(letter)),
                '.' | ')' => index == number && number > 0 && ends_word,
                _ => false,
            };
            match letter {
                '\n' | '\r' | '\t' => out.write_char(' ')?,
                // An underscore within a word has no meaning.
                '_' if is_in_word(before) && is_in_word(after) => out.write_char('_')?,
                // Neither HTML nor an entity begins with these.
                '<' | '&' if after == Some(' ') => out.write_char(letter)?,
                '\\' | '`' | '*' | '_' | '<' | '&' | '[' | ']' | '|' | '~' | '$' => {
                    write!(out, "\\{letter}")?
                }
                _ if begins_block => write!(out, "\\{letter}")?,
                _ if is_hidden(letter) => {
                    out.write_char('\\')?;
                    write_escaped(letter, out)?;
                }
                _ => out.write_char(letter)?,
            }
            before = Some(letter);
        }
        Ok(())
    }
}

impl Display for MarkdownCode<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        // The fence must be longer than any run of backticks inside.
        let longest = self
            .0
            .split(|letter| letter != '`')
            .map(str::len)
            .max()
            .unwrap_or_default();
        let fence = "`".repeat(longest + 1);
        // Markdown removes a space at each end, unless the code is all spaces.
        let blank = self.0.chars().all(|letter| letter == ' ');
        let pad = if longest > 0 || (self.0.starts_with(' ') && self.0.ends_with(' ') && !blank) {
            " "
        } else {
            ""
        };
        write!(out, "{fence}{pad}")?;
        if self.0.is_empty() {
            out.write_char(' ')?;
        }
        write!(out, "{}{pad}{fence}", TerminalText(self.0))
    }
}

impl Display for ShellWord<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let is_plain =
            |letter: char| letter.is_ascii_alphanumeric() || "+-./:@_=,".contains(letter);
        // Some shells expand `=NAME` to the path of a program.
        if !self.0.is_empty() && !self.0.starts_with('=') && self.0.chars().all(is_plain) {
            return out.write_str(self.0);
        }
        write!(out, "'{}'", self.0.replace('\0', "").replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn hostile_text() -> impl Strategy<Value = String> {
        let words = [
            "\u{1b}]0;x\u{7}",
            "\u{1b}[2J",
            "\u{9b}1m",
            "$(touch x)",
            "`touch x`",
            "&&",
        ]
        .map(str::to_owned);
        let letters = "\u{202e}\u{2066}\u{2028}\u{feff}\u{e0041}\r\n\t\u{0}\u{7f};'\"\\|# é=~-"
            .chars()
            .map(String::from);
        let nasty = prop::sample::select(words.into_iter().chain(letters).collect::<Vec<_>>());
        prop::collection::vec(
            prop_oneof![nasty, any::<char>().prop_map(String::from)],
            0..12,
        )
        .prop_map(|pieces| pieces.concat())
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn hidden_characters_are_escaped_and_json_keeps_its_meaning(text in hostile_text()) {
            prop_assert!(!TerminalText(&text).to_string().chars().any(is_hidden));
            prop_assert!(!TerminalLines(&text).to_string().chars().any(|c| is_hidden(c) && !"\n\t".contains(c)));
            let json = serde_json::to_string(&text).unwrap();
            prop_assert_eq!(serde_json::from_str::<String>(&TerminalLines(&json).to_string()).unwrap(), text);
        }

        #[test]
        fn a_shell_reads_quoted_words_unchanged(words in prop::collection::vec(hostile_text(), 0..5)) {
            let words: Vec<String> = words.into_iter().map(|word| word.replace('\0', "")).collect();
            let line = words.iter().map(|word| ShellWord(word).to_string()).collect::<Vec<_>>().join(" ");
            prop_assert_eq!(shlex::split(&line).unwrap(), words);
        }
    }

    #[test]
    fn messages_are_shortened_where_they_quote_and_as_a_whole() {
        let long = "ä".repeat(1_000_000);
        let quoted = TerminalMessage(&format!(
            "a.toml:1: unknown field `{long}`, expected `name`"
        ))
        .to_string();
        let expected = format!(
            "a.toml:1: unknown field `{}…`, expected `name`",
            "ä".repeat(MAX_QUOTED_CHARS - 1)
        );
        assert_eq!(quoted, expected);
        for text in [
            format!("a.toml:1: {long}: is no number"),
            format!("a.toml:1: `{long}: is no number"),
        ] {
            let short = shorten_message(&text);
            assert_eq!(short.chars().count(), MAX_MESSAGE_CHARS);
            assert!(
                short.starts_with("a.toml:1: ") && short.ends_with("ä: is no number"),
                "{short}"
            );
        }
        let whole = format!("`{}`", "x".repeat(MAX_QUOTED_CHARS));
        assert_eq!(shorten_message(&whole), whole);
    }

    #[test]
    fn harmless_text_is_unchanged() {
        let text = "policy-2 at 3.5 m/s², 1 - ε: `ttc_s` (v1.gap_m > 0.3)!";
        assert_eq!(
            [
                TerminalText(text).to_string(),
                TerminalLines(text).to_string()
            ],
            [text; 2]
        );
        for text in [
            "vehicle 2 hits 1, 3.5 m, ttc_s",
            "4.25",
            "-3.1 m/s²",
            "TTC < 1.4 s & more",
        ] {
            assert_eq!(MarkdownText(text).to_string(), text);
        }
        assert_eq!(
            ShellWord("shield:acc-aeb,ttc_s=2.0").to_string(),
            "shield:acc-aeb,ttc_s=2.0"
        );
    }

    #[test]
    fn text_is_quoted_for_each_output_format() {
        assert_eq!(
            TerminalText("a\u{1b}[2J\nb").to_string(),
            "a\\u001b[2J\\u000ab"
        );
        assert_eq!(
            MarkdownText("<img> & *x* [a](b) a|b").to_string(),
            "\\<img> & \\*x\\* \\[a\\](b) a\\|b"
        );
        assert_eq!(MarkdownText("  12. x\n- y").to_string(), "12\\. x - y");
        assert_eq!(MarkdownCode("a`b``").to_string(), "``` a`b`` ```");
        assert_eq!(
            ShellWord("x;touch PWNED;#.safetensors").to_string(),
            "'x;touch PWNED;#.safetensors'"
        );
    }
}
