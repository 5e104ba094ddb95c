"""Falsification campaigns, and comparisons of search methods."""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, overload

from crumple._controller import Controller, as_controller
from crumple._crumple import Figure, Scenario, Simulation, Space
from crumple._crumple import compare as _compare
from crumple._crumple import falsify as _falsify
from crumple._crumple import join_comparisons as _join_comparisons
from crumple._executor import Executor, Tasks
from crumple._numbers import MAX_SEED, whole_number
from crumple._search import SearchMethod
from crumple._seeds import read_seeds, run_seeds
from crumple._simulate import ControllerLike, Progress, SpaceLike, simulate
from crumple._simulate import space as find_space
from crumple.errors import CampaignError

_MAX_BUDGET = 1_000_000_000


@dataclass(frozen=True)
class Failure:
    """Distinct failure: a shrunk and replayed scenario."""

    scenario: Scenario
    kind: str
    facts: dict[str, Any] = field(repr=False)
    """Entry of the failure in the campaign's summary."""
    _controller: ControllerLike = field(repr=False)
    _estimator: Literal["kalman", "truth"] = field(repr=False)
    _after_collision: Literal["stop", "continue"] = field(repr=False)

    def replay(self) -> Simulation:
        """Simulates the failure again, with a trace; beyond a collision if the specification is a formula."""
        return simulate(self.scenario, self._controller, self._estimator, after_collision=self._after_collision)

    def plot(self, layout: Literal["wide", "stacked", "column"] = "wide") -> Figure:
        """Simulates the failure again and draws position, speed and gap over time."""
        return self.replay().plot(layout)


@dataclass(frozen=True)
class Campaign:
    """Result of a falsification campaign."""

    failures: list[Failure]
    """Distinct failures, the severest first."""
    summary: dict[str, Any] = field(repr=False)
    """Output of ``crumple falsify --format json``."""
    text: str = field(repr=False)
    """Output of ``crumple falsify``."""

    @property
    def falsified(self) -> bool:
        """True if any evaluation failed."""
        return bool(self.summary["falsified"])

    def __str__(self) -> str:
        return self.text


@overload
def falsify(
    controller: ControllerLike,
    space: SpaceLike = ...,
    *,
    spec: str = ...,
    against: ControllerLike | None = ...,
    method: str | SearchMethod = ...,
    aim: str = ...,
    budget: int = ...,
    seed: int = ...,
    estimator: Literal["kalman", "truth"] = ...,
    folder: str | os.PathLike[str] | None = ...,
    resume: bool = ...,
    threads: int | None = ...,
    executor: Executor | None = ...,
    progress: Progress | None = ...,
) -> Campaign: ...


@overload
def falsify(
    controller: ControllerLike,
    space: SpaceLike = ...,
    *,
    spec: str = ...,
    against: ControllerLike | None = ...,
    method: str | SearchMethod = ...,
    aim: str = ...,
    budget: int = ...,
    seed: Iterable[int],
    estimator: Literal["kalman", "truth"] = ...,
    folder: str | os.PathLike[str] | None = ...,
    resume: bool = ...,
    threads: int | None = ...,
    executor: Executor | None = ...,
    progress: Progress | None = ...,
) -> list[Campaign]: ...


def falsify(
    controller: ControllerLike,
    space: SpaceLike = "high-risk",
    *,
    spec: str = "no collision",
    against: ControllerLike | None = None,
    method: str | SearchMethod = "auto",
    aim: str = "severest",
    budget: int = 2000,
    seed: int | Iterable[int] = 0,
    estimator: Literal["kalman", "truth"] = "kalman",
    folder: str | os.PathLike[str] | None = None,
    resume: bool = False,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Campaign | list[Campaign]:
    """Searches a space for scenarios in which a controller fails, as ``crumple falsify`` does.

    With ``against``, another controller, a failure counts only if that controller passes the same scenario.

    ``method`` is a name as on the command line, or a :class:`crumple.SearchMethod` of your own.

    ``folder`` is the run folder, as on the command line, and ``resume`` continues it; a controller in Python then needs
    an identity. ``progress`` is called with the numbers of completed evaluations, of all evaluations, and of failures.
    An exception in it, and Ctrl-C, end the search. ``budget`` is 1 to 1 000 000 000.

    With several seeds, ``falsify`` returns the campaign of each, and uses the folders ``seed-N`` in ``folder``.
    ``executor`` runs each campaign as one task, and ``progress`` then receives numbers of campaigns instead of
    evaluations; ``folder`` must be one that all workers share. ``threads`` and ``executor`` are those of
    :func:`crumple.simulate`.
    """
    budget = whole_number("budget", budget, 1, _MAX_BUDGET, CampaignError)
    is_single = not isinstance(seed, Iterable)
    seeds = read_seeds(seed, MAX_SEED, CampaignError)
    options = (controller, find_space(space), spec, against, method, aim, budget, estimator)
    root = None if folder is None else Path(folder)
    arguments = [
        (*options, each, root if is_single or root is None else root / f"seed-{each}", resume, threads)
        for each in seeds
    ]
    campaigns = run_seeds(_falsify_seed, seeds, arguments, executor, progress, lambda campaign: campaign.falsified)
    return campaigns[0] if is_single else campaigns


def _falsify_seed(
    controller: ControllerLike,
    space: Space,
    spec: str,
    against: ControllerLike | None,
    method: str | SearchMethod,
    aim: str,
    budget: int,
    estimator: Literal["kalman", "truth"],
    seed: int,
    folder: Path | None,
    resume: bool,
    threads: int | None,
    progress: Progress | None,
) -> Campaign:
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="crumple-") as temporary:
            place = Path(temporary) / "campaign"
            return _falsify_seed(
                controller, space, spec, against, method, aim, budget, estimator, seed, place, resume, threads, progress
            )
    resolved = as_controller(controller)
    reference = None if against is None else as_controller(against)
    summary, text = _falsify(
        resolved, space, spec, reference, method, aim, budget, seed, estimator, folder, resume, threads, progress
    )
    stops = summary["specification"] in ("no collision", "no contact")  # the second one up to version 0.3.0
    after_collision: Literal["stop", "continue"] = "stop" if stops else "continue"
    failures = [
        Failure(Scenario.load(folder / found["file"]), found["kind"], found, controller, estimator, after_collision)
        for found in summary["counterexamples"]
    ]
    return Campaign(failures, summary, text)


