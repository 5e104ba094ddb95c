"""Compares random files with esmini: `openscenario_esmini.py LIBRARY COUNT`.

LIBRARY is esmini's library `libesminiLib.so` (3.6.0, https://github.com/esmini/esmini). Without OpenSceneGraph, OSI
and SUMO, it is built from the folders CommonMini, RoadManager, ScenarioEngine, Controllers and PlayerBase (without
Plot.cpp, OSIReporter.cpp, OSITrafficCommand.cpp and ControllerSumo.cpp), externals/pugixml and externals/yaml, with
`-DFMT_HEADER_ONLY` and the headers of fmt.

The files have speed actions by time and rate, no repetitions, no
priority `skip`, and no conditions on the end or stop of events, in which esmini differs from the standard
(docs/exchange.md). The interpreter of the standard, with which crumple agrees within 1 cm, must agree with esmini.
"""

import ctypes
import os
import random
import sys
import tempfile
from pathlib import Path

import openscenario_motion as motion
from openscenario_oracle import Engine

FRAME_S = 0.001
CLOSE_M = 0.02


class ObjectState(ctypes.Structure):
    """`SE_ScenarioObjectState` up to the speed."""

    _fields_ = [
        ("ids", ctypes.c_int * 3),
        ("timestamp", ctypes.c_double),
        ("pose", ctypes.c_double * 6),
        ("road_and_junction", ctypes.c_uint32 * 2),
        ("t", ctypes.c_double),
        ("lane", ctypes.c_int),
        ("offset", ctypes.c_double),
        ("s", ctypes.c_double),
        ("speed", ctypes.c_double),
        ("rest", ctypes.c_byte * 256),
    ]


class SpeedFile(motion.File):
    """Writes a random file without the constructs in which esmini differs."""

    def speed_action(self):
        chance = self.chance
        shape = chance.choice(["linear", "cubic", "sinusoidal"])
        dimension = chance.choice(["time", "rate"])
        value = {"time": chance.uniform(3, 6), "rate": chance.uniform(0.5, 3)}[dimension]
        target = motion.element("AbsoluteTargetSpeed", value=round(chance.uniform(10, 26), 2))
        content = motion.dynamics("SpeedActionDynamics", shape, dimension, round(value, 3))
        action = motion.element("SpeedAction", content + motion.element("SpeedActionTarget", target))
        return motion.element("LongitudinalAction", action)

    def lane_action(self, _):
        return self.speed_action()

    def write(self, folder):
        path = super().write(folder)
        text = path.read_text().replace('maximumExecutionCount="2"', 'maximumExecutionCount="1"')
        text = text.replace('priority="skip"', 'priority="override"')
        path.write_text(text.replace("stopTransition", "completeState").replace("endTransition", "completeState"))
        return path


def run(library, path, end_s):
    """Returns lists of (time, s) of each object."""
    for option in (b"disable_stdout", b"disable_log"):
        library.SE_SetOption(option)
    assert library.SE_Init(str(path).encode(), 1, 0, 0, 0) == 0, path
    ids = [library.SE_GetId(k) for k in range(library.SE_GetNumberOfObjects())]
    found = {library.SE_GetObjectName(number).decode(): [] for number in ids}
    while library.SE_GetQuitFlag() == 0 and library.SE_GetSimulationTime() < end_s:
        for number, rows in zip(ids, found.values()):
            state = ObjectState()
            library.SE_GetObjectState(number, ctypes.byref(state))
            rows.append((round(library.SE_GetSimulationTime(), 4), state.s))
        library.SE_StepDT(ctypes.c_double(FRAME_S))
    library.SE_Close()
    return found


def main():
    library = ctypes.CDLL(os.path.abspath(sys.argv[1]))
    library.SE_GetObjectName.restype = ctypes.c_char_p
    library.SE_GetSimulationTime.restype = ctypes.c_double
    worst_m = 0.0
    for number in range(int(sys.argv[2])):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            path = SpeedFile(random.Random(number), number).write(folder)
            end_s, record = Engine(path, folder / "road.xodr").run()
            for entity, rows in run(library, path, end_s).items():
                own = {round(row[0], 4): row[1] for row in record[entity]}
                off_m = max(abs(s - own[time]) for time, s in rows if time in own and time < end_s)
                assert off_m <= CLOSE_M, f"file {number}, {entity}: {off_m} m"
                worst_m = max(worst_m, off_m)
    print(f"{sys.argv[2]} files agree with esmini within {worst_m:.4f} m")


if __name__ == "__main__":
    main()
