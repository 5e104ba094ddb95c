//! The rows as a page in Markdown.

use super::drives::ImportedDrives;
use super::row::{ControllerRow, FollowerCounts, RowConfig, SEED, SPACE, SuiteScore};
use crumple::evidence::DriveComfort;
use crumple::suites::DISCLAIMER;
use crumple_core::digits::{format_fixed, format_fixed_down, format_fixed_up};
use crumple_core::markdown::Markdown;

/// Renders the page.
pub(super) fn render(rows: &[ControllerRow], config: &RowConfig) -> String {
    let mut page = Markdown::default();
    page.heading(1, "All controllers");
    page.paragraph(
        "This page has all built-in and fitted controllers that drive by themselves, in the same tests, with the \
         Kalman filter. It leaves out those that serve tests only (`crumple list --all`). Three groups need care. \
         `car:...` are the emergency brakes of cars, which hold their speed until they brake; they are valid only in \
         the tests with which they were compared. `cruise:...` are cruise controls, fitted to recordings without \
         emergencies: their results in emergencies say nothing about the cars. `shield2:...` is made for the true \
         state. With the errors of the filter, it finds a plan against full braking of the leader in few states. In \
         the other states, it protects only against milder braking of the leader, or not at all.",
    );
    page.paragraph(
        "The command, with the FOLDER that `examples/studies/openacc/fetch.py` fills: `cargo run --release -p \
         crumple-experiments -- controllers target/controllers recordings=FOLDER > reports/controllers.md`.",
    );
    page.heading(2, "Tests, gain and recorded drives");
    page.list(column_notes(config));
    page.plain_table(
        &header(rows).iter().map(String::as_str).collect::<Vec<_>>(),
        rows.iter().map(cells),
    );
    page.heading(2, "Collisions with each kind of follower");
    page.paragraph(format!(
        "The scenarios are the first {} random ones of the space `{SPACE}` (seed {SEED}), which has the emergencies \
         of `high-risk`. Each is simulated with every kind of follower (defined in `driver.md`). Cells have two \
         shares in percent: the vehicle first hits its leader / the follower first hits the vehicle. A drive in which \
         the controller gives no answer counts as a hit of the leader.",
        config.draws
    ));
    page.plain_table(
        &follower_header(rows)
            .iter()
            .map(String::as_str)
            .collect::<Vec<_>>(),
        rows.iter().map(|row| follower_cells(row, config.draws)),
    );
    page.into_string()
        + "\nSee also [the emergency brakes](credibility.md), [the cruise controls](openacc.md), \
           [the drivers](driver.md) and [all margins](suites.md).\n"
}

/// Explains the columns of the first table.
fn column_notes(config: &RowConfig) -> [String; 5] {
    [
        DISCLAIMER.replacen("Modelled", "Each suite is modelled", 1),
        "Suites: passed tests of those that can be run, and refused tests (those outside one lane and, with a shield, \
         those without a guarantee). Brackets have the mean margin over the tests that can be run. To find the margin \
         of a passed test, crumple makes the test harder in one parameter at a time, over a range. The share of the \
         range up to which the test passes is the margin; of several parameters, the smallest share counts. The \
         margin of a failed test is 0."
            .to_owned(),
        "Largest gain: that of a line of vehicles with the true state, for oscillations of 0.3 m/s at 0.05 to 2 rad/s \
         around 4 to 30 m/s. Above 1, oscillations grow from vehicle to vehicle. None: no line settles."
            .to_owned(),
        config
            .drives
            .as_ref()
            .map_or_else(|| "Recorded drives were not counted.".to_owned(), describe_drives),
        "`autoware-aeb` has the values of Autoware's parameter file. The row with an offset of 2 m, and 3 m/s² for the \
         braking of the object, has those of Autoware's documentation. The rows with offsets of 4 and 6 m and with a \
         response time of 2 s have values that users discuss for Autoware's cruise planner, not for its emergency \
         brake (autoware_launch, pull request 1166)."
            .to_owned(),
    ]
}

fn describe_drives(drives: &ImportedDrives) -> String {
    let recorded = DriveComfort::of_recorded_cars(&drives.set);
    format!(
        "Unnecessary braking: number per hour in {} drives of {} recordings of OpenACC ({:.1} hours), and its 95 % \
         interval, which is exact for independent events. Square brackets: unnecessary braking per hour that the \
         first number leaves out, because the same drive without the simulated follower has none. The follower causes \
         this braking, so it does not count against the controller here; `driver.md` counts it. The recorded cars: \
         {}. Collisions: drives in which the vehicle hits its leader or the controller gives no answer / drives in \
         which the follower hits the vehicle. This follower, `human`, starts at the gap of the recorded car; the \
         collision may be due to it, and not to the controller.",
        drives.set.drives().len(),
        drives.recordings,
        recorded.hours,
        describe_rate(&recorded.unnecessary_braking.per_hour_interval())
    )
}

fn header(rows: &[ControllerRow]) -> Vec<String> {
    let suites = rows.iter().take(1).flat_map(|row| &row.suites);
    let suites = suites.map(|score| score.suite.clone());
    let last = ["largest gain", "unnecessary braking", "collisions"].map(str::to_owned);
    std::iter::once("controller".to_owned())
        .chain(suites)
        .chain(last)
        .collect()
}

fn cells(row: &ControllerRow) -> Vec<String> {
    let mut cells = vec![row.controller.clone()];
    cells.extend(row.suites.iter().map(suite_cell));
    let gain = row.largest_gain;
    cells.push(gain.map_or("none".to_owned(), |gain| format_fixed(gain, 3)));
    match &row.drives {
        None => cells.extend(["not counted", "not counted"].map(str::to_owned)),
        Some(drives) => {
            let caused_behind = format_fixed(drives.caused_behind_per_hour, 2);
            let rate = describe_rate(&drives.unnecessary_per_hour);
            cells.push(format!("{rate} [{caused_behind}]"));
            cells.push(format!("{} / {}", drives.hits, drives.hit_from_behind));
        }
    }
    cells
}

fn suite_cell(score: &SuiteScore) -> String {
    let refused = match score.refused {
        0 => String::new(),
        count => format!(", {count} refused"),
    };
    match score.run {
        0 => format!("–{refused}"),
        run => {
            let margin = format_fixed(score.margin_percent, 0);
            format!("{} of {run}{refused} ({margin} %)", score.passed)
        }
    }
}

fn describe_rate(&[rate, lower, upper]: &[f64; 3]) -> String {
    format!(
        "{} ({} to {})",
        format_fixed(rate, 2),
        format_fixed_down(lower, 2),
        format_fixed_up(upper, 2)
    )
}

fn follower_header(rows: &[ControllerRow]) -> Vec<String> {
    let kinds = rows.iter().take(1).flat_map(|row| &row.followers);
    let kinds = kinds.map(|counts| counts.follower.clone());
    std::iter::once("controller".to_owned())
        .chain(kinds)
        .collect()
}

fn follower_cells(row: &ControllerRow, draws: u64) -> Vec<String> {
    let percent = |count: u64| format_fixed(100.0 * count as f64 / draws as f64, 1);
    let cell = |counts: &FollowerCounts| {
        let ahead = percent(counts.hits + counts.unanswered);
        format!("{ahead} / {}", percent(counts.hit_from_behind))
    };
    let kinds = row.followers.iter().map(cell);
    std::iter::once(row.controller.clone())
        .chain(kinds)
        .collect()
}