@dataclass(frozen=True)
class Comparison:
    """Comparison of search methods."""

    data: dict[str, Any] = field(repr=False)
    """Output of ``crumple falsify --compare --format json``."""
    text: str = field(repr=False)
    """Tables as text."""

    def __str__(self) -> str:
        return self.text

    def to_csv(self) -> str:
        """Returns the results of each method as CSV, a line per method.

        Rates are shares, and their intervals those at 95 %. Numbers of simulations are those of the runs that found a
        failure; the field is empty if there is none.
        """
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(_COMPARISON_COLUMNS)
        writer.writerows(self._rows())
        return out.getvalue()

    def to_latex(self) -> str:
        """Returns the results of each method as a LaTeX table (``tabular``), for the package ``booktabs``."""
        columns = "l" + "r" * (len(_COMPARISON_COLUMNS) - 1)
        header = " & ".join(_escape_latex(name.replace("_", " ")) for name in _COMPARISON_COLUMNS)
        rows = [" & ".join(_escape_latex(_format(value)) for value in row) for row in self._rows()]
        body = "".join(f"{row} \\\\\n" for row in rows)
        return (
            f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{header} \\\\\n\\midrule\n{body}\\bottomrule\n"
            "\\end{tabular}\n"
        )

    def _rows(self) -> list[list[Any]]:
        return [
            [
                method["method"],
                len(method["runs"]),
                method["falsified"],
                method["falsification_rate"],
                *method["interval"],
                method["mean_simulations"],
                method["median_simulations"],
            ]
            for method in self.data["methods"]
        ]


_COMPARISON_COLUMNS = (
    "method",
    "runs",
    "falsified",
    "falsification_rate",
    "rate_from",
    "rate_to",
    "mean_simulations",
    "median_simulations",
)

_LATEX_ESCAPES = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: "\\" + letter for letter in "&%$#_{}"},
}


def _escape_latex(text: str) -> str:
    return "".join(_LATEX_ESCAPES.get(letter, letter) for letter in text)


def _format(value: Any) -> str:
    if value is None:
        return "--"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def compare(
    controller: ControllerLike,
    space: SpaceLike = "high-risk",
    *,
    methods: Sequence[str | SearchMethod],
    seeds: int = 30,
    spec: str = "no collision",
    against: ControllerLike | None = None,
    budget: int = 2000,
    seed: int = 0,
    estimator: Literal["kalman", "truth"] = "kalman",
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compares search methods on the same seeds, as ``crumple falsify --compare`` does.

    Each method runs with each of 1 to 1000 seeds up to its first failure, with at most ``budget`` simulations.
    ``executor`` runs each seed as one task. ``threads`` and ``executor`` are those of :func:`crumple.simulate`.
    """
    seeds = whole_number("seeds", seeds, 1, 1000, CampaignError)
    budget = whole_number("budget", budget, 1, _MAX_BUDGET, CampaignError)
    seed = whole_number("seed", seed, 0, MAX_SEED, CampaignError)
    reference = None if against is None else as_controller(against)
    resolved, found = as_controller(controller), find_space(space)
    options = (resolved, found, spec, reference, list(methods), budget, estimator, threads)
    if executor is None:
        return Comparison(*_compare_seeds(*options, seed, seeds, progress))
    numbers = range(seed, seed + seeds)
    arguments = [(*options, each, 1, None) for each in numbers]
    tasks = Tasks(executor, _compare_seeds, arguments, [f"seed {each}" for each in numbers])
    parts = []
    failures = 0
    for data, _ in tasks.results():
        parts.append(json.dumps(data))
        failures += sum(method["falsified"] for method in data["methods"])
        if progress is not None:
            progress(len(parts) * budget * len(options[4]), seeds * budget * len(options[4]), failures)
    return Comparison(*_join_comparisons(parts))


def _compare_seeds(
    controller: str | Controller,
    space: Space,
    spec: str,
    against: str | Controller | None,
    methods: list[str | SearchMethod],
    budget: int,
    estimator: str,
    threads: int | None,
    seed: int,
    seeds: int,
    progress: Progress | None,
) -> tuple[dict[str, Any], str]:
    return _compare(controller, space, spec, against, methods, seeds, budget, seed, estimator, threads, progress)
