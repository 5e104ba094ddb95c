"""Failure rates, worst cases, and assessments."""

from __future__ import annotations

import contextlib
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
from crumple._crumple import count_blocks as _count_blocks
from crumple._crumple import pool as _pool
from crumple._crumple import rate as _rate
from crumple._crumple import worst_case as _worst_case
from crumple._executor import MAX_TASKS, Executor, Tasks, check_executor, split
from crumple._numbers import whole_number
from crumple._simulate import ControllerLike, Progress, ScenarioLike, SpaceLike, simulate
from crumple._simulate import scenario as find_scenario
from crumple._simulate import space as find_space
from crumple.errors import AssessmentError, RateError, RunError

_MIN_TASK_RUNS = 2000
"""Smallest number of runs of a task. Fewer take less time than their distribution."""


@dataclass(frozen=True)
class Rate:
    """Failure rate, or comparison of two controllers."""

    tally: dict[str, Any] = field(repr=False)
    """Content of ``progress.json`` in the run folder."""
    certificate: dict[str, Any] | None = field(repr=False)
    """Content of ``certificate.json``, for ``crumple check``; None for a comparison that shows nothing, and for a
    controller whose identity is no SHA-256."""
    words: str
    """Conclusion of the checker, or the reason why there is no certificate."""
    data: dict[str, Any] = field(repr=False, compare=False)
    """Output of ``crumple verify rate --format json``; without ``folder``, it names none."""
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
        """Certified upper bound of the failure rate, 1.0 if every run failed; None for a comparison, and without a
        certificate."""
        if self.certificate is None:
            return None
        bound = self.certificate["statement"].get("rate", {}).get("rate_at_most")
        return None if bound is None else float(bound)

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class PooledRate:
    """Failure rate from the counts of several seeds."""

    data: dict[str, Any] = field(repr=False)
    """Output of ``crumple check --pool --format json``."""
    text: str = field(repr=False)
    """Output of ``crumple check --pool``."""

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.data["runs"])

    @property
    def failures(self) -> int:
        """Number of runs that failed."""
        return int(self.data["failures"])

    @property
    def seeds(self) -> range:
        """Seeds of the counts."""
        first, last = self.data["seeds"]
        return range(first, last + 1)

    @property
    def is_expected_range(self) -> bool:
        """True if the seeds were given, false if they are those of the counts."""
        return bool(self.data["is_expected_range"])

    @property
    def rate_at_most(self) -> float:
        """Upper bound of the failure rate that the checker accepted."""
        return float(self.data["rate_at_most"])

    @property
    def confidence(self) -> float:
        """Confidence level of the bound."""
        return float(self.data["confidence"])

    def __str__(self) -> str:
        return self.text


class _RateFunction:
    """Function :func:`crumple.rate`, with the function ``pool``."""

    def __call__(
        self,
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
        threads: int | None = None,
        executor: Executor | None = None,
        tasks: int = MAX_TASKS,
        progress: Progress | None = None,
    ) -> Rate:
        """Counts failures in random scenarios and certifies a bound of their rate, as ``crumple verify rate`` does.

        With ``against`` both controllers run the same scenarios, and the claim is that the first one fails less often.
        A controller in Python needs an identity. The count has a certificate, which refers to the identity, only if
        that is a SHA-256 in hexadecimal, such as that of the controller's file. ``folder`` is the run folder with
        registration, progress and certificate, and ``resume`` continues it. ``runs`` is 1 to 1 000 000 000. A certified
        rate in a space that was fitted to recordings is also given per hour and per 1000 km, with the uncertainty of
        the data from ``resamples`` of the episodes (0, or 79 to 2000) with 500 more runs each.

        ``executor`` distributes the runs over its workers, in at most ``tasks`` tasks (1 to 1000) of at least 2000
        runs; ``folder`` is used here only. The result has the same bits as without it. ``threads`` and ``executor`` are
        those of :func:`crumple.simulate`.
        """
        runs = whole_number("runs", runs, 1, 1_000_000_000, RateError)
        seed = whole_number("seed", seed, 0, 2**64 - 1, RateError)
        resamples = whole_number("resamples", resamples, 0, 2000, RateError)
        parameters: dict[str, Any] = {
            "controller": as_controller(controller),
            "against": None if against is None else as_controller(against),
            "space": find_space(space),
            "runs": runs,
            "confidence": confidence,
            "seed": seed,
            "estimator": estimator,
        }
        tasks = whole_number("tasks", tasks, 1, MAX_TASKS, RateError)
        counter = None if executor is None else _BlockCounter(executor, parameters, threads, tasks)
        with contextlib.ExitStack() as stack:
            if counter is not None:
                stack.callback(counter.cancel)
            is_temporary = folder is None
            if folder is None:
                temporary = tempfile.TemporaryDirectory(prefix="crumple-")
                folder = Path(stack.enter_context(temporary)) / "rate"
            fields = _rate(parameters, resamples, Path(folder), is_temporary, resume, threads, counter, progress)
            return Rate(**fields)

    @staticmethod
    def pool(
        counts: Iterable[Rate | Mapping[str, Any] | str | os.PathLike[str]], seeds: range | None = None
    ) -> PooledRate:
        """Concludes one rate from the counts of several seeds, as ``crumple check --pool`` does.

        ``counts`` are results of :func:`crumple.rate`, contents of certificates, or paths of certificates. They must
        have the same controller, space, estimator, number of runs, confidence level and release, and their seeds must
        form a range without gaps. The range must have been fixed before the first run, because a seed that is left out
        could hide failures. With ``seeds``, such as ``range(100)``, a missing first or last seed is noticed, too.
        Raises :class:`RateError` otherwise.
        """
        if isinstance(counts, Rate | Mapping | str | bytes | os.PathLike):
            kind = type(counts).__name__
            raise TypeError(f"counts: must be a list of results, certificates or paths, found a single {kind}")
        expected = None if seeds is None else _ends(seeds)
        return PooledRate(*_pool([_certificate_text(count) for count in counts], expected))

    def __reduce__(self) -> str:
        return "rate"


