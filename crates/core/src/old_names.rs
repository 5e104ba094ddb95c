//! Old names of fields and values in files, and their new names.
//!
//! Version 0.4.0 renamed the fields whose names differed from those of the code. Types read the old names by
//! `serde(alias)`; in files that users write, [`OldNames`](crate::text_file::OldNames) warns of them. Names that a hash
//! depends on do not change: [`with_version_1_names`] writes the texts that identify a space and the header of a policy
//! with the names of version 1.

/// An old name and the present one.
pub type Rename = (&'static str, &'static str);

/// Names in configurations of trainings.
pub const TRAINING: &[Rename] = &[
    ("decision_steps", "action_repeat"),
    ("soft_update", "tau"),
    ("rates_fall", "lr_decay"),
    ("to_share", "final_factor"),
    ("random_episodes", "learning_starts_episode"),
    ("contact_share", "collision_fraction"),
    ("useful_draws", "usefulness_draws"),
    ("mean_over_updates", "weight_average_updates"),
    ("imposed", "induced_braking"),
    ("needless", "unnecessary_braking"),
    ("costs_times", "cost_multiplier"),
];

/// Names in scenario spaces.
pub const SPACE: &[Rename] = &[
    ("left_out", "undescribed_brakings"),
    ("waves", "braking_clusters"),
];

/// Names in suites.
pub const SUITE: &[Rename] = &[
    ("figures_from", "parameter_source"),
    ("outside", "not_modelled"),
    ("left_out", "omitted_parameters"),
    ("says", "summary"),
    ("refused", "refusal_reason"),
    ("figures", "parameters"),
    ("push", "parameter"),
];

/// Names in the configurations of campaigns, estimates of rare failures and retrainings, which crumple writes.
pub const STUDY: &[Rename] = &[
    ("aim", "objective"),
    ("contrast", "failure_criterion"),
    ("against", "differential"),
    ("populations", "repetition_count"),
    ("kept_aside", "validation_draws"),
    ("judged", "test_draws"),
];

/// Values of an enumeration in configurations of trainings, each with its field.
pub const VALUES: &[(&str, Rename)] = &[("time_limit", ("end", "termination"))];

/// Returns a text of JSON or TOML, as serde writes it, with the names of version 1 in place of the present ones.
///
/// Hashes of such texts identify what they describe, also in files of 0.3.0. A quotation mark within a text of JSON is
/// escaped, so that only names are replaced; in TOML, so is the beginning of a line, except of a text of several lines.
#[must_use]
pub fn with_version_1_names(text: &str, renames: &[Rename]) -> String {
    let replaced = renames.iter().fold(text.to_owned(), |text, (old, new)| {
        text.replace(&format!("\"{new}\":"), &format!("\"{old}\":"))
    });
    let lines = replaced
        .split_inclusive('\n')
        .map(|line| with_version_1_name(line, renames));
    lines.collect()
}

/// Returns a line of TOML with the names of version 1: that of a field, of the table that it begins, or of a value.
fn with_version_1_name(line: &str, renames: &[Rename]) -> String {
    if line.starts_with('[') {
        return renames.iter().fold(line.to_owned(), |line, (old, new)| {
            line.replace(&format!(".{new}]"), &format!(".{old}]"))
        });
    }
    let values = VALUES.iter().find_map(|(field, (old, new))| {
        let is_value = line.trim_end() == format!("{field} = \"{new}\"");
        is_value.then(|| line.replace(*new, old))
    });
    let field = || {
        renames.iter().find_map(|(old, new)| {
            let rest = line.strip_prefix(new)?;
            rest.starts_with(" = ").then(|| format!("{old}{rest}"))
        })
    };
    values.or_else(field).unwrap_or_else(|| line.to_owned())
}

/// Renames the fields of a value, at any depth, to those of version 1, and also their [`VALUES`].
pub fn rename_to_version_1(value: &mut serde_json::Value, renames: &[Rename]) {
    match value {
        serde_json::Value::Object(fields) => {
            for (old, new) in renames {
                if let Some(field) = fields.remove(*new) {
                    fields.insert((*old).to_owned(), field);
                }
            }
            for (name, (old, new)) in VALUES {
                if let Some(value) = fields.get_mut(*name).filter(|value| *value == new) {
                    *value = (*old).into();
                }
            }
            for field in fields.values_mut() {
                rename_to_version_1(field, renames);
            }
        }
        serde_json::Value::Array(entries) => {
            for entry in entries {
                rename_to_version_1(entry, renames);
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_version_1_differ_in_names_only() {
        let json = r#"{"braking_clusters":[1],"name":"\"braking_clusters\":"}"#;
        let old = r#"{"waves":[1],"name":"\"braking_clusters\":"}"#;
        assert_eq!(with_version_1_names(json, SPACE), old);
        let toml = "name = \"braking_clusters = 1\"\n\n[observed]\nbraking_clusters = [1]\n";
        let old = "name = \"braking_clusters = 1\"\n\n[observed]\nwaves = [1]\n";
        assert_eq!(with_version_1_names(toml, SPACE), old);
        let toml = "time_limit = \"termination\"\n[learning]\ntau = 1\n[learning.lr_decay]\nfinal_factor = 1\n";
        let old = "time_limit = \"end\"\n[learning]\nsoft_update = 1\n[learning.rates_fall]\nto_share = 1\n";
        assert_eq!(with_version_1_names(toml, TRAINING), old);
    }

    #[test]
    fn a_value_of_version_1_has_old_names_at_any_depth() {
        let mut value = serde_json::json!({"learning": [{"tau": 1, "time_limit": "termination"}]});
        rename_to_version_1(&mut value, TRAINING);
        assert_eq!(
            value,
            serde_json::json!({"learning": [{"soft_update": 1, "time_limit": "end"}]})
        );
    }
}
