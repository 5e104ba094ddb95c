"""A small interpreter of OpenSCENARIO, written from the clauses of the standard (ASAM OpenSCENARIO XML 1.3.1) alone.

The interpreter knows straight roads, speed actions, lane changes, lane offsets and trajectories. It steps through time
in steps of half a millisecond; crumple computes the times of crossings. `openscenario_motion.py` compares both.
"""

import math
import xml.etree.ElementTree as ElementTree

STEP_S = 0.0005
SHAPES = {
    "linear": lambda x: x,
    "cubic": lambda x: x * x * (3 - 2 * x),
    "sinusoidal": lambda x: 0.5 * (1 - math.cos(math.pi * x)),
    "step": lambda x: 1.0,
}
# Largest slope of a shape, relative to its mean: a rate states it (class TransitionDynamics).
SLOPES = {"linear": 1.0, "cubic": 1.5, "sinusoidal": math.pi / 2}


class Road:
    """Lanes of a straight road along x from x = 0."""

    def __init__(self, path):
        road = ElementTree.parse(path).getroot().find("road")
        self.right_hand = road.get("rule") != "LHT"
        self.lanes = {}
        for side, sign in (("left", 1), ("right", -1)):
            edge = 0.0
            for lane in sorted(road.iterfind(f".//{side}/lane"), key=lambda lane: abs(int(lane.get("id")))):
                width = float(lane.find("width").get("a"))
                self.lanes[int(lane.get("id"))] = (sign * (edge + width / 2), width)
                edge += width

    def direction(self, lane):
        """Returns 1 for lanes in the direction of the road, otherwise -1 (OpenDRIVE, attribute `rule`)."""
        return 1 if (lane < 0) == self.right_hand else -1

    def lane_at(self, y):
        return min(self.lanes, key=lambda lane: abs(y - self.lanes[lane][0]) - self.lanes[lane][1] / 2)

    def left_of(self, lane, by, direction):
        """Class RelativeTargetLane: lanes count along the y axis of the reference entity. There is no lane 0."""
        target = lane + by * direction
        return target + (by * direction > 0) - (by * direction < 0) if target == 0 or target * lane < 0 else target


class Vehicle:
    """The motion of an entity: one longitudinal and one lateral control strategy (7.5.1)."""

    def __init__(self, length, width, front):
        self.length, self.width, self.front = length, width, front
        self.x = self.y = self.v = self.travelled = 0.0
        self.direction = 1
        self.longitudinal = self.lateral = None

    def advance(self, now):
        """Moves to the time `now`. Without a strategy, the vehicle keeps its speed and its offset (7.4.1)."""
        before = self.v
        way = None
        if self.longitudinal:
            if hasattr(self.longitudinal, "place"):
                place, self.v = self.longitudinal.place(now)
                way = place - self.travelled
            else:
                self.v = self.longitudinal.speed(now, self.travelled + before * STEP_S)
        way = 0.5 * (before + self.v) * STEP_S if way is None else way
        self.travelled += way
        self.x += self.direction * way
        if self.lateral:
            self.y = self.lateral.position(now, self.travelled)


class Change:
    """A change of a value over time or distance (class TransitionDynamics)."""

    def __init__(self, now, travelled, start, target, shape, dimension, value):
        self.start_s, self.start_m, self.start, self.target, self.shape = now, travelled, start, target, shape
        self.over_distance = dimension == "distance" and shape != "step"
        if shape == "step" or abs(start - target) < 1e-6:
            self.extent, self.over_distance = 0.0, False
        elif dimension == "rate":
            self.extent = SLOPES[shape] * abs(target - start) / value
        else:
            self.extent = value

    def share(self, now, travelled):
        passed = travelled - self.start_m if self.over_distance else now - self.start_s
        return 1.0 if passed >= self.extent - 1e-9 else max(0.0, passed / self.extent)

    def value(self, now, travelled):
        return self.start + (self.target - self.start) * SHAPES[self.shape](self.share(now, travelled))

    speed = position = value

    # Class LaneOffsetAction: with `continuous`, the action keeps the offset without an end.
    is_endless = False

    def done(self, now, travelled):
        return not self.is_endless and self.share(now, travelled) >= 1.0


