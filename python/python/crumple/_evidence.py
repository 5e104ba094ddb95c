"""Failure rates, worst cases, and assessments."""

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
from crumple._numbers import whole_number
from crumple._simulate import ControllerLike, Progress, ScenarioLike, SpaceLike, simulate
from crumple._simulate import scenario as find_scenario
from crumple._simulate import space as find_space
from crumple.errors import AssessmentError, RateError, RunError


@dataclass(frozen=True)
class Rate:
    """Failure rate, or comparison of two controllers."""

    tally: dict[str, Any] = field(repr=False)
    """Content of ``progress.json`` in the run folder."""
    certificate: dict[str, Any] | None = field(repr=False)
    """Content of ``certificate.json``, for ``crumple check``; None if the counts show nothing."""
    words: str
    """Conclusion of the checker, or the reason why the counts show nothing."""
    data: dict[str, Any] = field(repr=False, compare=False)
    """Output of ``crumple verify rate --format json``. Without ``folder``, its paths no longer exist."""
    text: str = field(repr=False, compare=False)
    """Output of ``crumple verify rate``."""

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.tally["runs"])

    @property
    def failures(self) -> int:
        """Number of runs that failed; in a comparison, with both controllers."""
        return int(self.tally["failures"])

    @property
    def rate_at_most(self) -> float | None:
        """Certified upper bound of the failure rate; None for a comparison, and if nothing is shown."""
        if self.certificate is None:
            return None
        bound = self.certificate["statement"].get("rate", {}).get("rate_at_most")
        return None if bound is None else float(bound)

    def __str__(self) -> str:
        return self.text


def rate(
    controller: ControllerLike,
    space: SpaceLike = "paper",
    *,
    runs: int,
    confidence: float = 0.999,
    against: ControllerLike | None = None,
    seed: int = 0,
    estimator: Literal["kalman", "truth"] = "kalman",
    resamples: int = 200,
    folder: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Rate:
    """Counts failures in random scenarios and certifies a bound of their rate, as ``crumple verify rate`` does.

    With ``against`` both controllers run the same scenarios, and the claim is that the first one fails less often. A
    controller in Python needs an identity, to which the certificate refers. ``folder`` is the run folder with
    registration, progress and certificate, and ``resume`` continues it. ``runs`` is 1 to 1 000 000 000. A certified
    rate in a space that was fitted to recordings is also given per hour and per 1000 km, with the uncertainty of the
    data from ``resamples`` of the episodes (0, or 79 to 2000) with 500 more runs each.
    """
    runs = whole_number("runs", runs, 1, 1_000_000_000, RateError)
    seed = whole_number("seed", seed, 0, 2**64 - 1, RateError)
    resamples = whole_number("resamples", resamples, 0, 2000, RateError)
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="crumple-") as temporary:
            return rate(
                controller,
                space,
                runs=runs,
                confidence=confidence,
                against=against,
                seed=seed,
                estimator=estimator,
                resamples=resamples,
                folder=Path(temporary) / "rate",
                resume=resume,
                progress=progress,
            )
    reference = None if against is None else as_controller(against)
    resolved, resolved_space = as_controller(controller), find_space(space)
    fields = _rate(
        resolved,
        reference,
        resolved_space,
        runs,
        confidence,
        seed,
        estimator,
        resamples,
        Path(folder),
        resume,
        progress,
    )
    return Rate(**fields)


@dataclass(frozen=True)
class WorstCase:
    """Mildest braking of the leader that causes a collision, or the severest impact, if any was found."""

    scenario: Scenario | None
    """Scenario with the profile as the leader's script; None if no collision was found."""
    facts: dict[str, Any] = field(repr=False)
    """Output of ``crumple worst-case --format json``."""
    text: str = field(repr=False)
    """Output of ``crumple worst-case``."""
    _controller: ControllerLike = field(repr=False)
    _estimator: Literal["kalman", "truth"] = field(repr=False)

    @property
    def found(self) -> bool:
        """True if a profile with a collision was found."""
        return self.scenario is not None

    @property
    def peak_brake_mps2(self) -> float | None:
        """Hardest braking of the leader, positive."""
        peak = self.facts["peak_brake_mps2"]
        return None if peak is None else float(peak)

    def replay(self) -> Simulation:
        """Simulates the scenario again, with a trace."""
        if self.scenario is None:
            raise ValueError("no collision was found, so there is nothing to replay")
        return simulate(self.scenario, self._controller, self._estimator)

    def plot(self, layout: Literal["wide", "stacked", "column"] = "wide") -> Figure:
        """Draws position, speed and gap over time."""
        return self.replay().plot(layout)

    def __str__(self) -> str:
        return self.text


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
    """Searches for a braking profile of the leader that causes a collision, as ``crumple worst-case`` does.

    ``max_brake_mps2`` is the leader's hardest braking (its maximum on this road if None), ``jerk_mps3`` its largest
    jerk, ``budget`` the approximate number of simulations (1 to 10 000 000).
    """
    budget = whole_number("budget", budget, 1, 10_000_000, RunError)
    resolved_scenario, resolved_controller = find_scenario(scenario), as_controller(controller)
    found, facts, text = _worst_case(
        resolved_scenario, resolved_controller, aim, estimator, max_brake_mps2, jerk_mps3, budget, progress
    )
    return WorstCase(found, facts, text, controller, estimator)


def assess(
    config: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    controllers: Iterable[ControllerLike] = (),
    *,
    evidence: str | os.PathLike[str] | None = None,
    against: str | os.PathLike[str] | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> Assessment:
    """Gathers the evidence of an assessment, as ``crumple assess`` does.

    ``config`` is a path, a text of TOML (of two lines at least) or a dictionary; without it the built-in assessment is
    made. ``controllers`` are assessed in addition to those of the configuration; unless it states a subject, that is
    the first of them. The folder ``evidence`` caches evidence for later assessments, except of controllers without an
    identity; ``fresh`` ignores the cache. ``against`` is the ``assessment.json`` of an earlier assessment.
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
    resolved = [as_controller(one) for one in controllers]
    baseline = None if against is None else Path(against)
    cache_folder = None if evidence is None else Path(evidence)
    return _assess(path, toml, text, resolved, baseline, cache_folder, fresh, progress)


def write_report(assessment: Assessment, folder: str | os.PathLike[str]) -> Path:
    """Writes every file of a report into a new or empty folder; returns the path of its page."""
    root = Path(folder)
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise AssessmentError(f"{root}: a report is written into a folder that is new or empty", str(root))
    for name, contents in assessment.files().items():
        place = root / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(contents)
    return root / "assessment.html"
