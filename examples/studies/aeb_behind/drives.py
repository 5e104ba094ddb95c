"""Results of the drives of the study, by controller and group of emergencies, with their statistics."""

import csv
import functools
import math
import random
from collections import defaultdict
from operator import itemgetter

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
