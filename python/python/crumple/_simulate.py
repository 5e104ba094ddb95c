"""Scenarios, spaces and simulations."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, overload

from crumple._controller import Controller, as_controller
from crumple._crumple import Scenario, Simulation, Space
from crumple._crumple import simulate as _simulate
from crumple._executor import MAX_TASKS, Executor, Tasks, split
from crumple._numbers import whole_number
from crumple.errors import RunError, ScenarioError

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
    after_collision: Literal["stop", "continue"] = ...,
    trace: bool = ...,
    threads: int | None = ...,
    executor: Executor | None = ...,
    tasks: int = ...,
    progress: Progress | None = ...,
) -> Simulation: ...


@overload
def simulate(
    scenarios: Iterable[ScenarioLike],
    controller: ControllerLike = ...,
    estimator: Literal["kalman", "truth"] = ...,
    *,
    dt_s: float | None = ...,
    after_collision: Literal["stop", "continue"] = ...,
    trace: bool = ...,
    threads: int | None = ...,
    executor: Executor | None = ...,
    tasks: int = ...,
    progress: Progress | None = ...,
) -> list[Simulation]: ...


def simulate(
    scenarios: ScenarioLike | Iterable[ScenarioLike],
    controller: ControllerLike = "baseline",
    estimator: Literal["kalman", "truth"] = "kalman",
    *,
    dt_s: float | None = None,
    after_collision: Literal["stop", "continue"] = "stop",
    trace: bool = True,
    threads: int | None = None,
    executor: Executor | None = None,
    tasks: int = MAX_TASKS,
    progress: Progress | None = None,
    after_contact: Literal["stop", "continue"] | None = None,
) -> Simulation | list[Simulation]:
    """Simulates a scenario, or several in a batch.

    ``controller`` drives the vehicles under test: a name as on the command line, a callable or a
    :class:`crumple.Controller`. Without ``trace`` results have outcomes only. ``progress`` is called with the numbers
    of completed runs, of all runs, and of unsafe runs. An exception in it, and Ctrl-C, end the work. ``after_contact``
    is the name of ``after_collision`` in releases up to 0.3.0.

    ``threads`` is the number of threads, from 1 to 1024: by default ``RAYON_NUM_THREADS``, else ``OMP_NUM_THREADS``,
    else the cores that the process may use. ``executor`` distributes several scenarios over its workers: any object
    with the interface of :class:`concurrent.futures.Executor`, in at most ``tasks`` tasks (1 to 1000) of at least 16
    scenarios. ``threads`` are then those of each task.

    Results equal those of ``crumple simulate`` to the last bit, in a batch or not, on any workers.
    """
    if after_contact is not None:
        message = "`after_contact` is now `after_collision`; releases after 0.5 will refuse the old name"
        warnings.warn(message, FutureWarning, stacklevel=2)
        after_collision = after_contact
    tasks = whole_number("tasks", tasks, 1, MAX_TASKS, RunError)
    is_single = isinstance(scenarios, Scenario | str | os.PathLike | Mapping)
    items = [scenarios] if is_single else scenarios
    resolved = [scenario(one) for one in items]  # type: ignore[union-attr, arg-type]
    options = (as_controller(controller), estimator, dt_s, after_collision, trace, threads)
    if executor is None:
        results = _simulate(resolved, *options, progress)
    else:
        parts = split(len(resolved), tasks, least=16)
        results = _simulate_on_workers(executor, resolved, parts, options, progress)
    return results[0] if is_single else results


def _simulate_on_workers(
    executor: Executor,
    scenarios: list[Scenario],
    parts: list[range],
    options: tuple[Any, ...],
    progress: Progress | None,
) -> list[Simulation]:
    arguments = [(scenarios[part.start : part.stop], (*options, None)) for part in parts]
    names = [f"runs {part.start} to {part.stop - 1}" for part in parts]
    results: list[Simulation] = []
    unsafe = 0
    for simulated in Tasks(executor, _simulate_part, arguments, names).results():
        results.extend(simulated)
        unsafe += sum(not result.is_safe for result in simulated)
        if progress is not None:
            progress(len(results), len(scenarios), unsafe)
    return results


def _simulate_part(scenarios: list[Scenario], options: tuple[Any, ...]) -> list[Simulation]:
    return _simulate(scenarios, *options)
