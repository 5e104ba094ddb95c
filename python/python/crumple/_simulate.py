"""Scenarios, spaces and simulations."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, overload

from crumple._controller import Controller, as_controller
from crumple._crumple import Scenario, Simulation, Space
from crumple._crumple import simulate as _simulate
from crumple.errors import ScenarioError

ScenarioLike = Scenario | str | os.PathLike[str] | Mapping[str, Any]
SpaceLike = Space | str | os.PathLike[str]
ControllerLike = str | Controller | Callable[..., Any]
Progress = Callable[[int, int, int], object]


def scenario(what: ScenarioLike) -> Scenario:
    """Returns the scenario of a built-in name, a path, a text of TOML (of two lines at least) or a dictionary."""
    if isinstance(what, Scenario):
        return what
    if isinstance(what, str):
        return Scenario.from_toml(what) if "\n" in what else Scenario.find(what)
    if isinstance(what, Mapping):
        try:
            text = json.dumps(what, indent=1, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise ScenarioError(f"<dict>: {error}", "<dict>") from error
        return Scenario.from_json(text)
    return Scenario.load(what)


def space(what: SpaceLike) -> Space:
    """Returns the space of a built-in name, a path, or a text of TOML (of two lines at least)."""
    if isinstance(what, Space):
        return what
    if isinstance(what, str) and "\n" in what:
        return Space.from_toml(what)
    return Space.find(os.fspath(what))


@overload
def simulate(  # type: ignore[overload-overlap]
    scenarios: ScenarioLike,
    controller: ControllerLike = ...,
    estimator: Literal["kalman", "truth"] = ...,
    *,
    dt_s: float | None = ...,
    after_contact: Literal["stop", "continue"] = ...,
    trace: bool = ...,
    progress: Progress | None = ...,
) -> Simulation: ...


@overload
def simulate(
    scenarios: Iterable[ScenarioLike],
    controller: ControllerLike = ...,
    estimator: Literal["kalman", "truth"] = ...,
    *,
    dt_s: float | None = ...,
    after_contact: Literal["stop", "continue"] = ...,
    trace: bool = ...,
    progress: Progress | None = ...,
) -> list[Simulation]: ...


def simulate(
    scenarios: ScenarioLike | Iterable[ScenarioLike],
    controller: ControllerLike = "baseline",
    estimator: Literal["kalman", "truth"] = "kalman",
    *,
    dt_s: float | None = None,
    after_contact: Literal["stop", "continue"] = "stop",
    trace: bool = True,
    progress: Progress | None = None,
) -> Simulation | list[Simulation]:
    """Simulates a scenario, or several in a batch.

    ``controller`` drives the vehicles under test: a name as on the command line, a callable or a
    :class:`crumple.Controller`. Without ``trace`` results have outcomes only. ``progress`` is called with the numbers
    of completed runs, of all runs, and of unsafe runs. An exception in it, and Ctrl-C, end the work.

    Results equal those of ``crumple simulate`` to the last bit, in a batch or not.
    """
    is_single = isinstance(scenarios, Scenario | str | os.PathLike | Mapping)
    items = [scenarios] if is_single else scenarios
    resolved = [scenario(one) for one in items]  # type: ignore[union-attr, arg-type]
    results = _simulate(resolved, as_controller(controller), estimator, dt_s, after_contact, trace, progress)
    return results[0] if is_single else results
