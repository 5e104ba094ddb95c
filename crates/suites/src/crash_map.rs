//! Crash maps: a situation over two parameters, simulated with the reference drivers and with given controllers.

use crumple_world::control::{ControllerSpec, Role};
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::NamedController;
use serde::Serialize;

use super::result::{DISCLAIMER, TestVerdict};
use super::run::{ControllerSetup, Criterion, RunResult, SuiteRunError};
use super::situation::{Boundary, CrashMapAxis, CrashMapSituation};

const MAX_CELLS: usize = 100;

/// Situation and resolution of a crash map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrashMapSpec {
    situation: CrashMapSituation,
    cells: [usize; 2],
}

/// Problem of a crash map specification.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapProblem {
    /// The fixed parameter is out of range.
    #[error("must be from {low} to {high} {unit}, found {found}")]
    OutOfRange {
        /// Smallest allowed value.
        low: f64,
        /// Largest allowed value.
        high: f64,
        /// Unit of the values.
        unit: &'static str,
        /// Value that was given.
        found: f64,
    },
    /// Too few cells or too many.
    #[error("must have 2 to {MAX_CELLS} cells in each direction, found {0}x{1}")]
    Cells(usize, usize),
}

/// A crash map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CrashMap {
    /// Scope of the result: [`DISCLAIMER`].
    pub statement: &'static str,
    /// Situation with its fixed parameter.
    pub situation: CrashMapSituation,
    /// Horizontal axis, from left to right.
    pub across: CrashMapAxis,
    /// Vertical axis, from bottom to top.
    pub up: CrashMapAxis,
    /// Estimator of the controllers. Reference drivers observe the true state.
    pub estimator: EstimatorKind,
    /// Boundaries of collisions by closed forms.
    pub boundaries: Vec<Boundary>,
    /// Points (x, y) from the document. It requires that there is no collision there, nor with a longer gap or TTC at
    /// the same x.
    #[serde(rename = "stated")]
    pub stated_points: Vec<[f64; 2]>,
    /// Results, one per driver, the reference drivers first.
    pub panels: Vec<MapPanel>,
}

/// Results of one driver.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapPanel {
    /// Name of the driver.
    pub driver: String,
    /// True for a reference driver.
    pub is_reference: bool,
    /// Number of cells that end in a collision.
    pub contacts: usize,
    /// Number of these cells in which the driver never braked. For a reference driver this means that its model does
    /// not cover the situation.
    pub without_reaction: usize,
    /// Number of cells that contradict the driver's closed form; `None` without one.
    pub unlike_closed_form: Option<usize>,
    /// All cells, row by row from the bottom, each row from the left.
    pub cells: Vec<CrashCell>,
}

/// Result of one driver at one point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CrashCell {
    /// Value on the horizontal axis.
    pub across: f64,
    /// Value on the vertical axis.
    pub up: f64,
    /// Verdict of the simulation.
    #[serde(flatten)]
    pub verdict: TestVerdict,
    /// Smallest gap, in metres.
    pub min_gap_m: Option<f64>,
    /// Maximum deceleration of the vehicle under test, in m/s², positive; 0 if it never braked.
    pub max_brake_mps2: f64,
}

impl CrashMapSpec {
    /// Creates a specification with these numbers of cells per axis.
    ///
    /// # Errors
    /// [`MapProblem`] if a value is out of range.
    pub fn new(situation: CrashMapSituation, cells: [usize; 2]) -> Result<Self, MapProblem> {
        let ([low, high], unit, found) = situation.fixed_parameter();
        if !(low..=high).contains(&found) {
            return Err(MapProblem::OutOfRange { low, high, unit, found });
        }
        match cells.iter().all(|cells| (2..=MAX_CELLS).contains(cells)) {
            true => Ok(Self { situation, cells }),
            false => Err(MapProblem::Cells(cells[0], cells[1])),
        }
    }