rate = _RateFunction()
"""Counts failures in random scenarios and certifies a bound of their rate: see :meth:`_RateFunction.__call__`."""


def _ends(seeds: range) -> tuple[int, int]:
    """Returns the first and the last seed of a range."""
    if not isinstance(seeds, range) or not seeds or seeds.step != 1:
        raise TypeError(f"seeds: must be a range, such as range(100), found {seeds!r}")
    first, last = (whole_number("seeds", seed, 0, 2**64 - 1, RateError) for seed in (seeds[0], seeds[-1]))
    return first, last


def _certificate_text(count: Rate | Mapping[str, Any] | str | os.PathLike[str]) -> str:
    if isinstance(count, Rate):
        if count.certificate is None:
            raise RateError(f"a count without a certificate cannot be pooled: {count.words}")
        count = count.certificate
    if isinstance(count, Mapping):
        return json.dumps(count, allow_nan=False)
    try:
        return Path(count).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RateError(f"{os.fspath(count)}: {error}", os.fspath(count)) from error


def _count_part(parameters: dict[str, Any], first: int, end: int, threads: int | None) -> str:
    return _count_blocks(parameters, first, end, threads)


class _BlockCounter:
    """Counts blocks of runs on the workers of an executor. Begins at the first call, when the count is registered."""

    def __init__(self, executor: Executor, parameters: dict[str, Any], threads: int | None, most: int) -> None:
        self._executor = check_executor(executor)
        self._parameters = parameters
        self._threads = threads
        self._max_tasks = most
        self._tasks: Tasks[str] | None = None
        self._numbers: dict[int, int] = {}

    def __call__(self, first: int, blocks: int, block_runs: int) -> str | None:
        """Returns counted blocks from ``first`` on as JSON, or None while they are not counted yet."""
        if self._tasks is None:
            self._begin(first, blocks, block_runs)
        assert self._tasks is not None
        number = self._numbers[first]
        return self._tasks.result(number) if self._tasks.is_done(number) else None

    def _begin(self, first: int, blocks: int, block_runs: int) -> None:
        parts = split(blocks - first, self._max_tasks, least=-(-_MIN_TASK_RUNS // block_runs))
        parts = [range(first + part.start, first + part.stop) for part in parts]
        self._numbers = {part.start: number for number, part in enumerate(parts)}
        arguments = [(self._parameters, part.start, part.stop, self._threads) for part in parts]
        runs = self._parameters["runs"]
        names = [f"runs {part.start * block_runs} to {min(part.stop * block_runs, runs) - 1}" for part in parts]
        self._tasks = Tasks(self._executor, _count_part, arguments, names)

    def cancel(self) -> None:
        """Cancels all tasks that have not begun."""
        if self._tasks is not None:
            self._tasks.cancel()


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
    threads: int | None = None,
    progress: Progress | None = None,
) -> WorstCase:
    """Searches for a braking profile of the leader that causes a collision, as ``crumple worst-case`` does.

    ``max_brake_mps2`` is the leader's hardest braking (its maximum on this road if None), ``jerk_mps3`` its largest
    jerk, ``budget`` the approximate number of simulations (1 to 10 000 000). ``threads`` is that of
    :func:`crumple.simulate`.
    """
    budget = whole_number("budget", budget, 1, 10_000_000, RunError)
    resolved_scenario, resolved_controller = find_scenario(scenario), as_controller(controller)
    found, facts, text = _worst_case(
        resolved_scenario, resolved_controller, aim, estimator, max_brake_mps2, jerk_mps3, budget, threads, progress
    )
    return WorstCase(found, facts, text, controller, estimator)


def assess(
    config: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    controllers: Iterable[ControllerLike] = (),
    *,
    evidence: str | os.PathLike[str] | None = None,
    against: str | os.PathLike[str] | None = None,
    fresh: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Assessment:
    """Gathers the evidence of an assessment, as ``crumple assess`` does.

    ``config`` is a path, a text of TOML (of two lines at least) or a dictionary; without it the built-in assessment is
    made. ``controllers`` are assessed in addition to those of the configuration; unless it states a subject, that is
    the first of them. The folder ``evidence`` caches evidence for later assessments, except of controllers without an
    identity; ``fresh`` ignores the cache. ``against`` is the ``assessment.json`` of an earlier assessment. ``threads``
    is that of :func:`crumple.simulate`.
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
    return _assess(path, toml, text, resolved, baseline, cache_folder, fresh, threads, progress)


def write_report(assessment: Assessment, folder: str | os.PathLike[str]) -> Path:
    """Writes every file of a report into a folder, as ``crumple assess --out`` does; returns the path of its page.

    All files of an earlier report there are replaced, or none: no file that has changed since crumple wrote it, and
    none that crumple did not write. After an error, such as a full disk, the same call writes the whole report.
    """
    root = Path(folder)
    assessment._write(root)
    return root / "assessment.html"
