"""Exports scenarios, checks the files, reads them back and compares, and imports a file: `openscenario.py BIN COUNT`.

`.ci/openscenario` runs this program in an environment with the needed packages.
"""

import contextlib
import csv
import functools
import io
import json
import logging
import os
import random
import re
import subprocess
import sys
import tempfile
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

logging.disable(logging.CRITICAL)

import schemas  # OpenDRIVE schemas of scenariogeneration.
from lxml import etree
from qc_baselib import Configuration, Result, StatusType
from qc_openscenario import constants
from qc_openscenario.main import run_checks
from scenariogeneration import xodr, xosc

CLOSE_M = CLOSE_MPS = 0.01
# A trajectory states mean speeds only. The largest error in these random scenarios is 0.057 m/s.
TRAJECTORY_CLOSE_MPS = 0.1
BIN, COUNT = Path(sys.argv[1]), int(sys.argv[2])
# Distance from rear axle to front bumper that the exporter uses.
AHEAD = 0.8


def crumple(*arguments):
    """Runs crumple and returns its output."""
    done = subprocess.run([BIN / "crumple", "--quiet", *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, f"crumple {arguments}: {done.stderr}"
    return done.stdout


def objections(path):
    """Returns the objections of ASAM's checker, including errors of checks and too few completed checks."""
    config, result = Configuration(), Result()
    config.set_config_param("InputFile", str(path))
    result.register_checker_bundle(
        name=constants.BUNDLE_NAME, description="", version=constants.BUNDLE_VERSION, summary=""
    )
    result.set_result_version(version=constants.BUNDLE_VERSION)
    with contextlib.redirect_stdout(io.StringIO()):
        run_checks(config, result)
    bundle = result.get_checker_bundle_result(constants.BUNDLE_NAME)
    found = [issue.description for checker in bundle.checkers for issue in checker.issues]
    found += [
        f"{checker.checker_id}: {checker.status}" for checker in bundle.checkers if checker.status == StatusType.ERROR
    ]
    done = sum(checker.status == StatusType.COMPLETED for checker in bundle.checkers)
    return found + ([] if done >= 10 else [f"only {done} checks were completed"])


@functools.cache
def road_schema():
    """Returns the schema of OpenDRIVE."""
    return etree.XMLSchema(etree.parse(str(Path(next(iter(schemas.__path__))) / "opendrive_17_core.xsd")))


def assert_valid_road(path):
    """Validates an OpenDRIVE file."""
    road_schema().assertValid(etree.parse(str(path)))


def polylines(path):
    """Returns times and front bumper positions of each vehicle, in the order of the entities."""
    # Skip its schema check, which takes seconds and repeats that of ASAM's checker.
    scenario = xosc.Scenario.parse(ElementTree.parse(path))
    lengths = {}
    for entity in scenario.entities.scenario_objects:
        lengths[entity.name] = entity.entityobject.boundingbox.boundingbox.length
    found = {}
    for story in scenario.storyboard.stories:
        for act in story.acts:
            for group in act.maneuvergroup:
                name = group.actors.actors[0].entity
                action = group.maneuvers[0].events[0].action[0].action
                line = action.trajectory.shapes
                ahead_m = AHEAD * lengths[name]
                found[name] = [(t, place.x + ahead_m) for t, place in zip(line.time, line.positions)][:-1]
    return [found[name] for name in lengths]


def interpolate(points, times_s):
    """Yields the positions of a polyline at increasing times."""
    k = 0
    for time_s in times_s:
        while k + 2 < len(points) and points[k + 1][0] <= time_s:
            k += 1
        (t0, x0), (t1, x1) = points[k], points[min(k + 1, len(points) - 1)]
        yield x0 if t1 == t0 else x0 + (x1 - x0) * (time_s - t0) / (t1 - t0)


def read_trace(path):
    """Returns times, positions and speeds of each vehicle, front to rear."""
    tracks = defaultdict(lambda: ([], [], []))
    with open(path, newline="") as table:
        for row in csv.DictReader(table):
            for values, column in zip(tracks[int(row["vehicle"])], ("time_s", "position_m", "speed_mps")):
                values.append(float(row[column]))
    return [tracks[k] for k in sorted(tracks)]


def compare(name, exported, tracks):
    """Returns the largest errors of a position, and of a speed over a step."""
    worst_m = worst_mps = 0.0
    lines = polylines(exported)
    assert len(lines) == len(tracks), f"{name}: {len(lines)} polylines of {len(tracks)} vehicles"
    for points, (times_s, places_m, _) in zip(lines, tracks):
        read_m = list(interpolate(points, times_s))
        for k, (read, true) in enumerate(zip(read_m, places_m)):
            worst_m = max(worst_m, abs(read - true))
            if k and times_s[k] - times_s[k - 1] > 1e-5:
                speeds = [(x[k] - x[k - 1]) / (times_s[k] - times_s[k - 1]) for x in (read_m, places_m)]
                worst_mps = max(worst_mps, abs(speeds[0] - speeds[1]))
    assert worst_m <= CLOSE_M and worst_mps <= CLOSE_MPS, f"{name}: {worst_m} m, {worst_mps} m/s"
    return worst_m, worst_mps


def assert_same_motion(name, tracks, again):
    """Compares positions and speeds at the times of the first tracks, until the first of them ends."""
    assert len(tracks) == len(again), f"{name}: another number of vehicles"
    # A collision ends the last step early.
    end_s = min(tracks[0][0][-1], again[0][0][-1]) - 1e-6
    for (times_s, *values), (other_times_s, *other_values) in zip(tracks, again):
        for each, other, tolerance in zip(values, other_values, (CLOSE_M, TRAJECTORY_CLOSE_MPS)):
            read = interpolate(list(zip(other_times_s, other)), times_s)
            for time_s, value, found in zip(times_s, each, read):
                assert time_s >= end_s or abs(value - found) <= tolerance, f"{name}, {time_s} s: {value}, not {found}"


def check(task):
    """Exports a scenario in both ways and returns its errors."""
    scenario, folder = task
    folder.mkdir()
    controller = ["--controller", "baseline"]
    crumple("simulate", scenario, *controller, "--trace", folder / "trace.csv")
    for way, more in [("trajectories", controller), ("actions", [])]:
        crumple("export", scenario, "--to", "openscenario", "--as", way, *more, "--out", folder / way)
        (exported,) = (folder / way).glob("*.xosc")
        found = objections(exported)
        assert not found, f"{scenario}, {way}: {found}"
        assert_valid_road(exported.with_suffix(".xodr"))
        crumple("import", exported, "--out", folder / f"again-{way}")
        (imported,) = (folder / f"again-{way}").glob("*.toml")
        crumple("simulate", imported, *controller, "--trace", folder / "again.csv")
        if way == "trajectories":
            tracks = read_trace(folder / "trace.csv")
            errors = compare(scenario, exported, tracks)
            assert_same_motion(scenario, tracks, read_trace(folder / "again.csv"))
        else:
            crumple("export", imported, "--to", "openscenario", "--as", way, "--out", folder / "third")
            (third,) = (folder / "third").glob("*.xosc")
            assert third.read_bytes() == exported.read_bytes(), f"{scenario}: another export of the import"
    return errors


def generate_cut_in(folder):
    """Writes a cut-in and a road with scenariogeneration, and returns the path of the scenario."""
    road = xodr.create_road(xodr.Line(3000), id=1, left_lanes=0, right_lanes=2, lane_width=3.5)
    drive = xodr.OpenDrive("road")
    drive.add_road(road)
    drive.adjust_roads_and_lanes()
    drive.write_xml(str(folder / "road.xodr"))
    box = xosc.BoundingBox(2, 4.8, 1.5, 1.4, 0, 0.75)
    axles = [xosc.Axle(0.5, 0.6, 1.8, 2.8, 0.3), xosc.Axle(0, 0.6, 1.8, 0, 0.3)]
    car = xosc.Vehicle("car", xosc.VehicleCategory.car, box, *axles, 60, 5, 9)
    entities, init = xosc.Entities(), xosc.Init()
    entities.add_scenario_object("ego", car, xosc.Controller("mine", xosc.Properties()))
    entities.add_scenario_object("other", car)
    step = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0)
    for name, place, lane in [("ego", 50, -1), ("other", 90, -2)]:
        init.add_init_action(name, xosc.TeleportAction(xosc.LanePosition(place, 0, lane, 1)))
        init.add_init_action(name, xosc.AbsoluteSpeedAction("$speed" if name == "ego" else 20, step))
    sine = xosc.TransitionDynamics(xosc.DynamicsShapes.sinusoidal, xosc.DynamicsDimension.time, 3)
    brake = xosc.TransitionDynamics(xosc.DynamicsShapes.linear, xosc.DynamicsDimension.rate, 4)
    maneuver = xosc.Maneuver("maneuver")
    for name, time, action in [
        ("change", 3, xosc.AbsoluteLaneChangeAction(-1, sine)),
        ("brake", 8, xosc.AbsoluteSpeedAction(5, brake)),
    ]:
        event = xosc.Event(name, xosc.Priority.parallel)
        event.add_action(name, action)
        after = xosc.SimulationTimeCondition(time, xosc.Rule.greaterOrEqual)
        event.add_trigger(xosc.ValueTrigger(f"{name}-trigger", 0, xosc.ConditionEdge.none, after))
        maneuver.add_event(event)
    stop = xosc.SimulationTimeCondition(20, xosc.Rule.greaterThan)
    story = xosc.StoryBoard(init, xosc.ValueTrigger("end", 0, xosc.ConditionEdge.none, stop, "stop"))
    story.add_maneuver(maneuver, "other")
    parameters = xosc.ParameterDeclarations()
    parameters.add_parameter(xosc.Parameter("speed", xosc.ParameterType.double, "22"))
    roads = xosc.RoadNetwork("road.xodr")
    scenario = xosc.Scenario(
        "cut-in", "crumple", parameters, entities, story, roads, xosc.Catalog(), osc_minor_version=2
    )
    scenario.write_xml(str(folder / "cut-in.xosc"))
    return folder / "cut-in.xosc"


def assert_imports(folder):
    """Checks that a generated scenario is valid, is imported as written, and runs."""
    folder.mkdir()
    written = generate_cut_in(folder)
    found = objections(written)
    assert not found, found
    crumple("import", written, "--out", folder)
    with open(folder / "cut-in.toml", "rb") as text:
        other, ego = tomllib.load(text)["vehicles"]
    assert (ego["driver"], ego["speed_mps"], other["speed_mps"]) == ("under-test", 22, 20), (ego, other)
    assert other["driver"] == {"brake-to-speed": {"onset_s": 8, "rate_mps2": 4, "final_speed_mps": 5}}, other
    # The side is 0.75 m from the marking: 21 % of the way, after 31 % of the time.
    assert abs(other["enters"]["at_s"] - 3.92) < 0.01, other
    crumple("simulate", folder / "cut-in.toml", "--controller", "idm")


def random_script(chance, speed):
    """Returns a random driver that follows a script."""
    onset, rate = chance.uniform(0, 5), chance.uniform(0.1, 5)
    times = sorted({round(chance.uniform(0, 12), 2) for _ in range(chance.randint(2, 6))})
    final_speed = {"final_speed_mps": chance.uniform(0, speed)}
    ramp = {"ramp_s": chance.uniform(0, 2), "release_s": chance.uniform(0, 1)}
    scripts = [
        "constant-speed",
        {"brake": {"onset_s": onset, "rate_mps2": rate}},
        {"brake-to-speed": {"onset_s": onset, "rate_mps2": rate, **final_speed}},
        {"ramp-brake": {"onset_s": onset, "rate_mps2": rate, **ramp}},
        {"pieces": {"from_s": times, "accel_mps2": [chance.uniform(-5, 1.5) for _ in times]}},
        {"recorded": {"time_s": times, "speed_mps": [chance.uniform(0, 30) for _ in times]}},
    ]
    return chance.choice(scripts)


def random_scenario(chance, number):
    """Returns a random scenario with two to six vehicles."""
    vehicles, position = [], chance.uniform(-500, 500)
    for index in range(chance.randint(2, 6)):
        speed, length = chance.uniform(0, 35), chance.uniform(2, 20)
        follow = chance.choice(["under-test", "under-test", "baseline", "idm", random_script(chance, speed)])
        vehicle = {
            "class": chance.choice(["light", "heavy"]),
            "position_m": position,
            "speed_mps": speed,
            "length_m": length,
        }
        vehicle["driver"] = random_script(chance, speed) if index == 0 else follow
        vehicle["acceleration_noise_mps2"] = chance.choice([0.0, 0.3])
        vehicles.append(vehicle)
        position -= length + chance.uniform(1, 60)
    header = {"version": 1, "name": f"random {number}", "duration_s": chance.choice([5.0, 15.0]), "seed": number}
    header["step_s"] = chance.choice([0.01, 0.05])
    return header | {"environment": {"friction": chance.uniform(0.2, 1)}, "vehicles": vehicles}


def assert_faults_are_found(folder):
    """Checks that ASAM's checker finds two injected faults."""
    crumple("export", "paper-1", "--to", "openscenario", "--out", folder)
    exported = folder / "paper-1.xosc"
    text = exported.read_text()
    exported.write_text(text.replace('<EntityRef entityRef="vehicle_1"/>', '<EntityRef entityRef="vehicle_9"/>'))
    assert objections(exported), "an undeclared entity passed"
    exported.write_text(text.replace('vehicleCategory="car"', 'vehicleCategory="kart"'))
    assert objections(exported), "an unknown category passed"


def main():
    """Checks built-in and random scenarios."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        assert_faults_are_found(folder / "faults")
        assert_imports(folder / "imports")
        known = re.findall(r"^  (\S+)", crumple("list", "scenarios"), re.MULTILINE)
        assert "paper-1" in known, "no built-in scenarios"
        chance = random.Random(24)
        tasks = [(name, folder / name) for name in known]
        for k in range(COUNT):
            written = folder / f"random-{k}.json"
            written.write_text(json.dumps(random_scenario(chance, k)))
            tasks.append((written, folder / f"random-{k}"))
        with ProcessPoolExecutor(os.cpu_count()) as pool:
            errors = list(pool.map(check, tasks, chunksize=8))
        worst_m, worst_mps = (max(error[k] for error in errors) for k in (0, 1))
        errors = f"largest errors {worst_m:.4f} m and {worst_mps:.4f} m/s"
        print(f"{len(known)} built-in and {COUNT} random scenarios: valid, {errors}")


if __name__ == "__main__":
    main()
