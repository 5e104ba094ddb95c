//! Failures per hour and per 1000 km, in spaces fitted to recorded episodes.

use super::distribution::Distribution;
use crate::assessment::table::{Cell, Table};
use crumple_search::evidence::exposed::{ExposedRate, Figure, WithData};

/// A table of a space's controllers and what is to be said of it; none where the space does not say in how much driving it was seen.
pub(super) fn on_the_road(drawn: &Distribution) -> Option<(String, Table)> {
    let rates: Vec<(&str, &ExposedRate)> = drawn
        .controllers
        .iter()
        .filter_map(|sampled| Some((sampled.controller.as_str(), sampled.exposed.as_ref()?)))
        .collect();
    let (_, first) = rates.first()?;
    let mut words = format!(
        "On the road: {} episodes in {} waves were seen in {:.3} h and {:.1} km of following. Intervals are joint ones at {} %, of the number of \
         episodes and of the probability of a failure (Bonferroni).",
        first.episodes,
        first.waves,
        first.hours,
        first.kilometres,
        100.0 * first.confidence
    );
    if let Some(data) = first.with_data {
        words += &format!(
            " With data: {} resamples of the episodes, the space fitted to each, {} runs in each.",
            data.resamples, data.runs_each
        );
    }
    let mut table = Table::new(&[
        "controller",
        "failures per hour",
        "with data",
        "failures per 1000 km",
        "with data",
        "deviation by count, data, runs",
    ]);
    let interval = |figure: Figure| format!("{:.2e} – {:.2e}", figure.lower, figure.upper);
    let shown = |figure: Figure| format!("{:.2e} ({})", figure.estimate, interval(figure));
    for (controller, rate) in rates {
        let data = |of: fn(&WithData) -> Figure| rate.with_data.map_or("–".to_owned(), |data| interval(of(&data)));
        let percent =
            |variance: Option<f64>| variance.map_or("–".to_owned(), |v| format!("{:.0} %", 100.0 * v.sqrt()));
        let parts = rate.with_data.map_or("–".to_owned(), |data| {
            [Some(data.counting_variance), data.data_variance, data.sampling_variance].map(percent).join(", ")
        });
        table.row(vec![
            Cell::text(controller),
            Cell::number(shown(rate.fitted.per_hour)),
            Cell::number(data(|data| data.figures.per_hour)),
            Cell::number(shown(rate.fitted.per_1000_km)),
            Cell::number(data(|data| data.figures.per_1000_km)),
            Cell::number(parts),
        ]);
    }
    Some((words, table))
}
