#!/usr/bin/env python3
"""Recomputes the figures of the study of rear-end collisions from its raw runs. Needs only Python 3.9.

    aeb_behind.py REPORT                     compares REPORT/runs.csv with REPORT/assessment.json, and prints the tables
    aeb_behind.py REPORT PAGE [--write]      also compares the tables, pictures and figures of the text of PAGE, or
                                             writes the tables and pictures
    aeb_behind.py sensitivity CRUMPLE FOLDER [PAGE [--write]]
                                             runs the study in FOLDER with one assumption changed at a time
    aeb_behind.py mildest CRUMPLE [PAGE]     prints the mildest brakes that pass the modelled lead-vehicle tests
"""

import csv
import functools
import json
import math
import random
import re
import subprocess
import sys
from collections import defaultdict
from operator import itemgetter
from pathlib import Path

HERE = Path(__file__).parent
REFERENCE, COASTING = "emergency-brake,ttc_s=0.001", "emergency-brake,ttc_s=0"
BRAKE, EARLY, SOFT = "emergency-brake", "emergency-brake,ttc_s=3", "emergency-brake,ttc_s=3,brake_mps2=3.5"
HUMAN, ASSISTED, ASSISTED_EARLY = "human", "human,aeb_ttc_s=1.4", "human,aeb_ttc_s=3"
# Controllers of the pictures, and of the tables by follower and by activation.
SHOWN = [REFERENCE, COASTING, "emergency-brake,ttc_s=0.8", BRAKE, "emergency-brake,ttc_s=2", EARLY, SOFT,
         "emergency-brake,ttc_s=4,brake_mps2=5.25", "autoware-aeb", "openpilot", "acc-aeb", HUMAN, ASSISTED,
         ASSISTED_EARLY, "predictive", "road"]
NAMES = {
    REFERENCE: "no brake, brakes after impact",
    COASTING: "no brake, coasts after impact",
    "autoware-aeb": "`autoware-aeb`",
    "openpilot": "`openpilot`",
    "acc-aeb": "`acc-aeb`",
    HUMAN: "human",
    ASSISTED: "human + brake 1.4 s, 7.5 m/s²",
    ASSISTED_EARLY: "human + brake 3 s, 7.5 m/s²",
    "predictive": "`predictive`",
    "road": "`road`",
}
FOLLOWERS = ["human", "baseline", "acc-aeb", "idm"]
CHANGED = "hit from behind, change per 100", "seriously injured, change per 1000"
CLASSES = {"light": "car", "heavy": "lorry"}
MPH = 0.44704
UPPER_SPEED_MPS = 62 * MPH
RESAMPLES = 1000


def label(name):
    """Returns the name of a controller in plain words."""
    settings = dict(part.split("=") for part in name.split(",")[1:])
    return NAMES.get(name) or f"brake {settings.get('ttc_s', '1.4')} s, {settings.get('brake_mps2', '7.5')} m/s²"


def binomial_cdf(k, n, p):
    """Returns P(X <= k)."""
    if p <= 0 or k >= n:
        return 1.0
    if p >= 1:
        return 0.0
    logs = math.lgamma(n + 1)
    return min(1.0, sum(
        math.exp(logs - math.lgamma(i + 1) - math.lgamma(n - i + 1) + i * math.log(p) + (n - i) * math.log1p(-p))
        for i in range(k + 1)))


@functools.lru_cache(maxsize=None)
def clopper_pearson(k, n, tail=0.025):
    """Returns the exact 95 % interval of a share, by bisection."""
    if n == 0:
        return 0.0, 1.0

    def solve(is_above):
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (low, middle) if is_above(middle) else (middle, high)
        return (low + high) / 2

    lower = 0.0 if k == 0 else solve(lambda p: 1 - binomial_cdf(k - 1, n, p) > tail)
    upper = 1.0 if k == n else solve(lambda p: binomial_cdf(k, n, p) < tail)
    return lower, upper


@functools.lru_cache(maxsize=None)
def resamples(n):
    """Returns the samples of the bootstrap as functions that pick n of n values."""
    generator, places = random.Random(0), list(range(n))
    if n < 2:
        return [tuple] * RESAMPLES
    return [itemgetter(*generator.choices(places, k=n)) for _ in range(RESAMPLES)]


def bootstrap(values):
    """Returns the mean and the percentile interval at 95 %."""
    n = len(values)
    means = sorted(sum(pick(values)) / n for pick in resamples(n))
    return sum(values) / n, means[round(0.025 * RESAMPLES)], means[round(0.975 * RESAMPLES) - 1]


