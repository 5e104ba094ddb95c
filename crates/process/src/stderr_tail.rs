//! The last lines of a program's standard error.

use crumple_sim::control::escaped_excerpt;

/// Maximum number of lines returned, and of bytes kept.
const MAX_LINES: usize = 8;
const TAIL_BYTES: usize = 8 << 10;

#[derive(Default)]
pub(super) struct StderrTail(Vec<u8>);

impl StderrTail {
    pub(super) fn push(&mut self, output: &[u8]) {
        self.0.extend_from_slice(tail(output));
        if self.0.len() > 2 * TAIL_BYTES {
            self.0.drain(..self.0.len() - TAIL_BYTES);
        }
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns the last lines, escaped for terminals.
    pub(super) fn lines(&self) -> Vec<String> {
        let text = String::from_utf8_lossy(tail(&self.0));
        let lines: Vec<_> = text
            .lines()
            .filter(|line| !line.trim().is_empty())
            .collect();
        let last = lines
            .get(lines.len().saturating_sub(MAX_LINES)..)
            .unwrap_or_default();
        last.iter().map(|line| escaped_excerpt(line)).collect()
    }
}

/// Returns the last bytes of an output.
fn tail(output: &[u8]) -> &[u8] {
    output
        .get(output.len().saturating_sub(TAIL_BYTES)..)
        .unwrap_or(output)
}

#[cfg(test)]
mod tests {
    const MAX_CHARACTERS: usize = 300;
    use super::*;

    #[test]
    fn the_last_lines_of_any_output_are_reported() {
        let mut tail = StderrTail::default();
        assert!(tail.lines().is_empty());
        for number in 0..20_000 {
            tail.push(format!("line {number}\u{1b}\n\n").as_bytes());
            assert!(tail.0.len() <= 2 * TAIL_BYTES + 64);
        }
        assert_eq!(
            tail.lines().first().map(String::as_str),
            Some("line 19992\\u001b")
        );
        assert_eq!(tail.lines().len(), MAX_LINES);
        tail.push(&vec![b'x'; 1 << 20]);
        assert_eq!(tail.lines(), [format!("{}…", "x".repeat(MAX_CHARACTERS))]);
        tail.clear();
        assert!(tail.lines().is_empty());
    }
}
