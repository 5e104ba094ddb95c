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
    /// Index of the parameter among the coordinates of a point.
    coordinate: usize,
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
        reader: &CampaignReader,
        [x_name, y_name]: [&str; 2],
        filter: &EvaluationFilter<'_>,
    ) -> Option<Self> {
        let x_axis = find_axis(reader, x_name)?;
        let y_axis = find_axis(reader, y_name)?;
        let mut cells =
            vec![GridCell::default(); x_axis.cell_bounds.len() * y_axis.cell_bounds.len()];
        for (index, (method, evaluated)) in reader.evaluations().iter().enumerate() {
            let Some(fails) = filter.classify(reader, method, evaluated) else {
                continue;
            };
            let row = y_axis.cell_of(&evaluated.point);
            let column = x_axis.cell_of(&evaluated.point);
            if let Some(cell) = cells.get_mut(row * x_axis.cell_bounds.len() + column) {
                cell.count(index, fails, evaluated.verdict.robustness);
            }
        }
        Some(Self {
            x_axis,
            y_axis,
            cells,
        })
    }
}

/// Returns the axis of a parameter of a campaign; `None` for an unknown name.
fn find_axis(reader: &CampaignReader, name: &str) -> Option<GridAxis> {
    let space = reader.space();
    let coordinate = space
        .coordinate_names()
        .iter()
        .position(|coordinate| coordinate == name)?;
    let parameter = space.coordinate_parameters().nth(coordinate)?;
    let observed = space.observed_range(parameter.name());
    Some(GridAxis::new(name, coordinate, parameter, observed))
}

impl GridCell {
    fn count(&mut self, evaluation: usize, fails: bool, robustness: f64) {
        self.total += 1;
        self.failing += usize::from(fails);
        if self.worst.is_none_or(|(_, least)| robustness < least) {
            self.worst = Some((evaluation, robustness));
        }
    }
}

impl GridAxis {
    fn new(
        name: &str,
        coordinate: usize,
        parameter: &SpaceParameter,
        observed: Option<[f64; 2]>,
    ) -> Self {
        let [low, high] = parameter.range();
        let is_named = parameter.has_named_values();
        // Named values are equidistant in the unit cube, one cell each.
        let count = if is_named {
            (high - low).round().clamp(1.0, 40.0) as usize + 1
        } else {
            CELLS_PER_AXIS
        };
        let cell_bounds = (0..count).map(|index| {
            if is_named {
                let middle = parameter.value((index as f64 + 0.5) / count as f64);
                (parameter.format_value(middle), String::new())
            } else {
                let from = parameter.value(index as f64 / count as f64);
                let to = parameter.value((index + 1) as f64 / count as f64);
                (format_3_digits(from), format_3_digits(to))
            }
        });
        let unit = if parameter.unit() == "1" {
            ""
        } else {
            parameter.unit()
        };
        Self {
            name: name.to_owned(),
            coordinate,
            unit,
            observed,
            cell_bounds: cell_bounds.collect(),
            is_named,
        }
    }

    /// Returns the index of the cell that contains a point of the unit cube.
    fn cell_of(&self, point: &[f64]) -> usize {
        let share = point.get(self.coordinate).copied().unwrap_or(0.0);
        let cells = self.cell_bounds.len();
        ((share * cells as f64) as usize).min(cells - 1)
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
