"""Exceptions of crumple."""

from __future__ import annotations


class CrumpleError(Exception):
    """Input that crumple cannot use.

    ``file``, ``line`` (from 1) and ``field`` are its location, if known; the file of a text is ``<toml>``, that of a
    dictionary ``<dict>``.
    """

    def __init__(
        self, message: str, file: str | None = None, line: int | None = None, field: str | None = None
    ) -> None:
        super().__init__(message, file, line, field)
        self.file = file
        self.line = line
        self.field = field

    def __str__(self) -> str:
        return str(self.args[0])


class ScenarioError(CrumpleError):
    """A scenario does not exist or is invalid."""


class SpaceError(CrumpleError):
    """A space does not exist or is invalid."""


class ControllerError(CrumpleError):
    """A controller does not exist or cannot be read."""


class RunError(CrumpleError):
    """A scenario cannot be run with these options."""


class CampaignError(CrumpleError):
    """A campaign cannot be run with these options."""


class FormulaError(CrumpleError):
    """A formula cannot be read, or does not fit the signals."""


class RateError(CrumpleError):
    """A failure rate cannot be counted with these options."""


class AssessmentError(CrumpleError):
    """An assessment cannot be made with these options."""


class TrainingError(CrumpleError):
    """A training task is invalid, or an environment was used incorrectly."""


class WorkerError(CrumpleError):
    """Workers of an executor ended without a result. The message names the missing seeds or runs."""
