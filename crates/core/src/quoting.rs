//! What users wrote, as it goes out: names, files and texts quoted for the place that they go to.
//!
//! A name may hold anything: a sequence that moves a terminal's cursor, an override that turns the direction of what follows,
//! HTML, a backtick, a semicolon. Each type here is one place, and what it displays means the text there and nothing else:
//!
//! | type | place |
//! |---|---|
//! | [`TerminalText`] | a line for a reader: of a terminal, a log, a list |
//! | [`TerminalLines`] | a whole text for readers or programs, JSON, XML and HTML among them: line breaks and tabs stay |
//! | [`MarkdownText`] | text within a paragraph, a heading or a cell of Markdown |
//! | [`MarkdownCode`] | the same, as code |
//! | [`ShellWord`] | one argument of a command in a POSIX shell |

use std::fmt::{self, Display, Formatter, Write};

/// Text within one line for a reader: what does not show as itself is shown escaped, as in `\u001b`, line breaks and tabs too.
#[derive(Debug, Clone, Copy)]
pub struct TerminalText<'a>(pub &'a str);

/// Text of several lines: as [`TerminalText`], but line feeds and tabs stay. The escapes are those of JSON, where they mean the
/// same characters; in XML, which forbids most of these characters, they are text.
#[derive(Debug, Clone, Copy)]
pub struct TerminalLines<'a>(pub &'a str);

/// Text of Markdown, within one line, that is nothing but text: no HTML, link, emphasis, code or border of a cell.
#[derive(Debug, Clone, Copy)]
pub struct MarkdownText<'a>(pub &'a str);

/// Code in a line of Markdown. In a cell of a table, which is divided before code is found, `|` has to be escaped besides.
#[derive(Debug, Clone, Copy)]
pub struct MarkdownCode<'a>(pub &'a str);

/// One argument of a command: a POSIX shell reads it as this text. For what goes into a file that is run; a command that is shown
/// goes through the type of that place besides.
#[derive(Debug, Clone, Copy)]
pub struct ShellWord<'a>(pub &'a str);

/// Whether a character does not show as itself, or changes how others show: control characters, line and paragraph separators,
/// whatever sets the direction of text, what has no width and no use in a word, and tags.
#[must_use]
pub fn is_hidden(letter: char) -> bool {
    letter.is_control()
        || matches!(letter,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{fffe}' | '\u{ffff}'
            | '\u{e0000}'..='\u{e007f}')
}

/// A character, or its escape if it is hidden.
fn write_escaped(letter: char, out: &mut Formatter<'_>) -> fmt::Result {
    if !is_hidden(letter) {
        return out.write_char(letter);
    }
    // As JSON writes it, characters beyond 16 bits in two halves.
    letter.encode_utf16(&mut [0; 2]).iter().try_for_each(|half| write!(out, "\\u{half:04x}"))
}

impl Display for TerminalText<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        self.0.chars().try_for_each(|letter| write_escaped(letter, out))
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

impl Display for MarkdownText<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let text = self.0.trim_start_matches(char::is_whitespace);
        let number = text.len() - text.trim_start_matches(|letter: char| letter.is_ascii_digit()).len();
        let is_word = |letter: Option<char>| letter.is_some_and(char::is_alphanumeric);
        let mut before = None;
        for (place, letter) in text.char_indices() {
            let after = text.get(place + letter.len_utf8()..).and_then(|rest| rest.chars().next());
            let ends_word = after.is_none_or(char::is_whitespace);
            // Where text begins, these make headings, quotations, lines and lists.
            let begins_block = match letter {
                '#' | '>' | '=' => place == 0,
                '-' | '+' => place == 0 && (ends_word || after == Some(letter)),
                '.' | ')' => place == number && number > 0 && ends_word,
                _ => false,
            };
            match letter {
                '\n' | '\r' | '\t' => out.write_char(' ')?,
                // Within a word it means nothing.
                '_' if is_word(before) && is_word(after) => out.write_char('_')?,
                // Neither HTML nor an entity begins so.
                '<' | '&' if after == Some(' ') => out.write_char(letter)?,
                '\\' | '`' | '*' | '_' | '<' | '&' | '[' | ']' | '|' | '~' | '$' => write!(out, "\\{letter}")?,
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
        // Longer than any run of them inside.
        let longest = self.0.split(|letter| letter != '`').map(str::len).max().unwrap_or_default();
        let fence = "`".repeat(longest + 1);
        // A space at each end is taken away again, unless there is nothing else.
        let blank = self.0.chars().all(|letter| letter == ' ');
        let pad = if longest > 0 || (self.0.starts_with(' ') && self.0.ends_with(' ') && !blank) { " " } else { "" };
        write!(out, "{fence}{pad}")?;
        if self.0.is_empty() {
            out.write_char(' ')?;
        }
        write!(out, "{}{pad}{fence}", TerminalText(self.0))
    }
}

