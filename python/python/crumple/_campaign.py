"""Falsification campaigns, and comparisons of search methods."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from crumple._controller import as_controller
from crumple._crumple import Figure, Scenario, Simulation
from crumple._crumple import compare as _compare
from crumple._crumple import falsify as _falsify
from crumple._numbers import MAX_SEED, whole_number
from crumple._search import SearchMethod
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
    _after_contact: Literal["stop", "continue"] = field(repr=False)

    def replay(self) -> Simulation:
        """Simulates the failure again, with a trace; beyond a collision if the specification is a formula."""
        return simulate(self.scenario, self._controller, self._estimator, after_contact=self._after_contact)

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


def falsify(
    controller: ControllerLike,
    space: SpaceLike = "high-risk",
    *,
    spec: str = "no collision",
    against: ControllerLike | None = None,
    method: str | SearchMethod = "auto",
    aim: str = "severest",
    budget: int = 2000,
    seed: int = 0,
    estimator: Literal["kalman", "truth"] = "kalman",
    folder: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Campaign:
    """Searches a space for scenarios in which a controller fails, as ``crumple falsify`` does.

    With ``against``, another controller, a failure counts only if that controller passes the same scenario.

    ``method`` is a name as on the command line, or a :class:`crumple.SearchMethod` of your own.

    ``folder`` is the run folder, as on the command line, and ``resume`` continues it; a controller in Python then needs
    an identity. ``progress`` is called with the numbers of completed evaluations, of all evaluations, and of failures.
    An exception in it, and Ctrl-C, end the search. ``budget`` is 1 to 1 000 000 000.
    """
    budget = whole_number("budget", budget, 1, _MAX_BUDGET, CampaignError)
    seed = whole_number("seed", seed, 0, MAX_SEED, CampaignError)
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="crumple-") as temporary:
            return falsify(
                controller,
                space,
                spec=spec,
                against=against,
                method=method,
                aim=aim,
                budget=budget,
                seed=seed,
                estimator=estimator,
                folder=Path(temporary) / "campaign",
                resume=resume,
                progress=progress,
            )
    resolved = as_controller(controller)
    reference = None if against is None else as_controller(against)
    summary, text = _falsify(
        resolved,
        find_space(space),
        spec,
        reference,
        method,
        aim,
        budget,
        seed,
        estimator,
        Path(folder),
        resume,
        progress,
    )
    stops = summary["specification"] in ("no collision", "no contact")  # the second one up to version 0.3.0
    after_contact: Literal["stop", "continue"] = "stop" if stops else "continue"
    failures = [
        Failure(Scenario.load(Path(folder) / found["file"]), found["kind"], found, controller, estimator, after_contact)
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
    progress: Progress | None = None,
) -> Comparison:
    """Compares search methods on the same seeds, as ``crumple falsify --compare`` does.

    Each method runs with each of 1 to 1000 seeds up to its first failure, with at most ``budget`` simulations.
    """
    seeds = whole_number("seeds", seeds, 1, 1000, CampaignError)
    budget = whole_number("budget", budget, 1, _MAX_BUDGET, CampaignError)
    seed = whole_number("seed", seed, 0, MAX_SEED, CampaignError)
    reference = None if against is None else as_controller(against)
    resolved, found = as_controller(controller), find_space(space)
    compared = _compare(resolved, found, spec, reference, list(methods), seeds, budget, seed, estimator, progress)
    return Comparison(*compared)
