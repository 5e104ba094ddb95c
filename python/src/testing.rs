//! Families of scenarios and properties for tests.

use crumple_testing::{
    ControllerUnderTest, MetamorphicRelation, Property, PropertyVerdict, Scenarios, ScenariosError,
};
use pyo3::PyTypeInfo;
use pyo3::prelude::*;
use pyo3::types::{PyTuple, PyType};

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::{PyScenario, PySpace};
use crate::simulation::ESTIMATORS;
use crate::values::parse_choice;

/// Call of a static method that creates a value, for pickles.
struct Recipe {
    method: &'static str,
    arguments: Py<PyTuple>,
}

/// Function that calls a static method of a class, and its arguments: class, method, arguments.
type Reduced<'py> = (
    Bound<'py, PyAny>,
    (Bound<'py, PyType>, &'static str, Bound<'py, PyTuple>),
);

impl Recipe {
    fn new<'py>(
        py: Python<'py>,
        method: &'static str,
        arguments: impl IntoPyObject<
            'py,
            Target = PyTuple,
            Output = Bound<'py, PyTuple>,
            Error: Into<PyErr>,
        >,
    ) -> PyResult<Self> {
        let arguments = arguments.into_pyobject(py).map_err(Into::into)?.unbind();
        Ok(Self { method, arguments })
    }

    fn reduce<'py, T: PyTypeInfo>(&self, py: Python<'py>) -> PyResult<Reduced<'py>> {
        let call = py
            .import("crumple._pickle")?
            .getattr("call_static_method")?;
        let arguments = self.arguments.bind(py).clone();
        Ok((call, (py.get_type::<T>(), self.method, arguments)))
    }
}

/// Family of scenarios, of which bytes determine one.
#[pyclass(name = "Family", frozen, module = "crumple.testing")]
pub(crate) struct PyFamily {
    scenarios: Scenarios,
    recipe: Recipe,
}

#[pymethods]
impl PyFamily {
    #[staticmethod]
    fn any(py: Python<'_>) -> PyResult<Self> {
        Ok(Self {
            scenarios: Scenarios::any(),
            recipe: Recipe::new(py, "any", ())?,
        })
    }

    #[staticmethod]
    fn near(py: Python<'_>, scenario: Bound<'_, PyScenario>) -> PyResult<Self> {
        let family = Scenarios::near(&scenario.get().0);
        Self::new(py, family, Recipe::new(py, "near", (scenario,))?)
    }

    #[staticmethod]
    fn of_space(py: Python<'_>, space: Bound<'_, PySpace>) -> PyResult<Self> {
        Ok(Self {
            scenarios: Scenarios::from(space.get().0.clone()),
            recipe: Recipe::new(py, "of_space", (space,))?,
        })
    }

    #[staticmethod]
    fn line_of_five(py: Python<'_>) -> PyResult<Self> {
        let recipe = Recipe::new(py, "line_of_five", ())?;
        Self::new(py, Scenarios::line_of_five(), recipe)
    }

    #[getter]
    fn byte_count(&self) -> usize {
        self.scenarios.byte_count()
    }

    fn read(&self, bytes: &[u8]) -> PyScenario {
        PyScenario(self.scenarios.read(bytes))
    }

    /// Pickles the call that made the family.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py>> {
        self.recipe.reduce::<Self>(py)
    }
}

impl PyFamily {
    fn new(
        py: Python<'_>,
        family: Result<Scenarios, ScenariosError>,
        recipe: Recipe,
    ) -> PyResult<Self> {
        family
            .map(|scenarios| Self { scenarios, recipe })
            .map_err(|error| errors::exception(py, ExceptionClass::Space, &error))
    }
}

/// Property that a controller must have in every scenario.
#[pyclass(name = "Property", frozen, module = "crumple.testing")]
pub(crate) struct PyProperty {
    property: Property,
    recipe: Recipe,
}

#[pymethods]
impl PyProperty {
    #[staticmethod]
    fn no_avoidable_collision(py: Python<'_>) -> PyResult<Self> {
        let recipe = Recipe::new(py, "no_avoidable_collision", ())?;
        Ok(Self::new(Property::no_avoidable_collision(), recipe))
    }

    #[staticmethod]
    fn no_unnecessary_braking(py: Python<'_>) -> PyResult<Self> {
        let recipe = Recipe::new(py, "no_unnecessary_braking", ())?;
        Ok(Self::new(Property::no_unnecessary_braking(), recipe))
    }

    #[staticmethod]
    fn no_amplification(py: Python<'_>) -> PyResult<Self> {
        let recipe = Recipe::new(py, "no_amplification", ())?;
        Ok(Self::new(Property::no_amplification(), recipe))
    }

    #[staticmethod]
    fn bounded_jerk(py: Python<'_>, max_mps3: f64) -> PyResult<Self> {
        let recipe = Recipe::new(py, "bounded_jerk", (max_mps3,))?;
        Ok(Self::new(Property::bounded_jerk(max_mps3), recipe))
    }

    #[staticmethod]
    fn specification(py: Python<'_>, text: &str) -> PyResult<Self> {
        let property = Property::specification(text)
            .map_err(|error| errors::exception(py, ExceptionClass::Formula, &error))?;
        Ok(Self::new(
            property,
            Recipe::new(py, "specification", (text,))?,
        ))
    }

    #[staticmethod]
    fn not_worse_than(reference: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = reference.py();
        let recipe = Recipe::new(py, "not_worse_than", (reference,))?;
        let conversion = py.import("crumple._controller")?.getattr("as_controller")?;
        let reference =
            controller::resolve_controller(&conversion.call1((reference,))?, &StopFlag::default())?;
        Ok(Self::new(
            Property::not_worse_than(reference.source),
            recipe,
        ))
    }

    #[staticmethod]
    fn metamorphic(py: Python<'_>, relation: &str) -> PyResult<Self> {
        let recipe = Recipe::new(py, "metamorphic", (relation,))?;
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
        Ok(Self::new(Property::metamorphic(relation), recipe))
    }

    #[staticmethod]
    fn deterministic(py: Python<'_>) -> PyResult<Self> {
        let recipe = Recipe::new(py, "deterministic", ())?;
        Ok(Self::new(Property::deterministic(), recipe))
    }

    #[getter]
    fn name(&self) -> &str {
        self.property.name()
    }

    /// Pickles the call that made the property.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py>> {
        self.recipe.reduce::<Self>(py)
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
        run_interruptible(py, &stop, None, None, |_| {
            match self.property.evaluate(&tested, &scenario) {
                PropertyVerdict::Holds => ("holds", String::new(), String::new()),
                PropertyVerdict::NotApplicable(reason) => ("not applicable", reason, String::new()),
                PropertyVerdict::Violated(reason) => ("violated", reason, tested.draw(&scenario)),
            }
        })
    }
}

impl PyProperty {
    fn new(property: Property, recipe: Recipe) -> Self {
        Self { property, recipe }
    }
}
