//! Names that files had before 0.4.0, and their present names.
//!
//! Version 0.4.0 renamed the fields whose names differed from those of the code. Types read the old names by
//! `serde(alias)`. In files that users write, [`OldNames::warn`] reports them; releases after 0.5 refuse them. Names
//! that a hash depends on do not change: [`OldNames::restore_in_text`] writes the texts that identify a space or a
//! training with the old names.

use std::path::Path;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// An old name and the present one.
type Rename = (&'static str, &'static str);

/// Names that a format had before, each with the present one.
#[derive(Debug, Clone, Copy)]
pub struct OldNames {
    /// Names of fields, at any depth.
    fields: &'static [Rename],
    /// Values that are names, each with its field.
    values: &'static [(&'static str, Rename)],
}

/// Names in configurations of trainings.
pub const TRAINING: OldNames = OldNames {
    fields: &[
        ("decision_steps", "action_repeat"),
        ("soft_update", "tau"),
        ("rates_fall", "lr_decay"),
        ("to_share", "final_factor"),
        ("random_episodes", "learning_starts_episode"),
        ("contact_share", "collision_fraction"),
        ("contact_reward", "collision_reward"),
        ("useful_draws", "usefulness_draws"),
        ("mean_over_updates", "weight_average_updates"),
        ("imposed", "induced_braking"),
        ("needless", "unnecessary_braking"),
        ("costs_times", "cost_multiplier"),
    ],
    values: &[("time_limit", ("end", "termination"))],
};

/// Names in scenario spaces.
pub const SPACE: OldNames = OldNames {
    fields: &[
        ("left_out", "undescribed_brakings"),
        ("waves", "braking_clusters"),
    ],
    values: &[],
};

/// Names in suites.
pub const SUITE: OldNames = OldNames {
    fields: &[
        ("figures_from", "parameter_source"),
        ("outside", "not_modelled"),
        ("left_out", "omitted_parameters"),
        ("says", "summary"),
        ("refused", "refusal_reason"),
        ("figures", "parameters"),
        ("push", "parameter"),
    ],
    values: &[],
};

/// Names in configurations of assessments.
pub const ASSESSMENT: OldNames = OldNames {
    fields: &[],
    values: &[
        (
            "require",
            (
                "no-contact-in-paper-scenarios",
                "no-collision-in-paper-scenarios",
            ),
        ),
        (
            "require",
            ("needless-braking-at-most", "unnecessary-braking-at-most"),
        ),
    ],
};

/// Names in the configurations of campaigns, estimates of rare failures and retrainings, which crumple writes.
pub const STUDY: OldNames = OldNames {
    fields: &[
        ("aim", "objective"),
        ("contrast", "failure_criterion"),
        ("against", "differential"),
        ("populations", "repetition_count"),
        ("kept_aside", "validation_draws"),
        ("judged", "test_draws"),
    ],
    values: &[],
};

/// Formats of files that users write.
const FORMATS: [OldNames; 4] = [TRAINING, SPACE, SUITE, ASSESSMENT];

/// Returns the old names of a field, in any format.
pub(crate) fn old_names_of(field: &str) -> impl Iterator<Item = &'static str> {
    let renames = FORMATS.into_iter().flat_map(|format| format.fields);
    renames
        .filter(move |(_, new)| *new == field)
        .map(|(old, _)| *old)
}

/// Returns the present name of a field or a value that has this old one, in each format.
pub(crate) fn present_names(old: &str) -> impl Iterator<Item = &'static str> {
    let renames = FORMATS.into_iter().flat_map(|format| {
        let values = format.values.iter().map(|(_, rename)| rename);
        format.fields.iter().chain(values)
    });
    renames
        .filter(move |(name, _)| *name == old)
        .map(|(_, new)| *new)
}

impl OldNames {
    /// Logs a warning for each old name in the TOML text of a file, at its first line. `path` only names the file. Call
    /// it for a text that was read without an error, and so has the limits of a text file.
    pub fn warn(&self, text: &str, path: &Path) {
        for (line, old, new) in self.find(text) {
            log::warn!(
                "{}:{line}: `{old}` is now `{new}`; releases after 0.5 will refuse the old name",
                path.display()
            );
        }
    }

    /// Returns the first line of each old name in a TOML text, with the old and the new name, in the order of the file.
    #[must_use]
    pub fn find(&self, text: &str) -> Vec<(usize, &'static str, &'static str)> {
        let values = self.values.iter().map(|(_, rename)| rename);
        let mut names = self.fields.iter().chain(values);
        // Most files have no old name and need not be parsed a second time.
        if !names.any(|(old, _)| text.contains(old)) {
            return Vec::new();
        }
        let Ok(root) = DeTable::parse(text) else {
            return Vec::new();
        };
        let mut uses = Vec::new();
        self.collect_from_table(root.get_ref(), &mut uses);
        uses.sort_unstable();
        let mut first: Vec<(usize, &str, &str)> = Vec::new();
        for (offset, old, new) in uses {
            if first.iter().all(|(_, name, _)| *name != old) {
                let before = text.get(..offset).unwrap_or_default();
                first.push((1 + before.matches('\n').count(), old, new));
            }
        }
        first
    }

