"""Controllers written in Python."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from crumple.errors import ControllerError

OBSERVATION = (
    "gap_ahead_m",
    "gap_behind_m",
    "speed_ahead_mps",
    "speed_mps",
    "speed_behind_mps",
    "acceleration_ahead_mps2",
    "acceleration_mps2",
    "acceleration_behind_mps2",
)
"""The columns of a batch, in order; a number of a vehicle that is not there is NaN."""


@dataclass(frozen=True)
class Controller:
    """A callable as a controller. A plain callable stands for ``Controller(callable)``.

    ``decide`` gets an :class:`crumple.Observation` and returns the acceleration that it wants, in m/s²; it is shared by
    all vehicles and runs, and its answers must depend on what it sees alone. With ``batch`` it gets an array of shape
    (n, 8), its columns as :data:`OBSERVATION` says, and returns n accelerations; runs that step together share a call.
    With ``each_run`` it is called with a vehicle's index and the scenario's seed before each run, and returns the
    callable that drives this vehicle in this run, which may have a memory.

    ``interval_s`` is the time between decisions (every step if None). ``identity`` is a word for everything that decides
    how it drives: without one, a campaign cannot be resumed.

    An exception inside is a failure of the controller: the run ends there, and its result carries the traceback.
    """

    decide: Callable[..., Any]
    batch: bool = False
    each_run: bool = False
    interval_s: float | None = None
    name: str = "python"
    identity: str | None = None


def as_controller(controller: str | Controller | Callable[..., Any]) -> str | Controller:
    """A name as on the command line, or a controller."""
    if isinstance(controller, str | Controller):
        return controller
    if callable(controller):
        return Controller(controller, name=getattr(controller, "__name__", "python"))
    raise ControllerError(f"a controller is a name, a callable or a crumple.Controller, found {type(controller).__name__}")
