"""A second simulator of the study, written from the pages of the documentation. Needs only Python 3.11.

Rules: docs/mathematics.md (controllers, the driver `human`, after a collision), docs/reference/vehicles.md (motion,
limits), docs/reference/scenarios.md (settings), ../emergencies.toml (distributions). It shares no code and no random
number with crumple. Vehicles observe the true state. Impacts are found at the end of a step, not inside it. Its
figures, chosen in questions.toml before it ran, are compared with those of a run of crumple, and those with
reports/aeb-behind/results.csv.
"""

import csv
import math
import random
import sys
import tempfile
import tomllib
from pathlib import Path
from statistics import NormalDist

from study import CONFIG, SPACE, Assessment

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parents[2] / "reports/aeb-behind/results.csv"
STEP_S, STEPS = 0.01, 2500
LENGTH_M = {"light": 2.0, "heavy": 15.0}
MASS_KG = {"light": 1500.0, "heavy": 15_000.0}
BRAKE_MPS2 = {"light": 7.5, "heavy": 6.0}
ACCEL_MPS2 = {"light": 3.0, "heavy": 1.5}
LEADER_BRAKE_MPS2 = 9.0
HELD_MPS2 = {"hold": -6.0, "coast": 0.0}


class Idm:
    """Intelligent Driver Model with the default settings of the documentation."""

    def __init__(self, time_gap_s=1.6, desired_mps=120 / 3.6):
        self.time_gap_s, self.desired_mps = time_gap_s, desired_mps

    def decide(self, gap, speed, ahead, _):
        wish = 2.0 + max(0.0, speed * self.time_gap_s + speed * (speed - ahead) / (2 * math.sqrt(0.73 * 1.67)))
        return 0.73 * (1 - (speed / self.desired_mps) ** 4 - (wish / max(gap, 0.01)) ** 2)


class Baseline:
    """Coasts until the time to collision is below 1.4 s, then brakes fully to standstill."""

    def __init__(self):
        self.is_braking = False

    def decide(self, gap, speed, ahead, _):
        self.is_braking |= gap < 1.4 * (speed - ahead)
        return -math.inf if self.is_braking else 0.0


class AccAeb:
    """Cruise control with a time gap, and full braking while the time to collision is below 1.4 s."""

    def decide(self, gap, speed, ahead, _):
        if gap < 1.4 * (speed - ahead):
            return -math.inf
        follow = 0.25 * (gap - 2.0 - 0.8 * speed) + 0.8 * (ahead - speed)
        most = max(0.0, 0.8 * (ahead + 2.0 - speed))
        return min(max(min(follow, most), -3.5), 2.0)


class Brake:
    """Holds its speed; brakes below a time to collision until it no longer closes in."""

    def __init__(self, ttc_s, brake_mps2=7.5):
        self.ttc_s, self.brake_mps2, self.is_braking = ttc_s, brake_mps2, False

    def decide(self, gap, speed, ahead, _):
        closing = speed - ahead
        if self.ttc_s > 0:
            self.is_braking = gap < self.ttc_s * closing or (self.is_braking and closing > 0)
        return -self.brake_mps2 if self.is_braking else 0.0


class Human:
    """The driver `human` with its default settings, and an optional brake."""

    def __init__(self, chance, aeb_ttc_s=0.0):
        self.chance = chance
        self.factor = math.exp(0.42 * chance.gauss(0, 1) - 0.42 ** 2 / 2)
        self.level_mps2 = min(max(chance.gauss(5.0, 1.2), 2.0), 9.1)
        self.brake = Brake(aeb_ttc_s)
        self.model = None
        self.wait_steps = None
        self.glance_steps = 0
        self.held_mps2 = 0.0

    def looks(self):
        if self.glance_steps > 0:
            self.glance_steps -= 1
            return False
        if self.wait_steps is None and self.chance.random() < 0.1 * STEP_S:
            self.glance_steps = round(0.8 * math.exp(0.5 * self.chance.gauss(0, 1)) / STEP_S)
        return True

    def decide(self, gap, speed, ahead, ahead_mps2):
        if self.model is None:
            keeps_s = min(max((gap - 2.0) / speed, 0.3), 1.6)
            self.model = Idm(keeps_s, max(120 / 3.6, speed))
        emergency = self.brake.decide(gap, speed, ahead, ahead_mps2)
        if self.looks():
            closing = speed - ahead
            expansion = 1.8 * closing / (gap ** 2 + 0.9 ** 2)
            lights = ahead_mps2 <= -1.0
            if lights or expansion > 0.003 or (self.wait_steps is not None and closing > 0):
                if self.wait_steps is None:
                    self.wait_steps = round((1.25 if lights else 1.5) * self.factor / STEP_S)
                else:
                    self.wait_steps = max(self.wait_steps - 1, 0)
            else:
                self.wait_steps = None
            seen = ahead if abs(expansion) > 0.003 else speed
            most = self.level_mps2 if self.wait_steps == 0 else 0.5
            self.held_mps2 = max(self.model.decide(gap, speed, seen, 0.0), -most)
        return min(self.held_mps2, emergency) if emergency < 0 else self.held_mps2


