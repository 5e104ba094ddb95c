//! Failure maps: collisions of each controller over two parameters, and whether they are avoidable.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::failure_maps_figure;
use super::map_cell::{MapCell, MapRow};
use super::map_grid::{FailureMapAxis, FixedParameter, fixed_parameters, grid_scenarios};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, ReportPart};
use crumple_search::worst_case::{AvoidOptions, AvoidanceVerdict, avoid};
use crumple_world::scenario::Scenario;
use crumple_world::scenario::space::built_in_space;
use crumple_world::sim::{NamedController, RecordingLevel, Run, RunOptions, simulate_batch};

const SPACE: &str = "high-risk";

/// Horizontal and vertical parameter. Collisions are unavoidable only with little grip and hard braking.
const ACROSS: (&str, &str) = ("friction", "Friction of the road (1 is dry)");
const UP: (&str, &str) = ("lead_brake_share", "Braking of the leader (share of the road's limit)");

/// Number of columns and rows. Three in five cells need a convex program of about 50 ms.
const CELLS: (usize, usize) = (14, 14);

/// Maximum number of maps: the first controller and learned policies.
const MAX_MAPS: usize = 4;

/// Maps of the same scenarios, one per controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureMaps {
    /// Scenario space of the scenarios.
    pub space: String,
    /// Parameter that grows from left to right.
    pub across: FailureMapAxis,
    /// Parameter that grows from bottom to top.
    pub up: FailureMapAxis,
    /// Other parameters of the space and their fixed values.
    #[serde(rename = "held")]
    pub fixed_parameters: Vec<FixedParameter>,
    /// Number of scenarios in which every controller collides, so that a convex program had to decide.
    pub programs: usize,
    /// One map per controller.
    pub maps: Vec<FailureMap>,
}

/// The map of one controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureMap {
    /// Name of the controller.
    pub controller: String,
    /// Rows from top to bottom.
    pub rows: Vec<MapRow>,
}

impl FailureMaps {
    pub(in crate::assessment) fn gather(work: &GatherContext<'_>) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if !plan.config.paper {
            return Ok(None);
        }
        let inputs = json!([plan.config.seed, plan.identities()]);
        work.get_or_gather("failure maps", &inputs, || Self::compute(plan, [ACROSS, UP], CELLS))
    }

    fn compute(
        plan: &AssessmentPlan,
        named: [(&str, &str); 2],
        cells: (usize, usize),
    ) -> Result<Option<Self>, AssessError> {
        let Some(space) = built_in_space(SPACE) else { return Ok(None) };
        let space = space.with_noise_seed(plan.config.seed);
        let find = |name: &str| space.parameters().iter().find(|parameter| parameter.name() == name);
        let (Some(across), Some(up)) = (find(named[0].0), find(named[1].0)) else { return Ok(None) };
        let axes = (
            FailureMapAxis::new(&space, across, named[0].1, cells.0),
            FailureMapAxis::new(&space, up, named[1].1, cells.1),
        );
        let scenarios = grid_scenarios(&space, (across, up), &axes)?;

        let touched = simulate_contacts(plan, &scenarios)?;
        let survives = |cell: usize| touched.iter().any(|cells| cells.get(cell) == Some(&false));
        let survived: Vec<bool> = (0..scenarios.len()).map(survives).collect();
        let fates: Vec<MapCell> =
            scenarios.par_iter().zip(&survived).map(|(s, &survived)| classify_cell(s, survived)).collect();

        let of = |(controller, touched): (&NamedController, &Vec<bool>)| {
            let cell = |(&touched, &fate)| if touched { fate } else { MapCell::NoContact };
            let drawn: Vec<MapCell> = touched.iter().zip(&fates).map(cell).collect();
            let rows = drawn.chunks(cells.0).map(|row| MapRow(row.to_vec())).collect();
            FailureMap { controller: controller.name.clone(), rows }
        };
        let first = plan.controllers.first().map(|controller| controller.name.as_str());
        let shown = plan.controllers.iter().zip(&touched);
        let shown =
            shown.filter(|(controller, _)| Some(controller.name.as_str()) == first || controller.kind.is_learned());
        Ok(Some(Self {
            space: SPACE.to_owned(),
            fixed_parameters: fixed_parameters(&space, (across, up)),
            programs: survived.iter().filter(|survived| !**survived).count(),
            maps: shown.take(MAX_MAPS).map(of).collect(),
            across: axes.0,
            up: axes.1,
        }))
    }
}

/// Returns the occurrence of collisions. Shape: `[controller][cell]`.
fn simulate_contacts(plan: &AssessmentPlan, scenarios: &[Scenario]) -> Result<Vec<Vec<bool>>, AssessError> {
    let prepared = plan.controllers.iter().flat_map(|controller| {
        let options = RunOptions::new(controller.kind.clone()).with_estimator(plan.config.estimator);
        scenarios.iter().map(move |scenario| Run::new(scenario, options.clone()))
    });
    let runs = prepared.collect::<Result<Vec<_>, _>>()?;
    let touched = simulate_batch(&runs, RecordingLevel::Summary, |_, simulated| !simulated.outcome.is_safe());
    Ok(touched.chunks(scenarios.len().max(1)).map(<[bool]>::to_vec).collect())
}