class Track:
    """The part of a trajectory in one direction: straight between its vertices."""

    def __init__(self, times, values):
        self.times, self.values = times, values

    def at(self, now):
        k = 0
        while k + 2 < len(self.times) and self.times[k + 1] <= now:
            k += 1
        slope = (self.values[k + 1] - self.values[k]) / (self.times[k + 1] - self.times[k])
        share = min(now, self.times[-1]) - self.times[k]
        return self.values[k] + slope * share, slope

    def place(self, now):
        return self.at(now)

    def position(self, now, _):
        return self.at(now)[0]

    def done(self, now, _):
        return now >= self.times[-1] - 1e-9


class Element:
    """An element of the storyboard with its state and the transitions of this and the last step (8.1)."""

    def __init__(self, node, parent, engine):
        self.node, self.parent, self.engine = node, parent, engine
        self.kind = {"ManeuverGroup": "maneuverGroup"}.get(node.tag, node.tag.lower())
        self.name = node.get("name", "")
        self.state, self.count, self.transitions = "init", 0, []
        self.most = int(node.get("maximumExecutionCount", 1))
        inside = {"Story": "Act", "Act": "ManeuverGroup", "ManeuverGroup": "Maneuver", "Maneuver": "Event"}
        tag = inside.get(node.tag, "Action" if node.tag == "Event" else None)
        self.children = [Element(child, self, engine) for child in node if child.tag == tag]
        engine.elements.append(self)
        triggers = {}
        for name in ("StartTrigger", "StopTrigger"):
            trigger = node.find(name)
            triggers[name] = Trigger(trigger, engine) if trigger is not None and len(trigger) else None
        self.start_trigger, self.stop_trigger = triggers["StartTrigger"], triggers["StopTrigger"]

    def path(self):
        return ([] if self.parent is None else self.parent.path()) + [self.name]

    def note(self, transition, state):
        self.transitions.append((len(self.engine.log), transition))
        self.engine.log.append((self.engine.now, "::".join(self.path()), transition))
        self.state = state

    def begin(self):
        """8.3: parts with a start trigger wait, the others start."""
        self.note("startTransition", "runningState")
        self.count += 1
        for child in self.children:
            if child.kind == "event" or child.start_trigger:
                child.state = "standbyState"
            else:
                child.begin()
        self.check_children()

    def check_children(self):
        if self.state == "runningState" and all(child.state == "completeState" for child in self.children):
            self.end()

    def end(self):
        """8.4.2.1: an event or a maneuver group waits for its next execution, if there is one."""
        again = self.kind in ("event", "maneuverGroup") and self.count < self.most
        self.note("endTransition", "standbyState" if again else "completeState")
        if again:
            for child in self.children:
                child.reset()
            if self.start_trigger:
                self.start_trigger.reset()
        elif self.parent:
            self.parent.check_children()

    def reset(self):
        self.state, self.count = "init", 0
        for trigger in (self.start_trigger, self.stop_trigger):
            if trigger:
                trigger.reset()
        for child in self.children:
            child.reset()

    def stop(self, propagate=True):
        for child in self.children:
            child.stop(False)
        if self.state in ("standbyState", "runningState"):
            if self.kind == "action":
                self.engine.release(self)
            self.note("stopTransition", "completeState")
        if propagate and self.parent:
            self.parent.check_children()

    def trigger_event(self):
        """8.4.2.2: priorities."""
        running = [e for e in self.parent.children if e is not self and e.state == "runningState"]
        priority = self.node.get("priority", "parallel")
        self.count += 1
        if priority == "skip" and running:
            self.note("skipTransition", "completeState" if self.count >= self.most else "standbyState")
            self.parent.check_children()
            return
        self.note("startTransition", "runningState")
        if priority in ("override", "overwrite"):
            for event in running:
                event.stop()
        for action in self.children:
            action.note("startTransition", "runningState")
            self.engine.begin_action(action)
        for action in self.children:
            if action.state == "runningState" and not self.engine.runs(action):
                action.end()
        self.check_children()