    fn collect_from_table(&self, table: &DeTable<'_>, uses: &mut Vec<OldNameUse>) {
        for (key, value) in table {
            let field = self.fields.iter().find(|(old, _)| old == key.get_ref());
            uses.extend(field.map(|(old, new)| (key.span().start, *old, *new)));
            let named = self.values.iter().find(|(field, (old, _))| {
                field == key.get_ref() && value.get_ref().as_str() == Some(old)
            });
            uses.extend(named.map(|(_, (old, new))| (value.span().start, *old, *new)));
            self.collect_from_value(value, uses);
        }
    }

    fn collect_from_value(&self, value: &Spanned<DeValue<'_>>, uses: &mut Vec<OldNameUse>) {
        match value.get_ref() {
            DeValue::Array(items) => {
                for item in items {
                    self.collect_from_value(item, uses);
                }
            }
            DeValue::Table(table) => self.collect_from_table(table, uses),
            _ => {}
        }
    }

    /// Returns a text of JSON or TOML, as serde writes it, with the old names.
    ///
    /// Hashes of such texts identify what they describe, also in files of 0.3.0. A quotation mark within a text of JSON
    /// is escaped, so that only names are replaced; in TOML, so is the beginning of a line, except of a text of several
    /// lines.
    #[must_use]
    pub fn restore_in_text(&self, text: &str) -> String {
        let json = self
            .fields
            .iter()
            .fold(text.to_owned(), |text, (old, new)| {
                text.replace(&format!("\"{new}\":"), &format!("\"{old}\":"))
            });
        let lines = json.split_inclusive('\n');
        lines.map(|line| self.restore_in_line(line)).collect()
    }

    /// Returns a line of TOML with the old names: of a field, of the table that it begins, or of a value.
    fn restore_in_line(&self, line: &str) -> String {
        if line.starts_with('[') {
            return self
                .fields
                .iter()
                .fold(line.to_owned(), |line, (old, new)| {
                    line.replace(&format!(".{new}]"), &format!(".{old}]"))
                });
        }
        let is_line_of =
            |field: &str, value: &str| line.trim_end() == format!("{field} = \"{value}\"");
        for (field, (old, new)) in self.values {
            if is_line_of(field, new) {
                return line.replace(new, old);
            }
        }
        for (old, new) in self.fields {
            if let Some(rest) = line
                .strip_prefix(new)
                .filter(|rest| rest.starts_with(" = "))
            {
                return format!("{old}{rest}");
            }
        }
        line.to_owned()
    }

    /// Gives the fields of a value, at any depth, their old names, and also the values that are names.
    pub fn restore_in_value(&self, value: &mut serde_json::Value) {
        match value {
            serde_json::Value::Object(fields) => {
                for (old, new) in self.fields {
                    if let Some(field) = fields.remove(*new) {
                        fields.insert((*old).to_owned(), field);
                    }
                }
                for (name, (old, new)) in self.values {
                    if let Some(value) = fields.get_mut(*name).filter(|value| *value == new) {
                        *value = (*old).into();
                    }
                }
                fields
                    .values_mut()
                    .for_each(|field| self.restore_in_value(field));
            }
            serde_json::Value::Array(items) => {
                items
                    .iter_mut()
                    .for_each(|item| self.restore_in_value(item));
            }
            _ => {}
        }
    }
}

/// Offset in the text, old and new name.
type OldNameUse = (usize, &'static str, &'static str);

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: OldNames = OldNames {
        fields: &[("says", "summary"), ("push", "parameter")],
        values: &[("limit", ("end", "termination"))],
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
        assert_eq!(NAMES.find("summary = \"says\"\nend = \"end\"\n"), []);
        assert_eq!(NAMES.find("says = "), [], "the reader reports the error");
    }

    #[test]
    fn texts_of_version_1_differ_in_names_only() {
        let json = r#"{"braking_clusters":[1],"name":"\"braking_clusters\":"}"#;
        let old = r#"{"waves":[1],"name":"\"braking_clusters\":"}"#;
        assert_eq!(SPACE.restore_in_text(json), old);
        let toml = "name = \"braking_clusters = 1\"\n\n[observed]\nbraking_clusters = [1]\n";
        let old = "name = \"braking_clusters = 1\"\n\n[observed]\nwaves = [1]\n";
        assert_eq!(SPACE.restore_in_text(toml), old);
        let toml = "time_limit = \"termination\"\n[learning]\ntau = 1\n[learning.lr_decay]\nfinal_factor = 1\n";
        let old = "time_limit = \"end\"\n[learning]\nsoft_update = 1\n[learning.rates_fall]\nto_share = 1\n";
        assert_eq!(TRAINING.restore_in_text(toml), old);
    }

    #[test]
    fn a_value_of_version_1_has_old_names_at_any_depth() {
        let mut value = serde_json::json!({"learning": [{"tau": 1, "time_limit": "termination"}]});
        TRAINING.restore_in_value(&mut value);
        assert_eq!(
            value,
            serde_json::json!({"learning": [{"soft_update": 1, "time_limit": "end"}]})
        );
    }
}