def controller(name, chance):
    """Returns a controller from its text on the command line."""
    kind, *settings = name.split(",")
    value = float(settings[0].split("=")[1]) if settings else None
    if kind == "emergency-brake":
        return Brake(1.4 if value is None else value)
    if kind == "human":
        return Human(chance, value or 0.0)
    return {"idm": Idm, "baseline": Baseline, "acc-aeb": AccAeb}[kind]()


def truncated_normal(chance, mean, deviation, low, high):
    while not low <= (value := chance.gauss(mean, deviation)) <= high:
        pass
    return value


def from_histogram(chance, distribution):
    edges, weights = distribution["edges"], distribution["weights"]
    place = chance.choices(range(len(weights)), weights)[0]
    return chance.uniform(edges[place], edges[place + 1])


class Emergency:
    """One emergency: three vehicles, of which the first follows a script."""

    def __init__(self, chance, kind, figure, gaps):
        speed = chance.uniform(10.0, 33.0)
        ahead_s, behind_s = (from_histogram(chance, one) for one in gaps)
        friction = truncated_normal(chance, 1.0, 0.2, 0.4, 1.0)
        self.onset_s = chance.uniform(1.0, 4.0)
        self.lead_mps2 = truncated_normal(chance, 0.5, 0.2, 0.2, 1.0) * LEADER_BRAKE_MPS2 * friction
        classes = ["light", "light", kind]
        self.length = [LENGTH_M[one] for one in classes]
        self.mass = [MASS_KG[one] for one in classes]
        self.accel = [ACCEL_MPS2[one] for one in classes]
        offset = chance.uniform(-1.0, 0.0)
        self.brake = [math.inf, BRAKE_MPS2["light"] * friction, (BRAKE_MPS2[kind] + offset) * friction]
        second = -self.length[0] - ahead_s * speed
        self.place = [0.0, second, second - self.length[1] - behind_s * speed]
        self.speed = [speed] * 3
        self.last = [0.0] * 3
        self.drivers = [None, controller(figure["controller"], chance), controller(figure["follower"], chance)]
        self.held_mps2 = HELD_MPS2[figure["after_collision"]]
        self.has_hit = [False] * 3
        self.is_pushed = False

    def gap(self, rear):
        return self.place[rear - 1] - self.length[rear - 1] - self.place[rear]

    def command(self, index):
        ahead = index - 1
        answer = self.drivers[index].decide(self.gap(index), self.speed[index], self.speed[ahead], self.last[ahead])
        if self.has_hit[index]:
            answer = self.held_mps2
        return min(max(answer, -self.brake[index]), self.accel[index])

    def groups(self):
        """Returns the vehicles that move together, front to rear."""
        bodies = [[0]]
        for index in (1, 2):
            if self.has_hit[index]:
                bodies[-1].append(index)
            else:
                bodies.append([index])
        return bodies

    def move(self, index, accel):
        speed = self.speed[index]
        if accel < 0 and speed + accel * STEP_S < 0:
            self.place[index] += speed ** 2 / (-2 * accel)
            self.speed[index] = 0.0
        else:
            self.place[index] += speed * STEP_S + 0.5 * accel * STEP_S ** 2
            self.speed[index] = speed + accel * STEP_S

    def step(self, number):
        time = number * STEP_S
        braked_s = min(max(time + STEP_S - self.onset_s, 0.0), STEP_S)
        accel = [-self.lead_mps2 * braked_s / STEP_S, self.command(1), self.command(2)]
        for body in self.groups():
            mean = sum(self.mass[index] * accel[index] for index in body) / sum(self.mass[index] for index in body)
            if self.speed[body[0]] == 0.0 and len(body) > 1:
                mean = max(mean, 0.0)
            for index in body:
                accel[index] = mean
                self.move(index, mean)
        self.last = accel
        for rear in (1, 2):
            if not self.has_hit[rear] and self.gap(rear) <= 0:
                self.is_pushed |= rear == 1 and self.has_hit[2]
                self.has_hit[rear] = True
                body = next(one for one in self.groups() if rear in one)
                common = (sum(self.mass[index] * self.speed[index] for index in body)
                          / sum(self.mass[index] for index in body))
                for index in body:
                    self.speed[index] = common

    def run(self):
        """Returns whether the second vehicle hits the first without being pushed, and the third the second."""
        for number in range(STEPS):
            if all(self.has_hit[1:]) or number > 400 and not any(self.speed):
                break
            self.step(number)
        return {"ahead": self.has_hit[1] and not self.is_pushed, "behind": self.has_hit[2]}