/// Classifies a scenario with a collision. If another run has none (`survived`), no convex program is needed.
fn classify_cell(scenario: &Scenario, survived: bool) -> MapCell {
    if survived {
        return MapCell::Avoidable;
    }
    match avoid(scenario, AvoidOptions::default()).map(|found| found.verdict) {
        Ok(AvoidanceVerdict::Avoidable(_)) => MapCell::Avoidable,
        Ok(AvoidanceVerdict::Unavoidable(_)) => MapCell::Unavoidable,
        Ok(AvoidanceVerdict::Undecided(_)) | Err(_) => MapCell::Undecided,
    }
}

impl FailureMap {
    /// Returns the number of cells of a kind.
    #[must_use]
    pub fn count(&self, kind: MapCell) -> usize {
        self.rows.iter().flat_map(|row| &row.0).filter(|cell| **cell == kind).count()
    }
}

impl FailureMaps {
    fn introduction(&self) -> String {
        let held: Vec<_> =
            self.fixed_parameters.iter().map(|held| format!("{} {}", held.parameter, held.value)).collect();
        format!(
            "Scenarios of the space {} over {} and {}; other parameters are nominal ({}). Each of the {} cells is one \
             scenario, run for every controller. If every controller of this report collides ({} cells), a convex \
             program searches for an escape or a proof that there is none. Percentages are shares of cells, not of \
             traffic.",
            self.space,
            self.across.parameter,
            self.up.parameter,
            held.join(", "),
            self.across.values.len() * self.up.values.len(),
            self.programs,
        )
    }

    fn table(&self) -> ReportTable {
        let kinds = MapCell::ALL.map(MapCell::label);
        let header: Vec<&str> =
            ["controller"].into_iter().chain(kinds).chain(["avoidable cells without collision"]).collect();
        let mut table = ReportTable::new(&header);
        for map in &self.maps {
            let cells = MapCell::ALL.map(|kind| map.count(kind)).iter().sum::<usize>();
            let share = |count: usize, of: usize| match of {
                0 => "–".to_owned(),
                _ => format!("{count} ({:.1} %)", 100.0 * count as f64 / of as f64),
            };
            let survived = map.count(MapCell::NoContact);
            let counts = MapCell::ALL.map(|kind| ReportCell::number(share(map.count(kind), cells)));
            let of_avoidable = ReportCell::number(share(survived, survived + map.count(MapCell::Avoidable)));
            table.push_row(
                std::iter::once(ReportCell::text(&map.controller)).chain(counts).chain([of_avoidable]).collect(),
            );
        }
        table
    }
}

impl ReportPart for FailureMaps {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("maps", "Failure maps".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(&self.introduction());
        out.figure(failure_maps_figure::draw_responsive(self));
        out.table(&self.table());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::sim::simulate;

    fn small_maps() -> (AssessmentPlan, FailureMaps) {
        let plan = AssessmentPlan::built_in();
        let maps = FailureMaps::compute(&plan, [ACROSS, UP], (4, 5)).unwrap().unwrap();
        (plan, maps)
    }

    #[test]
    fn cells_agree_with_single_runs_of_the_values_beside_them() {
        let (plan, maps) = small_maps();
        let space = built_in_space(SPACE).unwrap();
        assert!(maps.maps.len() >= 2 && maps.maps.iter().any(|map| map.controller == "policy"));
        let mut kinds = std::collections::HashSet::new();
        for map in &maps.maps {
            let contender = plan.controllers.iter().find(|c| c.name == map.controller).unwrap();
            assert_eq!(map.rows.len(), 5);
            for (row, y) in map.rows.iter().zip(maps.up.values.iter().rev()) {
                assert_eq!(row.0.len(), 4);
                for (&cell, x) in row.0.iter().zip(&maps.across.values) {
                    let mut values = space.nominal();
                    for (name, value) in [(ACROSS.0, x.value()), (UP.0, y.value())] {
                        let parameter = space.parameters().iter().find(|p| p.name() == name).unwrap();
                        values[parameter.coordinates()].fill(value);
                    }
                    let scenario = space.scenario(&values).unwrap();
                    let run = Run::new(&scenario, RunOptions::new(contender.kind.clone())).unwrap();
                    let touched = !simulate(&run, RecordingLevel::Summary).outcome.is_safe();
                    assert_eq!(cell == MapCell::NoContact, !touched, "{} at {x}, {y}", map.controller);
                    kinds.insert(cell.letter());
                }
            }
        }
        assert!(['.', 'x', '#'].iter().all(|letter| kinds.contains(letter)), "the grid shows no contrast: {kinds:?}");
    }

    #[test]
    fn what_one_controller_survives_is_unavoidable_for_none() {
        let (_, maps) = small_maps();
        for (row, _) in maps.up.values.iter().enumerate() {
            for column in 0..maps.across.values.len() {
                let cells: Vec<_> = maps.maps.iter().map(|map| map.rows[row].0[column]).collect();
                let fates: std::collections::HashSet<_> =
                    cells.iter().filter(|cell| **cell != MapCell::NoContact).map(|cell| cell.letter()).collect();
                assert!(fates.len() <= 1, "{cells:?}");
                assert!(!cells.contains(&MapCell::NoContact) || !cells.contains(&MapCell::Unavoidable), "{cells:?}");
            }
        }
        for map in &maps.maps {
            assert_eq!(MapCell::ALL.map(|kind| map.count(kind)).iter().sum::<usize>(), 20);
        }
    }

    #[test]
    fn the_evidence_reads_back_as_it_was() {
        let (_, maps) = small_maps();
        let text = serde_json::to_string(&maps).unwrap();
        assert_eq!(serde_json::from_str::<FailureMaps>(&text).unwrap(), maps);
        assert!(serde_json::from_str::<MapRow>("\".x#!\"").is_err());
    }
}
