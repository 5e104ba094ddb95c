"""Compares imports of random OpenSCENARIO files with an interpreter of the standard.

`openscenario_motion.py BIN COUNT [FIRST]`: BIN is the folder of crumple, FIRST the number of the first file. For each
four files, there is a further one with more edges, delays and repetitions, one with more actions per vehicle, and one
with several actions in an event, several actors, and references to all kinds of elements.

Each file has two scripted vehicles with two to four (or four to six) actions each, and a vehicle at constant speed in
whose lane they are. Positions must agree within 2 cm, and the times at which a vehicle enters or leaves the lane within
one step.
"""

import math
import os
import random
import re
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from openscenario_oracle import Engine

# 1 cm, and 1 cm for the steps of the interpreter: 0.5 ms at differences of the speed of up to 20 m/s.
CLOSE_M = 0.02
# Number from which files are wide ones.
FIRST_WIDE = 5000
# Number from which files have more actions.
FIRST_LONG = 9000
# Number from which events have several actions.
FIRST_MIXED = 13000
# One step of crumple. An event that is repeated at once begins up to one step later each time.
STEP_S = 0.0101
WIDTH_M = 1.8


def element(tag, content="", /, **attributes):
    """Returns an XML element; a trailing underscore of an attribute is removed."""
    words = "".join(f' {key.rstrip("_")}="{value}"' for key, value in attributes.items())
    return f"<{tag}{words}>{content}</{tag}>" if content else f"<{tag}{words}/>"


def condition(content, chance=None, edge="none", delay=0):
    return element("Condition", content, name="c", delay=delay, conditionEdge=edge)


def by_value(tag, /, **attributes):
    return element("ByValueCondition", element(tag, **attributes))


def by_entity(entity, tag, /, **attributes):
    refs = element("EntityRef", entityRef=entity)
    triggering = element("TriggeringEntities", refs, triggeringEntitiesRule="any")
    return element("ByEntityCondition", triggering + element("EntityCondition", element(tag, **attributes)))


def at_time(time_s, rule="greaterOrEqual"):
    return by_value("SimulationTimeCondition", value=time_s, rule=rule)


def trigger(tag, conditions):
    return element(tag, element("ConditionGroup", "".join(conditions)))


def dynamics(tag, shape, dimension, value):
    return element(tag, dynamicsShape=shape, dynamicsDimension=dimension, value=value)


