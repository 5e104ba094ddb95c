"""Property tests of controllers with Hypothesis: strategies of scenarios, and the properties of ``crumple-testing``."""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import sys
import uuid
from pathlib import Path
from types import FrameType
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
    """Variations of a scenario.

    Gaps, speeds and the leader's script change by up to a quarter. Friction falls by up to a quarter, and reaction
    delays of vehicles under test grow by up to 0.3 s.
    """
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
) -> bool:
    """Checks that a controller has properties in a scenario; by default it has no avoidable collision.

    A violation raises :class:`PropertyViolated` and writes the scenario to the folder ``corpus``: one file for each
    test and property, at last the simplest scenario that Hypothesis finds. An error of the controller is a violation.

    Returns False if the scenario does not test one of the properties, for example because it lacks a vehicle that the
    controller needs or a signal of a formula. Hypothesis rejects such a scenario, and fails if it finds no other.
    """
    resolved = as_controller(controller)
    is_tested = True
    for tested in properties or (Property.no_avoidable_collision(),):
        verdict, reason, drawing = tested.evaluate(resolved, scenario, estimator)
        is_tested = is_tested and verdict != "not applicable"
        if verdict == "violated":
            file = _corpus_file(Path(corpus), _test_name(sys._getframe(1)), tested.name)
            _write_whole(file, scenario.to_toml())
            command = f"crumple.simulate({str(file)!r}, controller, {estimator!r})"
            if isinstance(resolved, str):
                command = f"crumple simulate {shlex.quote(str(file))} --controller {shlex.quote(resolved)}"
            raise PropertyViolated(
                f"property violated: {tested.name}\n  {reason}\nscenario: {file}\nreplay: {command}\n{drawing}"
            )
    if currently_in_test_context():
        assume(is_tested)
    return is_tested


def _test_name(caller: FrameType) -> str:
    """Returns file and name of the running test of pytest, or else of the caller."""
    test = os.environ.get("PYTEST_CURRENT_TEST")
    if test is not None:
        # The name ends with the phase, as in "tests/test_aeb.py::test_it[fast] (call)".
        return test.rsplit(" (", 1)[0]
    return f"{Path(caller.f_code.co_filename).name}::{caller.f_code.co_name}"


def _corpus_file(corpus: Path, test: str, tested: str) -> Path:
    """Returns the file of a test and a property. The hash distinguishes names that shorten to the same one."""
    file, _, name = test.partition("::")
    readable = re.sub(r"\W+", "-", f"{Path(file).stem}-{name.rpartition('::')[2]}-{tested}", flags=re.ASCII)[:80]
    unique = hashlib.sha256(f"{test}: {tested}".encode()).hexdigest()[:8]
    return corpus / f"{readable}-{unique}.toml"


def _write_whole(file: Path, text: str) -> None:
    """Writes a file at once: another process, such as a worker of pytest-xdist, reads all of it or none."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{uuid.uuid4().hex}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def _strategy(family: Family) -> st.SearchStrategy[Scenario]:
    return st.binary(min_size=family.byte_count, max_size=family.byte_count).map(family.read)