class Trigger:
    """7.6: a trigger is true if all conditions of one group are true."""

    def __init__(self, node, engine):
        self.groups = [[Condition(condition, engine) for condition in group] for group in node]

    def reset(self):
        for group in self.groups:
            for condition in group:
                condition.reset()

    def fires(self):
        # Each condition is evaluated, so that it knows its last value.
        return any([all([condition.fires() for condition in group]) for group in self.groups])


class Condition:
    """7.6.1 to 7.6.3: edges and delays."""

    def __init__(self, node, engine):
        self.node, self.engine = node, engine
        self.edge, self.delay = node.get("conditionEdge"), float(node.get("delay", 0))
        self.inner = next(e for e in node.iter() if e.tag.endswith("Condition") and e.tag not in self.FRAMES)
        self.reset()

    FRAMES = ("Condition", "ByValueCondition", "ByEntityCondition", "EntityCondition")

    def reset(self):
        self.last, self.due, self.seen = None, [], None

    def fires(self):
        value = self.holds()
        edge = self.edge
        rises = value and self.last is False
        falls = not value and self.last is True
        now = {"none": value, "rising": rises, "falling": falls, "risingOrFalling": rises or falls}[edge]
        self.last = value
        if self.delay == 0:
            return now
        if now:
            self.due.append(self.engine.now + self.delay)
        fired = bool(self.due) and self.due[0] <= self.engine.now + 1e-9
        if fired:
            self.due.pop(0)
        return fired

    def holds(self):
        inner, engine = self.inner, self.engine
        if inner.tag == "SimulationTimeCondition":
            return compare(engine.now, inner.get("rule"), float(inner.get("value")))
        if inner.tag == "StoryboardElementStateCondition":
            return self.element_holds()
        names = [e.get("entityRef") for e in self.node.iter("EntityRef")]
        every = self.node.find(".//TriggeringEntities").get("triggeringEntitiesRule") == "all"
        results = [self.entity_holds(engine.vehicles[name]) for name in names]
        return all(results) if every else any(results)

    def element_holds(self):
        """8.1: a state lasts; a transition is visible in one step."""
        inner, engine = self.inner, self.engine
        parts = inner.get("storyboardElementRef").split("::")
        kind = inner.get("storyboardElementType")
        found = [e for e in engine.elements if e.kind == kind and e.path()[-len(parts) :] == parts]
        assert len(found) == 1, f"{len(found)} elements {parts}"
        state = inner.get("state")
        if state.endswith("State"):
            return found[0].state == state
        # The transitions since the last evaluation; for the first one, those of this step.
        since = engine.logged_before if self.seen is None else self.seen
        self.seen = len(engine.log)
        return any(serial >= since for serial, name in found[0].transitions if name == state)

    def entity_holds(self, vehicle):
        inner, engine = self.inner, self.engine
        other = engine.vehicles.get(inner.get("entityRef"))
        value = float(inner.get("value", "nan"))
        if inner.tag == "SpeedCondition":
            return compare(vehicle.v, inner.get("rule"), value)
        if inner.tag == "RelativeSpeedCondition":
            return compare(vehicle.v - other.v, inner.get("rule"), value)
        if inner.tag == "TraveledDistanceCondition":
            return vehicle.travelled >= value
        if inner.tag == "StandStillCondition":
            return vehicle.v == 0 and engine.now - vehicle.moved_s >= float(inner.get("duration"))
        ahead = vehicle.direction * (other.x - vehicle.x)
        free = inner.get("freespace") == "true"
        bodies = 0.0
        if free:
            front, rear = (other, vehicle) if ahead >= 0 else (vehicle, other)
            bodies = rear.front + front.length - front.front
        gap = max(abs(ahead) - bodies, 0.0) if free else abs(ahead)
        if inner.tag == "RelativeDistanceCondition":
            return compare(gap, inner.get("rule"), value)
        if inner.tag == "TimeHeadwayCondition":
            return compare(gap / vehicle.v if vehicle.v else math.inf, inner.get("rule"), value)
        raise ValueError(inner.tag)


