"""Work that is repeated with several seeds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

from crumple._executor import Executor, Tasks
from crumple._numbers import whole_number
from crumple._simulate import Progress
from crumple.errors import CrumpleError

Result = TypeVar("Result")


def read_seeds(seed: int | Iterable[int], most: int, error: type[CrumpleError]) -> list[int]:
    """Returns the seeds of the argument ``seed``, which is one seed, or several different ones."""
    items = seed if isinstance(seed, Iterable) else [seed]
    seeds = [whole_number("seed", each, 0, most, error) for each in items]
    # The work of a repeated seed would be done twice, in one folder.
    repeated = next((each for each, count in Counter(seeds).items() if count > 1), None)
    if repeated is not None:
        raise error(f"seed: {repeated} occurs twice", field="seed")
    return seeds


def run_seeds(
    function: Callable[..., Result],
    seeds: Sequence[int],
    arguments: Sequence[tuple[Any, ...]],
    executor: Executor | None,
    progress: Progress | None,
    is_counted: Callable[[Result], bool],
) -> list[Result]:
    """Calls a function for each seed: one after the other, or each as one task of an executor.

    ``arguments`` are those of each seed without the last one, which is the progress. With an executor, ``progress``
    receives the numbers of completed seeds, of all seeds, and of results that ``is_counted`` accepts.
    """
    if executor is None:
        return [function(*each, progress) for each in arguments]
    tasks = Tasks(executor, function, [(*each, None) for each in arguments], [f"seed {seed}" for seed in seeds])
    results: list[Result] = []
    for result in tasks.results():
        results.append(result)
        if progress is not None:
            progress(len(results), len(seeds), sum(map(is_counted, results)))
    return results