class File:
    """Writes a random file."""

    # Smallest and largest number of actions of a vehicle.
    actions = (2, 4)

    def __init__(self, chance, number):
        self.chance, self.number = chance, number
        self.events = []
        self.left_hand = chance.random() < 0.2
        # Lanes 1 to 3 are driven against the direction of the road, unless traffic is on the left.
        self.side = chance.choice([-1, 1])
        against = (self.side > 0) != self.left_hand
        self.start = 2500 if against else 300
        self.sign = -1 if against else 1
        self.ego_lane = 2 * self.side

    def speed_action(self):
        chance = self.chance
        shape = chance.choice(["linear", "cubic", "sinusoidal"])
        dimension = chance.choice(["time", "rate", "distance"])
        value = {"time": chance.uniform(2, 6), "rate": chance.uniform(0.5, 4), "distance": chance.uniform(40, 120)}
        target = element("AbsoluteTargetSpeed", value=round(chance.uniform(8, 28), 2))
        content = dynamics("SpeedActionDynamics", shape, dimension, round(value[dimension], 3))
        action = element("SpeedAction", content + element("SpeedActionTarget", target))
        return element("LongitudinalAction", action)

    def lane_action(self, name):
        chance = self.chance
        if chance.random() < 0.25:
            content = element("LaneOffsetActionDynamics", maxLateralAcc=0.5, dynamicsShape="sinusoidal")
            target = element("AbsoluteTargetLaneOffset", value=round(chance.uniform(-1, 1), 2))
            action = element("LaneOffsetAction", content + element("LaneOffsetTarget", target), continuous="false")
            return element("LateralAction", action)
        shape = chance.choice(["linear", "cubic", "sinusoidal"])
        dimension = chance.choice(["time", "distance", "rate"])
        value = {"time": chance.uniform(2, 6), "distance": chance.uniform(30, 90), "rate": chance.uniform(0.6, 2)}
        if chance.random() < 0.3:
            target = element("RelativeTargetLane", entityRef="Ego", value=chance.choice([-1, 0, 1]))
        else:
            target = element("AbsoluteTargetLane", value=self.side * chance.choice([1, 2, 3]))
        content = dynamics("LaneChangeActionDynamics", shape, dimension, round(value[dimension], 3))
        action = element("LaneChangeAction", content + element("LaneChangeTarget", target))
        return element("LateralAction", action)

    def start_conditions(self, name, maneuver):
        chance = self.chance
        kind = chance.choice(["time", "time", "speed", "travelled", "distance", "state", "state"])
        edge = chance.choice(["none", "none", "rising"])
        delay = chance.choice([0, 0, 0, 0.5])
        if kind == "state" and self.events:
            path, event = chance.choice(self.events)
            state = chance.choice(
                ["startTransition", "endTransition", "stopTransition", "completeState", "runningState"]
            )
            # The name of the group is needed: each group has maneuvers of the same names.
            reference = "::".join([*path, event][-chance.randint(3, 5) :])
            state = by_value(
                "StoryboardElementStateCondition",
                storyboardElementType="event",
                storyboardElementRef=reference,
                state=state,
            )
            conditions = [condition(state, delay=delay)]
            if chance.random() < 0.3:
                conditions.append(condition(at_time(round(chance.uniform(3, 8), 2))))
            return conditions
        if kind == "speed":
            rule = chance.choice(["lessThan", "greaterThan"])
            value = round(chance.uniform(12, 24), 2)
            content = by_entity(chance.choice(["Ego", "A", "B"]), "SpeedCondition", value=value, rule=rule)
            return [condition(content, edge=edge, delay=delay), condition(at_time(1))]
        if kind == "travelled":
            content = by_entity(name, "TraveledDistanceCondition", value=round(chance.uniform(30, 160), 2))
            return [condition(content, edge=edge, delay=delay)]
        if kind == "distance":
            other = chance.choice([other for other in ["Ego", "A", "B"] if other != name])
            content = by_entity(
                name,
                "RelativeDistanceCondition",
                entityRef=other,
                relativeDistanceType="longitudinal",
                coordinateSystem="road",
                value=round(chance.uniform(15, 60), 2),
                freespace=chance.choice(["true", "false"]),
                rule=chance.choice(["lessThan", "greaterThan"]),
            )
            return [condition(content, edge=edge, delay=delay), condition(at_time(0.5))]
        return [condition(at_time(round(chance.uniform(0.5, 9), 2)), edge=edge, delay=delay)]

    def event(self, name, maneuver, path, k):
        chance = self.chance
        action = self.speed_action() if chance.random() < 0.5 else self.lane_action(name)
        event = f"e{k}"
        start = trigger("StartTrigger", self.start_conditions(name, maneuver))
        self.events.append((path, event))
        private = element("Action", element("PrivateAction", action), name=f"a{k}")
        priority = chance.choice(["override", "override", "overwrite", "parallel", "skip"])
        count = chance.choice([1, 1, 1, 2])
        return element("Event", private + start, name=event, priority=priority, maximumExecutionCount=count)

    def story(self):
        chance = self.chance
        groups = []
        for name in ["A", "B"]:
            actors = element("Actors", element("EntityRef", entityRef=name), selectTriggeringEntities="false")
            count = chance.randint(*self.actions)
            split = chance.choice([count, count, 1])
            parts = [range(split), range(split, count)]
            maneuvers = ""
            for m, part in enumerate(parts):
                path = ["s", "act", f"g{name}", f"m{m}"]
                events = "".join(self.event(name, f"m{m}", path, k) for k in part)
                if events:
                    maneuvers += element("Maneuver", events, name=f"m{m}")
            groups.append(element("ManeuverGroup", actors + maneuvers, name=f"g{name}", maximumExecutionCount=1))
        start = trigger("StartTrigger", [condition(at_time(chance.choice([0, 0, 0.3])))])
        stop = ""
        if chance.random() < 0.15:
            stop = trigger("StopTrigger", [condition(at_time(round(chance.uniform(4, 9), 2)))])
        act = element("Act", "".join(groups) + start + stop, name="act")
        return element("Story", act, name="s")

    def entity(self, name, length):
        box = element("Center", x=round(length / 3, 3), y=0, z=0.7)
        box += element("Dimensions", width=WIDTH_M, length=length, height=1.5)
        axle = {"maxSteering": 0.5, "wheelDiameter": 0.6, "trackWidth": 1.6, "positionZ": 0.3}
        axles = element("FrontAxle", positionX=2.8, **axle) + element("RearAxle", positionX=0, **axle)
        limits = element("Performance", maxSpeed=70, maxAcceleration=25, maxDeceleration=25)
        content = element("BoundingBox", box) + limits + element("Axles", axles) + element("Properties")
        return element("ScenarioObject", element("Vehicle", content, name="car", vehicleCategory="car"), name=name)

    def private(self, name, lane, ahead, speed):
        place = element("LanePosition", roadId=1, laneId=lane, s=self.start + self.sign * ahead)
        teleport = element("PrivateAction", element("TeleportAction", element("Position", place)))
        target = element("SpeedActionTarget", element("AbsoluteTargetSpeed", value=speed))
        content = dynamics("SpeedActionDynamics", "step", "time", 0) + target
        action = element("PrivateAction", element("LongitudinalAction", element("SpeedAction", content)))
        return element("Private", teleport + action, entityRef=name)

    def write(self, folder):
        chance = self.chance
        speeds = [20, round(chance.uniform(14, 24), 2), round(chance.uniform(14, 24), 2)]
        lanes = [self.ego_lane] + [self.side * chance.choice([1, 2, 3]) for _ in range(2)]
        ahead = [0, round(chance.uniform(20, 45), 2), round(chance.uniform(60, 90), 2)]
        names = ["Ego", "A", "B"]
        entities = "".join(self.entity(name, 4 + 0.1 * k) for k, name in enumerate(names))
        init = "".join(self.private(*row) for row in zip(names, lanes, ahead, speeds))
        header = element("FileHeader", revMajor=1, revMinor=2, date="2026-01-01T00:00:00", description="", author="a")
        stop = trigger("StopTrigger", [condition(at_time(14, "greaterThan"))])
        storyboard = element("Init", element("Actions", init)) + self.story() + stop
        network = element("RoadNetwork", element("LogicFile", filepath="road.xodr"))
        text = header + element("ParameterDeclarations") + element("CatalogLocations") + network
        text += element("Entities", entities) + element("Storyboard", storyboard)
        path = folder / f"file-{self.number}.xosc"
        path.write_text('<?xml version="1.0" encoding="UTF-8"?>' + element("OpenSCENARIO", text))
        (folder / "road.xodr").write_text(road(self.left_hand))
        return path


