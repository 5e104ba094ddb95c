"""Renders images of an episode."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]

_WIDTH, _ROAD, _DIAGRAM, _MARGIN = 640, 96, 288, 12
_BACKGROUND, _ASPHALT, _INK = (255, 255, 255), (208, 210, 214), (60, 64, 72)
# Palette of Okabe and Ito, which is safe for colour blindness. The agent's vehicle is the second.
_COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233))
_AHEAD_M, _BEHIND_M, _MIN_SPAN_S = 90.0, 70.0, 2.0


class EpisodeRenderer:
    """Renderer of an episode, with the positions of its vehicles at each decision."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Discards the previous episode."""
        self._positions_m: list[list[float]] = []
        self._lengths_m: list[float] = []
        self._decision_s = 0.0

    def add_positions(self, decision_s: float, positions_m: list[float], lengths_m: list[float]) -> None:
        """Adds the positions at a decision, ``decision_s`` after the one before."""
        self._decision_s, self._lengths_m = decision_s, lengths_m
        self._positions_m.append(positions_m)

    def render(self) -> Image:
        """Returns the vehicles from above, and below them their trajectories over time."""
        picture = np.full((_ROAD + _DIAGRAM, _WIDTH, 3), _BACKGROUND, np.uint8)
        if self._positions_m:
            self._draw_road(picture[:_ROAD])
            self._draw_trajectories(picture[_ROAD:])
        return picture

    def _draw_road(self, picture: Image) -> None:
        """Draws the vehicles, which drive to the right. The agent's vehicle is fixed; marks have a distance of 20 m."""
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

    def _draw_trajectories(self, picture: Image) -> None:
        """Draws position over time: a band for each vehicle, from its rear bumper to its front bumper."""
        trajectories_m = np.array(self._positions_m)
        lengths_m = np.array(self._lengths_m)
        inner = picture[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]
        height, width = inner.shape[:2]
        samples = len(trajectories_m)
        sample_positions = np.linspace(0.0, max(samples - 1, _MIN_SPAN_S / self._decision_s), width)
        low_m, high_m = float((trajectories_m - lengths_m).min()), float(trajectories_m.max())
        rows = high_m - (np.arange(height) + 0.5) / height * (high_m - low_m)
        for index, length_m in enumerate(lengths_m):
            front_m = np.interp(sample_positions, np.arange(samples), trajectories_m[:, index])
            visible_m = max(float(length_m), 1.5 * (high_m - low_m) / height)
            is_inside = (rows[:, None] <= front_m) & (rows[:, None] > front_m - visible_m)
            band = is_inside & (sample_positions <= samples - 1)
            inner[band] = _COLOURS[index % len(_COLOURS)]
        picture[-_MARGIN, _MARGIN:-_MARGIN] = _INK
        picture[_MARGIN:-_MARGIN, _MARGIN - 1] = _INK
