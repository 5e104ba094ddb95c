"""Searches for failures."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from crumple._controller import as_controller
from crumple._crumple import Figure, Scenario, Simulation
from crumple._crumple import falsify as _falsify
from crumple._simulate import ControllerLike, Progress, SpaceLike, simulate
from crumple._simulate import space as find_space


@dataclass(frozen=True)
class Failure:
    """A distinct failure: shrunk, replayed, and as a scenario of its own."""

    scenario: Scenario
    kind: str
    facts: dict[str, Any] = field(repr=False)
    """What the campaign's summary says of it."""
    _controller: ControllerLike = field(repr=False)
    _estimator: Literal["kalman", "truth"] = field(repr=False)
    _after_contact: Literal["stop", "continue"] = field(repr=False)

    def replay(self) -> Simulation:
        """Simulate it again, with a trace; a failure of a formula beyond contacts, as it was judged."""
        return simulate(self.scenario, self._controller, self._estimator, after_contact=self._after_contact)

    def plot(self, layout: Literal["wide", "stacked", "column"] = "wide") -> Figure:
        """Position, speed and spacing over time, of the failure simulated again."""
        return self.replay().plot(layout)


@dataclass(frozen=True)
class Campaign:
    """What a search found."""

    failures: list[Failure]
    """Distinct failures, the severest first."""
    summary: dict[str, Any] = field(repr=False)
    """What ``summary.json`` of the campaign's folder says."""
    text: str = field(repr=False)
    """The same for a reader."""

    @property
    def falsified(self) -> bool:
        """Whether any evaluation failed."""
        return bool(self.summary["falsified"])

    def __str__(self) -> str:
        return self.text


def falsify(
    controller: ControllerLike,
    space: SpaceLike = "high-risk",
    *,
    spec: str = "no contact",
    against: ControllerLike | None = None,
    metamorphic: str | None = None,
    method: str = "auto",
    aim: str = "severest",
    budget: int = 2000,
    seed: int = 0,
    estimator: Literal["kalman", "truth"] = "kalman",
    folder: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Campaign:
    """Search a space for scenarios in which a controller fails, as ``crumple falsify`` does.

    With ``against``, another controller, only what that one passes counts as a failure; with ``metamorphic``
    (``"larger-gap=2"``, ``"more-friction=0.1"``) only what the controller passes with less of it.

    With a ``folder`` everything is kept there, as the command line keeps it, and ``resume`` goes on with it; a controller
    in Python needs an identity for that. ``progress`` is called with how many evaluations are done, of how many, and how
    many of them failed; an exception in it, and Ctrl-C, end the search.
    """
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="crumple-") as own:
            return falsify(
                controller,
                space,
                spec=spec,
                against=against,
                metamorphic=metamorphic,
                method=method,
                aim=aim,
                budget=budget,
                seed=seed,
                estimator=estimator,
                folder=Path(own) / "campaign",
                resume=resume,
                progress=progress,
            )
    given = as_controller(controller)
    other = None if against is None else as_controller(against)
    beside = (other, metamorphic)
    summary, text = _falsify(
        given, find_space(space), spec, beside, method, aim, budget, seed, estimator, Path(folder), resume, progress
    )
    after_contact: Literal["stop", "continue"] = "stop" if summary["specification"] == "no contact" else "continue"
    failures = [
        Failure(Scenario.load(Path(folder) / found["file"]), found["kind"], found, controller, estimator, after_contact)
        for found in summary["counterexamples"]
    ]
    return Campaign(failures, summary, text)
