"""Robustness of formulas of signal temporal logic."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crumple._crumple import monitor as _monitor
from crumple.errors import FormulaError


def monitor(
    formula: str,
    signals: Mapping[str, ArrayLike],
    *,
    step_s: float = 1.0,
    over_time: bool = False,
) -> Any:
    """How robustly signals satisfy a formula: above 0 where they do, below 0 where they do not.

    ``signals`` are arrays by name, all sampled every ``step_s`` seconds from 0 on: of shape (samples,) for one trace, or
    (traces, samples) for many at once; one of a single trace stands for all of them. The formula is one of signal temporal
    logic as on the command line (``always[0,10] (gap_m > 2 and speed_mps < 30)``), its windows in seconds; a window is cut
    at the end of the trace.

    The answer is a number for one trace and an array of shape (traces,) for many, or, ``over_time``, one for every sample.
    """
    arrays: dict[str, NDArray[np.float64]] = {}
    for name, values in signals.items():
        try:
            array = np.asarray(values).astype(np.float64, casting="same_kind", copy=False)
        except (TypeError, ValueError) as error:
            raise FormulaError(f"signal `{name}` is no array of numbers: {error}") from error
        if array.ndim not in (1, 2):
            raise FormulaError(f"signal `{name}` has {array.ndim} dimensions: 1 or 2 are wanted")
        arrays[name] = array
    several = [len(array) for array in arrays.values() if array.ndim == 2]
    traces = max(several, default=1)
    given = [np.ascontiguousarray(np.atleast_2d(array)) for array in arrays.values()]
    found = _monitor(formula, list(arrays), given, step_s, traces, over_time)
    if over_time:
        return found if several else found[0]
    return found[:, 0] if several else float(found[0, 0])