class Drives:
    """Results of one controller in the emergencies of one group."""

    def __init__(self, rows):
        self.count = len(rows)
        self.ahead = [bool(row["ahead_mps"]) for row in rows]
        self.behind = [bool(row["behind_mps"]) for row in rows]
        self.active = [row["activates"] == "1" for row in rows]
        self.speed = [float(row["speed_mps"]) for row in rows]
        self.harm = [float(row["harm"]) for row in rows]
        decided = [row["avoidable"] for row in rows if row["avoidable"]]
        self.avoidable = decided.count("yes"), decided.count("no"), len(decided)

    def only(self, side, before):
        """Returns the collisions on one side in these drives only, and in the drives `before` only."""
        pairs = list(zip(getattr(self, side), getattr(before, side)))
        return sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs)

    def during_activations(self, side, before):
        """Returns `only` for the drives with an activation."""
        pairs = list(zip(getattr(self, side), getattr(before, side), self.active))
        return sum(c and a and not b for a, b, c in pairs), sum(c and b and not a for a, b, c in pairs)

    def change(self, before, what, is_active=False):
        """Returns the change of collisions per 100, or of harm per 1000 emergencies, with its interval."""
        scale = 1000 if what == "harm" else 100
        pairs = zip(getattr(self, what), getattr(before, what), self.active)
        values = [scale * (own - other) for own, other, active in pairs if active or not is_active]
        if what == "harm" or any(values):
            return bootstrap(values)
        limit = scale * clopper_pearson(0, len(values))[1]
        return 0.0, -limit, limit


def read_groups(path):
    """Returns {group: {controller: Drives}} for each type and class of follower and each band of speed."""
    rows = defaultdict(lambda: defaultdict(list))
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            band = "up to 62 mph" if float(row["speed_mps"]) <= UPPER_SPEED_MPS else "above 62 mph"
            driver, kind = row["follower"].split()
            part = [] if driver == "baseline" else ["without baseline"]
            for group in ("all", row["follower"], driver, CLASSES[kind], band, *part):
                rows[group][row["controller"]].append(row)
    return {group: {name: Drives(of) for name, of in by_name.items()} for group, by_name in rows.items()}


def compare(groups, report):
    """Compares the counts with those of the assessment. Returns the number of compared figures."""
    compared = 0

    def equal(what, own, stated, tolerance=0.0):
        nonlocal compared
        compared += 1
        if abs(own - stated) > tolerance:
            sys.exit(f"error: {what}: {own} from the runs, and the report states {stated}")

    for stated in report["harm"]["groups"]:
        key = stated["follower"]
        reference = groups[key][REFERENCE]
        for own, theirs in zip(reference.avoidable, stated["avoidable"]):
            equal(f"{key} avoidable", own, theirs)
        for one in stated["controllers"]:
            own, what = groups[key][one["controller"]], f"{key} {one['controller']}"
            activations = sum(own.active)
            mean = sum(own.harm) / own.count
            error = 1.96 * math.sqrt(sum((value - mean) ** 2 for value in own.harm)) / own.count
            equal(what + " activations", activations, one["activations"])
            equal(what + " avoided", own.only("ahead", reference)[1], one["avoided"])
            equal(what + " caused", own.only("behind", reference)[0], one["caused"])
            equal(what + " harm", 1000 * mean, one["harm_per_1000"][0], 0.0006)
            equal(what + " error of harm", 1000 * error, one["harm_per_1000"][1], 0.0006)
            for field, count, of in [
                ("ahead_percent", sum(own.ahead), own.count),
                ("behind_percent", sum(own.behind), own.count),
                ("caused_per_100_activations", own.during_activations("behind", reference)[0], activations),
            ]:
                low, high = clopper_pearson(count, of)
                equal(f"{what} {field}", 100 * count / max(of, 1), one[field]["observed"], 0.006)
                equal(f"{what} {field}, lower", 100 * low, one[field]["lower"], 0.011)
                equal(f"{what} {field}, upper", 100 * high, one[field]["upper"], 0.011)
    return compared


def number(value, is_signed=False, digits=1):
    """Returns a value without a negative zero."""
    text = f"{value:+.{digits}f}" if is_signed else f"{value:.{digits}f}"
    return text.lstrip("+-") if float(text) == 0 else text.replace("-", "−")