class WideFile(File):
    """Writes a random file with further edges, delays and repetitions, also of maneuver groups."""

    def start_conditions(self, name, maneuver):
        chance = self.chance
        first, *rest = super().start_conditions(name, maneuver)
        if chance.random() < 0.35:
            edge = chance.choice(["rising", "falling", "risingOrFalling", "none"])
            # The end of a transition depends on the step.
            edge = "rising" if "Transition" in first else edge
            first = re.sub(r'conditionEdge="\w+"', f'conditionEdge="{edge}"', first, count=1)
        if chance.random() < 0.25:
            first = re.sub(r' delay="[^"]*"', f' delay="{chance.choice([0.2, 0.35, 1])}"', first, count=1)
        return [first, *rest]

    def repeat(self, tag, text, counts):
        """Returns a text whose elements of a tag have one of the counts of executions."""
        pattern = rf'(<{tag} [^>]*maximumExecutionCount=")\d+'
        return re.sub(pattern, lambda match: match[1] + str(self.chance.choice(counts)), text)

    def event(self, name, maneuver, path, k):
        text = super().event(name, maneuver, path, k)
        # The number of steps in which an event is skipped depends on the step.
        return self.repeat("Event", text, [1] if 'priority="skip"' in text else [1, 1, 2, 3])

    def story(self):
        text = super().story()
        return self.repeat("ManeuverGroup", text, [1, 2, 3]) if self.chance.random() < 0.4 else text


