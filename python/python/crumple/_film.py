"""Pictures of an episode in pixels."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Picture: TypeAlias = NDArray[np.uint8]

_WIDTH, _ROAD, _DIAGRAM, _MARGIN = 640, 96, 288, 12
_PAPER, _ASPHALT, _INK = (255, 255, 255), (208, 210, 214), (60, 64, 72)
# Of Okabe and Ito: told apart by everybody. The agent's vehicle is the second.
_COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233))
_AHEAD_M, _BEHIND_M, _LEAST_SPAN_S = 90.0, 70.0, 2.0


class Film:
    """An episode so far: where its vehicles were at each decision."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Forget the episode before."""
        self._positions_m: list[list[float]] = []
        self._lengths_m: list[float] = []
        self._between_s = 0.0

    def add(self, between_s: float, positions_m: list[float], lengths_m: list[float]) -> None:
        """Where the vehicles are ``between_s`` after they were added last."""
        self._between_s, self._lengths_m = between_s, lengths_m
        self._positions_m.append(positions_m)

    def frame(self) -> Picture:
        """The line of vehicles from above, and below it their ways over time."""
        picture = np.full((_ROAD + _DIAGRAM, _WIDTH, 3), _PAPER, np.uint8)
        if self._positions_m:
            self._draw_road(picture[:_ROAD])
            self._draw_ways(picture[_ROAD:])
        return picture

    def _draw_road(self, picture: Picture) -> None:
        """The line drives to the right; the agent's vehicle stays where it is, and marks every 20 m pass by."""
        picture[_ROAD // 4 : -_ROAD // 4] = _ASPHALT
        now_m = self._positions_m[-1]
        left_m = now_m[min(1, len(now_m) - 1)] - _BEHIND_M
        pixels_a_m = _WIDTH / (_AHEAD_M + _BEHIND_M)
        for mark_m in np.arange(np.ceil(left_m / 20.0) * 20.0, left_m + _AHEAD_M + _BEHIND_M, 20.0):
            column = int((mark_m - left_m) * pixels_a_m)
            picture[_ROAD // 4 - 4 : _ROAD // 4, column : column + 2] = _INK
        for index, (front_m, length_m) in enumerate(zip(now_m, self._lengths_m, strict=True)):
            ends = np.array([front_m - length_m, front_m]) - left_m
            first, last = np.clip(ends * pixels_a_m, 0, _WIDTH).astype(int)
            picture[_ROAD // 2 - 10 : _ROAD // 2 + 10, first : max(last, first + 1)] = _COLOURS[index % len(_COLOURS)]

    def _draw_ways(self, picture: Picture) -> None:
        """Time to the right, position upwards: a band for each vehicle, from its rear bumper to its front."""
        ways_m = np.array(self._positions_m)
        lengths_m = np.array(self._lengths_m)
        inner = picture[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]
        height, width = inner.shape[:2]
        samples = len(ways_m)
        at = np.linspace(0.0, max(samples - 1, _LEAST_SPAN_S / self._between_s), width)
        low_m, high_m = float((ways_m - lengths_m).min()), float(ways_m.max())
        rows = high_m - (np.arange(height) + 0.5) / height * (high_m - low_m)
        for index, length_m in enumerate(lengths_m):
            front_m = np.interp(at, np.arange(samples), ways_m[:, index])
            least_m = max(float(length_m), 1.5 * (high_m - low_m) / height)
            band = (rows[:, None] <= front_m) & (rows[:, None] > front_m - least_m) & (at <= samples - 1)
            inner[band] = _COLOURS[index % len(_COLOURS)]
        picture[-_MARGIN, _MARGIN:-_MARGIN] = _INK
        picture[_MARGIN:-_MARGIN, _MARGIN - 1] = _INK
