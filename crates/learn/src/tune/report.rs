//! Report of a tuning as JSON and Markdown.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use super::objective::ControllerScore;
use super::plan::TUNE_VERSION;
use super::{TuneError, TuningConfig, TuningObjective, TuningPlan};
use crate::rl::{
    EXCESS_WEIGHT, MAX_RATIO_TO_IDM, RecordedUsefulness, TIME_GAP_RANGE_S, TrafficUsefulness,
};
use crumple_core::digest::sha256;
use crumple_core::markdown::Markdown;
use crumple_core::quoting::MarkdownText;
use crumple_evidence::RateInterval;
use crumple_sim::control::BuiltInController;

const CONFIDENCE: f64 = 0.95;

/// One setting of the report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TunedSetting {
    /// Name, with its unit.
    pub name: String,
    /// Unit; `1` if it has none.
    pub unit: String,
    /// Minimum and maximum of the search; none for a setting that was not searched.
    pub range: Option<[f64; 2]>,
    /// Default value.
    pub default: f64,
    /// Tuned value.
    pub tuned: f64,
}

impl TunedSetting {
    fn table_row(&self) -> Vec<String> {
        let range = self
            .range
            .map_or("fixed".to_owned(), |[low, high]| format!("{low} to {high}"));
        vec![
            format!("`{}`", self.name),
            self.unit.clone(),
            range,
            self.default.to_string(),
            self.tuned.to_string(),
        ]
    }
}

/// Results of one of the best candidates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TuningFinalist {
    /// Results in the tuning set.
    pub tuning: ControllerScore,
    /// Results in the selection set.
    pub selection: ControllerScore,
}

/// The file `report.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TuningReport {
    /// Version of the format: 1.
    pub version: u32,
    /// Version of crumple.
    pub crumple: String,
    /// SHA-256 of `tune.toml`.
    pub plan_sha256: String,
    /// Controller with its initial settings, as on the command line.
    pub initial: String,
    /// Controller with its tuned settings, as on the command line.
    pub tuned: String,
    /// Settings of the search, and sizes of the sets of scenarios.
    #[serde(flatten)]
    pub config: TuningConfig,
    /// Names of the spaces.
    pub spaces: Vec<String>,
    /// Weights of the spaces in the objective.
    pub weights: Vec<f64>,
    /// All settings of the controller.
    pub settings: Vec<TunedSetting>,
    /// Initial settings and best candidates, in the order of their objectives in the tuning set after the first.
    pub finalists: Vec<TuningFinalist>,
    /// Results of initial settings, tuned settings and `idm` in the test set.
    pub test: Vec<ControllerScore>,
}

impl TuningReport {
    pub(super) fn new(
        plan: &TuningPlan,
        tuned: BuiltInController,
        finalists: Vec<TuningFinalist>,
        test: Vec<ControllerScore>,
    ) -> Result<Self, TuneError> {
        let default = BuiltInController::from_name(tuned.name()).unwrap_or_else(|| tuned.clone());
        Ok(Self {
            version: TUNE_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            plan_sha256: sha256(plan.to_toml()?),
            initial: plan.search.initial().to_arg(),
            tuned: tuned.to_arg(),
            config: plan.config.clone(),
            spaces: plan
                .spaces
                .iter()
                .map(|tuning_space| tuning_space.space.name().to_owned())
                .collect(),
            weights: plan
                .spaces
                .iter()
                .map(|tuning_space| tuning_space.weight)
                .collect(),
            settings: tuned
                .values()
                .zip(default.values())
                .map(|((field, tuned), (_, default))| TunedSetting {
                    name: field.name.to_owned(),
                    unit: field.unit().to_owned(),
                    range: plan.search.searched_range(field),
                    default,
                    tuned,
                })
                .collect(),
            finalists,
            test,
        })
    }

    /// Returns false if the tuned settings differ from the initial ones, but are not better in the test set.
    #[must_use]
    pub fn is_confirmed(&self) -> bool {
        let objectives: Vec<f64> = self.test.iter().map(|score| score.objective).collect();
        self.tuned == self.initial
            || matches!(objectives[..], [initial, tuned, ..] if tuned < initial)
    }

