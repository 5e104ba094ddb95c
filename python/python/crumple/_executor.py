"""Distribution of tasks over the workers of an executor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Generic, Protocol, TypeVar

from crumple.errors import WorkerError

Result = TypeVar("Result")

MAX_TASKS = 1000
"""Maximum number of tasks of a call whose work can be split anywhere."""

_MAX_NAMED_TASKS = 100


class Future(Protocol):
    """Result of a task that a worker may not have finished."""

    def done(self) -> bool:
        """Returns true if :meth:`result` does not wait."""

    def result(self) -> Any:
        """Waits for the result, and returns it or raises the exception of the task."""

    def cancel(self) -> object:
        """Cancels the task if it has not begun."""


class Executor(Protocol):
    """Object that runs functions on workers, with the interface of :class:`concurrent.futures.Executor`."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future:
        """Starts a call of ``function`` on a worker."""


def check_executor(executor: Executor) -> Executor:
    """Returns an executor. Raises TypeError for any other object, before a task begins."""
    if isinstance(executor, type) or not callable(getattr(executor, "submit", None)):
        message = "executor: must be an object with the method `submit`, as those of concurrent.futures have"
        raise TypeError(f"{message}, found {executor!r}")
    return executor


def _call(function: Callable[..., Result], *arguments: Any) -> tuple[Result | None, Exception | None]:
    """Calls a function on a worker. Returns its exception, so that a lost worker can be told from a failed task."""
    try:
        return function(*arguments), None
    except Exception as error:
        return None, error


class Tasks(Generic[Result]):
    """Tasks of one function on workers. Their results are taken in order, whatever the order of the workers."""

    def __init__(
        self,
        executor: Executor,
        function: Callable[..., Result],
        arguments: Sequence[tuple[Any, ...]],
        names: Sequence[str],
    ) -> None:
        check_executor(executor)
        self._names = names
        self._futures: list[Future] = []
        try:
            for task in arguments:
                self._futures.append(executor.submit(_call, function, *task))
        except Exception as error:
            raise self._missing(error) from error

    def is_done(self, index: int) -> bool:
        """Returns true if a task has a result, or has failed."""
        return self._futures[index].done()

    def result(self, index: int) -> Result:
        """Waits for the result of a task. Raises its exception, or :class:`WorkerError` if there is no result."""
        try:
            result, raised = self._futures[index].result()
        except Exception as error:
            raise self._missing(error) from error
        if raised is not None:
            raise raised
        return result  # type: ignore[no-any-return]

    def results(self) -> Iterator[Result]:
        """Returns all results, in the order of the tasks. Cancels the rest at an exception."""
        try:
            for index in range(len(self._futures)):
                yield self.result(index)
        finally:
            self.cancel()

    def cancel(self) -> None:
        """Cancels all tasks that have not begun."""
        for future in self._futures:
            if not future.done():
                future.cancel()

    def _missing(self, error: Exception) -> WorkerError:
        """Returns an error that names all tasks without a result, and cancels those that have not begun."""
        self.cancel()
        missing = [name for index, name in enumerate(self._names) if not self._has_result(index)]
        named = ", ".join(missing[:_MAX_NAMED_TASKS])
        more = f" and {len(missing) - _MAX_NAMED_TASKS} more" if len(missing) > _MAX_NAMED_TASKS else ""
        return WorkerError(
            f"{len(missing)} of {len(self._names)} tasks have no result: {named}{more}"
            f" ({type(error).__name__}: {error})"
        )

    def _has_result(self, index: int) -> bool:
        if index >= len(self._futures) or not self._futures[index].done():
            return False
        try:
            self._futures[index].result()
        except BaseException:
            # A cancelled task raises CancelledError, which some engines do not derive from Exception.
            return False
        return True


def split(count: int, tasks: int, least: int) -> list[range]:
    """Splits the numbers from 0 to ``count`` into at most ``tasks`` ranges of at least ``least`` numbers.

    All ranges but the last have the same length.
    """
    size = max(least, -(-count // tasks))
    return [range(first, min(first + size, count)) for first in range(0, count, size)]