class LongFile(File):
    """Writes a random file with more actions, standstills, and lateral offsets without an end."""

    actions = (4, 6)

    def speed_action(self):
        chance = self.chance
        # A speed that is a function of the distance never leaves 0, and never reaches it.
        dimension, value = chance.choice([("time", chance.uniform(2, 5)), ("rate", chance.uniform(2, 5))])
        shape = chance.choice(["linear", "cubic", "sinusoidal"])
        target = element("AbsoluteTargetSpeed", value=chance.choice([0, round(chance.uniform(5, 25), 2)]))
        content = dynamics("SpeedActionDynamics", shape, dimension, round(value, 3))
        action = element("SpeedAction", content + element("SpeedActionTarget", target))
        return element("LongitudinalAction", action)

    def lane_action(self, name):
        action = super().lane_action(name)
        return action.replace('continuous="false"', f'continuous="{self.chance.choice(["true", "false"])}"')

    def start_conditions(self, name, maneuver):
        chance = self.chance
        if chance.random() < 0.8:
            return super().start_conditions(name, maneuver)
        content = by_entity(chance.choice(["A", "B"]), "StandStillCondition", duration=chance.choice([0, 0.5, 1.2]))
        return [condition(content, edge=chance.choice(["none", "rising"]), delay=chance.choice([0, 0.3]))]


class MixedFile(File):
    """Writes a random file with events of several actions, relative speeds, groups of two vehicles, several groups of
    conditions, and references to all kinds of elements."""

    def speed_action(self):
        chance = self.chance
        action = super().speed_action()
        if chance.random() < 0.7:
            return action
        kind, value = chance.choice([("factor", 1.1), ("factor", 0.8), ("delta", -3), ("delta", 0), ("delta", 2.5)])
        words = {"value": value, "speedTargetValueType": kind, "continuous": "false"}
        # A factor of a changing speed could exceed the limits of a vehicle.
        entity = "Ego" if kind == "factor" else chance.choice(["Ego", "A", "B"])
        target = element("RelativeTargetSpeed", entityRef=entity, **words)
        return re.sub("<AbsoluteTargetSpeed[^>]*/>", target, action)

    def lane_action(self, name):
        action = super().lane_action(name)
        if self.chance.random() < 0.6:
            return action
        offset = round(self.chance.uniform(-0.8, 0.8), 2)
        return action.replace("<LaneChangeAction>", f'<LaneChangeAction targetLaneOffset="{offset}">')

    def state_condition(self, delays):
        chance = self.chance
        path, event = chance.choice(self.events)
        depths = {"act": 2, "maneuverGroup": 3, "maneuver": 4, "event": 5, "action": 6}
        kind = chance.choice(list(depths))
        states = ["startTransition", "endTransition", "stopTransition", "completeState", "runningState"]
        if kind == "event":
            states += ["skipTransition", "standbyState"]
        state = by_value(
            "StoryboardElementStateCondition",
            storyboardElementType=kind,
            storyboardElementRef="::".join([*path, event, "a0"][: depths[kind]]),
            state=chance.choice(states),
        )
        return condition(state, delay=chance.choice(delays))

    def start_conditions(self, name, maneuver):
        chance = self.chance
        if not self.events or chance.random() < 0.65:
            return super().start_conditions(name, maneuver)
        conditions = [self.state_condition([0, 0, 0.3])]
        if chance.random() < 0.3:
            conditions.append(self.state_condition([0]))
        if chance.random() < 0.3:
            conditions.append(condition(at_time(round(chance.uniform(2, 8), 2))))
        return conditions

    def event(self, name, maneuver, path, k):
        chance = self.chance
        actions = [
            self.speed_action() if chance.random() < 0.5 else self.lane_action(name)
            for _ in range(chance.choice([1, 1, 2, 2, 3]))
        ]
        actions = [element("PrivateAction", action) for action in actions]
        actions = [element("Action", action, name=f"a{index}") for index, action in enumerate(actions)]
        groups = [self.start_conditions(name, maneuver) for _ in range(chance.choice([1, 1, 2]))]
        start = element("StartTrigger", "".join(element("ConditionGroup", "".join(group)) for group in groups))
        self.events.append((path, f"e{k}"))
        priority = chance.choice(["override", "override", "parallel", "skip"])
        return element("Event", "".join(actions) + start, name=f"e{k}", priority=priority, maximumExecutionCount=1)

    def story(self):
        text = super().story()
        if self.chance.random() < 0.7:
            return text
        both = '<EntityRef entityRef="A"/><EntityRef entityRef="B"/></Actors>'
        return text.replace('<EntityRef entityRef="A"/></Actors>', both, 1)


