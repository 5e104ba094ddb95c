"""Adapter for Ray: tasks of crumple on a Ray cluster."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import ray


def _call(function: Callable[..., Any], arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
    return function(*arguments, **named)


class RayExecutor(Executor):
    """Executor of ``executor=`` that runs each task as a Ray task.

    ``options`` are those of ``ray.remote``, such as ``num_cpus=1``. Ray sets ``OMP_NUM_THREADS`` to ``num_cpus``, so
    that a task uses as many threads. It repeats the task of a dead worker (``max_retries=3`` by default).
    """

    def __init__(self, **options: Any) -> None:
        self._remote = ray.remote(**({"num_cpus": 1} | options))(_call)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Starts a call on the cluster."""
        future: Future[Any] = self._remote.remote(fn, args, kwargs).future()
        return future
