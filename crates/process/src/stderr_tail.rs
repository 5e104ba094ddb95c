//! The last lines of a program's standard error.

use crumple_world::control::escaped_excerpt;

/// Maximum number of lines returned, and of bytes kept.
const MAX_LINES: usize = 8;
const TAIL_BYTES: usize = 8 << 10;

#[derive(Default)]
pub(super) struct StderrTail(Vec<u8>);

impl StderrTail {
    pub(super) fn push(&mut self, said: &[u8]) {
        let said = said
            .get(said.len().saturating_sub(TAIL_BYTES)..)
            .unwrap_or(said);
        self.0.extend_from_slice(said);
        if self.0.len() > 2 * TAIL_BYTES {
            self.0.drain(..self.0.len() - TAIL_BYTES);
        }
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns the last lines, escaped for terminals.
    pub(super) fn lines(&self) -> Vec<String> {
        let kept = self
            .0
            .get(self.0.len().saturating_sub(TAIL_BYTES)..)
            .unwrap_or(&self.0);
        let text = String::from_utf8_lossy(kept);
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

#[cfg(test)]
mod tests {
    const MAX_CHARACTERS: usize = 300;
    use super::*;

    #[test]
    fn the_last_lines_of_any_output_are_reported() {
        let mut words = StderrTail::default();
        assert!(words.lines().is_empty());
        for number in 0..20_000 {
            words.push(format!("line {number}\u{1b}\n\n").as_bytes());
            assert!(words.0.len() <= 2 * TAIL_BYTES + 64);
        }
        assert_eq!(
            words.lines().first().map(String::as_str),
            Some("line 19992\\u001b")
        );
        assert_eq!(words.lines().len(), MAX_LINES);
        words.push(&vec![b'x'; 1 << 20]);
        assert_eq!(words.lines(), [format!("{}…", "x".repeat(MAX_CHARACTERS))]);
        words.clear();
        assert!(words.lines().is_empty());
    }
}