def road(left_hand):
    """Returns a straight road with three lanes on each side."""

    def lane(number):
        width = element("width", sOffset=0, a=3.5, b=0, c=0, d=0)
        return element("lane", width, id=number, type="driving", level="false")

    center = element("center", element("lane", id=0, type="none", level="false"))
    sides = element("left", lane(3) + lane(2) + lane(1)) + center
    sides += element("right", lane(-1) + lane(-2) + lane(-3))
    geometry = element("geometry", element("line"), s=0, x=0, y=0, hdg=0, length=3000)
    content = element("planView", geometry) + element("lanes", element("laneSection", sides, s=0))
    rule = "LHT" if left_hand else "RHT"
    header = element("header", revMajor=1, revMinor=6, name="r")
    return element("OpenDRIVE", header + element("road", content, name="r", length=3000, id=1, junction=-1, rule=rule))


class Script:
    """The motion of a vehicle of an imported scenario."""

    def __init__(self, vehicle):
        self.front, self.start = vehicle["position_m"], vehicle["speed_mps"]
        driver = vehicle["driver"]
        kind, values = (driver, {}) if isinstance(driver, str) else next(iter(driver.items()))
        if kind == "constant-speed":
            self.knots = [(0.0, self.start)]
        elif kind == "recorded":
            self.knots = list(zip(values["time_s"], values["speed_mps"]))
        else:
            final = values.get("final_speed_mps", 0.0)
            end = values["onset_s"] + (self.start - final) / values["rate_mps2"]
            self.knots = [(0.0, self.start), (values["onset_s"], self.start), (end, final)]

    def positions(self, times):
        """Returns the positions of the front bumper at increasing times: speeds are linear between knots."""
        found, k, place = [], 0, self.front
        for time in times:
            while k + 1 < len(self.knots) and self.knots[k + 1][0] <= time:
                (t0, v0), (t1, v1) = self.knots[k], self.knots[k + 1]
                place += 0.5 * (v0 + v1) * (t1 - t0)
                k += 1
            t0, v0 = self.knots[k]
            v = v0
            if k + 1 < len(self.knots):
                t1, v1 = self.knots[k + 1]
                v = v0 + (v1 - v0) * (time - t0) / (t1 - t0)
            found.append(place + 0.5 * (v0 + v) * (time - t0))
        return found


def stays(record, lane, width):
    """Returns the times during which a body is in the lane."""
    low, high = lane[0] - lane[1] / 2 - width / 2, lane[0] + lane[1] / 2 + width / 2
    found, inside = [], False
    for time, _, y, _ in record:
        now = low + 1e-6 < y < high - 1e-6
        if now and not inside:
            found.append([time, math.inf])
        if inside and not now:
            found[-1][1] = time
        inside = now
    return found


def imported(binary, path, folder):
    """Returns the vehicles of an import, or its error."""
    out = folder / f"out-{path.stem}"
    done = subprocess.run([binary, "--quiet", "import", path, "--out", out], capture_output=True, text=True)
    if done.returncode:
        return None, done.stderr.strip()
    (file,) = out.glob("*.toml")
    return tomllib.loads(file.read_text())["vehicles"], ""


