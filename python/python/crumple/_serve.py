"""Controllers in Python as processes."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from crumple._controller import OBSERVATION, Controller, as_controller
from crumple._crumple import Observation
from crumple.errors import ControllerError


def serve(controller: Controller | Callable[..., Any]) -> None:
    """Drives vehicles as a process of crumple, until standard input ends.

    A program with this call is a controller of every command: ``crumple falsify --controller "exec:python3 mine.py"``.
    It takes the controllers of :func:`crumple.simulate`, and inputs without offsets and scales. What the controller
    prints goes to standard error.
    """
    served = as_controller(controller)
    if not isinstance(served, Controller):
        raise ControllerError("serve takes a callable or a crumple.Controller")
    answers, vehicle, names, decide = sys.stdout, 0, [""], served.decide
    with contextlib.redirect_stdout(sys.stderr):
        for line in sys.stdin:
            query = json.loads(line)
            answer: dict[str, Any] = {"id": query.get("id")}
            if "hello" in query:
                vehicle, names = query["hello"]["vehicle"]["index"], query["hello"]["inputs"]
                if query["hello"]["history"] != 1:
                    raise ControllerError("serve takes no history: keep the earlier observations in the controller")
                answer = {"crumple": 1, "name": served.name, "deterministic": True, "batch": not served.each_run}
                if served.interval_s is not None:
                    answer["interval_s"] = served.interval_s
                if served.warns:
                    answer["warns"] = True
            elif "reset" in query:
                decide = served.decide(vehicle, query["reset"]["seed"]) if served.each_run else decide
                answer["ready"] = True
            else:
                rows = [_quantities(names, see) for see in (query["see"] if "times_s" in query else [query["see"]])]
                if served.batch:
                    table = [[row.get(name, np.nan) for name in OBSERVATION] for row in rows]
                    commands = np.asarray(decide(np.array(table)), dtype=float).tolist()
                elif served.warns:
                    decisions = [decide(Observation(**row)) for row in rows]
                    commands = [float(command) for command, _ in decisions]
                    warnings = [bool(warning) for _, warning in decisions]
                    answer["warning"] = warnings if "times_s" in query else warnings[0]
                else:
                    commands = [float(decide(Observation(**row))) for row in rows]
                answer["acceleration_mps2"] = commands if "times_s" in query else commands[0]
            answers.write(json.dumps(answer) + "\n")
            answers.flush()


def _quantities(names: list[str], see: list[float]) -> dict[str, float]:
    """Returns the quantities of an observation, without those of absent vehicles."""
    seen = dict(zip(names, see, strict=True))
    for side in ("ahead", "behind"):
        relative_mps = seen.get(f"relative_speed_{side}_mps")
        if relative_mps is not None:
            seen.setdefault(f"speed_{side}_mps", seen["speed_mps"] + relative_mps)
        if seen.get(f"is_{side}", 1.0) == 0.0:
            seen = {name: value for name, value in seen.items() if side not in name}
    return {name: seen[name] for name in OBSERVATION if name in seen}
