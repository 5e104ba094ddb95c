//! Messages about names of earlier releases in files that users write.

use std::path::Path;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::position::line_at;

/// Names that a format had before, each with the current one.
///
/// Types read an old name by `serde(alias)`. Releases 0.4 and 0.5 do so, with a message; later ones refuse it.
#[derive(Debug, Clone, Copy)]
pub struct OldNames {
    /// Old and new names of fields, at any depth.
    pub fields: &'static [(&'static str, &'static str)],
    /// Old and new values that are names, in any field.
    pub values: &'static [(&'static str, &'static str)],
}

impl OldNames {
    /// Logs a warning for each old name in the TOML text of a file, at its first line. `path` only names the file.
    pub fn warn(&self, text: &str, path: &Path) {
        for (line, old, new) in self.find(text) {
            log::warn!(
                "{}:{line}: `{old}` is now `{new}`; releases after 0.5 will refuse the old name",
                path.display()
            );
        }
    }

    /// Returns the first line of each old name in a TOML text, with the old and the new name, in the order of the file.
    fn find(&self, text: &str) -> Vec<(usize, &'static str, &'static str)> {
        let mut names = self.fields.iter().chain(self.values);
        // Most files have no old name and need not be parsed a second time.
        if !names.any(|(old, _)| text.contains(old)) {
            return Vec::new();
        }
        let Ok(root) = DeTable::parse(text) else {
            return Vec::new();
        };
        let mut offsets = Vec::new();
        self.collect_from_table(root.get_ref(), &mut offsets);
        offsets.sort_unstable();
        let mut first: Vec<(usize, &str, &str)> = Vec::new();
        for (offset, old, new) in offsets {
            if first.iter().all(|(_, name, _)| *name != old) {
                first.push((line_at(text, offset), old, new));
            }
        }
        first
    }

    fn collect_from_table(&self, table: &DeTable<'_>, offsets: &mut Vec<OldName>) {
        for (key, value) in table {
            let named = self.fields.iter().find(|(old, _)| old == key.get_ref());
            if let Some((old, new)) = named {
                offsets.push((key.span().start, old, new));
            }
            self.collect_from_value(value, offsets);
        }
    }

    fn collect_from_value(&self, value: &Spanned<DeValue<'_>>, offsets: &mut Vec<OldName>) {
        match value.get_ref() {
            DeValue::String(text) => {
                if let Some((old, new)) = self.values.iter().find(|(old, _)| old == text) {
                    offsets.push((value.span().start, old, new));
                }
            }
            DeValue::Array(items) => {
                for item in items {
                    self.collect_from_value(item, offsets);
                }
            }
            DeValue::Table(table) => self.collect_from_table(table, offsets),
            _ => {}
        }
    }
}

/// Offset in the text, old and new name.
type OldName = (usize, &'static str, &'static str);

#[cfg(test)]
mod tests {
    use super::OldNames;

    const NAMES: OldNames = OldNames {
        fields: &[("says", "summary"), ("push", "parameter")],
        values: &[("end", "termination")],
    };

    #[test]
    fn each_old_name_is_reported_once_at_its_first_line() {
        let text =
            "limit = \"end\"\n[[clauses]]\nsays = \"push\"\ntests = [{ push = 1 }, { push = 2 }]\n";
        let old_names = [
            (1, "end", "termination"),
            (3, "says", "summary"),
            (4, "push", "parameter"),
        ];
        assert_eq!(NAMES.find(text), old_names);
        assert_eq!(NAMES.find("summary = \"says\"\nend = 1\n"), []);
        assert_eq!(NAMES.find("says = "), [], "the reader reports the error");
    }
}