def compare(path, vehicles, error, engine, end, record):
    """Returns the largest errors of positions and of times."""
    lane = engine.road.lanes[engine.road.lane_at(engine.vehicles["Ego"].y)]
    # Contacts with the lane of less than two steps at the end or the start may be absent in one of both.
    expected = {}
    for name, vehicle in engine.vehicles.items():
        rows = [row for row in record[name] if row[0] < end]
        expected[vehicle.length] = (name, [s for s in stays(rows, lane, vehicle.width)])
    if error:
        absent = [name for name, found in expected.values() if not found]
        assert "never in the lane" in error and len(absent) == 2, f"{path}: {error}"
        return 0.0, 0.0
    worst_m = worst_s = 0.0
    for length, (name, found) in expected.items():
        own = [vehicle for vehicle in vehicles if abs(vehicle["length_m"] - length) < 1e-9]
        # A vehicle that stays beside the lane would enter it after the end.
        own = [vehicle for vehicle in own if vehicle.get("enters", {}).get("at_s", 0.0) < end]
        own.sort(key=lambda vehicle: vehicle.get("enters", {}).get("at_s", 0.0))
        times = [[v.get("enters", {}).get("at_s", 0.0), v.get("leaves", {}).get("at_s", math.inf)] for v in own]
        assert len(times) == len(found), f"{path}, {name}: {times}, not {found}"
        for pair, other in zip(times, found):
            for time, reference in zip(pair, other):
                if time != reference:
                    worst_s = max(worst_s, abs(time - reference))
        if own:
            vehicle = engine.vehicles[name]
            rows = record[name][::20]
            front = [vehicle.direction * x + vehicle.front for _, x, _, _ in rows]
            for x, reference, row in zip(Script(own[0]).positions([row[0] for row in rows]), front, rows):
                worst_m = max(worst_m, abs(x - reference))
    return worst_m, worst_s


def check(task):
    binary, number, folder = task
    folder.mkdir()
    kinds = {FIRST_MIXED: MixedFile, FIRST_LONG: LongFile, FIRST_WIDE: WideFile, 0: File}
    kind = next(kind for first, kind in kinds.items() if number >= first)
    path = kind(random.Random(number), number).write(folder)
    vehicles, error = imported(binary, path, folder)
    engine = Engine(path, folder / "road.xodr")
    end, record = engine.run()
    try:
        worst = compare(path, vehicles, error, engine, end, record)
    except AssertionError as problem:
        return number, math.inf, math.inf, str(problem)
    repeats = sum(int(count) - 1 for count in re.findall(r'maximumExecutionCount="(\d+)"', path.read_text()))
    allowed_s = STEP_S * (1 + repeats)
    # Each event of a chain begins up to one step of the interpreter late.
    allowed_m = CLOSE_M * {File: 1, MixedFile: 1, WideFile: 1 + repeats, LongFile: 2 + repeats}[kind]
    problem = "" if worst[0] <= allowed_m and worst[1] <= allowed_s else "differs"
    return number, *worst, problem


def main():
    binary, count = Path(sys.argv[1]) / "crumple", int(sys.argv[2])
    first = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    with tempfile.TemporaryDirectory() as name:
        numbers = list(range(first, first + count))
        for further in (FIRST_WIDE, FIRST_LONG, FIRST_MIXED):
            numbers += range(further + first, further + first + count // 4)
        tasks = [(binary, k, Path(name) / str(k)) for k in numbers]
        with ProcessPoolExecutor(os.cpu_count()) as pool:
            results = list(pool.map(check, tasks))
    wrong = [row for row in results if row[3]]
    for row in wrong[:20]:
        print("file {}: {} m, {} s {}".format(*row))
    assert not wrong, f"{len(wrong)} of {len(results)} random files differ"
    worst_m, worst_s = (max(row[k] for row in results) for k in (1, 2))
    errors = f"largest errors {worst_m:.4f} m and {worst_s:.4f} s"
    print(f"{len(results)} random files with two to six actions per vehicle: {errors}")


if __name__ == "__main__":
    main()
