"""Counting failures, worst cases, and assessments."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from crumple._controller import as_controller
from crumple._crumple import Assessment, Figure, Scenario, Simulation
from crumple._crumple import assess as _assess
from crumple._crumple import rate as _rate
from crumple._crumple import worst_case as _worst_case
from crumple._simulate import ControllerLike, Progress, ScenarioLike, SpaceLike, simulate
from crumple._simulate import scenario as find_scenario
from crumple._simulate import space as find_space
from crumple.errors import AssessmentError


@dataclass(frozen=True)
class Rate:
    """What was counted, and what it shows."""

    tally: dict[str, Any] = field(repr=False)
    """What ``progress.json`` of the count's folder says."""
    certificate: dict[str, Any] | None = field(repr=False)
    """What ``certificate.json`` says, for ``crumple check``; None if the counts show nothing."""
    words: str
    """What the checker accepts it as, or why the counts show nothing."""

    @property
    def runs(self) -> int:
        """Runs that were made."""
        return int(self.tally["runs"])

    @property
    def failures(self) -> int:
        """Runs that failed; of two controllers, with both."""
        return int(self.tally["failures"])

    @property
    def rate_at_most(self) -> float | None:
        """The bound that is certified; None of a comparison, and where nothing is shown."""
        if self.certificate is None:
            return None
        bound = self.certificate["statement"].get("rate", {}).get("rate_at_most")
        return None if bound is None else float(bound)


def rate(
    controller: ControllerLike,
    space: SpaceLike = "paper",
    *,
    runs: int,
    confidence: float = 0.999,
    against: ControllerLike | None = None,
    seed: int = 0,
    estimator: Literal["kalman", "truth"] = "kalman",
    folder: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Rate:
    """Count failures on draws of a space and certify a bound of their rate, as ``crumple verify rate`` does.

    With ``against`` both drive the same draws, and what is to be shown is that the first fails less often. A controller in
    Python needs an identity: nothing is claimed of what cannot be told from something else. With a ``folder`` registration,
    progress and certificate are kept there, and ``resume`` goes on with them.
    """
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="crumple-") as own:
            return rate(
                controller,
                space,
                runs=runs,
                confidence=confidence,
                against=against,
                seed=seed,
                estimator=estimator,
                folder=Path(own) / "rate",
                resume=resume,
                progress=progress,
            )
    other = None if against is None else as_controller(against)
    given, drawn = as_controller(controller), find_space(space)
    done = _rate(given, other, drawn, runs, confidence, seed, estimator, Path(folder), resume, progress)
    return Rate(*done)


@dataclass(frozen=True)
class WorstCase:
    """The mildest braking of the leader that makes a controller collide, or the severest impact; or that none was found."""

    scenario: Scenario | None
    """The scenario with the profile as the leader's script; None if no collision was found."""
    facts: dict[str, Any] = field(repr=False)
    """What ``crumple worst-case --format json`` says."""
    _controller: ControllerLike = field(repr=False)
    _estimator: Literal["kalman", "truth"] = field(repr=False)

    @property
    def found(self) -> bool:
        """Whether some profile makes the controller collide."""
        return self.scenario is not None

    @property
    def peak_brake_mps2(self) -> float | None:
        """Hardest braking of the leader, positive."""
        peak = self.facts["peak_brake_mps2"]
        return None if peak is None else float(peak)

    def replay(self) -> Simulation:
        """Simulate what was found again, with a trace."""
        if self.scenario is None:
            raise ValueError("no collision was found, so there is nothing to replay")
        return simulate(self.scenario, self._controller, self._estimator)

    def plot(self, layout: Literal["wide", "stacked", "column"] = "wide") -> Figure:
        """Position, speed and spacing over time."""
        return self.replay().plot(layout)


def worst_case(
    scenario: ScenarioLike,
    controller: ControllerLike = "baseline",
    *,
    aim: Literal["mildest", "least-peak", "severest"] = "mildest",
    estimator: Literal["kalman", "truth"] = "kalman",
    max_brake_mps2: float | None = None,
    jerk_mps3: float | None = None,
    budget: int = 3000,
    progress: Progress | None = None,
) -> WorstCase:
    """Look for a braking profile of the leader that makes a controller collide, as ``crumple worst-case`` does.

    ``max_brake_mps2`` is the leader's hardest braking (all it has on this road if None), ``jerk_mps3`` the fastest change of
    its acceleration, ``budget`` the number of simulations, roughly.
    """
    start, given = find_scenario(scenario), as_controller(controller)
    found, facts = _worst_case(start, given, aim, estimator, max_brake_mps2, jerk_mps3, budget, progress)
    return WorstCase(found, facts, controller, estimator)


def assess(
    config: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    controllers: Iterable[ControllerLike] = (),
    *,
    evidence: str | os.PathLike[str] | None = None,
    against: str | os.PathLike[str] | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> Assessment:
    """Gather the evidence that an assessment asks for, as ``crumple assess`` does.

    ``config`` is a path, a text of TOML (of two lines at least) or a dictionary; without it the built-in assessment is made.
    ``controllers`` are assessed beside those that it names, and the argument is about the first of them unless it says
    otherwise. In the folder ``evidence`` what was gathered is kept for another time, unless a controller states no identity;
    ``fresh`` gathers all of it again. ``against`` is the ``assessment.json`` of an earlier assessment.
    """
    path, toml, text = None, None, None
    if isinstance(config, Mapping):
        try:
            text = json.dumps(config, indent=1, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise AssessmentError(f"<dict>: {error}", "<dict>") from error
    elif isinstance(config, str) and "\n" in config:
        toml = config
    elif config is not None:
        path = Path(config)
    own = [as_controller(one) for one in controllers]
    earlier = None if against is None else Path(against)
    kept = None if evidence is None else Path(evidence)
    return _assess(path, toml, text, own, earlier, kept, fresh, progress)


def write_report(assessment: Assessment, folder: str | os.PathLike[str]) -> Path:
    """Write every file of a report into a folder that is new or empty; the path of its page."""
    root = Path(folder)
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise AssessmentError(f"{root}: a report is written into a folder that is new or empty", str(root))
    for name, contents in assessment.files().items():
        place = root / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(contents)
    return root / "assessment.html"