impl Display for ShellWord<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "+-./:@_=,".contains(letter);
        // Some shells put a program's path in place of what begins with an equals sign.
        if !self.0.is_empty() && !self.0.starts_with('=') && self.0.chars().all(is_plain) {
            return out.write_str(self.0);
        }
        // No argument holds a NUL.
        write!(out, "'{}'", self.0.replace('\0', "").replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Whatever means something somewhere.
    fn hostile_text() -> impl Strategy<Value = String> {
        let nasty = prop::sample::select(vec![
            "\u{1b}]0;x\u{7}",
            "\u{1b}[2J",
            "\u{9b}1m",
            "\u{202e}",
            "\u{2066}",
            "\u{2028}",
            "\u{feff}",
            "\u{e0041}",
            "\r",
            "\n",
            "\t",
            "\u{0}",
            "\u{7f}",
            ";",
            "$(touch x)",
            "`touch x`",
            "'",
            "\"",
            "\\",
            "&&",
            "|",
            "#",
            " ",
            "é",
            "=",
            "~",
            "-",
        ]);
        prop::collection::vec(prop_oneof![nasty.prop_map(str::to_owned), any::<char>().prop_map(String::from)], 0..12)
            .prop_map(|pieces| pieces.concat())
    }

    proptest! {
        #[test]
        fn nothing_hidden_reaches_a_reader_and_json_means_the_same(text in hostile_text()) {
            prop_assert!(!TerminalText(&text).to_string().chars().any(is_hidden));
            prop_assert!(!TerminalLines(&text).to_string().chars().any(|letter| is_hidden(letter) && !"\n\t".contains(letter)));
            let json = serde_json::to_string(&text).unwrap();
            prop_assert_eq!(serde_json::from_str::<String>(&TerminalLines(&json).to_string()).unwrap(), text);
        }

        #[test]
        fn a_shell_reads_each_word_as_it_was(words in prop::collection::vec(hostile_text(), 0..5)) {
            let words: Vec<String> = words.into_iter().map(|word| word.replace('\0', "")).collect();
            let line = words.iter().map(|word| ShellWord(word).to_string()).collect::<Vec<_>>().join(" ");
            prop_assert_eq!(shlex::split(&line).unwrap(), words);
        }
    }

    #[test]
    fn what_is_harmless_is_left_alone() {
        let text = "policy-2 at 3.5 m/s², 1 - ε: `ttc_s` (v1.gap_m > 0.3)!";
        assert_eq!(
            (TerminalText(text).to_string(), TerminalLines(text).to_string()),
            (text.to_owned(), text.to_owned())
        );
        for text in ["vehicle 2 hits 1, 3.5 m, ttc_s", "4.25", "-3.1 m/s²", "TTC < 1.4 s & more"] {
            assert_eq!(MarkdownText(text).to_string(), text);
        }
        assert_eq!(ShellWord("shield:acc-aeb,ttc_s=2.0").to_string(), "shield:acc-aeb,ttc_s=2.0");
    }

    #[test]
    fn each_place_is_quoted_for() {
        assert_eq!(TerminalText("a\u{1b}[2J\nb").to_string(), "a\\u001b[2J\\u000ab");
        assert_eq!(MarkdownText("<img> & *x* [a](b) a|b").to_string(), "\\<img> & \\*x\\* \\[a\\](b) a\\|b");
        assert_eq!(MarkdownText("  12. x\n- y").to_string(), "12\\. x - y");
        assert_eq!(MarkdownCode("a`b``").to_string(), "``` a`b`` ```");
        assert_eq!(ShellWord("x;touch PWNED;#.safetensors").to_string(), "'x;touch PWNED;#.safetensors'");
    }
}