def share(count, of):
    """Returns a percentage with its exact interval."""
    values = [100 * value for value in (count / max(of, 1), *clopper_pearson(count, of))]
    digits = 0 if 9.95 <= values[0] < 99.5 else 1
    mean, low, high = (number(value, digits=digits) for value in values)
    return f"{mean} ({low}…{high})"


def signed(values, digits=1):
    mean, low, high = (number(value, True, digits) for value in values)
    return f"{mean} ({low}…{high})"


def table(columns, rows):
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def arrow(before, after, what):
    """Returns the shares, or the harm, of two controllers."""
    if what == "harm":
        return " → ".join(number(1000 * sum(one.harm) / one.count) for one in (before, after))
    return " → ".join(number(100 * sum(getattr(one, what)) / one.count, digits=0) for one in (before, after))


def by_follower(groups):
    return [(f"`{name}`", groups[name]) for name in FOLLOWERS] + [("all four", groups["all"])]


def tables(groups, passing, rate):
    """Returns the tables of the page."""
    every = groups["all"]
    reference, coasting = every[REFERENCE], every[COASTING]
    harm = lambda name, before, one: (f"level {number(1000 * sum(one[name].harm) / one[name].count)}"
                                      if name == before else signed(one[name].change(one[before], "harm")))
    assisted = [
        (text, brake, arrow(one[HUMAN], one[name], "ahead"), arrow(one[HUMAN], one[name], "behind"),
         signed(one[name].change(one[HUMAN], "behind")),
         *(share(count, one[HUMAN].count) for count in one[name].only("behind", one[HUMAN])),
         arrow(one[HUMAN], one[name], "harm"), signed(one[name].change(one[HUMAN], "harm")))
        for text, one in by_follower(groups) for brake, name in (("1.4 s", ASSISTED), ("3 s", ASSISTED_EARLY))
    ]
    alone = [
        (text, brake, *(signed(one[name].change(one[before], what))
                        for what in ("behind", "harm") for before in (REFERENCE, COASTING)))
        for text, one in by_follower(groups) for brake, name in (("1.4 s", BRAKE), ("3 s", EARLY))
    ]
    injuries = [("all", REFERENCE), ("human", REFERENCE), ("baseline", REFERENCE), ("baseline", COASTING)]
    everything = [
        (label(name), passing.get(name, "–"), share(sum(one.ahead), one.count), share(sum(one.behind), one.count),
         share(sum(b and not a for a, b in zip(one.ahead, one.behind)), one.count),
         *(harm(name, before, groups[group]) for group, before in injuries))
        for name, one in every.items()
    ]
    activations = []
    for name in SHOWN[2:]:
        one = every[name]
        active = sum(one.active)
        caused = one.during_activations("behind", reference)[0]
        activations.append((label(name), active, share(one.during_activations("ahead", reference)[1], active),
                            share(caused, active),
                            signed(one.change(reference, "behind", True)),
                            signed(one.change(coasting, "behind", True)),
                            signed([value / 10 for value in one.change(reference, "harm", True)], 2)))
    subsets = [(f"`{driver}`, {word}", groups.get(f"{driver} {kind}")) for driver in FOLLOWERS
               for kind, word in CLASSES.items()]
    subsets += [(name, groups.get(name)) for name in ("car", "lorry", "up to 62 mph", "above 62 mph")]
    parts = [
        (name, one[HUMAN].count, *(signed(one[after].change(one[before], what))
         for before, after in ((HUMAN, ASSISTED), (REFERENCE, EARLY)) for what in ("behind", "harm")))
        for name, one in subsets if one
    ]
    hourly = [
        (f"{label(before)} → {label(after)}", *(signed([scale * rate * value for value in
                                                        every[after].change(every[before], what)])
                                                for what, scale in (("ahead", 10), ("behind", 10), ("harm", 1))))
        for before, after in ((HUMAN, ASSISTED), (REFERENCE, EARLY), (COASTING, EARLY))
    ]
    return {
        "assisted": table(["vehicle behind", "brake from", "hits vehicle ahead, %: human → human + brake",
                           "hit from behind, %: human → human + brake", f"{CHANGED[0]} against human",
                           "caused against human, %", "prevented against human, %", "seriously injured per 1000: "
                           "human → human + brake", f"{CHANGED[1]} against human"], assisted),
        "alone": table(["vehicle behind", "brake from", *(f"{what} against {label(before)}" for what in CHANGED
                                                          for before in (REFERENCE, COASTING))], alone),
        "all": table(["system", "passes modelled tests", "hits vehicle ahead, %", "hit from behind, %",
                      "only hit from behind, %", *(
                          f"seriously injured, {group} behind, change per 1000 against {label(before)}"
                          for group, before in injuries)], everything),
        "parts": table(["vehicle behind, or speed", "emergencies", *(
            f"{pair}: {what}" for pair in ("human + brake 1.4 s against human", f"brake 3 s against {label(REFERENCE)}")
            for what in CHANGED)], parts),
        "activations": table(["system", "activations", f"avoided ahead against {label(REFERENCE)}",
                              f"caused behind against {label(REFERENCE)}",
                              f"change behind against {label(REFERENCE)}", f"change behind against {label(COASTING)}",
                              f"change of seriously injured against {label(REFERENCE)}"], activations),
        "hours": table(["change", "hits ahead", "hit from behind", "seriously injured"], hourly),
    }


