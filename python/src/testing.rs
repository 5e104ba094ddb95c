//! Families of scenarios and properties for tests.

use crumple_testing::{
    ControllerUnderTest, MetamorphicRelation, Property, PropertyVerdict, Scenarios, ScenariosError,
};
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::{PyScenario, PySpace};
use crate::simulation::ESTIMATORS;
use crate::values::parse_choice;

/// Family of scenarios, of which bytes determine one.
#[pyclass(name = "Family", frozen, module = "crumple.testing")]
pub(crate) struct PyFamily(Scenarios);

#[pymethods]
impl PyFamily {
    #[staticmethod]
    fn any() -> Self {
        Self(Scenarios::any())
    }

    #[staticmethod]
    fn near(py: Python<'_>, scenario: PyRef<'_, PyScenario>) -> PyResult<Self> {
        Self::new(py, Scenarios::near(&scenario.0))
    }

    #[staticmethod]
    fn of_space(space: PyRef<'_, PySpace>) -> Self {
        Self(Scenarios::from(space.0.clone()))
    }

    #[staticmethod]
    fn line_of_five(py: Python<'_>) -> PyResult<Self> {
        Self::new(py, Scenarios::line_of_five())
    }

    #[getter]
    fn byte_count(&self) -> usize {
        self.0.byte_count()
    }

    fn read(&self, bytes: &[u8]) -> PyScenario {
        PyScenario(self.0.read(bytes))
    }
}

impl PyFamily {
    fn new(py: Python<'_>, family: Result<Scenarios, ScenariosError>) -> PyResult<Self> {
        family
            .map(Self)
            .map_err(|error| errors::exception(py, ExceptionClass::Space, &error))
    }
}

/// Property that a controller must have in every scenario.
#[pyclass(name = "Property", frozen, module = "crumple.testing")]
pub(crate) struct PyProperty(Property);

#[pymethods]
impl PyProperty {
    #[staticmethod]
    fn no_avoidable_collision() -> Self {
        Self(Property::no_avoidable_collision())
    }

    #[staticmethod]
    fn no_unnecessary_braking() -> Self {
        Self(Property::no_unnecessary_braking())
    }

    #[staticmethod]
    fn no_amplification() -> Self {
        Self(Property::no_amplification())
    }

    #[staticmethod]
    fn bounded_jerk(max_mps3: f64) -> Self {
        Self(Property::bounded_jerk(max_mps3))
    }

    #[staticmethod]
    fn specification(py: Python<'_>, text: &str) -> PyResult<Self> {
        let property = Property::specification(text);
        property
            .map(Self)
            .map_err(|error| errors::exception(py, ExceptionClass::Formula, &error))
    }

    #[staticmethod]
    fn not_worse_than(reference: &Bound<'_, PyAny>) -> PyResult<Self> {
        let conversion = reference
            .py()
            .import("crumple._controller")?
            .getattr("as_controller")?;
        let reference =
            controller::resolve_controller(&conversion.call1((reference,))?, &StopFlag::default())?;
        Ok(Self(Property::not_worse_than(reference.source)))
    }

    #[staticmethod]
    fn metamorphic(py: Python<'_>, relation: &str) -> PyResult<Self> {
        let (name, amount) = relation.split_once('=').unwrap_or((relation, ""));
        let by = amount
            .parse::<f64>()
            .ok()
            .filter(|by| by.is_finite() && *by > 0.0);
        let relation = match (name, by) {
            ("larger-gap", Some(by_m)) => MetamorphicRelation::LargerGap { by_m },
            ("more-friction", Some(by)) => MetamorphicRelation::MoreFriction { by },
            ("earlier-reaction", Some(by_s)) => MetamorphicRelation::EarlierReaction { by_s },
            _ => {
                let problem = format!(
                    "`{relation}` is not a relation: use larger-gap=M, more-friction=F or earlier-reaction=S, with a \
                     number above 0"
                );
                return Err(errors::exception(py, ExceptionClass::Campaign, &problem));
            }
        };
        Ok(Self(Property::metamorphic(relation)))
    }

    #[staticmethod]
    fn deterministic() -> Self {
        Self(Property::deterministic())
    }

    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }

    /// Returns `holds`, `not applicable` or `violated`, the reason, and a drawing of a violation.
    fn evaluate(
        &self,
        py: Python<'_>,
        controller: &Bound<'_, PyAny>,
        scenario: PyRef<'_, PyScenario>,
        estimator: &str,
    ) -> PyResult<(&'static str, String, String)> {
        let stop = StopFlag::default();
        let source = controller::resolve_controller(controller, &stop)?.source;
        let tested = ControllerUnderTest {
            source,
            estimator: parse_choice("estimator", estimator, &ESTIMATORS)?,
        };
        let scenario = scenario.0.clone();
        run_interruptible(py, &stop, None, |_| {
            match self.0.evaluate(&tested, &scenario) {
                PropertyVerdict::Holds => ("holds", String::new(), String::new()),
                PropertyVerdict::NotApplicable(reason) => ("not applicable", reason, String::new()),
                PropertyVerdict::Violated(reason) => ("violated", reason, tested.draw(&scenario)),
            }
        })
    }
}