    /// Returns the text of `report.md`.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_markdown(&mut text);
        text
    }

    fn write_markdown(&self, out: &mut String) -> std::fmt::Result {
        let spaces = self.spaces.iter().zip(&self.weights);
        let spaces: Vec<_> = spaces
            .map(|(name, weight)| format!("{} ({weight})", MarkdownText(name)))
            .collect();
        let result = match self.tuned == self.initial {
            true => {
                "No candidate was better than the initial settings in both the tuning and the selection set."
            }
            false => "The tuned controller:",
        };
        writeln!(
            out,
            "# Tuning of `{}`\n\n{result}\n\n```text\n{}\n```\n",
            self.initial, self.tuned
        )?;
        writeln!(
            out,
            "{} candidates of the method {} (seed {}), each in {} random scenarios of each space. Spaces, with their \
             weights: {}. {}\n",
            self.config.evaluations,
            self.config.method,
            self.config.seed,
            self.config.runs,
            spaces.join(", "),
            self.objective_sentence()
        )?;
        let rows = self.settings.iter().map(TunedSetting::table_row);
        let mut table = Markdown::default();
        table.plain_table(&["setting", "unit", "range", "default", "tuned"], rows);
        out.push_str(&table.into_string());
        self.write_test(out)
    }

    fn objective_sentence(&self) -> String {
        match self.config.objective {
            TuningObjective::Safety => {
                "The objective is the weighted mean of their collision shares.".to_owned()
            }
            TuningObjective::Both => self.penalty_sentences(),
        }
    }

    fn penalty_sentences(&self) -> String {
        let [closest_s, furthest_s] = TIME_GAP_RANGE_S;
        let mut text = format!(
            "The objective is the weighted mean of their collision shares, plus a penalty. The penalty has the \
                 shares of drives in `traffic` with a collision, with hard unnecessary braking, and in which the \
                 vehicle falls behind. It has the share of drives in `everyday` with one of these faults or any \
                 unnecessary braking, if `idm` has none. The rest is {EXCESS_WEIGHT} times a sum: the relative \
                 excesses of RMS acceleration and of RMS jerk (also in `everyday`) above {MAX_RATIO_TO_IDM} times \
                 those of `idm`, and the distance of the mean time gap from {closest_s} to {furthest_s} s, in seconds."
        );
        if let Some(RecordedUsefulness { drive_count, .. }) = self.recorded() {
            text += &format!(
                " The {drive_count} recorded drives count as scenarios of `everyday` do, and are the same in all sets."
            );
        }
        text
    }

    /// Writes the table of the test set: one column per controller, one row per measure.
    fn write_test(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "\n## Test set\n\n{} other random scenarios of each space, of `traffic` and of `everyday`, which decided \
             nothing. \
             Shares in %, with exact {:.0} % intervals. Hard braking: above 4 m/s², of which less than 3 m/s² had a \
             cause.\n",
            self.config.test_runs,
            100.0 * CONFIDENCE
        )?;
        let mut table = Markdown::default();
        let header = ["measure", "initial settings", "tuned settings", "`idm`"];
        table.plain_table(&header, self.test_rows().into_iter());
        out.push_str(&table.into_string());
        match self.is_confirmed() {
            true => Ok(()),
            false => out.write_str(
                "\nThe tuned settings are not better than the initial ones in the test set: the improvement in the \
                 other sets was chance. Use more random scenarios for each candidate.\n",
            ),
        }
    }

    fn test_rows(&self) -> Vec<Vec<String>> {
        let mut rows = Vec::new();
        for (index, space) in self.spaces.iter().enumerate() {
            rows.push(self.test_row(&format!("collisions in {space}"), |score| {
                let count = score.collisions.get(index)?;
                Some(self.format_share(*count))
            }));
        }
        type MeasureRow = (
            &'static str,
            fn(&TrafficUsefulness, &TuningReport) -> String,
        );
        let measures: [MeasureRow; 8] = [
            ("collisions in `traffic`", |usefulness, report| {
                report.format_share(usefulness.collisions)
            }),
            (
                "hard unnecessary braking in `traffic`",
                |usefulness, report| report.format_share(usefulness.hard_braking),
            ),
            ("falls behind in `traffic`", |usefulness, report| {
                report.format_share(usefulness.fell_behind)
            }),
            ("faults in `everyday`", |usefulness, report| {
                let everyday = usefulness.everyday;
                everyday.map_or("–".to_owned(), |everyday| {
                    report.format_share(everyday.faults)
                })
            }),
            ("RMS acceleration, relative to `idm`", |usefulness, _| {
                format!("{:.2}", usefulness.acceleration_times_idm)
            }),
            ("RMS jerk, relative to `idm`", |usefulness, _| {
                format!("{:.2}", usefulness.jerk_times_idm)
            }),
            (
                "RMS jerk in `everyday`, relative to `idm`",
                |usefulness, _| {
                    let everyday = usefulness.everyday;
                    everyday.map_or("–".to_owned(), |everyday| {
                        format!("{:.2}", everyday.jerk_times_idm)
                    })
                },
            ),
            ("mean time gap, s", |usefulness, _| {
                format!("{:.2}", usefulness.mean_time_gap_s)
            }),
        ];
        for (name, measure) in measures {
            rows.push(self.test_row(name, |score| {
                score
                    .traffic
                    .as_ref()
                    .map(|usefulness| measure(usefulness, self))
            }));
        }
        rows.extend(self.recorded_rows());
        rows.push(self.test_row("objective", |score| Some(format!("{:.4}", score.objective))));
        rows
    }

    /// Returns the result of the initial settings in recorded drives; `None` if the tuning has none.
    fn recorded(&self) -> Option<RecordedUsefulness> {
        self.test.first()?.traffic?.recorded
    }

    /// Returns the rows about recorded drives; none if the tuning has none.
    fn recorded_rows(&self) -> Vec<Vec<String>> {
        if self.recorded().is_none() {
            return Vec::new();
        }
        let faults = self.test_row("faults in recorded drives", |score| {
            let recorded = score.traffic?.recorded?;
            Some(format_share_of(recorded.faults, recorded.drive_count))
        });
        let name = "RMS jerk in recorded drives, relative to `idm`";
        let jerk = self.test_row(name, |score| {
            let recorded = score.traffic?.recorded?;
            Some(format!("{:.2}", recorded.jerk_times_idm))
        });
        vec![faults, jerk]
    }

    fn test_row(
        &self,
        name: &str,
        cell: impl Fn(&ControllerScore) -> Option<String>,
    ) -> Vec<String> {
        let scores = self.test.iter();
        let cells = scores.map(|score| cell(score).unwrap_or_default());
        std::iter::once(name.to_owned()).chain(cells).collect()
    }

    fn format_share(&self, count: u64) -> String {
        format_share_of(count, self.config.test_runs)
    }
}

fn format_share_of(count: u64, runs: u64) -> String {
    let interval = RateInterval::clopper_pearson(count, runs, CONFIDENCE);
    let share = count as f64 / runs.max(1) as f64;
    format!("{:.2} ({})", 100.0 * share, interval.to_percent_text(2))
}