def statements(groups, passing):
    """Returns the sentences of the page that have figures of the runs."""
    every = groups["all"]
    of = lambda name, what, group="all": number(
        (1000 if what == "harm" else 100) * sum(getattr(groups[group][name], what)) / groups[group][name].count,
        digits=1 if what == "harm" else 0)
    change = lambda before, after, what, group="all": signed(groups[group][after].change(groups[group][before], what))
    fixed = [name for name in every if name.startswith(BRAKE) and name not in (REFERENCE, COASTING)]
    passed, failed = ([name for name in fixed if passing.get(name) == verdict] for verdict in ("yes", "no"))
    interval = lambda after, before, group: groups[group][after].change(groups[group][before], "harm")
    span = lambda names: " to ".join(
        number(end(interval(name, REFERENCE, "all")[0] for name in names), True) for end in (max, min))
    slowest, fastest = min(every[HUMAN].speed), max(every[HUMAN].speed)
    collides = all(all(every[name].ahead) for name in (REFERENCE, COASTING))
    fewest = all(sum(every["predictive"].ahead) < sum(one.ahead) and sum(every["predictive"].behind) < sum(one.behind)
                 for name, one in every.items() if name != "predictive")
    lorries = sum(one[HUMAN].count for name, one in groups.items() if name.endswith(" heavy"))
    escapes, _, examined = every[REFERENCE].avoidable
    early = [not a and b for a, b in zip(every[EARLY].ahead, every[EARLY].behind)]
    both = sum(hit and before for hit, before in zip(early, every[REFERENCE].behind))
    types = ", ".join(f"{groups[name][HUMAN].count} `{name}`" for name in FOLLOWERS)
    gain = lambda group, after=ASSISTED: change(HUMAN, after, "harm", group)
    behind = lambda group, before, *brakes: "/".join(change(before, one, "behind", group).split()[0] for one in brakes)
    alone = lambda group: f"{behind(group, REFERENCE, BRAKE, EARLY)} and {behind(group, COASTING, BRAKE, EARLY)}"
    lorry = groups["baseline heavy"]
    part = lambda group, after: number(
        1000 * (sum(group[after].harm) - sum(group[HUMAN].harm)) / every[HUMAN].count, True, 2)
    saves = all(interval(name, before, group)[2] < 0 for name in fixed for before in (REFERENCE, COASTING)
                for group in ("human", "acc-aeb", "idm"))
    adds = [sum(all(interval(name, before, "baseline")[1] > 0 for before in (REFERENCE, COASTING)) for name in names)
            for names in (passed, failed)]
    spares = sum(all(interval(name, before, "baseline")[2] < 0 for before in (REFERENCE, COASTING)) for name in fixed)
    if not (collides and fewest and saves):
        sys.exit("error: a statement of the page does not hold")
    return [
        f"each of the {len(fixed)} brakes evaluated saves injuries in front of `human`, `acc-aeb` and `idm`",
        f"{adds[0]} of the {len(passed)} that pass and {adds[1] or 'none'} of the {len(failed)} that fail add injuries "
        f"under both references (95 % interval above zero); {spares or 'none'} of the {len(fixed)} saves injuries "
        f"under both",
        f"change by {alone('human')} in front of `human`",
        *(f"by {alone(group)} in front of `{group}`" for group in ("baseline", "acc-aeb", "idm")),
        f"hits the vehicle ahead in {of(ASSISTED, 'ahead')} instead of {of(HUMAN, 'ahead')} % of the emergencies, and "
        f"is hit from behind in {of(ASSISTED, 'behind')} instead of {of(HUMAN, 'behind')} % "
        f"(change {change(HUMAN, ASSISTED, 'behind')} per 100)",
        f"The expected number of seriously injured drivers changes by {change(HUMAN, ASSISTED, 'harm')} per 1000",
        f"{gain('car')} per 1000 with a car behind and {gain('lorry')} with a lorry",
        f"{gain('up to 62 mph')} up to 62 mph and {gain('above 62 mph')} above",
        f"their {lorry[HUMAN].count} emergencies contribute {part(lorry, ASSISTED)} to the total of "
        f"{part(every, ASSISTED)} per 1000 (brake from 3 s: {part(lorry, ASSISTED_EARLY)} of "
        f"{part(every, ASSISTED_EARLY)})",
        f"by {gain('without baseline')} with the 1.4 s brake and by {gain('without baseline', ASSISTED_EARLY)} with",
        f"rise more with cars ({behind('car', HUMAN, ASSISTED)} per 100) than with lorries "
        f"({behind('lorry', HUMAN, ASSISTED)})",
        f"from 1.4 s changes injuries by {gain('human')} per 1000 in this sample",
        f"From 3 s, it adds {change(HUMAN, ASSISTED_EARLY, 'behind')} collisions behind per 100, and injuries change "
        f"by {change(HUMAN, ASSISTED_EARLY, 'harm')} per 1000",
        f"Of the {len(fixed)} brakes without a driver evaluated, the {len(passed)} that pass change injuries by "
        f"{span(passed)} per 1000, the {len(failed)} that fail by {span(failed)}",
        f"`openpilot` fails, yet changes them by {change(REFERENCE, 'openpilot', 'harm')}",
        f"hit the vehicle ahead in {number(100 * sum(every['predictive'].ahead) / every[HUMAN].count)} and "
        f"{number(100 * sum(every['road'].ahead) / every[HUMAN].count)} % and are hit from behind in "
        f"{number(100 * sum(every['predictive'].behind) / every[HUMAN].count)} and "
        f"{number(100 * sum(every['road'].behind) / every[HUMAN].count)} %",
        f"`predictive` has the fewest of both among all {len(every)} systems",
        f"With human followers `road` and `predictive` do not differ distinguishably (injuries: "
        f"{change('predictive', 'road', 'harm', 'human')} per 1000)",
        f"In {escapes} of the first {examined} emergencies",
        f"at least {number(100 * clopper_pearson(escapes, examined)[0])} %",
        f"{every[HUMAN].count} emergencies ({types}; {lorries} of them lorries)",
        f"In {sum(early)} of {len(early)} emergencies brake 3 s, 7.5 m/s² avoids the vehicle ahead and is hit from "
        f"behind; in {both} of these the car without a brake, which brakes after its impact, is hit, too",
        f"Speeds are {3.6 * slowest:.0f} to {3.6 * fastest:.0f} km/h "
        f"({slowest / MPH:.0f} to {fastest / MPH:.0f} mph)",
        f"In {sum(every[REFERENCE].active)} of {len(early)} drives noise makes the first reference brake shortly "
        f"before its impact",
        f"`openpilot` has no activation in {every['openpilot'].active.count(False)} drives",
    ]


