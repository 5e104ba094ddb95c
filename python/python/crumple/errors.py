"""What is raised where something given to crumple cannot be used."""

from __future__ import annotations


class CrumpleError(Exception):
    """Something that was given cannot be used.

    ``file``, ``line`` (from 1) and ``field`` say where, as far as they are known; a text is called ``<toml>``, a
    dictionary ``<dict>``.
    """

    def __init__(self, message: str, file: str | None = None, line: int | None = None, field: str | None = None) -> None:
        super().__init__(message, file, line, field)
        self.file = file
        self.line = line
        self.field = field

    def __str__(self) -> str:
        return str(self.args[0])


class ScenarioError(CrumpleError):
    """A scenario does not exist or is not valid."""


class SpaceError(CrumpleError):
    """A space does not exist or is not valid."""


class ControllerError(CrumpleError):
    """A controller does not exist or cannot be read."""


class RunError(CrumpleError):
    """A scenario cannot be run as asked."""


class CampaignError(CrumpleError):
    """A search cannot be made as asked."""


class FormulaError(CrumpleError):
    """A formula cannot be read, or does not fit the signals."""


class RateError(CrumpleError):
    """A rate cannot be counted as asked."""


class AssessmentError(CrumpleError):
    """An assessment cannot be made as asked."""


class TrainingError(CrumpleError):
    """A training task cannot be used, or an environment was not used as it must be."""
