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
"""Columns of a batch, in order; values of an absent vehicle are NaN."""


@dataclass(frozen=True)
class Controller:
    """Controller from a callable. A plain callable is equivalent to ``Controller(callable)``.

    ``decide`` takes an :class:`crumple.Observation` and returns the commanded acceleration, in m/s². All vehicles and
    runs share it, so its result must depend on the observation only. With ``batch`` it takes an array of shape (n, 8)
    with the columns of :data:`OBSERVATION`, and returns n accelerations; runs that step together share a call. With
    ``each_run`` it is called with a vehicle's index and the scenario's seed before each run, and returns the callable
    that drives this vehicle in this run, which may have state.

    With ``warns``, ``decide`` returns a pair: the acceleration, and True while the controller warns its driver of a
    forward collision. The test driver of suites brakes after such a warning. Excludes ``batch``.

    ``interval_s`` is the time between decisions (every step if None). ``identity`` names everything that determines
    its commands, such as a version; without it a campaign cannot be resumed. A count of failures has a certificate only
    if it is a SHA-256: 64 hexadecimal digits in lower case, such as those of the file that defines the controller.

    An exception is a failure of the controller: it ends the run, whose result contains the traceback.
    """

    decide: Callable[..., Any]
    batch: bool = False
    each_run: bool = False
    interval_s: float | None = None
    name: str = "python"
    identity: str | None = None
    warns: bool = False


def as_controller(controller: str | Controller | Callable[..., Any]) -> str | Controller:
    """Converts a callable to a controller; keeps a name or a controller."""
    if isinstance(controller, str | Controller):
        return controller
    if callable(controller):
        return Controller(controller, name=getattr(controller, "__name__", "python"))
    raise ControllerError(
        f"a controller is a name, a callable or a crumple.Controller, found {type(controller).__name__}"
    )
