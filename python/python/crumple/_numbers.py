"""Checks of numbers in arguments."""

from __future__ import annotations

import operator

from crumple.errors import CrumpleError

MAX_SEED = 2**63 - 1
"""Largest seed of scenarios and campaigns."""


def whole_number(name: str, value: object, least: int, most: int, error: type[CrumpleError]) -> int:
    """Returns an argument as a whole number from ``least`` to ``most``."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = least - 1
    if not least <= number <= most:
        raise error(f"{name}: must be a whole number from {least} to {most}, found {value!r}", field=name)
    return number
