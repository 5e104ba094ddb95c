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
    """Returns the robustness of a formula on signals: positive if they satisfy it, negative if they violate it.

    ``signals`` are arrays by name, sampled every ``step_s`` seconds from 0 on: of shape (samples,) for one trace, or
    (traces, samples) for several; a signal of one trace is shared by all. The formula is in signal temporal logic as on
    the command line (``always[0,10] (gap_m > 2 and speed_mps < 30)``), with windows in seconds that are clipped at the
    end of the trace.

    The result is a number for one trace and an array of shape (traces,) for several. With ``over_time`` it has one
    value for every sample.
    """
    arrays: dict[str, NDArray[np.float64]] = {}
    for name, values in signals.items():
        try:
            array = np.asarray(values).astype(np.float64, casting="same_kind", copy=False)
        except (TypeError, ValueError) as error:
            raise FormulaError(f"signal `{name}` is no array of numbers: {error}") from error
        if array.ndim not in (1, 2):
            raise FormulaError(f"signal `{name}` has {array.ndim} dimensions: it must have 1 or 2")
        arrays[name] = array
    batch_sizes = [len(array) for array in arrays.values() if array.ndim == 2]
    traces = max(batch_sizes, default=1)
    rows = [np.ascontiguousarray(np.atleast_2d(array)) for array in arrays.values()]
    robustness = _monitor(formula, list(arrays), rows, step_s, traces, over_time)
    if over_time:
        return robustness if batch_sizes else robustness[0]
    return robustness[:, 0] if batch_sizes else float(robustness[0, 0])