def compare(value, rule, limit):
    """Class Rule."""
    # Times are sums of steps.
    if abs(value - limit) < 1e-9:
        return rule.endswith("OrEqual")
    return value > limit if rule.startswith("greater") else value < limit


DOMAINS = {
    "SpeedAction": {"long"},
    "LaneChangeAction": {"lat"},
    "LaneOffsetAction": {"lat"},
    "FollowTrajectoryAction": {"long", "lat"},
}


class Engine:
    """Runs a scenario, and records the motion and the transitions."""

    def __init__(self, scenario, road):
        self.road = Road(road)
        self.root = ElementTree.parse(scenario).getroot()
        self.elements, self.log, self.logged_before, self.now = [], [], 0, 0.0
        self.vehicles = {}
        for entity in self.root.iter("ScenarioObject"):
            box, center = entity.find(".//Dimensions"), entity.find(".//Center")
            length = float(box.get("length"))
            front = float(center.get("x")) + length / 2
            self.vehicles[entity.get("name")] = Vehicle(length, float(box.get("width")), front)
        for private in self.root.iter("Private"):
            self.place(self.vehicles[private.get("entityRef")], private)
        self.active = []
        self.stories = [Element(story, None, self) for story in self.root.iter("Story")]
        self.stop = Trigger(self.root.find("Storyboard/StopTrigger"), self)

    def place(self, vehicle, private):
        position = private.find(".//LanePosition")
        lane = int(position.get("laneId"))
        vehicle.x = float(position.get("s"))
        vehicle.y = self.road.lanes[lane][0] + float(position.get("offset", 0))
        vehicle.direction = self.road.direction(lane)
        vehicle.v = float(private.find(".//AbsoluteTargetSpeed").get("value"))
        vehicle.moved_s = 0.0

    def release(self, action, name=None):
        """A stopped action leaves the speed and the offset as they are (7.5.1); with a name, that of one actor."""
        released = [entry for entry in self.active if entry[0] is action and name in (None, entry[1])]
        for _, actor, strategy in released:
            vehicle = self.vehicles[actor]
            if vehicle.longitudinal is strategy or getattr(vehicle.longitudinal, "partner", 0) is strategy:
                vehicle.longitudinal = None
            if vehicle.lateral is strategy or getattr(strategy, "partner", 0) is vehicle.lateral:
                vehicle.lateral = None
        self.active = [entry for entry in self.active if entry not in released]

    def runs(self, action):
        return any(entry[0] is action for entry in self.active)

    def begin_action(self, action):
        """7.5.1: an action replaces those of the same domain of the same entity."""
        inner = next(e for e in action.node.iter() if e.tag in DOMAINS)
        group = action.parent.parent.parent.node
        for actor in [e.get("entityRef") for e in group.iterfind("Actors/EntityRef")]:
            for other, name, strategy in list(self.active):
                if name == actor and other is not action and strategy.domains & DOMAINS[inner.tag]:
                    other.stop()
            strategy = self.strategy(inner, self.vehicles[actor])
            strategy.domains = DOMAINS[inner.tag]
            self.active.append((action, actor, strategy))

    def strategy(self, inner, vehicle):
        if inner.tag == "SpeedAction":
            target = self.target_speed(inner.find("SpeedActionTarget")[0])
            vehicle.longitudinal = self.change(inner.find("SpeedActionDynamics"), vehicle, vehicle.v, target)
            return vehicle.longitudinal
        if inner.tag == "LaneChangeAction":
            target = inner.find("LaneChangeTarget")[0]
            lane = int(target.get("value"))
            if target.tag == "RelativeTargetLane":
                other = self.vehicles[target.get("entityRef")]
                lane = self.road.left_of(self.road.lane_at(other.y), lane, other.direction)
            y = self.road.lanes[lane][0] + vehicle.direction * float(inner.get("targetLaneOffset", 0))
            vehicle.lateral = self.change(inner.find("LaneChangeActionDynamics"), vehicle, vehicle.y, y)
            return vehicle.lateral
        if inner.tag == "LaneOffsetAction":
            dynamics = inner.find("LaneOffsetActionDynamics")
            middle = self.road.lanes[self.road.lane_at(vehicle.y)][0]
            y = middle + vehicle.direction * float(inner.find(".//AbsoluteTargetLaneOffset").get("value"))
            # Sinusoidal: the largest second derivative is pi^2 / 2 times the change by the square of the time.
            duration = math.pi * math.sqrt(abs(y - vehicle.y) / 2 / float(dynamics.get("maxLateralAcc")))
            vehicle.lateral = Change(self.now, 0, vehicle.y, y, "sinusoidal", "time", duration)
            vehicle.lateral.is_endless = inner.get("continuous") == "true"
            return vehicle.lateral
        vertices = list(inner.iter("Vertex"))
        times = [self.now + float(vertex.get("time")) for vertex in vertices]
        places = [vertex.find(".//LanePosition") for vertex in vertices]
        along = [vehicle.direction * float(place.get("s")) for place in places]
        start = vehicle.travelled - along[0]
        vehicle.longitudinal = Track(times, [start + value for value in along])
        vehicle.lateral = Track(times, [self.road.lanes[int(place.get("laneId"))][0] for place in places])
        vehicle.longitudinal.partner = vehicle.lateral
        return vehicle.longitudinal

    def target_speed(self, target):
        value = float(target.get("value"))
        if target.tag == "AbsoluteTargetSpeed":
            return value
        other = self.vehicles[target.get("entityRef")].v
        return other + value if target.get("speedTargetValueType") == "delta" else other * value

    def change(self, dynamics, vehicle, start, target):
        words = [dynamics.get(name) for name in ("dynamicsShape", "dynamicsDimension")]
        return Change(self.now, vehicle.travelled, start, target, *words, float(dynamics.get("value")))

    def run(self, longest_s=60.0):
        """Returns the time of the end, and lists of (time, x, y, v) of each vehicle."""
        record = {name: [] for name in self.vehicles}
        for story in self.stories:
            story.begin()
        while self.now < longest_s:
            for action, actor, strategy in list(self.active):
                vehicle = self.vehicles[actor]
                if action.state == "runningState" and strategy.done(self.now, vehicle.travelled):
                    # The goal is reached exactly.
                    if isinstance(strategy, Change) and strategy is vehicle.longitudinal:
                        vehicle.v = strategy.target
                    if isinstance(strategy, Change) and strategy is vehicle.lateral:
                        vehicle.y = strategy.target
                    self.release(action, actor)
                    if not self.runs(action):
                        action.end()
            acts = [element for element in self.elements if element.kind == "act"]
            for act in acts:
                if act.state == "runningState" and act.stop_trigger and act.stop_trigger.fires():
                    act.stop()
            for act in acts:
                if act.state == "standbyState" and act.start_trigger.fires():
                    act.begin()
            for group in self.elements:
                if group.kind == "maneuverGroup" and group.state == "standbyState":
                    group.begin()
            events = [e for e in self.elements if e.kind == "event" and e.state == "standbyState"]
            firing = [e for e in events if e.start_trigger is None or e.start_trigger.fires()]
            for event in firing:
                if event.state == "standbyState":
                    event.trigger_event()
            for name, vehicle in self.vehicles.items():
                record[name].append((self.now, vehicle.x, vehicle.y, vehicle.v))
            if self.stop.fires():
                return self.now, record
            self.logged_before = len(self.log)
            self.now = round(self.now + STEP_S, 9)
            for vehicle in self.vehicles.values():
                vehicle.advance(self.now)
                if vehicle.v != 0:
                    vehicle.moved_s = self.now
        raise ValueError("no stop")