def check_page(page, made, sentences, is_written):
    """Compares the tables and the figures of the text with the page, or writes the tables."""
    text = page.read_text()
    for name, block in made.items():
        head = block.split("\n")[0]
        old = re.search(re.escape(head) + r"\n(?:\|.*\n)+", text)
        if old is None:
            sys.exit(f"error: {page} has no table `{name}` with the head {head}")
        if old[0] != block + "\n" and not is_written:
            rows = zip(old[0].splitlines(), block.splitlines())
            sys.exit(f"error: table `{name}` of {page} differs: " + str(next((a, b) for a, b in rows if a != b)))
        text = text.replace(old[0], block + "\n")
    if is_written:
        page.write_text(text)
    words = " ".join(text.split())
    missing = [sentence for sentence in sentences if " ".join(sentence.split()) not in words]
    if missing:
        sys.exit(f"error: {page} does not state:\n" + "\n".join(missing))
    cells = sum(block.count("|") - block.count("\n") for block in made.values())
    print(f"{len(made)} tables with {cells} cells and {len(sentences)} statements of the page agree with the runs.")


def draw(title, controllers, passing):
    """Returns the picture of the collisions ahead and behind, in percent of the emergencies, as SVG."""
    left, top, size = 70, 60, 480
    x = lambda value: left + size * value / 100
    y = lambda value: top + size * (1 - value / 100)
    count = controllers[REFERENCE].count
    widest = 100 * max(high - low for one in controllers.values() for side in (one.ahead, one.behind)
                       for low, high in [clopper_pearson(sum(side), one.count)]) / 2
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="860" height="610" viewBox="0 0 860 610" '
           'font-family="sans-serif" font-size="12">', '<rect width="860" height="610" fill="white"/>',
           f'<text x="{left}" y="24" font-size="16">{title}</text>',
           f'<text x="{left}" y="44" fill="#444">{count} simulated emergencies; 95 % intervals are at most '
           f'±{widest:.1f} percentage points</text>']
    for value in range(0, 101, 20):
        out.append(f'<path d="M{x(value):.1f} {top}V{top + size}M{left} {y(value):.1f}H{left + size}" stroke="#ddd"/>')
        out.append(f'<text x="{x(value):.1f}" y="{top + size + 18}" text-anchor="middle">{value} %</text>')
        out.append(f'<text x="{left - 8}" y="{y(value) + 4:.1f}" text-anchor="end">{value} %</text>')
    out.append(f'<text x="{left + size / 2}" y="{top + size + 42}" text-anchor="middle">'
               'Hit from behind (% of emergencies)</text>')
    out.append(f'<text transform="translate(18 {top + size / 2}) rotate(-90)" text-anchor="middle">'
               'Hits the vehicle ahead (% of emergencies)</text>')
    points = {name: (x(100 * sum(one.behind) / count), y(100 * sum(one.ahead) / count))
              for name, one in controllers.items() if name in SHOWN}
    taken, names, markers = list(points.values()), [], []
    angles = [math.radians(angle) for angle in range(0, 360, 30)]
    for number, name in enumerate(SHOWN, 1):
        px, py = points[name]
        places = [(px + far * math.cos(angle), py + far * math.sin(angle)) for far in (20, 28, 36, 46, 58)
                  for angle in angles]
        is_free = lambda place: (left + 12 < place[0] < left + size - 12 and top - 14 < place[1] < top + size - 12
                                 and all(math.dist(place, other) > 17 for other in taken))
        lx, ly = next(filter(is_free, places))
        taken.append((lx, ly))
        passes = passing.get(name) == "yes"
        color = "#0060a0" if passes else "#c04000"
        shape = (f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4"' if passes else
                 f'<rect x="{px - 3.5:.1f}" y="{py - 3.5:.1f}" width="7" height="7"')
        markers.append(f'<line x1="{px:.1f}" y1="{py:.1f}" x2="{lx:.1f}" y2="{ly:.1f}" stroke="#444"/>')
        names.append(shape + f' fill="none" stroke="{color}" stroke-width="1.6"/>')
        names.append(f'<circle cx="{lx:.1f}" cy="{ly:.1f}" r="8" fill="white"/>')
        names.append(f'<text x="{lx:.1f}" y="{ly + 4:.1f}" text-anchor="middle" fill="{color}">{number}</text>')
        text = label(name).replace("`", "")
        names.append(f'<text x="{left + size + 24}" y="{top + 42 + 20 * number}" fill="{color}">'
                     f'{number} {text}</text>')
    for line, color, text in ((0, "#0060a0", "blue circles pass, as modelled,"),
                              (1, "#c04000", "red squares fail the tests")):
        out.append(f'<text x="{left + size + 24}" y="{top + 10 + 16 * line}" fill="{color}">{text}</text>')
    return "\n".join([*out, *markers, *names, "</svg>\n"])