    /// Simulates every cell with every driver. The result does not depend on the number of threads.
    ///
    /// # Errors
    /// [`SuiteRunError`] if a controller is refused during the run, or a cell makes no scenario.
    pub fn run(&self, controllers: &[NamedController], estimator: EstimatorKind) -> Result<CrashMap, SuiteRunError> {
        let situation = self.situation;
        let [across, up] = situation.axes(self.cells);
        let points: Vec<[f64; 2]> = (0..up.cells)
            .flat_map(|row| (0..across.cells).map(move |column| [across.cell_middle(column), up.cell_middle(row)]))
            .collect();
        let scenarios =
            points.iter().map(|&[across, up]| situation.scenario(across, up)).collect::<Result<Vec<_>, _>>()?;
        let boundaries = situation.boundaries([&across, &up]);
        let references = ControllerSpec::all().into_iter().filter(|spec| spec.role() == Role::Reference);
        let references = references.map(|spec| (NamedController::from(spec), EstimatorKind::Truth, true));
        let asked = controllers.iter().map(|one| (one.clone(), estimator, false));
        let panel = |(controller, estimator, is_reference): (NamedController, _, bool)| {
            let driven = ControllerSetup { controller: &controller.kind, estimator };
            let seen = driven.run_scenarios(Criterion::no_contact(situation.lead_maneuver()), &scenarios);
            controller.ensure_trusted()?;
            let driver = controller.name;
            let cell = |(&[across, up], seen): (&[f64; 2], RunResult)| {
                let RunResult { verdict, min_gap_m, max_brake_mps2 } = seen;
                CrashCell { across, up, verdict, min_gap_m, max_brake_mps2 }
            };
            let cells: Vec<CrashCell> = points.iter().zip(seen).map(cell).collect();
            let own = boundaries.iter().find(|line| is_reference && line.driver == Some(driver.as_str()));
            let unlike = |line: &Boundary| {
                let says = |cell: &&CrashCell| situation.predicts_contact(line, [cell.across, cell.up]);
                cells.iter().filter(|cell| says(cell).is_some_and(|touches| touches != cell.is_contact())).count()
            };
            Ok(MapPanel {
                contacts: cells.iter().filter(|cell| cell.is_contact()).count(),
                without_reaction: cells.iter().filter(|cell| cell.is_without_reaction()).count(),
                unlike_closed_form: own.map(unlike),
                driver,
                is_reference,
                cells,
            })
        };
        let panels = references.chain(asked).map(panel).collect::<Result<_, SuiteRunError>>()?;
        let stated_points = situation.stated_points();
        Ok(CrashMap { statement: DISCLAIMER, situation, across, up, estimator, boundaries, stated_points, panels })
    }
}

impl CrashCell {
    #[must_use]
    pub(crate) fn is_contact(&self) -> bool {
        matches!(self.verdict, TestVerdict::Failed { .. })
    }

    /// True if the cell ends in a collision and the driver never braked.
    #[must_use]
    pub fn is_without_reaction(&self) -> bool {
        self.is_contact() && self.max_brake_mps2 == 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::scenario::VehicleClass;

    const SITUATIONS: [CrashMapSituation; 3] = [
        CrashMapSituation::CarFollowing { time_gap_s: 1.0 },
        CrashMapSituation::CutInGap { own_speed_kmph: 100.0 },
        CrashMapSituation::CutInTime { own_speed_kmph: 100.0 },
    ];

    /// No driver avoids a collision that full braking at once cannot avoid. The simple driver agrees with its closed
    /// form except in cells next to the boundary: there the time step, or the driver's margin of a metre, changes the
    /// result.
    #[test]
    fn maps_agree_with_closed_forms() {
        for situation in SITUATIONS {
            let spec = CrashMapSpec::new(situation, [12, 10]).unwrap();
            let drivers = ["full-brake", "baseline", "acc-aeb"].map(|name| NamedController::find(name, "".as_ref()));
            let drivers: Vec<_> = drivers.into_iter().flatten().collect();
            let map = spec.run(&drivers, EstimatorKind::Truth).unwrap();
            let hardest = Boundary {
                label: String::new(),
                driver: None,
                reaction_s: 0.0,
                brake_mps2: VehicleClass::Light.max_brake_mps2(),
                points: Vec::new(),
            };
            for panel in &map.panels {
                assert_eq!(panel.cells.len(), 120);
                for cell in &panel.cells {
                    let touches = situation.predicts_contact(&hardest, [cell.across, cell.up]).unwrap();
                    assert!(
                        !touches || !cell.verdict.is_passed(),
                        "{}: {} at {cell:?}",
                        situation.name(),
                        panel.driver
                    );
                }
            }
            let simple = map.panels.iter().find(|panel| panel.driver == "r157-simple").unwrap();
            assert!(simple.unlike_closed_form.unwrap() <= 2, "{}: {simple:?}", situation.name());
            assert!((1..120).contains(&simple.contacts), "{}", situation.name());
        }
    }

    #[test]
    fn rows_of_the_table_are_on_the_map_by_time_and_by_gap() {
        let [_, by_gap, by_time] = SITUATIONS.map(CrashMapSituation::stated_points);
        let stated = [[10.0, 0.48], [20.0, 0.71], [30.0, 0.94], [40.0, 1.18], [50.0, 1.41], [60.0, 1.64]];
        assert_eq!(by_time, stated);
        for ([_, gap_m], [slower_kmph, time_s]) in by_gap.into_iter().zip(by_time) {
            assert!((gap_m - time_s * slower_kmph / 3.6).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        for time_gap_s in [f64::NAN, 0.0, 11.0, -1.0, f64::INFINITY] {
            assert!(CrashMapSpec::new(CrashMapSituation::CarFollowing { time_gap_s }, [2, 2]).is_err());
        }
        for own_speed_kmph in [f64::NAN, 29.0, 251.0] {
            assert!(CrashMapSpec::new(CrashMapSituation::CutInGap { own_speed_kmph }, [2, 2]).is_err());
        }
        for cells in [[1, 2], [2, 1], [101, 2], [0, 0], [usize::MAX, 2]] {
            assert!(CrashMapSpec::new(SITUATIONS[0], cells).is_err());
        }
        for (held, least) in [(30.0, 15.0), (250.0, 85.0)] {
            let [across, _] = CrashMapSituation::CutInGap { own_speed_kmph: held }.axes([5, 5]);
            assert_eq!(across.high - across.low, least);
        }
    }
}
