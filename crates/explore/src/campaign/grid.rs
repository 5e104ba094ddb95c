//! Failure grid of a campaign over two parameters: evaluations, failures and the worst one of each cell.

use crumple_search::falsify::campaign::CampaignReader;
use crumple_spaces::SpaceParameter;

use super::EvaluationFilter;

const CELLS_PER_AXIS: usize = 12;

#[derive(Debug)]
pub(crate) struct FailureGrid {
    pub(crate) x_axis: GridAxis,
    pub(crate) y_axis: GridAxis,
    /// Cells row by row, from the smallest value up.
    pub(crate) cells: Vec<GridCell>,
}

#[derive(Debug)]
pub(crate) struct GridAxis {
    pub(crate) name: String,
    /// Unit; empty for a pure number.
    pub(crate) unit: &'static str,
    /// Smallest and largest value in the recordings that the space was fitted to.
    observed: Option<[f64; 2]>,
    /// Formatted bounds of each cell; one name for a parameter with named values.
    pub(crate) cell_bounds: Vec<(String, String)>,
    pub(crate) is_named: bool,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct GridCell {
    pub(crate) total: usize,
    pub(crate) failing: usize,
    /// Index and robustness of the evaluation with the smallest robustness.
    pub(crate) worst: Option<(usize, f64)>,
}

impl FailureGrid {
    /// Counts the evaluations of a campaign in cells of the two named parameters. Returns `None` if the campaign has no
    /// parameter of one of the names.
    pub(crate) fn from_campaign(
        look: &CampaignReader,
        names: [&str; 2],
        chosen: &EvaluationFilter<'_>,
    ) -> Option<Self> {
        let known = look.space().coordinate_names();
        let parameters: Vec<&SpaceParameter> = look.space().coordinate_parameters().collect();
        let side = |name: &str| {
            let place = known.iter().position(|known| known == name)?;
            let parameter = parameters.get(place)?;
            Some((
                place,
                GridAxis::new(
                    name,
                    parameter,
                    look.space().observed_range(parameter.name()),
                ),
            ))
        };
        let [(x, across), (y, up)] = [side(names[0])?, side(names[1])?];
        let mut cells = vec![GridCell::default(); across.cell_bounds.len() * up.cell_bounds.len()];
        for (index, (method, evaluated)) in look.evaluations().iter().enumerate() {
            let Some(fails) = chosen.classify(look, method, evaluated) else {
                continue;
            };
            let at = |side: &GridAxis, coordinate: usize| {
                let share = evaluated.point.get(coordinate).copied().unwrap_or(0.0);
                ((share * side.cell_bounds.len() as f64) as usize).min(side.cell_bounds.len() - 1)
            };
            let place = at(&up, y) * across.cell_bounds.len() + at(&across, x);
            if let Some(cell) = cells.get_mut(place) {
                cell.total += 1;
                cell.failing += usize::from(fails);
                let robustness = evaluated.verdict.robustness;
                if cell.worst.is_none_or(|(_, least)| robustness < least) {
                    cell.worst = Some((index, robustness));
                }
            }
        }
        Some(Self {
            x_axis: across,
            y_axis: up,
            cells,
        })
    }
}

impl GridAxis {
    fn new(name: &str, parameter: &SpaceParameter, observed: Option<[f64; 2]>) -> Self {
        let [low, high] = parameter.range();
        let is_named = parameter.has_named_values();
        // Named values are equidistant in the unit cube, one cell each.
        let count = if is_named {
            (high - low).round().clamp(1.0, 40.0) as usize + 1
        } else {
            CELLS_PER_AXIS
        };
        let value = |share: f64| match is_named {
            true => parameter.format_value(parameter.value(share)),
            false => format_3_digits(parameter.value(share)),
        };
        let cell = |index: usize| match is_named {
            true => (value((index as f64 + 0.5) / count as f64), String::new()),
            false => (
                value(index as f64 / count as f64),
                value((index + 1) as f64 / count as f64),
            ),
        };
        let unit = if parameter.unit() == "1" {
            ""
        } else {
            parameter.unit()
        };
        Self {
            name: name.to_owned(),
            unit,
            observed,
            cell_bounds: (0..count).map(cell).collect(),
            is_named,
        }
    }

    pub(crate) fn title(&self) -> String {
        let observed = self
            .observed
            .map(|range| range.map(format_3_digits).join(" to "));
        let observed = observed.map_or(String::new(), |range| format!(", observed {range}"));
        let unit = if self.unit.is_empty() {
            String::new()
        } else {
            format!(" ({})", self.unit)
        };
        format!("{}{unit}{observed}", self.name)
    }

    pub(crate) fn cell_label(&self, cell: usize) -> String {
        let Some((from, to)) = self.cell_bounds.get(cell) else {
            return String::new();
        };
        let unit = if self.unit.is_empty() {
            String::new()
        } else {
            format!(" {}", self.unit)
        };
        match self.is_named {
            true => format!("{} {from}", self.name),
            false => format!("{} {from} to {to}{unit}", self.name),
        }
    }
}

fn format_3_digits(value: f64) -> String {
    let digits = if value == 0.0 {
        0
    } else {
        (2 - value.abs().log10().floor() as i32).clamp(0, 6)
    };
    let text = format!("{value:.*}", digits as usize);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}