def suite_verdicts(report):
    """Returns whether each controller passes the lead-vehicle tests (clause S7.1) of the suite."""
    verdicts = {}
    for suite in report.get("suites", {}).get("suites", []):
        for test in suite["tests"]:
            if test["clause"] == "S7.1":
                for name, outcome in zip(suite["controllers"], test["outcomes"]):
                    passes = outcome["passed"] and verdicts.get(name, "yes") == "yes"
                    verdicts[name] = "yes" if passes else "no"
    return verdicts


def show(folder, page, is_written):
    report = json.loads((folder / "assessment.json").read_text())
    groups = read_groups(folder / "runs.csv")
    print(f"{compare(groups, report)} figures of the assessment agree with the runs.", flush=True)
    passing = suite_verdicts(report)
    made = tables(groups, passing, report["harm"]["emergencies_per_hour"])
    if page is None:
        print("\n\n".join(made.values()))
        return
    for group, follower in (("all", "all four types"), ("human", "human driver"),
                            ("baseline", "coasts until its emergency brake fires")):
        path = page.with_suffix("") / f"{group}.svg"
        drawn = draw(f"Vehicle behind: {follower}", groups[group], passing)
        if is_written:
            path.write_text(drawn)
        elif path.read_text() != drawn:
            sys.exit(f"error: {path} is not the picture of the runs")
    check_page(page, made, statements(groups, passing), is_written)


