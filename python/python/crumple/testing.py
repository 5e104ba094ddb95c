"""Property tests of controllers with Hypothesis: strategies of scenarios, and the properties of ``crumple-testing``."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import Literal

from hypothesis import assume, currently_in_test_context
from hypothesis import strategies as st

from crumple._controller import as_controller
from crumple._crumple import Family, Property, Scenario
from crumple._simulate import ControllerLike, ScenarioLike, SpaceLike
from crumple._simulate import scenario as find_scenario
from crumple._simulate import space as find_space

__all__ = ["Property", "PropertyViolated", "any_scenario", "check", "line_of_five", "near", "scenarios"]


class PropertyViolated(AssertionError):  # noqa: N818 (an assertion fails, not the package)
    """A controller violates a property; the message has the finding, the scenario's file and a drawing."""


def any_scenario() -> st.SearchStrategy[Scenario]:
    """Scenarios with two to six vehicles, any drivers and any road."""
    return _strategy(Family.any())


def near(scenario: ScenarioLike) -> st.SearchStrategy[Scenario]:
    """Variations of a scenario: friction, gaps, speeds, delays and the leader's script change by up to a quarter."""
    return _strategy(Family.near(find_scenario(scenario)))


def scenarios(space: SpaceLike = "high-risk") -> st.SearchStrategy[Scenario]:
    """Scenarios of a space; they shrink to nominal values."""
    return _strategy(Family.of_space(find_space(space)))


def line_of_five() -> st.SearchStrategy[Scenario]:
    """Lines of five vehicles under test behind a leader that slows down and recovers."""
    return _strategy(Family.line_of_five())


def check(
    controller: ControllerLike,
    scenario: Scenario,
    *properties: Property,
    estimator: Literal["kalman", "truth"] = "kalman",
    corpus: str | os.PathLike[str] = "crumple-corpus",
) -> None:
    """Checks that a controller has properties in a scenario; by default it has no avoidable collision.

    A violation raises :class:`PropertyViolated` and writes the scenario to the folder ``corpus``: one file for each
    test and property, at last the simplest scenario that Hypothesis finds. Hypothesis rejects a scenario that does not
    test a property.
    """
    resolved = as_controller(controller)
    for tested in properties or (Property.no_avoidable_collision(),):
        verdict, reason, drawing = tested.evaluate(resolved, scenario, estimator)
        if currently_in_test_context():
            assume(verdict != "not applicable")
        if verdict == "violated":
            test = os.environ.get("PYTEST_CURRENT_TEST", "test").split(" ")[0].rsplit("::")[-1]
            file = Path(corpus) / (re.sub(r"\W+", "-", f"{test}-{tested.name}", flags=re.ASCII)[:80] + ".toml")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(scenario.to_toml(), encoding="utf-8")
            command = f"crumple.simulate({str(file)!r}, controller, {estimator!r})"
            if isinstance(resolved, str):
                command = f"crumple simulate {shlex.quote(str(file))} --controller {shlex.quote(resolved)}"
            raise PropertyViolated(
                f"property violated: {tested.name}\n  {reason}\nscenario: {file}\nreplay: {command}\n{drawing}"
            )


def _strategy(family: Family) -> st.SearchStrategy[Scenario]:
    return st.binary(min_size=family.byte_count, max_size=family.byte_count).map(family.read)
