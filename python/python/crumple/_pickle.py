"""Functions that pickles of native classes name."""

from __future__ import annotations

from typing import Any


def call_static_method(cls: type, name: str, arguments: tuple[Any, ...]) -> Any:
    """Calls a static method of a class."""
    return getattr(cls, name)(*arguments)