# Logarithmic means and deviations of 20 events of NGSIM, and of OpenACC with the short and the long setting.
RECORDED_GAPS = [(0.385, 0.408), (0.370, 0.415), (0.985, 0.222)]


def time_gaps(ln_mean, ln_deviation):
    return "ln_mean = 0.405, ln_deviation = 0.5", f"ln_mean = {ln_mean}, ln_deviation = {ln_deviation}"


# Assumption, and the replacements in the text of the space and of the list of controllers.
DRIVER = 'driver = "human"'
CHANGES = {
    "base case": [],
    "reaction 1.0 s": [(DRIVER, "driver.human = { reaction_s = 1.0, surprise_s = 1.0 }")],
    "reaction 2.0 s": [(DRIVER, "driver.human = { reaction_s = 2.0, surprise_s = 2.0 }")],
    "perception 0.001 rad/s": [(DRIVER, "driver.human = { looming_rad_per_s = 0.001 }")],
    "perception 0.04 rad/s": [(DRIVER, "driver.human = { looming_rad_per_s = 0.04 }")],
    "braking level 4.3 m/s²": [(DRIVER, "driver.human = { brake_mps2 = 4.3 }")],
    "braking level 6.9 m/s²": [(DRIVER, "driver.human = { brake_mps2 = 6.9 }")],
    "no glances": [(DRIVER, "driver.human = { glance_per_s = 0.0 }")],
    "0.3 glances per second": [(DRIVER, "driver.human = { glance_per_s = 0.3 }")],
    "glances of 1.5 s": [(DRIVER, "driver.human = { glance_s = 1.5 }")],
    "follower has an emergency brake": [(DRIVER, "driver.human = { aeb_ttc_s = 1.4 }")],
    "time gap behind 1.0 s": [('"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                               '"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.0')],
    "time gap behind 2.0 s": [('"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                               '"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.693')],
    "time gaps: 20 NGSIM events": [time_gaps(*RECORDED_GAPS[0])],
    "time gaps: OpenACC, short setting": [time_gaps(*RECORDED_GAPS[1])],
    "time gaps: OpenACC, long setting": [time_gaps(*RECORDED_GAPS[2])],
    "time gap ahead 1.0 s": [('"vehicles[1].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                              '"vehicles[1].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.0')],
    "followers are cars": [('values = ["light", "heavy"]', 'values = ["light"]')],
    "followers are lorries": [('values = ["light", "heavy"]', 'values = ["heavy"]'),
                              ('class = "light"\nposition_m = 0.0', 'class = "heavy"\nposition_m = 0.0')],
    "leader brakes less (mean share 0.35)": [("mean = 0.5, deviation = 0.2", "mean = 0.35, deviation = 0.2")],
    "leader brakes more (mean share 0.7)": [("mean = 0.5, deviation = 0.2", "mean = 0.7, deviation = 0.2")],
    "wet road (mean friction 0.6)": [("mean = 1.0, deviation = 0.2", "mean = 0.6, deviation = 0.2")],
}


def sensitivity_statements(cells):
    """Returns the sentences about the table, from its cells."""
    harm = {name: row[1] for name, row in cells.items()}
    low, *_, high = sorted((text.split()[0] for text in harm.values()), key=lambda text: float(text.replace("−", "-")))
    return [
        f"In a second sample, with human drivers behind only: {harm['follower has an emergency brake']} per 1000 if "
        f"they have the brake, too, {harm['base case']} if not",
        f"{harm['base case']} in the second, and {low} to {high} over the assumptions of the "
        f"[last table](#which-assumptions-matter-most) (reaction 2.0 s: {harm['reaction 2.0 s'].split()[0]})",
    ]


def sensitivity(crumple, folder, page, is_written):
    space = (HERE / "emergencies.toml").read_text()
    start = space.index('[[parameters]]\nname = "follower"\n')
    space = space[:start] + space[space.index("[[parameters]]", start + 5):]
    names = [REFERENCE, COASTING, EARLY, HUMAN, ASSISTED]

    def run(follower, index, changes):
        text = space
        for old, new in changes:
            if old not in text:
                sys.exit(f"error: `{old}` is not in the space")
            text = text.replace(old, new)
        one = folder / f"{follower}-{index:02}"
        one.mkdir(parents=True, exist_ok=True)
        (one / "space.toml").write_text(text.replace(DRIVER, f'driver = "{follower}"'))
        (one / "study.toml").write_text(
            f"version = 1\ncontrollers = {json.dumps(names)}\npaper = false\ndistributions = [\"space.toml\"]\n"
            "draws = 2000\neveryday_draws = 0\nsearch = { spaces = [] }\nrates = { runs = 0 }\ncertificates = []\n"
            "harm = { emergencies_per_hour = 0.1 }\n")
        subprocess.run([crumple, "assess", "study.toml", "--out", "report"], cwd=one, check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return read_groups(one / "report" / "runs.csv")["all"]

    rows = []
    for index, (assumption, changes) in enumerate(CHANGES.items()):
        human = run("human", index, changes)
        is_of_driver = any(old == DRIVER for old, _ in changes)
        coasting = None if is_of_driver else run("baseline", index, changes)
        pairs = [(before, after, what, drives)
                 for drives, wanted in ((human, ("behind", "harm")), (coasting, ("harm",)))
                 for before, after in ((HUMAN, ASSISTED), (REFERENCE, EARLY)) for what in wanted]
        cells = lambda pairs: [signed(drives[after].change(drives[before], what)) if drives else "–"
                               for before, after, what, drives in pairs]
        rows.append((assumption, *cells(pairs)))
        if index == 0:
            coasts = [(COASTING if before == REFERENCE else before, *rest) for before, *rest in pairs]
            last = (label(COASTING), *cells(coasts))
    compared = ["human + brake 1.4 s against human", "brake 3 s against no brake"]
    heads = [f"{pair}: {what}" for pair in compared for what in CHANGED]
    heads += [f"`baseline` behind, {pair}: {CHANGED[1]}" for pair in compared]
    made = table(["assumption", *heads], [*rows, last])
    if page:
        medians = [f"{math.exp(mean):.2f}" for mean, _ in RECORDED_GAPS]
        check_page(page, {"sensitivity": made}, [
            f"have medians of {medians[0]} and {medians[1]} s; OpenACC with the long setting has {medians[2]} s",
            *sensitivity_statements(dict((row[0], row[1:]) for row in [*rows, last])),
        ], is_written)
    else:
        print(made)


def mildest(crumple, page):
    found = []
    for threshold in (1.4, 1.6, 1.8, 2, 2.2, 2.4, 2.6, 2.8, 3, 3.5, 4):
        for braking in (4.75 + 0.25 * step for step in range(12)):
            name = f"emergency-brake,ttc_s={threshold:g},brake_mps2={braking:g}"
            command = [crumple, "suite", "run", "fmvss-127", "--controller", name]
            lines = subprocess.run(command, capture_output=True, text=True).stdout.split("\nS9 ")[0]
            if len(re.findall(r" emergency-brake\S*: PASSED, ", lines)) == 3:
                found.append(f"{braking:g} {'from' if found else 'm/s² from'} {threshold:g} s")
                break
    if page:
        check_page(page, {}, [", ".join(found)], False)
    else:
        print(", ".join(found))


if __name__ == "__main__":
    is_written = "--write" in sys.argv
    arguments = [one for one in sys.argv[1:] if one != "--write"]
    page = lambda place: Path(arguments[place]) if len(arguments) > place else None
    if arguments[:1] == ["sensitivity"] and len(arguments) in (3, 4):
        sensitivity(Path(arguments[1]).resolve(), Path(arguments[2]), page(3), is_written)
    elif arguments[:1] == ["mildest"] and len(arguments) in (2, 3):
        mildest(Path(arguments[1]).resolve(), page(2))
    elif len(arguments) in (1, 2) and (Path(arguments[0]) / "runs.csv").is_file():
        show(Path(arguments[0]), page(1), is_written)
    else:
        sys.exit(__doc__)
