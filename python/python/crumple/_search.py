"""Search methods written in Python."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import ArrayLike


class Search(Protocol):
    """Search for the smallest robustness in a unit cube."""

    def ask(self) -> ArrayLike:
        """Returns the next points, an array of shape (points, dimension) with numbers from 0 to 1."""

    def tell(self, robustness: list[float]) -> object:
        """Receives the robustness of the last points, which may be infinite; of fewer points at the end."""


@dataclass(frozen=True)
class SearchMethod:
    """Search method of your own: ``start`` takes the dimension of the cube and a seed, and returns a :class:`Search`.

    The seed must determine the search; otherwise a campaign cannot be resumed. The name has letters, digits and ``-``.
    """

    start: Callable[[int, int], Search]
    name: str = "python"