def simulate(figure, seed, count, gaps):
    """Returns {measure: {class: share}} of `count` emergencies, half of them with a lorry behind."""
    totals = {measure: {"light": 0, "heavy": 0} for measure in ("ahead", "behind")}
    for kind in ("light", "heavy"):
        for number in range(count // 2):
            chance = random.Random(f"{seed} {figure['controller']} {figure['follower']} {kind} {number}")
            for measure, collides in Emergency(chance, kind, figure, gaps).run().items():
                totals[measure][kind] += collides
    return {measure: {kind: (total, count // 2) for kind, total in of.items()} for measure, of in totals.items()}


def runs_of_crumple(crumple, figures):
    """Runs crumple with the systems of the figures, and returns {motion after an impact: {system: Drives}}."""
    systems = list(dict.fromkeys(figure["controller"] for figure in figures))
    draws = tomllib.loads(CONFIG.read_text())["draws"]
    runs = {}
    with tempfile.TemporaryDirectory() as folder:
        for after_collision in HELD_MPS2:
            assessment = Assessment(after_collision, {"emergencies": SPACE.read_text()}, systems, draws,
                                    after_collision, "truth")
            assessment.run(crumple, Path(folder))
            runs[after_collision] = {system: drives for (_, system), drives in assessment.read(Path(folder)).items()}
    return runs


def count(drives, figure):
    """Returns {class: (collisions, emergencies)} of a figure."""
    counts = {}
    for kind in ("light", "heavy"):
        hits = [hit for hit, stratum in zip(getattr(drives, figure["measure"]), drives.strata)
                if stratum == (figure["follower"], kind)]
        counts[kind] = (int(sum(hits)), len(hits))
    return counts


def committed(figure):
    """Returns {class: (collisions, emergencies)} of the results that the page has."""
    column = {"ahead": "hits_ahead", "behind": "hit_from_behind"}[figure["measure"]]
    with open(RESULTS, newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = {"space": "emergencies", "estimator": "truth", "system": figure["controller"],
              "follower": figure["follower"], "after_collision": figure["after_collision"]}
    rows = [row for row in rows if all(row[name] == value for name, value in wanted.items())]
    return {row["class"]: (int(row[column]), int(row["emergencies"])) for row in rows}


def mean(counts):
    """Returns the mean share of both classes, and its variance."""
    shares = [(hits / count, count) for hits, count in counts.values()]
    return sum(share for share, _ in shares) / 2, sum(
        max(share * (1 - share), 1 / count) / count for share, count in shares) / 4


def compare_with_page(figure, counts):
    """Refuses figures of crumple that the page does not have."""
    if counts != committed(figure):
        sys.exit(f"error: crumple's collisions of {figure} are {counts}, those of {RESULTS.name} {committed(figure)}")


def main(crumple, is_written):
    """Runs crumple and the second simulator, and compares their figures.

    Writes them to `second.csv` if `is_written`; otherwise they must be those of that file.
    """
    config = tomllib.loads((HERE / "questions.toml").read_text())["second"]
    space = tomllib.loads(SPACE.read_text())
    gaps = [one["distribution"]["histogram"] for one in space["parameters"] if one["name"].startswith("time_gap")]
    quantile = NormalDist().inv_cdf(0.5 + config["confidence"] / 2)
    lines = ["controller,follower,after_collision,measure,crumple_percent,second_percent,difference,interval"]
    runs, known, outside = runs_of_crumple(crumple, config["figures"]), {}, 0
    for figure in config["figures"]:
        key = figure["controller"], figure["follower"], figure["after_collision"]
        if key not in known:
            known[key] = simulate(figure, config["seed"], config["emergencies"], gaps)
        counts = count(runs[key[2]][key[0]], figure)
        compare_with_page(figure, counts)
        (own, own_variance), (theirs, their_variance) = mean(known[key][figure["measure"]]), mean(counts)
        limit = quantile * math.sqrt(own_variance + their_variance)
        outside += abs(own - theirs) > limit
        lines.append(",".join([f'"{key[0]}"', *key[1:], figure["measure"], *(
            f"{100 * value:.1f}" for value in (theirs, own, own - theirs, limit))]))
        print(lines[-1], flush=True)
    path = RESULTS.with_name("second.csv")
    text = "\n".join(lines) + "\n"
    if is_written:
        path.write_text(text)
    elif path.read_text() != text:
        sys.exit(f"error: {path} differs")
    if outside:
        sys.exit(f"error: {outside} of {len(config['figures'])} figures differ by more than their interval")
    print(f"All {len(config['figures'])} figures of crumple and of the second simulator agree.")
